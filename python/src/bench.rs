//! A bench on virtual time.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_host::options::{Assignment, RunOptions};
use drivetwin_host::{Configuration, Memories, Offline, OnBoard, reasons};
use drivetwin_sim::bench::{self, DriveId, Settings};
use drivetwin_sim::commands::{self, Refusal};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::has_own_motor;
use drivetwin_sim::config::preset::{Number, Preset};
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::export::plot::Options;
use drivetwin_sim::record::trace::Retention;
use drivetwin_sim::{catalog, export};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyIterator, PyList, PyString, PyTuple};

use crate::drive::Drive;
use crate::errors::{Error, NotOnBoard, refused, whole, words, wrong};
use crate::line::Line;
use crate::recording::{self, PanelView};
use crate::server::Server;
use crate::shared::{Bench, Shared, seconds, span};
use crate::tables;
use crate::views::Motor;

/// Number of bytes that a recording may have: minutes of step pulses at 40,000 steps/s, days of requests. A bench in an
/// endless loop does not fill the memory of the computer.
const RECORDING: usize = 1 << 30;

/// Settings that keep long recordings, as tests want them.
fn keeping_more(settings: Settings) -> Settings {
    let recording = Retention::Ring(RECORDING);
    Settings { trace: recording, capture: recording, shafts: true, ..settings }
}

impl Bench {
    fn of(configuration: &Configuration) -> PyResult<Self> {
        let offline = configuration.offline(keeping_more).map_err(|sentence| wrong(&sentence))?;
        Ok(Self { shared: Shared::new(offline) })
    }

    fn drive(&self, py: Python<'_>, id: DriveId) -> PyResult<Drive> {
        let (spec, name) =
            self.shared.with(py, |open| (open.bench.spec(id), open.bench.name(id).to_owned()))?;
        Ok(Drive { shared: Arc::clone(&self.shared), id, spec, name })
    }

    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.shared.with(py, |open| {
            let drives = open.bench.drives();
            drives.map(|id| open.bench.name(id).to_owned()).collect()
        })
    }

    /// Refuses what changes the ports of a bench that is served.
    fn check_no_ports(&self, method: &str) -> PyResult<()> {
        self.shared.refuse_on_board(reasons::NO_BENCH)?;
        if self.shared.server().is_none() {
            return Ok(());
        }
        Err(Error::new_err(format!(
            "{method} is not possible where ports are open already; name the drives in a bench file: drivetwin.run('bench.toml')"
        )))
    }

    /// Adds a table of a bench file.
    fn add_table(&self, py: Python<'_>, name: &str, keys: &Bound<'_, PyDict>) -> PyResult<()> {
        self.shared.refuse_on_board(reasons::NO_BENCH)?;
        let text = tables::table(name, keys)?;
        let added = self.shared.with(py, |open| tables::add(open.bench, &text).map(drop))?;
        added.map_err(|sentence| wrong(&sentence))
    }
}

/// A number as an argument.
fn number(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Number> {
    let Ok(text) = value.extract::<String>() else { return Ok(Number::Decimal(whole(name, value)?)) };
    Number::parse(&text)
        .ok_or_else(|| Error::new_err(format!("'{text}' is not a number; 8000, -5 and 0x1F40 are")))
}

/// A register's value as text, as the option `--set` takes it.
fn assigned(register: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(text) = value.extract::<String>() {
        return Ok(text);
    }
    if let Some(words) = words(register, value)? {
        return Ok(words.iter().map(ToString::to_string).collect::<Vec<_>>().join(","));
    }
    Ok(whole::<i64>(register, value)?.to_string())
}

#[pymethods]
impl Bench {
    /// An empty bench. `seed` is that of every random choice; `line` is "timed", or "fast": characters take no time.
    #[new]
    #[pyo3(signature = (*, seed = None, line = "timed"), text_signature = "(*, seed=1, line='timed')")]
    fn new(seed: Option<&Bound<'_, PyAny>>, line: &str) -> PyResult<Self> {
        let seed = seed.map_or(Ok(1), |seed| whole("seed", seed))?;
        let line = bench_file::line_mode(line).map_err(|sentence| wrong(&sentence))?;
        let settings = keeping_more(Settings { seed, line, ..Settings::default() });
        let bench = bench::Bench::with(settings);
        Ok(Self { shared: Shared::new(Offline { bench, memories: Memories::default() }) })
    }

    /// A bench from a bench file. Its ports are not opened. Paths in it are relative to its folder.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let what = path.into_os_string().into_string();
        let what = what.map_err(|path: OsString| Error::new_err(format!("{path:?} is not UTF-8")))?;
        if !what.ends_with(".toml") {
            return Err(Error::new_err(format!("'{what}' is not a bench file: its name ends in .toml")));
        }
        let options = RunOptions { what, ..RunOptions::default() };
        Self::of(&Configuration::read(options).map_err(|sentence| wrong(&sentence))?)
    }

    /// A bench from the text of a bench file. Its ports are not opened. Paths in it are relative to the current folder.
    #[staticmethod]
    fn loads(text: &str) -> PyResult<Self> {
        Self::of(&Configuration::parse(text, Path::new("")).map_err(|sentence| wrong(&sentence))?)
    }

    /// Runs `drivetwin run` with these arguments in a thread, which serves the ports of the bench.
    #[staticmethod]
    fn _run(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        Ok(Self { shared: Shared::of_run(Server::start(py, arguments)?) })
    }

    /// Runs `drivetwin attach` with these arguments in a thread, which serves the control API of a board.
    #[staticmethod]
    fn _attach(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        Ok(Self { shared: Shared::of_run(Server::attach(py, arguments)?) })
    }

    /// Makes the drive of a board a new one of this kind, with registers as `add` takes them. Returns it.
    #[pyo3(signature = (kind, address, set))]
    fn _begin_anew(
        &self,
        py: Python<'_>,
        kind: &str,
        address: Option<&Bound<'_, PyAny>>,
        set: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Drive> {
        let spec = catalog::make(kind).map_err(|sentence| wrong(&sentence))?.spec();
        let Some(board) = self.shared.board() else {
            return Err(Error::new_err("the drives of this bench are emulated; add makes new ones"));
        };
        let mut presets = Vec::new();
        if let Some(address) = address {
            let row = spec.address.and_then(|row| spec.registers.rows.get(row));
            let row = row.ok_or_else(|| wrong(&format!("address: {kind} has no bus address")))?;
            let preset = Preset::new(spec, row.name, &number("address", address)?);
            presets.push(preset.map_err(|sentence| wrong(&format!("address: {sentence}")))?);
        }
        for (register, value) in set.into_iter().flat_map(|set| set.iter()) {
            let register = register.extract::<String>()?;
            let value = assigned(&format!("set: {register}"), &value)?;
            let preset = Preset::typed(spec, &register, &value);
            presets.extend(preset.map_err(|sentence| wrong(&format!("set: {sentence}")))?);
        }
        let begun = py.detach(|| {
            if commands::Drive::spec(&board.drive()?).kind != kind {
                board.drive()?.choose(kind)?;
            }
            board.drive()?.begin_anew(&presets)
        });
        begun.map_err(|refusal| match refusal {
            Refusal::Conflict(sentence) => NotOnBoard::new_err(sentence),
            other => refused(other),
        })?;
        // A drive of another kind is on the bench a moment later.
        self.shared
            .poll(py, |open| open.bench.drives().any(|id| open.bench.spec(id).kind == kind).then_some(()))?;
        let id = self.shared.with(py, |open| open.bench.drives().next())?;
        self.drive(py, id.ok_or_else(|| Error::new_err("the board is gone"))?)
    }

    /// True if the drive of the board starts without its start-up delay.
    fn _boots_fast(&self, py: Python<'_>) -> PyResult<bool> {
        let Some(board) = self.shared.board() else { return Ok(false) };
        py.detach(|| Ok(board.drive()?.is_fast_boot())).map_err(refused)
    }

    /// Place of the board, for instance "/dev/ttyACM1 (usb:E661)"; None if the drives are emulated here.
    #[getter]
    fn board(&self) -> Option<String> {
        self.shared.board().map(OnBoard::place)
    }

    /// URL of the control API; None if there is none. `drivetwin.run` serves it.
    #[getter]
    fn control(&self) -> Option<&str> {
        self.shared.server().and_then(Server::control)
    }

    /// Time mode: "manual" if only calls and requests move the clock, "real" or "xN" if it follows the wall clock, which
    /// is possible with `drivetwin.run` only. May be set.
    #[getter]
    fn time(&self, py: Python<'_>) -> PyResult<String> {
        self.shared.with(py, |open| open.time_mode.to_string())
    }

    #[setter]
    fn set_time(&self, py: Python<'_>, mode: &str) -> PyResult<()> {
        let mode: TimeMode =
            mode.parse().map_err(|sentence| Error::new_err(format!("time: {sentence}, not '{mode}'")))?;
        if mode != TimeMode::Times(1) {
            self.shared.refuse_with_boards(reasons::NO_TIME)?;
        }
        if self.shared.server().is_none() && mode != TimeMode::Manual {
            return Err(Error::new_err(
                "a bench without ports has virtual time; drivetwin.run has one that follows the wall clock",
            ));
        }
        self.shared.with(py, |open| *open.time_mode = mode)
    }

    /// Adds a drive of a kind, for instance "md3", and switches its power on.
    ///
    /// `name` is its kind by default; `address` its bus address and `set` registers, as if saved before power-on; `fast_boot`
    /// skips the start-up delay; `nv` is the file of its non-volatile memory, and `program` that of a user program (RS
    /// drives). `motor` is a dict with the keys of a table `[[motor]]` of a bench file, for drives whose motor must be there
    /// from the start: RS, MDROBOT, MDrive.
    #[pyo3(signature = (kind, name = None, *, address = None, fast_boot = false, set = None, nv = None, program = None, motor = None))]
    #[expect(clippy::too_many_arguments, reason = "each is a keyword argument of the method")]
    fn add(
        &self,
        py: Python<'_>,
        kind: &str,
        name: Option<&str>,
        address: Option<&Bound<'_, PyAny>>,
        fast_boot: bool,
        set: Option<&Bound<'_, PyDict>>,
        nv: Option<PathBuf>,
        program: Option<PathBuf>,
        motor: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Drive> {
        self.check_no_ports("add")?;
        let spec = catalog::make(kind).map_err(|sentence| wrong(&sentence))?.spec();
        let name = name.unwrap_or(kind);
        let mut options =
            RunOptions { what: kind.to_owned(), fast_boot, nv, program, ..RunOptions::default() };
        options.address = address.map(|value| number("address", value)).transpose()?;
        for (register, value) in set.into_iter().flat_map(|set| set.iter()) {
            let register = register.extract::<String>()?;
            let value = assigned(&format!("set: {register}"), &value)?;
            Preset::typed(spec, &register, &value).map_err(|sentence| wrong(&format!("set: {sentence}")))?;
            options.set.push(Assignment { register, value });
        }
        let motor = match motor {
            None => String::new(),
            Some(keys) => {
                let keys = keys.copy()?;
                keys.set_item("drive", name)?;
                if !keys.contains("name")? {
                    keys.set_item("name", self.free_motor_name(py)?)?;
                }
                tables::table("motor", &keys)?
            }
        };
        let added = self.shared.with(py, |open| {
            let (id, memories) = Configuration::read(options)?.add_to(open.bench, name, &motor)?;
            open.memories.extend(memories);
            Ok::<_, String>(id)
        })?;
        self.drive(py, added.map_err(|sentence| wrong(&sentence))?)
    }

    /// The drive with that name.
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<Drive> {
        let found = self.shared.with(py, |open| commands::drive(open.bench, name))?;
        self.drive(py, found.map_err(refused)?)
    }

    fn __contains__(&self, py: Python<'_>, name: &str) -> PyResult<bool> {
        self.shared.with(py, |open| open.bench.find_drive(name).is_some())
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.shared.with(py, |open| open.bench.drives().len())
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyList::new(py, self.names(py)?)?.try_iter()
    }

    /// The names of the drives, in the order in which they were added.
    fn keys(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.names(py)
    }

    /// The drives, in the order in which they were added.
    fn values(&self, py: Python<'_>) -> PyResult<Vec<Drive>> {
        let ids = self.shared.with(py, |open| open.bench.drives())?;
        ids.map(|id| self.drive(py, id)).collect()
    }

    /// Bench time in seconds.
    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<f64> {
        if let Some(board) = self.shared.board() {
            return py.detach(|| board.drive()?.now()).map(seconds).map_err(refused);
        }
        self.shared.with(py, |open| seconds(open.bench.now()))
    }

    /// Lets that many seconds of bench time pass, at once. Other threads run meanwhile, and Ctrl-C interrupts.
    fn advance(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let span = span("advance", seconds)?;
        self.shared.refuse_with_boards(reasons::NO_TIME)?;
        let until = self.shared.with(py, |open| open.bench.now() + span)?;
        self.shared.run(py, until)
    }

    /// Lets that many seconds pass: at once, as `advance` does, and where the clock follows the wall clock, or on a board,
    /// really. A test that calls `wait` runs on both.
    fn wait(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        self.shared.wait(py, span("wait", seconds)?)
    }

    /// Lets bench time pass until `seconds`, at once, as `advance` does. Time does not go back.
    fn run_until(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let until = Instant::ZERO + span("run_until", seconds)?;
        self.shared.refuse_with_boards(reasons::NO_TIME)?;
        let now = self.shared.with(py, |open| open.bench.now())?;
        if until < now {
            let now = crate::shared::seconds(now);
            return Err(Error::new_err(format!("{seconds} s have passed already: the bench is at {now} s")));
        }
        self.shared.run(py, until)
    }

    /// The line or TCP port with that name: the name of a bus of a bench file, or "DRIVE.PORT".
    fn line(&self, py: Python<'_>, name: &str) -> PyResult<Line> {
        let found = self.shared.with(py, |open| commands::outlet(open.bench, name))?;
        let outlet = found.map_err(refused)?;
        for drive in self.shared.with(py, |open| open.bench.drives_at(outlet))? {
            self.shared.refuse_on_board_of(drive, reasons::NO_LINE_FAULTS)?;
        }
        Ok(Line::new(Arc::clone(&self.shared), outlet))
    }

    /// Connects the serial ports of several drives to one line: a table `[[bus]]` of a bench file.
    #[pyo3(signature = (name, drives, **keys))]
    fn bus(
        &self,
        py: Python<'_>,
        name: &str,
        drives: &Bound<'_, PyAny>,
        keys: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Line> {
        self.check_no_ports("bus")?;
        let table = copy(py, keys)?;
        table.set_item("name", name)?;
        if drives.is_instance_of::<PyString>() {
            return Err(PyTypeError::new_err("bus takes a list of drives or names, not a string"));
        }
        let names = drives.try_iter()?.map(|drive| self.drive_name(&drive?));
        table.set_item("drives", names.collect::<PyResult<Vec<String>>>()?)?;
        self.add_table(py, "bus", &table)?;
        self.line(py, name)
    }

    /// Attaches a motor to a drive: a table `[[motor]]` of a bench file. Its name is by default "m", the next one "m2". The motor of an RS,
    /// MDROBOT or MDrive must be there from the start: see `add`.
    #[pyo3(signature = (drive, name = None, **keys))]
    fn motor(
        &self,
        py: Python<'_>,
        drive: &Bound<'_, PyAny>,
        name: Option<String>,
        keys: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Motor> {
        let name = name.map_or_else(|| self.free_motor_name(py), Ok)?;
        let table = copy(py, keys)?;
        let drive = self.drive_name(drive)?;
        table.set_item("name", &name)?;
        table.set_item("drive", &drive)?;
        if let Some(kind) = self.kind_with_own_motor(py, &drive)? {
            return Err(Error::new_err(format!(
                "the motor of {kind} must be there from the start: bench.add('{kind}', motor={{...}}), or a bench file"
            )));
        }
        self.add_table(py, "motor", &table)?;
        self.motors(py)?.remove(&name).ok_or_else(|| Error::new_err(format!("there is no motor '{name}'")))
    }

    /// The motors at this instant, by name.
    #[getter]
    fn motors(&self, py: Python<'_>) -> PyResult<HashMap<String, Motor>> {
        self.shared.with(py, |open| {
            let motors = open.bench.motors().map(|motor| Motor::of(open.bench, motor));
            motors.map(|motor| (motor.name.clone(), motor)).collect()
        })
    }

    /// Puts an encoder on the shaft of a motor: a table `[[encoder]]` of a bench file.
    fn encoder(
        &self,
        py: Python<'_>,
        motor: &str,
        cycles_per_rev: &Bound<'_, PyAny>,
        to: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let table = PyDict::new(py);
        table.set_item("motor", motor)?;
        table.set_item("cycles_per_rev", cycles_per_rev)?;
        table.set_item("to", to)?;
        self.add_table(py, "encoder", &table)
    }

    /// Puts a switch on the shaft of a motor, which pulls a pin to ground within a range of positions: a table `[[switch]]` of
    /// a bench file, for instance `closed={"below_rev": -2.0}, to="x.J2.2"`.
    fn switch(
        &self,
        py: Python<'_>,
        motor: &str,
        closed: &Bound<'_, PyAny>,
        to: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let table = PyDict::new(py);
        table.set_item("motor", motor)?;
        table.set_item("closed", closed)?;
        table.set_item("to", to)?;
        self.add_table(py, "switch", &table)
    }

    /// Connects an output pin to an input pin, for instance `wire("a.STEP", "b.J2.4")`.
    fn wire(&self, py: Python<'_>, from_pin: &str, to: &str) -> PyResult<()> {
        let table = PyDict::new(py);
        table.set_item("from", from_pin)?;
        table.set_item("to", to)?;
        self.add_table(py, "wire", &table)
    }

    /// Plays a scenario: the steps of a table `[[scenario]]` of a bench file, for instance
    /// `[{"at_s": 0.5, "drive": "x", "fault": "over_temperature"}]`.
    fn scenario(&self, py: Python<'_>, steps: &Bound<'_, PyAny>) -> PyResult<()> {
        self.shared.refuse_on_board(reasons::NO_SCENARIO)?;
        let table = PyDict::new(py);
        table.set_item("steps", steps)?;
        let text = tables::table("scenario", &table)?;
        let played = self.shared.with(py, |open| tables::play(open.bench, &text))?;
        played.map_err(|sentence| wrong(&sentence))
    }

    /// Motion of a drive's first axis since it was added: a list of (seconds, position in steps or counts, speed per second),
    /// or, where numpy is installed, a structured array with the fields "at", "position" and "speed".
    ///
    /// The values are exact. There is a sample at each begin and end of an acceleration and at each command, between them one
    /// each `every` seconds while the axis moves, and two at an instant where the speed jumps. The motion of a motor of an
    /// RS or MDROBOT is as it was simulated, each 1 to 10 ms.
    #[pyo3(signature = (drive, every = 0.001))]
    fn history<'py>(
        &self,
        py: Python<'py>,
        drive: &Bound<'_, PyAny>,
        every: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let drive = self.__getitem__(py, &self.drive_name(drive)?)?;
        if drive.spec.axes.is_empty() {
            return Err(Error::new_err(format!(
                "{} moves nothing: {} has no axis",
                drive.name, drive.spec.kind
            )));
        }
        let span = span("every", every)?;
        self.shared.catch_up(py)?;
        if span < Duration::micros(1) {
            return Err(Error::new_err(format!("every takes at least 0.000001 s, not {every}")));
        }
        let motion = self.shared.with_detached(py, |open| recording::motion(open.bench, drive.id, span))?;
        let motion = motion.ok_or_else(|| {
            Error::new_err(format!(
                "the history has more than {} samples; take a greater every",
                recording::MOST
            ))
        })?;
        let fields = vec![("at", "=f8"), ("position", "=i4"), ("speed", "=f8")];
        recording::rows(py, motion, fields, |(at, position, speed), bytes| {
            bytes.extend(at.to_ne_bytes());
            bytes.extend(position.to_ne_bytes());
            bytes.extend(speed.to_ne_bytes());
        })
    }

    /// A matplotlib figure of what happened: position, speed, frames and pins of the drives over time, as far as they
    /// change. `drives` are drives or names, all by default; `start` and `end` are in seconds. Frames have the colour and
    /// sign of their outcome. Needs matplotlib: `pip install 'drivetwin[plot]'`.
    #[pyo3(signature = (*drives, start = None, end = None, title = None))]
    fn plot<'py>(
        slf: &Bound<'py, Self>,
        drives: &Bound<'_, PyTuple>,
        start: Option<f64>,
        end: Option<f64>,
        title: Option<&str>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let names =
            drives.iter().map(|drive| slf.get().drive_name(&drive)).collect::<PyResult<Vec<String>>>()?;
        slf.py().import("drivetwin._plot")?.call_method1("plot", (slf, names, start, end, title))
    }

    /// The tracks of a picture, for `plot`.
    fn _tracks(
        &self,
        py: Python<'_>,
        drives: Vec<String>,
        start: Option<f64>,
        end: Option<f64>,
    ) -> PyResult<Vec<PanelView>> {
        for (name, seconds) in [("start", start), ("end", end)] {
            seconds.map(|seconds| span(name, seconds)).transpose()?;
        }
        let options = Options { drives, from: start, to: end, ..Options::default() };
        self.shared.catch_up(py)?;
        let trace = self.shared.with_detached(py, |open| recording::copy(open.bench))?;
        recording::panels(py, &trace, &options)
    }

    /// The recording so far, as text for `drivetwin replay`.
    fn trace(&self, py: Python<'_>) -> PyResult<String> {
        self.shared.catch_up(py)?;
        self.shared.with_detached(py, |open| open.bench.trace().to_text())
    }

    /// The waveforms of pins, motion and messages so far (VCD, for GTKWave), at most 256 MiB of them: a minute of fast step
    /// pulses.
    fn vcd<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.shared.catch_up(py)?;
        let trace = self.shared.with_detached(py, |open| open.bench.trace().clone())?;
        Ok(PyBytes::new(py, &recording::vcd(py, &trace)?))
    }

    /// All frames on the bench's lines and TCP ports up to now (pcapng, for Wireshark).
    fn pcapng<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.shared.catch_up(py)?;
        let bytes = self.shared.with_detached(py, |open| {
            let mut bytes = Vec::new();
            export::pcapng::write(open.bench, &mut bytes).map(|()| bytes)
        })?;
        Ok(PyBytes::new(py, &bytes?))
    }

    /// Ends the bench and completes the files of memories. A later call of the bench or of its drives raises.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.shared.close(py)
    }

    /// True if the bench is closed.
    #[getter]
    fn closed(&self, py: Python<'_>) -> PyResult<bool> {
        self.shared.is_closed(py)
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_raised))]
    fn __exit__(&self, py: Python<'_>, _raised: &Bound<'_, PyAny>) -> PyResult<()> {
        self.close(py)
    }

    fn __eq__(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.shared, &other.shared)
    }

    fn __hash__(&self) -> isize {
        // The address is that of the bench as long as an object of it lives.
        Arc::as_ptr(&self.shared).addr().cast_signed()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        if self.shared.is_closed(py)? {
            return Ok("<Bench, closed>".to_owned());
        }
        let (now, drives) = self.shared.with(py, |open| (open.bench.now(), open.bench.drives().len()))?;
        Ok(format!("<Bench at {} s with {drives} drives>", seconds(now)))
    }
}

impl Bench {
    /// The name of a drive of this bench that is given as itself or by its name.
    fn drive_name(&self, drive: &Bound<'_, PyAny>) -> PyResult<String> {
        let Ok(drive) = drive.cast::<Drive>() else { return drive.extract() };
        let drive = drive.get();
        if !Arc::ptr_eq(&drive.shared, &self.shared) {
            return Err(Error::new_err(format!("{} is a drive of another bench", drive.name)));
        }
        Ok(drive.name.clone())
    }

    /// A name for a motor that has none: "m", "m2" and so on.
    fn free_motor_name(&self, py: Python<'_>) -> PyResult<String> {
        let is_free = |name: &String| self.shared.with(py, |open| !open.bench.is_taken(name));
        let mut name = "m".to_owned();
        for number in 2.. {
            if is_free(&name)? {
                break;
            }
            name = format!("m{number}");
        }
        Ok(name)
    }

    /// The kind of a drive whose motor must be there from the start.
    fn kind_with_own_motor(&self, py: Python<'_>, drive: &str) -> PyResult<Option<&'static str>> {
        self.shared.with(py, |open| {
            let spec = open.bench.spec(open.bench.find_drive(drive)?);
            has_own_motor(spec).then_some(spec.kind)
        })
    }
}

/// A copy of keyword arguments.
fn copy<'py>(py: Python<'py>, keys: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyDict>> {
    keys.map_or_else(|| Ok(PyDict::new(py)), |keys| keys.copy())
}
