//! Waveforms of the drives of a trace: pins, motion of the axes, messages on the ports.
//!
//! | variable | contents |
//! |---|---|
//! | a pin | what a probe at the pin sees |
//! | an analogue input | V |
//! | `position` | position of the axis, in steps or counts |
//! | `speed` | steps or counts per second, signed |
//! | `current` | A: peak phase current, or the current that the motor draws |
//! | `duty` | duty of a motor without steps, −1 to 1 |
//! | `rs485_rx` | words of the message to the drive on that port while it lasts, and with its outcome when that is known; else empty |
//! | `rs485_tx` | words of the message of the drive on that port while it lasts; else empty |
//!
//! A second axis has its name before those of its variables.
//!
//! | value | meaning |
//! |---|---|
//! | `0` `1` | the output of the drive, else the stimulus from outside, else the idle level |
//! | `z` | floating: a released output or an open input, without a wire |
//! | `x`, no number | unknown: the drive has no power, its events were lost, or the motion of its motor was not recorded |
//!
//! Edges of STEP and DIR are computed from the plans of the axes, and edges of lights and clocks from their
//! waves. A moving axis has a sample in each millisecond, and at each begin and end of an acceleration. If a
//! variable changes several times at one instant, only the last change counts. [`PortMessage`] tells when a
//! message begins and ends; one that takes no time lasts 1 ms here.

use std::collections::VecDeque;
use std::io;
use std::mem;
use std::ops::Range;

use drivetwin_firmware::device::{
    Axis, Duration, HIGH_MV, Instant, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role, Spec,
};

use crate::decode::messages::{KnownOutcome, Messages, PortMessage};
use crate::record::trace::{Entry, Event, Group, InputRecord, OutputRecord, Power, Trace, TraceDrive};
use crate::scheduler::Tournament;
use crate::signals::motion::{Commanded, Motion, SAMPLE};
use crate::signals::pin_waveform::{PinOutput, level_of};
use crate::signals::pulses::{Lent, Shaper, StepDir};

/// Duration of a message that takes no time.
const GLANCE: Duration = Duration::millis(1);

/// Value of a variable.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Value {
    /// Level of a pin: `0`, `1`, `z` or `x`.
    Level(char),
    /// A number in millionths; `None` if it is unknown.
    Number(Option<i64>),
    /// Words of a message.
    Words(Words),
}

/// Words of a message; empty while there is none.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Words {
    /// The words.
    pub text: String,
    /// The outcome of the message, if the words have it.
    pub outcome: Option<KnownOutcome>,
}

/// Type of a variable.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A digital pin.
    Level,
    /// An analogue input, in V.
    Volts,
    /// Position, speed, current or duty of an axis.
    Track(Track),
    /// Messages to the drive on a port.
    Received,
    /// Messages of the drive on a port.
    Sent,
}

/// A number of an axis over time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Track {
    /// Steps or counts.
    Position,
    /// Steps or counts per second, signed.
    Speed,
    /// A.
    Current,
    /// Duty of a motor without steps, −1 to 1.
    Duty,
}

/// A variable of a drive.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Index of the drive in [`Trace::drives`].
    pub drive: usize,
    /// Name of the pin, the track, or the port with `rx` or `tx`.
    pub name: String,
    /// Type.
    pub kind: Kind,
}

/// Receiver of the changes of variables, in the order of time.
pub trait Sink {
    /// A variable, by its index in [`Waveforms::variables`], has that value from `at` on. The first values of all
    /// variables come together, at one time.
    fn change(&mut self, at: Instant, variable: usize, value: &Value);

    /// A place between two instants, where the receiver can write what it has.
    ///
    /// # Errors
    /// Errors of a writer.
    fn pause(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Waveforms of the drives of a trace while it grows. Only the present state is kept.
pub struct Waveforms {
    variables: Vec<Variable>,
    /// State of each variable.
    states: Vec<State>,
    motors: Vec<Motor>,
    axes: Vec<AxisTracks>,
    /// The drives of the trace, by index.
    drives: Vec<Drive>,
    /// Finds the messages on the ports.
    messages: Messages,
    /// Drives that are not added yet, and the time of each; the next one is last.
    not_added: Vec<(Instant, usize)>,
    /// Next change of each [`Source`].
    edges: Tournament,
    now: Instant,
    /// Variables that may have changed at `now`.
    changed: Vec<usize>,
    /// Number of events taken from the trace.
    taken: u64,
    /// Time that the trace has reached.
    end: Instant,
}

/// Something that changes by itself, by its index.
#[derive(Clone, Copy)]
enum Source {
    Variable(usize),
    Motor(usize),
    Axis(usize),
}

/// Indices of a drive's variables, motors and axes.
struct Drive {
    pins: Range<usize>,
    /// For each port, the variables of the messages to the drive and from it.
    ports: Vec<[usize; 2]>,
    variables: Range<usize>,
    motors: Range<usize>,
    axes: Range<usize>,
}

/// An axis with step pulses.
struct Motor {
    axis: Axis,
    /// Indices of the wires of STEP and DIR.
    step: usize,
    dir: usize,
    shaper: Shaper,
    /// Outputs that the drive uses for other purposes now.
    lent: Lent,
}

/// The tracks of an axis: position, speed, current and duty.
struct AxisTracks {
    /// Index of the first variable; the others follow.
    first: usize,
    commanded: Commanded,
    /// True if the axis turns a motor, so that the commands do not show its motion.
    turns_motor: bool,
    /// The last recorded motion of the motor.
    recorded: Option<Motion>,
    /// True for each track whose number is known.
    known: [bool; TRACKS.len()],
}

/// Tracks by their place in [`TRACKS`].
const MOTION: Range<usize> = 0..2;
const CURRENT: Range<usize> = 2..3;
const DUTY: Range<usize> = 3..4;

/// State of a variable.
struct State {
    content: Content,
    /// Last value that the sink got.
    shown: Option<Value>,
}

enum Content {
    Pin(PinContent),
    /// A number in millionths; `None` if it is unknown.
    Number(Option<i64>),
    Text(TextContent),
}

/// A pin.
struct PinContent {
    pin: &'static PinSpec,
    /// True if the waveform is known now.
    known: bool,
    drives: PinOutput,
    /// Stimulus from outside in mV, if there is one.
    applied: Option<i32>,
}

/// Messages on a port in one direction.
#[derive(Default)]
struct TextContent {
    words: Words,
    /// End of the message that is shown.
    ends: Option<Instant>,
    /// Later messages.
    later: VecDeque<PortMessage>,
}

/// The tracks of an axis, in the order of their variables.
const TRACKS: [Track; 4] = [Track::Position, Track::Speed, Track::Current, Track::Duty];

impl Track {
    fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Speed => "speed",
            Self::Current => "current",
            Self::Duty => "duty",
        }
    }

    /// The number of a motion in millionths.
    fn millionths(self, motion: &Motion) -> i64 {
        match self {
            Self::Position => i64::from(motion.position) * 1_000_000,
            // Rounded down to thousandths, which keeps files short.
            Self::Speed => ((motion.speed.to_bits() * 1_000) >> 16) * 1_000,
            Self::Current => i64::from(motion.current_ma) * 1_000,
            Self::Duty => i64::from(motion.duty) * 1_000_000 / 65_536,
        }
    }
}

impl Waveforms {
    /// Begins with the drives of the trace.
    #[must_use]
    pub fn new(trace: &Trace) -> Self {
        let (mut variables, mut states, mut motors, mut axes, mut drives) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (drive, TraceDrive { spec, turns_motor, .. }) in trace.drives.iter().enumerate() {
            let first = variables.len();
            for (name, kind, content) in contents(spec) {
                variables.push(Variable { drive, name, kind });
                states.push(State { content, shown: None });
            }
            let pins = first..first + spec.pins.len();
            let tracks = pins.end..pins.end + spec.axes.len() * TRACKS.len();
            let first_motor = motors.len();
            let numbered = (0..).map(Axis).zip(spec.axes);
            motors.extend(numbered.filter_map(|(axis, spec)| {
                let (step, dir) = spec.step_dir?;
                let index = |pin: Pin| first + usize::from(pin.0);
                let (shaper, lent) = (Shaper::default(), Lent::default());
                Some(Motor { axis, step: index(step), dir: index(dir), shaper, lent })
            }));
            let first_axis = axes.len();
            axes.extend(tracks.clone().step_by(TRACKS.len()).map(|first| AxisTracks {
                first,
                commanded: Commanded::at_rest(Instant::ZERO),
                turns_motor: *turns_motor,
                recorded: None,
                known: [false; TRACKS.len()],
            }));
            let ports = (tracks.end..variables.len()).step_by(2).map(|first| [first, first + 1]).collect();
            drives.push(Drive {
                pins,
                ports,
                variables: first..variables.len(),
                motors: first_motor..motors.len(),
                axes: first_axis..axes.len(),
            });
        }
        let mut not_added: Vec<_> = trace.drives.iter().map(|drive| drive.from).zip(0..).collect();
        not_added.sort_unstable_by(|a, b| b.cmp(a));
        Self {
            edges: Tournament::new(&vec![Instant::NEVER; states.len() + motors.len() + axes.len()]),
            changed: (0..states.len()).collect(),
            variables,
            states,
            motors,
            axes,
            drives,
            messages: Messages::new(trace),
            not_added,
            now: Instant::ZERO,
            taken: 0,
            end: Instant::ZERO,
        }
    }

    /// The variables, drive by drive: pins, tracks, messages of ports.
    #[must_use]
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Takes the events since the last call. Changes at the last instant are held back, because more may
    /// happen at that instant.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn follow(&mut self, trace: &Trace, sink: &mut impl Sink) -> io::Result<()> {
        if trace.lost > self.taken {
            let resumes = trace.events().next().map_or(trace.end, |entry| entry.at);
            self.forget(resumes, sink)?;
            self.taken = trace.lost;
        }
        for entry in trace.since(self.taken) {
            self.happen(entry, sink)?;
        }
        self.taken = trace.mark();
        self.end = self.end.max(trace.end);
        self.run_until(self.end, sink)
    }

    /// Passes on the changes at the last instant. Returns the end of the trace.
    pub fn finish(mut self, sink: &mut impl Sink) -> Instant {
        self.tell_changes(sink);
        self.end.max(self.now)
    }

    /// Applies an event of the trace.
    fn happen(&mut self, entry: &Entry, sink: &mut impl Sink) -> io::Result<()> {
        let message = self.messages.take(entry);
        if let Event::Output(output) = &entry.event
            && matches!(output.group(), Group::Tx | Group::Line)
        {
            // Timestamps of these outputs may be in the future.
            message.into_iter().for_each(|message| self.show_message(message));
            return Ok(());
        }
        self.run_until(entry.at, sink)?;
        message.into_iter().for_each(|message| self.show_message(message));
        let (at, drive) = (entry.at, entry.drive);
        match &entry.event {
            Event::Input(input) => match *input {
                InputRecord::Power(Power::On) => self.power(drive, true),
                InputRecord::Power(Power::Off) => self.power(drive, false),
                InputRecord::Edge { pin, high } => {
                    self.set_stimulus(drive, pin, Some(if high { LOGIC_HIGH_MV } else { 0 }));
                }
                InputRecord::Open { pin } => self.set_stimulus(drive, pin, None),
                InputRecord::Millivolts { pin, mv } => self.set_stimulus(drive, pin, Some(mv)),
                _ => {}
            },
            Event::Output(output) => match output {
                OutputRecord::PowerOff => self.power(drive, false),
                &OutputRecord::Level { pin, level } => self.drive(drive, pin, PinOutput::Level(level)),
                &OutputRecord::Wave { pin, period, high } => {
                    self.drive(drive, pin, PinOutput::Wave { since: at, period, high });
                }
                OutputRecord::Plan { axis, plan } => {
                    self.turn(drive, *axis, |motor| {
                        motor.shaper.plan(at, plan, mem::take(&mut motor.lent));
                    });
                    self.command(drive, *axis, MOTION, |commanded| commanded.follow(plan));
                }
                OutputRecord::Step { axis, steps } => {
                    self.turn(drive, *axis, |motor| motor.shaper.steps(at, *steps));
                    self.command(drive, *axis, 0..0, |commanded| commanded.step(*steps));
                }
                &OutputRecord::CurrentLimit { axis, ma } => {
                    self.command(drive, axis, CURRENT, |commanded| commanded.current_ma = ma);
                }
                &OutputRecord::Duty { axis, duty } => {
                    self.command(drive, axis, DUTY, |commanded| commanded.duty = duty);
                }
                OutputRecord::Course { axis, .. } => self.lose(drive, *axis),
                _ => {}
            },
            &Event::Shaft { axis, shaft } => self.record(drive, axis, shaft.into()),
            Event::Received(_) | Event::Missing { .. } => {}
        }
        Ok(())
    }

    /// Handles a change of power of a drive: all its pins are released. After power-on the trace reports the
    /// stimuli again.
    fn power(&mut self, drive: usize, on: bool) {
        let Some(drive) = self.drives.get(drive) else { return };
        for index in drive.variables.clone() {
            match &mut self.states[index].content {
                Content::Pin(pin) => (pin.known, pin.drives, pin.applied) = (on, PinOutput::NOTHING, None),
                Content::Number(_) => {}
                Content::Text(text) => *text = TextContent::default(),
            }
            self.edges.set(index as u32, Instant::NEVER);
            self.changed.push(index);
        }
        for index in drive.motors.clone() {
            let motor = &mut self.motors[index];
            (motor.shaper, motor.lent) = (Shaper::default(), Lent::default());
            self.edges.set(self.rank(Source::Motor(index)), Instant::NEVER);
        }
        for index in drive.axes.clone() {
            let axis = &mut self.axes[index];
            axis.commanded = Commanded::at_rest(self.now);
            (axis.recorded, axis.known) = (None, [on && !axis.turns_motor; TRACKS.len()]);
            self.sample(index);
        }
    }

    /// Handles a change of the step pulses of an axis.
    fn turn(&mut self, drive: usize, axis: Axis, change: impl FnOnce(&mut Motor)) {
        let Some(index) = self.motor(drive, axis) else { return };
        change(&mut self.motors[index]);
        self.make_pulses(index);
    }

    /// Applies all edges of a motor up to now.
    fn make_pulses(&mut self, index: usize) {
        let Motor { step, dir, shaper, lent, .. } = &mut self.motors[index];
        while shaper.take(self.now).is_some() {}
        let outputs = [(*step, StepDir::Step), (*dir, StepDir::Dir)];
        for (index, output) in outputs.into_iter().filter(|(_, output)| !lent.has(*output)) {
            let Content::Pin(pin) = &mut self.states[index].content else { continue };
            (pin.known, pin.drives) = (true, PinOutput::Level(level_of(shaper.is_high(output))));
            self.changed.push(index);
        }
        let due = shaper.due();
        self.edges.set(self.rank(Source::Motor(index)), due);
    }

    /// Marks the pulses and the motion of an axis as unknown: a trace from text has the course of a motion, not
    /// the times of its steps.
    fn lose(&mut self, drive: usize, axis: Axis) {
        if let Some(index) = self.motor(drive, axis) {
            let Motor { step, dir, .. } = self.motors[index];
            for index in [step, dir] {
                let Content::Pin(pin) = &mut self.states[index].content else { continue };
                pin.known = false;
                self.changed.push(index);
            }
        }
        if let Some(index) = self.axis(drive, axis) {
            self.axes[index].known[MOTION].fill(false);
            self.sample(index);
        }
    }

    /// Handles a command of a drive to an axis, after which the tracks `known` are known.
    fn command(
        &mut self,
        drive: usize,
        axis: Axis,
        known: Range<usize>,
        change: impl FnOnce(&mut Commanded),
    ) {
        let Some(index) = self.axis(drive, axis) else { return };
        let axis = &mut self.axes[index];
        change(&mut axis.commanded);
        if !axis.turns_motor {
            axis.known[known].fill(true);
        }
        self.sample(index);
    }

    /// Handles a recorded motion of a motor.
    fn record(&mut self, drive: usize, axis: Axis, motion: Motion) {
        let Some(index) = self.axis(drive, axis) else { return };
        let axis = &mut self.axes[index];
        (axis.recorded, axis.known) = (Some(motion), [true; TRACKS.len()]);
        self.sample(index);
    }

    /// Sets the tracks of an axis to its motion now.
    fn sample(&mut self, index: usize) {
        let AxisTracks { first, ref commanded, recorded, known, .. } = self.axes[index];
        let motion = recorded.unwrap_or_else(|| commanded.motion(self.now));
        let next = if known[MOTION.start] && recorded.is_none() {
            commanded.next_sample(self.now, SAMPLE)
        } else {
            Instant::NEVER
        };
        for (variable, (track, known)) in (first..).zip(TRACKS.into_iter().zip(known)) {
            self.states[variable].content = Content::Number(known.then(|| track.millionths(&motion)));
            self.changed.push(variable);
        }
        self.edges.set(self.rank(Source::Axis(index)), next);
    }

    /// Shows a message from its begin on, or from now on.
    fn show_message(&mut self, message: PortMessage) {
        let Some(ports) = self.drives.get(message.drive).map(|drive| &drive.ports) else { return };
        let Some(&[received, sent]) = ports.get(usize::from(message.port.0)) else { return };
        let index = if message.sent { sent } else { received };
        if let Content::Text(text) = &mut self.states[index].content {
            text.later.push_back(message);
        }
        self.make_text(index);
    }

    /// Applies all begins and ends of messages up to now.
    fn make_text(&mut self, index: usize) {
        let Content::Text(text) = &mut self.states[index].content else { return };
        let due = text.advance(self.now);
        self.edges.set(self.rank(Source::Variable(index)), due);
        self.changed.push(index);
    }

    /// Sets the stimulus of a pin from outside, or removes it (`None`).
    fn set_stimulus(&mut self, drive: usize, pin: Pin, mv: Option<i32>) {
        let Some(index) = self.index(drive, pin) else { return };
        let Content::Pin(pin) = &mut self.states[index].content else { return };
        (pin.known, pin.applied) = (true, mv);
        self.changed.push(index);
    }

    /// Handles an output of a drive at a pin.
    fn drive(&mut self, drive: usize, pin: Pin, drives: PinOutput) {
        let Some(index) = self.index(drive, pin) else { return };
        for motor in self.drives[drive].motors.clone() {
            let Motor { step, dir, lent, .. } = &mut self.motors[motor];
            lent.step |= *step == index;
            lent.dir |= *dir == index;
        }
        let Content::Pin(pin) = &mut self.states[index].content else { return };
        (pin.known, pin.drives) = (true, drives);
        self.edges.set(index as u32, drives.next_edge(self.now));
        self.changed.push(index);
    }

    fn index(&self, drive: usize, pin: Pin) -> Option<usize> {
        self.drives.get(drive)?.pins.clone().nth(pin.0.into())
    }

    fn motor(&self, drive: usize, axis: Axis) -> Option<usize> {
        self.drives.get(drive)?.motors.clone().find(|&index| self.motors[index].axis == axis)
    }

    fn axis(&self, drive: usize, axis: Axis) -> Option<usize> {
        self.drives.get(drive)?.axes.clone().nth(axis.0.into())
    }

    /// Rank of a source in `edges`.
    fn rank(&self, source: Source) -> u32 {
        (match source {
            Source::Variable(index) => index,
            Source::Motor(index) => self.states.len() + index,
            Source::Axis(index) => self.states.len() + self.motors.len() + index,
        }) as u32
    }

    /// The source with that rank.
    fn source(&self, rank: u32) -> Source {
        let index = rank as usize;
        match index.checked_sub(self.states.len()) {
            None => Source::Variable(index),
            Some(index) => index.checked_sub(self.motors.len()).map_or(Source::Motor(index), Source::Axis),
        }
    }

    /// Advances to `at` and marks everything as unknown, because events before `at` are lost.
    fn forget(&mut self, at: Instant, sink: &mut impl Sink) -> io::Result<()> {
        self.not_added.retain(|(from, _)| *from > at);
        self.run_until(at, sink)?;
        for drive in 0..self.drives.len() {
            self.power(drive, false);
        }
        Ok(())
    }

    /// Advances to `to`: adds drives, and applies all edges up to then.
    fn run_until(&mut self, to: Instant, sink: &mut impl Sink) -> io::Result<()> {
        while let Some((from, drive)) = self.not_added.pop_if(|(from, _)| *from <= to) {
            self.make_edges(from, sink)?;
            self.power(drive, true);
        }
        self.make_edges(to, sink)
    }

    fn make_edges(&mut self, to: Instant, sink: &mut impl Sink) -> io::Result<()> {
        loop {
            let (due, source) = self.edges.first();
            if due > to || due == Instant::NEVER {
                return self.pass(to, sink);
            }
            self.pass(due, sink)?;
            match self.source(source) {
                Source::Motor(motor) => self.make_pulses(motor),
                Source::Axis(axis) => self.sample(axis),
                Source::Variable(index) => match &self.states[index].content {
                    Content::Text(_) => self.make_text(index),
                    Content::Pin(pin) => {
                        self.edges.set(source, pin.drives.next_edge(due));
                        self.changed.push(index);
                    }
                    Content::Number(_) => {}
                },
            }
        }
    }

    /// Advances the time to `at`. Changes at the previous time are complete, so the sink gets them.
    fn pass(&mut self, at: Instant, sink: &mut impl Sink) -> io::Result<()> {
        if at <= self.now {
            return Ok(());
        }
        self.tell_changes(sink);
        self.now = at;
        sink.pause()
    }

    /// Passes on the variables whose values have changed by now; at the first call, all variables.
    fn tell_changes(&mut self, sink: &mut impl Sink) {
        let mut changed = mem::take(&mut self.changed);
        changed.sort_unstable();
        changed.dedup();
        for index in changed.drain(..) {
            let State { content, shown } = &mut self.states[index];
            if shown.as_ref().is_some_and(|shown| content.shows(self.now, shown)) {
                continue;
            }
            let value = content.value(self.now);
            sink.change(self.now, index, &value);
            *shown = Some(value);
        }
        self.changed = changed;
    }
}

/// The variables of a drive: pins, tracks of the axes, messages of the ports.
fn contents(spec: &'static Spec) -> Vec<(String, Kind, Content)> {
    let pin = |pin: &'static PinSpec| {
        let content = PinContent { pin, known: false, drives: PinOutput::NOTHING, applied: None };
        let kind = if pin.role == Role::Analogue { Kind::Volts } else { Kind::Level };
        (pin.name.to_owned(), kind, Content::Pin(content))
    };
    let tracks = spec.axes.iter().enumerate().flat_map(|(index, axis)| {
        let axis = if index == 0 { String::new() } else { format!("{}_", axis.name) };
        TRACKS
            .map(move |track| (format!("{axis}{}", track.name()), Kind::Track(track), Content::Number(None)))
    });
    let ports = spec.ports.iter().flat_map(|port| {
        [("rx", Kind::Received), ("tx", Kind::Sent)]
            .map(|(way, kind)| (format!("{}_{way}", port.name), kind, Content::Text(TextContent::default())))
    });
    spec.pins.iter().map(pin).chain(tracks).chain(ports).collect()
}

impl TextContent {
    /// Applies all begins and ends of messages up to `now`. Returns the time of the next one.
    fn advance(&mut self, now: Instant) -> Instant {
        while self.later.front().is_some_and(|message| message.begin <= now)
            && let Some(message) = self.later.pop_front()
        {
            let shown = if message.end > message.begin { message.end } else { message.begin + GLANCE };
            let PortMessage { text, outcome, .. } = message;
            (self.words, self.ends) = (Words { text, outcome }, Some(shown));
        }
        if self.ends.is_some_and(|ends| ends <= now) {
            (self.words, self.ends) = (Words::default(), None);
        }
        let begins = self.later.front().map(|message| message.begin);
        begins.into_iter().chain(self.ends).min().unwrap_or(Instant::NEVER)
    }
}

impl Content {
    fn value(&self, at: Instant) -> Value {
        match self {
            Self::Pin(pin) => pin.value(at),
            Self::Number(number) => Value::Number(*number),
            Self::Text(text) => Value::Words(text.words.clone()),
        }
    }

    /// Returns true if `value` is the present value.
    fn shows(&self, at: Instant, value: &Value) -> bool {
        match (self, value) {
            (Self::Text(text), Value::Words(words)) => text.words == *words,
            _ => self.value(at) == *value,
        }
    }
}

impl PinContent {
    fn value(&self, at: Instant) -> Value {
        let logic = |high| Value::Level(if high { '1' } else { '0' });
        if self.pin.role == Role::Analogue {
            let millivolts = |mv: i32| Value::Number(Some(i64::from(mv) * 1_000));
            return match self.applied {
                _ if !self.known => Value::Number(None),
                Some(mv) => millivolts(mv),
                None if self.pin.idle == Level::High => millivolts(LOGIC_HIGH_MV),
                None => millivolts(0),
            };
        }
        match self.drives.level(at) {
            _ if !self.known => Value::Level('x'),
            Level::High => logic(true),
            Level::Low => logic(false),
            Level::Float => match (self.applied, self.pin.idle) {
                (Some(mv), _) => logic(mv > HIGH_MV),
                (None, Level::Float) => Value::Level('z'),
                (None, rest) => logic(rest == Level::High),
            },
        }
    }
}
