//! Signals at the drive's pins: of the wires, and of stimuli in their place.

use drivetwin_control::Stimulus;
use drivetwin_firmware::device::{HIGH_MV, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role, Spec};
use drivetwin_firmware::shell::BoardEvent;

/// Greatest number of pins of a drive on a board.
const MOST: usize = 32;

/// Signal that a drive reads at a pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Signal {
    /// High or low.
    Digital(bool),
    /// A voltage in mV.
    Millivolts(i32),
    /// Not driven, and no wire at the pin.
    Open,
}

impl Signal {
    /// Event that reports the signal to the drive.
    pub(crate) fn event(self, pin: Pin) -> BoardEvent {
        match self {
            Self::Digital(high) => BoardEvent::Edge(pin, high),
            Self::Millivolts(mv) => BoardEvent::Millivolts(pin, mv),
            Self::Open => BoardEvent::Open(pin),
        }
    }

    fn is_high(self) -> bool {
        match self {
            Self::Digital(high) => high,
            Self::Millivolts(mv) => mv > HIGH_MV,
            // An open input is pulled up, too.
            Self::Open => true,
        }
    }
}

/// One bit for each pin.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Bits(u32);

impl Bits {
    fn has(self, pin: Pin) -> bool {
        self.0 & bit(pin) != 0
    }

    fn set(&mut self, pin: Pin, on: bool) {
        let bit = bit(pin);
        self.0 = if on { self.0 | bit } else { self.0 & !bit };
    }
}

fn bit(pin: Pin) -> u32 {
    if usize::from(pin.0) < MOST { 1 << (pin.0 & 31) } else { 0 }
}

/// The pins of a drive, as seen from outside.
#[derive(Debug)]
pub(crate) struct Pins {
    spec: &'static Spec,
    /// Levels that the board reported last.
    high: Bits,
    /// Pins at which the board has reported a level. The others may have no wire.
    wired: Bits,
    /// Pins that have had a stimulus.
    used: Bits,
    stimuli: [Stimulus; MOST],
}

impl Pins {
    /// The pins at the start: idle, without a stimulus.
    pub(crate) fn new(spec: &'static Spec) -> Self {
        let mut high = Bits::default();
        for (place, pin) in (0..).zip(spec.pins) {
            high.set(Pin(place), pin.idle != Level::Low);
        }
        Self { spec, high, wired: Bits::default(), used: Bits::default(), stimuli: [Stimulus::Wire; MOST] }
    }

    /// All pins.
    pub(crate) fn all(&self) -> impl Iterator<Item = Pin> + use<> {
        (0..self.spec.pins.len().min(MOST) as u8).map(Pin)
    }

    /// Description of a pin.
    pub(crate) fn spec(&self, pin: Pin) -> Option<&'static PinSpec> {
        self.spec.pins.get(usize::from(pin.0)).filter(|_| usize::from(pin.0) < MOST)
    }

    /// Stimulus of a pin.
    pub(crate) fn stimulus(&self, pin: Pin) -> Stimulus {
        self.stimuli.get(usize::from(pin.0)).copied().unwrap_or(Stimulus::Wire)
    }

    /// Changes the stimulus of a pin. Returns the event for the drive, if the signal has changed.
    pub(crate) fn drive(&mut self, pin: Pin, stimulus: Stimulus) -> Option<BoardEvent> {
        let before = self.seen(pin);
        if let Some(place) = self.stimuli.get_mut(usize::from(pin.0)) {
            *place = stimulus;
            self.used.set(pin, true);
        }
        let now = self.seen(pin);
        (now != before).then(|| now.event(pin))
    }

    /// Notes an edge that the board reports. Returns `false` if a stimulus hides it from the drive.
    #[inline]
    pub(crate) fn edge(&mut self, pin: Pin, high: bool) -> bool {
        self.high.set(pin, high);
        self.wired.set(pin, true);
        self.stimulus(pin) == Stimulus::Wire
    }

    /// Signal that the drive reads.
    pub(crate) fn seen(&self, pin: Pin) -> Signal {
        let Some(spec) = self.spec(pin) else { return Signal::Open };
        match self.stimulus(pin) {
            Stimulus::Wire if self.wired.has(pin) => Signal::Digital(self.high.has(pin)),
            Stimulus::Wire => signal(spec, Stimulus::Open, self.rest(pin, spec)),
            stimulus => signal(spec, stimulus, self.rest(pin, spec)),
        }
    }

    /// Returns true if the drive reads a high level.
    pub(crate) fn is_high(&self, pin: Pin) -> bool {
        self.seen(pin).is_high()
    }

    /// Signal to report at power-on: one that differs from the signal that the drive assumes then.
    pub(crate) fn news(&self, pin: Pin) -> Option<BoardEvent> {
        let assumed = signal(self.spec(pin)?, Stimulus::Open, self.spec(pin)?.idle);
        let now = self.seen(pin);
        (now != assumed).then(|| now.event(pin))
    }

    /// Level at a pin, as measured from outside, if the drive gives it the level `own`.
    pub(crate) fn level(&self, pin: Pin, own: Level) -> Level {
        let Some(spec) = self.spec(pin).filter(|_| own == Level::Float) else { return own };
        match self.stimulus(pin) {
            Stimulus::Wire if !self.wired.has(pin) => self.rest(pin, spec),
            Stimulus::Open => self.rest(pin, spec),
            _ if self.is_high(pin) => Level::High,
            _ => Level::Low,
        }
    }

    /// Level of a pin that nothing drives: high for a contact that is in use, otherwise the idle level.
    fn rest(&self, pin: Pin, spec: &PinSpec) -> Level {
        let used = spec.high_once_used && (self.wired.has(pin) || self.used.has(pin));
        if used || spec.reports_open() && self.wired.has(pin) { Level::High } else { spec.idle }
    }
}

/// Signal of a stimulus at a pin that otherwise has the level `rest`.
fn signal(spec: &PinSpec, stimulus: Stimulus, rest: Level) -> Signal {
    let rests_high = rest == Level::High;
    match (spec.role, stimulus) {
        (Role::Analogue | Role::AnalogueOrDigital, Stimulus::Millivolts(mv)) => Signal::Millivolts(mv),
        (Role::Analogue, Stimulus::High) => Signal::Millivolts(LOGIC_HIGH_MV),
        (Role::Analogue, Stimulus::Open | Stimulus::Wire) if rests_high => Signal::Millivolts(LOGIC_HIGH_MV),
        (Role::Analogue, _) => Signal::Millivolts(0),
        (_, Stimulus::Low) => Signal::Digital(false),
        (_, Stimulus::High) => Signal::Digital(true),
        (_, Stimulus::Millivolts(mv)) => Signal::Digital(mv > HIGH_MV),
        (_, Stimulus::Open | Stimulus::Wire) if spec.reports_open() && !rests_high => Signal::Open,
        (_, Stimulus::Open | Stimulus::Wire) => Signal::Digital(rests_high),
    }
}
