//! Conversion of traces from text and to text.

use std::fmt::{self, Write as _};
use std::io;
use std::sync::Arc;

use drivetwin_firmware::device::{
    Axis, Encoder, Fault, Framing, Instant, Level, Line, Link, Pin, PinSpec, Port, PortSpec, Rotation, Spec,
};
use drivetwin_firmware::motor::Parameters;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::time::Duration;

use super::{
    Course, Cut, Entry, Event, Group, InputRecord, Leg, Make, OutputRecord, Power, Retention, Trace,
    TraceDrive,
};

/// Version of the format.
const VERSION: &str = "1";
/// First word of a trace.
const PROJECT: &str = "drivetwin";
/// First word of traces that are older than the present name of the project.
const FORMER_PROJECT: &str = "standin";

/// Maximum number of bytes in a `memory` line.
const MEMORY_ROW: usize = 16;

/// First error in the text of a trace, with its line number.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ParseError {
    /// Line number of the error, from 1.
    pub line: usize,
    /// The error in one sentence.
    pub what: String,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.what)
    }
}

impl std::error::Error for ParseError {}

/// The complete text lines of a file, and true if an incomplete last line was omitted. A program that is
/// killed while it writes leaves such a line. An `end` is complete without a line feed, too.
#[must_use]
pub fn whole_lines(file: &[u8]) -> (&[u8], bool) {
    let whole = file.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    match file.split_at(whole) {
        (_, last) if last.is_empty() || last.ends_with(b" end") => (file, false),
        (lines, _) => (lines, true),
    }
}

impl Trace {
    /// Reads a trace. `make` makes a drive of a kind.
    ///
    /// # Errors
    /// The error, with its line number.
    pub fn parse(text: &str, make: &Make<'_>) -> Result<Self, ParseError> {
        let mut reader = Reader::new();
        for (index, line) in text.lines().enumerate() {
            let line_number = index + 1;
            reader.line(line, line_number, make).map_err(|what| ParseError { line: line_number, what })?;
        }
        if !reader.begun {
            return Err(ParseError {
                line: 1,
                what: format!("a trace begins with \"{PROJECT} trace {VERSION}\""),
            });
        }
        Ok(reader.finish())
    }

    /// The trace as text, including the header. Drives are sorted by name, events by timestamp.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = self.header();
        for entry in self.in_order() {
            line(&mut text, format_args!("{}", self.entry_text(entry)));
        }
        line(&mut text, format_args!("{}", self.end_text()));
        text
    }

    /// Writes the text of [`to_text`](Self::to_text), line by line.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn write(&self, to: &mut dyn io::Write) -> io::Result<()> {
        to.write_all(self.header().as_bytes())?;
        for entry in self.in_order() {
            writeln!(to, "{}", self.entry_text(entry))?;
        }
        writeln!(to, "{}", self.end_text())
    }

    /// The last line of the text.
    pub(super) fn end_text(&self) -> String {
        format!("{} end", stamp(self.end))
    }

    /// Indices of the drives, sorted by name.
    fn by_name(&self) -> Vec<usize> {
        let mut drives: Vec<usize> = (0..self.drives.len()).collect();
        drives.sort_by(|&a, &b| self.drives[a].name.cmp(&self.drives[b].name));
        drives
    }

    /// The header: all lines before the first event.
    pub(super) fn header(&self) -> String {
        let mut text = format!("{PROJECT} trace {VERSION}\nseed {}\n", self.seed);
        for drive in self.by_name().iter().map(|&index| &self.drives[index]) {
            let fast = if drive.boot_fast { " fast" } else { "" };
            let apart = if drive.external_motor { " apart" } else { "" };
            let elsewhere = if drive.elsewhere { " elsewhere" } else { "" };
            let untimed = if drive.fast_line { " untimed" } else { "" };
            let from = match drive.from {
                Instant::ZERO => String::new(),
                later => format!(" from {}", stamp(later)),
            };
            line(
                &mut text,
                format_args!(
                    "drive {} {}{fast}{apart}{elsewhere}{untimed}{from}",
                    drive.name, drive.spec.kind
                ),
            );
            for (row, bytes) in drive.memory.chunks(MEMORY_ROW).enumerate() {
                if bytes.iter().any(|&byte| byte != 0xFF) {
                    let offset = row * MEMORY_ROW;
                    line(&mut text, format_args!("memory {} 0x{offset:04X}{}", drive.name, hex(bytes)));
                }
            }
        }
        if self.compare.len() < Group::ALL.len() {
            let names: Vec<&str> = self.compare.iter().map(|group| group.name()).collect();
            line(&mut text, format_args!("compare {}", names.join(" ")));
        }
        if self.lost > 0 {
            line(&mut text, format_args!("lost {}", self.lost));
        }
        text
    }

    /// The events in the order of the text: by timestamp, then by drive. The timestamp of an output may be
    /// later than its recording.
    fn in_order(&self) -> Vec<&Entry> {
        let mut rank = vec![0; self.drives.len()];
        for (position, index) in self.by_name().into_iter().enumerate() {
            rank[index] = position;
        }
        let mut events: Vec<&Entry> = self.events.iter().filter(|entry| entry.is_text()).collect();
        events.sort_by_key(|entry| (entry.at, rank.get(entry.drive)));
        events
    }

    /// An event as a line of the text.
    pub(crate) fn entry_text(&self, entry: &Entry) -> String {
        let Some(drive) = self.drives.get(entry.drive) else { return String::new() };
        let name = if self.drives.len() > 1 { format!(" {}", drive.name) } else { String::new() };
        if let Event::Missing { .. } = entry.event {
            return format!("# {}{name}: {}", stamp(entry.at), self.words(entry));
        }
        let sign = match entry.event {
            Event::Input(_) => '>',
            _ => '<',
        };
        format!("{}{name} {sign} {}", stamp(entry.at), self.words(entry))
    }

    /// The words of an event in a line of text: `rx 01 03`; empty if the text does not contain the event.
    #[must_use]
    pub fn words(&self, entry: &Entry) -> String {
        let Some(drive) = self.drives.get(entry.drive) else { return String::new() };
        match &entry.event {
            Event::Input(input) => fed_text(drive.spec, input),
            Event::Output(output) => did_text(drive.spec, entry.at, output),
            Event::Shaft { .. } | Event::Received(_) => String::new(),
            Event::Missing { events: None } => "events may be missing here".to_owned(),
            Event::Missing { events: Some(1) } => "an event is missing here".to_owned(),
            Event::Missing { events: Some(events) } => format!("{events} events are missing here"),
        }
    }
}

impl Entry {
    /// Returns true if the text of a trace contains the event.
    #[must_use]
    pub fn is_text(&self) -> bool {
        !matches!(self.event, Event::Shaft { .. } | Event::Received(_))
    }
}

/// Appends a text line.
fn line(text: &mut String, content: fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{content}");
}

/// A time in milliseconds.
fn stamp(at: Instant) -> String {
    millis(at.ticks())
}

/// Ticks in milliseconds with six decimals, that is, to the nanosecond.
fn millis(ticks: u64) -> String {
    // A tick is 62.5 ns.
    let nanos = (u128::from(ticks) * 125).div_ceil(2);
    format!("{}.{:06}", nanos / 1_000_000, nanos % 1_000_000)
}

/// Nearest number of ticks to a time in milliseconds; `None` if the text is not a number with up to six
/// decimals.
fn ticks(text: &str) -> Option<u64> {
    let (whole, part) = text.split_once('.').unwrap_or((text, "0"));
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(whole) || !digits(part) || part.len() > 6 {
        return None;
    }
    let millis: u64 = whole.parse().ok()?;
    let nanos = part.parse::<u32>().ok()? * 10_u32.pow(6 - part.len() as u32);
    u64::try_from(((u128::from(millis) * 1_000_000 + u128::from(nanos)) * 2 + 62) / 125).ok()
}

/// Bytes in hex, a space before each.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, " {byte:02X}");
        text
    })
}

/// Bytes in the form that suits the port: text between quotes if characters end a message there, otherwise
/// hex.
fn payload(port: Option<&PortSpec>, bytes: &[u8]) -> String {
    let spoken = port.is_some_and(|port| matches!(port.framing, Framing::Character | Framing::Return));
    let plain = |&byte: &u8| byte == b'\r' || byte == b'\n' || (b' '..=b'~').contains(&byte);
    if !spoken || bytes.is_empty() || !bytes.iter().all(plain) {
        return hex(bytes);
    }
    let mut text = String::from(" \"");
    for &byte in bytes {
        match byte {
            b'\r' => text.push_str("\\r"),
            b'\n' => text.push_str("\\n"),
            b'"' | b'\\' => text.extend(['\\', char::from(byte)]),
            _ => text.push(char::from(byte)),
        }
    }
    text.push('"');
    text
}

/// A word about a port, with the name of the port after a colon unless it is the first port.
fn at_port(spec: &Spec, word: &str, port: Port) -> String {
    match spec.ports.get(usize::from(port.0)) {
        Some(named) if port.0 > 0 => format!("{word}:{}", named.name),
        _ => word.to_owned(),
    }
}

fn port_of(spec: &'static Spec, port: Port) -> Option<&'static PortSpec> {
    spec.ports.get(usize::from(port.0))
}

fn pin_name(spec: &Spec, pin: Pin) -> &'static str {
    spec.pins.get(usize::from(pin.0)).map_or("?", |pin| pin.name)
}

fn axis_name(spec: &Spec, axis: Axis) -> &'static str {
    spec.axes.get(usize::from(axis.0)).map_or("?", |axis| axis.name)
}

fn high_low(high: bool) -> &'static str {
    if high { "high" } else { "low" }
}

fn on_off(on: bool) -> &'static str {
    if on { "on" } else { "off" }
}

/// Text of an input.
fn fed_text(spec: &'static Spec, input: &InputRecord) -> String {
    match input {
        InputRecord::Power(Power::On) => "power on".to_owned(),
        InputRecord::Power(Power::Off) => "power off".to_owned(),
        InputRecord::Power(Power::Cut(None)) => "power cut".to_owned(),
        InputRecord::Power(Power::Cut(Some(cut))) => format!("power cut {} {}", cut.stores, cut.bytes),
        InputRecord::Fault { fault, on } => {
            let name = spec.faults.get(usize::from(fault.0)).copied().unwrap_or("?");
            format!("fault {name} {}", on_off(*on))
        }
        InputRecord::Edge { pin, high } => format!("pin {} {}", pin_name(spec, *pin), high_low(*high)),
        InputRecord::Open { pin } => format!("pin {} open", pin_name(spec, *pin)),
        InputRecord::Millivolts { pin, mv } => format!("millivolts {} {mv}", pin_name(spec, *pin)),
        InputRecord::Count { encoder, steps, a, b } => {
            format!("count {} {steps} {} {}", encoder.0, high_low(*a), high_low(*b))
        }
        InputRecord::StepsCorrection { axis, steps } => format!("slipped {} {steps}", axis_name(spec, *axis)),
        InputRecord::MotorCurrent { axis, ma } => format!("draws {} {ma}", axis_name(spec, *axis)),
        InputRecord::Motor { axis, parameters } => {
            format!("motor {} {}", axis_name(spec, *axis), motor(parameters))
        }
        InputRecord::Rotation { axis, rotation: Rotation { angle, speed, acceleration } } => {
            format!("rotation {} {angle} {speed} {acceleration}", axis_name(spec, *axis))
        }
        InputRecord::Bytes { port, bytes } => {
            format!("{}{}", at_port(spec, "rx", *port), payload(port_of(spec, *port), bytes))
        }
        InputRecord::RxError { port } => at_port(spec, "spoiled", *port),
        InputRecord::Idle { port } => at_port(spec, "idle", *port),
        InputRecord::HostPresence { port, here } => {
            format!("{} {}", at_port(spec, "attached", *port), on_off(*here))
        }
        InputRecord::Opened { port, link } => format!("{} {}", at_port(spec, "opened", *port), link.0),
        InputRecord::Message { port, link, bytes } => {
            let word = at_port(spec, "message", *port);
            format!("{word} {}{}", link.0, payload(port_of(spec, *port), bytes))
        }
        InputRecord::Closed { port, link } => format!("{} {}", at_port(spec, "closed", *port), link.0),
        InputRecord::Poke { row, value } => {
            let name = spec.registers.rows.get(*row).map_or("?", |row| row.name);
            format!("poke {name} {value}")
        }
    }
}

/// Text of an output at `at`.
fn did_text(spec: &'static Spec, at: Instant, output: &OutputRecord) -> String {
    match output {
        OutputRecord::Bytes { port, bytes } => {
            format!("{}{}", at_port(spec, "tx", *port), payload(port_of(spec, *port), bytes))
        }
        OutputRecord::Message { port, link, bytes } => {
            let word = at_port(spec, "message", *port);
            format!("{word} {}{}", link.0, payload(port_of(spec, *port), bytes))
        }
        OutputRecord::Close { port, link } => format!("{} {}", at_port(spec, "close", *port), link.0),
        OutputRecord::Line { port, line } => format!("{} {line}", at_port(spec, "line", *port)),
        OutputRecord::Level { pin, level } => {
            let level = match level {
                Level::Low => "low",
                Level::High => "high",
                Level::Float => "float",
            };
            format!("pin {} {level}", pin_name(spec, *pin))
        }
        OutputRecord::Wave { pin, period, high } => {
            format!("wave {} {} of {}", pin_name(spec, *pin), millis(high.ticks()), millis(period.ticks()))
        }
        OutputRecord::Plan { axis, plan } => course_text(spec, *axis, &Course::of(plan, at)),
        OutputRecord::Course { axis, course } => course_text(spec, *axis, course),
        OutputRecord::Step { axis, steps } => format!("step {} {steps}", axis_name(spec, *axis)),
        OutputRecord::CurrentLimit { axis, ma } => format!("current {} {ma}", axis_name(spec, *axis)),
        OutputRecord::Duty { axis, duty } => format!("duty {} {duty}", axis_name(spec, *axis)),
        OutputRecord::Store { offset, bytes } => format!("store 0x{offset:04X}{}", hex(bytes)),
        OutputRecord::PowerOff => "power off".to_owned(),
    }
}

fn course_text(spec: &Spec, axis: Axis, course: &Course) -> String {
    let mut text = format!("plan {} {}", axis_name(spec, axis), course.from);
    for leg in &course.legs {
        let time = if leg.time == Duration::FOREVER { "ever".to_owned() } else { millis(leg.time.ticks()) };
        let _ = write!(text, " {time}@{}", thousandths(leg.speed));
    }
    if let (Some(to), false) = (course.to, course.legs.is_empty()) {
        let _ = write!(text, " {to}");
    }
    text
}

/// Thousandths as a decimal number without trailing zeros.
fn thousandths(value: i64) -> String {
    let (sign, size) = (if value < 0 { "-" } else { "" }, value.unsigned_abs());
    let text = format!("{sign}{}.{:03}", size / 1_000, size % 1_000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// State of reading a text.
struct Reader {
    trace: Trace,
    /// True after the line with the version.
    begun: bool,
    /// Last timestamp of an input.
    last_input: Instant,
    /// Last timestamp of any event.
    last: Instant,
}

impl Reader {
    fn new() -> Self {
        let trace = Trace { ended: false, ..Trace::new(1, Retention::All) };
        Self { trace, begun: false, last_input: Instant::ZERO, last: Instant::ZERO }
    }

    /// Returns the trace. Without `end`, the trace ends at its last timestamp. With `end`, outputs with later
    /// timestamps were already scheduled then.
    fn finish(mut self) -> Trace {
        if !self.trace.ended {
            self.trace.end = self.last;
        }
        self.trace
    }

    fn line(&mut self, text: &str, line: usize, make: &Make<'_>) -> Result<(), String> {
        let mut words = Words { rest: without_comment(text).trim() };
        if words.rest.is_empty() {
            return Ok(());
        }
        if !self.begun {
            self.begun = true;
            return match (words.next(), words.next(), words.next()) {
                (PROJECT | FORMER_PROJECT, "trace", VERSION) => words.end(),
                (PROJECT | FORMER_PROJECT, "trace", other) => {
                    Err(format!("version \"{other}\" of the format is not known, only {VERSION}"))
                }
                _ => Err(format!("a trace begins with \"{PROJECT} trace {VERSION}\"")),
            };
        }
        if words.rest.starts_with(|c: char| c.is_ascii_digit()) {
            self.event(&mut words, line)
        } else if self.trace.events.is_empty() {
            self.header(&mut words, make)
        } else {
            Err(format!("\"{}\" is not a time stamp in milliseconds", words.next()))
        }
    }

    fn header(&mut self, words: &mut Words<'_>, make: &Make<'_>) -> Result<(), String> {
        match words.next() {
            "seed" => self.trace.seed = words.number("a seed")?,
            "lost" => self.trace.lost = words.number("a number of events")?,
            "compare" => {
                self.trace.compare.clear();
                while let Some(name) = words.more() {
                    let group = Group::ALL.into_iter().find(|group| group.name() == name);
                    self.trace.compare.push(group.ok_or_else(|| {
                        format!("\"{name}\" cannot be compared: {}", known(Group::ALL.map(Group::name)))
                    })?);
                }
            }
            "drive" => self.drive(words, make)?,
            "memory" => {
                let name = words.next();
                let drives = &mut self.trace.drives;
                let drive = drives.iter_mut().find(|drive| drive.name == name);
                let drive = drive.ok_or_else(|| format!("there is no drive \"{name}\" above this line"))?;
                let offset = words.address()?;
                let bytes = words.bytes()?;
                let target = Arc::make_mut(&mut drive.memory).get_mut(offset..offset + bytes.len());
                let size = drive.spec.memory;
                target
                    .ok_or_else(|| format!("the memory of {name} has {size} bytes"))?
                    .copy_from_slice(&bytes);
            }
            word => {
                let words = ["seed", "drive", "memory", "compare", "lost"];
                return Err(format!(
                    "\"{word}\" is not known here: {}, or a stamp in milliseconds",
                    known(words)
                ));
            }
        }
        words.end()
    }

    fn drive(&mut self, words: &mut Words<'_>, make: &Make<'_>) -> Result<(), String> {
        let (name, kind) = (words.next().to_owned(), words.next());
        if !is_name(&name) {
            return Err(format!("\"{name}\" is not a valid name for a drive"));
        }
        if self.trace.drives.iter().any(|drive| drive.name == name) {
            return Err(format!("two drives have the name {name}"));
        }
        let device = make(kind).ok_or_else(|| format!("there is no kind \"{kind}\""))?;
        let spec = device.spec();
        let mut drive = TraceDrive {
            name,
            spec,
            boot_fast: false,
            fast_line: false,
            external_motor: false,
            elsewhere: false,
            turns_motor: device.internal_motor().is_some(),
            from: Instant::ZERO,
            memory: vec![0xFF; usize::from(spec.memory)].into(),
        };
        while let Some(word) = words.more() {
            match word {
                "fast" => drive.boot_fast = true,
                "apart" => drive.external_motor = true,
                "elsewhere" => drive.elsewhere = true,
                "untimed" => drive.fast_line = true,
                "from" => drive.from = Instant::from_ticks(words.millis()?),
                _ => {
                    let words = ["fast", "apart", "elsewhere", "untimed", "from"];
                    return Err(format!("\"{word}\" is not known here: {}", known(words)));
                }
            }
        }
        self.trace.drives.push(drive);
        Ok(())
    }

    fn event(&mut self, words: &mut Words<'_>, line: usize) -> Result<(), String> {
        let at = Instant::from_ticks(words.millis()?);
        let mut word = words.next();
        let drives = &self.trace.drives;
        let named = drives.iter().position(|drive| drive.name == word);
        if named.is_some() {
            word = words.next();
        }
        if word == "end" && named.is_none() {
            if at < self.last_input {
                return Err("\"end\" is earlier than the line before it".to_owned());
            }
            self.trace.end = self.trace.end.max(at);
            self.trace.ended = true;
            return words.end();
        }
        let drive = match (named, drives.len()) {
            (Some(drive), _) => drive,
            (None, 1) => 0,
            (None, 0) => {
                return Err("there is no drive above this line; begin with \"drive NAME KIND\"".to_owned());
            }
            (None, _) => return Err(format!("\"{word}\" is not a drive of this trace")),
        };
        let spec = drives[drive].spec;
        let event = match word {
            ">" => {
                if at < self.last_input || at < drives[drive].from {
                    return Err(
                        "inputs must be in the order of their stamps, and not before their drive is added"
                            .to_owned(),
                    );
                }
                self.last_input = at;
                self.trace.end = self.trace.end.max(at);
                Event::Input(input(spec, words)?)
            }
            "<" => Event::Output(output(spec, words)?),
            _ => return Err(format!("after the stamp comes \">\", \"<\" or \"end\", not \"{word}\"")),
        };
        words.end()?;
        self.last = self.last.max(at);
        self.trace.events.push_back(Entry { at, drive, event, line });
        Ok(())
    }
}

/// Returns true if a drive can have that name. A name has no dots, because a dot separates it from the name
/// of a pin or line of the drive.
pub(crate) fn is_name(name: &str) -> bool {
    let reserved = |first: char| first.is_ascii_digit() || "#<>\"".contains(first);
    let separators = |char: char| char == '.' || char.is_whitespace();
    !name.is_empty() && !name.starts_with(reserved) && !name.contains(separators) && name != "end"
}

/// Parses an input.
fn input(spec: &'static Spec, words: &mut Words<'_>) -> Result<InputRecord, String> {
    let (word, port) = words.at_port(spec)?;
    Ok(match word {
        "rx" => InputRecord::Bytes { port, bytes: words.some_bytes()?.into() },
        "spoiled" => InputRecord::RxError { port },
        "idle" => InputRecord::Idle { port },
        "attached" => InputRecord::HostPresence { port, here: words.either("on", "off")? },
        "opened" => InputRecord::Opened { port, link: Link(words.number("a connection")?) },
        "message" => InputRecord::Message {
            port,
            link: Link(words.number("a connection")?),
            bytes: words.some_bytes()?,
        },
        "closed" => InputRecord::Closed { port, link: Link(words.number("a connection")?) },
        "pin" => {
            let pin = words.pin(spec)?;
            let open = spec.pins.get(usize::from(pin.0)).is_some_and(PinSpec::reports_open);
            match words.next() {
                "open" if open => InputRecord::Open { pin },
                "high" => InputRecord::Edge { pin, high: true },
                "low" => InputRecord::Edge { pin, high: false },
                word if open => return Err(format!("\"high\", \"low\" or \"open\", not \"{word}\"")),
                word => return Err(format!("\"high\" or \"low\", not \"{word}\"")),
            }
        }
        "millivolts" => {
            InputRecord::Millivolts { pin: words.pin(spec)?, mv: words.number("a voltage in mV")? }
        }
        "count" => InputRecord::Count {
            encoder: Encoder(words.number("an encoder")?),
            steps: words.number("quarter cycles")?,
            a: words.either("high", "low")?,
            b: words.either("high", "low")?,
        },
        "slipped" => InputRecord::StepsCorrection { axis: words.axis(spec)?, steps: words.number("steps")? },
        "draws" => {
            InputRecord::MotorCurrent { axis: words.axis(spec)?, ma: words.number("a current in mA")? }
        }
        "motor" => InputRecord::Motor {
            axis: words.axis(spec)?,
            parameters: Box::new(Parameters {
                supply_mv: words.number("a supply in mV")?,
                no_load_rpm: words.number("a speed in rpm")?,
                resistance_mohm: words.number("a resistance in mΩ")?,
                inertia_gcm2: words.number("an inertia in g·cm²")?,
                friction_unm: words.number("a friction in µN·m")?,
                load_unm: words.number("a load in µN·m")?,
                hall_pulses: words.number("pulses of a Hall sensor")?,
                hall_sensors: words.number("Hall sensors")?,
                encoder_cycles: words.number("cycles of an encoder")?,
            }),
        },
        "rotation" => {
            let axis = words.axis(spec)?;
            let rotation = Rotation {
                angle: words.number("an angle")?,
                speed: words.number("a speed")?,
                acceleration: words.number("an acceleration")?,
            };
            InputRecord::Rotation { axis, rotation: rotation.limited() }
        }
        "fault" => {
            let names = spec.faults.iter().copied();
            InputRecord::Fault { fault: Fault(words.index("fault", names)?), on: words.either("on", "off")? }
        }
        "poke" => {
            let name = words.next();
            let row = spec.registers.rows.iter().position(|row| row.name == name);
            InputRecord::Poke {
                row: row.ok_or_else(|| format!("there is no register \"{name}\""))?,
                value: words.number("a value")?,
            }
        }
        "power" => InputRecord::Power(match words.next() {
            "on" => Power::On,
            "off" => Power::Off,
            "cut" if words.rest.is_empty() => Power::Cut(None),
            "cut" => Power::Cut(Some(Cut { stores: words.number("stores")?, bytes: words.number("bytes")? })),
            other => return Err(format!("power goes \"on\", \"off\" or \"cut\", not \"{other}\"")),
        }),
        _ => {
            let words = [
                "rx",
                "spoiled",
                "idle",
                "attached",
                "opened",
                "message",
                "closed",
                "pin",
                "millivolts",
                "count",
                "slipped",
                "draws",
                "motor",
                "rotation",
                "fault",
                "poke",
                "power",
            ];
            return Err(format!("\"{word}\" is not an input; inputs are: {}", known(words)));
        }
    })
}

/// The parameters of a motor as numbers, in the order of [`Parameters`].
fn motor(parameters: &Parameters) -> String {
    let Parameters {
        supply_mv,
        no_load_rpm,
        resistance_mohm,
        inertia_gcm2,
        friction_unm,
        load_unm,
        hall_pulses,
        hall_sensors,
        encoder_cycles,
    } = parameters;
    format!(
        "{supply_mv} {no_load_rpm} {resistance_mohm} {inertia_gcm2} {friction_unm} {load_unm} {hall_pulses} \
         {hall_sensors} {encoder_cycles}"
    )
}

/// Parses an output.
fn output(spec: &'static Spec, words: &mut Words<'_>) -> Result<OutputRecord, String> {
    let (word, port) = words.at_port(spec)?;
    Ok(match word {
        "tx" => OutputRecord::Bytes { port, bytes: words.some_bytes()? },
        "message" => OutputRecord::Message {
            port,
            link: Link(words.number("a connection")?),
            bytes: words.some_bytes()?,
        },
        "close" => OutputRecord::Close { port, link: Link(words.number("a connection")?) },
        "line" => OutputRecord::Line { port, line: words.line()? },
        "pin" => {
            let pin = words.pin(spec)?;
            let level = match words.next() {
                "low" => Level::Low,
                "high" => Level::High,
                "float" => Level::Float,
                other => return Err(format!("a pin is \"low\", \"high\" or \"float\", not \"{other}\"")),
            };
            OutputRecord::Level { pin, level }
        }
        "wave" => {
            let pin = words.pin(spec)?;
            let high = Duration::from_ticks(words.millis()?);
            match words.next() {
                "of" => OutputRecord::Wave { pin, high, period: Duration::from_ticks(words.millis()?) },
                other => return Err(format!("\"of\" and a period are missing before \"{other}\"")),
            }
        }
        "plan" => OutputRecord::Course { axis: words.axis(spec)?, course: Box::new(words.course()?) },
        "step" => OutputRecord::Step { axis: words.axis(spec)?, steps: words.number("steps")? },
        "current" => {
            OutputRecord::CurrentLimit { axis: words.axis(spec)?, ma: words.number("a current in mA")? }
        }
        "duty" => OutputRecord::Duty { axis: words.axis(spec)?, duty: words.number("a duty in 1/65536")? },
        "store" => {
            let offset = words.address()?;
            let offset =
                u16::try_from(offset).map_err(|_| "the address is past the end of the memory".to_owned())?;
            OutputRecord::Store { offset, bytes: words.bytes()? }
        }
        "power" => match words.next() {
            "off" => OutputRecord::PowerOff,
            other => return Err(format!("as an output, power is \"off\", not \"{other}\"")),
        },
        _ => {
            let words = [
                "tx", "message", "close", "line", "pin", "wave", "plan", "step", "current", "duty", "store",
                "power",
            ];
            return Err(format!("\"{word}\" is not an output; outputs are: {}", known(words)));
        }
    })
}

/// A text line without its comment. A `#` between quotes does not begin a comment.
pub(crate) fn without_comment(line: &str) -> &str {
    let (mut quoted, mut escaped) = (false, false);
    for (index, c) in line.char_indices() {
        match c {
            '#' if !quoted => return &line[..index],
            '"' if !escaped => quoted = !quoted,
            _ => {}
        }
        escaped = c == '\\' && !escaped;
    }
    line
}

/// A list of valid words, for messages.
fn known<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    words.into_iter().collect::<Vec<_>>().join(", ")
}

/// The words of a text line that are not read yet.
struct Words<'a> {
    rest: &'a str,
}

impl<'a> Words<'a> {
    /// The next word; `None` at the end of the line.
    fn more(&mut self) -> Option<&'a str> {
        let (word, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        self.rest = rest.trim_start();
        (!word.is_empty()).then_some(word)
    }

    /// The next word; empty at the end of the line.
    fn next(&mut self) -> &'a str {
        self.more().unwrap_or("")
    }

    fn end(&self) -> Result<(), String> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(format!("\"{}\" is not expected at the end of the line", self.rest))
        }
    }

    fn number<N: std::str::FromStr>(&mut self, what: &str) -> Result<N, String> {
        let word = self.next();
        word.parse().map_err(|_| format!("\"{word}\" is not {what}"))
    }

    /// Reads a time in milliseconds, and returns it in ticks.
    fn millis(&mut self) -> Result<u64, String> {
        let word = self.next();
        ticks(word).ok_or_else(|| format!("\"{word}\" is not a time in milliseconds with up to six decimals"))
    }

    fn either(&mut self, yes: &str, no: &str) -> Result<bool, String> {
        match self.next() {
            word if word == yes => Ok(true),
            word if word == no => Ok(false),
            word => Err(format!("\"{yes}\" or \"{no}\", not \"{word}\"")),
        }
    }

    /// Reads a name, and returns its index in a list.
    fn index(&mut self, what: &str, names: impl Iterator<Item = &'static str>) -> Result<u8, String> {
        let word = self.next();
        let names: Vec<&str> = names.collect();
        let index = names.iter().position(|&name| name == word);
        index
            .and_then(|index| u8::try_from(index).ok())
            .ok_or_else(|| format!("there is no {what} \"{word}\"; there are: {}", known(names)))
    }

    fn pin(&mut self, spec: &Spec) -> Result<Pin, String> {
        let index = self.index("pin", spec.pin_names().map(|(name, _)| name))?;
        spec.pin_names().nth(index.into()).map(|(_, pin)| pin).ok_or_else(|| "there is no such pin".into())
    }

    fn axis(&mut self, spec: &Spec) -> Result<Axis, String> {
        self.index("axis", spec.axes.iter().map(|axis| axis.name)).map(Axis)
    }

    /// Reads a word and the port after its colon. Without a colon it is the first port.
    fn at_port(&mut self, spec: &Spec) -> Result<(&'a str, Port), String> {
        let word = self.next();
        let Some((word, name)) = word.split_once(':') else { return Ok((word, Port(0))) };
        let port = Words { rest: name }.index("port", spec.ports.iter().map(|port| port.name))?;
        Ok((word, Port(port)))
    }

    /// Reads a memory address like `0x0010`.
    fn address(&mut self) -> Result<usize, String> {
        let word = self.next();
        let digits = word.strip_prefix("0x").filter(|digits| digits.len() <= 4);
        digits
            .and_then(|digits| usize::from_str_radix(digits, 16).ok())
            .ok_or_else(|| format!("\"{word}\" is not a memory address like 0x0010"))
    }

    /// Reads bytes to the end of the line, at least one.
    fn some_bytes(&mut self) -> Result<Vec<u8>, String> {
        let bytes = self.bytes()?;
        if bytes.is_empty() { Err("no bytes follow".to_owned()) } else { Ok(bytes) }
    }

    /// Reads bytes to the end of the line: two hex digits each, or text between quotes.
    fn bytes(&mut self) -> Result<Vec<u8>, String> {
        let mut bytes = Vec::new();
        while !self.rest.is_empty() {
            if let Some(text) = self.rest.strip_prefix('"') {
                self.rest = quoted(text, &mut bytes)?;
                continue;
            }
            let word = self.next();
            let digits = word.len() == 2 && word.bytes().all(|digit| digit.is_ascii_hexdigit());
            let byte = u8::from_str_radix(word, 16).ok().filter(|_| digits);
            bytes.push(byte.ok_or_else(|| format!("\"{word}\" is not a byte of two hex digits"))?);
        }
        Ok(bytes)
    }

    /// Reads serial settings like `19200 8E1`.
    fn line(&mut self) -> Result<Line, String> {
        let baud = self.number("a baud rate")?;
        let format = self.next();
        let parts = match *format.as_bytes() {
            [data @ b'7'..=b'8', parity, stop @ b'1'..=b'2'] => Some((data - b'0', parity, stop - b'0')),
            _ => None,
        };
        let line = parts.and_then(|(data, parity, stop)| {
            let parity = match parity {
                b'N' => Parity::None,
                b'E' => Parity::Even,
                b'O' => Parity::Odd,
                _ => return None,
            };
            Some(Line::new(baud, data, parity, stop))
        });
        line.ok_or_else(|| format!("\"{format}\" is not a character format like 8E1"))
    }

    /// Reads a course like `0 500.000000@5000 500.000000@0 2500`.
    fn course(&mut self) -> Result<Course, String> {
        let from = self.number("a position")?;
        let mut legs = Vec::new();
        let mut to = None;
        while let Some(word) = self.more() {
            let Some((time, speed)) = word.split_once('@') else {
                to = Some(Words { rest: word }.number("a position")?);
                break;
            };
            let time = match time {
                "ever" => Duration::FOREVER,
                time => Duration::from_ticks(Words { rest: time }.millis()?),
            };
            let speed =
                in_thousandths(speed).ok_or_else(|| format!("\"{speed}\" is not a speed in steps/s"))?;
            legs.push(Leg { time, speed });
        }
        if legs.is_empty() {
            to = Some(from);
        }
        let ever = legs.last().is_some_and(|leg| leg.time == Duration::FOREVER);
        if ever == to.is_some() {
            return Err("a plan ends with a position, unless it goes on for ever".to_owned());
        }
        Ok(Course { from, legs, to })
    }
}

/// A decimal number with up to three decimals, in thousandths; `None` if the text is not such a number.
fn in_thousandths(text: &str) -> Option<i64> {
    let (sign, size) = text.strip_prefix('-').map_or((1, text), |size| (-1, size));
    let (whole, part) = size.split_once('.').unwrap_or((size, "0"));
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(whole) || !digits(part) || part.len() > 3 {
        return None;
    }
    let whole: i64 = whole.parse().ok()?;
    Some(sign * whole.checked_mul(1_000)?.checked_add(format!("{part:0<3}").parse().ok()?)?)
}

/// Reads text up to its closing quote into `bytes`. Returns the text after the quote.
fn quoted<'a>(text: &'a str, bytes: &mut Vec<u8>) -> Result<&'a str, String> {
    let mut chars = text.char_indices();
    while let Some((index, c)) = chars.next() {
        let c = match c {
            '"' => return Ok(text[index + 1..].trim_start()),
            '\\' => match chars.next() {
                Some((_, 'r')) => '\r',
                Some((_, 'n')) => '\n',
                Some((_, c @ ('"' | '\\'))) => c,
                _ => return Err("after \\ comes r, n, \" or \\".to_owned()),
            },
            c => c,
        };
        bytes.push(u8::try_from(c).ok().filter(u8::is_ascii).ok_or_else(|| format!("\"{c}\" is not ASCII"))?);
    }
    Err("the closing quote is missing".to_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_stamp_is_its_tick(ticks in any::<u64>()) {
            let text = super::millis(ticks);
            prop_assert_eq!(super::ticks(&text), Some(ticks), "{}", text);
        }
    }
}
