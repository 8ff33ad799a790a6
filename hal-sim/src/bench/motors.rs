//! Motors of their own.
//!
//! A motor hears what its drive does a tick later, and what it does arrives a tick later: at its drive the edges of
//! Hall sensors and the current that it draws, elsewhere what the [sensors](super::shaft_sensors) on its shaft show
//! (BENCH-6).

use std::collections::VecDeque;

use drivetwin_firmware::device::{
    Axis, Boot, Context, Duration, Fault, Input, Instant, Level, Output, Pin, Rotation, Shaft,
};
use drivetwin_firmware::motor::{self, HALL_PINS, Kinematics, Rotor, STALL, stepper};
use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::events::EventKind;
use super::shaft_sensors::{Sensor, SensorKind};
use super::{Bench, DriveId};
use crate::record::trace::{self, InputRecord};
use crate::scheduler::Phase;
use crate::slot::{MotorCommand, Wakes};

/// A motor on the bench.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Motor(u32);

/// Model of a motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotorModel {
    /// A stepper motor, which follows the plans and steps of its drive.
    Stepper(stepper::StepperParameters),
    /// A motor with brushes, or a brushless one, turned by the duty of a drive that was added
    /// [`apart`](super::Setup::apart), or that may turn a stepper motor or this
    /// ([`dc_motor`](drivetwin_firmware::device::Spec::dc_motor)).
    Brush(motor::Parameters),
}

/// State of a shaft.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct ShaftState {
    /// Turns from where it began.
    pub revolutions: f64,
    /// Turns per minute, signed.
    pub rpm: f64,
    /// True if it cannot follow its drive.
    pub stalled: bool,
    /// Current in mA; of a stepper motor the peak current that its drive gives it.
    pub ma: i32,
}

/// Places from here on are those of motors, not of seats.
const MOTORS: u32 = 1 << 31;

/// Which motor has that place; `None` for a seat's.
pub(super) fn at_place(place: u32) -> Option<usize> {
    place.checked_sub(MOTORS).map(|motor| motor as usize)
}

/// Units of an angle in a turn.
pub(super) const TURN: f64 = (1_u64 << 32) as f64;

/// A motor that is fitted to a drive.
pub(super) struct MotorSlot {
    name: String,
    drive: (DriveId, Axis),
    machine: Machine,
    /// Present motion.
    pace: Kinematics,
    /// Angle at which the shaft began.
    began: i64,
    /// Microsteps that its drive reported last.
    microsteps: u16,
    /// Commands on their way to it, by time.
    inbox: VecDeque<(Instant, MotorCommand)>,
    /// The ends of the wires of its Hall sensors.
    halls: Vec<u32>,
    felt: MotorReports,
    sensors: Vec<Sensor>,
    wakes: Wakes,
    /// Tells what is due next from what was foreseen earlier.
    number: u32,
}

enum Machine {
    Stepper(Box<stepper::StepperMotor>),
    Brush(Box<motor::Motor>),
}

impl Machine {
    fn rotor(&self) -> &dyn Rotor {
        match self {
            Self::Stepper(stepper) => &**stepper,
            Self::Brush(motor) => &**motor,
        }
    }

    fn rotor_mut(&mut self) -> &mut dyn Rotor {
        match self {
            Self::Stepper(stepper) => &mut **stepper,
            Self::Brush(motor) => &mut **motor,
        }
    }

    fn hear(&mut self, at: Instant, told: &MotorCommand, out: &mut MotorReports) {
        const AXIS: Axis = Axis(0);
        let plan;
        let input = match *told {
            MotorCommand::Plan(told) => {
                // What is heard a tick later is also done a tick later.
                plan = told.delayed(Duration::TICK);
                Input::Plan { axis: AXIS, plan: &plan }
            }
            MotorCommand::Microsteps(microsteps) => {
                if let Self::Stepper(stepper) = self {
                    stepper.set_microsteps(at, microsteps);
                }
                return;
            }
            MotorCommand::Steps(steps) => Input::Step { axis: AXIS, steps },
            MotorCommand::Current(ma) => Input::CurrentLimit { axis: AXIS, ma },
            MotorCommand::Duty(duty) => Input::Duty { axis: AXIS, duty },
            MotorCommand::Held(on) => Input::Fault { fault: STALL, on },
        };
        self.rotor_mut().input(at, input, out);
    }
}

/// Reports of a motor at an instant, on their way to its drive.
#[derive(Default)]
struct MotorReports {
    halls: [Option<Level>; HALL_PINS.len()],
    draws: Option<i32>,
    motor: Option<Box<motor::Parameters>>,
    rotation: Option<Rotation>,
    /// True if its arrival is scheduled.
    foreseen: bool,
}

impl MotorReports {
    fn is_news(&self) -> bool {
        self.draws.is_some()
            || self.motor.is_some()
            || self.rotation.is_some()
            || self.halls.iter().any(Option::is_some)
    }
}

impl Context for MotorReports {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        match output {
            Output::Level { pin, level } => {
                if let Some(hall) = HALL_PINS.iter().position(|hall| *hall == pin) {
                    self.halls[hall] = Some(level);
                }
            }
            Output::MotorCurrent { ma, .. } => self.draws = Some(ma),
            Output::Motor { parameters, .. } => self.motor = Some(Box::new(*parameters)),
            Output::Rotation { rotation, .. } => self.rotation = Some(rotation),
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// Motors.
impl Bench {
    /// Has an axis turn a motor from now on. A drive has one motor an axis. It hears what the drive does at
    /// present, and its shaft stands until then.
    ///
    /// # Errors
    /// One sentence: why not.
    pub fn attach_motor(
        &mut self,
        name: &str,
        drive: DriveId,
        axis: Axis,
        is: MotorModel,
    ) -> Result<Motor, String> {
        let of = self.name(drive).to_owned();
        if !trace::is_name(name) {
            return Err(format!("\"{name}\" is no name for a motor: use one word without dots"));
        }
        if self.is_taken(name) {
            return Err(format!("there are two things called {name}"));
        }
        if self.spec(drive).axes.get(usize::from(axis.0)).is_none() {
            return Err(format!("{of} has no axis {}, so it cannot turn {name}", axis.0));
        }
        if self.at(drive).motors.iter().any(|&(other, _)| other == axis) {
            return Err(format!("{of} turns a motor already, so it cannot turn {name}"));
        }
        let halls = self.at(drive).halls;
        let either = self.spec(drive).dc_motor.is_some();
        let machine = match (is, halls) {
            (MotorModel::Stepper(is), None) => Machine::Stepper(Box::new(stepper::StepperMotor::new(is))),
            (MotorModel::Brush(is), None) if either => Machine::Brush(Box::new(motor::Motor::new(is))),
            (MotorModel::Brush(is), Some(_)) => Machine::Brush(Box::new(motor::Motor::new(is))),
            (MotorModel::Stepper(_), Some(_)) => {
                return Err(format!("{of} turns a brush motor, and {name} is a stepper motor"));
            }
            (MotorModel::Brush(_), None) => {
                return Err(format!("{of} does not turn brush motors of a bench, and {name} is one"));
            }
        };
        if let (MotorModel::Brush(is), Some(halls)) = (is, halls)
            && usize::from(is.hall_sensors) != halls.len()
        {
            let (has, wants) = (is.hall_sensors, halls.len());
            return Err(format!("{of} turns a motor with {wants} Hall sensors, and {name} has {has}"));
        }
        let place = u32::try_from(self.motors.len()).expect("a bench has room for two billion motors");
        let halls = halls.unwrap_or_default().iter().map(|&pin| self.end_of_wire((drive, pin))).collect();
        let mut motor = MotorSlot {
            name: name.to_owned(),
            drive: (drive, axis),
            began: 0,
            pace: machine.rotor().kinematics(),
            machine,
            microsteps: 1,
            inbox: VecDeque::new(),
            halls,
            felt: MotorReports::default(),
            sensors: Vec::new(),
            wakes: Wakes::default(),
            number: 0,
        };
        let now = self.now;
        let rotor = motor.machine.rotor_mut();
        rotor.power_on(now, Boot::default(), &mut motor.felt);
        (motor.began, motor.pace) = (rotor.angle_at(now), rotor.kinematics());
        let arrives = now + Duration::TICK;
        motor.microsteps = self.at(drive).microsteps(axis);
        let mut told = self.at_mut(drive).turns(axis, place);
        told.extend(self.is_held(drive).then_some(MotorCommand::Held(true)));
        motor.inbox.extend(told.into_iter().map(|told| (arrives, told)));
        self.names.insert(motor.name.clone(), None);
        self.motors.push(motor);
        self.indexed = false;
        self.carry_felt(place as usize);
        self.foresee_motor(place as usize);
        Ok(Motor(place))
    }

    /// The motor that a drive has parted from when it was seated [`apart`](super::Setup::apart): as its registers
    /// described it when it had been powered on for the first time, with its memory and its presets (BENCH-5).
    #[must_use]
    pub fn detached_motor(&self, drive: DriveId) -> Option<motor::Parameters> {
        self.at(drive).parted
    }

    /// Puts a sensor beside a motor's shaft, whose first wire goes `to` that pin. A drive that was seated at this
    /// instant finds its first level at power-on, and no edge.
    pub(super) fn put_sensor(&mut self, motor: Motor, to: (DriveId, Pin), sees: SensorKind) {
        let (now, key) = (self.now, (self.name(to.0).to_owned(), to.1));
        let MotorSlot { machine, pace, sensors, began, .. } = &mut self.motors[motor.0 as usize];
        let mut sensor = Sensor::new(key, sees, *began);
        sensor.foresee(machine.rotor(), pace, now);
        let shown = sensor.seen();
        sensor.foresee(machine.rotor(), pace, now);
        let place = sensors.partition_point(|other| other.key <= sensor.key);
        sensors.insert(place, sensor);
        for (wire, level) in shown.into_iter().flatten() {
            self.stands(wire, level);
        }
        self.foresee_motor(motor.0 as usize);
    }

    /// All motors, in the order in which they were fitted.
    pub fn motors(&self) -> impl ExactSizeIterator<Item = Motor> + use<> {
        (0..self.motors.len() as u32).map(Motor)
    }

    /// The name of a motor.
    #[must_use]
    pub fn motor_name(&self, motor: Motor) -> &str {
        &self.motors[motor.0 as usize].name
    }

    /// The drive and axis that turn a motor.
    #[must_use]
    pub fn turned_by(&self, motor: Motor) -> (DriveId, Axis) {
        self.motors[motor.0 as usize].drive
    }

    /// State of a motor's shaft now.
    #[must_use]
    pub fn turn(&self, motor: Motor) -> ShaftState {
        let MotorSlot {
            machine,
            pace: Kinematics { since, half_speed, half_acceleration, turn, .. },
            began,
            ..
        } = &self.motors[motor.0 as usize];
        let rotor = machine.rotor();
        let speed =
            2.0 * (*half_speed as f64 + *half_acceleration as f64 * self.now.since(*since).ticks() as f64);
        ShaftState {
            revolutions: rotor.angle_at(self.now).wrapping_sub(*began) as f64 / TURN,
            rpm: speed / *turn as f64 * (60 * TICKS_PER_SECOND) as f64,
            stalled: rotor.stalled(),
            ma: rotor.draws_ma(),
        }
    }

    /// State of the brush motor on an axis, if the bench has one there and the drive looks at its Hall sensors: that
    /// is where the shaft is for such a drive.
    pub(super) fn shaft(&self, seat: DriveId, axis: Axis) -> Option<Shaft> {
        self.at(seat).halls?;
        let &(_, motor) = self.at(seat).motors.iter().find(|(of, _)| *of == axis)?;
        self.motors[motor as usize].machine.rotor().shaft(self.now, axis)
    }

    /// The ranks of motors come after those of all seats, by name.
    pub(super) fn rank_motors(&mut self) {
        let mut order: Vec<usize> = (0..self.motors.len()).collect();
        order.sort_by(|&a, &b| self.motors[a].name.cmp(&self.motors[b].name));
        self.motor_ranks = vec![0; order.len()];
        for (rank, place) in (self.seats.len() as u32..).zip(order) {
            self.motor_ranks[place] = rank;
        }
    }

    /// After a device was called: its motors will hear what it did.
    pub(super) fn tell_motors(&mut self, place: u32) {
        for n in 0.. {
            let seated = &self.seats[place as usize];
            let Some(&(axis, motor)) = seated.motors.get(n) else { break };
            let fitted = &mut self.motors[motor as usize];
            let heard = fitted.inbox.len();
            let microsteps = seated.microsteps(axis);
            if fitted.microsteps != microsteps {
                fitted.microsteps = microsteps;
                fitted.inbox.push_back((self.now + Duration::TICK, MotorCommand::Microsteps(microsteps)));
            }
            for (_, _, at, told) in self.outbox.told.iter().filter(|told| (told.0, told.1) == (place, axis)) {
                fitted.inbox.push_back((*at + Duration::TICK, told.clone()));
            }
            if fitted.inbox.len() > heard {
                self.foresee_motor(motor as usize);
            }
        }
        self.outbox.told.clear();
    }

    /// Returns whether the shaft of a drive's motor is blocked, by the fault of that name.
    fn is_held(&self, drive: DriveId) -> bool {
        let stall = self.spec(drive).faults.iter().position(|fault| *fault == "stall");
        stall.is_some_and(|stall| self.faulty(drive, Fault(stall as u8)))
    }

    /// The cause of a fault comes or goes: if it is a held shaft, then at once.
    pub(super) fn hold(&mut self, place: u32, fault: Fault, on: bool) {
        let seated = &self.seats[place as usize];
        if seated.motors.is_empty() || seated.spec.faults.get(usize::from(fault.0)) != Some(&"stall") {
            return;
        }
        for n in 0.. {
            let Some(&(_, motor)) = self.seats[place as usize].motors.get(n) else { break };
            // Before what the drive did a tick ago, and so is this instant.
            self.motors[motor as usize].inbox.push_front((self.now, MotorCommand::Held(on)));
            self.foresee_motor(motor as usize);
        }
    }

    /// Foresees what is due at a motor next: something that it hears, something that its sensors saw a tick ago,
    /// or its own deadline.
    fn foresee_motor(&mut self, motor: usize) {
        let fitted = &mut self.motors[motor];
        fitted.number = fitted.number.wrapping_add(1);
        let number = fitted.number;
        let told = fitted.inbox.front().map_or(Instant::NEVER, |(at, _)| *at);
        let seen = fitted.sensors.iter().map(Sensor::next).min().unwrap_or(Instant::NEVER);
        let outside = told.min(seen + Duration::TICK);
        let due = fitted.machine.rotor().deadline();
        let (at, class) = if outside <= due { (outside, Phase::Pin) } else { (due, Phase::Deadline) };
        if at < Instant::NEVER {
            let rank = self.motor_ranks.get(motor).copied().unwrap_or(0);
            self.under_way.push(at, class, rank, MOTORS + motor as u32, EventKind::Motor { number });
        }
    }

    /// Handles a prediction of a motor that is due.
    pub(super) fn motor_is_due(&mut self, place: u32, number: u32, class: Phase) {
        let Some(motor) = at_place(place).filter(|&motor| self.motors[motor].number == number) else {
            return;
        };
        let now = self.now;
        self.see(motor);
        let MotorSlot { name, machine, pace, inbox, felt, sensors, wakes, .. } = &mut self.motors[motor];
        let mut looks = false;
        while inbox.front().is_some_and(|(at, _)| *at <= now)
            && let Some((_, told)) = inbox.pop_front()
        {
            machine.hear(now, &told, felt);
            looks = true;
        }
        if class == Phase::Deadline {
            machine.rotor_mut().timeout(now, felt);
            wakes.count(name, now, machine.rotor().deadline());
            looks = true;
        }
        let rotor = machine.rotor();
        if looks && rotor.kinematics() != *pace {
            *pace = rotor.kinematics();
            for sensor in sensors {
                sensor.foresee(rotor, pace, now);
            }
        }
        self.carry_felt(motor);
        self.foresee_motor(motor);
    }

    /// Reports of the motors of a drive that gets power: parameters, rotation, current.
    pub(super) fn motors_report(&self, place: u32) -> Vec<InputRecord> {
        let of = |&(axis, motor): &(Axis, u32)| {
            let Machine::Brush(motor) = &self.motors[motor as usize].machine else { return None };
            let rotation = motor.rotation_at(self.now);
            let parameters = Box::new(*motor.parameters());
            let draws = InputRecord::MotorCurrent { axis, ma: motor.draws_ma() };
            Some([InputRecord::Motor { axis, parameters }, InputRecord::Rotation { axis, rotation }, draws])
        };
        let seated = &self.seats[place as usize];
        // Other drives do not look at what they turn.
        if seated.halls.is_none() {
            return Vec::new();
        }
        seated.motors.iter().filter_map(of).flatten().collect()
    }

    /// Lets the sensors of a motor see its shaft as it was a tick ago.
    fn see(&mut self, motor: usize) {
        for n in 0.. {
            let MotorSlot { machine, pace, sensors, .. } = &mut self.motors[motor];
            let Some(sensor) = sensors.get_mut(n) else { break };
            if sensor.next() >= self.now {
                continue;
            }
            let news = sensor.seen();
            sensor.foresee(machine.rotor(), pace, self.now);
            for (wire, level) in news.into_iter().flatten() {
                self.wired(wire, level);
            }
        }
    }

    /// Sends reports of a motor on their way to its drive.
    fn carry_felt(&mut self, motor: usize) {
        let MotorSlot { felt, drive: (drive, _), .. } = &mut self.motors[motor];
        if self.seats[drive.0 as usize].halls.is_none() {
            // Its drive is told nothing of it.
            *felt = MotorReports::default();
            return;
        }
        if felt.is_news() && !felt.foreseen {
            felt.foreseen = true;
            let drive = drive.0;
            let what = EventKind::MotorReports { motor: motor as u32 };
            self.schedule(self.now + Duration::TICK, Phase::Pin, drive, what);
        }
    }

    /// Delivers reports of a motor to its drive.
    pub(super) fn felt(&mut self, motor: u32) {
        let MotorSlot { felt, drive: (drive, axis), .. } = &mut self.motors[motor as usize];
        let (felt, drive, axis) = (std::mem::take(felt), *drive, *axis);
        let MotorReports { halls, draws, motor: parameters, rotation, .. } = felt;
        if let Some(parameters) = parameters {
            self.deliver(drive.0, &InputRecord::Motor { axis, parameters });
        }
        if let Some(rotation) = rotation {
            self.deliver(drive.0, &InputRecord::Rotation { axis, rotation });
        }
        for (n, level) in halls.into_iter().enumerate() {
            if let (Some(&wire), Some(level)) = (self.motors[motor as usize].halls.get(n), level) {
                self.wired(wire, level);
            }
        }
        if let Some(ma) = draws {
            self.deliver(drive.0, &InputRecord::MotorCurrent { axis, ma });
        }
    }
}
