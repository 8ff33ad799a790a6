//! Requests and responses of the control API, as JSON.

use std::collections::BTreeMap;

use drivetwin_firmware::device::{Instant, Level, Pin, Port, Role};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{self, DriveId, Outlet, PowerAction, scenario};
use drivetwin_sim::commands::{self, Contact, InputLevel, OnBench, Refusal};
use drivetwin_sim::config::bench_file::parse_scenarios;
use drivetwin_sim::value::Value;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value as Json;
use utoipa::ToSchema;

use super::faults::Faults;
use crate::board::{Board, Drive as OnBoard, of_first_port};
use crate::event_loop::EventLoop;

/// An object whose members are in the order of the manual.
pub(super) struct InOrder<V>(Vec<(&'static str, V)>);

impl<V: Serialize> Serialize for InOrder<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, value)| (name, value)))
    }
}

/// State of the bench: time, drives, lines, motors.
#[derive(Serialize, ToSchema)]
pub(super) struct Bench {
    drives: Vec<Seated>,
    buses: Vec<Bus>,
    motors: Vec<Motor>,
    /// Boards at this computer; a board is a drive, too.
    boards: Vec<BoardView>,
    time: Time,
    /// True if the time is that of the board.
    #[serde(skip)]
    follows_board: bool,
}

/// A board at this computer.
#[derive(Serialize, ToSchema)]
#[schema(as = Board)]
pub(super) struct BoardView {
    /// Name of its drive.
    drive: String,
    /// Control port of the board.
    #[schema(example = "/dev/ttyACM1 (usb:E66138935F3A6C2B)")]
    place: String,
    /// The reason in one sentence why it cannot be reached now; null while it is connected.
    away: Option<String>,
    /// The image and what was lost; null while it cannot be reached.
    image: Option<ImageView>,
}

/// Image of a board, and statistics since the board started.
#[derive(Serialize, ToSchema)]
#[schema(as = BoardImage)]
struct ImageView {
    /// Version of the image.
    #[schema(example = "0.1.0")]
    version: String,
    /// Kinds of drive that the board can be.
    kinds: Vec<String>,
    /// True if the drive starts without its start-up delay.
    fast_boot: bool,
    /// Number of inputs of the drive that were lost because too many waited.
    lost_inputs: u32,
    /// Number of events that are missing in the recording, because too many waited to be sent.
    lost_events: u32,
    /// Number of characters of the drive that the computer did not read in time from the port of the bus.
    lost_characters: u32,
    /// Number of failures of pins, ports and the memory.
    failures: u32,
    /// Steps that were made in addition to those planned.
    slipped_steps: i32,
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
pub(super) struct Bus {
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
struct Motor {
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
pub(super) struct Time {
    /// `real`, `xN` or `manual`.
    #[schema(example = "real")]
    mode: String,
    /// Bench time since the start, in seconds.
    seconds: f64,
}

/// A drive's state at this instant.
#[derive(Serialize, ToSchema)]
pub(super) struct Drive {
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
    #[schema(value_type = BTreeMap<String, Seen>)]
    ports: InOrder<Seen>,
}

/// State of a pin.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Shown {
    Low,
    High,
    Open,
}

/// Motion of an axis.
#[derive(Serialize, ToSchema)]
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
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
enum Seen {
    Serial(Statistics),
    Tcp(TcpStatistics),
}

/// Statistics of a TCP port.
#[derive(Serialize, ToSchema)]
struct TcpStatistics {
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
#[derive(Serialize, ToSchema)]
struct Statistics {
    /// Serial settings now.
    #[schema(example = "9600 8E1")]
    line: String,
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

/// Level, voltage or current of an input pin: exactly one of the three.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"level": "low"}))]
pub(super) struct PinLevel {
    /// `low` pulls the pin low, `high` drives it high, `open` does not drive it.
    level: Option<Driven>,
    /// A voltage, on an analogue input.
    volts: Option<f64>,
    /// A current in mA, on an analogue input that can measure one.
    milliamps: Option<f64>,
}

/// A level from outside.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Driven {
    Low,
    High,
    Open,
}

impl From<PinLevel> for InputLevel {
    fn from(PinLevel { level, volts, milliamps }: PinLevel) -> Self {
        let level = level.map(|level| match level {
            Driven::Low => Contact::Low,
            Driven::High => Contact::High,
            Driven::Open => Contact::Open,
        });
        Self { level, volts, milliamps }
    }
}

/// A train of pulses.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"count": 1000, "hz": 250000}))]
pub(super) struct Pulses {
    #[schema(minimum = 1, maximum = 4294967295_i64)]
    pub(super) count: u32,
    /// Pulses per second of bench time.
    #[schema(minimum = 0.000001, maximum = 8000000)]
    pub(super) hz: f64,
    /// Duty: the part of each period for which the pulse lasts, above 0 and below 1; 0.5 by default.
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
    pub(super) duty: Option<f64>,
}

/// Motion of an encoder.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"counts": 400, "hz": 10000}))]
pub(super) struct Turn {
    /// Number of edges, four per cycle; not 0. A negative number turns in the other direction.
    #[schema(minimum = -2147483648, maximum = 2147483647)]
    pub(super) counts: i64,
    /// Edges per second of bench time.
    #[schema(minimum = 0.000001, maximum = 16000000)]
    pub(super) hz: f64,
}

/// A number, or a list of words (each 0 to 65,535, in bus order) for a register in which each word has its
/// own meaning.
// The schema of `Value`. `Value` itself is in a crate without HTTP.
#[derive(Serialize, ToSchema)]
#[schema(as = Value)]
#[serde(untagged)]
#[expect(dead_code, reason = "only its schema is used")]
pub(super) enum ValueSchema {
    /// A number.
    Number(i64),
    /// A list of words.
    Words(Vec<i64>),
}

/// New value of a register.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"value": 5}))]
pub(super) struct NewValue {
    #[schema(value_type = ValueSchema)]
    pub(super) value: Value,
}

/// Change of a drive's power.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"action": "cycle"}))]
pub(super) struct Power {
    pub(super) action: Action,
}

/// `off`, `on`, `cycle` (off and on again), or `cut`: the drive continues to run, and its power fails in the
/// middle of its next save to memory.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Action {
    Off,
    On,
    Cycle,
    Cut,
}

impl From<Action> for PowerAction {
    fn from(action: Action) -> Self {
        match action {
            Action::Off => Self::Off,
            Action::On => Self::On,
            Action::Cycle => Self::Cycle,
            Action::Cut => Self::Cut,
        }
    }
}

/// The kind that a board shall be.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"kind": "qsb-d"}))]
pub(super) struct Kind {
    pub(super) kind: String,
}

/// The kind that a board is now.
#[derive(Serialize, ToSchema)]
pub(super) struct Kinds {
    pub(super) kind: String,
    /// Kinds that it can be.
    pub(super) kinds: Vec<String>,
}

/// New time mode.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Mode {
    /// `real`, `xN` (N times faster than real time, N up to 1000) or `manual`.
    #[schema(example = "manual", pattern = "^(real|x([1-9][0-9]{0,2}|1000)|manual)$")]
    pub(super) mode: String,
}

/// Advance of the clock in manual time.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Advance {
    /// Bench time to run, 0 to 86,400 s.
    #[schema(minimum = 0, maximum = 86400, example = 1.25)]
    pub(super) seconds: f64,
}

/// Actions that happen at a time, or after a request of a master.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Scenario {
    /// The steps, each with the keys of a step of a `[[scenario]]` in a bench file.
    #[schema(value_type = Vec<Object>, min_items = 1, example = json!([
        {"when": {"drive": "md3", "register": "MotionControl"}, "after_ms": 100, "drive": "md3", "power": "cut"}
    ]))]
    steps: Vec<serde_json::Map<String, Json>>,
}

impl Scenario {
    /// The scenario for a bench.
    ///
    /// # Errors
    /// The first error, with the number of the step.
    pub(super) fn on(&self, bench: &bench::Bench) -> Result<Vec<scenario::Scenario>, String> {
        let steps = self.steps.iter().zip(1..).map(|(step, number)| {
            toml(&Json::Object(step.clone())).ok_or_else(|| format!("step {number}: null is not a value"))
        });
        let steps = steps.collect::<Result<Vec<_>, _>>()?.join(",\n");
        // Each step has a line of its own. The first one is line 3.
        let text = format!("[[scenario]]\nsteps = [\n{steps}\n]");
        parse_scenarios(&text, bench).map_err(|error| match error.line {
            line @ 3.. if line - 3 < self.steps.len() => format!("step {}: {}", line - 2, error.what),
            _ => error.what,
        })
    }
}

/// A value of JSON on one line of TOML; `None` if it has a null. A text of JSON is one of TOML, too, except that TOML
/// takes DEL only as an escape.
fn toml(json: &Json) -> Option<String> {
    Some(match json {
        Json::Null => return None,
        Json::Bool(_) | Json::Number(_) | Json::String(_) => json.to_string().replace('\u{7f}', "\\u007f"),
        Json::Array(values) => {
            let values: Option<Vec<String>> = values.iter().map(toml).collect();
            format!("[{}]", values?.join(", "))
        }
        Json::Object(members) => {
            let member = |(key, value): (&String, &Json)| {
                Some(format!("{} = {}", toml(&Json::String(key.clone()))?, toml(value)?))
            };
            let members: Option<Vec<String>> = members.iter().map(member).collect();
            format!("{{ {} }}", members?.join(", "))
        }
    })
}

/// URIs of each line and TCP port.
pub(crate) type Places = BTreeMap<Outlet, Vec<String>>;

impl BoardView {
    pub(super) fn of(board: &Board) -> (Self, Option<Now>) {
        let seen = board.drive().and_then(|mut drive| {
            let (state, statistics) = (commands::Drive::state(&mut drive)?, drive.statistics()?);
            let now = Now { powered: state.powered, at: drive.now()? };
            Ok((ImageView::of(&drive, statistics)?, now))
        });
        let (image, away, now) = match seen {
            Ok((image, now)) => (Some(image), None, Some(now)),
            Err(refusal) => (None, Some(refusal.to_string()), None),
        };
        (Self { drive: board.name().to_owned(), place: board.place().to_owned(), away, image }, now)
    }
}

/// Power and time of a board at this instant.
pub(super) struct Now {
    powered: bool,
    at: Instant,
}

impl ImageView {
    fn of(drive: &OnBoard, statistics: drivetwin_control::Statistics) -> Result<Self, Refusal> {
        Ok(Self {
            version: drive.image().to_owned(),
            kinds: drive.kinds()?,
            fast_boot: drive.is_fast_boot(),
            lost_inputs: statistics.lost_inputs,
            lost_events: statistics.lost_events,
            lost_characters: statistics.lost_characters,
            failures: statistics.failures,
            slipped_steps: statistics.slipped,
        })
    }
}

impl Bench {
    /// Adds a board, whose drive is on the bench already.
    pub(super) fn add(&mut self, (board, now): (BoardView, Option<Now>)) {
        if let Some(seat) = self.drives.iter_mut().find(|seat| seat.name == board.drive) {
            seat.powered = now.as_ref().is_some_and(|now| now.powered);
        }
        if let Some(now) = now.filter(|_| self.follows_board) {
            self.time.seconds = self.time.seconds.max(seconds(now.at));
        }
        self.boards.push(board);
    }

    pub(super) fn of(event_loop: &EventLoop, places: &Places) -> Self {
        let bench = &event_loop.bench;
        let name = |id: DriveId| bench.name(id).to_owned();
        let drives = bench.drives().map(|id| Seated {
            name: name(id),
            kind: bench.spec(id).kind,
            powered: bench.powered(id),
        });
        let motors = bench.motors().map(|motor| Motor::of(bench, motor));
        Self {
            drives: drives.collect(),
            buses: Bus::all(bench, places),
            motors: motors.collect(),
            boards: Vec::new(),
            time: Time::of(event_loop),
            follows_board: event_loop.follows_board(),
        }
    }
}

impl Bus {
    pub(super) fn all(bench: &bench::Bench, places: &Places) -> Vec<Self> {
        let bus = |outlet: Outlet| Self {
            name: bench.outlet_name(outlet),
            line: match outlet {
                Outlet::Line(bus) => Some(bench.line(bus).to_string()),
                Outlet::Tcp(..) => None,
            },
            drives: bench.drives_at(outlet).into_iter().map(|id| bench.name(id).to_owned()).collect(),
            listen: places.get(&outlet).cloned().unwrap_or_default(),
            faults: Faults::of(bench, outlet),
            strict: matches!(outlet, Outlet::Line(bus) if bench.is_strict(bus)),
            early_requests: match outlet {
                Outlet::Line(bus) => bench.early_requests(bus).count,
                Outlet::Tcp(..) => 0,
            },
        };
        bench.outlets().into_iter().map(bus).collect()
    }
}

impl Motor {
    fn of(bench: &bench::Bench, motor: bench::Motor) -> Self {
        let bench::ShaftState { revolutions, rpm, stalled, ma } = bench.turn(motor);
        let (drive, _) = bench.turned_by(motor);
        Self {
            name: bench.motor_name(motor).to_owned(),
            drive: bench.name(drive).to_owned(),
            revolutions,
            rpm,
            stalled,
            current: f64::from(ma) / 1_000.0,
        }
    }
}

impl Time {
    pub(super) fn of(event_loop: &EventLoop) -> Self {
        Self { mode: event_loop.time_mode().to_string(), seconds: seconds(event_loop.bench.now()) }
    }
}

impl Drive {
    /// A drive of a bench.
    pub(super) fn of_bench(bench: &mut bench::Bench, id: DriveId, places: &Places) -> Result<Self, Refusal> {
        let ports = (0..).map(Port).zip(bench.spec(id).ports);
        let ports = ports.map(|(port, of)| (of.name, Seen::of(bench, id, port, places))).collect();
        Self::of(&mut OnBench::new(bench, id), InOrder(ports))
    }

    /// The drive of a board.
    pub(super) fn of_board(drive: &mut OnBoard) -> Result<Self, Refusal> {
        let (line, seen) = of_first_port(&drive.statistics()?);
        let first = commands::Drive::spec(drive).ports.iter().take(1);
        let ports = first.map(|port| (port.name, Seen::Serial(Statistics::of(line.clone(), seen)))).collect();
        Self::of(drive, InOrder(ports))
    }

    fn of(drive: &mut dyn commands::Drive, ports: InOrder<Seen>) -> Result<Self, Refusal> {
        let spec = drive.spec();
        let (state, registers) = (drive.state()?, drive.values()?);
        let is_light = |pin: Pin| spec.pins.get(usize::from(pin.0)).is_some_and(|pin| pin.role == Role::Led);
        let lights = spec.pin_names().filter(|(_, pin)| is_light(*pin));
        let pins = spec.pin_names().filter(|(_, pin)| !is_light(*pin));
        let faults = spec.faults.iter().copied().zip(state.faults.iter().copied());
        Ok(Self {
            name: drive.name().to_owned(),
            kind: spec.kind,
            powered: state.powered,
            registers: InOrder(registers),
            pins: InOrder(pins.map(|(name, pin)| (name, Shown::of(state.level(pin)))).collect()),
            leds: InOrder(lights.map(|(name, pin)| (name, state.level(pin) == Level::High)).collect()),
            motion: state.motion.map(Motion::of),
            faults: InOrder(faults.collect()),
            ports,
        })
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

impl Seen {
    fn of(bench: &bench::Bench, id: DriveId, port: Port, places: &Places) -> Self {
        let seen = bench.statistics(id, port);
        match bench.outlet(id, port) {
            Outlet::Line(bus) => Self::Serial(Statistics::of(bench.line(bus).to_string(), seen)),
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
    fn of(line: String, seen: bench::Statistics) -> Self {
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

/// Time since the start of the bench, in seconds.
pub(super) fn seconds(at: Instant) -> f64 {
    at.ticks() as f64 / TICKS_PER_SECOND as f64
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
        let drive = serde_json::to_value(Drive::of_bench(&mut bench, echo, &places).unwrap()).unwrap();
        let expected = serde_json::json!({
            "modbus": {"listen": ["tcp:127.0.0.1:5020"], "connected": 1, "connections": 2, "broken": 1,
                "messages": 1, "requests": 1, "refused": 0, "dropped": 0},
            "mcode": {"listen": [], "connected": 0, "connections": 0, "broken": 0,
                "messages": 0, "requests": 0, "refused": 0, "dropped": 0},
        });
        assert_eq!(drive["ports"], expected);
    }
}
