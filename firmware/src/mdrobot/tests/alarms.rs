//! Alarms: their causes, their effects, and how they are cleared (p. 9).

use super::super::ALARM_RESET;
use super::*;

/// A motor that turns at 1,000 rpm.
fn turning() -> Dut {
    let mut dut = Dut::armed();
    dut.write(130, 1_000);
    dut.wait(2.secs());
    assert!((990..=1_010).contains(&dut.rpm()), "{}", dut.rpm());
    dut
}

/// The last word of MONITOR: status2 and CTRL_STATUS.
fn status(dut: &mut Dut) -> u16 {
    let status = dut.read_words(196, 6)[5];
    assert_eq!(dut.read(34), status & 0xFF);
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
        let mut dut = turning();
        let at = dut.now;
        dut.fault(fault, true);
        assert_eq!(dut.out.levels.last(), Some(&(at, ALARM, Level::Low)), "{fault}");
        assert_eq!(status(&mut dut), expected, "{fault}");
        dut.wait(1.millis());
        assert_eq!(dut.get(Pid::TQ_DATA), 0, "{fault}: the output is off");
        dut.wait(8.secs());
        assert_eq!(dut.rpm(), 0, "{fault}");

        // While the cause is present, the alarm cannot be cleared, and a command is only stored.
        dut.write(12, 0);
        dut.write(10, 8);
        dut.write(130, 500);
        dut.wait(1.secs());
        assert_eq!((status(&mut dut), dut.alarm(), dut.rpm()), (expected, true, 0), "{fault}");

        dut.fault(fault, false);
        assert_eq!((status(&mut dut), dut.alarm()), (expected, true), "{fault} is latched");
        dut.write(12, 0xFFFF);
        assert_eq!((status(&mut dut), dut.alarm(), dut.read(130)), (0, false, 500), "{fault}");
        dut.wait(1.secs());
        assert_eq!(dut.rpm(), 0, "{fault}: it waits for the next command");
        dut.write(130, 500);
        dut.wait(2.secs());
        assert!((490..=510).contains(&dut.rpm()), "{fault}");
    }
}

#[test]
fn three_ways_to_clear_one() {
    let clear: [fn(&mut Dut); 3] = [
        |dut| dut.write(12, 0),
        |dut| dut.write(10, 8),
        |dut| {
            dut.contact(ALARM_RESET, false);
            dut.contact(ALARM_RESET, true);
        },
    ];
    for (way, clear) in clear.into_iter().enumerate() {
        let mut dut = Dut::ready();
        dut.fault("overload", true);
        dut.fault("overload", false);
        assert!(dut.alarm());
        clear(&mut dut);
        assert_eq!((dut.read(34), dut.alarm()), (0, false), "{way}");
    }
}

#[test]
fn power_clears_one_and_a_cause_that_stays_brings_it_back() {
    let mut dut = Dut::ready();
    dut.fault("over_temperature", true);
    dut.cycle();
    assert_eq!((dut.read(34), dut.alarm()), (0, false));
    // The test sets the fault again after power-on, here before the drive is ready.
    let mut dut = Dut::booting();
    dut.fault("over_temperature", true);
    assert!(!dut.alarm());
    dut.run_until(Instant::from(300.millis()));
    assert_eq!(dut.out.levels, [(dut.now, ALARM, Level::Low)]);
}

#[test]
fn supply_over_60_v() {
    let mut dut = Dut::ready();
    dut.set(Pid::VOLT_IN, 600);
    assert_eq!((dut.read(143), dut.read(34)), (600, 0));
    dut.set(Pid::VOLT_IN, 601);
    assert_eq!((dut.read(143), dut.read(34)), (601, 5));
    dut.set(Pid::VOLT_IN, 250);
    assert_eq!(dut.read(34), 5);
    dut.write(12, 0);
    assert_eq!((dut.read(143), dut.read(34)), (250, 0));
    dut.fault("over_voltage", true);
    assert_eq!((dut.read(143), dut.read(34)), (610, 5));
    dut.fault("over_voltage", false);
    assert_eq!((dut.read(143), dut.read(34)), (250, 5));
}

#[test]
fn inv_alarm_turns_the_pin_round() {
    let mut dut = Dut::ready();
    assert!(!dut.alarm());
    dut.write(19, 1);
    assert!(dut.alarm());
    dut.fault("overload", true);
    assert!(!dut.alarm());
    dut.write(19, 0);
    assert!(dut.alarm());
    dut.fault("overload", false);
    dut.write(12, 0);
    assert!(!dut.alarm());
    dut.write(19, 1);
    dut.wait(10.millis());
    dut.cycle();
    assert_eq!(dut.out.levels.iter().filter(|(_, pin, _)| *pin == ALARM).count(), 1);
    assert!(dut.alarm());
    dut.write(3, 0x55);
    assert!(!dut.alarm(), "DEFAULT_SET brings INV_ALARM to 0");
}

#[test]
fn several_are_cleared_as_their_causes_go() {
    let mut dut = Dut::ready();
    dut.fault("over_voltage", true);
    dut.fault("ctrl_fail", true);
    assert_eq!(status(&mut dut), 0x0007);
    dut.fault("over_voltage", false);
    dut.write(12, 0);
    assert_eq!((status(&mut dut), dut.alarm()), (0x0003, true));
    dut.fault("ctrl_fail", false);
    dut.write(12, 0);
    assert_eq!((status(&mut dut), dut.alarm()), (0, false));
}

#[test]
fn causes_that_show_when_the_motor_turns() {
    for (fault, expected) in [("hall_fail", 0x0021), ("inverse_velocity", 0x0041)] {
        let mut dut = turning();
        dut.fault(fault, true);
        dut.wait(3.secs());
        assert_eq!((status(&mut dut), dut.alarm()), (expected, true), "{fault}");
        dut.write(12, 0);
        assert_eq!(status(&mut dut), expected, "{fault}: its cause is there");
        dut.fault(fault, false);
        dut.write(12, 0);
        assert_eq!((status(&mut dut), dut.alarm()), (0, false), "{fault}");
        dut.wait(8.secs());
        dut.write(130, 1_000);
        dut.wait(3.secs());
        assert!((990..=1_010).contains(&dut.rpm()), "{fault}: {}", dut.rpm());
    }
}

#[test]
fn a_held_shaft_is_the_motor_s_and_an_alarm_after_a_second() {
    let mut dut = turning();
    dut.fault("stall", true);
    dut.wait(900.millis());
    assert_eq!(dut.read(34), 0);
    dut.wait(1.secs());
    assert_eq!(dut.read(34), 0x81);
    dut.fault("stall", false);
    dut.write(12, 0);
    assert_eq!(dut.read(34), 0);
}

#[test]
fn an_encoder_that_is_not_there() {
    let mut dut = Dut::armed();
    dut.write(156, 1_000);
    dut.write(130, 500);
    dut.wait(3.secs());
    assert_eq!(status(&mut dut), 0x0221);
    dut.write(156, 0);
    dut.write(12, 0);
    assert_eq!(status(&mut dut), 0);
}

#[test]
fn an_encoder_that_nobody_looks_at_holds_no_alarm() {
    for (off, value) in [(156, 0), (10, 26)] {
        let mut dut = Dut::armed();
        dut.fault("encoder_fail", true);
        dut.write(156, 1_000);
        dut.write(130, 500);
        dut.wait(3.secs());
        assert_eq!(status(&mut dut), 0x0221);
        dut.write(12, 0);
        assert_eq!(status(&mut dut), 0x0221, "its cause is there");
        dut.write(off, value);
        dut.write(12, 0);
        assert_eq!((status(&mut dut), dut.alarm()), (0, false), "PID {off}");
    }
}

#[test]
fn a_hall_state_that_cannot_be_is_an_alarm_as_long_as_it_lasts() {
    // The Hall state is impossible from power-on on, so the drive raises the alarm as soon as it is ready.
    let mut dut = Dut::new();
    dut.drive.detach_motor();
    dut.power_on(Boot::default());
    for pin in [HU, HV, HW] {
        dut.contact(pin, false);
    }
    dut.wait(1.secs());
    assert_eq!((status(&mut dut), dut.alarm()), (0x0021, true));
    dut.write(12, 0);
    assert_eq!((status(&mut dut), dut.alarm()), (0x0021, true), "its cause is there");
    dut.contact(HV, true);
    dut.wait(1.millis());
    assert_eq!(status(&mut dut), 0x0021, "it is latched");
    dut.write(12, 0);
    assert_eq!((status(&mut dut), dut.alarm()), (0, false));
}

#[test]
fn an_alarm_at_power_on_shows_once_with_inv_alarm_too() {
    for (inverted, levels) in [(0, vec![Level::Low]), (1, vec![])] {
        let mut dut = Dut::new();
        dut.set(Pid::INV_ALARM, inverted);
        dut.power_on(Boot::default());
        dut.fault("over_temperature", true);
        dut.wait(1.secs());
        assert_eq!(dut.read(34), 0x09);
        let shown: Vec<_> = dut.out.levels.iter().map(|(_, _, level)| *level).collect();
        assert_eq!(shown, levels, "INV_ALARM {inverted}");
    }
}

#[test]
fn connectors_that_command_wait_for_start_stop_after_an_alarm() {
    use super::super::{RUN_BRAKE, SPEED_IN, START_STOP};
    let mut dut = Dut::ready();
    dut.contact(RUN_BRAKE, true);
    dut.feed(Input::Millivolts { pin: SPEED_IN, mv: 5_000 });
    dut.contact(START_STOP, true);
    dut.wait(3.secs());
    assert!(dut.rpm() > 2_900, "{}", dut.rpm());
    dut.fault("overload", true);
    dut.fault("overload", false);
    dut.write(12, 0);
    dut.wait(20.secs());
    assert_eq!(dut.rpm(), 0);
    dut.contact(START_STOP, false);
    dut.contact(START_STOP, true);
    dut.wait(3.secs());
    assert!(dut.rpm() > 2_900, "{}", dut.rpm());
}
