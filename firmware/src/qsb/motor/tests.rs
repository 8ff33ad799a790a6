//! Tests of moves and jogs in virtual time. The expected positions are half of acceleration times time
//! squared, computed by hand.
#![allow(clippy::float_arithmetic, reason = "the model of the state knows neither plans nor ticks")]

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::time::Span;
use proptest::prelude::*;

use super::*;
use crate::device::LogEvent;
use crate::testing::{Recorder, Treatment};

/// The ramp to 2,000 steps/s takes 0.2 s and 200 steps.
const RATES: Settings = Settings { step_rate: 2_000, acceleration: 10_000, steps: 2_000, jog_rate: 2_000 };

/// A recorder that keeps levels and plans. Any other output of a motor, except a reason, fails the test.
fn recorder() -> Recorder {
    Recorder::default().ruled(|output| match output {
        Output::Level { .. } | Output::Plan { axis: AXIS, .. } => Treatment::Keep,
        Output::Log(LogEvent::Reason(_)) => Treatment::Ignore,
        _ => Treatment::Refuse,
    })
}

impl Recorder {
    fn position_at(&self, at: Instant) -> i32 {
        let plan = self.plans.iter().rfind(|(from, ..)| *from <= at);
        plan.map_or(0, |(.., plan)| plan.position_at(at))
    }

    /// All steps up to `until`, as the step iterator yields them.
    fn walked(&self, until: Instant) -> Vec<crate::motion::Step> {
        let mut steps = Vec::new();
        for (n, (from, _, plan)) in self.plans.iter().enumerate() {
            let until = self.plans.get(n + 1).map_or(until, |(next, ..)| *next);
            steps.extend(StepIterator::new(plan, *from).take_while(|step| step.at <= until));
        }
        steps
    }
}

/// A motor drive, the record of its outputs, and the present time.
struct Dut {
    motor: Motor,
    out: Recorder,
    now: Instant,
    settings: Settings,
}

impl Dut {
    /// A motor drive that is active from the start.
    fn new() -> Self {
        let mut dut = Self::inactive();
        dut.motor.activate(dut.now, &mut dut.out);
        dut
    }

    fn inactive() -> Self {
        let now = Instant::ZERO;
        Self { motor: Motor::new(now), out: recorder(), now, settings: RATES }
    }

    fn run_until(&mut self, until: impl Into<Instant>) {
        let until = until.into();
        while self.motor.deadline() <= until && self.motor.deadline() < Instant::NEVER {
            let due = self.motor.deadline();
            assert!(due >= self.now, "nothing is due in the past");
            self.now = due;
            self.motor.timeout(due, &mut self.out);
        }
        self.now = until;
    }

    fn order(&mut self, order: Order) -> bool {
        self.motor.order(self.now, order, &self.settings, &mut self.out)
    }

    fn order_at(&mut self, ms: u64, order: Order) {
        self.run_until(ms.millis());
        assert!(self.order(order), "{order:?} at {ms} ms");
    }

    fn status(&self) -> u8 {
        self.motor.status(self.now)
    }

    fn position(&self) -> i32 {
        self.out.position_at(self.now)
    }

    /// Asserts the position and MD STATUS at `at`, and that the status was different one tick earlier.
    fn becomes(&mut self, at: impl Into<Instant>, position: i32, status: u8) {
        let at = at.into();
        self.run_until(at - Duration::TICK);
        assert_ne!(self.status(), status, "before {at:?}");
        self.run_until(at);
        assert_eq!((self.position(), self.status()), (position, status), "at {at:?}");
    }

    fn is(&mut self, ms: u64, position: i32, status: u8) {
        self.run_until(ms.millis());
        assert_eq!((self.position(), self.status()), (position, status), "at {ms} ms");
    }
}

const ORDERS: [Order; 6] = [Order::Stop, Order::Quit, Order::Pause, Order::Resume, Order::Move, Order::Jog];

#[test]
fn an_inactive_motor_does_nothing_and_refuses_to_start() {
    let mut dut = Dut::inactive();
    for order in ORDERS {
        assert_eq!(dut.order(order), !matches!(order, Order::Move | Order::Jog), "{order:?}");
    }
    dut.motor.deactivate(dut.now, &mut dut.out);
    assert_eq!((dut.motor.is_active(), dut.status(), dut.motor.deadline()), (false, 0x01, Instant::NEVER));
    assert!(dut.out.levels.is_empty() && dut.out.plans.is_empty());
}

#[test]
fn an_active_motor_has_pulled_its_pins_low_and_stands() {
    let mut dut = Dut::new();
    let now = dut.now;
    assert_eq!(dut.out.levels, [(now, DIO1, Level::Low), (now, DIO2, Level::Low)]);
    assert_eq!(dut.out.plans, [(now, AXIS, Plan::at_rest(now, 0))]);
    dut.motor.activate(now, &mut dut.out);
    assert_eq!((dut.out.levels.len(), dut.out.plans.len()), (2, 1));
    assert_eq!((dut.motor.is_active(), dut.status(), dut.motor.is_forward(now)), (true, 0x11, false));
}

#[test]
fn a_move_is_a_trapezoid() {
    for steps in [2_000, -2_000] {
        let mut dut = Dut::new();
        dut.settings.steps = steps;
        dut.order_at(0, Order::Move);
        let sign = steps.signum();
        dut.is(100, 50 * sign, 0x12);
        dut.is(200, 200 * sign, 0x12);
        dut.is(700, 1_200 * sign, 0x12);
        // 2,000 steps at 2,000 steps/s, plus half the time of each ramp.
        dut.becomes(1_200.millis(), steps, 0x11);
        let made = dut.out.walked(Instant::NEVER);
        assert_eq!(made.len(), 2_000);
        assert!(made.iter().all(|step| step.forward == (steps > 0)));
        assert_eq!(made.last().map(|step| step.at), Some(1_200.millis().into()));
    }
}

#[test]
fn a_short_move_is_a_triangle() {
    let mut dut = Dut::new();
    dut.settings.steps = 200;
    dut.order_at(0, Order::Move);
    // 2·sqrt(200/10,000) s = 4,525,483.4 ticks
    dut.becomes(Instant::from_ticks(4_525_483), 200, 0x11);
}

#[test]
fn rates_are_used_in_steps_of_16_towards_0() {
    let mut dut = Dut::new();
    dut.settings = Settings { step_rate: 2_015, acceleration: 10_015, jog_rate: -2_015, ..RATES };
    dut.order_at(0, Order::Move);
    dut.becomes(1_200.millis(), 2_000, 0x11);
    dut.order_at(2_000, Order::Jog);
    dut.is(3_000, 2_000 - 200 - 1_600, 0x18);
}

#[test]
fn at_the_limits_13_000_acts_as_12_992() {
    let mut dut = Dut::new();
    dut.settings = Settings { step_rate: 13_000, acceleration: 360_000, steps: 129_920, jog_rate: 13_000 };
    dut.order_at(0, Order::Move);
    // 10 s at 12,992 steps/s, and 12,992/360,000 s = 0.0360888... s
    dut.becomes(Instant::from_ticks(160_577_422), 129_920, 0x11);
}

#[test]
fn below_16_nothing_moves() {
    for (step_rate, acceleration) in [(15, 10_000), (2_000, 15)] {
        let mut dut = Dut::new();
        dut.settings = Settings { step_rate, acceleration, jog_rate: -15, ..RATES };
        assert!(dut.order(Order::Move));
        assert_eq!(dut.status(), 0x11);
        assert!(dut.order(Order::Jog));
        assert!(!dut.order(Order::Move));
        dut.is(1_000, 0, 0x18);
        dut.order_at(1_000, Order::Stop);
        assert_eq!(dut.status(), 0x11);
    }
}

#[test]
fn no_steps_are_done_at_once() {
    let mut dut = Dut::new();
    dut.settings.steps = 0;
    assert!(dut.order(Order::Move));
    assert_eq!((dut.status(), dut.motor.deadline()), (0x11, Instant::NEVER));
}

#[test]
fn a_paused_move_makes_the_steps_that_are_left() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    dut.order_at(700, Order::Pause);
    dut.is(800, 1_200 + 150, 0x12);
    dut.becomes(900.millis(), 1_400, 0x14);
    // The move keeps its own rate but uses the new acceleration: 2,000 steps/s in 0.05 s.
    dut.settings = Settings { step_rate: 500, acceleration: 40_000, steps: 7, jog_rate: 32 };
    dut.order_at(2_000, Order::Resume);
    assert_eq!(dut.status(), 0x12);
    dut.becomes(2_350.millis(), 2_000, 0x11);
    assert_eq!(dut.out.walked(Instant::NEVER).len(), 2_000);
}

#[test]
fn a_move_resumed_while_it_slows_down_goes_on_when_it_stands() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    dut.order_at(700, Order::Pause);
    dut.order_at(750, Order::Resume);
    dut.is(900, 1_400, 0x12);
    dut.becomes(1_400.millis(), 2_000, 0x11);
}

#[test]
fn a_pause_takes_a_resume_back() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    for (ms, order) in [(700, Order::Pause), (750, Order::Resume), (800, Order::Pause)] {
        dut.order_at(ms, order);
    }
    dut.becomes(900.millis(), 1_400, 0x14);
    dut.is(5_000, 1_400, 0x14);
}

#[test]
fn a_move_never_goes_beyond_its_last_step() {
    for (order, status) in [(Order::Pause, 0x14), (Order::Stop, 0x11)] {
        let mut dut = Dut::new();
        dut.order_at(0, Order::Move);
        // The motor still has 1,000 steps/s and 50 steps left. At 64 steps/s² the ramp would need 7,812
        // steps.
        dut.is(1_100, 1_950, 0x12);
        dut.settings.acceleration = 64;
        dut.order_at(1_100, order);
        dut.becomes(1_200.millis(), 2_000, status);
        dut.order_at(1_300, Order::Resume);
        assert_eq!(dut.status(), 0x11);
        dut.is(9_000, 2_000, 0x11);
    }
}

#[test]
fn a_jog_goes_on_until_it_is_stopped() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    dut.is(1_000, 1_800, 0x18);
    dut.is(10_000, 19_800, 0x18);
    dut.order_at(10_000, Order::Stop);
    assert_eq!(dut.status(), 0x18);
    dut.becomes(10_200.millis(), 20_000, 0x11);
}

#[test]
fn a_jog_ramps_to_another_rate() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    // A new rate has no effect before the next order.
    dut.settings.jog_rate = 1_008;
    dut.is(1_000, 1_800, 0x18);
    // 992 steps/s less takes 0.0992 s and 149.1968 steps; then 1,008 steps/s for 0.9008 s.
    dut.order_at(1_000, Order::Jog);
    dut.is(2_000, 1_800 + 149 + 908, 0x18);
    // The motor stands still after 0.1008 s and 50.8 steps, then makes 50 steps back in 0.1 s.
    dut.settings.jog_rate = -2_000;
    dut.order_at(2_000, Order::Jog);
    let turned = dut.now + 100_800.micros();
    dut.run_until(turned);
    let furthest = dut.position();
    assert!((2_857 + 50..=2_857 + 51).contains(&furthest), "{furthest}");
    dut.run_until(turned + 100.millis());
    assert_eq!((dut.position(), dut.status()), (furthest - 50, 0x18));
    // At rate 0 the motor stands still, but the jog continues.
    dut.run_until(turned + 1_200.millis());
    dut.settings.jog_rate = 0;
    assert!(dut.order(Order::Jog));
    dut.run_until(turned + 5.secs());
    assert_eq!((dut.position(), dut.status()), (furthest - 2_400, 0x18));
}

#[test]
fn a_paused_jog_goes_on_at_its_own_rate() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    dut.order_at(1_000, Order::Pause);
    dut.is(1_100, 1_950, 0x18);
    dut.becomes(1_200.millis(), 2_000, 0x14);
    dut.settings.jog_rate = -32;
    dut.settings.acceleration = 20_000;
    dut.order_at(2_000, Order::Resume);
    // The ramp takes 0.1 s and 100 steps.
    dut.is(3_000, 2_000 + 100 + 1_800, 0x18);
}

#[test]
fn a_jog_resumed_while_it_slows_down_ramps_up_at_once() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    dut.order_at(1_000, Order::Pause);
    dut.order_at(1_100, Order::Resume);
    dut.is(1_200, 2_100, 0x18);
    dut.is(2_200, 4_100, 0x18);
}

#[test]
fn another_jog_ends_the_pause_of_a_jog() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    dut.order_at(1_000, Order::Pause);
    dut.is(1_500, 2_000, 0x14);
    dut.settings.jog_rate = -2_000;
    dut.order_at(2_000, Order::Jog);
    dut.is(3_000, 200, 0x18);
}

#[test]
fn a_stop_ends_what_is_paused_or_slows_down() {
    // One stop while the motor slows down to the pause, one stop in the pause.
    for ms in [800, 1_500] {
        let mut dut = Dut::new();
        dut.order_at(0, Order::Move);
        dut.order_at(700, Order::Pause);
        dut.order_at(ms, Order::Stop);
        dut.is(1_500, 1_400, 0x11);
        dut.order_at(1_600, Order::Resume);
        dut.is(2_000, 1_400, 0x11);
        // A new move starts at the present position.
        dut.order_at(2_000, Order::Move);
        dut.is(3_200, 3_400, 0x11);
    }
}

#[test]
fn what_stops_cannot_be_paused() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    dut.order_at(700, Order::Stop);
    dut.order_at(750, Order::Pause);
    dut.order_at(800, Order::Resume);
    dut.becomes(900.millis(), 1_400, 0x11);
}

#[test]
fn quit_stands_at_once() {
    for (before, at) in [(Order::Move, 700), (Order::Jog, 700)] {
        let mut dut = Dut::new();
        dut.order_at(0, before);
        dut.order_at(at, Order::Quit);
        dut.is(at, 1_200, 0x11);
        dut.is(9_000, 1_200, 0x11);
    }
}

#[test]
fn what_may_be_ordered_when() {
    // For a move and for a jog: true if it is allowed. The other orders are always allowed.
    let moves = (0, Order::Move);
    let jogs = (0, Order::Jog);
    let paused = (700, Order::Pause);
    let stopped = (700, Order::Stop);
    for (script, ms, may_move, may_jog) in [
        (vec![], 0, true, true),
        (vec![moves], 700, false, false),
        (vec![moves, paused], 800, false, false),
        (vec![moves, paused], 1_500, false, false),
        (vec![moves, stopped], 800, false, false),
        // The motion ends at exactly this instant, so it is over.
        (vec![moves, stopped], 900, true, true),
        (vec![jogs], 700, false, true),
        (vec![jogs, paused], 1_500, false, true),
        (vec![jogs, stopped], 800, false, true),
    ] {
        for order in ORDERS {
            let mut dut = Dut::new();
            for (ms, order) in &script {
                dut.order_at(*ms, *order);
            }
            dut.run_until(Instant::from(ms.millis()) - Duration::TICK);
            // An input is handled before a deadline of the same instant.
            dut.now += Duration::TICK;
            let may = match order {
                Order::Move => may_move,
                Order::Jog => may_jog,
                _ => true,
            };
            let before = (dut.status(), dut.out.plans.len());
            assert_eq!(dut.order(order), may, "{order:?} at {ms} ms of {script:?}");
            if !may {
                assert_eq!((dut.status(), dut.out.plans.len()), before);
            }
        }
    }
}

#[test]
fn the_direction_changes_5_us_before_the_first_step() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Jog);
    // The first step is due after sqrt(2/10,000) s = 226,274.2 ticks.
    let turn = Instant::from_ticks(226_274) - 5.micros();
    assert_eq!(dut.motor.deadline(), turn);
    assert!(!dut.motor.is_forward(turn - Duration::TICK) && dut.motor.is_forward(turn));
    // The motor stands still after 0.2 s. The first step back follows after the same time as the first step
    // forward.
    dut.settings.jog_rate = -2_000;
    dut.order_at(1_000, Order::Jog);
    let turn = turn + 1_200.millis();
    assert_eq!(dut.motor.deadline(), turn);
    dut.run_until(turn - Duration::TICK);
    assert!(dut.motor.is_forward(dut.now));
    dut.run_until(turn);
    assert!(!dut.motor.is_forward(dut.now));
    assert_eq!(dut.motor.deadline(), Instant::NEVER);
    // After a new activation DIO2 is low, whatever it was before.
    dut.settings.jog_rate = 2_000;
    assert!(dut.order(Order::Jog));
    dut.run_until(5.secs());
    assert!(dut.motor.is_forward(dut.now));
    dut.motor.deactivate(dut.now, &mut dut.out);
    dut.motor.activate(dut.now, &mut dut.out);
    assert!(!dut.motor.is_forward(dut.now));
}

#[test]
fn it_stands_where_it_is_deactivated() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    dut.run_until(700.millis());
    dut.motor.deactivate(dut.now, &mut dut.out);
    dut.is(5_000, 1_200, 0x01);
    dut.motor.activate(dut.now, &mut dut.out);
    dut.is(6_000, 1_200, 0x11);
    assert_eq!(dut.out.plans.last(), Some(&(5.secs().into(), AXIS, Plan::at_rest(5.secs().into(), 1_200))));
}

#[test]
fn steps_that_a_board_has_slipped_count() {
    let mut dut = Dut::new();
    dut.order_at(0, Order::Move);
    dut.order_at(700, Order::Pause);
    dut.motor.correct_steps(3);
    dut.run_until(900.millis());
    assert_eq!(dut.status(), 0x14);
    dut.order_at(1_000, Order::Resume);
    let (.., plan) = dut.out.plans.last().unwrap();
    assert_eq!((plan.position_at(dut.now), plan.position_at(Instant::NEVER)), (1_403, 2_000));
}

/// Expected behaviour of a motor, in seconds and steps, without plans and ticks.
#[derive(Debug)]
struct Model {
    now: f64,
    position: f64,
    speed: f64,
    doing: Doing,
    /// End position of a move, or speed of a jog.
    goal: f64,
    jogs: bool,
    /// Speed of a move.
    rate: f64,
    /// Remaining ramps: durations and accelerations.
    ramps: Vec<(f64, f64)>,
    /// Tolerance of the position in steps: each reversal drops a part of a step.
    doubt: i32,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Doing {
    Nothing,
    Running,
    Stopping,
    Pausing,
    /// Resumes at standstill with this acceleration.
    Resuming(f64),
    Pause,
}

impl Model {
    fn status(&self) -> u8 {
        match self.doing {
            Doing::Nothing => 0x11,
            Doing::Pause => 0x14,
            _ if self.jogs => 0x18,
            _ => 0x12,
        }
    }

    /// Time at which the present motion ends by itself.
    fn ends(&self) -> f64 {
        let rests = matches!(self.doing, Doing::Nothing | Doing::Pause);
        if rests || (self.jogs && self.doing == Doing::Running) {
            return f64::INFINITY;
        }
        self.now + self.ramps.iter().map(|(time, _)| time).sum::<f64>()
    }

    fn pass(&mut self, until: f64) {
        while self.now < until {
            let (time, acceleration) = self.ramps.first().copied().unwrap_or((f64::INFINITY, 0.0));
            let d = time.min(until - self.now);
            if time <= until - self.now {
                self.ramps.remove(0);
            } else if let Some(ramp) = self.ramps.first_mut() {
                ramp.0 -= d;
            }
            self.position += self.speed * d + acceleration * d * d / 2.0;
            self.speed += acceleration * d;
            self.now = if time <= d { self.now + time } else { until };
        }
    }

    /// Advances to `until`. At the end of each motion the model takes over the position of the motor.
    fn run_until(&mut self, until: f64, out: &Recorder) -> Result<(), TestCaseError> {
        while self.ends() <= until {
            let end = self.ends();
            self.pass(end);
            self.ramps.clear();
            let position = out.position_at(instant(end + 1e-6));
            prop_assert!(
                (self.position - f64::from(position)).abs() < f64::from(self.doubt),
                "{} instead of {:?}",
                position,
                self
            );
            (self.position, self.speed, self.doubt) = (f64::from(position), 0.0, 2);
            match self.doing {
                Doing::Resuming(acceleration) => self.go(acceleration),
                Doing::Pausing => self.doing = Doing::Pause,
                _ => {
                    if !self.jogs && self.doing == Doing::Running {
                        prop_assert_eq!(self.position, self.goal);
                    }
                    self.doing = Doing::Nothing;
                }
            }
        }
        self.pass(until);
        Ok(())
    }

    /// Starts the motion towards the goal.
    fn go(&mut self, acceleration: f64) {
        self.doing = Doing::Running;
        if self.jogs {
            self.ramps = vec![];
            let mut from = self.speed;
            if from * self.goal < 0.0 || self.goal == 0.0 {
                self.ramps.push((from.abs() / acceleration, -from.signum() * acceleration));
                from = 0.0;
            }
            let change = self.goal - from;
            self.ramps.push((change.abs() / acceleration, change.signum() * acceleration));
            self.doubt += 1;
        } else {
            let way = self.goal - self.position;
            let up = (self.rate / acceleration).min((way.abs() / acceleration).sqrt());
            let cruise = (way.abs() - up * up * acceleration) / (up * acceleration);
            let a = acceleration * way.signum();
            self.ramps = if way == 0.0 { vec![] } else { vec![(up, a), (cruise, 0.0), (up, -a)] };
        }
    }

    fn slow(&mut self, doing: Doing, acceleration: f64) {
        self.doing = doing;
        let beyond = self.speed.powi(2) / 2.0 / acceleration - (self.goal - self.position).abs();
        // At the last step or beyond it, a moving motor is in its last ramp already.
        if self.jogs || beyond < 0.5 {
            self.ramps = vec![(self.speed.abs() / acceleration, -self.speed.signum() * acceleration)];
        }
    }

    /// Handles an order. Returns `false` if it is not allowed, and `None` if rounding decides the outcome.
    fn order(&mut self, order: Order, with: &Settings) -> Option<bool> {
        let acceleration = f64::from(with.acceleration & !15);
        let doing = self.doing;
        let slows = match order {
            Order::Stop => !matches!(doing, Doing::Nothing | Doing::Pause),
            Order::Pause => doing == Doing::Running,
            _ => false,
        };
        if slows && !self.jogs {
            let beyond = self.speed.powi(2) / 2.0 / acceleration - (self.goal - self.position).abs();
            if beyond.abs() < 2.0 {
                return None;
            }
        }
        match (order, doing) {
            (Order::Move, Doing::Nothing) => {
                (self.jogs, self.goal) = (false, self.position + f64::from(with.steps));
                self.rate = f64::from(with.step_rate & !15);
                self.go(acceleration);
            }
            (Order::Move, _) => return Some(false),
            (Order::Jog, _) if !self.jogs && doing != Doing::Nothing => return Some(false),
            (Order::Jog, _) => {
                (self.jogs, self.goal) = (true, f64::from(with.jog_rate / 16 * 16));
                self.go(acceleration);
            }
            (_, Doing::Nothing) => {}
            (Order::Quit, _) => {
                (self.doing, self.speed, self.ramps) = (Doing::Nothing, 0.0, vec![]);
            }
            (Order::Stop, Doing::Pause) => self.doing = Doing::Nothing,
            (Order::Stop, _) => self.slow(Doing::Stopping, acceleration),
            (Order::Pause, Doing::Running) => self.slow(Doing::Pausing, acceleration),
            (Order::Pause, Doing::Resuming(_)) => self.doing = Doing::Pausing,
            (Order::Resume, Doing::Pausing | Doing::Resuming(_)) if !self.jogs => {
                self.doing = Doing::Resuming(acceleration);
            }
            (Order::Resume, Doing::Pausing | Doing::Pause) => self.go(acceleration),
            (Order::Pause | Order::Resume, _) => {}
        }
        Some(true)
    }
}

fn instant(seconds: f64) -> Instant {
    Instant::from_ticks((seconds * 16e6).round() as u64)
}

fn settings() -> impl Strategy<Value = Settings> {
    let rates = (32_u16..=13_000, 64_u32..=360_000, -13_000..=13_000_i32);
    (rates, prop_oneof![-200..200_i32, -30_000..30_000]).prop_map(
        |((step_rate, acceleration, jog_rate), steps)| Settings { step_rate, acceleration, steps, jog_rate },
    )
}

proptest! {
    #[test]
    fn orders_at_any_time_do_what_a_slow_model_does(
        orders in proptest::collection::vec(
            (0_u64..3_000, proptest::sample::select(&ORDERS[..]), settings()), 1..30,
        ),
    ) {
        let mut dut = Dut::new();
        let mut model = Model {
            now: 0.0, position: 0.0, speed: 0.0, doing: Doing::Nothing, goal: 0.0, jogs: false, rate: 0.0,
            ramps: vec![], doubt: 2,
        };
        let mut now = 0.0;
        for (wait, order, settings) in orders {
            // Orders are never so close to the end of a motion that rounding decides their sequence.
            now += wait as f64 / 1_000.0 + 2e-4;
            while (model.ends() - now).abs() < 1e-4 {
                now += 2e-4;
            }
            dut.run_until(instant(now));
            model.run_until(now, &dut.out)?;
            prop_assert_eq!(dut.status(), model.status(), "{:?} at {}", model, now);
            let beside = (model.position - f64::from(dut.position())).abs();
            prop_assert!(beside < f64::from(model.doubt), "{} {:?}", dut.position(), model);
            dut.settings = settings;
            let Some(may) = model.order(order, &settings) else { return Ok(()) };
            prop_assert_eq!(dut.order(order), may);
            if order == Order::Quit {
                model.position = f64::from(dut.position());
                model.doubt = 2;
            }
        }
        let steps = dut.out.walked(dut.now);
        let made: i32 = steps.iter().map(|step| if step.forward { 1 } else { -1 }).sum();
        prop_assert_eq!(made, dut.position());
    }

    #[test]
    fn a_move_paused_and_resumed_any_number_of_times_makes_its_steps(
        first in settings(),
        pauses in proptest::collection::vec((0_u64..800_000, 0_u64..800_000, settings()), 0..8),
    ) {
        let mut dut = Dut::new();
        dut.settings = first;
        prop_assert!(dut.order(Order::Move));
        for (runs, pauses, settings) in pauses {
            dut.run_until(dut.now + runs.micros());
            dut.settings = settings;
            prop_assert!(dut.order(Order::Pause));
            dut.run_until(dut.now + pauses.micros());
            prop_assert!(dut.order(Order::Resume));
        }
        while dut.motor.deadline() < Instant::NEVER {
            dut.run_until(dut.motor.deadline());
        }
        prop_assert_eq!((dut.position(), dut.status()), (first.steps, 0x11));
        let steps = dut.out.walked(dut.now);
        prop_assert_eq!(steps.len(), first.steps.unsigned_abs() as usize);
        prop_assert!(steps.iter().all(|step| step.forward == (first.steps > 0)));
    }

    #[test]
    fn the_direction_is_that_of_the_steps(
        jogs in proptest::collection::vec((0_u64..400_000, settings()), 1..20),
    ) {
        let mut dut = Dut::new();
        let mut told = vec![];
        for (wait, settings) in jogs {
            let until = dut.now + wait.micros();
            while dut.motor.deadline() <= until {
                dut.run_until(dut.motor.deadline());
                told.push((dut.now, dut.motor.is_forward(dut.now)));
            }
            dut.run_until(until);
            dut.settings = settings;
            prop_assert!(dut.order(Order::Jog));
        }
        let mut forward = false;
        let mut expected = vec![];
        for step in dut.out.walked(dut.now) {
            if step.forward != forward {
                forward = step.forward;
                expected.push((step.at - 5.micros(), forward));
            }
        }
        // DIO2 may have changed already for a step that is still to come.
        prop_assert!(told.starts_with(&expected), "{:?} {:?}", told, expected);
        prop_assert!(told.len() <= expected.len() + 1);
    }
}
