//! Waveforms of the pins as a VCD file (IEEE 1364-2001, section 18), for GTKWave and similar programs.
//!
//! The unit is 100 ps, the coarsest unit of the format that divides a tick of 62.5 ns: a tick is 625 units.
//! Each drive is a scope, each of its pins is a wire, and analogue inputs are reals in volts. Names are those
//! of drives and pins. Every character that is neither letter nor digit is replaced by `_`, because readers
//! take a dot for a level of hierarchy: `J2.5` becomes `J2_5`.
//!
//! | value | what a probe at the pin sees |
//! |---|---|
//! | `0` `1` | the output of the drive, else the stimulus from outside, else the idle level |
//! | `z` | floating: a released output or an open input, without a wire |
//! | `x` `nan` | unknown: the drive has no power, or its events were lost |
//!
//! While the file is written, edges of STEP and DIR are computed from the plans of the axes, and edges of
//! lights and clocks from their waves. If a pin changes several times at one instant, only the last change is
//! written.

use std::fmt;
use std::io::{self, Write};
use std::ops::Range;

use drivetwin_firmware::device::{Axis, HIGH_MV, Instant, LOGIC_HIGH_MV, Level, Pin, PinSpec, Role};

use crate::record::trace::{Entry, Event, Group, InputRecord, OutputRecord, Power, Trace};
use crate::scheduler::Tournament;
use crate::signals::pin_waveform::{PinOutput, level_of};
use crate::signals::pulses::{Lent, Shaper, StepDir};

/// Time unit of a file, and number of units per tick (HOST-11).
const TIMESCALE: &str = "100 ps";
const UNITS_PER_TICK: u128 = 625;

/// Number of bytes of text that are written at once; at most as many again are buffered.
const CHUNK: usize = 64 << 10;

/// Writes all waveforms of a trace.
///
/// # Errors
/// Errors of the writer.
pub fn write(trace: &Trace, out: impl Write) -> io::Result<()> {
    let mut waves = Waves::new(trace, out)?;
    waves.follow(trace)?;
    waves.finish()
}

/// Writer of a VCD file while a trace grows. It keeps only the present state of the pins.
pub struct Waves<W> {
    out: W,
    /// Complete lines that are not written yet.
    text: Vec<u8>,
    wires: Vec<VcdVar>,
    motors: Vec<Motor>,
    /// The drives of the trace, by index.
    drives: Vec<Drive>,
    /// Drives that are not added yet, and the time of each; the next one is last.
    not_added: Vec<(Instant, usize)>,
    /// Next change of each wire, then next change of each motor.
    edges: Tournament,
    now: Instant,
    /// Wires that may have changed at `now`.
    changed: Vec<usize>,
    /// The last time that was written to the file.
    stamped: Option<Instant>,
    /// Number of events taken from the trace.
    taken: u64,
    /// Time that the trace has reached.
    end: Instant,
}

/// Indices of a drive's wires and motors.
struct Drive {
    wires: Range<usize>,
    motors: Range<usize>,
}

/// An axis with step pulses.
struct Motor {
    axis: Axis,
    /// Indices of the wires of STEP and DIR.
    step: usize,
    dir: usize,
    shaper: Shaper,
    /// Outputs that the drive uses for other purposes now.
    lent: Lent,
}

/// A pin.
struct VcdVar {
    pin: &'static PinSpec,
    /// Code that identifies the wire in the file.
    code: String,
    /// True if the waveform is known now.
    known: bool,
    drives: PinOutput,
    /// Stimulus from outside in mV, if there is one.
    applied: Option<i32>,
    /// Value that was written last.
    shown: Option<Value>,
}

/// Value of a pin in a file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Value {
    Bit(char),
    Millivolts(i32),
    NotANumber,
}

impl<W: Write> Waves<W> {
    /// Begins the file with the drives of the trace.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(trace: &Trace, mut out: W) -> io::Result<Self> {
        let (mut wires, mut motors, mut drives) = (Vec::new(), Vec::new(), Vec::new());
        let mut header = Vec::new();
        let version = env!("CARGO_PKG_VERSION");
        writeln!(header, "$version drivetwin {version} $end\n$timescale {TIMESCALE} $end")?;
        let scopes = names(trace.drives.iter().map(|drive| drive.name.as_str()));
        for (drive, scope) in trace.drives.iter().zip(scopes) {
            writeln!(header, "$scope module {scope} $end")?;
            let first = wires.len();
            for (pin, name) in drive.spec.pins.iter().zip(names(drive.spec.pins.iter().map(|pin| pin.name))) {
                let kind = if pin.role == Role::Analogue { "real 64" } else { "wire 1" };
                let wire = VcdVar::new(pin, code(wires.len()));
                writeln!(header, "$var {kind} {} {name} $end", wire.code)?;
                wires.push(wire);
            }
            let first_motor = motors.len();
            let axes = (0..).map(Axis).zip(drive.spec.axes);
            motors.extend(axes.filter_map(|(axis, spec)| {
                let (step, dir) = spec.step_dir?;
                let index = |pin: Pin| first + usize::from(pin.0);
                let (shaper, lent) = (Shaper::default(), Lent::default());
                Some(Motor { axis, step: index(step), dir: index(dir), shaper, lent })
            }));
            drives.push(Drive { wires: first..wires.len(), motors: first_motor..motors.len() });
            writeln!(header, "$upscope $end")?;
        }
        writeln!(header, "$enddefinitions $end")?;
        out.write_all(&header)?;
        let mut not_added: Vec<_> = trace.drives.iter().map(|drive| drive.from).zip(0..).collect();
        not_added.sort_unstable_by(|a, b| b.cmp(a));
        Ok(Self {
            out,
            text: Vec::new(),
            edges: Tournament::new(&vec![Instant::NEVER; wires.len() + motors.len()]),
            changed: (0..wires.len()).collect(),
            wires,
            motors,
            drives,
            not_added,
            now: Instant::ZERO,
            stamped: None,
            taken: 0,
            end: Instant::ZERO,
        })
    }

    /// Writes the events since the last call. Changes at the last instant are held back, because more may
    /// happen at that instant.
    ///
    /// # Errors
    /// Errors of the writer.
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

    /// Ends the file at the end of the trace.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn finish(mut self) -> io::Result<()> {
        self.tell_changes();
        // This last time shows how far the file goes.
        self.stamp(self.end.max(self.now));
        self.write_text()?;
        self.out.flush()
    }

    /// Applies an event of the trace.
    fn happen(&mut self, entry: &Entry) -> io::Result<()> {
        if let Event::Output(output) = &entry.event
            && matches!(output.group(), Group::Tx | Group::Line)
        {
            // These outputs are not visible at a pin, and their timestamps may be in the future.
            return Ok(());
        }
        self.run_until(entry.at)?;
        let (at, drive) = (entry.at, entry.drive);
        match &entry.event {
            Event::Input(input) => match *input {
                InputRecord::Power(Power::On) => self.power(drive, true),
                InputRecord::Power(Power::Off) => self.power(drive, false),
                InputRecord::Edge { pin, high } => {
                    self.set_stimulus(drive, pin, Some(if high { LOGIC_HIGH_MV } else { 0 }));
                }
                InputRecord::Open { pin } => self.set_stimulus(drive, pin, None),
                InputRecord::Millivolts { pin, mv } => self.set_stimulus(drive, pin, Some(mv)),
                _ => {}
            },
            Event::Output(output) => match output {
                OutputRecord::PowerOff => self.power(drive, false),
                &OutputRecord::Level { pin, level } => self.drive(drive, pin, PinOutput::Level(level)),
                &OutputRecord::Wave { pin, period, high } => {
                    self.drive(drive, pin, PinOutput::Wave { since: at, period, high });
                }
                OutputRecord::Plan { axis, plan } => self.turn(drive, *axis, |motor| {
                    motor.shaper.plan(at, plan, std::mem::take(&mut motor.lent));
                }),
                OutputRecord::Step { axis, steps } => {
                    self.turn(drive, *axis, |motor| motor.shaper.steps(at, *steps));
                }
                OutputRecord::Course { axis, .. } => self.lose(drive, *axis),
                _ => {}
            },
        }
        Ok(())
    }

    /// Handles a change of power of a drive: all its pins are released. After power-on the trace reports the
    /// stimuli again.
    fn power(&mut self, drive: usize, on: bool) {
        let Some(drive) = self.drives.get(drive) else { return };
        for index in drive.wires.clone() {
            let wire = &mut self.wires[index];
            (wire.known, wire.drives, wire.applied) = (on, PinOutput::NOTHING, None);
            self.edges.set(index as u32, Instant::NEVER);
            self.changed.push(index);
        }
        for index in drive.motors.clone() {
            let motor = &mut self.motors[index];
            (motor.shaper, motor.lent) = (Shaper::default(), Lent::default());
            self.edges.set((self.wires.len() + index) as u32, Instant::NEVER);
        }
    }

    /// Handles a change of an axis.
    fn turn(&mut self, drive: usize, axis: Axis, change: impl FnOnce(&mut Motor)) {
        let Some(index) = self.motor(drive, axis) else { return };
        change(&mut self.motors[index]);
        self.make_pulses(index);
    }

    /// Applies all edges of a motor up to now.
    fn make_pulses(&mut self, index: usize) {
        let Motor { step, dir, shaper, lent, .. } = &mut self.motors[index];
        while shaper.take(self.now).is_some() {}
        let outputs = [(*step, StepDir::Step), (*dir, StepDir::Dir)];
        for (index, output) in outputs.into_iter().filter(|(_, output)| !lent.has(*output)) {
            let wire = &mut self.wires[index];
            (wire.known, wire.drives) = (true, PinOutput::Level(level_of(shaper.is_high(output))));
            self.changed.push(index);
        }
        self.edges.set((self.wires.len() + index) as u32, shaper.due());
    }

    /// Marks the pulses of a motor as unknown: a trace from text has the course of a motion, not the times of
    /// its steps.
    fn lose(&mut self, drive: usize, axis: Axis) {
        let Some(index) = self.motor(drive, axis) else { return };
        let Motor { step, dir, .. } = self.motors[index];
        for index in [step, dir] {
            self.wires[index].known = false;
            self.changed.push(index);
        }
    }

    /// Sets the stimulus of a pin from outside, or removes it (`None`).
    fn set_stimulus(&mut self, drive: usize, pin: Pin, mv: Option<i32>) {
        let Some(index) = self.index(drive, pin) else { return };
        let wire = &mut self.wires[index];
        (wire.known, wire.applied) = (true, mv);
        self.changed.push(index);
    }

    /// Handles an output of a drive at a pin.
    fn drive(&mut self, drive: usize, pin: Pin, drives: PinOutput) {
        let Some(index) = self.index(drive, pin) else { return };
        for motor in self.drives[drive].motors.clone() {
            let Motor { step, dir, lent, .. } = &mut self.motors[motor];
            lent.step |= *step == index;
            lent.dir |= *dir == index;
        }
        let wire = &mut self.wires[index];
        (wire.known, wire.drives) = (true, drives);
        self.edges.set(index as u32, drives.next_edge(self.now));
        self.changed.push(index);
    }

    fn index(&self, drive: usize, pin: Pin) -> Option<usize> {
        self.drives.get(drive)?.wires.clone().nth(pin.0.into())
    }

    fn motor(&self, drive: usize, axis: Axis) -> Option<usize> {
        self.drives.get(drive)?.motors.clone().find(|&index| self.motors[index].axis == axis)
    }

    /// Advances to `at` and marks everything as unknown, because events before `at` are lost.
    fn forget(&mut self, at: Instant) -> io::Result<()> {
        self.not_added.retain(|(from, _)| *from > at);
        self.run_until(at)?;
        for drive in 0..self.drives.len() {
            self.power(drive, false);
        }
        Ok(())
    }

    /// Advances to `to`: adds drives, and applies all edges up to then.
    fn run_until(&mut self, to: Instant) -> io::Result<()> {
        while let Some((from, drive)) = self.not_added.pop_if(|(from, _)| *from <= to) {
            self.make_edges(from)?;
            self.power(drive, true);
        }
        self.make_edges(to)
    }

    fn make_edges(&mut self, to: Instant) -> io::Result<()> {
        loop {
            let (due, source) = self.edges.first();
            if due > to || due == Instant::NEVER {
                return self.pass(to);
            }
            self.pass(due)?;
            let index = source as usize;
            if let Some(motor) = index.checked_sub(self.wires.len()) {
                self.make_pulses(motor);
            } else {
                self.edges.set(source, self.wires[index].drives.next_edge(due));
                self.changed.push(index);
            }
        }
    }

    /// Advances the time to `at`. Changes at the previous time are complete, so they are written.
    fn pass(&mut self, at: Instant) -> io::Result<()> {
        if at <= self.now {
            return Ok(());
        }
        self.tell_changes();
        self.now = at;
        if self.text.len() < CHUNK { Ok(()) } else { self.write_text() }
    }

    /// Writes the wires whose values have changed by now; at the first call, all wires.
    fn tell_changes(&mut self) {
        let first = self.stamped.is_none();
        if first {
            self.stamp(self.now);
            self.text.extend_from_slice(b"$dumpvars\n");
        }
        let mut changed = std::mem::take(&mut self.changed);
        changed.sort_unstable();
        changed.dedup();
        for index in changed.drain(..) {
            let wire = &mut self.wires[index];
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

    /// Writes the time of the changes that follow, unless it is already written.
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

impl VcdVar {
    fn new(pin: &'static PinSpec, code: String) -> Self {
        Self { pin, code, known: false, drives: PinOutput::NOTHING, applied: None, shown: None }
    }

    fn value(&self, at: Instant) -> Value {
        let logic = |high| Value::Bit(if high { '1' } else { '0' });
        if self.pin.role == Role::Analogue {
            return match self.applied {
                _ if !self.known => Value::NotANumber,
                Some(mv) => Value::Millivolts(mv),
                None if self.pin.idle == Level::High => Value::Millivolts(LOGIC_HIGH_MV),
                None => Value::Millivolts(0),
            };
        }
        match self.drives.level(at) {
            _ if !self.known => Value::Bit('x'),
            Level::High => logic(true),
            Level::Low => logic(false),
            Level::Float => match (self.applied, self.pin.idle) {
                (Some(mv), _) => logic(mv > HIGH_MV),
                (None, Level::Float) => Value::Bit('z'),
                (None, rest) => logic(rest == Level::High),
            },
        }
    }
}

impl fmt::Display for Value {
    /// Text that is written before the code of the wire.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Bit(bit) => write!(f, "{bit}"),
            Self::Millivolts(mv) => write!(f, "r{} ", f64::from(mv) / 1_000.0),
            Self::NotANumber => f.write_str("rnan "),
        }
    }
}

/// Code of a wire from its index: as few printable characters as possible.
fn code(index: usize) -> String {
    const FIRST: u8 = b'!';
    const COUNT: usize = (b'~' - FIRST) as usize + 1;
    let mut code = String::new();
    let mut rest = index;
    loop {
        code.push(char::from(FIRST + (rest % COUNT) as u8));
        if rest < COUNT {
            return code;
        }
        rest = rest / COUNT - 1;
    }
}

/// Unique names that every reader accepts.
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

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Device;
    use drivetwin_firmware::md3::Md3;
    use drivetwin_firmware::mdrobot::mdrobot;
    use drivetwin_protocol::modbus::rtu;
    use drivetwin_protocol::time::Span;
    use proptest::prelude::*;

    use super::*;
    use crate::bench::{Bench, PinStimulus, PowerAction, Settings, Setup};
    use crate::record::trace::Retention;
    use crate::testing::test_device::{LEVEL, TestDevice};

    fn text(trace: &Trace) -> String {
        let mut text = Vec::new();
        write(trace, &mut text).unwrap();
        String::from_utf8(text).unwrap()
    }

    /// The changes after the header, one text for each instant.
    fn changes(trace: &Trace) -> Vec<String> {
        let text = text(trace);
        let (_, changes) = text.split_once("$enddefinitions $end").unwrap();
        let changes = changes.replace("$dumpvars\n", "").replace("$end\n", "");
        changes.split("\n#").skip(1).map(|instant| instant.trim_end().replace('\n', ", ")).collect()
    }

    #[test]
    fn a_file_from_its_beginning_to_its_end() {
        let mut bench = Bench::new();
        let toy = bench.add::<TestDevice>("a-toy");
        bench.run_until(500.micros());
        bench.set_pin(toy, LEVEL, PinStimulus::Millivolts(2_500));
        bench.run_until(2.millis());
        bench.power(toy, PowerAction::Off);
        bench.run_until(3.millis());
        bench.power(toy, PowerAction::On);
        bench.run_until(3_500.micros());
        let version = env!("CARGO_PKG_VERSION");
        let header = format!("$version drivetwin {version} $end\n");
        let expected = "\
$timescale 100 ps $end
$scope module a_toy $end
$var wire 1 ! IN $end
$var real 64 \" LEVEL $end
$var wire 1 # OUT $end
$var wire 1 $ LED $end
$upscope $end
$enddefinitions $end
#0
$dumpvars
1!
r0 \"
1#
1$
$end
#5000625
r2.5 \"
#10000000
0$
#20000000
x!
rnan \"
x#
x$
#30000000
1!
r2.5 \"
1#
1$
#35000000
";
        assert_eq!(text(bench.trace()), header + expected);
    }

    #[test]
    fn a_contact_that_is_not_wired_floats() {
        let mut bench = Bench::new();
        let id = bench.add_with("c", Box::new(mdrobot()), Setup::default()).unwrap();
        let dir = bench.spec(id).pin("DIR").unwrap();
        for drive in [PinStimulus::Low, PinStimulus::Open] {
            bench.run_until(bench.now() + 1.millis());
            bench.set_pin(id, dir, drive);
        }
        bench.run_until(bench.now() + 1.millis());
        let text = text(bench.trace());
        let code = text.lines().find_map(|line| line.strip_suffix(" DIR $end")?.strip_prefix("$var wire 1 "));
        let (mut at, mut changes) = (0, Vec::new());
        for line in text.lines() {
            if let Some(units) = line.strip_prefix('#') {
                at = units.parse::<u64>().unwrap();
            } else if let Some(value) = line.strip_suffix(code.unwrap()).filter(|value| value.len() == 1) {
                changes.push((at, value));
            }
        }
        assert_eq!(changes, [(0, "z"), (10_000_625, "0"), (20_000_625, "z")]);
    }

    #[test]
    fn a_drive_that_is_added_later_is_unknown_until_then() {
        let mut bench = Bench::new();
        bench.run_until(1.millis());
        bench.add::<TestDevice>("late");
        bench.run_until(1_500.micros());
        assert_eq!(
            changes(bench.trace()),
            ["0, x!, rnan \", x#, x$", "10000000, 1!, r0 \", 1#, 1$", "15000000"]
        );
    }

    #[test]
    fn what_is_lost_is_unknown_until_it_is_told() {
        // The ring has room for a few events only.
        let mut bench = Bench::with(Settings { trace: Retention::Ring(1_000), ..Settings::default() });
        let toy = bench.add::<TestDevice>("toy");
        bench.run_until(1.millis());
        for mv in 0..100 {
            bench.set_pin(toy, LEVEL, PinStimulus::Millivolts(mv));
            bench.run_until(bench.now() + 1.millis());
        }
        assert!(bench.trace().lost > 90);
        let changes = changes(bench.trace());
        assert_eq!(changes.first().unwrap(), "0, x!, rnan \", x#, x$");
        assert!(changes[1].contains(", r0.09"), "{changes:?}");
        assert!(!changes[1..].iter().any(|change| change.contains(['!', '#', '$'])), "{changes:?}");
    }

    #[test]
    fn steps_that_a_text_does_not_tell_are_unknown() {
        let mut bench = Bench::new();
        let md3 = bench.add::<Md3>("md3");
        bench.run_until(2_500.millis());
        bench.ask(md3, &rtu::write(1, 0x11, 1));
        let make = |_: &str| Some(Box::new(Md3::new()) as Box<dyn Device>);
        let told = Trace::parse(&bench.trace().to_text(), &make).unwrap();
        let initial = &changes(&told)[0];
        assert!(initial.contains("x*, x+") && initial.contains("1!"), "{initial}");
        assert!(changes(bench.trace())[0].contains("0*, 0+"));
    }

    #[test]
    fn names_are_legal_and_differ() {
        let legal = names(["J2.10", "1", "_x", "a-b", "a.b", "a_b", "ä"].into_iter());
        assert_eq!(legal, ["J2_10", "_1", "_x", "a_b", "a_b_", "a_b__", "_"]);
    }

    #[test]
    fn codes_are_short_and_differ() {
        assert_eq!(
            (code(0), code(93), code(94), code(187)),
            ("!".into(), "~".into(), "!!".into(), "~!".into())
        );
        let codes: std::collections::BTreeSet<String> = (0..20_000).map(code).collect();
        assert_eq!(codes.len(), 20_000);
        assert!(codes.iter().all(|code| code.len() <= 3 && code.bytes().all(|byte| byte.is_ascii_graphic())));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]
        #[test]
        fn looking_often_or_once_makes_the_same_file(pauses in proptest::collection::vec(0_u64..200_000, 1..20)) {
            let mut bench = Bench::new();
            let (x, y) = (bench.add::<Md3>("x"), bench.add::<Md3>("y"));
            let mut followed = Vec::new();
            let mut waves = Waves::new(bench.trace(), &mut followed).unwrap();
            bench.run_until(2_500.millis());
            bench.ask(x, &rtu::write(1, 0x11, 1));
            bench.ask(y, &rtu::write(1, 0x11, 2));
            for pause in pauses {
                waves.follow(bench.trace()).unwrap();
                bench.run_until(bench.now() + pause.micros());
                if pause % 7 == 0 {
                    bench.ask(y, &rtu::write(1, 0x14, if pause % 2 == 0 { 0xFFFF } else { 0 }));
                    bench.ask(x, &rtu::write(1, 0x11, 1));
                }
            }
            waves.follow(bench.trace()).unwrap();
            waves.finish().unwrap();
            prop_assert_eq!(String::from_utf8(followed).unwrap(), text(bench.trace()));
        }
    }
}
