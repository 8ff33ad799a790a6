//! The hardware of the board in memory.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

use drivetwin_board::{
    Axis, Board, Cable, CablePort, End, Gpio, Output, SerialBus, Tap, Timer, Uart, is_awake, is_full_duplex,
};
use drivetwin_firmware::device::{Boot, Fault, Instant, Line, Pin, Port, Role, Spec};
use drivetwin_firmware::motion::{Counted, StepDir};
use drivetwin_firmware::shell::BoardEvent;
use embedded_storage::{ReadStorage, Storage};

/// Wires of the board: as many as a drive has pins and faults at most, and DTR.
pub(super) const ENDS: [u8; 48] = {
    let mut ends = [0; 48];
    let mut n = 0;
    while n < ends.len() {
        ends[n] = n as u8;
        n += 1;
    }
    ends
};

/// Number of bytes that the computer has not read yet, after which the cable has no room.
const CABLE_ROOM: usize = 512;

/// Bytes between the computer and the board, in both directions, of a port.
#[derive(Default)]
struct Pipe {
    to_board: VecDeque<u8>,
    to_host: VecDeque<u8>,
    open: bool,
    /// True if the computer takes one packet at each read of the test.
    slow: bool,
}

#[derive(Default)]
struct Wires {
    /// Events of the hardware that the loop has not taken.
    caught: VecDeque<(Instant, BoardEvent)>,
    bus: Pipe,
    control: Pipe,
    host_line: Option<Line>,
    is_pending: bool,
    stalled: bool,
    watched: bool,
    uart: UartState,
    steps: Vec<Instant>,
    levels: Vec<(Instant, Pin, Option<bool>)>,
}

/// A UART with a character that is being sent and one that waits.
#[derive(Default)]
struct UartState {
    line: Option<Line>,
    /// The character that leaves, and the end of its stop bit.
    leaving: Option<Instant>,
    next: Option<u8>,
    sent: Vec<(Instant, u8)>,
    /// True if the UART's interrupt is due.
    is_pending: bool,
    /// True if the end of the last stop bit is waited for.
    ends: bool,
}

impl Wires {
    fn pipe(&mut self, port: CablePort) -> &mut Pipe {
        match port {
            CablePort::Bus => &mut self.bus,
            CablePort::Control => &mut self.control,
        }
    }
}

thread_local! {
    static NOW: Cell<Instant> = const { Cell::new(Instant::ZERO) };
    /// Time at which the test goes on.
    static HORIZON: Cell<Instant> = const { Cell::new(Instant::ZERO) };
    /// Time of the next interrupt of the step timer.
    static STEP: Cell<Instant> = const { Cell::new(Instant::NEVER) };
    static WIRES: RefCell<Wires> = RefCell::default();
    static BUS: Cell<Option<&'static SerialBus<SimulatedUart>>> = const { Cell::new(None) };
    static TAP: Cell<Option<&'static Tap>> = const { Cell::new(None) };
    static AXIS: Cell<Option<&'static Axis<StepClock>>> = const { Cell::new(None) };
}

fn with<R>(act: impl FnOnce(&mut Wires) -> R) -> R {
    WIRES.with_borrow_mut(act)
}

/// A new board on this thread.
pub(super) fn reset() {
    NOW.set(Instant::ZERO);
    HORIZON.set(Instant::ZERO);
    STEP.set(Instant::NEVER);
    WIRES.take();
    BUS.set(Some(Box::leak(Box::new(SerialBus::new()))));
    TAP.set(Some(Box::leak(Box::new(Tap::new()))));
    AXIS.set(Some(Box::leak(Box::new(Axis::new(Counted::new(Steps))))));
}

pub(super) fn now() -> Instant {
    NOW.get()
}

pub(super) fn set_horizon(until: Instant) {
    HORIZON.set(until);
}

pub(super) fn open(port: CablePort, open: bool) {
    with(|wires| {
        wires.pipe(port).open = open;
        wires.is_pending = true;
    });
}

pub(super) fn take_slowly(port: CablePort) {
    with(|wires| wires.pipe(port).slow = true);
}

pub(super) fn set_host_line(line: Option<Line>) {
    with(|wires| (wires.host_line, wires.is_pending) = (line, true));
}

pub(super) fn uart_line() -> Option<Line> {
    with(|wires| wires.uart.line)
}

pub(super) fn write(port: CablePort, bytes: &[u8]) {
    with(|wires| {
        wires.pipe(port).to_board.extend(bytes);
        wires.is_pending = true;
    });
}

pub(super) fn read(port: CablePort) -> Vec<u8> {
    with(|wires| {
        if port == CablePort::Control && wires.stalled {
            return Vec::new();
        }
        wires.is_pending = true;
        wires.pipe(port).to_host.drain(..).collect()
    })
}

pub(super) fn unread(port: CablePort) -> usize {
    with(|wires| wires.pipe(port).to_host.len())
}

pub(super) fn untaken(port: CablePort) -> usize {
    with(|wires| wires.pipe(port).to_board.len())
}

pub(super) fn stall(stalled: bool) {
    with(|wires| (wires.stalled, wires.is_pending) = (stalled, true));
}

/// Makes the board stop at each message, so that the computer reads it.
pub(super) fn set_watched(watched: bool) {
    with(|wires| wires.watched = watched);
}

/// Returns true if the computer is about to read.
fn is_read() -> bool {
    with(|wires| wires.watched && !wires.stalled && !wires.control.to_host.is_empty())
}

pub(super) fn catch(event: BoardEvent) {
    with(|wires| wires.caught.push_back((now(), event)));
}

pub(super) fn sent() -> Vec<(Instant, u8)> {
    with(|wires| wires.uart.sent.clone())
}

pub(super) fn steps() -> Vec<Instant> {
    with(|wires| wires.steps.clone())
}

pub(super) fn levels() -> Vec<(Instant, Pin, Option<bool>)> {
    with(|wires| wires.levels.clone())
}

/// Handles the interrupts that are due.
fn interrupt() {
    loop {
        let ended = with(|wires| {
            let uart = &mut wires.uart;
            let ended = uart.leaving.is_some_and(|end| end <= now());
            if ended {
                uart.leaving = None;
                uart.is_pending = true;
                uart.begin();
            }
            ended
        });
        if ended && with(|wires| wires.uart.leaving.is_none() && std::mem::take(&mut wires.uart.ends)) {
            SimulatedUart::bus().sent();
        }
        let sends = with(|wires| std::mem::take(&mut wires.uart.is_pending));
        if sends {
            SimulatedUart::bus().send();
        }
        let steps = STEP.get() <= now();
        if steps {
            STEP.set(Instant::NEVER);
            InMemory::axis().fire();
        }
        if !(ended || sends || steps) {
            return;
        }
    }
}

/// Time of the next interrupt.
fn next_interrupt() -> Instant {
    let uart = with(|wires| wires.uart.leaving).unwrap_or(Instant::NEVER);
    STEP.get().min(uart)
}

/// The UART.
pub(super) enum SimulatedUart {}

impl UartState {
    /// Begins to send the character that waits.
    fn begin(&mut self) {
        if self.leaving.is_none()
            && let Some(byte) = self.next.take()
        {
            self.sent.push((now(), byte));
            self.leaving = self.line.map(|line| now() + line.character());
        }
    }
}

impl Uart for SimulatedUart {
    fn bus() -> &'static SerialBus<Self> {
        BUS.get().expect("a board on this thread")
    }

    fn start() {}

    fn configure(line: Line) {
        with(|wires| wires.uart.line = Some(line));
    }

    fn has_room() -> bool {
        with(|wires| wires.uart.next.is_none())
    }

    fn write(byte: u8) {
        with(|wires| {
            wires.uart.next = Some(byte);
            wires.uart.begin();
        });
    }

    fn tap() -> Option<&'static Tap> {
        TAP.get()
    }

    fn pend() {
        with(|wires| wires.uart.is_pending = true);
    }

    fn turn(_sends: bool) {}

    fn end() {
        if Self::bus().begin_end() {
            if with(|wires| wires.uart.leaving.is_some()) {
                with(|wires| wires.uart.ends = true);
            } else {
                Self::bus().sent();
            }
        }
    }
}

/// STEP and DIR.
pub(super) struct Steps;

impl StepDir for Steps {
    fn rise(&mut self) {
        with(|wires| wires.steps.push(now()));
    }

    fn fall(&mut self) {}

    fn set_direction(&mut self, _forward: bool) {}
}

/// The step timer.
pub(super) struct StepClock;

impl Timer for StepClock {
    type Pins = Counted<Steps>;

    fn start() {}

    fn now() -> Instant {
        NOW.get()
    }

    fn set(at: Instant) -> bool {
        let comes = at > now();
        STEP.set(if comes { at } else { Instant::NEVER });
        comes
    }
}

/// A pin of the board.
#[derive(Debug)]
pub(super) struct Wired(Option<Pin>);

impl Wired {
    fn note(&self, level: Option<bool>) {
        if let Some(pin) = self.0 {
            with(|wires| wires.levels.push((now(), pin, level)));
        }
    }
}

impl Gpio for Wired {
    fn set(&self, high: bool, released: bool) {
        if !released {
            self.note(Some(high));
        }
    }

    fn release(&self, released: bool) {
        if released {
            self.note(None);
        }
    }
}

/// The cable.
pub(super) struct InMemoryCable;

impl Cable for InMemoryCable {
    fn is_pending() -> bool {
        with(|wires| wires.is_pending)
    }

    fn poll(&mut self) {
        with(|wires| wires.is_pending = false);
    }

    fn read(&mut self, port: CablePort, bytes: &mut [u8]) -> usize {
        with(|wires| {
            let pipe = wires.pipe(port);
            let count = bytes.len().min(pipe.to_board.len());
            for (place, byte) in bytes.iter_mut().zip(pipe.to_board.drain(..count)) {
                *place = byte;
            }
            count
        })
    }

    fn write(&mut self, port: CablePort, bytes: &[u8]) -> usize {
        with(|wires| {
            let pipe = wires.pipe(port);
            let room = if pipe.slow && !pipe.to_host.is_empty() { 0 } else { CABLE_ROOM };
            let count = bytes.len().min(room.saturating_sub(pipe.to_host.len()));
            pipe.to_host.extend(&bytes[..count]);
            count
        })
    }

    fn is_open(&self, port: CablePort) -> bool {
        with(|wires| wires.pipe(port).open)
    }

    fn line(&self) -> Option<Line> {
        with(|wires| wires.host_line)
    }
}

/// The saved registers.
pub(super) struct Flash(pub(super) Vec<u8>);

/// Offset outside the memory.
#[derive(Debug)]
pub(super) struct OutOfBounds;

impl AsRef<[u8]> for Flash {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl ReadStorage for Flash {
    type Error = OutOfBounds;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), OutOfBounds> {
        let source = self.0.get(offset as usize..).and_then(|rest| rest.get(..bytes.len()));
        bytes.copy_from_slice(source.ok_or(OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl Storage for Flash {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), OutOfBounds> {
        let offset = offset as usize;
        let place = self.0.get_mut(offset..offset + bytes.len()).ok_or(OutOfBounds)?;
        place.copy_from_slice(bytes);
        Ok(())
    }
}

/// The board.
pub(super) enum InMemory {}

impl InMemory {
    /// The drive's end of a wire. STEP and DIR have pins of their own if the drive uses them for nothing else.
    fn end(spec: &Spec, number: u8) -> Option<End> {
        let place = usize::from(number);
        if let Some(pin) = spec.pins.get(place) {
            let pulses = spec.axes.first().and_then(|axis| axis.step_dir);
            let is_own = pulses.is_some_and(|(step, dir)| step.0 == number || dir.0 == number)
                && pin.role == Role::Output;
            return (!is_own).then_some(End::Pin(Pin(number)));
        }
        let fault = place - spec.pins.len();
        if fault < spec.faults.len() {
            return Some(End::Fault(Fault(fault as u8)));
        }
        (fault == spec.faults.len() && is_full_duplex(spec)).then_some(End::Dtr(Port(0)))
    }
}

impl Board for InMemory {
    type Wire = u8;
    type Pin = Output<Wired>;
    type Uart = SimulatedUart;
    type Timer = StepClock;
    type Cable = InMemoryCable;

    const NAME: &'static str = "memory";

    fn axis() -> &'static Axis<StepClock> {
        AXIS.get().expect("a board on this thread")
    }

    fn start() -> Boot {
        Boot::default()
    }

    fn wire<const N: usize>(spec: &Spec, wires: &[u8; N]) -> [(Option<End>, Self::Pin); N] {
        wires.map(|number| {
            let end = Self::end(spec, number);
            let pin = match end {
                Some(End::Pin(pin)) => Some(pin),
                _ => None,
            };
            (end, Output::new(Wired(pin)))
        })
    }

    fn unmask() {}

    fn log(_kind: &str, _boot: Boot) {}

    fn past() -> Instant {
        NOW.get()
    }

    fn next_event(until: Instant) -> Option<(Instant, BoardEvent)> {
        with(|wires| {
            let is_due = wires.caught.front().is_some_and(|(at, _)| *at <= until);
            if is_due { wires.caught.pop_front() } else { None }
        })
    }

    fn is_quiet() -> bool {
        with(|wires| wires.caught.is_empty())
    }

    fn tell_missed() {}

    fn feed() {
        interrupt();
    }

    fn cable() -> InMemoryCable {
        InMemoryCable
    }

    fn sleep_until(deadline: Instant) {
        interrupt();
        while now() < deadline && now() < HORIZON.get() && !is_awake::<Self>() && !is_read() {
            NOW.set(deadline.min(HORIZON.get()).min(next_interrupt()).max(now()));
            interrupt();
        }
    }
}
