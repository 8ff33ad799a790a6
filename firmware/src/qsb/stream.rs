//! Streams: registers that the adapter sends repeatedly.

use drivetwin_protocol::registers::Register;

use super::adapter::Adapter;
use super::reasons::Why;
use super::registers::Reg;
use crate::device::{Context, Instant};

/// Streams, in the order of the bits of [`Reg::Streams`].
const STREAMS: [Reg; 5] = [Reg::DigIO, Reg::Capture, Reg::Str, Reg::ReadEncoder, Reg::MdStatus];
/// The stream with an interval; the other streams send after a change.
const ENCODER: u8 = bit(Reg::ReadEncoder);
/// The stream of the counter's status, which must be compared after every event of the counter.
pub(super) const STATUS: u8 = bit(Reg::Str);
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

    fn set_sent(&mut self, reg: Reg, value: u32) {
        for (name, sent) in STREAMS.into_iter().zip(&mut self.sent) {
            if name == reg {
                *sent = value;
            }
        }
    }

    fn sent(&self, reg: Reg) -> u32 {
        STREAMS.into_iter().zip(self.sent).find_map(|(name, sent)| (name == reg).then_some(sent)).unwrap_or(0)
    }
}

impl Adapter {
    /// Starts the saved streams, as if they were requested now (QSB-13).
    pub(super) fn resume_streams(&mut self, at: Instant) {
        let saved = self.bank.word(Reg::Streams) as u8;
        for reg in STREAMS.into_iter().filter(|reg| saved & bit(*reg) != 0) {
            let exists = Reg::ENTRIES.list.get(reg.row()).is_some_and(|row| self.has(row));
            if exists {
                let _ = self.begin_stream(at, reg);
            }
        }
    }

    /// Starts a stream. The response to `S` carries its first value.
    ///
    /// # Errors
    /// The stream is paused.
    pub(super) fn begin_stream(&mut self, at: Instant, reg: Reg) -> Result<(), Why> {
        self.streams.running |= bit(reg);
        self.note_sent(at, reg);
        let paused = reg == Reg::ReadEncoder && self.streams.next == Instant::NEVER;
        if paused { Err(Why::IntervalPaused) } else { Ok(()) }
    }

    /// Notes that the present value of a register is being sent.
    fn note_sent(&mut self, at: Instant, reg: Reg) {
        let value = self.comparison_value(at, reg);
        self.streams.set_sent(reg, value);
        if reg == Reg::ReadEncoder {
            self.streams.measured = at;
            self.schedule(at);
        }
    }

    /// Value that is compared to detect a change of a register.
    fn comparison_value(&self, at: Instant, reg: Reg) -> u32 {
        if reg == Reg::ReadEncoder { self.encoder_value() } else { self.value(at, reg) as u32 }
    }

    /// Schedules the next measurement: an interval after the last one, but not in the past (QSB-11).
    pub(super) fn schedule(&mut self, at: Instant) {
        let measured = self.streams.measured;
        self.streams.next = match self.bank.word(Reg::IntervalRate) {
            _ if self.streams.running & ENCODER == 0 => Instant::NEVER,
            PAUSED => Instant::NEVER,
            0 => (measured + self.mode().measurement()).max(at),
            ticks => {
                let due = self.clock.instant(self.clock.ticks(measured) + u64::from(ticks));
                let passed = self.clock.ticks(at);
                let now = self.clock.instant(passed);
                due.max(if now < at { self.clock.instant(passed + 1) } else { now })
            }
        };
    }

    /// Time at which a record is ready and the line is free.
    pub(super) fn stream_due(&self) -> Instant {
        let due = self.streams.changed.min(self.streams.next);
        if due == Instant::NEVER { due } else { due.max(self.serial.free_at()) }
    }

    /// Sends one record if one is due. Streams that wait for the line take turns, lowest register first
    /// (QSB-12).
    pub(super) fn stream(&mut self, at: Instant, out: &mut dyn Context) {
        if at < self.serial.free_at() {
            return;
        }
        let waiting = self.changed_streams(at) | if self.streams.next <= at { ENCODER } else { 0 };
        let turn = match waiting & !self.streams.round_robin {
            0 => waiting,
            turn => turn,
        };
        if let Some(reg) = STREAMS.into_iter().find(|reg| turn & bit(*reg) != 0) {
            let others = waiting & !bit(reg) != 0;
            self.streams.round_robin = if others { waiting & !turn | bit(reg) } else { 0 };
            match reg {
                Reg::ReadEncoder => self.measure(at, out),
                _ => self.record(at, reg, out),
            }
        }
    }

    /// Notes the time at which a register began to differ from its last record.
    pub(super) fn note_changes(&mut self, at: Instant) {
        self.streams.changed = match self.changed_streams(at) {
            0 => Instant::NEVER,
            _ => self.streams.changed.min(at),
        };
    }

    /// Streams with a register that differs from its last record, without READ ENCODER.
    fn changed_streams(&self, at: Instant) -> u8 {
        let watched = self.streams.running & !ENCODER;
        if watched == 0 {
            return 0;
        }
        let changed = |reg: &Reg| {
            watched & bit(*reg) != 0 && self.comparison_value(at, *reg) != self.streams.sent(*reg)
        };
        STREAMS.into_iter().filter(changed).fold(0, |changed, reg| changed | bit(reg))
    }

    /// Measures the encoder, and sends the value if it has changed by THRESHOLD or more.
    fn measure(&mut self, at: Instant, out: &mut dyn Context) {
        let way = self.encoder_value().wrapping_sub(self.streams.sent(Reg::ReadEncoder));
        if way.cast_signed().unsigned_abs() >= u32::from(self.bank.word(Reg::Threshold)) {
            self.record(at, Reg::ReadEncoder, out);
        } else {
            self.streams.measured = at;
            self.schedule(at);
        }
    }

    fn record(&mut self, at: Instant, reg: Reg, out: &mut dyn Context) {
        self.note_sent(at, reg);
        self.send_value(at, b's', reg, out);
    }
}
