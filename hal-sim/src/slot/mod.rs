//! A device on a bench: its wake-ups, its inputs, and its state as others see it.

mod axis;
mod pins;
mod serial_port;
mod state;
mod tcp_port;

use drivetwin_firmware::device::{
    Axis, Boot, Device, Duration, Encoder, EncoderSpec, Fault, Instant, Level, Line, Pin, Port, PresetError,
    Spec,
};
use drivetwin_firmware::motor::Parameters;

use crate::record::trace::{InputRecord, Power};
use crate::rng::Rng;
use crate::scheduler::Phase;
pub use axis::Motion;
pub use pins::PinStimulus;
pub(crate) use pins::{EdgeTrain, EncoderState, PinState, PulseTrain, Signal};
pub(crate) use serial_port::Serial;
pub use serial_port::Statistics;
pub use state::PersistFn;
pub(crate) use state::{CallContext, MotorCommand, Outputs, PinChange, Sent, TcpSend};
use state::{SlotContext, SlotState};
pub use tcp_port::MOST_CONNECTIONS;
pub(crate) use tcp_port::Tcp;

/// A device, and all that it has to do with.
pub(crate) struct Slot {
    pub(crate) name: String,
    pub(crate) spec: &'static Spec,
    device: Box<dyn Device>,
    pub(crate) body: SlotState,
    boot_fast: bool,
    /// Once it has parted from the motor that it brings: its pins for the Hall sensors.
    pub(crate) halls: Option<&'static [Pin]>,
    /// And that motor, as its registers described it after its first power-on.
    pub(crate) parted: Option<Parameters>,
    /// Motors of the bench that it turns.
    pub(crate) motors: Vec<(Axis, u32)>,
    /// Rows that are set after every power-on, and their values.
    pub(crate) presets: Vec<(usize, i64)>,
    /// Seeds of its random choices, one for each power-on.
    dice: Rng,
    /// The last that happened to it: nothing can come before it any more.
    last: (Instant, Phase),
    wakes: Wakes,
    /// Next wake-up; without power never.
    deadline: Instant,
}

impl Slot {
    /// A device without power, in its seat.
    pub(crate) fn new(
        seat: u32,
        name: &str,
        device: Box<dyn Device>,
        seed: u64,
        boot_fast: bool,
        memory: Option<Vec<u8>>,
        keep: Option<PersistFn>,
    ) -> Self {
        let spec = device.spec();
        let body = SlotState::new(seat, name, spec, seed, memory, keep);
        let dice = Rng::new(seed, name);
        let last = (Instant::ZERO, Phase::Power);
        Self {
            name: name.to_owned(),
            spec,
            device,
            body,
            boot_fast,
            halls: None,
            parted: None,
            motors: Vec::new(),
            presets: Vec::new(),
            dice,
            last,
            wakes: Wakes::default(),
            deadline: Instant::NEVER,
        }
    }

    /// Next wake-up; without power never.
    pub(crate) fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Parts from the motor that it brings, before its first power-on.
    pub(crate) fn part(&mut self) {
        self.halls = self.device.detach_motor();
    }

    /// After its first power-on: what the motor is that it has parted from.
    pub(crate) fn know_parted(&mut self) {
        self.parted = self.halls.and_then(|_| self.device.internal_motor());
    }

    /// An axis turns a motor of the bench from now on; returns what that must know, in the order in which it is
    /// [told](MotorCommand).
    pub(crate) fn turns(&mut self, axis: Axis, motor: u32) -> Vec<MotorCommand> {
        self.motors.push((axis, motor));
        let microsteps = MotorCommand::Microsteps(self.microsteps(axis));
        let Some(state) = self.body.axis(axis) else { return Vec::new() };
        state.turns_motor = true;
        std::iter::once(microsteps).chain(state.told()).collect()
    }

    /// Returns whether a TCP port accepts connections.
    pub(crate) fn accepts(&self, port: Port) -> bool {
        self.device.accepts(port)
    }

    /// Returns whether it takes what comes on the connections of a TCP port.
    pub(crate) fn takes(&self, port: Port) -> bool {
        !self.body.powered || self.device.takes(port)
    }

    /// Steps of its plans in a full step of the motor on an axis.
    pub(crate) fn microsteps(&self, axis: Axis) -> u16 {
        self.device.microsteps(axis)
    }

    /// Wakes it at its deadline; returns the next one.
    ///
    /// # Panics
    /// If it wants to be woken at one instant for ever: time would stand still.
    pub(crate) fn wake(&mut self, due: Instant, tape: &mut CallContext<'_>) -> Instant {
        self.device.timeout(due, &mut SlotContext { body: &mut self.body, tape });
        let next = self.done(due, Phase::Deadline, tape);
        self.wakes.count(&self.name, due, next);
        next
    }

    /// Sets what is preset after every power-on; returns what it refuses.
    pub(crate) fn preset_again(
        &mut self,
        at: Instant,
        tape: &mut CallContext<'_>,
    ) -> Result<(), (usize, PresetError)> {
        for n in 0..self.presets.len() {
            let (row, value) = self.presets[n];
            // A preset comes after the deadlines of its instant.
            while self.deadline() <= at {
                self.wake(self.deadline(), tape);
            }
            self.feed(at, &InputRecord::Poke { row, value }, tape).map_err(|why| (row, why))?;
        }
        Ok(())
    }

    /// Powers it on, untold by the trace: at the beginning that goes without saying.
    pub(crate) fn power_on(&mut self, at: Instant, tape: &mut CallContext<'_>) {
        let boot = Boot { seed: self.dice.next(), fast: self.boot_fast, fast_line: tape.fast };
        self.body.power_on(at);
        self.device.power_on(at, boot, &mut SlotContext { body: &mut self.body, tape });
        self.done(at, Phase::Power, tape);
    }

    /// Notes what comes to it from outside, and says whether it hears it: not without power, and not
    /// on a pair of wires on which it sends.
    pub(crate) fn hears(&mut self, at: Instant, fed: &InputRecord) -> bool {
        match *fed {
            InputRecord::Edge { pin, high } => self.tell(pin, Signal::Digital(high)),
            InputRecord::Millivolts { pin, mv } => self.tell(pin, Signal::Millivolts(mv)),
            InputRecord::Open { pin } => self.tell(pin, Signal::Open),
            InputRecord::Fault { fault, on } => {
                if let Some(cause) = self.body.faults.get_mut(usize::from(fault.0)) {
                    *cause = on;
                }
            }
            InputRecord::Bytes { port, .. } | InputRecord::RxError { port } | InputRecord::Idle { port }
                if self.serial(port).is_some_and(|serial| serial.silence && serial.sends_until > at) =>
            {
                return false;
            }
            _ => {}
        }
        self.body.powered || matches!(fed, InputRecord::Power(_))
    }

    fn tell(&mut self, pin: Pin, signal: Signal) {
        if let Some(pin) = self.pin_mut(pin) {
            pin.told = signal;
        }
    }

    /// Feeds it. Without power it hears nothing.
    pub(crate) fn feed(
        &mut self,
        at: Instant,
        fed: &InputRecord,
        tape: &mut CallContext<'_>,
    ) -> Result<(), PresetError> {
        let heard = match fed {
            InputRecord::Power(Power::On) => !self.body.powered,
            InputRecord::Power(Power::Cut(_)) => true,
            _ => self.body.powered,
        };
        if !heard {
            return Ok(());
        }
        let mark = tape.trace.mark();
        tape.trace.fed(at, self.body.seat, fed);
        match *fed {
            InputRecord::Power(Power::On) => self.power_on(at, tape),
            InputRecord::Power(Power::Off) => self.body.power_off(at, tape.outbox),
            InputRecord::Power(Power::Cut(cut)) => self.body.cut(cut),
            InputRecord::Poke { row, value } => {
                let hand = &mut SlotContext { body: &mut self.body, tape };
                if let Err(why) = self.device.poke(at, row, value, hand) {
                    tape.trace.rewind(mark);
                    return Err(why);
                }
            }
            _ => {
                if let Some(input) = fed.input() {
                    self.device.input(at, input, &mut SlotContext { body: &mut self.body, tape });
                }
            }
        }
        self.done(at, Phase::of(fed), tape);
        Ok(())
    }

    /// Puts a value into its memory before its first power-on (PROJECT-6).
    pub(crate) fn preset(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        tape: &mut CallContext<'_>,
    ) -> Result<(), PresetError> {
        self.device.poke(at, row, value, &mut SlotContext { body: &mut self.body, tape })
    }

    /// After a call of the device: whether that was its last, and its next deadline.
    fn done(&mut self, at: Instant, class: Phase, tape: &mut CallContext<'_>) -> Instant {
        self.last = (at, class);
        if self.body.dead {
            self.body.power_off(at, tape.outbox);
        }
        self.deadline = if self.body.powered { self.device.deadline() } else { Instant::NEVER };
        self.deadline
    }

    /// The first instant from `now` on at which something of that class can still come to it.
    pub(crate) fn free(&self, now: Instant, class: Phase) -> Instant {
        if self.last > (now, class) { now + Duration::TICK } else { now }
    }

    /// All that differs from what it believes untold, and that it must be told when power comes: faults, then pins.
    pub(crate) fn surroundings(&self) -> Vec<InputRecord> {
        let faults = (0..).zip(&self.body.faults).filter(|(_, on)| **on);
        let pins = (0..).zip(&self.body.pins).filter(|(_, pin)| pin.away());
        faults
            .map(|(place, _)| InputRecord::Fault { fault: Fault(place), on: true })
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

    /// Time at which it began to send its last message on the port that `fed` comes to.
    pub(crate) fn began(&self, fed: &InputRecord) -> Option<Instant> {
        match *fed {
            InputRecord::Bytes { port, .. } | InputRecord::RxError { port } | InputRecord::Idle { port } => {
                self.serial(port)?.began
            }
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

    /// A word of a register of more than four.
    pub(crate) fn peek_word(&self, at: Instant, row: usize, word: usize) -> u16 {
        self.device.peek_word(at, row, word)
    }

    /// A pin as it is seen from outside (HOST-12).
    pub(crate) fn level(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.level(at)),
        }
    }

    /// The level of STEP or DIR; `None` for any other pin, and while the device uses it itself.
    fn pulses_at(&self, at: Instant, pin: Pin) -> Option<Level> {
        self.body.axes.iter().find_map(|axis| axis.level(at, pin, self.body.powered))
    }

    /// Level that the device drives at a pin.
    pub(crate) fn driven(&self, at: Instant, pin: Pin) -> Level {
        match self.pulses_at(at, pin) {
            Some(level) => level,
            None => self.pin(pin).map_or(Level::Float, |pin| pin.drives.level(at)),
        }
    }

    /// Time of the next change of a wave on an output, and the number of that change.
    pub(crate) fn wave_after(&self, at: Instant, pin: Pin) -> Option<(Instant, u32)> {
        let pin = self.pin(pin)?;
        let due = pin.drives.next_edge(at);
        (due < Instant::NEVER).then_some((due, pin.changes))
    }

    /// The axis of which a pin is STEP or DIR.
    pub(crate) fn axis_at(&self, pin: Pin) -> Option<Axis> {
        (0..)
            .map(Axis)
            .zip(&self.body.axes)
            .find(|(_, axis)| axis.output(pin).is_some())
            .map(|(axis, _)| axis)
    }

    /// Makes the pulses of an axis from now on, for a wire.
    pub(crate) fn listen(&mut self, at: Instant, axis: Axis) {
        let powered = self.body.powered;
        if let Some(axis) = self.body.axis(axis) {
            axis.listen(at, powered);
        }
    }

    /// Time of the next edge of an axis, and a number that tells it from earlier predictions.
    pub(crate) fn next_edge(&mut self, axis: Axis) -> Option<(Instant, u32)> {
        self.body.axis(axis)?.next_edge()
    }

    /// The edge of an axis that was foreseen under that number, and due by `until`; no level while the
    /// device uses the pin itself.
    pub(crate) fn take_edge(
        &mut self,
        axis: Axis,
        number: u32,
        until: Instant,
    ) -> Option<(Pin, Option<Level>)> {
        self.body.axis(axis)?.take_edge(number, until)
    }

    /// Motion of an axis: that of its motor, if it has one of its own, else as commanded.
    pub(crate) fn motion(&self, at: Instant, axis: Axis) -> Motion {
        let told = || self.body.axes.get(usize::from(axis.0)).map(|axis| axis.motion(at));
        self.device.shaft(at, axis).map(Motion::from).or_else(told).unwrap_or_default()
    }
}

/// Wake-ups in a row after which something wanted to be woken again at once.
#[derive(Default)]
pub(crate) struct Wakes(u32);

impl Wakes {
    /// Wake-ups at one instant after which a device is taken for hanging.
    const MOST: u32 = 1_000_000;

    /// Counts a wake-up at `due`, after which the next one is at `next`.
    ///
    /// # Panics
    /// If it wants to be woken at one instant for ever: time would stand still.
    pub(crate) fn count(&mut self, name: &str, due: Instant, next: Instant) {
        self.0 = if next > due { 0 } else { self.0 + 1 };
        assert!(self.0 < Self::MOST, "{name}: deadline {due:?} comes again and again");
    }
}

#[cfg(test)]
mod tests;
