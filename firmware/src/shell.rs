//! The main loop of a board: runs one drive over embedded-hal, embedded-io, embedded-storage and nb.
//!
//! Interrupts record events with their time. The loop calls [`Shell::poll`] until `poll` would block, sets a
//! timer to [`Shell::deadline`] and sleeps. A board implements [`Inputs`] and [`Outputs`], and [`Links`] if
//! its drive has TCP ports. The simulator implements them with virtual wires, so that the same loop runs on a
//! host.
//!
//! A board may be late. A move that the board starts late is delayed as a whole. The drive has a clock of its
//! own and must not consider the move finished too early, so the shell delays the drive's clock by the same
//! time. The shell also does this if a drive asks for more than the board can do, for example an endless
//! sequence of moves that are shorter than the planning of one move. Then the drive's clock waits, and the
//! bus is still served (BOARD-1).
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
//! // The UART receives a request to read DeviceAddress. A character takes 18,333 ticks.
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
    Output, Pin, Plan, Port, PresetError, feed,
};

/// Number of pins that can have a wave at the same time.
const WAVES: usize = 4;
/// Number of messages that can wait to be sent. Messages without a pause between them count as one.
const MESSAGES: usize = 4;

/// Room for characters to send, for a drive that gets a new request only after its answer: the longest
/// message and a short one.
pub const TX_ONE_REPLY: usize = 272;
/// Room for characters to send, for a drive that can get many requests at once. A message that does not fit
/// is dropped as a whole and counted as a failure.
pub const TX_REPLIES: usize = 1_024;

/// An event recorded by an interrupt.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardEvent {
    /// A received character. The timestamp is the end of its stop bit, or the time of the UART's interrupt
    /// during the stop bit.
    Byte(Port, u8),
    /// A character was received with an error.
    RxError(Port),
    /// The UART has detected an idle line.
    Idle(Port),
    /// The host opened or closed a port, by its DTR.
    HostPresence(Port, bool),
    /// An input pin changed to high (`true`) or low. An interrupt cannot detect [`Input::Open`]. So a pin
    /// with the [idle level](crate::device::PinSpec::idle) [`Level::Float`] counts as not wired until it is
    /// low for the first time since power-on. From then on high means an open contact.
    Edge(Pin, bool),
    /// Nothing drives an input pin any more whose [idle level](crate::device::PinSpec::idle) is [`Level::Float`]. Only a
    /// stimulus ends so; an interrupt cannot detect it.
    Open(Pin),
    /// A converter measured a new voltage at an input pin, in mV.
    Millivolts(Pin, i32),
    /// A hardware counter has counted: encoder, quarter cycles since the last event of this kind, levels of
    /// channels A and B now.
    Count(Encoder, i32, bool, bool),
    /// The cause of a fault appeared (`true`) or disappeared.
    Fault(Fault, bool),
    /// A plan was started late, and this number of steps was made in addition to it.
    StepsCorrection(Axis, i32),
}

/// Inputs of a board, and its clock.
pub trait Inputs {
    /// The present time. When this returns, all events up to this time can be read.
    fn now(&self) -> Instant;

    /// The oldest event that is not after `until`. Timestamps ascend.
    fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)>;
}

/// An event of a TCP connection.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkEvent {
    /// A client connected.
    Opened,
    /// A message was received: a whole Modbus ADU, or received bytes of MCode. Bytes of MCode end at the end
    /// of a text line at the latest, and are no more than an [`Adu`] can hold.
    Message,
    /// The connection was closed, but not by the drive.
    Closed,
}

/// The network of a board: TCP connections to the drive's ports. The numbers of open connections on one port
/// differ.
pub trait Links {
    /// Does the network work that is due at `now` and returns the next event of a connection with its time.
    /// The bytes of a [`LinkEvent::Message`] are then in `message`. If an interrupt timestamps frames, the
    /// time may be before `now`. While `device` does not [accept](Device::accepts) connections, new
    /// connections wait. While `device` does not [take](Device::takes) messages, only new connections are
    /// returned.
    ///
    /// # Errors
    /// No event has happened. Call again when a frame is received, and at the returned time at the latest.
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant>;

    /// Sends all of `bytes`, or drops all of them and returns `false`. If there is no room, the connection is
    /// closed, because a client cannot find the next message after a gap. A connection that the other side
    /// has just closed accepts all bytes.
    fn send(&mut self, port: Port, link: Link, bytes: &[u8]) -> bool;

    /// Closes a connection after everything sent on it has left.
    fn close(&mut self, port: Port, link: Link);
}

/// A network can be used by reference.
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

/// The type of the network on a board without one.
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
    /// Transmitter of a UART. Its `write` takes only the bytes that fit into its buffer and never waits.
    type Serial: Write + WriteReady;
    /// An output pin. On an open-drain pin, high means not driven.
    type Pin: OutputPin;
    /// Non-volatile memory in which single bytes can be written.
    type Memory: Storage;
    /// The network; [`NoNetwork`] on a board without one.
    type Links: Links;

    /// The UART of a port.
    fn serial(&mut self, port: Port) -> Option<&mut Self::Serial>;

    /// The network, if there is one.
    fn links(&mut self) -> Option<&mut Self::Links> {
        None
    }

    /// Changes the line settings of a port after everything written to the port has been sent.
    fn set_line(&mut self, port: Port, line: Line);

    /// An output pin, if it is wired.
    fn pin(&mut self, pin: Pin) -> Option<&mut Self::Pin>;

    /// Stops driving an output pin (`released`), so that the wiring outside decides its level, or drives the
    /// pin again. Does nothing on a board where high has this effect.
    fn release(&mut self, _pin: Pin, _released: bool) {}

    /// The non-volatile memory.
    fn memory(&mut self) -> &mut Self::Memory;

    /// Content of the memory for the drive: at least [`Spec::memory`](crate::device::Spec::memory) bytes,
    /// `0xFF` where nothing was ever stored. The shell keeps no copy.
    fn stored(&self) -> &[u8];

    /// Starts the plan of an axis. Does nothing on a board that makes no steps. Returns the delay of the
    /// whole plan.
    fn plan(&mut self, _axis: Axis, _plan: &Plan) -> Duration {
        Duration::ZERO
    }

    /// Called when the drive's clock is delayed by `late`, in addition to its present delay behind the
    /// board's clock.
    fn wait(&mut self, _late: Duration) {}

    /// Makes steps of an axis now, although no plan contains them. Does nothing on a board that makes no steps.
    fn step(&mut self, _axis: Axis, _steps: i32) {}

    /// Sets the current of an axis, in mA. Does nothing on a board that cannot set it.
    fn current(&mut self, _axis: Axis, _ma: u32) {}

    /// Sets the duty of an axis, in 1/65536. Does nothing on a board that cannot set it.
    fn duty(&mut self, _axis: Axis, _duty: i32) {}

    /// Notes an input that the drive is about to get, with its time on the board's clock.
    fn note_input(&mut self, _at: Instant, _input: &Input<'_>) {}

    /// Notes an output of the drive, with its time on the board's clock, before it has its effect. A plan is noted
    /// afterwards, with its delay.
    fn note_output(&mut self, _at: Instant, _output: &Output<'_>) {}
}

/// Longest delay of a wake-up before the shell delays the drive's clock. It is longer than the erasure of a
/// flash sector takes.
const MAX_LATENESS: Duration = Duration::millis(60);

/// A drive on a board. `CHARACTERS` is the room for characters that wait to be sent.
#[derive(Debug)]
pub struct Shell<D, I, O, const CHARACTERS: usize = TX_ONE_REPLY> {
    device: D,
    /// The device's deadline. It is stored because asking for it takes time.
    due: Instant,
    /// Time of the last call of the drive, on its clock.
    last_event: Instant,
    inputs: I,
    state: OutputState<O, CHARACTERS>,
}

/// State that the drive's outputs need.
#[derive(Debug)]
struct OutputState<O, const CHARACTERS: usize> {
    outputs: O,
    waves: Vec<Wave, WAVES>,
    messages: Deque<Message, MESSAGES>,
    /// Characters of all messages, in the order of the messages.
    characters: Characters<CHARACTERS>,
    /// Duration of a character with the line settings that the drive put last.
    character: Duration,
    /// Duration of all dropped messages. The timestamps of later messages include this time, but the line was
    /// not used.
    dropped_time: Duration,
    /// Time of the next network poll.
    network: Instant,
    /// Delay of the drive's clock behind the board's clock.
    clock_offset: Duration,
    failures: u32,
}

/// A queue of characters, taken from the front.
#[derive(Debug)]
struct Characters<const N: usize> {
    buffer: Vec<u8, N>,
    /// Number of characters at the front that were already sent.
    sent: usize,
}

/// A pin with a wave.
#[derive(Clone, Copy, Debug)]
struct Wave {
    pin: Pin,
    period: Duration,
    high: Duration,
    /// Time of the next change.
    due: Instant,
    /// True if the next change is to high.
    rises: bool,
}

/// A message to send from a port.
#[derive(Clone, Copy, Debug)]
struct Message {
    port: Port,
    /// Earliest start of the first character.
    from: Instant,
    begun: bool,
    /// End of the last character, as the drive expects it.
    until: Instant,
    /// Number of characters not sent yet.
    left: usize,
    /// Line settings to apply after the message.
    then: Option<Line>,
}

impl<D: Device, I: Inputs, O: Outputs, const CHARACTERS: usize> Shell<D, I, O, CHARACTERS> {
    /// Runs `device` on a board; `device` has no power yet.
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

    /// Switches the drive's power on at `at`: once, or again after [`power_off`](Self::power_off). The board itself has
    /// had power since its clock started.
    pub fn power_on(&mut self, at: Instant, boot: Boot) {
        self.last_event = at;
        self.device.power_on(self.last_event, boot, &mut self.state);
        self.due = self.device.deadline();
    }

    /// Switches the drive's power off: what it has not sent yet is lost, and its waves end. Do not call
    /// [`poll`](Self::poll) before the next [`power_on`](Self::power_on). The outputs of the board are the caller's.
    pub fn power_off(&mut self) {
        let now = self.inputs.now();
        self.device.power_off(self.drive_time(now));
        self.due = Instant::NEVER;
        self.state.power_off();
    }

    /// Does the work that is due, in the order of timestamps, up to one deadline of the drive.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] if no work was due. Then the caller sleeps until the
    /// [`deadline`](Self::deadline) or until the next event.
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
                BoardEvent::Open(pin) => Input::Open { pin },
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

    /// Passes the next network event to the drive, with its own time or with the drive's deadline if that is
    /// earlier. Returns true if there was an event.
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

    /// Passes an input to the drive. `at` is a time of the board's clock.
    fn deliver(&mut self, at: Instant, input: Input<'_>) {
        self.state.outputs.note_input(at, &input);
        self.last_event = self.last_event.max(at - self.state.clock_offset);
        self.due = feed(&mut self.device, self.due, self.last_event, input, &mut self.state);
    }

    /// Time of the next work, if no input is received until then.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.due().min(self.state.deadline())
    }

    /// The drive's deadline on the board's clock.
    fn due(&self) -> Instant {
        self.due + self.state.clock_offset
    }

    /// The drive.
    #[must_use]
    pub fn device(&self) -> &D {
        &self.device
    }

    /// Number of failures of pins, ports, connections and the memory.
    #[must_use]
    pub fn failures(&self) -> u32 {
        self.state.failures
    }

    /// The inputs of the board.
    pub fn inputs(&mut self) -> &mut I {
        &mut self.inputs
    }

    /// The outputs of the board.
    pub fn outputs(&mut self) -> &mut O {
        &mut self.state.outputs
    }

    /// The level that the drive gives now to a pin with a wave; `None` if the pin has none.
    #[must_use]
    pub fn wave_level(&self, pin: Pin) -> Option<bool> {
        self.state.waves.iter().find(|wave| wave.pin == pin).map(|wave| !wave.rises)
    }

    /// The time at which the drive is asked at the time `now` of the board's clock.
    #[must_use]
    pub fn drive_time(&self, now: Instant) -> Instant {
        self.last_event.max(now - self.state.clock_offset)
    }

    /// Presets a register at the time `now` of the board's clock, as [`Device::poke`] does. A caller that wants it behind
    /// all that is due before `now` [polls](Self::poll) until nothing is.
    ///
    /// # Errors
    /// The errors of [`Device::poke`].
    pub fn poke(&mut self, now: Instant, row: usize, value: i64) -> Result<(), PresetError> {
        self.last_event = self.drive_time(now);
        let result = self.device.poke(self.last_event, row, value, &mut self.state);
        self.due = self.device.deadline();
        result
    }
}

impl<O: Outputs, const CHARACTERS: usize> OutputState<O, CHARACTERS> {
    fn deadline(&self) -> Instant {
        let waves = self.waves.iter().map(|wave| wave.due);
        let first = waves.fold(self.network, Instant::min);
        match self.messages.front() {
            // A message that has begun waits for room in the port's buffer. The port's interrupt then wakes
            // the loop.
            Some(Message { from, begun: false, .. }) => first.min(*from),
            _ => first,
        }
    }

    /// Drops what is to be sent, and all waves. The next drive has the board's clock.
    fn power_off(&mut self) {
        self.waves.clear();
        self.messages.clear();
        self.characters.clear();
        (self.dropped_time, self.clock_offset) = (Duration::ZERO, Duration::ZERO);
    }

    /// Delays the drive's clock if the drive's deadline is handled too late. In this case the drive needs
    /// more time than the board has.
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

    /// Sets a pin to a level and ends the pin's wave.
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

    /// Updates the waves up to `now`. Returns true if a pin changed.
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

    /// Queues a message that a port sends from `from` on. Returns `false` if it does not fit. A message that
    /// begins before the message ahead of it has ended is appended to that message, so it needs room only for
    /// its characters.
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

    /// Writes the characters that may be sent by `now` to the ports. Returns true if any was written.
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
            // If a port reports an error, the whole message is dropped, because half a message is useless.
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
    /// Appends `bytes`. Returns `false` if they do not fit.
    fn push(&mut self, bytes: &[u8]) -> bool {
        if bytes.len() > N.saturating_sub(self.buffer.len()) {
            self.compact();
        }
        self.buffer.extend_from_slice(bytes).is_ok()
    }

    /// Moves the unsent characters to the beginning. Copies them one by one, because a copy of all would need
    /// stack space.
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

    /// Removes all characters.
    fn clear(&mut self) {
        self.buffer.clear();
        self.sent = 0;
    }

    /// The unsent characters at the front, at most `most`.
    fn front(&self, most: usize) -> &[u8] {
        let rest = self.buffer.get(self.sent..).unwrap_or(&[]);
        rest.get(..most).unwrap_or(rest)
    }

    /// Removes sent characters from the front.
    fn take(&mut self, count: usize) {
        self.sent += count;
        if self.sent >= self.buffer.len() {
            self.clear();
        }
    }
}

impl<O: Outputs, const CHARACTERS: usize> Context for OutputState<O, CHARACTERS> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let at = at + self.clock_offset;
        if !matches!(output, Output::Plan { .. }) {
            self.outputs.note_output(at, &output);
        }
        match output {
            Output::Bytes { port, bytes } => {
                // After a dropped message, later messages are sent earlier by its duration. Otherwise they
                // would wait for nothing.
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
                let plan = &plan.delayed(self.clock_offset);
                self.outputs.note_output(at + late, &Output::Plan { axis, plan });
            }
            Output::Step { axis, steps } => self.outputs.step(axis, steps),
            Output::CurrentLimit { axis, ma } => self.outputs.current(axis, ma),
            Output::Duty { axis, duty } => self.outputs.duty(axis, duty),
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
