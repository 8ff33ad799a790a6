//! Alarms: their causes, what they do, and how they go (p. 9).

use super::super::ALARM_RESET;
use super::*;

/// A motor that turns at 1,000 rpm.
fn turning() -> Bed {
    let mut bed = Bed::armed();
    bed.write(130, 1_000);
    bed.wait(2.secs());
    assert!((990..=1_010).contains(&bed.rpm()), "{}", bed.rpm());
    bed
}

/// The last word of MONITOR: status2 and CTRL_STATUS.
fn status(bed: &mut Bed) -> u16 {
    let status = bed.read_words(196, 6)[5];
    assert_eq!(bed.read(34), status & 0xFF);
    status
}

#[test]
fn what_is_there_at_once() {
    for (fault, expected) in [
        ("over_voltage", 0x0005),
        ("over_temperature", 0x0009),
        ("overload", 0x0011),
        ("ctrl_fail", 0x0003),
        ("regen_over_temperature", 0x0101),
    ] {
        let mut bed = turning();
        let at = bed.now;
        bed.fault(fault, true);
        assert_eq!(bed.world.levels.last(), Some(&(at, ALARM, Level::Low)), "{fault}");
        assert_eq!(status(&mut bed), expected, "{fault}");
        bed.wait(1.millis());
        assert_eq!(bed.get(Pid::TQ_DATA), 0, "{fault}: the output is off");
        bed.wait(8.secs());
        assert_eq!(bed.rpm(), 0, "{fault}");

        // While its cause is there it cannot be cleared, and commands are only kept.
        bed.write(12, 0);
        bed.write(10, 8);
        bed.write(130, 500);
        bed.wait(1.secs());
        assert_eq!((status(&mut bed), bed.alarm(), bed.rpm()), (expected, true, 0), "{fault}");

        bed.fault(fault, false);
        assert_eq!((status(&mut bed), bed.alarm()), (expected, true), "{fault} is latched");
        bed.write(12, 0xFFFF);
        assert_eq!((status(&mut bed), bed.alarm(), bed.read(130)), (0, false, 500), "{fault}");
        bed.wait(1.secs());
        assert_eq!(bed.rpm(), 0, "{fault}: it waits for the next command");
        bed.write(130, 500);
        bed.wait(2.secs());
        assert!((490..=510).contains(&bed.rpm()), "{fault}");
    }
}

#[test]
fn three_ways_to_clear_one() {
    let clear: [fn(&mut Bed); 3] = [
        |bed| bed.write(12, 0),
        |bed| bed.write(10, 8),
        |bed| {
            bed.contact(ALARM_RESET, false);
            bed.contact(ALARM_RESET, true);
        },
    ];
    for (way, clear) in clear.into_iter().enumerate() {
        let mut bed = Bed::ready();
        bed.fault("overload", true);
        bed.fault("overload", false);
        assert!(bed.alarm());
        clear(&mut bed);
        assert_eq!((bed.read(34), bed.alarm()), (0, false), "{way}");
    }
}

#[test]
fn power_clears_one_and_a_cause_that_stays_brings_it_back() {
    let mut bed = Bed::ready();
    bed.fault("over_temperature", true);
    bed.cycle();
    assert_eq!((bed.read(34), bed.alarm()), (0, false));
    // What is around the drive is told anew, here before it is ready.
    let mut bed = Bed::booting();
    bed.fault("over_temperature", true);
    assert!(!bed.alarm());
    bed.run_until(Instant::from(300.millis()));
    assert_eq!(bed.world.levels, [(bed.now, ALARM, Level::Low)]);
}

#[test]
fn supply_over_60_v() {
    let mut bed = Bed::ready();
    bed.set(Pid::VOLT_IN, 600);
    assert_eq!((bed.read(143), bed.read(34)), (600, 0));
    bed.set(Pid::VOLT_IN, 601);
    assert_eq!((bed.read(143), bed.read(34)), (601, 5));
    bed.set(Pid::VOLT_IN, 250);
    assert_eq!(bed.read(34), 5);
    bed.write(12, 0);
    assert_eq!((bed.read(143), bed.read(34)), (250, 0));
    bed.fault("over_voltage", true);
    assert_eq!((bed.read(143), bed.read(34)), (610, 5));
    bed.fault("over_voltage", false);
    assert_eq!((bed.read(143), bed.read(34)), (250, 5));
}

#[test]
fn inv_alarm_turns_the_pin_round() {
    let mut bed = Bed::ready();
    assert!(!bed.alarm());
    bed.write(19, 1);
    assert!(bed.alarm());
    bed.fault("overload", true);
    assert!(!bed.alarm());
    bed.write(19, 0);
    assert!(bed.alarm());
    bed.fault("overload", false);
    bed.write(12, 0);
    assert!(!bed.alarm());
    bed.write(19, 1);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!(bed.world.levels.iter().filter(|(_, pin, _)| *pin == ALARM).count(), 1);
    assert!(bed.alarm());
    bed.write(3, 0x55);
    assert!(!bed.alarm(), "DEFAULT_SET brings INV_ALARM to 0");
}

#[test]
fn several_are_cleared_as_their_causes_go() {
    let mut bed = Bed::ready();
    bed.fault("over_voltage", true);
    bed.fault("ctrl_fail", true);
    assert_eq!(status(&mut bed), 0x0007);
    bed.fault("over_voltage", false);
    bed.write(12, 0);
    assert_eq!((status(&mut bed), bed.alarm()), (0x0003, true));
    bed.fault("ctrl_fail", false);
    bed.write(12, 0);
    assert_eq!((status(&mut bed), bed.alarm()), (0, false));
}

#[test]
fn causes_that_show_when_the_motor_turns() {
    for (fault, expected) in [("hall_fail", 0x0021), ("inverse_velocity", 0x0041)] {
        let mut bed = turning();
        bed.fault(fault, true);
        bed.wait(3.secs());
        assert_eq!((status(&mut bed), bed.alarm()), (expected, true), "{fault}");
        bed.write(12, 0);
        assert_eq!(status(&mut bed), expected, "{fault}: its cause is there");
        bed.fault(fault, false);
        bed.write(12, 0);
        assert_eq!((status(&mut bed), bed.alarm()), (0, false), "{fault}");
        bed.wait(8.secs());
        bed.write(130, 1_000);
        bed.wait(3.secs());
        assert!((990..=1_010).contains(&bed.rpm()), "{fault}: {}", bed.rpm());
    }
}

#[test]
fn a_held_shaft_is_the_motor_s_and_an_alarm_after_a_second() {
    let mut bed = turning();
    bed.fault("stall", true);
    bed.wait(900.millis());
    assert_eq!(bed.read(34), 0);
    bed.wait(1.secs());
    assert_eq!(bed.read(34), 0x81);
    bed.fault("stall", false);
    bed.write(12, 0);
    assert_eq!(bed.read(34), 0);
}

#[test]
fn an_encoder_that_is_not_there() {
    let mut bed = Bed::armed();
    bed.write(156, 1_000);
    bed.write(130, 500);
    bed.wait(3.secs());
    assert_eq!(status(&mut bed), 0x0221);
    bed.write(156, 0);
    bed.write(12, 0);
    assert_eq!(status(&mut bed), 0);
}

#[test]
fn an_encoder_that_nobody_looks_at_holds_no_alarm() {
    for (off, value) in [(156, 0), (10, 26)] {
        let mut bed = Bed::armed();
        bed.fault("encoder_fail", true);
        bed.write(156, 1_000);
        bed.write(130, 500);
        bed.wait(3.secs());
        assert_eq!(status(&mut bed), 0x0221);
        bed.write(12, 0);
        assert_eq!(status(&mut bed), 0x0221, "its cause is there");
        bed.write(off, value);
        bed.write(12, 0);
        assert_eq!((status(&mut bed), bed.alarm()), (0, false), "PID {off}");
    }
}

#[test]
fn a_hall_state_that_cannot_be_is_an_alarm_as_long_as_it_lasts() {
    // From power-on, while the drive starts: it shows when it is ready.
    let mut bed = Bed::new();
    bed.drive.part();
    bed.drive.power_on(bed.now, Boot::default(), &mut bed.world);
    for pin in [HU, HV, HW] {
        bed.contact(pin, false);
    }
    bed.wait(1.secs());
    assert_eq!((status(&mut bed), bed.alarm()), (0x0021, true));
    bed.write(12, 0);
    assert_eq!((status(&mut bed), bed.alarm()), (0x0021, true), "its cause is there");
    bed.contact(HV, true);
    bed.wait(1.millis());
    assert_eq!(status(&mut bed), 0x0021, "it is latched");
    bed.write(12, 0);
    assert_eq!((status(&mut bed), bed.alarm()), (0, false));
}

#[test]
fn an_alarm_at_power_on_shows_once_with_inv_alarm_too() {
    for (inverted, levels) in [(0, vec![Level::Low]), (1, vec![])] {
        let mut bed = Bed::new();
        bed.set(Pid::INV_ALARM, inverted);
        bed.drive.power_on(bed.now, Boot::default(), &mut bed.world);
        bed.fault("over_temperature", true);
        bed.wait(1.secs());
        assert_eq!(bed.read(34), 0x09);
        let shown: Vec<_> = bed.world.levels.iter().map(|(_, _, level)| *level).collect();
        assert_eq!(shown, levels, "INV_ALARM {inverted}");
    }
}

#[test]
fn connectors_that_command_wait_for_start_stop_after_an_alarm() {
    use super::super::{RUN_BRAKE, SPEED_IN, START_STOP};
    let mut bed = Bed::ready();
    bed.contact(RUN_BRAKE, true);
    bed.input(bed.now, Input::Millivolts { pin: SPEED_IN, mv: 5_000 });
    bed.contact(START_STOP, true);
    bed.wait(3.secs());
    assert!(bed.rpm() > 2_900, "{}", bed.rpm());
    bed.fault("overload", true);
    bed.fault("overload", false);
    bed.write(12, 0);
    bed.wait(20.secs());
    assert_eq!(bed.rpm(), 0);
    bed.contact(START_STOP, false);
    bed.contact(START_STOP, true);
    bed.wait(3.secs());
    assert!(bed.rpm() > 2_900, "{}", bed.rpm());
}
