//! Register values of a PL011 for the settings of a line.
#![allow(missing_docs, reason = "a test")]

use drivetwin_board::Pl011;
use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

#[test]
fn a_character_takes_no_longer_than_the_drive_believes() {
    // The manual's example (3.3.6): for 230,400 baud from 4 MHz the divisor is 1 and 5/64.
    let example = Pl011::new(4, Line::new(230_400, 8, Parity::None, 1));
    assert_eq!((example.divisor, example.divisor_64ths), (1, 5));
    for (mhz, baud) in [50_u32, 125].into_iter().flat_map(|mhz| {
        [600_u32, 1_200, 9_600, 14_400, 19_200, 38_400, 56_000, 57_600, 115_200, 128_000, 230_400, 256_000]
            .map(|baud| (mhz, baud))
    }) {
        let line = Line::new(baud, 8, Parity::None, 1);
        let settings = Pl011::new(mhz, line);
        let divisor = f64::from(settings.divisor) + f64::from(settings.divisor_64ths) / 64.0;
        let character = 10.0 * 16.0 * divisor / f64::from(mhz);
        let believed = line.character().ticks() as f64 / 16.0;
        let least = believed - 10.0 * 16.0 / 64.0 / f64::from(mhz);
        assert!((least..=believed).contains(&character), "{baud}: {character} µs, not {believed}");
        let right = 10e6 / f64::from(baud);
        assert!((character / right - 1.0).abs() < 0.002, "{baud}: {character} µs, not {right}");
    }
}

#[test]
fn the_format_is_that_of_the_line() {
    // The bits of the register, from bit 7 down: stick parity, WLEN, FEN, STP2, EPS, PEN, BRK (3.3.7).
    for (data, parity, stop, format) in [
        (8, Parity::None, 1, 0b0110_0000),
        (8, Parity::Even, 1, 0b0110_0110),
        (8, Parity::Odd, 1, 0b0110_0010),
        (8, Parity::None, 2, 0b0110_1000),
        (7, Parity::Even, 1, 0b0100_0110),
        (7, Parity::Odd, 1, 0b0100_0010),
    ] {
        assert_eq!(Pl011::new(50, Line::new(9_600, data, parity, stop)).format, format);
    }
}
