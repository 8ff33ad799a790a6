//! A run of a bench, in three steps: configuration, preparation, service.
//!
//! Names, values, addresses in use and files are checked before any port listens. Old recordings are
//! overwritten last.

mod attach;
mod backlog;
mod configuration;
mod memories;
mod offline;
mod output_files;
mod rack;
mod reserved_ports;

use std::collections::BTreeMap;
use std::os::fd::AsFd;
use std::sync::Arc;

use drivetwin_firmware::device::{Port, Spec};
use drivetwin_sim::bench::{Bench, Bus, DriveId, Settings};
use drivetwin_sim::config::layout::Built;
use drivetwin_sim::config::time_mode::TimeMode;
use tracing::info;

use crate::api::{self, Boards};
use crate::banner::{Address, Banner};
use crate::board::{Board, OnBoard};
use crate::event_loop::{self, BenchHandle, EventLoop, Inbox};
use crate::lender::Lender;
use crate::options::Control;
use crate::ports::Bound;
pub use attach::attach;
pub use configuration::Configuration;
use memories::{Memory, store_programs};
pub use offline::{Memories, Offline};
use output_files::OutputFiles;
use reserved_ports::ReservedPorts;

/// A bench with reserved ports and open files. Nothing listens yet, and output files are unchanged. The [crate]
/// has an example.
pub struct Prepared {
    bench: Bench,
    drives: Vec<DriveId>,
    buses: Vec<Bus>,
    time_mode: TimeMode,
    ports: ReservedPorts,
    control: Option<Bound>,
    allow_host: Vec<String>,
    memories: Vec<Memory>,
    files: OutputFiles,
    handle: BenchHandle,
    inbox: Inbox,
    boards: BTreeMap<String, Board>,
    /// Addresses of the buses of boards, by the names of their drives.
    buses_of_boards: Vec<(String, Address)>,
}

/// A bench whose ports and control API are open. The [crate] has an example.
pub struct Running {
    event_loop: EventLoop,
    lender: Lender,
    banner: Banner,
    memories: Vec<Memory>,
    /// The control API, if there is one.
    api: Option<api::Server>,
    /// Boards, by the names of their drives.
    boards: Boards,
}

impl Configuration {
    /// Reserves ports, opens files, attaches boards and builds the bench.
    ///
    /// # Errors
    /// One sentence that names the address, file or drive, and the error.
    pub fn prepare(mut self) -> Result<Prepared, String> {
        let programs = self.programs()?;
        let ports = ReservedPorts::all(&self.layout)?;
        let control = reserve_control(&self.options.control)?;
        let memories = self.memories(&programs)?;
        let files = OutputFiles::open(&self.options, &memories)?;

        let (handle, inbox) = event_loop::handle()
            .map_err(|error| format!("an event descriptor cannot be created: {error}"))?;
        let boards = self.attach_boards(&handle)?;
        let buses_of_boards = self.layout.drives.iter().filter_map(|drive| {
            let bus = drive.board.as_ref()?.bus.clone();
            Some((drive.name.clone(), rack::bus_address(bus, boards.get(&drive.name)?)?))
        });
        let buses_of_boards = buses_of_boards.collect();

        let is_read = control.is_some() || self.options.recorded;
        let (trace, capture) = files.retention(is_read);
        // Waveforms show the motion of motors: those of `--vcd`, and those that the control API or a lender serves.
        let shafts = files.has_waves() || is_read;
        let outcomes = files.has_waves();
        let settings = Settings { trace, capture, shafts, outcomes, ..self.layout.settings() };
        let setups = memories.iter().map(Memory::setup).collect();
        let built = self.layout.build(settings, setups);
        let Built { mut bench, drives, buses, .. } = built.map_err(|sentence| self.wrong(&sentence))?;
        store_programs(&memories, &programs)?;

        // A drive may change its line after it has read its pins.
        bench.run_until(bench.now());
        if !boards.is_empty() {
            bench.wait_for_reports(attach::DELAY);
        }
        let time_mode = self.layout.time.unwrap_or(TimeMode::Times(1));
        let allow_host = self.options.allow_host;
        Ok(Prepared {
            bench,
            drives,
            buses,
            time_mode,
            ports,
            control,
            allow_host,
            memories,
            files,
            handle,
            inbox,
            boards,
            buses_of_boards,
        })
    }
}

/// Reserves the address of the control API, if it has one.
///
/// # Errors
/// One sentence: the address cannot be used.
fn reserve_control(control: &Control) -> Result<Option<Bound>, String> {
    match control {
        Control::Off => Ok(None),
        Control::At(address) => reserved_ports::reserve_tcp("--control ", address).map(Some),
    }
}

/// Most connections to the control API that may wait to be accepted. This limit is low because a waiting connection
/// is still served after its caller has left.
const API_BACKLOG: i32 = 128;

impl Prepared {
    /// Opens the ports and the control API, and starts the output files. Clients may connect from now on, but
    /// only [`Running::serve`] serves them.
    ///
    /// # Errors
    /// One sentence that names what cannot be opened, and the reason.
    pub fn open(self) -> Result<Running, String> {
        let Self { mut bench, drives, buses, time_mode, ports, control, allow_host, memories, files, .. } =
            self;
        let Self { handle, inbox, boards, buses_of_boards, .. } = self;
        let (ports, mut addresses) = ports.open(&mut bench, &drives, &buses)?;
        for (name, address) in buses_of_boards {
            if let Some(drive) = bench.find_drive(&name) {
                addresses.insert(bench.outlet(drive, Port(0)), vec![address]);
            }
        }
        let lender = Lender::new(handle.clone());
        let mut banner = Banner::new(&bench, &drives, addresses);
        boards.values().try_for_each(|board| rack::show(&mut banner, board))?;
        let boards: Boards = Arc::new(boards);
        let api = serve_control(control, &allow_host, handle, &mut banner, &boards)?;
        let files = files.begin(&bench)?;
        memories.iter().for_each(Memory::warn);
        let event_loop = EventLoop::new(bench, ports, time_mode, files, inbox);
        Ok(Running { event_loop, lender, banner, memories, api, boards })
    }
}

/// Serves the control API, if it has an address, which the banner then shows.
///
/// # Errors
/// One sentence: the address cannot be listened on.
fn serve_control(
    control: Option<Bound>,
    allow_host: &[String],
    handle: BenchHandle,
    banner: &mut Banner,
    boards: &Boards,
) -> Result<Option<api::Server>, String> {
    let Some(bound) = control else { return Ok(None) };
    let api = bound.listen(API_BACKLOG).and_then(|listener| {
        let address = listener.local_addr()?;
        Ok((api::serve(listener, allow_host, handle, banner.places(), Arc::clone(boards))?, address))
    });
    let (api, address) = api.map_err(|error| format!("--control cannot listen: {error}"))?;
    banner.set_control(address);
    Ok(Some(api))
}

impl Running {
    /// Lends the bench to other threads while it is served.
    #[must_use]
    pub fn lender(&self) -> Lender {
        self.lender.clone()
    }

    /// The boards, each with its drive on the bench.
    pub fn boards(&self) -> impl Iterator<Item = (DriveId, OnBoard)> {
        self.boards.keys().filter_map(|name| {
            Some((self.event_loop.bench.find_drive(name)?, OnBoard::new(&self.boards, name)?))
        })
    }

    /// Names and descriptions of the drives.
    pub fn drives(&self) -> impl Iterator<Item = (&str, &'static Spec)> {
        self.banner.drives()
    }

    /// URIs of a port of a drive; none if there is no such drive or port.
    #[must_use]
    pub fn uris(&self, drive: &str, port: &str) -> Vec<String> {
        self.banner.uris(drive, port)
    }

    /// URL of the control API; `None` if it is off.
    #[must_use]
    pub fn control(&self) -> Option<String> {
        self.banner.control()
    }

    /// The banner as one line of JSON: URIs of all ports and of the control API.
    ///
    /// # Errors
    /// The banner cannot be written as JSON.
    pub fn json(&self) -> Result<String, String> {
        self.banner.json().map_err(|error| error.to_string())
    }

    /// The banner as text: URIs of all ports and of the control API, and commands to try.
    #[must_use]
    pub fn text(&self) -> String {
        self.banner.text()
    }

    /// Serves until `stop` becomes readable. If a line uses standard input, its end also ends the serving.
    /// Then completes the files.
    ///
    /// # Errors
    /// One sentence that says what is wrong: the files that are not complete, or the reason why the bench
    /// cannot continue.
    pub fn serve(mut self, stop: &impl AsFd) -> Result<(), String> {
        let ended = self.event_loop.run(stop);
        info!("stopping");
        // A board that is gone has reported what it will. The others are waited for at the same time.
        let last: Vec<_> = std::thread::scope(|scope| {
            let ask = |board: &Board| Some(board.drive().ok()?.now_within(attach::LAST));
            let boards = self.boards.values();
            let asked = boards.map(|board| (board.name(), scope.spawn(move || ask(board))));
            let asked: Vec<_> = asked.collect();
            asked.into_iter().filter_map(|(name, asked)| Some((name, asked.join().ok()??))).collect()
        });
        if !self.boards.is_empty() {
            self.event_loop.do_jobs();
            for (name, at) in last {
                match at {
                    Ok(at) => self.event_loop.bench.report_time(at),
                    Err(_) => self.event_loop.report_missing(name),
                }
            }
            self.event_loop.complete_recordings();
        }
        let mut failures: Vec<String> =
            self.memories.iter().filter_map(|memory| memory.sync().err()).collect();
        failures.extend(self.event_loop.end_files());
        failures.extend(ended.err().map(|error| format!("the bench cannot go on: {error}")));
        // Calls that wait for the bench get an error, and then the API ends.
        drop(self.event_loop);
        drop(self.api);
        drop(self.boards);
        if failures.is_empty() { Ok(()) } else { Err(failures.join("; ")) }
    }
}
