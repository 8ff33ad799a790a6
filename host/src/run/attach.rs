//! A run with a board: its drive is on a bench that records what the board reports.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use drivetwin_control::State;
use drivetwin_firmware::device::{Duration, Instant, Port};
use drivetwin_sim::bench::{Bench, Settings};
use drivetwin_sim::catalog;
use drivetwin_sim::commands::Drive as _;
use drivetwin_sim::config::listen::Uri;
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::record::trace::Event;

use super::output_files::OutputFiles;
use super::{Running, reserve_control, serve_control};
use crate::api::Boards;
use crate::banner::{Address, Banner};
use crate::board::{self, Board, Report, Session, Sink};
use crate::event_loop::{self, BenchHandle, EventLoop};
use crate::lender::Lender;
use crate::options::{AttachOptions, Control, RunOptions};
use crate::ports::Ports;

/// Name of the drive of the board.
const NAME: &str = "board";

/// Maximum number of events that wait to be recorded. A file that is written slowly does not fill the memory.
const MOST_EVENTS: usize = 1 << 20;

/// Time that events of a board take at most until they are here, unless it is overloaded. A recording is complete until
/// that time before the present one.
const DELAY: Duration = Duration::millis(500);

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
    check_bus(bus.as_ref())?;
    let is_read = control != Control::Off || recorded;
    let control = reserve_control(&control)?;
    let files = OutputFiles::open(&RunOptions { record, vcd, pcap, ..RunOptions::default() }, &[])?;
    let (trace, capture) = files.retention(is_read);
    let (handle, inbox) =
        event_loop::handle().map_err(|error| format!("an event descriptor cannot be created: {error}"))?;
    let board = Board::attach(&place, NAME, recorder(handle.clone()))?;
    let session = board.session()?;
    let mut bench = Bench::with(Settings { trace, capture, journals: false, ..Settings::default() });
    add(&mut bench, &session)?;

    let mut addresses = BTreeMap::new();
    let drive = bench.find_drive(NAME);
    if let Some(drive) = drive
        && let Some(address) = bus_address(bus, &board)
    {
        addresses.insert(bench.outlet(drive, Port(0)), vec![address]);
    }
    let mut banner = Banner::new(&bench, drive.as_slice(), addresses);
    let away = |refusal: drivetwin_sim::commands::Refusal| refusal.to_string();
    let mut on_board = board.drive().map_err(away)?;
    let unit = session.spec.address.map(|row| on_board.peek(row)).transpose().map_err(away)?;
    banner.set_board(NAME, &format!("{}, image {}", board.place(), session.image), unit, session.line);

    let boards: Boards = Arc::new(BTreeMap::from([(NAME.to_owned(), board)]));
    let lender = Lender::new(handle.clone());
    let api = serve_control(control, &allow_host, handle, &mut banner, &boards)?;
    let files = files.begin(&bench)?;
    let ports = Ports::new().map_err(|error| format!("ports cannot be waited for: {error}"))?;
    let mut event_loop = EventLoop::new(bench, ports, TimeMode::Manual, files, inbox);
    event_loop.follow_board();
    Ok(Running { event_loop, lender, banner, memories: Vec::new(), api, boards })
}

/// Checks that the address of the drive's bus is one that masters can open.
///
/// # Errors
/// The address is one that only a drive of this program can have.
fn check_bus(bus: Option<&Uri>) -> Result<(), String> {
    match bus {
        Some(uri @ (Uri::Pty(_) | Uri::Stdio)) => Err(format!(
            "--bus {uri} is not where the bus of a board can be; it takes serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT"
        )),
        _ => Ok(()),
    }
}

/// Address of the drive's bus for masters: the option, or the port at the same USB cable.
fn bus_address(option: Option<Uri>, board: &Board) -> Option<Address> {
    match option {
        Some(Uri::Serial(path)) => Some(Address::Port(path)),
        Some(uri) => Some(Address::Uri(uri.to_string())),
        None => board.bus().cloned().map(Address::Port),
    }
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
    let (caller, waiting) = (Arc::new(()), Arc::new(AtomicUsize::new(0)));
    let mut dropped: u64 = 0;
    Box::new(move |report| {
        let mut report = report;
        if let Report::Events(events) = &mut report {
            if waiting.load(Ordering::Relaxed) > MOST_EVENTS {
                dropped += events.len() as u64;
                return;
            }
            if dropped > 0
                && let Some((at, _)) = events.first()
            {
                events.insert(0, (*at, Event::Missing { events: Some(std::mem::take(&mut dropped)) }));
            }
            waiting.fetch_add(events.len(), Ordering::Relaxed);
        }
        let waiting = Arc::clone(&waiting);
        handle.submit(Arc::downgrade(&caller), move |event_loop| {
            record(event_loop, report, &waiting);
            || {}
        });
    })
}

/// Records a report.
fn record(event_loop: &mut EventLoop, report: Report, waiting: &AtomicUsize) {
    match report {
        Report::Begun(session, state) => begin(event_loop, &session, &state),
        Report::Events(events) => {
            waiting.fetch_sub(events.len(), Ordering::Relaxed);
            let bench = &mut event_loop.bench;
            let Some(drive) = bench.find_drive(NAME) else { return };
            for (at, event) in events {
                bench.report(drive, at, event);
            }
        }
        Report::At(at) => {
            event_loop.bench.report_time(Instant::ZERO + at.since(Instant::ZERO + DELAY));
        }
        Report::Gone => {}
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
