//! An MD400 with a motor on a bench, a master at its port, and methods that set its pins.

use drivetwin_firmware::device::{Axis, Fault, Level, Pin, Port};
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motor::Parameters;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{
    Bench, DriveId, Motion, Motor, MotorModel, PinStimulus, PowerAction, Settings, Setup,
};
use drivetwin_sim::line::LineMode;

use crate::pid;

/// Time from power-on until the drive receives requests (MDROBOT-11).
pub(crate) const BOOT: Duration = Duration::millis(300);

/// Bytes that a master receives if the drive does not reply: none.
pub(crate) const SILENCE: [u8; 0] = [];

/// Broadcast id (p. 3).
pub(crate) const ALL: u8 = 0xFE;

/// Exception code of a refused request.
pub(crate) type Exception = u8;

/// A controller with its motor. By default characters take no time on the line, so a command takes effect at
/// the instant of the call.
pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) seat: DriveId,
    /// Poles of the motor. A turn has three counts per pole (MDROBOT-27).
    pub(crate) poles: f64,
}

impl Default for Rig {
    fn default() -> Self {
        Self::with(&[])
    }
}

/// Methods for time, power, pins and the motor.
impl Rig {
    /// A new controller whose power has just been switched on.
    pub(crate) fn new(line: LineMode, setup: Setup) -> Self {
        let mut bench = Bench::with(Settings { line, ..Settings::default() });
        let seat =
            bench.add_with("x", Box::new(Mdrobot::md400()), setup).expect("a drive that can be seated");
        Self { bench, seat, poles: 4.0 }
    }

    /// A rig after its start-up, with these one-word PIDs written.
    pub(crate) fn with(settings: &[(u16, u16)]) -> Self {
        let mut rig = Self::new(LineMode::Fast, Setup::default());
        rig.after(BOOT + 1.millis());
        rig.set(settings);
        rig
    }

    /// A rig that obeys velocity commands of the bus, with these PIDs written (MDROBOT-13).
    pub(crate) fn armed(settings: &[(u16, u16)]) -> Self {
        let mut rig = Self::with(settings);
        rig.set(&[(pid::UI_COM, 1), (pid::START_STOP, 1)]);
        rig
    }

    /// A rig whose motor is a separate part of the bench: the drive's own motor with changed parameters.
    pub(crate) fn turning(settings: &[(u16, u16)], change: impl FnOnce(&mut Parameters)) -> (Self, Motor) {
        let mut rig = Self::new(LineMode::Fast, Setup { external_motor: true, ..Setup::default() });
        rig.after(BOOT + 1.millis());
        let mut motor = rig.bench.detached_motor(rig.seat).expect("a drive that has parted from its motor");
        change(&mut motor);
        rig.poles = f64::from(2 * motor.hall_pulses);
        let motor = rig
            .bench
            .attach_motor("m", rig.seat, Axis(0), MotorModel::Brush(motor))
            .expect("a motor that fits");
        rig.set(settings);
        rig.set(&[(pid::UI_COM, 1), (pid::START_STOP, 1)]);
        (rig, motor)
    }

    /// A rig that is set to a motor with other poles, by HALL_TYPE at power-on (p. 8).
    pub(crate) fn with_poles(hall_type: u16, poles: f64, settings: &[(u16, u16)]) -> Self {
        let mut rig = Self::with(&[(pid::HALL_TYPE, hall_type)]);
        rig.power_cycle();
        rig.poles = poles;
        rig.set(settings);
        rig.set(&[(pid::UI_COM, 1), (pid::START_STOP, 1)]);
        rig
    }

    pub(crate) fn now(&self) -> Instant {
        self.bench.now()
    }

    /// Advances the time.
    pub(crate) fn after(&mut self, span: Duration) {
        self.bench.run_until(self.now() + span);
    }

    /// Advances the time and calls `look` after each `step`.
    pub(crate) fn watch(
        &mut self,
        span: Duration,
        step: Duration,
        mut look: impl FnMut(&mut Self, Duration),
    ) {
        let start = self.now();
        for n in 1..=span / step {
            self.bench.run_until(start + step * n);
            look(self, step * n);
        }
    }

    /// Switches power off for a second and on again. Returns when the drive has started.
    pub(crate) fn power_cycle(&mut self) {
        self.bench.power(self.seat, PowerAction::Off);
        self.after(1.secs());
        self.bench.power(self.seat, PowerAction::On);
        self.after(BOOT + 1.millis());
    }

    /// The pin with this name in the manual.
    pub(crate) fn pin(&self, name: &str) -> Pin {
        self.bench.spec(self.seat).pin(name).unwrap_or_else(|| panic!("there is no {name}"))
    }

    /// Sets a pin from outside. Returns when the drive has received the change.
    pub(crate) fn drive(&mut self, name: &str, drive: PinStimulus) {
        self.bench.set_pin(self.seat, self.pin(name), drive);
        self.after(Duration::TICK);
    }

    /// Closes a contact to ground: ON (MDROBOT-21).
    pub(crate) fn close(&mut self, name: &str) {
        self.drive(name, PinStimulus::Low);
    }

    /// Opens a contact that is wired.
    pub(crate) fn open(&mut self, name: &str) {
        self.drive(name, PinStimulus::High);
    }

    /// Applies a voltage to an analogue input.
    pub(crate) fn volts(&mut self, name: &str, volts: f64) {
        self.drive(name, PinStimulus::Millivolts((volts * 1_000.0).round() as i32));
    }

    /// Level of a pin as an outside observer sees it.
    pub(crate) fn level(&self, name: &str) -> Level {
        self.bench.level(self.seat, self.pin(name))
    }

    /// Adds or removes the cause of a fault. Returns when the drive has noticed.
    pub(crate) fn fault(&mut self, name: &str, on: bool) {
        let place = self.bench.spec(self.seat).faults.iter().position(|fault| *fault == name);
        let place = place.unwrap_or_else(|| panic!("there is no fault {name}"));
        self.bench.fault(self.seat, Fault(place as u8), on);
        self.after(2.millis());
    }

    /// Sets the internal volume (MDROBOT-24): 0 to 1,023.
    pub(crate) fn volume(&mut self, value: i64) {
        let row = self.bench.spec(self.seat).find("INT_VOLUME").expect("a setting").row;
        assert_eq!(self.bench.poke(self.seat, row, value), Ok(()));
    }

    pub(crate) fn motion(&self) -> Motion {
        self.bench.motion(self.seat, Axis(0))
    }

    /// True speed of the shaft in rpm, as opposed to the drive's reading.
    pub(crate) fn shaft(&self) -> f64 {
        self.motion().speed.to_num::<f64>() / (3.0 * self.poles) * 60.0
    }

    /// Current of the motor now, in A.
    pub(crate) fn amperes(&self) -> f64 {
        f64::from(self.motion().current_ma) / 1_000.0
    }
}

/// Methods for the bus.
impl Rig {
    /// The PDU with which controller 1 answers a request. Empty if there is no reply.
    pub(crate) fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.bench.ask(self.seat, &rtu::frame(1, pdu));
        if reply.is_empty() {
            return reply;
        }
        let body = rtu::verify_crc(&reply).expect("a reply has a CRC that holds");
        assert_eq!(body[0], 1, "the id of a reply");
        body[1..].to_vec()
    }

    /// Sends a request that must be answered or refused.
    #[track_caller]
    fn try_ask(&mut self, pdu: &[u8]) -> Result<Vec<u8>, Exception> {
        let reply = self.ask(pdu);
        if reply.first() == Some(&(pdu[0] | 0x80)) {
            assert_eq!(reply.len(), 2, "a refusal is two bytes: {reply:02X?}");
            return Err(reply[1]);
        }
        assert_eq!(reply.first(), Some(&pdu[0]), "to {pdu:02X?} came {reply:02X?}");
        Ok(reply)
    }

    /// Reads that many words of a PID (p. 3, p. 4).
    #[track_caller]
    pub(crate) fn try_words(&mut self, pid: u16, words: u16) -> Result<Vec<u16>, Exception> {
        let reply = self.try_ask(&request(3, pid, words))?;
        assert_eq!(usize::from(reply[1]), 2 * usize::from(words), "its byte count");
        assert_eq!(reply.len(), 2 + usize::from(reply[1]));
        Ok(reply[2..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect())
    }

    #[track_caller]
    pub(crate) fn words(&mut self, pid: u16, words: u16) -> Vec<u16> {
        self.try_words(pid, words).unwrap_or_else(|code| panic!("PID {pid}: exception {code:02X}"))
    }

    #[track_caller]
    pub(crate) fn read(&mut self, pid: u16) -> u16 {
        self.words(pid, 1)[0]
    }

    /// Reads a signed word.
    #[track_caller]
    pub(crate) fn signed(&mut self, pid: u16) -> i16 {
        self.read(pid).cast_signed()
    }

    /// Reads two words, the low one first (p. 4).
    #[track_caller]
    pub(crate) fn long(&mut self, pid: u16) -> i32 {
        let pair = self.words(pid, 2);
        (u32::from(pair[1]) << 16 | u32::from(pair[0])).cast_signed()
    }

    /// Reads RPM_DATA.
    #[track_caller]
    pub(crate) fn rpm(&mut self) -> f64 {
        f64::from(self.signed(pid::RPM_DATA))
    }

    /// Reads POSI_DATA.
    #[track_caller]
    pub(crate) fn position(&mut self) -> i32 {
        self.long(pid::POSI_DATA)
    }

    /// Reads CTRL_STATUS, and status2, which only MONITOR (196) has.
    #[track_caller]
    pub(crate) fn status(&mut self) -> (u16, u16) {
        let word = self.words(pid::MONITOR, 6)[5];
        let status = self.read(pid::CTRL_STATUS);
        assert_eq!(word & 0xFF, status, "MONITOR and CTRL_STATUS");
        (status, word >> 8)
    }

    /// Writes a word with function 6 (p. 4).
    #[track_caller]
    pub(crate) fn try_write(&mut self, pid: u16, value: u16) -> Result<(), Exception> {
        let pdu = request(6, pid, value);
        assert_eq!(self.try_ask(&pdu)?, pdu, "the echo of a write");
        Ok(())
    }

    #[track_caller]
    pub(crate) fn write(&mut self, pid: u16, value: u16) {
        assert_eq!(self.try_write(pid, value), Ok(()), "{value} to PID {pid}");
    }

    #[track_caller]
    pub(crate) fn write_signed(&mut self, pid: u16, value: i16) {
        self.write(pid, value.cast_unsigned());
    }

    /// Writes several PIDs, one after the other.
    #[track_caller]
    pub(crate) fn set(&mut self, settings: &[(u16, u16)]) {
        for &(pid, value) in settings {
            self.write(pid, value);
        }
    }

    /// Writes words with function 16 (p. 5).
    #[track_caller]
    pub(crate) fn try_write_words(&mut self, pid: u16, words: &[u16]) -> Result<(), Exception> {
        let head = request(16, pid, words.len() as u16);
        let mut pdu = head.to_vec();
        pdu.push(2 * words.len() as u8);
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        assert_eq!(self.try_ask(&pdu)?, head, "the reply to function 16");
        Ok(())
    }

    #[track_caller]
    pub(crate) fn write_words(&mut self, pid: u16, words: &[u16]) {
        assert_eq!(self.try_write_words(pid, words), Ok(()), "{words:?} to PID {pid}");
    }

    /// Writes two words, the low one first (p. 5).
    #[track_caller]
    pub(crate) fn write_long(&mut self, pid: u16, value: i32) {
        self.write_words(pid, &halves(value));
    }

    /// Writes a position and a speed to PID 219 or 220.
    #[track_caller]
    pub(crate) fn write_move(&mut self, pid: u16, position: i32, rpm: u16) {
        let [low, high] = halves(position);
        self.write_words(pid, &[low, high, rpm]);
    }

    /// Writes VEL_CMD.
    #[track_caller]
    pub(crate) fn velocity(&mut self, rpm: i16) {
        self.write_signed(pid::VEL_CMD, rpm);
    }

    #[track_caller]
    pub(crate) fn command(&mut self, code: u16) {
        self.write(pid::COMMAND, code);
    }
}

/// Assertions that tests share.
impl Rig {
    /// Asserts that 2 s later the motor turns at this speed, both by RPM_DATA and in truth.
    #[track_caller]
    pub(crate) fn assert_turns(&mut self, rpm: f64) {
        self.after(2.secs());
        let (shown, shaft) = (self.rpm(), self.shaft());
        let within = (rpm.abs() * 0.01).max(2.0);
        assert!((shown - rpm).abs() <= within, "RPM_DATA is {shown}, not {rpm}");
        // The shaft has ripple that the Hall sensors do not show. Counts show the mean speed.
        assert!((shaft - rpm).abs() <= (rpm.abs() * 0.03).max(6.0), "the shaft is at {shaft:.1}, not {rpm}");
    }

    /// Asserts that the motor is at rest 2 s later, and stays there for 0.5 s.
    #[track_caller]
    pub(crate) fn assert_stands(&mut self) {
        self.after(2.secs());
        let before = self.position();
        self.after(500.millis());
        assert_eq!((self.rpm(), self.position()), (0.0, before), "RPM_DATA, POSI_DATA");
    }
}

/// Low and high word.
pub(crate) fn halves(value: i32) -> [u16; 2] {
    let value = value.cast_unsigned();
    [value as u16, (value >> 16) as u16]
}

/// A request: a function, a PID and a word.
pub(crate) fn request(function: u8, pid: u16, word: u16) -> [u8; 5] {
    let ([a, b], [c, d]) = (pid.to_be_bytes(), word.to_be_bytes());
    [function, a, b, c, d]
}

/// A controller after its start-up, on a line on which characters take time.
pub(crate) fn timed() -> Rig {
    let mut rig = Rig::new(LineMode::Timed, Setup::default());
    rig.after(BOOT + 1.millis());
    rig
}

/// Current settings of the controller's serial line.
pub(crate) fn line(rig: &Rig) -> drivetwin_firmware::device::Line {
    rig.bench.line(rig.bench.bus(rig.seat, Port(0)).expect("a line"))
}
