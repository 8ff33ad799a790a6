//! An MD3 on a bench, with a master and a stimulus for every pin.

use drivetwin_firmware::device::{Axis, Device, Fault, Level, Pin};
use drivetwin_protocol::modbus::{Frame, rtu};
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, DriveId, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_tests::md3;
pub(crate) use drivetwin_tests::md3::{at, bit};

/// The lights D5 and D6 (section 2).
pub(crate) const RED: &str = "D5";
pub(crate) const GREEN: &str = "D6";

/// The BUSY output: open, or switched to ground while the drive is busy (section 2).
pub(crate) const BUSY: &str = "J3.7";

/// A drive of a kind, without power.
fn make(kind: &str) -> Box<dyn Device> {
    macro_rules! boxed {
        ($($new:expr,)*) => { vec![$(Box::new($new()) as Box<dyn Device>),*] };
    }
    let drives: Vec<Box<dyn Device>> = drivetwin_firmware::devices!(boxed);
    let found = drives.into_iter().find(|drive| drive.spec().kind == kind);
    found.unwrap_or_else(|| panic!("there is no {kind}"))
}

/// An MD3 and its stimuli. Characters take no time, so that a command takes effect at the instant at which it
/// is sent.
pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) seat: DriveId,
}

impl Rig {
    /// An MD3 that has just been powered on, with the memory of `setup`.
    pub(crate) fn new(kind: &str, setup: Setup) -> Self {
        let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
        let seat = bench.add_with("x", make(kind), setup).expect("a drive that can be seated");
        Self { bench, seat }
    }

    /// A new MD3 that is ready.
    pub(crate) fn ready() -> Self {
        Self::ready_kind("md3")
    }

    /// A new drive of that kind that is ready.
    pub(crate) fn ready_kind(kind: &str) -> Self {
        let mut rig = Self::new(kind, Setup::default());
        rig.after(2_500.millis());
        rig
    }

    /// An MD3 that was powered on a moment ago and had saved these registers before.
    pub(crate) fn restarted(registers: &[(u16, u16)]) -> Self {
        let mut rig = Self::ready();
        for &(address, value) in registers {
            rig.write(address, value);
        }
        rig.save();
        rig.power_cycle();
        rig
    }

    pub(crate) fn now(&self) -> Instant {
        self.bench.now()
    }

    /// Advances the time.
    pub(crate) fn after(&mut self, span: Duration) {
        self.bench.run_until(self.now() + span);
    }

    /// Reply of the drive to a frame.
    pub(crate) fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        self.bench.ask(self.seat, frame)
    }

    /// Reads `count` words from the address `first`.
    pub(crate) fn words(&mut self, first: u16, count: u16) -> Vec<u16> {
        words(&self.ask(&rtu::read(1, first, count)))
    }

    /// Reads a register.
    pub(crate) fn read(&mut self, address: u16) -> u16 {
        self.words(address, 1)[0]
    }

    /// Reads a pair of registers.
    pub(crate) fn read_long(&mut self, first: u16) -> i32 {
        let pair = self.words(first, 2);
        (u32::from(pair[0]) << 16 | u32::from(pair[1])).cast_signed()
    }

    /// Returns true if a write is accepted. Else the drive must refuse it with exception 02, the only one
    /// (6.2).
    pub(crate) fn accepts(&mut self, address: u16, value: u16) -> bool {
        let request = rtu::write(1, address, value);
        let reply = self.ask(&request);
        let refusal: Frame = rtu::frame(1, &[0x86, 0x02]);
        assert!(reply == request[..] || reply == refusal[..], "{reply:02x?}");
        reply == request[..]
    }

    #[track_caller]
    pub(crate) fn write(&mut self, address: u16, value: u16) {
        md3::write(&mut self.bench, self.seat, address, value);
    }

    /// Writes both halves of a pair, the high one first.
    #[track_caller]
    pub(crate) fn write_long(&mut self, first: u16, value: i32) {
        md3::write_pair(&mut self.bench, self.seat, first, value.cast_unsigned());
    }

    /// Writes MotionControl.
    pub(crate) fn command(&mut self, bits: u16) {
        self.write(at::MOTION, bits);
    }

    pub(crate) fn motion_control(&mut self) -> u16 {
        self.read(at::MOTION)
    }

    fn row(&self, name: &str) -> usize {
        let named = self.bench.spec(self.seat).registers.find(name);
        named.unwrap_or_else(|| panic!("there is no {name}")).row
    }

    /// Presets a register that the bus cannot reach.
    pub(crate) fn poke(&mut self, name: &str, value: i64) {
        let row = self.row(name);
        self.bench.poke(self.seat, row, value).expect("a value that it takes");
    }

    /// Value of a register of one word at the present instant.
    pub(crate) fn peek(&self, name: &str) -> u16 {
        self.bench.peek(self.seat, self.row(name)) as u16
    }

    /// Saves the registers, and waits until they are saved (MD3-12: 20 ms).
    pub(crate) fn save(&mut self) {
        self.write(at::EEPROM, 1);
        self.after(20.millis());
        assert_eq!(self.read(at::EEPROM), 0);
    }

    /// Switches power off and on; returns two ticks later.
    pub(crate) fn power_cycle(&mut self) {
        self.bench.power(self.seat, PowerAction::Cycle);
        self.after(Duration::TICK * 2);
    }

    pub(crate) fn fault(&mut self, name: &str, on: bool) {
        let faults = self.bench.spec(self.seat).faults;
        let place = faults.iter().position(|fault| *fault == name).expect("a fault of the drive");
        self.bench.fault(self.seat, Fault(place as u8), on);
        self.after(Duration::TICK);
    }

    pub(crate) fn pin(&self, name: &str) -> Pin {
        let pins = self.bench.spec(self.seat).pins;
        Pin(pins.iter().position(|pin| pin.name == name).expect("a pin of the drive") as u8)
    }

    fn drive(&mut self, name: &str, drive: PinStimulus) {
        self.bench.set_pin(self.seat, self.pin(name), drive);
        self.after(Duration::TICK);
    }

    /// Pulls a pin to ground. Like the next two functions, returns when the drive has received the level.
    pub(crate) fn low(&mut self, name: &str) {
        self.drive(name, PinStimulus::Low);
    }

    /// Drives a pin high.
    pub(crate) fn high(&mut self, name: &str) {
        self.drive(name, PinStimulus::High);
    }

    /// Releases a pin.
    pub(crate) fn open(&mut self, name: &str) {
        self.drive(name, PinStimulus::Open);
    }

    /// Applies a train of pulses to a pin; returns after its end.
    pub(crate) fn pulses(&mut self, name: &str, count: u32, hz: f64) {
        self.bench.pulse(self.seat, self.pin(name), count, hz).expect("no train runs there");
        let lasts = (f64::from(count) / hz * 16e6).ceil() as u64;
        self.after(Duration::from_ticks(lasts + 1));
    }

    pub(crate) fn level(&self, name: &str) -> Level {
        self.bench.level(self.seat, self.pin(name))
    }

    pub(crate) fn lit(&self, light: &str) -> bool {
        self.level(light) == Level::High
    }

    pub(crate) fn busy(&self) -> bool {
        match self.level(BUSY) {
            Level::Low => true,
            Level::Float => false,
            Level::High => panic!("an open drain is never high"),
        }
    }

    /// Steps since power-on.
    pub(crate) fn position(&self) -> i32 {
        self.bench.motion(self.seat, Axis(0)).position
    }

    /// Speed in steps per second.
    pub(crate) fn speed(&self) -> f64 {
        self.bench.motion(self.seat, Axis(0)).speed.to_num()
    }

    pub(crate) fn moving(&self) -> bool {
        self.bench.motion(self.seat, Axis(0)).moving
    }

    /// Peak current in mA.
    pub(crate) fn current(&self) -> u32 {
        self.bench.motion(self.seat, Axis(0)).current_ma
    }

    /// Duty of a DC motor, in 1/65536.
    pub(crate) fn duty(&self) -> i32 {
        self.bench.motion(self.seat, Axis(0)).duty
    }

    /// Asserts that the motor moves: at `position`, at most one step off, and at `speed`.
    #[track_caller]
    pub(crate) fn assert_on_its_way(&self, position: i32, speed: f64) {
        let (is, fast) = (self.position(), self.speed());
        assert!((is - position).abs() <= 1 && (fast - speed).abs() < 1.0, "{is} at {fast}/s");
        assert!(self.moving() && self.busy());
    }

    /// Asserts that the motor is at rest at `position`, and BUSY is off.
    #[track_caller]
    pub(crate) fn assert_stands(&self, position: i32) {
        assert_eq!((self.position(), self.speed()), (position, 0.0));
        assert!(!self.moving() && !self.busy());
    }

    /// Runs until BUSY is released; returns the time that this took.
    #[track_caller]
    pub(crate) fn until_idle(&mut self) -> Duration {
        let start = self.now();
        while self.busy() {
            let next = self.bench.next();
            assert!(next < start + 1_000.secs(), "still busy after 1,000 s");
            self.bench.run_until(next);
        }
        self.now().since(start)
    }
}

/// The registers in a reply.
pub(crate) fn words(reply: &[u8]) -> Vec<u16> {
    let body = rtu::verify_crc(reply).expect("a reply has a CRC that holds");
    assert_eq!((body[1], usize::from(body[2])), (3, body.len() - 3));
    body[3..].chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
}
