//! `standin run`: everything that is checked and made before the first byte moves.
//!
//! What can be wrong is found before anything listens: names and values, addresses in use, files. An
//! old recording is overwritten last of all.

use std::cell::RefCell;
use std::fs::{File, Metadata};
use std::io::{self, BufWriter};
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use signal_hook::consts::{SIGINT, SIGTERM};
use standin_firmware::device::{Port, Spec};
use standin_sim::bench::{Bench, Keep, SeatError, Settings, Setup};
use standin_sim::bus::LineMode;
use standin_sim::listen::{Listen, Uri};
use standin_sim::preset::{self, Preset};
use standin_sim::rsasm::Image;
use standin_sim::trace::TraceKeep;
use tracing::{error, info};

use crate::api;
use crate::cli::{self, Control};
use crate::followed::Followed;
use crate::kinds;
use crate::nearest;
use crate::nv::Nv;
use crate::output::Output;
use crate::ports::{self, Bound, Ports};
use crate::programs;
use crate::ready::{Address, Ready};
use crate::realtime::{self, Host};

/// Runs a drive until a signal ends it.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub(crate) fn run(options: &cli::Run) -> Result<(), String> {
    not_yet(options)?;
    let device = kinds::make(&options.kind)?;
    let spec = device.spec();
    let listen = places(spec, &options.listen)?;
    let presets = presets(spec, options)?;
    let program = options.program.as_deref().map(|file| programs::load(file, spec)).transpose()?;
    let listen = reserve(listen)?;
    let control = match &options.control {
        Control::Off => None,
        Control::At(address) => Some(reserve_tcp("--control ", address)?),
    };
    let mut memory = Memory::open(options.nv.as_deref(), spec)?;
    if let Some(program) = &program {
        memory.hold(program, spec)?;
    }
    let record = output("--record", options.record.as_deref(), &memory)?;
    let waves = output("--vcd", options.vcd.as_deref(), &memory)?;
    let frames = output("--pcap", options.pcap.as_deref(), &memory)?;
    let all: Vec<&Output> = [&record, &waves, &frames].into_iter().flatten().collect();
    for (n, output) in all.iter().enumerate() {
        for other in &all[..n] {
            if output.is(other)? {
                let (one, two, path) = (output.option(), other.option(), output.path().display());
                return Err(format!("{one} and {two} are the same file, {path}; use two"));
            }
        }
    }

    let mut bench = Bench::with(Settings {
        seed: options.seed,
        line: match options.line {
            cli::Line::Timed => LineMode::Timed,
            cli::Line::Fast => LineMode::Fast,
        },
        patience: options.time.patience(),
        trace: if record.is_some() { TraceKeep::All } else { TraceKeep::default() },
        capture: TraceKeep::default(),
    });
    let setup = Setup {
        boot_fast: options.fast_boot,
        memory: memory.content.clone(),
        keep: memory.keeper(),
        presets: values(&presets, spec, memory.content.as_deref()),
        apart: false,
    };
    let seat = bench.seat(spec.kind, device, setup).map_err(|error| seat_error(&error, spec, options))?;
    if let Some(program) = &program {
        memory.keep(program)?;
    }

    // A drive may tell its line when it has looked at its pins.
    bench.run_until(bench.now());

    // From here on somebody may come.
    let stop = signals().map_err(|error| format!("signals cannot be caught: {error}"))?;
    let mut ports = Ports::new().map_err(|error| format!("openings of ptys cannot be watched: {error}"))?;
    let mut ready = Ready::new(spec);
    for (port, place) in listen {
        let bus = bench.bus(seat, port).ok_or("a port without a line")?;
        let address = match place {
            Reserved::Tcp(bound) => Address::Tcp(
                ports.add_tcp(bus, bound).map_err(|error| format!("tcp: cannot listen: {error}"))?,
            ),
            Reserved::Pty(link) => Address::Pty(ports.add_pty(bus, link).map_err(|error| error.to_string())?),
        };
        ready.reached(port, bench.bus_name(bus), bench.line(bus), address);
    }
    let unit = spec.address.map(|row| bench.peek(seat, row));
    let (door, inbox) = realtime::door().map_err(|error| format!("the bench cannot be woken: {error}"))?;
    if let Some(bound) = control {
        let api = bound.listen().and_then(|listener| {
            let address = listener.local_addr()?;
            api::serve(listener, door, ready.places())?;
            Ok(address)
        });
        ready.controlled_at(api.map_err(|error| format!("--control cannot listen: {error}"))?);
    }
    record.as_ref().map_or(Ok(()), Output::begin)?;
    let waves = waves.map(|output| Followed::waves(output, &bench));
    let frames = frames.map(|output| Followed::frames(output, &bench));
    let files = waves.into_iter().chain(frames).collect::<Result<Vec<_>, _>>()?;
    let mut host = Host::new(bench, ports, options.time, files, inbox);
    ready.print(options.json, unit).map_err(|error| format!("stdout cannot be written: {error}"))?;

    let ended = host.run(&stop);
    info!("stopping");
    memory.sync();
    let files = host.end_files();
    if let Some(record) = record {
        record.fails(write_trace(&host.bench, record.file()))?;
    }
    files?;
    ended.map_err(|error| format!("the bench cannot go on: {error}"))
}

/// Options that later versions bring.
fn not_yet(options: &cli::Run) -> Result<(), String> {
    let missing = if options.kind.ends_with(".toml") {
        "bench files"
    } else {
        return Ok(());
    };
    Err(crate::not_yet(missing))
}

/// Which ports are reached where; without a wish, a serial port gets a pty and a loopback TCP port.
fn places(spec: &Spec, listen: &[Listen]) -> Result<Vec<(Port, Uri)>, String> {
    let ports = || (0..).map(Port).zip(spec.ports);
    let mut places = Vec::new();
    for Listen { port: name, uri } in listen {
        let found = ports().find(|(_, port)| name.as_deref().is_none_or(|name| port.name == name));
        let (port, of) = found.ok_or_else(|| {
            let what = format!("port of {}", spec.kind);
            let name = name.as_deref().unwrap_or_default();
            format!("--listen: {}", nearest::unknown(&what, name, spec.ports.iter().map(|port| port.name)))
        })?;
        if of.line.is_none() && matches!(uri, Uri::Pty(_)) {
            return Err(format!("--listen: {} of {} is a TCP port and has no pty", of.name, spec.kind));
        }
        if matches!(uri, Uri::Pty(Some(_))) && places.iter().any(|(_, other)| other == uri) {
            return Err(format!("--listen: {uri} is there twice; a link leads to one pty"));
        }
        places.push((port, uri.clone()));
    }
    if listen.is_empty() {
        for (port, _) in ports() {
            places.extend([(port, Uri::Tcp("127.0.0.1:0".into())), (port, Uri::Pty(None))]);
        }
    }
    match places
        .iter()
        .find_map(|(port, _)| spec.ports.get(usize::from(port.0)).filter(|of| of.line.is_none()))
    {
        Some(tcp) => Err(crate::not_yet(&format!("TCP ports like {} of {}", tcp.name, spec.kind))),
        None => Ok(places),
    }
}

/// The registers to preset, in the order of the command line.
fn presets(spec: &Spec, options: &cli::Run) -> Result<Vec<Preset>, String> {
    let mut presets = Vec::new();
    if let Some(address) = options.address {
        let row = spec.address.and_then(|row| spec.registers.rows.get(row));
        let row = row.ok_or_else(|| format!("--address: {} has no bus address", spec.kind))?;
        presets
            .push(Preset::new(spec, row.name, address).map_err(|sentence| format!("--address: {sentence}"))?);
    }
    for set in &options.set {
        let preset = Preset::new(spec, &set.register, set.value)
            .and_then(|preset| preset.check_saved(spec).map(|()| preset));
        presets.push(preset.map_err(|sentence| format!("--set: {sentence}"))?);
    }
    Ok(presets)
}

/// The presets as whole values. A half goes onto what was set before, or is in the memory.
fn values(presets: &[Preset], spec: &Spec, memory: Option<&[u8]>) -> Vec<(usize, i64)> {
    let mut values: Vec<(usize, i64)> = Vec::new();
    for preset in presets {
        let before = values.iter().position(|&(row, _)| row == preset.row);
        let old = match before {
            Some(place) => values[place].1,
            None if preset.is_half() => stored(spec, memory, preset.row),
            None => 0,
        };
        let value = preset.onto(spec, old);
        match before {
            Some(place) => values[place].1 = value,
            None => values.push((preset.row, value)),
        }
    }
    values
}

/// What a row holds when a drive wakes up with `memory`.
fn stored(spec: &Spec, memory: Option<&[u8]>, row: usize) -> i64 {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, memory: memory.map(<[u8]>::to_vec), ..Setup::default() };
    let seat = kinds::make(spec.kind).ok().and_then(|device| bench.seat(spec.kind, device, setup).ok());
    seat.map_or(0, |seat| bench.peek(seat, row))
}

/// A place to be reached that nobody else can take any more.
enum Reserved {
    Tcp(Bound),
    Pty(Option<PathBuf>),
}

fn reserve(places: Vec<(Port, Uri)>) -> Result<Vec<(Port, Reserved)>, String> {
    let reserved = places.into_iter().map(|(port, uri)| {
        let place = match uri {
            Uri::Tcp(address) => Reserved::Tcp(reserve_tcp("tcp:", &address)?),
            Uri::Pty(link) => {
                if let Some(link) = &link {
                    ports::check_link(link).map_err(|error| format!("pty:{}: {error}", link.display()))?;
                }
                Reserved::Pty(link)
            }
            Uri::Serial(_) | Uri::Stdio => return Err(crate::not_yet(&uri.to_string())),
        };
        Ok((port, place))
    });
    reserved.collect()
}

fn reserve_tcp(what: &str, address: &str) -> Result<Bound, String> {
    ports::bind(address).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => format!("{what}{address} is in use; another port, or port 0, is free"),
        _ => format!("{what}{address} cannot be listened on: {error}"),
    })
}

/// Where the non-volatile memory is.
struct Memory {
    content: Option<Vec<u8>>,
    file: Option<(PathBuf, Rc<RefCell<Nv>>)>,
}

impl Memory {
    fn open(path: Option<&Path>, spec: &Spec) -> Result<Self, String> {
        let Some(path) = path else { return Ok(Self { content: None, file: None }) };
        let opened = Nv::open(path, spec.memory.into());
        let (content, nv) = opened.map_err(|error| format!("--nv {}: {error}", path.display()))?;
        Ok(Self { content: Some(content), file: Some((path.into(), Rc::new(RefCell::new(nv)))) })
    }

    /// The drive finds a user program there.
    fn hold(&mut self, program: &Image, spec: &Spec) -> Result<(), String> {
        if let Some((path, nv)) = &self.file {
            let length =
                nv.borrow().metadata().map_err(|error| format!("--nv {}: {error}", path.display()))?.len();
            if length > u64::from(spec.memory) {
                return Err(format!(
                    "--program: {} is longer than the memory of {}",
                    path.display(),
                    spec.kind
                ));
            }
        }
        program.put_into(self.content.get_or_insert_with(|| vec![0xFF; spec.memory.into()]));
        Ok(())
    }

    /// The file has that program, too.
    fn keep(&self, program: &Image) -> Result<(), String> {
        let Some((path, nv)) = &self.file else { return Ok(()) };
        let stored = nv.borrow_mut().store(program.offset, &program.bytes);
        stored.map_err(|error| format!("--nv {}: {error}", path.display()))
    }

    /// Who writes to the file what the drive stores.
    fn keeper(&self) -> Option<Keep> {
        let (path, nv) = self.file.clone()?;
        Some(Box::new(move |offset, bytes| {
            if let Err(error) = nv.borrow_mut().store(offset, bytes) {
                error!("{} does not keep what the drive stores: {error}", path.display());
            }
        }))
    }

    /// Whether it is in that file.
    fn is_in(&self, file: &Metadata) -> io::Result<bool> {
        let Some((_, nv)) = &self.file else { return Ok(false) };
        let own = nv.borrow().metadata()?;
        Ok((own.dev(), own.ino()) == (file.dev(), file.ino()))
    }

    fn sync(&self) {
        if let Some((path, nv)) = &self.file
            && let Err(error) = nv.borrow().sync()
        {
            error!("{} may not be on the disk: {error}", path.display());
        }
    }
}

/// Opens the file that an option names, which must not be that of the memory.
fn output(option: &'static str, path: Option<&Path>, memory: &Memory) -> Result<Option<Output>, String> {
    let Some(path) = path else { return Ok(None) };
    let output = Output::open(option, path)?;
    if output.fails(memory.is_in(&output.metadata()?))? {
        return Err(format!("{option} and --nv are the same file, {}; use two", path.display()));
    }
    Ok(Some(output))
}

fn write_trace(bench: &Bench, file: &File) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    bench.trace().write(&mut writer)?;
    writer.into_inner()?.sync_all()
}

/// A stream on which Ctrl-C and SIGTERM can be read.
fn signals() -> io::Result<UnixStream> {
    let (stop, caught) = UnixStream::pair()?;
    signal_hook::low_level::pipe::register(SIGINT, caught.try_clone()?)?;
    signal_hook::low_level::pipe::register(SIGTERM, caught)?;
    Ok(stop)
}

fn seat_error(error: &SeatError, spec: &Spec, options: &cli::Run) -> String {
    let SeatError::Preset { row, why } = error else { return error.to_string() };
    let name = spec.registers.rows.get(*row).map_or("", |row| row.name);
    let place = options.nv.as_ref().map(|path| format!(" (--nv {})", path.display())).unwrap_or_default();
    format!("{name} cannot be preset: {}{place}", preset::why(*why))
}

#[cfg(test)]
mod tests {
    use super::*;
    use standin_firmware::device::{Ends, PortSpec};
    use standin_protocol::line::{Line, Parity};

    static PORTS: &[PortSpec] = &[
        PortSpec { name: "rs485", ends: Ends::Silence, line: Some(Line::new(9_600, 8, Parity::Even, 1)) },
        PortSpec { name: "modbus", ends: Ends::Mbap, line: None },
    ];

    fn spec(ports: &'static [PortSpec]) -> Spec {
        Spec { kind: "toy", ports, ..Spec::BARE }
    }

    #[test]
    fn a_serial_port_is_reached_by_a_pty_and_a_loopback_port_unless_told_otherwise() {
        let spec = spec(&PORTS[..1]);
        let default = places(&spec, &[]).unwrap();
        assert_eq!(default, [(Port(0), Uri::Tcp("127.0.0.1:0".into())), (Port(0), Uri::Pty(None))]);
        let told = places(&spec, &["rs485=pty:".parse().unwrap()]).unwrap();
        assert_eq!(told, [(Port(0), Uri::Pty(None))]);
    }

    #[test]
    fn ports_that_are_not_there_and_ptys_on_tcp_are_errors() {
        let spec = spec(PORTS);
        let wrong = |text: &str| places(&spec, &[text.parse().unwrap()]).unwrap_err();
        assert_eq!(wrong("rs458=pty:"), "--listen: there is no port of toy 'rs458'; the nearest is 'rs485'");
        assert_eq!(wrong("modbus=pty:"), "--listen: modbus of toy is a TCP port and has no pty");
        let twice = ["pty:a".parse().unwrap(), "rs485=pty:a".parse().unwrap()];
        let sentence = "--listen: pty:a is there twice; a link leads to one pty";
        assert_eq!(places(&spec, &twice).unwrap_err(), sentence);
    }
}
