//! The value of READ ENCODER in each MODE.

use super::adapter::Adapter;
use super::registers::Reg;
use crate::counter::Channel;
use crate::device::{Duration, HIGH_MV, Instant, LOGIC_HIGH_MV};

/// Voltage at full scale.
const FULL_SCALE_MV: i32 = 5_000;
/// A longer period is that of a 12-bit encoder (250 Hz), a shorter one that of a 10-bit encoder (1 kHz).
const TWELVE_BIT: Duration = Duration::millis(2);
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
pub(super) struct Pwm {
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

impl Adapter {
    pub(super) fn mode(&self) -> Mode {
        match self.bank.word(Reg::Mode) & 3 {
            1 => Mode::Pwm,
            2 => Mode::Analogue,
            _ => Mode::Quadrature,
        }
    }

    /// Value of MODE when read.
    pub(super) fn mode_register(&self) -> i64 {
        let twelve_bit = if self.pwm.is_twelve_bit() { PWM_RESOLUTION } else { 0 };
        self.bank.get(Reg::Mode) & 3 | twelve_bit
    }

    /// Handles a voltage at A, under any of the pin's names (QSB-16).
    pub(super) fn voltage(&mut self, at: Instant, mv: i32) {
        self.pins.mv = mv;
        self.contact(at, mv > HIGH_MV);
    }

    /// Handles a level at A, under any of the pin's names.
    pub(super) fn level(&mut self, at: Instant, high: bool) {
        self.pins.mv = if high { LOGIC_HIGH_MV } else { 0 };
        self.contact(at, high);
    }

    fn contact(&mut self, at: Instant, high: bool) {
        if self.pins.a == high {
            return;
        }
        self.pins.a = high;
        self.count(at, Channel::A, high);
        if self.mode() == Mode::Pwm {
            self.pwm.edge(at, high);
        }
    }

    /// The value that is compared with THRESHOLD.
    pub(super) fn encoder_value(&self) -> u32 {
        match self.mode() {
            Mode::Quadrature => self.counter.cntr(),
            Mode::Pwm => self.pwm.value(),
            Mode::Analogue => {
                let mv = self.pins.mv.clamp(0, FULL_SCALE_MV);
                (mv * 1_024 / FULL_SCALE_MV).min(1_023).cast_unsigned()
            }
        }
    }

    /// Value of READ ENCODER when read (QSB-15).
    pub(super) fn encoder_register(&self, at: Instant) -> u32 {
        let value = self.encoder_value();
        if self.mode() != Mode::Analogue {
            return value;
        }
        u32::from(self.clock.half_milliseconds(at)) << 16 | u32::from(self.port(at)) << 12 | value
    }
}
