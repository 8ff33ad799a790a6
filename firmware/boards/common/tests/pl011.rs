//! The settings of a PL011 for a line.
#![allow(missing_docs, reason = "a test")]

use standin_board::Pl011;
use standin_firmware::device::Line;
use standin_protocol::line::Parity;

#[test]
fn the_divisor_is_the_nearest() {
    // The manual's example (3.3.6): 230,400 baud from 4 MHz are 1 and 5/64.
    let example = Pl011::new(4_000_000, Line::new(230_400, 8, Parity::None, 1));
    assert_eq!((example.divisor, example.divisor_64ths), (1, 5));
    for baud in [1_200_u32, 9_600, 19_200, 57_600, 115_200] {
        let settings = Pl011::new(125_000_000, Line::new(baud, 8, Parity::None, 1));
        let divisor = f64::from(settings.divisor) + f64::from(settings.divisor_64ths) / 64.0;
        let exact = 125e6 / 16.0 / f64::from(baud);
        assert!((divisor - exact).abs() <= 0.5 / 64.0, "{baud}: {divisor}, not {exact}");
    }
}

#[test]
fn the_format_is_that_of_the_line() {
    // Stick parity, WLEN, FEN, STP2, EPS, PEN, BRK, from bit 7 down (3.3.7).
    for (data, parity, stop, format) in [
        (8, Parity::None, 1, 0b0110_0000),
        (8, Parity::Even, 1, 0b0110_0110),
        (8, Parity::Odd, 1, 0b0110_0010),
        (8, Parity::None, 2, 0b0110_1000),
        (7, Parity::Even, 1, 0b0100_0110),
    ] {
        assert_eq!(Pl011::new(50_000_000, Line::new(9_600, data, parity, stop)).format, format);
    }
}
