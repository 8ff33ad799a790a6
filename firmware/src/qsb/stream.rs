//! Streams: registers that the adapter sends repeatedly.

use super::clock::Clock;
use super::instrument::Instrument;
use super::reasons::Why;
use super::registers::Reg;
use crate::device::{Duration, Instant};

/// Streams, in the order of the bits of [`Reg::Streams`].
const STREAMS: [Reg; 5] = [Reg::DigIO, Reg::Capture, Reg::Str, Reg::ReadEncoder, Reg::MdStatus];
/// The stream with an interval; the other streams send after a change.
const ENCODER: u8 = bit(Reg::ReadEncoder);
/// The stream of the counter's status.
const STATUS: u8 = bit(Reg::Str);
/// Streams that W160 and W161 end.
const ENDED_BY_COMMAND: u8 = bit(Reg::DigIO) | ENCODER | bit(Reg::MdStatus);
/// Value of INTERVAL RATE that pauses the encoder's stream.
const PAUSED: u16 = 0xFFFF;

/// Bit in [`Reg::Streams`]; 0 for a register that does not stream.
const fn bit(reg: Reg) -> u8 {
    match reg {
        Reg::DigIO => 1 << 0,
        Reg::Capture => 1 << 1,
        Reg::Str => 1 << 2,
        Reg::ReadEncoder => 1 << 3,
        Reg::MdStatus => 1 << 4,
        _ => 0,
    }
}

/// The pace of the encoder's stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    clock: Clock,
    rate: u16,
    measurement: Duration,
}

impl Pace {
    /// The pace that INTERVAL RATE selects, if a measurement takes this time.
    pub(super) fn new(clock: Clock, rate: u16, measurement: Duration) -> Self {
        Self { clock, rate, measurement }
    }

    /// Time of the measurement that follows the one at `measured`: an interval later, but not before `at` (QSB-11).
    fn next(self, measured: Instant, at: Instant) -> Instant {
        match self.rate {
            PAUSED => Instant::NEVER,
            0 => (measured + self.measurement).max(at),
            ticks => {
                let due = self.clock.instant(self.clock.ticks(measured) + u64::from(ticks));
                let passed = self.clock.ticks(at);
                let now = self.clock.instant(passed);
                due.max(if now < at { self.clock.instant(passed + 1) } else { now })
            }
        }
    }
}

/// The running streams.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    running: u8,
    /// For each register the value that was sent last. For READ ENCODER the value that is compared with
    /// THRESHOLD.
    sent: [u32; STREAMS.len()],
    /// Time since which a stream other than READ ENCODER differs from its last record; [`Instant::NEVER`] if
    /// none differs.
    changed: Instant,
    /// Time of the last measurement of the encoder.
    measured: Instant,
    /// Time of the next measurement.
    next: Instant,
    /// Streams that were already served while others waited for the line.
    round_robin: u8,
}

impl Streams {
    pub(super) fn new() -> Self {
        Self {
            running: 0,
            sent: [0; STREAMS.len()],
            changed: Instant::NEVER,
            measured: Instant::ZERO,
            next: Instant::NEVER,
            round_robin: 0,
        }
    }

    /// Bits of the running streams, as in [`Reg::Streams`].
    pub(super) fn running(&self) -> u8 {
        self.running
    }

    /// Ends the streams with these bits, as in [`Reg::Streams`].
    pub(super) fn end(&mut self, streams: u8) {
        self.running &= !streams;
        if streams & ENCODER != 0 {
            self.next = Instant::NEVER;
        }
    }

    /// Ends the streams that W160 and W161 end.
    ///
    /// # Errors
    /// Other streams go on.
    pub(super) fn end_by_command(&mut self) -> Result<(), Why> {
        self.end(ENDED_BY_COMMAND);
        if self.running == 0 { Ok(()) } else { Err(Why::StreamsRun) }
    }

    /// Ends the stream of a register, if it has one.
    pub(super) fn end_of(&mut self, reg: Reg) {
        self.end(bit(reg));
    }

    /// Returns true if the stream of the counter's status runs, which is compared after every event of the counter.
    pub(super) fn has_status(&self) -> bool {
        self.running & STATUS != 0
    }

    /// The streams whose bits are set in a saved [`Reg::Streams`].
    pub(super) fn saved(streams: u16) -> impl Iterator<Item = Reg> {
        STREAMS.into_iter().filter(move |reg| streams & u16::from(bit(*reg)) != 0)
    }

    /// Starts a stream. Its first value is sent now.
    ///
    /// # Errors
    /// The stream is paused.
    pub(super) fn begin(&mut self, at: Instant, reg: Reg, value: u32, pace: Pace) -> Result<(), Why> {
        self.running |= bit(reg);
        self.note_sent(reg, value);
        if reg != Reg::ReadEncoder {
            return Ok(());
        }
        self.measured = at;
        self.schedule(at, pace);
        if self.next == Instant::NEVER { Err(Why::IntervalPaused) } else { Ok(()) }
    }

    fn note_sent(&mut self, reg: Reg, value: u32) {
        for (name, sent) in STREAMS.into_iter().zip(&mut self.sent) {
            if name == reg {
                *sent = value;
            }
        }
    }

    /// Schedules the next measurement.
    pub(super) fn schedule(&mut self, at: Instant, pace: Pace) {
        let runs = self.running & ENCODER != 0;
        self.next = if runs { pace.next(self.measured, at) } else { Instant::NEVER };
    }

    /// Time at which a record is ready and the line, which is free from `free_at` on, can send it.
    pub(super) fn deadline(&self, free_at: Instant) -> Instant {
        let due = self.changed.min(self.next);
        if due == Instant::NEVER { due } else { due.max(free_at) }
    }

    /// Notes the time at which a register began to differ from its last record. It follows every event.
    pub(super) fn note_changes(&mut self, at: Instant, instrument: &Instrument) {
        let watched = self.running & !ENCODER;
        let differs = |(reg, sent)| watched & bit(reg) != 0 && instrument.measure(at, reg) != sent;
        let any_differs = watched != 0 && STREAMS.into_iter().zip(self.sent).any(differs);
        self.note_changed(at, any_differs);
    }

    fn note_changed(&mut self, at: Instant, differs: bool) {
        self.changed = if differs { self.changed.min(at) } else { Instant::NEVER };
    }

    /// Returns the register and the value of the record that is sent now, if one is due. Streams that wait for the line
    /// take turns, lowest register first (QSB-12).
    pub(super) fn take_record(&mut self, at: Instant, instrument: &Instrument) -> Option<(Reg, u32)> {
        let mut values = self.sent;
        let mut waiting = 0;
        for (reg, value) in STREAMS.into_iter().zip(&mut values) {
            let is_encoder = reg == Reg::ReadEncoder;
            if self.running & bit(reg) == 0 || is_encoder && at < self.next {
                continue;
            }
            let sent = *value;
            *value = instrument.measure(at, reg);
            if is_encoder || *value != sent {
                waiting |= bit(reg);
            }
        }
        let turn = match waiting & !self.round_robin {
            0 => waiting,
            turn => turn,
        };
        let found = STREAMS.into_iter().zip(values).find(|(reg, _)| turn & bit(*reg) != 0);
        let Some((reg, value)) = found else {
            // In this instant the values have become again those that were sent last.
            self.note_changed(at, false);
            return None;
        };
        let others = waiting & !bit(reg);
        self.round_robin = if others == 0 { 0 } else { waiting & !turn | bit(reg) };
        self.note_changed(at, others & !ENCODER != 0);
        let sends = reg != Reg::ReadEncoder || self.measure(at, value, instrument);
        if sends {
            self.note_sent(reg, value);
        }
        sends.then_some((reg, value))
    }

    /// Notes a measurement of the encoder. Returns true if the value has changed by THRESHOLD or more.
    fn measure(&mut self, at: Instant, value: u32, instrument: &Instrument) -> bool {
        let [_, _, _, sent, _] = self.sent;
        self.measured = at;
        self.schedule(at, instrument.pace());
        let way = value.wrapping_sub(sent).cast_signed().unsigned_abs();
        way >= u32::from(instrument.bank().word(Reg::Threshold))
    }
}
