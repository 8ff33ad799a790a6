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
    /// Not driven from outside.
    Open,
    /// A voltage, in mV.
    Millivolts(i32),
}

/// A pin, with its stimulus and its output.
pub(crate) struct PinState {
    spec: &'static PinSpec,
    /// Stimulus set from outside.
    pub(crate) stimulus: PinStimulus,
    /// Stimulus from outside that has reached the drive.
    arrived: PinStimulus,
    /// True once the pin has been driven from outside.
    was_driven: bool,
    /// Stimulus from wires.
    pub(crate) wire_stimulus: PinStimulus,
    /// `None` if no wire is connected.
    wires: Option<Box<PinWires>>,
    /// Signal that was last reported to the drive.
    pub(crate) reported: Signal,
    /// The running train of pulses, if any.
    pub(crate) train: Option<Box<PulseTrain>>,
    /// Number of trains so far.
    pub(crate) trains: u32,
    /// Output of the drive at the pin.
    pub(super) drives: PinOutput,
    /// Number of changes of `drives` so far.
    pub(super) changes: u32,
}

/// Indices of the wires at a pin, in the bench's list of wires. Most pins have none.
#[derive(Default)]
struct PinWires {
    /// Those that drive the pin.
    driven_by: Vec<u32>,
    /// Those that the pin drives.
    drives: Vec<u32>,
}

impl PinState {
    pub(super) fn new(spec: &'static PinSpec) -> Self {
        let mut pin = Self {
            spec,
            stimulus: PinStimulus::Open,
            arrived: PinStimulus::Open,
            was_driven: false,
            wire_stimulus: PinStimulus::Open,
            wires: None,
            reported: Signal::Open,
            train: None,
            trains: 0,
            drives: PinOutput::NOTHING,
            changes: 0,
        };
        pin.reported = pin.signal(PinStimulus::Open);
        pin
    }

    /// Indices of the wires that drive the pin, in the bench's list of wires.
    pub(crate) fn driven_by(&self) -> &[u32] {
        self.wires.as_ref().map_or(&[], |wires| &wires.driven_by)
    }

    /// Indices of the wires that the pin drives.
    pub(crate) fn drives_wires(&self) -> &[u32] {
        self.wires.as_ref().map_or(&[], |wires| &wires.drives)
    }

    /// Connects a wire that drives the pin.
    pub(crate) fn connect_input(&mut self, wire: u32) {
        self.wires.get_or_insert_default().driven_by.push(wire);
    }

    /// Connects a wire that the pin drives.
    pub(crate) fn connect_output(&mut self, wire: u32) {
        self.wires.get_or_insert_default().drives.push(wire);
    }

    /// Level of the pin without a stimulus: high for a contact that is pulled up because a wire or a stimulus
    /// uses it, otherwise the idle level of the pin.
    fn rest(&self) -> Level {
        let wired = !self.driven_by().is_empty();
        let used = self.spec.high_once_used && (wired || self.was_driven);
        if used || self.spec.reports_open() && wired { Level::High } else { self.spec.idle }
    }

    /// Handles a stimulus from outside that reaches the drive.
    pub(crate) fn stimulus_arrives(&mut self, drive: PinStimulus) {
        (self.arrived, self.was_driven) = (drive, true);
    }

    /// Signal that the drive reads. Without a stimulus from outside, the wires determine it.
    pub(crate) fn seen(&self) -> Signal {
        self.signal(if self.arrived == PinStimulus::Open { self.wire_stimulus } else { self.arrived })
    }

    /// Signal that the drive reads for a stimulus.
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

    /// Present stimulus: from outside, or else from the wires.
    fn applied(&self) -> PinStimulus {
        if self.stimulus == PinStimulus::Open { self.wire_stimulus } else { self.stimulus }
    }

    /// Returns true if the drive would read a high level now.
    pub(crate) fn is_high(&self) -> bool {
        match self.signal(self.applied()) {
            Signal::Digital(high) => high,
            Signal::Millivolts(mv) => mv > HIGH_MV,
            // An open input is pulled up, too.
            Signal::Open => true,
        }
    }

    /// Returns true if the reported signal differs from the one that a drive assumes at power-on.
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
    /// Not driven, and no wire drives the pin.
    Open,
}

impl Signal {
    /// Input that reports the signal to the drive.
    pub(crate) fn input(self, pin: Pin) -> InputRecord {
        match self {
            Self::Digital(high) => InputRecord::Edge { pin, high },
            Self::Millivolts(mv) => InputRecord::Millivolts { pin, mv },
            Self::Open => InputRecord::Open { pin },
        }
    }
}

/// Edges at a constant rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeTrain {
    pub(crate) start: Instant,
    pub(crate) ticks_per_edge: f64,
    /// Additional delay of every second edge, in ticks.
    pub(crate) second_later: f64,
    /// Number of edges made so far.
    pub(crate) made: u64,
    /// Total number of edges.
    pub(crate) count: u64,
}

impl EdgeTrain {
    /// Time of the next edge; `None` after the last one.
    pub(crate) fn due(&self) -> Option<Instant> {
        // Rounded to the nearest tick, and exact below 2^53. Beyond the end of time the conversion saturates.
        let later = if self.made % 2 == 1 { self.second_later } else { 0.0 };
        let ticks = (self.made as f64 * self.ticks_per_edge + later + 0.5) as u64;
        (self.made < self.count).then_some(self.start + Duration::from_ticks(ticks))
    }
}

/// Pulse train on an input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PulseTrain {
    pub(crate) edges: EdgeTrain,
    /// The level between pulses.
    pub(crate) rest: bool,
    /// Stimulus of the pin before the train, to which the pin returns.
    pub(crate) before: PinStimulus,
}

/// Rotation of an encoder from outside.
#[derive(Default)]
pub(crate) struct EncoderState {
    pub(crate) edges: Option<EdgeTrain>,
    /// True if B leads A.
    pub(crate) back: bool,
    /// Number of rotations started so far.
    pub(crate) turns: u32,
}
