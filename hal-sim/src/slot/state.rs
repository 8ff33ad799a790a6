//! State of a device on the bench: its memory, its power, and its outputs.

use drivetwin_firmware::device::{
    Axis, Context, DropReason, Instant, Level, Line, Link, LogEvent, Output, Pin, Plan, Port, Spec,
};

use super::axis::AxisState;
use super::pins::{EncoderState, PinState};
use super::serial_port::{PortState, Serial};
use super::tcp_port::Tcp;
use crate::record::trace::{Cut, Trace};
use crate::rng::Rng;
use crate::signals::pin_waveform::PinOutput;

/// Told each range of bytes as it is stored: where it begins, and the bytes.
pub type PersistFn = Box<dyn FnMut(u16, &[u8])>;

/// State of a device that outlives a call: memory, power and outputs.
pub(crate) struct SlotState {
    pub(super) seat: u32,
    pub(crate) memory: Vec<u8>,
    keep: Option<PersistFn>,
    pub(crate) powered: bool,
    /// The next power cut, and whether it has come.
    cut: Option<Place>,
    pub(super) dead: bool,
    /// Random stream of the places where power fails.
    dice: Rng,
    pub(crate) pins: Vec<PinState>,
    pub(super) axes: Vec<AxisState>,
    pub(super) encoders: Vec<EncoderState>,
    pub(crate) ports: Vec<PortState>,
    /// Which causes of faults are there.
    pub(crate) faults: Vec<bool>,
}

/// Place in a save at which power fails.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Stores that still go through.
    stores: u32,
    part: Part,
}

/// Part of a store that goes through.
#[derive(Clone, Copy, Debug)]
enum Part {
    Bytes(usize),
    /// A random part; `whole`: it may be all of it.
    Random {
        number: u64,
        whole: bool,
    },
}

/// Characters that leave a port.
pub(crate) struct Sent {
    pub(crate) seat: u32,
    pub(crate) port: Port,
    /// Start of the first one.
    pub(crate) start: Instant,
    pub(crate) line: Line,
    /// Number of characters; they are in [`Outputs::bytes`].
    pub(crate) count: usize,
}

/// A message of a device on a TCP connection.
pub(crate) struct TcpSend {
    pub(crate) seat: u32,
    pub(crate) port: Port,
    pub(crate) link: Link,
    /// The client.
    pub(crate) client: u32,
    /// Number of bytes, which are in [`Outputs::messages`]; `None`: the device closes the connection.
    pub(crate) count: Option<usize>,
}

/// Change of an output that has a wire.
pub(crate) enum PinChange {
    /// A pin took a level then.
    Pin { pin: Pin, at: Instant, level: Level },
    /// A pin repeats from now on.
    Wave { pin: Pin },
    /// An axis has other steps before it.
    Axis { axis: Axis },
}

/// A command to a motor: from its drive, or from outside.
///
/// Of one instant it hears first how large the drive's steps are, which is what a plan is made of: a plan in steps of
/// another size would make the shaft jump. The rest comes in the order in which the drive did it.
#[derive(Clone, Debug)]
pub(crate) enum MotorCommand {
    Plan(Plan),
    /// From the next plan on, and for what is left of the present one.
    Microsteps(u16),
    Steps(i32),
    Current(u32),
    Duty(i32),
    /// The shaft is blocked, or released.
    Held(bool),
}

/// Outputs of a device in one call.
#[derive(Default)]
pub(crate) struct Outputs {
    /// Commands to its motors: the device, its axis, the time.
    pub(crate) told: Vec<(u32, Axis, Instant, MotorCommand)>,
    pub(crate) sent: Vec<Sent>,
    /// All characters, one message behind the other.
    pub(crate) bytes: Vec<u8>,
    pub(crate) said: Vec<TcpSend>,
    /// All that it says, one message behind the other.
    pub(crate) messages: Vec<u8>,
    /// And whose output it was.
    pub(crate) moved: Vec<(u32, PinChange)>,
}

impl Outputs {
    pub(crate) fn is_empty(&self) -> bool {
        self.sent.is_empty() && self.said.is_empty() && self.moved.is_empty()
    }

    /// Empties it, and keeps its room.
    pub(crate) fn clear(&mut self) {
        self.sent.clear();
        self.bytes.clear();
        self.said.clear();
        self.messages.clear();
        self.moved.clear();
        self.told.clear();
    }
}

/// Destination of a device's outputs, beside its body.
pub(crate) struct CallContext<'a> {
    pub(crate) trace: &'a mut Trace,
    pub(crate) outbox: &'a mut Outputs,
    /// True if characters take no time.
    pub(crate) fast: bool,
}

/// The sink of one call of a device.
pub(super) struct SlotContext<'a, 'b> {
    pub(super) body: &'a mut SlotState,
    pub(super) tape: &'a mut CallContext<'b>,
}

impl Context for SlotContext<'_, '_> {
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

impl SlotState {
    /// State of a device without power, with that name.
    pub(super) fn new(
        seat: u32,
        name: &str,
        spec: &'static Spec,
        seed: u64,
        memory: Option<Vec<u8>>,
        keep: Option<PersistFn>,
    ) -> Self {
        let mut memory = memory.unwrap_or_default();
        memory.resize(usize::from(spec.memory), 0xFF);
        Self {
            seat,
            memory,
            keep,
            powered: false,
            cut: None,
            dead: false,
            dice: Rng::new(seed, &format!("power cuts of {name}")),
            pins: spec.pins.iter().map(PinState::new).collect(),
            axes: spec.axes.iter().map(|axis| AxisState::new(axis, spec.pins)).collect(),
            encoders: spec.encoders.iter().map(|_| EncoderState::default()).collect(),
            ports: spec.ports.iter().map(PortState::new).collect(),
            faults: vec![false; spec.faults.len()],
        }
    }

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
    fn put(&mut self, at: Instant, output: Output<'_>, tape: &mut CallContext<'_>) {
        match output {
            Output::Bytes { port, bytes } => {
                let Some(serial) = self.serial(port) else { return };
                let (start, line) = serial.send(at, bytes.len(), tape.fast);
                tape.outbox.sent.push(Sent { seat: self.seat, port, start, line, count: bytes.len() });
                tape.outbox.bytes.extend_from_slice(bytes);
            }
            Output::Line { port, line } => {
                if let Some(serial) = self.serial(port) {
                    serial.change(at, line);
                }
            }
            Output::Level { pin, level } => self.drive(pin, at, PinOutput::Level(level), tape.outbox),
            Output::Wave { pin, period, high } => {
                self.drive(pin, at, PinOutput::Wave { since: at, period, high }, tape.outbox);
            }
            Output::Plan { axis, plan } => {
                self.take_back(axis, at, tape.outbox);
                self.shape(axis, at, tape.outbox, |axis| axis.follow(at, plan));
                self.tell(axis, at, tape.outbox, || MotorCommand::Plan(*plan));
            }
            Output::Step { axis, steps } => {
                self.shape(axis, at, tape.outbox, |axis| axis.step(at, steps));
                self.tell(axis, at, tape.outbox, || MotorCommand::Steps(steps));
            }
            Output::CurrentLimit { axis, ma } => {
                if let Some(axis) = self.axis(axis) {
                    (axis.current_ma, axis.tells_current) = (ma, true);
                }
                self.tell(axis, at, tape.outbox, || MotorCommand::Current(ma));
            }
            Output::Duty { axis, duty } => {
                if let Some(axis) = self.axis(axis) {
                    axis.duty = duty;
                }
                self.tell(axis, at, tape.outbox, || MotorCommand::Duty(duty));
            }
            Output::Log(note) => self.count(note),
            Output::Message { port, link, bytes } => self.say(port, link, Some(bytes), tape.outbox),
            Output::Close { port, link } => self.say(port, link, None, tape.outbox),
            // A store has its own way, and no motor has a seat.
            Output::Store { .. }
            | Output::MotorCurrent { .. }
            | Output::Motor { .. }
            | Output::Rotation { .. } => {}
        }
    }

    /// Says something on a TCP connection, or closes it (`None`), if somebody is there.
    fn say(&mut self, port: Port, link: Link, bytes: Option<&[u8]>, outbox: &mut Outputs) {
        let seat = self.seat;
        let Some(tcp) = self.tcp(port) else { return };
        let client = if bytes.is_some() { tcp.known(link) } else { tcp.close(link) };
        let Some(client) = client else { return };
        outbox.said.push(TcpSend { seat, port, link, client, count: bytes.map(<[u8]>::len) });
        outbox.messages.extend_from_slice(bytes.unwrap_or_default());
    }

    /// The motor of an axis, if it has one, is to hear of it.
    fn tell(&self, axis: Axis, at: Instant, outbox: &mut Outputs, told: impl FnOnce() -> MotorCommand) {
        if self.axes.get(usize::from(axis.0)).is_some_and(|axis| axis.turns_motor) {
            outbox.told.push((self.seat, axis, at, told()));
        }
    }

    fn count(&mut self, note: LogEvent) {
        let (LogEvent::Request { port, .. }
        | LogEvent::Refused { port, .. }
        | LogEvent::Dropped { port, .. }) = note;
        let Some(port) = self.ports.get_mut(usize::from(port.0)) else { return };
        let statistics = &mut port.statistics;
        *match note {
            LogEvent::Request { .. } => &mut statistics.requests,
            LogEvent::Refused { .. } => &mut statistics.refused,
            LogEvent::Dropped { why, .. } => match why {
                DropReason::Crc => &mut statistics.crc,
                DropReason::Gap => &mut statistics.gap,
                DropReason::Length => &mut statistics.length,
                DropReason::RxError => &mut statistics.spoiled,
                DropReason::Address => &mut statistics.foreign,
                DropReason::Starting => &mut statistics.starting,
            },
        } += 1;
    }

    fn drive(&mut self, pin: Pin, at: Instant, drives: PinOutput, outbox: &mut Outputs) {
        let Some(state) = self.pins.get_mut(usize::from(pin.0)) else { return };
        state.drives = drives;
        state.changes = state.changes.wrapping_add(1);
        let is_wired = !state.drives_wires.is_empty();
        let reaches_wires = self.lend(pin, at, outbox);
        if is_wired && reaches_wires {
            let moved = match drives {
                PinOutput::Level(level) => PinChange::Pin { pin, at, level },
                PinOutput::Wave { .. } => PinChange::Wave { pin },
            };
            outbox.moved.push((self.seat, moved));
        }
    }

    /// An axis leaves a pin to the device, if it can; where pulses have pins of their own, they stay there.
    fn lend(&mut self, pin: Pin, at: Instant, outbox: &mut Outputs) -> bool {
        for axis in (0..self.axes.len() as u8).map(Axis) {
            let Some(output) = self.axis(axis).and_then(|axis| axis.output(pin)) else { continue };
            self.shape(axis, at, outbox, |_| {});
            return self.axis(axis).is_some_and(|axis| axis.lend(output));
        }
        true
    }

    /// An axis takes its pins from the device, and they are low.
    fn take_back(&mut self, axis: Axis, at: Instant, outbox: &mut Outputs) {
        let Some(state) = self.axes.get(usize::from(axis.0)) else { return };
        for pin in state.lent() {
            let Some(state) = self.pins.get_mut(usize::from(pin.0)) else { continue };
            state.drives = PinOutput::NOTHING;
            state.changes = state.changes.wrapping_add(1);
            outbox.moved.push((self.seat, PinChange::Pin { pin, at, level: Level::Low }));
        }
    }

    /// Changes an axis; if its pulses are wired, edges up to then come first.
    fn shape(
        &mut self,
        axis: Axis,
        at: Instant,
        outbox: &mut Outputs,
        gen_bool: impl FnOnce(&mut AxisState),
    ) {
        let Some(state) = self.axes.get_mut(usize::from(axis.0)) else { return };
        let mut moves = |state: &mut AxisState| {
            while let Some((pin, at, level)) = state.take(at) {
                outbox.moved.extend(level.map(|level| (self.seat, PinChange::Pin { pin, at, level })));
            }
        };
        moves(state);
        gen_bool(state);
        // Without power the outputs fall at once.
        moves(state);
        if state.shaper.is_some() {
            outbox.moved.push((self.seat, PinChange::Axis { axis }));
        }
    }

    pub(super) fn axis(&mut self, axis: Axis) -> Option<&mut AxisState> {
        self.axes.get_mut(usize::from(axis.0))
    }

    /// A serial port.
    pub(crate) fn serial(&mut self, port: Port) -> Option<&mut Serial> {
        self.ports.get_mut(usize::from(port.0))?.serial.as_mut()
    }

    /// A TCP port.
    pub(crate) fn tcp(&mut self, port: Port) -> Option<&mut Tcp> {
        self.ports.get_mut(usize::from(port.0))?.tcp.as_mut()
    }

    pub(super) fn power_on(&mut self, at: Instant) {
        self.powered = true;
        for axis in &mut self.axes {
            axis.power_on(at);
        }
        for serial in self.ports.iter_mut().filter_map(|port| port.serial.as_mut()) {
            serial.power_on();
        }
    }

    pub(super) fn power_off(&mut self, at: Instant, outbox: &mut Outputs) {
        (self.powered, self.dead) = (false, false);
        for pin in (0..self.pins.len() as u8).map(Pin) {
            self.drive(pin, at, PinOutput::NOTHING, outbox);
        }
        for axis in (0..self.axes.len() as u8).map(Axis) {
            self.shape(axis, at, outbox, |axis| axis.power_off(at));
            for told in self.axis(axis).map(|axis| axis.told()).into_iter().flatten() {
                self.tell(axis, at, outbox, || told);
            }
        }
    }

    pub(super) fn cut(&mut self, cut: Option<Cut>) {
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
