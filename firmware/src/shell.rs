//! The main loop of a board: one drive over embedded-hal, embedded-io, embedded-storage and nb.
//!
//! Interrupts catch what happens and stamp it; the loop calls [`Shell::turn`] until it would block,
//! arms a timer at [`Shell::deadline`] and sleeps. What a board must plug in is [`Inputs`] and
//! [`Outputs`], and [`Links`] where a drive has TCP ports; the simulator plugs in virtual wires, so that the
//! very same loop runs on a host.
//!
//! A board takes its time. A move that it begins late is made later as a whole, and the drive, which goes
//! by its own clock, must not believe that it is over before it is. So the shell puts the drive's time
//! behind the board's by as much. The same helps where a drive asks for more than the board can do, say an
//! endless row of moves shorter than planning one takes: its time waits, and the bus is still served (BOARD-1).

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
pub const ONE_ANSWER: usize = 272;
/// Characters that may wait to be sent, where a drive may be asked many things at once. What does not fit is
/// lost as a whole and counted.
pub const ANSWERS: usize = 1_024;

/// An event that an interrupt caught.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BoardEvent {
    /// A character; its stamp is the end of its stop bit, or when the UART hands it over within that.
    Byte(Port, u8),
    /// A character that could not be read.
    RxError(Port),
    /// The UART says that the line fell silent.
    Idle(Port),
    /// The host opened or left a port: its DTR.
    HostPresence(Port, bool),
    /// An input pin changed, to high or low. No interrupt can tell [`Input::Open`]: a pin whose
    /// [rest](crate::device::PinSpec::rest) is [`Level::Float`] counts as not wired, whatever is wired there, until it
    /// is low for the first time since power-on; from then on high is an open contact.
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
    fn caught(&mut self, until: Instant) -> Option<(Instant, BoardEvent)>;
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
    /// Does what is due on the network at `now` and returns what came on one of the connections, and when, with the
    /// bytes of a [`LinkEvent::Message`] in `message`. Where an interrupt stamps frames, that is before `now`. Where
    /// `device` does not [accept](Device::accepts) connections they wait, and where it does not [take](Device::takes)
    /// more nothing but openings is returned.
    ///
    /// # Errors
    /// Nothing came. Then this wants to be called again as soon as there is a frame, and then at the latest.
    fn next(
        &mut self,
        now: Instant,
        device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant>;

    /// Sends all of `bytes`, or loses all of them and returns `false`: where there is no room for them the
    /// connection is closed, since behind a gap nobody knows what he reads. What was just closed by the other side
    /// takes everything.
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

    /// The motion of an axis from now on; nothing where no steps are made. Returns how much later than
    /// planned all of it will be made.
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
const PATIENCE: Duration = Duration::millis(60);

/// A drive on a board. `CHARACTERS` is how many characters may wait to be sent.
#[derive(Debug)]
pub struct Shell<D, I, O, const CHARACTERS: usize = ONE_ANSWER> {
    device: D,
    /// The device's deadline, which takes a while to ask for.
    due: Instant,
    /// The last thing that it was told, in its time.
    past: Instant,
    inputs: I,
    hands: OutputState<O, CHARACTERS>,
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
    /// Time on the line of all messages that did not fit: the drive reckons with it, the line does not.
    lost: Duration,
    /// Next poll of the network.
    network: Instant,
    /// Delay of the drive's time behind the board's.
    behind: Duration,
    failures: u32,
}

/// Characters in a row, taken from the front.
#[derive(Debug)]
struct Characters<const N: usize> {
    kept: Vec<u8, N>,
    /// Number of characters that have left.
    gone: usize,
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
        let hands = OutputState {
            outputs,
            waves: Vec::new(),
            messages: Deque::new(),
            characters: Characters { kept: Vec::new(), gone: 0 },
            character: Duration::ZERO,
            lost: Duration::ZERO,
            network: Instant::NEVER,
            behind: Duration::ZERO,
            failures: 0,
        };
        Self { device, due: Instant::NEVER, past: Instant::ZERO, inputs, hands }
    }

    /// Gives the drive power at `at`, once. A board has power since its clock began to count.
    pub fn power_on(&mut self, at: Instant, boot: Boot) {
        self.past = at;
        self.device.power_on(self.past, boot, &mut self.hands);
        self.due = self.device.deadline();
    }

    /// Does what is due up to one deadline of the drive, in the order of its stamps.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] if nothing was: sleep until the [`deadline`](Self::deadline), or
    /// until something is caught.
    pub fn turn(&mut self) -> nb::Result<(), Infallible> {
        let now = self.inputs.now();
        let mut idle = true;
        while let Some((at, caught)) = self.inputs.caught(now.min(self.due())) {
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
            self.tell(at, input);
        }
        idle &= !self.hear(now);
        if self.due() <= now {
            idle = false;
            self.hands.wait_for(self.due, now);
            self.past = self.due;
            self.device.timeout(self.due, &mut self.hands);
            self.due = self.device.deadline();
        }
        idle &= !self.hands.wave(now);
        idle &= !self.hands.send(now);
        if idle { Err(nb::Error::WouldBlock) } else { Ok(()) }
    }

    /// Tells the drive what came first on the network; whether anything did. It is told at its instant, or at the
    /// deadline that comes first.
    fn hear(&mut self, now: Instant) -> bool {
        let Some(links) = self.hands.outputs.links() else { return false };
        let mut message = Adu::new();
        let (at, port, link, came) = match links.next(now, &self.device, &mut message) {
            Ok(came) => came,
            Err(again) => {
                self.hands.network = again;
                return false;
            }
        };
        let input = match came {
            LinkEvent::Opened => Input::Opened { port, link },
            LinkEvent::Message => Input::Message { port, link, bytes: &message },
            LinkEvent::Closed => Input::Closed { port, link },
        };
        self.tell(at.min(self.due()), input);
        true
    }

    /// Tells the drive what happened at an instant of the board's clock.
    fn tell(&mut self, at: Instant, input: Input<'_>) {
        self.past = self.past.max(at - self.hands.behind);
        self.due = feed(&mut self.device, self.due, self.past, input, &mut self.hands);
    }

    /// Time of the next work, should no input come before.
    #[must_use]
    pub fn deadline(&self) -> Instant {
        self.due().min(self.hands.deadline())
    }

    /// The drive's deadline, as the board's clock shows it.
    fn due(&self) -> Instant {
        self.due + self.hands.behind
    }

    /// The drive.
    #[must_use]
    pub fn device(&self) -> &D {
        &self.device
    }

    /// Failures of a pin, a port, a connection or the memory.
    #[must_use]
    pub fn failures(&self) -> u32 {
        self.hands.failures
    }
}

impl<O: Outputs, const CHARACTERS: usize> OutputState<O, CHARACTERS> {
    fn deadline(&self) -> Instant {
        let waves = self.waves.iter().map(|wave| wave.due);
        let first = waves.fold(self.network, Instant::min);
        match self.messages.front() {
            // One that has begun waits for room in the port's buffer, and its interrupt tells.
            Some(Message { from, begun: false, .. }) => first.min(*from),
            _ => first,
        }
    }

    /// The drive asks for more than the board can do: it gets less time.
    fn wait_for(&mut self, due: Instant, now: Instant) {
        let late = now.since(due + self.behind);
        if late > PATIENCE {
            self.behind = self.behind + late;
            self.outputs.wait(late);
        }
    }

    fn count<T, E>(&mut self, result: Result<T, E>) -> Option<T> {
        self.failures = self.failures.saturating_add(u32::from(result.is_err()));
        result.ok()
    }

    /// Gives a pin a level, and no wave.
    fn hold(&mut self, pin: Pin, level: Level) {
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

    /// Queues what leaves a port from `from` on; `false` if it does not fit. What begins before the message
    /// ahead of it has left goes on with that, so that only characters need room.
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

    /// Hands what may leave by `now` to the ports; whether anything left.
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
            // What a port refuses is lost: the rest of a message would only be half of it.
            self.failures = self.failures.saturating_add(u32::from(written.is_err()));
            let gone = written.unwrap_or(message.left).min(message.left);
            if gone == 0 && message.left > 0 {
                break;
            }
            message.left -= gone;
            let Message { port, left, then, .. } = *message;
            self.characters.take(gone);
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
        if bytes.len() > N.saturating_sub(self.kept.len()) {
            self.close_up();
        }
        self.kept.extend_from_slice(bytes).is_ok()
    }

    /// Moves those that have not left to the beginning, one by one: all at once would take as much of the stack.
    fn close_up(&mut self) {
        let left = self.kept.len().saturating_sub(self.gone);
        for place in 0..left {
            if let Some(byte) = self.kept.get(self.gone + place).copied()
                && let Some(to) = self.kept.get_mut(place)
            {
                *to = byte;
            }
        }
        self.kept.truncate(left);
        self.gone = 0;
    }

    /// Characters at the front, at most that many.
    fn front(&self, most: usize) -> &[u8] {
        let rest = self.kept.get(self.gone..).unwrap_or(&[]);
        rest.get(..most).unwrap_or(rest)
    }

    /// Removes characters that have left.
    fn take(&mut self, count: usize) {
        self.gone += count;
        if self.gone >= self.kept.len() {
            self.kept.clear();
            self.gone = 0;
        }
    }
}

impl<O: Outputs, const CHARACTERS: usize> Context for OutputState<O, CHARACTERS> {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        let at = at + self.behind;
        match output {
            Output::Bytes { port, bytes } => {
                // What a drive puts behind an answer that was lost would wait for nothing.
                if !self.queue(port, at - self.lost, bytes) {
                    self.lost = self.lost + self.character * bytes.len() as u64;
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
            Output::Level { pin, level } => self.hold(pin, level),
            Output::Wave { pin, period, high } => {
                self.hold(pin, Level::High);
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
                let late = self.outputs.plan(axis, &plan.delayed(self.behind));
                self.behind = self.behind + late;
            }
            Output::Step { axis, steps } => self.outputs.step(axis, steps),
            Output::CurrentLimit { axis, ma } => self.outputs.current(axis, ma),
            Output::Duty { axis, duty } => self.outputs.duty(axis, duty),
            // Only a motor that is there would tell.
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
