//! The MD3 User Guide V1.7 as tests: its tables, and each section of chapter 7 with its examples. The tests
//! see the drive as a master does, over the bus and the pins. Values and times are typed from the guide, or
//! follow from the arithmetic of constant acceleration given in comments.
//!
//! Where the guide is silent or contradicts itself, a decision of the project applies (docs/decisions:
//! `MD3-5`, `MODBUS-2`). Numbers like 7.8 are sections of the guide.
#![allow(missing_docs, reason = "a test")]

mod agreement;
mod bus;
mod eeprom;
mod homing;
mod io_encoder;
mod motion;
mod pins_2_3;
mod pins_4_5;
mod rig;
mod settings;
mod start_up;

use rig::Rig;

/// The table at the head of chapter 7, with the serial number of the emulated drive.
const DEFAULTS: [u16; 32] = [
    0x0001, 0x030a, 0x0000, 0x0000, // DeviceAddress … StartupDelay
    0x0000, 0x0000, 0x0000, 0x0000, // HomingConfiguration … HomeOffsetHigh
    0x0000, 0x0000, 0x000f, 0x0000, // HomeOffsetLow … Reserved
    0x0005, 0x0f9f, 0x0000, 0x0000, // QuadratureEncoderConfiguration … EncoderIndexCountLow
    0x0000, 0x0000, 0x0000, 0x2710, // QuadratureEncoderCount … MoveStepsLow
    0x0000, 0x1388, 0x0000, 0x09c4, // SpeedHigh … AlternateSpeedLow
    0x0000, 0x2710, 0x9a00, 0xbd01, // AccelDecelHigh … ProductInformation
    0x0021, 0x0000, 0x0000, 0x0001, // SerialPortConfiguration … SerialNumberLow
];

/// A single read returns all 32 registers, including the reserved 0x0b.
#[test]
fn section_7_initial_values_in_one_read() {
    assert_eq!(Rig::ready().words(0x00, 32), DEFAULTS);
    let mut low = DEFAULTS;
    low[0x1b] = 0x3d01;
    assert_eq!(Rig::ready_kind("md3-low").words(0x00, 32), low);
}

#[test]
fn section_7_initial_values_one_by_one() {
    let mut rig = Rig::ready();
    for (address, default) in (0..).zip(DEFAULTS) {
        assert_eq!(rig.read(address), default, "register {address:#04x}");
    }
}

#[test]
fn section_7_all_registers_can_be_written_but_four() {
    for address in 0x00..0x20 {
        // Reserved (7.10), product (7.21), serial number (7.24).
        let read_only = [0x0b, 0x1b, 0x1e, 0x1f].contains(&address);
        assert_eq!(Rig::ready().accepts(address, 0x0001), !read_only, "register {address:#04x}");
    }
}

/// MD3-2 and MD3-18: registers keep unused bits, and codes that the manual does not print.
#[test]
fn section_7_values_read_back_as_written() {
    let mut rig = Rig::ready();
    // Without 0x00 (takes 1 to 247), 0x0a (shows pins), 0x11 and 0x1a (commands), 0x1c (changes the line),
    // and the four read-only registers.
    for address in (0x01..=0x09).chain(0x0c..=0x10).chain(0x12..=0x19).chain([0x1d]) {
        for value in [0xFFFF, 0x0000, 0xA5C3] {
            rig.write(address, value);
            assert_eq!(rig.read(address), value, "register {address:#04x}");
        }
    }
}

/// Register names as in the manual, without slashes.
#[test]
fn section_7_register_names() {
    let rig = Rig::ready();
    let registers = rig.bench.spec(rig.seat).registers;
    let names = [
        "DeviceAddress MotorCurrentAndMicrostepping CurrentCutbackSettings StartupDelay",
        "HomingConfiguration PreHomeOffsetHigh PreHomeOffsetLow HomeOffsetHigh HomeOffsetLow",
        "PinFunctionAndPolarity IOPortData Reserved QuadratureEncoderConfiguration",
        "QuadratureEncoderMaxCount EncoderIndexCountHigh EncoderIndexCountLow QuadratureEncoderCount",
        "MotionControl MoveStepsHigh MoveStepsLow SpeedHigh SpeedLow AlternateSpeedHigh",
        "AlternateSpeedLow AccelDecelHigh AccelDecelLow EEPROMControl ProductInformation",
        "SerialPortConfiguration UserRegister SerialNumberHigh SerialNumberLow",
        "PreHomeOffset HomeOffset EncoderIndexCount MoveSteps Speed AlternateSpeed AccelDecel SerialNumber",
    ];
    for name in names.iter().flat_map(|line| line.split(' ')) {
        assert!(registers.find(name).is_some(), "{name}");
    }
}
