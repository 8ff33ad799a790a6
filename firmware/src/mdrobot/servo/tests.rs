#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use std::format;
use std::vec::Vec;

use super::*;
use crate::device::{Boot, Device, Input, Level, Shaft};
use crate::mdrobot::alarm::status;
use crate::motor::{ENCODER_A, ENCODER_B, HALL_PINS, Motor, Parameters, STALL};

/// The motor of the drive: 24 V, 0.06 Nm/A, 0.3 Ω.
const MOTOR: Parameters = Parameters {
    no_load_rpm: 3_820,
    resistance_mohm: 300,
    inertia_gcm2: 5_000,
    friction_unm: 10_000,
    hall_pulses: 2,
    hall_sensors: 3,
    ..Parameters::NOMINAL
};

/// What is on the wires between drive and motor.
#[derive(Clone, Copy, Debug)]
enum Wire {
    Duty(i32),
    Current(u32),
    Draws(i32),
    Sensor(Sensor, bool),
}

struct Wires<'a>(&'a mut Vec<(Instant, Wire)>);

impl Sink for Wires<'_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let wire = match output {
            Output::Duty { duty, .. } => Wire::Duty(duty),
            Output::Current { ma, .. } => Wire::Current(ma),
            Output::Draws { ma, .. } => Wire::Draws(ma),
            Output::Level { pin, level } => {
                let sensor = match pin {
                    ENCODER_A => Sensor::EncoderA,
                    ENCODER_B => Sensor::EncoderB,
                    _ => match HALL_PINS.iter().position(|hall| *hall == pin) {
                        Some(place) => Sensor::Hall(place as u8),
                        None => return,
                    },
                };
                Wire::Sensor(sensor, level == Level::High)
            }
            _ => return,
        };
        self.0.push((at + Duration::TICK, wire));
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// A servo, its motor, and wires between them that take a tick.
struct Bench {
    settings: Settings,
    servo: Servo,
    motor: Motor,
    wires: Vec<(Instant, Wire)>,
    now: Instant,
    most_ma: u32,
    alarms: u16,
    looks: u64,
}

impl Bench {
    fn new(settings: Settings, motor: Parameters) -> Self {
        let mut bench = Self {
            settings,
            servo: Servo::new(settings),
            motor: Motor::new(motor),
            wires: Vec::new(),
            now: Instant::ZERO,
            most_ma: 0,
            alarms: 0,
            looks: 0,
        };
        bench.servo.power_on(Instant::ZERO, settings, &mut Wires(&mut bench.wires));
        bench.motor.power_on(Instant::ZERO, Boot::default(), &mut Wires(&mut bench.wires));
        bench.run_ms(1);
        bench
    }

    fn deliver(&mut self) {
        let wires = core::mem::take(&mut self.wires);
        let mut out = Wires(&mut self.wires);
        for (at, wire) in wires {
            match wire {
                Wire::Duty(duty) => self.motor.input(at, Input::Duty { axis: AXIS, duty }, &mut out),
                Wire::Current(ma) => self.motor.input(at, Input::Current { axis: AXIS, ma }, &mut out),
                Wire::Draws(ma) => {
                    self.most_ma = self.most_ma.max(ma.unsigned_abs());
                    self.servo.draws(at, ma);
                }
                Wire::Sensor(sensor, high) => self.servo.edge(at, sensor, high),
            }
        }
    }

    fn run_ms(&mut self, ms: u64) {
        self.run(Duration::millis(ms));
    }

    fn run(&mut self, span: Duration) {
        let end = self.now + span;
        loop {
            let arrives = self.wires.first().map_or(Instant::NEVER, |(at, _)| *at);
            let due = arrives.min(self.motor.deadline()).min(self.servo.deadline());
            if due > end {
                break;
            }
            self.now = due;
            if arrives <= due {
                self.deliver();
            }
            if self.motor.deadline() <= due {
                self.motor.timeout(due, &mut Wires(&mut self.wires));
            }
            if self.servo.deadline() <= due {
                self.looks += 1;
                self.servo.timeout(due, &mut Wires(&mut self.wires));
            }
            self.alarms |= self.servo.alarms();
            if self.servo.halls_are_broken() {
                self.alarms |= status::HALL_FAIL;
            }
        }
        self.now = end;
    }

    fn order(&mut self, order: Order) {
        self.servo.order(self.now, order, &mut Wires(&mut self.wires));
    }

    fn set(&mut self, change: impl FnOnce(&mut Settings)) {
        change(&mut self.settings);
        self.servo.set(self.now, self.settings, &mut Wires(&mut self.wires));
    }

    fn hold(&mut self, on: bool) {
        self.motor.input(self.now, Input::Fault { fault: STALL, on }, &mut Wires(&mut self.wires));
    }

    fn load(&mut self, load_unm: i32) {
        let parameters = Parameters { load_unm, ..*self.motor.parameters() };
        self.motor.become_another(self.now, parameters, &mut Wires(&mut self.wires));
    }

    fn shaft(&self) -> Shaft {
        self.motor.shaft(self.now, AXIS).unwrap()
    }

    fn real_rpm(&self) -> f64 {
        self.shaft().speed.to_num::<f64>() * 60.0 / (6.0 * f64::from(self.motor.parameters().hall_pulses))
    }

    fn rpm(&self) -> i32 {
        self.servo.rpm(self.now)
    }
}

/// Poles, inertias and frictions that the tolerances hold for.
fn motors() -> impl Iterator<Item = (Settings, Parameters)> {
    [4, 10].into_iter().flat_map(|poles| {
        [2_000, 10_000].into_iter().flat_map(move |inertia_gcm2| {
            [5_000, 60_000].into_iter().map(move |friction_unm| {
                let motor = Parameters { hall_pulses: poles / 2, inertia_gcm2, friction_unm, ..MOTOR };
                (Settings { poles, ..Settings::FACTORY }, motor)
            })
        })
    })
}

#[test]
fn a_step_of_the_velocity_comes_in_time_and_stays() {
    for (settings, motor) in motors() {
        for (from, to) in [(0, 1_000), (0, 40), (1_000, 40), (40, 2_500), (2_500, 100), (1_000, -1_000)] {
            let mut bench = Bench::new(settings, motor);
            if from != 0 {
                bench.order(Order::Velocity(from));
                bench.run_ms(2_000);
            }
            bench.order(Order::Velocity(to));
            let begin = bench.real_rpm();
            let part = |bench: &Bench| (bench.real_rpm() - begin) / (f64::from(to) - begin);
            let what = format!("{from} to {to} of {motor:?}");
            for ms in 1..4_000 {
                bench.run_ms(1);
                let part = part(&bench);
                assert!(part <= 1.2, "{part} of {what} after {ms} ms");
                assert!(ms > 1 || part < 0.6, "{part} of {what} at once");
                assert!(ms < 580 || part >= 0.9, "{part} of {what} after {ms} ms");
                if ms >= 2_000 {
                    let off = (bench.rpm() - to).abs();
                    let most = if to == 40 { 4 } else { (to.abs() / 100).max(2) };
                    assert!(off <= most, "{} of {what} after {ms} ms", bench.rpm());
                }
            }
            assert!(bench.most_ma <= 20_000 && bench.alarms == 0, "{what}: {:?}", bench.alarms);
        }
    }
}

#[test]
fn it_follows_a_ramp() {
    // 15 s·raw/1,023 for 3,000 rpm.
    for (settings, motor) in motors() {
        for (from, to, start, down) in [
            (0, 600, 68, 0),
            (0, 600, 1_023, 0),
            (600, 0, 0, 68),
            (0, 1_000, 205, 0),
            (1_000, 0, 0, 205),
            (0, 2_500, 68, 0),
            (2_500, 0, 0, 136),
            (2_000, 500, 0, 136),
            (0, 1_000, 1_023, 0),
            (1_000, -1_000, 341, 205),
        ] {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(from));
            bench.run_ms(2_000);
            bench.set(|settings| (settings.slow_start, settings.slow_down) = (start, down));
            bench.order(Order::Velocity(to));
            let slope = |raw: u16| 3_000.0 / (15.0 * f64::from(raw) / 1_023.0);
            let ideal = |t: f64| {
                let (from, to) = (f64::from(from), f64::from(to));
                if from * to < 0.0 {
                    let stands = from / slope(down);
                    if t < stands { from - slope(down) * t } else { (slope(start) * (stands - t)).max(to) }
                } else if to > from {
                    (from + slope(start) * t).min(to)
                } else {
                    (from - slope(down) * t).max(to)
                }
            };
            let (mut done, mut ms) = (0, 0);
            while done < 500 {
                bench.run_ms(1);
                ms += 1;
                let should = ideal(f64::from(ms) / 1e3);
                let off = (f64::from(bench.rpm()) - should).abs();
                let step = f64::from(to - from).abs();
                // Inertia and friction at their greatest are 20 ms behind at 3,000 rpm/s, whatever the step, and a
                // ms or two measure the winding.
                assert!(
                    off <= (0.08 * step).max(66.0),
                    "{} for {should} from {from} to {to}, {ms} ms, {motor:?}",
                    bench.rpm()
                );
                done += i32::from((should - f64::from(to)).abs() < 0.5);
            }
            let most = (f64::from(to).abs() / 100.0).max(2.0);
            assert!(f64::from(bench.rpm() - to).abs() <= most, "{} after {from} to {to}", bench.rpm());
        }
    }
}

#[test]
fn a_move_arrives_in_time_and_stays() {
    for (settings, motor) in motors() {
        for (count, rpm) in
            [(1, 1_000), (-2, 1_000), (7, 1_000), (400, 600), (-1_200, 1_500), (3_000, 2_500), (120, 40)]
        {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Position { count, rpm });
            let ideal = f64::from(count).abs() / (f64::from(rpm) / 60.0 * 3.0 * f64::from(settings.poles));
            let what = format!("{count} at {rpm} rpm of {motor:?}");
            let mut arrived = None;
            for ms in 1..(ideal * 2e3) as u64 + 1_500 {
                bench.run_ms(1);
                assert!(bench.real_rpm().abs() <= f64::from(rpm) * 1.15, "{} rpm, {what}", bench.real_rpm());
                let error = bench.servo.error().unwrap();
                assert!(-error * count.signum() <= (count.abs() / 20).max(1), "{error} too far, {what}");
                if error.abs() <= 1 && arrived.is_none() {
                    arrived = Some(ms as f64 / 1e3);
                }
                assert!(arrived.is_none() || error.abs() <= 1, "{error} after {ms} ms, {what}");
            }
            let arrived = arrived.unwrap();
            // The end of it PV_GAIN stretches: 20 rpm for a count are 60/(20·3·poles) s for e-fold slowing down.
            let slowing = 60.0 / (20.0 * 3.0 * f64::from(settings.poles));
            if ideal > 6.0 * slowing {
                // From the middle of a count to the one before the target's.
                let least = ideal * (1.0 - 1.5 / f64::from(count).abs());
                assert!((least..2.0 * ideal).contains(&arrived), "{arrived} s for {ideal}, {what}");
            }
            assert_eq!(bench.servo.position() - count, -bench.servo.error().unwrap());
            assert!(bench.alarms == 0 && bench.real_rpm().abs() < 0.1, "{what}: {:?}", bench.alarms);
        }
    }
}

#[test]
fn the_furthest_position_is_on_its_own_side() {
    for (start, count) in [(100, i32::MIN), (-100, i32::MAX)] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.order(Order::Position { count: start, rpm: 1_000 });
        bench.run_ms(3_000);
        bench.order(Order::Position { count, rpm: 1_000 });
        bench.run_ms(1_000);
        assert!((bench.rpm() - 1_000 * count.signum()).abs() <= 10, "{} rpm to {count}", bench.rpm());
    }
}

#[test]
fn what_is_held_does_not_hunt() {
    for (settings, motor) in motors() {
        let settings = Settings { stop_status: 1, ..settings };
        // Up to half of what 20 A are.
        for load in [0, 30_000, -600_000] {
            for order in [Order::Velocity(0), Order::Position { count: 50, rpm: 500 }] {
                let mut bench = Bench::new(settings, motor);
                bench.order(Order::Velocity(500));
                bench.run_ms(1_000);
                bench.order(order);
                bench.run_ms(3_000);
                bench.load(load);
                bench.run_ms(2_000);
                let place = bench.servo.position();
                for _ in 0..10_000 {
                    bench.run_ms(1);
                    let moved = (bench.servo.position() - place).abs();
                    assert!(moved <= 1, "{moved} counts by {load} µNm, {order:?}, {motor:?}");
                    assert_eq!(bench.rpm(), 0, "by {load} µNm, {order:?}, {motor:?}");
                }
                assert!(
                    bench.servo.error().is_none_or(|error| error.abs() <= 1),
                    "{:?}",
                    bench.servo.error()
                );
            }
        }
    }
}

/// The real speed some seconds after an order.
fn rpm_after(settings: Settings, motor: Parameters, order: Order, ms: u64) -> f64 {
    let mut bench = Bench::new(settings, motor);
    bench.order(order);
    bench.run_ms(ms);
    bench.real_rpm()
}

#[test]
fn gains_act_on_the_motor() {
    for (settings, motor) in motors() {
        let steady = |p_gain, i_gain| {
            rpm_after(Settings { p_gain, i_gain, ..settings }, motor, Order::Velocity(1_000), 3_000)
        };
        assert_eq!(steady(0, 0), 0.0);
        assert!(steady(1, 0) < 900.0);
        let errors = [1_000, 3_000, 6_000, 20_000].map(|p_gain| 1_000.0 - steady(p_gain, 0));
        assert!(errors.is_sorted_by(|more, less| more > less) && errors[3] > 0.0, "{errors:?}");
        for (p_gain, i_gain) in [(6_000, 1_000), (0, 2_000), (20_000, 6_000)] {
            assert!(
                (steady(p_gain, i_gain) - 1_000.0).abs() < 10.0,
                "{p_gain} {i_gain} {}",
                steady(p_gain, i_gain)
            );
        }
    }
}

#[test]
fn no_gain_and_no_limit_make_it_stick_on_the_way() {
    for i_gain in [500, 6_000, 20_000] {
        for p_gain in [1_000, 6_000, 20_000] {
            for limit_ma in [500, 2_000, 20_000] {
                for (from, to) in [(0, 3_000), (3_000, 0), (1_000, -1_000)] {
                    let settings = Settings { i_gain, p_gain, limit_ma, stop_status: 1, ..Settings::FACTORY };
                    let mut bench = turning(Settings::FACTORY, MOTOR, from);
                    bench.set(|now| *now = settings);
                    bench.order(Order::Velocity(to));
                    let what = format!("{from} to {to}, I {i_gain}, P {p_gain}, {limit_ma} mA");
                    // 0.5 A are 0.02 Nm more than friction: 382 rpm/s on 5·10⁻⁴ kg·m².
                    bench.run_ms(11_000);
                    let (mut off, mut accelerates) = (0.0_f64, 0.0_f64);
                    for _ in 0..10 {
                        let before = bench.real_rpm();
                        bench.run_ms(100);
                        off = off.max((bench.real_rpm() - f64::from(to)).abs());
                        accelerates = accelerates.max((bench.real_rpm() - before).abs());
                    }
                    // What is off still swings, as integral gains without proportional ones do; it does not rest there.
                    let settles = off <= (f64::from(to).abs() / 100.0).max(2.0);
                    assert!(settles || accelerates > off / 10.0, "off by {off}: {what}");
                    assert!(settles || p_gain < 6_000, "off by {off}: {what}");
                    // A current at its limit for 4 s is what it is.
                    assert_eq!(bench.alarms & !status::OVER_LOAD, 0, "{what}");
                }
            }
        }
    }
}

#[test]
fn a_smaller_pv_gain_is_later_and_a_lower_max_load_slower() {
    for (settings, motor) in motors() {
        let arrival = |settings| {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Position { count: 300, rpm: 1_000 });
            (1..20_000).find(|_| {
                bench.run_ms(1);
                bench.servo.error().unwrap().abs() <= 1
            })
        };
        let arrivals = [40, 20, 10, 5].map(|pv_gain| arrival(Settings { pv_gain, ..settings }).unwrap());
        assert!(arrivals.is_sorted_by(|soon, late| soon < late), "{arrivals:?}");
        // The fifth of a second in which 20 A accelerate anything to it.
        let speeds = [4_000, 8_000, 16_000]
            .map(|limit_ma| rpm_after(Settings { limit_ma, ..settings }, motor, Order::Velocity(2_500), 60));
        assert!(speeds.is_sorted_by(|slow, fast| slow < fast), "{speeds:?}");
    }
}

#[test]
fn a_current_stays_below_max_load() {
    for (settings, motor) in motors() {
        for limit_ma in [1_500, 20_000] {
            let mut bench = Bench::new(Settings { limit_ma, ..settings }, motor);
            for order in [
                Order::Velocity(3_000),
                Order::Velocity(-3_000),
                Order::Brake,
                Order::Open(1_023),
                Order::Open(-1_023),
                Order::Position { count: 0, rpm: 3_000 },
                Order::Torque(1_023),
                Order::Torque(-1_023),
            ] {
                bench.order(order);
                bench.run_ms(500);
            }
            assert!(bench.most_ma <= limit_ma && bench.most_ma > limit_ma * 9 / 10, "{}", bench.most_ma);
        }
    }
}

#[test]
fn it_coasts_longer_than_it_brakes_and_without_a_current() {
    for (settings, motor) in motors() {
        let stands = |order| {
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(1_000));
            bench.run_ms(1_000);
            bench.order(order);
            bench.run_ms(1);
            (0..60_000).find(|_| {
                bench.run_ms(1);
                assert!(order == Order::Brake || bench.servo.current() == 0);
                assert_eq!(bench.servo.output(bench.now), 0);
                bench.real_rpm() == 0.0
            })
        };
        let (coasts, brakes) = (stands(Order::Free).unwrap(), stands(Order::Brake).unwrap());
        assert!(coasts >= 2 * brakes, "{coasts} and {brakes} ms, {motor:?}");
    }
}

#[test]
fn an_open_loop_is_mirrored_and_goes_with_the_output() {
    for (settings, motor) in motors() {
        let steady = |output| rpm_after(settings, motor, Order::Open(output), 3_000);
        let (one, two) = (steady(300), steady(600));
        assert!((1.6..2.6).contains(&(two / one)), "{one} and {two}");
        assert!((steady(-300) + one).abs() < 0.01 * one);
        // The whole supply, but for friction: 24 V are 3,820 rpm, and 0.06 Nm are 1 A and 0.3 V.
        let lost = f64::from(motor.friction_unm) / 60_000.0 * 0.3 / 24.0;
        assert!((steady(1_023) / (3_820.0 * (1.0 - lost)) - 1.0).abs() < 0.01);
    }
}

#[test]
fn a_torque_is_its_part_of_max_load() {
    for (torque, ma) in [(1_023, 20_000), (-1_023, -20_000), (100, 20_000 * 100 / 1_023), (0, 0)] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.hold(true);
        bench.order(Order::Torque(torque));
        bench.run_ms(100);
        assert_eq!(bench.servo.current(), ma);
        // What it loses in 0.3 Ω of 24 V.
        let output = f64::from(ma) * 0.3 / 24_000.0 * 1_023.0;
        assert!(
            (f64::from(bench.servo.output(bench.now)) - output).abs() <= 1.0,
            "{} {output}",
            bench.servo.output(bench.now)
        );
        bench.hold(false);
        bench.run_ms(20);
        // 0.06 Nm for an A, 0.01 Nm of friction, 5·10⁻⁴ kg·m².
        let way = f64::from(ma) * 0.06e-3 - 0.01 * f64::from(ma.signum());
        let rpm = way / 5e-4 * 0.02 / core::f64::consts::TAU * 60.0;
        assert!((bench.real_rpm() - rpm).abs() <= 0.02 * rpm.abs(), "{} {rpm}", bench.real_rpm());
    }
}

#[test]
fn halls_count_as_the_motor_shows_them() {
    // Turned by its load a turn and more: each count of the shaft is one of the drive.
    for load_unm in [-50_000, 50_000] {
        let mut bench = Bench::new(Settings::FACTORY, Parameters { load_unm, ..MOTOR });
        let start = bench.shaft().position;
        while bench.servo.position().abs() < 24 {
            bench.run(Duration::micros(100));
            // An edge takes a tick from there to here.
            let made = bench.shaft().position - start;
            assert!((bench.servo.position() - made).abs() <= 1, "{made}");
        }
        assert_eq!(bench.servo.position().signum(), -load_unm.signum());
    }
}

#[test]
fn counts_are_three_for_each_pole_and_turn() {
    for (settings, motor) in motors() {
        let mut bench = Bench::new(settings, motor);
        bench.order(Order::Velocity(-1_200));
        bench.run_ms(2_000);
        let (before, shaft) = (bench.servo.position(), bench.shaft().position);
        bench.run_ms(3_000);
        let made = bench.servo.position() - before;
        let ideal = -1_200.0 / 60.0 * 3.0 * f64::from(settings.poles) * 3.0;
        assert!((f64::from(made) - ideal).abs() <= 0.02 * ideal.abs() + 2.0, "{made} {ideal}");
        assert!((bench.shaft().position - shaft - made).abs() <= 1);
    }
}

#[test]
fn what_a_rpm_is_the_sensors_say() {
    // Poles of HALL_TYPE and of the motor, ENC_PPR and the encoder's: by how much the motor is faster.
    for (poles, real_poles, enc_ppr, real_ppr, times) in [
        (8, 4, 0, 0, 2.0),
        (4, 12, 0, 0, 1.0 / 3.0),
        (4, 4, 1_000, 1_000, 1.0),
        (4, 4, 1_000, 500, 2.0),
        (4, 4, 100, 500, 0.2),
        (10, 4, 20, 20, 1.0),
    ] {
        for rpm in [100, 1_000, -600] {
            let settings = Settings { poles, enc_ppr, ..Settings::FACTORY };
            let motor = Parameters { hall_pulses: real_poles / 2, encoder_cycles: real_ppr, ..MOTOR };
            let mut bench = Bench::new(settings, motor);
            bench.order(Order::Velocity(rpm));
            bench.run_ms(3_000);
            let ideal = f64::from(rpm) * times;
            let what = format!("{rpm}, {poles}/{real_poles} poles, {enc_ppr}/{real_ppr}");
            assert!(
                (bench.real_rpm() / ideal - 1.0).abs() < 0.01,
                "{} for {ideal}: {what}",
                bench.real_rpm()
            );
            assert!((bench.rpm() - rpm).abs() <= (rpm.abs() / 100).max(2), "{}: {what}", bench.rpm());
            assert_eq!(bench.alarms, 0, "{what}");
        }
    }
}

#[test]
fn other_motors_are_turned_well() {
    for resistance_mohm in [50, 150, 500, 1_500] {
        for no_load_rpm in [2_000, 4_000, 8_000] {
            for ms in [1.5, 10.0, 50.0] {
                // The time constant is J·R/K².
                let k = 24.0 / (f64::from(no_load_rpm) * core::f64::consts::TAU / 60.0);
                let inertia = ms * 1e-3 * k * k / (f64::from(resistance_mohm) * 1e-3);
                let motor = Parameters {
                    resistance_mohm,
                    inertia_gcm2: (inertia * 1e7) as u32,
                    no_load_rpm,
                    ..MOTOR
                };
                let mut bench = Bench::new(Settings::FACTORY, motor);
                for rpm in [300, -1_000, 100] {
                    bench.order(Order::Velocity(rpm));
                    bench.run_ms(3_000);
                    for _ in 0..500 {
                        bench.run_ms(1);
                        let off = (bench.real_rpm() - f64::from(rpm)).abs();
                        assert!(
                            off <= 0.01 * f64::from(rpm).abs() + 2.0,
                            "{} for {rpm}, {motor:?}",
                            bench.real_rpm()
                        );
                    }
                }
                bench.order(Order::Position { count: bench.servo.position() + 200, rpm: 600 });
                bench.run_ms(4_000);
                assert!(bench.servo.error().unwrap().abs() <= 1, "{:?} left, {motor:?}", bench.servo.error());
            }
        }
    }
}

#[test]
fn the_winding_is_known_after_any_rest() {
    for resistance_mohm in [100, 200, 900, 2_000] {
        for (rest, limit_ma) in [
            (Order::Free, 20_000),
            (Order::Brake, 20_000),
            (Order::Brake, 1_000),
            (Order::Velocity(0), 20_000),
        ] {
            for friction_unm in [10_000, 40_000] {
                let motor = Parameters { resistance_mohm, friction_unm, ..MOTOR };
                let mut bench = Bench::new(Settings { limit_ma, stop_status: 2, ..Settings::FACTORY }, motor);
                bench.order(rest);
                bench.run_ms(100);
                bench.order(Order::Velocity(300));
                bench.run_ms(3_000);
                for _ in 0..500 {
                    bench.run_ms(1);
                    let (shown, real) = (bench.rpm(), bench.real_rpm());
                    let what = format!("{shown} {real} rpm after {rest:?}, {motor:?}");
                    assert!((real - 300.0).abs() <= 3.0 && (shown - 300).abs() <= 3, "{what}");
                }
            }
        }
    }
}

#[test]
fn a_winding_is_measured_while_it_turns() {
    for resistance_mohm in [200, 450, 900] {
        for load_unm in [-40_000, 40_000] {
            for is_seen in [true, false] {
                // Its load has turned it for 0.3 s; then it is caught, by a drive that has not seen it with 14 A at once.
                let motor = Parameters { resistance_mohm, inertia_gcm2: 2_000, load_unm, ..MOTOR };
                let mut bench = Bench::new(Settings::FACTORY, motor);
                bench.run_ms(300);
                if !is_seen {
                    bench.servo.power_on(bench.now, Settings::FACTORY, &mut Wires(&mut bench.wires));
                }
                assert!(bench.real_rpm().abs() > 400.0);
                bench.order(Order::Position { count: -237, rpm: 2_500 });
                bench.run_ms(1);
                // A mA loses so much of 24 V.
                let lost = f64::from(resistance_mohm) * 1e-6 / 24.0 * 65_536.0;
                let measured = bench.servo.emf.lost(1_000).to_num::<f64>() / 1_000.0;
                let what = format!("{measured} for {lost}, {load_unm} µNm, seen: {is_seen}");
                assert!((measured / lost - 1.0).abs() < 0.005, "{what}");
            }
        }
    }
}

#[test]
fn the_output_is_what_the_limit_of_the_current_lets_it() {
    // At 2 A the winding of 0.3 Ω takes 0.6 V, and 0.12 - 0.01 Nm are 110 rad/s in 0.5 s on 5·10⁻⁴ kg·m²: 6.6 V.
    for order in [Order::Open(1_023), Order::Velocity(3_000), Order::Torque(1_023)] {
        let mut bench = Bench::new(Settings { limit_ma: 2_000, ..Settings::FACTORY }, MOTOR);
        bench.hold(true);
        bench.order(order);
        bench.run_ms(100);
        let held = bench.servo.output(bench.now);
        assert!((held - 26).abs() <= 2, "{held} of 25.6, {order:?}");
        bench.hold(false);
        bench.run_ms(500);
        let turns = bench.servo.output(bench.now);
        // Control of the speed leaves some of the limit to itself.
        assert!((285..=310).contains(&turns), "{turns} of 307, {order:?}");
    }
}

#[test]
fn what_stands_stands_for_good() {
    for (settings, motor) in motors() {
        for load in [0, 200_000, -200_000] {
            for order in [Order::Velocity(0), Order::Position { count: 50, rpm: 500 }] {
                let mut bench = Bench::new(Settings { stop_status: 1, ..settings }, motor);
                bench.order(Order::Velocity(700));
                bench.run_ms(1_000);
                bench.load(load);
                bench.order(order);
                bench.run_ms(10_000);
                let before = (bench.servo.position(), bench.servo.duty, bench.servo.pi.clone());
                let what = format!("{load} µNm, {order:?}, {motor:?}");
                // At rest with the same integral and no mistake the next ms is as this one, for ever.
                bench.run_ms(3_000);
                let after = (bench.servo.position(), bench.servo.duty, bench.servo.pi.clone());
                assert_eq!((bench.real_rpm(), bench.rpm(), bench.alarms), (0.0, 0, 0), "{what}");
                assert_eq!(format!("{before:?}"), format!("{after:?}"), "{what}");
                let needed = (f64::from(load).abs() + f64::from(motor.friction_unm)) / 60.0;
                let ma = f64::from(bench.servo.current().abs());
                assert!(ma <= needed + 200.0, "{ma} of {needed} mA, {what}");
            }
        }
    }
}

/// A bench whose motor turns at so many rpm.
fn turning(settings: Settings, motor: Parameters, rpm: i32) -> Bench {
    let mut bench = Bench::new(settings, motor);
    bench.order(Order::Velocity(rpm));
    bench.run_ms(2_000);
    assert!((bench.rpm() - rpm).abs() <= 10 && bench.alarms == 0);
    bench
}

/// When which alarm comes, in ms, within a time.
fn alarm(bench: &mut Bench, most: u64) -> Option<(u64, u16)> {
    (0..most).find_map(|ms| {
        bench.run_ms(1);
        (bench.alarms != 0).then_some((ms, bench.alarms))
    })
}

#[track_caller]
fn assert_alarm(bench: &mut Bench, from: u64, to: u64, status: u16) {
    let alarm = alarm(bench, 2 * to);
    assert!(alarm.is_some_and(|(ms, bits)| (from..=to).contains(&ms) && bits == status), "{alarm:?}");
}

#[test]
fn a_shaft_that_is_held_is_a_stall() {
    for rpm in [60, 300, -1_000, 3_000] {
        let mut bench = turning(Settings::FACTORY, MOTOR, rpm);
        bench.hold(true);
        assert_alarm(&mut bench, 990, 3_500, status::STALL);
        // All that 20 A may be: 6 of 24 V.
        assert!((bench.servo.output(bench.now).abs() - 256).abs() <= 10, "{}", bench.servo.output(bench.now));
    }
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.hold(true);
    bench.order(Order::Position { count: 10, rpm: 1_000 });
    assert_alarm(&mut bench, 990, 3_500, status::STALL);
}

#[test]
fn a_current_at_max_load_is_an_overload() {
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.hold(true);
    bench.order(Order::Torque(1_023));
    assert_alarm(&mut bench, 3_900, 4_100, status::OVER_LOAD);
    // 2 A are 0.12 Nm, of which 0.01 Nm is friction.
    let settings = Settings { limit_ma: 2_000, ..Settings::FACTORY };
    let mut bench = turning(settings, MOTOR, 1_500);
    bench.load(95_000);
    assert_eq!(alarm(&mut bench, 10_000), None);
    bench.order(Order::Velocity(2_500));
    bench.load(109_000);
    let alarm = alarm(&mut bench, 10_000);
    assert!(alarm.is_some_and(|(_, bits)| bits & status::OVER_LOAD != 0), "{alarm:?}");
}

#[test]
fn a_speed_that_does_not_come_is_a_failure_of_control() {
    // 0.5 A are 0.03 Nm, of which 0.01 Nm is friction: too little for a load of 0.019 Nm on a great wheel.
    let settings = Settings { limit_ma: 500, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, Parameters { inertia_gcm2: 100_000, ..MOTOR });
    bench.order(Order::Velocity(2_000));
    assert_alarm(&mut bench, 2_900, 3_100, status::CTRL_FAIL);
}

#[test]
fn a_reference_of_zero_is_no_failure_of_control() {
    // 0.5 A against a load of 1 A: it turns, and faster and faster.
    let settings = Settings { limit_ma: 500, stop_status: 1, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, Parameters { inertia_gcm2: 100_000, ..MOTOR });
    bench.order(Order::Velocity(0));
    bench.load(-60_000);
    bench.run_ms(3_900);
    assert!(bench.real_rpm() > 10.0 && bench.alarms & status::CTRL_FAIL == 0, "{}", bench.alarms);
}

#[test]
fn swapped_wires_turn_it_against_its_reference() {
    for rpm in [300, -1_000] {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.servo.swap(bench.now, true, &mut Wires(&mut bench.wires));
        bench.order(Order::Velocity(rpm));
        assert_alarm(&mut bench, 500, 700, status::INV_VEL);
        assert!((bench.real_rpm() + f64::from(rpm)).abs() < 10.0 && (bench.rpm() + rpm).abs() <= 10);
        bench.order(Order::Free);
        bench.run_ms(1);
        assert_eq!((bench.servo.current(), bench.servo.output(bench.now)), (0, 0));
    }
    // And while it turns.
    let mut bench = turning(Settings::FACTORY, MOTOR, 1_000);
    bench.servo.swap(bench.now, true, &mut Wires(&mut bench.wires));
    assert_alarm(&mut bench, 500, 900, status::INV_VEL);
}

#[test]
fn a_reversal_or_a_stop_is_no_alarm_however_long_it_takes() {
    for (settings, motor) in motors() {
        // 0.5 A are 0.03 Nm: on 10⁻³ kg·m² 3,000 rpm take 12 s with 0.005 Nm of friction. More friction it cannot move.
        for (limit_ma, slow, seconds) in [(20_000, 0, 6), (20_000, 1_023, 20), (3_000, 100, 6), (500, 0, 40)]
        {
            if motor.friction_unm > 30_000 && limit_ma == 500 {
                continue;
            }
            for target in [-1_500, 0] {
                let settings =
                    Settings { limit_ma, slow_start: slow, slow_down: slow, stop_status: 1, ..settings };
                let mut bench =
                    turning(Settings { poles: settings.poles, ..Settings::FACTORY }, motor, 1_500);
                bench.set(|now| *now = settings);
                bench.order(Order::Velocity(target));
                bench.run_ms(1_000 * seconds);
                // A current at its limit for 4 s is what it is.
                let alarms = bench.alarms & !status::OVER_LOAD;
                assert_eq!(alarms, 0, "{target}, {limit_ma} mA, {motor:?}");
                assert!((bench.real_rpm() - f64::from(target)).abs() < 20.0, "{}", bench.real_rpm());
            }
        }
    }
}

#[test]
fn a_broken_hall_sensor_is_noticed() {
    let mut bench = turning(Settings::FACTORY, MOTOR, 300);
    bench.servo.cut(bench.now, true, false);
    // All three are high once in a period, 1/600 min.
    assert_alarm(&mut bench, 0, 101, status::HALL_FAIL);
    // They are told as broken in every ms while it lasts: 1 is high for half of a period of 10 ms, in a sixth all are.
    while !bench.servo.halls_are_broken() {
        bench.run_ms(1);
    }
    bench.hold(true);
    for _ in 0..100 {
        bench.alarms = 0;
        bench.run_ms(1);
        assert!(bench.servo.halls_are_broken());
    }
    bench.hold(false);
    bench.servo.cut(bench.now, false, false);
    bench.run_ms(10);
    bench.alarms = 0;
    assert_eq!(alarm(&mut bench, 2_000), None);
}

/// A motor with an encoder of so many cycles, and ENC_PPR right.
fn encoded(cycles: u16, stop_status: u16) -> Bench {
    let settings = Settings { enc_ppr: cycles, stop_status, ..Settings::FACTORY };
    Bench::new(settings, Parameters { encoder_cycles: cycles, ..MOTOR })
}

#[test]
fn a_good_encoder_is_no_alarm() {
    for cycles in [1, 2, 16, 500, 2_500] {
        for order in [
            Order::Position { count: 100, rpm: 600 },
            Order::Velocity(10),
            Order::Velocity(-40),
            Order::Velocity(1_000),
        ] {
            let mut bench = encoded(cycles, 1);
            bench.order(order);
            assert_eq!(alarm(&mut bench, 6_000), None, "{order:?}, {cycles} cycles");
            // Held, and pushed a little.
            bench.order(Order::Velocity(0));
            assert_eq!(alarm(&mut bench, 3_000), None, "0 after {order:?}, {cycles} cycles");
            bench.load(-100_000);
            assert_eq!(alarm(&mut bench, 3_000), None, "a load after {order:?}, {cycles} cycles");
        }
    }
}

#[test]
fn a_silent_encoder_is_noticed() {
    let settings = Settings { enc_ppr: 500, ..Settings::FACTORY };
    let mut bench = Bench::new(settings, MOTOR);
    bench.order(Order::Velocity(500));
    assert_alarm(&mut bench, 600, 900, status::HALL_FAIL | status::ENCODER_FAIL);
    assert_eq!(bench.rpm(), 0);

    let mut bench = turning(settings, Parameters { encoder_cycles: 500, ..MOTOR }, 500);
    bench.servo.cut(bench.now, false, true);
    assert_alarm(&mut bench, 590, 700, status::HALL_FAIL | status::ENCODER_FAIL);
}

#[test]
fn nothing_is_wrong_with_a_motor_that_is_left_alone() {
    let mut bench =
        Bench::new(Settings { enc_ppr: 500, ..Settings::FACTORY }, Parameters { load_unm: -50_000, ..MOTOR });
    for order in [Order::Free, Order::Brake] {
        bench.order(order);
        assert_eq!(alarm(&mut bench, 6_000), None);
    }
    assert_eq!(bench.looks, 0);
}

#[test]
fn stop_status_says_what_zero_is() {
    for (stop_status, slow_down) in [(0, 0), (0, 68), (1, 0), (1, 68), (2, 0), (2, 68), (3, 0), (3, 68)] {
        let mut bench = turning(Settings { stop_status, slow_down, ..Settings::FACTORY }, MOTOR, 1_500);
        bench.order(Order::Velocity(0));
        // 68 is 1 s for 3,000 rpm.
        bench.run_ms(100);
        let free = bench.shaft().ma == 0 && bench.shaft().duty == 0;
        let at_once = slow_down == 0 || stop_status == 3;
        assert_eq!(free, at_once && matches!(stop_status, 0 | 3), "{stop_status} {slow_down}");
        if !at_once {
            assert!((bench.real_rpm() - 1_200.0).abs() < 100.0);
        }
        bench.run_ms(600);
        assert_eq!(bench.real_rpm() < 50.0, !matches!((stop_status, slow_down), (0, 0) | (3, _)));
        bench.run_ms(15_000);
        assert_eq!((bench.rpm(), bench.real_rpm()), (0, 0.0), "{stop_status} {slow_down}");
        // What is held pushes back.
        bench.load(-200_000);
        bench.run_ms(2_000);
        let rpm = bench.real_rpm();
        match stop_status {
            1 => assert!(rpm.abs() < 1.0, "{rpm}"),
            // 0.19 Nm are 3.17 A, 0.95 V.
            2 => assert!((rpm - 0.95 / 24.0 * 3_820.0).abs() < 2.0, "{rpm}"),
            _ => assert!(rpm > 3_000.0, "{rpm}"),
        }
    }
}

#[test]
fn an_order_goes_on_from_the_present_speed() {
    let settings = Settings { slow_start: 341, slow_down: 341, ..Settings::FACTORY };
    for before in
        [Order::Free, Order::Open(400), Order::Torque(0), Order::Position { count: 100_000, rpm: 1_000 }]
    {
        let mut bench = Bench::new(Settings::FACTORY, MOTOR);
        bench.order(Order::Velocity(1_000));
        bench.run_ms(2_000);
        bench.order(before);
        bench.run_ms(100);
        bench.set(|now| *now = settings);
        let speed = bench.real_rpm();
        bench.order(Order::Velocity(2_000));
        // 600 rpm a second.
        for ms in 1..200 {
            bench.run_ms(1);
            let ideal = speed + 0.6 * f64::from(ms);
            assert!(
                (bench.real_rpm() - ideal).abs() < 60.0,
                "{} for {ideal} after {before:?}",
                bench.real_rpm()
            );
        }
    }
}

#[test]
fn clearing_the_position_moves_the_target_along() {
    let mut bench = Bench::new(Settings::FACTORY, MOTOR);
    bench.order(Order::Position { count: 100, rpm: 500 });
    bench.run_ms(500);
    let (error, speed) = (bench.servo.error().unwrap(), bench.real_rpm());
    assert!(error > 10);
    bench.servo.clear_position();
    assert_eq!((bench.servo.position(), bench.servo.target(), bench.servo.error()), (0, error, Some(error)));
    bench.run_ms(1);
    assert!((bench.real_rpm() - speed).abs() < 5.0);
    bench.run_ms(3_000);
    assert!(bench.servo.error().unwrap().abs() <= 1);
    assert_eq!(bench.servo.target(), error);
}

#[test]
fn wild_registers_and_orders_do_no_harm() {
    let wild = Settings {
        max_rpm: u16::MAX,
        limit_ma: u32::MAX,
        pv_gain: u16::MAX,
        p_gain: u16::MAX,
        i_gain: u16::MAX,
        slow_start: u16::MAX,
        slow_down: u16::MAX,
        stop_status: u16::MAX,
        poles: u16::MAX,
        enc_ppr: u16::MAX,
    };
    let none = Settings {
        max_rpm: 0,
        limit_ma: 0,
        pv_gain: 0,
        p_gain: 0,
        i_gain: 0,
        slow_start: 0,
        slow_down: 0,
        stop_status: 1,
        poles: 0,
        enc_ppr: 0,
    };
    for settings in
        [wild, none, Settings { enc_ppr: 0, slow_start: 0, ..wild }, Settings { poles: 1, ..wild }]
    {
        let mut bench = Bench::new(Settings::FACTORY, Parameters { encoder_cycles: 100, ..MOTOR });
        bench.set(|now| *now = settings);
        for order in [
            Order::Velocity(i32::MAX),
            Order::Velocity(i32::MIN),
            Order::Open(i16::MIN),
            Order::Torque(i16::MIN),
            Order::Position { count: i32::MIN, rpm: i32::MAX },
            Order::Position { count: i32::MAX, rpm: i32::MIN },
        ] {
            bench.order(order);
            bench.run_ms(200);
            bench.servo.draws(bench.now, i32::MIN);
            bench.run_ms(10);
            bench.servo.draws(bench.now, i32::MAX);
            bench.run_ms(10);
        }
        // It ends as it should, and can still be commanded.
        bench.order(Order::Free);
        bench.run_ms(10);
        assert_eq!((bench.shaft().ma, bench.servo.output(bench.now)), (0, 0));
        bench.set(|now| *now = Settings { stop_status: 2, ..Settings::FACTORY });
        bench.order(Order::Brake);
        bench.run_ms(5_000);
        bench.order(Order::Velocity(300));
        bench.run_ms(3_000);
        assert!((bench.real_rpm() - 300.0).abs() <= 3.0, "{} {settings:?}", bench.real_rpm());
    }
}
