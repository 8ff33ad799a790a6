//! Pins of a device, and what runs on them.

use drivetwin_firmware::device::{Duration, HIGH_MV, Instant, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role};

use crate::record::trace::InputRecord;
use crate::signals::pin_waveform::{PinOutput, level_of};

/// Stimulus of a pin from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PinStimulus {
    /// Pulled to ground.
    Low,
    /// Driven high.
    High,
    /// Let go.
    Open,
    /// A voltage, in mV.
    Millivolts(i32),
}

/// A pin and what both sides do to it.
pub(crate) struct PinState {
    spec: &'static PinSpec,
    /// Stimulus from outside.
    pub(crate) hands: PinStimulus,
    /// Stimulus that has arrived.
    held: PinStimulus,
    /// Hands have been there.
    touched: bool,
    /// Stimulus by wires.
    pub(crate) wired: PinStimulus,
    /// The wires that drive it, and those that it drives: places in the bench's list.
    pub(crate) driven_by: Vec<u32>,
    pub(crate) drives_wires: Vec<u32>,
    /// Signal that the device was given last.
    pub(crate) told: Signal,
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
            hands: PinStimulus::Open,
            held: PinStimulus::Open,
            touched: false,
            wired: PinStimulus::Open,
            driven_by: Vec::new(),
            drives_wires: Vec::new(),
            told: Signal::Open,
            train: None,
            trains: 0,
            drives: PinOutput::NOTHING,
            changes: 0,
        };
        pin.told = pin.signal(PinStimulus::Open);
        pin
    }

    /// Idle level: a contact that is wired is pulled up.
    fn rest(&self) -> Level {
        let wired = !self.driven_by.is_empty();
        let used = self.spec.high_once_used && (wired || self.touched);
        if used || self.spec.reports_open() && wired { Level::High } else { self.spec.idle }
    }

    /// A stimulus of a pin arrives.
    pub(crate) fn hold(&mut self, drive: PinStimulus) {
        (self.held, self.touched) = (drive, true);
    }

    /// Signal that the device sees of what has arrived: a pin that is released from outside follows its wires.
    pub(crate) fn seen(&self) -> Signal {
        self.signal(if self.held == PinStimulus::Open { self.wired } else { self.held })
    }

    /// Signal that the device sees with that stimulus.
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

    /// Stimulus that holds: from outside, else by wires.
    fn outside(&self) -> PinStimulus {
        if self.hands == PinStimulus::Open { self.wired } else { self.hands }
    }

    /// Returns whether the device would see a high level now.
    pub(crate) fn is_high(&self) -> bool {
        match self.signal(self.outside()) {
            Signal::Digital(high) => high,
            Signal::Millivolts(mv) => mv > HIGH_MV,
            // Its pull-up is there all the same.
            Signal::Open => true,
        }
    }

    /// Returns whether the signal is another one than a device assumes before its first input.
    pub(super) fn away(&self) -> bool {
        self.told != Self::new(self.spec).told
    }

    /// The pin as it is seen from outside.
    pub(super) fn level(&self, at: Instant) -> Level {
        match self.drives.level(at) {
            Level::Float if self.outside() == PinStimulus::Open => self.rest(),
            Level::Float => level_of(self.is_high()),
            level => level,
        }
    }
}

/// Signal at an input of a device.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Signal {
    Digital(bool),
    Millivolts(i32),
    /// Not driven, and no wire ends there.
    Open,
}

impl Signal {
    /// Input of the device for that signal.
    pub(crate) fn fed(self, pin: Pin) -> InputRecord {
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
    /// Ticks by which every second edge comes later than that.
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
