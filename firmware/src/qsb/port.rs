//! The digital port: levels of the lines, and the pulse of a trigger.

use super::clock::TICK;
use super::reasons::Why;
use super::registers::Reg;
use super::{DIO, Words};
use crate::device::{Context, Instant, Level, Output, Pin, REPORTS_REASONS};

/// Positions of DIO0's bits in DIG I/O CONFIG.
const FALLING: u16 = 0;
const CAPTURES: u16 = 4;
const OUTPUTS: u16 = 8;
/// Bit of DIG I/O CONFIG: a trigger makes a pulse.
const PULSE: u16 = 1 << 12;

/// DIO1 and DIO2, which the motor drive uses.
const MOTOR_LINES: u8 = 0b0110;
/// DIO2, the direction of the motor.
const DIRECTION: u8 = 0b0100;
/// All lines that a QSB may have.
const LINES: u8 = 0b1111;

/// The digital port. A bit of a mask is a line, from DIO0 on.
#[derive(Clone, Debug)]
pub(super) struct DigitalPort {
    /// The lines of the variant.
    lines: u8,
    /// True while the motor drive uses [`MOTOR_LINES`].
    is_lent: bool,
    /// Levels from outside. They stay unchanged by a reset.
    outside: u8,
    /// Lines that the adapter pulls low, without those of the motor drive.
    pulled: u8,
    /// End of a trigger's pulse; [`Instant::NEVER`] without a pulse. DIO0 is inverted during the pulse.
    pulse_end: Instant,
}

impl DigitalPort {
    /// A port with these lines, and no connection.
    pub(super) fn new(lines: u8) -> Self {
        Self { lines, is_lent: false, outside: LINES, pulled: 0, pulse_end: Instant::NEVER }
    }

    /// Releases all lines at a reset, independently of their state (QSB-23).
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        *self = Self { outside: self.outside, ..Self::new(self.lines) };
        self.put_lines(self.lines, at, out);
    }

    /// Value of DIG I/O when read: the levels of the pins. `forward` is the direction of the motor.
    pub(super) fn value(&self, forward: bool) -> u8 {
        let bits = (self.outside | !self.lines) & !self.pulled & LINES;
        if !self.is_lent {
            return bits;
        }
        // A step pulse is too short to be read (QSB-26).
        bits & !MOTOR_LINES | if forward { DIRECTION } else { 0 }
    }

    /// Sets a level from outside. Returns true if the edge captures the count.
    pub(super) fn edge(&mut self, pin: Pin, high: bool, bank: &Words) -> bool {
        let Some(n) = DIO.iter().position(|dio| *dio == pin) else { return false };
        let line = 1 << n & self.lines;
        if line == 0 || (self.outside & line != 0) == high {
            return false;
        }
        self.outside ^= line;
        let has = |position: u16| bank.word(Reg::DigIOConfig) & u16::from(line) << position != 0;
        line & self.free_lines() != 0 && !has(OUTPUTS) && has(CAPTURES) && has(FALLING) != high
    }

    /// Executes a trigger: an event of the counter that MDR1 selects (QSB-25).
    pub(super) fn trigger(&mut self, at: Instant, bank: &mut Words, out: &mut dyn Context) {
        const TRIGGERED: u16 = PULSE | 1 << OUTPUTS;
        if bank.word(Reg::DigIOConfig) & TRIGGERED != TRIGGERED {
            return;
        }
        match bank.word(Reg::IntervalRate) {
            0 => bank.set(Reg::DigIO, bank.get(Reg::DigIO) ^ 1),
            ticks => self.pulse_end = at + TICK * u64::from(ticks),
        }
        self.update(at, bank, out);
    }

    /// End of a trigger's pulse.
    pub(super) fn deadline(&self) -> Instant {
        self.pulse_end
    }

    /// Ends a pulse that is over.
    pub(super) fn timeout(&mut self, at: Instant, bank: &Words, out: &mut dyn Context) {
        if self.pulse_end <= at {
            self.end_pulse(at, bank, out);
        }
    }

    /// Ends a trigger's pulse, because it is over or the port was written. The pin gets the written value.
    pub(super) fn end_pulse(&mut self, at: Instant, bank: &Words, out: &mut dyn Context) {
        self.pulse_end = Instant::NEVER;
        self.update(at, bank, out);
    }

    /// Drives the outputs that have a new level. Lines of the motor drive stay unchanged.
    pub(super) fn update(&mut self, at: Instant, bank: &Words, out: &mut dyn Context) {
        let latch = bank.word(Reg::DigIO) as u8 ^ u8::from(self.pulse_end != Instant::NEVER);
        let pulled = self.driven_lines(bank) & !latch;
        let changed = pulled ^ self.pulled;
        self.pulled = pulled;
        self.put_lines(changed & !self.motor_lines(), at, out);
    }

    /// Gives DIO1 and DIO2 to the motor drive.
    pub(super) fn lend(&mut self) {
        self.is_lent = true;
    }

    /// Ends a trigger's pulse, and drives DIO1 and DIO2 if the motor drive had them. Returns true if it did.
    pub(super) fn take_back(&mut self, at: Instant, bank: &Words, out: &mut dyn Context) -> bool {
        let was_lent = core::mem::take(&mut self.is_lent);
        self.end_pulse(at, bank, out);
        if was_lent {
            self.put_lines(MOTOR_LINES, at, out);
        }
        was_lent
    }

    /// Checks a write of DIG I/O that changes these lines: one of them must be an output.
    pub(super) fn check_write(&self, changed: u8, bank: &Words) -> Result<(), Why> {
        match changed & LINES {
            _ if !REPORTS_REASONS => Ok(()),
            0 => Ok(()),
            lines if lines & self.driven_lines(bank) != 0 => Ok(()),
            lines => self.check_lines(lines).and(Err(Why::InputPins)),
        }
    }

    /// Checks a write of DIG I/O CONFIG that changes the bits `changed`. At least one of their lines must be
    /// free. Lines that are low become high.
    pub(super) fn check_config(&self, changed: u16) -> Result<(), Why> {
        if self.pulled != 0 {
            return Err(Why::AllHigh);
        }
        let pulse = if changed & PULSE != 0 { 1 } else { 0 };
        let lines = (changed | changed >> CAPTURES | changed >> OUTPUTS) as u8 & LINES;
        self.check_lines(lines | pulse)
    }

    /// Checks a write for these lines. At least one of the lines must be free.
    fn check_lines(&self, lines: u8) -> Result<(), Why> {
        if !REPORTS_REASONS || lines == 0 || lines & self.free_lines() != 0 {
            Ok(())
        } else if lines & self.lines != 0 {
            Err(Why::MotorLines)
        } else {
            Err(Why::NoSuchLines)
        }
    }

    /// The lines that the motor drive uses now.
    fn motor_lines(&self) -> u8 {
        if self.is_lent { MOTOR_LINES } else { 0 }
    }

    /// The lines that the variant has and the motor drive does not use.
    fn free_lines(&self) -> u8 {
        self.lines & !self.motor_lines()
    }

    /// The lines that DIG I/O drives.
    fn driven_lines(&self, bank: &Words) -> u8 {
        (bank.word(Reg::DigIOConfig) >> OUTPUTS) as u8 & self.free_lines()
    }

    fn put_lines(&self, lines: u8, at: Instant, out: &mut dyn Context) {
        for (n, pin) in DIO.into_iter().enumerate() {
            if lines & 1 << n != 0 {
                let level = if self.pulled & 1 << n != 0 { Level::Low } else { Level::Float };
                out.put(at, Output::Level { pin, level });
            }
        }
    }
}
