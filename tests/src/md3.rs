//! Access to an MD3 for tests: its registers and bits as in the manual, and writes over the bus.

use drivetwin_protocol::modbus::rtu;
use drivetwin_sim::bench::{Bench, DriveId};

/// First addresses of the registers, as in the table at the head of chapter 7. A pair has its high half
/// first.
pub mod at {
    /// Section 7.1
    pub const DEVICE_ADDRESS: u16 = 0x00;
    /// Section 7.2
    pub const CURRENT_AND_MICROSTEPPING: u16 = 0x01;
    /// Section 7.3
    pub const CURRENT_CUTBACK: u16 = 0x02;
    /// Section 7.4
    pub const STARTUP_DELAY: u16 = 0x03;
    /// Section 7.5
    pub const HOMING: u16 = 0x04;
    /// Section 7.6, a pair
    pub const PRE_HOME_OFFSET: u16 = 0x05;
    /// Section 7.7, a pair
    pub const HOME_OFFSET: u16 = 0x07;
    /// Section 7.8
    pub const PINS: u16 = 0x09;
    /// Section 7.9
    pub const IO_PORT: u16 = 0x0a;
    /// Section 7.11
    pub const ENCODER: u16 = 0x0c;
    /// Section 7.12
    pub const MAX_COUNT: u16 = 0x0d;
    /// Section 7.13, a pair
    pub const INDEX_COUNT: u16 = 0x0e;
    /// Section 7.14
    pub const ENCODER_COUNT: u16 = 0x10;
    /// Section 7.15
    pub const MOTION: u16 = 0x11;
    /// Section 7.16, a pair
    pub const MOVE_STEPS: u16 = 0x12;
    /// Section 7.17, a pair
    pub const SPEED: u16 = 0x14;
    /// Section 7.18, a pair
    pub const ALTERNATE_SPEED: u16 = 0x16;
    /// Section 7.19, a pair
    pub const ACCEL_DECEL: u16 = 0x18;
    /// Section 7.20
    pub const EEPROM: u16 = 0x1a;
    /// Section 7.21
    pub const PRODUCT: u16 = 0x1b;
    /// Section 7.22
    pub const SERIAL_PORT: u16 = 0x1c;
    /// Section 7.23
    pub const USER: u16 = 0x1d;
    /// Section 7.24, a pair
    pub const SERIAL_NUMBER: u16 = 0x1e;
}

/// The bits of MotionControl (7.15).
pub mod bit {
    /// A profile move.
    pub const MOVE: u16 = 1 << 0;
    /// A jog.
    pub const JOG: u16 = 1 << 1;
    /// A home cycle.
    pub const HOME: u16 = 1 << 2;
    /// Stops at once.
    pub const STOP: u16 = 1 << 3;
    /// Stops with a ramp.
    pub const DECEL_STOP: u16 = 1 << 4;
    /// Switches the current off.
    pub const DISABLE: u16 = 1 << 5;
    /// Read: there is a fault. Written: clears the fault.
    pub const FAULT: u16 = 1 << 15;
}

/// Writes a register of the drive at address 1; the reply is the request itself (6.2).
///
/// # Panics
///
/// If the drive answers anything else.
#[track_caller]
pub fn write(bench: &mut Bench, md3: DriveId, address: u16, value: u16) {
    let request = rtu::write(1, address, value);
    assert_eq!(bench.ask(md3, &request), request.as_slice(), "{value:#06x} to {address:#04x}");
}

/// Writes both halves of a pair, the high one first.
///
/// # Panics
///
/// Same as [`write()`].
#[track_caller]
pub fn write_pair(bench: &mut Bench, md3: DriveId, first: u16, value: u32) {
    write(bench, md3, first, (value >> 16) as u16);
    write(bench, md3, first + 1, value as u16);
}
