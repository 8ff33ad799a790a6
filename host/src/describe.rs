//! Description of a kind of drive: as text, as the reference in docs/, as JSON.
//!
//! Every text is generated from the drive's [`Spec`], so the same kind always gives the same text.

mod family;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use drivetwin_firmware::device::{self, Framing, Level, Pin, PinSpec, Role, Spec};
use drivetwin_panel::schema::ValueSchema;
use drivetwin_protocol::registers::{self, Legal, Row, Shape, Space, Table, characters};
use drivetwin_sim::value::Value;
use serde::Serialize;
use utoipa::ToSchema;

/// Description of a kind as JSON, on one line.
pub fn json(spec: &Spec) -> String {
    let pin = |pin: Pin| pin_name(spec, pin);
    let kind = Kind {
        kind: spec.kind,
        product: spec.product,
        manual: spec.manual,
        ports: spec
            .ports
            .iter()
            .map(|port| Port {
                name: port.name,
                message_ends: ends(port.framing),
                line: port.line.map(|line| line.to_string()),
            })
            .collect(),
        pins: spec
            .pins
            .iter()
            .map(|pin| PinOf {
                name: pin.name,
                aliases: aliases(spec, pin.name),
                role: role(pin),
                rest: level(pin.idle),
            })
            .collect(),
        axes: spec
            .axes
            .iter()
            .map(|axis| Axis {
                name: axis.name,
                step: axis.step_dir.map(|(step, _)| pin(step)),
                direction: axis.step_dir.map(|(_, direction)| pin(direction)),
            })
            .collect(),
        encoders: spec
            .encoders
            .iter()
            .map(|encoder| Encoder { a: pin(encoder.a), b: pin(encoder.b), index: encoder.index.map(pin) })
            .collect(),
        faults: spec.faults,
        memory_bytes: spec.memory,
        address_register: spec.address.and_then(|row| spec.registers.rows.get(row)).map(|row| row.name),
        registers: spec.rows().map(|(_, row)| Register::of(spec.registers, row)).collect(),
        commands: spec.commands.iter().map(Command::of).collect(),
        not_modelled: spec.not_modelled,
    };
    serde_json::to_string(&kind).expect("plain numbers and text")
}

/// A kind of drive.
#[derive(Serialize, ToSchema)]
#[schema(as = KindDescription)]
pub(crate) struct Kind {
    kind: &'static str,
    product: &'static str,
    manual: &'static str,
    ports: Vec<Port>,
    pins: Vec<PinOf>,
    axes: Vec<Axis>,
    encoders: Vec<Encoder>,
    faults: &'static [&'static str],
    memory_bytes: u16,
    address_register: Option<&'static str>,
    registers: Vec<Register>,
    commands: Vec<Command>,
    not_modelled: &'static [&'static str],
}

#[derive(Serialize, ToSchema)]
#[schema(as = PortDescription)]
struct Port {
    name: &'static str,
    message_ends: &'static str,
    line: Option<String>,
}

#[derive(Serialize, ToSchema)]
#[schema(as = PinDescription)]
struct PinOf {
    name: &'static str,
    aliases: Vec<&'static str>,
    role: &'static str,
    rest: &'static str,
}

#[derive(Serialize, ToSchema)]
#[schema(as = AxisDescription)]
struct Axis {
    name: &'static str,
    step: Option<&'static str>,
    direction: Option<&'static str>,
}

#[derive(Serialize, ToSchema)]
#[schema(as = EncoderDescription)]
struct Encoder {
    a: &'static str,
    b: &'static str,
    index: Option<&'static str>,
}

#[derive(Serialize, ToSchema)]
#[schema(as = RegisterDescription)]
struct Register {
    name: &'static str,
    section: &'static str,
    space: &'static str,
    address: u16,
    addresses: u16,
    #[serde(rename = "type")]
    shape: String,
    access: &'static str,
    streams: bool,
    least: Option<i64>,
    greatest: Option<i64>,
    codes: Option<&'static [i64]>,
    /// Minimum and maximum of each word, in bus order; only for rows that are not one number.
    words: Option<Vec<(u16, u16)>>,
    acts_within: Option<(i64, i64)>,
    #[schema(value_type = ValueSchema)]
    default: Value,
    saved_bits: u16,
    doc: String,
    fields: Vec<Field>,
    not_modelled: Option<&'static str>,
}

/// Bits of a register that have a meaning of their own.
#[derive(Serialize, ToSchema)]
#[schema(as = FieldDescription)]
struct Field {
    /// `12:8`, `5`, or `15:0` for a whole register.
    bits: String,
    name: &'static str,
    /// Names of values.
    #[schema(value_type = BTreeMap<String, String>)]
    values: BTreeMap<u16, &'static str>,
}

impl Field {
    fn of(field: &registers::Field) -> Self {
        Self { bits: bits(field), name: field.name, values: field.values.iter().copied().collect() }
    }
}

impl Register {
    fn of(table: &Table, row: &Row) -> Self {
        let (limits, codes, words) = match (row.legal, row.shape) {
            (Legal::Any, Shape::Words(n)) => (None, None, Some(vec![(0, u16::MAX); n.into()])),
            (Legal::Any, shape) => (Some(shape.limits()), None, None),
            (Legal::Range(least, greatest), _) => (Some((least, greatest)), None, None),
            (Legal::OneOf(codes), _) => (None, Some(codes), None),
            (Legal::Each(ranges), _) => (None, None, Some(ranges.to_vec())),
            (Legal::Text, shape) => (None, None, Some(vec![(0, u16::MAX); shape.words().into()])),
        };
        Self {
            name: row.name,
            section: row.section,
            space: space(row.space),
            address: row.address,
            addresses: addresses(table, row),
            shape: shape(row),
            access: row.access.as_str(),
            streams: row.streams,
            least: limits.map(|(least, _)| least),
            greatest: limits.map(|(_, greatest)| greatest),
            codes,
            words,
            acts_within: row.clamp,
            default: Value::of(table, row.shape, row.reset),
            saved_bits: row.saved,
            doc: doc(row),
            fields: row.fields.iter().map(Field::of).collect(),
            not_modelled: (!row.missing.is_empty()).then_some(row.missing),
        }
    }
}

#[derive(Serialize, ToSchema)]
#[schema(as = CommandDescription)]
struct Command {
    code: u16,
    name: &'static str,
    section: &'static str,
    doc: &'static str,
    not_modelled: Option<&'static str>,
}

impl Command {
    fn of(command: &device::CommandSpec) -> Self {
        let &device::CommandSpec { code, name, section, doc, missing } = command;
        Self { code, name, section, doc, not_modelled: (!missing.is_empty()).then_some(missing) }
    }
}

/// Description of a kind as text in aligned columns.
pub fn text(spec: &Spec) -> String {
    let mut text = format!("{}: {}, after {}\n", spec.kind, spec.product, spec.manual);
    for section in sections(spec) {
        let _ = write!(text, "\n{}\n", section.title);
        section.aligned(&mut text);
    }
    text
}

/// The reference page in docs/: of one kind, or of a family of kinds that share most of their tables.
pub fn markdown(specs: &[&Spec]) -> String {
    match specs {
        [spec] => of_one(spec),
        _ => family::markdown(specs),
    }
}

fn of_one(spec: &Spec) -> String {
    let mut text = format!(
        "<!-- Made by `drivetwin describe {kind} --markdown`; not to be edited. -->\n\n# {product} (`{kind}`)\n\n\
         After {manual}. The column § names its sections.\n",
        kind = spec.kind,
        product = spec.product,
        manual = spec.manual,
    );
    for section in sections(spec) {
        let _ = write!(text, "\n## {}\n\n", section.title);
        section.markdown(&mut text);
    }
    text
}

/// A table with a heading.
struct Section {
    title: &'static str,
    /// Column headings; empty for a plain list.
    columns: &'static [&'static str],
    rows: Vec<Vec<String>>,
}

impl Section {
    fn aligned(&self, text: &mut String) {
        if self.columns.is_empty() {
            for row in &self.rows {
                let _ = writeln!(text, "  {}", row.join(": "));
            }
            return;
        }
        let heading: Vec<String> = self.columns.iter().map(ToString::to_string).collect();
        let lines = || std::iter::once(&heading).chain(&self.rows);
        let width = |column: usize| {
            lines().filter_map(|line| line.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        for line in lines() {
            let mut row = String::from(" ");
            for (column, cell) in line.iter().enumerate() {
                let _ = write!(row, " {cell:<width$} ", width = width(column));
            }
            let _ = writeln!(text, "{}", row.trim_end());
        }
    }

    fn markdown(&self, text: &mut String) {
        if self.columns.is_empty() {
            for row in &self.rows {
                let _ = writeln!(text, "- {}", row.join(": "));
            }
            return;
        }
        let _ = writeln!(text, "| {} |\n|{}", self.columns.join(" | "), "---|".repeat(self.columns.len()));
        for row in &self.rows {
            let cells: Vec<String> = row.iter().map(|cell| cell.replace('|', "\\|")).collect();
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        }
    }
}

/// Title of the list of what is not modelled.
const NOT_MODELLED: &str = "Also not modelled";

/// Columns of rows that have no address.
const NAMED: &[&str] = &["Name", "§", "Type", "Access", "Values", "Default", "Saved", "What it is"];

/// All tables of the description that may have rows, in the order of a manual.
fn sections(spec: &Spec) -> Vec<Section> {
    let pin = |pin: Pin| pin_name(spec, pin).to_owned();
    let ports = spec.ports.iter().map(|port| {
        let line = port.line.map_or("TCP".into(), |line| line.to_string());
        vec![port.name.into(), line, ends(port.framing).into()]
    });
    let pins = spec.pins.iter().map(|pin| {
        let mut names = vec![pin.name];
        names.extend(aliases(spec, pin.name));
        vec![names.join(", "), role(pin).into(), rest(pin)]
    });
    let axes = spec.axes.iter().map(|axis| {
        let (step, direction) = axis.step_dir.map_or_else(Default::default, |(a, b)| (pin(a), pin(b)));
        vec![axis.name.into(), step, direction]
    });
    let encoders = spec
        .encoders
        .iter()
        .map(|encoder| vec![pin(encoder.a), pin(encoder.b), encoder.index.map(pin).unwrap_or_default()]);
    let rows = || spec.rows().map(|(_, row)| row);
    let by_name = |space| rows().filter(move |row| row.space == space).map(|row| cells_of(spec, row));
    let on_a_bus = |row: &&Row| !matches!(row.space, Space::Variable | Space::Setting);
    let on_the_bus = rows().filter(on_a_bus).map(|row| {
        let mut cells = vec![register_address(spec, row)];
        cells.extend(cells_of(spec, row));
        cells
    });
    let commands = spec.commands.iter().map(|command| {
        let does = with_reason(command.doc.into(), command.missing);
        vec![command.code.to_string(), command.name.into(), command.section.into(), does]
    });
    let missing = spec.not_modelled.iter().map(|what| vec![what.to_string()]);
    let sections = [
        Section { title: "Ports", columns: &["Port", "Line", "A message ends"], rows: ports.collect() },
        Section { title: "Pins", columns: &["Pin", "Role", "At rest"], rows: pins.collect() },
        Section { title: "Axes", columns: &["Axis", "Step", "Direction"], rows: axes.collect() },
        Section { title: "Encoder inputs", columns: &["A", "B", "Index"], rows: encoders.collect() },
        Section {
            title: "Faults",
            columns: &[],
            rows: spec.faults.iter().map(|fault| vec![fault.to_string()]).collect(),
        },
        Section {
            title: "Registers",
            columns: &["Address", "Name", "§", "Type", "Access", "Values", "Default", "Saved", "What it is"],
            rows: on_the_bus.collect(),
        },
        Section {
            title: "Commands",
            columns: &["Code", "Name", "§", "What it does"],
            rows: commands.collect(),
        },
        Section {
            title: "Variables without an address",
            columns: NAMED,
            rows: by_name(Space::Variable).collect(),
        },
        Section {
            title: "Settings of the emulation (by name only)",
            columns: NAMED,
            rows: by_name(Space::Setting).collect(),
        },
        Section {
            title: "Bits and values of registers",
            columns: &["Register", "Bits", "Meaning", "Values"],
            rows: rows().flat_map(fields).collect(),
        },
        Section { title: NOT_MODELLED, columns: &[], rows: missing.collect() },
    ];
    sections.into_iter().filter(|section| !section.rows.is_empty()).collect()
}

/// Cells of a register's row, without its address.
fn cells_of(spec: &Spec, row: &Row) -> Vec<String> {
    let saved = match row.saved {
        0 => "no".into(),
        u16::MAX => "yes".into(),
        bits => format!("bits {bits:#06x}"),
    };
    vec![
        row.name.into(),
        row.section.into(),
        shape(row),
        access(row),
        values(spec, row),
        default(spec, row),
        saved,
        with_reason(doc(row), row.missing),
    ]
}

/// Appends the reason why something is not modelled.
fn with_reason(what: String, missing: &str) -> String {
    if missing.is_empty() { what } else { format!("{what} ({missing})") }
}

/// Access that a master has to a row; `/S` if the row can be streamed.
fn access(row: &Row) -> String {
    format!("{}{}", row.access.as_str(), if row.streams { "/S" } else { "" })
}

/// Factory value of a row: single words in hexadecimal, as most manuals print them; longer and signed values
/// as numbers.
fn default(spec: &Spec, row: &Row) -> String {
    match row.shape {
        _ if row.legal == Legal::Text => {
            String::from_utf8_lossy(&characters(row.reset).collect::<Vec<_>>()).into()
        }
        Shape::U8 | Shape::U16 if spec.decimal => row.reset.to_string(),
        Shape::U8 => format!("{:#04x}", row.reset),
        Shape::U16 => format!("{:#06x}", row.reset),
        _ => Value::of(spec.registers, row.shape, row.reset).to_string(),
    }
}

/// Valid values of a row, and the range to which the drive limits their effect.
fn values(spec: &Spec, row: &Row) -> String {
    let mut values = match row.legal {
        Legal::Any => "any".into(),
        Legal::Text => "text".into(),
        Legal::Range(least, greatest) => format!("{least}…{greatest}"),
        Legal::Each(ranges) => {
            let ranges = ranges.iter().map(|(least, greatest)| format!("{least}…{greatest}"));
            ranges.collect::<Vec<_>>().join(", ")
        }
        Legal::OneOf(codes) => {
            // Except in a manual with decimal numbers, codes are bit patterns whatever their width.
            let code = |code: &i64| if spec.decimal { code.to_string() } else { format!("{code:#x}") };
            codes.iter().map(code).collect::<Vec<_>>().join(", ")
        }
    };
    if let Some((least, greatest)) = row.clamp {
        let _ = write!(values, ", acts as {least}…{greatest}");
    }
    values
}

/// Address of a row.
fn register_address(spec: &Spec, row: &Row) -> String {
    let address = |n: u16| if spec.decimal { n.to_string() } else { format!("{n:#04x}") };
    let first = row.address;
    let last = first.saturating_add(addresses(spec.registers, row) - 1);
    let register_address =
        if last == first { address(first) } else { format!("{}–{}", address(first), address(last)) };
    match row.space {
        Space::Holding | Space::Variable | Space::Setting => register_address,
        other => format!("{} {register_address}", space(other)),
    }
}

fn addresses(table: &Table, row: &Row) -> u16 {
    if table.layout.objects { 1 } else { row.shape.words() }
}

fn shape(row: &Row) -> String {
    match row.shape {
        Shape::Words(n) => format!("{n} words"),
        shape => shape.as_str().into(),
    }
}

fn doc(row: &Row) -> String {
    row.doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Rows of the table of fields: register, bits, meaning, values with a name.
fn fields(row: &Row) -> impl Iterator<Item = Vec<String>> {
    row.fields.iter().map(|field| {
        let values: Vec<_> = field.values.iter().map(|(value, name)| format!("{value} = {name}")).collect();
        let (bits, name) = match field.name {
            "" => ("all".into(), "value"),
            name => (bits(field), name),
        };
        vec![row.name.into(), bits, name.into(), values.join("; ")]
    })
}

/// The bits of a field: `12:8` or `5`.
fn bits(field: &registers::Field) -> String {
    if field.high == field.low { field.low.to_string() } else { format!("{}:{}", field.high, field.low) }
}

/// The other names of a pin.
fn aliases(spec: &Spec, name: &str) -> Vec<&'static str> {
    let pin = spec.pin(name);
    spec.aliases.iter().filter(|(_, of)| Some(*of) == pin).map(|(alias, _)| *alias).collect()
}

fn pin_name(spec: &Spec, pin: Pin) -> &'static str {
    spec.pins.get(usize::from(pin.0)).map_or("-", |pin| pin.name)
}

fn ends(ends: Framing) -> &'static str {
    match ends {
        Framing::Silence => "with 3.5 characters of silence",
        Framing::Character => "with an end character of its commands",
        Framing::Mbap => "after the length that its header contains",
        Framing::Return => "with a carriage return",
    }
}

fn role(pin: &PinSpec) -> &'static str {
    match pin.role {
        Role::Input => "input",
        Role::Output => "output",
        Role::Both => "input or output",
        Role::Analogue if pin.shunt_ohm > 0 => "analogue input, V or mA",
        Role::Analogue => "analogue input",
        Role::AnalogueOrDigital => "digital or analogue input",
        Role::Led => "LED",
    }
}

fn rest(pin: &PinSpec) -> String {
    let once_used = if pin.high_once_used { ", high once used" } else { "" };
    format!("{}{once_used}", level(pin.idle))
}

fn level(level: Level) -> &'static str {
    match level {
        Level::Low => "low",
        Level::High => "high",
        Level::Float => "open",
    }
}

fn space(space: Space) -> &'static str {
    match space {
        Space::Coil => "coil",
        Space::Discrete => "discrete",
        Space::Input => "input",
        Space::Holding => "holding",
        Space::Variable => "variable",
        Space::Setting => "setting",
    }
}
