//! The panel without a server: a bench in WebAssembly answers the calls of the page.
//!
//! The calls are those of the control API that the page makes, with the same requests, responses and sentences, and
//! `POST master` for a small [`master`]. [`exports`] has what JavaScript calls.

pub mod exports;
pub mod master;

use std::time::Duration as WallSpan;

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_panel::describe;
use drivetwin_panel::faults::Faults;
use drivetwin_panel::live::{Snapshot, Viewer};
use drivetwin_panel::requests::{Advance, Mode, NewValue, PinLevel, Power, Pulses, Scenario, Turn, Typed};
use drivetwin_panel::schema::{self, Places};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{Bench, Client, DriveId, Settings, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::commands::{self, OnBench, Refusal};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::DriveLayout;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::export::{pcapng, vcd};
use drivetwin_sim::record::trace::Retention;
use drivetwin_sim::rsasm::{self, Image};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use master::{Master, Step};

/// Memory for the trace, and as much for the frames of the lines.
const RING: usize = 16 << 20;

/// Bench time between two steps of the masters.
const SLICE: Duration = Duration::millis(5);

/// Longest time that passes at once. A page that was hidden does not make up for more.
const LONGEST: f64 = 0.25;

/// Longest wait of a step of a master, in seconds.
const LONGEST_WAIT: f64 = 600.0;

/// User programs that a bench file may name: there are no files here.
const PROGRAMS: [(&str, &str); 1] =
    [("speed-profile.rsasm", include_str!("../../../examples/speed-profile.rsasm"))];

/// Largest number of characters that a terminal keeps for the page.
const MOST_SHOWN: usize = 64 << 10;

/// A bench, its clock and its masters.
pub struct Site {
    bench: Bench,
    mode: TimeMode,
    viewer: Viewer,
    masters: Vec<Master>,
    terminals: Vec<Terminal>,
    last_terminal: u32,
}

/// A person's client at a port for text.
struct Terminal {
    id: u32,
    client: Client,
}

/// The answer to a call.
#[derive(Debug)]
pub struct Answer {
    /// Status of HTTP.
    pub status: u16,
    /// JSON, or a file.
    pub body: Vec<u8>,
}

impl Answer {
    fn json(value: impl serde::Serialize) -> Self {
        Self { status: 200, body: serde_json::to_vec(&value).unwrap_or_default() }
    }

    fn done() -> Self {
        Self { status: 204, body: Vec::new() }
    }

    fn refusal(status: u16, detail: &str) -> Self {
        let body = json!({"status": status, "detail": detail});
        Self { status, ..Self::json(body) }
    }
}

/// A refused call.
#[derive(Debug)]
struct Refused(u16, String);

impl From<Refusal> for Refused {
    fn from(refusal: Refusal) -> Self {
        let status = match refusal {
            Refusal::Unknown(_) => 404,
            Refusal::Invalid(_) => 422,
            Refusal::Conflict(_) => 409,
            Refusal::Away(_) => 503,
        };
        Self(status, refusal.to_string())
    }
}

/// A refusal of what the request says.
fn invalid(sentence: impl Into<String>) -> Refused {
    Refused(422, sentence.into())
}

/// A call of the page: `{"method": "PUT", "path": ["drives", "x", "power"], "body": {"action": "off"}}`.
#[derive(Deserialize)]
struct Call {
    method: String,
    path: Vec<String>,
    #[serde(default)]
    body: Value,
}

/// Steps for a master: `{"drive": "md3", "steps": [{"write": "MotionControl", "value": 1}], "poll": "Speed"}`. A step
/// `{"say": "S0E"}` is a command for a drive that takes text. The answer `{"ended": true}` says that earlier steps were not done.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Play {
    drive: String,
    #[serde(default)]
    steps: Vec<StepOfPage>,
    /// Register that is read when there is nothing else to do.
    poll: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum StepOfPage {
    Write { write: String, value: i64 },
    Read { read: String },
    Say { say: String },
    Wait { wait: f64 },
}

impl Site {
    /// A bench from the text of a bench file, in real time.
    ///
    /// # Errors
    /// The line in the text, and what is wrong there.
    pub fn new(text: &str) -> Result<Self, String> {
        let layout = bench_file::parse(text).map_err(|error| error.to_string())?;
        let ring = Retention::Ring(RING);
        let settings =
            Settings { trace: ring, capture: ring, shafts: true, outcomes: true, ..layout.settings() };
        let setups = layout.drives.iter().map(setup).collect::<Result<_, _>>()?;
        let bench = layout.build(settings, setups)?.bench;
        Ok(Self {
            bench,
            mode: TimeMode::Times(1),
            viewer: Viewer::new(None),
            masters: Vec::new(),
            terminals: Vec::new(),
            last_terminal: 0,
        })
    }

    /// Lets time pass: this many seconds for the person who looks.
    pub fn pass(&mut self, seconds: f64) {
        if let TimeMode::Times(factor) = self.mode {
            let end = self.bench.now() + span(seconds.clamp(0.0, LONGEST) * f64::from(factor));
            self.run_until(end);
        }
    }

    /// Runs the bench and its masters.
    fn run_until(&mut self, end: Instant) {
        while self.bench.now() < end {
            let next = end.min(self.bench.now() + SLICE);
            self.bench.run_until(next);
            for master in &mut self.masters {
                master.run(&mut self.bench);
            }
        }
    }

    /// Begins to follow the bench anew, with the details of a drive if it is named.
    pub fn follow(&mut self, drive: Option<String>) {
        self.viewer = Viewer::new(drive);
    }

    /// The changes since the last update, as JSON; `None` if there are none. `since_last` is the time since the last
    /// update.
    pub fn update(&mut self, since_last: WallSpan) -> Option<Vec<u8>> {
        let snapshot = Snapshot::of(&self.bench, self.mode, &Places::new(), self.viewer.look());
        let update = self.viewer.update(snapshot, since_last)?;
        serde_json::to_vec(&update).ok()
    }

    /// Answers a call of the page.
    pub fn call(&mut self, call: &[u8]) -> Answer {
        let answer = match serde_json::from_slice::<Call>(call) {
            Ok(Call { method, path, body }) => {
                let path: Vec<&str> = path.iter().map(String::as_str).collect();
                self.answer(&method, &path, body)
            }
            Err(error) => Err(Refused(400, format!("the call is not valid: {error}"))),
        };
        answer.unwrap_or_else(|Refused(status, detail)| Answer::refusal(status, &detail))
    }

    fn answer(&mut self, method: &str, path: &[&str], body: Value) -> Result<Answer, Refused> {
        let places = Places::new();
        match (method, path) {
            ("GET", ["bench"]) => Ok(Answer::json(schema::Bench::of(&self.bench, self.mode, &places))),
            ("GET", ["buses"]) => Ok(Answer::json(schema::Bus::all(&self.bench, &places))),
            ("GET", ["kinds", kind]) => {
                let device = catalog::make(kind).map_err(|sentence| Refused(404, sentence))?;
                Ok(Answer { status: 200, body: describe::json(device.spec()).into_bytes() })
            }
            ("GET", ["trace", format]) => self.trace(format),
            ("GET", ["drives", name]) => {
                let id = self.drive(name)?;
                Ok(Answer::json(schema::Drive::of_bench(&self.bench, id, &places)))
            }
            ("PUT", ["drives", name, "pins", pin]) => {
                let level: PinLevel = read(body)?;
                self.act(name, true, |drive| commands::drive_pin(drive, pin, level.into()))
            }
            ("POST", ["drives", name, "pins", pin, "pulses"]) => {
                let Pulses { count, hz, duty } = read(body)?;
                self.act(name, false, |drive| commands::pulse_pin(drive, pin, count, hz, duty.unwrap_or(0.5)))
            }
            ("POST", ["drives", name, "encoder"]) => {
                let Turn { counts, hz } = read(body)?;
                self.act(name, false, |drive| commands::encoder(drive, counts, hz))
            }
            ("PUT", ["drives", name, "registers", register]) => {
                let NewValue { value } = read(body)?;
                let value = commands::NewValue::Number(value.into());
                self.act(name, true, |drive| commands::preset(drive, register, &value))
            }
            ("PUT", ["drives", name, "faults", fault]) => {
                self.act(name, true, |drive| commands::fault(drive, fault, true))
            }
            ("DELETE", ["drives", name, "faults", fault]) => {
                self.act(name, true, |drive| commands::fault(drive, fault, false))
            }
            ("POST", ["drives", name, "power"]) => {
                let Power { action } = read(body)?;
                self.act(name, true, |drive| drive.power(action.into()))
            }
            ("POST", ["drives", name, "ports", port, "terminal"]) => self.open_terminal(name, port),
            ("GET", ["terminals", id]) => self.shown(id),
            ("POST", ["terminals", id]) => {
                let Typed { text } = read(body)?;
                let client = self.terminal(id)?;
                self.bench.send(client, text.as_bytes());
                self.settle();
                Ok(Answer::done())
            }
            ("DELETE", ["terminals", id]) => {
                let client = self.terminal(id)?;
                self.bench.disconnect(client);
                self.terminals.retain(|terminal| terminal.client != client);
                Ok(Answer::done())
            }
            ("PUT", ["buses", name, "faults"]) => self.disturb(name, &read(body)?),
            ("POST", ["scenario"]) => {
                let scenario: Scenario = read(body)?;
                let scenarios = scenario.on(&self.bench).map_err(invalid)?;
                self.bench.play_all(scenarios).map_err(|sentence| Refused(409, sentence.to_string()))?;
                Ok(Answer::done())
            }
            ("PUT", ["time"]) => {
                let Mode { mode } = read(body)?;
                let mode = mode.parse().map_err(|sentence| invalid(format!("mode: {sentence}")))?;
                self.set_mode(mode);
                Ok(Answer::json(schema::Time::new(self.mode, self.bench.now())))
            }
            ("POST", ["time", "advance"]) => self.advance(&read(body)?),
            ("POST", ["master"]) => self.play(read(body)?),
            _ => Err(Refused(404, format!("this page has no {method} {}", path.join("/")))),
        }
    }

    fn drive(&self, name: &str) -> Result<DriveId, Refused> {
        Ok(commands::drive(&self.bench, name)?)
    }

    /// Acts on a drive. With `settles`, in manual time the action has its whole effect before the next call.
    fn act(
        &mut self,
        name: &str,
        settles: bool,
        act: impl FnOnce(&mut dyn commands::Drive) -> Result<(), Refusal>,
    ) -> Result<Answer, Refused> {
        let id = self.drive(name)?;
        act(&mut OnBench::new(&mut self.bench, id))?;
        if settles {
            self.settle();
        }
        Ok(Answer::done())
    }

    /// In manual time, lets a change have its whole effect.
    fn settle(&mut self) {
        if self.mode == TimeMode::Manual {
            self.bench.run_until_idle();
        }
    }

    fn set_mode(&mut self, mode: TimeMode) {
        self.bench.set_frame_timeout(mode.frame_timeout());
        self.bench.judge_silence(mode != TimeMode::Manual);
        self.bench.forget_silence();
        self.mode = mode;
    }

    fn advance(&mut self, advance: &Advance) -> Result<Answer, Refused> {
        if self.mode != TimeMode::Manual {
            return Err(Refused(409, "the time mode is not manual".into()));
        }
        let end = match advance.span().map_err(invalid)? {
            Some(span) => self.bench.now() + span,
            None => self.bench.next(),
        };
        if end == Instant::NEVER {
            return Err(Refused(409, "nothing will happen on this bench before somebody acts".into()));
        }
        self.run_until(end);
        Ok(Answer::json(schema::Time::new(self.mode, self.bench.now())))
    }

    fn disturb(&mut self, name: &str, faults: &Faults) -> Result<Answer, Refused> {
        let outlet = commands::outlet(&self.bench, name)?;
        faults.set_on(&mut self.bench, outlet).map_err(invalid)?;
        Ok(Answer::done())
    }

    fn trace(&self, format: &str) -> Result<Answer, Refused> {
        let mut body = Vec::new();
        let written = match format {
            "trace" => self.bench.trace().write(&mut body),
            "vcd" => vcd::write(self.bench.trace(), &mut body),
            "pcapng" => pcapng::write(&self.bench, &mut body),
            _ => {
                return Err(Refused(
                    404,
                    format!("there is no format {format}; there are trace, vcd, pcapng"),
                ));
            }
        };
        written.map_err(|error| Refused(500, error.to_string()))?;
        Ok(Answer { status: 200, body })
    }

    fn open_terminal(&mut self, name: &str, port: &str) -> Result<Answer, Refused> {
        let drive = self.drive(name)?;
        let port = commands::port(self.bench.spec(drive), port)?;
        let outlet = self.bench.outlet(drive, port);
        let client = self.bench.join(outlet).map_err(|error| Refused(409, error.to_string()))?;
        self.last_terminal += 1;
        self.terminals.push(Terminal { id: self.last_terminal, client });
        Ok(Answer::json(json!({"id": self.last_terminal})))
    }

    fn terminal(&self, id: &str) -> Result<Client, Refused> {
        let of = |terminal: &&Terminal| id.parse() == Ok(terminal.id);
        let found = self.terminals.iter().find(of).map(|terminal| terminal.client);
        found.ok_or_else(|| Refused(404, format!("there is no terminal {id}")))
    }

    /// Characters that a terminal has received since the last call.
    fn shown(&mut self, id: &str) -> Result<Answer, Refused> {
        let client = self.terminal(id)?;
        let mut bytes = Vec::new();
        self.bench.receive(client, &mut bytes);
        let newest = &bytes[bytes.len().saturating_sub(MOST_SHOWN)..];
        let character =
            |&byte: &u8| if byte.is_ascii() { char::from(byte) } else { char::REPLACEMENT_CHARACTER };
        let text: String = newest.iter().map(character).collect();
        Ok(Answer::json(json!({"text": text, "ended": self.bench.ended(client).is_some()})))
    }

    /// Gives steps to the master of a drive.
    fn play(&mut self, play: Play) -> Result<Answer, Refused> {
        let drive = self.drive(&play.drive)?;
        let spec = self.bench.spec(drive);
        let row = |name: &str| Ok::<_, Refused>(commands::register(spec, name)?.row);
        let step = |step: &StepOfPage| {
            Ok::<_, Refused>(match step {
                StepOfPage::Write { write, value } => Step::Write { row: row(write)?, value: *value },
                StepOfPage::Read { read } => Step::Read { row: row(read)? },
                StepOfPage::Say { say } => Step::Say(say.clone()),
                StepOfPage::Wait { wait } => Step::Wait(span(wait.clamp(0.0, LONGEST_WAIT))),
            })
        };
        let steps = play.steps.iter().map(step).collect::<Result<Vec<_>, _>>()?;
        let poll = play.poll.as_deref().map(row).transpose()?;
        let master = match self.masters.iter().position(|master| master.drive() == drive) {
            Some(known) => &mut self.masters[known],
            None => {
                let none = || Refused(409, format!("{} takes no master", play.drive));
                let master = Master::new(&mut self.bench, drive).ok_or_else(none)?;
                self.masters.push(master);
                self.masters.last_mut().ok_or_else(|| Refused(500, "there is no master".into()))?
            }
        };
        let mut ended = false;
        if !steps.is_empty() {
            ended = master.play(&self.bench, &steps).map_err(|rest| {
                let seconds = rest.ticks().div_ceil(TICKS_PER_SECOND);
                Refused(409, format!("the master waits for the drive: {seconds} s"))
            })?;
        }
        if let Some(row) = poll {
            master.poll(&self.bench, row);
        }
        Ok(Answer::json(json!({"ended": ended})))
    }
}

/// The memory of a drive, with its user program.
fn setup(drive: &DriveLayout) -> Result<Setup, String> {
    let Some(file) = &drive.program else { return Ok(Setup::default()) };
    let (_, text) = PROGRAMS.iter().find(|(name, _)| file.as_os_str() == *name).ok_or_else(|| {
        let names = PROGRAMS.map(|(name, _)| name).join(", ");
        format!("the site has no program {}; it has {names}", file.display())
    })?;
    let program = rsasm::assemble(text).map_err(|error| format!("{}:{error}", file.display()))?;
    Ok(Setup { memory: Some(Image::of(&program).memory()), ..Setup::default() })
}

/// Reads the body of a call.
fn read<T: DeserializeOwned>(body: Value) -> Result<T, Refused> {
    serde_json::from_value(body).map_err(|error| invalid(format!("the body is not valid: {error}")))
}

/// A time of at most a day.
fn span(seconds: f64) -> Duration {
    Duration::from_ticks((seconds * TICKS_PER_SECOND as f64).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A site with an MD3, and a function that makes a call and returns its status and its body.
    fn site() -> Site {
        let text = "[[drive]]\nname = \"x\"\nkind = \"md3\"\n\n[[motor]]\nname = \"m\"\ndrive = \"x\"\n";
        Site::new(text).expect("a bench")
    }

    fn call(site: &mut Site, method: &str, path: &str, body: Value) -> (u16, Value) {
        let path: Vec<&str> = path.split('/').collect();
        let call = json!({"method": method, "path": path, "body": body});
        let Answer { status, body } = site.call(call.to_string().as_bytes());
        (status, serde_json::from_slice(&body).unwrap_or(Value::Null))
    }

    fn pass(site: &mut Site, seconds: u32) {
        for _ in 0..seconds * 50 {
            site.pass(0.02);
        }
    }

    #[test]
    fn a_master_moves_a_drive_and_its_messages_are_seen() {
        let mut site = site();
        site.follow(Some("x".into()));
        pass(&mut site, 3);
        let steps = json!([{"write": "MoveSteps", "value": 2500}, {"write": "MotionControl", "value": 1}]);
        assert_eq!(call(&mut site, "POST", "master", json!({"drive": "x", "steps": steps})).0, 200);
        pass(&mut site, 3);
        let (status, drive) = call(&mut site, "GET", "drives/x", Value::Null);
        assert_eq!((status, &drive["motion"]["position"]), (200, &json!(2500)));
        let update = site.update(WallSpan::from_secs(1)).expect("the whole state");
        let update: Value = serde_json::from_slice(&update).expect("JSON");
        assert_eq!(update["state"]["drive"]["motion"]["position"], 2500);
        let texts: Vec<&str> = update["traffic"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|frame| frame["text"].as_str())
            .collect();
        assert_eq!(
            texts,
            ["write MoveStepsHigh = 0", "write MoveStepsLow = 2500", "write MotionControl = 1"]
        );
        assert!(site.update(WallSpan::ZERO).is_none(), "nothing has changed");
    }

    /// Words of the messages since the last update.
    fn texts(site: &mut Site) -> Vec<String> {
        let update = site.update(WallSpan::from_secs(1)).expect("an update");
        let update: Value = serde_json::from_slice(&update).expect("JSON");
        let frames = update["traffic"].as_array().into_iter().flatten();
        frames.filter_map(|frame| frame["text"].as_str()).map(ToOwned::to_owned).collect()
    }

    #[test]
    fn a_master_ends_earlier_steps_or_says_for_how_long_it_waits() {
        let mut site = site();
        pass(&mut site, 3);
        site.follow(Some("x".into()));
        let play = |steps: &Value| json!({"drive": "x", "steps": steps});
        let refused = json!([{"write": "Reserved", "value": 5}]);
        let reads = json!([{"read": "MotionControl"}, {"read": "Speed"}, {"read": "MoveSteps"}]);
        assert_eq!(call(&mut site, "POST", "master", play(&reads)), (200, json!({"ended": false})));
        site.pass(0.02);
        assert_eq!(call(&mut site, "POST", "master", play(&refused)), (200, json!({"ended": true})));
        pass(&mut site, 1);
        assert_eq!(texts(&mut site), ["read MotionControl", "write Reserved = 5"]);

        // No press may end a wait, nor steps with a wait behind them: the read would never come.
        let story = json!([{"write": "UserRegister", "value": 7}, {"wait": 11}, {"read": "UserRegister"}]);
        assert_eq!(call(&mut site, "POST", "master", play(&story)).0, 200);
        for (seconds, rest) in [(0, 11), (4, 8)] {
            pass(&mut site, seconds);
            let (status, problem) = call(&mut site, "POST", "master", play(&refused));
            let sentence = format!("the master waits for the drive: {rest} s");
            assert_eq!((status, problem["detail"].as_str()), (409, Some(sentence.as_str())));
        }
        pass(&mut site, 8);
        assert_eq!(texts(&mut site), ["write UserRegister = 7", "read UserRegister"]);
        assert_eq!(call(&mut site, "POST", "master", play(&refused)), (200, json!({"ended": false})));
    }

    #[test]
    fn calls_have_the_sentences_of_the_control_api() {
        let mut site = site();
        pass(&mut site, 3);
        for (method, path, body, status, sentence) in [
            ("PUT", "drives/y/faults/stall", Value::Null, 404, "there is no drive 'y'"),
            (
                "PUT",
                "drives/x/registers/DeviceAddress",
                json!({"value": 248}),
                422,
                "DeviceAddress takes 1 to 247, not 248",
            ),
            ("POST", "time/advance", json!({"seconds": 1}), 409, "the time mode is not manual"),
            ("GET", "kinds/md4", Value::Null, 404, "md4"),
            ("GET", "trace/gif", Value::Null, 404, "there is no format gif"),
            ("DELETE", "terminals/7", Value::Null, 404, "there is no terminal 7"),
        ] {
            let (got, problem) = call(&mut site, method, path, body);
            let detail = problem["detail"].as_str().unwrap_or_default();
            assert!(got == status && detail.contains(sentence), "{method} {path}: {got} {detail}");
        }
        assert_eq!(site.call(b"nonsense").status, 400);
    }

    #[test]
    fn manual_time_stands_until_it_is_advanced() {
        let mut site = site();
        assert_eq!(call(&mut site, "PUT", "time", json!({"mode": "manual"})).0, 200);
        let (_, before) = call(&mut site, "GET", "bench", Value::Null);
        pass(&mut site, 1);
        let (_, after) = call(&mut site, "GET", "bench", Value::Null);
        assert_eq!(before["time"], after["time"]);
        let (status, time) = call(&mut site, "POST", "time/advance", json!({"seconds": 1.5}));
        assert_eq!((status, &time["seconds"]), (200, &json!(1.5)));
        let (status, time) = call(&mut site, "POST", "time/advance", json!({"to": "next"}));
        assert!(status == 200 && time["seconds"].as_f64() > Some(1.5), "{time}");
    }

    #[test]
    fn the_bench_of_the_site_runs_a_program_and_streams() {
        let mut site = Site::new(include_str!("../bench.toml")).expect("a bench");
        pass(&mut site, 3);
        for (drive, steps) in [
            ("rs434", json!([{"write": "MODE_USER_PROGRAM", "value": 2}])),
            ("qsb", json!([{"write": "IntervalRate", "value": 51}, {"say": "S0E"}])),
            ("mdrive", json!([{"write": "HC", "value": 50}, {"write": "MR", "value": 51_200}])),
        ] {
            let play = json!({"drive": drive, "steps": steps});
            assert_eq!(call(&mut site, "POST", "master", play).0, 200, "{drive}");
        }
        site.follow(Some("qsb".into()));
        pass(&mut site, 2);
        // The first speed of the program is 500 rpm, forward.
        assert_eq!(call(&mut site, "GET", "drives/rs434", Value::Null).1["motion"]["moving"], true);
        let (_, mdrive) = call(&mut site, "GET", "drives/mdrive", Value::Null);
        assert_eq!((&mdrive["registers"]["HC"], &mdrive["motion"]["position"]), (&json!(50), &json!(51_200)));
        let update = site.update(WallSpan::from_secs(1)).expect("the whole state");
        let update: Value = serde_json::from_slice(&update).expect("JSON");
        let traffic = update["traffic"].as_array().expect("traffic");
        // S0E answers once, then every 51 of 512 parts of a second.
        let streamed =
            traffic.iter().filter(|frame| frame["sent"] == true && frame["text"] == "ReadEncoder = 0");
        assert!((15..=20).contains(&streamed.count()), "{traffic:?}");
    }

    #[test]
    fn a_program_that_the_site_does_not_have_is_an_error() {
        let file = "[[drive]]\nname = \"x\"\nkind = \"rs434544\"\nprogram = \"other.rsasm\"\n";
        let sentence = Site::new(file).err().expect("an error");
        assert_eq!(sentence, "the site has no program other.rsasm; it has speed-profile.rsasm");
    }

    #[test]
    fn a_trace_of_the_page_is_a_trace() {
        let mut site = site();
        pass(&mut site, 1);
        let call = json!({"method": "GET", "path": ["trace", "trace"]}).to_string();
        assert!(site.call(call.as_bytes()).body.starts_with(b"drivetwin trace 1\n"));
    }
}
