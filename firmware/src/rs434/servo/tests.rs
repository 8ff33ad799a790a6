use core::f64::consts::TAU;

use proptest::prelude::*;

use super::*;
use crate::device::{Axis, Boot, Device, Fault, Input, Pin, Refused, Shaft, Spec, advance, feed};
use crate::motor::{Rig, Turns};

const HALLS: [Pin; 2] = [Pin(0), Pin(1)];
const HELD: Fault = Fault(0);

static BARE: Spec = Spec { kind: "servo", ..Spec::BARE };

/// What a test tells a drive that is nothing but a servo.
mod tell {
    pub(super) const ROTATE: usize = 0;
    pub(super) const GO: usize = 1;
    pub(super) const STOP: usize = 2;
    pub(super) const HALT: usize = 3;
    pub(super) const SPEED: usize = 4;
    pub(super) const COMPENSATION: usize = 5;
}

/// And asks it.
mod ask {
    pub(super) const DIRECTION: usize = 0;
    pub(super) const POSITION: usize = 1;
    pub(super) const LEFT: usize = 2;
    pub(super) const SPEED: usize = 3;
    pub(super) const ERRORS: usize = 4;
}

/// A drive that is nothing but a servo.
#[derive(Clone)]
struct Bare {
    settings: Settings,
    motor: Parameters,
    compensation: i16,
    errors: u16,
    servo: Option<Servo>,
}

impl Turns for Bare {
    const HALLS: &'static [Pin] = &HALLS;
    const STALL: Option<Fault> = Some(HELD);

    fn motor(&self) -> Parameters {
        self.motor
    }
}

impl Device for Bare {
    fn spec(&self) -> &'static Spec {
        &BARE
    }

    fn power_on(&mut self, at: Instant, _boot: Boot, out: &mut dyn Sink) {
        self.servo = Some(Servo::new(at, self.settings, out));
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Sink) {
        let servo = self.servo.as_mut().unwrap();
        match input {
            Input::Edge { pin, high } => servo.edge(at, pin == HALLS[0], high, out),
            Input::Draws { ma, .. } => servo.draws(at, ma),
            _ => {}
        }
        self.errors |= servo.errors();
    }

    fn deadline(&self) -> Instant {
        self.servo.as_ref().map_or(Instant::NEVER, Servo::deadline)
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Sink) {
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
            _ => self.errors.into(),
        }
    }

    fn poke(&mut self, at: Instant, row: usize, value: i64, out: &mut dyn Sink) -> Result<(), Refused> {
        let servo = self.servo.as_mut().unwrap();
        match row {
            tell::ROTATE => servo.rotate(at, value > 0, out),
            tell::GO => servo.go(at, value as i32, self.compensation, out),
            tell::STOP => servo.stop(at, out),
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

struct Nowhere;

impl Sink for Nowhere {
    fn put(&mut self, _at: Instant, _output: Output<'_>) {}
    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// A servo with its motor, and a clock.
struct Bench {
    rig: Rig<Bare>,
    now: Instant,
}

impl Bench {
    fn new(settings: Settings) -> Self {
        Self::with(settings, Parameters::NOMINAL)
    }

    /// With another friction, load or inertia.
    fn with(settings: Settings, motor: Parameters) -> Self {
        let motor = Parameters { no_load_rpm: settings.rated.into(), hall_pulses: settings.pulses, ..motor };
        let mut rig = Rig::new(Bare { settings, motor, compensation: 0, errors: 0, servo: None });
        rig.power_on(Instant::ZERO, Boot::default(), &mut Nowhere);
        let mut bench = Self { rig, now: Instant::ZERO };
        bench.run(LOOK);
        bench
    }

    fn tell(&mut self, what: usize, value: i64) {
        self.rig.poke(self.now, what, value, &mut Nowhere).unwrap();
    }

    fn ask(&self, what: usize) -> i64 {
        self.rig.peek(self.now, what)
    }

    fn hold(&mut self, on: bool) {
        feed(&mut self.rig, Instant::NEVER, self.now, Input::Fault { fault: HELD, on }, &mut Nowhere);
    }

    fn shaft(&self) -> Shaft {
        self.rig.shaft(self.now, Axis(0)).unwrap()
    }

    fn run(&mut self, span: Duration) {
        self.now += span;
        advance(&mut self.rig, self.now, core::iter::empty(), &mut Nowhere);
    }

    /// Until it stands; how long that took.
    fn finish(&mut self) -> Duration {
        let begin = self.now;
        while self.ask(ask::DIRECTION) != 0 {
            self.run(LOOK);
            assert!(self.now.since(begin) < Duration::secs(60), "still on its way");
        }
        self.now.since(begin)
    }
}

/// The time of a move in ms, by the formulas of uniform acceleration.
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

/// Settings, and a move that takes some seconds at most.
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

/// Torque of a current, in µN·m.
fn torque(settings: &Settings, ma: u32) -> u32 {
    let k = 24.0 / (f64::from(settings.rated) * TAU / 60.0);
    (k * f64::from(ma) * 1e3) as u32
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, max_shrink_iters: 100, ..ProptestConfig::default() })]

    #[test]
    fn a_move_ends_on_its_count((settings, counts) in moves(), friction in 0..51_u32, load in -50..51_i32) {
        // Half of what REF_CURRENT can carry, for both together.
        let most = torque(&settings, settings.limit_ma) / 100;
        let (friction, load) = if friction.cast_signed() + load.abs() > 50 { (friction / 2, load / 2) } else { (friction, load) };
        let motor = Parameters { friction_unm: friction * most, load_unm: load * most.cast_signed(), ..Parameters::NOMINAL };
        // A load that friction does not hold turns the motor before the move and after it.
        let mut bench = Bench::with(settings, motor);
        let before = bench.ask(ask::POSITION);
        bench.tell(tell::GO, counts.into());
        let took = bench.finish();
        prop_assert_eq!(bench.ask(ask::POSITION), before + i64::from(counts));
        prop_assert_eq!(bench.ask(ask::LEFT), 0);
        let _ = took;
    }
}
