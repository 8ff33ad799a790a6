//! Commands from the bus (MDROBOT-12 to MDROBOT-18).

use super::*;

/// The value of a position command: counts in the two low words, a speed in the third.
fn at_speed(count: i32, rpm: i16) -> i64 {
    i64::from(rpm.cast_unsigned()) << 32 | i64::from(count.cast_unsigned())
}

#[test]
fn a_velocity_needs_both_arms() {
    for (ui_com, start_stop, drives) in
        [(0, 0, false), (0, 1, false), (1, 0, false), (1, 1, true), (1, 2, true)]
    {
        for (pid, order) in [
            (Pid::VEL_CMD, Order::Velocity(500)),
            (Pid::OPEN_VEL_CMD, Order::Open(500)),
            (Pid::TQ_CMD, Order::Torque(500)),
        ] {
            let mut dut = Dut::ready();
            dut.set(Pid::UI_COM, ui_com);
            dut.set(Pid::START_STOP, start_stop);
            let before = dut.order();
            dut.set(pid, 500);
            assert_eq!(dut.order(), if drives { order } else { before }, "{pid:?} {ui_com} {start_stop}");
            assert_eq!(dut.get(pid), 500);
        }
    }
}

#[test]
fn what_was_written_before_arming_is_for_reading_only() {
    let mut dut = Dut::ready();
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::UI_COM, 1);
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::START_STOP, 1);
    assert_eq!((dut.order(), dut.get(Pid::VEL_CMD)), (Order::Velocity(0), 500));
    dut.set(Pid::VEL_CMD, 600);
    assert_eq!(dut.order(), Order::Velocity(600));
}

#[test]
fn the_speed_of_start_stop_drives_from_the_write_of_either() {
    let mut dut = Dut::armed();
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.set(Pid::COM_TAR_SPEED, 700);
    assert_eq!(dut.order(), Order::Velocity(700), "1 is CCW");
    dut.set(Pid::START_STOP, 2);
    assert_eq!(dut.order(), Order::Velocity(-700), "2 is CW");
    dut.set(Pid::START_STOP, 0);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.set(Pid::COM_TAR_SPEED, 800);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.set(Pid::START_STOP, 1);
    assert_eq!(dut.order(), Order::Velocity(800));
    dut.set(Pid::COM_TAR_SPEED, 0);
    assert_eq!(dut.order(), Order::Velocity(0));
}

#[test]
fn without_a_speed_start_stop_arms_and_no_more() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::COM_TAR_SPEED, 0);
    dut.set(Pid::START_STOP, 2);
    assert_eq!(dut.order(), Order::Velocity(500));
    // START_STOP does not take its speed from `TAR_VEL` (MDROBOT-13).
    dut.set(Pid::TAR_VEL, 900);
    dut.set(Pid::START_STOP, 1);
    assert_eq!(dut.order(), Order::Velocity(500));
}

#[test]
fn start_stop_0_stops_and_disarms() {
    for (pid, value) in
        [(Pid::VEL_CMD, 500), (Pid::OPEN_VEL_CMD, 500), (Pid::TQ_CMD, 500), (Pid::POSI_CMD, 500)]
    {
        let mut dut = Dut::armed();
        dut.set(pid, value);
        assert_ne!(dut.order(), Order::Velocity(0));
        dut.set(Pid::START_STOP, 0);
        assert_eq!(dut.order(), Order::Velocity(0), "{pid:?}");
        dut.set(Pid::VEL_CMD, 600);
        assert_eq!(dut.order(), Order::Velocity(0), "{pid:?}");
    }
}

#[test]
fn the_last_command_decides() {
    let mut dut = Dut::armed();
    let script = [
        (Pid::VEL_CMD, 500, Order::Velocity(500)),
        (Pid::OPEN_VEL_CMD, -300, Order::Open(-300)),
        (Pid::TQ_CMD, 200, Order::Torque(200)),
        (Pid::COM_TAR_SPEED, 400, Order::Velocity(400)),
        (Pid::POSI_CMD, 1_000, Order::Position { count: 1_000, rpm: 3_000 }),
        (Pid::VEL_CMD, -1, Order::Velocity(-1)),
        (Pid::START_STOP, 2, Order::Velocity(-400)),
        (Pid::BRAKE, 0, Order::Brake),
        (Pid::POSI_VEL_CMD, at_speed(-7, 250), Order::Position { count: -7, rpm: 250 }),
        (Pid::TQ_OFF, 0xFFFF, Order::Free),
        (Pid::VEL_CMD, 100, Order::Velocity(100)),
        (Pid::VEL_CMD, 0, Order::Velocity(0)),
    ];
    for (pid, value, order) in script {
        dut.set(pid, value);
        assert_eq!(dut.order(), order, "{pid:?} = {value}");
    }
}

#[test]
fn a_freed_or_braked_motor_obeys_the_next_command() {
    for (pid, order) in [(Pid::TQ_OFF, Order::Free), (Pid::BRAKE, Order::Brake)] {
        let mut dut = Dut::armed();
        dut.set(Pid::VEL_CMD, 500);
        dut.set(pid, 1);
        assert_eq!(dut.order(), order);
        dut.wait(1.secs());
        dut.set(Pid::INV_SIGN_CMD, 1);
        assert_eq!(dut.order(), order, "no command");
        dut.set(Pid::VEL_CMD, 500);
        assert_eq!(dut.order(), Order::Velocity(-500));
    }
}

#[test]
fn zero_and_another_side_leave_what_was_dropped() {
    for (pid, order) in [(Pid::TQ_OFF, Order::Free), (Pid::BRAKE, Order::Brake)] {
        for (zero, value) in
            [(Pid::START_STOP, 0), (Pid::VEL_CMD, 0), (Pid::COM_TAR_SPEED, 0), (Pid::FUNC_CMD_TYPE, 3)]
        {
            let mut dut = Dut::armed();
            dut.close(RUN_BRAKE);
            dut.set(Pid::VEL_CMD, 500);
            dut.set(pid, 0);
            dut.set(zero, value);
            assert_eq!(dut.order(), order, "{pid:?} {zero:?}");
        }
        let mut dut = Dut::armed();
        dut.close(RUN_BRAKE);
        dut.set(pid, 0);
        for ui_com in [0, 1] {
            dut.set(Pid::UI_COM, ui_com);
            assert_eq!(dut.order(), order, "{pid:?} {ui_com}");
        }
        dut.set(Pid::VEL_CMD, 500);
        assert_eq!(dut.order(), Order::Velocity(500), "{pid:?}");
    }
}

#[test]
fn positions_need_ui_com_only() {
    let mut dut = Dut::ready();
    let before = dut.order();
    dut.set(Pid::POSI_CMD, 1_000);
    assert_eq!(dut.order(), before);
    dut.set(Pid::UI_COM, 1);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.set(Pid::POSI_CMD, 1_000);
    assert_eq!(dut.order(), Order::Position { count: 1_000, rpm: 3_000 });
}

#[test]
fn positions_are_32_bits_and_their_speed_a_magnitude() {
    let mut dut = Dut::armed();
    dut.set(Pid::POSI_CMD, -100_000);
    assert_eq!(dut.order(), Order::Position { count: -100_000, rpm: 3_000 });
    for (rpm, most) in [(250, 250), (-250, 250), (0, 0), (4_000, 3_000), (i16::MIN, 3_000)] {
        dut.set(Pid::POSI_VEL_CMD, at_speed(100_000, rpm));
        assert_eq!(dut.order(), Order::Position { count: 100_000, rpm: most }, "{rpm}");
    }
    dut.set(Pid::POSI_VEL_CMD, at_speed(i32::MIN, 1));
    assert_eq!(dut.order(), Order::Position { count: i32::MIN, rpm: 1 });
}

#[test]
fn increments_begin_where_the_motor_is() {
    let mut dut = Dut::armed();
    dut.set(Pid::POSI_CMD, 1_000);
    dut.turn(20);
    dut.set(Pid::INC_POSI_CMD, 5);
    assert_eq!(dut.order(), Order::Position { count: 25, rpm: 3_000 });
    dut.turn(-30);
    dut.set(Pid::INC_POSI_VEL_CMD, at_speed(-5, 100));
    assert_eq!(dut.order(), Order::Position { count: -15, rpm: 100 });
}

#[test]
fn positions_end_where_32_bits_do() {
    for (start, counts, end) in [(20, i32::MAX, i32::MAX), (-20, i32::MIN, i32::MIN)] {
        let mut dut = Dut::armed();
        dut.turn(start);
        dut.set(Pid::INC_POSI_CMD, counts.into());
        assert_eq!(dut.order(), Order::Position { count: end, rpm: 3_000 });
    }
    let mut dut = Dut::armed();
    dut.set(Pid::INV_SIGN_CMD, 1);
    dut.set(Pid::POSI_CMD, i32::MIN.into());
    assert_eq!(dut.order(), Order::Position { count: i32::MAX, rpm: 3_000 });
}

#[test]
fn a_target_moves_along_when_the_position_is_cleared() {
    let mut dut = Dut::armed();
    dut.turn(20);
    dut.set(Pid::POSI_CMD, 100);
    dut.set(Pid::POSI_RESET, 0);
    dut.set(Pid::MAX_RPM, 2_000);
    assert_eq!(dut.order(), Order::Position { count: 80, rpm: 2_000 });
    assert_eq!((dut.get(Pid::TAR_POSI), dut.get(Pid::POSI_DATA)), (80, 0));
}

#[test]
fn inv_sign_cmd_turns_everything_round() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::INV_SIGN_CMD, 1);
    assert_eq!(dut.order(), Order::Velocity(-500), "at once");
    assert_eq!(dut.get(Pid::VEL_CMD), 500);
    dut.set(Pid::OPEN_VEL_CMD, 300);
    assert_eq!(dut.order(), Order::Open(-300));
    dut.set(Pid::TQ_CMD, -300);
    assert_eq!(dut.order(), Order::Torque(300));
    dut.set(Pid::COM_TAR_SPEED, 400);
    assert_eq!(dut.order(), Order::Velocity(-400));
    dut.set(Pid::POSI_CMD, 1_000);
    assert_eq!(dut.order(), Order::Position { count: -1_000, rpm: 3_000 });
    dut.turn(7);
    dut.set(Pid::INC_POSI_CMD, 10);
    assert_eq!(dut.order(), Order::Position { count: -3, rpm: 3_000 });
    dut.set(Pid::INV_SIGN_CMD, 0);
    assert_eq!(dut.order(), Order::Position { count: -3, rpm: 3_000 }, "from the next command on");
}

#[test]
fn max_rpm_limits_where_it_acts() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, -4_500);
    assert_eq!((dut.order(), dut.get(Pid::VEL_CMD)), (Order::Velocity(-3_000), -4_500));
    dut.set(Pid::MAX_RPM, 4_000);
    assert_eq!(dut.order(), Order::Velocity(-4_000));
    dut.set(Pid::VEL_CMD, i16::MIN.into());
    dut.set(Pid::MAX_RPM, 60_000);
    assert_eq!(dut.order(), Order::Velocity(-5_000), "no more than 5,000");
    dut.set(Pid::COM_TAR_SPEED, 65_535);
    assert_eq!(dut.order(), Order::Velocity(5_000));
}

#[test]
fn switching_over_stops_the_motor() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::UI_COM, 1);
    assert_eq!(dut.order(), Order::Velocity(500), "that is no other side");
    dut.set(Pid::UI_COM, 0);
    assert_eq!(dut.order(), Order::Brake, "RUN/BRAKE is not wired");
    dut.set(Pid::VEL_CMD, 500);
    assert_eq!(dut.order(), Order::Brake);
    dut.set(Pid::UI_COM, 1);
    assert_eq!(dut.order(), Order::Velocity(0));
    dut.set(Pid::VEL_CMD, 500);
    assert_eq!(dut.order(), Order::Velocity(500), "START_STOP is still 1");
}

#[test]
fn a_command_before_the_start_is_over_is_kept_for_reading_only() {
    for pid in [Pid::VEL_CMD, Pid::OPEN_VEL_CMD, Pid::TQ_CMD, Pid::COM_TAR_SPEED, Pid::POSI_CMD, Pid::BRAKE] {
        let mut dut = Dut::starting(false);
        for (pid, value) in [(Pid::UI_COM, 1), (Pid::START_STOP, 1), (pid, 500)] {
            dut.set(pid, value);
        }
        assert_eq!(dut.order(), Order::Free, "{pid:?}");
        dut.start();
        assert_eq!((dut.now, dut.order()), (300.millis().into(), Order::Velocity(0)), "{pid:?}");
        assert_eq!((dut.get(Pid::UI_COM), dut.get(Pid::START_STOP), dut.get(pid)), (1, 1, 500), "{pid:?}");
        dut.set(Pid::VEL_CMD, 600);
        assert_eq!(dut.order(), Order::Velocity(600), "{pid:?}: it is armed");
    }
}

#[test]
fn an_alarm_drops_the_reference_and_the_next_command_drives() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    dut.alarm(true);
    assert_eq!(dut.order(), Order::Free);
    for (pid, value) in [(Pid::VEL_CMD, 500), (Pid::POSI_CMD, 500), (Pid::BRAKE, 0), (Pid::START_STOP, 0)] {
        dut.set(pid, value);
        assert_eq!(dut.order(), Order::Free, "{pid:?}");
    }
    dut.set(Pid::START_STOP, 1);
    dut.alarm(false);
    dut.set(Pid::ALARM_RESET, 0);
    assert_eq!(dut.order(), Order::Free);
    dut.set(Pid::VEL_CMD, 500);
    assert_eq!(dut.order(), Order::Velocity(500));
}

#[test]
fn nothing_is_followed_after_an_alarm_whoever_commands_by_then() {
    let mut dut = Dut::armed();
    dut.close(RUN_BRAKE);
    dut.set(Pid::VEL_CMD, 500);
    for ui_com in [0, 1] {
        dut.alarm(true);
        dut.set(Pid::UI_COM, ui_com);
        dut.alarm(false);
        dut.set(Pid::ALARM_RESET, 0);
        assert_eq!(dut.order(), Order::Free, "{ui_com}");
        dut.set(Pid::TQ_CTRL, 1);
        assert_eq!(dut.order(), Order::Free, "{ui_com}: no command");
    }
}
