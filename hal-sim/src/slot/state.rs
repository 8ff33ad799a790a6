//! State of a drive on the bench: memory, power and outputs.

use std::sync::Arc;

use drivetwin_firmware::device::{
    Axis, Context, DropReason, Instant, Level, Line, Link, LogEvent, Output, Pin, Plan, Port, PortSpec, Spec,
};

use super::axis::AxisState;
use super::pins::{EncoderState, PinState};
use super::reception::Reception;
use super::serial_port::{PortState, Serial};
use super::tcp_port::Tcp;
use crate::record::journal::{Entry, Journal, Outcome};
use crate::record::own_messages::OwnMessages;
use crate::record::requests::StartingRequests;
use crate::record::trace::{Cut, Trace};
use crate::rng::Rng;
use crate::signals::pin_waveform::PinOutput;

/// Function that is called for each store to the memory: offset of the first byte, and the bytes.
pub type PersistFn = Box<dyn FnMut(u16, &[u8]) + Send>;

/// State of a drive between calls: memory, power and outputs.
pub(crate) struct SlotState {
    pub(super) drive: u32,
    /// Shared with the trace, and by drives whose memory is erased, until the drive stores something.
    pub(crate) memory: Arc<[u8]>,
    persist: Option<PersistFn>,
    pub(crate) powered: bool,
    /// Scheduled power cut; `dead` is true after it has happened, until power is switched off.
    cut: Option<Place>,
    pub(super) dead: bool,
    /// Random numbers for the points at which power fails.
    rng: Rng,
    pub(crate) pins: Vec<PinState>,
    pub(super) axes: Vec<AxisState>,
    pub(super) encoders: Vec<EncoderState>,
    pub(crate) ports: Vec<PortState>,
    pub(crate) has_tcp: bool,
    /// True for each fault whose cause is present.
    pub(crate) faults: Vec<bool>,
    pub(crate) reception: Reception,
    pub(crate) journal: Journal,
    pub(crate) own_messages: OwnMessages,
    /// Requests while the drive was starting.
    pub(crate) starting: StartingRequests,
}

/// Point in a save at which power fails.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Number of stores that are completed before power fails.
    stores: u32,
    part: Part,
}

/// Completed part of the store in which power fails.
#[derive(Clone, Copy, Debug)]
enum Part {
    Bytes(usize),
    /// A random part. With `whole`, it may be the whole store.
    Random {
        number: u64,
        whole: bool,
    },
}

/// Characters that a port sends in one output.
pub(crate) struct Sent {
    pub(crate) drive: u32,
    pub(crate) port: Port,
    /// Start of the first character.
    pub(crate) start: Instant,
    pub(crate) line: Line,
    /// Number of characters; they are in [`Outputs::bytes`].
    pub(crate) count: usize,
}

/// A message of a drive on a TCP connection.
pub(crate) struct TcpSend {
    /// The client of the connection.
    pub(crate) client: u32,
    /// Number of bytes, which are in [`Outputs::messages`]; `None` if the drive closes the connection.
    pub(crate) count: Option<usize>,
    /// True on a port with lines of text.
    is_text: bool,
}

impl TcpSend {
    /// Returns true if `next` continues the text of this message.
    pub(crate) fn is_continued_by(&self, next: &Self) -> bool {
        self.is_text && next.client == self.client && self.count.is_some() && next.count.is_some()
    }
}

/// Change of an output that has a wire.
pub(crate) enum PinChange {
    /// A pin changes to a level.
    Pin { pin: Pin, at: Instant, level: Level },
    /// A pin carries a wave from now on.
    Wave { pin: Pin },
    /// The next steps of an axis change.
    Axis { axis: Axis },
}

/// A command to a motor, from its drive or from outside.
///
/// At one instant the step size is applied first, because plans are in steps: with a plan in steps of another
/// size the shaft would jump. The other commands keep the order in which the drive gave them.
#[derive(Clone, Debug)]
pub(crate) enum MotorCommand {
    Plan(Plan),
    /// Step size for the next plan, and for the rest of the present plan.
    Microsteps(u16),
    Steps(i32),
    Current(u32),
    Duty(i32),
    /// The shaft is blocked, or released.
    Blocked(bool),
}

/// Outputs of a drive in one call.
#[derive(Default)]
pub(crate) struct Outputs {
    /// Commands to motors: drive, axis, time and command.
    pub(crate) motor_commands: Vec<(u32, Axis, Instant, MotorCommand)>,
    pub(crate) sent: Vec<Sent>,
    /// Characters of all entries of `sent`.
    pub(crate) bytes: Vec<u8>,
    pub(crate) tcp_sends: Vec<TcpSend>,
    /// Bytes of all entries of `tcp_sends`.
    pub(crate) messages: Vec<u8>,
    /// Changes of outputs, each with the drive.
    pub(crate) pin_changes: Vec<(u32, PinChange)>,
    /// Messages on a half-duplex line that a drive did not execute, each with the drive.
    pub(crate) unclaimed: Vec<(u32, Entry)>,
    /// Ports on half-duplex lines whose drive executed or refused a message.
    pub(crate) claimed: Vec<(u32, Port)>,
    /// Number of the last entry of a journal; not cleared.
    pub(crate) entries: u64,
    /// Number of the last message that a drive has sent by itself; not cleared.
    pub(crate) own_messages: u64,
    /// The last frame that a drive reported as one for another address: line, end, and the drive; not cleared.
    foreign: Option<(u32, Instant, u32)>,
}

impl Outputs {
    pub(crate) fn is_empty(&self) -> bool {
        self.sent.is_empty()
            && self.tcp_sends.is_empty()
            && self.pin_changes.is_empty()
            && self.unclaimed.is_empty()
            && self.claimed.is_empty()
    }

    /// Clears all outputs, and keeps the allocated memory.
    pub(crate) fn clear(&mut self) {
        self.sent.clear();
        self.bytes.clear();
        self.tcp_sends.clear();
        self.messages.clear();
        self.pin_changes.clear();
        self.motor_commands.clear();
        self.unclaimed.clear();
        self.claimed.clear();
    }
}

/// Trace and outputs of the bench, to which a drive's outputs go during a call.
pub(crate) struct CallContext<'a> {
    pub(crate) trace: &'a mut Trace,
    pub(crate) outputs: &'a mut Outputs,
    /// True if characters take no time.
    pub(crate) fast: bool,
    /// True to record the motion of motors.
    pub(crate) shafts: bool,
}

/// Context of one call of a drive: updates the slot's state and passes outputs on to the bench.
pub(super) struct SlotContext<'a, 'b> {
    pub(super) state: &'a mut SlotState,
    pub(super) context: &'a mut CallContext<'b>,
}

impl Context for SlotContext<'_, '_> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        if self.state.dead {
            return;
        }
        if let Output::Store { offset, bytes } = output {
            let bytes = self.state.store(offset, bytes);
            self.context.trace.record_output(at, self.state.drive, Output::Store { offset, bytes });
            if self.state.dead {
                self.context.trace.record_power_cut(at, self.state.drive);
            }
            return;
        }
        self.state.put(at, output, self.context);
        self.context.trace.record_output(at, self.state.drive, output);
    }

    fn memory(&self) -> &[u8] {
        &self.state.memory
    }
}

impl SlotState {
    /// State of a drive whose power is off.
    pub(super) fn new(
        drive: u32,
        name: &str,
        spec: &'static Spec,
        seed: u64,
        memory: Arc<[u8]>,
        persist: Option<PersistFn>,
    ) -> Self {
        Self {
            drive,
            memory,
            persist,
            powered: false,
            cut: None,
            dead: false,
            rng: Rng::new(seed, &format!("power cuts of {name}")),
            pins: spec.pins.iter().map(PinState::new).collect(),
            axes: spec.axes.iter().map(|axis| AxisState::new(axis, spec.pins)).collect(),
            encoders: spec.encoders.iter().map(|_| EncoderState::default()).collect(),
            ports: spec.ports.iter().map(PortState::new).collect(),
            has_tcp: spec.ports.iter().any(PortSpec::is_tcp),
            faults: vec![false; spec.faults.len()],
            reception: Reception::new(spec),
            journal: Journal::default(),
            own_messages: OwnMessages::default(),
            starting: StartingRequests::default(),
        }
    }

    /// Stores bytes; at a power cut only a part of them. Returns the bytes that were stored.
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
                        // With `whole`, at least one byte changes: a cut that leaves the memory unchanged is
                        // not in the middle of a save.
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
        let place = Arc::make_mut(&mut self.memory).get_mut(from..from + part);
        debug_assert!(place.is_some(), "a drive stores {part} bytes at {from}, outside of its memory");
        if let Some(place) = place {
            place.copy_from_slice(bytes);
        }
        if let Some(persist) = &mut self.persist {
            persist(offset, bytes);
        }
        bytes
    }

    /// Handles all outputs except stores.
    fn put(&mut self, at: Instant, output: Output<'_>, context: &mut CallContext<'_>) {
        match output {
            Output::Bytes { port, bytes } => {
                self.reception.sent(port, None, bytes);
                let Some(serial) = self.serial(port) else { return };
                let (start, line) = serial.send(at, bytes.len(), context.fast);
                context.outputs.sent.push(Sent { drive: self.drive, port, start, line, count: bytes.len() });
                context.outputs.bytes.extend_from_slice(bytes);
            }
            Output::Line { port, line } => {
                if let Some(serial) = self.serial(port) {
                    serial.change(at, line);
                }
            }
            Output::Level { pin, level } => self.drive(pin, at, PinOutput::Level(level), context.outputs),
            Output::Wave { pin, period, high } => {
                self.drive(pin, at, PinOutput::Wave { since: at, period, high }, context.outputs);
            }
            Output::Plan { axis, plan } => {
                self.take_back(axis, at, context.outputs);
                self.shape(axis, at, context.outputs, |axis| axis.follow(at, plan));
                self.command_motor(axis, at, context.outputs, || MotorCommand::Plan(*plan));
            }
            Output::Step { axis, steps } => {
                self.shape(axis, at, context.outputs, |axis| axis.step(at, steps));
                self.command_motor(axis, at, context.outputs, || MotorCommand::Steps(steps));
            }
            Output::CurrentLimit { axis, ma } => {
                if let Some(axis) = self.axis(axis) {
                    (axis.commanded.current_ma, axis.reports_current) = (ma, true);
                }
                self.command_motor(axis, at, context.outputs, || MotorCommand::Current(ma));
            }
            Output::Duty { axis, duty } => {
                if let Some(axis) = self.axis(axis) {
                    axis.commanded.duty = duty;
                }
                self.command_motor(axis, at, context.outputs, || MotorCommand::Duty(duty));
            }
            Output::Log(note) => {
                self.count(note);
                self.note(note, context.outputs);
            }
            Output::Message { port, link, bytes } => {
                self.reception.sent(port, Some(link), bytes);
                self.send_tcp(port, link, Some(bytes), context.outputs);
            }
            Output::Close { port, link } => self.send_tcp(port, link, None, context.outputs),
            // The caller handles stores.
            Output::Store { .. } => {}
        }
    }

    /// Sends bytes on a TCP connection, or closes it (`None`). Without a client this has no effect.
    fn send_tcp(&mut self, port: Port, link: Link, bytes: Option<&[u8]>, outputs: &mut Outputs) {
        let Some(tcp) = self.tcp(port) else { return };
        let is_text = !tcp.framed;
        let client = if bytes.is_some() { tcp.known(link) } else { tcp.close(link) };
        let Some(client) = client else { return };
        outputs.tcp_sends.push(TcpSend { client, count: bytes.map(<[u8]>::len), is_text });
        outputs.messages.extend_from_slice(bytes.unwrap_or_default());
    }

    /// Adds a command to the motor of an axis, if a motor is attached.
    fn command_motor(
        &self,
        axis: Axis,
        at: Instant,
        outputs: &mut Outputs,
        command: impl FnOnce() -> MotorCommand,
    ) {
        if self.axes.get(usize::from(axis.0)).is_some_and(|axis| axis.turns_motor) {
            outputs.motor_commands.push((self.drive, axis, at, command()));
        }
    }

    /// Takes a note of the drive for the journal. All drives of a line but one ignore a frame; the first of them
    /// reports it.
    fn note(&mut self, note: LogEvent, outputs: &mut Outputs) {
        if let LogEvent::Dropped { port, why: DropReason::Address } = note
            && let Some(bus) = self.serial(port).map(|serial| serial.bus)
        {
            let Some(end) = self.reception.frame_end(port) else { return self.reception.skip(port) };
            match outputs.foreign {
                Some((line, time, drive)) if (line, time) == (bus, end) && drive != self.drive => {
                    return self.reception.skip(port);
                }
                _ => outputs.foreign = Some((bus, end, self.drive)),
            }
        }
        self.reception.note(note);
    }

    /// Returns true if another drive of the line has reported the frame that ends now as one for another address, or if
    /// nobody asks for reports.
    pub(super) fn is_reported(&self, port: Port, end: Instant, outputs: &Outputs) -> bool {
        if self.reception.is_off() {
            return true;
        }
        let bus = self
            .ports
            .get(usize::from(port.0))
            .and_then(|port| port.serial.as_ref())
            .map(|serial| serial.bus);
        outputs
            .foreign
            .is_some_and(|(line, time, drive)| (Some(line), time) == (bus, end) && drive != self.drive)
    }

    /// Returns true if the characters that a port receives at `at` do not follow others, and the drive does not send.
    /// Another drive of the line began to send them at `began`, unless a client sends them.
    pub(super) fn hears_alone(&self, port: Port, at: Instant, began: Option<Instant>) -> bool {
        let serial = self.ports.get(usize::from(port.0)).and_then(|port| port.serial.as_ref());
        serial.is_some_and(|serial| {
            let sends = serial.sends_until > at || (began.is_some() && serial.began == began);
            !sends && self.reception.is_silent(port)
        })
    }

    /// Adds an entry to the journal. On a half-duplex line the bench decides which drive's journal gets the
    /// entry, unless this drive executed or refused the message. The bench also counts the messages that come while a
    /// drive starts, on each port.
    pub(crate) fn enter(&mut self, mut entry: Entry, outputs: &mut Outputs) {
        if let Some(port) = self.ports.get_mut(usize::from(entry.port.0)) {
            entry.on_message = std::mem::take(&mut port.on_request);
            entry.on_answer = std::mem::take(&mut port.on_echo);
        }
        let serial = self.serial(entry.port).map(|serial| {
            entry.answer_until = serial.sends_until;
            serial.framed
        });
        let starts = matches!(entry.outcome, Outcome::Dropped(DropReason::Starting));
        if let Some(port) = self.ports.get_mut(usize::from(entry.port.0))
            && port.tcp.is_some()
        {
            port.statistics.starting += u64::from(starts);
        }
        let framed = serial == Some(true) || starts;
        let executed = matches!(entry.outcome, Outcome::Accepted | Outcome::Refused(_));
        match (framed, executed) {
            (true, false) => return outputs.unclaimed.push((self.drive, entry)),
            (true, true) => outputs.claimed.push((self.drive, entry.port)),
            (false, _) => {}
        }
        self.journal.push(&mut outputs.entries, entry);
    }

    pub(super) fn count(&mut self, note: LogEvent) {
        let (LogEvent::Request { port, .. }
        | LogEvent::Refused { port, .. }
        | LogEvent::Dropped { port, .. }) = note
        else {
            return;
        };
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
                // A text on a TCP port counts with its entry, because it is reported in parts.
                DropReason::Starting if port.tcp.is_some() => return,
                DropReason::Starting => &mut statistics.starting,
            },
            LogEvent::Reason(_) => return,
        } += 1;
    }

    fn drive(&mut self, pin: Pin, at: Instant, drives: PinOutput, outputs: &mut Outputs) {
        let Some(state) = self.pins.get_mut(usize::from(pin.0)) else { return };
        state.drives = drives;
        state.changes = state.changes.wrapping_add(1);
        let is_wired = !state.drives_wires().is_empty();
        let reaches_wires = self.lend(pin, at, outputs);
        if is_wired && reaches_wires {
            let change = match drives {
                PinOutput::Level(level) => PinChange::Pin { pin, at, level },
                PinOutput::Wave { .. } => PinChange::Wave { pin },
            };
            outputs.pin_changes.push((self.drive, change));
        }
    }

    /// Lends a shared output of an axis to the drive. Returns true if the drive now controls the pin, false
    /// if the pin is only for pulses and stays with the axis.
    fn lend(&mut self, pin: Pin, at: Instant, outputs: &mut Outputs) -> bool {
        for axis in (0..self.axes.len() as u8).map(Axis) {
            let Some(output) = self.axis(axis).and_then(|axis| axis.output(pin)) else { continue };
            self.shape(axis, at, outputs, |_| {});
            return self.axis(axis).is_some_and(|axis| axis.lend(output));
        }
        true
    }

    /// Returns the lent pins of an axis from the drive to the axis. They are low then.
    fn take_back(&mut self, axis: Axis, at: Instant, outputs: &mut Outputs) {
        let Some(state) = self.axes.get(usize::from(axis.0)) else { return };
        for pin in state.lent() {
            let Some(state) = self.pins.get_mut(usize::from(pin.0)) else { continue };
            state.drives = PinOutput::NOTHING;
            state.changes = state.changes.wrapping_add(1);
            outputs.pin_changes.push((self.drive, PinChange::Pin { pin, at, level: Level::Low }));
        }
    }

    /// Changes an axis. If its pulses are wired, the edges up to `at` are added to the outputs first.
    fn shape(&mut self, axis: Axis, at: Instant, outputs: &mut Outputs, change: impl FnOnce(&mut AxisState)) {
        let Some(state) = self.axes.get_mut(usize::from(axis.0)) else { return };
        let mut moves = |state: &mut AxisState| {
            while let Some((pin, at, level)) = state.take(at) {
                outputs
                    .pin_changes
                    .extend(level.map(|level| (self.drive, PinChange::Pin { pin, at, level })));
            }
        };
        moves(state);
        change(state);
        // If power is off now, the outputs fall at once.
        moves(state);
        if state.shaper.is_some() {
            outputs.pin_changes.push((self.drive, PinChange::Axis { axis }));
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
        self.ports.get_mut(usize::from(port.0))?.tcp.as_deref_mut()
    }

    pub(super) fn power_on(&mut self, at: Instant) {
        self.powered = true;
        self.reception.clear();
        for axis in &mut self.axes {
            axis.power_on(at);
        }
        for serial in self.ports.iter_mut().filter_map(|port| port.serial.as_mut()) {
            serial.power_on();
        }
    }

    pub(super) fn power_off(&mut self, at: Instant, outputs: &mut Outputs) {
        (self.powered, self.dead) = (false, false);
        for port in (0..self.ports.len() as u8).map(Port) {
            if let Some(entry) = self.reception.power_lost(port, at) {
                self.enter(entry, outputs);
            }
        }
        for pin in (0..self.pins.len() as u8).map(Pin) {
            self.drive(pin, at, PinOutput::NOTHING, outputs);
        }
        for axis in (0..self.axes.len() as u8).map(Axis) {
            self.shape(axis, at, outputs, |axis| axis.power_off(at));
            for command in self.axis(axis).map(|axis| axis.motor_commands()).into_iter().flatten() {
                self.command_motor(axis, at, outputs, || command);
            }
        }
    }

    pub(super) fn cut(&mut self, cut: Option<Cut>) {
        self.cut = Some(match cut {
            Some(Cut { stores, bytes }) => Place { stores, part: Part::Bytes(bytes) },
            None => {
                // A save is two stores. The end of the first store is in the middle of the save, but the end
                // of the second is not.
                let stores = u32::from(self.rng.next() % 2 == 1);
                Place { stores, part: Part::Random { number: self.rng.next(), whole: stores == 0 } }
            }
        });
    }
}
