//! Outputs of a drive on a board with a cable: those of the board, noted for the computer, and a memory in which power
//! can fail.

use drivetwin_control::{Event, Motion, Statistics};
use drivetwin_firmware::device::{
    self, AxisSpec, Duration, Input, Instant, Level, Line, Output, Pin, Plan, Port, Role, Shaft, Spec,
};
use drivetwin_firmware::motion::StepGenerator;
use drivetwin_firmware::shell::{Links, Outputs};
use embedded_storage::{ReadStorage, Storage};

use super::motion::{Commanded, of_shaft};
use super::trace::{PART, Trace};
use super::{convert, counts};
use crate::board::{Board, OutputsOf};
use crate::board_outputs::Bus;
use crate::bus::{Sender, Uart};

/// Failure of the power in a store.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Cut {
    No,
    /// Power fails in the next store.
    Armed,
    /// Power fails in this store, after this number of bytes. All later outputs are lost.
    Failed(usize),
}

/// Levels that the drive gives to its pins.
#[derive(Debug)]
struct Driven {
    /// STEP and DIR of the axis.
    step_dir: Option<(Pin, Pin)>,
    /// One bit for each pin: driven at all, driven high, STEP or DIR of an axis that makes pulses.
    driven: u32,
    high: u32,
    lent: u32,
}

impl Driven {
    fn new(spec: &Spec) -> Self {
        let step_dir = match spec.axes {
            [AxisSpec { step_dir, .. }, ..] => *step_dir,
            [] => None,
        };
        let mut driven = Self { step_dir, driven: 0, high: 0, lent: 0 };
        driven.reset(spec);
        driven
    }

    /// Drives nothing. The axis has the pins that are for pulses only.
    fn reset(&mut self, spec: &Spec) {
        let only_pulses =
            |pin: &Pin| spec.pins.get(usize::from(pin.0)).is_some_and(|pin| pin.role == Role::Output);
        let pins = self.step_dir.into_iter().flat_map(|(step, dir)| [step, dir]);
        (self.driven, self.high) = (0, 0);
        self.lent = pins.filter(only_pulses).fold(0, |lent, pin| lent | bit(pin));
    }

    fn note(&mut self, output: &Output<'_>) {
        let (pin, level) = match *output {
            Output::Level { pin, level } => (pin, level),
            // Its level is asked for.
            Output::Wave { pin, .. } => (pin, Level::High),
            Output::Plan { .. } => {
                self.lent |= self.step_dir.map_or(0, |(step, dir)| bit(step) | bit(dir));
                return;
            }
            _ => return,
        };
        let set = |bits: u32, on: bool| if on { bits | bit(pin) } else { bits & !bit(pin) };
        self.driven = set(self.driven, level != Level::Float);
        self.high = set(self.high, level == Level::High);
        self.lent = set(self.lent, false);
    }

    /// Level of a pin. `is_forward` is the level of DIR, if the axis has it.
    fn level(&self, pin: Pin, is_forward: bool) -> Level {
        let is_in = |bits: u32| bits & bit(pin) != 0;
        let is_high = match self.step_dir {
            // STEP is high for microseconds only.
            Some((_, dir)) if is_in(self.lent) => pin == dir && is_forward,
            _ if !is_in(self.driven) => return Level::Float,
            _ => is_in(self.high),
        };
        if is_high { Level::High } else { Level::Low }
    }
}

fn bit(pin: Pin) -> u32 {
    1_u32.checked_shl(pin.0.into()).unwrap_or(0)
}

/// Outputs of a drive on a board with a cable.
pub(crate) struct StationOutputs<'a, B: Board, M, L, const WIRES: usize> {
    outputs: OutputsOf<B, M, L, WIRES>,
    spec: &'static Spec,
    is_on: bool,
    /// Settings of the line, and those that it gets when all characters have left.
    line: Line,
    next_line: Option<Line>,
    driven: Driven,
    commanded: Commanded,
    statistics: Statistics,
    cut: Cut,
    trace: Trace<'a>,
}

impl<'a, B: Board, M, L, const WIRES: usize> StationOutputs<'a, B, M, L, WIRES>
where
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    pub(crate) fn new(spec: &'static Spec, outputs: OutputsOf<B, M, L, WIRES>, ring: &'a mut [u8]) -> Self {
        Self {
            outputs,
            spec,
            is_on: false,
            line: factory_line(spec),
            next_line: None,
            driven: Driven::new(spec),
            commanded: Commanded::at_rest(Instant::ZERO, 0),
            statistics: Statistics::default(),
            cut: Cut::No,
            trace: Trace::new(ring),
        }
    }

    /// Notes that the drive gets power at `at`.
    pub(crate) fn power_on(&mut self, at: Instant) {
        self.is_on = true;
        self.driven.reset(self.spec);
        self.commanded = Commanded::at_rest(at, 0);
        self.trace.put(at, &Event::Power(true));
    }

    /// Ends all outputs of a drive that loses its power at `at`. Its shaft stands at `position`.
    pub(crate) fn power_off(&mut self, at: Instant, position: i32) {
        self.is_on = false;
        self.outputs.power_off();
        B::Uart::bus().silence();
        self.commanded = Commanded::at_rest(at, position);
        if self.cut == Cut::No || self.cut == Cut::Armed {
            self.trace.put(at, &Event::Power(false));
        } else {
            self.cut = Cut::No;
        }
    }

    /// Makes the power fail in the middle of the next store, or no longer.
    pub(crate) fn set_cut(&mut self, on: bool) {
        self.cut = if on { Cut::Armed } else { Cut::No };
    }

    /// Returns true if the power has failed in a store.
    pub(crate) fn has_failed(&self) -> bool {
        matches!(self.cut, Cut::Failed(_))
    }

    /// Present settings of the line.
    pub(crate) fn line(&mut self) -> Line {
        if !B::Uart::bus().is_changing()
            && let Some(line) = self.next_line.take()
        {
            self.line = line;
        }
        self.line
    }

    /// The level that the drive gives to a pin, except for a wave.
    pub(crate) fn level(&mut self, pin: Pin) -> Level {
        if !self.is_on {
            return Level::Float;
        }
        let is_forward = self.outputs.axis.look(StepGenerator::is_forward).unwrap_or_default();
        self.driven.level(pin, is_forward)
    }

    /// The motion of the first axis at `at`. `shaft` is the motion of the motor, if the drive has one inside.
    pub(crate) fn motion(&mut self, at: Instant, shaft: Option<Shaft>) -> Option<Motion> {
        if self.spec.axes.is_empty() {
            return None;
        }
        let pulses = self.outputs.axis.look(StepGenerator::pulses).unwrap_or_default();
        Some(match shaft.filter(|_| self.is_on) {
            Some(shaft) => of_shaft(shaft, pulses),
            None => self.commanded.motion(at, pulses),
        })
    }

    /// The counts of requests.
    pub(crate) fn statistics(&self) -> Statistics {
        self.statistics
    }

    /// The trace.
    pub(crate) fn trace(&mut self) -> &mut Trace<'a> {
        &mut self.trace
    }

    /// Notes an input of the drive.
    #[inline(never)]
    fn trace_input(&mut self, at: Instant, input: &Input<'_>) {
        if !self.has_failed()
            && let Some(event) = convert::input(input)
        {
            self.trace.put(at, &event);
        }
    }

    /// Notes characters that the drive sends from `at` on.
    fn trace_sent(&mut self, mut at: Instant, port: Port, bytes: &[u8]) {
        if self.trace.is_on() {
            let character = self.next_line.unwrap_or(self.line).character();
            for part in bytes.chunks(PART) {
                self.trace.put(at, &Event::Sent(port.0, part));
                at += character * part.len() as u64;
            }
        }
    }

    /// Notes a store, and how much of it is done before the power fails: a half, and at least one byte that changes
    /// (BOARD-16).
    fn note_store(&mut self, at: Instant, offset: u16, bytes: &[u8]) {
        let mut done = bytes;
        if self.is_on && self.cut == Cut::Armed {
            let old = self.outputs.stored().get(usize::from(offset)..).unwrap_or_default();
            let same = old.iter().zip(bytes).take_while(|(old, new)| old == new).count();
            let count = (bytes.len() / 2).max(same + 1).min(bytes.len());
            done = bytes.get(..count).unwrap_or(bytes);
            self.cut = Cut::Failed(count);
        }
        if self.trace.is_on() {
            for (part, number) in done.chunks(PART).zip(0..) {
                self.trace.put(at, &Event::Store(offset + PART as u16 * number, part));
            }
            if self.has_failed() {
                self.trace.put(at, &Event::Cut(done.len() as u16));
            }
        }
    }
}

/// Settings of the line of a drive that has set none.
fn factory_line(spec: &Spec) -> Line {
    const NONE: Line = Line::new(0, 8, drivetwin_protocol::line::Parity::None, 1);
    spec.ports.iter().find_map(|port| port.line).unwrap_or(NONE)
}

impl<B: Board, M, L, const WIRES: usize> Outputs for StationOutputs<'_, B, M, L, WIRES>
where
    M: Storage + AsRef<[u8]>,
    L: Links,
{
    type Serial = Sender<B::Uart>;
    type Pin = B::Pin;
    type Memory = Self;
    type Links = L;

    fn serial(&mut self, port: Port) -> Option<&mut Self::Serial> {
        self.outputs.serial(port)
    }

    fn links(&mut self) -> Option<&mut L> {
        self.outputs.links()
    }

    fn set_line(&mut self, _port: Port, line: Line) {
        if !self.has_failed() {
            self.next_line = Some(line);
            self.outputs.bus.set_line(line);
        }
    }

    fn pin(&mut self, pin: Pin) -> Option<&mut B::Pin> {
        if self.has_failed() { None } else { self.outputs.pin(pin) }
    }

    fn release(&mut self, pin: Pin, released: bool) {
        if !self.has_failed() {
            self.outputs.release(pin, released);
        }
    }

    fn memory(&mut self) -> &mut Self {
        self
    }

    fn stored(&self) -> &[u8] {
        self.outputs.stored()
    }

    fn plan(&mut self, axis: device::Axis, plan: &Plan) -> Duration {
        if self.has_failed() { Duration::ZERO } else { self.outputs.plan(axis, plan) }
    }

    fn wait(&mut self, late: Duration) {
        self.outputs.wait(late);
    }

    fn step(&mut self, axis: device::Axis, steps: i32) {
        if !self.has_failed() {
            self.outputs.step(axis, steps);
        }
    }

    #[inline]
    fn note_input(&mut self, at: Instant, input: &Input<'_>) {
        if self.trace.is_on() {
            self.trace_input(at, input);
        }
    }

    fn note_output(&mut self, at: Instant, output: &Output<'_>) {
        if self.has_failed() {
            return;
        }
        self.driven.note(output);
        self.commanded.note(output);
        match *output {
            Output::Log(note) => counts::count(&mut self.statistics, note),
            Output::Bytes { port, bytes } => self.trace_sent(at, port, bytes),
            Output::Store { offset, bytes } => self.note_store(at, offset, bytes),
            _ if self.trace.is_on() => {
                if let Some(event) = convert::output(output) {
                    self.trace.put(at, &event);
                }
            }
            _ => {}
        }
    }
}

impl<B: Board, M, L, const WIRES: usize> ReadStorage for StationOutputs<'_, B, M, L, WIRES>
where
    M: Storage,
{
    type Error = M::Error;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), M::Error> {
        self.outputs.memory.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.outputs.memory.capacity()
    }
}

impl<B: Board, M, L, const WIRES: usize> Storage for StationOutputs<'_, B, M, L, WIRES>
where
    M: Storage,
{
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), M::Error> {
        match self.cut {
            Cut::No | Cut::Armed => self.outputs.memory.write(offset, bytes),
            // Only the store in which the power fails writes. `note_store` has noted it just before.
            Cut::Failed(count) => {
                self.cut = Cut::Failed(0);
                self.outputs.memory.write(offset, bytes.get(..count).unwrap_or(bytes))
            }
        }
    }
}
