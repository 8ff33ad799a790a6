//! An MD controller without its serial port: its PIDs, and the effect of a write.
//!
//! | file | part of the drive |
//! |---|---|
//! | `registers` | the table of PIDs |
//! | `command` | the codes of COMMAND |
//! | `startup` | the start-up |
//! | `saved` | PIDs in the non-volatile memory |
//! | `inputs` | the connectors: contacts, speed input |
//! | `reference` | the source of commands, and the order to the motor; functions |
//! | `alarm` | alarms, their causes and outputs |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `servo` | control of the motor according to the order |

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::registers::{Bank, Register};

use super::alarm::Alarms;
use super::inputs::Inputs;
use super::reasons::Why;
use super::reference::Reference;
use super::registers::{self, Pid, SUPPLY, function};
use super::servo::{Servo, Settings};
use crate::device::{Boot, Context, Instant, Line, PresetError};
use crate::motor::Parameters;

/// Limit of `RPM_DATA` in both directions (p. 12; MDROBOT-18).
const MOST_RPM: i32 = 5_000;
/// Unit of MAX_LOAD and TQ_DATA, in mA.
const MA_PER_UNIT: u32 = 100;
/// Words of the longest PID.
pub(super) const MOST_WORDS: usize = 9;
/// Unit of VOLT_IN, in mV.
const MV_PER_UNIT: u32 = 100;

/// The built-in motor: 0.06 V·s, which is 0.06 Nm/A. `HALL_TYPE` selects its poles (MDROBOT-27).
pub(super) const MOTOR: Parameters = Parameters {
    supply_mv: SUPPLY as u32 * MV_PER_UNIT,
    no_load_rpm: 3_820,
    resistance_mohm: 300,
    inertia_gcm2: 5_000,
    hall_sensors: 3,
    ..Parameters::NOMINAL
};

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum State {
    /// No power.
    Off,
    /// During start-up the drive receives no message.
    Booting {
        /// End of the start-up.
        due: Instant,
    },
    /// Normal operation, or an alarm.
    Ready,
}

/// An MD controller without its serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) state: State,
    pub(super) bank: Bank<Pid, { Pid::WORDS }>,
    /// The address on which the drive answers: the one that was saved at power-on (MDROBOT-4).
    pub(super) unit: u8,
    pub(super) alarms: Alarms,
    pub(super) inputs: Inputs,
    pub(super) reference: Reference,
    pub(super) servo: Servo,
    /// Poles of the built-in motor, from `HALL_TYPE` at power-on.
    poles: u16,
    /// True if the motor's parameters have changed since the last [`Drive::new_motor`].
    other_motor: bool,
}

impl Drive {
    // Inlined, so that the value is built in place: a copy takes space on a board's stack.
    #[inline(always)]
    pub(super) fn new() -> Self {
        let bank = Bank::factory();
        Self {
            state: State::Off,
            servo: Servo::new(servo_settings(&bank)),
            poles: hall_poles(&bank),
            bank,
            unit: 1,
            alarms: Alarms::NONE,
            inputs: Inputs::REST,
            reference: Reference::NONE,
            other_motor: false,
        }
    }

    /// Handles power-on. The caller passes the state of all inputs afterwards.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.load(out);
        self.unit = (self.bank.word(Pid::CONTROLLER_ID) & 0xFF) as u8;
        self.alarms = Alarms::NONE;
        self.inputs = Inputs::REST;
        self.reference = Reference::NONE;
        self.boot(at, boot);
        (self.poles, self.other_motor) = (hall_poles(&self.bank), true);
        self.servo.power_on(at, servo_settings(&self.bank), out);
    }

    pub(super) fn deadline(&self) -> Instant {
        self.startup_due().min(self.sources_due()).min(self.servo.deadline())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup_due() <= at {
            self.ready(at, out);
        }
        if self.sources_due() <= at {
            self.sources_timeout(at, out);
        }
        if self.servo.deadline() <= at {
            self.servo.timeout(at, out);
            self.reverse_when_slow(at, out);
        }
        self.check_alarms(at, out);
    }

    /// Handles deadlines that are due. It is called before a character of this instant.
    pub(super) fn wake(&mut self, at: Instant, out: &mut dyn Context) {
        if self.deadline() <= at {
            self.timeout(at, out);
        }
    }

    /// Settings of the serial line after the next power-on.
    pub(super) fn line(&self) -> Line {
        registers::line(self.bank.word(Pid::CONTROLLER_BAUD))
    }

    /// Parameters of [`MOTOR`] at the present supply.
    pub(super) fn motor(&self) -> Parameters {
        let supply = u32::from(self.alarms.supply()).min(Parameters::MOST.supply_mv / MV_PER_UNIT);
        Parameters {
            supply_mv: supply * MV_PER_UNIT,
            no_load_rpm: MOTOR.no_load_rpm * supply / u32::from(SUPPLY),
            hall_pulses: self.poles / 2,
            ..MOTOR
        }
    }

    /// Handles a change of the supply.
    pub(super) fn supply_changed(&mut self, at: Instant, out: &mut dyn Context) {
        self.other_motor = true;
        self.set_servo(at, out);
    }

    /// Parameters as from [`Drive::motor`], if they may have changed since the last call.
    pub(super) fn new_motor(&mut self) -> Option<Parameters> {
        core::mem::take(&mut self.other_motor).then(|| self.motor())
    }

    /// Passes the settings from the registers to the servo.
    fn set_servo(&mut self, at: Instant, out: &mut dyn Context) {
        self.servo.set(at, servo_settings(&self.bank), out);
    }

    /// Present value of a PID. A PID of more than four words gives the value of its first four words.
    pub(super) fn value(&self, at: Instant, pid: Pid) -> i64 {
        match pid {
            Pid::CTRL_STATUS => (self.alarms.status() & 0xFF).into(),
            Pid::DI => self.digital_inputs().into(),
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
    pub(super) fn report(&self, at: Instant, pid: Pid) -> [u16; MOST_WORDS] {
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
        !self.reverses() && self.servo.error().is_some_and(|error| error.unsigned_abs() <= u64::from(window))
    }

    /// Copies a live PID to the bank, because it is read.
    pub(super) fn refresh(&mut self, at: Instant, pid: Pid) {
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

    /// Checks a value that the row accepts already. For ID and BAUDRATE with the key, DH must be legal. For
    /// `FUNC_CMD_TYPE` only DL is checked.
    pub(super) fn validate(pid: Pid, value: i64) -> Result<(), Exception> {
        let legal = match pid {
            Pid::ID => unlocked(value).is_none_or(|id| accepts(Pid::CONTROLLER_ID, id)),
            Pid::BAUDRATE => unlocked(value).is_none_or(|code| accepts(Pid::CONTROLLER_BAUD, code)),
            Pid::FUNC_CMD_TYPE => value & 0xFF <= i64::from(function::SPEED_ADD),
            _ => true,
        };
        if legal { Ok(()) } else { Err(Exception::IllegalDataValue) }
    }

    /// Applies a written PID. The cases are in the order of the PIDs.
    pub(super) fn written(&mut self, at: Instant, pid: Pid, out: &mut dyn Context) {
        let value = self.bank.get(pid);
        let mut why = None;
        match pid {
            Pid::DEFAULT_SET if self.bank.word(pid) == registers::DEFAULT_CHECK => {
                self.restore();
                self.set_servo(at, out);
                self.reference_changed(at, out);
                self.update_alarm_pin(at, out);
                self.save(at, out);
            }
            Pid::DEFAULT_SET => why = Some(Why::NoDefaultKey),
            Pid::COMMAND => self.command(at, self.bank.word(pid), out),
            Pid::ALARM_RESET => why = self.reset_alarms(at, out),
            Pid::POSI_RESET => self.servo.clear_position(),
            Pid::INV_ALARM => self.update_alarm_pin(at, out),
            Pid::TQ_OFF
            | Pid::BRAKE
            | Pid::UI_COM
            | Pid::START_STOP
            | Pid::VEL_CMD
            | Pid::OPEN_VEL_CMD
            | Pid::TQ_CMD
            | Pid::COM_TAR_SPEED
            | Pid::FUNC_CMD
            | Pid::POSI_VEL_CMD
            | Pid::INC_POSI_VEL_CMD
            | Pid::POSI_CMD
            | Pid::INC_POSI_CMD => why = self.command_written(at, pid, out),
            Pid::INV_SIGN_CMD
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
                self.reference_changed(at, out);
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
                self.command_written(at, pid, out);
            }
            Pid::MAX_LOAD | Pid::MAX_RPM => {
                self.set_servo(at, out);
                self.reference_changed(at, out);
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
            self.save(at, out);
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
    pub(super) fn set(&mut self, at: Instant, pid: Pid, value: i64, out: &mut dyn Context) {
        self.bank.set(pid, value);
        self.written(at, pid, out);
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
    }

    pub(super) fn poke(
        &mut self,
        at: Instant,
        pid: Pid,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let row = Pid::ENTRIES.list.get(pid.row()).ok_or(PresetError::NoSuchRegister)?;
        if !row.accepts(value) || Self::validate(pid, value).is_err() {
            return Err(PresetError::OutOfRange);
        }
        if self.state == State::Off {
            return if row.saved == 0 {
                Err(PresetError::ReadOnly)
            } else {
                self.preset(at, pid, value, out)
            };
        }
        if pid == Pid::VOLT_IN {
            self.set_supply(at, value as u16, out);
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

/// Poles of the motor that `HALL_TYPE` selects.
fn hall_poles(bank: &Bank<Pid, { Pid::WORDS }>) -> u16 {
    registers::poles(bank.word(Pid::HALL_TYPE))
}

/// Settings of the servo from the bank (MDROBOT-8).
fn servo_settings(bank: &Bank<Pid, { Pid::WORDS }>) -> Settings {
    let word = |pid| bank.word(pid);
    Settings {
        max_rpm: bank.clamped_value(Pid::MAX_RPM) as u16,
        limit_ma: bank.clamped_value(Pid::MAX_LOAD) as u32 * MA_PER_UNIT,
        pv_gain: word(Pid::PV_GAIN),
        p_gain: word(Pid::P_GAIN),
        i_gain: word(Pid::I_GAIN),
        slow_start: word(Pid::SLOW_START),
        slow_down: word(Pid::SLOW_DOWN),
        stop_status: word(Pid::STOP_STATUS),
        poles: hall_poles(bank),
        enc_ppr: word(Pid::ENC_PPR),
    }
}

/// The DH byte of a value written to ID or BAUDRATE, if the DL byte is the key (MDROBOT-5).
fn unlocked(value: i64) -> Option<i64> {
    (value & 0xFF == registers::WRITE_CHECK).then_some(value >> 8 & 0xFF)
}

/// The value that a PID stores of a written one: `FUNC_CMD_TYPE` stores only DL (p. 15) (MDROBOT-3).
pub(super) fn stored_value(pid: Pid, value: i64) -> i64 {
    if pid == Pid::FUNC_CMD_TYPE { value & 0xFF } else { value }
}

/// Returns true if the row of a PID accepts a value.
fn accepts(pid: Pid, value: i64) -> bool {
    Pid::ENTRIES.list.get(pid.row()).is_some_and(|row| row.accepts(value))
}
