//! Fields of registers, with the values of chapter 6.

use drivetwin_protocol::registers::Field;

/// 6.3.
pub(super) const STATUS: &[Field] = &[Field::whole(&[(0, "stopped"), (1, "forward"), (2, "backward")])];

/// 6.3.
pub(super) const PROGRAM: &[Field] = &[Field::whole(&[
    (1, "stopped by the bus"),
    (2, "started by the bus"),
    (3, "started by power-on"),
    (4, "running"),
    (5, "ended by END"),
    (6, "ended by ENDF"),
    (7, "ended by an error"),
])];

/// 6.4.
pub(super) const TYPE: &[Field] =
    &[Field::whole(&[(1, "ASCII 7E1"), (2, "ASCII 7O1"), (3, "RTU 8E1"), (4, "RTU 8O1"), (5, "RTU 8N2")])];

/// 6.4.
pub(super) const BITRATE: &[Field] = &[Field::whole(&[
    (0, "600"),
    (1, "1200"),
    (2, "2400"),
    (3, "4800"),
    (4, "9600"),
    (5, "14400"),
    (6, "19200"),
    (7, "38400"),
    (8, "57600"),
    (9, "115200"),
    (10, "128000"),
])];

/// 6.5.
pub(super) const MODE_DEVICE: &[Field] = &[Field::whole(&[(1, "the bus"), (2, "the inputs")])];

/// 6.5.
pub(super) const MODE_PROGRAM: &[Field] =
    &[Field::whole(&[(1, "stop"), (2, "start"), (3, "start at power-on, if saved")])];

/// 6.5.
pub(super) const MODE_ROTATION: &[Field] = &[Field::whole(&[
    (1, "continuous rotation"),
    (2, "move by OFFSET"),
    (3, "move to the position that POSITION_N selects"),
])];

/// 6.5.
pub(super) const MODE_EXT_IN: &[Field] = &[Field::whole(&[
    (1, "IN1 pulse starts and stops, IN2 pulse reverses"),
    (2, "IN1 pulse starts and stops, IN2 level is the direction"),
    (3, "IN1 level runs, IN2 pulse reverses"),
    (4, "IN1 level runs, IN2 level is the direction"),
    (5, "IN1 level runs forward, IN2 level runs backward"),
])];

/// 6.5.
pub(super) const DIRECTION: &[Field] = &[Field::whole(&[(1, "forward"), (2, "backward")])];

/// 6.5.
pub(super) const MODE_COIL: &[Field] = &[Field::whole(&[(0, "open"), (1, "closed")])];

/// 6.5.
pub(super) const ERROR: &[Field] = &[
    Field::bit(0, "supply voltage out of range"),
    Field::bit(1, "short circuit of the motor"),
    Field::bit(2, "brake circuit too hot"),
    Field::bit(3, "power circuit too hot"),
    Field::bit(4, "Hall sensors"),
    Field::bit(5, "emergency stop"),
    Field::bit(6, "processor too hot"),
    Field::bit(7, "test of the control program"),
    Field::bit(8, "user program"),
    Field::bit(9, "reading or writing of settings"),
    Field::bit(10, "output transistors"),
    Field::bit(11, "current limit exceeded"),
    Field::bit(12, "breakpoint cannot be calculated"),
    Field::bit(13, "written value out of range"),
    Field::bit(14, "parity on RS-485"),
    Field::bit(15, "positioning with fewer than two Hall sensors"),
];
