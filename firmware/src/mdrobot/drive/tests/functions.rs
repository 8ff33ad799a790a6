//! Functions (p. 17, 18; MDROBOT-20).

use super::*;

/// `FUNC_SPEED` for 800 rpm during 0.5 s.
const SPEED: i64 = 5 << 16 | 800;
const TICK: Duration = Duration::TICK;

impl Dut {
    /// A drive with a function that START/STOP or `FUNC_CMD` may start.
    fn of_function(number: i64) -> Self {
        let mut dut = Self::ready();
        dut.set(Pid::FUNC_SPEED, SPEED);
        dut.set(Pid::FUNC_POSI, 240 << 16 | 1_500);
        dut.set(Pid::FUNC_CMD_TYPE, number);
        dut
    }

    /// Sets the start signal, by the bus or by the contact.
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
        let mut dut = Dut::of_function(1);
        assert_eq!(dut.order(), STANDS);
        dut.signal(by_bus, true);
        assert_eq!(dut.order(), RUNS);
        dut.wait(200.millis());
        dut.signal(by_bus, false);
        dut.wait(100.millis());
        dut.signal(by_bus, true);
        dut.wait(200.millis() - TICK);
        assert_eq!(dut.order(), RUNS);
        dut.wait(TICK);
        assert_eq!(dut.order(), STANDS, "0.5 s from the first edge");
        dut.wait(1.secs());
        assert_eq!(dut.order(), STANDS, "ON has to come");
        dut.signal(by_bus, false);
        dut.signal(by_bus, true);
        assert_eq!(dut.order(), RUNS);
    }
}

#[test]
fn speed_momentary_runs_while_on() {
    for by_bus in [false, true] {
        let mut dut = Dut::of_function(3);
        dut.signal(by_bus, true);
        dut.wait(5.secs());
        assert_eq!(dut.order(), RUNS);
        dut.signal(by_bus, false);
        assert_eq!(dut.order(), STANDS);
    }
}

#[test]
fn speed_add_runs_until_time_and_signal_are_over() {
    for by_bus in [false, true] {
        // The signal changes to OFF before the time has passed.
        let mut dut = Dut::of_function(4);
        dut.signal(by_bus, true);
        dut.wait(100.millis());
        dut.signal(by_bus, false);
        dut.wait(400.millis() - TICK);
        assert_eq!(dut.order(), RUNS);
        dut.wait(TICK);
        assert_eq!(dut.order(), STANDS);
        // The time passes before the signal changes to OFF.
        dut.signal(by_bus, true);
        dut.wait(2.secs());
        assert_eq!(dut.order(), RUNS);
        dut.signal(by_bus, false);
        assert_eq!(dut.order(), STANDS);
        // Changing to ON again in between does not extend the run time.
        dut.signal(by_bus, true);
        dut.wait(300.millis());
        dut.signal(by_bus, false);
        dut.signal(by_bus, true);
        dut.wait(100.millis());
        dut.signal(by_bus, false);
        dut.wait(100.millis());
        assert_eq!(dut.order(), STANDS);
    }
}

#[test]
fn position_goes_so_far_from_where_the_motor_is() {
    for by_bus in [false, true] {
        let mut dut = Dut::of_function(2);
        dut.turn(10);
        dut.signal(by_bus, true);
        assert_eq!(dut.order(), Order::Position { count: 250, rpm: 1_500 });
        dut.wait(5.secs());
        dut.signal(by_bus, false);
        assert_eq!(dut.order(), Order::Position { count: 250, rpm: 1_500 }, "it is held");
        dut.turn(5);
        dut.set(Pid::FUNC_POSI, 0xFFF0 << 16 | 100);
        dut.signal(by_bus, true);
        assert_eq!(dut.order(), Order::Position { count: 15 - 16, rpm: 100 });
    }
}

#[test]
fn only_the_function_drives() {
    let mut dut = Dut::armed();
    dut.set(Pid::VEL_CMD, 500);
    dut.set(Pid::FUNC_CMD_TYPE, 3);
    assert_eq!(dut.order(), STANDS);
    dut.set(Pid::COM_TAR_SPEED, 500);
    for pid in
        [Pid::VEL_CMD, Pid::OPEN_VEL_CMD, Pid::TQ_CMD, Pid::COM_TAR_SPEED, Pid::POSI_CMD, Pid::INC_POSI_CMD]
    {
        dut.set(pid, 500);
        assert_eq!(dut.order(), STANDS, "{pid:?}");
    }
    dut.close(START_STOP);
    assert_eq!(dut.order(), STANDS, "it is a limit switch");
    dut.set(Pid::FUNC_SPEED, 5 << 16 | 0xFF38);
    dut.set(Pid::FUNC_CMD, 1);
    assert_eq!(dut.order(), Order::Velocity(-200));
    dut.set(Pid::FUNC_SPEED, SPEED);
    dut.set(Pid::INV_SIGN_CMD, 1);
    assert_eq!(dut.order(), Order::Velocity(200), "its speed is that of the edge");
    dut.set(Pid::FUNC_CMD_TYPE, 0);
    dut.set(Pid::VEL_CMD, 500);
    assert_eq!(dut.order(), Order::Velocity(-500));
}

#[test]
fn the_connectors_do_not_drive_beside_a_function() {
    let mut dut = Dut::of_function(3);
    dut.volts(5_000);
    dut.close(RUN_BRAKE);
    assert_eq!(dut.order(), STANDS);
    dut.open(RUN_BRAKE);
    dut.close(DIR);
    dut.close(START_STOP);
    assert_eq!(dut.order(), RUNS, "by its own speed, whatever RUN/BRAKE and DIR are");
    dut.set(Pid::FUNC_CMD_TYPE, 0);
    assert_eq!(dut.order(), Order::Brake);
    dut.close(RUN_BRAKE);
    assert_eq!(dut.order(), STANDS, "START/STOP has to be off before");
    dut.open(START_STOP);
    dut.close(START_STOP);
    assert_eq!(dut.order(), Order::Velocity(-3_000));
}

#[test]
fn another_type_ends_what_runs() {
    for first in 1..=4 {
        for second in (0..=4).filter(|second| *second != first) {
            let mut dut = Dut::of_function(first);
            dut.close(RUN_BRAKE);
            dut.close(START_STOP);
            let order = dut.order();
            assert_ne!(order, STANDS);
            dut.set(Pid::FUNC_CMD_TYPE, first);
            assert_eq!(dut.order(), order, "the same one");
            dut.set(Pid::FUNC_CMD_TYPE, second);
            assert_eq!(dut.order(), STANDS, "{first} {second}");
            dut.wait(2.secs());
            assert_eq!(dut.order(), STANDS, "{first} {second}");
        }
    }
}

#[test]
fn it_ends_with_what_ends_every_command() {
    for (pid, value, order) in
        [(Pid::TQ_OFF, 0, Order::Free), (Pid::BRAKE, 0, Order::Brake), (Pid::UI_COM, 1, STANDS)]
    {
        for number in 1..=4 {
            let mut dut = Dut::of_function(number);
            dut.close(START_STOP);
            dut.set(pid, value);
            assert_eq!(dut.order(), order, "{pid:?} {number}");
            dut.wait(2.secs());
            assert_eq!(dut.order(), order, "{pid:?} {number}");
        }
    }
}

#[test]
fn no_time_is_no_run() {
    let mut dut = Dut::of_function(1);
    dut.set(Pid::FUNC_SPEED, 800);
    dut.signal(true, true);
    assert_eq!(dut.order(), STANDS);
    let mut dut = Dut::of_function(4);
    dut.set(Pid::FUNC_SPEED, 800);
    dut.signal(true, true);
    dut.wait(1.secs());
    assert_eq!(dut.order(), RUNS, "while ON");
    dut.signal(true, false);
    assert_eq!(dut.order(), STANDS);
}

#[test]
fn the_longest_time_is_6553_and_a_half_seconds() {
    let mut dut = Dut::of_function(1);
    dut.set(Pid::FUNC_SPEED, 0xFFFF << 16 | 800);
    dut.signal(true, true);
    dut.wait(6_553_500.millis() - TICK);
    assert_eq!(dut.order(), RUNS);
    dut.wait(TICK);
    assert_eq!(dut.order(), STANDS);
}

#[test]
fn what_was_on_before_the_type_starts_nothing() {
    let mut dut = Dut::ready();
    dut.close(START_STOP);
    dut.set(Pid::FUNC_CMD, 1);
    dut.set(Pid::FUNC_CMD_TYPE, 3);
    assert_eq!(dut.order(), STANDS);
    dut.set(Pid::FUNC_CMD, 0);
    dut.set(Pid::FUNC_CMD, 1);
    assert_eq!(dut.order(), STANDS, "START/STOP is ON all the time");
    dut.open(START_STOP);
    dut.set(Pid::FUNC_CMD, 0);
    dut.set(Pid::FUNC_CMD, 2);
    assert_eq!(dut.order(), Order::Velocity(1_000));
}

#[test]
fn what_is_on_when_power_comes_starts_nothing() {
    for number in 1..=4 {
        for by_bus in [false, true] {
            let mut dut = Dut::starting(false);
            dut.set(Pid::FUNC_CMD_TYPE, number);
            dut.signal(by_bus, true);
            dut.start();
            assert_eq!(dut.order(), STANDS, "{number}: ON has to come");
            dut.signal(by_bus, false);
            assert_eq!(dut.order(), STANDS, "{number}");
            dut.signal(by_bus, true);
            assert_ne!(dut.order(), STANDS, "{number}");
        }
    }
}

#[test]
fn start_stop_0_of_the_bus_does_nothing_to_one() {
    for number in 1..=4 {
        let mut dut = Dut::armed();
        dut.set(Pid::FUNC_CMD_TYPE, number);
        dut.set(Pid::FUNC_CMD, 1);
        let order = dut.order();
        assert_ne!(order, STANDS, "{number}");
        for direction in [0, 1, 2] {
            dut.set(Pid::START_STOP, direction);
            assert_eq!(dut.order(), order, "{number} {direction}");
        }
    }
}
