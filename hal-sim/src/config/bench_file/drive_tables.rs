//! Tables of drives, and of the lines that drives share.

use std::path::{Path, PathBuf};

use drivetwin_firmware::device::{Framing, Pin, Port, PortSpec, Spec};

use super::Reader;
use super::scenario_tables::find_fault;
use super::table::{Located, LocatedError, Table};
use crate::catalog;
use crate::config::board_place::{BoardPlace, check_bus, reasons};
use crate::config::layout::{self, At, BoardLayout, BusLayout, DriveLayout};
use crate::config::listen::{Listen, Uri};
use crate::config::preset::{self, Number, Preset};
use crate::rsasm;
use crate::suggest;

/// The keys of `[[drive]]`.
pub(super) const DRIVE: [&str; 11] =
    ["name", "kind", "address", "nv", "set", "program", "fast_boot", "listen", "faults", "board", "bus"];
/// The keys of `[[drive]]` that are for emulated drives only, each with the reason why a board does not take it (BENCH-22).
const NOT_OF_BOARDS: [(&str, &str); 7] = [
    ("address", "it has the address that it has saved; a master or the control API sets another one"),
    ("nv", "it has its memory in its flash; the control API reads and replaces it"),
    ("set", "it has the registers that it has saved; a master or the control API sets them"),
    ("program", "it has its memory in its flash; the control API reads and replaces it"),
    ("fast_boot", "its image has a start-up delay, or has none"),
    ("listen", "its line is a real one; 'bus' is the address at which masters open it"),
    ("faults", "a run does not change it at its start; the control API sets faults"),
];
/// The keys of `[[bus]]`.
pub(super) const BUS: [&str; 5] = ["name", "listen", "drives", "collisions", "strict"];

/// A line or TCP port of the bench.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Line {
    /// A shared line: index in the layout.
    Shared(usize),
    /// The own line of a serial port, or a TCP port: index of the drive, and port.
    Own(usize, Port),
}

impl Reader {
    pub(super) fn drive(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let name = self.name(table, "drive")?;
        if table.text("board")?.is_some() {
            return self.board(table, name);
        }
        if let Some(bus) = table.any_of(&["bus"]) {
            return Err(bus.wrong(format!("bus is a key of a drive on a board, and '{name}' has no 'board'")));
        }
        let kind = table.needed_text("kind")?;
        let spec = catalog::make(kind.is).map_err(LocatedError::at(kind.at))?.spec();
        let program = path(table, "program")?;
        if let Some(program) = &program
            && !rsasm::runs_on(spec)
        {
            return Err(program.wrong(format!("{} has no user programs", spec.kind)));
        }
        let nv = path(table, "nv")?;
        if let Some(nv) = &nv {
            if self.memories.iter().any(|other| layout::same_path(other, &nv.is)) {
                return Err(nv.wrong(format!(
                    "{} is already the memory of another drive; use another file",
                    nv.is.display()
                )));
            }
            self.memories.push(nv.is.clone());
        }
        let mut drive = DriveLayout {
            name,
            kind: spec.kind,
            listen: Vec::new(),
            nv: nv.map(|nv| nv.is),
            presets: Vec::new(),
            program: program.map(|program| program.is),
            fast_boot: table.flag("fast_boot")?.is_some_and(|fast| fast.is),
            faults: Vec::new(),
            board: None,
        };
        let listen = table.texts("listen")?;
        self.no_listen.push(listen.as_ref().is_some_and(|listen| listen.is.is_empty()));
        for text in listen.map_or(Vec::new(), |listen| listen.is) {
            let address = layout::address(spec, &self.listen(&text)?).map_err(LocatedError::at(text.at))?;
            self.add_address(&text, &address.1)?;
            drive.listen.push(address);
        }
        for fault in table.texts("faults")?.map_or(Vec::new(), |faults| faults.is) {
            drive.faults.push(find_fault(spec, fault.is).map_err(LocatedError::at(fault.at))?);
        }
        let presets = presets(table, spec)?;
        drive.presets = presets.iter().map(|preset| preset.is).collect();
        if let Err((row, why)) = drive.try_presets() {
            let preset = presets.iter().find(|preset| preset.is.row == row);
            let name = spec.registers.rows.get(row).map_or("", |row| row.name);
            let at = preset.map_or(table.at, |preset| preset.at);
            return Err(LocatedError { at, what: preset::refusal(spec, row, name, why) });
        }
        self.layout.drives.push(drive);
        self.specs.push(spec);
        Ok(())
    }

    /// Reads a drive that is on a board.
    fn board(&mut self, table: &Table<'_>, name: String) -> Result<(), LocatedError> {
        for key in table.keys() {
            if let Some((_, why)) = NOT_OF_BOARDS.iter().find(|(other, _)| *other == key.is) {
                return Err(key.wrong(format!("'{name}' is on a board and takes no '{}': {why}", key.is)));
            }
        }
        let text = table.needed_text("board")?;
        let place: BoardPlace = text
            .is
            .parse()
            .map_err(|error| text.wrong(format!("there is no board at '{}': {error}", text.is)))?;
        let boards = self.layout.drives.iter().filter_map(|drive| Some((drive, drive.board.as_ref()?)));
        if let Some((other, _)) = boards.into_iter().find(|(_, board)| board.place == place) {
            return Err(
                text.wrong(format!("{place} is already the board of '{}'; a board is one drive", other.name))
            );
        }
        let kind = table.text("kind")?;
        let spec = match &kind {
            Some(kind) => catalog::make(kind.is).map_err(LocatedError::at(kind.at))?.spec(),
            None => &Spec::EMPTY,
        };
        let bus = table.text("bus")?.map(|text| {
            let bus = text.is.parse().and_then(|bus| check_bus(&bus).map(|()| bus));
            bus.map_err(|error| text.wrong(format!("bus: {error}")))
        });
        self.layout.drives.push(DriveLayout {
            name,
            kind: spec.kind,
            listen: Vec::new(),
            nv: None,
            presets: Vec::new(),
            program: None,
            fast_boot: false,
            faults: Vec::new(),
            board: Some(BoardLayout { place, bus: bus.transpose()? }),
        });
        self.specs.push(spec);
        self.no_listen.push(true);
        Ok(())
    }

    pub(super) fn bus(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let name = self.name(table, "bus")?;
        let mut bus = BusLayout {
            name,
            listen: vec![Uri::Tcp("127.0.0.1:0".into())],
            drives: Vec::new(),
            collisions: table.flag("collisions")?.is_some_and(|collide| collide.is),
            strict: table.flag("strict")?.is_some_and(|strict| strict.is),
        };
        let drives = table.needs("drives", table.texts("drives")?)?;
        if drives.is.is_empty() {
            return Err(drives.wrong("list at least one drive of the bus"));
        }
        for text in drives.is {
            let (drive, port) = self.port(text.is).map_err(LocatedError::at(text.at))?;
            let spec = self.spec(drive);
            let of = (spec.ports.get(usize::from(port.0))).map_or("", |port| port.name);
            let what = || format!("{of} of {}", self.layout.drives[drive].name);
            if bus.drives.contains(&(drive, port)) {
                return Err(text.wrong(format!("{} is on this bus already", what())));
            }
            if let Some(other) = self.bus_of(drive, port) {
                return Err(text.wrong(format!("{} is on the bus '{}' already", what(), other.name)));
            }
            if self.layout.drives[drive].listen.iter().any(|(reached, _)| *reached == port) {
                let goes = format!("its listen is in the [[bus]] '{}'", bus.name);
                return Err(text.wrong(format!("{} is on a bus, so {goes}", what())));
            }
            bus.drives.push((drive, port));
        }
        if let Some(listen) = table.texts("listen")? {
            bus.listen.clear();
            for text in listen.is {
                let listen = self.listen(&text)?;
                if let Some(port) = listen.port {
                    return Err(text.wrong(format!("a bus has no ports; leave out '{port}='")));
                }
                self.add_address(&text, &listen.uri)?;
                bus.listen.push(listen.uri);
            }
        }
        self.layout.buses.push(bus);
        Ok(())
    }

    /// Assigns a loopback TCP port to each port without a listening address in the file (HOST-18).
    pub(super) fn reach_the_others(&mut self) {
        for drive in 0..self.layout.drives.len() {
            let ports = (0..self.spec(drive).ports.len()).map(|port| Port(port as u8));
            let has_address =
                |port| self.layout.drives[drive].listen.iter().any(|&(listed, _)| listed == port);
            let left = |&port: &Port| {
                !self.no_listen[drive] && !has_address(port) && self.bus_of(drive, port).is_none()
            };
            let own = ports.filter(left);
            let addresses: Vec<_> = own.map(|port| (port, Uri::Tcp("127.0.0.1:0".into()))).collect();
            self.layout.drives[drive].listen.extend(addresses);
        }
    }

    fn listen(&self, text: &Located<&str>) -> Result<Listen, LocatedError> {
        text.is.parse().map_err(|error| text.wrong(format!("cannot listen at '{}': {error}", text.is)))
    }

    /// Adds a listening address and checks that it is not in use.
    fn add_address(&mut self, text: &Located<&str>, uri: &Uri) -> Result<(), LocatedError> {
        if self.addresses.iter().any(|other| layout::clash(other, uri)) {
            return Err(text.wrong(format!("{uri} is given twice")));
        }
        self.addresses.push(uri.clone());
        Ok(())
    }

    /// Description of a drive.
    pub(super) fn spec(&self, drive: usize) -> &'static Spec {
        self.specs[drive]
    }

    /// Index of the drive with that name.
    pub(super) fn drive_named(&self, name: &str) -> Result<usize, String> {
        let names = self.layout.drives.iter().map(|drive| drive.name.as_str());
        names.clone().position(|other| other == name).ok_or_else(|| suggest::unknown("drive", name, names))
    }

    /// Index of the drive with that name, which must not be on a board, for the reason `why`.
    pub(super) fn emulated(&self, name: &str, why: &str) -> Result<usize, String> {
        let drive = self.drive_named(name)?;
        match self.layout.drives[drive].board {
            Some(_) => Err(format!("'{name}' is on a board: {why}")),
            None => Ok(drive),
        }
    }

    /// The bus that a port is on.
    fn bus_of(&self, drive: usize, port: Port) -> Option<&BusLayout> {
        self.layout.buses.iter().find(|bus| bus.drives.contains(&(drive, port)))
    }

    /// A port that can be on a bus, named like `x` or `x.rs485`.
    fn port(&self, text: &str) -> Result<(usize, Port), String> {
        let (drive, name) = text.split_once('.').map_or((text, None), |(drive, port)| (drive, Some(port)));
        let drive = self.emulated(drive, reasons::NO_BUS)?;
        let spec = self.spec(drive);
        let fits = |port: &PortSpec| port.framing == Framing::Silence && !port.is_tcp();
        let mut ports = (0..).map(Port).zip(spec.ports);
        let Some(name) = name else {
            let fit = ports.find(|(_, port)| fits(port)).map(|(port, _)| (drive, port));
            return fit.ok_or_else(|| format!("{} has no port for a bus", spec.kind));
        };
        let found = ports.find(|(_, port)| port.name == name);
        match found {
            Some((port, of)) if fits(of) => Ok((drive, port)),
            Some(_) => Err(format!("{name} of {} is not a port for a bus", spec.kind)),
            None => Err(unknown_port(spec, name)),
        }
    }

    /// The line or TCP port with a name like `line1`, `rs485` or `x.modbus`.
    pub(super) fn line_named(&self, text: &str) -> Result<Line, String> {
        if let Some(bus) = self.layout.buses.iter().position(|bus| bus.name == text) {
            return Ok(Line::Shared(bus));
        }
        let lines = self.own_lines();
        if let Some((drive, port)) = text.split_once('.')
            && self.drive_named(drive).is_ok()
        {
            let drive = self.emulated(drive, reasons::NO_LINE_FAULTS)?;
            let spec = self.spec(drive);
            let (port, _) = (0..)
                .map(Port)
                .zip(spec.ports)
                .find(|(_, of)| of.name == port)
                .ok_or_else(|| unknown_port(spec, port))?;
            if let Some(bus) = self.bus_of(drive, port) {
                return Err(format!("{text} is on the bus '{}'", bus.name));
            }
            return Ok(Line::Own(drive, port));
        }
        let alike: Vec<Line> = lines.iter().copied().filter(|&line| self.port_name(line) == text).collect();
        match alike[..] {
            [line] => Ok(line),
            [] => {
                let names: Vec<String> = (0..self.layout.buses.len())
                    .map(Line::Shared)
                    .chain(lines)
                    .map(|line| self.name_of(line))
                    .collect();
                Err(suggest::unknown("bus", text, names.iter().map(String::as_str)))
            }
            [first, ..] => {
                Err(format!("several drives have a port '{text}'; '{}' is one", self.name_of(first)))
            }
        }
    }

    /// The lines of all serial ports that are on no bus, and all TCP ports.
    fn own_lines(&self) -> Vec<Line> {
        let drives = (0..self.layout.drives.len()).filter(|&drive| self.layout.drives[drive].board.is_none());
        let ports = drives.flat_map(|drive| {
            let ports = (0..).map(Port).zip(self.spec(drive).ports);
            ports.map(move |(port, _)| (drive, port))
        });
        ports
            .filter(|&(drive, port)| self.bus_of(drive, port).is_none())
            .map(|(drive, port)| Line::Own(drive, port))
            .collect()
    }

    /// Port of the first drive on a line.
    pub(super) fn port_of(&self, line: Line) -> Option<&'static PortSpec> {
        let (drive, port) = match line {
            Line::Shared(bus) => *self.layout.buses[bus].drives.first()?,
            Line::Own(drive, port) => (drive, port),
        };
        self.spec(drive).ports.get(usize::from(port.0))
    }

    fn port_name(&self, line: Line) -> &'static str {
        self.port_of(line).map_or("", |port| port.name)
    }

    /// The unique name of a line (BENCH-3).
    pub(super) fn name_of(&self, line: Line) -> String {
        match line {
            Line::Shared(bus) => self.layout.buses[bus].name.clone(),
            Line::Own(drive, _) => format!("{}.{}", self.layout.drives[drive].name, self.port_name(line)),
        }
    }

    /// The pin with a name like `x.J2.4`.
    pub(super) fn pin(&self, text: &str) -> Result<At, String> {
        let (drive, name) = text
            .split_once('.')
            .ok_or_else(|| format!("'{text}' is not a pin; write drive and pin, like x.J2.2"))?;
        let drive = self.emulated(drive, reasons::NO_WIRE)?;
        let spec = self.spec(drive);
        let pin: Option<Pin> = spec.pin(name);
        let unknown = || {
            let what = format!("pin of {}", spec.kind);
            suggest::unknown(&what, name, spec.pin_names().map(|(name, _)| name))
        };
        Ok((drive, pin.ok_or_else(unknown)?))
    }
}

fn unknown_port(spec: &Spec, name: &str) -> String {
    suggest::unknown(&format!("port of {}", spec.kind), name, spec.ports.iter().map(|port| port.name))
}

/// The path of a key. It must not be empty.
fn path(table: &Table<'_>, key: &str) -> Result<Option<Located<PathBuf>>, LocatedError> {
    let Some(text) = table.text(key)? else { return Ok(None) };
    if text.is.is_empty() {
        return Err(text.wrong(format!("{key} takes the name of a file")));
    }
    Ok(Some(Located { is: Path::new(text.is).to_owned(), at: text.at }))
}

/// Presets from `address` and `set`, each with the position of its value. They are sorted by row, and the
/// whole register comes before its halves, so that the order in the file makes no difference.
fn presets(table: &Table<'_>, spec: &Spec) -> Result<Vec<Located<Preset>>, LocatedError> {
    let mut presets = Vec::new();
    let address = spec.address.and_then(|row| spec.registers.rows.get(row));
    let address_value = table.integer("address")?;
    if let Some(value) = &address_value {
        let row = address.ok_or_else(|| value.wrong(format!("{} has no bus address", spec.kind)))?;
        let preset = Preset::new(spec, row.name, &value.is).map_err(LocatedError::at(value.at))?;
        presets.push(Located { is: preset, at: value.at });
    }
    if let Some(set) = table.any_table("set")? {
        for key in set.keys() {
            if Preset::text(spec, key.is, "").is_some() {
                let Some(text) = set.text(key.is)? else { continue };
                let text_presets = Preset::text(spec, key.is, text.is).unwrap_or_else(|| Ok(Vec::new()));
                let text_presets = text_presets.map_err(LocatedError::at(text.at))?;
                presets.extend(text_presets.into_iter().map(|preset| Located { is: preset, at: text.at }));
                continue;
            }
            if spec.find(key.is).is_none() {
                // This call returns the error for an unknown name.
                Preset::new(spec, key.is, &Number::Decimal(0)).map_err(LocatedError::at(key.at))?;
            }
            let Some(value) = set.integers(key.is)? else { continue };
            let preset = Preset::new(spec, key.is, &value.is)
                .and_then(|preset| preset.check_saved(spec).map(|()| preset))
                .map_err(LocatedError::at(value.at))?;
            if address_value.is_some() && spec.address == Some(preset.row) {
                return Err(key.wrong(format!("{} is set by 'address' already", key.is)));
            }
            presets.push(Located { is: preset, at: value.at });
        }
    }
    presets.sort_by_key(|preset| (preset.is.row, preset.is.is_half()));
    Ok(presets)
}
