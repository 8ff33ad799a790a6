//! The digital port: levels, captures, and the pulse of a trigger.

use super::DIO;
use super::adapter::{Adapter, flush_filter};
use super::clock::TICK;
use super::reasons::Why;
use super::registers::{Reg, config};
use crate::device::{Context, Duration, Instant, Level, Output, Pin, REPORTS_REASONS};

/// Time after which every delayed edge has passed the counter's filter.
const FILTER: Duration = Duration::micros(1);
/// DIO1 and DIO2, which the motor drive uses.
const MOTOR_LINES: u8 = 0b0110;
/// DIO2, the direction of the motor.
const DIRECTION: u8 = 0b0100;
/// All lines that a QSB may have.
const LINES: u8 = 0b1111;

impl Adapter {
    /// The lines that the motor drive uses now.
    fn motor_lines(&self) -> u8 {
        if self.motor.is_active() { MOTOR_LINES } else { 0 }
    }

    /// Value of DIG I/O when read: the levels of the pins.
    pub(super) fn port(&self, at: Instant) -> u8 {
        let outside = self.pins.dio | !self.variant.lines;
        let bits = outside & !self.pulled & LINES;
        if !self.motor.is_active() {
            return bits;
        }
        // A step pulse is too short to be read (QSB-26).
        bits & !MOTOR_LINES | if self.motor.is_forward(at) { DIRECTION } else { 0 }
    }

    /// Handles a new level from outside.
    pub(super) fn line_edge(&mut self, at: Instant, pin: Pin, high: bool, out: &mut dyn Context) {
        let Some(n) = DIO.iter().position(|dio| *dio == pin) else { return };
        let line = 1 << n & self.variant.lines;
        if line == 0 || (self.pins.dio & line != 0) == high {
            return;
        }
        self.pins.dio ^= line;
        let config = self.bank.word(Reg::DigIOConfig);
        let word = u16::from(line);
        let input = config & word << config::OUTPUTS == 0 && self.motor_lines() & line == 0;
        let falling = config & word << config::FALLING != 0;
        if self.is_ready() && input && config & word << config::CAPTURES != 0 && falling != high {
            self.catch_up(at, out);
            let count = self.count_with_edges(at);
            self.bank.set(Reg::Capture, i64::from(count));
        }
    }

    /// The count, including the edges of A and B that have arrived by `at` but are still delayed by the
    /// filter (QSB-24).
    fn count_with_edges(&self, at: Instant) -> u32 {
        let mut counter = self.counter.clone();
        flush_filter(&mut counter, at + FILTER);
        counter.cntr()
    }

    /// Executes a trigger: an event of the counter that MDR1 selects (QSB-25).
    pub(super) fn trigger(&mut self, at: Instant, out: &mut dyn Context) {
        const PULSE: u16 = config::PULSE | 1 << config::OUTPUTS;
        if self.bank.word(Reg::DigIOConfig) & PULSE != PULSE {
            return;
        }
        match self.bank.word(Reg::IntervalRate) {
            0 => self.bank.set(Reg::DigIO, self.bank.get(Reg::DigIO) ^ 1),
            ticks => self.pulse = Some(at + TICK * u64::from(ticks)),
        }
        self.update_port(at, out);
    }

    pub(super) fn pulse_due(&self) -> Instant {
        self.pulse.unwrap_or(Instant::NEVER)
    }

    /// Ends a trigger's pulse, because it is over or the port was written. The pin gets the written value.
    pub(super) fn end_pulse(&mut self, at: Instant, out: &mut dyn Context) {
        self.pulse = None;
        self.update_port(at, out);
    }

    /// The lines that the variant has and the motor drive does not use.
    fn free_lines(&self) -> u8 {
        self.variant.lines & !self.motor_lines()
    }

    /// The lines that DIG I/O drives.
    fn driven_lines(&self) -> u8 {
        (self.bank.word(Reg::DigIOConfig) >> config::OUTPUTS) as u8 & self.free_lines()
    }

    /// Checks a write of DIG I/O that changes these lines: one of them must be an output.
    pub(super) fn check_port(&self, changed: u8) -> Result<(), Why> {
        match changed & LINES {
            _ if !REPORTS_REASONS => Ok(()),
            0 => Ok(()),
            lines if lines & self.driven_lines() != 0 => Ok(()),
            lines => self.check_lines(lines).and(Err(Why::InputPins)),
        }
    }

    /// Checks a write of DIG I/O CONFIG that changes the bits `changed`. At least one of their lines must be
    /// free.
    pub(super) fn check_config(&self, changed: u16) -> Result<(), Why> {
        let pulse = if changed & config::PULSE != 0 { 1 } else { 0 };
        let lines = (changed | changed >> config::CAPTURES | changed >> config::OUTPUTS) as u8 & LINES;
        self.check_lines(lines | pulse)
    }

    /// Checks a write for these lines. At least one of the lines must be free.
    fn check_lines(&self, lines: u8) -> Result<(), Why> {
        if !REPORTS_REASONS || lines == 0 || lines & self.free_lines() != 0 {
            Ok(())
        } else if lines & self.variant.lines != 0 {
            Err(Why::MotorLines)
        } else {
            Err(Why::NoSuchLines)
        }
    }

    /// Drives the outputs that have a new level. Lines of the motor drive stay unchanged.
    pub(super) fn update_port(&mut self, at: Instant, out: &mut dyn Context) {
        let latch = self.bank.word(Reg::DigIO) as u8 ^ u8::from(self.pulse.is_some());
        let pulled = self.driven_lines() & !latch;
        let changed = pulled ^ self.pulled;
        self.pulled = pulled;
        self.put_lines(changed & !self.motor_lines(), at, out);
    }

    /// Drives DIO1 and DIO2 after the motor drive has released them.
    pub(super) fn on_motor_released(&mut self, at: Instant, out: &mut dyn Context) {
        self.update_port(at, out);
        self.put_lines(MOTOR_LINES, at, out);
    }

    /// Releases all lines, independently of their state (QSB-23).
    pub(super) fn release_port(&mut self, at: Instant, out: &mut dyn Context) {
        self.pulled = 0;
        self.put_lines(self.variant.lines, at, out);
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
