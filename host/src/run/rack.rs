//! Boards of a bench file: their drives are on a bench that also has emulated ones.
//!
//! The bench follows the wall clock. A board stamps its events by its own clock, of which [`BoardClock`] knows the wall time.
//! The events are here some milliseconds later, so recordings wait for them (BENCH-23).

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant as WallInstant;

use drivetwin_firmware::device::Instant;
use drivetwin_sim::commands::{Drive as _, Refusal};
use drivetwin_sim::config::layout::{BoardLayout, DriveLayout};
use drivetwin_sim::config::listen::Uri;
use drivetwin_sim::record::trace::Event;
use tracing::debug;

use super::Configuration;
use super::backlog::Backlog;
use crate::banner::{Address, Banner};
use crate::board::{self, Board, BoardClock, Report, Sink, Target, Wanted};
use crate::event_loop::{BenchHandle, EventLoop};

impl Configuration {
    /// Attaches the boards of the bench file, and enters what kinds they are. Returns them by the names of their drives.
    ///
    /// # Errors
    /// One sentence: a board is not there, is of another kind, or is named twice.
    pub(super) fn attach_boards(&mut self, handle: &BenchHandle) -> Result<BTreeMap<String, Board>, String> {
        let mut boards = BTreeMap::new();
        let mut targets: Vec<(String, Target)> = Vec::new();
        for index in 0..self.layout.drives.len() {
            let DriveLayout { name, kind, board: Some(BoardLayout { place, .. }), .. } =
                &self.layout.drives[index]
            else {
                continue;
            };
            let wrong = |why: String| self.of(index, "board", &why);
            let target = Target::find(place).map_err(wrong)?;
            if let Some((other, _)) = targets.iter().find(|(_, other)| other.is_same(&target)) {
                return Err(wrong(format!("{target} is the board of {other}, too; a board is one drive")));
            }
            let wanted = Wanted::Kept((!kind.is_empty()).then_some(*kind));
            let board = Board::attach(target.clone(), name, wanted, recorder(handle.clone(), name));
            let board = board.map_err(wrong)?;
            let session = board.session().map_err(wrong)?;
            targets.push((name.clone(), target));
            boards.insert(name.clone(), board);
            self.layout.drives[index].kind = session.spec.kind;
        }
        Ok(boards)
    }
}

/// Shows in the banner where a board is, and what its bus is like.
///
/// # Errors
/// One sentence: the board cannot be reached.
pub(super) fn show(banner: &mut Banner, board: &Board) -> Result<(), String> {
    let session = board.session()?;
    let away = |refusal: Refusal| refusal.to_string();
    let mut drive = board.drive().map_err(away)?;
    let peek = |row| drive.peek(row);
    let unit = session.spec.address.map(peek).transpose().map_err(away)?;
    banner.set_board(
        board.name(),
        &format!("{}, image {}", board.place(), session.image),
        unit,
        session.line,
    );
    Ok(())
}

/// Address of the bus of a board for masters: the one that a user has given, or the port at the same USB cable.
pub(super) fn bus_address(given: Option<Uri>, board: &Board) -> Option<Address> {
    match given {
        Some(Uri::Serial(path)) => Some(Address::Port(path)),
        Some(uri) => Some(Address::Uri(uri.to_string())),
        None => board.bus().cloned().map(Address::Port),
    }
}

/// A function that lets the thread of the bench record the reports of the board with the drive `name`.
fn recorder(handle: BenchHandle, name: &str) -> Sink {
    let (name, caller): (Arc<str>, _) = (name.into(), Arc::new(()));
    let (mut backlog, mut clock) = (Backlog::default(), None::<BoardClock>);
    Box::new(move |report| {
        let events: Vec<(Stamp, Event)> = match report {
            Report::Begun(session, state, seen) => {
                let clock = clock.insert(BoardClock::new(seen));
                let stamp = Stamp::new(clock, session.began, seen.answered);
                board::present(&session, &state).into_iter().map(|event| (stamp, event)).collect()
            }
            Report::Events(events, received) => {
                let Some(clock) = &clock else { return };
                let stamped = |(at, event)| (Stamp::new(clock, at, received), event);
                events.into_iter().map(stamped).collect()
            }
            Report::At(seen) => {
                if let Some(clock) = &mut clock {
                    clock.see(seen);
                    debug!("{name}: the clock of the board is known within {} µs", clock.error().as_micros());
                }
                return;
            }
            // The recording waits for no board, and there may be no session any more.
            Report::Gone { last, received } => {
                vec![(Stamp { own: last, wall: received }, Event::Missing { events: None })]
            }
        };
        let Some(mut waiting) = backlog.add(events) else { return };
        let name = Arc::clone(&name);
        handle.submit(Arc::downgrade(&caller), move |event_loop| {
            record(event_loop, &name, std::mem::take(&mut waiting.events));
            drop(waiting);
            || {}
        });
    })
}

/// Time of an event of a board: by its own clock, and by the wall clock.
#[derive(Clone, Copy)]
struct Stamp {
    own: Instant,
    wall: WallInstant,
}

impl Stamp {
    /// The time of an event that was received at `received`.
    fn new(clock: &BoardClock, own: Instant, received: WallInstant) -> Self {
        Self { own, wall: clock.wall_at(own, received) }
    }
}

/// Records events of a board at their times of the bench.
fn record(event_loop: &mut EventLoop, name: &str, events: Vec<(Stamp, Event)>) {
    let Some(drive) = event_loop.bench.find_drive(name) else { return };
    for (stamp, event) in events {
        let at = event_loop.bench_time(stamp.wall);
        event_loop.bench.report(drive, at, board::moved(event, stamp.own, at));
    }
}
