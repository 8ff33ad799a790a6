#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

mod alarms;
mod output;
mod position;
mod sensing;
mod velocity;

use std::format;
use std::vec::Vec;

use super::*;
use crate::device::{Rotation, Shaft};
use crate::mdrobot::alarm::Alarm;
use crate::motor::{self, Command, Motor, Parameters, Plant, Report, Reports};

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

/// A value on the wires between drive and motor.
#[derive(Clone, Copy, Debug)]
enum Wire {
    Duty(i32),
    Current(u32),
    MotorCurrent(i32),
    Motor(Parameters),
    Rotation(Rotation),
    Sensor(Sensor, bool),
}

struct Wires<'a>(&'a mut Vec<(Instant, Wire)>);

impl Context for Wires<'_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let wire = match output {
            Output::Duty { duty, .. } => Wire::Duty(duty),
            Output::CurrentLimit { ma, .. } => Wire::Current(ma),
            _ => return,
        };
        self.0.push((at + Duration::TICK, wire));
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

impl Reports for Wires<'_> {
    fn report(&mut self, at: Instant, report: Report<'_>) {
        let wire = match report {
            Report::MotorCurrent(ma) => Wire::MotorCurrent(ma),
            Report::Motor(parameters) => Wire::Motor(*parameters),
            Report::Rotation(rotation) => Wire::Rotation(rotation),
            Report::Level(motor::Sensor::Hall(hall), high) => Wire::Sensor(Sensor::Hall(hall), high),
            Report::Level(motor::Sensor::EncoderA, high) => Wire::Sensor(Sensor::EncoderA, high),
            Report::Level(motor::Sensor::EncoderB, high) => Wire::Sensor(Sensor::EncoderB, high),
            Report::Level(motor::Sensor::Index, _) => return,
        };
        self.0.push((at + Duration::TICK, wire));
    }
}

/// A servo, its motor, and wires between them with a delay of one tick.
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
        bench.motor.power_on(Instant::ZERO, &mut Wires(&mut bench.wires));
        bench.run_ms(1);
        bench
    }

    fn deliver(&mut self) {
        let wires = core::mem::take(&mut self.wires);
        let mut out = Wires(&mut self.wires);
        for (at, wire) in wires {
            match wire {
                Wire::Duty(duty) => self.motor.command(at, Command::Duty(duty), &mut out),
                Wire::Current(ma) => self.motor.command(at, Command::CurrentLimit(ma), &mut out),
                Wire::MotorCurrent(ma) => {
                    self.most_ma = self.most_ma.max(ma.unsigned_abs());
                    self.servo.report(at, &Input::MotorCurrent { axis: AXIS, ma });
                }
                Wire::Motor(parameters) => {
                    self.servo.report(at, &Input::Motor { axis: AXIS, parameters: &parameters });
                }
                Wire::Rotation(rotation) => self.servo.report(at, &Input::Rotation { axis: AXIS, rotation }),
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
                self.alarms |= Alarm::HallFail as u16;
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
        self.motor.set_blocked(self.now, on, &mut Wires(&mut self.wires));
    }

    fn load(&mut self, load_unm: i32) {
        let parameters = Parameters { load_unm, ..*self.motor.parameters() };
        self.motor.set_parameters(self.now, parameters, &mut Wires(&mut self.wires));
    }

    fn shaft(&self) -> Shaft {
        self.motor.shaft(self.now).unwrap()
    }

    fn real_rpm(&self) -> f64 {
        self.shaft().speed.to_num::<f64>() * 60.0 / (6.0 * f64::from(self.motor.parameters().hall_pulses))
    }

    fn rpm(&self) -> i32 {
        self.servo.rpm(self.now)
    }
}

/// The motors for which the tolerances of the tests hold: several poles, inertias and frictions.
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

/// The real speed `ms` after an order.
fn rpm_after(settings: Settings, motor: Parameters, order: Order, ms: u64) -> f64 {
    let mut bench = Bench::new(settings, motor);
    bench.order(order);
    bench.run_ms(ms);
    bench.real_rpm()
}

/// A bench with a motor that turns at `rpm`.
fn turning(settings: Settings, motor: Parameters, rpm: i32) -> Bench {
    let mut bench = Bench::new(settings, motor);
    bench.order(Order::Velocity(rpm));
    bench.run_ms(2_000);
    assert!((bench.rpm() - rpm).abs() <= 10 && bench.alarms == 0);
    bench
}
