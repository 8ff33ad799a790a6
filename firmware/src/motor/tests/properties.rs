//! Compares random motors with a numerical solution of their equations.

use proptest::prelude::*;

use super::*;

/// The same motor in SI units and floating point, computed in steps of 10 µs by the Runge-Kutta method.
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

    /// Acceleration in rad/s² at a speed in rad/s. `way` is the direction of the motion.
    fn acceleration(&self, speed: f64, way: f64) -> f64 {
        let p = &self.parameters;
        let k = f64::from(p.supply_mv) * 1e-3 / (f64::from(p.no_load_rpm) * TAU / 60.0);
        let volts = self.duty * f64::from(p.supply_mv) * 1e-3 - k * speed;
        let through = |volts: f64| volts / (f64::from(p.resistance_mohm) * 1e-3);
        let current = through(volts).clamp(-self.limit, self.limit);
        // If a load turns the motor faster than the supply voltage can, the motor charges the supply.
        let charge = through(k * speed.abs() - f64::from(p.supply_mv) * 1e-3).max(0.0);
        let current = match speed {
            _ if charge == 0.0 => current,
            0.0.. => current.min(-charge),
            _ => current.max(charge),
        };
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

/// Parameters of motors from a toy to a washing machine.
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

/// A sequence of times in ms, each with a duty and a current limit.
fn script() -> impl Strategy<Value = Vec<(u64, i32, u32)>> {
    let duty = prop_oneof![Just(0), -65_536..65_537_i32];
    proptest::collection::vec((1..200_u64, duty, prop_oneof![Just(0), Just(40_000), 1..40_000_u32]), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64, max_shrink_iters: 500, max_global_rejects: 100_000, ..ProptestConfig::default()
    })]

    /// The speed is right within 1 % of the fastest speed so far, and the distance within 1 % of the distance
    /// at that speed. While the motor approaches a new speed, the exponential is a polygon with corners at the steps
    /// (see [`Constants`]): half a time constant apart, 3 % of the change beside it.
    #[test]
    fn a_motor_turns_as_its_equations_say(parameters in parameters(), script in script()) {
        let (mut reference, mut out) = (Reference::new(parameters), recorder());
        let mut motor = motor(parameters);
        let counts = counts(&parameters);
        let full = f64::from(parameters.no_load_rpm) / 60.0;
        let (mut ms, mut fastest) = (0, full);
        // J·R/k², with k = U/ω of the motor without load.
        let k = f64::from(parameters.supply_mv) * 1e-3 / (full * TAU);
        let inertia = f64::from(parameters.inertia_gcm2) * 1e-7;
        let time_constant = inertia * f64::from(parameters.resistance_mohm) * 1e-3 / (k * k);
        for (span, drive, ma) in script {
            motor.command(at_ms(ms), current(ma), &mut out);
            motor.command(at_ms(ms), duty(drive), &mut out);
            (reference.duty, reference.limit) = (f64::from(drive) / 65_536.0, f64::from(ma) * 1e-3);
            let change = f64::from(drive.abs()) / 65_536.0 * full + (reference.speed / TAU).abs();
            reference.run(span);
            ms += span;
            let seconds = span as f64 / 1e3;
            let step = (1e-3 / time_constant).min(0.5);
            let beside = if seconds < 4.0 * time_constant { 0.12 * step * step * change } else { 0.0 };
            advance(&mut motor, at_ms(ms), &mut out);
            fastest = fastest.max((reference.speed / TAU).abs());
            let speed = turns_per_second(&motor, at_ms(ms));
            prop_assert!((speed - reference.speed / TAU).abs() <= 0.01 * fastest + beside, "{} rps, not {}", speed, reference.speed / TAU);
            let turns = f64::from(motor.shaft(at_ms(ms)).unwrap().position) / counts;
            let tolerance = 1.0 / counts + 0.01 * fastest * ms as f64 / 1e3;
            prop_assert!((turns - reference.turns).abs() <= tolerance, "{} turns, not {}", turns, reference.turns);
        }
    }

    #[test]
    fn every_edge_is_where_the_shaft_crosses_it(parameters in parameters(), script in script()) {
        let (mut motor, mut ms) = (motor(parameters), 0);
        for (span, drive, ma) in script {
            motor.command(at_ms(ms), current(ma), &mut recorder());
            motor.command(at_ms(ms), duty(drive), &mut recorder());
            ms += span;
            while motor.deadline() <= at_ms(ms) {
                let due = motor.deadline();
                let place = |at| i64::from(motor.shaft(at).unwrap().position);
                let (before, here) = (place(due - Duration::TICK), place(due));
                let mut out = recorder();
                motor.timeout(due, &mut out);
                // With two sensors both are high in count 0, and A leads. With three, each is high for half
                // of a pulse, and rises a third of a pulse after the sensor before it.
                let (of, high): (i64, &[_]) = match parameters.hall_sensors {
                    2 => (4, &[[3, 0].as_slice(), &[0, 1]]),
                    _ => (6, &[&[0, 1, 2], &[2, 3, 4], &[4, 5, 0]]),
                };
                for &(_, sensor, level) in &out.levels {
                    let Sensor::Hall(hall) = sensor else { panic!("it has no encoder") };
                    let counts = high[usize::from(hall)];
                    prop_assert_eq!(level, counts.contains(&here.rem_euclid(of)), "{:?} in {}", sensor, here);
                }
                if !out.levels.is_empty() {
                    prop_assert_eq!(((here - before).abs(), out.levels.len()), (1, 1));
                }
            }
        }
    }

    /// Exception: the current that charges the supply, when the motor is faster than the supply would turn
    /// it.
    #[test]
    fn it_never_draws_more_than_the_bridge_carries(parameters in parameters(), script in script()) {
        let (mut motor, mut ms) = (motor(parameters), 0);
        let full = f64::from(parameters.no_load_rpm) / 60.0;
        for (span, drive, ma) in script {
            motor.command(at_ms(ms), current(ma), &mut recorder());
            motor.command(at_ms(ms), duty(drive), &mut recorder());
            ms += span;
            while motor.deadline() <= at_ms(ms) {
                let at = motor.deadline();
                motor.timeout(at, &mut recorder());
                let (turns, drawn) = (turns_per_second(&motor, at), motor.shaft(at).unwrap().ma);
                let charges = turns.abs() > 0.999 * full && f64::from(drawn) * turns < 0.0;
                prop_assert!(drawn.unsigned_abs() <= ma || charges, "{} mA at {} rps", drawn, turns);
            }
        }
    }

    /// A motor that is not polled coasts like one that is polled all the time, as long as it does not charge
    /// its supply.
    #[test]
    fn it_coasts_in_one_go_as_stretch_by_stretch(
        parameters in parameters(), spun in -65_536..65_537_i32, ms in 1..3_000_u64,
    ) {
        let (mut motor, mut out) = (motor(parameters), recorder());
        motor.command(at_ms(0), duty(spun), &mut out);
        motor.command(at_ms(0), current(20_000), &mut out);
        advance(&mut motor, at_ms(300), &mut out);
        motor.command(at_ms(300), current(0), &mut out);
        let at = at_ms(300 + ms);
        let unseen = motor.shaft(at).unwrap();
        let full = f64::from(parameters.no_load_rpm) / 60.0;
        prop_assume!([at_ms(300), at].map(|at| turns_per_second(&motor, at).abs() < full) == [true; 2]);
        advance(&mut motor, at, &mut out);
        let seen = motor.shaft(at).unwrap();
        prop_assert!((unseen.position - seen.position).abs() <= 1, "{:?} {:?}", unseen, seen);
        let off = (unseen.speed - seen.speed).abs().to_num::<f64>();
        prop_assert!(off <= 0.001 + 1e-6 * seen.speed.abs().to_num::<f64>(), "{:?} {:?}", unseen, seen);
    }

    #[test]
    fn left_alone_it_only_gets_slower_and_then_is_quiet(
        parameters in parameters(), spun in -65_536..65_537_i32, shorted in any::<bool>(),
    ) {
        let parameters = Parameters { load_unm: 0, friction_unm: parameters.friction_unm.max(1_000), ..parameters };
        let (mut motor, mut out) = (motor(parameters), recorder());
        motor.command(at_ms(0), current(40_000), &mut out);
        motor.command(at_ms(0), duty(spun), &mut out);
        advance(&mut motor, at_ms(500), &mut out);
        motor.command(at_ms(500), duty(0), &mut out);
        motor.command(at_ms(500), current(if shorted { 40_000 } else { 0 }), &mut out);
        let mut speed = turns_per_second(&motor, at_ms(500)).abs();
        while motor.deadline() != Instant::NEVER {
            let at = motor.deadline();
            motor.timeout(at, &mut out);
            let slower = turns_per_second(&motor, at).abs();
            prop_assert!(slower <= speed, "{} after {}", slower, speed);
            speed = slower;
        }
        prop_assert_eq!(speed, 0.0);
        prop_assert_eq!(motor.shaft(Instant::NEVER).unwrap().ma, 0);
    }
}
