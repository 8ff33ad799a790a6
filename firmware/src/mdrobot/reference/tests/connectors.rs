//! The contacts of CTRL (decisions, MDROBOT 14, 20 to 22).

use super::*;

#[test]
fn di_shows_what_is_closed_and_of_the_encoder_what_is_open() {
    let mut bed = Bed::ready();
    assert_eq!(bed.get(Pid::DI), 0b110_0000, "nothing is wired");
    for (pin, bit) in [(INT_SPEED, 0), (ALARM_RESET, 1), (DIR, 2), (RUN_BRAKE, 3), (START_STOP, 4)] {
        bed.close(pin);
        assert_eq!(bed.get(Pid::DI), 0b110_0000 | 1 << bit);
        bed.set(Pid::START_INV_SIGN, 1);
        bed.set(Pid::RUN_INV_SIGN, 1);
        assert_eq!(bed.get(Pid::DI), 0b110_0000 | 1 << bit, "before they are turned round");
        bed.open(pin);
        assert_eq!(bed.get(Pid::DI), 0b110_0000);
        bed.close(pin);
        bed.unwire(pin);
        assert_eq!(bed.get(Pid::DI), 0b110_0000);
    }
    bed.edge(ENC_B, false);
    assert_eq!(bed.get(Pid::DI), 0b100_0000);
    bed.edge(ENC_A, false);
    assert_eq!(bed.get(Pid::DI), 0);
    bed.edge(ENC_B, true);
    assert_eq!(bed.get(Pid::DI), 0b010_0000);
}

#[test]
fn start_stop_starts_run_brake_brakes_and_dir_turns() {
    let mut bed = Bed::ready();
    assert_eq!(bed.order(), Order::Brake, "RUN/BRAKE that is not wired is open");
    bed.close(RUN_BRAKE);
    assert_eq!(bed.order(), Order::Velocity(0));
    bed.volts(5_000);
    assert_eq!(bed.order(), Order::Velocity(0));
    bed.close(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(3_000));
    bed.close(DIR);
    assert_eq!(bed.order(), Order::Velocity(-3_000), "ON is CW");
    bed.open(RUN_BRAKE);
    assert_eq!(bed.order(), Order::Brake);
    bed.close(RUN_BRAKE);
    assert_eq!(bed.order(), Order::Velocity(-3_000));
    bed.open(DIR);
    assert_eq!(bed.order(), Order::Velocity(3_000));
    bed.open(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(0));
}

#[test]
fn start_stop_and_run_brake_may_be_turned_round() {
    // Closed, open, not wired; as they are, and turned round.
    for (contact, on) in [(Some(false), [true, false]), (Some(true), [false, true]), (None, [false, false])] {
        for inverted in [0, 1] {
            let mut bed = Bed::connected();
            bed.volts(5_000);
            bed.set(Pid::START_INV_SIGN, inverted);
            match contact {
                Some(high) => bed.edge(START_STOP, high),
                None => bed.unwire(START_STOP),
            }
            let rpm = if on[inverted as usize] { 3_000 } else { 0 };
            assert_eq!(bed.order(), Order::Velocity(rpm), "{contact:?} {inverted}");
        }
    }
    for (contact, runs) in [(Some(false), [true, false]), (Some(true), [false, true]), (None, [false, true])]
    {
        for inverted in [0, 1] {
            let mut bed = Bed::ready();
            bed.set(Pid::RUN_INV_SIGN, inverted);
            match contact {
                Some(high) => bed.edge(RUN_BRAKE, high),
                None => bed.unwire(RUN_BRAKE),
            }
            let order = if runs[inverted as usize] { Order::Velocity(0) } else { Order::Brake };
            assert_eq!(bed.order(), order, "{contact:?} {inverted}");
        }
    }
}

#[test]
fn a_register_that_turns_a_contact_round_acts_at_once() {
    let mut bed = Bed::connected();
    bed.volts(5_000);
    bed.open(START_STOP);
    bed.set(Pid::START_INV_SIGN, 1);
    assert_eq!(bed.order(), Order::Velocity(3_000));
    bed.set(Pid::RUN_INV_SIGN, 1);
    assert_eq!(bed.order(), Order::Brake);
    bed.set(Pid::RUN_INV_SIGN, 0);
    bed.set(Pid::START_INV_SIGN, 0);
    assert_eq!(bed.order(), Order::Velocity(0));
}

#[test]
fn levels_at_power_on_act_when_the_start_is_over() {
    let mut bed = Bed::starting(false);
    bed.volts(5_000);
    bed.close(RUN_BRAKE);
    bed.close(START_STOP);
    bed.wait(299.millis());
    bed.close(DIR);
    assert_eq!(bed.order(), Order::Free);
    bed.start();
    assert_eq!((bed.now, bed.order()), (300.millis().into(), Order::Velocity(-3_000)));
}

#[test]
fn what_was_dropped_starts_again_when_start_stop_has_been_off() {
    for (pid, order) in [(Pid::TQ_OFF, Order::Free), (Pid::BRAKE, Order::Brake)] {
        let mut bed = Bed::connected();
        bed.volts(5_000);
        bed.close(START_STOP);
        bed.set(pid, 0);
        assert_eq!(bed.order(), order);
        bed.close(DIR);
        bed.volts(4_000);
        assert_eq!(bed.order(), order);
        bed.open(START_STOP);
        assert_eq!(bed.order(), order);
        bed.close(START_STOP);
        assert_eq!(bed.order(), Order::Velocity(-2_398), "818 of 1,023");
    }
}

#[test]
fn an_alarm_is_cleared_by_its_contact_and_start_stop_has_to_be_off() {
    let mut bed = Bed::connected();
    bed.volts(5_000);
    bed.close(START_STOP);
    bed.drive.set_cause(bed.now, OVER_VOLTAGE, true, &mut Nowhere);
    assert_eq!(bed.order(), Order::Free);
    bed.close(ALARM_RESET);
    bed.open(ALARM_RESET);
    assert_ne!(bed.get(Pid::CTRL_STATUS), 0, "the cause is there");
    bed.drive.set_cause(bed.now, OVER_VOLTAGE, false, &mut Nowhere);
    // What comes during an alarm starts nothing.
    bed.open(START_STOP);
    bed.close(START_STOP);
    bed.close(ALARM_RESET);
    assert_eq!((bed.get(Pid::CTRL_STATUS), bed.order()), (0, Order::Free));
    bed.open(START_STOP);
    bed.close(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(3_000));
}

#[test]
fn run_brake_brakes_what_was_dropped_too() {
    let drop: [fn(&mut Bed); 2] = [
        |bed| bed.set(Pid::TQ_OFF, 0),
        |bed| {
            bed.drive.set_cause(bed.now, OVER_VOLTAGE, true, &mut Nowhere);
            bed.drive.set_cause(bed.now, OVER_VOLTAGE, false, &mut Nowhere);
            bed.set(Pid::ALARM_RESET, 0);
        },
    ];
    for (way, drop) in drop.into_iter().enumerate() {
        let mut bed = Bed::connected();
        bed.set(Pid::TAR_VEL, 1_500);
        bed.close(START_STOP);
        drop(&mut bed);
        assert_eq!(bed.order(), Order::Free, "{way}");
        bed.open(RUN_BRAKE);
        assert_eq!(bed.order(), Order::Brake, "{way}");
        bed.close(RUN_BRAKE);
        assert_eq!(bed.order(), Order::Free, "{way}: START/STOP has to come");
        bed.set(Pid::RUN_INV_SIGN, 1);
        assert_eq!(bed.order(), Order::Brake, "{way}");
        bed.open(START_STOP);
        bed.close(START_STOP);
        assert_eq!(bed.order(), Order::Brake, "{way}");
        bed.open(RUN_BRAKE);
        assert_eq!(bed.order(), Order::Velocity(1_500), "{way}");
    }
}

#[test]
fn run_brake_that_is_off_brakes_after_an_alarm_and_when_the_connectors_take_over() {
    let mut bed = Bed::ready();
    bed.drive.set_cause(bed.now, OVER_VOLTAGE, true, &mut Nowhere);
    bed.set(Pid::ALARM_RESET, 0);
    assert_eq!(bed.order(), Order::Free, "the alarm is still there");
    bed.drive.set_cause(bed.now, OVER_VOLTAGE, false, &mut Nowhere);
    bed.set(Pid::ALARM_RESET, 0);
    assert_eq!(bed.order(), Order::Brake);
    bed.set(Pid::TQ_OFF, 0);
    bed.set(Pid::ALARM_RESET, 0);
    assert_eq!(bed.order(), Order::Free, "there was no alarm");
    bed.set(Pid::UI_COM, 1);
    bed.open(RUN_BRAKE);
    assert_eq!(bed.order(), Order::Free, "it is of no interest to the bus");
    bed.set(Pid::UI_COM, 0);
    assert_eq!(bed.order(), Order::Brake);
}

#[test]
fn the_contacts_do_nothing_while_the_bus_commands() {
    let mut bed = Bed::connected();
    bed.set(Pid::USE_LIMIT_SW, 0);
    bed.set(Pid::UI_COM, 1);
    bed.volts(5_000);
    for pin in [RUN_BRAKE, START_STOP, DIR] {
        bed.close(pin);
        bed.open(pin);
        bed.close(pin);
        assert_eq!(bed.order(), Order::Velocity(0));
    }
    assert_eq!(bed.get(Pid::DI), 0b111_1100, "they are read");
    bed.set(Pid::UI_COM, 0);
    assert_eq!(bed.order(), Order::Velocity(0), "START/STOP has to be off before");
    bed.open(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(0));
    bed.close(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(-3_000));
}

#[test]
fn seven_steps() {
    let mut bed = Bed::ready();
    bed.set(Pid::MAX_RPM, 400);
    bed.set(Pid::INPUT_TYPE, 5);
    bed.set(Pid::TAR_VEL, 123);
    // Floors of sevenths (HW), in the manual's order: INT_SPEED, RUN/BRAKE, START/STOP.
    for (step, rpm) in [0, 57, 114, 171, 228, 285, 342, 400].into_iter().enumerate() {
        for (bit, pin) in [INT_SPEED, RUN_BRAKE, START_STOP].into_iter().enumerate() {
            bed.edge(pin, step >> bit & 1 == 0);
        }
        bed.open(DIR);
        assert_eq!(bed.order(), Order::Velocity(rpm), "{step}");
        bed.close(DIR);
        assert_eq!(bed.order(), Order::Velocity(-rpm), "{step}");
    }
    bed.set(Pid::MAX_RPM, 3_500);
    assert_eq!(bed.order(), Order::Velocity(-3_500));
    bed.set(Pid::TQ_OFF, 0);
    bed.open(INT_SPEED);
    assert_eq!(bed.order(), Order::Free, "the number has not been 0");
    bed.open(RUN_BRAKE);
    bed.open(START_STOP);
    assert_eq!(bed.order(), Order::Free);
    bed.close(INT_SPEED);
    assert_eq!(bed.order(), Order::Velocity(-500), "a seventh");
}

#[test]
fn inv_sign_cmd_turns_the_connectors_round() {
    let mut bed = Bed::connected();
    bed.volts(5_000);
    bed.close(START_STOP);
    bed.set(Pid::INV_SIGN_CMD, 1);
    assert_eq!(bed.order(), Order::Velocity(-3_000));
}
