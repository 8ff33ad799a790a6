//! Waveforms as a VCD file (IEEE 1364-2001, section 18), for GTKWave and similar programs.
//!
//! The unit is 1 ns: readers that turn the unit into a rate of samples, as sigrok does, cannot cope with a
//! finer one. A time is rounded down from ticks of 62.5 ns, so different ticks have different times.
//!
//! Each drive is a scope. [`waveforms`](crate::signals::waveforms) describes its variables: pins are wires;
//! analogue inputs and motion are reals, `nan` if unknown; messages are strings, in which a space is written as
//! `\x20`. Every character of a name that is neither letter nor digit is replaced by `_`, because readers take a
//! dot for a level of hierarchy: `J2.5` becomes `J2_5`.

use std::io::{self, Write};

use drivetwin_firmware::device::Instant;

use crate::record::trace::Trace;
use crate::signals::waveforms::{Kind, Sink, Value, Waveforms};

/// Time unit of a file (HOST-11).
const TIMESCALE: &str = "1 ns";

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

/// Writer of a VCD file while a trace grows.
pub struct Waves<W> {
    waveforms: Waveforms,
    file: File<W>,
}

impl<W: Write> Waves<W> {
    /// Begins the file with the drives of the trace.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(trace: &Trace, mut out: W) -> io::Result<Self> {
        let waveforms = Waveforms::new(trace);
        let version = env!("CARGO_PKG_VERSION");
        let mut header = Vec::new();
        writeln!(header, "$version drivetwin {version} $end\n$timescale {TIMESCALE} $end")?;
        let mut codes = Vec::new();
        let scopes = names(trace.drives.iter().map(|drive| drive.name.as_str()));
        for (drive, scope) in scopes.iter().enumerate() {
            writeln!(header, "$scope module {scope} $end")?;
            let own = || waveforms.variables().iter().filter(|variable| variable.drive == drive);
            for (variable, name) in own().zip(names(own().map(|variable| variable.name.as_str()))) {
                let code = code(codes.len());
                let kind = match variable.kind {
                    Kind::Level => "wire 1",
                    Kind::Volts | Kind::Track(_) => "real 64",
                    Kind::Received | Kind::Sent => "string 1",
                };
                writeln!(header, "$var {kind} {code} {name} $end")?;
                codes.push(code);
            }
            writeln!(header, "$upscope $end")?;
        }
        writeln!(header, "$enddefinitions $end")?;
        out.write_all(&header)?;
        Ok(Self { waveforms, file: File { out, codes, text: Vec::new(), stamped: None, dumps: false } })
    }

    /// Writes the events since the last call. Changes at the last instant are held back, because more may
    /// happen at that instant.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn follow(&mut self, trace: &Trace) -> io::Result<()> {
        self.waveforms.follow(trace, &mut self.file)?;
        self.file.write_text()
    }

    /// Ends the file at the end of the trace.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn finish(self) -> io::Result<()> {
        let Self { waveforms, mut file } = self;
        let end = waveforms.finish(&mut file);
        // This last time shows how far the file goes.
        file.stamp(end);
        file.write_text()?;
        file.out.flush()
    }
}

/// The changes in a file.
struct File<W> {
    out: W,
    /// Codes that identify the variables, by index.
    codes: Vec<String>,
    /// Complete lines that are not written yet.
    text: Vec<u8>,
    /// The last time that was written.
    stamped: Option<Instant>,
    /// True while the first values are written.
    dumps: bool,
}

impl<W: Write> File<W> {
    /// Writes the time of the changes that follow, unless it is already written. The first time begins the
    /// first values.
    fn stamp(&mut self, at: Instant) {
        if self.stamped == Some(at) {
            return;
        }
        if std::mem::take(&mut self.dumps) {
            self.text.extend_from_slice(b"$end\n");
        }
        // A tick is 62.5 ns.
        let nanos = u128::from(at.ticks()) * 125 / 2;
        self.text.extend_from_slice(format!("#{nanos}\n").as_bytes());
        if self.stamped.replace(at).is_none() {
            self.text.extend_from_slice(b"$dumpvars\n");
            self.dumps = true;
        }
    }

    fn write_text(&mut self) -> io::Result<()> {
        self.out.write_all(&self.text)?;
        self.text.clear();
        Ok(())
    }
}

impl<W: Write> Sink for File<W> {
    fn change(&mut self, at: Instant, variable: usize, value: &Value) {
        self.stamp(at);
        let code = self.codes.get(variable).map_or("", String::as_str);
        let change = format!("{}{code}\n", text(value));
        self.text.extend_from_slice(change.as_bytes());
    }

    fn pause(&mut self) -> io::Result<()> {
        if self.text.len() < CHUNK { Ok(()) } else { self.write_text() }
    }
}

/// Text of a value, which is written before the code of the variable.
fn text(value: &Value) -> String {
    match value {
        Value::Level(level) => level.to_string(),
        Value::Number(Some(millionths)) => format!("r{} ", *millionths as f64 / 1e6),
        Value::Number(None) => "rnan ".to_owned(),
        // Readers skip a space, so no words are one space.
        Value::Words(words) if words.text.is_empty() => "s\\x20 ".to_owned(),
        Value::Words(words) => {
            let mut text = "s".to_owned();
            for char in words.text.chars() {
                match char {
                    // A text is one word. Readers know the escapes of C.
                    ' ' => text.push_str("\\x20"),
                    '\\' => text.push_str("\\x5c"),
                    '!'..='~' => text.push(char),
                    '…' => text.push_str("..."),
                    _ => text.push('?'),
                }
            }
            text + " "
        }
    }
}

/// Characters of codes. A reader that does not know texts takes the code after a text for a value, for instance
/// libsigrok. So codes have no characters that begin a value: letters, digits, `#`, `$` and `-`.
const SIGNS: &[u8] = br##"!"%&'()*+,./:;<=>?@[\]^_`{|}~"##;

/// Code of a variable from its index: as few characters as possible.
fn code(index: usize) -> String {
    let mut code = String::new();
    let mut rest = index;
    loop {
        code.extend(SIGNS.get(rest % SIGNS.len()).map(|&sign| char::from(sign)));
        if rest < SIGNS.len() {
            return code;
        }
        rest = rest / SIGNS.len() - 1;
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
    use drivetwin_firmware::mdrobot::Mdrobot;
    use drivetwin_firmware::rs434::Rs434;
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
$timescale 1 ns $end
$scope module a_toy $end
$var wire 1 ! IN $end
$var real 64 \" LEVEL $end
$var wire 1 % OUT $end
$var wire 1 & LED $end
$var real 64 ' position $end
$var real 64 ( speed $end
$var real 64 ) current $end
$var real 64 * duty $end
$var string 1 + usb_rx $end
$var string 1 , usb_tx $end
$var string 1 . net_rx $end
$var string 1 / net_tx $end
$upscope $end
$enddefinitions $end
#0
$dumpvars
1!
r0 \"
1%
1&
r0 '
r0 (
r0 )
r0 *
s\\x20 +
s\\x20 ,
s\\x20 .
s\\x20 /
$end
#500062
r2.5 \"
r0.038146 *
#1000000
0&
#2000000
x!
rnan \"
x%
x&
rnan '
rnan (
rnan )
rnan *
#3000000
1!
r2.5 \"
1%
1&
r0 '
r0 (
r0 )
r0.038146 *
#3500000
";
        assert_eq!(text(bench.trace()), header + expected);
    }

    #[test]
    fn a_contact_that_is_not_wired_floats() {
        let mut bench = Bench::new();
        let id = bench.add_with("c", Box::new(Mdrobot::md400()), Setup::default()).unwrap();
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
        assert_eq!(changes, [(0, "z"), (1_000_062, "0"), (2_000_062, "z")]);
    }

    #[test]
    fn a_drive_that_is_added_later_is_unknown_until_then() {
        let mut bench = Bench::new();
        bench.run_until(1.millis());
        bench.add::<TestDevice>("late");
        bench.run_until(1_500.micros());
        assert_eq!(
            changes(bench.trace()),
            [
                "0, x!, rnan \", x%, x&, rnan ', rnan (, rnan ), rnan *, s\\x20 +, s\\x20 ,, s\\x20 ., s\\x20 /",
                "1000000, 1!, r0 \", 1%, 1&, r0 ', r0 (, r0 ), r0 *",
                "1500000"
            ]
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
        assert!(changes.first().unwrap().starts_with("0, x!, rnan \", x%, x&, rnan '"), "{changes:?}");
        assert!(changes[2].contains(", r0.09"), "{changes:?}");
        // The drive has set its duty again, but not yet told of its plan.
        assert!(
            !changes[1..].iter().any(|change| change.contains(['!', '%', '&', '\'', '('])),
            "{changes:?}"
        );
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
        assert!(initial.contains("x,, x.") && initial.contains("1!"), "{initial}");
        assert!(changes(bench.trace())[0].contains("0,, 0."));
    }

    #[test]
    fn names_are_legal_and_differ() {
        let legal = names(["J2.10", "1", "_x", "a-b", "a.b", "a_b", "ä"].into_iter());
        assert_eq!(legal, ["J2_10", "_1", "_x", "a_b", "a_b_", "a_b__", "_"]);
    }

    #[test]
    fn codes_are_short_and_differ() {
        assert_eq!(
            (code(0), code(28), code(29), code(57)),
            ("!".into(), "~".into(), "!!".into(), "~!".into())
        );
        let codes: std::collections::BTreeSet<String> = (0..20_000).map(code).collect();
        assert_eq!(codes.len(), 20_000);
        assert!(
            codes.iter().all(|code| code.len() <= 3 && code.bytes().all(|sign| sign.is_ascii_punctuation()))
        );
        assert!(codes.iter().all(|code| !code.contains(['#', '$', '-'])));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]
        #[test]
        fn looking_often_or_once_makes_the_same_file(pauses in proptest::collection::vec(0_u64..200_000, 1..20)) {
            let mut bench = Bench::with(Settings { shafts: true, outcomes: true, ..Settings::default() });
            let (x, y) = (bench.add::<Md3>("x"), bench.add::<Md3>("y"));
            let z = bench.add_with("z", Box::new(Rs434::rs434544()), Setup::default()).unwrap();
            let mut followed = Vec::new();
            let mut waves = Waves::new(bench.trace(), &mut followed).unwrap();
            bench.run_until(2_500.millis());
            bench.ask(x, &rtu::write(1, 0x11, 1));
            bench.ask(y, &rtu::write(1, 0x11, 2));
            for (name, value) in [("MODE_ROTATION", 2), ("OFFSET", 300), ("START_bit", 1)] {
                let row = bench.spec(z).find(name).unwrap().row;
                bench.poke(z, row, value).unwrap();
            }
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
