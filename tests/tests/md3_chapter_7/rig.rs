//! An MD3 on a bench, with a master and drivers for every pin.

use drivetwin_firmware::device::{Axis, Device, Fault, Level, Pin};
use drivetwin_protocol::modbus::{Frame, rtu};
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, DriveId, PinStimulus, PowerAction, Settings, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_tests::md3;
pub(crate) use drivetwin_tests::md3::{at, bit};

/// The lights (2).
pub(crate) const RED: &str = "D5";
pub(crate) const GREEN: &str = "D6";

/// Open, or switched to ground while the drive is busy (2).
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

/// An MD3 and its stimuli. Characters take no time here, so that a command counts from
/// the instant at which it was given.
pub(crate) struct Rig {
    pub(crate) bench: Bench,
    pub(crate) seat: DriveId,
}

impl Rig {
    /// An MD3 that has just been given power, with this in its memory.
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

    /// An MD3 that was given power a moment ago, and had these registers saved before.
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

    /// Answer of the drive to a frame.
    pub(crate) fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        self.bench.ask(self.seat, frame)
    }

    /// The words from an address on.
    pub(crate) fn words(&mut self, first: u16, count: u16) -> Vec<u16> {
        words(&self.ask(&rtu::read(1, first, count)))
    }

    /// A register.
    pub(crate) fn read(&mut self, address: u16) -> u16 {
        self.words(address, 1)[0]
    }

    /// A pair of registers.
    pub(crate) fn read_long(&mut self, first: u16) -> i32 {
        let pair = self.words(first, 2);
        (u32::from(pair[0]) << 16 | u32::from(pair[1])).cast_signed()
    }

    /// Returns whether a write is accepted; if not it must be refused with exception 02, the only one (6.2).
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

    /// Both halves of a pair, the high one first.
    #[track_caller]
    pub(crate) fn write_long(&mut self, first: u16, value: i32) {
        md3::write_pair(&mut self.bench, self.seat, first, value.cast_unsigned());
    }

    /// A write of MotionControl.
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

    /// A register of one word as it reads at this very instant.
    pub(crate) fn peek(&self, name: &str) -> u16 {
        self.bench.peek(self.seat, self.row(name)) as u16
    }

    /// Saves the registers, and waits until they are saved (MD3-12: 20 ms).
    pub(crate) fn save(&mut self) {
        self.write(at::EEPROM, 1);
        self.after(20.millis());
        assert_eq!(self.read(at::EEPROM), 0);
    }

    /// Takes power and gives it again; returns two ticks later.
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

    /// Pulls a pin to ground; returns when the drive has seen it, as the next two do.
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

    /// A train of pulses on a pin, to its end.
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

    /// Steps per second.
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

    /// On its way: at `position`, give or take the step that is due, and at `speed`.
    #[track_caller]
    pub(crate) fn assert_on_its_way(&self, position: i32, speed: f64) {
        let (is, fast) = (self.position(), self.speed());
        assert!((is - position).abs() <= 1 && (fast - speed).abs() < 1.0, "{is} at {fast}/s");
        assert!(self.moving() && self.busy());
    }

    /// Asserts that the motor is at rest at this position, and BUSY is off.
    #[track_caller]
    pub(crate) fn assert_stands(&self, position: i32) {
        assert_eq!((self.position(), self.speed()), (position, 0.0));
        assert!(!self.moving() && !self.busy());
    }

    /// Runs until BUSY is released, and returns the time that it took.
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
