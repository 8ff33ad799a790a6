//! A bench of drives on virtual time.

use std::fmt;

use fixed::types::I48F16;
use standin_firmware::device::{
    Axis, Device, Duration, Fault, Instant, Level, Line, Pin, Port, Refused, Spec,
};

use crate::bus::{LineMode, Sender};
use crate::trace::{Trace, TraceKeep};

/// A device on the bench.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Seat(u32);

/// A serial line and the ports on it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Bus(u32);

/// Somebody outside, who talks and listens on a line.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Client(u32);

/// What holds for a whole bench.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settings {
    /// Seed of every random choice.
    pub seed: u64,
    /// How long characters take.
    pub line: LineMode,
    /// How long half a message may wait for its rest, in time of the bench.
    pub patience: Duration,
    /// How much of what happens is kept.
    pub trace: TraceKeep,
}

impl Default for Settings {
    fn default() -> Self {
        Self { seed: 1, line: LineMode::Timed, patience: Duration::millis(20), trace: TraceKeep::default() }
    }
}

/// Told each range of bytes as it is stored: where it begins, and the bytes.
pub type Keep = Box<dyn FnMut(u16, &[u8])>;

/// How a device is seated.
#[derive(Default)]
pub struct Setup {
    /// No start-up delay.
    pub boot_fast: bool,
    /// What is in its memory; cut or filled up with `0xFF` to its size. `None`: a new one.
    pub memory: Option<Vec<u8>>,
    /// Who keeps its memory.
    pub keep: Option<Keep>,
    /// Rows and their values: saved ones are in the memory before the first power-on, others are
    /// set after every power-on.
    pub presets: Vec<(usize, i64)>,
}

/// Why a device cannot be seated; the bench is as before.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum SeatError {
    /// A name is one word that does not begin with `#`, `<` or `>`.
    Name(String),
    /// There is a seat of that name.
    Taken(String),
    /// A preset is refused.
    Preset {
        /// Of which row.
        row: usize,
        /// Why.
        why: Refused,
    },
}

impl fmt::Display for SeatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "\"{name}\" is no name for a drive: use one word"),
            Self::Taken(name) => write!(f, "there are two drives called {name}"),
            Self::Preset { row, why } => write!(f, "the preset of row {row} is refused: {why:?}"),
        }
    }
}

impl std::error::Error for SeatError {}

/// What is done to a pin from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Drive {
    /// Pulled to ground.
    Low,
    /// Driven high.
    High,
    /// Let go.
    Open,
    /// A voltage, in mV.
    Millivolts(i32),
}

/// A train of pulses runs on that pin already.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Busy;

impl fmt::Display for Busy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a train of pulses runs on that pin already")
    }
}

impl std::error::Error for Busy {}

/// What is done to a device's power.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PowerAction {
    /// Taken away.
    Off,
    /// Given.
    On,
    /// Taken away, and given again a tick later.
    Cycle,
    /// Fails in the middle of the next save, and stays away.
    Cut,
}

/// What an axis does at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Motion {
    /// Steps or counts since the first power-on.
    pub position: i32,
    /// Steps or counts per second, signed.
    pub speed: I48F16,
    /// Whether it is on its way.
    pub moving: bool,
    /// Peak current in mA.
    pub current_ma: u32,
    /// Duty of a motor without steps, in 1/65536, signed.
    pub duty: i32,
}

/// What a port has seen since its device was seated.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// Requests carried out.
    pub requests: u64,
    /// Requests refused with an exception.
    pub refused: u64,
    /// Frames whose check sum did not hold.
    pub crc: u64,
    /// Frames with a silence inside.
    pub gap: u64,
    /// Frames of a wrong length.
    pub length: u64,
    /// Frames with a character that nobody could read.
    pub spoiled: u64,
    /// Frames for somebody else.
    pub foreign: u64,
    /// Frames that came while the device was starting.
    pub starting: u64,
}

impl Statistics {
    /// Frames ignored, for whatever reason.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.crc + self.gap + self.length + self.spoiled + self.foreign + self.starting
    }
}

/// Drives, lines and time.
pub struct Bench {}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

#[expect(unused_variables, clippy::unimplemented, reason = "a skeleton")]
impl Bench {
    /// An empty bench at the beginning of time.
    #[must_use]
    pub fn new() -> Self {
        Self::with(Settings::default())
    }

    /// An empty bench with other settings.
    #[must_use]
    pub fn with(settings: Settings) -> Self {
        Self {}
    }

    /// Seats a device and powers it on now.
    ///
    /// # Panics
    /// If the name is no name, or taken.
    pub fn add<D: Device + Default + 'static>(&mut self, name: &str) -> Seat {
        unimplemented!()
    }

    /// Seats a device and powers it on now. Each of its serial ports gets a line of its own.
    ///
    /// # Errors
    /// Its name or a preset is refused.
    pub fn seat(&mut self, name: &str, device: Box<dyn Device>, setup: Setup) -> Result<Seat, SeatError> {
        unimplemented!()
    }

    /// Puts several serial ports on one line. Clients connect after it.
    pub fn share(&mut self, name: &str, ports: &[(Seat, Port)]) -> Bus {
        unimplemented!()
    }

    /// The line of a serial port; `None` for any other port.
    #[must_use]
    pub fn bus(&self, seat: Seat, port: Port) -> Option<Bus> {
        unimplemented!()
    }

    /// All seats, in the order of their names.
    pub fn seats(&self) -> impl Iterator<Item = Seat> {
        std::iter::empty()
    }

    /// The name of a line: as given to [`share`](Self::share), or that of its port.
    #[must_use]
    pub fn bus_name(&self, bus: Bus) -> &str {
        unimplemented!()
    }

    /// The ports on a line.
    #[must_use]
    pub fn ports(&self, bus: Bus) -> &[(Seat, Port)] {
        unimplemented!()
    }

    /// How far time has come.
    #[must_use]
    pub fn now(&self) -> Instant {
        unimplemented!()
    }

    /// The next instant at which something happens, or a client can read a character;
    /// [`Instant::NEVER`] if nothing is under way.
    #[must_use]
    pub fn next(&self) -> Instant {
        unimplemented!()
    }

    /// Brings everything to `at`, which is included. Time does not go back.
    pub fn run_until(&mut self, at: impl Into<Instant>) {
        unimplemented!()
    }

    /// Runs until every complete request is answered to its end, or judged, and what was done to
    /// pins and power has arrived.
    pub fn settle(&mut self) {
        unimplemented!()
    }

    /// How long half a message may wait for its rest from now on, in time of the bench.
    pub fn set_patience(&mut self, patience: Duration) {
        unimplemented!()
    }

    /// Somebody joins a line.
    pub fn connect(&mut self, bus: Bus) -> Client {
        unimplemented!()
    }

    /// A client leaves, and takes its half message along. What was complete is still sent.
    pub fn disconnect(&mut self, client: Client) {
        unimplemented!()
    }

    /// A client's bytes arrive now.
    pub fn send(&mut self, client: Client, bytes: &[u8]) {
        self.send_from(client, bytes, Sender::default());
    }

    /// A client's bytes arrive now, from a port with these settings. A drive whose line they do not
    /// fit hears characters that nobody can read.
    pub fn send_from(&mut self, client: Client, bytes: &[u8], sender: Sender) {
        unimplemented!()
    }

    /// Bytes of a client that are not on the line yet. A host that reads only while this is small
    /// holds back who sends faster than the line.
    #[must_use]
    pub fn backlog(&self, client: Client) -> usize {
        unimplemented!()
    }

    /// Appends the characters that have reached a client by now; returns how many.
    pub fn receive(&mut self, client: Client, into: &mut Vec<u8>) -> usize {
        unimplemented!()
    }

    /// The settings of a line now: those of its first drive, by name.
    #[must_use]
    pub fn line(&self, bus: Bus) -> Line {
        unimplemented!()
    }

    /// Somebody opens or leaves the port at the other end of a line (DTR, a pty).
    pub fn attach(&mut self, bus: Bus, here: bool) {
        unimplemented!()
    }

    /// Sends a frame to the first port of a device, [settles](Self::settle), and returns what came.
    pub fn ask(&mut self, seat: Seat, frame: &[u8]) -> Vec<u8> {
        unimplemented!()
    }

    /// Drives a pin from outside. It arrives a tick later.
    pub fn set_pin(&mut self, seat: Seat, pin: Pin, drive: Drive) {
        unimplemented!()
    }

    /// A train of `count` pulses on an input pin, away from its present level and back, `hz` a
    /// second (limited to 1 µHz to 8 MHz). Edges are made one by one as time comes to them.
    ///
    /// # Errors
    /// One runs there already.
    pub fn pulse(&mut self, seat: Seat, pin: Pin, count: u32, hz: f64) -> Result<(), Busy> {
        unimplemented!()
    }

    /// The cause of a fault comes or goes.
    pub fn fault(&mut self, seat: Seat, fault: Fault, on: bool) {
        unimplemented!()
    }

    /// Does something to a device's power, now or a tick later.
    pub fn power(&mut self, seat: Seat, action: PowerAction) {
        unimplemented!()
    }

    /// Presets a register past the bus.
    ///
    /// # Errors
    /// The device refuses it; nothing has changed then.
    pub fn poke(&mut self, seat: Seat, row: usize, value: i64) -> Result<(), Refused> {
        unimplemented!()
    }

    /// A register as it reads now, without the bus's side effects.
    #[must_use]
    pub fn peek(&self, seat: Seat, row: usize) -> i64 {
        unimplemented!()
    }

    /// What a device is.
    #[must_use]
    pub fn spec(&self, seat: Seat) -> &'static Spec {
        unimplemented!()
    }

    /// The name of a seat.
    #[must_use]
    pub fn name(&self, seat: Seat) -> &str {
        unimplemented!()
    }

    /// The seat of that name.
    #[must_use]
    pub fn seat_named(&self, name: &str) -> Option<Seat> {
        unimplemented!()
    }

    /// A pin as it is seen from outside now.
    #[must_use]
    pub fn level(&self, seat: Seat, pin: Pin) -> Level {
        unimplemented!()
    }

    /// Whether the cause of a fault is there.
    #[must_use]
    pub fn faulty(&self, seat: Seat, fault: Fault) -> bool {
        unimplemented!()
    }

    /// What an axis does now.
    #[must_use]
    pub fn motion(&self, seat: Seat, axis: Axis) -> Motion {
        unimplemented!()
    }

    /// What a port has seen.
    #[must_use]
    pub fn statistics(&self, seat: Seat, port: Port) -> Statistics {
        unimplemented!()
    }

    /// The non-volatile memory of a device.
    #[must_use]
    pub fn memory(&self, seat: Seat) -> &[u8] {
        unimplemented!()
    }

    /// Whether a device has power.
    #[must_use]
    pub fn powered(&self, seat: Seat) -> bool {
        unimplemented!()
    }

    /// What has happened.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        unimplemented!()
    }
}
