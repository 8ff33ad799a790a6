//! A run with a board: its drive is on a bench that records what the board reports.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration as WallSpan;

use drivetwin_control::State;
use drivetwin_firmware::device::{Duration, Instant, Port};
use drivetwin_sim::bench::{Bench, Settings};
use drivetwin_sim::catalog;
use drivetwin_sim::config::board_place::check_bus;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::record::trace::Event;

use super::backlog::{Backlog, Waiting};
use super::output_files::OutputFiles;
use super::{Running, rack, reserve_control, serve_control};
use crate::api::Boards;
use crate::banner::Banner;
use crate::board::{self, Board, Report, Seen, Session, Sink, Target, Wanted};
use crate::event_loop::{self, BenchHandle, EventLoop};
use crate::lender::Lender;
use crate::options::{AttachOptions, Control, RunOptions};
use crate::ports::Ports;

/// Name of the drive of the board.
const NAME: &str = "board";

/// Time that events of a board take at most until they are here, unless it is overloaded. A recording is complete until
/// that time before the present one.
pub(super) const DELAY: Duration = Duration::millis(500);

/// Longest wait for the last reports of boards when a run ends.
pub(super) const LAST: WallSpan = WallSpan::from_millis(500);

/// Attaches a board, opens the control API, and starts the output files.
///
/// ```no_run
/// use std::os::unix::net::UnixStream;
///
/// use drivetwin_host::options::{AttachOptions, Control};
///
/// let control = Control::At("127.0.0.1:0".into());
/// let place = "/dev/ttyACM1".parse()?;
/// let running = drivetwin_host::attach(AttachOptions { place, control, ..AttachOptions::default() })?;
/// print!("{}", running.text());
/// let (stop, _stopper) = UnixStream::pair()?;
/// running.serve(&stop)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// One sentence that names the place, the option or the file, and the error.
pub fn attach(options: AttachOptions) -> Result<Running, String> {
    let AttachOptions { place, bus, control, allow_host, record, vcd, pcap, recorded } = options;
    if let Some(bus) = &bus {
        check_bus(bus).map_err(|why| format!("--bus {why}"))?;
    }
    let is_read = control != Control::Off || recorded;
    let control = reserve_control(&control)?;
    let files = OutputFiles::open(&RunOptions { record, vcd, pcap, ..RunOptions::default() }, &[])?;
    let (trace, capture) = files.retention(is_read);
    let (handle, inbox) =
        event_loop::handle().map_err(|error| format!("an event descriptor cannot be created: {error}"))?;
    let board = Board::attach(Target::find(&place)?, NAME, Wanted::Any, recorder(handle.clone()))?;
    let session = board.session()?;
    let mut bench = Bench::with(Settings { trace, capture, journals: false, ..Settings::default() });
    add(&mut bench, &session)?;

    let mut addresses = BTreeMap::new();
    let drive = bench.find_drive(NAME);
    if let Some(drive) = drive
        && let Some(address) = rack::bus_address(bus, &board)
    {
        addresses.insert(bench.outlet(drive, Port(0)), vec![address]);
    }
    let mut banner = Banner::new(&bench, drive.as_slice(), addresses);
    rack::show(&mut banner, &board)?;

    let boards: Boards = Arc::new(BTreeMap::from([(NAME.to_owned(), board)]));
    let lender = Lender::new(handle.clone());
    let api = serve_control(control, &allow_host, handle, &mut banner, &boards)?;
    let files = files.begin(&bench)?;
    let ports = Ports::new().map_err(|error| format!("ports cannot be waited for: {error}"))?;
    let mut event_loop = EventLoop::new(bench, ports, TimeMode::Manual, files, inbox);
    event_loop.follow_board();
    Ok(Running { event_loop, lender, banner, memories: Vec::new(), api, boards })
}

/// Adds the drive of a session to a bench without drives.
fn add(bench: &mut Bench, session: &Session) -> Result<(), String> {
    bench.report_time(session.began);
    let device = catalog::make(session.spec.kind)?;
    bench.add_elsewhere(NAME, device).map_err(|error| error.to_string())?;
    Ok(())
}

/// A function that lets the thread of the bench record reports.
fn recorder(handle: BenchHandle) -> Sink {
    let (caller, mut backlog) = (Arc::new(()), Backlog::default());
    Box::new(move |report| {
        let caller = Arc::downgrade(&caller);
        let mut add = |events| {
            let Some(waiting) = backlog.add(events) else { return };
            handle.submit(caller.clone(), move |event_loop| {
                record(event_loop, waiting);
                || {}
            });
        };
        match report {
            Report::Begun(session, state, _) => handle.submit(caller, move |event_loop| {
                begin(event_loop, &session, &state);
                || {}
            }),
            Report::Events(events, _) => add(events),
            Report::At(Seen { at, .. }) => handle.submit(caller, move |event_loop| {
                event_loop.bench.report_time(Instant::ZERO + at.since(Instant::ZERO + DELAY));
                || {}
            }),
            // There may be no session any more.
            Report::Gone { last, .. } => add(vec![(last, Event::Missing { events: None })]),
        }
    })
}

/// Records events.
fn record(event_loop: &mut EventLoop, mut waiting: Waiting<Instant>) {
    let bench = &mut event_loop.bench;
    let Some(drive) = bench.find_drive(NAME) else { return };
    for (at, event) in std::mem::take(&mut waiting.events) {
        bench.report(drive, at, event);
    }
}

/// Begins the recording of a session. If the board is a drive of another kind now, the recording begins anew.
fn begin(event_loop: &mut EventLoop, session: &Session, state: &State) {
    let bench = &event_loop.bench;
    if bench.find_drive(NAME).is_none_or(|drive| bench.spec(drive).kind != session.spec.kind) {
        let mut next = bench.next_bench();
        // The name is free on a bench without drives.
        if add(&mut next, session).is_ok() {
            event_loop.replace_bench(next);
        }
    }
    let bench = &mut event_loop.bench;
    let Some(drive) = bench.find_drive(NAME) else { return };
    for event in board::present(session, state) {
        bench.report(drive, session.began, event);
    }
}
