//! Functions (p. 17, 18; decisions, MDROBOT 20).

use super::*;

/// 800 rpm for 0.5 s.
const SPEED: i64 = 5 << 16 | 800;
const TICK: Duration = Duration::TICK;

impl Bed {
    /// A drive with a function, which START/STOP or FUNC_CMD may start.
    fn of_function(number: i64) -> Self {
        let mut bed = Self::ready();
        bed.set(Pid::FUNC_SPEED, SPEED);
        bed.set(Pid::FUNC_POSI, 240 << 16 | 1_500);
        bed.set(Pid::FUNC_CMD_TYPE, number);
        bed
    }

    /// The signal, by the contact or by the bus.
    fn signal(&mut self, by_bus: bool, on: bool) {
        if by_bus {
            self.set(Pid::FUNC_CMD, if on { 0x0100 } else { 0 });
        } else if on {
            self.close(START_STOP);
        } else {
            self.open(START_STOP);
        }
    }
}

const RUNS: Order = Order::Velocity(800);
const STANDS: Order = Order::Velocity(0);

#[test]
fn speed_runs_its_time_whatever_the_signal_does() {
    for by_bus in [false, true] {
        let mut bed = Bed::of_function(1);
        assert_eq!(bed.order(), STANDS);
        bed.signal(by_bus, true);
        assert_eq!(bed.order(), RUNS);
        bed.wait(200.millis());
        bed.signal(by_bus, false);
        bed.wait(100.millis());
        bed.signal(by_bus, true);
        bed.wait(200.millis() - TICK);
        assert_eq!(bed.order(), RUNS);
        bed.wait(TICK);
        assert_eq!(bed.order(), STANDS, "0.5 s from the first edge");
        bed.wait(1.secs());
        assert_eq!(bed.order(), STANDS, "ON has to come");
        bed.signal(by_bus, false);
        bed.signal(by_bus, true);
        assert_eq!(bed.order(), RUNS);
    }
}

#[test]
fn speed_momentary_runs_while_on() {
    for by_bus in [false, true] {
        let mut bed = Bed::of_function(3);
        bed.signal(by_bus, true);
        bed.wait(5.secs());
        assert_eq!(bed.order(), RUNS);
        bed.signal(by_bus, false);
        assert_eq!(bed.order(), STANDS);
    }
}

#[test]
fn speed_add_runs_until_time_and_signal_are_over() {
    for by_bus in [false, true] {
        // OFF first.
        let mut bed = Bed::of_function(4);
        bed.signal(by_bus, true);
        bed.wait(100.millis());
        bed.signal(by_bus, false);
        bed.wait(400.millis() - TICK);
        assert_eq!(bed.order(), RUNS);
        bed.wait(TICK);
        assert_eq!(bed.order(), STANDS);
        // Time first.
        bed.signal(by_bus, true);
        bed.wait(2.secs());
        assert_eq!(bed.order(), RUNS);
        bed.signal(by_bus, false);
        assert_eq!(bed.order(), STANDS);
        // ON again in between does not lengthen its time.
        bed.signal(by_bus, true);
        bed.wait(300.millis());
        bed.signal(by_bus, false);
        bed.signal(by_bus, true);
        bed.wait(100.millis());
        bed.signal(by_bus, false);
        bed.wait(100.millis());
        assert_eq!(bed.order(), STANDS);
    }
}

#[test]
fn position_goes_so_far_from_where_the_motor_is() {
    for by_bus in [false, true] {
        let mut bed = Bed::of_function(2);
        bed.turn(10);
        bed.signal(by_bus, true);
        assert_eq!(bed.order(), Order::Position { count: 250, rpm: 1_500 });
        bed.wait(5.secs());
        bed.signal(by_bus, false);
        assert_eq!(bed.order(), Order::Position { count: 250, rpm: 1_500 }, "it is held");
        bed.turn(5);
        bed.set(Pid::FUNC_POSI, 0xFFF0 << 16 | 100);
        bed.signal(by_bus, true);
        assert_eq!(bed.order(), Order::Position { count: 15 - 16, rpm: 100 });
    }
}

#[test]
fn only_the_function_drives() {
    let mut bed = Bed::armed();
    bed.set(Pid::VEL_CMD, 500);
    bed.set(Pid::FUNC_CMD_TYPE, 3);
    assert_eq!(bed.order(), STANDS);
    bed.set(Pid::COM_TAR_SPEED, 500);
    for pid in
        [Pid::VEL_CMD, Pid::OPEN_VEL_CMD, Pid::TQ_CMD, Pid::COM_TAR_SPEED, Pid::POSI_CMD, Pid::INC_POSI_CMD]
    {
        bed.set(pid, 500);
        assert_eq!(bed.order(), STANDS, "{pid:?}");
    }
    bed.close(START_STOP);
    assert_eq!(bed.order(), STANDS, "it is a limit switch");
    bed.set(Pid::FUNC_SPEED, 5 << 16 | 0xFF38);
    bed.set(Pid::FUNC_CMD, 1);
    assert_eq!(bed.order(), Order::Velocity(-200));
    bed.set(Pid::FUNC_SPEED, SPEED);
    bed.set(Pid::INV_SIGN_CMD, 1);
    assert_eq!(bed.order(), Order::Velocity(200), "its speed is that of the edge");
    bed.set(Pid::FUNC_CMD_TYPE, 0);
    bed.set(Pid::VEL_CMD, 500);
    assert_eq!(bed.order(), Order::Velocity(-500));
}

#[test]
fn the_connectors_do_not_drive_beside_a_function() {
    let mut bed = Bed::of_function(3);
    bed.volts(5_000);
    bed.close(RUN_BRAKE);
    assert_eq!(bed.order(), STANDS);
    bed.open(RUN_BRAKE);
    bed.close(DIR);
    bed.close(START_STOP);
    assert_eq!(bed.order(), RUNS, "by its own speed, whatever RUN/BRAKE and DIR are");
    bed.set(Pid::FUNC_CMD_TYPE, 0);
    assert_eq!(bed.order(), Order::Brake);
    bed.close(RUN_BRAKE);
    assert_eq!(bed.order(), STANDS, "START/STOP has to be off before");
    bed.open(START_STOP);
    bed.close(START_STOP);
    assert_eq!(bed.order(), Order::Velocity(-3_000));
}

#[test]
fn another_type_ends_what_runs() {
    for first in 1..=4 {
        for second in (0..=4).filter(|second| *second != first) {
            let mut bed = Bed::of_function(first);
            bed.close(RUN_BRAKE);
            bed.close(START_STOP);
            let order = bed.order();
            assert_ne!(order, STANDS);
            bed.set(Pid::FUNC_CMD_TYPE, first);
            assert_eq!(bed.order(), order, "the same one");
            bed.set(Pid::FUNC_CMD_TYPE, second);
            assert_eq!(bed.order(), STANDS, "{first} {second}");
            bed.wait(2.secs());
            assert_eq!(bed.order(), STANDS, "{first} {second}");
        }
    }
}

#[test]
fn it_ends_with_what_ends_every_command() {
    for (pid, value, order) in
        [(Pid::TQ_OFF, 0, Order::Free), (Pid::BRAKE, 0, Order::Brake), (Pid::UI_COM, 1, STANDS)]
    {
        for number in 1..=4 {
            let mut bed = Bed::of_function(number);
            bed.close(START_STOP);
            bed.set(pid, value);
            assert_eq!(bed.order(), order, "{pid:?} {number}");
            bed.wait(2.secs());
            assert_eq!(bed.order(), order, "{pid:?} {number}");
        }
    }
}

#[test]
fn no_time_is_no_run() {
    let mut bed = Bed::of_function(1);
    bed.set(Pid::FUNC_SPEED, 800);
    bed.signal(true, true);
    assert_eq!(bed.order(), STANDS);
    let mut bed = Bed::of_function(4);
    bed.set(Pid::FUNC_SPEED, 800);
    bed.signal(true, true);
    bed.wait(1.secs());
    assert_eq!(bed.order(), RUNS, "while ON");
    bed.signal(true, false);
    assert_eq!(bed.order(), STANDS);
}

#[test]
fn the_longest_time_is_6553_and_a_half_seconds() {
    let mut bed = Bed::of_function(1);
    bed.set(Pid::FUNC_SPEED, 0xFFFF << 16 | 800);
    bed.signal(true, true);
    bed.wait(6_553_500.millis() - TICK);
    assert_eq!(bed.order(), RUNS);
    bed.wait(TICK);
    assert_eq!(bed.order(), STANDS);
}

#[test]
fn what_was_on_before_the_type_starts_nothing() {
    let mut bed = Bed::ready();
    bed.close(START_STOP);
    bed.set(Pid::FUNC_CMD, 1);
    bed.set(Pid::FUNC_CMD_TYPE, 3);
    assert_eq!(bed.order(), STANDS);
    bed.set(Pid::FUNC_CMD, 0);
    bed.set(Pid::FUNC_CMD, 1);
    assert_eq!(bed.order(), STANDS, "START/STOP is ON all the time");
    bed.open(START_STOP);
    bed.set(Pid::FUNC_CMD, 0);
    bed.set(Pid::FUNC_CMD, 2);
    assert_eq!(bed.order(), Order::Velocity(1_000));
}

#[test]
fn what_is_on_when_power_comes_starts_nothing() {
    for number in 1..=4 {
        for by_bus in [false, true] {
            let mut bed = Bed::starting(false);
            bed.set(Pid::FUNC_CMD_TYPE, number);
            bed.signal(by_bus, true);
            bed.start();
            assert_eq!(bed.order(), STANDS, "{number}: ON has to come");
            bed.signal(by_bus, false);
            assert_eq!(bed.order(), STANDS, "{number}");
            bed.signal(by_bus, true);
            assert_ne!(bed.order(), STANDS, "{number}");
        }
    }
}

#[test]
fn start_stop_0_of_the_bus_does_nothing_to_one() {
    for number in 1..=4 {
        let mut bed = Bed::armed();
        bed.set(Pid::FUNC_CMD_TYPE, number);
        bed.set(Pid::FUNC_CMD, 1);
        let order = bed.order();
        assert_ne!(order, STANDS, "{number}");
        for direction in [0, 1, 2] {
            bed.set(Pid::START_STOP, direction);
            assert_eq!(bed.order(), order, "{number} {direction}");
        }
    }
}
