//! `drivetwin run`: everything that is checked and made before the first byte moves.
//!
//! What can be wrong is found before anything listens: names and values, addresses in use, files. An
//! old recording is overwritten last of all.

mod files;
mod listen;
mod memory;
mod told;

use std::fs;
use std::io::{self, Write as _};
use std::os::unix::net::UnixStream;

use drivetwin_sim::bench::{Settings, Setup};
use drivetwin_sim::layout::Built;
use drivetwin_sim::pace::Pace;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::retry_on_intr;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use tracing::info;

use crate::api;
use crate::cli::{self, Control};
use crate::ready::Ready;
use crate::realtime::{self, Host};
use files::Files;
use listen::Reserved;
use memory::Memory;
use told::Told;

/// Runs a drive, or a bench of several, until a signal ends it.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub(crate) fn run(options: &cli::Run) -> Result<(), String> {
    raise_limit_of_descriptors();
    let told = Told::new(options)?;
    let layout = &told.layout;
    let programs = told.programs()?;
    let listen = Reserved::all(layout)?;
    if options.json && listen.has_stdio() {
        return Err("--json and stdio: cannot share stdout; use one of them".into());
    }
    let control = match &options.control {
        Control::Off => None,
        Control::At(address) => Some(listen::reserve_tcp("--control ", address)?),
    };
    let mut memories = Vec::new();
    for (place, program) in programs.iter().enumerate() {
        memories.push(Memory::open(&told, place, program.as_ref())?);
    }
    let files = Files::open(options, &memories)?;

    let (trace, capture) = files.keep(control.is_some());
    let settings = Settings { trace, capture, ..layout.settings() };
    let given =
        |memory: &Memory| Setup { memory: memory.content(), keep: memory.keeper(), ..Setup::default() };
    let given = memories.iter().map(given).collect();
    let built = layout.build(settings, given);
    let Built { mut bench, seats, buses, .. } = built.map_err(|sentence| told.wrong(&sentence))?;
    for (memory, program) in memories.iter().zip(&programs) {
        program.as_ref().map_or(Ok(()), |program| memory.hold(program))?;
    }

    // A drive may tell its line when it has looked at its pins.
    bench.run_until(bench.now());

    // From here on somebody may come.
    let stop = signals().map_err(|error| format!("signals cannot be caught: {error}"))?;
    let (ports, addresses) = listen.open(&mut bench, &seats, &buses)?;
    let (door, inbox) = realtime::door().map_err(|error| format!("the bench cannot be woken: {error}"))?;
    let mut ready = Ready::new(&bench, &seats, addresses);
    if let Some(bound) = control {
        let api = bound.listen().and_then(|listener| {
            let address = listener.local_addr()?;
            api::serve(listener, &options.allow_host, door, ready.places())?;
            Ok(address)
        });
        ready.controlled_at(api.map_err(|error| format!("--control cannot listen: {error}"))?);
    }
    let followed = files.begin(&bench)?;
    memories.iter().for_each(Memory::warn);
    let mut host = Host::new(bench, ports, layout.time.unwrap_or(Pace::Times(1)), followed, inbox);
    print(&ready, options.json, &stop).map_err(|error| format!("stdout cannot be written: {error}"))?;

    let ended = host.run(&stop);
    info!("stopping");
    let mut failures: Vec<String> = memories.iter().filter_map(|memory| memory.sync().err()).collect();
    failures.extend(host.end_files());
    failures.extend(ended.err().map(|error| format!("the bench cannot go on: {error}")));
    if failures.is_empty() { Ok(()) } else { Err(failures.join("; ")) }
}

/// Says that the bench is ready, until somebody has read so much that it fits, or a signal comes.
fn print(ready: &Ready, json: bool, stop: &UnixStream) -> io::Result<()> {
    let text = ready.said(json)?;
    let Some(text) = text else { return Ok(()) };
    let (written, writes) = UnixStream::pair()?;
    let writer = std::thread::spawn(move || {
        let mut stdout = io::stdout();
        let result = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
        // Its end tells that it is done.
        drop(writes);
        result
    });
    let mut both = [PollFd::new(&written, PollFlags::IN), PollFd::new(stop, PollFlags::IN)];
    retry_on_intr(|| poll(&mut both, None))?;
    if both[0].revents().is_empty() { Ok(()) } else { writer.join().unwrap_or(Ok(())) }
}

/// A bench may have thousands of ports, and the usual limit is 1,024 descriptors.
fn raise_limit_of_descriptors() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    // As far as we may; what is refused for lack of them says so.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
}

/// A stream on which can be read that the program is to end: Ctrl-C, SIGTERM, a terminal that is closed, Ctrl-\.
/// A signal that `nohup` or a shell has it ignore is ignored.
fn signals() -> io::Result<UnixStream> {
    let (stop, caught) = UnixStream::pair()?;
    let ignored = ignored();
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        let is_ignored = [SIGHUP, SIGQUIT].contains(&signal) && ignored >> (signal - 1) & 1 == 1;
        if !is_ignored {
            signal_hook::low_level::pipe::register(signal, caught.try_clone()?)?;
        }
    }
    Ok(stop)
}

/// The signals that are ignored since before the program began, signal 1 in bit 0; none where the system does not say.
fn ignored() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
