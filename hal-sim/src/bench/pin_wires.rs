//! Wires from output pins to input pins, and step pulses.

use drivetwin_firmware::device::{Axis, Duration, Instant, Level, Pin};

use super::events::EventKind;
use super::{Bench, DriveId, PinStimulus};
use crate::scheduler::Phase;
use crate::signals::pulses::{self, Pulse};
use crate::slot::PinChange;

/// A wire.
pub(super) struct PinWire {
    to: (DriveId, Pin),
    /// Level that has arrived at its end.
    level: Level,
}

/// The STEP output of an axis, see [`DriveId::step`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StepOutput {
    seat: DriveId,
    axis: Axis,
}

impl DriveId {
    /// The STEP output of the device's first axis, to count [pulses](Bench::pulses) on.
    #[must_use]
    pub fn step(self) -> StepOutput {
        StepOutput { seat: self, axis: Axis(0) }
    }
}

/// Wires and step pulses.
impl Bench {
    /// The pulses on a STEP output that have begun by now, from the beginning of time. They are walked
    /// from the plans and steps in the [trace](Self::trace).
    ///
    /// # Panics
    /// If the axis has no such output, or if the trace does not hold all that happened: then there
    /// is no telling. Keep all of it with [`Retention::All`](crate::record::trace::Retention::All).
    pub fn pulses(&self, of: StepOutput) -> impl Iterator<Item = Pulse> {
        let StepOutput { seat, axis } = of;
        let spec = self.spec(seat).axes.get(usize::from(axis.0));
        let name = self.name(seat);
        assert!(spec.is_some_and(|axis| axis.step_dir.is_some()), "{name} has no STEP output");
        assert!(
            self.trace.is_whole(),
            "the pulses of {name} cannot be counted: the trace has lost its beginning, or keeps nothing; \
             give the bench `TraceKeep::All`",
        );
        pulses::pulses(&self.trace, seat.0 as usize, axis, self.now)
    }

    /// Wires an output pin to an input pin, for good. A drive that was seated at this instant finds the output's level
    /// at power-on, and no edge. What the output does arrives a tick later: the levels it is set to, each edge of a
    /// wave, each step pulse and each change of direction; an output that floats leaves the input to its pull-up. Edges
    /// are made only while a wire is there.
    ///
    /// Several outputs may be wired to one input: low wins over high (BENCH-9). An input that
    /// [hands](Self::set_pin) hold sees only them, until they let go.
    ///
    /// # Panics
    /// If a pin is not there.
    pub fn wire(&mut self, from: (DriveId, Pin), to: (DriveId, Pin)) {
        let (seat, pin) = from;
        assert!(self.at(seat).pin(pin).is_some(), "{} has no pin {}", self.name(seat), pin.0);
        let wire = self.end_of_wire(to);
        let now = self.now;
        let source = self.at_mut(from.0);
        let mut first = false;
        if let Some(state) = source.pin_mut(from.1) {
            first = state.drives_wires.is_empty();
            state.drives_wires.push(wire);
        }
        if let Some(axis) = source.axis_at(from.1) {
            source.listen(now, axis);
            self.foresee(from.0.0, axis);
        }
        let level = self.at(from.0).driven(now, from.1);
        self.stands(wire, level);
        if first {
            self.foresee_wave(from.0.0, from.1);
        }
    }

    /// Puts a level on a new wire. A drive that was seated at this instant is told now, before its deadlines, as what
    /// has stood there at power-on; any other one a tick later, as of a change.
    pub(super) fn stands(&mut self, wire: u32, level: Level) {
        let seat = self.wires[wire as usize].to.0;
        let starts = self.trace.drives[seat.0 as usize].from == self.now;
        if starts {
            let at = self.at(seat).free(self.now, Phase::Pin);
            self.put_on_wire(wire, level);
            self.schedule(at, Phase::Pin, seat.0, EventKind::Contacts);
        } else {
            self.schedule(self.now + Duration::TICK, Phase::Pin, seat.0, EventKind::Wired { wire, level });
        }
    }

    /// Tells a device what stands at its pins, in their order, in whatever order wires and sensors were put there.
    pub(super) fn find_contacts(&mut self, place: u32) {
        for pin in (0..self.seats[place as usize].spec.pins.len() as u8).map(Pin) {
            self.look(place, pin);
        }
    }

    /// The end of a new wire, at an input pin. Nothing drives it so far.
    pub(super) fn end_of_wire(&mut self, to: (DriveId, Pin)) -> u32 {
        let wire = u32::try_from(self.wires.len()).expect("a bench has room for four billion wires");
        let name = self.name(to.0).to_owned();
        let state = self.at_mut(to.0).pin_mut(to.1);
        state.unwrap_or_else(|| panic!("{name} has no pin {}", to.1.0)).driven_by.push(wire);
        self.wires.push(PinWire { to, level: Level::Float });
        wire
    }

    /// Carries what an output did to the ends of its wires.
    pub(super) fn carry_moved(&mut self, place: u32, moved: &PinChange) {
        match *moved {
            PinChange::Pin { pin, at, level } => {
                for n in 0.. {
                    let Some(wire) = self.wire_of(place, pin, n) else { break };
                    let (seat, _) = self.wires[wire as usize].to;
                    self.schedule(at + Duration::TICK, Phase::Pin, seat.0, EventKind::Wired { wire, level });
                }
            }
            PinChange::Wave { pin } => {
                let level = self.seats[place as usize].driven(self.now, pin);
                self.carry_moved(place, &PinChange::Pin { pin, at: self.now, level });
                self.foresee_wave(place, pin);
            }
            PinChange::Axis { axis } => self.foresee(place, axis),
        }
    }

    /// The wires from a pin, one after the other.
    fn wire_of(&self, place: u32, pin: Pin, n: usize) -> Option<u32> {
        self.seats[place as usize].pin(pin)?.drives_wires.get(n).copied()
    }

    /// A level arrives at the end of a wire.
    pub(super) fn wired(&mut self, wire: u32, level: Level) {
        self.put_on_wire(wire, level);
        let (seat, pin) = self.wires[wire as usize].to;
        self.look(seat.0, pin);
    }

    /// A level is at the end of a wire, and its pin is driven by it.
    fn put_on_wire(&mut self, wire: u32, level: Level) {
        let PinWire { to: (seat, pin), level: end } = &mut self.wires[wire as usize];
        *end = level;
        let (seat, pin) = (*seat, *pin);
        let Some(state) = self.seats[seat.0 as usize].pin_mut(pin) else { return };
        let mut levels = state.driven_by.iter().map(|&wire| self.wires[wire as usize].level);
        state.wired = if levels.clone().any(|level| level == Level::Low) {
            PinStimulus::Low
        } else if levels.any(|level| level == Level::High) {
            PinStimulus::High
        } else {
            PinStimulus::Open
        };
    }

    /// Sends the next edge of an axis on its way to whoever is wired to it.
    fn foresee(&mut self, place: u32, axis: Axis) {
        let Some((due, number)) = self.seats[place as usize].next_edge(axis) else { return };
        if due < Instant::NEVER {
            self.schedule(due + Duration::TICK, Phase::Pin, place, EventKind::Steps { axis, number });
        }
    }

    /// An edge of an axis arrives.
    pub(super) fn axis_edge(&mut self, place: u32, axis: Axis, number: u32) {
        let made = self.now - Duration::TICK;
        let Some((pin, level)) = self.seats[place as usize].take_edge(axis, number, made) else { return };
        self.foresee(place, axis);
        if let Some(level) = level {
            self.arrive(place, pin, level);
        }
    }

    /// Sends the next edge of a wave on its way, if somebody is wired to it.
    fn foresee_wave(&mut self, place: u32, pin: Pin) {
        if let Some((due, number)) = self.seats[place as usize].wave_after(self.now, pin) {
            self.schedule(due + Duration::TICK, Phase::Pin, place, EventKind::Wave { pin, number });
        }
    }

    /// An edge of a wave arrives.
    pub(super) fn wave_edge(&mut self, place: u32, pin: Pin, number: u32) {
        let made = self.now - Duration::TICK;
        let Some((due, now)) = self.seats[place as usize].wave_after(made, pin) else { return };
        if now == number {
            self.schedule(due + Duration::TICK, Phase::Pin, place, EventKind::Wave { pin, number });
            let level = self.seats[place as usize].driven(made, pin);
            self.arrive(place, pin, level);
        }
    }

    /// A level arrives at the ends of all wires from a pin.
    fn arrive(&mut self, place: u32, pin: Pin, level: Level) {
        for n in 0.. {
            let Some(wire) = self.wire_of(place, pin, n) else { break };
            self.wired(wire, level);
        }
    }
}
