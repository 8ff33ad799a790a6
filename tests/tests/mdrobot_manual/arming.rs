//! Sources of commands (MDROBOT-12 to MDROBOT-15): UI_COM, START_STOP, COM_TAR_SPEED. The last command
//! counts.

use drivetwin_protocol::time::Span;

use crate::pid;
use crate::rig::Rig;

/// VEL_CMD moves the motor only if both UI_COM and START_STOP are set. Otherwise the value can only be read
/// back.
#[test]
fn page_12_velocity_wants_78_and_100() {
    for (ui_com, start_stop, moves) in
        [(0, 0, false), (1, 0, false), (0, 1, false), (0, 2, false), (1, 1, true), (1, 2, true)]
    {
        for rpm in [600, -600] {
            let mut rig = Rig::with(&[(pid::UI_COM, ui_com), (pid::START_STOP, start_stop)]);
            rig.velocity(rpm);
            assert_eq!(rig.signed(pid::VEL_CMD), rpm);
            if moves {
                // The sign of VEL_CMD is the direction, also if START_STOP (PID 100) is 2.
                rig.assert_turns(f64::from(rpm));
            } else {
                rig.assert_stands();
                assert_eq!(rig.position(), 0);
            }
        }
    }
}

/// Open loop and torque commands need UI_COM and START_STOP, too (MDROBOT-13).
#[test]
fn page_12_open_loop_and_torque_want_them_too() {
    for pid in [pid::OPEN_VEL_CMD, pid::TQ_CMD] {
        for (ui_com, start_stop, moves) in
            [(0, 0, false), (1, 0, false), (0, 1, false), (1, 1, true), (1, 2, true)]
        {
            let mut rig = Rig::with(&[(pid::UI_COM, ui_com), (pid::START_STOP, start_stop)]);
            rig.write(pid, 300);
            rig.after(500.millis());
            assert_eq!(rig.shaft() > 100.0, moves, "PID {pid}, {ui_com}, {start_stop}: {}", rig.shaft());
        }
    }
}

/// A velocity that was written before UI_COM and START_STOP are both set does not take effect when they are.
#[test]
fn page_12_a_velocity_before_the_arming() {
    for first in [pid::UI_COM, pid::START_STOP] {
        let second = if first == pid::UI_COM { pid::START_STOP } else { pid::UI_COM };
        let mut rig = Rig::with(&[(first, 1)]);
        rig.velocity(600);
        rig.write(second, 1);
        rig.assert_stands();
        assert_eq!((rig.signed(pid::VEL_CMD), rig.position()), (600, 0));
        rig.velocity(600);
        rig.assert_turns(600.0);
    }
}

/// "0: STOP, 1: CCW direction driving, 2: CW direction driving", at COM_TAR_SPEED (p. 12). The motor starts
/// when the second of the two PIDs is written.
#[test]
fn page_12_com_tar_speed() {
    for (start_stop, sign) in [(1, 1.0), (2, -1.0)] {
        let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::COM_TAR_SPEED, 400)]);
        rig.assert_stands();
        rig.write(pid::START_STOP, start_stop);
        rig.assert_turns(400.0 * sign);
        rig.write(pid::COM_TAR_SPEED, 700);
        rig.assert_turns(700.0 * sign);
        rig.write(pid::START_STOP, 3 - start_stop);
        rig.assert_turns(-700.0 * sign);
        rig.write(pid::START_STOP, 0);
        rig.after(20.secs());
        rig.assert_stands();
        let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::START_STOP, start_stop)]);
        rig.assert_stands();
        rig.write(pid::COM_TAR_SPEED, 400);
        rig.assert_turns(400.0 * sign);
    }
    let mut rig = Rig::with(&[(pid::COM_TAR_SPEED, 400), (pid::START_STOP, 1)]);
    rig.assert_stands();
    assert_eq!(rig.position(), 0, "without UI_COM");
}

/// START_STOP (PID 100) does not use TAR_VEL (MDROBOT-13).
#[test]
fn page_12_tar_vel_is_for_pins() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::TAR_VEL, 500), (pid::START_STOP, 1)]);
    rig.assert_stands();
    assert_eq!(rig.position(), 0);
}

/// START_STOP 0 ramps the reference to zero. Later velocities do not move the motor (MDROBOT-13).
#[test]
fn page_12_start_stop_0() {
    // SLOW_DOWN 682 is 10 s from 3,000 rpm, and so 2 s from 600 rpm.
    let mut rig = Rig::armed(&[(pid::SLOW_DOWN, 682), (pid::STOP_STATUS, 2)]);
    rig.velocity(600);
    rig.assert_turns(600.0);
    rig.write(pid::START_STOP, 0);
    rig.after(1.secs());
    assert!((rig.rpm() - 300.0).abs() <= 48.0, "{} rpm half way down", rig.rpm());
    rig.velocity(600);
    rig.after(1_500.millis());
    assert_eq!(rig.shaft(), 0.0);
    rig.assert_stands();
    rig.velocity(600);
    rig.assert_stands();
    assert_eq!(rig.signed(pid::VEL_CMD), 600);
    rig.write(pid::START_STOP, 1);
    rig.assert_stands();
    rig.velocity(600);
    rig.assert_turns(600.0);
}

/// Position commands need only UI_COM (MDROBOT-13).
#[test]
fn page_16_positions_want_78() {
    let moves: [(u16, &[u16]); 4] = [
        (pid::POSI_CMD, &[60, 0]),
        (pid::INC_POSI_CMD, &[60, 0]),
        (pid::POSI_VEL_CMD, &[60, 0, 300]),
        (pid::INC_POSI_VEL_CMD, &[60, 0, 300]),
    ];
    for (pid, words) in moves {
        for (ui_com, start_stop, moves) in
            [(0, 0, false), (0, 1, false), (1, 0, true), (1, 1, true), (1, 2, true)]
        {
            let mut rig = Rig::with(&[(pid::UI_COM, ui_com), (pid::START_STOP, start_stop)]);
            rig.write_words(pid, words);
            rig.after(4.secs());
            let goal = if moves { 60 } else { 0 };
            assert!(
                rig.position().abs_diff(goal) <= 1,
                "PID {pid}, {ui_com}, {start_stop}: {}",
                rig.position()
            );
        }
    }
}

/// The last command counts, whatever came before (MDROBOT-13).
#[test]
fn page_12_the_last_command() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(600);
    rig.assert_turns(600.0);
    rig.write(pid::COM_TAR_SPEED, 900);
    rig.assert_turns(900.0);
    rig.velocity(-300);
    rig.assert_turns(-300.0);
    rig.write_signed(pid::OPEN_VEL_CMD, 400);
    rig.after(2.secs());
    let open = rig.rpm();
    assert!(open > 800.0, "{open}");
    rig.velocity(500);
    rig.assert_turns(500.0);
    let goal = rig.position() + 300;
    rig.write_long(pid::POSI_CMD, goal);
    rig.after(4.secs());
    assert!(rig.position().abs_diff(goal) <= 1, "{} is not {goal}", rig.position());
    rig.velocity(700);
    rig.assert_turns(700.0);
    rig.write(pid::TQ_CMD, 0);
    rig.after(20.secs());
    assert_eq!(rig.shaft(), 0.0, "no torque");
    rig.write(pid::START_STOP, 2);
    rig.assert_turns(-900.0);
}

/// "If PC sending data is X -> Controller gets -X" (p. 7): INV_SIGN_CMD inverts every reference but no
/// measurement (MDROBOT-15).
#[test]
fn page_7_inv_sign() {
    let mut rig = Rig::armed(&[(pid::INV_SIGN_CMD, 1)]);
    rig.velocity(600);
    assert_eq!(rig.signed(pid::VEL_CMD), 600);
    rig.assert_turns(-600.0);
    assert!(rig.position() < -100);
    rig.velocity(-600);
    rig.assert_turns(600.0);
    rig.write(pid::COM_TAR_SPEED, 500);
    rig.assert_turns(-500.0);
    rig.write(pid::START_STOP, 2);
    rig.assert_turns(500.0);
    rig.write(pid::COM_TAR_SPEED, 0);
    rig.write(pid::OPEN_VEL_CMD, 400);
    rig.after(2.secs());
    assert!(rig.rpm() < -800.0, "{}", rig.rpm());
    rig.write(pid::TQ_OFF, 0);
    rig.after(20.secs());
    rig.write(pid::TQ_CMD, 300);
    rig.after(100.millis());
    assert!(rig.rpm() < 0.0, "{}", rig.rpm());
    // Setting INV_SIGN_CMD back to 0 takes effect at once, too.
    rig.write(pid::INV_SIGN_CMD, 0);
    rig.velocity(400);
    rig.assert_turns(400.0);
}

#[test]
fn page_7_inv_sign_of_a_running_velocity() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(400);
    rig.assert_turns(400.0);
    rig.write(pid::INV_SIGN_CMD, 1);
    rig.assert_turns(-400.0);
}

/// A change of INV_SIGN_CMD applies from the next position command on (MDROBOT-15).
#[test]
fn page_7_inv_sign_of_positions() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
    rig.write_long(pid::POSI_CMD, 100);
    rig.after(3.secs());
    rig.write(pid::INV_SIGN_CMD, 1);
    rig.after(3.secs());
    assert!(rig.position().abs_diff(100) <= 1, "{}", rig.position());
    for (pid, words, goal) in [
        (pid::POSI_CMD, [50, 0, 0], -50),
        (pid::POSI_VEL_CMD, [100, 0, 500], -100),
        (pid::INC_POSI_CMD, [40, 0, 0], -140),
        (pid::INC_POSI_VEL_CMD, [60, 0, 500], -200),
    ] {
        let length = if words[2] == 0 { 2 } else { 3 };
        rig.write_words(pid, &words[..length]);
        rig.after(4.secs());
        // An increment starts at the actual position, so errors of one count may add up.
        assert!(rig.position().abs_diff(goal) <= 3, "PID {pid}: {} is not {goal}", rig.position());
    }
}

/// A change of UI_COM stops the motor (MDROBOT-12).
#[test]
fn page_7_ui_com_stops() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(600);
    rig.assert_turns(600.0);
    rig.write(pid::UI_COM, 0);
    rig.after(20.secs());
    rig.assert_stands();
    rig.write(pid::UI_COM, 1);
    rig.assert_stands();
    rig.velocity(600);
    rig.assert_turns(600.0);
    // A change to the bus stops a motor that the pins drive, too. Before the pins can drive again, START/STOP
    // must be off once (MDROBOT-14).
    let mut rig = Rig::with(&[(pid::TAR_VEL, 500)]);
    rig.open("START_STOP");
    rig.close("RUN_BRAKE");
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    rig.write(pid::UI_COM, 1);
    rig.after(20.secs());
    rig.assert_stands();
}

/// Writing the present value of UI_COM again does not stop the motor.
#[test]
fn page_7_ui_com_again() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(600);
    rig.assert_turns(600.0);
    rig.write(pid::UI_COM, 1);
    rig.command(45);
    rig.assert_turns(600.0);
}

/// While the pins command, references from the bus are echoed and stored, but do not move the motor
/// (MDROBOT-12).
#[test]
fn page_7_ui_com_0_ignores_the_bus() {
    let mut rig = Rig::with(&[(pid::START_STOP, 1)]);
    rig.velocity(600);
    rig.set(&[(pid::COM_TAR_SPEED, 500), (pid::OPEN_VEL_CMD, 500), (pid::TQ_CMD, 500)]);
    rig.write_long(pid::POSI_CMD, 1_000);
    rig.write_move(pid::INC_POSI_VEL_CMD, 1_000, 500);
    rig.assert_stands();
    assert_eq!((rig.position(), rig.read(pid::VEL_CMD)), (0, 600));
}
