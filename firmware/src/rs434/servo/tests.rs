#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use core::f64::consts::TAU;

use proptest::prelude::*;

use super::*;
use crate::device::{
    Axis, Boot, Device, Duration, Fault, NullContext, Pin, PresetError, Shaft, Spec, advance, feed,
};
use crate::motor::{DriveWithMotor, MotorDrive, Parameters};
use crate::testing::{Recorder, Treatment};

const HALLS: [Pin; 2] = [Pin(0), Pin(1)];
const HELD: Fault = Fault(0);

static EMPTY: Spec = Spec { kind: "servo", ..Spec::EMPTY };

/// Commands of a test to a drive that consists of a servo only.
mod tell {
    pub(super) const ROTATE: usize = 0;
    pub(super) const GO: usize = 1;
    pub(super) const STOP: usize = 2;
    pub(super) const HALT: usize = 3;
    pub(super) const SPEED: usize = 4;
    pub(super) const COMPENSATION: usize = 5;
}

/// Values that a test reads from this drive.
mod ask {
    pub(super) const DIRECTION: usize = 0;
    pub(super) const POSITION: usize = 1;
    pub(super) const LEFT: usize = 2;
    pub(super) const SPEED: usize = 3;
    pub(super) const CURRENT: usize = 4;
    pub(super) const ERRORS: usize = 5;
}

/// A drive that consists of a servo only.
#[derive(Clone)]
struct Bare {
    settings: Settings,
    motor: Parameters,
    compensation: i16,
    errors: u16,
    /// True if the wires of its Hall sensors are swapped.
    swapped: bool,
    servo: Option<Servo>,
}

impl MotorDrive for Bare {
    const HALLS: &'static [Pin] = &HALLS;
    const STALL: Option<Fault> = Some(HELD);

    fn motor(&self) -> Parameters {
        self.motor
    }
}

impl Device for Bare {
    fn spec(&self) -> &'static Spec {
        &EMPTY
    }

    fn power_on(&mut self, at: Instant, _boot: Boot, out: &mut dyn Context) {
        let servo = self.servo.insert(Servo::new(at, self.settings));
        servo.power_on(at, self.settings, out);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, _out: &mut dyn Context) {
        let servo = self.servo.as_mut().unwrap();
        match input {
            Input::Edge { pin, high } => servo.edge(at, (pin == HALLS[0]) != self.swapped, high),
            Input::MotorCurrent { .. } | Input::Motor { .. } | Input::Rotation { .. } => {
                servo.report(at, &input);
            }
            _ => {}
        }
        self.errors |= servo.errors();
    }

    fn deadline(&self) -> Instant {
        self.servo.as_ref().map_or(Instant::NEVER, Servo::deadline)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        let servo = self.servo.as_mut().unwrap();
        servo.timeout(at, out);
        self.errors |= servo.errors();
    }

    fn peek(&self, at: Instant, row: usize) -> i64 {
        let servo = self.servo.as_ref().unwrap();
        match row {
            ask::DIRECTION => servo.direction().into(),
            ask::POSITION => servo.position().into(),
            ask::LEFT => servo.left().into(),
            ask::SPEED => servo.speed(at).into(),
            ask::CURRENT => servo.current(at).into(),
            _ => self.errors.into(),
        }
    }

    fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let servo = self.servo.as_mut().unwrap();
        match row {
            tell::ROTATE => servo.rotate(at, value > 0, out),
            tell::GO => {
                let _ = servo.go(at, value as i32, self.compensation, out);
            }
            tell::STOP => servo.stop(),
            tell::HALT => servo.halt(at, out),
            tell::COMPENSATION => self.compensation = value as i16,
            _ => {
                self.settings.speed = value as u16;
                servo.set(at, self.settings, out);
            }
        }
        self.errors |= servo.errors();
        Ok(())
    }
}

const FACTORY: Settings = Settings {
    speed: 1_000,
    acc: 100,
    dec: 100,
    rated: 3_000,
    pulses: 4,
    halls: 2,
    limit_ma: 20_000,
    closed: false,
};

/// A recorder of the levels of the Hall sensors. All other outputs must stay inside.
fn levels_only() -> Recorder {
    Recorder::default().ruled(|output| match output {
        Output::Level { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

/// A recorder of the edges of Hall sensor A.
fn edges_of_a() -> Recorder {
    Recorder::default().ruled(|output| match output {
        Output::Level { pin, .. } if *pin == HALLS[0] => Treatment::Keep,
        _ => Treatment::Ignore,
    })
}

/// A servo with its motor, and the current time.
struct Bench {
    rig: DriveWithMotor<Bare>,
    now: Instant,
    edges: Recorder,
}

impl Bench {
    fn new(settings: Settings) -> Self {
        Self::with(settings, Parameters::NOMINAL)
    }

    /// A bench with another friction, load or inertia of the motor.
    fn with(settings: Settings, motor: Parameters) -> Self {
        let motor = Parameters { no_load_rpm: settings.rated.into(), hall_pulses: settings.pulses, ..motor };
        Self::on(settings, motor)
    }

    /// A bench with a motor that may differ from the one in the settings.
    fn on(settings: Settings, motor: Parameters) -> Self {
        Self::of(Bare { settings, motor, compensation: 0, errors: 0, swapped: false, servo: None })
    }

    fn of(bare: Bare) -> Self {
        let mut rig = DriveWithMotor::new(bare);
        rig.power_on(Instant::ZERO, Boot::default(), &mut NullContext);
        let mut bench = Self { rig, now: Instant::ZERO, edges: edges_of_a() };
        bench.run(TICK);
        bench
    }

    fn feed(&mut self, what: usize, value: i64) {
        self.rig.poke(self.now, what, value, &mut self.edges).unwrap();
    }

    fn ask(&self, what: usize) -> i64 {
        self.rig.peek(self.now, what)
    }

    fn hold(&mut self, on: bool) {
        feed(&mut self.rig, Instant::NEVER, self.now, Input::Fault { fault: HELD, on }, &mut self.edges);
    }

    fn shaft(&self) -> Shaft {
        self.rig.shaft(self.now, Axis(0)).unwrap()
    }

    fn run(&mut self, span: Duration) {
        self.now += span;
        advance(&mut self.rig, self.now, core::iter::empty(), &mut self.edges);
    }

    /// Runs until the motor stands. Returns the duration.
    fn finish(&mut self) -> Duration {
        let begin = self.now;
        while self.ask(ask::DIRECTION) != 0 {
            self.run(TICK);
            assert!(self.now.since(begin) < Duration::secs(60), "still on its way");
        }
        self.now.since(begin)
    }
}

/// Duration of a move in ms, by the formulas of uniform acceleration.
fn ideal_ms(settings: &Settings, counts: f64) -> f64 {
    let ramp = |register: u16| 100.0 + (f64::from(register) - 10.0) * 4_900.0 / 990.0;
    let (a, b) = (ramp(settings.acc), ramp(settings.dec));
    let turns = counts / (4.0 * f64::from(settings.pulses));
    let v = f64::from(settings.speed.min(settings.rated / 100 * 98)) / 60.0;
    let ramps = v * v / 2.0 * (1.0 / a + 1.0 / b);
    let seconds = if ramps > turns {
        (2.0 * turns * (1.0 / a + 1.0 / b)).sqrt()
    } else {
        v / a + v / b + (turns - ramps) / v
    };
    seconds * 1_000.0
}

/// Settings, and a move that takes a few seconds at most.
fn moves() -> impl Strategy<Value = (Settings, i32)> {
    let ramp = || prop_oneof![Just(10_u16), Just(1_000), 10..1_001_u16];
    let speed = prop_oneof![Just(30_u16), Just(15_000), 30..15_001_u16, 30..300_u16];
    let rated = prop_oneof![Just(1_000_u16), Just(15_000), 1_000..15_001_u16];
    let limit = prop_oneof![Just(1_000_u32), Just(20_000), 1_000..20_001_u32];
    let settings = (speed, ramp(), ramp(), rated, 1..13_u16, limit, any::<bool>()).prop_map(
        |(speed, acc, dec, rated, pulses, limit_ma, closed)| Settings {
            speed,
            acc,
            dec,
            rated,
            pulses,
            halls: 2,
            limit_ma,
            closed,
        },
    );
    (settings, 0.0..1.0_f64, any::<bool>()).prop_map(|(settings, part, back)| {
        let a_second = f64::from(settings.speed) / 60.0 * 4.0 * f64::from(settings.pulses);
        let counts = (a_second).max(1.0).powf(part).round() as i32;
        (settings, if back { -counts } else { counts })
    })
}

/// Friction and load in percent of the torque at REF_CURRENT. Together they are 50 % at most, because the
/// ramps need torque, too.
fn burdens() -> impl Strategy<Value = (u32, i32)> {
    (0..51_u32).prop_flat_map(|friction| {
        let rest = 50 - friction.cast_signed();
        (Just(friction), -rest..=rest)
    })
}

/// Torque of a current, in µN·m.
fn torque(settings: &Settings, ma: u32) -> u32 {
    let k = 24.0 / (f64::from(settings.rated) * TAU / 60.0);
    (k * f64::from(ma) * 1e3) as u32
}

/// Gives orders, each with its value and the time until the next one in ms. Then the motor must come to rest,
/// at the position of its Hall sensors and without a Hall error.
fn counts_what_the_shaft_turns(settings: Settings, orders: &[(usize, i64, u64)]) {
    let mut bench = Bench::new(settings);
    let begin = bench.shaft().position;
    for &(order, value, ms) in orders {
        match order {
            tell::SPEED => bench.feed(tell::SPEED, 30 + value.abs() * 70),
            tell::COMPENSATION => bench.hold(value > 100),
            tell::GO if settings.halls < 2 => {}
            _ => bench.feed(order, value),
        }
        bench.run(Duration::millis(ms));
    }
    bench.hold(false);
    bench.feed(tell::STOP, 0);
    bench.finish();
    let (made, position) = (i64::from(bench.shaft().position - begin), bench.ask(ask::POSITION));
    match settings.halls {
        0 => assert_eq!(position, 0),
        // A single sensor does not show the direction of a shaft that is pushed through standstill. It only
        // shows the number of edges.
        1 => {
            let edges = bench.edges.levels.len() as i64;
            assert!(position.abs() <= edges && (edges - position) % 2 == 0, "{edges} {position}");
        }
        _ => assert_eq!(position, made),
    }
    assert_eq!(bench.ask(ask::ERRORS) & 0x10, 0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, max_shrink_iters: 100, ..ProptestConfig::default() })]

    /// The outputs and their timestamps do not depend on the times between two calls.
    #[test]
    fn being_called_late_changes_nothing((settings, counts) in moves(), pauses in proptest::collection::vec(1..400_000_u64, 1..50)) {
        let run = |pauses: &[u64]| {
            let (mut bench, mut log) = (Bench::new(settings), levels_only());
            bench.feed(tell::GO, counts.into());
            for ticks in pauses {
                bench.now += Duration::from_ticks(*ticks);
                advance(&mut bench.rig, bench.now, core::iter::empty(), &mut log);
            }
            (log.levels, bench.shaft())
        };
        prop_assert_eq!(run(&pauses), run(&[pauses.iter().sum()]));
    }

    /// After any commands: [`counts_what_the_shaft_turns`].
    #[test]
    fn it_counts_what_the_shaft_turns(
        (settings, _) in moves(), halls in 0..3_u16,
        orders in proptest::collection::vec((0..6_usize, -200..200_i64, 1..300_u64), 1..12),
    ) {
        counts_what_the_shaft_turns(Settings { halls, ..settings }, &orders);
    }

    #[test]
    fn a_move_ends_on_its_count((settings, counts) in moves(), (friction, load) in burdens()) {
        let most = torque(&settings, settings.limit_ma) / 100;
        let motor = Parameters { friction_unm: friction * most, load_unm: load * most.cast_signed(), ..Parameters::NOMINAL };
        // A load that friction does not hold turns the motor before and after the move.
        let mut bench = Bench::with(settings, motor);
        let (before, shaft) = (bench.ask(ask::POSITION), bench.shaft().position);
        bench.feed(tell::GO, counts.into());
        bench.finish();
        prop_assert_eq!(bench.ask(ask::POSITION), before + i64::from(counts));
        prop_assert_eq!(bench.shaft().position, shaft + counts);
        prop_assert_eq!(bench.ask(ask::LEFT), 0);
    }
}

#[test]
fn a_single_sensor_that_counts_up_and_down_has_no_broken_wire() {
    // At the reversal the low current limit leaves the shaft turning forward for so long that as many edges
    // are counted backward as were counted forward before.
    for closed in [false, true] {
        let settings = Settings {
            speed: 218,
            acc: 38,
            dec: 847,
            rated: 7_650,
            pulses: 7,
            halls: 1,
            limit_ma: 1_000,
            closed,
        };
        let orders = [(0, 0, 280), (0, 1, 177), (0, 1, 196), (4, 76, 296), (0, -184, 189)];
        counts_what_the_shaft_turns(settings, &orders);
    }
}

#[test]
fn a_move_takes_the_time_of_its_ramps() {
    // Columns: rated, SPEED, ACC, DEC, pulses, counts.
    for (rated, speed, acc, dec, pulses, counts) in [
        (3_000, 1_000, 100, 100, 4, 1_000),
        (3_000, 1_000, 100, 1_000, 4, -1_000),
        (3_000, 1_000, 10, 10, 4, 10),
        (3_000, 2_000, 400, 10, 12, 5_000),
        (1_000, 900, 1_000, 100, 12, 1_000),
        (15_000, 9_000, 200, 10, 1, 10_000),
        // The speed is limited to the speed at 0.98 of the supply, minus the loss by friction.
        (3_000, 15_000, 100, 100, 4, 5_000),
    ] {
        let settings = Settings { rated, speed, acc, dec, pulses, ..FACTORY };
        let mut bench = Bench::new(settings);
        bench.feed(tell::GO, counts);
        let took = bench.finish().ticks() as f64 / 16_000.0;
        let ideal = ideal_ms(&settings, counts.abs() as f64);
        assert!((took - ideal).abs() <= 6.0 + 0.005 * ideal, "{took} ms instead of {ideal}: {settings:?}");
        assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::ERRORS)), (counts, 0), "{settings:?}");
    }
}

#[test]
fn rotation_follows_speed_and_direction_at_once() {
    let mut bench = Bench::new(FACTORY);
    bench.feed(tell::ROTATE, 1);
    // ACC 100 is 545.5 rps². The motor reaches 1,000 rpm after 30.6 ms.
    bench.run(Duration::millis(100));
    assert_eq!((bench.ask(ask::SPEED), bench.ask(ask::DIRECTION)), (1_000, 1));
    bench.feed(tell::SPEED, 2_000);
    bench.run(Duration::millis(100));
    assert_eq!(bench.ask(ask::SPEED), 2_000);
    bench.feed(tell::ROTATE, -1);
    bench.run(Duration::millis(30));
    assert_eq!(bench.ask(ask::DIRECTION), 1);
    bench.run(Duration::millis(170));
    assert_eq!((bench.ask(ask::SPEED), bench.ask(ask::DIRECTION)), (2_000, -1));
    bench.feed(tell::STOP, 0);
    // 61.1 ms for the ramp, and a few ticks until standstill is detected.
    assert!(bench.finish() <= Duration::millis(66));
    assert_eq!((bench.ask(ask::SPEED), bench.ask(ask::ERRORS)), (0, 0));
}

#[test]
fn a_stopped_move_keeps_what_is_left_and_the_rest_brings_it_there() {
    let mut bench = Bench::new(FACTORY);
    bench.feed(tell::GO, -2_000);
    bench.run(Duration::millis(1_000));
    bench.feed(tell::STOP, 0);
    bench.finish();
    let left = bench.ask(ask::LEFT);
    assert!((-1_800..-1_700).contains(&left), "{left}");
    assert_eq!(bench.ask(ask::POSITION), -2_000 - left);
    bench.feed(tell::GO, left);
    bench.finish();
    assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (-2_000, 0));
}

#[test]
fn compensation_moves_the_stopping_point_along_the_motion() {
    for (counts, compensation, position) in
        [(500, -15, 485), (-500, -15, -485), (500, 15, 515), (-5, 15, -20)]
    {
        let mut bench = Bench::new(FACTORY);
        bench.feed(tell::COMPENSATION, compensation);
        bench.feed(tell::GO, counts);
        bench.finish();
        assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (position, 0));
    }
}

#[test]
fn compensation_never_turns_a_move_round() {
    for (counts, compensation) in [(10, -15), (-10, -15), (15, -15), (1, -32_768), (-32_768, -32_768)] {
        let mut bench = Bench::new(FACTORY);
        bench.feed(tell::COMPENSATION, compensation);
        bench.feed(tell::GO, counts);
        assert_eq!((bench.ask(ask::DIRECTION), bench.ask(ask::LEFT)), (0, 0), "{counts} {compensation}");
        bench.run(Duration::secs(1));
        assert_eq!((bench.ask(ask::POSITION), bench.edges.levels.len()), (0, 0), "{counts} {compensation}");
    }
}

#[test]
fn the_longest_moves_go_where_their_sign_says() {
    for counts in [i32::MAX, i32::MIN, i32::MAX - 32_767] {
        for compensation in [0, 1, -1, 32_767, -32_768] {
            let mut bench = Bench::new(FACTORY);
            let sign = i64::from(counts.signum());
            bench.feed(tell::COMPENSATION, compensation);
            bench.feed(tell::GO, counts.into());
            for _ in 0..20 {
                bench.run(Duration::millis(50));
                let (position, left) = (bench.ask(ask::POSITION), bench.ask(ask::LEFT));
                assert_eq!(position + left, i64::from(counts), "{compensation}");
                assert_eq!(bench.ask(ask::DIRECTION), sign, "{counts} {compensation}");
            }
            assert!(bench.ask(ask::POSITION) * sign > 200, "{counts} {compensation}");
        }
    }
}

/// A bench that turns in the direction `way`, brakes, and gets a move by `counts` while it brakes.
fn told_while_it_brakes(settings: Settings, way: i64, counts: i64) -> Bench {
    let mut bench = Bench::new(settings);
    bench.feed(tell::ROTATE, way);
    bench.run(Duration::millis(300));
    bench.feed(tell::STOP, 0);
    bench.run(Duration::millis(2));
    assert_eq!(bench.ask(ask::DIRECTION), way);
    bench.feed(tell::GO, counts);
    bench
}

#[test]
fn what_is_left_of_a_move_does_not_depend_on_what_turns_now() {
    for way in [1, -1] {
        // The motor must reverse first; or it goes too far and returns.
        for counts in [-100 * way, 3 * way] {
            let mut bench = told_while_it_brakes(Settings { speed: 2_000, ..FACTORY }, way, counts);
            let goal = bench.ask(ask::POSITION) + counts;
            assert_eq!(bench.ask(ask::LEFT), counts);
            let mut beyond = 0;
            while bench.ask(ask::DIRECTION) != 0 {
                bench.run(Duration::micros(100));
                let left = goal - bench.ask(ask::POSITION);
                let expected = if left.signum() == counts.signum() { left } else { 0 };
                assert_eq!(bench.ask(ask::LEFT), expected, "{way} {counts}");
                beyond += i64::from(left.signum() == -counts.signum());
            }
            assert_eq!(beyond > 0, counts == 3 * way, "{way} {counts}");
            assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (goal, 0));
        }
    }
}

#[test]
fn a_move_that_cannot_stop_in_time_is_warned_of() {
    const BRAKING: i64 = 1 << 12;
    let fast = Settings { speed: 2_000, ..FACTORY };
    let weak = Settings { limit_ma: 1_000, dec: 1_000, ..fast };
    // 2,000 rpm are 33.3 rps. With DEC 100 (545.5 rps²) the braking distance is a turn, or 16 counts. With
    // DEC 1,000 (5,000 rps²) it would be 0.11 turns, or 1.8 counts. But 1 A gives 76.4 mN·m, with friction
    // 86.4. On 400 g·cm² this is 344 rps²: 1.6 turns, or 26 counts.
    for (settings, counts, warned) in [
        (fast, 4, true),
        (fast, 25, false),
        (fast, -4, false),
        (fast, -100, false),
        (weak, 10, true),
        (weak, 60, false),
    ] {
        for way in [1, -1] {
            let mut bench = told_while_it_brakes(settings, way, way * counts);
            let goal = bench.ask(ask::POSITION) + way * counts;
            assert_eq!(bench.ask(ask::ERRORS) & BRAKING != 0, warned, "{counts} {way}");
            let mut farthest = 0;
            while bench.ask(ask::DIRECTION) != 0 {
                bench.run(TICK);
                farthest = farthest.max((bench.ask(ask::POSITION) - goal) * way * counts.signum());
            }
            // If there was a warning, the motor overshoots. The move still ends on its count.
            assert_eq!((farthest > 0, bench.ask(ask::POSITION)), (warned, goal), "{counts} {way}");
        }
    }
}

#[test]
fn a_held_shaft_is_waited_for() {
    let mut bench = Bench::new(FACTORY);
    bench.feed(tell::GO, 1_000);
    bench.run(Duration::millis(1_000));
    bench.hold(true);
    bench.run(Duration::secs(10));
    assert_eq!((bench.ask(ask::SPEED), bench.ask(ask::ERRORS)), (0, 0x800));
    assert!(bench.shaft().ma <= 20_000);
    bench.hold(false);
    for _ in 0..200 {
        bench.run(TICK);
        // 1,000 rpm are 266.7 counts/s.
        assert!(bench.shaft().speed < 400, "it jumps");
    }
    bench.finish();
    assert_eq!(bench.ask(ask::POSITION), 1_000);
}

#[test]
fn a_halt_takes_no_ramp() {
    let mut bench = Bench::new(Settings { dec: 10, ..FACTORY });
    bench.feed(tell::ROTATE, 1);
    bench.run(Duration::millis(200));
    bench.feed(tell::HALT, 0);
    // The ramp from 16.7 rps at 100 rps² would take 167 ms.
    assert!(bench.finish() < Duration::millis(20));
    assert_eq!(bench.shaft().duty, 0);
}

#[test]
fn terminals_of_what_stands_are_as_mode_coil_says() {
    for (closed, turns) in [(false, true), (true, false)] {
        let load = Parameters { load_unm: -50_000, ..Parameters::NOMINAL };
        let mut bench = Bench::with(Settings { closed, ..FACTORY }, load);
        bench.run(Duration::millis(100));
        // Shorted terminals brake the shaft to 32.7 rpm, or 8.7 counts/s.
        assert_eq!(bench.shaft().speed > 20, turns);
    }
}

#[test]
fn without_sensors_the_duty_is_the_speed_of_the_rated_one() {
    let mut bench = Bench::new(Settings { halls: 0, speed: 1_500, ..FACTORY });
    bench.feed(tell::ROTATE, -1);
    bench.run(Duration::millis(500));
    assert_eq!((bench.shaft().duty, bench.ask(ask::SPEED)), (-32_768, 1_500));
    assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::DIRECTION)), (0, -1));
    bench.feed(tell::SPEED, 15_000);
    bench.run(Duration::millis(500));
    assert_eq!(bench.shaft().duty, -64_225); // 0.98
}

#[test]
fn without_sensors_no_speed_is_too_slow_for_the_least_duty() {
    for (way, duty) in [(1, 656), (-1, -656)] {
        let mut bench = Bench::new(Settings { halls: 0, speed: 30, rated: 15_000, ..FACTORY });
        bench.feed(tell::ROTATE, way);
        bench.run(Duration::millis(500));
        // The least duty is 0.01 of 65,536; 30 rpm would need 0.002.
        assert_eq!((bench.ask(ask::DIRECTION), bench.shaft().duty), (way, duty));
        assert_eq!(bench.ask(ask::SPEED), 150);
        bench.feed(tell::STOP, 0);
        bench.run(Duration::millis(100));
        assert_eq!((bench.ask(ask::DIRECTION), bench.shaft().duty), (0, 0));
    }
}

#[test]
fn the_current_is_what_the_supply_gives() {
    // With a load against the motion the supply gives current, with a load in its direction the current flows
    // back.
    for (load_unm, supplied) in [(200_000, true), (-200_000, false)] {
        for way in [1, -1] {
            let load = Parameters { load_unm: load_unm * way, ..Parameters::NOMINAL };
            let mut bench = Bench::with(FACTORY, load);
            bench.feed(tell::ROTATE, way.into());
            bench.run(Duration::millis(500));
            let Shaft { duty, ma, .. } = bench.shaft();
            let given = (f64::from(ma) * f64::from(duty) / 65_536.0).round();
            assert!(ma.abs() > 2_000 && (given > 0.0) == supplied, "{ma} mA, duty {duty}");
            assert_eq!(bench.ask(ask::CURRENT), given.max(0.0) as i64);
            // The current of shorted terminals does not come from the supply.
            bench.feed(tell::HALT, 0);
            bench.run(Duration::micros(100));
            assert!(bench.shaft().ma.abs() > 1_000);
            assert_eq!((bench.ask(ask::DIRECTION).abs(), bench.ask(ask::CURRENT)), (1, 0));
        }
    }
}

#[test]
fn one_sensor_counts_half_in_the_direction_that_is_told() {
    let mut bench = Bench::new(Settings { halls: 1, ..FACTORY });
    let begin = bench.shaft().position;
    bench.feed(tell::ROTATE, -1);
    bench.run(Duration::millis(500));
    bench.feed(tell::STOP, 0);
    bench.finish();
    let made = bench.shaft().position - begin;
    assert!(made < -100 && (bench.ask(ask::POSITION) * 2 - i64::from(made)).abs() <= 2);
}

#[test]
fn swapped_hall_wires_are_an_error() {
    for (way, speed) in [(1, 1_000), (-1, 1_000), (1, 30), (-1, 30)] {
        let settings = Settings { speed, ..FACTORY };
        let motor = Parameters::NOMINAL;
        let mut bench =
            Bench::of(Bare { settings, motor, compensation: 0, errors: 0, swapped: true, servo: None });
        bench.feed(tell::ROTATE, way);
        // The shaft turns by a few counts. A turn has 16.
        bench.run(Duration::millis(if speed == 30 { 2_000 } else { 200 }));
        assert_eq!(bench.ask(ask::ERRORS), 0x10, "{speed} rpm");
        // The position counts backward until the drive stops the motor.
        assert_eq!(bench.ask(ask::POSITION).signum(), -way);
    }
}

#[test]
fn an_edge_that_is_none_is_an_error() {
    let mut servo = Servo::new(Instant::ZERO, FACTORY);
    for a in [true, false] {
        servo.edge(Instant::ZERO, a, true);
    }
    assert_eq!((servo.position(), servo.errors()), (0, 0));
    servo.edge(Instant::ZERO + TICK, true, true);
    assert_eq!((servo.position(), servo.errors()), (0, 0x10));
}

#[test]
fn what_stands_wants_nothing() {
    let mut bench = Bench::new(FACTORY);
    assert_eq!(bench.rig.deadline(), Instant::NEVER);
    bench.feed(tell::GO, 0);
    assert_eq!(bench.rig.deadline(), Instant::NEVER);
    bench.feed(tell::GO, 3);
    bench.finish();
    bench.run(Duration::secs(1));
    assert_eq!(bench.rig.deadline(), Instant::NEVER);
}

/// A motor that may differ from the one in the registers, ready to start from rest.
fn on_another(settings: Settings, motor: Parameters) -> Bench {
    let mut bench = Bench::on(settings, motor);
    bench.run(Duration::millis(500));
    bench
}

/// With the nominal counts per turn the servo believes that the distance is six times as long in turns. The motor
/// passes the target to and fro, and makes two edges 1.86 ms apart in each direction.
#[test]
fn a_move_of_one_count_of_many_learns_the_counts_in_two_edges() {
    let motor = Parameters {
        no_load_rpm: 1_500,
        hall_pulses: 12,
        inertia_gcm2: 100,
        resistance_mohm: 200,
        ..Parameters::NOMINAL
    };
    let mut bench = on_another(Settings { pulses: 2, speed: 673, acc: 633, dec: 752, ..FACTORY }, motor);
    bench.feed(tell::GO, 1);
    assert!(bench.finish() < Duration::millis(50));
    assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (1, 0));
}

#[test]
fn a_heavy_motor_that_was_learnt_wrongly_is_waited_for() {
    // The current is at its limit from the start.
    let heavy = Parameters {
        no_load_rpm: 4_315,
        hall_pulses: 10,
        inertia_gcm2: 10_000,
        resistance_mohm: 289,
        ..Parameters::NOMINAL
    };
    let mut bench = on_another(Settings { pulses: 5, speed: 1_096, acc: 95, dec: 882, ..FACTORY }, heavy);
    let begin = bench.shaft().position;
    bench.feed(tell::GO, 49);
    bench.finish();
    bench.run(Duration::secs(1));
    assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (49, 0));
    assert_eq!(bench.shaft().position - begin, 49);
}

#[test]
fn any_motor_comes_to_its_speed() {
    for no_load_rpm in [1_500, 3_000, 6_000] {
        for (hall_pulses, pulses) in [(4, 4), (2, 4), (12, 4), (2, 12), (12, 2)] {
            for inertia_gcm2 in [100, 400, 2_000, 10_000] {
                for resistance_mohm in [200, 500, 1_000] {
                    let motor = Parameters {
                        no_load_rpm,
                        hall_pulses,
                        inertia_gcm2,
                        resistance_mohm,
                        ..Parameters::NOMINAL
                    };
                    for (halls, speed, acc) in
                        [(2, 300, 100), (1, 300, 100), (2, 1_000, 10), (2, 1_000, 1_000)]
                    {
                        // The greatest and the least speed as the registers count it: at full duty, and at
                        // the least duty.
                        let full = f64::from(no_load_rpm) * f64::from(hall_pulses) / f64::from(pulses);
                        if !(0.015 * full..0.95 * full).contains(&f64::from(speed)) {
                            continue;
                        }
                        let settings = Settings { halls, pulses, speed, acc, ..FACTORY };
                        let mut bench = on_another(settings, motor);
                        bench.feed(tell::ROTATE, 1);
                        bench.run(Duration::secs(2));
                        let within = i64::from(speed / 100);
                        for _ in 0..200 {
                            bench.run(TICK);
                            let off = bench.ask(ask::SPEED) - i64::from(speed);
                            assert!(off.abs() <= within, "off by {off} rpm: {settings:?} {motor:?}");
                        }
                        assert_eq!(bench.ask(ask::ERRORS) & 0x10, 0, "{settings:?} {motor:?}");
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, max_shrink_iters: 100, ..ProptestConfig::default() })]

    #[test]
    fn any_motor_ends_its_moves_on_their_counts(
        no_load_rpm in 1_500..6_001_u32, hall_pulses in 2..13_u16, pulses in 2..13_u16,
        inertia_gcm2 in prop_oneof![Just(100_u32), Just(10_000), 100..10_001_u32],
        resistance_mohm in 200..1_001_u32, speed in 100..2_001_u16, acc in 10..1_001_u16, dec in 10..1_001_u16,
        closed in any::<bool>(), counts in proptest::collection::vec(-100..100_i64, 1..4),
    ) {
        let motor = Parameters {
            no_load_rpm, hall_pulses, inertia_gcm2, resistance_mohm, ..Parameters::NOMINAL
        };
        let mut bench = on_another(Settings { pulses, speed, acc, dec, closed, ..FACTORY }, motor);
        let (mut goal, begin) = (0, bench.shaft().position);
        for counts in counts {
            goal += counts;
            bench.feed(tell::GO, counts);
            bench.finish();
            // Coasting after the end would show here.
            bench.run(Duration::secs(1));
            prop_assert_eq!((bench.ask(ask::POSITION), bench.ask(ask::LEFT)), (goal, 0));
            prop_assert_eq!(i64::from(bench.shaft().position - begin), goal);
        }
        prop_assert_eq!(bench.ask(ask::ERRORS) & 0x10, 0);
    }
}
