//! Effects of reading and writing each register.

use drivetwin_protocol::registers::Register;

use super::adapter::{Adapter, flush_filter};
use super::encoder::Pwm;
use super::motor::{self, Order, Settings};
use super::reasons::Why;
use super::registers::{Reg, mdr1};
use crate::counter::Channel;
use crate::device::{Context, Instant, PresetError, REPORTS_REASONS};

impl Adapter {
    /// Present value of a register; the caller has updated the counter.
    pub(super) fn value(&self, at: Instant, reg: Reg) -> i64 {
        match reg {
            Reg::Mode => self.mode_register(),
            Reg::DigIO => self.port(at).into(),
            Reg::Str => self.counter.status().into(),
            Reg::Otr => self.counter.cntr().into(),
            Reg::TimeStamp => self.clock.timestamp(at).into(),
            Reg::ReadEncoder => self.encoder_register(at).into(),
            Reg::MdStatus => self.motor.status(at).into(),
            Reg::Version => self.version().into(),
            _ => self.bank.get(reg),
        }
    }

    /// Version of the firmware.
    pub(super) fn firmware(&self) -> u8 {
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

    /// Writes a value that the register's row accepts, and applies it. Returns false if the drive refuses the
    /// write for a reason that the row does not state. The registers are in the order of their addresses.
    pub(super) fn write(&mut self, at: Instant, reg: Reg, value: i64, out: &mut dyn Context) -> bool {
        if reg == Reg::Command {
            return self.command(at, value, out);
        }
        let before = self.bank.word(reg);
        self.bank.set(reg, stored_value(reg, value));
        let mut done = Ok(());
        match reg {
            Reg::Mode => {
                self.pwm = Pwm::default();
                self.schedule(at);
            }
            Reg::DigIO => {
                done = self.check_port((before ^ self.bank.word(reg)) as u8);
                self.end_pulse(at, out);
            }
            Reg::DigIOConfig => {
                done = match self.pulled {
                    0 => self.check_config(before ^ self.bank.word(reg)),
                    _ => Err(Why::AllHigh),
                };
                self.bank.set(Reg::DigIO, 0xF);
                self.end_pulse(at, out);
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
                    done = Err(Why::HiddenOtr);
                }
            },
            Reg::IntervalRate => self.schedule(at),
            Reg::TimeStamp if value == 1 => self.clock.set_timestamp(at, 0),
            Reg::TimeStamp => done = Err(Why::TimeStampKey),
            // The motor's orders read these registers.
            Reg::MdStepRate | Reg::MdAccel | Reg::MdMoveSteps | Reg::MdJogRate
                if REPORTS_REASONS && self.motor.has_motion() =>
            {
                done = Err(Why::NextCommand);
            }
            Reg::MdStepRate | Reg::MdAccel | Reg::MdJogRate
                if REPORTS_REASONS && value % motor::UNIT != 0 =>
            {
                done = Err(Why::Rounded);
            }
            // The other registers are read when they are used.
            _ => {}
        }
        if let Err(why) = done {
            why.put(at, out);
        }
        true
    }

    /// Applies a register of the counter from the bank.
    pub(super) fn configure_counter(&mut self, at: Instant, reg: Reg) {
        match reg {
            Reg::Mdr0 => self.counter.set_mdr0(self.bank.word(Reg::Mdr0) as u8),
            Reg::Mdr1 => {
                let mdr1 = self.bank.word(Reg::Mdr1);
                self.counter.set_mdr1((mdr1 & !mdr1::WIDTH) as u8);
                self.counter.set_reversed(mdr1 & mdr1::COUNT_DOWN != 0);
                self.counter.edge(at, Channel::Index, self.index_level());
            }
            _ => self.counter.set_dtr(self.bank.get(Reg::Dtr) as u32),
        }
    }

    /// Executes COMMAND. Returns false if it is refused: this variant does not have the command, or the motor
    /// cannot obey it.
    fn command(&mut self, at: Instant, value: i64, out: &mut dyn Context) -> bool {
        let order = match value {
            1 => {
                if let Err(why) = self.streams.end_by_command() {
                    why.put(at, out);
                }
                return true;
            }
            3 => {
                self.save_parameters(at, out);
                return true;
            }
            rate if rate & 0xFF == 0x0A => {
                self.save_rate(at, rate >> 8, out);
                return true;
            }
            _ if !self.variant.motor => return false,
            0 => {
                self.release_motor(at, out);
                return true;
            }
            2 => {
                self.motor.activate(at, out);
                self.update_port(at, out);
                return true;
            }
            4 => Order::Stop,
            5 => Order::Quit,
            6 => Order::Pause,
            7 => Order::Resume,
            8 => Order::Move,
            _ => Order::Jog,
        };
        let settings = Settings {
            step_rate: self.bank.word(Reg::MdStepRate),
            acceleration: self.bank.get(Reg::MdAccel) as u32,
            steps: self.bank.get(Reg::MdMoveSteps) as i32,
            jog_rate: self.bank.get(Reg::MdJogRate) as i32,
        };
        self.motor.order(at, order, &settings, out)
    }

    /// Command 0: ends the motor drive mode, ends the same streams as command 1, and restores the saved values
    /// of the port.
    fn release_motor(&mut self, at: Instant, out: &mut dyn Context) {
        let ended = self.streams.end_by_command();
        let stored = self.stored(out);
        for reg in [Reg::DigIO, Reg::DigIOConfig] {
            self.bank.set(reg, stored.get(reg));
        }
        let had_lines = self.motor.is_active();
        self.motor.deactivate(at, out);
        self.end_pulse(at, out);
        if had_lines {
            self.on_motor_released(at, out);
        } else if let Err(why) = ended {
            why.put(at, out);
        }
    }

    /// Value that a read of a register would return now. The adapter does not change.
    pub(super) fn peek(&self, at: Instant, row: usize) -> i64 {
        let Some(reg) = Reg::from_row(row) else { return 0 };
        let mut copy = self.clone();
        flush_filter(&mut copy.counter, at);
        copy.value(at, reg)
    }

    /// Presets a register.
    pub(super) fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let reg = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        let row =
            Reg::ENTRIES.list.get(row).filter(|row| self.has(row)).ok_or(PresetError::NoSuchRegister)?;
        if !row.accepts(value) {
            return Err(PresetError::OutOfRange);
        }
        if !self.has_run() {
            let saved = row.saved != 0;
            return if saved {
                self.preset(at, reg, stored_value(reg, value), out)
            } else {
                Err(PresetError::ReadOnly)
            };
        }
        self.catch_up(at, out);
        match reg {
            // Only command 3 writes these two registers.
            Reg::MotorDrive | Reg::Streams => return Err(PresetError::ReadOnly),
            Reg::TimeStamp => self.clock.set_timestamp(at, value as u32),
            _ if !row.access.writes() => return Err(PresetError::ReadOnly),
            _ if !self.write(at, reg, value, out) => return Err(PresetError::OutOfRange),
            _ => self.serial.set_rate(at, self.rate(), out),
        }
        self.note_changes(at);
        Ok(())
    }
}

/// The value that a register stores when a master writes `value` (QSB-9).
fn stored_value(reg: Reg, value: i64) -> i64 {
    match reg {
        Reg::Mode => value & 3,
        Reg::Mdr1 => value & !i64::from(mdr1::WIDTH),
        _ => value,
    }
}

/// Returns true for a value of COMMAND that `command` refuses without a motor.
pub(super) fn is_for_motor(command: i64) -> bool {
    !matches!(command, 1 | 3) && command & 0xFF != 0x0A
}
