//! A drive on a bench: its deadlines, its inputs, and its state as visible from outside.

mod axis;
mod pins;
mod reception;
mod serial_port;
mod state;
mod tcp_port;

use std::sync::Arc;

use drivetwin_firmware::device::{
    Axis, Boot, Device, DropReason, Duration, Encoder, EncoderSpec, Fault, Instant, Level, Line, LogEvent,
    Pin, Port, PresetError, Rotation, Shaft, Spec,
};
use drivetwin_firmware::motor::Parameters;

use crate::record::effects::FrameEffects;
use crate::record::journal::{Entry, Outcome};
use crate::record::trace::{InputRecord, Power, Trace};
use crate::rng::Rng;
use crate::scheduler::Phase;
pub use crate::signals::motion::Motion;
pub use pins::PinStimulus;
pub(crate) use pins::{EdgeTrain, EncoderState, PinState, PulseTrain, Signal};
pub(crate) use serial_port::Serial;
pub use serial_port::Statistics;
pub use state::PersistFn;
pub(crate) use state::{CallContext, MotorCommand, Outputs, PinChange, Sent, TcpSend};
use state::{SlotContext, SlotState};
pub use tcp_port::MOST_CONNECTIONS;
pub(crate) use tcp_port::Tcp;

/// A whole RTU frame, and its end at the same instant, on a line on which characters take no time.
#[derive(Clone, Copy)]
pub(crate) struct WholeFrame<'a> {
    pub(crate) port: Port,
    pub(crate) address: u8,
    pub(crate) bytes: &'a Arc<[u8]>,
    /// Time at which a drive of the line began to send the frame; `None` if a client sends it.
    pub(crate) began: Option<Instant>,
}

/// A drive and its surroundings.
pub(crate) struct Slot {
    pub(crate) name: String,
    pub(crate) spec: &'static Spec,
    device: Box<dyn Device>,
    pub(crate) state: SlotState,
    boot_fast: bool,
    /// Pins of the drive for Hall sensors, if its internal motor is detached.
    pub(crate) halls: Option<&'static [Pin]>,
    /// Parameters of the detached motor, from the drive's registers after the first power-on.
    pub(crate) detached_motor: Option<Parameters>,
    /// The last reports of a motor that is not on this bench, in a replay: parameters, rotation, current.
    reported: (Option<Parameters>, Option<Rotation>, i32),
    /// Axes with an attached motor, and the index of each motor.
    pub(crate) motors: Vec<(Axis, u32)>,
    /// Presets for every power-on: row and value.
    pub(crate) presets: Vec<(usize, i64)>,
    /// Random numbers: the seed of the drive at each power-on.
    rng: Rng,
    /// Time and phase of the last event. No later event may come before them.
    last: (Instant, Phase),
    wakes: Wakes,
    /// Next deadline; [`Instant::NEVER`] if power is off.
    deadline: Instant,
    /// Time at which power went off last.
    off_since: Instant,
}

impl Slot {
    /// A drive whose power is off.
    pub(crate) fn new(
        drive: u32,
        name: &str,
        device: Box<dyn Device>,
        seed: u64,
        boot_fast: bool,
        memory: Arc<[u8]>,
        persist: Option<PersistFn>,
    ) -> Self {
        let spec = device.spec();
        let state = SlotState::new(drive, name, spec, seed, memory, persist);
        let rng = Rng::new(seed, name);
        let last = (Instant::ZERO, Phase::Power);
        Self {
            name: name.to_owned(),
            spec,
            device,
            state,
            boot_fast,
            halls: None,
            detached_motor: None,
            reported: (None, None, 0),
            motors: Vec::new(),
            presets: Vec::new(),
            rng,
            last,
            wakes: Wakes::default(),
            deadline: Instant::NEVER,
            off_since: Instant::ZERO,
        }
    }

    /// Next deadline; [`Instant::NEVER`] if power is off.
    pub(crate) fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Detaches the internal motor; to be called before the first power-on.
    pub(crate) fn detach_motor(&mut self) {
        self.halls = self.device.detach_motor();
    }

    /// Records the parameters of the detached motor; to be called after the first power-on.
    pub(crate) fn record_detached_motor(&mut self) {
        self.detached_motor = self.halls.and_then(|_| self.device.internal_motor());
    }

    /// Attaches a motor of the bench to an axis. Returns the commands that give the motor the present state
    /// of the axis, in their order.
    pub(crate) fn turns(&mut self, axis: Axis, motor: u32) -> Vec<MotorCommand> {
        self.motors.push((axis, motor));
        let microsteps = MotorCommand::Microsteps(self.microsteps(axis));
        let Some(state) = self.state.axis(axis) else { return Vec::new() };
        state.turns_motor = true;
        std::iter::once(microsteps).chain(state.motor_commands()).collect()
    }

    /// Returns true if a TCP port accepts connections.
    pub(crate) fn accepts(&self, port: Port) -> bool {
        self.device.accepts(port)
    }

    /// Returns true if the drive takes messages on a TCP port, or if power is off.
    pub(crate) fn takes(&self, port: Port) -> bool {
        !self.state.powered || self.device.takes(port)
    }

    /// Number of steps in a motion plan per full step of the motor on an axis.
    pub(crate) fn microsteps(&self, axis: Axis) -> u16 {
        self.device.microsteps(axis)
    }

    /// Calls the drive at its deadline. Returns the next deadline.
    ///
    /// # Panics
    /// If the drive sets deadlines at the same instant forever, so that time cannot advance.
    pub(crate) fn wake(&mut self, due: Instant, context: &mut CallContext<'_>) -> Instant {
        self.device.timeout(due, &mut SlotContext { state: &mut self.state, context });
        let next = self.done(due, Phase::Deadline, context);
        self.wakes.count(&self.name, due, next);
        next
    }

    /// Applies the presets for every power-on. An error contains the row that the drive refuses.
    pub(crate) fn preset_again(
        &mut self,
        at: Instant,
        context: &mut CallContext<'_>,
    ) -> Result<(), (usize, PresetError)> {
        for n in 0..self.presets.len() {
            let (row, value) = self.presets[n];
            // A preset is applied after the deadlines of its instant.
            while self.deadline() <= at {
                self.wake(self.deadline(), context);
            }
            self.feed(at, &InputRecord::Poke { row, value }, context).map_err(|why| (row, why))?;
        }
        Ok(())
    }

    /// Powers the drive on. This is not recorded in the trace: the initial power-on is implied.
    pub(crate) fn power_on(&mut self, at: Instant, context: &mut CallContext<'_>) {
        let boot = Boot { seed: self.rng.next(), fast: self.boot_fast, fast_line: context.fast };
        self.state.power_on(at);
        self.device.power_on(at, boot, &mut SlotContext { state: &mut self.state, context });
        self.done(at, Phase::Power, context);
    }

    /// Powers the drive off.
    fn power_off(&mut self, at: Instant, outputs: &mut Outputs) {
        self.off_since = at;
        self.device.power_off(at);
        self.state.power_off(at, outputs);
    }

    /// The instant at which the drive is asked for its state: now, or the last one with power.
    fn asked_at(&self, now: Instant) -> Instant {
        if self.state.powered { now } else { self.off_since }
    }

    /// Updates the signal of a pin or the cause of a fault. Returns true if the drive receives the input. If
    /// power is off, it receives only changes of power; while it sends on a half-duplex line, it receives no
    /// characters.
    pub(crate) fn receives(&mut self, at: Instant, input: &InputRecord) -> bool {
        match *input {
            InputRecord::Edge { pin, high } => self.set_reported(pin, Signal::Digital(high)),
            InputRecord::Millivolts { pin, mv } => self.set_reported(pin, Signal::Millivolts(mv)),
            InputRecord::Open { pin } => self.set_reported(pin, Signal::Open),
            InputRecord::Fault { fault, on } => {
                if let Some(cause) = self.state.faults.get_mut(usize::from(fault.0)) {
                    *cause = on;
                }
            }
            InputRecord::Bytes { port, .. } | InputRecord::RxError { port } | InputRecord::Idle { port }
                if self.serial(port).is_some_and(|serial| serial.framed && serial.sends_until > at) =>
            {
                return false;
            }
            _ => {}
        }
        self.state.powered || matches!(input, InputRecord::Power(_))
    }

    fn set_reported(&mut self, pin: Pin, signal: Signal) {
        if let Some(pin) = self.pin_mut(pin) {
            pin.reported = signal;
        }
    }

    /// Delivers an input and records it. While power is off, only inputs that change the power have an
    /// effect.
    pub(crate) fn feed(
        &mut self,
        at: Instant,
        input: &InputRecord,
        context: &mut CallContext<'_>,
    ) -> Result<(), PresetError> {
        let is_input = match input {
            InputRecord::Power(Power::On) => !self.state.powered,
            InputRecord::Power(Power::Cut(_)) => true,
            _ => self.state.powered,
        };
        if !is_input {
            return Ok(());
        }
        let mark = context.trace.position();
        context.trace.record_input(at, self.state.drive, input);
        match *input {
            InputRecord::Power(Power::On) => self.power_on(at, context),
            InputRecord::Power(Power::Off) => self.power_off(at, context.outputs),
            InputRecord::Power(Power::Cut(cut)) => self.state.cut(cut),
            InputRecord::Poke { row, value } => {
                let sink = &mut SlotContext { state: &mut self.state, context };
                if let Err(why) = self.device.poke(at, row, value, sink) {
                    context.trace.rewind(mark);
                    return Err(why);
                }
            }
            _ => {
                let afterwards = self.notes_afterwards(input);
                if !afterwards {
                    self.note_reception(at, input, context.fast);
                }
                self.note_report(input);
                if let Some(input) = input.input() {
                    self.device.input(at, input, &mut SlotContext { state: &mut self.state, context });
                }
                if afterwards {
                    // A drive that starts does not report characters with an error.
                    if let InputRecord::RxError { port } = *input
                        && at < self.device.receives_from()
                    {
                        self.state.reception.ignore(port, Outcome::Dropped(DropReason::Starting));
                    }
                    self.note_reception(at, input, context.fast);
                }
            }
        }
        self.done(at, Phase::of(input), context);
        Ok(())
    }

    /// Records a frame that has no effect on the drive because it is for others, without a call of the drive. Returns
    /// false if the frame must be delivered: it has an effect, or it is the first of its kind, which the drive reports
    /// for all.
    pub(crate) fn ignores(
        &mut self,
        at: Instant,
        frame: WholeFrame<'_>,
        context: &mut CallContext<'_>,
    ) -> bool {
        let WholeFrame { port, address, bytes, began } = frame;
        let (state, device) = (&mut self.state, &self.device);
        let is_reported = || began.is_some() || state.is_reported(port, at, context.outputs);
        let is_idle = state.powered && self.deadline > at && !context.shafts;
        let ignores = is_idle
            && state.hears_alone(port, at, began)
            && is_reported()
            && device.is_for_others(at, port, address);
        if ignores {
            context.trace.record_frame(at, state.drive, port, bytes);
            state.count(LogEvent::Dropped { port, why: DropReason::Address });
            self.last = (at, Phase::Line);
        }
        ignores
    }

    /// Returns true if the drive reports the outcome of earlier characters during a call with this input.
    fn notes_afterwards(&self, input: &InputRecord) -> bool {
        match input {
            InputRecord::Bytes { port, .. } | InputRecord::RxError { port } => {
                self.state.reception.notes_afterwards(*port)
            }
            _ => false,
        }
    }

    /// Notes what the drive receives, for its journal.
    fn note_reception(&mut self, at: Instant, input: &InputRecord, fast: bool) {
        let (device, powered) = (&self.device, self.state.powered);
        let is_deaf = || !powered || at < device.receives_from();
        let (port, bytes) = match input {
            InputRecord::Bytes { port, bytes } => (*port, &**bytes),
            InputRecord::RxError { port } => (*port, &[][..]),
            InputRecord::Message { port, link, bytes } => {
                return self.state.reception.message(at, *port, *link, bytes, is_deaf);
            }
            InputRecord::Closed { port, link } => {
                if let Some(port) = self.state.ports.get_mut(usize::from(port.0)) {
                    (port.on_request, port.on_echo) = (FrameEffects::NONE, FrameEffects::NONE);
                }
                return self.state.reception.closed(*port, *link);
            }
            InputRecord::HostPresence { port, here: true } => return self.state.reception.opened(*port),
            _ => return,
        };
        if self.state.reception.overhears {
            return self.state.reception.overhear(port);
        }
        let serial = self.state.ports.get(usize::from(port.0)).and_then(|port| port.serial.as_ref());
        let Some(line) = serial.map(|serial| serial.line_at(at)) else { return };
        let character = if fast || bytes.len() < 2 { Duration::ZERO } else { line.character() };
        self.state.reception.characters(at, port, line, character, bytes, is_deaf);
    }

    /// Notes what the drive does not receive. Returns an entry for the journal when a message is complete.
    pub(crate) fn misses(&mut self, at: Instant, input: &InputRecord, fast: bool) -> Option<Entry> {
        let (port, count) = match input {
            InputRecord::Bytes { port, bytes } => (*port, bytes.len()),
            InputRecord::RxError { port } => (*port, 0),
            _ => return None,
        };
        let framed = self.serial(port)?.framed;
        if self.state.reception.overhears {
            return None;
        }
        let outcome = if self.state.powered { Outcome::Sending } else { Outcome::NoPower };
        if framed && count < 2 {
            self.state.reception.ignore(port, outcome);
            self.note_reception(at, input, fast);
            return None;
        }
        self.note_reception(at, input, fast);
        self.state.reception.missed(port, outcome)
    }

    /// The entry of a frame on a half-duplex line that has ended, if its characters arrived one by one and the drive
    /// did not receive them.
    pub(crate) fn missed_frame(&mut self, port: Port) -> Option<Entry> {
        self.state.reception.missed_frame(port).map(|entry| self.with_time_left(entry))
    }

    /// The entry of characters with errors on a port with text, when no more follow at once.
    pub(crate) fn unreadable(&mut self, port: Port) -> Option<Entry> {
        self.state.reception.unreadable(port).map(|entry| self.with_time_left(entry))
    }

    /// The entry with the time until the drive receives, if the drive was starting.
    fn with_time_left(&self, mut entry: Entry) -> Entry {
        if entry.outcome == Outcome::Dropped(DropReason::Starting) {
            let from = self.receives_from();
            entry.deaf_for = (from < Instant::NEVER).then(|| from.since(entry.at));
        }
        entry
    }

    /// Writes a preset to the memory; to be called before the first power-on (PROJECT-6).
    pub(crate) fn preset(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        context: &mut CallContext<'_>,
    ) -> Result<(), PresetError> {
        self.device.poke(at, row, value, &mut SlotContext { state: &mut self.state, context })
    }

    /// Handles the end of a call of the drive: a power cut, and the next deadline.
    fn done(&mut self, at: Instant, phase: Phase, context: &mut CallContext<'_>) -> Instant {
        self.last = (at, phase);
        if self.state.reception.is_touched() {
            let device = &self.device;
            if let Some(row) = self.spec.last_error {
                self.state.reception.note_error(|| device.peek(at, row) as u8);
            }
            let last = self.state.reception.finish(|| device.receives_from());
            for entry in self.state.reception.earlier_entries() {
                self.state.enter(entry, context.outputs);
            }
            if let Some(entry) = last {
                self.state.enter(entry, context.outputs);
            }
        }
        if let Some((port, bytes)) = self.state.reception.take_own() {
            self.state.own_messages.push(&mut context.outputs.own_messages, at, port, bytes);
        }
        if self.state.dead {
            self.power_off(at, context.outputs);
        }
        if context.shafts {
            self.record_shafts(at, context);
        }
        self.deadline = if self.state.powered { self.device.deadline() } else { Instant::NEVER };
        self.deadline
    }

    /// Notes a report of a motor.
    fn note_report(&mut self, input: &InputRecord) {
        let (parameters, rotation, ma) = &mut self.reported;
        match input {
            InputRecord::Motor { parameters: reported, .. } => *parameters = Some(**reported),
            InputRecord::Rotation { rotation: reported, .. } => *rotation = Some(reported.limited()),
            InputRecord::MotorCurrent { ma: reported, .. } => *ma = *reported,
            _ => {}
        }
    }

    /// The motion of a motor that is not on this bench, as it reported it last.
    fn reported_shaft(&self, axis: Axis) -> Option<Shaft> {
        let (Some(parameters), Some(rotation), ma) = self.reported else { return None };
        let commanded = &self.state.axes.get(usize::from(axis.0))?.commanded;
        let is_apart = self.halls.is_some() && self.motors.is_empty();
        let duty = if commanded.current_ma > 0 { commanded.duty } else { 0 };
        is_apart.then(|| parameters.shaft(rotation, duty, ma))
    }

    /// Records the motion of the internal motor, or of a motor that reports from another bench.
    fn record_shafts(&mut self, at: Instant, context: &mut CallContext<'_>) {
        for axis in (0..self.spec.axes.len() as u8).map(Axis) {
            if let Some(shaft) = self.device.shaft(at, axis).or_else(|| self.reported_shaft(axis)) {
                self.record_shaft(at, axis, shaft, context.trace);
            }
        }
    }

    /// Records the motion of a motor, unless it is like the last record, or power is off.
    pub(crate) fn record_shaft(&mut self, at: Instant, axis: Axis, shaft: Shaft, trace: &mut Trace) {
        let drive = self.state.drive;
        let powered = self.state.powered;
        if let Some(state) = self.state.axis(axis).filter(|_| powered)
            && state.sampler.takes(at, shaft)
        {
            trace.record_shaft(at, drive, axis, shaft);
        }
    }

    /// Number of the line of the user program that is executed next.
    pub(crate) fn program_line(&self) -> Option<u16> {
        if self.state.powered { self.device.program_line() } else { None }
    }

    /// Time from which the drive receives what arrives at its ports.
    pub(crate) fn receives_from(&self) -> Instant {
        self.device.receives_from()
    }

    /// Returns true if the drive turns a brush or brushless motor, internal or of the bench.
    pub(crate) fn turns_motor(&self) -> bool {
        self.device.internal_motor().is_some()
    }

    /// Earliest time, `now` or one tick later, at which the drive can still receive an event of that phase.
    pub(crate) fn free(&self, now: Instant, phase: Phase) -> Instant {
        if self.last > (now, phase) { now + Duration::TICK } else { now }
    }

    /// Inputs to report at power-on: first the faults, then the pins that differ from the state that a drive
    /// assumes then.
    pub(crate) fn state_to_report(&self) -> Vec<InputRecord> {
        let faults = (0..).zip(&self.state.faults).filter(|(_, on)| **on);
        let pins = (0..).zip(&self.state.pins).filter(|(_, pin)| pin.is_news());
        faults
            .map(|(index, _)| InputRecord::Fault { fault: Fault(index), on: true })
            .chain(pins.map(|(index, pin)| pin.reported.input(Pin(index))))
            .collect()
    }

    /// A pin.
    pub(crate) fn pin_mut(&mut self, pin: Pin) -> Option<&mut PinState> {
        self.state.pins.get_mut(usize::from(pin.0))
    }

    /// A pin.
    pub(crate) fn pin(&self, pin: Pin) -> Option<&PinState> {
        self.state.pins.get(usize::from(pin.0))
    }

    /// An encoder input, and its description with its pins.
    pub(crate) fn encoder_mut(
        &mut self,
        encoder: Encoder,
    ) -> Option<(&mut EncoderState, &'static EncoderSpec)> {
        let index = usize::from(encoder.0);
        Some((self.state.encoders.get_mut(index)?, self.spec.encoders.get(index)?))
    }

    /// The encoder inputs that have a pin as A or B.
    pub(crate) fn encoders_at(&mut self, pin: Pin) -> impl Iterator<Item = &mut EncoderState> {
        let encoders = self.state.encoders.iter_mut().zip(self.spec.encoders);
        encoders.filter(move |(_, spec)| spec.a == pin || spec.b == pin).map(|(state, _)| state)
    }

    /// Changes the settings of a serial port after all queued characters have left.
    pub(crate) fn change_line(&mut self, at: Instant, port: Port, line: Line) {
        if let Some(serial) = self.state.serial(port) {
            serial.change(at, line);
        }
    }

    /// A serial port.
    pub(crate) fn serial(&self, port: Port) -> Option<&Serial> {
        self.state.ports.get(usize::from(port.0))?.serial.as_ref()
    }

    /// Start of the last message that the drive sent on the port of `input`; `None` if `input` has no
    /// characters.
    pub(crate) fn began(&self, input: &InputRecord) -> Option<Instant> {
        match *input {
            InputRecord::Bytes { port, .. } | InputRecord::RxError { port } | InputRecord::Idle { port } => {
                self.serial(port)?.began
            }
            _ => None,
        }
    }

    /// Serial settings of a character that begins at `at`; `None` if the port is not serial.
    pub(crate) fn line_at(&self, port: Port, at: Instant) -> Option<Line> {
        self.serial(port).map(|serial| serial.line_at(at))
    }

    /// The line that a serial port is on.
    pub(crate) fn bus(&self, port: Port) -> Option<u32> {
        self.serial(port).map(|serial| serial.bus)
    }

    /// Puts a serial port on a line.
    pub(crate) fn set_bus(&mut self, port: Port, bus: usize) {
        if let Some(serial) = self.state.serial(port) {
            serial.bus = bus as u32;
        }
    }

    /// Value of a register, as it would be read at `at`; without power its last value.
    pub(crate) fn peek(&self, at: Instant, row: usize) -> i64 {
        self.device.peek(self.asked_at(at), row)
    }

    /// A word of a register that has more than four words.
    pub(crate) fn peek_word(&self, at: Instant, row: usize, word: usize) -> u16 {
        self.device.peek_word(self.asked_at(at), row, word)
    }

    /// The level at a pin, as measured from outside (HOST-12).
    pub(crate) fn level(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.level(at)),
        }
    }

    /// The level of STEP or DIR; `None` for any other pin, and while the drive uses the pin itself.
    fn pulses_at(&self, at: Instant, pin: Pin) -> Option<Level> {
        self.state.axes.iter().find_map(|axis| axis.level(at, pin, self.state.powered))
    }

    /// The level that the drive outputs at a pin.
    pub(crate) fn driven(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.drives.level(at)),
        }
    }

    /// Time of the next edge of a wave on an output, and the count of output changes, which identifies this
    /// wave.
    pub(crate) fn wave_after(&self, at: Instant, pin: Pin) -> Option<(Instant, u32)> {
        let pin = self.pin(pin)?;
        let due = pin.drives.next_edge(at);
        (due < Instant::NEVER).then_some((due, pin.changes))
    }

    /// The axis of which a pin is STEP or DIR.
    pub(crate) fn axis_at(&self, pin: Pin) -> Option<Axis> {
        (0..)
            .map(Axis)
            .zip(&self.state.axes)
            .find(|(_, axis)| axis.output(pin).is_some())
            .map(|(axis, _)| axis)
    }

    /// Generates the step pulses of an axis from `at` on, because a wire needs them.
    pub(crate) fn listen(&mut self, at: Instant, axis: Axis) {
        let powered = self.state.powered;
        if let Some(axis) = self.state.axis(axis) {
            axis.listen(at, powered);
        }
    }

    /// Time of the next edge of an axis, and a number that identifies this prediction.
    pub(crate) fn next_edge(&mut self, axis: Axis) -> Option<(Instant, u32)> {
        self.state.axis(axis)?.next_edge()
    }

    /// Takes the edge of an axis that was predicted under that number, if it is due by `until`. The level is
    /// `None` while the drive uses the pin for another purpose.
    pub(crate) fn take_edge(
        &mut self,
        axis: Axis,
        number: u32,
        until: Instant,
    ) -> Option<(Pin, Option<Level>)> {
        self.state.axis(axis)?.take_edge(number, until)
    }

    /// Motion of an axis: that of the internal motor if there is one, otherwise as commanded.
    pub(crate) fn motion(&self, at: Instant, axis: Axis) -> Motion {
        let commanded = || self.state.axes.get(usize::from(axis.0)).map(|axis| axis.commanded.motion(at));
        self.device.shaft(at, axis).map(Motion::from).or_else(commanded).unwrap_or_default()
    }
}

/// Number of consecutive calls that each set the next deadline to the same instant.
#[derive(Default)]
pub(crate) struct Wakes(u32);

impl Wakes {
    /// Number of calls at one instant after which a drive counts as hanging.
    const MOST: u32 = 1_000_000;

    /// Counts a call at `due` that set the next deadline to `next`.
    ///
    /// # Panics
    /// If the drive sets deadlines at the same instant forever, so that time cannot advance.
    pub(crate) fn count(&mut self, name: &str, due: Instant, next: Instant) {
        self.0 = if next > due { 0 } else { self.0 + 1 };
        assert!(
            self.0 < Self::MOST,
            "{name}: it sets the deadline {due:?} again and again, so time cannot advance"
        );
    }
}

#[cfg(test)]
mod tests;
