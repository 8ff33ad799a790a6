//! Reads and writes of PIDs, by the bus and by presets.

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::modbus::server::RequestHandler;
use drivetwin_protocol::registers::Register;

use super::Drive;
use crate::device::{Context, Instant, Output, PresetError};
use crate::mdrobot::command::{self, Act};
use crate::mdrobot::reasons::Why;
use crate::mdrobot::reference::Event;
use crate::mdrobot::registers::{DEFAULT_CHECK, MA_PER_UNIT, Pid, stored_value, unlocked, validate};
use crate::mdrobot::saved;

/// Limit of `RPM_DATA` in both directions (p. 12; MDROBOT-18).
const MOST_RPM: i32 = 5_000;
/// Words of the longest PID.
const MOST_WORDS: usize = 9;

impl Drive {
    /// Present value of a PID. A PID of more than four words gives the value of its first four words.
    pub(in crate::mdrobot) fn value(&self, at: Instant, pid: Pid) -> i64 {
        match pid {
            Pid::CTRL_STATUS => (self.alarms.status() & 0xFF).into(),
            Pid::DI => self.inputs.bits(self.servo.encoder_levels()).into(),
            Pid::IN_POSITION_OK => self.in_position().into(),
            Pid::RPM_DATA => self.rpm(at).into(),
            Pid::TQ_DATA => self.current().into(),
            Pid::VOLT_IN => self.alarms.supply().into(),
            Pid::MAX_LOAD_181 => self.bank.get(Pid::MAX_LOAD),
            Pid::MONITOR | Pid::PNT_MAIN_DATA | Pid::PNT_MONITOR => {
                let words = self.report(at, pid).into_iter().take(4).rev();
                words.fold(0, |value, word| value << 16 | i64::from(word))
            }
            Pid::POSI_DATA => self.servo.position().into(),
            Pid::SPEED_LIMIT => {
                self.bank.get(Pid::HIGH_SPEED_LIMIT) << 16 | self.bank.get(Pid::LOW_SPEED_LIMIT)
            }
            Pid::TAR_POSI => self.servo.target().into(),
            _ => self.bank.get(pid),
        }
    }

    /// The words of `MONITOR`, `PNT_MAIN_DATA` or `PNT_MONITOR`, filled up with 0.
    pub(in crate::mdrobot) fn report(&self, at: Instant, pid: Pid) -> [u16; MOST_WORDS] {
        let (rpm, current) = (self.rpm(at).cast_unsigned(), self.current().cast_unsigned());
        let position = self.servo.position().cast_unsigned();
        let [low, high] = [(position & 0xFFFF) as u16, (position >> 16) as u16];
        let status = self.alarms.status();
        match pid {
            Pid::MONITOR => {
                let output = self.servo.output(at).cast_unsigned();
                [rpm, current, output, low, high, status, 0, 0, 0]
            }
            Pid::PNT_MAIN_DATA => [rpm, current, low, high, 0, 0, 0, 0, status & 0xFF],
            Pid::PNT_MONITOR => [rpm, low, high, 0, 0, 0, status & 0xFF, 0, 0],
            _ => [0; MOST_WORDS],
        }
    }

    /// The value of `RPM_DATA`.
    fn rpm(&self, at: Instant) -> i16 {
        self.servo.rpm(at).clamp(-MOST_RPM, MOST_RPM) as i16
    }

    /// The value of `TQ_DATA`, in 0.1 A.
    fn current(&self) -> i16 {
        let (ma, unit) = (i64::from(self.servo.current()), i64::from(MA_PER_UNIT));
        let rounded = (ma + ma.signum() * unit / 2) / unit;
        rounded.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    }

    fn in_position(&self) -> bool {
        let window = self.bank.word(Pid::IN_POSITION);
        !self.reference.reverses()
            && self.servo.error().is_some_and(|error| error.unsigned_abs() <= u64::from(window))
    }

    /// Copies a live PID to the bank, because it is read.
    fn refresh(&mut self, at: Instant, pid: Pid) {
        if matches!(pid, Pid::MONITOR | Pid::PNT_MAIN_DATA | Pid::PNT_MONITOR) {
            let (entries, row) = (Pid::ENTRIES, pid.row());
            let count = entries.list.get(row).map_or(0, |entry| entry.shape.words());
            let words = self.report(at, pid).into_iter().take(count.into());
            let places = self.bank.words_mut().iter_mut().skip(entries.offset(row));
            for (place, word) in places.zip(words) {
                *place = word;
            }
        } else {
            let value = self.value(at, pid);
            self.bank.set(pid, value);
        }
    }

    /// Applies a written PID. The cases are in the order of the PIDs.
    fn written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) {
        let value = self.bank.get(pid);
        let mut why = None;
        match pid {
            Pid::DEFAULT_SET if self.bank.word(pid) == DEFAULT_CHECK => {
                saved::restore(&mut self.bank);
                self.set_servo(at, out);
                self.refer(at, Event::Setting, out);
                self.update_alarm_pin(at, out);
                saved::save(&self.bank, at, out);
            }
            Pid::DEFAULT_SET => why = Some(Why::NoDefaultKey),
            Pid::COMMAND => self.command(at, self.bank.word(pid), out),
            Pid::ALARM_RESET => why = self.reset_alarms(at, out),
            Pid::POSI_RESET => self.servo.clear_position(),
            Pid::INV_ALARM => self.update_alarm_pin(at, out),
            Pid::TQ_OFF
            | Pid::BRAKE
            | Pid::START_STOP
            | Pid::VEL_CMD
            | Pid::OPEN_VEL_CMD
            | Pid::TQ_CMD
            | Pid::COM_TAR_SPEED
            | Pid::FUNC_CMD
            | Pid::POSI_VEL_CMD
            | Pid::INC_POSI_VEL_CMD
            | Pid::POSI_CMD
            | Pid::INC_POSI_CMD => why = self.refer(at, Event::Command(pid), out),
            Pid::UI_COM
            | Pid::INV_SIGN_CMD
            | Pid::USE_LIMIT_SW
            | Pid::INPUT_TYPE
            | Pid::START_INV_SIGN
            | Pid::RUN_INV_SIGN
            | Pid::LIMIT_STOP_COND
            | Pid::TQ_CTRL
            | Pid::TAR_VEL
            | Pid::LOW_SPEED_LIMIT
            | Pid::HIGH_SPEED_LIMIT
            | Pid::INT_VOLUME => {
                self.refer(at, Event::Setting, out);
            }
            Pid::ID => why = Some(self.set_with_key(at, Pid::CONTROLLER_ID, value, out)),
            Pid::BAUDRATE => why = Some(self.set_with_key(at, Pid::CONTROLLER_BAUD, value, out)),
            Pid::HALL_TYPE
            | Pid::STOP_STATUS
            | Pid::SLOW_START
            | Pid::SLOW_DOWN
            | Pid::ENC_PPR
            | Pid::PV_GAIN
            | Pid::P_GAIN
            | Pid::I_GAIN => self.set_servo(at, out),
            Pid::MAX_LOAD_181 => self.set(at, Pid::MAX_LOAD, value, out),
            Pid::FUNC_CMD_TYPE => {
                self.bank.set(pid, stored_value(pid, value));
                self.refer(at, Event::Setting, out);
            }
            Pid::MAX_LOAD | Pid::MAX_RPM => {
                self.set_servo(at, out);
                self.refer(at, Event::Setting, out);
                why = (self.bank.clamped_value(pid) != value).then_some(Why::Limit);
            }
            Pid::SPEED_LIMIT => {
                self.bank.set(Pid::HIGH_SPEED_LIMIT, value >> 16);
                self.set(at, Pid::LOW_SPEED_LIMIT, value & 0xFFFF, out);
            }
            Pid::TAR_POSI_VEL => why = (value > i64::from(i16::MAX)).then_some(Why::Unsigned),
            // The other PIDs apply from the next power-on, are read when they are used, or have no effect.
            _ => {}
        }
        if let Some(why) = why {
            why.put(at, out);
        }
        if Pid::ENTRIES.list.get(pid.row()).is_some_and(|row| row.saved != 0) {
            saved::save(&self.bank, at, out);
        }
    }

    /// Executes a code written to COMMAND.
    fn command(&mut self, at: Instant, code: u16, out: &mut dyn Context) {
        match command::act(code) {
            None => Why::NoSuchCode.put(at, out),
            Some(Act::As(pid)) => self.written(at, pid, out),
            Some(Act::Set(pid, value)) => self.set(at, pid, value, out),
            Some(Act::Erase(pids)) => {
                // All PIDs are set before the first save. So a loss of power in that save leaves all PIDs as
                // they were, instead of erasing only the first.
                for &pid in pids {
                    self.bank.set(pid, Pid::ENTRIES.list.get(pid.row()).map_or(0, |row| row.reset));
                }
                for &pid in pids {
                    self.written(at, pid, out);
                }
            }
            Some(Act::Switch(pin, level)) => out.put(at, Output::Level { pin, level }),
            Some(Act::Nothing) => Why::NotModelled.put(at, out),
        }
    }

    /// Writes the DH byte of a value written to ID or BAUDRATE, if its key is right. Returns the reason why it
    /// does not count now.
    fn set_with_key(&mut self, at: Instant, pid: Pid, value: i64, out: &mut dyn Context) -> Why {
        let Some(value) = unlocked(value) else { return Why::NoKey };
        self.set(at, pid, value, out);
        Why::NextPowerOn
    }

    /// Writes `value` to a PID as a consequence of another action.
    fn set(&mut self, at: Instant, pid: Pid, value: i64, out: &mut dyn Context) {
        self.bank.set(pid, value);
        self.written(at, pid, out);
    }

    pub(in crate::mdrobot) fn poke(
        &mut self,
        at: Instant,
        pid: Pid,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let row = Pid::ENTRIES.list.get(pid.row()).ok_or(PresetError::NoSuchRegister)?;
        if !row.accepts(value) || validate(pid, value).is_err() {
            return Err(PresetError::OutOfRange);
        }
        if self.startup.is_off() {
            if row.saved == 0 {
                return Err(PresetError::ReadOnly);
            }
            saved::preset(&mut self.bank, pid, value, at, out);
            return Ok(());
        }
        if pid == Pid::VOLT_IN {
            self.alarms.set_supply(value as u16);
            self.supply_changed(at, out);
            self.settle(at, out);
            return Ok(());
        }
        match pid {
            Pid::VERSION => self.bank.set(pid, value),
            _ if !row.access.writes() => return Err(PresetError::ReadOnly),
            _ => self.set(at, pid, value, out),
        }
        Ok(())
    }
}

/// Access to the drive's PIDs during a request from the bus.
pub(in crate::mdrobot) struct Bus<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
}

impl<'a> Bus<'a> {
    pub(in crate::mdrobot) fn new(drive: &'a mut Drive, at: Instant, out: &'a mut dyn Context) -> Self {
        Self { drive, at, out }
    }
}

impl RequestHandler for Bus<'_> {
    type Register = Pid;

    fn words(&self) -> &[u16] {
        self.drive.bank.words()
    }

    fn words_mut(&mut self) -> &mut [u16] {
        self.drive.bank.words_mut()
    }

    fn refresh(&mut self, pid: Pid) {
        self.drive.refresh(self.at, pid);
    }

    fn written(&mut self, pid: Pid) {
        self.drive.written(self.at, pid, self.out);
    }

    fn validate(&self, pid: Pid, value: i64) -> Result<(), Exception> {
        validate(pid, value)
    }
}
