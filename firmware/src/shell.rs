//! The main loop of a board: one drive over embedded-hal, embedded-io, embedded-storage and nb.
//!
//! Interrupts record events with their time; the loop calls [`Shell::poll`] until it would block, arms a timer at
//! [`Shell::deadline`] and sleeps. A board implements [`Inputs`] and [`Outputs`], and [`Links`] where a drive has TCP
//! ports. The simulator implements them with virtual wires, so that the same loop runs on a host.
//!
//! A board may be late. A move that it begins late is delayed as a whole. The drive has a clock of its own and must not
//! consider the move finished too early, so the shell delays the drive's clock by the same time. The same applies where
//! a drive asks for more than the board can do, for example an endless sequence of moves that are shorter than planning
//! one takes: the drive's clock waits, and the bus is still served (BOARD-1).
//!
//! # Example
//!
//! ```
//! # use std::cell::RefCell;
//! # use std::collections::VecDeque;
//! # use std::convert::Infallible;
//! # use std::rc::Rc;
//! # use embedded_hal::digital::{self, OutputPin};
//! # use embedded_io::{ErrorType, Write, WriteReady};
//! # use embedded_storage::{ReadStorage, Storage};
//! use drivetwin_firmware::device::{Boot, Duration, Instant, Line, Pin, Port};
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_firmware::shell::{BoardEvent, Inputs, NoNetwork, Outputs, Shell};
//! use drivetwin_protocol::modbus::rtu;
//!
//! /// The clock, and the events that interrupts have recorded.
//! #[derive(Clone, Default)]
//! struct Interrupts(Rc<RefCell<(Instant, VecDeque<(Instant, BoardEvent)>)>>);
//!
//! impl Inputs for Interrupts {
//!     fn now(&self) -> Instant {
//!         self.0.borrow().0
//!     }
//!
//!     fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)> {
//!         let queue = &mut self.0.borrow_mut().1;
//!         if queue.front()?.0 <= until { queue.pop_front() } else { None }
//!     }
//! }
//!
//! # impl Default for Hardware {
//! #     fn default() -> Self {
//! #         Self { uart: Uart::default(), eeprom: Eeprom(vec![0xFF; 256]) }
//! #     }
//! # }
//! /// A UART and an EEPROM; no pin is wired.
//! struct Hardware {
//!     uart: Uart,
//!     eeprom: Eeprom,
//! }
//!
//! impl Outputs for Hardware {
//!     type Serial = Uart;
//!     type Pin = NoPin;
//!     type Memory = Eeprom;
//!     type Links = NoNetwork;
//!
//!     fn serial(&mut self, _port: Port) -> Option<&mut Uart> {
//!         Some(&mut self.uart)
//!     }
//!
//!     fn set_line(&mut self, _port: Port, _line: Line) {}
//!
//!     fn pin(&mut self, _pin: Pin) -> Option<&mut NoPin> {
//!         None
//!     }
//!
//!     fn memory(&mut self) -> &mut Eeprom {
//!         &mut self.eeprom
//!     }
//!
//!     fn stored(&self) -> &[u8] {
//!         &self.eeprom.0
//!     }
//! }
//! # #[derive(Clone, Default)]
//! # struct Uart(Rc<RefCell<Vec<u8>>>);
//! # impl ErrorType for Uart {
//! #     type Error = Infallible;
//! # }
//! # impl Write for Uart {
//! #     fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
//! #         self.0.borrow_mut().extend_from_slice(bytes);
//! #         Ok(bytes.len())
//! #     }
//! #     fn flush(&mut self) -> Result<(), Infallible> {
//! #         Ok(())
//! #     }
//! # }
//! # impl WriteReady for Uart {
//! #     fn write_ready(&mut self) -> Result<bool, Infallible> {
//! #         Ok(true)
//! #     }
//! # }
//! # enum NoPin {}
//! # impl digital::ErrorType for NoPin {
//! #     type Error = Infallible;
//! # }
//! # impl OutputPin for NoPin {
//! #     fn set_low(&mut self) -> Result<(), Infallible> {
//! #         match *self {}
//! #     }
//! #     fn set_high(&mut self) -> Result<(), Infallible> {
//! #         match *self {}
//! #     }
//! # }
//! # struct Eeprom(Vec<u8>);
//! # impl ReadStorage for Eeprom {
//! #     type Error = Infallible;
//! #     fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
//! #         bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
//! #         Ok(())
//! #     }
//! #     fn capacity(&self) -> usize {
//! #         self.0.len()
//! #     }
//! # }
//! # impl Storage for Eeprom {
//! #     fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
//! #         self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
//! #         Ok(())
//! #     }
//! # }
//!
//! let (interrupts, hardware) = (Interrupts::default(), Hardware::default());
//! let sent = hardware.uart.0.clone();
//! let mut shell: Shell<_, _, _> = Shell::new(Md3::new(), interrupts.clone(), hardware);
//! shell.power_on(Instant::ZERO, Boot { fast: true, ..Boot::default() });
//!
//! // The UART receives a request to read CommandVersion, a character of 18,333 ticks each.
//! for (n, byte) in (1..).zip(rtu::read(1, 0x00, 1)) {
//!     let at = Instant::from_ticks(n * 18_333);
//!     interrupts.0.borrow_mut().1.push_back((at, BoardEvent::Byte(Port(0), byte)));
//! }
//! // The loop of a board: poll until nothing is left to do, then sleep until the deadline.
//! while sent.borrow().is_empty() {
//!     while shell.poll().is_ok() {}
//!     let wake_up = shell.deadline().min(interrupts.now() + Duration::millis(1));
//!     interrupts.0.borrow_mut().0 = wake_up;
//! }
//! assert_eq!(sent.borrow().as_slice(), rtu::frame(1, &[3, 2, 0, 1]).as_slice());
//! assert_eq!(shell.failures(), 0);
//! ```

use core::convert::Infallible;

use drivetwin_protocol::modbus::tcp::Adu;
use embedded_hal::digital::{OutputPin, PinState};
use embedded_io::{Write, WriteReady};
use embedded_storage::Storage;
use heapless::{Deque, Vec};

use crate::device::{
    Axis, Boot, Context, Device, Duration, Encoder, Fault, Input, Instant, Level, Line, Link, LogEvent,
    Output, Pin, Plan, Port, feed,
};

/// Pins that may wave at a time.
const WAVES: usize = 4;
/// Messages that may wait to be sent. Those that follow each other without a pause are one.
const MESSAGES: usize = 4;

/// Characters that may wait to be sent, where a drive is asked again when it has answered: those of the
/// longest message, and of a short one.
pub const TX_ONE_REPLY: usize = 272;
/// Characters that may wait to be sent, where a drive may be asked many things at once. What does not fit is
/// lost as a whole and counted.
pub const TX_REPLIES: usize = 1_024;

/// An event that an interrupt caught.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardEvent {
    /// A character; its stamp is the end of its stop bit, or the time of the UART's interrupt within that.
    Byte(Port, u8),
    /// A character that could not be read.
    RxError(Port),
    /// The UART has detected an idle line.
    Idle(Port),
    /// The host opened or left a port: its DTR.
    HostPresence(Port, bool),
    /// An input pin changed, to high or low. An interrupt cannot detect [`Input::Open`]: a pin whose [idle
    /// level](crate::device::PinSpec::idle) is [`Level::Float`] counts as not wired until it is low for the first time
    /// since power-on; from then on high is an open contact.
    Edge(Pin, bool),
    /// A converter measured another voltage at an input pin, in mV.
    Millivolts(Pin, i32),
    /// A counter in hardware: which encoder, quarter cycles since the last time, channels A and B now.
    Count(Encoder, i32, bool, bool),
    /// The cause of a fault came or went.
    Fault(Fault, bool),
    /// A plan was taken late: so many steps more were made.
    StepsCorrection(Axis, i32),
}

/// Inputs of a board, and its clock.
pub trait Inputs {
    /// Now. Everything caught until now is there when this returns.
    fn now(&self) -> Instant;

    /// The oldest input that is not after `until`. Stamps ascend.
    fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)>;
}

/// An event of a TCP connection.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkEvent {
    /// A client connected.
    Opened,
    /// A message: of Modbus a whole ADU, of MCode what came, never past the end of a line nor more than an
    /// [`Adu`] holds.
    Message,
    /// Closed, though the drive did not close it.
    Closed,
}

/// The network of a board: TCP connections at the drive's ports. Each has a number that no other open one of its
/// port has.
pub trait Links {
    /// Does the network work that is due at `now` and returns the next event of a connection with its time; the bytes
    /// of a [`LinkEvent::Message`] are in `message`. Where an interrupt stamps frames, the time is before `now`. While
    /// `device` does not [accept](Device::accepts) connections they wait, and while it does not [take](Device::takes)
    /// messages only openings are returned.
    ///
    /// # Errors
    /// Nothing came. Then this wants to be called again as soon as there is a frame, and then at the latest.
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant>;

    /// Sends all of `bytes`, or drops all of them and returns `false`. Without room for them the connection is closed,
    /// because a client cannot find the next message behind a gap. A connection that the other side has just closed
    /// accepts everything.
    fn send(&mut self, port: Port, link: Link, bytes: &[u8]) -> bool;

    /// Closes a connection once all that was sent on it has left.
    fn close(&mut self, port: Port, link: Link);
}

/// Links by reference.
impl<L: Links> Links for &mut L {
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant> {
        (**self).next(now, device, message)
    }

    fn send(&mut self, port: Port, link: Link, bytes: &[u8]) -> bool {
        (**self).send(port, link, bytes)
    }

    fn close(&mut self, port: Port, link: Link) {
        (**self).close(port, link);
    }
}

/// The network of a board that has none.
#[derive(Clone, Copy, Debug)]
pub enum NoNetwork {}

impl Links for NoNetwork {
    fn next(
        &mut self,
        _now: Instant,
        _device: &dyn Device,
        _message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant> {
        match *self {}
    }

    fn send(&mut self, _port: Port, _link: Link, _bytes: &[u8]) -> bool {
        match *self {}
    }

    fn close(&mut self, _port: Port, _link: Link) {
        match *self {}
    }
}

/// Outputs of a board.
pub trait Outputs {
    /// The sending half of a UART. Its `write` takes what its buffer has room for and never waits.
    type Serial: Write + WriteReady;
    /// An output pin. High lets an open drain go.
    type Pin: OutputPin;
    /// Non-volatile memory, a byte at a time.
    type Memory: Storage;
    /// The network; [`NoNetwork`] where there is none.
    type Links: Links;

    /// The UART of a port.
    fn serial(&mut self, port: Port) -> Option<&mut Self::Serial>;

    /// The network, if there is one.
    fn links(&mut self) -> Option<&mut Self::Links> {
        None
    }

    /// Changes the settings of a port, once all that was written to it has left.
    fn set_line(&mut self, port: Port, line: Line);

    /// An output pin, if it is wired.
    fn pin(&mut self, pin: Pin) -> Option<&mut Self::Pin>;

    /// Lets an output pin go, so that whatever is wired there decides, or drives it again; nothing where
    /// high does that.
    fn release(&mut self, _pin: Pin, _released: bool) {}

    /// The non-volatile memory.
    fn memory(&mut self) -> &mut Self::Memory;

    /// Content of the memory, as the drive reads it: at least [`Spec::memory`](crate::device::Spec::memory) bytes,
    /// `0xFF` where nothing was ever stored. The shell keeps no copy.
    fn stored(&self) -> &[u8];

    /// The motion of an axis from now on; nothing where no steps are made. Returns the delay of the whole plan.
    fn plan(&mut self, _axis: Axis, _plan: &Plan) -> Duration {
        Duration::ZERO
    }

    /// The drive's time waits for so long: it will be that much further behind the board's.
    fn wait(&mut self, _late: Duration) {}

    /// Steps of an axis without a plan, made now; nothing where no steps are made.
    fn step(&mut self, _axis: Axis, _steps: i32) {}

    /// The current of an axis, in mA; nothing where it cannot be set.
    fn current(&mut self, _axis: Axis, _ma: u32) {}

    /// The duty of an axis, in 1/65536; nothing where it cannot be set.
    fn duty(&mut self, _axis: Axis, _duty: i32) {}
}

/// Longest delay of a wake-up, before the drive's time waits: longer than a board's flash takes to erase a sector.
const MAX_LATENESS: Duration = Duration::millis(60);

/// A drive on a board. `CHARACTERS` is how many characters may wait to be sent.
#[derive(Debug)]
pub struct Shell<D, I, O, const CHARACTERS: usize = TX_ONE_REPLY> {
    device: D,
    /// The device's deadline, which takes a while to ask for.
    due: Instant,
    /// Time of the last call of the drive, on its clock.
    last_event: Instant,
    inputs: I,
    state: OutputState<O, CHARACTERS>,
}

/// Everything that a drive's outputs need.
#[derive(Debug)]
struct OutputState<O, const CHARACTERS: usize> {
    outputs: O,
    waves: Vec<Wave, WAVES>,
    messages: Deque<Message, MESSAGES>,
    /// Characters of all messages, in their order.
    characters: Characters<CHARACTERS>,
    /// Time of a character on the line, as the drive set it last.
    character: Duration,
    /// Time on the line of all dropped messages: the drive counts it, the line does not.
    dropped_time: Duration,
    /// Next poll of the network.
    network: Instant,
    /// Delay of the drive's time behind the board's.
    clock_offset: Duration,
    failures: u32,
}

/// Characters in a row, taken from the front.
#[derive(Debug)]
struct Characters<const N: usize> {
    buffer: Vec<u8, N>,
    /// Number of characters that have left.
    sent: usize,
}

/// A pin that repeats.
#[derive(Clone, Copy, Debug)]
struct Wave {
    pin: Pin,
    period: Duration,
    high: Duration,
    /// Time of its next change.
    due: Instant,
    /// To which level.
    rises: bool,
}

/// A message that leaves a port.
#[derive(Clone, Copy, Debug)]
struct Message {
    port: Port,
    /// Earliest start of the first character.
    from: Instant,
    begun: bool,
    /// End of the last character, as the drive expects it.
    until: Instant,
    /// Characters that have not left.
    left: usize,
    /// Settings of the line behind it.
    then: Option<Line>,
}

impl<D: Device, I: Inputs, O: Outputs, const CHARACTERS: usize> Shell<D, I, O, CHARACTERS> {
    /// `device` on a board, without power.
    pub const fn new(device: D, inputs: I, outputs: O) -> Self {
        let state = OutputState {
            outputs,
            waves: Vec::new(),
            messages: Deque::new(),
            characters: Characters { buffer: Vec::new(), sent: 0 },
            character: Duration::ZERO,
            dropped_time: Duration::ZERO,
            network: Instant::NEVER,
            clock_offset: Duration::ZERO,
            failures: 0,
        };
        Self { device, due: Instant::NEVER, last_event: Instant::ZERO, inputs, state }
    }

    /// Gives the drive power at `at`, once. A board has power since its clock began to count.
    pub fn power_on(&mut self, at: Instant, boot: Boot) {
        self.last_event = at;
        self.device.power_on(self.last_event, boot, &mut self.state);
        self.due = self.device.deadline();
    }

    /// Does the work that is due, up to one deadline of the drive, in the order of stamps.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] if nothing was: sleep until the [`deadline`](Self::deadline), or
    /// until something is caught.
    pub fn poll(&mut self) -> nb::Result<(), Infallible> {
        let now = self.inputs.now();
        let mut idle = true;
        while let Some((at, caught)) = self.inputs.next_event(now.min(self.due())) {
            idle = false;
            let character;
            let input = match caught {
                BoardEvent::Byte(port, byte) => {
                    character = [byte];
                    Input::Bytes { port, bytes: &character }
                }
                BoardEvent::RxError(port) => Input::RxError { port },
                BoardEvent::Idle(port) => Input::Idle { port },
                BoardEvent::HostPresence(port, here) => Input::HostPresence { port, here },
                BoardEvent::Edge(pin, high) => Input::Edge { pin, high },
                BoardEvent::Millivolts(pin, mv) => Input::Millivolts { pin, mv },
                BoardEvent::Count(encoder, steps, a, b) => Input::Count { encoder, steps, a, b },
                BoardEvent::Fault(fault, on) => Input::Fault { fault, on },
                BoardEvent::StepsCorrection(axis, steps) => Input::StepsCorrection { axis, steps },
            };
            self.deliver(at, input);
        }
        idle &= !self.poll_network(now);
        if self.due() <= now {
            idle = false;
            self.state.wait_for(self.due, now);
            self.last_event = self.due;
            self.device.timeout(self.due, &mut self.state);
            self.due = self.device.deadline();
        }
        idle &= !self.state.wave(now);
        idle &= !self.state.send(now);
        if idle { Err(nb::Error::WouldBlock) } else { Ok(()) }
    }

    /// Delivers the next network event, at its time or at the drive's deadline if that is earlier. Returns whether
    /// there was one.
    fn poll_network(&mut self, now: Instant) -> bool {
        let Some(links) = self.state.outputs.links() else { return false };
        let mut message = Adu::new();
        let (at, port, link, came) = match links.next(now, &self.device, &mut message) {
            Ok(came) => came,
            Err(again) => {
                self.state.network = again;
                return false;
            }
        };
        let input = match came {
            LinkEvent::Opened => Input::Opened { port, link },
            LinkEvent::Message => Input::Message { port, link, bytes: &message },
            LinkEvent::Closed => Input::Closed { port, link },
        };
        self.deliver(at.min(self.due()), input);
        true
    }

    /// Delivers an input at an instant of the board's clock.
    fn deliver(&mut self, at: Instant, input: Input<'_>) {
        self.last_event = self.last_event.max(at - self.state.clock_offset);
        self.due = feed(&mut self.device, self.due, self.last_event, input, &mut self.state);
    }

    /// Time of the next work, should no input come before.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.due().min(self.state.deadline())
    }

    /// The drive's deadline, as the board's clock shows it.
    fn due(&self) -> Instant {
        self.due + self.state.clock_offset
    }

    /// The drive.
    #[must_use]
    pub fn device(&self) -> &D {
        &self.device
    }

    /// Failures of a pin, a port, a connection or the memory.
    #[must_use]
    pub fn failures(&self) -> u32 {
        self.state.failures
    }
}

impl<O: Outputs, const CHARACTERS: usize> OutputState<O, CHARACTERS> {
    fn deadline(&self) -> Instant {
        let waves = self.waves.iter().map(|wave| wave.due);
        let first = waves.fold(self.network, Instant::min);
        match self.messages.front() {
            // A message that has begun waits for room in the port's buffer; its interrupt wakes the loop.
            Some(Message { from, begun: false, .. }) => first.min(*from),
            _ => first,
        }
    }

    /// The drive asks for more than the board can do: it gets less time.
    fn wait_for(&mut self, due: Instant, now: Instant) {
        let late = now.since(due + self.clock_offset);
        if late > MAX_LATENESS {
            self.clock_offset = self.clock_offset + late;
            self.outputs.wait(late);
        }
    }

    fn count<T, E>(&mut self, result: Result<T, E>) -> Option<T> {
        self.failures = self.failures.saturating_add(u32::from(result.is_err()));
        result.ok()
    }

    /// Gives a pin a level, and no wave.
    fn set_level(&mut self, pin: Pin, level: Level) {
        self.waves.retain(|wave| wave.pin != pin);
        self.outputs.release(pin, level == Level::Float);
        self.level(pin, level != Level::Low);
    }

    fn level(&mut self, pin: Pin, high: bool) {
        if let Some(pin) = self.outputs.pin(pin) {
            let result = pin.set_state(PinState::from(high));
            self.count(result);
        }
    }

    /// Moves the waves on to `now`; whether any changed.
    fn wave(&mut self, now: Instant) -> bool {
        let mut changed = false;
        for index in 0..self.waves.len() {
            while let Some(wave) = self.waves.get_mut(index)
                && wave.due <= now
            {
                let Wave { pin, rises, .. } = *wave;
                wave.due += if rises { wave.high } else { wave.period - wave.high };
                wave.rises = !rises;
                self.level(pin, rises);
                changed = true;
            }
        }
        changed
    }

    /// Queues a message that leaves a port from `from` on; `false` if it does not fit. A message that begins before the
    /// one ahead of it has left is appended to that, so that only characters need room.
    fn queue(&mut self, port: Port, from: Instant, bytes: &[u8]) -> bool {
        let takes = self.character * bytes.len() as u64;
        let joins = |last: &&mut Message| last.port == port && last.then.is_none() && from <= last.until;
        if let Some(last) = self.messages.back_mut().filter(joins) {
            let fits = self.characters.push(bytes);
            if fits {
                last.left += bytes.len();
                last.until += takes;
            }
            return fits;
        }
        let message =
            Message { port, from, begun: false, until: from + takes, left: bytes.len(), then: None };
        !self.messages.is_full() && self.characters.push(bytes) && self.messages.push_back(message).is_ok()
    }

    /// Writes the characters that may leave by `now` to the ports; returns whether any left.
    fn send(&mut self, now: Instant) -> bool {
        let mut moved = false;
        while let Some(message) = self.messages.front_mut().filter(|message| message.from <= now) {
            message.begun = true;
            let next = self.characters.front(message.left);
            let written = match self.outputs.serial(message.port) {
                Some(serial) if !next.is_empty() => match serial.write_ready() {
                    Ok(false) => break,
                    Ok(true) => serial.write(next),
                    Err(error) => Err(error),
                },
                _ => Ok(next.len()),
            };
            moved = true;
            // If a port reports an error the whole message is dropped: half a message would be of no use.
            self.failures = self.failures.saturating_add(u32::from(written.is_err()));
            let sent = written.unwrap_or(message.left).min(message.left);
            if sent == 0 && message.left > 0 {
                break;
            }
            message.left -= sent;
            let Message { port, left, then, .. } = *message;
            self.characters.take(sent);
            if left == 0 {
                self.messages.pop_front();
                if let Some(line) = then {
                    self.outputs.set_line(port, line);
                }
            }
        }
        moved
    }
}

impl<const N: usize> Characters<N> {
    /// Puts some at the end; `false` if they do not fit.
    fn push(&mut self, bytes: &[u8]) -> bool {
        if bytes.len() > N.saturating_sub(self.buffer.len()) {
            self.compact();
        }
        self.buffer.extend_from_slice(bytes).is_ok()
    }

    /// Moves those that have not left to the beginning, one by one: all at once would take as much of the stack.
    fn compact(&mut self) {
        let left = self.buffer.len().saturating_sub(self.sent);
        for place in 0..left {
            if let Some(byte) = self.buffer.get(self.sent + place).copied()
                && let Some(to) = self.buffer.get_mut(place)
            {
                *to = byte;
            }
        }
        self.buffer.truncate(left);
        self.sent = 0;
    }

    /// Characters at the front, at most that many.
    fn front(&self, most: usize) -> &[u8] {
        let rest = self.buffer.get(self.sent..).unwrap_or(&[]);
        rest.get(..most).unwrap_or(rest)
    }

    /// Removes characters that have left.
    fn take(&mut self, count: usize) {
        self.sent += count;
        if self.sent >= self.buffer.len() {
            self.buffer.clear();
            self.sent = 0;
        }
    }
}

impl<O: Outputs, const CHARACTERS: usize> Context for OutputState<O, CHARACTERS> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let at = at + self.clock_offset;
        match output {
            Output::Bytes { port, bytes } => {
                // What a drive puts behind an answer that was lost would wait for nothing.
                if !self.queue(port, at - self.dropped_time, bytes) {
                    self.dropped_time = self.dropped_time + self.character * bytes.len() as u64;
                    self.failures = self.failures.saturating_add(1);
                }
            }
            Output::Line { port, line } => {
                self.character = line.character();
                match self.messages.iter_mut().rfind(|message| message.port == port) {
                    Some(message) => message.then = Some(line),
                    None => self.outputs.set_line(port, line),
                }
            }
            Output::Level { pin, level } => self.set_level(pin, level),
            Output::Wave { pin, period, high } => {
                self.set_level(pin, Level::High);
                let period = period.max(Duration::TICK);
                let wave = Wave { pin, period, high, due: at + high, rises: false };
                let result = self.waves.push(wave);
                self.count(result);
            }
            Output::Store { offset, bytes } => {
                let result = self.outputs.memory().write(u32::from(offset), bytes);
                self.count(result);
            }
            Output::Plan { axis, plan } => {
                let late = self.outputs.plan(axis, &plan.delayed(self.clock_offset));
                self.clock_offset = self.clock_offset + late;
            }
            Output::Step { axis, steps } => self.outputs.step(axis, steps),
            Output::CurrentLimit { axis, ma } => self.outputs.current(axis, ma),
            Output::Duty { axis, duty } => self.outputs.duty(axis, duty),
            // Outputs of motors only, not of drives.
            Output::MotorCurrent { .. } | Output::Motor { .. } | Output::Rotation { .. } => {}
            Output::Log(note) => log(note),
            Output::Message { port, link, bytes } => {
                let sent = self.outputs.links().is_some_and(|links| links.send(port, link, bytes));
                self.failures = self.failures.saturating_add(u32::from(!sent));
            }
            Output::Close { port, link } => {
                if let Some(links) = self.outputs.links() {
                    links.close(port, link);
                }
            }
        }
    }

    fn memory(&self) -> &[u8] {
        self.outputs.stored()
    }
}

#[cfg(feature = "defmt")]
fn log(note: LogEvent) {
    defmt::debug!("{}", note);
}

#[cfg(not(feature = "defmt"))]
fn log(_note: LogEvent) {}
