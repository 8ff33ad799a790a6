//! Stimulus from outside: pins, faults, power and registers.

use std::ops::RangeInclusive;

use drivetwin_firmware::device::{
    Axis, Duration, Encoder, EncoderSpec, Fault, Level, Pin, Port, PresetError,
};
use drivetwin_protocol::registers::Shape;
use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::events::EventKind;
use super::{Bench, Busy, DriveId, Motion, PinStimulus, PowerAction, Statistics, call_context};
use crate::record::trace::{Cut, InputRecord, Power};
use crate::scheduler::Phase;
use crate::slot::{EdgeTrain, PinState, PulseTrain, Signal};
use crate::value::Value;

/// Maximum number of edges per second: one per tick.
const MOST_HZ: f64 = TICKS_PER_SECOND as f64;

/// Least number of pulses or edges per second.
const LEAST_HZ: f64 = 1e-6;

/// Numbers of pulses per second of a pulse train: a pulse has two edges.
pub const PULSE_HZ: RangeInclusive<f64> = LEAST_HZ..=MOST_HZ / 2.0;

/// Numbers of edges per second of an encoder.
pub const ENCODER_HZ: RangeInclusive<f64> = LEAST_HZ..=MOST_HZ;

/// Ticks between edges at `hz` edges per second, clamped to the range from one edge per 1,000,000 s to one
/// per tick. NaN counts as the slowest rate.
fn ticks_per_edge(hz: f64) -> f64 {
    MOST_HZ / if hz > 0.0 { hz.clamp(LEAST_HZ, MOST_HZ) } else { LEAST_HZ }
}

/// Pins, faults, power and registers.
impl Bench {
    /// Drives a pin from outside. The change arrives one tick later. A pulse train or an encoder motion on
    /// the pin ends. The levels of [wires](Self::wire) count only while the stimulus is
    /// [`Open`](PinStimulus::Open). If there is no such pin, nothing happens.
    ///
    /// ```
    /// use drivetwin_firmware::device::{Duration, Level};
    /// use drivetwin_firmware::md3::Md3;
    /// use drivetwin_sim::bench::{Bench, PinStimulus};
    ///
    /// let mut bench = Bench::new();
    /// let drive = bench.add::<Md3>("x");
    /// let pin = bench.spec(drive).pin("J2.2").unwrap();
    /// bench.set_pin(drive, pin, PinStimulus::Low);
    /// bench.run_until(bench.now() + Duration::TICK);
    /// assert_eq!(bench.level(drive, pin), Level::Low);
    /// // Three pulses, away from the present level and back, at 1 kHz.
    /// bench.pulse(drive, pin, 3, 1_000.0)?;
    /// assert!(bench.pulse(drive, pin, 1, 1_000.0).is_err(), "a train runs");
    /// bench.run_until(bench.now() + Duration::millis(4));
    /// assert_eq!(bench.level(drive, pin), Level::Low);
    /// # Ok::<(), drivetwin_sim::bench::Busy>(())
    /// ```
    pub fn set_pin(&mut self, drive: DriveId, pin: Pin, stimulus: PinStimulus) {
        let at = self.now + Duration::TICK;
        let Some(state) = self.at_mut(drive).pin_mut(pin) else { return };
        state.train = None;
        state.stimulus = stimulus;
        for encoder in self.at_mut(drive).encoders_at(pin) {
            encoder.edges = None;
        }
        self.schedule(at, Phase::Pin, drive.0, EventKind::Stimulus { pin, stimulus });
    }

    /// Handles a stimulus that reaches a pin.
    pub(super) fn stimulus_arrives(&mut self, index: u32, pin: Pin, stimulus: PinStimulus) {
        if let Some(state) = self.slots[index as usize].pin_mut(pin) {
            state.stimulus_arrives(stimulus);
        }
        self.report_pin(index, pin);
    }

    /// Reports the signal at a pin to the drive, if it has changed.
    pub(super) fn report_pin(&mut self, index: u32, pin: Pin) {
        let Some(state) = self.slots[index as usize].pin(pin) else { return };
        let signal = state.seen();
        if signal != state.reported {
            self.deliver(index, &signal.input(pin));
        }
    }

    /// Starts a train of `count` pulses on an input pin, away from its present level and back, at `hz` pulses
    /// per second (clamped to 0.5 µHz to 8 MHz). The duty is 50 %. Each edge is at the nearest tick.
    ///
    /// # Errors
    /// A pulse train or an encoder motion runs on the pin.
    pub fn pulse(&mut self, drive: DriveId, pin: Pin, count: u32, hz: f64) -> Result<(), Busy> {
        self.pulse_width(drive, pin, count, hz, 0.5)
    }

    /// Like [`pulse`](Self::pulse), with a duty from 0 to 1, for instance to imitate a PWM encoder. A pulse
    /// is at least one tick long and at most one tick shorter than its period. NaN counts as 0.5.
    ///
    /// # Errors
    /// As [`pulse`](Self::pulse).
    pub fn pulse_width(
        &mut self,
        drive: DriveId,
        pin: Pin,
        count: u32,
        hz: f64,
        duty: f64,
    ) -> Result<(), Busy> {
        let start = self.now + Duration::TICK;
        if self.runs(drive, pin) {
            return Err(Busy);
        }
        let Some(state) = self.at_mut(drive).pin_mut(pin).filter(|_| count > 0) else { return Ok(()) };
        state.trains = state.trains.wrapping_add(1);
        let number = state.trains;
        let count = 2 * u64::from(count);
        let ticks_per_edge = ticks_per_edge(2.0 * hz);
        let most = ticks_per_edge - 1.0;
        let duty = if duty.is_nan() { 0.5 } else { duty };
        let second_later = ((2.0 * duty - 1.0) * ticks_per_edge).clamp(-most, most);
        let edges = EdgeTrain { start, ticks_per_edge, second_later, made: 0, count };
        let train = PulseTrain { edges, rest: state.is_high(), before: state.stimulus };
        state.train = Some(Box::new(train));
        self.schedule(start, Phase::Pin, drive.0, EventKind::Pulse { pin, number });
        Ok(())
    }

    /// Handles the next edge of a pulse train.
    pub(super) fn pulse_edge(&mut self, index: u32, pin: Pin, number: u32) {
        let Some(state) = self.slots[index as usize].pin_mut(pin).filter(|state| state.trains == number)
        else {
            return;
        };
        let Some(train) = &mut state.train else { return };
        let high = train.rest == (train.edges.made % 2 == 1);
        let before = train.before;
        train.edges.made += 1;
        let due = train.edges.due();
        let stimulus = if high { PinStimulus::High } else { PinStimulus::Low };
        state.stimulus = stimulus;
        state.stimulus_arrives(stimulus);
        match due {
            Some(due) => self.schedule(due, Phase::Pin, index, EventKind::Pulse { pin, number }),
            None => (state.train, state.stimulus) = (None, before),
        }
        self.report_pin(index, pin);
        if due.is_none() {
            self.stimulus_arrives(index, pin, before);
        }
    }

    /// Turns the encoder at a drive's inputs A and B by `counts` edges, four per cycle, at `hz` edges per
    /// second (clamped to 1 µHz to 16 MHz). It starts from the present levels. A leads B; with negative
    /// `counts` B leads A. Each edge is at the nearest tick, and the pins keep the levels of the last edges.
    /// For an index pulse use [`set_pin`](Self::set_pin).
    ///
    /// # Errors
    /// The encoder turns already, or a pulse train is running on A or B.
    pub fn encoder(&mut self, drive: DriveId, encoder: Encoder, counts: i32, hz: f64) -> Result<(), Busy> {
        let start = self.now + Duration::TICK;
        let Some((_, &EncoderSpec { a, b, .. })) = self.at_mut(drive).encoder_mut(encoder) else {
            return Ok(());
        };
        if self.runs(drive, a) || self.runs(drive, b) {
            return Err(Busy);
        }
        let Some((state, _)) = self.at_mut(drive).encoder_mut(encoder).filter(|_| counts != 0) else {
            return Ok(());
        };
        state.turns = state.turns.wrapping_add(1);
        state.back = counts < 0;
        let number = state.turns;
        let count = u64::from(counts.unsigned_abs());
        state.edges =
            Some(EdgeTrain { start, ticks_per_edge: ticks_per_edge(hz), second_later: 0.0, made: 0, count });
        self.schedule(start, Phase::Pin, drive.0, EventKind::Encoder { encoder, number });
        Ok(())
    }

    /// Handles the next edge of an encoder.
    pub(super) fn encoder_edge(&mut self, index: u32, encoder: Encoder, number: u32) {
        let slot = &mut self.slots[index as usize];
        let Some((state, spec)) = slot.encoder_mut(encoder).filter(|(state, _)| state.turns == number) else {
            return;
        };
        let (back, Some(edges)) = (state.back, &mut state.edges) else { return };
        let is_first = edges.made == 0;
        edges.made += 1;
        let due = edges.due();
        if due.is_none() {
            state.edges = None;
        }
        let high = |pin| slot.pin(pin).is_some_and(PinState::is_high);
        // If A leads, A changes while A and B have the same level.
        let pin = if (high(spec.a) == high(spec.b)) == back { spec.b } else { spec.a };
        let stimulus = if high(pin) { PinStimulus::Low } else { PinStimulus::High };
        if let Some(due) = due {
            self.schedule(due, Phase::Pin, index, EventKind::Encoder { encoder, number });
        }
        if is_first {
            self.drive_channels(index, *spec);
        }
        if let Some(state) = self.slots[index as usize].pin_mut(pin) {
            state.stimulus = stimulus;
        }
        self.stimulus_arrives(index, pin, stimulus);
    }

    /// Drives both channels of an encoder that begins to turn. Otherwise a drive that distinguishes an open
    /// pin from a high one would miss the first edges.
    fn drive_channels(&mut self, index: u32, EncoderSpec { a, b, .. }: EncoderSpec) {
        for pin in [a, b] {
            let Some(state) = self.slots[index as usize].pin_mut(pin) else { continue };
            if state.seen() == Signal::Open {
                state.stimulus = PinStimulus::High;
                self.stimulus_arrives(index, pin, PinStimulus::High);
            }
        }
    }

    /// Returns true if a pulse train or an encoder motion is running on a pin.
    fn runs(&mut self, drive: DriveId, pin: Pin) -> bool {
        let slot = self.at_mut(drive);
        slot.encoders_at(pin).any(|encoder| encoder.edges.is_some())
            || slot.pin(pin).is_some_and(|state| state.train.is_some())
    }

    /// The level at a pin now, as measured from outside.
    #[must_use]
    pub fn level(&self, drive: DriveId, pin: Pin) -> Level {
        self.at(drive).level(self.now, pin)
    }

    /// The level that a drive outputs at a pin now; [`Level::Float`] if the drive does not drive the pin.
    #[must_use]
    pub fn output(&self, drive: DriveId, pin: Pin) -> Level {
        self.at(drive).driven(self.now, pin)
    }

    /// Sets (`true`) or clears the cause of a fault.
    pub fn fault(&mut self, drive: DriveId, fault: Fault, on: bool) {
        let at = self.at(drive).free(self.now, Phase::Fault);
        self.send_to(at, drive.0, InputRecord::Fault { fault, on });
    }

    /// Returns true if the cause of a fault is present.
    #[must_use]
    pub fn faulty(&self, drive: DriveId, fault: Fault) -> bool {
        self.at(drive).state.faults.get(usize::from(fault.0)).copied().unwrap_or(false)
    }

    /// Switches the power of a drive, now or one tick later.
    pub fn power(&mut self, drive: DriveId, action: PowerAction) {
        let at = self.at(drive).free(self.now, Phase::Power);
        let power = match action {
            PowerAction::Off | PowerAction::Cycle => Power::Off,
            PowerAction::On => Power::On,
            PowerAction::Cut => Power::Cut(None),
        };
        self.send_to(at, drive.0, InputRecord::Power(power));
        if action == PowerAction::Cycle {
            self.send_to(at + Duration::TICK, drive.0, InputRecord::Power(Power::On));
        }
    }

    /// Makes the power of a drive fail in a later save, at an exact point. [`PowerAction::Cut`] chooses the
    /// point at random, and never before the first or after the last byte.
    pub fn cut_power(&mut self, drive: DriveId, cut: Cut) {
        let at = self.at(drive).free(self.now, Phase::Power);
        self.send_to(at, drive.0, InputRecord::Power(Power::Cut(Some(cut))));
    }

    /// Returns true if a drive has power.
    #[must_use]
    pub fn powered(&self, drive: DriveId) -> bool {
        self.at(drive).state.powered
    }

    /// Presets a register directly, not through its bus. `row` is the row of the register map
    /// ([`Spec::find`](drivetwin_firmware::device::Spec::find)).
    ///
    /// # Errors
    /// The drive refuses the value; nothing changes then. A drive without power refuses every value:
    /// [`PresetError::ReadOnly`].
    pub fn poke(&mut self, drive: DriveId, row: usize, value: i64) -> Result<(), PresetError> {
        // All other events of this instant are handled first, because a replay does the same.
        self.run_until(self.now);
        if !self.powered(drive) {
            return Err(PresetError::ReadOnly);
        }
        let mut context = call_context(&mut self.trace, &mut self.outputs, self.settings);
        let result =
            self.slots[drive.0 as usize].feed(self.now, &InputRecord::Poke { row, value }, &mut context);
        self.finish_call(drive.0);
        self.run_until(self.now);
        result
    }

    /// The present value of a register, without the side effects of a bus read. `row` is the row of the
    /// register map.
    #[must_use]
    pub fn peek(&self, drive: DriveId, row: usize) -> i64 {
        self.at(drive).peek(self.now, row)
    }

    /// The value of a register as users see it: a number, or a list of words.
    #[must_use]
    pub fn value(&self, drive: DriveId, row: usize) -> Value {
        let table = self.spec(drive).registers;
        let shape = table.list.get(row).map_or(Shape::U16, |entry| entry.shape);
        let value = self.peek(drive, row);
        Value::with_words(shape, value, |n| match shape {
            Shape::Words(5..) => self.at(drive).peek_word(self.now, row, n),
            _ => table.word(shape, value, n),
        })
    }

    /// Present motion of an axis: position in steps or counts, speed, current. With an attached brush motor
    /// it is the motion of that motor.
    #[must_use]
    pub fn motion(&self, drive: DriveId, axis: Axis) -> Motion {
        self.shaft(drive, axis).map_or_else(|| self.at(drive).motion(self.now, axis), Motion::from)
    }

    /// Number of the line of a drive's user program that is executed next; `None` if no program runs.
    /// [`programs::listing`](crate::programs::listing) has the same numbers.
    #[must_use]
    pub fn program_line(&self, drive: DriveId) -> Option<u16> {
        self.at(drive).program_line()
    }

    /// Statistics of a port since its drive was added.
    #[must_use]
    pub fn statistics(&self, drive: DriveId, port: Port) -> Statistics {
        self.at(drive).state.ports.get(usize::from(port.0)).map(|port| port.statistics).unwrap_or_default()
    }

    /// Content of the non-volatile memory of a drive.
    #[must_use]
    pub fn memory(&self, drive: DriveId) -> &[u8] {
        &self.at(drive).state.memory
    }
}
