#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use core::f64::consts::TAU;
use std::string::String;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::device::advance;

const AXIS: Axis = Axis(0);

/// What a motor put.
#[derive(Default)]
struct Log {
    edges: Vec<(Instant, Pin, bool)>,
    draws: Vec<(Instant, i32)>,
}

impl Sink for Log {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Level { pin, level } => self.edges.push((at, pin, level == Level::High)),
            Output::Draws { ma, .. } => self.draws.push((at, ma)),
            _ => panic!("a motor does not put {output:?}"),
        }
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// A motor that has had power for no time.
fn motor(parameters: Parameters) -> Motor {
    let mut motor = Motor::new(parameters);
    motor.power_on(Instant::ZERO, Boot::default(), &mut Log::default());
    motor
}

fn at_ms(ms: u64) -> Instant {
    Instant::from(Duration::millis(ms))
}

fn current(ma: u32) -> Input<'static> {
    Input::Current { axis: AXIS, ma }
}

fn duty(duty: i32) -> Input<'static> {
    Input::Duty { axis: AXIS, duty }
}

fn held(on: bool) -> Input<'static> {
    Input::Fault { fault: STALL, on }
}

/// Edges of its Hall sensors in a turn.
fn counts(parameters: &Parameters) -> f64 {
    2.0 * f64::from(parameters.hall_sensors) * f64::from(parameters.hall_pulses)
}

fn turns_per_second(motor: &Motor, at: Instant) -> f64 {
    motor.shaft(at, AXIS).unwrap().speed.to_num::<f64>() / counts(motor.parameters())
}

/// The same motor in SI units and floating point, 10 µs by 10 µs after Runge and Kutta.
struct Reference {
    parameters: Parameters,
    duty: f64,
    limit: f64,
    turns: f64,
    speed: f64,
}

impl Reference {
    fn new(parameters: Parameters) -> Self {
        Self { parameters, duty: 0.0, limit: 0.0, turns: 0.0, speed: 0.0 }
    }

    /// rad/s² at a speed in rad/s, while it turns in the direction `way`.
    fn acceleration(&self, speed: f64, way: f64) -> f64 {
        let p = &self.parameters;
        let k = f64::from(p.supply_mv) * 1e-3 / (f64::from(p.no_load_rpm) * TAU / 60.0);
        let volts = self.duty * f64::from(p.supply_mv) * 1e-3 - k * speed;
        let current = (volts / (f64::from(p.resistance_mohm) * 1e-3)).clamp(-self.limit, self.limit);
        let torque = k * current - f64::from(p.load_unm) * 1e-6;
        let friction = f64::from(p.friction_unm) * 1e-6;
        let net = if way == 0.0 {
            if torque.abs() <= friction { 0.0 } else { torque - torque.signum() * friction }
        } else {
            torque - way * friction
        };
        net / (f64::from(p.inertia_gcm2) * 1e-7)
    }

    fn run(&mut self, ms: u64) {
        const H: f64 = 10e-6;
        for _ in 0..100 * ms {
            let way = if self.speed == 0.0 { 0.0 } else { self.speed.signum() };
            let a = |speed: f64| self.acceleration(speed, way);
            let k1 = a(self.speed);
            let k2 = a(self.speed + k1 * H / 2.0);
            let k3 = a(self.speed + k2 * H / 2.0);
            let k4 = a(self.speed + k3 * H);
            let next = self.speed + (k1 + 2.0 * k2 + 2.0 * k3 + k4) * H / 6.0;
            let next = if next * self.speed < 0.0 { 0.0 } else { next };
            self.turns += (self.speed + next) / 2.0 * H / TAU;
            self.speed = next;
        }
    }
}

#[test]
fn a_small_current_turns_the_lightest_of_motors_too() {
    // It would be at its speed in 8 µs, but for 20 mA: 0.161 N·m/A of it on 20 g·cm² are 256 turns/s².
    let light = Parameters {
        supply_mv: 23_362,
        no_load_rpm: 1_387,
        resistance_mohm: 100,
        inertia_gcm2: 20,
        friction_unm: 0,
        ..Parameters::NOMINAL
    };
    let (mut motor, mut log) = (motor(light), Log::default());
    motor.input(at_ms(0), current(20), &mut log);
    motor.input(at_ms(0), duty(4_183), &mut log);
    advance(&mut motor, at_ms(1), core::iter::empty(), &mut log);
    assert_eq!((turns_per_second(&motor, at_ms(1)) * 1e3).round(), 256.0);
    assert_eq!(log.draws, [(at_ms(0), 20)]);
}

/// Motors from a toy to a washing machine's.
fn parameters() -> impl Strategy<Value = Parameters> {
    let load = -60_000..60_000_i32;
    let halls = (1..13_u16, 2..4_u8);
    (8_000..30_000_u32, 1_000..15_000_u32, 100..2_000_u32, 20..5_000_u32, 0..60_000_u32, load, halls)
        .prop_map(|(supply_mv, no_load_rpm, resistance_mohm, inertia_gcm2, friction_unm, load_unm, halls)| {
            Parameters {
                supply_mv,
                no_load_rpm,
                resistance_mohm,
                inertia_gcm2,
                friction_unm,
                load_unm,
                hall_pulses: halls.0,
                hall_sensors: halls.1,
                encoder_cycles: 0,
            }
        })
}

/// Milliseconds, the duty and the limit of the current in them.
fn script() -> impl Strategy<Value = Vec<(u64, i32, u32)>> {
    let duty = prop_oneof![Just(0), -65_536..65_537_i32];
    proptest::collection::vec((1..200_u64, duty, prop_oneof![Just(0), Just(40_000), 1..40_000_u32]), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, max_shrink_iters: 500, ..ProptestConfig::default() })]

    /// Speed within 1 % of the fastest so far, way within 1 % of what it would be at that.
    #[test]
    fn a_motor_turns_as_its_equations_say(parameters in parameters(), script in script()) {
        let (mut reference, mut log) = (Reference::new(parameters), Log::default());
        let mut motor = motor(parameters);
        let counts = counts(&parameters);
        let (mut ms, mut fastest) = (0, f64::from(parameters.no_load_rpm) / 60.0);
        for (span, drive, ma) in script {
            motor.input(at_ms(ms), current(ma), &mut log);
            motor.input(at_ms(ms), duty(drive), &mut log);
            (reference.duty, reference.limit) = (f64::from(drive) / 65_536.0, f64::from(ma) * 1e-3);
            reference.run(span);
            ms += span;
            advance(&mut motor, at_ms(ms), core::iter::empty(), &mut log);
            fastest = fastest.max((reference.speed / TAU).abs());
            let speed = turns_per_second(&motor, at_ms(ms));
            prop_assert!((speed - reference.speed / TAU).abs() <= 0.01 * fastest, "{} rps, not {}", speed, reference.speed / TAU);
            let turns = f64::from(motor.shaft(at_ms(ms), AXIS).unwrap().position) / counts;
            let tolerance = 1.0 / counts + 0.01 * fastest * ms as f64 / 1e3;
            prop_assert!((turns - reference.turns).abs() <= tolerance, "{} turns, not {}", turns, reference.turns);
        }
    }

    #[test]
    fn every_edge_is_where_the_shaft_crosses_it(parameters in parameters(), script in script()) {
        let (mut motor, mut ms) = (motor(parameters), 0);
        for (span, drive, ma) in script {
            motor.input(at_ms(ms), current(ma), &mut Log::default());
            motor.input(at_ms(ms), duty(drive), &mut Log::default());
            ms += span;
            while motor.deadline() <= at_ms(ms) {
                let due = motor.deadline();
                let place = |at| i64::from(motor.shaft(at, AXIS).unwrap().position);
                let (before, here) = (place(due - Duration::TICK), place(due));
                let mut log = Log::default();
                motor.timeout(due, &mut log);
                // Of two both sensors are high in count 0, and A leads; of three each is high for half of a pulse
                // from where it rises, a third of one behind the last.
                let (of, high): (i64, &[_]) = match parameters.hall_sensors {
                    2 => (4, &[(HALL_A, [3, 0].as_slice()), (HALL_B, &[0, 1])]),
                    _ => (6, &[(HALL_A, &[0, 1, 2]), (HALL_B, &[2, 3, 4]), (HALL_C, &[4, 5, 0])]),
                };
                for &(_, pin, level) in &log.edges {
                    let (_, counts) = high.iter().find(|(of, _)| *of == pin).unwrap();
                    prop_assert_eq!(level, counts.contains(&here.rem_euclid(of)), "{:?} in {}", pin, here);
                }
                if !log.edges.is_empty() {
                    prop_assert_eq!(((here - before).abs(), log.edges.len()), (1, 1));
                }
            }
        }
    }

    #[test]
    fn it_never_draws_more_than_the_bridge_carries(parameters in parameters(), script in script()) {
        let (mut motor, mut ms) = (motor(parameters), 0);
        for (span, drive, ma) in script {
            motor.input(at_ms(ms), current(ma), &mut Log::default());
            let mut log = Log::default();
            motor.input(at_ms(ms), duty(drive), &mut log);
            ms += span;
            advance(&mut motor, at_ms(ms), core::iter::empty(), &mut log);
            prop_assert!(log.draws.iter().all(|(_, drawn)| drawn.unsigned_abs() <= ma), "{:?}", log.draws);
        }
    }

    /// What nobody looks at coasts as what is looked at all the time.
    #[test]
    fn it_coasts_in_one_go_as_stretch_by_stretch(
        parameters in parameters(), spun in -65_536..65_537_i32, ms in 1..3_000_u64,
    ) {
        let (mut motor, mut log) = (motor(parameters), Log::default());
        motor.input(at_ms(0), duty(spun), &mut log);
        motor.input(at_ms(0), current(20_000), &mut log);
        advance(&mut motor, at_ms(300), core::iter::empty(), &mut log);
        motor.input(at_ms(300), current(0), &mut log);
        let at = at_ms(300 + ms);
        let unseen = motor.shaft(at, AXIS).unwrap();
        advance(&mut motor, at, core::iter::empty(), &mut log);
        let seen = motor.shaft(at, AXIS).unwrap();
        // That of all motors: what still accelerates there goes a little too far, stretch by stretch.
        const MOST: f64 = 3_906.0;
        prop_assume!(turns_per_second(&motor, at).abs() < MOST);
        prop_assert!((unseen.position - seen.position).abs() <= 1, "{:?} {:?}", unseen, seen);
        let off = (unseen.speed - seen.speed).abs().to_num::<f64>();
        prop_assert!(off <= 0.001 + 1e-6 * seen.speed.abs().to_num::<f64>(), "{:?} {:?}", unseen, seen);
    }

    #[test]
    fn left_alone_it_only_gets_slower_and_then_is_quiet(
        parameters in parameters(), spun in -65_536..65_537_i32, shorted in any::<bool>(),
    ) {
        let parameters = Parameters { load_unm: 0, friction_unm: parameters.friction_unm.max(1_000), ..parameters };
        let (mut motor, mut log) = (motor(parameters), Log::default());
        motor.input(at_ms(0), current(40_000), &mut log);
        motor.input(at_ms(0), duty(spun), &mut log);
        advance(&mut motor, at_ms(500), core::iter::empty(), &mut log);
        motor.input(at_ms(500), duty(0), &mut log);
        motor.input(at_ms(500), current(if shorted { 40_000 } else { 0 }), &mut log);
        let mut speed = turns_per_second(&motor, at_ms(500)).abs();
        while motor.deadline() != Instant::NEVER {
            let at = motor.deadline();
            motor.timeout(at, &mut log);
            let slower = turns_per_second(&motor, at).abs();
            prop_assert!(slower <= speed, "{} after {}", slower, speed);
            speed = slower;
        }
        prop_assert_eq!(speed, 0.0);
        prop_assert_eq!(motor.shaft(Instant::NEVER, AXIS).unwrap().ma, 0);
    }
}

#[test]
fn at_full_duty_it_comes_to_its_no_load_speed_but_for_friction() {
    let (mut motor, mut log) = (motor(Parameters { friction_unm: 0, ..Parameters::NOMINAL }), Log::default());
    motor.input(at_ms(0), duty(65_536), &mut log);
    motor.input(at_ms(0), current(100_000), &mut log);
    // 24 V at 0.5 Ω.
    assert_eq!(log.draws, [(at_ms(0), 48_000)]);
    advance(&mut motor, at_ms(1_000), core::iter::empty(), &mut log);
    assert!((turns_per_second(&motor, at_ms(1_000)) - 50.0).abs() < 0.001);
    assert_eq!(motor.shaft(at_ms(1_000), AXIS).unwrap().ma, 0);
}

#[test]
fn friction_holds_what_is_not_stronger() {
    // 24 V·60/(2π·3,000) is 76.394 mN·m/A: 10 mN·m are 130.9 mA, at 48 A for 65,536 a duty of 178.7.
    for (drive, turns) in [(178, false), (179, true), (-178, false), (-179, true)] {
        let (mut motor, mut log) = (motor(Parameters::NOMINAL), Log::default());
        motor.input(at_ms(0), duty(drive), &mut log);
        motor.input(at_ms(0), current(20_000), &mut log);
        assert_eq!(motor.deadline() != Instant::NEVER, turns, "{drive}");
    }
}

#[test]
fn a_load_turns_open_terminals_and_is_braked_by_shorted_ones() {
    let (mut motor, mut log) =
        (motor(Parameters { load_unm: -50_000, ..Parameters::NOMINAL }), Log::default());
    motor.input(at_ms(0), held(true), &mut log);
    motor.input(at_ms(0), held(false), &mut log);
    advance(&mut motor, at_ms(100), core::iter::empty(), &mut log);
    // 40 mN·m on 400 g·cm² are 1,000 rad/s².
    assert!((turns_per_second(&motor, at_ms(100)) - 100.0 / TAU).abs() < 0.001);
    motor.input(at_ms(100), current(20_000), &mut log);
    advance(&mut motor, at_ms(1_000), core::iter::empty(), &mut log);
    // 40 mN·m are 523.6 mA and, in 0.5 Ω, 261.8 mV: 32.725 rpm.
    assert!((turns_per_second(&motor, at_ms(1_000)) - 32.725 / 60.0).abs() < 0.001);
    assert_eq!(motor.shaft(at_ms(1_000), AXIS).unwrap().ma, -524);
}

#[test]
fn a_held_shaft_stands_and_draws_what_the_voltage_gives() {
    let (mut motor, mut log) = (motor(Parameters::NOMINAL), Log::default());
    motor.input(at_ms(0), duty(16_384), &mut log);
    motor.input(at_ms(0), current(20_000), &mut log);
    advance(&mut motor, at_ms(100), core::iter::empty(), &mut log);
    motor.input(at_ms(100), held(true), &mut log);
    let shaft = motor.shaft(at_ms(100), AXIS).unwrap();
    assert_eq!(
        (shaft.speed, shaft.ma, motor.deadline()),
        (fixed::types::I48F16::ZERO, 12_000, Instant::NEVER)
    );
    motor.input(at_ms(200), held(false), &mut log);
    advance(&mut motor, at_ms(300), core::iter::empty(), &mut log);
    assert!(turns_per_second(&motor, at_ms(300)) > 10.0);
}

#[test]
fn without_power_it_coasts() {
    let (mut motor, mut log) = (motor(Parameters::NOMINAL), Log::default());
    motor.input(at_ms(0), duty(65_536), &mut log);
    motor.input(at_ms(0), current(20_000), &mut log);
    advance(&mut motor, at_ms(1_000), core::iter::empty(), &mut log);
    let fast = turns_per_second(&motor, at_ms(1_000));
    // 10 mN·m on 400 g·cm² are 250 rad/s², 39.79 rps², and up to 1 ms of it was not looked at.
    let slower = turns_per_second(&motor, at_ms(1_500));
    assert!((fast - slower - 19.89).abs() < 0.05, "{fast} {slower}");
    motor.power_on(at_ms(1_500), Boot::default(), &mut log);
    assert_eq!(turns_per_second(&motor, at_ms(1_500)), slower);
    motor.power_on(at_ms(10_000), Boot::default(), &mut log);
    assert_eq!(motor.deadline(), Instant::NEVER);
}

#[test]
fn without_power_it_coasts_however_long() {
    let spun = |load_unm, friction_unm| {
        let mut motor = motor(Parameters { load_unm, friction_unm, ..Parameters::NOMINAL });
        motor.input(at_ms(0), duty(32_768), &mut Log::default());
        motor.input(at_ms(0), current(20_000), &mut Log::default());
        advance(&mut motor, at_ms(1_000), core::iter::empty(), &mut Log::default());
        motor.input(at_ms(1_000), current(0), &mut Log::default());
        motor
    };
    let day = Instant::from(Duration::secs(86_400));
    // Nothing brakes it: 25 turns a second.
    let motor = spun(0, 0);
    let made = f64::from(
        motor.shaft(day, AXIS).unwrap().position - motor.shaft(at_ms(1_000), AXIS).unwrap().position,
    );
    assert!((made / (86_399.0 * 25.0 * 16.0) - 1.0).abs() < 1e-6, "{made}");
    // A load pulls it, or turns it round first: 234,375 rpm is as fast as anything is.
    for load in [-200_000, 200_000] {
        let mut motor = spun(load, 10_000);
        for at in [day, Instant::from(Duration::from_ticks(1 << 60))] {
            assert_eq!(turns_per_second(&motor, at), -3_906.25 * f64::from(load.signum()));
        }
        motor.power_on(day, Boot::default(), &mut Log::default());
        assert!(motor.deadline() > day && motor.deadline() <= day + Duration::from_ticks(1 << 16));
    }
    assert_eq!(turns_per_second(&spun(0, 1), day), 0.0);
}

#[test]
fn an_encoder_tells_the_same_turns_and_an_index_each() {
    let parameters = Parameters { encoder_cycles: 100, ..Parameters::NOMINAL };
    let (mut motor, mut log) = (motor(parameters), Log::default());
    motor.input(at_ms(0), duty(65_536), &mut log);
    motor.input(at_ms(0), current(20_000), &mut log);
    advance(&mut motor, at_ms(1_000), core::iter::empty(), &mut log);
    let count = |pins: &[Pin]| log.edges.iter().filter(|(_, pin, _)| pins.contains(pin)).count() as i64;
    let (halls, encoder) = (count(&[HALL_A, HALL_B]), count(&[ENCODER_A, ENCODER_B]));
    assert!(halls > 500 && (encoder - halls * 400 / 16).abs() <= 25, "{halls} {encoder}");
    assert!((count(&[ENCODER_I]) - encoder / 200).abs() <= 1);
}

/// What Hall sensors of a motor show while it is turned, each after the other, as long as a turn takes.
fn shown(parameters: Parameters, drive: i32) -> Vec<String> {
    let (mut motor, mut log) = (Motor::new(parameters), Log::default());
    motor.power_on(Instant::ZERO, Boot::default(), &mut log);
    motor.input(at_ms(0), duty(drive), &mut log);
    motor.input(at_ms(0), current(20_000), &mut log);
    advance(&mut motor, at_ms(100), core::iter::empty(), &mut log);
    let pins = [HALL_A, HALL_B, HALL_C];
    let mut levels = [None; 3];
    let mut shown = Vec::new();
    for (at, pin, high) in log.edges {
        levels[pins.iter().position(|of| *of == pin).unwrap()] = Some(high);
        // At the beginning the sensors tell their levels one after the other.
        if at > Instant::ZERO || pin == pins[usize::from(parameters.hall_sensors) - 1] {
            shown.push(levels.into_iter().flatten().map(|high| if high { '1' } else { '0' }).collect());
        }
    }
    shown
}

#[test]
fn hall_sensors_go_through_their_states_one_by_one() {
    let mut three = ["101", "100", "110", "010", "011", "001"];
    let mut two = ["11", "01", "00", "10"];
    for drive in [65_536, -65_536] {
        for (hall_sensors, states) in [(3, three.as_slice()), (2, &two)] {
            let shown = shown(Parameters { hall_sensors, ..Parameters::NOMINAL }, drive);
            assert!(shown.len() > 20, "{shown:?}");
            for (state, expected) in shown.iter().zip(states.iter().cycle()) {
                assert_eq!(state, expected, "{drive}: {shown:?}");
            }
        }
        // Backward from the first one.
        three[1..].reverse();
        two[1..].reverse();
    }
}

#[test]
fn another_motor_is_at_the_same_count() {
    let (mut motor, mut log) = (motor(Parameters::NOMINAL), Log::default());
    motor.input(at_ms(0), duty(-65_536), &mut log);
    motor.input(at_ms(0), current(20_000), &mut log);
    advance(&mut motor, at_ms(300), core::iter::empty(), &mut log);
    let before = motor.shaft(at_ms(300), AXIS).unwrap().position;
    let edges = log.edges.len();
    for hall_pulses in [1, 12, 5, 4] {
        motor.become_another(at_ms(300), Parameters { hall_pulses, ..Parameters::NOMINAL }, &mut log);
        assert_eq!(motor.shaft(at_ms(300), AXIS).unwrap().position, before);
    }
    assert_eq!(log.edges.len(), edges);
    // With another sensor more it is also there, and tells what each of them shows.
    motor.become_another(at_ms(300), Parameters { hall_sensors: 3, ..Parameters::NOMINAL }, &mut log);
    assert_eq!(motor.shaft(at_ms(300), AXIS).unwrap().position, before);
    let states = ["101", "100", "110", "010", "011", "001"];
    let state: String = log.edges[edges..].iter().map(|&(.., high)| if high { '1' } else { '0' }).collect();
    assert_eq!(state, states[before.rem_euclid(6) as usize]);
}
