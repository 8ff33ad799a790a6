//! Pins of a drive: stimulus, wires, outputs and pulse trains.

use drivetwin_firmware::device::{Duration, HIGH_MV, Instant, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role};

use crate::record::trace::InputRecord;
use crate::signals::pin_waveform::{PinOutput, level_of};

/// Stimulus of a pin from outside, for [`Bench::set_pin`](crate::bench::Bench::set_pin).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PinStimulus {
    /// Pulled to ground.
    Low,
    /// Driven high.
    High,
    /// Not driven.
    Open,
    /// A voltage, in mV.
    Millivolts(i32),
}

/// A pin, with its stimulus and its output.
pub(crate) struct PinState {
    spec: &'static PinSpec,
    /// Stimulus from outside.
    pub(crate) stimulus: PinStimulus,
    /// Stimulus that has arrived.
    arrived: PinStimulus,
    /// True once it was driven from outside.
    was_driven: bool,
    /// Stimulus by wires.
    pub(crate) wire_stimulus: PinStimulus,
    /// Wires that drive the pin, and wires that the pin drives: indices in the bench's list.
    pub(crate) driven_by: Vec<u32>,
    pub(crate) drives_wires: Vec<u32>,
    /// Signal that was reported to the drive last.
    pub(crate) reported: Signal,
    /// The train of pulses that runs.
    pub(crate) train: Option<PulseTrain>,
    /// Count of trains.
    pub(crate) trains: u32,
    /// Output of the device.
    pub(super) drives: PinOutput,
    /// Count of changes of that.
    pub(super) changes: u32,
}

impl PinState {
    pub(super) fn new(spec: &'static PinSpec) -> Self {
        let mut pin = Self {
            spec,
            stimulus: PinStimulus::Open,
            arrived: PinStimulus::Open,
            was_driven: false,
            wire_stimulus: PinStimulus::Open,
            driven_by: Vec::new(),
            drives_wires: Vec::new(),
            reported: Signal::Open,
            train: None,
            trains: 0,
            drives: PinOutput::NOTHING,
            changes: 0,
        };
        pin.reported = pin.signal(PinStimulus::Open);
        pin
    }

    /// Idle level: a wired contact is pulled up.
    fn rest(&self) -> Level {
        let wired = !self.driven_by.is_empty();
        let used = self.spec.high_once_used && (wired || self.was_driven);
        if used || self.spec.reports_open() && wired { Level::High } else { self.spec.idle }
    }

    /// Handles a stimulus that arrives.
    pub(crate) fn stimulus_arrives(&mut self, drive: PinStimulus) {
        (self.arrived, self.was_driven) = (drive, true);
    }

    /// Signal at the drive: a pin without a stimulus follows its wires.
    pub(crate) fn seen(&self) -> Signal {
        self.signal(if self.arrived == PinStimulus::Open { self.wire_stimulus } else { self.arrived })
    }

    /// Signal at the drive for a stimulus.
    fn signal(&self, drive: PinStimulus) -> Signal {
        let rests_high = self.rest() == Level::High;
        if self.spec.role == Role::Analogue {
            return Signal::Millivolts(match drive {
                PinStimulus::Millivolts(mv) => mv,
                PinStimulus::High => LOGIC_HIGH_MV,
                PinStimulus::Open if rests_high => LOGIC_HIGH_MV,
                PinStimulus::Low | PinStimulus::Open => 0,
            });
        }
        if let (Role::AnalogueOrDigital, PinStimulus::Millivolts(mv)) = (self.spec.role, drive) {
            return Signal::Millivolts(mv);
        }
        Signal::Digital(match drive {
            PinStimulus::Low => false,
            PinStimulus::High => true,
            PinStimulus::Open if self.spec.reports_open() && !rests_high => return Signal::Open,
            PinStimulus::Open => rests_high,
            PinStimulus::Millivolts(mv) => mv > HIGH_MV,
        })
    }

    /// Stimulus in effect: from outside, else by wires.
    fn applied(&self) -> PinStimulus {
        if self.stimulus == PinStimulus::Open { self.wire_stimulus } else { self.stimulus }
    }

    /// Returns whether the drive would read a high level now.
    pub(crate) fn is_high(&self) -> bool {
        match self.signal(self.applied()) {
            Signal::Digital(high) => high,
            Signal::Millivolts(mv) => mv > HIGH_MV,
            // The pull-up is effective all the same.
            Signal::Open => true,
        }
    }

    /// Returns whether the signal differs from the one that a drive assumes at power-on.
    pub(super) fn is_news(&self) -> bool {
        self.reported != Self::new(self.spec).reported
    }

    /// The level at the pin, as measured from outside.
    pub(super) fn level(&self, at: Instant) -> Level {
        match self.drives.level(at) {
            Level::Float if self.applied() == PinStimulus::Open => self.rest(),
            Level::Float => level_of(self.is_high()),
            level => level,
        }
    }
}

/// Signal at an input of a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Signal {
    Digital(bool),
    Millivolts(i32),
    /// Not driven, and no wire ends there.
    Open,
}

impl Signal {
    /// Input of the device for that signal.
    pub(crate) fn input(self, pin: Pin) -> InputRecord {
        match self {
            Self::Digital(high) => InputRecord::Edge { pin, high },
            Self::Millivolts(mv) => InputRecord::Millivolts { pin, mv },
            Self::Open => InputRecord::Open { pin },
        }
    }
}

/// Edges at a steady rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeTrain {
    pub(crate) start: Instant,
    pub(crate) ticks_per_edge: f64,
    /// Additional delay of every second edge, in ticks.
    pub(crate) second_later: f64,
    /// Edges made.
    pub(crate) made: u64,
    /// Edges to make in all.
    pub(crate) count: u64,
}

impl EdgeTrain {
    /// Time of the next edge; `None` after the last one.
    pub(crate) fn due(&self) -> Option<Instant> {
        // Exact below 2^53, to the nearest; beyond the end of time the conversion saturates.
        let later = if self.made % 2 == 1 { self.second_later } else { 0.0 };
        let ticks = (self.made as f64 * self.ticks_per_edge + later + 0.5) as u64;
        (self.made < self.count).then_some(self.start + Duration::from_ticks(ticks))
    }
}

/// Pulses on an input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseTrain {
    pub(crate) edges: EdgeTrain,
    /// The level between pulses.
    pub(crate) rest: bool,
    /// Stimulus to which the pin returns.
    pub(crate) before: PinStimulus,
}

/// Motion of an encoder that is turned from outside.
#[derive(Default)]
pub(crate) struct EncoderState {
    pub(crate) edges: Option<EdgeTrain>,
    /// True if B leads A.
    pub(crate) back: bool,
    /// Count of turns that were ordered.
    pub(crate) turns: u32,
}
