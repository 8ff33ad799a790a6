//! Limit switches (p. 7; decisions, MDROBOT 23): DIR permits CW, START/STOP CCW.

use super::*;

/// Everything that the bus may ask for, one way and the other.
const COMMANDS: [(Pid, [i64; 2]); 5] = [
    (Pid::VEL_CMD, [500, -500]),
    (Pid::OPEN_VEL_CMD, [300, -300]),
    (Pid::TQ_CMD, [300, -300]),
    (Pid::POSI_CMD, [1_000, -1_000]),
    (Pid::INC_POSI_CMD, [1_000, -1_000]),
];

impl Bed {
    /// Armed, with both switches closed.
    fn limited() -> Self {
        let mut bed = Self::armed();
        bed.close(DIR);
        bed.close(START_STOP);
        bed
    }
}

#[test]
fn opening_one_stops_what_it_forbids_and_the_next_command_drives() {
    for (pid, ways) in COMMANDS {
        for (forbidden, permitted, switch, other) in
            [(ways[0], ways[1], START_STOP, DIR), (ways[1], ways[0], DIR, START_STOP)]
        {
            for (cond, stopped) in [(0, Order::Free), (1, Order::Brake)] {
                let mut bed = Bed::limited();
                bed.set(Pid::LIMIT_STOP_COND, cond);
                bed.set(pid, forbidden);
                let order = bed.order();
                bed.open(other);
                assert_eq!(bed.order(), order, "{pid:?}: the other one forbids nothing");
                bed.close(other);
                bed.open(switch);
                assert_eq!(bed.order(), stopped, "{pid:?}");
                bed.set(pid, forbidden);
                assert_eq!(bed.order(), stopped, "{pid:?}");
                bed.set(pid, permitted);
                assert_ne!(bed.order(), stopped, "{pid:?}: the way back is open");
                bed.set(pid, forbidden);
                bed.close(switch);
                assert_eq!(bed.order(), stopped, "{pid:?}: it was dropped");
                bed.set(pid, forbidden);
                assert_eq!(bed.order(), order, "{pid:?}");
            }
        }
    }
}

#[test]
fn one_that_is_not_wired_permits() {
    let mut bed = Bed::armed();
    bed.set(Pid::VEL_CMD, 500);
    assert_eq!(bed.order(), Order::Velocity(500));
    bed.close(START_STOP);
    bed.unwire(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(500));
    bed.open(START_STOP);
    assert_eq!(bed.order(), Order::Free);
}

#[test]
fn they_act_only_if_they_are_used() {
    let mut bed = Bed::limited();
    bed.set(Pid::USE_LIMIT_SW, 0);
    bed.set(Pid::VEL_CMD, 500);
    bed.open(START_STOP);
    bed.open(DIR);
    assert_eq!(bed.order(), Order::Velocity(500));
    bed.set(Pid::USE_LIMIT_SW, 1);
    assert_eq!(bed.order(), Order::Free, "from the write on");
}

#[test]
fn inv_sign_cmd_turns_the_way_that_is_forbidden() {
    let mut bed = Bed::limited();
    bed.set(Pid::INV_SIGN_CMD, 1);
    bed.set(Pid::VEL_CMD, 500);
    bed.open(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(-500));
    bed.open(DIR);
    assert_eq!(bed.order(), Order::Free);
}

#[test]
fn a_reversal_towards_an_open_one_stops() {
    let mut bed = Bed::limited();
    bed.set(Pid::COM_TAR_SPEED, 500);
    bed.open(DIR);
    assert_eq!(bed.order(), Order::Velocity(500));
    bed.set(Pid::START_STOP, 2);
    assert_eq!(bed.order(), Order::Free);
    bed.set(Pid::START_STOP, 1);
    assert_eq!(bed.order(), Order::Velocity(500));
}

#[test]
fn a_motor_that_is_where_it_was_to_go_is_left_there() {
    let mut bed = Bed::limited();
    bed.set(Pid::POSI_CMD, 10);
    bed.turn(8);
    bed.wait(2_000.millis());
    bed.set(Pid::IN_POSITION, 2);
    bed.open(START_STOP);
    bed.open(DIR);
    assert_eq!(bed.order(), Order::Position { count: 10, rpm: 3_000 });
    bed.set(Pid::IN_POSITION, 0);
    bed.close(DIR);
    assert_eq!(bed.order(), Order::Free, "it has a way to go");
}

#[test]
fn the_furthest_position_is_forbidden_as_the_nearest_is() {
    for (start, count, switch, other) in [(100, i32::MIN, DIR, START_STOP), (-100, i32::MAX, START_STOP, DIR)]
    {
        let mut bed = Bed::limited();
        bed.turn(start);
        bed.wait(2_000.millis());
        bed.set(Pid::POSI_CMD, count.into());
        bed.open(other);
        assert_eq!(bed.order(), Order::Position { count, rpm: 3_000 });
        bed.open(switch);
        assert_eq!(bed.order(), Order::Free);
    }
}

#[test]
fn they_are_judged_from_the_end_of_the_start_on() {
    let mut bed = Bed::starting(false);
    bed.open(START_STOP);
    bed.start();
    for (pid, value) in [(Pid::UI_COM, 1), (Pid::START_STOP, 1), (Pid::VEL_CMD, 500)] {
        bed.set(pid, value);
    }
    assert_eq!(bed.order(), Order::Free);
}

#[test]
fn they_stop_functions_too() {
    for function in [1, 2, 3, 4] {
        let mut bed = Bed::limited();
        bed.set(Pid::FUNC_CMD_TYPE, function);
        bed.set(Pid::FUNC_CMD, 1);
        assert_ne!(bed.order(), Order::Velocity(0), "{function}");
        bed.open(START_STOP);
        assert_eq!(bed.order(), Order::Free, "{function}");
        bed.close(START_STOP);
        bed.wait(2.secs());
        assert_eq!(bed.order(), Order::Free, "{function}");
        bed.set(Pid::FUNC_CMD, 0);
        bed.set(Pid::FUNC_CMD, 1);
        assert_ne!(bed.order(), Order::Free, "{function}");
    }
}
