//! Motors outside of drives.
//!
//! A motor receives the commands of its drive one tick later. Its reactions also arrive one tick later: edges
//! of Hall sensors and the motor current at its drive, and levels of the [sensors](super::shaft_sensors) on
//! its shaft at other pins (BENCH-6).

use std::collections::VecDeque;

use drivetwin_firmware::device::{Axis, Duration, Fault, Instant, Level, Pin, Rotation, Shaft};
use drivetwin_firmware::motor::{self, Command, HALLS, Kinematics, Plant, Report, Reports, stepper};
use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::events::EventKind;
use super::shaft_sensors::{Sensor, SensorKind};
use super::{Bench, DriveId};
use crate::record::trace::{self, InputRecord};
use crate::scheduler::Phase;
use crate::slot::{MotorCommand, Wakes};

/// Handle of a motor, returned by [`Bench::attach_motor`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Motor(u32);

/// Model of a motor for [`Bench::attach_motor`]: its kind and parameters.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotorModel {
    /// A stepper motor, which follows the motion plans and steps of its drive.
    Stepper(stepper::StepperParameters),
    /// A brush or brushless motor. It turns by the duty of a drive that was added with
    /// [`external_motor`](super::Setup::external_motor), or of a drive that can turn stepper and brush motors
    /// ([`dc_motor`](drivetwin_firmware::device::Spec::dc_motor)).
    Brush(motor::Parameters),
}

/// State of a motor's shaft at an instant, returned by [`Bench::turn`].
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct ShaftState {
    /// Revolutions since the motor was attached, signed.
    pub revolutions: f64,
    /// Speed in revolutions per minute, signed.
    pub rpm: f64,
    /// True if the shaft cannot follow the commands of its drive.
    pub stalled: bool,
    /// Current in mA; for a stepper motor the peak phase current that its drive sets.
    pub ma: i32,
}

/// First event target that is a motor; smaller indices are drives.
const MOTORS: u32 = 1 << 31;

/// The motor of an event target; `None` if the target is a drive.
pub(super) fn motor_at(index: u32) -> Option<usize> {
    index.checked_sub(MOTORS).map(|motor| motor as usize)
}

/// Units of angle per turn.
pub(super) const TURN: f64 = (1_u64 << 32) as f64;

/// A motor that is attached to a drive.
pub(super) struct MotorSlot {
    name: String,
    drive: (DriveId, Axis),
    plant: Box<dyn Plant>,
    /// Present motion.
    kinematics: Kinematics,
    /// Angle of the shaft when the motor was attached.
    began: i64,
    /// Microsteps per full step that the drive last reported.
    microsteps: u16,
    /// Commands that have not reached the motor yet, with their times of arrival.
    inbox: VecDeque<(Instant, MotorCommand)>,
    /// Wires from its Hall sensors.
    pub(super) halls: Vec<u32>,
    reports: MotorReports,
    pub(super) sensors: Vec<Sensor>,
    wakes: Wakes,
    /// Number of the next event; events with earlier numbers are outdated.
    number: u32,
}

fn apply(plant: &mut dyn Plant, at: Instant, command: &MotorCommand, out: &mut MotorReports) {
    let command = match command {
        // A command that arrives one tick late is also executed one tick late.
        MotorCommand::Plan(at_drive) => {
            return plant.command(at, Command::Plan(&at_drive.delayed(Duration::TICK)), out);
        }
        MotorCommand::Blocked(blocked) => return plant.set_blocked(at, *blocked, out),
        MotorCommand::Microsteps(microsteps) => Command::Microsteps(*microsteps),
        MotorCommand::Steps(steps) => Command::Step(*steps),
        MotorCommand::Current(ma) => Command::CurrentLimit(*ma),
        MotorCommand::Duty(duty) => Command::Duty(*duty),
    };
    plant.command(at, command, out);
}

/// Reports of a motor that its drive has not received yet.
#[derive(Default)]
struct MotorReports {
    halls: [Option<Level>; HALLS],
    draws: Option<i32>,
    motor: Option<Box<motor::Parameters>>,
    rotation: Option<Rotation>,
    /// True if their delivery is scheduled.
    is_scheduled: bool,
}

impl MotorReports {
    fn is_news(&self) -> bool {
        self.draws.is_some()
            || self.motor.is_some()
            || self.rotation.is_some()
            || self.halls.iter().any(Option::is_some)
    }
}

impl Reports for MotorReports {
    fn report(&mut self, _at: Instant, report: Report<'_>) {
        match report {
            Report::Level(motor::Sensor::Hall(hall), high) => {
                self.halls[usize::from(hall)] = Some(if high { Level::High } else { Level::Low });
            }
            Report::Level(..) => {}
            Report::MotorCurrent(ma) => self.draws = Some(ma),
            Report::Motor(parameters) => self.motor = Some(Box::new(*parameters)),
            Report::Rotation(rotation) => self.rotation = Some(rotation),
        }
    }
}

/// The reports of a motor as inputs of its drive.
struct Inputs<'a> {
    axis: Axis,
    inputs: &'a mut Vec<InputRecord>,
}

impl Reports for Inputs<'_> {
    fn report(&mut self, _at: Instant, report: Report<'_>) {
        let axis = self.axis;
        self.inputs.push(match report {
            Report::Level(..) => return,
            Report::MotorCurrent(ma) => InputRecord::MotorCurrent { axis, ma },
            Report::Motor(parameters) => InputRecord::Motor { axis, parameters: Box::new(*parameters) },
            Report::Rotation(rotation) => InputRecord::Rotation { axis, rotation },
        });
    }
}

/// Motors.
impl Bench {
    /// Attaches a motor to an axis of a drive, from now on. An axis has at most one motor. The shaft is at
    /// rest until the motor receives the present commands of the drive.
    ///
    /// # Errors
    /// One sentence with the reason: the name is not valid or taken, there is no such axis, the axis has a
    /// motor already, or the drive does not turn that kind of motor.
    pub fn attach_motor(
        &mut self,
        name: &str,
        drive: DriveId,
        axis: Axis,
        is: MotorModel,
    ) -> Result<Motor, String> {
        let of = self.name(drive).to_owned();
        if !trace::is_name(name) {
            return Err(format!("\"{name}\" is not a valid name for a motor: use one word without dots"));
        }
        if self.is_taken(name) {
            return Err(format!("the name {name} is in use already"));
        }
        if self.spec(drive).axes.get(usize::from(axis.0)).is_none() {
            return Err(format!("{of} has no axis {}, so it cannot turn {name}", axis.0));
        }
        if self.at(drive).motors.iter().any(|&(other, _)| other == axis) {
            return Err(format!("{of} turns a motor already, so it cannot turn {name}"));
        }
        let halls = self.at(drive).halls;
        let either = self.spec(drive).dc_motor.is_some();
        let plant: Box<dyn Plant> = match (is, halls) {
            (MotorModel::Stepper(is), None) => Box::new(stepper::StepperMotor::new(is)),
            (MotorModel::Brush(is), None) if either => Box::new(motor::Motor::new(is)),
            (MotorModel::Brush(is), Some(_)) => Box::new(motor::Motor::new(is)),
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
        let index = u32::try_from(self.motors.len()).expect("a bench has room for two billion motors");
        let halls = halls.unwrap_or_default().iter().map(|&pin| self.end_of_wire((drive, pin))).collect();
        let mut motor = MotorSlot {
            name: name.to_owned(),
            drive: (drive, axis),
            began: 0,
            kinematics: plant.kinematics(),
            plant,
            microsteps: 1,
            inbox: VecDeque::new(),
            halls,
            reports: MotorReports::default(),
            sensors: Vec::new(),
            wakes: Wakes::default(),
            number: 0,
        };
        let now = self.now;
        motor.plant.power_on(now, &mut motor.reports);
        (motor.began, motor.kinematics) = (motor.plant.angle_at(now), motor.plant.kinematics());
        let arrives = now + Duration::TICK;
        motor.microsteps = self.at(drive).microsteps(axis);
        let mut commands = self.at_mut(drive).turns(axis, index);
        commands.extend(self.is_shaft_blocked(drive).then_some(MotorCommand::Blocked(true)));
        motor.inbox.extend(commands.into_iter().map(|command| (arrives, command)));
        self.names.insert(motor.name.clone(), None);
        self.motors.push(motor);
        self.indexed = false;
        self.record_motors(drive.0);
        self.schedule_motor_reports(index as usize);
        self.schedule_motor(index as usize);
        Ok(Motor(index))
    }

    /// Parameters of the internal motor of a drive that was added with
    /// [`external_motor`](super::Setup::external_motor): those in the drive's registers after the first
    /// power-on, with its memory and presets. `None` for any other drive (BENCH-5).
    #[must_use]
    pub fn detached_motor(&self, drive: DriveId) -> Option<motor::Parameters> {
        self.at(drive).detached_motor
    }

    /// Adds a sensor to a motor's shaft; its first wire goes to the pin `to`. A drive that was added at this
    /// instant receives the first level as its initial level, without an edge.
    pub(super) fn add_sensor(&mut self, motor: Motor, to: (DriveId, Pin), kind: SensorKind) {
        let (now, key) = (self.now, (self.name(to.0).to_owned(), to.1));
        let MotorSlot { plant, kinematics, sensors, began, .. } = &mut self.motors[motor.0 as usize];
        let mut sensor = Sensor::new(key, kind, *began);
        sensor.predict(&**plant, kinematics, now);
        let shown = sensor.take_change();
        sensor.predict(&**plant, kinematics, now);
        let index = sensors.partition_point(|other| other.key <= sensor.key);
        sensors.insert(index, sensor);
        for (wire, level) in shown.into_iter().flatten() {
            self.set_initial_level(wire, level);
        }
        self.schedule_motor(motor.0 as usize);
    }

    /// All motors, in the order in which they were attached.
    pub fn motors(&self) -> impl ExactSizeIterator<Item = Motor> + use<> {
        (0..self.motors.len() as u32).map(Motor)
    }

    /// The name of a motor.
    #[must_use]
    pub fn motor_name(&self, motor: Motor) -> &str {
        &self.motors[motor.0 as usize].name
    }

    /// Drive and axis to which a motor is attached.
    #[must_use]
    pub fn turned_by(&self, motor: Motor) -> (DriveId, Axis) {
        self.motors[motor.0 as usize].drive
    }

    /// Present position, speed and current of a motor's shaft.
    #[must_use]
    pub fn turn(&self, motor: Motor) -> ShaftState {
        let MotorSlot {
            plant,
            kinematics: Kinematics { since, half_speed, half_acceleration, turn, .. },
            began,
            ..
        } = &self.motors[motor.0 as usize];
        let speed =
            2.0 * (*half_speed as f64 + *half_acceleration as f64 * self.now.since(*since).ticks() as f64);
        ShaftState {
            revolutions: plant.angle_at(self.now).wrapping_sub(*began) as f64 / TURN,
            rpm: speed / *turn as f64 * (60 * TICKS_PER_SECOND) as f64,
            stalled: plant.stalled(),
            ma: plant.draws_ma(),
        }
    }

    /// State of the brush motor on an axis, if the drive reads its Hall sensors. For such a drive, the motor
    /// determines the position of the axis.
    pub(super) fn shaft(&self, drive: DriveId, axis: Axis) -> Option<Shaft> {
        self.at(drive).halls?;
        let &(_, motor) = self.at(drive).motors.iter().find(|(of, _)| *of == axis)?;
        self.motors[motor as usize].plant.shaft(self.now)
    }

    /// Ranks the motors by name, after all drives.
    pub(super) fn rank_motors(&mut self) {
        let mut order: Vec<usize> = (0..self.motors.len()).collect();
        order.sort_by(|&a, &b| self.motors[a].name.cmp(&self.motors[b].name));
        self.motor_ranks = vec![0; order.len()];
        for (rank, index) in (self.slots.len() as u32..).zip(order) {
            self.motor_ranks[index] = rank;
        }
    }

    /// Schedules the commands of a drive for its motors, after a call of the drive.
    pub(super) fn schedule_motor_commands(&mut self, index: u32) {
        for n in 0.. {
            let slot = &self.slots[index as usize];
            let Some(&(axis, motor)) = slot.motors.get(n) else { break };
            let microsteps = slot.microsteps(axis);
            let driven = &mut self.motors[motor as usize];
            let waiting = driven.inbox.len();
            if driven.microsteps != microsteps {
                driven.microsteps = microsteps;
                driven.inbox.push_back((self.now + Duration::TICK, MotorCommand::Microsteps(microsteps)));
            }
            for (_, _, at, command) in
                self.outputs.motor_commands.iter().filter(|entry| (entry.0, entry.1) == (index, axis))
            {
                driven.inbox.push_back((*at + Duration::TICK, command.clone()));
            }
            if driven.inbox.len() > waiting {
                self.schedule_motor(motor as usize);
            }
        }
        self.outputs.motor_commands.clear();
    }

    /// Returns true if the fault `stall` blocks the shafts of a drive's motors.
    fn is_shaft_blocked(&self, drive: DriveId) -> bool {
        let stall = self.spec(drive).faults.iter().position(|fault| *fault == "stall");
        stall.is_some_and(|stall| self.faulty(drive, Fault(stall as u8)))
    }

    /// Blocks or releases the shafts of a drive's motors at once, if the fault is `stall`.
    pub(super) fn set_shaft_blocked(&mut self, index: u32, fault: Fault, on: bool) {
        let slot = &self.slots[index as usize];
        if slot.motors.is_empty() || slot.spec.faults.get(usize::from(fault.0)) != Some(&"stall") {
            return;
        }
        for n in 0.. {
            let Some(&(_, motor)) = self.slots[index as usize].motors.get(n) else { break };
            // The drive's commands of one tick ago arrive at this instant, too. The command here takes effect
            // before them.
            self.motors[motor as usize].inbox.push_front((self.now, MotorCommand::Blocked(on)));
            self.schedule_motor(motor as usize);
        }
    }

    /// Schedules the next event of a motor: a command, the arrival of a change of a sensor one tick after the
    /// change, or the motor's own deadline.
    fn schedule_motor(&mut self, motor: usize) {
        let slot = &mut self.motors[motor];
        slot.number = slot.number.wrapping_add(1);
        let number = slot.number;
        let command = slot.inbox.front().map_or(Instant::NEVER, |(at, _)| *at);
        let seen = slot.sensors.iter().map(Sensor::next).min().unwrap_or(Instant::NEVER);
        let input_due = command.min(seen + Duration::TICK);
        let due = slot.plant.deadline();
        let (at, phase) = if input_due <= due { (input_due, Phase::Pin) } else { (due, Phase::Deadline) };
        if at < Instant::NEVER {
            let rank = self.motor_ranks.get(motor).copied().unwrap_or(0);
            self.scheduled.push(at, phase, rank, MOTORS + motor as u32, EventKind::Motor { number });
        }
    }

    /// Handles the next event of a motor.
    pub(super) fn motor_is_due(&mut self, index: u32, number: u32, phase: Phase) {
        let Some(motor) = motor_at(index).filter(|&motor| self.motors[motor].number == number) else {
            return;
        };
        let now = self.now;
        self.update_sensors(motor);
        let MotorSlot { name, plant, kinematics, inbox, reports, sensors, wakes, .. } =
            &mut self.motors[motor];
        let mut changed = false;
        while inbox.front().is_some_and(|(at, _)| *at <= now)
            && let Some((_, command)) = inbox.pop_front()
        {
            apply(&mut **plant, now, &command, reports);
            changed = true;
        }
        if phase == Phase::Deadline {
            plant.timeout(now, reports);
            wakes.count(name, now, plant.deadline());
            changed = true;
        }
        if changed && plant.kinematics() != *kinematics {
            *kinematics = plant.kinematics();
            for sensor in sensors {
                sensor.predict(&**plant, kinematics, now);
            }
        }
        let (drive, _) = self.motors[motor].drive;
        self.record_motors(drive.0);
        self.schedule_motor_reports(motor);
        self.schedule_motor(motor);
    }

    /// Records the motion of the brush motors of a drive, if the settings say so.
    pub(super) fn record_motors(&mut self, index: u32) {
        if !self.settings.shafts {
            return;
        }
        for n in 0.. {
            let Some(&(axis, _)) = self.slots[index as usize].motors.get(n) else { break };
            if let Some(shaft) = self.shaft(DriveId(index), axis) {
                self.slots[index as usize].record_shaft(self.now, axis, shaft, &mut self.trace);
            }
        }
    }

    /// Reports from the motors of a drive at its power-on: parameters, rotation, current.
    pub(super) fn motors_report(&self, index: u32) -> Vec<InputRecord> {
        let slot = &self.slots[index as usize];
        // A drive without Hall sensor inputs gets no feedback from its motors.
        if slot.halls.is_none() {
            return Vec::new();
        }
        let mut inputs = Vec::new();
        for &(axis, motor) in &slot.motors {
            self.motors[motor as usize]
                .plant
                .repeat_reports(self.now, &mut Inputs { axis, inputs: &mut inputs });
        }
        inputs
    }

    /// Updates the sensors of a motor to the position that its shaft had one tick ago.
    fn update_sensors(&mut self, motor: usize) {
        for n in 0.. {
            let MotorSlot { plant, kinematics, sensors, .. } = &mut self.motors[motor];
            let Some(sensor) = sensors.get_mut(n) else { break };
            if sensor.next() >= self.now {
                continue;
            }
            let changes = sensor.take_change();
            sensor.predict(&**plant, kinematics, self.now);
            for (wire, level) in changes.into_iter().flatten() {
                self.wire_level_arrives(wire, level);
            }
        }
    }

    /// Schedules the delivery of a motor's reports to its drive.
    fn schedule_motor_reports(&mut self, motor: usize) {
        let MotorSlot { reports, drive: (drive, _), .. } = &mut self.motors[motor];
        if self.slots[drive.0 as usize].halls.is_none() {
            // The drive has no Hall sensor inputs, so it gets no feedback.
            *reports = MotorReports::default();
            return;
        }
        if reports.is_news() && !reports.is_scheduled {
            reports.is_scheduled = true;
            let drive = drive.0;
            let what = EventKind::MotorReports { motor: motor as u32 };
            self.schedule(self.now + Duration::TICK, Phase::Pin, drive, what);
        }
    }

    /// Delivers reports of a motor to its drive.
    pub(super) fn deliver_motor_reports(&mut self, motor: u32) {
        let MotorSlot { reports, drive: (drive, axis), .. } = &mut self.motors[motor as usize];
        let (reports, drive, axis) = (std::mem::take(reports), *drive, *axis);
        let MotorReports { halls, draws, motor: parameters, rotation, .. } = reports;
        if let Some(parameters) = parameters {
            self.deliver(drive.0, &InputRecord::Motor { axis, parameters });
        }
        if let Some(rotation) = rotation {
            self.deliver(drive.0, &InputRecord::Rotation { axis, rotation });
        }
        for (n, level) in halls.into_iter().enumerate() {
            if let (Some(&wire), Some(level)) = (self.motors[motor as usize].halls.get(n), level) {
                self.wire_level_arrives(wire, level);
            }
        }
        if let Some(ma) = draws {
            self.deliver(drive.0, &InputRecord::MotorCurrent { axis, ma });
        }
    }
}
