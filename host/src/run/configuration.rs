//! Configuration of a run: from a bench file, or from the options of a single drive.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use drivetwin_firmware::device::{Port, Spec};
use drivetwin_sim::catalog;
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::{self, DriveLayout, Layout};
use drivetwin_sim::config::listen::{Listen, Uri};
use drivetwin_sim::config::preset::Preset;
use drivetwin_sim::rsasm::Image;

use crate::options::RunOptions;
use crate::rs_programs;

/// Configuration of a run: options, and the layout of the bench. The [crate] has an example.
pub struct Configuration {
    pub(super) options: RunOptions,
    pub(super) layout: Layout,
    /// Path of the bench file; `None` for a single drive.
    file: Option<PathBuf>,
}

impl Configuration {
    /// Reads the options of a single drive, or the bench file that they name. Opens no port.
    ///
    /// # Errors
    /// One sentence that names the option or the place in the file, and the error.
    pub fn read(options: RunOptions) -> Result<Self, String> {
        let is_file = options.what.ends_with(".toml") || options.what == STDIN;
        let is_path = options.what.contains(['/', '.']);
        if !is_file && is_path {
            return Err(format!(
                "'{}' is not a bench file: the name of a bench file ends in .toml; - is standard input",
                options.what
            ));
        }
        let file = is_file.then(|| PathBuf::from(&options.what));
        let mut layout = match &file {
            Some(file) => {
                refuse_single_drive_options(&options, file)?;
                read(file)?
            }
            None => Layout { drives: vec![drive(&options)?], ..Layout::default() },
        };
        layout.seed = options.seed.or(layout.seed);
        layout.time = options.time.or(layout.time);
        layout.check_time().map_err(|why| format!("--time: {why}"))?;
        layout.line = options.line.or(layout.line);
        if options.strict && !layout.has_modbus_line() {
            let what = file.as_deref().map_or_else(|| options.what.as_str().into(), shown);
            return Err(format!("--strict: {what} has no Modbus line, where frames need a silence of t3.5"));
        }
        layout.strict |= options.strict;
        let is_emulated = |drive: &&mut DriveLayout| drive.board.is_none();
        let mut emulated = layout.drives.iter_mut().filter(is_emulated).peekable();
        if options.fast_boot && emulated.peek().is_none() {
            let what = file.as_deref().map_or_else(|| options.what.as_str().into(), shown);
            return Err(format!(
                "--fast-boot: {what} has no emulated drive; the image of a board has a start-up delay, or has none"
            ));
        }
        emulated.for_each(|drive| drive.fast_boot |= options.fast_boot);
        let this = Self { options, layout, file };
        if this.options.what == STDIN && this.uses_stdio() {
            return Err("standard input cannot be both the bench file and stdio:; name a file".into());
        }
        Ok(this)
    }

    /// The configuration of a layout without options.
    pub(super) fn of_layout(layout: Layout) -> Self {
        Self { options: RunOptions::default(), layout, file: None }
    }

    /// Checks a bench file, or the options of a single drive, without opening a port. Returns a summary and
    /// warnings, one sentence each.
    ///
    /// # Errors
    /// One sentence that names the place in the file, and the error.
    pub fn check(&self) -> Result<(String, Vec<String>), String> {
        self.programs()?;
        let warnings = self.layout.warnings().map_err(|sentence| self.wrong(&sentence))?;
        let warnings = warnings.iter().map(|warning| self.wrong(warning)).collect();
        let Layout { drives, buses, motors, .. } = &self.layout;
        let counts = [
            (drives.len(), "drive", "drives"),
            (drives.iter().filter(|drive| drive.board.is_some()).count(), "board", "boards"),
            (buses.len(), "bus", "buses"),
            (motors.len(), "motor", "motors"),
        ];
        let counted = counts.iter().filter(|(count, ..)| *count > 0);
        let parts: Vec<String> = counted
            .map(|&(count, one, many)| format!("{count} {}", if count == 1 { one } else { many }))
            .collect();
        Ok((self.wrong(&parts.join(", ")), warnings))
    }

    /// Returns whether a line listens on standard input and output.
    #[must_use]
    pub fn uses_stdio(&self) -> bool {
        let own = self.layout.drives.iter().flat_map(|drive| &drive.listen).map(|(_, uri)| uri);
        let mut all = own.chain(self.layout.buses.iter().flat_map(|bus| &bus.listen));
        all.any(|uri| *uri == Uri::Stdio)
    }

    /// Assembles the user programs of the drives; one entry for each drive.
    ///
    /// # Errors
    /// One sentence that names the program and the error.
    pub(super) fn programs(&self) -> Result<Vec<Option<Image>>, String> {
        let load = |(place, drive): (usize, &DriveLayout)| {
            let Some(file) = &drive.program else { return Ok(None) };
            let spec = catalog::make(drive.kind)?.spec();
            rs_programs::load(file, spec).map(Some).map_err(|error| self.of(place, "program", &error))
        };
        self.layout.drives.iter().enumerate().map(load).collect()
    }

    /// Adds the name of the bench file, if there is one, to a sentence about the bench.
    pub(super) fn wrong(&self, sentence: &str) -> String {
        match &self.file {
            Some(file) => format!("{}: {sentence}", shown(file)),
            None => sentence.into(),
        }
    }

    /// Adds the source of a wrong value to a sentence about a drive: the key in the bench file or, without a
    /// bench file, the option of the command line.
    pub(super) fn of(&self, drive: usize, key: &str, sentence: &str) -> String {
        match &self.file {
            Some(file) => {
                let name = &self.layout.drives[drive].name;
                format!("{}: {key} of {name}: {sentence}", shown(file))
            }
            None => format!("--{key}: {sentence}"),
        }
    }
}

/// Rejects options for a single drive if there is a bench file (BENCH-4).
fn refuse_single_drive_options(options: &RunOptions, file: &Path) -> Result<(), String> {
    let given = [
        ("--listen", !options.listen.is_empty(), "listen = [\"tcp:127.0.0.1:5020\"]"),
        ("--address", options.address.is_some(), "address = 1"),
        ("--nv", options.nv.is_some(), "nv = \"x.nv\""),
        ("--set", !options.set.is_empty(), "set = { Speed = 8000 }"),
        ("--program", options.program.is_some(), "program = \"x.rsasm\""),
    ];
    match given.into_iter().find(|&(_, given, _)| given) {
        Some((option, _, key)) => Err(format!(
            "{option} is for a single drive only; in {} set it in [[drive]], for instance {key}",
            shown(file)
        )),
        None => Ok(()),
    }
}

/// Path that means standard input.
const STDIN: &str = "-";

/// Name of a bench file in a sentence.
fn shown(path: &Path) -> std::borrow::Cow<'_, str> {
    if path == Path::new(STDIN) { "standard input".into() } else { path.to_string_lossy() }
}

/// Reads a bench file. Paths in the file are relative to its folder; on standard input, to the current folder.
fn read(path: &Path) -> Result<Layout, String> {
    let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", shown(path));
    let mut text = String::new();
    let read = if path == Path::new(STDIN) {
        std::io::stdin().lock().read_to_string(&mut text).map(drop)
    } else {
        std::fs::read_to_string(path).map(|all| text = all)
    };
    read.map_err(|error| wrong(&error))?;
    let variable = |name: &str| std::env::var(name).ok();
    let mut layout = bench_file::parse_with(&text, &variable).map_err(|error| wrong(&error))?;
    layout.relative_to(path.parent().unwrap_or(Path::new("")));
    Ok(layout)
}

/// A single drive, whose name is its kind.
fn drive(options: &RunOptions) -> Result<DriveLayout, String> {
    let spec = catalog::make(&options.what)?.spec();
    Ok(DriveLayout {
        name: spec.kind.into(),
        kind: spec.kind,
        listen: places(spec, &options.listen)?,
        nv: options.nv.clone(),
        presets: presets(spec, options)?,
        program: options.program.clone(),
        fast_boot: options.fast_boot,
        faults: Vec::new(),
        board: None,
    })
}

/// Listening addresses of the ports. A port without an address gets a free loopback TCP port, and a serial
/// port also gets a pty.
fn places(spec: &Spec, listen: &[Listen]) -> Result<Vec<(Port, Uri)>, String> {
    let mut places: Vec<(Port, Uri)> = Vec::new();
    for listen in listen {
        let place = layout::address(spec, listen).map_err(|sentence| format!("--listen: {sentence}"))?;
        if let Some((_, other)) = places.iter().find(|(_, other)| layout::clash(other, &place.1)) {
            return Err(format!("--listen: {other} is given twice; use it for one port only"));
        }
        places.push(place);
    }
    for (port, of) in (0..).map(Port).zip(spec.ports) {
        if places.iter().all(|(assigned, _)| *assigned != port) {
            places.push((port, Uri::Tcp("127.0.0.1:0".into())));
            places.extend(of.line.map(|_| (port, Uri::Pty(None))));
        }
    }
    Ok(places)
}

/// The registers to preset, in the order of the command line.
fn presets(spec: &Spec, options: &RunOptions) -> Result<Vec<Preset>, String> {
    let mut presets = Vec::new();
    if let Some(address) = &options.address {
        let row = spec.address.and_then(|row| spec.registers.rows.get(row));
        let row = row.ok_or_else(|| format!("--address: {} has no bus address", spec.kind))?;
        presets
            .push(Preset::new(spec, row.name, address).map_err(|sentence| format!("--address: {sentence}"))?);
    }
    for set in &options.set {
        let found = Preset::typed(spec, &set.register, &set.value).and_then(|presets| {
            presets.iter().try_for_each(|preset| preset.check_saved(spec))?;
            Ok(presets)
        });
        presets.extend(found.map_err(|sentence| format!("--set: {sentence}"))?);
    }
    Ok(presets)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_firmware::device::{Framing, PortSpec};
    use drivetwin_protocol::line::{Line, Parity};

    static PORTS: &[PortSpec] = &[
        PortSpec {
            name: "rs485",
            framing: Framing::Silence,
            line: Some(Line::new(9_600, 8, Parity::Even, 1)),
        },
        PortSpec { name: "modbus", framing: Framing::Mbap, line: None },
    ];

    fn spec(ports: &'static [PortSpec]) -> Spec {
        Spec { kind: "toy", ports, ..Spec::EMPTY }
    }

    #[test]
    fn a_port_gets_a_loopback_address_and_a_serial_one_a_pty_by_default() {
        let spec = spec(PORTS);
        let default = places(&spec, &[]).unwrap();
        let tcp = || Uri::Tcp("127.0.0.1:0".into());
        assert_eq!(default, [(Port(0), tcp()), (Port(0), Uri::Pty(None)), (Port(1), tcp())]);
        for listen in ["pty:", "rs485=pty:"] {
            let found = places(&spec, &[listen.parse().unwrap()]).unwrap();
            assert_eq!(found, [(Port(0), Uri::Pty(None)), (Port(1), tcp())]);
        }
        let uri = || Uri::Tcp("127.0.0.1:5020".into());
        let found = places(&spec, &["modbus=tcp:127.0.0.1:5020".parse().unwrap()]).unwrap();
        assert_eq!(found, [(Port(1), uri()), (Port(0), tcp()), (Port(0), Uri::Pty(None))]);
    }

    #[test]
    fn ports_that_are_not_there_and_places_that_are_there_twice_are_errors() {
        let spec = spec(PORTS);
        let wrong = |texts: &[&str]| {
            let listen: Vec<Listen> = texts.iter().map(|text| text.parse().unwrap()).collect();
            places(&spec, &listen).unwrap_err()
        };
        let unknown = "--listen: there is no port of toy 'rs458'; the nearest is 'rs485'";
        assert_eq!(wrong(&["rs458=pty:"]), unknown);
        assert_eq!(
            wrong(&["modbus=pty:"]),
            "--listen: modbus of toy is a TCP port and cannot have a pty; use tcp:"
        );
        let twice = |uri: &str| format!("--listen: {uri} is given twice; use it for one port only");
        assert_eq!(wrong(&["pty:a", "rs485=pty:a"]), twice("pty:a"));
        assert_eq!(wrong(&["stdio:", "pty:", "stdio:"]), twice("stdio:"));
        assert_eq!(wrong(&["serial:/dev/ttyS0", "serial:/dev/ttyS0"]), twice("serial:/dev/ttyS0"));
    }
}
