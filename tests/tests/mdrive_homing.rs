//! Random homings of an MDrive, compared with figure 5.1 of the MCode manual (MC 5-29 to 5-31, 5-43).
//!
//! A home switch, limits and an index are on the shaft of a motor of the bench, at angles between whole
//! steps. The expected end follows from the geometry alone: which mark is found, and on which side of it the
//! shaft ends.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Axis, Pin, Port};
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, Closed, DriveId, Motor, MotorModel, Setup};
use proptest::prelude::*;

/// Full steps per turn.
const FULL_STEPS: f64 = 200.0;

/// The two products. An MDrivePlus has an encoder of 512 lines, a Hybrid one of 1,000.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Product {
    Plus,
    Hybrid,
}

impl Product {
    /// Counts per turn of the built-in encoder.
    fn counts(self) -> f64 {
        if self == Self::Plus { 2_048.0 } else { 4_000.0 }
    }
}

/// A switch that is closed between two angles, in turns.
#[derive(Clone, Copy, Debug)]
struct Switch {
    above: f64,
    below: f64,
}

impl Switch {
    fn beyond(self, rev: f64) -> Self {
        Self { above: self.above + rev, below: self.below + rev }
    }

    fn closed(self) -> Closed {
        let bound = |rev: f64| rev.is_finite().then_some(rev);
        Closed { above_rev: bound(self.above), below_rev: bound(self.below) }
    }
}

/// Rates of a motion: speeds in steps/s, accelerations in steps/s².
#[derive(Clone, Copy, Debug)]
struct Rates {
    microsteps: u16,
    start: f64,
    speed: f64,
    up: f64,
    down: f64,
}

impl Rates {
    fn turns(&self, steps: f64) -> f64 {
        steps / (FULL_STEPS * f64::from(self.microsteps))
    }

    /// Speed in steps/s after `steps` from standstill.
    fn speed_after(&self, steps: f64) -> f64 {
        (self.start * self.start + 2.0 * self.up * steps.max(0.0)).sqrt().min(self.speed)
    }

    /// Length in steps of a ramp from `speed` to standstill.
    fn ramp(&self, speed: f64) -> f64 {
        ((speed * speed - self.start * self.start) / (2.0 * self.down)).max(0.0)
    }
}

struct Rig {
    bench: Bench,
    drive: DriveId,
    motor: Motor,
    /// Angle of the built-in encoder's index mark, in turns of the motor.
    mark: f64,
}

impl Rig {
    fn new(product: Product, rates: &Rates, settings: &[(&str, i64)]) -> Self {
        let mut bench = Bench::new();
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let device = if product == Product::Plus { Mdrive::plus() } else { Mdrive::hybrid() };
        let drive = bench.add_with("x", Box::new(device), setup).unwrap();
        // A Hybrid calibrates for 3.12 s (MC 5-9).
        bench.run_until(4.secs());
        let motor =
            bench.attach_motor("m", drive, Axis(0), MotorModel::Stepper(StepperParameters::NOMINAL)).unwrap();
        let mut rig = Self { bench, drive, motor, mark: 0.0 };
        rig.set("MS", rates.microsteps.into());
        // Sets VI to 1 first, because VI must always be below VM.
        rig.set("VI", 1);
        for (name, value) in [("VM", rates.speed), ("VI", rates.start), ("A", rates.up), ("D", rates.down)] {
            rig.set(name, value as i64);
        }
        for &(name, value) in settings {
            rig.set(name, value);
        }
        // A change of MS calibrates a Hybrid again. The calibration ends on a full step.
        rig.after(4.secs());
        let counted = rig.get("C2") as f64 / product.counts();
        rig.mark = ((rig.turns() - counted) * FULL_STEPS).round() / FULL_STEPS;
        rig
    }

    fn row(&self, name: &str) -> usize {
        self.bench.spec(self.drive).find(name).unwrap_or_else(|| panic!("no register {name}")).row
    }

    fn set(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        self.bench.poke(self.drive, row, value).unwrap_or_else(|error| panic!("{name} = {value}: {error:?}"));
    }

    fn get(&self, name: &str) -> i64 {
        self.bench.peek(self.drive, self.row(name))
    }

    fn pin(&self, name: &str) -> Pin {
        self.bench.spec(self.drive).pin(name).unwrap()
    }

    /// Attaches a switch to input `n` and sets its function (MC 5-63), active low and sinking.
    fn switch(&mut self, n: u8, kind: i64, switch: Switch) {
        let pin = self.pin(&format!("IO{n}"));
        self.bench.switch(self.motor, switch.closed(), (self.drive, pin));
        self.set(&format!("S{n}"), kind << 32);
        self.after(1.millis());
    }

    fn after(&mut self, span: Duration) {
        self.bench.run_until(self.bench.now() + span);
    }

    /// Sends an immediate MCode command.
    fn say(&mut self, line: &str) {
        let client = self.bench.connect_to(self.drive, Port(1)).unwrap();
        self.bench.send(client, format!("{line}\r").as_bytes());
        self.after(20.millis());
        self.bench.disconnect(client);
    }

    /// Runs until MV is 0, for at most `most` seconds.
    #[track_caller]
    fn run_out(&mut self, most: f64) {
        let mut left = (most * 1e3) as u64;
        self.after(3.millis());
        while self.get("MV") != 0 {
            assert!(left > 0, "not at home after {most} s: {} turns", self.turns());
            left -= 1;
            self.after(1.millis());
        }
        // A stop between whole steps leaves a part of a step, by which the shaft now falls back.
        self.after(5.millis());
    }

    fn turns(&self) -> f64 {
        self.bench.turn(self.motor).revolutions
    }
}

#[derive(Clone, Debug)]
struct Scene {
    product: Product,
    kind: u8,
    rates: Rates,
    mt: i64,
    debounce_ms: i64,
    /// Starting position, in turns.
    from: f64,
    switch: Switch,
    /// Limits: closed below the first and above the second angle, in turns; and LM.
    limits: Option<(f64, f64, i64)>,
}

fn rates() -> impl Strategy<Value = Rates> {
    let microsteps = prop::sample::select(vec![1_u16, 2, 5, 16, 50, 108, 250, 256]);
    // VM in turns/s, VI as a share of VM, lengths of ramps in turns. All but VI are exponents of 10.
    (microsteps, -1.0..1.3_f64, 0.005..0.9_f64, -3.0..0.5_f64, -3.0..0.5_f64).prop_map(
        |(microsteps, speed, share, up, down)| {
            let turn = FULL_STEPS * f64::from(microsteps);
            let speed = (10_f64.powf(speed) * turn).round().max(2.0);
            let start = (speed * share).round().clamp(1.0, speed - 1.0);
            let ramp = |turns: f64| {
                let steps = 10_f64.powf(turns) * turn;
                ((speed * speed - start * start) / (2.0 * steps)).round().clamp(91.0, 1_500_000_000.0)
            };
            Rates { microsteps, start, speed, up: ramp(up), down: ramp(down) }
        },
    )
}

fn product() -> impl Strategy<Value = Product> {
    prop_oneof![Just(Product::Plus), Just(Product::Hybrid)]
}

fn scene() -> impl Strategy<Value = Scene> {
    let mt = prop_oneof![Just(0_i64), 1..200_i64];
    let debounce = prop_oneof![2 => Just(0_i64), 1 => 1..20_i64];
    // In one case of four the switch is behind the start, and a limit must reverse the motor.
    let place = (-2.0..2.0_f64, 0.01..2.0_f64, 0.001..0.5_f64, proptest::bool::weighted(0.25));
    let limits = proptest::option::of((0.001..2.0_f64, 0.001..2.0_f64, 1..=6_i64));
    ((product(), 1..=4_u8), rates(), mt, debounce, place, limits).prop_map(
        |((product, kind), rates, mt, debounce_ms, (from, away, width, behind), limits)| {
            // The drive sees a switch only if it is closed longer than the debounce time, at VM and at VI.
            let lasts = rates.turns(1.2 * rates.speed * (debounce_ms as f64 + 1.0) / 1e3);
            let width = width + lasts + rates.turns(2.0);
            let ahead = (kind > 2) != behind;
            let above = if ahead { from + away } else { from - away - width };
            let switch = Switch { above, below: above + width };
            let limits = limits.map(|(near, far, mode)| {
                let (low, high) = (above.min(from), (above + width).max(from));
                // The creep continues until debouncing has reported that the switch is released.
                let clear = rates.turns(3.0 + rates.start * (debounce_ms as f64 / 1e3 + 1e-3));
                (low - near - clear, high + far + clear, mode)
            });
            // If the switch is behind the start, there must be limits.
            let limits =
                limits.or(behind.then_some((above.min(from) - 1.0, (above + width).max(from) + 1.0, 1)));
            Scene { product, kind, rates, mt, debounce_ms, from, switch, limits }
        },
    )
}

/// Expected end of a homing.
#[derive(Clone, Copy, PartialEq, Debug)]
enum End {
    /// Just off the switch, on the side that the kind of homing prescribes.
    Home,
    /// At a limit, with this error code.
    Limit(i64),
    /// Home or at a limit, because the ramp ends very close to the limit.
    Either(i64),
}

/// Expected end by figure 5.1 and MC 5-43, from the geometry.
fn expected(scene: &Scene, from: f64) -> End {
    let Scene { kind, rates, debounce_ms, switch, limits, .. } = scene;
    let back = *kind <= 2;
    let way = if back { from - switch.below } else { switch.above - from };
    let Some((low, high, mode)) = *limits else { return End::Home };
    if matches!(mode, 1 | 4) {
        return End::Home;
    }
    let error = if back { 84 } else { 83 };
    if way < 0.0 {
        return End::Limit(error);
    }
    // In the other modes any limit ends the homing, even one in the ramp after the switch.
    let steps = way * FULL_STEPS * f64::from(rates.microsteps);
    let late = *debounce_ms as f64 / 1e3;
    let speed = rates.speed_after(steps + rates.speed * late);
    let reaches = way + rates.turns(speed * late + rates.ramp(speed));
    let limit = if back { from - low } else { high - from };
    let unsure = rates.turns(3.0 + speed * late) + 0.01 * rates.turns(rates.ramp(speed));
    match limit - reaches {
        beyond if beyond > unsure => End::Home,
        beyond if beyond < -unsure => End::Limit(error),
        _ => End::Either(error),
    }
}

fn check(scene: &Scene) {
    let Scene { product, kind, rates, mt, debounce_ms, from, switch, limits } = scene;
    let mut rig = Rig::new(*product, rates, &[("MT", *mt)]);
    // The calibration of a Hybrid has already turned the shaft.
    let origin = rig.turns();
    let switch = switch.beyond(origin);
    let limits = limits.map(|(low, high, mode)| (low + origin, high + origin, mode));
    // The start is where an ordinary move ends.
    let steps = (from * FULL_STEPS * f64::from(rates.microsteps)).round() as i64;
    rig.set("MA", steps);
    rig.run_out(1_000.0);
    let begins = rig.turns() - origin;
    rig.set("D1", *debounce_ms);
    rig.switch(1, 1, switch);
    if let Some((low, high, mode)) = limits {
        rig.switch(2, 2, Switch { above: high, below: f64::INFINITY });
        rig.switch(3, 3, Switch { above: f64::NEG_INFINITY, below: low });
        rig.set("LM", mode);
    }
    rig.after((debounce_ms + 1).cast_unsigned().millis());
    rig.set("HM", (*kind).into());

    // Time to return from the furthest point at VI, and to go this way several times at VM.
    let span = 20.0 + 4.0 * rates.turns(rates.ramp(rates.speed) + rates.speed * 0.02);
    let most = 10.0 * span * (1.0 / rates.turns(rates.start) + 1.0 / rates.turns(rates.speed)) + 60.0;
    rig.run_out(most);

    let (end, error, active) = (rig.turns(), rig.get("ER"), rig.get("I1") != 0);
    let limit_active = rig.get("I2") != 0 || rig.get("I3") != 0;
    let creeps_back = matches!(kind, 2 | 3);
    let at_home = || {
        assert_eq!((error, active), (0, false), "error and home switch at {end}");
        // A step, and the distance that VI makes in the debounce time.
        let most = rates.turns(1.01 + rates.start * (*debounce_ms as f64 / 1e3 + 1e-6));
        let beyond = if creeps_back { switch.above - end } else { end - switch.below };
        assert!((-1e-9..=most).contains(&beyond), "{beyond} turns off the edge, at most {most}");
    };
    match expected(scene, begins) {
        End::Home => at_home(),
        End::Limit(code) => assert_eq!((error, limit_active), (code, true), "error and limit at {end}"),
        End::Either(code) if error == code => assert!(limit_active),
        End::Either(_) => at_home(),
    }
}

/// Checks a homing to the index by HI `kind`. `from` is the start in turns. With `closed`, EE is 1 if the
/// rates allow it.
fn check_index(product: Product, kind: u8, rates: &Rates, mt: i64, from: f64, closed: bool) {
    let (mut rates, counts) = (*rates, product.counts());
    let turn = FULL_STEPS * f64::from(rates.microsteps);
    let mut rig = Rig::new(product, &rates, &[("MT", mt)]);
    rig.set("MA", (from * turn).round() as i64);
    rig.run_out(1_000.0);
    // EE = 1 needs two steps per count (MC 5-21), and speeds of at least some counts/s (error 90).
    let closed = closed && turn >= 2.0 * counts && rates.start * counts >= 4.0 * turn;
    if closed {
        // EE = 1 rounds VI, VM, A and D to whole counts.
        rig.set("EE", 1);
        for value in [&mut rates.start, &mut rates.speed, &mut rates.up, &mut rates.down] {
            *value = (*value * counts / turn).floor() * turn / counts;
        }
    }
    // A change of EE calibrates a Hybrid, too.
    rig.after(4.secs());
    let begins = rig.turns() - rig.mark;
    rig.say(&format!("HI {kind}"));
    let span = 4.0 + 4.0 * rates.turns(rates.ramp(rates.speed));
    let most = 10.0 * span * (1.0 / rates.turns(rates.start) + 1.0 / rates.turns(rates.speed)) + 60.0;
    rig.run_out(most);

    let end = rig.turns() - rig.mark;
    assert_eq!(rig.get("ER"), 0);
    // The mark is one count wide, the first count of a turn. The search detects the first mark in its
    // direction, and returns to the last mark that its ramp has passed.
    let (search_back, creeps_back) = (kind <= 2, matches!(kind, 2 | 3));
    let begins_on_it = (begins * counts).floor().rem_euclid(counts) == 0.0;
    let first = if search_back || begins_on_it { begins.floor() } else { begins.ceil() };
    // Backward it begins at its upper edge.
    let way = if search_back { begins - first - 1.0 / counts } else { first - begins };
    let speed = rates.speed_after(way.max(0.0) * turn);
    let ramp = if begins_on_it { 0.0 } else { rates.turns(rates.ramp(speed)) };
    let off = |mark: f64| if creeps_back { mark - end } else { end - mark - 1.0 / counts };
    let most = rates.turns(1.01 + rates.start * 1e-6);
    let passed = [0.97 * ramp - 0.02, 1.03 * ramp + 0.02].map(|turns| turns.max(0.0).floor());
    let marks = passed.map(|turns| if search_back { first - turns } else { first + turns });
    let is_off = marks.iter().any(|mark| (-1e-9..=most).contains(&off(*mark)));
    assert!(is_off, "at {end}, not within {most} turns of one of {marks:?}");
    assert!((end * counts + 1e-6).floor().rem_euclid(counts) != 0.0, "on the index at {end}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_homing_to_a_switch_ends_at_the_edge_of_figure_5_1(scene in scene()) {
        check(&scene);
    }

    #[test]
    fn any_homing_to_the_index_ends_a_step_off_it(
        product in product(), kind in 1..=4_u8, rates in rates(), mt in prop_oneof![Just(0_i64), 1..200_i64], from in -2.0..2.0_f64, closed: bool,
    ) {
        check_index(product, kind, &rates, mt, from, closed);
    }
}

/// The mark is a count wide. From its upper edge backward the ramp takes 0.98 turns, from its lower edge it would take 1.29
/// turns and pass another mark.
#[test]
fn a_search_backward_brakes_from_the_upper_edge_of_the_mark() {
    let rates = Rates { microsteps: 50, start: 50.0, speed: 10_000.0, up: 1_099_344.0, down: 1_788.0 };
    check_index(Product::Plus, 1, &rates, 0, -1.997_897_715_050_766_4, false);
}

/// The switch is 10,240 steps wide, and a ramp takes 200,000 steps.
#[test]
fn a_homing_that_overshoots_far_comes_home() {
    for mt in [0, 50] {
        let rates =
            Rates { microsteps: 256, start: 1_000.0, speed: 200_000.0, up: 1_000_000.0, down: 100_000.0 };
        let switch = Switch { above: 1.0, below: 1.2 };
        for kind in 1..=4 {
            let (product, from) = (Product::Plus, if kind <= 2 { 3.0 } else { 0.0 });
            check(&Scene { product, kind, rates, mt, debounce_ms: 0, from, switch, limits: None });
        }
    }
}

/// EE = 1, MT = 50, MR 1000, HI 3: the shaft leaves the mark at 2,048 counts backward, to 2,047.
#[test]
fn hi_3_with_mt_ends_at_the_mark_it_has_found() {
    for mt in [0, 50] {
        let rates = Rates { microsteps: 256, start: 1_000.0, speed: 768_000.0, up: 1e6, down: 1e6 };
        let mut rig = Rig::new(Product::Plus, &rates, &[("MT", mt), ("EE", 1)]);
        rig.set("MR", 1_000);
        rig.run_out(10.0);
        rig.say("HI 3");
        rig.run_out(30.0);
        assert_eq!((rig.get("C2"), rig.get("ER")), (2_047, 0), "MT {mt}");
    }
}

/// LM 4 to 6 stop without a ramp. LM 1 to 3 stop with a ramp that is shorter than a step. Wherever within a
/// step the limit is, the shaft reaches it.
#[test]
fn a_limit_is_still_reached_where_it_stops_a_slew() {
    let rates = Rates { microsteps: 16, start: 1_000.0, speed: 1_010.0, up: 1e6, down: 1e6 };
    for mode in 1..=6 {
        for part in [0.01, 0.3, 0.5, 0.7, 0.99] {
            for back in [false, true] {
                let mut rig = Rig::new(Product::Plus, &rates, &[("LM", mode)]);
                let edge = (rates.turns(1.0) * (700.0 + part)) * if back { -1.0 } else { 1.0 };
                let beyond = Switch { above: edge, below: f64::INFINITY };
                let below = Switch { above: f64::NEG_INFINITY, below: edge };
                if back {
                    rig.switch(3, 3, below);
                } else {
                    rig.switch(2, 2, beyond);
                }
                rig.set("SL", if back { -1_010 } else { 1_010 });
                rig.run_out(5.0);
                let input = if back { "I3" } else { "I2" };
                assert_eq!(
                    (rig.get(input), rig.get("ER")),
                    (1, if back { 84 } else { 83 }),
                    "LM {mode} at {part}"
                );
                // The shaft is within two steps of the edge, and moves no further.
                assert!(rates.turns(2.01) >= (rig.turns() - edge).abs());
                rig.set("MR", if back { -1_000 } else { 1_000 });
                let at = rig.get("C1");
                rig.after(1.secs());
                assert_eq!(rig.get("C1"), at);
            }
        }
    }
}
