//! Queues, and what the names of wires stand for.
#![allow(missing_docs, reason = "a test")]

use standin_board::{End, Queue};
use standin_firmware::device::{Device, Fault, Pin};
use standin_firmware::md3::Md3;
use standin_firmware::shell::Caught;

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
    // As the table in firmware/boards/rp2040/README.md has them.
    let expected = [
        // Name, is an input, rests high, is an open drain.
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
    assert_eq!(End::Fault(Fault(1)).edge(false), Caught::Fault(Fault(1), true));
    assert_eq!(End::Fault(Fault(1)).edge(true), Caught::Fault(Fault(1), false));
    assert_eq!(End::Pin(Pin(3)).edge(true), Caught::Edge(Pin(3), true));
}
