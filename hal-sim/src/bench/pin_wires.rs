//! Wires from output pins to input pins, and step pulses.

use drivetwin_firmware::device::{Axis, Duration, Instant, Level, Pin};

use super::events::EventKind;
use super::{Bench, DriveId, Motor, PinStimulus};
use crate::record::trace::{Event, InputRecord, Power};
use crate::scheduler::Phase;
use crate::signals::pulses::{self, Pulse};
use crate::slot::PinChange;

/// The input end of a wire.
pub(super) struct PinWire {
    to: (DriveId, Pin),
    /// Level that has reached the input end.
    level: Level,
}

/// The STEP output of an axis, see [`DriveId::step`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StepOutput {
    drive: DriveId,
    axis: Axis,
}

/// A wire of a bench, see [`Bench::wires`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Wire {
    /// The output.
    pub from: WireOutput,
    /// The input pin.
    pub to: (DriveId, Pin),
}

/// The output that a wire comes from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WireOutput {
    /// An output pin of a drive.
    Pin(DriveId, Pin),
    /// A Hall sensor of a motor.
    Hall(Motor),
    /// An encoder on a shaft: channel A (0), channel B (1) or the index (2).
    Encoder(Motor, u8),
    /// A switch on a shaft.
    Switch(Motor),
}

impl DriveId {
    /// The STEP output of the drive's first axis, to count its [pulses](Bench::pulses).
    #[must_use]
    pub fn step(self) -> StepOutput {
        StepOutput { drive: self, axis: Axis(0) }
    }
}

/// Wires and step pulses.
impl Bench {
    /// All pulses on a STEP output that have begun by now. They are computed from the plans and steps in the
    /// [trace](Self::trace).
    ///
    /// # Panics
    /// If the axis has no STEP output, or if the trace is not complete; use
    /// [`Retention::All`](crate::record::trace::Retention::All).
    pub fn pulses(&self, of: StepOutput) -> impl Iterator<Item = Pulse> {
        let StepOutput { drive, axis } = of;
        let spec = self.spec(drive).axes.get(usize::from(axis.0));
        let name = self.name(drive);
        assert!(spec.is_some_and(|axis| axis.step_dir.is_some()), "{name} has no STEP output");
        assert!(
            self.trace.is_whole(),
            "the pulses of {name} cannot be counted: the trace has lost its beginning, or keeps nothing; \
             give the bench `Retention::All`",
        );
        pulses::pulses(&self.trace, drive.0 as usize, axis, Instant::ZERO, self.now)
    }

    /// The pulses on a STEP output since the last power-on of its drive; `None` if the trace does not have them all.
    ///
    /// # Panics
    /// If the axis has no STEP output.
    pub fn pulses_since_power_on(&self, of: StepOutput) -> Option<impl Iterator<Item = Pulse>> {
        let StepOutput { drive, axis } = of;
        let spec = self.spec(drive).axes.get(usize::from(axis.0));
        assert!(spec.is_some_and(|axis| axis.step_dir.is_some()), "{} has no STEP output", self.name(drive));
        let index = drive.0 as usize;
        let mut since = self.trace.is_whole().then_some(Instant::ZERO);
        for entry in self.trace.events().filter(|entry| entry.drive == index) {
            match entry.event {
                Event::Input(InputRecord::Power(Power::On)) => since = Some(entry.at),
                Event::Missing { .. } => since = None,
                _ => {}
            }
        }
        Some(pulses::pulses(&self.trace, index, axis, since?, self.now))
    }

    /// Connects an output pin to an input pin, permanently. A change of the output arrives one tick later,
    /// also edges of waves, step pulses and changes of direction. While the output floats, the input is
    /// pulled up. A drive that was added at this instant receives the output's level as its initial level,
    /// without an edge.
    ///
    /// Several outputs may be connected to one input: low wins over high. An input with a [stimulus](Self::set_pin)
    /// other than [`Open`](PinStimulus::Open) ignores its wires (BENCH-9).
    ///
    /// # Panics
    /// If one of the drives has no such pin.
    pub fn wire(&mut self, from: (DriveId, Pin), to: (DriveId, Pin)) {
        let (drive, pin) = from;
        assert!(self.at(drive).pin(pin).is_some(), "{} has no pin {}", self.name(drive), pin.0);
        let wire = self.end_of_wire(to);
        let now = self.now;
        let source = self.at_mut(from.0);
        let mut first = false;
        if let Some(state) = source.pin_mut(from.1) {
            first = state.drives_wires().is_empty();
            state.connect_output(wire);
        }
        if let Some(axis) = source.axis_at(from.1) {
            source.listen(now, axis);
            self.schedule_step_edge(from.0.0, axis);
        }
        let level = self.at(from.0).driven(now, from.1);
        self.set_initial_level(wire, level);
        if first {
            self.schedule_wave_edge(from.0.0, from.1);
        }
    }

    /// All wires: those between pins in the order of their drives, then those from the shafts of motors.
    #[must_use]
    pub fn wires(&self) -> Vec<Wire> {
        let to = |wire: u32| self.wires.get(wire as usize).map(|wire| wire.to);
        let outputs = self.drives().flat_map(|drive| {
            let pins = (0..).map(Pin).zip(&self.at(drive).state.pins);
            pins.flat_map(move |(pin, state)| {
                state.drives_wires().iter().map(move |&wire| (WireOutput::Pin(drive, pin), wire))
            })
        });
        let outputs = outputs.chain(self.shaft_wires());
        outputs.filter_map(|(from, wire)| Some(Wire { from, to: to(wire)? })).collect()
    }

    /// Number of wires.
    pub(super) fn wire_count(&self) -> usize {
        self.wires.len()
    }

    /// Time of the next edge of a wave that a drive outputs at a pin; [`Instant::NEVER`] if it outputs none there.
    #[must_use]
    pub fn next_edge(&self, drive: DriveId, pin: Pin) -> Instant {
        self.at(drive).wave_after(self.now, pin).map_or(Instant::NEVER, |(due, _)| due)
    }

    /// Sets the initial level of a new wire. A drive that was added at this instant receives it now, before
    /// its deadlines, as an initial level. Any other drive receives it one tick later, as a change.
    pub(super) fn set_initial_level(&mut self, wire: u32, level: Level) {
        let drive = self.wires[wire as usize].to.0;
        let starts = self.trace.drives[drive.0 as usize].from == self.now;
        if starts {
            let at = self.at(drive).free(self.now, Phase::Pin);
            self.put_on_wire(wire, level);
            self.schedule(at, Phase::Pin, drive.0, EventKind::InitialLevels);
        } else {
            self.schedule(
                self.now + Duration::TICK,
                Phase::Pin,
                drive.0,
                EventKind::WireLevel { wire, level },
            );
        }
    }

    /// Reports the initial levels of a drive's pins, in the order of the pins. The order of wires and sensors
    /// makes no difference.
    pub(super) fn report_initial_levels(&mut self, index: u32) {
        for pin in (0..self.slots[index as usize].spec.pins.len() as u8).map(Pin) {
            self.report_pin(index, pin);
        }
    }

    /// Adds the input end of a new wire at a pin. Nothing drives it yet.
    pub(super) fn end_of_wire(&mut self, to: (DriveId, Pin)) -> u32 {
        let wire = u32::try_from(self.wires.len()).expect("a bench has room for four billion wires");
        let name = self.name(to.0).to_owned();
        let state = self.at_mut(to.0).pin_mut(to.1);
        state.unwrap_or_else(|| panic!("{name} has no pin {}", to.1.0)).connect_input(wire);
        self.wires.push(PinWire { to, level: Level::Float });
        wire
    }

    /// Schedules the arrival of a change of an output at the ends of its wires.
    pub(super) fn schedule_pin_change(&mut self, index: u32, change: &PinChange) {
        match *change {
            PinChange::Pin { pin, at, level } => {
                for n in 0.. {
                    let Some(wire) = self.wire_of(index, pin, n) else { break };
                    let (drive, _) = self.wires[wire as usize].to;
                    self.schedule(
                        at + Duration::TICK,
                        Phase::Pin,
                        drive.0,
                        EventKind::WireLevel { wire, level },
                    );
                }
            }
            PinChange::Wave { pin } => {
                let level = self.slots[index as usize].driven(self.now, pin);
                self.schedule_pin_change(index, &PinChange::Pin { pin, at: self.now, level });
                self.schedule_wave_edge(index, pin);
            }
            PinChange::Axis { axis } => self.schedule_step_edge(index, axis),
        }
    }

    /// The wire with number `n` of those from a pin; `None` after the last one.
    fn wire_of(&self, index: u32, pin: Pin, n: usize) -> Option<u32> {
        self.slots[index as usize].pin(pin)?.drives_wires().get(n).copied()
    }

    /// Handles a level that reaches the end of a wire.
    pub(super) fn wire_level_arrives(&mut self, wire: u32, level: Level) {
        self.put_on_wire(wire, level);
        let (drive, pin) = self.wires[wire as usize].to;
        self.report_pin(drive.0, pin);
    }

    /// Sets the level at the end of a wire, and updates the stimulus of its pin from all wires of the pin.
    fn put_on_wire(&mut self, wire: u32, level: Level) {
        let PinWire { to: (drive, pin), level: end } = &mut self.wires[wire as usize];
        *end = level;
        let (drive, pin) = (*drive, *pin);
        let Some(state) = self.slots[drive.0 as usize].pin_mut(pin) else { return };
        let mut levels = state.driven_by().iter().map(|&wire| self.wires[wire as usize].level);
        state.wire_stimulus = if levels.clone().any(|level| level == Level::Low) {
            PinStimulus::Low
        } else if levels.any(|level| level == Level::High) {
            PinStimulus::High
        } else {
            PinStimulus::Open
        };
    }

    /// Schedules the arrival of the next step edge of an axis at the ends of its wires.
    fn schedule_step_edge(&mut self, index: u32, axis: Axis) {
        let Some((due, number)) = self.slots[index as usize].next_edge(axis) else { return };
        if due < Instant::NEVER {
            self.schedule(due + Duration::TICK, Phase::Pin, index, EventKind::Steps { axis, number });
        }
    }

    /// Handles a step edge that reaches the ends of its wires.
    pub(super) fn axis_edge(&mut self, index: u32, axis: Axis, number: u32) {
        let made = self.now - Duration::TICK;
        let Some((pin, level)) = self.slots[index as usize].take_edge(axis, number, made) else { return };
        self.schedule_step_edge(index, axis);
        if let Some(level) = level {
            self.level_arrives(index, pin, level);
        }
    }

    /// Schedules the next edge of a wave, if a wire is connected.
    fn schedule_wave_edge(&mut self, index: u32, pin: Pin) {
        if let Some((due, number)) = self.slots[index as usize].wave_after(self.now, pin) {
            self.schedule(due + Duration::TICK, Phase::Pin, index, EventKind::Wave { pin, number });
        }
    }

    /// Handles an edge of a wave that reaches the ends of its wires.
    pub(super) fn wave_edge(&mut self, index: u32, pin: Pin, number: u32) {
        let made = self.now - Duration::TICK;
        let Some((due, now)) = self.slots[index as usize].wave_after(made, pin) else { return };
        if now == number {
            self.schedule(due + Duration::TICK, Phase::Pin, index, EventKind::Wave { pin, number });
            let level = self.slots[index as usize].driven(made, pin);
            self.level_arrives(index, pin, level);
        }
    }

    /// Handles a level that reaches the ends of all wires from a pin.
    fn level_arrives(&mut self, index: u32, pin: Pin, level: Level) {
        for n in 0.. {
            let Some(wire) = self.wire_of(index, pin, n) else { break };
            self.wire_level_arrives(wire, level);
        }
    }
}
