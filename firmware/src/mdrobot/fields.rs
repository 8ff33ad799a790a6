//! Fields of PIDs, with the values of the manual's tables.

use drivetwin_protocol::registers::Field;

/// p. 8.
pub(super) const HALL_TYPE: &[Field] = &[Field::whole(&[
    (0, "4 poles"),
    (1, "8 poles"),
    (2, "10 poles"),
    (3, "12 poles"),
    (4, "2 poles"),
    (5, "6 poles"),
])];

/// p. 8.
pub(super) const STOP_STATUS: &[Field] =
    &[Field::whole(&[(0, "free"), (1, "speed control at zero"), (2, "electric brake"), (3, "free at once")])];

/// p. 8.
pub(super) const INPUT_TYPE: &[Field] =
    &[Field::whole(&[(0, "analogue or PWM"), (1, "joystick"), (2, "pulses"), (3, "RC"), (5, "seven steps")])];

/// p. 9.
pub(super) const CTRL_STATUS: &[Field] = &[
    Field::bit(0, "ALARM: any alarm"),
    Field::bit(1, "CTRL_FAIL"),
    Field::bit(2, "OVER_VOLT"),
    Field::bit(3, "OVER_TEMP"),
    Field::bit(4, "OVER_LOAD"),
    Field::bit(5, "HALL_FAIL"),
    Field::bit(6, "INV_VEL"),
    Field::bit(7, "STALL"),
];

/// p. 9.
pub(super) const LIMIT_STOP: &[Field] = &[Field::whole(&[(0, "free"), (1, "electric brake")])];

/// p. 11.
pub(super) const DI: &[Field] = &[
    Field::bit(0, "INT_SPEED"),
    Field::bit(1, "ALARM_RESET"),
    Field::bit(2, "DIR"),
    Field::bit(3, "RUN/BRAKE"),
    Field::bit(4, "START/STOP"),
    Field::bit(5, "ENC_B"),
    Field::bit(6, "ENC_A"),
];

/// p. 7.
pub(super) const UI_COM: &[Field] = &[Field::whole(&[(0, "the CTRL connector"), (1, "the bus")])];

/// p. 12.
pub(super) const START_STOP: &[Field] = &[Field::whole(&[(0, "stop"), (1, "CCW"), (2, "CW")])];

/// p. 15.
pub(super) const FUNCTION: &[Field] = &[Field::bits(7, 0, "DL").values(&[
    (0, "none"),
    (1, "SPEED"),
    (2, "POSITION"),
    (3, "SPEED_MOMENTARY"),
    (4, "SPEED_ADD"),
])];
