//! The digital port: registers 01 and 02 and the pins.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::Span;

use crate::rig::Rig;

/// DIO3 to DIO0.
const PINS: [&str; 4] = ["DIO3", "DIO2", "DIO1", "DIO0"];

/// Examples 6.1 and 6.3: as inputs all pins are pulled up. Register 01 reads their levels.
#[test]
fn inputs() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02000");
    assert_eq!(rig.read("01"), 0xF);
    for value in [0x0, 0x5, 0xA, 0x7, 0xE, 0xF, 0x1, 0x8] {
        for (n, pin) in (0..4).rev().zip(PINS) {
            rig.hold(pin, value >> n & 1 == 1);
        }
        assert_eq!(rig.read("01"), value);
    }
    for pin in PINS {
        rig.open(pin);
    }
    assert_eq!(rig.read("01"), 0xF);
}

/// Examples 6.2 and 6.4: outputs are open drain.
#[test]
fn outputs() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02F00");
    for value in 0..=0xF_u32 {
        rig.write(&format!("W01{value:X}"));
        assert_eq!(rig.read("01"), value);
        for (n, pin) in (0..4).rev().zip(PINS) {
            assert_eq!(rig.level(pin) == Level::Low, value >> n & 1 == 0, "{pin} of {value:X}");
        }
    }
}

/// "A read returns the actual state measured": an external low pulls down an output that is 1. An output that
/// is 0 stays low.
#[test]
fn pins_are_read_not_latches() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02F00");
    rig.write("W01C");
    for pin in PINS {
        rig.low(pin);
    }
    assert_eq!(rig.read("01"), 0x0);
    for pin in PINS {
        rig.high(pin);
    }
    assert_eq!(rig.read("01"), 0xC);
}

/// "All I/O port pins will be set high after a write to this configuration register", each time.
#[test]
fn a_write_of_the_configuration_releases_all_outputs_to_high() {
    let mut rig = Rig::ready("qsb-m");
    for config in ["W02F00", "W02F00", "W020F5", "W02300"] {
        rig.write("W02F00");
        rig.write("W010");
        assert_eq!(rig.read("01"), 0);
        rig.write(config);
        assert_eq!(rig.read("01"), 0xF);
        assert!(PINS.iter().all(|pin| rig.is_high(pin)), "{config}");
    }
    // A refused write of the configuration does not release the outputs.
    rig.write("W02F00");
    rig.write("W016");
    rig.says(&[("W022000", "e 02 00002000 !"), ("R01", "r 01 00000006 !")]);
}

/// Inputs and outputs together. An input does not drive its pin.
#[test]
fn some_of_each() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W02500");
    rig.write("W010");
    // DIO2 and DIO0 are outputs, DIO3 and DIO1 are inputs.
    assert_eq!(rig.read("01"), 0xA);
    rig.low("DIO3");
    assert_eq!(rig.read("01"), 0x2);
    assert!(rig.is_high("DIO1"));
}

/// A QSB-D has only DIO0. The other bits read 1 (QSB-23).
#[test]
fn one_line() {
    let mut rig = Rig::ready("qsb-d");
    rig.write("W02F00");
    rig.write("W010");
    assert_eq!(rig.read("01"), 0xE);
    assert!(!rig.is_high("DIO0"));
    let names: Vec<&str> = rig.bench.spec(rig.seat).pins.iter().map(|pin| pin.name).collect();
    assert!(!names.contains(&"DIO1") && !names.contains(&"DIO3"));
}

/// Example 6.5: "a new I/O state is output only if the I/O bit state has changed".
#[test]
fn streamed() {
    let mut rig = Rig::ready("qsb-m");
    rig.says(&[("S01", "s 01 0000000F !")]);
    rig.low("DIO2");
    assert_eq!(rig.texts(10.millis()), ["s 01 0000000B !"]);
    rig.low("DIO2");
    assert_eq!(rig.texts(1.secs()), [""; 0]);
    rig.says(&[("W02F00", "w 02 00000F00 !"), ("W01C", "w 01 0000000C !")]);
    // The test still holds DIO2 low.
    assert_eq!(rig.texts(10.millis()), ["s 01 00000008 !"]);
    rig.says(&[("R01", "r 01 00000008 !"), ("W010", "w 01 00000000 !")]);
    assert_eq!(rig.texts(1.secs()), [""; 0]);
}
