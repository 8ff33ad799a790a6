//! Limit switches (p. 7; MDROBOT-23): DIR permits CW, START/STOP CCW.

use super::*;

/// All motion commands of the bus, with a value for each direction.
const COMMANDS: [(Pid, [i64; 2]); 5] = [
    (Pid::VEL_CMD, [500, -500]),
    (Pid::OPEN_VEL_CMD, [300, -300]),
    (Pid::TQ_CMD, [300, -300]),
    (Pid::POSI_CMD, [1_000, -1_000]),
    (Pid::INC_POSI_CMD, [1_000, -1_000]),
];

impl Dut {
    /// A drive that the bus may move, with both switches closed.
    fn limited() -> Self {
        let mut dut = Self::armed();
        dut.close(DIR);
        dut.close(START_STOP);
        dut
    }
}

#[test]
fn opening_one_stops_what_it_forbids_and_the_next_command_drives() {
    for (pid, ways) in COMMANDS {
        for (forbidden, permitted, switch, other) in
            [(ways[0], ways[1], START_STOP, DIR), (ways[1], ways[0], DIR, START_STOP)]
        {
            for (cond, stopped) in [(0, Order::Free), (1, Order::Brake)] {
                let mut dut = Dut::limited();
                dut.set(Pid::LIMIT_STOP_COND, cond);
                dut.set(pid, forbidden);
                let order = dut.order();
                dut.open(other);
                assert_eq!(dut.order(), order, "{pid:?}: the other one forbids nothing");
                dut.close(other);
                dut.open(switch);
                assert_eq!(dut.order(), stopped, "{pid:?}");
                dut.set(pid, forbidden);
                assert_eq!(dut.order(), stopped, "{pid:?}");
                dut.set(pid, permitted);
                assert_ne!(dut.order(), stopped, "{pid:?}: the way back is open");
                dut.set(pid, forbidden);
                dut.close(switch);
                assert_eq!(dut.order(), stopped, "{pid:?}: it was dropped");
                dut.set(pid, forbidden);
                assert_eq!(dut.order(), order, "{pid:?}");
            }
        }
    }
}

#[test]
fn one_that_is_not_wired_permits() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    assert_eq!(dut.order(), Order::Velocity(500));
    dut.close(START_STOP);
    dut.unwire(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(500));
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Free);
}

#[test]
fn they_act_only_if_they_are_used() {
    let mut dut = Dut::limited();
    dut.set(Pid::USE_LIMIT_SW, 0);
    dut.set(Pid::VEL_CMD, 500);
    dut.open(START_STOP);
    dut.open(DIR);
    assert_eq!(dut.order(), Order::Velocity(500));
    dut.set(Pid::USE_LIMIT_SW, 1);
    assert_eq!(dut.order(), Order::Free, "from the write on");
}

#[test]
fn inv_sign_cmd_turns_the_way_that_is_forbidden() {
    let mut dut = Dut::limited();
    dut.set(Pid::INV_SIGN_CMD, 1);
    dut.set(Pid::VEL_CMD, 500);
    dut.open(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(-500));
    dut.open(DIR);
    assert_eq!(dut.order(), Order::Free);
}

#[test]
fn a_reversal_towards_an_open_one_stops() {
    let mut dut = Dut::limited();
    dut.set(Pid::COM_TAR_SPEED, 500);
    dut.open(DIR);
    assert_eq!(dut.order(), Order::Velocity(500));
    dut.set(Pid::START_STOP, 2);
    assert_eq!(dut.order(), Order::Free);
    dut.set(Pid::START_STOP, 1);
    assert_eq!(dut.order(), Order::Velocity(500));
}

#[test]
fn a_motor_that_is_where_it_was_to_go_is_left_there() {
    let mut dut = Dut::limited();
    dut.set(Pid::POSI_CMD, 10);
    dut.turn(8);
    dut.wait(2_000.millis());
    dut.set(Pid::IN_POSITION, 2);
    dut.open(START_STOP);
    dut.open(DIR);
    assert_eq!(dut.order(), Order::Position { count: 10, rpm: 3_000 });
    dut.set(Pid::IN_POSITION, 0);
    dut.close(DIR);
    assert_eq!(dut.order(), Order::Free, "it has a way to go");
}

#[test]
fn the_furthest_position_is_forbidden_as_the_nearest_is() {
    for (start, count, switch, other) in [(100, i32::MIN, DIR, START_STOP), (-100, i32::MAX, START_STOP, DIR)]
    {
        let mut dut = Dut::limited();
        dut.turn(start);
        dut.wait(2_000.millis());
        dut.set(Pid::POSI_CMD, count.into());
        dut.open(other);
        assert_eq!(dut.order(), Order::Position { count, rpm: 3_000 });
        dut.open(switch);
        assert_eq!(dut.order(), Order::Free);
    }
}

#[test]
fn they_are_judged_from_the_end_of_the_start_on() {
    let mut dut = Dut::starting(false);
    dut.open(START_STOP);
    dut.start();
    for (pid, value) in [(Pid::UI_COM, 1), (Pid::START_STOP, 1), (Pid::VEL_CMD, 500)] {
        dut.set(pid, value);
    }
    assert_eq!(dut.order(), Order::Free);
}

#[test]
fn they_stop_functions_too() {
    for function in [1, 2, 3, 4] {
        let mut dut = Dut::limited();
        dut.set(Pid::FUNC_CMD_TYPE, function);
        dut.set(Pid::FUNC_CMD, 1);
        assert_ne!(dut.order(), Order::Velocity(0), "{function}");
        dut.open(START_STOP);
        assert_eq!(dut.order(), Order::Free, "{function}");
        dut.close(START_STOP);
        dut.wait(2.secs());
        assert_eq!(dut.order(), Order::Free, "{function}");
        dut.set(Pid::FUNC_CMD, 0);
        dut.set(Pid::FUNC_CMD, 1);
        assert_ne!(dut.order(), Order::Free, "{function}");
    }
}
