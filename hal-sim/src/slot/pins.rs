//! Pins of a device, and what runs on them.

use drivetwin_firmware::device::{Duration, HIGH_MV, Instant, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role};

use crate::record::trace::Fed;
use crate::signals::pin_waveform::{Drives, level_of};

/// What is done to a pin from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Driving {
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
    /// What hands do to it.
    pub(crate) hands: Driving,
    /// What of that has arrived.
    held: Driving,
    /// Hands have been there.
    touched: bool,
    /// What wires do to it.
    pub(crate) wired: Driving,
    /// The wires that drive it, and those that it drives: places in the bench's list.
    pub(crate) driven_by: Vec<u32>,
    pub(crate) drives_wires: Vec<u32>,
    /// What the device was told last.
    pub(crate) told: Signal,
    /// The train of pulses that runs.
    pub(crate) train: Option<PulseTrain>,
    /// How many trains there have been.
    pub(crate) trains: u32,
    /// What the device does with it.
    pub(super) drives: Drives,
    /// How often that has changed.
    pub(super) changes: u32,
}

impl PinState {
    pub(super) fn new(spec: &'static PinSpec) -> Self {
        let mut pin = Self {
            spec,
            hands: Driving::Open,
            held: Driving::Open,
            touched: false,
            wired: Driving::Open,
            driven_by: Vec::new(),
            drives_wires: Vec::new(),
            told: Signal::Open,
            train: None,
            trains: 0,
            drives: Drives::NOTHING,
            changes: 0,
        };
        pin.told = pin.signal(Driving::Open);
        pin
    }

    /// What it reads, or shows, while nobody drives it: a contact that is wired is pulled up.
    fn rest(&self) -> Level {
        let wired = !self.driven_by.is_empty();
        let used = self.spec.high_once_used && (wired || self.touched);
        if used || self.spec.tells_open() && wired { Level::High } else { self.spec.rest }
    }

    /// A stimulus of a pin arrives.
    pub(crate) fn hold(&mut self, drive: Driving) {
        (self.held, self.touched) = (drive, true);
    }

    /// What the device sees of what has arrived: where hands let go wires decide.
    pub(crate) fn seen(&self) -> Signal {
        self.signal(if self.held == Driving::Open { self.wired } else { self.held })
    }

    /// What the device sees while that is done to the pin.
    fn signal(&self, drive: Driving) -> Signal {
        let rests_high = self.rest() == Level::High;
        if self.spec.role == Role::Analogue {
            return Signal::Millivolts(match drive {
                Driving::Millivolts(mv) => mv,
                Driving::High => LOGIC_HIGH_MV,
                Driving::Open if rests_high => LOGIC_HIGH_MV,
                Driving::Low | Driving::Open => 0,
            });
        }
        if let (Role::Mixed, Driving::Millivolts(mv)) = (self.spec.role, drive) {
            return Signal::Millivolts(mv);
        }
        Signal::Digital(match drive {
            Driving::Low => false,
            Driving::High => true,
            Driving::Open if self.spec.tells_open() && !rests_high => return Signal::Open,
            Driving::Open => rests_high,
            Driving::Millivolts(mv) => mv > HIGH_MV,
        })
    }

    /// What is done to it from outside.
    fn outside(&self) -> Driving {
        if self.hands == Driving::Open { self.wired } else { self.hands }
    }

    /// Whether the device would see a high level now.
    pub(crate) fn is_high(&self) -> bool {
        match self.signal(self.outside()) {
            Signal::Digital(high) => high,
            Signal::Millivolts(mv) => mv > HIGH_MV,
            // Its pull-up is there all the same.
            Signal::Open => true,
        }
    }

    /// Whether the device sees something else than it believes before it is told.
    pub(super) fn away(&self) -> bool {
        self.told != Self::new(self.spec).told
    }

    /// The pin as it is seen from outside.
    pub(super) fn level(&self, at: Instant) -> Level {
        match self.drives.level(at) {
            Level::Float if self.outside() == Driving::Open => self.rest(),
            Level::Float => level_of(self.is_high()),
            level => level,
        }
    }
}

/// What a device sees at an input.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Signal {
    Digital(bool),
    Millivolts(i32),
    /// Nobody drives it, and no wire ends there.
    Open,
}

impl Signal {
    /// What the device is told.
    pub(crate) fn fed(self, pin: Pin) -> Fed {
        match self {
            Self::Digital(high) => Fed::Edge { pin, high },
            Self::Millivolts(mv) => Fed::Millivolts { pin, mv },
            Self::Open => Fed::Open { pin },
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
    /// When the next edge is; `None` after the last one.
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
    /// What the pin goes back to.
    pub(crate) before: Driving,
}

/// What turns an encoder.
#[derive(Default)]
pub(crate) struct EncoderState {
    pub(crate) edges: Option<EdgeTrain>,
    /// Whether B leads A.
    pub(crate) back: bool,
    /// How often it was turned.
    pub(crate) turns: u32,
}
