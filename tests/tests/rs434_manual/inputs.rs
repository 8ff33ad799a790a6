//! Section 6.1, and MODE_EXT_IN of section 6.5: the contacts IN1, IN2 and HARD_STOP.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{PinStimulus, PowerAction};
use drivetwin_tests::rs434::{BOOT, Rig, at};

/// Time longer than any ramp here, and longer than debouncing.
const WHILE: Duration = Duration::secs(1);

/// A drive that is controlled by its inputs.
fn by_inputs(mode_ext_in: u16) -> Rig {
    let mut rig = Rig::default();
    rig.write(at::MODE_EXT_IN, mode_ext_in);
    rig.write(at::MODE_DEVICE, 2);
    rig
}

/// A pulse: closes the contact for 50 ms, then opens it and waits.
fn pulse(rig: &mut Rig, contact: &str) {
    rig.close(contact);
    rig.after(50.millis());
    rig.open(contact);
    rig.after(WHILE);
}

#[track_caller]
fn assert_turns(rig: &mut Rig, status: u16, direction: u16) {
    assert_eq!((rig.read(at::STATUS), rig.read(at::DIRECTION)), (status, direction), "STATUS, DIRECTION");
    let sign = rig.motion().speed.signum();
    assert_eq!(sign, [0, 1, -1][usize::from(status)], "the shaft");
}

/// "1 - input shorted to output GND, 0 - input open". The registers show the contacts before debouncing
/// (RS434-21).
#[test]
fn section_6_1_contacts() {
    let mut rig = Rig::default();
    rig.write(at::PRESSED, 60_000);
    for (contact, address) in [("IN1", at::IN1), ("IN2", at::IN2), ("HARD_STOP", at::IN_HARD_STOP)] {
        rig.open(contact);
        assert_eq!(rig.read(address), 0, "{contact}");
        rig.close(contact);
        assert_eq!(rig.read(address), 1, "{contact}");
    }
    rig.close("IN2");
    rig.open("IN1");
    assert_eq!(rig.try_bits(2, at::IN1, 3), Ok(vec![false, true, true]));
}

/// MODE_EXT_IN 1: IN1 is start/stop and IN2 is reverse, both at the end of a pulse.
#[test]
fn section_6_5_mode_ext_in_1() {
    let mut rig = by_inputs(1);
    rig.close("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 1);
    rig.open("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
    pulse(&mut rig, "IN2");
    assert_turns(&mut rig, 2, 2);
    pulse(&mut rig, "IN1");
    assert_turns(&mut rig, 0, 2);
    pulse(&mut rig, "IN2");
    assert_turns(&mut rig, 0, 1);
    pulse(&mut rig, "IN1");
    assert_turns(&mut rig, 1, 1);
}

/// MODE_EXT_IN 2: IN1 is start/stop at the end of a pulse. IN2 is the direction by level: open is forward,
/// closed backward (RS434-22).
#[test]
fn section_6_5_mode_ext_in_2() {
    let mut rig = by_inputs(2);
    pulse(&mut rig, "IN1");
    assert_turns(&mut rig, 1, 1);
    rig.close("IN2");
    rig.after(WHILE);
    assert_turns(&mut rig, 2, 2);
    rig.open("IN2");
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
    pulse(&mut rig, "IN1");
    assert_turns(&mut rig, 0, 1);
    rig.close("IN2");
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 2);
}

/// MODE_EXT_IN 3: IN1 runs the motor by level, IN2 reverses it at the end of a pulse.
#[test]
fn section_6_5_mode_ext_in_3() {
    let mut rig = by_inputs(3);
    rig.close("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
    pulse(&mut rig, "IN2");
    assert_turns(&mut rig, 2, 2);
    rig.open("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 2);
}

/// MODE_EXT_IN 4: IN1 runs the motor and IN2 sets the direction, both by level.
#[test]
fn section_6_5_mode_ext_in_4() {
    let mut rig = by_inputs(4);
    rig.close("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
    rig.close("IN2");
    rig.after(WHILE);
    assert_turns(&mut rig, 2, 2);
    rig.open("IN1");
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 2);
}

/// MODE_EXT_IN 5: IN1 is forward and IN2 backward, by level. If both are closed, the motor stops (RS434-22).
#[test]
fn section_6_5_mode_ext_in_5() {
    let mut rig = by_inputs(5);
    let status = |rig: &mut Rig| {
        rig.after(WHILE);
        rig.read(at::STATUS)
    };
    assert_eq!(status(&mut rig), 0);
    rig.close("IN1");
    assert_eq!(status(&mut rig), 1);
    rig.close("IN2");
    assert_eq!(status(&mut rig), 0);
    rig.open("IN1");
    assert_eq!(status(&mut rig), 2);
    rig.open("IN2");
    assert_eq!(status(&mut rig), 0);
    rig.close("IN2");
    assert_eq!(status(&mut rig), 2);
}

/// RS434-22: with MODE_EXT_IN 5, IN2 moves by the negative offset.
#[test]
fn section_6_5_mode_ext_in_5_and_offsets() {
    for (contact, position) in [("IN1", 200), ("IN2", -200)] {
        let mut rig = by_inputs(5);
        rig.write(at::MODE_ROTATION, 2);
        rig.write_long(at::OFFSET_CONST, 200);
        rig.close(contact);
        rig.after(5.secs());
        assert_eq!((rig.read_long(at::CURRENT_POSITION), rig.read(at::STATUS)), (position, 0), "{contact}");
    }
}

/// RS434-22: MODE_EXT_IN 5 neither reads nor writes DIRECTION. If a master writes any DIRECTION, the motor
/// still turns as its input demands.
#[test]
fn section_6_5_mode_ext_in_5_and_direction() {
    for (contact, status) in [("IN1", 1), ("IN2", 2)] {
        let mut rig = by_inputs(5);
        rig.close(contact);
        rig.after(WHILE);
        for direction in [1, 2, 1] {
            assert_eq!(rig.try_write_all(at::SPEED, &[500, 100, 100, direction]), Ok(()));
            rig.after(WHILE);
            assert_turns(&mut rig, status, direction);
        }
    }
}

/// A change-over contact opens IN1 and closes IN2 at the same time (or the reverse): the motor changes its
/// direction.
#[test]
fn section_6_5_mode_ext_in_5_changes_over() {
    for (rotation, from, to, status) in
        [(1, "IN1", "IN2", 2), (1, "IN2", "IN1", 1), (2, "IN1", "IN2", 2), (2, "IN2", "IN1", 1)]
    {
        let mut rig = by_inputs(5);
        rig.write(at::MODE_ROTATION, rotation);
        rig.write_long(at::OFFSET_CONST, 2_000);
        rig.close(from);
        rig.after(WHILE);
        let before = rig.read_long(at::CURRENT_POSITION);
        for (contact, driving) in [(from, PinStimulus::High), (to, PinStimulus::Low)] {
            rig.bench.set_pin(rig.seat, rig.pin(contact), driving);
        }
        rig.after(WHILE);
        assert_turns(&mut rig, status, 1);
        if rotation == 2 {
            // The motor moves 2,000 counts back from that position. During the 10 ms of PRESSED and WAITED it
            // made 3 more.
            rig.after(10.secs());
            let way = rig.read_long(at::CURRENT_POSITION) - before;
            let sign = if status == 1 { 1 } else { -1 };
            assert!((1_990..2_000).contains(&(way * sign)), "{way} counts");
            assert_turns(&mut rig, 0, 1);
        }
    }
}

/// RS434-22: with MODE_EXT_IN 5 both inputs go to the same position.
#[test]
fn section_6_5_mode_ext_in_5_and_positions() {
    for contact in ["IN1", "IN2"] {
        let mut rig = by_inputs(5);
        rig.write(at::MODE_ROTATION, 3);
        rig.write_long(at::TARGET_POSITION1, 200);
        rig.close(contact);
        rig.after(5.secs());
        assert_eq!(rig.read_long(at::CURRENT_POSITION), 200, "{contact}");
        assert_turns(&mut rig, 0, 1);
    }
}

/// PRESSED is the time that a closure must last: "minimum time of a positive part of a pulse" (6.1).
#[test]
fn section_6_1_pressed() {
    for (mode, lasts, status) in [(1, 49, 0), (1, 51, 1), (3, 49, 0), (3, 51, 1)] {
        let mut rig = by_inputs(mode);
        rig.write(at::PRESSED, 50);
        rig.close("IN1");
        rig.after(u64::from(lasts as u32).millis());
        if mode == 1 {
            rig.open("IN1");
            rig.after(WHILE);
        } else {
            // A level input starts the motor at once. A closure that is too short is ignored.
            rig.after(10.millis() * u64::from(status));
            let speed = rig.motion().speed;
            assert_eq!(speed > 0, status == 1, "{lasts} ms: {speed}");
            continue;
        }
        assert_eq!(rig.read(at::STATUS), status, "{lasts} ms, way {mode}");
    }
}

/// WAITED is the time that the opening after a pulse must last. The pulse ends only then (RS434-21).
#[test]
fn section_6_1_waited() {
    let mut rig = by_inputs(1);
    rig.write(at::WAITED, 300);
    rig.close("IN1");
    rig.after(20.millis());
    rig.open("IN1");
    rig.after(295.millis());
    assert_eq!(rig.motion().speed, 0);
    rig.after(50.millis());
    assert_eq!(rig.read(at::STATUS), 1);
}

/// RS434-21: two closures with a short opening are one pulse.
#[test]
fn section_6_1_contact_bounce() {
    let mut rig = by_inputs(1);
    rig.write(at::PRESSED, 20);
    rig.write(at::WAITED, 20);
    for _ in 0..2 {
        rig.close("IN1");
        rig.after(30.millis());
        rig.open("IN1");
        rig.after(10.millis());
    }
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
    // Twenty bounces, closed for 5 ms and open for 5 ms, are ignored.
    for _ in 0..20 {
        rig.close("IN1");
        rig.after(5.millis());
        rig.open("IN1");
        rig.after(5.millis());
    }
    rig.after(WHILE);
    assert_turns(&mut rig, 1, 1);
}

/// Section 6.5: with MODE_DEVICE 1 the inputs have no effect. With 2, START has no effect but gets a normal
/// reply. STOP works in both (RS434-6).
#[test]
fn section_6_5_mode_device() {
    let mut rig = Rig::default();
    pulse(&mut rig, "IN1");
    assert_turns(&mut rig, 0, 1);
    pulse(&mut rig, "IN2");
    assert_turns(&mut rig, 0, 1);
    rig.write(at::MODE_DEVICE, 2);
    rig.write(at::START, 1);
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 1);
    assert_eq!(rig.read(at::ERROR), 0);
    // The ignored START does not take effect later.
    rig.write(at::MODE_DEVICE, 1);
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 1);
    for coil in [at::STOP, at::HARD_STOP] {
        let mut rig = by_inputs(1);
        pulse(&mut rig, "IN1");
        assert_turns(&mut rig, 1, 1);
        rig.write(coil, 1);
        rig.after(WHILE);
        assert_turns(&mut rig, 0, 1);
    }
}

/// RS434-22: levels take effect at power-on and when MODE_DEVICE is written. Edges do not.
#[test]
fn section_6_5_levels_at_power_up() {
    for (mode, status) in [(1, 0), (2, 0), (3, 1), (4, 2), (5, 0)] {
        let mut rig = Rig::default();
        rig.write(at::MODE_EXT_IN, mode);
        rig.write(at::MODE_DEVICE, 2);
        rig.save();
        rig.bench.power(rig.seat, PowerAction::Off);
        rig.after(WHILE);
        rig.close("IN1");
        rig.close("IN2");
        rig.bench.power(rig.seat, PowerAction::On);
        rig.after(BOOT + WHILE);
        assert_eq!(rig.read(at::STATUS), status, "way {mode}");
        assert_eq!(rig.read(at::DIRECTION), if [2, 4].contains(&mode) { 2 } else { 1 }, "way {mode}");
    }
    let mut rig = Rig::default();
    rig.write(at::MODE_EXT_IN, 4);
    rig.close("IN1");
    rig.close("IN2");
    rig.after(WHILE);
    assert_turns(&mut rig, 0, 1);
    rig.write(at::MODE_DEVICE, 2);
    rig.after(WHILE);
    assert_turns(&mut rig, 2, 2);
}

/// "Operation is permitted with closed contact" (section 6). An open contact stops the motor at once and sets
/// bit 5, which stays until a restart (RS434-20), with any MODE_DEVICE.
#[test]
fn section_6_hard_stop() {
    for mode in [1, 2] {
        let mut rig = Rig::default();
        rig.write(at::MODE_EXT_IN, 3);
        rig.write(at::DEC, 10);
        rig.write(at::START, 1);
        rig.write(at::MODE_DEVICE, mode);
        rig.close("IN1");
        rig.after(WHILE);
        assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (1, 0));
        rig.open("HARD_STOP");
        rig.after(500.millis());
        assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (0, 1 << 5));
        rig.close("HARD_STOP");
        rig.write(at::ERROR, 0);
        rig.write(at::START, 1);
        rig.after(WHILE);
        assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (0, 1 << 5));
        rig.restart();
        assert_eq!(rig.read(at::ERROR), 0);
        rig.write(at::START, 1);
        rig.after(WHILE);
        assert_eq!(rig.read(at::STATUS), 1);
    }
}

/// An open contact at power-on sets bit 5, too, because the input is a level (RS434-20).
#[test]
fn section_6_hard_stop_at_power_up() {
    let mut rig = Rig::default();
    rig.open("HARD_STOP");
    rig.restart();
    assert_eq!(rig.read(at::ERROR), 1 << 5);
    rig.write(at::START, 1);
    rig.after(WHILE);
    assert_eq!(rig.read(at::STATUS), 0);
}

/// An unused contact counts as closed (RS434-8). After its first stimulus a released contact is open,
/// whatever the levels before.
#[test]
fn section_6_released_hard_stop() {
    for before in [None, Some(PinStimulus::Low), Some(PinStimulus::High)] {
        let mut rig = Rig::default();
        assert_eq!(rig.read(at::IN_HARD_STOP), 1, "the contact is unused");
        if let Some(before) = before {
            rig.drive("HARD_STOP", before);
            rig.restart();
        }
        if before != Some(PinStimulus::High) {
            rig.write(at::START, 1);
            rig.after(WHILE);
            assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (1, 0), "{before:?}");
        }
        rig.drive("HARD_STOP", PinStimulus::Open);
        rig.after(500.millis());
        assert_eq!((rig.read(at::IN_HARD_STOP), rig.read(at::ERROR)), (0, 1 << 5), "{before:?}");
        assert_eq!((rig.read(at::STATUS), rig.motion().speed == 0), (0, true), "{before:?}");
        // The contact is still open after a power cycle.
        rig.power_cycle();
        assert_eq!((rig.read(at::IN_HARD_STOP), rig.read(at::ERROR)), (0, 1 << 5), "{before:?}");
        rig.close("HARD_STOP");
        rig.power_cycle();
        assert_eq!((rig.read(at::IN_HARD_STOP), rig.read(at::ERROR)), (1, 0), "{before:?}");
    }
}
