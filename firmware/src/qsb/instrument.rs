//! The instrument behind the registers: counter, encoder, port, clock and motor drive, and the effects of reading and
//! writing each register.

use drivetwin_protocol::registers::{Bank, Entry};

use super::clock::Clock;
use super::command::banner;
use super::encoder::{Encoder, Mode};
use super::motor::{self, Motor, Order, Settings};
use super::port::DigitalPort;
use super::reasons::Why;
use super::registers::{Reg, Variant};
use super::stream::Pace;
use super::{DIO, Words};
use crate::counter::{Channel, Ls7366r, status};
use crate::device::{Context, Duration, Input, Instant, REPORTS_REASONS};

/// Width of the counter in MDR1, which always has 32 bits.
const WIDTH: u16 = 0b11;
/// Overflow, underflow, match and index in MDR1, in the bit positions of the counter's flags.
const TRIGGERS: u16 = 0xF0;
/// Bit of MDR1, which the counter does not have.
const COUNT_DOWN: u16 = 1 << 8;
/// Time after which every delayed edge has passed the counter's filter.
const FILTER: Duration = Duration::micros(1);

/// The parts whose state the registers show and set.
#[derive(Clone, Debug)]
pub(super) struct Instrument {
    variant: Variant,
    /// The registers; DIG I/O holds the value written last.
    bank: Words,
    /// True after the start-up: the counter counts.
    is_ready: bool,
    clock: Clock,
    encoder: Encoder,
    counter: Ls7366r,
    port: DigitalPort,
    motor: Motor,
}

impl Instrument {
    /// An instrument whose power was switched on at `at`, with nothing connected.
    pub(super) fn new(at: Instant, variant: Variant) -> Self {
        Self {
            variant,
            bank: Bank::factory(),
            is_ready: false,
            clock: Clock::new(at),
            encoder: Encoder::new(),
            counter: Ls7366r::new(true, true, true),
            port: DigitalPort::new(variant.lines),
            motor: Motor::new(at),
        }
    }

    /// Releases the motor before a reset.
    pub(super) fn deactivate_motor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motor.deactivate(at, out);
    }

    /// Begins the start-up with these registers. The levels of the pins and the position of the motor stay.
    pub(super) fn start(&mut self, at: Instant, bank: Words, out: &mut dyn Context) {
        self.bank = bank;
        self.is_ready = false;
        self.clock = Clock::new(at);
        self.encoder.restart();
        self.counter = Ls7366r::new(true, true, true);
        self.port.restart(at, out);
    }

    /// Ends the start-up.
    pub(super) fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.is_ready = true;
        self.counter = self.encoder.counter(self.bank.word(Reg::Mdr1));
        for reg in [Reg::Mdr0, Reg::Mdr1, Reg::Dtr] {
            self.configure_counter(at, reg);
        }
        self.counter.clear_status();
        self.port.update(at, &self.bank, out);
        if self.variant.motor && self.bank.word(Reg::MotorDrive) != 0 {
            self.motor.activate(at, out);
            self.port.lend();
        }
    }

    /// Returns true if events of the counter have an effect: all events, or those that trigger.
    fn watches_counter(&self, all: bool) -> bool {
        self.is_ready && (all || self.triggers() != 0)
    }

    /// Time of the next [`timeout`](Self::timeout). `streams_status` is true if each event of the counter may send a
    /// record.
    pub(super) fn deadline(&self, streams_status: bool) -> Instant {
        let watches = self.watches_counter(streams_status);
        let counter = if watches { self.counter.deadline() } else { Instant::NEVER };
        counter.min(self.port.deadline()).min(self.motor.deadline())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.catch_up(at, out);
        self.port.timeout(at, &self.bank, out);
        self.motor.timeout(at, out);
    }

    /// Handles an input of a pin, or the counts of a board's hardware counter.
    pub(super) fn input(
        &mut self,
        at: Instant,
        input: Input<'_>,
        streams_status: bool,
        out: &mut dyn Context,
    ) {
        match input {
            Input::Edge { pin, high } if DIO.contains(&pin) => {
                let captures = self.port.edge(pin, high, &self.bank);
                if captures && self.is_ready {
                    self.catch_up(at, out);
                    let count = self.count_with_edges(at);
                    self.bank.set(Reg::Capture, i64::from(count));
                }
            }
            Input::StepsCorrection { steps, .. } => self.motor.correct_steps(steps),
            _ => {
                let edge = self.encoder.input(at, &input, self.mode(), self.bank.word(Reg::Mdr1));
                if !self.is_ready {
                    return;
                }
                if let Some((channel, high)) = edge {
                    self.counter.edge(at, channel, high);
                } else if let Input::Count { steps, a, b, .. } = input {
                    self.counter.take_steps(steps, a, b);
                }
            }
        }
        if self.watches_counter(streams_status) {
            self.catch_up(at, out);
        }
    }

    /// The count, including the edges of A and B that have arrived by `at` but are still delayed by the
    /// filter (QSB-24).
    fn count_with_edges(&self, at: Instant) -> u32 {
        let mut counter = self.counter.clone();
        flush_filter(&mut counter, at + FILTER);
        counter.cntr()
    }

    /// The events of the counter that trigger (MDR1).
    fn triggers(&self) -> u16 {
        self.bank.word(Reg::Mdr1) & TRIGGERS
    }

    /// Updates the counter, and executes the triggers of MDR1 (QSB-22).
    pub(super) fn catch_up(&mut self, at: Instant, out: &mut dyn Context) {
        flush_filter(&mut self.counter, at);
        let events = u16::from(self.counter.take_events()) & self.triggers();
        if events & u16::from(status::IDX) != 0 {
            self.bank.set(Reg::Capture, i64::from(self.counter.at_index()));
        }
        if events != 0 {
            self.port.trigger(at, &mut self.bank, out);
        }
    }

    /// Returns true if this variant has a row.
    pub(super) fn has(&self, row: &Entry) -> bool {
        row.variants & self.variant.bit != 0
    }

    /// The variant of the product.
    pub(super) fn variant(&self) -> Variant {
        self.variant
    }

    /// The registers as they were written or captured last.
    pub(super) fn bank(&self) -> &Words {
        &self.bank
    }

    /// Present value of TIME STAMP.
    pub(super) fn timestamp(&self, at: Instant) -> u32 {
        self.clock.timestamp(at)
    }

    /// Presets TIME STAMP.
    pub(super) fn set_timestamp(&mut self, at: Instant, value: u32) {
        self.clock.set_timestamp(at, value);
    }

    /// Present value of a register; the caller has updated the counter.
    pub(super) fn value(&self, at: Instant, reg: Reg) -> i64 {
        match reg {
            Reg::Mode => self.bank.get(Reg::Mode) & 3 | self.encoder.pwm_resolution(),
            Reg::DigIO => self.port_value(at).into(),
            Reg::Str => self.counter.status().into(),
            Reg::Otr => self.counter.cntr().into(),
            Reg::TimeStamp => self.clock.timestamp(at).into(),
            Reg::ReadEncoder => self.data(at, reg, self.measure(at, reg)).into(),
            Reg::MdStatus => self.motor.status(at).into(),
            Reg::Version => self.version().into(),
            _ => self.bank.get(reg),
        }
    }

    /// The value of a register that is compared for its stream, with THRESHOLD for READ ENCODER.
    pub(super) fn measure(&self, at: Instant, reg: Reg) -> u32 {
        match reg {
            Reg::ReadEncoder => self.encoder.value(self.mode(), self.counter.cntr()),
            _ => self.value(at, reg) as u32,
        }
    }

    /// The data of a record with a measured value. A packet of the analogue input also has the time and the port
    /// (QSB-15).
    pub(super) fn data(&self, at: Instant, reg: Reg, measured: u32) -> u32 {
        if reg != Reg::ReadEncoder || self.mode() != Mode::Analogue {
            return measured;
        }
        u32::from(self.clock.half_milliseconds(at)) << 16 | u32::from(self.port_value(at)) << 12 | measured
    }

    /// The value that [`value`](Self::value) would have after an update of the counter.
    pub(super) fn peek(&self, at: Instant, reg: Reg) -> i64 {
        let mut copy = self.clone();
        flush_filter(&mut copy.counter, at);
        copy.value(at, reg)
    }

    fn mode(&self) -> Mode {
        Mode::of(self.bank.word(Reg::Mode))
    }

    /// The pace of the encoder's stream.
    pub(super) fn pace(&self) -> Pace {
        Pace::new(self.clock, self.bank.word(Reg::IntervalRate), self.mode().measurement())
    }

    fn port_value(&self, at: Instant) -> u8 {
        self.port.value(self.motor.is_forward(at))
    }

    /// The banner that is sent after the start-up.
    pub(super) fn banner(&self) -> [u8; 12] {
        banner(self.variant.letter, self.firmware())
    }

    /// Version of the firmware.
    fn firmware(&self) -> u8 {
        (self.bank.word(Reg::Firmware) & 0xFF) as u8
    }

    /// VERSION: decimal digits of the serial number, then the product and the firmware.
    fn version(&self) -> u32 {
        let mut version = u32::from(self.variant.digit) << 8 | u32::from(self.firmware());
        let mut serial = self.bank.get(Reg::SerialNumber) as u32;
        for digit in 3..8 {
            version |= (serial % 10) << (4 * digit);
            serial /= 10;
        }
        version
    }

    /// Writes a value that the register's row accepts, and applies it. COMMAND is not among the registers, which are in
    /// the order of their addresses.
    ///
    /// # Errors
    /// The reason why the write has no effect, or has another effect.
    pub(super) fn write(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        let before = self.bank.word(reg);
        self.bank.set(reg, stored_value(reg, value));
        let changed = before ^ self.bank.word(reg);
        match reg {
            Reg::Mode => self.encoder.restart(),
            Reg::DigIO => {
                let done = self.port.check_write(changed as u8, &self.bank);
                self.port.end_pulse(at, &self.bank, out);
                return done;
            }
            Reg::DigIOConfig => {
                let done = self.port.check_config(changed);
                self.bank.set(Reg::DigIO, 0xF);
                self.port.end_pulse(at, &self.bank, out);
                return done;
            }
            Reg::Mdr0 | Reg::Mdr1 | Reg::Dtr => self.configure_counter(at, reg),
            Reg::ClearReg => match value {
                0 => return self.write(at, Reg::Mdr0, 0, out),
                1 => return self.write(at, Reg::Mdr1, 0, out),
                2 => self.counter.clear_cntr(),
                _ => self.counter.clear_status(),
            },
            Reg::LoadReg => match value {
                0 => self.counter.load_cntr(),
                _ => {
                    self.counter.load_otr();
                    return Err(Why::HiddenOtr);
                }
            },
            Reg::TimeStamp if value == 1 => self.clock.set_timestamp(at, 0),
            Reg::TimeStamp => return Err(Why::TimeStampKey),
            // The motor's orders read these registers.
            Reg::MdStepRate | Reg::MdAccel | Reg::MdMoveSteps | Reg::MdJogRate
                if REPORTS_REASONS && self.motor.has_motion() =>
            {
                return Err(Why::NextCommand);
            }
            Reg::MdStepRate | Reg::MdAccel | Reg::MdJogRate
                if REPORTS_REASONS && value % motor::UNIT != 0 =>
            {
                return Err(Why::Rounded);
            }
            // The other registers are read when they are used.
            _ => {}
        }
        Ok(())
    }

    /// Applies a register of the counter from the bank.
    fn configure_counter(&mut self, at: Instant, reg: Reg) {
        match reg {
            Reg::Mdr0 => self.counter.set_mdr0(self.bank.word(Reg::Mdr0) as u8),
            Reg::Mdr1 => {
                let mdr1 = self.bank.word(Reg::Mdr1);
                self.counter.set_mdr1((mdr1 & !WIDTH) as u8);
                self.counter.set_reversed(mdr1 & COUNT_DOWN != 0);
                self.counter.edge(at, Channel::Index, self.encoder.index(mdr1));
            }
            _ => self.counter.set_dtr(self.bank.get(Reg::Dtr) as u32),
        }
    }

    /// Sets a register that only a command writes: what the command saves.
    pub(super) fn note(&mut self, reg: Reg, value: i64) {
        self.bank.set(reg, value);
    }

    /// Returns true if DIO1 and DIO2 belong to the motor drive.
    pub(super) fn is_motor_active(&self) -> bool {
        self.motor.is_active()
    }

    /// Command 2: starts the motor drive mode.
    pub(super) fn activate_motor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motor.activate(at, out);
        self.port.lend();
        self.port.update(at, &self.bank, out);
    }

    /// Command 0: ends the motor drive mode, and restores the saved values of the port. Returns false if the mode was
    /// not active.
    pub(super) fn release_motor(&mut self, at: Instant, stored: &Words, out: &mut dyn Context) -> bool {
        for reg in [Reg::DigIO, Reg::DigIOConfig] {
            self.bank.set(reg, stored.get(reg));
        }
        self.motor.deactivate(at, out);
        self.port.take_back(at, &self.bank, out)
    }

    /// Commands 4 to 9. Returns false if the motor cannot obey the order.
    pub(super) fn order(&mut self, at: Instant, order: Order, out: &mut dyn Context) -> bool {
        let settings = Settings {
            step_rate: self.bank.word(Reg::MdStepRate),
            acceleration: self.bank.get(Reg::MdAccel) as u32,
            steps: self.bank.get(Reg::MdMoveSteps) as i32,
            jog_rate: self.bank.get(Reg::MdJogRate) as i32,
        };
        self.motor.order(at, order, &settings, out)
    }
}

/// The value that a register stores when a master writes `value` (QSB-9).
pub(super) fn stored_value(reg: Reg, value: i64) -> i64 {
    match reg {
        Reg::Mode => value & 3,
        Reg::Mdr1 => value & !i64::from(WIDTH),
        _ => value,
    }
}

/// Applies the edges that have passed the counter's filter by `at`. Never inlined, because each copy takes a
/// kilobyte of a board's flash.
#[inline(never)]
fn flush_filter(counter: &mut Ls7366r, at: Instant) {
    counter.timeout(at);
}
