//! State of a bench as JSON: the responses of the control API.

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Instant, Level, Line, Pin, Port, Role, Spec};
use drivetwin_sim::bench::{self, DriveId, Outlet, ShaftState};
use drivetwin_sim::commands::{self, State};
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::line::faults::LineFaults;
use drivetwin_sim::value::Value;
use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use crate::faults::Faults;
use crate::units::seconds;

/// An object whose members are in the order of the manual.
#[derive(Clone, PartialEq, Debug)]
struct InOrder<V>(Vec<(&'static str, V)>);

impl<V: Serialize> Serialize for InOrder<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, value)| (name, value)))
    }
}

/// State of the bench: time, drives, lines, motors.
#[derive(Serialize, ToSchema)]
pub struct Bench {
    drives: Vec<Seated>,
    buses: Vec<Bus>,
    motors: Vec<Motor>,
    /// Boards at this computer; a board is a drive, too.
    boards: Vec<BoardView>,
    time: Time,
}

/// A board at this computer.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[schema(as = Board)]
pub struct BoardView {
    /// Name of its drive.
    pub drive: String,
    /// Control port of the board.
    #[schema(example = "/dev/ttyACM1 (usb:E66138935F3A6C2B)")]
    pub place: String,
    /// The reason in one sentence why it cannot be reached now; null while it is connected.
    pub away: Option<String>,
    /// The image and what was lost; null while it cannot be reached.
    pub image: Option<ImageView>,
}

/// Image of a board, and statistics since the board started.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[schema(as = BoardImage)]
pub struct ImageView {
    /// Version of the image.
    #[schema(example = "0.1.0")]
    pub version: String,
    /// Kinds of drive that the board can be.
    pub kinds: Vec<String>,
    /// True if the drive starts without its start-up delay.
    pub fast_boot: bool,
    /// Number of inputs of the drive that were lost because too many waited.
    pub lost_inputs: u32,
    /// Number of events that are missing in the recording, because too many waited to be sent.
    pub lost_events: u32,
    /// Number of characters of the drive that the computer did not read in time from the port of the bus.
    pub lost_characters: u32,
    /// Number of failures of pins, ports and the memory.
    pub failures: u32,
    /// Steps that were made in addition to those planned.
    pub slipped_steps: i32,
}

/// A drive on the bench.
#[derive(Serialize, ToSchema)]
struct Seated {
    name: String,
    kind: &'static str,
    powered: bool,
}

/// A serial line, or a TCP port of a drive.
#[derive(Serialize, ToSchema)]
pub struct Bus {
    name: String,
    /// Serial settings now; null for a TCP port.
    #[schema(example = "9600 8E1")]
    line: Option<String>,
    /// Names of the drives on the line, or of the drive with the port.
    drives: Vec<String>,
    /// Listening addresses, as URIs.
    #[schema(example = json!(["pty:/dev/pts/4", "tcp:127.0.0.1:5020"]))]
    listen: Vec<String>,
    /// Faults of the line or port.
    faults: Faults,
    /// True if the line drops requests that are too early.
    strict: bool,
    /// Number of requests so far that were too early: without a silence of t3.5 before or after them.
    early_requests: u64,
}

/// A motor on the bench.
#[derive(Serialize, ToSchema)]
pub(crate) struct Motor {
    name: String,
    /// Name of the drive that turns the motor.
    drive: String,
    /// Revolutions since the start, signed.
    revolutions: f64,
    /// Speed in revolutions per minute, signed.
    rpm: f64,
    /// True if the shaft cannot follow the commands of its drive.
    stalled: bool,
    /// Current in A.
    current: f64,
}

/// The clock of the bench.
#[derive(Serialize, ToSchema)]
pub struct Time {
    /// `real`, `xN` or `manual`.
    #[schema(example = "real")]
    mode: String,
    /// Bench time since the start, in seconds.
    seconds: f64,
}

/// A drive's state at this instant.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct Drive {
    name: String,
    kind: &'static str,
    powered: bool,
    /// Register values, by the names of the manual.
    #[schema(value_type = BTreeMap<String, ValueSchema>)]
    registers: InOrder<Value>,
    /// Pin levels, `low`, `high` or `open`, by the names of the manual.
    #[schema(value_type = BTreeMap<String, Shown>)]
    pins: InOrder<Shown>,
    /// LEDs: true while lit.
    #[schema(value_type = BTreeMap<String, bool>)]
    leds: InOrder<bool>,
    /// Motion of the first axis; null if there is none.
    motion: Option<Motion>,
    /// Faults by name: true while the cause is present.
    #[schema(value_type = BTreeMap<String, bool>)]
    faults: InOrder<bool>,
    /// Statistics of the ports.
    #[schema(value_type = BTreeMap<String, PortState>)]
    ports: InOrder<PortState>,
}

/// State of a pin.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Shown {
    Low,
    High,
    Open,
}

/// Motion of an axis.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
struct Motion {
    /// Position in steps or counts.
    position: i32,
    /// Speed in steps or counts per second, signed.
    speed: f64,
    moving: bool,
    /// Current in A.
    current: f64,
    /// Duty of a motor that has no steps, −1 to 1.
    duty: f64,
}

/// Statistics of a port since its drive was added.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum PortState {
    /// A serial port.
    Serial(Statistics),
    /// A TCP port.
    Tcp(TcpStatistics),
}

/// Statistics of a TCP port.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct TcpStatistics {
    /// Listening addresses, as URIs.
    #[schema(example = json!(["tcp:127.0.0.1:5020"]))]
    listen: Vec<String>,
    /// Number of clients that are connected now.
    connected: usize,
    /// Number of connections so far.
    connections: u64,
    /// Number of connections that were closed because of bytes that are not Modbus/TCP.
    broken: u64,
    /// Number of messages to the drive. On a text port a message is a piece of a text line.
    messages: u64,
    /// Number of requests that were executed.
    requests: u64,
    /// Number of requests that were refused with an exception.
    refused: u64,
    /// Number of requests that were ignored.
    dropped: u64,
}

/// Statistics of a serial port.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct Statistics {
    /// Serial settings now.
    #[schema(value_type = String, example = "9600 8E1")]
    #[serde(serialize_with = "as_text")]
    line: Line,
    /// Number of requests that were executed.
    requests: u64,
    /// Number of requests that were refused with an exception.
    refused: u64,
    /// Number of frames that were ignored: the sum of the numbers that follow.
    dropped: u64,
    /// Frames with a wrong checksum.
    crc: u64,
    /// Frames with a silent gap inside.
    gap: u64,
    /// Frames of a wrong length.
    length: u64,
    /// Frames with a parity or framing error.
    spoiled: u64,
    /// Frames for another address.
    foreign: u64,
    /// Frames that arrived while the drive was starting.
    starting: u64,
}

/// A number, or a list of words (each 0 to 65,535, in bus order) for a register in which each word has its
/// own meaning.
// The schema of `Value`. `Value` itself is in a crate without HTTP.
#[derive(Serialize, ToSchema)]
#[schema(as = Value)]
#[serde(untagged)]
pub enum ValueSchema {
    /// A number.
    Number(i64),
    /// A list of words.
    Words(Vec<i64>),
}

/// URIs of each line and TCP port.
pub type Places = BTreeMap<Outlet, Vec<String>>;

impl Bench {
    /// The bench without its boards. `places` has the addresses of its lines and TCP ports.
    #[must_use]
    pub fn of(bench: &bench::Bench, mode: TimeMode, places: &Places) -> Self {
        let drives = bench.drives().map(|id| Seated {
            name: bench.name(id).to_owned(),
            kind: bench.spec(id).kind,
            powered: bench.powered(id),
        });
        let motors = bench.motors().map(|motor| {
            let (drive, _) = bench.turned_by(motor);
            Motor::new(bench.motor_name(motor), bench.name(drive), bench.turn(motor))
        });
        Self {
            drives: drives.collect(),
            buses: Bus::all(bench, places),
            motors: motors.collect(),
            boards: Vec::new(),
            time: Time::new(mode, bench.now()),
        }
    }

    /// Adds a board, whose drive is on the bench already, and has power or not.
    pub fn add(&mut self, board: BoardView, powered: bool) {
        if let Some(seat) = self.drives.iter_mut().find(|seat| seat.name == board.drive) {
            seat.powered = powered;
        }
        self.boards.push(board);
    }

    /// Sets the time to that of the board whose clock the bench has, if that is later.
    pub fn reach(&mut self, at: Instant) {
        self.time.seconds = self.time.seconds.max(seconds(at));
    }
}

/// State of a line or TCP port at one instant, without its names.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct BusState {
    /// Serial settings; `None` for a TCP port.
    line: Option<Line>,
    faults: LineFaults,
    strict: bool,
    early_requests: u64,
}

impl BusState {
    /// The present state of a line or TCP port.
    pub(crate) fn of(bench: &bench::Bench, outlet: Outlet) -> Self {
        let line = match outlet {
            Outlet::Line(bus) => Some(bus),
            Outlet::Tcp(..) => None,
        };
        Self {
            line: line.map(|bus| bench.line(bus)),
            faults: bench.faults(outlet),
            strict: line.is_some_and(|bus| bench.is_strict(bus)),
            early_requests: line.map_or(0, |bus| bench.early_requests(bus).count),
        }
    }
}

impl Bus {
    /// A line or TCP port with its names. `name_of` gives the name of a drive.
    pub(crate) fn new<'a>(
        name: &str,
        drives: &[String],
        listen: &[String],
        state: &BusState,
        name_of: impl Fn(DriveId) -> &'a str,
    ) -> Self {
        Self {
            name: name.to_owned(),
            line: state.line.map(|line| line.to_string()),
            drives: drives.to_vec(),
            listen: listen.to_vec(),
            faults: Faults::of(&state.faults, name_of),
            strict: state.strict,
            early_requests: state.early_requests,
        }
    }

    /// All lines and TCP ports of a bench.
    #[must_use]
    pub fn all(bench: &bench::Bench, places: &Places) -> Vec<Self> {
        let bus = |outlet: Outlet| {
            let drives: Vec<String> =
                bench.drives_at(outlet).into_iter().map(|id| bench.name(id).to_owned()).collect();
            let listen = places.get(&outlet).map_or(&[][..], Vec::as_slice);
            let (name, state) = (bench.outlet_name(outlet), BusState::of(bench, outlet));
            Self::new(&name, &drives, listen, &state, |id| bench.name(id))
        };
        bench.outlets().into_iter().map(bus).collect()
    }
}

impl Motor {
    pub(crate) fn new(name: &str, drive: &str, shaft: ShaftState) -> Self {
        let ShaftState { revolutions, rpm, stalled, ma } = shaft;
        let (name, drive, current) = (name.to_owned(), drive.to_owned(), f64::from(ma) / 1_000.0);
        Self { name, drive, revolutions, rpm, stalled, current }
    }
}

impl Time {
    /// The clock of a bench.
    #[must_use]
    pub fn new(mode: TimeMode, now: Instant) -> Self {
        Self { mode: mode.to_string(), seconds: seconds(now) }
    }
}

impl Drive {
    /// A drive of a bench.
    #[must_use]
    pub fn of_bench(bench: &bench::Bench, id: DriveId, places: &Places) -> Self {
        let spec = bench.spec(id);
        let ports = (0..).map(Port).zip(spec.ports);
        let ports = ports.map(|(port, of)| (of.name, PortState::of(bench, id, port, places))).collect();
        Self::new(bench.name(id), spec, &commands::state(bench, id), commands::values(bench, id), ports)
    }

    /// A drive in this state, with the values of its registers and the statistics of its ports.
    #[must_use]
    pub fn new(
        name: &str,
        spec: &'static Spec,
        state: &State,
        registers: Vec<(&'static str, Value)>,
        ports: Vec<(&'static str, PortState)>,
    ) -> Self {
        let is_light = |pin: Pin| spec.pins.get(usize::from(pin.0)).is_some_and(|pin| pin.role == Role::Led);
        let lights = spec.pin_names().filter(|(_, pin)| is_light(*pin));
        let pins = spec.pin_names().filter(|(_, pin)| !is_light(*pin));
        let faults = spec.faults.iter().copied().zip(state.faults.iter().copied());
        Self {
            name: name.to_owned(),
            kind: spec.kind,
            powered: state.powered,
            registers: InOrder(registers),
            pins: InOrder(pins.map(|(name, pin)| (name, Shown::of(state.level(pin)))).collect()),
            leds: InOrder(lights.map(|(name, pin)| (name, state.level(pin) == Level::High)).collect()),
            motion: state.motion.map(Motion::of),
            faults: InOrder(faults.collect()),
            ports: InOrder(ports),
        }
    }
}

impl Shown {
    fn of(level: Level) -> Self {
        match level {
            Level::Low => Self::Low,
            Level::High => Self::High,
            Level::Float => Self::Open,
        }
    }
}

impl Motion {
    fn of(motion: bench::Motion) -> Self {
        Self {
            position: motion.position,
            speed: motion.speed.to_num(),
            moving: motion.moving,
            current: f64::from(motion.current_ma) / 1_000.0,
            duty: f64::from(motion.duty) / 65_536.0,
        }
    }
}

impl PortState {
    /// A serial port with this line.
    #[must_use]
    pub fn serial(line: Line, seen: bench::Statistics) -> Self {
        Self::Serial(Statistics::of(line, seen))
    }

    fn of(bench: &bench::Bench, id: DriveId, port: Port, places: &Places) -> Self {
        let seen = bench.statistics(id, port);
        match bench.outlet(id, port) {
            Outlet::Line(bus) => Self::serial(bench.line(bus), seen),
            outlet @ Outlet::Tcp(..) => Self::Tcp(TcpStatistics {
                listen: places.get(&outlet).cloned().unwrap_or_default(),
                connected: bench.connections(id, port),
                connections: seen.connections,
                broken: seen.broken,
                messages: seen.messages,
                requests: seen.requests,
                refused: seen.refused,
                dropped: seen.dropped(),
            }),
        }
    }
}

impl Statistics {
    fn of(line: Line, seen: bench::Statistics) -> Self {
        Self {
            line,
            requests: seen.requests,
            refused: seen.refused,
            dropped: seen.dropped(),
            crc: seen.crc,
            gap: seen.gap,
            length: seen.length,
            spoiled: seen.spoiled,
            foreign: seen.foreign,
            starting: seen.starting,
        }
    }
}

/// Serializes the settings of a line as text.
fn as_text<S: Serializer>(line: &Line, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_sim::testing::echo_device::{EchoDevice, MODBUS};

    #[test]
    fn a_tcp_port_has_its_addresses_clients_and_counts() {
        let mut bench = bench::Bench::new();
        let echo = bench.add::<EchoDevice>("echo");
        let places = Places::from([(bench.outlet(echo, MODBUS), vec!["tcp:127.0.0.1:5020".to_owned()])]);
        let [client, _] = [(); 2].map(|()| bench.connect_to(echo, MODBUS).unwrap());
        bench.send(client, &[0, 1, 0, 0, 0, 2, 1, 0x11]);
        bench.send(client, &[0, 1, 2, 3]);
        bench.run_until_idle();
        let drive = serde_json::to_value(Drive::of_bench(&bench, echo, &places)).unwrap();
        let expected = serde_json::json!({
            "modbus": {"listen": ["tcp:127.0.0.1:5020"], "connected": 1, "connections": 2, "broken": 1,
                "messages": 1, "requests": 1, "refused": 0, "dropped": 0},
            "mcode": {"listen": [], "connected": 0, "connections": 0, "broken": 0,
                "messages": 0, "requests": 0, "refused": 0, "dropped": 0},
        });
        assert_eq!(drive["ports"], expected);
    }
}
