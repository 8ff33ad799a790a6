//! Tests of queues, and of the pins and faults to which the names of wires belong.
#![allow(missing_docs, reason = "a test")]

use drivetwin_board::{AxisPins, End, Queue, is_full_duplex};
use drivetwin_firmware::device::{Device, Fault, Pin, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_firmware::shell::BoardEvent;

#[test]
fn a_queue_keeps_the_order_and_refuses_what_does_not_fit() {
    let queue = Queue::<u8, 3>::new();
    assert!(queue.is_empty());
    assert_eq!([1, 2, 3, 4].map(|thing| queue.push(thing)), [true, true, true, false]);
    assert!(queue.is_full());
    assert_eq!(queue.len(), 3);
    assert_eq!(queue.pop_if(|first| *first == 2), None);
    assert_eq!(queue.pop_if(|first| *first == 1), Some(1));
    assert!(queue.push(5));
    assert_eq!([(); 4].map(|()| queue.pop()), [Some(2), Some(3), Some(5), None]);
    assert!(queue.is_empty());
}

#[test]
fn the_names_of_an_md3_are_its_pins_and_faults() {
    let md3 = Md3::new();
    let spec = md3.spec();
    let end = |name| End::of(spec, name).unwrap_or_else(|| panic!("an MD3 has no {name}"));
    // As in the table in firmware/boards/rp2040/README.md.
    let expected = [
        // Name; true if an input; true if the idle level is high; true if an open drain.
        ("J2.4", true, true, false),
        ("J2.9", true, false, false),
        ("J3.7", false, true, true),
        ("D5", false, false, false),
        ("over_current", true, true, false),
    ];
    for (name, is_input, rests_high, is_open_drain) in expected {
        assert_eq!(end(name).is_input(spec), is_input, "{name}");
        assert_eq!(end(name).rests_high(spec), rests_high, "{name}");
        assert_eq!(end(name).is_open_drain(spec), is_open_drain, "{name}");
    }
    assert_eq!(End::of(spec, "J9.1"), None);
}

#[test]
fn a_fault_is_there_while_its_wire_is_low() {
    assert_eq!(End::Fault(Fault(1)).edge(false), BoardEvent::Fault(Fault(1), true));
    assert_eq!(End::Fault(Fault(1)).edge(true), BoardEvent::Fault(Fault(1), false));
    assert_eq!(End::Pin(Pin(3)).edge(true), BoardEvent::Edge(Pin(3), true));
}

#[test]
fn the_names_of_an_rs434544_are_its_pins_and_faults() {
    let rs434 = Rs434::rs434544();
    let spec = rs434.spec();
    // As in the table in firmware/boards/rp2040/README.md: name; true if an input; true if the idle level is
    // high.
    let expected = [
        ("IN1", true, true),
        ("IN2", true, true),
        ("HARD_STOP", true, false),
        ("CLR_FLASH", true, true),
        ("RED", false, false),
        ("GREEN", false, false),
        ("supply_voltage", true, true),
        ("short_circuit", true, true),
        ("brake_overheat", true, true),
        ("power_overheat", true, true),
        ("hall", true, true),
        ("mcu_overheat", true, true),
        ("switches", true, true),
        ("current_limit", true, true),
        ("stall", true, true),
    ];
    for (name, is_input, rests_high) in expected {
        let end = End::of(spec, name).unwrap_or_else(|| panic!("an RS 434544 has no {name}"));
        assert_eq!(end.is_input(spec), is_input, "{name}");
        assert_eq!(end.rests_high(spec), rests_high, "{name}");
        assert!(!end.is_open_drain(spec), "{name}");
    }
    assert!(!is_full_duplex(spec));
}

#[test]
fn the_names_of_an_mdrobot_are_its_pins_and_faults() {
    let mdrobot = Mdrobot::md400();
    let spec = mdrobot.spec();
    // As in the table in firmware/boards/rp2040/README.md: name; true if an input; true if the idle level is
    // high.
    let expected = [
        ("INT_SPEED", true, true),
        ("ALARM_RESET", true, true),
        ("DIR", true, true),
        ("RUN_BRAKE", true, true),
        ("START_STOP", true, true),
        ("ENC_A", true, true),
        ("ENC_B", true, true),
        ("SPEED_IN", true, false),
        ("PULSE_IN", true, false),
        ("CLUTCH", false, false),
        ("FAN", false, false),
        ("over_voltage", true, true),
        ("over_temperature", true, true),
        ("hall_fail", true, true),
        ("inverse_velocity", true, true),
        ("stall", true, true),
    ];
    for (name, is_input, rests_high) in expected {
        let end = End::of(spec, name).unwrap_or_else(|| panic!("an MD400 has no {name}"));
        assert_eq!(end.is_input(spec), is_input, "{name}");
        assert_eq!(end.rests_high(spec), rests_high, "{name}");
        assert!(!end.is_open_drain(spec), "{name}");
    }
    assert!(!is_full_duplex(spec));
}

#[test]
fn the_names_of_a_qsb_are_its_pins_and_dtr() {
    let qsb = Qsb::m();
    let spec = qsb.spec();
    let end = |name| End::of(spec, name).unwrap_or_else(|| panic!("a QSB has no {name}"));
    for name in ["A", "B", "DIO1", "DTR"] {
        assert!(end(name).is_input(spec) && end(name).rests_high(spec), "{name}");
    }
    assert!(end("I").is_input(spec) && !end("I").rests_high(spec));
    assert_eq!(End::of(Qsb::s().spec(), "DIO0"), None);
    // A QSB detects its host. An MD3, which is on a bus, does not.
    assert_eq!(End::of(Md3::new().spec(), "DTR"), None);
    assert!(is_full_duplex(spec) && !is_full_duplex(Md3::new().spec()));
    // DTR# is low while the host is present.
    assert_eq!(end("DTR").edge(false), BoardEvent::HostPresence(Port(0), true));
    assert_eq!(end("DTR").edge(true), BoardEvent::HostPresence(Port(0), false));
}

#[test]
fn an_axis_has_pins_of_its_own_unless_they_are_wired_as_others() {
    let (md3, qsb) = (Md3::new(), Qsb::m());
    let wired = |name| [End::of(qsb.spec(), "A"), End::of(qsb.spec(), name)].into_iter();
    let Some(End::Pin(dio2)) = End::of(qsb.spec(), "DIO2") else { panic!("a QSB-M has DIO2") };
    assert_eq!(AxisPins::of(qsb.spec(), wired("DIO2")), AxisPins::Shared(dio2));
    assert_eq!(AxisPins::of(Qsb::s().spec(), wired("DIO2")), AxisPins::None);
    let wired = ["J2.4", "D5"].map(|name| End::of(md3.spec(), name));
    assert_eq!(AxisPins::of(md3.spec(), wired.into_iter()), AxisPins::Own);
    // The motor of an MDrive is inside the drive.
    assert_eq!(AxisPins::of(Mdrive::plus().spec(), [].into_iter()), AxisPins::None);
}
