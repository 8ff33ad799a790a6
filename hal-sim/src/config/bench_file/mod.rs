//! Bench files: a [`Layout`] as TOML. `docs/reference/bench-files.md` describes the format.
//!
//! The order of tables and keys makes no difference: a table may refer to a later table.

mod drive_tables;
mod expand;
mod fault_tables;
mod plant_tables;
mod scenario_tables;
mod table;

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use toml::de::DeTable;

use crate::bench::Bench;
use crate::bench::scenario::Scenario;
use crate::catalog;
use crate::config::layout::{DriveLayout, Layout};
use crate::config::listen::Uri;
use crate::line::LineMode;
use crate::record::trace;
use drive_tables::{BUS, DRIVE};
use drivetwin_firmware::device::{Instant, Spec};
use fault_tables::fault_keys;
use plant_tables::{ENCODER, MOTOR, SWITCH, WIRE};
use scenario_tables::SCENARIO;
use table::{Located, LocatedError, Table};

/// First error in the text of a bench file, with its position.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FileError {
    /// Line of the error, from 1.
    pub line: usize,
    /// Column of the error, in characters from 1.
    pub column: usize,
    /// The error in one sentence.
    pub what: String,
}

impl FileError {
    fn new(text: &str, wrong: LocatedError) -> Self {
        let before = text.get(..wrong.at).unwrap_or(text);
        let start = before.rfind('\n').map_or(0, |at| at + 1);
        let (line, column) = (before.matches('\n').count() + 1, before[start..].chars().count() + 1);
        Self { line, column, what: wrong.what }
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}", self.line, self.column, self.what)
    }
}

impl std::error::Error for FileError {}

/// Reads the text of a bench file that uses no environment variables. See [`parse_with`].
///
/// # Errors
/// The first error of the text, with its line and column.
pub fn parse(text: &str) -> Result<Layout, FileError> {
    parse_with(text, &|_| None)
}

/// Reads the text of a bench file. `variable` returns the value of an environment variable. Paths in the text
/// are returned unchanged; see [`Layout::relative_to`].
///
/// ```
/// use drivetwin_sim::config::bench_file::parse_with;
///
/// let text = r#"
/// [defaults.drive]
/// kind = "md3"
///
/// [[drive]]
/// name = "x{1..3}"
/// address = "{n}"
/// set = { Speed = "${SPEED:-8000}" }
/// "#;
/// let layout = parse_with(text, &|name| std::env::var(name).ok()).unwrap();
/// let names: Vec<&str> = layout.drives.iter().map(|drive| drive.name.as_str()).collect();
/// assert_eq!(names, ["x1", "x2", "x3"]);
/// ```
///
/// # Errors
/// The first error of the text, with its line and column.
pub fn parse_with(text: &str, variable: &dyn Fn(&str) -> Option<String>) -> Result<Layout, FileError> {
    read(text, variable, Reader::default())
}

/// Reads tables for a bench that has drives already: they may refer to what `layout` has. Returns the layout with the
/// entries of both.
///
/// ```
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::config::bench_file::parse_more;
/// use drivetwin_sim::config::layout::Layout;
///
/// let mut bench = Bench::new();
/// bench.add::<Md3>("x");
/// let layout = parse_more("[[motor]]\nname = 'm'\ndrive = 'x'", Layout::of(&bench)).unwrap();
/// layout.add_to(&mut bench, Vec::new()).unwrap();
/// assert_eq!(bench.motors().len(), 1);
/// ```
///
/// # Errors
/// The first error of the text, with its line and column.
pub fn parse_more(text: &str, layout: Layout) -> Result<Layout, FileError> {
    read(text, &|_| None, Reader::after(layout))
}

/// Reads the `[[scenario]]` tables of a text for a bench, for [`Bench::play`]. Other tables are errors.
///
/// ```
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_sim::bench::Bench;
/// use drivetwin_sim::config::bench_file::parse_scenarios;
///
/// let mut bench = Bench::new();
/// bench.add::<Md3>("x");
/// let text = "[[scenario]]\nsteps = [{ after_ms = 100, drive = 'x', power = 'off' }]";
/// for scenario in parse_scenarios(text, &bench)? {
///     bench.play(scenario)?;
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The first error of the text, with its line and column. A step at a bench time that is past is an error, too.
pub fn parse_scenarios(text: &str, bench: &Bench) -> Result<Vec<Scenario>, FileError> {
    let reader = Reader { now: bench.now(), ..Reader::after(Layout::of(bench)) };
    read_root(text, &|_| None, &["scenario"], |root| reader.read_scenarios(root))
}

fn read(text: &str, variable: &dyn Fn(&str) -> Option<String>, reader: Reader) -> Result<Layout, FileError> {
    read_root(text, variable, &KEYS, |root| reader.read(root))
}

/// Reads a text whose tables and keys at the top are `keys`.
fn read_root<T>(
    text: &str,
    variable: &dyn Fn(&str) -> Option<String>,
    keys: &[&str],
    read: impl FnOnce(&Table<'_>) -> Result<T, LocatedError>,
) -> Result<T, FileError> {
    let (mut root, errors) = DeTable::parse_recoverable(text);
    let errors = errors.iter().map(|error| LocatedError {
        at: error.span().map_or(0, |span| span.start),
        what: format!("this is not TOML: {}", error.message()),
    });
    let result = match errors.min_by_key(|wrong| wrong.at) {
        Some(wrong) => Err(wrong),
        None => expand::expand(root.get_mut(), variable).and_then(|filled| {
            let root = Table::new("a bench file", root.span().start, root.get_ref(), &filled, keys)?;
            read(&root)
        }),
    };
    result.map_err(|wrong| FileError::new(text, wrong))
}

/// The keys of a bench file.
const KEYS: [&str; 11] =
    ["seed", "time", "line", "drive", "bus", "motor", "encoder", "switch", "wire", "fault", "scenario"];

/// Tables that have been read so far, and the names in use.
#[derive(Default)]
struct Reader {
    layout: Layout,
    /// Names of all drives, buses and motors, and the kind of each.
    names: BTreeMap<String, &'static str>,
    /// Description of each drive, by index.
    specs: Vec<&'static Spec>,
    /// True for each drive with an empty `listen` list, whose ports get no listening address.
    no_listen: Vec<bool>,
    /// All listening addresses so far.
    addresses: Vec<Uri>,
    /// All memory files so far.
    memories: Vec<PathBuf>,
    /// Bench time at which scenarios begin.
    now: Instant,
}

impl Reader {
    /// A reader that has read a layout.
    fn after(layout: Layout) -> Self {
        let drives = layout.drives.iter().map(|drive| (&drive.name, "drive"));
        let buses = layout.buses.iter().map(|bus| (&bus.name, "bus"));
        let motors = layout.motors.iter().map(|motor| (&motor.name, "motor"));
        let names = drives.chain(buses).chain(motors).map(|(name, what)| (name.clone(), what)).collect();
        let spec = |drive: &DriveLayout| {
            catalog::make(drive.kind).map_or(const { &Spec::EMPTY }, |device| device.spec())
        };
        let specs = layout.drives.iter().map(spec).collect();
        let no_listen = vec![true; layout.drives.len()];
        let memories = layout.drives.iter().filter_map(|drive| drive.nv.clone()).collect();
        Self { names, specs, no_listen, addresses: Vec::new(), memories, layout, now: Instant::ZERO }
    }

    fn read(mut self, root: &Table<'_>) -> Result<Layout, LocatedError> {
        self.layout.seed = root.whole("seed", 0, u64::MAX)?.map(|seed| seed.is);
        let time = root.text("time")?;
        self.layout.time = read_as(time, |text| text.parse().map_err(|error| format!("time: {error}")))?;
        self.layout.line = read_as(root.text("line")?, line_mode)?;
        let drives = root.each("drive", "[[drive]]", &DRIVE)?;
        if drives.is_empty() && self.layout.drives.is_empty() {
            return Err(LocatedError { at: root.at, what: "a bench needs a [[drive]]".to_owned() });
        }
        for table in drives {
            self.drive(&table)?;
        }
        if let (Some(time), Err(why)) = (time, self.layout.check_time()) {
            return Err(time.wrong(why));
        }
        for table in root.each("bus", "[[bus]]", &BUS)? {
            self.bus(&table)?;
        }
        self.reach_the_others();
        for table in root.each("motor", "[[motor]]", &MOTOR)? {
            self.motor(&table)?;
        }
        for table in root.each("encoder", "[[encoder]]", &ENCODER)? {
            self.encoder(&table)?;
        }
        for table in root.each("switch", "[[switch]]", &SWITCH)? {
            self.switch(&table)?;
        }
        for table in root.each("wire", "[[wire]]", &WIRE)? {
            self.wire(&table)?;
        }
        for table in root.each("fault", "[[fault]]", &fault_keys())? {
            self.fault(&table)?;
        }
        for table in root.each("scenario", "[[scenario]]", &SCENARIO)? {
            self.scenario(&table)?;
        }
        Ok(self.layout)
    }

    /// Reads the name of a drive, bus or motor, and checks that it is not in use.
    fn name(&mut self, table: &Table<'_>, what: &'static str) -> Result<String, LocatedError> {
        let name = table.needed_text("name")?;
        let word = |name: &str| name.chars().all(|char| char.is_alphanumeric() || "-_".contains(char));
        if !trace::is_name(name.is) || !word(name.is) {
            let rule = "a name is one word of letters, digits, - and _, does not begin with a digit and is not 'end'";
            return Err(name.wrong(format!("'{}' is no name; {rule}", name.is)));
        }
        if let Some(other) = self.names.insert(name.is.to_owned(), what) {
            return Err(name.wrong(format!("there is a {other} '{}' already", name.is)));
        }
        Ok(name.is.to_owned())
    }
}

/// Parses the string of a key, if the key is present.
fn read_as<T>(
    text: Option<Located<&str>>,
    read: impl FnOnce(&str) -> Result<T, String>,
) -> Result<Option<T>, LocatedError> {
    text.map(|text| read(text.is).map_err(LocatedError::at(text.at))).transpose()
}

/// Reads the value of the key `line`: `timed` or `fast`.
///
/// # Errors
/// One sentence: it is neither.
pub fn line_mode(text: &str) -> Result<LineMode, String> {
    match text {
        "timed" | "wire" => Ok(LineMode::Timed),
        "fast" => Ok(LineMode::Fast),
        _ => Err(format!("line takes timed or fast, not '{text}'")),
    }
}

#[cfg(test)]
mod tests {
    use super::scenario_tables::{STEP, WHEN};
    use super::*;

    /// The reference has a heading for every table, and a row for every key of the table.
    #[test]
    fn the_reference_has_every_key() {
        let reference = include_str!("../../../../docs/reference/bench-files.md");
        let section = |heading: &str| {
            let (_, rest) = reference.split_once(heading).unwrap_or_else(|| panic!("no {heading}"));
            rest.split("\n## ").next().unwrap_or_default()
        };
        let tables: [(&str, &[&str]); 9] = [
            ("\n## The bench\n", &KEYS[..3]),
            ("\n## `[[drive]]`\n", &DRIVE),
            ("\n## `[[bus]]`\n", &BUS),
            ("\n## `[[motor]]`\n", &MOTOR),
            ("\n## `[[encoder]]`\n", &ENCODER),
            ("\n## `[[switch]]`\n", &SWITCH),
            ("\n## `[[wire]]`\n", &WIRE),
            ("\n## `[[fault]]`\n", &fault_keys()),
            ("\n## `[[scenario]]`\n", &[&SCENARIO[..], &STEP, &WHEN[..]].concat()),
        ];
        assert_eq!(3 + tables.len() - 1, KEYS.len());
        for (heading, keys) in tables {
            let section = section(heading);
            for key in keys {
                let is_row = |row: &str| row.replace('*', "").starts_with(&format!("| `{key}` |"));
                assert!(section.lines().any(is_row), "{heading}: {key}");
            }
        }
        let fault = section("\n## `[[fault]]`\n");
        for key in fault_tables::RULE.iter().chain(&["code", "before", "ms", "spread_ms"]) {
            assert!(fault.lines().any(|row| row.starts_with(&format!("| `{key}` |"))), "{key}");
        }
    }
}
