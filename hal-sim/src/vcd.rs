//! Waveforms of the pins: VCD (IEEE 1364-2001, section 18), as GTKWave and its like read it.
//!
//! The unit is 100 ps, the coarsest one of the format in which a tick of 62.5 ns is whole: 625 of
//! them. Each drive is a scope, each of its pins a wire, analogue inputs are reals in volts. Both bear
//! the names users know, with `_` for whatever is neither letter nor digit, because readers take a dot
//! for a step into a hierarchy: `J2.5` is `J2_5`.
//!
//! | value | what a probe at the pin sees |
//! |---|---|
//! | `0` `1` | what the drive drives, else what comes from outside, else what the pin rests at |
//! | `z` | nothing: an output is let go, and nothing is wired to it |
//! | `x` `nan` | nobody knows: the drive has no power, or what was recorded of it is lost |
//!
//! STEP and DIR come from the plans of the axes, lights and clocks from their waves, edge by edge while
//! the file is written. Of several changes of a pin at one instant the last one is told.

use std::fmt;
use std::io::{self, Write};
use std::ops::Range;

use standin_firmware::device::{Duration, Instant, Level, Pin, PinSpec, Role};

use crate::schedule::Tournament;
use crate::seat::LOGIC_HIGH_MV;
use crate::trace::{Did, Entry, Event, Fed, Power, Trace};

/// What a file is in, and how many of it are a tick.
const TIMESCALE: &str = "100 ps";
const UNITS_PER_TICK: u128 = 625;

/// So much text is written at once, and as much again at most is kept.
const CHUNK: usize = 64 << 10;

/// Writes all that a trace tells.
///
/// # Errors
/// Those of the writer.
pub fn write(trace: &Trace, out: impl Write) -> io::Result<()> {
    let mut waves = Waves::new(trace, out)?;
    waves.follow(trace)?;
    waves.finish()
}

/// A file that follows a trace as it grows. It holds no more than what the pins do at present.
pub struct Waves<W> {
    out: W,
    /// Whole lines that are not written yet.
    text: Vec<u8>,
    wires: Vec<Wire>,
    /// The wires of each drive of the trace.
    drives: Vec<Range<usize>>,
    /// Drives that are yet to be seated, the next one last.
    seats: Vec<(Instant, usize)>,
    /// When each wire changes by itself.
    edges: Tournament,
    now: Instant,
    /// Wires that may have changed at `now`.
    changed: Vec<usize>,
    /// The last instant in the file.
    stamped: Option<Instant>,
    /// Events taken from the trace.
    taken: u64,
    /// How far the trace went.
    end: Instant,
}

/// A pin.
struct Wire {
    pin: &'static PinSpec,
    /// What the file calls it.
    code: String,
    /// Whether anybody knows what it does.
    known: bool,
    drives: Drives,
    /// What comes from outside, if something does: mV at an analogue input, else 0 or 1.
    outside: Option<i32>,
    /// What was last written.
    shown: Option<Value>,
}

/// What a drive does with a pin.
#[derive(Clone, Copy)]
enum Drives {
    Level(Level),
    Wave { since: Instant, period: Duration, high: Duration },
}

/// What a file says of a pin.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Value {
    Bit(char),
    Millivolts(i32),
    NotANumber,
}

impl<W: Write> Waves<W> {
    /// Begins the file, about the drives that the trace tells of so far.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn new(trace: &Trace, mut out: W) -> io::Result<Self> {
        let (mut wires, mut drives): (Vec<Wire>, Vec<Range<usize>>) = (Vec::new(), Vec::new());
        let mut header = Vec::new();
        let version = env!("CARGO_PKG_VERSION");
        writeln!(header, "$version standin {version} $end\n$timescale {TIMESCALE} $end")?;
        let scopes = names(trace.drives.iter().map(|drive| drive.name.as_str()));
        for (drive, scope) in trace.drives.iter().zip(scopes) {
            writeln!(header, "$scope module {scope} $end")?;
            let first = wires.len();
            for (pin, name) in drive.spec.pins.iter().zip(names(drive.spec.pins.iter().map(|pin| pin.name))) {
                let kind = if pin.role == Role::Analogue { "real 64" } else { "wire 1" };
                let wire = Wire::new(pin, code(wires.len()));
                writeln!(header, "$var {kind} {} {name} $end", wire.code)?;
                wires.push(wire);
            }
            drives.push(first..wires.len());
            writeln!(header, "$upscope $end")?;
        }
        writeln!(header, "$enddefinitions $end")?;
        out.write_all(&header)?;
        let mut seats: Vec<_> = trace.drives.iter().map(|drive| drive.from).zip(0..).collect();
        seats.sort_unstable_by(|a, b| b.cmp(a));
        Ok(Self {
            out,
            text: Vec::new(),
            edges: Tournament::new(&vec![Instant::NEVER; wires.len()]),
            changed: (0..wires.len()).collect(),
            wires,
            drives,
            seats,
            now: Instant::ZERO,
            stamped: None,
            taken: 0,
            end: Instant::ZERO,
        })
    }

    /// Writes what the trace tells beyond what it told last time. What may still change at its last
    /// instant waits.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn follow(&mut self, trace: &Trace) -> io::Result<()> {
        if trace.lost > self.taken {
            let resumes = trace.events().next().map_or(trace.end, |entry| entry.at);
            self.forget(resumes)?;
            self.taken = trace.lost;
        }
        let old = usize::try_from(self.taken - trace.lost).unwrap_or(usize::MAX);
        for entry in trace.events().skip(old) {
            self.happen(entry)?;
        }
        self.taken = trace.lost + trace.events().len() as u64;
        self.end = self.end.max(trace.end);
        self.run_until(self.end)?;
        self.write_text()
    }

    /// Ends the file where the trace has come to.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn finish(mut self) -> io::Result<()> {
        self.run_until(self.end + Duration::TICK)?;
        self.tell_changes();
        // So that the file shows how far it goes.
        self.stamp(self.end);
        self.write_text()?;
        self.out.flush()
    }

    /// Takes an event.
    fn happen(&mut self, entry: &Entry) -> io::Result<()> {
        if !is_seen(&entry.event) {
            return Ok(());
        }
        self.run_until(entry.at)?;
        match entry.event {
            Event::Fed(Fed::Power(power)) => self.power(entry.drive, power == Power::On),
            Event::Fed(Fed::Edge { pin, high }) => self.outside(entry.drive, pin, high.into()),
            Event::Fed(Fed::Millivolts { pin, mv }) => self.outside(entry.drive, pin, mv),
            Event::Did(Did::Level { pin, level }) => self.drive(entry.drive, pin, Drives::Level(level)),
            Event::Did(Did::Wave { pin, period, high }) => {
                self.drive(entry.drive, pin, Drives::Wave { since: entry.at, period, high });
            }
            _ => {}
        }
        Ok(())
    }

    /// Power comes to a drive, or goes: all pins are let go. What comes from outside is told anew.
    fn power(&mut self, drive: usize, on: bool) {
        for place in self.drives.get(drive).cloned().unwrap_or_default() {
            let wire = &mut self.wires[place];
            (wire.known, wire.drives, wire.outside) = (on, Drives::Level(Level::Float), None);
            self.edges.set(place as u32, Instant::NEVER);
            self.changed.push(place);
        }
    }

    /// Something comes to a pin from outside.
    fn outside(&mut self, drive: usize, pin: Pin, value: i32) {
        let Some(place) = self.place(drive, pin) else { return };
        let wire = &mut self.wires[place];
        (wire.known, wire.outside) = (true, Some(value));
        self.changed.push(place);
    }

    /// A drive does something with a pin.
    fn drive(&mut self, drive: usize, pin: Pin, drives: Drives) {
        let Some(place) = self.place(drive, pin) else { return };
        let wire = &mut self.wires[place];
        (wire.known, wire.drives) = (true, drives);
        self.edges.set(place as u32, drives.next_edge(self.now));
        self.changed.push(place);
    }

    fn place(&self, drive: usize, pin: Pin) -> Option<usize> {
        self.drives.get(drive)?.clone().nth(pin.0.into())
    }

    /// Nobody knows what happened before `at`.
    fn forget(&mut self, at: Instant) -> io::Result<()> {
        self.seats.retain(|(from, _)| *from > at);
        self.run_until(at)?;
        for drive in 0..self.drives.len() {
            self.power(drive, false);
        }
        Ok(())
    }

    /// Goes to `to`. Edges at that instant wait: something else may come first.
    fn run_until(&mut self, to: Instant) -> io::Result<()> {
        while let Some((from, drive)) = self.seats.pop_if(|(from, _)| *from <= to) {
            self.make_edges(from)?;
            self.power(drive, true);
        }
        self.make_edges(to)
    }

    fn make_edges(&mut self, to: Instant) -> io::Result<()> {
        loop {
            let (due, source) = self.edges.first();
            if due >= to {
                return self.pass(to);
            }
            self.pass(due)?;
            let place = source as usize;
            self.edges.set(source, self.wires[place].drives.next_edge(due));
            self.changed.push(place);
        }
    }

    /// Time goes on to `at`; what was before is settled.
    fn pass(&mut self, at: Instant) -> io::Result<()> {
        if at <= self.now {
            return Ok(());
        }
        self.tell_changes();
        self.now = at;
        if self.text.len() < CHUNK { Ok(()) } else { self.write_text() }
    }

    /// Tells what has changed by now; the first time, everything.
    fn tell_changes(&mut self) {
        let first = self.stamped.is_none();
        if first {
            self.stamp(self.now);
            self.text.extend_from_slice(b"$dumpvars\n");
        }
        let mut changed = std::mem::take(&mut self.changed);
        changed.sort_unstable();
        changed.dedup();
        for place in changed.drain(..) {
            let wire = &mut self.wires[place];
            let value = wire.value(self.now);
            if wire.shown.replace(value) != Some(value) {
                let change = format!("{value}{}\n", wire.code);
                self.stamp(self.now);
                self.text.extend_from_slice(change.as_bytes());
            }
        }
        self.changed = changed;
        if first {
            self.text.extend_from_slice(b"$end\n");
        }
    }

    /// What follows is at `at`.
    fn stamp(&mut self, at: Instant) {
        if self.stamped != Some(at) {
            self.stamped = Some(at);
            let units = u128::from(at.ticks()) * UNITS_PER_TICK;
            self.text.extend_from_slice(format!("#{units}\n").as_bytes());
        }
    }

    fn write_text(&mut self) -> io::Result<()> {
        self.out.write_all(&self.text)?;
        self.text.clear();
        Ok(())
    }
}

impl Wire {
    fn new(pin: &'static PinSpec, code: String) -> Self {
        Self { pin, code, known: false, drives: Drives::Level(Level::Float), outside: None, shown: None }
    }

    fn value(&self, at: Instant) -> Value {
        let logic = |high| Value::Bit(if high { '1' } else { '0' });
        if self.pin.role == Role::Analogue {
            return match self.outside {
                _ if !self.known => Value::NotANumber,
                Some(mv) => Value::Millivolts(mv),
                None if self.pin.rest == Level::High => Value::Millivolts(LOGIC_HIGH_MV),
                None => Value::Millivolts(0),
            };
        }
        match self.drives {
            _ if !self.known => Value::Bit('x'),
            Drives::Level(level @ (Level::Low | Level::High)) => logic(level == Level::High),
            Drives::Wave { since, period, high } => logic(cycle(since, period, at) < high),
            Drives::Level(Level::Float) => match (self.outside, self.pin.rest) {
                (Some(outside), _) => logic(outside != 0),
                (None, Level::Float) => Value::Bit('z'),
                (None, rest) => logic(rest == Level::High),
            },
        }
    }
}

impl Drives {
    /// When the level changes next after `now`, if nothing else happens.
    fn next_edge(self, now: Instant) -> Instant {
        match self {
            Self::Wave { since, period, high } if Duration::ZERO < high && high < period => {
                let passed = cycle(since, period, now);
                now + (if passed < high { high - passed } else { period - passed })
            }
            Self::Wave { .. } | Self::Level(_) => Instant::NEVER,
        }
    }
}

impl fmt::Display for Value {
    /// What stands before the code of the wire.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Bit(bit) => write!(f, "{bit}"),
            Self::Millivolts(mv) => write!(f, "r{} ", f64::from(mv) / 1_000.0),
            Self::NotANumber => f.write_str("rnan "),
        }
    }
}

/// How far a wave is in its cycle.
fn cycle(since: Instant, period: Duration, at: Instant) -> Duration {
    Duration::from_ticks(at.since(since).ticks() % period.ticks().max(1))
}

/// Whether pins show it. Stamps of what they do not show may lie ahead.
fn is_seen(event: &Event) -> bool {
    match event {
        Event::Fed(fed) => match fed {
            Fed::Power(power) => !matches!(power, Power::Cut(_)),
            fed => matches!(fed, Fed::Edge { .. } | Fed::Millivolts { .. }),
        },
        Event::Did(did) => matches!(did, Did::Level { .. } | Did::Wave { .. }),
    }
}

/// What the file calls the wire at a place: printable characters, as few as there can be.
fn code(place: usize) -> String {
    const FIRST: u8 = b'!';
    const COUNT: usize = (b'~' - FIRST) as usize + 1;
    let mut code = String::new();
    let mut rest = place;
    loop {
        code.push(char::from(FIRST + (rest % COUNT) as u8));
        if rest < COUNT {
            return code;
        }
        rest = rest / COUNT - 1;
    }
}

/// Names that every reader takes, each of them once.
fn names<'a>(given: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for given in given {
        let mut name: String =
            given.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if name.starts_with(|c: char| c.is_ascii_digit()) {
            name.insert(0, '_');
        }
        while names.contains(&name) {
            name.push('_');
        }
        names.push(name);
    }
    names
}
