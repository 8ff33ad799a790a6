//! Boards at this computer: the other end of the control protocol ([`drivetwin_control`]).
//!
//! | module | what it holds |
//! |---|---|
//! | `place` | where a board is: serial ports, USB serial numbers, TCP |
//! | `link` | an open control port: messages over bytes |
//! | `answer` | messages that own their data |
//! | `board_clock` | wall time of the times of a board |
//! | `report` | events as entries of a trace |
//! | `client` | the thread that has the port: calls, sessions |
//! | `drive` | the drive of a board, for commands by name |

mod answer;
mod board_clock;
mod client;
mod drive;
mod link;
mod place;
mod report;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use drivetwin_firmware::device::{Instant, Pin, Plan, Port, Role};
use drivetwin_sim::commands::Refusal;
pub use drivetwin_sim::config::board_place::reasons;
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord};

use crate::options::BoardPlace;
pub(crate) use board_clock::{BoardClock, Seen};
use client::Client;
pub(crate) use client::{NotStarted, Report, Session, Sink, Wanted};
pub use drive::Drive;
pub(crate) use drive::of_first_port;
pub(crate) use place::PORTS;
pub(crate) use place::Target;

/// USB serial numbers of the boards that are plugged in. `ports` is the folder with the [serial ports](PORTS).
pub(crate) fn plugged(ports: &Path) -> Vec<String> {
    place::plugged(ports).into_iter().map(|board| board.serial).collect()
}

/// Names of the boards that `drivetwin flash` knows, which they say themselves.
pub(crate) const PICO: &str = "pico";
pub(crate) const PICO_2: &str = "pico2";

/// Starts the boot loader of a board, if it has this name. Returns the text of its place.
///
/// # Errors
/// There is no board, or another one, or it does not start a boot loader.
pub(crate) fn start_boot_loader(ports: &Path, place: &BoardPlace, name: &str) -> Result<String, NotStarted> {
    let mut target = Target::find_in(ports, place)?;
    client::start_boot_loader(&mut target, name)?;
    Ok(target.to_string())
}

/// Advice for a board of another version, by its name, which may be empty.
fn flash_again(name: &str) -> String {
    match name {
        PICO | PICO_2 => format!("flash it again with `drivetwin flash {name}`"),
        "" => "flash it again with `drivetwin flash`".into(),
        _ => "flash it again".into(),
    }
}

/// A board that is attached.
pub(crate) struct Board {
    client: Client,
    /// Name of its drive.
    name: Arc<str>,
    /// Text of its place.
    place: String,
    /// The serial port of the drive's bus.
    bus: Option<PathBuf>,
}

/// The events of a board since a time of its own, moved to another time. Only plans contain times.
pub(crate) fn moved(event: Event, from: Instant, to: Instant) -> Event {
    let Event::Output(OutputRecord::Plan { axis, plan }) = event else { return event };
    let ticks = to.ticks().saturating_add(plan.start().ticks()).saturating_sub(from.ticks());
    let moved = Plan::of_segments(Instant::from_ticks(ticks), plan.segments());
    Event::Output(OutputRecord::Plan { axis, plan: moved.map_or(plan, Box::new) })
}

impl Board {
    /// Attaches the board at a place. Its drive gets a name. `sink` takes its reports, the first one before this function
    /// returns.
    ///
    /// # Errors
    /// One sentence: there is no board, one of another version of drivetwin, or one of another kind.
    pub(crate) fn attach(target: Target, name: &str, wanted: Wanted, sink: Sink) -> Result<Self, String> {
        let (text, bus) = (target.to_string(), target.bus.clone());
        Ok(Self { client: Client::connect(target, wanted, sink)?, name: name.into(), place: text, bus })
    }

    /// The drive, as it is now.
    ///
    /// # Errors
    /// The board cannot be reached.
    pub(crate) fn drive(&self) -> Result<Drive, Refusal> {
        let shared = Arc::clone(&self.client.shared);
        let session = shared.session().map_err(Refusal::Away)?;
        Ok(Drive::new(shared, session, Arc::clone(&self.name)))
    }

    /// The session; the reason in one sentence if there is none.
    pub(crate) fn session(&self) -> Result<Session, String> {
        self.client.shared.session()
    }

    /// Waits for a session after the one with number `last`.
    #[cfg(test)]
    pub(crate) fn wait_for_session_after(
        &self,
        last: u64,
        span: std::time::Duration,
    ) -> Result<Session, String> {
        self.client.shared.session_after(last, span)
    }

    /// Name of its drive.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Text of its place.
    pub(crate) fn place(&self) -> &str {
        &self.place
    }

    /// The serial port of the drive's bus, if it is known.
    pub(crate) fn bus(&self) -> Option<&PathBuf> {
        self.bus.as_ref()
    }
}

/// The board of a [run](crate::Running), for other threads.
#[derive(Clone)]
pub struct OnBoard {
    boards: Arc<BTreeMap<String, Board>>,
    name: String,
}

impl OnBoard {
    pub(crate) fn new(boards: &Arc<BTreeMap<String, Board>>, name: &str) -> Option<Self> {
        boards.contains_key(name).then(|| Self { boards: Arc::clone(boards), name: name.to_owned() })
    }

    /// Text of the place of the board.
    #[must_use]
    pub fn place(&self) -> String {
        self.boards.get(&self.name).map_or_else(String::new, |board| board.place().to_owned())
    }

    /// The drive, as it is now. Its calls wait for the answers of the board.
    ///
    /// # Errors
    /// The board cannot be reached.
    pub fn drive(&self) -> Result<Drive, Refusal> {
        let board = self.boards.get(&self.name);
        board.ok_or_else(|| Refusal::Away("the board is no longer attached".into()))?.drive()
    }
}

/// The present state of a drive as events, so that recordings begin with it. Lights are left out, because they may blink.
pub(crate) fn present(session: &Session, state: &drivetwin_control::State) -> Vec<Event> {
    let (spec, at) = (session.spec, session.began);
    let mut events = vec![Event::Missing { events: None }];
    if let Some(line) = session.line {
        events.push(Event::Output(OutputRecord::Line { port: Port(0), line }));
    }
    let steps = spec.axes.first().and_then(|axis| axis.step_dir);
    for (number, pin) in (0..64).zip(spec.pins) {
        let level = state.level(number);
        // The pulses of the axis are not levels.
        if steps.is_some_and(|(step, dir)| [step, dir].contains(&Pin(number))) {
            continue;
        }
        let is_driven = state.driven >> number & 1 == 1;
        match (pin.role, level) {
            (Role::Output, level) => {
                let level = report::level(level);
                events.push(Event::Output(OutputRecord::Level { pin: Pin(number), level }));
            }
            (Role::Input, drivetwin_control::Level::Open) => {}
            (Role::Input, level) if is_driven || report::level(level) != pin.idle => {
                let high = level == drivetwin_control::Level::High;
                events.push(Event::Input(InputRecord::Edge { pin: Pin(number), high }));
            }
            _ => {}
        }
    }
    if let (Some(motion), Some(_)) = (state.motion, spec.axes.first()) {
        let plan = Box::new(Plan::at_rest(at, motion.position));
        if !motion.moving {
            let axis = drivetwin_firmware::device::Axis(0);
            events.push(Event::Output(OutputRecord::Plan { axis, plan }));
        }
    }
    events
}
