//! The Pico's image in the exact virtual time of its emulator: behaviour of a board's serial line, step timer
//! and flash that a bench cannot show.
//!
//! `cargo xtask test` builds the images, sets `DRIVETWIN_IMAGES` to their folder and `DRIVETWIN_UF2` to the
//! UF2 with all of them, and runs these tests. The pins are those of firmware/boards/rp2040/README.md, typed by hand.
#![allow(missing_docs, reason = "a test")]

mod kinds;
mod line;
mod load;
mod memory;
mod motion;
mod pins;
mod play;
mod qsb;
mod reset;
mod rs434;
mod usb;

use std::path::PathBuf;

use drivetwin_protocol::modbus::rtu;

use self::play::{MS, Nanos, Run, Script};

/// Pins for the direction of RS-485, STEP and DIR.
mod pin {
    pub(crate) const DE: u8 = 2;
    pub(crate) const STEP: u8 = 3;
    pub(crate) const DIR: u8 = 4;
}

/// The image of an MD3.
fn image() -> PathBuf {
    image_of("md3")
}

/// The image of a kind of drive.
fn image_of(kind: &str) -> PathBuf {
    let folder =
        std::env::var_os("DRIVETWIN_IMAGES").expect("DRIVETWIN_IMAGES names the folder of the images");
    PathBuf::from(folder).join(kind)
}

/// Duration of a character at 9600 8E1, 11 bits.
const CHARACTER: Nanos = 11_000_000_000 / 9_600;

/// Time of the first request to a board that starts at 0. Before, the board copies itself to RAM.
const START: Nanos = 40 * MS;

/// Time for a request of one register and its reply at 9600 baud, with t3.5 after both.
const TURN: Nanos = 40 * MS;

/// Writes registers one after the other, starting at `at`; returns the time after the last reply.
fn write(script: &mut Script, at: Nanos, writes: &[(u16, u16)]) -> Nanos {
    let mut at = at;
    for &(register, value) in writes {
        script.hear(at, &rtu::write(1, register, value));
        at += TURN;
    }
    at
}

/// Asserts that every write was answered with itself (6.2 of the MD3's guide).
fn expect_written(run: &Run, at: Nanos, writes: &[(u16, u16)]) {
    for (n, &(register, value)) in (0..).zip(writes) {
        let from = at + n * TURN;
        assert_eq!(run.sent(from, from + TURN).1, rtu::write(1, register, value).as_slice());
    }
}

/// Value of a register that was requested at `at`.
fn value(run: &Run, at: Nanos) -> u16 {
    let (_, reply) = run.sent(at, at + TURN);
    let pdu = rtu::verify_crc(&reply).unwrap_or_else(|| panic!("{reply:02x?} at {at} ns"));
    let [1, 3, 2, high, low] = *pdu else { panic!("{pdu:02x?} at {at} ns") };
    u16::from_be_bytes([high, low])
}
