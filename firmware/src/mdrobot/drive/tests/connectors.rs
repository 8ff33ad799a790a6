//! The contacts of CTRL (MDROBOT-14, MDROBOT-20 to MDROBOT-22).

use super::*;

#[test]
fn di_shows_what_is_closed_and_of_the_encoder_what_is_open() {
    let mut dut = Dut::ready();
    assert_eq!(dut.get(Pid::DI), 0b110_0000, "nothing is wired");
    for (pin, bit) in [(INT_SPEED, 0), (ALARM_RESET, 1), (DIR, 2), (RUN_BRAKE, 3), (START_STOP, 4)] {
        dut.close(pin);
        assert_eq!(dut.get(Pid::DI), 0b110_0000 | 1 << bit);
        dut.set(Pid::START_INV_SIGN, 1);
        dut.set(Pid::RUN_INV_SIGN, 1);
        assert_eq!(dut.get(Pid::DI), 0b110_0000 | 1 << bit, "before they are turned round");
        dut.open(pin);
        assert_eq!(dut.get(Pid::DI), 0b110_0000);
        dut.close(pin);
        dut.unwire(pin);
        assert_eq!(dut.get(Pid::DI), 0b110_0000);
    }
    dut.edge(ENC_B, false);
    assert_eq!(dut.get(Pid::DI), 0b100_0000);
    dut.edge(ENC_A, false);
    assert_eq!(dut.get(Pid::DI), 0);
    dut.edge(ENC_B, true);
    assert_eq!(dut.get(Pid::DI), 0b010_0000);
}

#[test]
fn start_stop_starts_run_brake_brakes_and_dir_turns() {
    let mut dut = Dut::ready();
    assert_eq!(dut.order(), Order::Brake, "RUN/BRAKE that is not wired is open");
    dut.close(RUN_BRAKE);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.volts(5_000);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.close(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(3_000));
    dut.close(DIR);
    assert_eq!(dut.order(), Order::Velocity(-3_000), "ON is CW");
    dut.open(RUN_BRAKE);
    assert_eq!(dut.order(), Order::Brake);
    dut.close(RUN_BRAKE);
    assert_eq!(dut.order(), Order::Velocity(-3_000));
    dut.open(DIR);
    assert_eq!(dut.order(), Order::Velocity(3_000));
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(0));
}

#[test]
fn start_stop_and_run_brake_may_be_turned_round() {
    // A closed, an open and an unwired contact, each with both polarities.
    for (contact, on) in [(Some(false), [true, false]), (Some(true), [false, true]), (None, [false, false])] {
        for inverted in [0, 1] {
            let mut dut = Dut::connected();
            dut.volts(5_000);
            dut.set(Pid::START_INV_SIGN, inverted);
            match contact {
                Some(high) => dut.edge(START_STOP, high),
                None => dut.unwire(START_STOP),
            }
            let rpm = if on[inverted as usize] { 3_000 } else { 0 };
            assert_eq!(dut.order(), Order::Velocity(rpm), "{contact:?} {inverted}");
        }
    }
    for (contact, runs) in [(Some(false), [true, false]), (Some(true), [false, true]), (None, [false, true])]
    {
        for inverted in [0, 1] {
            let mut dut = Dut::ready();
            dut.set(Pid::RUN_INV_SIGN, inverted);
            match contact {
                Some(high) => dut.edge(RUN_BRAKE, high),
                None => dut.unwire(RUN_BRAKE),
            }
            let order = if runs[inverted as usize] { Order::Velocity(0) } else { Order::Brake };
            assert_eq!(dut.order(), order, "{contact:?} {inverted}");
        }
    }
}

#[test]
fn a_register_that_turns_a_contact_round_acts_at_once() {
    let mut dut = Dut::connected();
    dut.volts(5_000);
    dut.open(START_STOP);
    dut.set(Pid::START_INV_SIGN, 1);
    assert_eq!(dut.order(), Order::Velocity(3_000));
    dut.set(Pid::RUN_INV_SIGN, 1);
    assert_eq!(dut.order(), Order::Brake);
    dut.set(Pid::RUN_INV_SIGN, 0);
    dut.set(Pid::START_INV_SIGN, 0);
    assert_eq!(dut.order(), Order::Velocity(0));
}

#[test]
fn levels_at_power_on_act_when_the_start_is_over() {
    let mut dut = Dut::starting(false);
    dut.volts(5_000);
    dut.close(RUN_BRAKE);
    dut.close(START_STOP);
    dut.wait(299.millis());
    dut.close(DIR);
    assert_eq!(dut.order(), Order::Free);
    dut.start();
    assert_eq!((dut.now, dut.order()), (300.millis().into(), Order::Velocity(-3_000)));
}

#[test]
fn what_was_dropped_starts_again_when_start_stop_has_been_off() {
    for (pid, order) in [(Pid::TQ_OFF, Order::Free), (Pid::BRAKE, Order::Brake)] {
        let mut dut = Dut::connected();
        dut.volts(5_000);
        dut.close(START_STOP);
        dut.set(pid, 0);
        assert_eq!(dut.order(), order);
        dut.close(DIR);
        dut.volts(4_000);
        assert_eq!(dut.order(), order);
        dut.open(START_STOP);
        assert_eq!(dut.order(), order);
        dut.close(START_STOP);
        assert_eq!(dut.order(), Order::Velocity(-2_398), "818 of 1,023");
    }
}

#[test]
fn an_alarm_is_cleared_by_its_contact_and_start_stop_has_to_be_off() {
    let mut dut = Dut::connected();
    dut.volts(5_000);
    dut.close(START_STOP);
    dut.alarm(true);
    assert_eq!(dut.order(), Order::Free);
    dut.close(ALARM_RESET);
    dut.open(ALARM_RESET);
    assert_ne!(dut.get(Pid::CTRL_STATUS), 0, "the cause is there");
    dut.alarm(false);
    // A signal that changes to ON during an alarm starts nothing.
    dut.open(START_STOP);
    dut.close(START_STOP);
    dut.close(ALARM_RESET);
    assert_eq!((dut.get(Pid::CTRL_STATUS), dut.order()), (0, Order::Free));
    dut.open(START_STOP);
    dut.close(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(3_000));
}

#[test]
fn run_brake_brakes_what_was_dropped_too() {
    let drop: [fn(&mut Dut); 2] = [
        |dut| dut.set(Pid::TQ_OFF, 0),
        |dut| {
            dut.alarm(true);
            dut.alarm(false);
            dut.set(Pid::ALARM_RESET, 0);
        },
    ];
    for (way, drop) in drop.into_iter().enumerate() {
        let mut dut = Dut::connected();
        dut.set(Pid::TAR_VEL, 1_500);
        dut.close(START_STOP);
        drop(&mut dut);
        assert_eq!(dut.order(), Order::Free, "{way}");
        dut.open(RUN_BRAKE);
        assert_eq!(dut.order(), Order::Brake, "{way}");
        dut.close(RUN_BRAKE);
        assert_eq!(dut.order(), Order::Free, "{way}: START/STOP has to come");
        dut.set(Pid::RUN_INV_SIGN, 1);
        assert_eq!(dut.order(), Order::Brake, "{way}");
        dut.open(START_STOP);
        dut.close(START_STOP);
        assert_eq!(dut.order(), Order::Brake, "{way}");
        dut.open(RUN_BRAKE);
        assert_eq!(dut.order(), Order::Velocity(1_500), "{way}");
    }
}

#[test]
fn run_brake_that_is_off_brakes_after_an_alarm_and_when_the_connectors_take_over() {
    let mut dut = Dut::ready();
    dut.alarm(true);
    dut.set(Pid::ALARM_RESET, 0);
    assert_eq!(dut.order(), Order::Free, "the alarm is still there");
    dut.alarm(false);
    dut.set(Pid::ALARM_RESET, 0);
    assert_eq!(dut.order(), Order::Brake);
    dut.set(Pid::TQ_OFF, 0);
    dut.set(Pid::ALARM_RESET, 0);
    assert_eq!(dut.order(), Order::Free, "there was no alarm");
    dut.set(Pid::UI_COM, 1);
    dut.open(RUN_BRAKE);
    assert_eq!(dut.order(), Order::Free, "it is of no interest to the bus");
    dut.set(Pid::UI_COM, 0);
    assert_eq!(dut.order(), Order::Brake);
}

#[test]
fn the_contacts_do_nothing_while_the_bus_commands() {
    let mut dut = Dut::connected();
    dut.set(Pid::USE_LIMIT_SW, 0);
    dut.set(Pid::UI_COM, 1);
    dut.volts(5_000);
    for pin in [RUN_BRAKE, START_STOP, DIR] {
        dut.close(pin);
        dut.open(pin);
        dut.close(pin);
        assert_eq!(dut.order(), Order::Velocity(0));
    }
    assert_eq!(dut.get(Pid::DI), 0b111_1100, "they are read");
    dut.set(Pid::UI_COM, 0);
    assert_eq!(dut.order(), Order::Velocity(0), "START/STOP has to be off before");
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.close(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(-3_000));
}

#[test]
fn seven_steps() {
    let mut dut = Dut::ready();
    dut.set(Pid::MAX_RPM, 400);
    dut.set(Pid::INPUT_TYPE, 5);
    dut.set(Pid::TAR_VEL, 123);
    // Speeds are sevenths, rounded down (MDROBOT-24). The manual's order of the bits is INT_SPEED, RUN/BRAKE,
    // START/STOP.
    for (step, rpm) in [0, 57, 114, 171, 228, 285, 342, 400].into_iter().enumerate() {
        for (bit, pin) in [INT_SPEED, RUN_BRAKE, START_STOP].into_iter().enumerate() {
            dut.edge(pin, step >> bit & 1 == 0);
        }
        dut.open(DIR);
        assert_eq!(dut.order(), Order::Velocity(rpm), "{step}");
        dut.close(DIR);
        assert_eq!(dut.order(), Order::Velocity(-rpm), "{step}");
    }
    dut.set(Pid::MAX_RPM, 3_500);
    assert_eq!(dut.order(), Order::Velocity(-3_500));
    dut.set(Pid::TQ_OFF, 0);
    dut.open(INT_SPEED);
    assert_eq!(dut.order(), Order::Free, "the number has not been 0");
    dut.open(RUN_BRAKE);
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Free);
    dut.close(INT_SPEED);
    assert_eq!(dut.order(), Order::Velocity(-500), "a seventh");
}

#[test]
fn inv_sign_cmd_turns_the_connectors_round() {
    let mut dut = Dut::connected();
    dut.volts(5_000);
    dut.close(START_STOP);
    dut.set(Pid::INV_SIGN_CMD, 1);
    assert_eq!(dut.order(), Order::Velocity(-3_000));
}
