//! Motors of their own, and what is on their shafts: encoders and switches.
//!
//! A motor hears what its drive does a tick later, and what it does arrives a tick later: at its drive the edges of
//! Hall sensors and the current that it draws, elsewhere what encoders and switches show. Those are made where
//! a pin is wired, one ahead, each at the tick at which the shaft crosses it.

use std::collections::VecDeque;

use standin_firmware::device::{
    Axis, Boot, Duration, Fault, Input, Instant, Level, Output, Pin, Shaft, Sink,
};
use standin_firmware::motor::{self, HALL_A, HALL_B, Pace, Rotor, STALL, stepper};
use standin_protocol::time::TICKS_PER_SECOND;

use super::{Bench, Seat};
use crate::drives::level_of;
use crate::schedule::{Class, What};
use crate::seat::Told;
use crate::trace::{self, Fed};

/// A motor on the bench.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Motor(u32);

/// What a motor is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fitting {
    /// It follows the plans and steps of its drive.
    Stepper(stepper::Parameters),
    /// It is turned by the duty of a drive that was seated [`apart`](super::Setup::apart).
    Brush(motor::Parameters),
}

/// Where a switch is closed: above one position of the shaft and below another, in turns from where it began.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Closed {
    /// Above that.
    pub above_rev: Option<f64>,
    /// And below that.
    pub below_rev: Option<f64>,
}

/// What a shaft does.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Turn {
    /// Turns from where it began.
    pub revolutions: f64,
    /// Turns per minute, signed.
    pub rpm: f64,
    /// Whether it cannot follow its drive.
    pub stalled: bool,
    /// What it draws, in mA; of a stepper motor the peak current that its drive gives it.
    pub ma: i32,
}

/// Places from here on are those of motors, not of seats.
const MOTORS: u32 = 1 << 31;

/// Which motor has that place; `None` for a seat's.
pub(super) fn at_place(place: u32) -> Option<usize> {
    place.checked_sub(MOTORS).map(|motor| motor as usize)
}

/// Turns in an angle.
const TURN: f64 = (1_u64 << 32) as f64;

/// A motor that is fitted to a drive.
pub(super) struct Fitted {
    name: String,
    drive: (Seat, Axis),
    machine: Machine,
    /// How it turns at present.
    pace: Pace,
    /// Where the shaft began.
    began: i64,
    /// What its drive was told last to step in.
    microsteps: u16,
    /// What it is to hear, and when.
    inbox: VecDeque<(Instant, Told)>,
    /// The ends of the wires of its Hall sensors.
    halls: Vec<u32>,
    felt: Felt,
    sensors: Vec<Sensor>,
    /// Tells what is due next from what was foreseen earlier.
    number: u32,
}

enum Machine {
    Stepper(Box<stepper::Stepper>),
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

    fn hear(&mut self, at: Instant, told: &Told, out: &mut Felt) {
        const AXIS: Axis = Axis(0);
        let plan;
        let input = match *told {
            Told::Plan(told) => {
                // What is heard a tick later is also done a tick later.
                plan = told.delayed(Duration::TICK);
                Input::Plan { axis: AXIS, plan: &plan }
            }
            Told::Microsteps(microsteps) => {
                if let Self::Stepper(stepper) = self {
                    stepper.set_microsteps(at, microsteps);
                }
                return;
            }
            Told::Steps(steps) => Input::Step { axis: AXIS, steps },
            Told::Current(ma) => Input::Current { axis: AXIS, ma },
            Told::Duty(duty) => Input::Duty { axis: AXIS, duty },
            Told::Held(on) => Input::Fault { fault: STALL, on },
        };
        self.rotor_mut().input(at, input, out);
    }
}

/// What a motor did at an instant, on its way to its drive.
#[derive(Default)]
struct Felt {
    halls: [Option<Level>; 2],
    draws: Option<i32>,
    /// Whether its arrival is foreseen.
    foreseen: bool,
}

impl Felt {
    fn is_news(&self) -> bool {
        self.draws.is_some() || self.halls.iter().any(Option::is_some)
    }
}

impl Sink for Felt {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        match output {
            Output::Level { pin: HALL_A, level } => self.halls[0] = Some(level),
            Output::Level { pin: HALL_B, level } => self.halls[1] = Some(level),
            Output::Draws { ma, .. } => self.draws = Some(ma),
            _ => {}
        }
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

/// Wires, and what is on them.
type Shows = [Option<(u32, Level)>; 3];

/// What looks at a shaft. It is at one of many places, in the order of angles.
struct Sensor {
    /// Where its first wire goes: the order of a motor's sensors.
    key: (String, Pin),
    sees: Sees,
    place: i64,
    /// What its wires show of that.
    shows: Option<Shows>,
    /// When the shaft comes to another place next, and which.
    next: Instant,
    to: i64,
}

enum Sees {
    /// Counts, four to a cycle.
    Encoder { counts: i64, wires: [Option<u32>; 3] },
    /// Place 0 from one angle on and up to another is where it is closed, if there are such.
    Switch { from: Option<i64>, to: Option<i64>, wire: u32 },
}

impl Sees {
    /// The place of an angle.
    fn place(&self, angle: i64) -> i64 {
        match *self {
            Self::Encoder { counts, .. } => {
                let part = angle & 0xFFFF_FFFF;
                // A shaft begins in the middle of a count, where nothing trembles.
                (angle >> 32) * counts + ((part * counts + (1 << 31)) >> 32)
            }
            Self::Switch { from, .. } if from.is_some_and(|from| angle < from) => -1,
            Self::Switch { to, .. } => i64::from(to.is_some_and(|to| angle >= to)),
        }
    }

    /// Where a count begins.
    fn count_begins(counts: i64, count: i64) -> i64 {
        let (turn, part) = (count.div_euclid(counts), count.rem_euclid(counts));
        (turn << 32) - ((1 << 31) - (part << 32)).div_euclid(counts)
    }

    /// The next place to be seen from another one, and the angle from which on, or below which, the shaft is
    /// there.
    fn next(&self, place: i64, forward: bool) -> Option<(i64, i64)> {
        match *self {
            Self::Encoder { counts, wires: [None, None, _] } => {
                // Only the index is seen: the first count of a turn, and the others.
                let count = match (place.rem_euclid(counts), forward) {
                    (0, true) => place + 1,
                    (0, false) => place - 1,
                    (part, true) => place - part + counts,
                    (part, false) => place - part,
                };
                Some((count, Self::count_begins(counts, if forward { count } else { count + 1 })))
            }
            Self::Encoder { counts, .. } if forward => {
                Some((place + 1, Self::count_begins(counts, place + 1)))
            }
            Self::Encoder { counts, .. } => Some((place - 1, Self::count_begins(counts, place))),
            Self::Switch { from, to, .. } => match (place, forward) {
                (-1, true) => from.map(|from| (0, from)),
                (0, true) => to.map(|to| (1, to)),
                (0, false) => from.map(|from| (-1, from)),
                (1, false) => to.map(|to| (0, to)),
                _ => None,
            },
        }
    }

    /// Its wires, and what is on them at a place.
    fn shows(&self, place: i64) -> Shows {
        match *self {
            Self::Encoder { counts, wires: [a, b, index] } => {
                let shows = |wire: Option<u32>, high: bool| wire.map(|wire| (wire, level_of(high)));
                let quarter = place & 3;
                [
                    shows(a, quarter == 0 || quarter == 3),
                    shows(b, quarter <= 1),
                    shows(index, place.rem_euclid(counts) == 0),
                ]
            }
            Self::Switch { wire, .. } => {
                [Some((wire, if place == 0 { Level::Low } else { Level::Float })), None, None]
            }
        }
    }
}

impl Sensor {
    /// Foresees what comes next, from `from` on, at a shaft that turns like that.
    fn foresee(&mut self, rotor: &dyn Rotor, pace: &Pace, began: i64, from: Instant) {
        if self.shows.is_none() {
            (self.next, self.to) = (from, self.sees.place(rotor.angle_at(from).wrapping_sub(began)));
            return;
        }
        self.next = Instant::NEVER;
        let ways = if stands(pace) { [true, false].as_slice() } else { &[forward(pace)] };
        for &forward in ways {
            let Some((to, angle)) = self.sees.next(self.place, forward) else { continue };
            let at = crossing(rotor, pace, angle.wrapping_add(began), forward, from);
            if at < Instant::NEVER {
                (self.next, self.to) = (at, to);
                return;
            }
        }
    }
}

fn stands(pace: &Pace) -> bool {
    pace.h == 0 && pace.a == 0
}

fn forward(pace: &Pace) -> bool {
    pace.h > 0 || (pace.h == 0 && pace.a > 0)
}

/// The first tick from `from` on, and before the shaft begins to turn otherwise, at which it is at an angle or
/// forward of it, or, going backward, before it.
///
/// It is reckoned in floating point, which is mostly right; the shaft tells.
fn crossing(rotor: &dyn Rotor, pace: &Pace, angle: i64, forward: bool, from: Instant) -> Instant {
    let there = |tick: u64| rotor.is_at_least(Instant::from_ticks(tick), angle) == forward;
    let first = from.ticks();
    let Some(last) = rotor.until().ticks().checked_sub(1).filter(|last| *last >= first) else {
        // It begins to turn otherwise now, and is looked at again then.
        return Instant::NEVER;
    };
    if stands(pace) {
        return if there(first) { from } else { Instant::NEVER };
    }
    let way = angle.wrapping_sub(pace.angle) as f64 / TURN * pace.turn as f64;
    let (h, a) = (pace.h as f64, pace.a as f64);
    let root = (h * h + a * way).max(0.0).sqrt();
    let ticks = way / if forward { h + root } else { h - root };
    // Not a number is no time.
    let guess = (pace.since.ticks().saturating_add(ticks.ceil() as u64)).clamp(first, last);

    // From `low` to `high` it comes there; it is searched for in steps that double.
    let (mut low, mut high, mut step) = (guess, guess, 1);
    if there(guess) {
        loop {
            if high == first {
                return from;
            }
            low = high.saturating_sub(step).max(first);
            if !there(low) {
                break;
            }
            (high, step) = (low, 2 * step);
        }
    } else {
        loop {
            if low == last {
                return Instant::NEVER;
            }
            high = low.saturating_add(step).min(last);
            if there(high) {
                break;
            }
            (low, step) = (high, step.saturating_mul(2));
        }
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if there(middle) { high = middle } else { low = middle }
    }
    Instant::from_ticks(high)
}

/// Motors.
impl Bench {
    /// Has an axis turn a motor from now on. A drive has one motor an axis. It hears what the drive does at
    /// present, and its shaft stands until then.
    ///
    /// # Errors
    /// One sentence: why not.
    pub fn fit(&mut self, name: &str, drive: Seat, axis: Axis, is: Fitting) -> Result<Motor, String> {
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
        let parted = self.at(drive).parted;
        let machine = match (is, parted) {
            (Fitting::Stepper(is), None) => Machine::Stepper(Box::new(stepper::Stepper::new(is))),
            (Fitting::Brush(is), Some(_)) => Machine::Brush(Box::new(motor::Motor::new(is))),
            (Fitting::Stepper(_), Some(_)) => {
                return Err(format!("{of} turns a brush motor, and {name} is a stepper motor"));
            }
            (Fitting::Brush(_), None) => {
                return Err(format!("{of} does not turn brush motors of a bench, and {name} is one"));
            }
        };
        let place = u32::try_from(self.motors.len()).expect("a bench has room for two billion motors");
        let halls = parted.map_or(&[][..], |parted| parted.halls);
        let halls = halls.iter().map(|&pin| self.end_of_wire((drive, pin))).collect();
        let mut motor = Fitted {
            name: name.to_owned(),
            drive: (drive, axis),
            began: 0,
            pace: machine.rotor().pace(),
            machine,
            microsteps: 1,
            inbox: VecDeque::new(),
            halls,
            felt: Felt::default(),
            sensors: Vec::new(),
            number: 0,
        };
        let now = self.now;
        let rotor = motor.machine.rotor_mut();
        rotor.power_on(now, Boot::default(), &mut motor.felt);
        (motor.began, motor.pace) = (rotor.angle_at(now), rotor.pace());
        let arrives = now + Duration::TICK;
        let mut told = self.at_mut(drive).turns(axis, place);
        // Before the plan that is made of them.
        motor.microsteps = self.at(drive).microsteps(axis);
        told.insert(0, Told::Microsteps(motor.microsteps));
        told.extend(self.is_held(drive).then_some(Told::Held(true)));
        motor.inbox.extend(told.into_iter().map(|told| (arrives, told)));
        self.motors.push(motor);
        self.indexed = false;
        self.carry_felt(place as usize);
        self.foresee_motor(place as usize);
        Ok(Motor(place))
    }

    /// The motor that a drive has parted from when it was seated [`apart`](super::Setup::apart).
    #[must_use]
    pub fn parted(&self, drive: Seat) -> Option<motor::Parameters> {
        self.at(drive).parted.map(|parted| parted.motor)
    }

    /// Puts an encoder of `cycles_per_rev` cycles a turn (1 to 10,000,000) on a motor's shaft, and wires its channels A
    /// and B and its index. It begins in the middle of a count, with all three high; A is a quarter of a cycle before
    /// B while the motor turns forward. The index is high in the first quarter of a cycle of every turn.
    ///
    /// # Panics
    /// If a pin is not there.
    pub fn encode(&mut self, motor: Motor, cycles_per_rev: u32, to: [Option<(Seat, Pin)>; 3]) {
        let counts = 4 * i64::from(cycles_per_rev.clamp(1, 10_000_000));
        let wires = to.map(|to| to.map(|to| self.end_of_wire(to)));
        if let Some(to) = to.into_iter().flatten().next() {
            self.put_sensor(motor, to, Sees::Encoder { counts, wires });
        }
    }

    /// Puts a switch beside a motor's shaft that pulls a pin to ground while it is closed.
    ///
    /// # Panics
    /// If the pin is not there.
    pub fn switch(&mut self, motor: Motor, closed: Closed, to: (Seat, Pin)) {
        let (wire, pin) = (self.end_of_wire(to), to);
        // Above and below, and not there.
        let from = closed.above_rev.map(|rev| (rev * TURN).floor() as i64 + 1);
        let to = closed.below_rev.map(|rev| (rev * TURN).ceil() as i64);
        // One that is never closed is so at no angle.
        let to = if let (Some(from), Some(to)) = (from, to) { Some(to.max(from)) } else { to };
        self.put_sensor(motor, pin, Sees::Switch { from, to, wire });
    }

    /// What it shows so far is on its way like all that it will show.
    fn put_sensor(&mut self, motor: Motor, to: (Seat, Pin), sees: Sees) {
        let (now, key) = (self.now, (self.name(to.0).to_owned(), to.1));
        let Fitted { machine, pace, sensors, began, .. } = &mut self.motors[motor.0 as usize];
        let mut sensor = Sensor { key, sees, place: 0, shows: None, next: now, to: 0 };
        sensor.foresee(machine.rotor(), pace, *began, now);
        let place = sensors.partition_point(|other| other.key <= sensor.key);
        sensors.insert(place, sensor);
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

    /// What turns a motor.
    #[must_use]
    pub fn turned_by(&self, motor: Motor) -> (Seat, Axis) {
        self.motors[motor.0 as usize].drive
    }

    /// What a motor's shaft does now.
    #[must_use]
    pub fn turn(&self, motor: Motor) -> Turn {
        let Fitted { machine, pace: Pace { since, h, a, turn, .. }, began, .. } =
            &self.motors[motor.0 as usize];
        let rotor = machine.rotor();
        let speed = 2.0 * (*h as f64 + *a as f64 * self.now.since(*since).ticks() as f64);
        Turn {
            revolutions: rotor.angle_at(self.now).wrapping_sub(*began) as f64 / TURN,
            rpm: speed / *turn as f64 * (60 * TICKS_PER_SECOND) as f64,
            stalled: rotor.stalled(),
            ma: rotor.draws_ma(),
        }
    }

    /// What the brush motor on an axis does, if the bench has one there.
    pub(super) fn shaft(&self, seat: Seat, axis: Axis) -> Option<Shaft> {
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
                fitted.inbox.push_back((self.now + Duration::TICK, Told::Microsteps(microsteps)));
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

    /// Whether hands hold the shaft of a drive's motor: the fault that is called so.
    fn is_held(&self, drive: Seat) -> bool {
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
            self.motors[motor as usize].inbox.push_front((self.now, Told::Held(on)));
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
        let seen = fitted.sensors.iter().map(|sensor| sensor.next).min().unwrap_or(Instant::NEVER);
        let outside = told.min(seen + Duration::TICK);
        let due = fitted.machine.rotor().deadline();
        let (at, class) = if outside <= due { (outside, Class::Pin) } else { (due, Class::Deadline) };
        if at < Instant::NEVER {
            let rank = self.motor_ranks.get(motor).copied().unwrap_or(0);
            self.under_way.push(at, class, rank, MOTORS + motor as u32, What::Motor { number });
        }
    }

    /// Something that was foreseen at a motor is due.
    pub(super) fn motor_is_due(&mut self, place: u32, number: u32, class: Class) {
        let Some(motor) = at_place(place).filter(|&motor| self.motors[motor].number == number) else {
            return;
        };
        let now = self.now;
        self.see(motor);
        let Fitted { machine, pace, inbox, felt, sensors, began, .. } = &mut self.motors[motor];
        let mut looks = false;
        while inbox.front().is_some_and(|(at, _)| *at <= now)
            && let Some((_, told)) = inbox.pop_front()
        {
            machine.hear(now, &told, felt);
            looks = true;
        }
        if class == Class::Deadline {
            machine.rotor_mut().timeout(now, felt);
            looks = true;
        }
        let rotor = machine.rotor();
        if looks && rotor.pace() != *pace {
            *pace = rotor.pace();
            for sensor in sensors {
                sensor.foresee(rotor, pace, *began, now);
            }
        }
        self.carry_felt(motor);
        self.foresee_motor(motor);
    }

    /// What a motor's sensors have seen by a tick ago arrives.
    fn see(&mut self, motor: usize) {
        for n in 0.. {
            let Fitted { machine, pace, sensors, began, .. } = &mut self.motors[motor];
            let Some(sensor) = sensors.get_mut(n) else { break };
            if sensor.next >= self.now {
                continue;
            }
            let after = sensor.sees.shows(sensor.to);
            let before = sensor.shows.replace(after).unwrap_or_default();
            sensor.place = sensor.to;
            sensor.foresee(machine.rotor(), pace, *began, self.now);
            for (before, after) in before.into_iter().zip(after) {
                if let Some((wire, level)) = after.filter(|_| after != before) {
                    self.wired(wire, level);
                }
            }
        }
    }

    /// What a motor did is on its way to its drive.
    fn carry_felt(&mut self, motor: usize) {
        let Fitted { felt, drive: (drive, _), .. } = &mut self.motors[motor];
        if felt.is_news() && !felt.foreseen {
            felt.foreseen = true;
            let drive = drive.0;
            let what = What::Felt { motor: motor as u32 };
            self.schedule(self.now + Duration::TICK, Class::Pin, drive, what);
        }
    }

    /// What a motor did arrives at its drive.
    pub(super) fn felt(&mut self, motor: u32) {
        let Fitted { felt, drive: (drive, axis), .. } = &mut self.motors[motor as usize];
        let (Felt { halls, draws, .. }, drive, axis) = (std::mem::take(felt), *drive, *axis);
        for (n, level) in halls.into_iter().enumerate() {
            if let (Some(&wire), Some(level)) = (self.motors[motor as usize].halls.get(n), level) {
                self.wired(wire, level);
            }
        }
        if let Some(ma) = draws {
            self.deliver(drive.0, &Fed::Draws { axis, ma });
        }
    }
}
