//! The signals of the encoder, and the value of READ ENCODER in each MODE.

use super::{A, B, I};
use crate::counter::{Channel, Ls7366r};
use crate::device::{Duration, HIGH_MV, Input, Instant, LOGIC_HIGH_MV};

/// Voltage at full scale.
const FULL_SCALE_MV: i32 = 5_000;
/// A longer period is that of a 12-bit encoder (250 Hz), a shorter one that of a 10-bit encoder (1 kHz).
const TWELVE_BIT: Duration = Duration::millis(2);
/// Bit of MDR1: INDEX/ is active high.
const INVERT_INDEX: u16 = 1 << 3;
/// Bit of MODE: the PWM encoder seen now has 12 bits.
const PWM_RESOLUTION: i64 = 1 << 4;

/// Bits 1:0 of MODE.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mode {
    Quadrature,
    Pwm,
    Analogue,
}

impl Mode {
    /// The mode that MODE selects.
    pub(super) fn of(mode: u16) -> Self {
        match mode & 3 {
            1 => Self::Pwm,
            2 => Self::Analogue,
            _ => Self::Quadrature,
        }
    }

    /// Duration of a measurement (INTERVAL RATE).
    pub(super) fn measurement(self) -> Duration {
        match self {
            Self::Quadrature | Self::Pwm => Duration::micros(100),
            Self::Analogue => Duration::micros(200),
        }
    }
}

/// The pulse width of the signal at A.
#[derive(Clone, Copy, Default, Debug)]
struct Pwm {
    rose: Option<Instant>,
    fell: Option<Instant>,
    /// On time and period of the last complete period.
    last_period: Option<(Duration, Duration)>,
}

impl Pwm {
    fn edge(&mut self, at: Instant, high: bool) {
        if !high {
            self.fell = Some(at);
            return;
        }
        if let (Some(rose), Some(fell)) = (self.rose, self.fell) {
            self.last_period = Some((fell.since(rose), at.since(rose)));
        }
        (self.rose, self.fell) = (Some(at), None);
    }

    fn is_twelve_bit(self) -> bool {
        self.last_period.is_some_and(|(_, period)| period > TWELVE_BIT)
    }

    /// The position, by the formula of the encoder's data sheet (US Digital MA3; QSB-14).
    fn value(self) -> u32 {
        let (range, highest) = if self.is_twelve_bit() { (4_098, 4_095) } else { (1_026, 1_023) };
        let value = self.last_period.map_or(0, |(on, period)| on * range / period);
        value.saturating_sub(1).min(highest) as u32
    }
}

/// The signals at A, B and I. Their levels stay unchanged by a reset.
#[derive(Clone, Debug)]
pub(super) struct Encoder {
    a: bool,
    b: bool,
    index: bool,
    /// Voltage at A, in mV.
    mv: i32,
    pwm: Pwm,
}

impl Encoder {
    /// Signals with no connection.
    pub(super) fn new() -> Self {
        Self { a: true, b: true, index: false, mv: LOGIC_HIGH_MV, pwm: Pwm::default() }
    }

    /// Forgets the PWM signal, at a reset or a write of MODE.
    pub(super) fn restart(&mut self) {
        self.pwm = Pwm::default();
    }

    /// A counter that has these levels at its inputs, with the polarity of MDR1.
    pub(super) fn counter(&self, mdr1: u16) -> Ls7366r {
        Ls7366r::new(self.a, self.b, self.index(mdr1))
    }

    /// The level of INDEX/, with the polarity of MDR1.
    pub(super) fn index(&self, mdr1: u16) -> bool {
        self.index == (mdr1 & INVERT_INDEX != 0)
    }

    /// Handles an input at A, under any of the pin's names (QSB-16), at B or at I, with these values of MODE and MDR1.
    /// Returns the channel of the counter that has a new level.
    pub(super) fn input(
        &mut self,
        at: Instant,
        input: &Input<'_>,
        mode: Mode,
        mdr1: u16,
    ) -> Option<(Channel, bool)> {
        match *input {
            Input::Edge { pin: A, high } => {
                self.mv = if high { LOGIC_HIGH_MV } else { 0 };
                self.set_a(at, high, mode)
            }
            Input::Millivolts { pin: A, mv } => {
                self.mv = mv;
                self.set_a(at, mv > HIGH_MV, mode)
            }
            Input::Edge { pin: B, high } => {
                self.b = high;
                Some((Channel::B, high))
            }
            Input::Edge { pin: I, high } => {
                self.index = high;
                Some((Channel::Index, self.index(mdr1)))
            }
            // The counter of a board has counted.
            Input::Count { a, b, .. } => {
                (self.a, self.b) = (a, b);
                None
            }
            _ => None,
        }
    }

    fn set_a(&mut self, at: Instant, high: bool, mode: Mode) -> Option<(Channel, bool)> {
        if self.a == high {
            return None;
        }
        self.a = high;
        if mode == Mode::Pwm {
            self.pwm.edge(at, high);
        }
        Some((Channel::A, high))
    }

    /// The bit of MODE for the resolution of a PWM encoder.
    pub(super) fn pwm_resolution(&self) -> i64 {
        if self.pwm.is_twelve_bit() { PWM_RESOLUTION } else { 0 }
    }

    /// The value that is compared with THRESHOLD; `count` is that of the counter.
    pub(super) fn value(&self, mode: Mode, count: u32) -> u32 {
        match mode {
            Mode::Quadrature => count,
            Mode::Pwm => self.pwm.value(),
            Mode::Analogue => {
                let mv = self.mv.clamp(0, FULL_SCALE_MV);
                (mv * 1_024 / FULL_SCALE_MV).min(1_023).cast_unsigned()
            }
        }
    }
}
