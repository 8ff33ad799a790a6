//! Settings of a line, as a computer sets them at a serial port of a USB device (PSTN subclass 1.2, 6.3.11).
#![allow(missing_docs, reason = "a test")]

use drivetwin_board::line_of;
use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;

#[test]
fn settings_of_a_uart_are_a_line() {
    assert_eq!(line_of([0x80, 0x25, 0, 0, 0, 2, 8]), Some(Line::new(9_600, 8, Parity::Even, 1)));
    assert_eq!(line_of([0x00, 0xC2, 0x01, 0, 2, 1, 7]), Some(Line::new(115_200, 7, Parity::Odd, 2)));
    assert_eq!(line_of([0x00, 0x84, 0x03, 0, 0, 0, 8]), Some(Line::new(230_400, 8, Parity::None, 1)));
    assert_eq!(line_of([0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 8]), Some(Line::new(u32::MAX, 8, Parity::None, 1)));
}

#[test]
fn other_settings_are_none() {
    let others =
        [[0, 0, 5], [0, 0, 6], [0, 0, 9], [0, 0, 16], [1, 0, 8], [3, 0, 8], [0, 3, 8], [0, 4, 8], [0, 5, 8]];
    for [stop, parity, data] in others {
        let coding = [0x80, 0x25, 0, 0, stop, parity, data];
        assert_eq!(line_of(coding), None, "{coding:?}");
    }
    assert_eq!(line_of([0, 0, 0, 0, 0, 0, 8]), None, "no baud rate");
}
