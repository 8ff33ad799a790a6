//! Fields of registers, with the names and values of chapter 7.

use drivetwin_protocol::registers::Field;

const POLARITY: &[(u16, &str)] = &[(0, "active low"), (1, "active high")];

/// 7.2.
pub(super) const MOTOR: &[Field] = &[
    Field::bit(13, "motor mode").values(&[(0, "stepper motor"), (1, "DC motor, jog only")]),
    Field::bits(12, 8, "microstepping, or PWM frequency of a DC motor").values(&[
        (0, "full step, or 500 Hz"),
        (1, "1/2 step, or 1 kHz"),
        (2, "1/4 step, or 2 kHz"),
        (3, "1/8 step, or 5 kHz"),
        (4, "1/16 step, or 10 kHz"),
        (5, "1/32 step, or 16 kHz"),
        (6, "1/64 step, or 20 kHz"),
        (7, "1/128 step, or 25 kHz"),
        (8, "1/256 step, or 40 kHz"),
    ]),
    Field::bits(7, 0, "phase current, a code of the table in 7.2"),
];

/// 7.3.
pub(super) const CUTBACK: &[Field] = &[
    Field::bits(15, 8, "timeout, in 0.1 s").values(&[(0, "no cutback")]),
    Field::bits(7, 0, "current, a code of the table in 7.2"),
];

/// 7.5.
pub(super) const HOMING: &[Field] = &[
    Field::bits(7, 5, "speed divisor, a power of 2"),
    Field::bit(4, "direction"),
    Field::bits(3, 1, "mode").values(&[
        (0, "switch at J2.2, stop at once"),
        (1, "switch at J2.2, decelerate"),
        (2, "encoder index at J2.9, stop at once"),
        (3, "encoder index at J2.9, decelerate"),
    ]),
    Field::bit(0, "home on startup"),
];

/// 7.8.
pub(super) const PINS: &[Field] = &[
    Field::bit(12, "use of J2.9, J2.10, J2.12").values(&[(0, "encoder inputs"), (1, "outputs")]),
    Field::bits(11, 10, "function of J2.2 while homing is by index").values(&[
        (0, "LOWCURRENT"),
        (1, "SPEEDSEL"),
        (2, "invalid"),
        (3, "invalid"),
    ]),
    Field::bits(9, 8, "function of J2.3").values(&[
        (0, "INHIBIT"),
        (1, "HOME"),
        (2, "INHIBIT_MODBUS_MOTION"),
        (3, "invalid"),
    ]),
    Field::bits(7, 4, "functions of J2.4 and J2.5").values(&[
        (0, "step, direction"),
        (1, "profile move, direction"),
        (2, "profile move forward and backward, none"),
        (3, "profile move forward and home, none"),
        (4, "profile move forward, backward"),
        (5, "profile move forward, home"),
        (6, "jog, direction"),
        (7, "jog forward, backward"),
        (8, "profile moves forward and backward without end"),
        (9, "profile move and home without end"),
        (15, "none"),
    ]),
    Field::bit(3, "polarity of J2.2").values(POLARITY),
    Field::bit(2, "polarity of J2.3").values(POLARITY),
    Field::bit(1, "polarity of J2.4").values(POLARITY),
    Field::bit(0, "polarity of J2.5").values(POLARITY),
];

/// 7.9.
pub(super) const PORT: &[Field] = &[
    Field::bit(7, "output J3.8"),
    Field::bit(6, "output J2.9"),
    Field::bit(5, "output J2.10"),
    Field::bit(4, "output J2.12"),
    Field::bit(3, "input J2.2"),
    Field::bit(2, "input J2.3"),
    Field::bit(1, "input J2.4"),
    Field::bit(0, "input J2.5"),
];

/// 7.11.
pub(super) const ENCODER: &[Field] = &[
    Field::bit(9, "noise filter on"),
    Field::bits(8, 6, "clock of the noise filter").values(&[
        (0, "40 MHz"),
        (1, "20 MHz"),
        (2, "10 MHz"),
        (3, "2.5 MHz"),
        (4, "1.25 MHz"),
        (5, "625 kHz"),
        (6, "312.5 kHz"),
        (7, "156.25 kHz"),
    ]),
    Field::bits(5, 4, "index valid when").values(&[
        (0, "x4: B=0, A=0; x2: A=0"),
        (1, "x4: B=0, A=1; x2: A=1"),
        (2, "x4: B=1, A=0; x2: B=0"),
        (3, "x4: B=1, A=1; x2: B=1"),
    ]),
    Field::bit(3, "A and B swapped"),
    Field::bits(2, 1, "mode").values(&[
        (0, "x2, reset by the index"),
        (1, "x2, reset at QuadratureEncoderMaxCount"),
        (2, "x4, reset by the index"),
        (3, "x4, reset at QuadratureEncoderMaxCount"),
    ]),
    Field::bit(0, "index clears the counter"),
];

/// 7.15.
pub(super) const MOTION: &[Field] = &[
    Field::bit(15, "Fault; writing 1 clears it"),
    Field::bit(5, "Disable: no motor current"),
    Field::bit(4, "Decel-stop"),
    Field::bit(3, "Stop at once"),
    Field::bit(2, "Home"),
    Field::bit(1, "Jog"),
    Field::bit(0, "Move"),
];

/// 7.20.
pub(super) const EEPROM: &[Field] = &[
    Field::bits(15, 8, "CRC status").values(&[(0x00, "written"), (0x9a, "pass"), (0xf1, "fail")]),
    Field::bit(1, "read from the EEPROM"),
    Field::bit(0, "write to the EEPROM"),
];

/// 7.21.
pub(super) const PRODUCT: &[Field] = &[
    Field::bit(15, "current").values(&[(0, "1.8 A"), (1, "7 A")]),
    Field::bits(14, 8, "product").values(&[(0x3d, "MD3")]),
    Field::bits(7, 0, "version of the firmware"),
];

/// 7.22. Parity code 3 is not in the manual (MD3-9).
pub(super) const SERIAL: &[Field] = &[
    Field::bits(5, 4, "parity").values(&[(0, "none"), (1, "odd"), (2, "even")]),
    Field::bit(3, "stop bits").values(&[(0, "1"), (1, "2")]),
    Field::bits(2, 0, "baud rate").values(&[
        (0, "4800"),
        (1, "9600"),
        (2, "19200"),
        (3, "38400"),
        (4, "57600"),
        (5, "115200"),
        (6, "230400"),
        (7, "460800"),
    ]),
];
