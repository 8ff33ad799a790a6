//! A device on a bench: its memory, its power, and what it does to the world.

use fixed::types::I48F16;
use standin_firmware::device::{
    Axis, AxisSpec, Boot, Device, Duration, Encoder, EncoderSpec, Ends, Fault, Instant, Level, Line, Note,
    Output, Pin, PinSpec, Plan, Port, Refused, Role, Sink, Spec, Why,
};

use crate::bench::{Driving, Keep, Motion, Statistics};
use crate::dice::Dice;
use crate::drives::{Drives, level_of};
use crate::pulses::{HIGH, Shaper, StepDir};
use crate::schedule::Class;
use crate::trace::{Cut, Fed, Power, Trace};

/// A digital input is high above this: the middle of TTL's 0.8 V and 2.0 V.
const HIGH_MV: i32 = 1_400;

/// A device that is woken so often at one instant hangs.
const MOST_AT_ONCE: u32 = 1_000_000;

/// What an analogue input sees of a logic level.
pub(crate) const LOGIC_HIGH_MV: i32 = 5_000;

/// A device, and all that it has to do with.
pub(crate) struct Seated {
    pub(crate) name: String,
    pub(crate) spec: &'static Spec,
    device: Box<dyn Device>,
    pub(crate) body: Body,
    boot_fast: bool,
    /// Rows that are set after every power-on, and their values.
    pub(crate) presets: Vec<(usize, i64)>,
    /// Seeds of its random choices, one for each power-on.
    dice: Dice,
    /// The last that happened to it: nothing can come before it any more.
    last: (Instant, Class),
    /// Wake-ups in a row after which it wanted to be woken again at once.
    at_once: u32,
    /// When it wants to be woken; without power never.
    deadline: Instant,
}

/// What a device leaves behind, in the world and in its memory.
pub(crate) struct Body {
    seat: u32,
    pub(crate) memory: Vec<u8>,
    keep: Option<Keep>,
    pub(crate) powered: bool,
    /// The next power cut, and whether it has come.
    cut: Option<Place>,
    dead: bool,
    /// Where cuts fall.
    dice: Dice,
    pub(crate) pins: Vec<PinState>,
    axes: Vec<AxisState>,
    encoders: Vec<EncoderState>,
    pub(crate) ports: Vec<PortState>,
    /// Which causes of faults are there.
    pub(crate) faults: Vec<bool>,
}

/// Where in a save power fails.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Stores that still go through.
    stores: u32,
    part: Part,
}

/// How much of a store goes through.
#[derive(Clone, Copy, Debug)]
enum Part {
    Bytes(usize),
    /// What a random number picks; `whole`: all of it may.
    Random {
        number: u64,
        whole: bool,
    },
}

/// A pin and what both sides do to it.
pub(crate) struct PinState {
    spec: &'static PinSpec,
    /// What hands do to it.
    pub(crate) hands: Driving,
    /// What of that has arrived.
    pub(crate) held: Driving,
    /// What wires do to it.
    pub(crate) wired: Driving,
    /// The wires that drive it, and those that it drives: places in the bench's list.
    pub(crate) driven_by: Vec<u32>,
    pub(crate) drives_wires: Vec<u32>,
    /// What the device was told last.
    pub(crate) told: Signal,
    /// The train of pulses that runs.
    pub(crate) train: Option<PulseTrain>,
    /// How many trains there have been.
    pub(crate) trains: u32,
    /// What the device does with it.
    drives: Drives,
    /// How often that has changed.
    changes: u32,
}

/// What a device sees at an input.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Signal {
    Digital(bool),
    Millivolts(i32),
}

impl Signal {
    /// What the device is told.
    pub(crate) fn fed(self, pin: Pin) -> Fed {
        match self {
            Self::Digital(high) => Fed::Edge { pin, high },
            Self::Millivolts(mv) => Fed::Millivolts { pin, mv },
        }
    }
}

/// Edges at a steady rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeTrain {
    pub(crate) start: Instant,
    pub(crate) ticks_per_edge: f64,
    /// Edges made.
    pub(crate) made: u64,
    /// Edges to make in all.
    pub(crate) count: u64,
}

impl EdgeTrain {
    /// When the next edge is; `None` after the last one.
    pub(crate) fn due(&self) -> Option<Instant> {
        // Exact below 2^53, to the nearest; beyond the end of time the conversion saturates.
        let ticks = (self.made as f64 * self.ticks_per_edge + 0.5) as u64;
        (self.made < self.count).then_some(self.start + Duration::from_ticks(ticks))
    }
}

/// Pulses on an input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseTrain {
    pub(crate) edges: EdgeTrain,
    /// The level between pulses.
    pub(crate) rest: bool,
    /// What the pin goes back to.
    pub(crate) before: Driving,
}

/// What turns an encoder.
#[derive(Default)]
pub(crate) struct EncoderState {
    pub(crate) edges: Option<EdgeTrain>,
    /// Whether B leads A.
    pub(crate) back: bool,
    /// How often it was turned.
    pub(crate) turns: u32,
}

/// What is known of an axis.
struct AxisState {
    step_dir: Option<(Pin, Pin)>,
    plan: Plan,
    /// Steps made without a plan since the last one.
    steps: i32,
    /// Whether the last step before the plan was forward.
    forward: bool,
    /// Whether the last of `steps` was, if there are any.
    stepped: Option<bool>,
    current_ma: u32,
    duty: i32,
    /// Makes the pulses for whoever is wired to them.
    shaper: Option<Shaper>,
    /// How often the next edge has changed.
    changes: u32,
}

/// What is known of a port.
pub(crate) struct PortState {
    pub(crate) serial: Option<Serial>,
    pub(crate) statistics: Statistics,
}

/// A serial port.
pub(crate) struct Serial {
    /// The line it is on.
    bus: u32,
    factory: Line,
    line: Line,
    /// Settings that hold later.
    later: Vec<(Instant, Line)>,
    /// Silence ends its messages: one pair of wires for both directions. Otherwise each character
    /// has its time, and both directions run at once.
    pub(crate) silence: bool,
    /// When its last message began to leave.
    began: Option<Instant>,
    /// When its last character has left.
    pub(crate) sends_until: Instant,
}

impl Serial {
    /// The settings of a character that begins at `at`.
    pub(crate) fn line_at(&self, at: Instant) -> Line {
        self.later.iter().rev().find(|(from, _)| *from <= at).map_or(self.line, |&(_, line)| line)
    }

    fn change(&mut self, at: Instant, line: Line) {
        self.line = self.line_at(at);
        self.later.retain(|(from, _)| *from > at);
        self.later.push((at.max(self.sends_until), line));
    }
}

/// Characters that leave a port.
pub(crate) struct Sent {
    pub(crate) seat: u32,
    pub(crate) port: Port,
    /// When the first one begins.
    pub(crate) start: Instant,
    pub(crate) line: Line,
    /// How many; they are in [`Outbox::bytes`].
    pub(crate) count: usize,
}

/// What an output did to which a wire goes.
pub(crate) enum Moved {
    /// A pin took a level then.
    Pin { pin: Pin, at: Instant, level: Level },
    /// A pin repeats from now on.
    Wave { pin: Pin },
    /// An axis has other steps before it.
    Axis { axis: Axis },
}

/// What a device has done in one call.
#[derive(Default)]
pub(crate) struct Outbox {
    pub(crate) sent: Vec<Sent>,
    /// All characters, one message behind the other.
    pub(crate) bytes: Vec<u8>,
    /// And whose output it was.
    pub(crate) moved: Vec<(u32, Moved)>,
}

impl Outbox {
    pub(crate) fn is_empty(&self) -> bool {
        self.sent.is_empty() && self.moved.is_empty()
    }

    /// Empties it, and keeps its room.
    pub(crate) fn clear(&mut self) {
        self.sent.clear();
        self.bytes.clear();
        self.moved.clear();
    }
}

/// What the outputs of a device go to, beside its body.
pub(crate) struct Tape<'a> {
    pub(crate) trace: &'a mut Trace,
    pub(crate) outbox: &'a mut Outbox,
    /// Whether characters take no time.
    pub(crate) fast: bool,
}

/// The sink of one call of a device.
struct Hand<'a, 'b> {
    body: &'a mut Body,
    tape: &'a mut Tape<'b>,
}

impl Sink for Hand<'_, '_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        if self.body.dead {
            return;
        }
        if let Output::Store { offset, bytes } = output {
            let bytes = self.body.store(offset, bytes);
            self.tape.trace.did(at, self.body.seat, Output::Store { offset, bytes });
            if self.body.dead {
                self.tape.trace.power_fails(at, self.body.seat);
            }
            return;
        }
        self.body.put(at, output, self.tape);
        self.tape.trace.did(at, self.body.seat, output);
    }

    fn memory(&self) -> &[u8] {
        &self.body.memory
    }
}

impl Body {
    /// Stores as much as power allows, and returns it.
    fn store<'a>(&mut self, offset: u16, bytes: &'a [u8]) -> &'a [u8] {
        let part = match &mut self.cut {
            None => bytes.len(),
            Some(place) if place.stores > 0 => {
                place.stores -= 1;
                bytes.len()
            }
            Some(Place { part, .. }) => {
                let length = bytes.len();
                let part = match *part {
                    Part::Bytes(part) => part.min(length),
                    Part::Random { number, whole } => {
                        // A cut that leaves the memory as it was is in no save's middle.
                        let old = self.memory.get(usize::from(offset)..).unwrap_or(&[]);
                        let same = old.iter().zip(bytes).take_while(|(old, new)| old == new).count();
                        let least = if whole { (same + 1).min(length) } else { 0 };
                        let choices = (length + usize::from(whole)).saturating_sub(least).max(1);
                        least + usize::try_from(number % choices as u64).unwrap_or(0)
                    }
                };
                self.cut = None;
                self.dead = true;
                part
            }
        };
        let bytes = &bytes[..part];
        let from = usize::from(offset);
        if let Some(place) = self.memory.get_mut(from..from + part) {
            place.copy_from_slice(bytes);
        }
        if let Some(keep) = &mut self.keep {
            keep(offset, bytes);
        }
        bytes
    }

    /// Does anything but a store.
    fn put(&mut self, at: Instant, output: Output<'_>, tape: &mut Tape<'_>) {
        match output {
            Output::Bytes { port, bytes } => {
                let Some(serial) = self.serial(port) else { return };
                let start = at.max(serial.sends_until);
                let line = serial.line_at(start);
                let character = if tape.fast { Duration::ZERO } else { line.character() };
                serial.began = Some(start);
                serial.sends_until = start + character * bytes.len() as u64;
                tape.outbox.sent.push(Sent { seat: self.seat, port, start, line, count: bytes.len() });
                tape.outbox.bytes.extend_from_slice(bytes);
            }
            Output::Line { port, line } => {
                if let Some(serial) = self.serial(port) {
                    serial.change(at, line);
                }
            }
            Output::Level { pin, level } => self.drive(pin, at, Drives::Level(level), tape.outbox),
            Output::Wave { pin, period, high } => {
                self.drive(pin, at, Drives::Wave { since: at, period, high }, tape.outbox);
            }
            Output::Plan { axis, plan } => {
                self.shape(axis, at, tape.outbox, |shaper| shaper.plan(at, plan));
                if let Some(axis) = self.axes.get_mut(usize::from(axis.0)) {
                    axis.forward = axis.forward_at(at);
                    (axis.plan, axis.steps, axis.stepped) = (*plan, 0, None);
                }
            }
            Output::Step { axis, steps } => {
                self.shape(axis, at, tape.outbox, |shaper| shaper.steps(at, steps));
                if let Some(axis) = self.axes.get_mut(usize::from(axis.0)) {
                    axis.steps = axis.steps.wrapping_add(steps);
                    axis.stepped = Some(steps > 0);
                }
            }
            Output::Current { axis, ma } => {
                if let Some(axis) = self.axes.get_mut(usize::from(axis.0)) {
                    axis.current_ma = ma;
                }
            }
            Output::Duty { axis, duty } => {
                if let Some(axis) = self.axes.get_mut(usize::from(axis.0)) {
                    axis.duty = duty;
                }
            }
            Output::Note(note) => self.count(note),
            // A store has its own way; of connections only the trace tells so far.
            Output::Store { .. } | Output::Message { .. } | Output::Close { .. } => {}
        }
    }

    fn count(&mut self, note: Note) {
        let (Note::Request { port, .. } | Note::Refused { port, .. } | Note::Dropped { port, .. }) = note;
        let Some(port) = self.ports.get_mut(usize::from(port.0)) else { return };
        let statistics = &mut port.statistics;
        *match note {
            Note::Request { .. } => &mut statistics.requests,
            Note::Refused { .. } => &mut statistics.refused,
            Note::Dropped { why, .. } => match why {
                Why::Crc => &mut statistics.crc,
                Why::Gap => &mut statistics.gap,
                Why::Length => &mut statistics.length,
                Why::Spoiled => &mut statistics.spoiled,
                Why::Address => &mut statistics.foreign,
                Why::Starting => &mut statistics.starting,
            },
        } += 1;
    }

    fn drive(&mut self, pin: Pin, at: Instant, drives: Drives, outbox: &mut Outbox) {
        let Some(state) = self.pins.get_mut(usize::from(pin.0)) else { return };
        state.drives = drives;
        state.changes = state.changes.wrapping_add(1);
        // Pulses and their direction come from the axis.
        let pulses = |axis: &AxisState| axis.step_dir.is_some_and(|(step, dir)| step == pin || dir == pin);
        if !state.drives_wires.is_empty() && !self.axes.iter().any(pulses) {
            let moved = match drives {
                Drives::Level(level) => Moved::Pin { pin, at, level },
                Drives::Wave { .. } => Moved::Wave { pin },
            };
            outbox.moved.push((self.seat, moved));
        }
    }

    /// Something happens to an axis: if somebody listens, its edges up to then come first.
    fn shape(&mut self, axis: Axis, at: Instant, outbox: &mut Outbox, happens: impl FnOnce(&mut Shaper)) {
        let Some(state) = self.axes.get_mut(usize::from(axis.0)) else { return };
        let mut moves = |state: &mut AxisState| {
            while let Some((pin, at, level)) = state.take(at) {
                outbox.moved.push((self.seat, Moved::Pin { pin, at, level }));
            }
        };
        moves(state);
        let Some(shaper) = &mut state.shaper else { return };
        happens(shaper);
        // Without power the outputs fall at once.
        moves(state);
        outbox.moved.push((self.seat, Moved::Axis { axis }));
    }

    /// A serial port.
    pub(crate) fn serial(&mut self, port: Port) -> Option<&mut Serial> {
        self.ports.get_mut(usize::from(port.0))?.serial.as_mut()
    }

    fn power_on(&mut self, at: Instant) {
        self.powered = true;
        for axis in &mut self.axes {
            (axis.plan, axis.steps, axis.current_ma, axis.duty) = (Plan::rest(at, 0), 0, 0, 0);
            (axis.forward, axis.stepped) = (false, None);
        }
        for serial in self.ports.iter_mut().filter_map(|port| port.serial.as_mut()) {
            serial.line = serial.factory;
            serial.later.clear();
        }
    }

    fn power_off(&mut self, at: Instant, outbox: &mut Outbox) {
        (self.powered, self.dead) = (false, false);
        for pin in (0..self.pins.len() as u8).map(Pin) {
            self.drive(pin, at, Drives::NOTHING, outbox);
        }
        for axis in (0..self.axes.len() as u8).map(Axis) {
            self.shape(axis, at, outbox, |shaper| shaper.power_off(at));
        }
        for axis in &mut self.axes {
            (axis.plan, axis.current_ma, axis.duty) = (axis.plan.halt(at), 0, 0);
            // DIR is low then, wherever it went last.
            axis.stepped = Some(false);
        }
    }

    fn cut(&mut self, cut: Option<Cut>) {
        self.cut = Some(match cut {
            Some(Cut { stores, bytes }) => Place { stores, part: Part::Bytes(bytes) },
            None => {
                // A save is two stores. After the whole first one is in its middle, after the second
                // is not.
                let stores = u32::from(self.dice.next() % 2 == 1);
                Place { stores, part: Part::Random { number: self.dice.next(), whole: stores == 0 } }
            }
        });
    }
}

impl AxisState {
    fn new(spec: &AxisSpec) -> Self {
        Self {
            step_dir: spec.step_dir,
            plan: Plan::rest(Instant::ZERO, 0),
            steps: 0,
            forward: false,
            stepped: None,
            current_ma: 0,
            duty: 0,
            shaper: None,
            changes: 0,
        }
    }

    /// The next edge for whoever is wired to the pulses, if it comes by `until`: of which pin, when,
    /// and to which level.
    fn take(&mut self, until: Instant) -> Option<(Pin, Instant, Level)> {
        let (step, dir) = self.step_dir?;
        let edge = self.shaper.as_mut()?.take(until)?;
        let pin = if edge.output == StepDir::Step { step } else { dir };
        Some((pin, edge.at, level_of(edge.high)))
    }

    /// Whether the last step by `at` was forward.
    fn forward_at(&self, at: Instant) -> bool {
        let speed = self.plan.speed_at(at);
        let moved = self.plan.position_at(at).wrapping_sub(self.plan.position_at(self.plan.start()));
        match self.stepped {
            _ if speed != 0 => speed > 0,
            Some(forward) => forward,
            None if moved != 0 => moved > 0,
            None => self.forward,
        }
    }
}

impl PinState {
    fn new(spec: &'static PinSpec) -> Self {
        let mut pin = Self {
            spec,
            hands: Driving::Open,
            held: Driving::Open,
            wired: Driving::Open,
            driven_by: Vec::new(),
            drives_wires: Vec::new(),
            told: Signal::Digital(false),
            train: None,
            trains: 0,
            drives: Drives::NOTHING,
            changes: 0,
        };
        pin.told = pin.signal(Driving::Open);
        pin
    }

    /// What the device sees of what has arrived: where hands let go wires decide.
    pub(crate) fn seen(&self) -> Signal {
        self.signal(if self.held == Driving::Open { self.wired } else { self.held })
    }

    /// What the device sees while that is done to the pin.
    fn signal(&self, drive: Driving) -> Signal {
        let rests_high = self.spec.rest == Level::High;
        if self.spec.role == Role::Analogue {
            return Signal::Millivolts(match drive {
                Driving::Millivolts(mv) => mv,
                Driving::High => LOGIC_HIGH_MV,
                Driving::Open if rests_high => LOGIC_HIGH_MV,
                Driving::Low | Driving::Open => 0,
            });
        }
        Signal::Digital(match drive {
            Driving::Low => false,
            Driving::High => true,
            Driving::Open => rests_high,
            Driving::Millivolts(mv) => mv > HIGH_MV,
        })
    }

    /// What is done to it from outside.
    fn outside(&self) -> Driving {
        if self.hands == Driving::Open { self.wired } else { self.hands }
    }

    /// Whether the device would see a high level now.
    pub(crate) fn is_high(&self) -> bool {
        match self.signal(self.outside()) {
            Signal::Digital(high) => high,
            Signal::Millivolts(mv) => mv > HIGH_MV,
        }
    }

    /// Whether the device sees something else than at rest.
    fn away(&self) -> bool {
        self.told != self.signal(Driving::Open)
    }

    /// The pin as it is seen from outside.
    fn level(&self, at: Instant) -> Level {
        match self.drives.level(at) {
            Level::Float if self.outside() == Driving::Open => self.spec.rest,
            Level::Float => level_of(self.is_high()),
            level => level,
        }
    }
}

impl Seated {
    /// A device without power, in its seat.
    pub(crate) fn new(
        seat: u32,
        name: &str,
        device: Box<dyn Device>,
        seed: u64,
        boot_fast: bool,
        memory: Option<Vec<u8>>,
        keep: Option<Keep>,
    ) -> Self {
        let spec = device.spec();
        let mut memory = memory.unwrap_or_default();
        memory.resize(usize::from(spec.memory), 0xFF);
        let serial = |line, silence| Serial {
            bus: 0,
            factory: line,
            line,
            later: Vec::new(),
            silence,
            began: None,
            sends_until: Instant::ZERO,
        };
        let ports = spec.ports.iter().map(|port| PortState {
            serial: port.line.map(|line| serial(line, port.ends == Ends::Silence)),
            statistics: Statistics::default(),
        });
        let body = Body {
            seat,
            memory,
            keep,
            powered: false,
            cut: None,
            dead: false,
            dice: Dice::new(seed, &format!("power cuts of {name}")),
            pins: spec.pins.iter().map(PinState::new).collect(),
            axes: spec.axes.iter().map(AxisState::new).collect(),
            encoders: spec.encoders.iter().map(|_| EncoderState::default()).collect(),
            ports: ports.collect(),
            faults: vec![false; spec.faults.len()],
        };
        let dice = Dice::new(seed, name);
        let last = (Instant::ZERO, Class::Power);
        Self {
            name: name.to_owned(),
            spec,
            device,
            body,
            boot_fast,
            presets: Vec::new(),
            dice,
            last,
            at_once: 0,
            deadline: Instant::NEVER,
        }
    }

    /// When it wants to be woken; without power never.
    pub(crate) fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Wakes it at its deadline; returns the next one.
    ///
    /// # Panics
    /// If it wants to be woken at one instant for ever: time would stand still.
    pub(crate) fn wake(&mut self, due: Instant, tape: &mut Tape<'_>) -> Instant {
        self.device.timeout(due, &mut Hand { body: &mut self.body, tape });
        let next = self.done(due, Class::Deadline, tape);
        if next > due {
            self.at_once = 0;
        } else {
            self.at_once += 1;
            assert!(self.at_once < MOST_AT_ONCE, "{}: deadline {due:?} comes again and again", self.name);
        }
        next
    }

    /// Sets what is preset after every power-on; returns what it refuses.
    pub(crate) fn preset_again(&mut self, at: Instant, tape: &mut Tape<'_>) -> Result<(), (usize, Refused)> {
        for n in 0..self.presets.len() {
            let (row, value) = self.presets[n];
            // A preset comes after the deadlines of its instant.
            while self.deadline() <= at {
                self.wake(self.deadline(), tape);
            }
            self.feed(at, &Fed::Poke { row, value }, tape).map_err(|why| (row, why))?;
        }
        Ok(())
    }

    /// Powers it on, untold by the trace: at the beginning that goes without saying.
    pub(crate) fn power_on(&mut self, at: Instant, tape: &mut Tape<'_>) {
        let boot = Boot { seed: self.dice.next(), fast: self.boot_fast };
        self.body.power_on(at);
        self.device.power_on(at, boot, &mut Hand { body: &mut self.body, tape });
        self.done(at, Class::Power, tape);
    }

    /// Notes what comes to it from outside, and says whether it hears it: not without power, and not
    /// on a pair of wires on which it sends.
    pub(crate) fn hears(&mut self, at: Instant, fed: &Fed) -> bool {
        match *fed {
            Fed::Edge { pin, high } => self.tell(pin, Signal::Digital(high)),
            Fed::Millivolts { pin, mv } => self.tell(pin, Signal::Millivolts(mv)),
            Fed::Fault { fault, on } => {
                if let Some(cause) = self.body.faults.get_mut(usize::from(fault.0)) {
                    *cause = on;
                }
            }
            Fed::Bytes { port, .. } | Fed::Spoiled { port } | Fed::Idle { port }
                if self.serial(port).is_some_and(|serial| serial.silence && serial.sends_until > at) =>
            {
                return false;
            }
            _ => {}
        }
        self.body.powered || matches!(fed, Fed::Power(_))
    }

    fn tell(&mut self, pin: Pin, signal: Signal) {
        if let Some(pin) = self.pin_mut(pin) {
            pin.told = signal;
        }
    }

    /// Feeds it. Without power it hears nothing.
    pub(crate) fn feed(&mut self, at: Instant, fed: &Fed, tape: &mut Tape<'_>) -> Result<(), Refused> {
        let heard = match fed {
            Fed::Power(Power::On) => !self.body.powered,
            Fed::Power(Power::Cut(_)) => true,
            _ => self.body.powered,
        };
        if !heard {
            return Ok(());
        }
        let mark = tape.trace.mark();
        tape.trace.fed(at, self.body.seat, fed);
        match *fed {
            Fed::Power(Power::On) => self.power_on(at, tape),
            Fed::Power(Power::Off) => self.body.power_off(at, tape.outbox),
            Fed::Power(Power::Cut(cut)) => self.body.cut(cut),
            Fed::Poke { row, value } => {
                let hand = &mut Hand { body: &mut self.body, tape };
                if let Err(why) = self.device.poke(at, row, value, hand) {
                    tape.trace.rewind(mark);
                    return Err(why);
                }
            }
            _ => {
                if let Some(input) = fed.input() {
                    self.device.input(at, input, &mut Hand { body: &mut self.body, tape });
                }
            }
        }
        self.done(at, Class::of(fed), tape);
        Ok(())
    }

    /// Puts a value into its memory before its first power-on.
    pub(crate) fn preset(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        tape: &mut Tape<'_>,
    ) -> Result<(), Refused> {
        self.device.poke(at, row, value, &mut Hand { body: &mut self.body, tape })
    }

    /// After a call of the device: whether that was its last, and its next deadline.
    fn done(&mut self, at: Instant, class: Class, tape: &mut Tape<'_>) -> Instant {
        self.last = (at, class);
        if self.body.dead {
            self.body.power_off(at, tape.outbox);
        }
        self.deadline = if self.body.powered { self.device.deadline() } else { Instant::NEVER };
        self.deadline
    }

    /// The first instant from `now` on at which something of that class can still come to it.
    pub(crate) fn free(&self, now: Instant, class: Class) -> Instant {
        if self.last > (now, class) { now + Duration::TICK } else { now }
    }

    /// All that differs from rest, and that it must be told when power comes: faults, then pins.
    pub(crate) fn surroundings(&self) -> Vec<Fed> {
        let faults = (0..).zip(&self.body.faults).filter(|(_, on)| **on);
        let pins = (0..).zip(&self.body.pins).filter(|(_, pin)| pin.away());
        faults
            .map(|(place, _)| Fed::Fault { fault: Fault(place), on: true })
            .chain(pins.map(|(place, pin)| pin.told.fed(Pin(place))))
            .collect()
    }

    /// A pin.
    pub(crate) fn pin_mut(&mut self, pin: Pin) -> Option<&mut PinState> {
        self.body.pins.get_mut(usize::from(pin.0))
    }

    /// A pin.
    pub(crate) fn pin(&self, pin: Pin) -> Option<&PinState> {
        self.body.pins.get(usize::from(pin.0))
    }

    /// An encoder input, and its pins.
    pub(crate) fn encoder_mut(
        &mut self,
        encoder: Encoder,
    ) -> Option<(&mut EncoderState, &'static EncoderSpec)> {
        let place = usize::from(encoder.0);
        Some((self.body.encoders.get_mut(place)?, self.spec.encoders.get(place)?))
    }

    /// The encoder inputs of which a pin is A or B.
    pub(crate) fn encoders_at(&mut self, pin: Pin) -> impl Iterator<Item = &mut EncoderState> {
        let encoders = self.body.encoders.iter_mut().zip(self.spec.encoders);
        encoders.filter(move |(_, spec)| spec.a == pin || spec.b == pin).map(|(state, _)| state)
    }

    /// A serial port.
    pub(crate) fn serial(&self, port: Port) -> Option<&Serial> {
        self.body.ports.get(usize::from(port.0))?.serial.as_ref()
    }

    /// When it began to send its last message on the port that `fed` comes to.
    pub(crate) fn began(&self, fed: &Fed) -> Option<Instant> {
        match *fed {
            Fed::Bytes { port, .. } | Fed::Spoiled { port } | Fed::Idle { port } => self.serial(port)?.began,
            _ => None,
        }
    }

    /// The settings of a character that begins at `at`; `None` if that is no serial port.
    pub(crate) fn line_at(&self, port: Port, at: Instant) -> Option<Line> {
        self.serial(port).map(|serial| serial.line_at(at))
    }

    /// The line that a serial port is on.
    pub(crate) fn bus(&self, port: Port) -> Option<u32> {
        self.serial(port).map(|serial| serial.bus)
    }

    /// Puts a serial port on a line.
    pub(crate) fn set_bus(&mut self, port: Port, bus: usize) {
        if let Some(serial) = self.body.serial(port) {
            serial.bus = bus as u32;
        }
    }

    /// A register as it reads at `at`.
    pub(crate) fn peek(&self, at: Instant, row: usize) -> i64 {
        self.device.peek(at, row)
    }

    /// A pin as it is seen from outside.
    pub(crate) fn level(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.level(at)),
        }
    }

    /// The level of STEP or DIR; `None` for any other pin.
    fn pulses_at(&self, at: Instant, pin: Pin) -> Option<Level> {
        let axis = self.body.axes.get(usize::from(self.axis_at(pin)?.0))?;
        let mut shaper = match &axis.shaper {
            Some(shaper) => shaper.clone(),
            None if self.body.powered => {
                // No pulse is longer.
                let from = axis.plan.start().max(at - HIGH);
                Shaper::new(from, &axis.plan, axis.forward_at(from))
            }
            None => Shaper::default(),
        };
        while shaper.take(at).is_some() {}
        let (step, _) = axis.step_dir?;
        let output = if pin == step { StepDir::Step } else { StepDir::Dir };
        Some(level_of(shaper.is_high(output)))
    }

    /// What a device does with a pin.
    pub(crate) fn driven(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.drives.level(at)),
        }
    }

    /// When a wave on an output changes next, and the number of that change.
    pub(crate) fn wave_after(&self, at: Instant, pin: Pin) -> Option<(Instant, u32)> {
        let pin = self.pin(pin)?;
        let due = pin.drives.next_edge(at);
        (due < Instant::NEVER).then_some((due, pin.changes))
    }

    /// The axis of which a pin is STEP or DIR.
    pub(crate) fn axis_at(&self, pin: Pin) -> Option<Axis> {
        let mut axes = (0..).map(Axis).zip(self.spec.axes);
        axes.find(|(_, axis)| axis.step_dir.is_some_and(|(step, dir)| step == pin || dir == pin))
            .map(|(axis, _)| axis)
    }

    /// Somebody is wired to the pulses of an axis from now on.
    pub(crate) fn listen(&mut self, at: Instant, axis: Axis) {
        let powered = self.body.powered;
        let Some(axis) = self.body.axes.get_mut(usize::from(axis.0)).filter(|axis| axis.shaper.is_none())
        else {
            return;
        };
        let shaper =
            if powered { Shaper::new(at, &axis.plan, axis.forward_at(at)) } else { Shaper::default() };
        axis.shaper = Some(shaper);
    }

    /// When the next edge of an axis is due, and a number that tells it from those foreseen earlier.
    pub(crate) fn next_edge(&mut self, axis: Axis) -> Option<(Instant, u32)> {
        let axis = self.body.axes.get_mut(usize::from(axis.0))?;
        axis.changes = axis.changes.wrapping_add(1);
        Some((axis.shaper.as_ref()?.due(), axis.changes))
    }

    /// The edge of an axis that was foreseen under that number, and due by `until`.
    pub(crate) fn take_edge(&mut self, axis: Axis, number: u32, until: Instant) -> Option<(Pin, Level)> {
        let axis = self.body.axes.get_mut(usize::from(axis.0)).filter(|axis| axis.changes == number)?;
        axis.take(until).map(|(pin, _, level)| (pin, level))
    }

    /// What an axis does.
    pub(crate) fn motion(&self, at: Instant, axis: Axis) -> Motion {
        let Some(axis) = self.body.axes.get(usize::from(axis.0)) else { return Motion::default() };
        let speed: I48F16 = axis.plan.speed_at(at);
        Motion {
            position: axis.plan.position_at(at).wrapping_add(axis.steps),
            speed,
            moving: axis.plan.end() > at || axis.duty != 0,
            current_ma: axis.current_ma,
            duty: axis.duty,
        }
    }
}
