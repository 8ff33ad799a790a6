//! Simulated hardware of a board: a clock, UARTs, pins and a memory that implement embedded-hal, embedded-io
//! and embedded-storage. On the host, the [shell](drivetwin_firmware::shell) of a board runs on this hardware
//! in virtual time. All outputs are recorded.
//!
//! A [`Board`] is a handle: its clones, UARTs, pins and memory share one state.

use std::cell::{Ref, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use drivetwin_firmware::device::{Axis, Device, Duration, Instant, Line, Link, Pin, Plan, Port, Spec};
use drivetwin_firmware::shell::{BoardEvent, Inputs, LinkEvent, Links, Outputs};
use drivetwin_protocol::modbus::tcp::Adu;
use embedded_hal::digital;
use embedded_io::ErrorType;
use embedded_storage::{ReadStorage, Storage};

/// Maximum number of characters in a UART that have not left completely.
const FIFO: usize = 16;

/// A recorded output of a simulated board.
#[derive(Clone, PartialEq, Debug)]
pub enum Done {
    /// Characters that left back to back; the timestamp is the start of the first one.
    Sent(Port, Vec<u8>),
    /// A message left on a TCP connection.
    Message(Port, Link, Vec<u8>),
    /// The drive closed a TCP connection.
    Closed(Port, Link),
    /// The serial settings of a port changed.
    Line(Port, Line),
    /// A pin changed, to high or low.
    Level(Pin, bool),
    /// Bytes were stored in the memory at an offset.
    Stored(u32, Vec<u8>),
    /// An axis received a plan.
    Planned(Axis, Plan),
    /// An axis made steps without a plan.
    Stepped(Axis, i32),
    /// An axis received a current limit, in mA.
    Current(Axis, u32),
    /// An axis received a duty, in 1/65536.
    Duty(Axis, i32),
}

/// A simulated board: inputs queued by interrupts, recorded outputs, and the time.
#[derive(Clone, Debug)]
pub struct Board(Rc<RefCell<State>>);

#[derive(Debug)]
struct State {
    now: Instant,
    caught: VecDeque<(Instant, BoardEvent)>,
    /// Events of TCP connections, with the bytes of messages.
    came: VecDeque<(Instant, Port, Link, LinkEvent, Adu)>,
    done: Vec<(Instant, Done)>,
    uarts: Vec<Line>,
    /// For each UART: time at which its last queued character has left, and index in `done` of its present
    /// [`Done::Sent`].
    busy: Vec<Option<(Instant, usize)>>,
    levels: Vec<bool>,
    memory: Vec<u8>,
    /// Number of bytes that the memory still stores before the power fails; `None`: no power failure.
    cut: Option<usize>,
}

impl Board {
    /// A board with the ports and pins of `spec`, and `memory` as the content of its memory.
    #[must_use]
    pub fn new(spec: &Spec, memory: Vec<u8>) -> Self {
        let lines: Vec<Line> = spec.ports.iter().filter_map(|port| port.line).collect();
        Self(Rc::new(RefCell::new(State {
            now: Instant::ZERO,
            caught: VecDeque::new(),
            came: VecDeque::new(),
            done: Vec::new(),
            busy: vec![None; lines.len()],
            uarts: lines,
            levels: vec![false; spec.pins.len()],
            memory,
            cut: None,
        })))
    }

    /// Outputs for a [`Shell`](drivetwin_firmware::shell::Shell).
    #[must_use]
    pub fn outputs(&self) -> SimOutputs {
        let state = self.0.borrow();
        SimOutputs {
            board: self.clone(),
            uarts: (0..state.uarts.len()).map(|n| Uart(self.clone(), n)).collect(),
            pins: (0..state.levels.len()).map(|n| WiredPin(self.clone(), n)).collect(),
            memory: Memory { board: self.clone(), stored: state.memory.clone() },
            network: Network(self.clone()),
        }
    }

    /// Queues an input that an interrupt receives at `at`. Inputs must be added in the order of their times.
    pub fn catch(&self, at: Instant, caught: BoardEvent) {
        self.0.borrow_mut().caught.push_back((at, caught));
    }

    /// Queues an event of a TCP connection at `at`. Events must be added in the order of their times.
    pub fn come(&self, at: Instant, port: Port, link: Link, came: LinkEvent) {
        self.0.borrow_mut().came.push_back((at, port, link, came, Adu::new()));
    }

    /// Queues a message on a TCP connection, like [`come`](Self::come).
    ///
    /// # Panics
    /// If the message is longer than the buffer of a board.
    pub fn say(&self, at: Instant, port: Port, link: Link, bytes: &[u8]) {
        let message = Adu::from_slice(bytes).expect("no more than comes at once");
        self.0.borrow_mut().came.push_back((at, port, link, LinkEvent::Message, message));
    }

    /// Advances the clock to `now`.
    pub fn set_now(&self, now: Instant) {
        let mut state = self.0.borrow_mut();
        state.now = state.now.max(now);
    }

    /// Earliest time at which a full UART has room again; [`Instant::NEVER`] if none is full.
    #[must_use]
    pub fn room_at(&self) -> Instant {
        let state = self.0.borrow();
        let ports = 0..state.uarts.len();
        ports.map(|port| state.room_at(port)).filter(|&at| at > state.now).min().unwrap_or(Instant::NEVER)
    }

    /// Time of the oldest queued input; [`Instant::NEVER`] if there is none.
    #[must_use]
    pub fn caught_at(&self) -> Instant {
        let state = self.0.borrow();
        let caught = state.caught.front().map(|(at, _)| *at);
        let came = state.came.front().map(|(at, ..)| *at);
        caught.into_iter().chain(came).min().unwrap_or(Instant::NEVER)
    }

    /// Outputs so far, in the order of their timestamps.
    pub fn done(&self) -> Ref<'_, [(Instant, Done)]> {
        Ref::map(self.0.borrow(), |state| state.done.as_slice())
    }

    /// Content of the memory.
    #[must_use]
    pub fn memory(&self) -> Vec<u8> {
        self.0.borrow().memory.clone()
    }

    /// Lets the power fail after the memory has stored `bytes` more bytes. The rest of that write and all
    /// later writes are lost.
    pub fn cut_after(&self, bytes: usize) {
        self.0.borrow_mut().cut = Some(bytes);
    }
}

impl State {
    fn room_at(&self, port: usize) -> Instant {
        let (Some(line), Some(Some((free, _)))) = (self.uarts.get(port), self.busy.get(port)) else {
            return Instant::ZERO;
        };
        *free - line.character() * (FIFO as u64 - 1)
    }

    /// Queues as many characters as the UART has room for. Returns their number.
    fn send(&mut self, port: usize, bytes: &[u8]) -> usize {
        let (Some(line), Some(busy)) = (self.uarts.get(port), self.busy.get_mut(port)) else { return 0 };
        let character = line.character();
        let (free, index) = match *busy {
            Some((free, index)) if free > self.now => (free, index),
            _ => {
                self.done.push((self.now, Done::Sent(Port(port as u8), Vec::new())));
                (self.now, self.done.len() - 1)
            }
        };
        let waiting = (free.since(self.now) + character - Duration::TICK) / character;
        let taken = bytes.len().min(FIFO.saturating_sub(waiting as usize));
        if let Some((_, Done::Sent(_, sent))) = self.done.get_mut(index) {
            sent.extend_from_slice(&bytes[..taken]);
        }
        *busy = Some((free + character * taken as u64, index));
        taken
    }
}

impl Inputs for Board {
    fn now(&self) -> Instant {
        self.0.borrow().now
    }

    fn next_event(&mut self, until: Instant) -> Option<(Instant, BoardEvent)> {
        let mut state = self.0.borrow_mut();
        let due = state.caught.front().is_some_and(|(at, _)| *at <= until);
        if due { state.caught.pop_front() } else { None }
    }
}

/// Output side of a [`Board`].
#[derive(Debug)]
pub struct SimOutputs {
    board: Board,
    uarts: Vec<Uart>,
    pins: Vec<WiredPin>,
    memory: Memory,
    network: Network,
}

impl SimOutputs {
    fn done(&self, done: Done) {
        let mut state = self.board.0.borrow_mut();
        let now = state.now;
        state.done.push((now, done));
    }
}

impl Outputs for SimOutputs {
    type Serial = Uart;
    type Pin = WiredPin;
    type Memory = Memory;
    type Links = Network;

    fn serial(&mut self, port: Port) -> Option<&mut Uart> {
        self.uarts.get_mut(usize::from(port.0))
    }

    fn links(&mut self) -> Option<&mut Network> {
        Some(&mut self.network)
    }

    fn set_line(&mut self, port: Port, line: Line) {
        let mut state = self.board.0.borrow_mut();
        let index = usize::from(port.0);
        let left = state.busy.get(index).copied().flatten().map_or(state.now, |(free, _)| free);
        let at = left.max(state.now);
        if let Some(present) = state.uarts.get_mut(index) {
            *present = line;
        }
        state.done.push((at, Done::Line(port, line)));
    }

    fn pin(&mut self, pin: Pin) -> Option<&mut WiredPin> {
        self.pins.get_mut(usize::from(pin.0))
    }

    fn memory(&mut self) -> &mut Memory {
        &mut self.memory
    }

    fn stored(&self) -> &[u8] {
        &self.memory.stored
    }

    fn plan(&mut self, axis: Axis, plan: &Plan) -> Duration {
        self.done(Done::Planned(axis, *plan));
        Duration::ZERO
    }

    fn step(&mut self, axis: Axis, steps: i32) {
        self.done(Done::Stepped(axis, steps));
    }

    fn current(&mut self, axis: Axis, ma: u32) {
        self.done(Done::Current(axis, ma));
    }

    fn duty(&mut self, axis: Axis, duty: i32) {
        self.done(Done::Duty(axis, duty));
    }
}

/// A UART that sends queued characters at the baud rate of its serial line.
#[derive(Debug)]
pub struct Uart(Board, usize);

impl ErrorType for Uart {
    type Error = Infallible;
}

impl embedded_io::Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(self.0.0.borrow_mut().send(self.1, bytes))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl embedded_io::WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        let state = self.0.0.borrow();
        Ok(state.room_at(self.1) <= state.now)
    }
}

/// TCP connections without limits. Output is delivered at once.
#[derive(Debug)]
pub struct Network(Board);

impl Links for Network {
    fn next(
        &mut self,
        now: Instant,
        _device: &dyn Device,
        message: &mut Adu,
    ) -> Result<(Instant, Port, Link, LinkEvent), Instant> {
        let mut state = self.0.0.borrow_mut();
        let due = state.came.front().map_or(Instant::NEVER, |(at, ..)| *at);
        let first = if due <= now { state.came.pop_front() } else { None };
        let (at, port, link, came, bytes) = first.ok_or(due)?;
        *message = bytes;
        Ok((at, port, link, came))
    }

    fn send(&mut self, port: Port, link: Link, bytes: &[u8]) -> bool {
        let mut state = self.0.0.borrow_mut();
        let now = state.now;
        state.done.push((now, Done::Message(port, link, bytes.to_vec())));
        true
    }

    fn close(&mut self, port: Port, link: Link) {
        let mut state = self.0.0.borrow_mut();
        let now = state.now;
        state.done.push((now, Done::Closed(port, link)));
    }
}

/// An input or output pin of a simulated board.
#[derive(Debug)]
pub struct WiredPin(Board, usize);

impl WiredPin {
    fn set(&mut self, high: bool) {
        let mut state = self.0.0.borrow_mut();
        let now = state.now;
        if let Some(level) = state.levels.get_mut(self.1)
            && *level != high
        {
            *level = high;
            state.done.push((now, Done::Level(Pin(self.1 as u8), high)));
        }
    }
}

impl digital::ErrorType for WiredPin {
    type Error = Infallible;
}

impl digital::OutputPin for WiredPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl digital::InputPin for WiredPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.0.borrow().levels.get(self.1).copied().unwrap_or(false))
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// A memory in which power may fail after any byte.
#[derive(Debug)]
pub struct Memory {
    board: Board,
    /// Content after all writes. If the power fails during a write, the memory of the board has a part of it.
    stored: Vec<u8>,
}

/// Error: an offset outside the memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct OutOfBounds;

impl ReadStorage for Memory {
    type Error = OutOfBounds;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), OutOfBounds> {
        let state = self.board.0.borrow();
        let source = state.memory.get(offset as usize..).and_then(|rest| rest.get(..bytes.len()));
        bytes.copy_from_slice(source.ok_or(OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.board.0.borrow().memory.len()
    }
}

impl Storage for Memory {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), OutOfBounds> {
        let mut state = self.board.0.borrow_mut();
        let taken = state.cut.map_or(bytes.len(), |left| left.min(bytes.len()));
        state.cut = state.cut.map(|left| left - taken);
        let index = offset as usize;
        let target = state.memory.get_mut(index..index + bytes.len()).ok_or(OutOfBounds)?;
        target[..taken].copy_from_slice(&bytes[..taken]);
        self.stored[index..index + bytes.len()].copy_from_slice(bytes);
        let now = state.now;
        state.done.push((now, Done::Stored(offset, bytes[..taken].to_vec())));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::echo_device::{EchoDevice, MCODE};
    use drivetwin_firmware::device::{Boot, Device};
    use drivetwin_firmware::md3::Md3;
    use drivetwin_firmware::qsb::Qsb;
    use drivetwin_firmware::shell::{Shell, TX_ONE_REPLY, TX_REPLIES};
    use drivetwin_protocol::modbus::rtu;
    use drivetwin_protocol::time::Span;
    use embedded_io::{Write, WriteReady};

    fn md3_board() -> Board {
        let spec = Md3::new().spec();
        Board::new(spec, vec![0xFF; usize::from(spec.memory)])
    }

    #[test]
    fn a_uart_takes_what_fits_and_sends_it_back_to_back() {
        let board = md3_board();
        let mut outputs = board.outputs();
        let uart = outputs.serial(Port(0)).expect("an MD3 has a port");
        assert_eq!(uart.write(&[7; 20]), Ok(16));
        assert_eq!(uart.write_ready(), Ok(false));
        // A character of 9600 8E1 is 18,333 ticks.
        board.set_now(Instant::from_ticks(18_333));
        assert_eq!(uart.write_ready(), Ok(true));
        assert_eq!(uart.write(&[8; 4]), Ok(1));
        let expected: Vec<u8> = [[7; 16].as_slice(), &[8]].concat();
        assert_eq!(*board.done(), [(Instant::ZERO, Done::Sent(Port(0), expected))]);
    }

    #[test]
    fn a_cut_leaves_a_prefix() {
        let board = md3_board();
        board.cut_after(3);
        let mut outputs = board.outputs();
        assert_eq!(outputs.memory().write(1, &[1, 2, 3, 4]), Ok(()));
        assert_eq!(outputs.memory().write(0, &[9]), Ok(()));
        assert_eq!(board.memory()[..6], [0xFF, 1, 2, 3, 0xFF, 0xFF]);
        assert_eq!(outputs.memory().write(1_000, &[9]), Err(OutOfBounds));
    }

    #[test]
    fn the_shell_answers_through_the_simulated_hardware() {
        let board = md3_board();
        let boot = Boot { fast: true, ..Boot::default() };
        let mut shell: Shell<_, _, _> = Shell::new(Md3::new(), board.clone(), board.outputs());
        shell.power_on(Instant::ZERO, boot);
        let character = Duration::from_ticks(18_333);
        let mut at = Instant::ZERO;
        for byte in rtu::read(1, 0x14, 10) {
            at += character;
            board.catch(at, BoardEvent::Byte(Port(0), byte));
        }
        let reply = at + Duration::from_ticks(64_166 + 18_333);
        board.set_now(reply - Duration::TICK);
        while shell.poll().is_ok() {}
        assert_eq!(shell.deadline(), reply);
        assert!(!board.done().iter().any(|(_, done)| matches!(done, Done::Sent(..))));
        // The reply has 25 characters, more than the UART's buffer.
        board.set_now(reply);
        while shell.poll().is_ok() {}
        while board.room_at() != Instant::NEVER {
            board.set_now(board.room_at());
            while shell.poll().is_ok() {}
        }
        let done = board.done();
        let sent: Vec<_> = done.iter().filter(|(_, done)| matches!(done, Done::Sent(..))).collect();
        assert!(matches!(sent[..], [(at, Done::Sent(Port(0), bytes))]
            if *at == reply && bytes.len() == 25 && rtu::verify_crc(bytes).is_some()));
        assert_eq!(shell.failures(), 0);
    }

    /// Steps of a factory-new MD3 on a board where its pin J2.4 goes low at `closed` and stays low.
    fn steps_of_a_contact(boot: Boot, closed: Instant) -> Vec<(Instant, i32)> {
        let j2_4 = Md3::new().spec().pin("J2.4").unwrap();
        let board = md3_board();
        let mut shell: Shell<_, _, _> = Shell::new(Md3::new(), board.clone(), board.outputs());
        // The images of boards do the same: they read the pins before power-on and stamp them with time 0,
        // when the loop begins.
        board.catch(closed, BoardEvent::Edge(j2_4, false));
        shell.power_on(Instant::ZERO, boot);
        for now in [Instant::ZERO, closed, Instant::from(10.secs())] {
            board.set_now(now);
            while shell.poll().is_ok() {}
        }
        let done = board.done();
        let steps = done.iter().filter_map(|(at, done)| match done {
            Done::Stepped(_, steps) => Some((*at, *steps)),
            _ => None,
        });
        steps.collect()
    }

    #[test]
    fn a_contact_that_is_closed_at_power_on_is_reported_before_the_drive_is_ready() {
        for fast in [true, false] {
            let boot = Boot { fast, ..Boot::default() };
            assert_eq!(steps_of_a_contact(boot, Instant::ZERO), [], "fast: {fast}");
        }
        let boot = Boot { fast: true, ..Boot::default() };
        let later = Instant::ZERO + Duration::TICK;
        let steps = steps_of_a_contact(boot, later);
        assert!(
            matches!(steps[..], [(at, 1 | -1)] if at == later),
            "one that closes then is an edge: {steps:?}"
        );
    }

    /// Sends a QSB-M `commands` requests for its version without a pause. The loop first runs after all of
    /// them have arrived. The queue for output has room for `CHARACTERS` characters. Returns the characters
    /// that left the UART after the banner, and the number of failures.
    fn ask_at_once<const CHARACTERS: usize>(commands: usize) -> (Vec<(Instant, Vec<u8>)>, u32) {
        let board = Board::new(Qsb::m().spec(), vec![0xFF; drivetwin_firmware::qsb::MEMORY]);
        let boot = Boot { fast: true, ..Boot::default() };
        let mut shell: Shell<_, _, _, CHARACTERS> = Shell::new(Qsb::m(), board.clone(), board.outputs());
        shell.power_on(Instant::ZERO, boot);
        while shell.poll().is_ok() {}
        let begin = Instant::ZERO + Duration::secs(1);
        for (n, byte) in (0..).zip("R14\r".repeat(commands).bytes()) {
            board.catch(begin + CHARACTER * n, BoardEvent::Byte(Port(0), byte));
        }
        board.set_now(begin + Duration::secs(1));
        loop {
            while shell.poll().is_ok() {}
            let next = shell.deadline().min(board.room_at());
            if next == Instant::NEVER {
                break;
            }
            board.set_now(next);
        }
        let sent = |(at, done): &(Instant, Done)| match done {
            Done::Sent(_, bytes) if *at >= begin => Some((*at, bytes.clone())),
            _ => None,
        };
        let sent = board.done().iter().filter_map(sent).collect();
        (sent, shell.failures())
    }

    /// Duration of a character at 230,400 8N1: 694.4 ticks, rounded.
    const CHARACTER: Duration = Duration::from_ticks(694);
    const ANSWER: &[u8] = b"r 14 0000110E !\r\n";

    #[test]
    fn answers_without_a_pause_need_room_for_their_characters_only() {
        const COMMANDS: usize = TX_REPLIES / ANSWER.len();
        let (sent, failures) = ask_at_once::<TX_REPLIES>(COMMANDS);
        let all: Vec<u8> = sent.iter().flat_map(|(_, bytes)| bytes.clone()).collect();
        assert_eq!(all, ANSWER.repeat(COMMANDS));
        assert_eq!(failures, 0);
        for pair in sent.windows(2) {
            let [(at, bytes), (next, _)] = pair else { unreachable!("two") };
            assert_eq!(*next, *at + CHARACTER * bytes.len() as u64, "there is no pause");
        }
    }

    #[test]
    fn an_answer_that_does_not_fit_is_lost_as_a_whole_and_counted() {
        const FIT: usize = TX_ONE_REPLY / ANSWER.len();
        let (sent, failures) = ask_at_once::<TX_ONE_REPLY>(FIT + 10);
        let all: Vec<u8> = sent.into_iter().flat_map(|(_, bytes)| bytes).collect();
        assert_eq!(all.len() % ANSWER.len(), 0);
        assert_eq!(all, ANSWER.repeat(all.len() / ANSWER.len()));
        assert!(failures > 0, "all of it fits");
        assert_eq!(all.len() / ANSWER.len() + failures as usize, FIT + 10);
    }

    /// An echo device that is powered on, on a board.
    fn powered(echo: EchoDevice) -> (Board, Shell<EchoDevice, Board, SimOutputs>) {
        let board = Board::new(echo.spec(), Vec::new());
        let mut shell = Shell::new(echo, board.clone(), board.outputs());
        shell.power_on(Instant::ZERO, Boot::default());
        (board, shell)
    }

    #[test]
    fn the_shell_delivers_tcp_input_and_output() {
        let (board, mut shell) = powered(EchoDevice::default());
        let second = |n| Instant::ZERO + Duration::secs(n);
        board.come(second(1), MCODE, Link(0), LinkEvent::Opened);
        board.come(second(2), MCODE, Link(1), LinkEvent::Opened);
        board.say(second(2), MCODE, Link(0), b"t");
        board.say(second(2), MCODE, Link(1), b"a");
        board.come(second(3), MCODE, Link(0), LinkEvent::Closed);
        board.say(second(4), MCODE, Link(1), b"x");
        assert!(shell.poll().is_err(), "nothing has come");
        // The shell sleeps only until the next event arrives.
        for n in 1..=4 {
            assert_eq!(shell.deadline(), second(n));
            board.set_now(second(n));
            while shell.poll().is_ok() {}
        }
        let output = |n, link, bytes: &[u8]| (second(n), Done::Message(MCODE, Link(link), bytes.to_vec()));
        let expected = [
            output(1, 0, b">"),
            output(2, 1, b">"),
            // One `T` only, because the drive learns of the closing one second later.
            output(2, 0, b"T"),
            output(2, 1, b"a"),
            (second(4), Done::Closed(MCODE, Link(1))),
        ];
        assert_eq!(*board.done(), expected);
        assert_eq!(shell.failures(), 0);
    }

    #[test]
    fn what_comes_by_tcp_waits_for_no_deadline_and_no_deadline_for_it() {
        const TEN_MS: Duration = Duration::millis(10);
        let (board, mut shell) = powered(EchoDevice { ring: Some(TEN_MS), ..EchoDevice::default() });
        // The loop is late: three deadlines have passed, and a client has connected and sent messages.
        let late = Instant::ZERO + TEN_MS * 3;
        board.come(late, MCODE, Link(0), LinkEvent::Opened);
        board.say(late, MCODE, Link(0), b"a");
        board.say(late, MCODE, Link(0), b"b");
        board.set_now(late);
        let mut rings = 0;
        for output in [">", "a", "b"] {
            shell.poll().expect("there is something to do");
            let done: Vec<_> = board.done().iter().map(|(_, done)| done.clone()).collect();
            rings += 1;
            let message = |text: &str| Done::Message(MCODE, Link(0), text.as_bytes().to_vec());
            assert!(done.contains(&message(output)), "{output} is answered in turn {rings}");
            assert_eq!(done.iter().filter(|done| **done == message("T")).count(), rings);
        }
    }

    #[test]
    fn messages_of_a_drive_on_a_board_without_a_network_are_counted() {
        use drivetwin_firmware::shell::NoNetwork;

        const HOUR: Duration = Duration::secs(3_600);

        /// Outputs of a board without a network.
        struct Alone(SimOutputs);

        impl Outputs for Alone {
            type Serial = Uart;
            type Pin = WiredPin;
            type Memory = Memory;
            type Links = NoNetwork;

            fn serial(&mut self, port: Port) -> Option<&mut Uart> {
                self.0.serial(port)
            }

            fn set_line(&mut self, port: Port, line: Line) {
                self.0.set_line(port, line);
            }

            fn pin(&mut self, pin: Pin) -> Option<&mut WiredPin> {
                self.0.pin(pin)
            }

            fn memory(&mut self) -> &mut Memory {
                self.0.memory()
            }

            fn stored(&self) -> &[u8] {
                self.0.stored()
            }
        }

        let echo = EchoDevice { ring: Some(HOUR), ..EchoDevice::default() };
        let board = Board::new(echo.spec(), Vec::new());
        let mut shell: Shell<_, _, _> = Shell::new(echo, board.clone(), Alone(board.outputs()));
        shell.power_on(Instant::ZERO, Boot::default());
        board.set_now(Instant::ZERO + HOUR);
        while shell.poll().is_ok() {}
        assert_eq!(shell.failures(), 1, "it rang");
    }
}
