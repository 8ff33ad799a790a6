//! After any sequence of actions a drive's indications agree: MotionControl (7.15), BUSY and the lights
//! (section 2), the current (7.2, 7.3), the motion.

use drivetwin_protocol::time::{Duration, Span};
use proptest::prelude::*;

use crate::rig::{RED, Rig, at, bit};

/// An action on a drive.
#[derive(Clone, Debug)]
enum Deed {
    Command(u16),
    Write(u16, u16),
    Low(&'static str),
    Open(&'static str),
    Fault(&'static str, bool),
    Wait(u64),
}

const PINS: [&str; 5] = ["J2.2", "J2.3", "J2.4", "J2.5", "J2.9"];

fn deed() -> impl Strategy<Value = Deed> {
    let pin = prop::sample::select(&PINS[..]);
    let fault = prop::sample::select(&["over_temperature", "over_current"][..]);
    let command = (0..6_u32).prop_map(|place| Deed::Command(1 << place));
    let speed = prop::sample::select(&[0_u16, 10, 500, 5_000, 40_000][..]);
    prop_oneof![
        4 => command,
        1 => Just(Deed::Command(0)),
        1 => Just(Deed::Command(bit::FAULT)),
        2 => any::<u16>().prop_map(|word| Deed::Write(at::PINS, word & 0x0FFF)),
        1 => (0..0x100_u16).prop_map(|word| Deed::Write(at::HOMING, word)),
        1 => (0..0x100_u16).prop_map(|steps| Deed::Write(at::MOVE_STEPS + 1, steps)),
        1 => (0..0x400_u16).prop_map(|steps| Deed::Write(at::HOME_OFFSET + 1, steps)),
        1 => (0..0x400_u16).prop_map(|steps| Deed::Write(at::PRE_HOME_OFFSET + 1, steps)),
        1 => speed.clone().prop_map(|speed| Deed::Write(at::SPEED + 1, speed)),
        1 => speed.prop_map(|speed| Deed::Write(at::ALTERNATE_SPEED + 1, speed)),
        1 => (0..3_u16).prop_map(|n| Deed::Write(at::ACCEL_DECEL + 1, n * 20_000)),
        1 => (0..4_u16).prop_map(|tenths| Deed::Write(at::CURRENT_CUTBACK, tenths << 8 | 5)),
        1 => (1..3_u16).prop_map(|bits| Deed::Write(at::EEPROM, bits)),
        4 => pin.clone().prop_map(Deed::Low),
        4 => pin.prop_map(Deed::Open),
        1 => (fault, any::<bool>()).prop_map(|(fault, on)| Deed::Fault(fault, on)),
        4 => (1..1_000_000_u64).prop_map(Deed::Wait),
    ]
}

/// Asserts that all indications agree at this instant. It reads registers directly, because a request over
/// the bus takes time.
fn agrees(rig: &Rig) {
    let shown = rig.peek("MotionControl");
    let runs = shown & (bit::MOVE | bit::JOG | bit::HOME | bit::DECEL_STOP);
    let off = shown & (bit::DISABLE | bit::FAULT) != 0;
    let dc = rig.peek("MotorCurrentAndMicrostepping") & 1 << 13 != 0;
    assert!(runs.count_ones() <= 1, "one motion at a time: {shown:#06x}");
    assert_eq!(shown & !(runs | bit::DISABLE | bit::FAULT), 0, "{shown:#06x}");
    assert!(runs == 0 || !off, "{shown:#06x}");
    let turns = if dc { rig.duty() != 0 } else { runs != 0 };
    assert_eq!(rig.busy(), turns || shown & bit::FAULT != 0, "{shown:#06x}");
    if dc {
        assert_eq!(rig.moving(), turns, "{shown:#06x}");
        assert_eq!((rig.position(), rig.speed()), (0, 0.0));
        assert!(runs & (bit::MOVE | bit::HOME) == 0 && (runs != 0 || !turns), "{shown:#06x}");
    }
    let pin_3_low = rig.peek("IOPortData") & 1 << 2 == 0;
    let pins = rig.peek("PinFunctionAndPolarity");
    let inhibited = pins >> 8 & 3 == 0 && pin_3_low != (pins & 1 << 2 != 0);
    let current = match (off || inhibited, rig.lit(RED)) {
        (true, _) => 0,
        (false, true) => 500,
        (false, false) => 1_000,
    };
    assert_eq!(rig.current(), current, "{shown:#06x}");
    if runs == 0 || current == 0 {
        assert_eq!((rig.moving(), rig.speed(), rig.duty()), (false, 0.0, 0), "{shown:#06x}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn section_7_15_what_is_shown_agrees(dc: bool, deeds in proptest::collection::vec(deed(), 1..60)) {
        let mut rig = Rig::ready();
        rig.write(at::CURRENT_CUTBACK, 5);
        rig.write(at::CURRENT_AND_MICROSTEPPING, if dc { 0x220a } else { 0x030a });
        rig.save();
        for deed in deeds {
            match deed {
                Deed::Command(bits) => rig.command(bits),
                Deed::Write(address, value) => rig.write(address, value),
                Deed::Low(pin) => rig.low(pin),
                Deed::Open(pin) => rig.open(pin),
                Deed::Fault(fault, on) => rig.fault(fault, on),
                Deed::Wait(micros) => rig.after(micros.micros()),
            }
            agrees(&rig);
            rig.after(Duration::TICK);
            agrees(&rig);
        }
    }
}
