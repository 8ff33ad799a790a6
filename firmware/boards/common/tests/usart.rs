//! Register values of an STM32's USART for the settings of a line.
#![allow(missing_docs, reason = "a test")]

use drivetwin_board::Usart;
use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

/// Clock of a Black Pill's USART in MHz, and the clock for slow lines.
const CLOCKS: [u32; 2] = [96, 24];

#[test]
fn a_bit_is_as_long_as_the_manual_says() {
    // For 9,600 baud, 96 MHz is divided by 625, which is 10,000 cycles in sixteenths; for 115,200 baud by
    // 52.0625, which is 833 (19.3.4). If a character does not take whole ticks, each bit may be one cycle
    // shorter.
    for (baud, bit) in [(9_600, 10_000), (10_000, 9_600), (19_200, 5_000), (115_200, 833)] {
        let usart = Usart::new(96, Line::new(baud, 8, Parity::None, 1));
        let usart = usart.unwrap_or_else(|| panic!("{baud} baud cannot be set"));
        assert!((bit - 1..=bit).contains(&usart.bit), "{baud}: {} cycles", usart.bit);
    }
}

#[test]
fn a_character_takes_no_longer_than_the_drive_believes() {
    for baud in [
        600, 1_200, 2_400, 4_800, 9_600, 14_400, 19_200, 38_400, 56_000, 57_600, 115_200, 128_000, 230_400,
        256_000,
    ] {
        let line = Line::new(baud, 8, Parity::None, 1);
        let settings = CLOCKS.map(|mhz| (mhz, Usart::new(mhz, line)));
        let Some((mhz, usart)) = settings.into_iter().find_map(|(mhz, usart)| Some((mhz, usart?))) else {
            panic!("{baud} baud cannot be set");
        };
        // The register for the cycles of a bit has 16 bits.
        assert_eq!(mhz, if baud < 96_000_000 / 0xFFFF { 24 } else { 96 }, "{baud}");
        let character = 10.0 * f64::from(usart.bit) / f64::from(mhz);
        let believed = line.character().ticks() as f64 / 16.0;
        assert!((believed - 10.0 / f64::from(mhz)..=believed).contains(&character), "{baud}: {character} µs");
        let right = 10e6 / f64::from(baud);
        assert!((character / right - 1.0).abs() < 0.002, "{baud}: {character} µs, not {right}");
    }
}

#[test]
fn a_bit_that_it_cannot_count_is_refused() {
    assert_eq!(Usart::new(96, Line::new(600, 8, Parity::None, 1)), None);
    assert_eq!(Usart::new(1, Line::new(115_200, 8, Parity::None, 1)), None);
}

#[test]
fn the_format_is_that_of_the_line() {
    // Bits M (12), PCE (10) and PS (9) of CR1; STOP (bits 13 and 12) of CR2 (19.6.4, 19.6.5).
    for (data, parity, stop, control, stops, mask) in [
        (8, Parity::None, 1, 0, 0, 0xFF),
        (8, Parity::None, 2, 0, 0x2000, 0xFF),
        (8, Parity::Even, 1, 0x1400, 0, 0xFF),
        (8, Parity::Odd, 1, 0x1600, 0, 0xFF),
        (7, Parity::Even, 1, 0x0400, 0, 0x7F),
        (7, Parity::Odd, 1, 0x0600, 0, 0x7F),
    ] {
        let usart = Usart::new(96, Line::new(9_600, data, parity, stop));
        let format = usart.map(|usart| (usart.control, usart.stop, usart.mask));
        assert_eq!(format, Some((control, stops, mask)), "{data} {parity:?} {stop}");
    }
}
