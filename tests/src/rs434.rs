//! Access to an RS 434544 or 434546 for tests: its registers as in the manual, requests over the bus, and
//! stimuli for every pin.

use drivetwin_firmware::device::{Axis, Device, Fault, Level, Pin};
use drivetwin_firmware::rs434::Rs434;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, DriveId, Motion, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::line::LineMode;

/// Both models, as users type them.
pub const KINDS: [&str; 2] = ["rs434544", "rs434546"];

/// Time from power-on, or a restart, until the drive receives requests (RS434-9).
pub const BOOT: Duration = Duration::millis(500);

/// Duration longer than any save (10 ms, RS434-11).
pub const SAVE: Duration = Duration::millis(20);

/// Time that an instruction takes (RS434-25).
pub const LINE: Duration = Duration::micros(100);

/// Register addresses as chapter 6 prints them, each with its section. A 32-bit register has the address of
/// its low word.
pub mod at {
    /// Section 6.1
    pub const IN1: u16 = 0x1000;
    /// Section 6.1
    pub const IN2: u16 = 0x1001;
    /// Section 6.1
    pub const IN_HARD_STOP: u16 = 0x1002;
    /// Section 6.2
    pub const START: u16 = 0x2000;
    /// Section 6.2
    pub const STOP: u16 = 0x2001;
    /// Section 6.2
    pub const HARD_STOP: u16 = 0x2002;
    /// Section 6.2
    pub const CLR_POSITION: u16 = 0x2003;
    /// Section 6.3
    pub const STATUS: u16 = 0x3000;
    /// Section 6.3
    pub const CURRENT_VALID: u16 = 0x3001;
    /// Section 6.3
    pub const SPEED_VALID: u16 = 0x3002;
    /// Section 6.3, a pair
    pub const CURRENT_POSITION: u16 = 0x3003;
    /// Section 6.3
    pub const TEMPERATURE_MCU: u16 = 0x3005;
    /// Section 6.3
    pub const TEMPERATURE_MOSFET: u16 = 0x3006;
    /// Section 6.3
    pub const TEMPERATURE_BRAKE: u16 = 0x3007;
    /// Section 6.3
    pub const TASK_COUNTER: u16 = 0x3008;
    /// Section 6.3
    pub const STATUS_USER_PROGRAM: u16 = 0x3009;
    /// Section 6.4
    pub const SLAVE_ADDRESS: u16 = 0x5000;
    /// Section 6.4
    pub const TYPE: u16 = 0x5001;
    /// Section 6.4
    pub const BITRATE: u16 = 0x5002;
    /// Section 6.4
    pub const TIMEOUT: u16 = 0x5003;
    /// Section 6.5
    pub const MODE_DEVICE: u16 = 0x5004;
    /// Section 6.5
    pub const MODE_USER_PROGRAM: u16 = 0x5005;
    /// Section 6.5
    pub const MODE_ROTATION: u16 = 0x5006;
    /// Section 6.5
    pub const MODE_EXT_IN: u16 = 0x5007;
    /// Section 6.5
    pub const POSITION_N: u16 = 0x5008;
    /// Section 6.5
    pub const REF_CURRENT: u16 = 0x5009;
    /// Section 6.5
    pub const RATED_SPEED: u16 = 0x500A;
    /// Section 6.5
    pub const SPEED: u16 = 0x500B;
    /// Section 6.5
    pub const ACC: u16 = 0x500C;
    /// Section 6.5
    pub const DEC: u16 = 0x500D;
    /// Section 6.5
    pub const DIRECTION: u16 = 0x500E;
    /// Section 6.5
    pub const PULSES: u16 = 0x500F;
    /// Section 6.5
    pub const USE_HALL: u16 = 0x5010;
    /// Section 6.5
    pub const MODE_COIL: u16 = 0x5011;
    /// Section 6.5
    pub const OFFSET_COMPENSATION: u16 = 0x5012;
    /// Section 6.1
    pub const PRESSED: u16 = 0x5013;
    /// Section 6.1
    pub const WAITED: u16 = 0x5014;
    /// Section 6.5, a pair
    pub const OFFSET: u16 = 0x5015;
    /// Section 6.5, a pair
    pub const OFFSET_CONST: u16 = 0x5017;
    /// Section 6.5, a pair
    pub const TARGET_POSITION: u16 = 0x5019;
    /// Section 6.5: the first of four target positions, each a pair
    pub const TARGET_POSITION1: u16 = 0x501B;
    /// Section 6.5, a pair
    pub const TARGET_POSITION4: u16 = 0x5021;
    /// Section 6.5
    pub const ERROR: u16 = 0x5023;
    /// Section 6.5
    pub const SAVE_INI: u16 = 0x5024;
    /// Section 6.6
    pub const SAVE_PROGRAM: u16 = 0x5025;
    /// Section 6.5
    pub const RESTART: u16 = 0x5026;
    /// Section 6.6
    pub const WRITE_CMD: u16 = 0x6000;
    /// Section 6.6, a pair
    pub const CMD_W: u16 = 0x6001;
    /// Section 6.6
    pub const READ_CMD: u16 = 0x6003;
    /// Section 6.6, a pair
    pub const CMD_R: u16 = 0x6004;
    /// Section 6.7: AX to FX, up to 7005h
    pub const AX: u16 = 0x7000;
    /// Section 6.7
    pub const PC: u16 = 0x7006;
    /// Section 6.7: GX to JX, up to 700Ah
    pub const GX: u16 = 0x7007;
    /// Section 6.8: the first of the four registers 8001h to 8004h
    pub const HW_MAJOR: u16 = 0x8001;
}

/// Values for the key registers (6.5, 6.6).
pub mod key {
    /// Saves the settings.
    pub const SAVE: u16 = 0x37FA;
    /// Saves the buffer to flash.
    pub const SAVE_PROGRAM: u16 = 0x8426;
    /// Loads the flash into the buffer.
    pub const LOAD_PROGRAM: u16 = 0x9346;
    /// Restarts the drive.
    pub const RESTART: u16 = 0x95AF;
}

/// Address of system register 0 to 9: AX to FX, then GX to JX, which follow PC (6.7).
#[must_use]
pub const fn system_register(number: u16) -> u16 {
    if number < 6 { at::AX + number } else { at::GX + number - 6 }
}

/// The reply if the drive does not answer.
pub const SILENCE: [u8; 0] = [];

/// The exception code of a refusal.
pub type Exception = u8;

/// A drive of a kind with its motor, without power.
///
/// # Panics
/// If there is no such kind.
#[must_use]
pub fn make(kind: &str) -> Box<dyn Device> {
    match kind {
        "rs434544" => Box::new(Rs434::rs434544()),
        "rs434546" => Box::new(Rs434::rs434546()),
        _ => panic!("there is no {kind}"),
    }
}

/// A drive with its motor on a bench. Characters take no time unless a test sets a line mode, so that a
/// command takes effect at the instant at which it is sent.
pub struct Rig {
    /// The bench.
    pub bench: Bench,
    /// The only drive on the bench.
    pub seat: DriveId,
}

impl Default for Rig {
    fn default() -> Self {
        Self::ready("rs434544")
    }
}

/// Time, power and pins.
impl Rig {
    /// A drive that has just been powered on.
    ///
    /// # Panics
    /// If the bench does not accept it.
    #[must_use]
    pub fn new(kind: &str, line: LineMode, setup: Setup) -> Self {
        let mut bench = Bench::with(Settings { line, ..Settings::default() });
        let seat = bench.add_with("x", make(kind), setup).expect("a drive that can be seated");
        Self { bench, seat }
    }

    /// A new drive that is ready.
    #[must_use]
    pub fn ready(kind: &str) -> Self {
        let mut rig = Self::new(kind, LineMode::Fast, Setup::default());
        rig.after(BOOT);
        rig
    }

    /// The time on the bench.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.bench.now()
    }

    /// Advances the time.
    pub fn after(&mut self, span: Duration) {
        self.bench.run_until(self.now() + span);
    }

    /// Switches power off, and on again after a second; returns when the drive is ready.
    pub fn power_cycle(&mut self) {
        self.bench.power(self.seat, PowerAction::Off);
        self.after(1.secs());
        self.bench.power(self.seat, PowerAction::On);
        self.after(BOOT + 1.millis());
    }

    /// Finds a pin by its name in the manual.
    ///
    /// # Panics
    /// If there is no such pin.
    #[must_use]
    pub fn pin(&self, name: &str) -> Pin {
        self.bench.spec(self.seat).pin(name).unwrap_or_else(|| panic!("there is no {name}"))
    }

    /// Applies a stimulus to a pin; returns when the drive has received it.
    pub fn drive(&mut self, name: &str, drive: PinStimulus) {
        self.bench.set_pin(self.seat, self.pin(name), drive);
        self.after(Duration::TICK);
    }

    /// Closes a contact to ground.
    pub fn close(&mut self, name: &str) {
        self.drive(name, PinStimulus::Low);
    }

    /// Opens a contact; the pull-up makes the pin high.
    pub fn open(&mut self, name: &str) {
        self.drive(name, PinStimulus::High);
    }

    /// Level of a pin as seen from outside.
    #[must_use]
    pub fn level(&self, name: &str) -> Level {
        self.bench.level(self.seat, self.pin(name))
    }

    /// Sets or removes the cause of a fault; returns when the drive has noticed.
    ///
    /// # Panics
    /// If the drive has no such fault.
    pub fn fault(&mut self, name: &str, on: bool) {
        let faults = self.bench.spec(self.seat).faults;
        let place = faults.iter().position(|fault| *fault == name);
        let place = place.unwrap_or_else(|| panic!("there is no fault {name}"));
        self.bench.fault(self.seat, Fault(place as u8), on);
        self.after(2.millis());
    }

    /// Sets the supply voltage that the drive measures, in 0.1 V.
    ///
    /// # Panics
    /// If the drive refuses the value.
    pub fn supply(&mut self, tenths: i64) {
        let row = self.bench.spec(self.seat).find("SUPPLY").expect("a setting").row;
        self.bench.poke(self.seat, row, tenths).expect("a supply");
    }

    /// Present motion of the motor.
    #[must_use]
    pub fn motion(&self) -> Motion {
        self.bench.motion(self.seat, Axis(0))
    }
}

/// Requests over the bus.
impl Rig {
    /// Reply of the drive at address 1 to a request: its PDU, or nothing.
    ///
    /// # Panics
    /// If the reply is not a frame from address 1.
    pub fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.bench.ask(self.seat, &rtu::frame(1, pdu));
        if reply.is_empty() {
            return reply;
        }
        let body = rtu::verify_crc(&reply).expect("a reply has a CRC that holds");
        assert_eq!(body[0], 1, "the address of a reply");
        body[1..].to_vec()
    }

    /// Sends a request; returns the reply, or the exception of a refusal.
    fn try_ask(&mut self, pdu: &[u8]) -> Result<Vec<u8>, Exception> {
        let reply = self.ask(pdu);
        if reply.first() == Some(&(pdu[0] | 0x80)) {
            assert_eq!(reply.len(), 2, "a refusal is two bytes: {reply:02X?}");
            return Err(reply[1]);
        }
        assert_eq!(reply.first(), Some(&pdu[0]), "to {pdu:02X?} came {reply:02X?}");
        Ok(reply)
    }

    /// Reads with function 01 or 02.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    pub fn try_bits(&mut self, function: u8, first: u16, count: u16) -> Result<Vec<bool>, Exception> {
        let reply = self.try_ask(&request(function, first, count))?;
        assert_eq!(usize::from(reply[1]), usize::from(count).div_ceil(8), "its byte count");
        assert_eq!(reply.len(), 2 + usize::from(reply[1]));
        Ok((0..usize::from(count)).map(|n| reply[2 + n / 8] >> (n % 8) & 1 == 1).collect())
    }

    /// Reads with function 03 or 04.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    pub fn try_words(&mut self, function: u8, first: u16, count: u16) -> Result<Vec<u16>, Exception> {
        let reply = self.try_ask(&request(function, first, count))?;
        assert_eq!(usize::from(reply[1]), 2 * usize::from(count), "its byte count");
        assert_eq!(reply.len(), 2 + usize::from(reply[1]));
        Ok(reply[2..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect())
    }

    /// Reads one register with the function of its address space.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    pub fn try_read(&mut self, address: u16) -> Result<u16, Exception> {
        match address >> 12 {
            1 => self.try_bits(2, address, 1).map(|bits| u16::from(bits[0])),
            2 => self.try_bits(1, address, 1).map(|bits| u16::from(bits[0])),
            3 | 8 => self.try_words(4, address, 1).map(|words| words[0]),
            _ => self.try_words(3, address, 1).map(|words| words[0]),
        }
    }

    /// Reads one register.
    ///
    /// # Panics
    /// If the drive refuses the read.
    #[track_caller]
    pub fn read(&mut self, address: u16) -> u16 {
        self.try_read(address).unwrap_or_else(|code| panic!("{address:04X}h: exception {code:02X}"))
    }

    /// Reads a pair of registers at once, the low word at the low address.
    ///
    /// # Panics
    /// If the drive refuses the read.
    #[track_caller]
    pub fn read_long(&mut self, address: u16) -> i32 {
        let function = if address >> 12 == 3 { 4 } else { 3 };
        let pair = self.try_words(function, address, 2).expect("a pair");
        (u32::from(pair[1]) << 16 | u32::from(pair[0])).cast_signed()
    }

    /// Writes a coil with function 05 or a register with function 06.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    ///
    /// # Panics
    /// If the reply to an accepted write is not a copy of the request.
    pub fn try_write(&mut self, address: u16, value: u16) -> Result<(), Exception> {
        let pdu = match address >> 12 {
            2 => request(5, address, if value == 0 { 0 } else { 0xFF00 }),
            _ => request(6, address, value),
        };
        let reply = self.try_ask(&pdu)?;
        assert_eq!(reply, pdu, "the echo of a write");
        Ok(())
    }

    /// Writes a coil or a register.
    ///
    /// # Panics
    /// If the drive refuses the write.
    #[track_caller]
    pub fn write(&mut self, address: u16, value: u16) {
        let written = self.try_write(address, value);
        assert_eq!(written, Ok(()), "{value:04X}h to {address:04X}h");
    }

    /// Writes registers with function 16.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    ///
    /// # Panics
    /// If the reply to an accepted write does not name the first register and their number.
    pub fn try_write_all(&mut self, first: u16, values: &[u16]) -> Result<(), Exception> {
        let head = request(16, first, values.len() as u16);
        let mut pdu = head.to_vec();
        pdu.push(2 * values.len() as u8);
        pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        let reply = self.try_ask(&pdu)?;
        assert_eq!(reply, head, "the reply to function 16");
        Ok(())
    }

    /// Writes coils with function 15.
    ///
    /// # Errors
    /// The exception code if the drive refuses.
    ///
    /// # Panics
    /// If the reply to an accepted write does not name the first coil and their number.
    pub fn try_write_coils(&mut self, first: u16, values: &[bool]) -> Result<(), Exception> {
        let head = request(15, first, values.len() as u16);
        let mut pdu = head.to_vec();
        pdu.push(values.len().div_ceil(8) as u8);
        for eight in values.chunks(8) {
            pdu.push((0..).zip(eight).fold(0, |byte, (n, &bit)| byte | u8::from(bit) << n));
        }
        let reply = self.try_ask(&pdu)?;
        assert_eq!(reply, head, "the reply to function 15");
        Ok(())
    }

    /// Writes a pair of registers at once, the low word at the low address.
    ///
    /// # Panics
    /// If the drive refuses the write.
    #[track_caller]
    pub fn write_long(&mut self, address: u16, value: i32) {
        let value = value.cast_unsigned();
        let written = self.try_write_all(address, &[value as u16, (value >> 16) as u16]);
        assert_eq!(written, Ok(()), "{value:08X}h to {address:04X}h");
    }

    /// Saves the settings, and waits until they are saved.
    pub fn save(&mut self) {
        self.write(at::SAVE_INI, key::SAVE);
        self.after(SAVE);
    }

    /// Restarts, and waits until the drive is ready.
    pub fn restart(&mut self) {
        self.write(at::RESTART, key::RESTART);
        self.after(BOOT + 1.millis());
    }

    /// Writes lines to the buffer from line 0, one request each, and saves the buffer.
    ///
    /// # Panics
    /// If the drive refuses a line.
    #[track_caller]
    pub fn load(&mut self, lines: &[u32]) {
        for (number, &line) in (0..).zip(lines) {
            let written = self.try_write_all(at::WRITE_CMD, &[number, line as u16, (line >> 16) as u16]);
            assert_eq!(written, Ok(()), "line {number}");
        }
        self.write(at::SAVE_PROGRAM, key::SAVE_PROGRAM);
        self.after(SAVE);
    }

    /// Starts the user program; returns when the drive has executed line 0.
    pub fn run(&mut self) {
        self.write(at::MODE_USER_PROGRAM, 2);
        self.after(LINE);
    }
}

/// A request with a function, an address and a word.
#[must_use]
pub fn request(function: u8, first: u16, word: u16) -> [u8; 5] {
    let ([a, b], [c, d]) = (first.to_be_bytes(), word.to_be_bytes());
    [function, a, b, c, d]
}
