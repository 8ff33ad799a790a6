//! Stimulus from outside: pins, faults, power, registers.

use drivetwin_firmware::device::{
    Axis, Duration, Encoder, EncoderSpec, Fault, Level, Pin, Port, PresetError,
};
use drivetwin_protocol::registers::Shape;
use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::events::EventKind;
use super::{Bench, Busy, DriveId, Motion, PinStimulus, PowerAction, Statistics, tape};
use crate::record::trace::{InputRecord, Power};
use crate::scheduler::Phase;
use crate::slot::{EdgeTrain, PinState, PulseTrain, Signal};
use crate::value::Value;

/// The most edges a second: one a tick.
const MOST_HZ: f64 = TICKS_PER_SECOND as f64;

/// Ticks between edges of which `hz` come in a second, limited to one in 1,000,000 s and one a tick.
/// Not a number counts as the least.
fn ticks_per_edge(hz: f64) -> f64 {
    MOST_HZ / if hz > 0.0 { hz.clamp(1e-6, MOST_HZ) } else { 1e-6 }
}

/// Pins, faults, power and registers.
impl Bench {
    /// Drives a pin from outside, and ends a train of pulses, or the turning of an encoder, there. It
    /// arrives a tick later. Whatever [wires](Self::wire) do to the pin counts only while it is open.
    pub fn set_pin(&mut self, seat: DriveId, pin: Pin, drive: PinStimulus) {
        let at = self.now + Duration::TICK;
        let Some(state) = self.at_mut(seat).pin_mut(pin) else { return };
        state.train = None;
        state.hands = drive;
        for encoder in self.at_mut(seat).encoders_at(pin) {
            encoder.edges = None;
        }
        self.schedule(at, Phase::Pin, seat.0, EventKind::Hand { pin, drive });
    }

    /// A change of a pin from outside arrives.
    pub(super) fn hand(&mut self, place: u32, pin: Pin, drive: PinStimulus) {
        if let Some(state) = self.seats[place as usize].pin_mut(pin) {
            state.hold(drive);
        }
        self.look(place, pin);
    }

    /// Tells a device what it sees at a pin, if that is news.
    pub(super) fn look(&mut self, place: u32, pin: Pin) {
        let Some(state) = self.seats[place as usize].pin(pin) else { return };
        let signal = state.seen();
        if signal != state.told {
            self.deliver(place, &signal.fed(pin));
        }
    }

    /// A train of `count` pulses on an input pin, away from its present level and back, `hz` a
    /// second (limited to 0.5 µHz to 8 MHz), each of half its period. Edges are made one by one as time comes
    /// to them, each at the tick nearest to its instant.
    ///
    /// # Errors
    /// One runs there already, or an encoder turns.
    pub fn pulse(&mut self, seat: DriveId, pin: Pin, count: u32, hz: f64) -> Result<(), Busy> {
        self.pulse_width(seat, pin, count, hz, 0.5)
    }

    /// As [`pulse`](Self::pulse), with pulses that take the share `duty` of their period, as a PWM encoder
    /// makes them: from 0 to 1, but a tick at least, and a tick less than the period at most. Not a number
    /// counts as a half.
    ///
    /// # Errors
    /// As [`pulse`](Self::pulse).
    pub fn pulse_width(
        &mut self,
        seat: DriveId,
        pin: Pin,
        count: u32,
        hz: f64,
        duty: f64,
    ) -> Result<(), Busy> {
        let start = self.now + Duration::TICK;
        if self.runs(seat, pin) {
            return Err(Busy);
        }
        let Some(state) = self.at_mut(seat).pin_mut(pin).filter(|_| count > 0) else { return Ok(()) };
        state.trains = state.trains.wrapping_add(1);
        let number = state.trains;
        let count = 2 * u64::from(count);
        let ticks_per_edge = ticks_per_edge(2.0 * hz);
        let most = ticks_per_edge - 1.0;
        let duty = if duty.is_nan() { 0.5 } else { duty };
        let second_later = ((2.0 * duty - 1.0) * ticks_per_edge).clamp(-most, most);
        let edges = EdgeTrain { start, ticks_per_edge, second_later, made: 0, count };
        state.train = Some(PulseTrain { edges, rest: state.is_high(), before: state.hands });
        self.schedule(start, Phase::Pin, seat.0, EventKind::Pulse { pin, number });
        Ok(())
    }

    /// The next edge of a train.
    pub(super) fn pulse_edge(&mut self, place: u32, pin: Pin, number: u32) {
        let Some(state) = self.seats[place as usize].pin_mut(pin).filter(|state| state.trains == number)
        else {
            return;
        };
        let Some(train) = &mut state.train else { return };
        let high = train.rest == (train.edges.made % 2 == 1);
        let before = train.before;
        train.edges.made += 1;
        let due = train.edges.due();
        let drive = if high { PinStimulus::High } else { PinStimulus::Low };
        state.hands = drive;
        state.hold(drive);
        match due {
            Some(due) => self.schedule(due, Phase::Pin, place, EventKind::Pulse { pin, number }),
            None => (state.train, state.hands) = (None, before),
        }
        self.look(place, pin);
        if due.is_none() {
            self.hand(place, pin, before);
        }
    }

    /// Turns the encoder at a device's inputs A and B: `counts` edges, four to a cycle, `hz` a second
    /// (limited to 1 µHz to 16 MHz), from the present levels; A leads B, or B leads A if `counts` is
    /// negative. Edges are made one by one as time comes to them, each at the tick nearest to its
    /// instant; the pins keep the levels of the last ones. An index pulse is for hands to
    /// [make](Self::set_pin).
    ///
    /// # Errors
    /// It turns already, or a train of pulses runs on A or B.
    pub fn encoder(&mut self, seat: DriveId, encoder: Encoder, counts: i32, hz: f64) -> Result<(), Busy> {
        let start = self.now + Duration::TICK;
        let Some((_, &EncoderSpec { a, b, .. })) = self.at_mut(seat).encoder_mut(encoder) else {
            return Ok(());
        };
        if self.runs(seat, a) || self.runs(seat, b) {
            return Err(Busy);
        }
        let Some((state, _)) = self.at_mut(seat).encoder_mut(encoder).filter(|_| counts != 0) else {
            return Ok(());
        };
        state.turns = state.turns.wrapping_add(1);
        state.back = counts < 0;
        let number = state.turns;
        let count = u64::from(counts.unsigned_abs());
        state.edges =
            Some(EdgeTrain { start, ticks_per_edge: ticks_per_edge(hz), second_later: 0.0, made: 0, count });
        self.schedule(start, Phase::Pin, seat.0, EventKind::Encoder { encoder, number });
        Ok(())
    }

    /// The next edge of an encoder.
    pub(super) fn encoder_edge(&mut self, place: u32, encoder: Encoder, number: u32) {
        let seated = &mut self.seats[place as usize];
        let Some((state, spec)) = seated.encoder_mut(encoder).filter(|(state, _)| state.turns == number)
        else {
            return;
        };
        let (back, Some(edges)) = (state.back, &mut state.edges) else { return };
        let is_first = edges.made == 0;
        edges.made += 1;
        let due = edges.due();
        if due.is_none() {
            state.edges = None;
        }
        let high = |pin| seated.pin(pin).is_some_and(PinState::is_high);
        // Where A leads, A changes while the two are alike.
        let pin = if (high(spec.a) == high(spec.b)) == back { spec.b } else { spec.a };
        let drive = if high(pin) { PinStimulus::Low } else { PinStimulus::High };
        if let Some(due) = due {
            self.schedule(due, Phase::Pin, place, EventKind::Encoder { encoder, number });
        }
        if is_first {
            self.plug(place, *spec);
        }
        if let Some(state) = self.seats[place as usize].pin_mut(pin) {
            state.hands = drive;
        }
        self.hand(place, pin, drive);
    }

    /// An encoder that begins to turn drives both of its channels: a device that tells an open pin from a high one
    /// would not see its first edges else.
    fn plug(&mut self, place: u32, EncoderSpec { a, b, .. }: EncoderSpec) {
        for pin in [a, b] {
            let Some(state) = self.seats[place as usize].pin_mut(pin) else { continue };
            if state.seen() == Signal::Open {
                state.hands = PinStimulus::High;
                self.hand(place, pin, PinStimulus::High);
            }
        }
    }

    /// Returns whether a train of pulses, or an encoder, runs on a pin.
    fn runs(&mut self, seat: DriveId, pin: Pin) -> bool {
        let seated = self.at_mut(seat);
        seated.encoders_at(pin).any(|encoder| encoder.edges.is_some())
            || seated.pin(pin).is_some_and(|state| state.train.is_some())
    }

    /// A pin as it is seen from outside now.
    #[must_use]
    pub fn level(&self, seat: DriveId, pin: Pin) -> Level {
        self.at(seat).level(self.now, pin)
    }

    /// The cause of a fault comes or goes.
    pub fn fault(&mut self, seat: DriveId, fault: Fault, on: bool) {
        let at = self.at(seat).free(self.now, Phase::Fault);
        self.send_to(at, seat.0, InputRecord::Fault { fault, on });
    }

    /// Returns whether the cause of a fault is present.
    #[must_use]
    pub fn faulty(&self, seat: DriveId, fault: Fault) -> bool {
        self.at(seat).body.faults.get(usize::from(fault.0)).copied().unwrap_or(false)
    }

    /// Does something to a device's power, now or a tick later.
    pub fn power(&mut self, seat: DriveId, action: PowerAction) {
        let at = self.at(seat).free(self.now, Phase::Power);
        let power = match action {
            PowerAction::Off | PowerAction::Cycle => Power::Off,
            PowerAction::On => Power::On,
            PowerAction::Cut => Power::Cut(None),
        };
        self.send_to(at, seat.0, InputRecord::Power(power));
        if action == PowerAction::Cycle {
            self.send_to(at + Duration::TICK, seat.0, InputRecord::Power(Power::On));
        }
    }

    /// Returns whether a device has power.
    #[must_use]
    pub fn powered(&self, seat: DriveId) -> bool {
        self.at(seat).body.powered
    }

    /// Presets a register past the bus.
    ///
    /// # Errors
    /// The device refuses it; nothing has changed then. Without power it takes nothing.
    pub fn poke(&mut self, seat: DriveId, row: usize, value: i64) -> Result<(), PresetError> {
        // After all else that happens now, so that a replay does the same.
        self.run_until(self.now);
        if !self.powered(seat) {
            return Err(PresetError::ReadOnly);
        }
        let mut tape = tape(&mut self.trace, &mut self.outbox, self.settings);
        let result = self.seats[seat.0 as usize].feed(self.now, &InputRecord::Poke { row, value }, &mut tape);
        self.after(seat.0);
        self.run_until(self.now);
        result
    }

    /// A register as it reads now, without the bus's side effects.
    #[must_use]
    pub fn peek(&self, seat: DriveId, row: usize) -> i64 {
        self.at(seat).peek(self.now, row)
    }

    /// The same as users see it.
    #[must_use]
    pub fn value(&self, seat: DriveId, row: usize) -> Value {
        let table = self.spec(seat).registers;
        let shape = table.list.get(row).map_or(Shape::U16, |entry| entry.shape);
        let value = self.peek(seat, row);
        Value::with_words(shape, value, |n| match shape {
            Shape::Words(5..) => self.at(seat).peek_word(self.now, row, n),
            _ => table.word(shape, value, n),
        })
    }

    /// Motion of an axis now; with a motor of the bench that motor's.
    #[must_use]
    pub fn motion(&self, seat: DriveId, axis: Axis) -> Motion {
        self.shaft(seat, axis).map_or_else(|| self.at(seat).motion(self.now, axis), Motion::from)
    }

    /// Statistics of a port since its device was added.
    #[must_use]
    pub fn statistics(&self, seat: DriveId, port: Port) -> Statistics {
        self.at(seat).body.ports.get(usize::from(port.0)).map(|port| port.statistics).unwrap_or_default()
    }

    /// The non-volatile memory of a device.
    #[must_use]
    pub fn memory(&self, seat: DriveId) -> &[u8] {
        &self.at(seat).body.memory
    }
}
