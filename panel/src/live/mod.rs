//! The viewer: what a reader knows of a bench, and what has changed since.
//!
//! A [`Viewer`] says what it wants to see ([`Viewer::look`]). The thread of the bench copies that, as numbers
//! ([`Snapshot::of`]). The viewer compares the copy with the state that its reader has, and makes JSON of the difference
//! ([`Viewer::update`]). So a reader that is late gets fewer updates, and nothing waits for it.
//!
//! ```
//! use std::time::Duration;
//!
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_panel::live::{Snapshot, Viewer};
//! use drivetwin_panel::schema::Places;
//! use drivetwin_protocol::{modbus::rtu, time::Span};
//! use drivetwin_sim::bench::Bench;
//! use drivetwin_sim::config::time_mode::TimeMode;
//!
//! let mut bench = Bench::new();
//! let x = bench.add::<Md3>("x");
//! let mut viewer = Viewer::new(None);
//! let see = |bench: &Bench, viewer: &Viewer| Snapshot::of(bench, TimeMode::Manual, &Places::new(), viewer.look());
//! let whole = viewer.update(see(&bench, &viewer), Duration::ZERO).expect("the first update is whole");
//! assert_eq!(whole.state.expect("a state")["drives"]["x"]["position"], 0);
//!
//! bench.run_until(2_500.millis());
//! bench.ask(x, &rtu::write(1, 0x11, 1));
//! bench.run_until(6.secs());
//! let update = viewer.update(see(&bench, &viewer), Duration::from_secs(1)).expect("the motor has moved");
//! assert_eq!(update.state.expect("a change")["drives"]["x"]["position"], 10_000);
//! assert_eq!(update.traffic[0].text, "write MotionControl = 1");
//! ```

mod frames;
mod patch;
mod seen;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use drivetwin_firmware::device::{Instant, Spec};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{Bench, DriveId, News, Outlet, OwnNews};
use drivetwin_sim::commands::State;
use drivetwin_sim::config::time_mode::TimeMode;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

pub use self::frames::Frame;
use self::seen::{Layout, Seen};
use crate::schema::{BoardView, Drive, Places};

/// Maximum number of frames per update.
pub const MOST_FRAMES: usize = 100;

/// Shortest time between two updates: at most 30 per second.
pub const SHORTEST: Duration = Duration::from_millis(34);

/// Longest time between two looks at a bench whose time goes on by itself, and shortest time between two updates in
/// which only the time has changed.
pub const LONGEST: Duration = Duration::from_millis(250);

/// The pace of a reader: at most 30 updates per second, and an event is told at once if the last update is older than
/// that. Instants are times since a moment that the caller chooses.
#[derive(Clone, Copy, Default, Debug)]
pub struct Pace {
    /// Time of the last look that an event caused, or that gave an update.
    looked: Option<Duration>,
    updated: Option<Duration>,
}

impl Pace {
    /// Returns true after the first look.
    #[must_use]
    pub fn has_looked(&self) -> bool {
        self.looked.is_some()
    }

    /// Time from `now` until the reader may look because of an event.
    #[must_use]
    pub fn rest(&self, now: Duration) -> Duration {
        self.looked.map_or(Duration::ZERO, |looked| (looked + SHORTEST).saturating_sub(now))
    }

    /// Time since the last update; [`LONGEST`] before the first one.
    #[must_use]
    pub fn since_update(&self, now: Duration) -> Duration {
        self.updated.map_or(LONGEST, |updated| now.saturating_sub(updated))
    }

    /// Notes a look. A look of an idle reader that finds nothing does not delay the next event.
    pub fn looked(&mut self, now: Duration, has_news: bool, gave_update: bool) {
        if has_news || gave_update || self.looked.is_none() {
            self.looked = Some(now);
        }
        if gave_update {
            self.updated = Some(now);
        }
    }
}

/// An update of what a reader has. Members that are empty are absent.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LiveUpdate)]
pub struct Update {
    /// The changes, as a JSON merge patch (RFC 7396). The first one is the whole state.
    #[schema(value_type = Option<Object>, nullable = false)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Value>,
    /// Messages to drives and from them, in the order in which their outcomes became known; the newest 100.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub traffic: Vec<Frame>,
    /// Number of older messages since the last update that `traffic` does not have.
    #[serde(skip_serializing_if = "is_zero")]
    pub left_out: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde asks for")]
fn is_zero(number: &u64) -> bool {
    *number == 0
}

/// The part of a bench that a viewer wants to see.
#[derive(Clone, Debug)]
pub struct Look {
    /// The drive whose details are wanted.
    drive: Option<String>,
    /// Shape of the bench that the viewer knows, and its lines and TCP ports.
    shape: Option<[usize; 5]>,
    outlets: Arc<[Outlet]>,
    /// Numbers of the last messages that the viewer has: to drives, and of drives by themselves.
    received: u64,
    own: u64,
}

/// State of a bench at one instant, as numbers; the thread of the bench has nothing to do with the texts.
pub struct Snapshot {
    /// Names of everything, if the viewer does not know them.
    layout: Option<Layout>,
    seen: Seen,
    news: News,
    own: OwnNews,
    /// Time of the next change of a light that nothing announces.
    next_light: Instant,
}

impl Snapshot {
    /// The present state of a bench.
    #[must_use]
    pub fn of(bench: &Bench, mode: TimeMode, places: &Places, look: &Look) -> Self {
        let drive = look.drive.as_ref().and_then(|name| bench.find_drive(name));
        let layout = (look.shape != Some(bench.shape())).then(|| Layout::of(bench, places));
        let outlets = layout.as_ref().map_or_else(|| Arc::clone(&look.outlets), Layout::outlets);
        let next_lights = bench.drives().map(|id| seen::next_light(bench, id));
        Self {
            seen: Seen::of(bench, mode, &outlets, drive, places),
            next_light: next_lights.min().unwrap_or(Instant::NEVER),
            news: bench.received_lately(look.received, MOST_FRAMES, drive),
            own: bench.own_messages(look.own, MOST_FRAMES, drive),
            layout,
        }
    }

    /// Adds a board, whose drive is on the bench already, with the state and the details of its drive.
    pub fn add_board(
        &mut self,
        drive: DriveId,
        spec: &'static Spec,
        board: BoardView,
        state: Option<&State>,
        details: Option<Drive>,
    ) {
        self.seen.add_board(spec, drive, board, state, details);
    }
}

/// Reader of a bench: the state that it has.
pub struct Viewer {
    look: Look,
    layout: Layout,
    /// The state that the reader has; `None` before the first update.
    seen: Option<Seen>,
    /// Controls that the bench does not have, with the reason in one sentence.
    cannot: BTreeMap<&'static str, &'static str>,
    /// Longest time until the next look.
    wait: Duration,
}

impl Viewer {
    /// A reader that has nothing yet. With the name of a drive it sees the details of that drive, and no messages to
    /// others.
    #[must_use]
    pub fn new(drive: Option<String>) -> Self {
        Self {
            look: Look { drive, shape: None, outlets: Arc::default(), received: 0, own: 0 },
            layout: Layout::default(),
            seen: None,
            cannot: BTreeMap::new(),
            wait: SHORTEST,
        }
    }

    /// Adds what the bench cannot do: the name of the control, and the reason in one sentence.
    #[must_use]
    pub fn without(mut self, control: &'static str, reason: &'static str) -> Self {
        self.cannot.insert(control, reason);
        self
    }

    /// Content of the next [`Snapshot`].
    #[must_use]
    pub fn look(&self) -> &Look {
        &self.look
    }

    /// Longest time until the next look, if nothing announces a change. In manual time everything is announced.
    #[must_use]
    pub fn wait(&self) -> Duration {
        self.wait
    }

    /// Takes a snapshot. Returns what the reader does not have yet; `None` if nothing has changed, or only the time and
    /// less than [`LONGEST`] has passed since the last update.
    pub fn update(&mut self, snapshot: Snapshot, since_last: Duration) -> Option<Update> {
        let Snapshot { layout, seen, news, own, next_light } = snapshot;
        let (traffic, left_out) = frames::of(&news, &own, layout.as_ref().unwrap_or(&self.layout));
        (self.look.received, self.look.own) = (news.last(), own.last());
        let old = self.seen.as_ref();
        let state = match layout {
            Some(layout) => {
                let whole = |layout: &Layout, seen: &Seen| seen.whole(layout, &self.cannot);
                let before =
                    old.map_or_else(|| Value::Object(serde_json::Map::new()), |old| whole(&self.layout, old));
                let state = patch::merge_patch(&before, &whole(&layout, &seen));
                (self.look.shape, self.look.outlets) = (Some(seen.shape), layout.outlets());
                self.layout = layout;
                state
            }
            None => old.and_then(|old| seen.changes_since(old, &self.layout, &self.cannot)),
        };
        let has_moved = seen.is_moving() || state.as_ref().is_some_and(|state| !is_only_time(state));
        self.wait = self.wait_after(&seen, has_moved, next_light);
        let only_time = traffic.is_empty() && left_out == 0 && state.as_ref().is_some_and(is_only_time);
        if only_time && since_last < LONGEST {
            return None;
        }
        self.seen = Some(seen);
        let is_news = state.is_some() || !traffic.is_empty() || left_out > 0;
        is_news.then_some(Update { state, traffic, left_out })
    }

    fn wait_after(&self, seen: &Seen, has_moved: bool, next_light: Instant) -> Duration {
        let TimeMode::Times(factor) = seen.mode else { return LONGEST };
        if has_moved {
            return SHORTEST;
        }
        let ticks = next_light.since(seen.now).ticks() / u64::from(factor.max(1));
        Duration::from_nanos(ticks.saturating_mul(1_000_000_000 / TICKS_PER_SECOND)).clamp(SHORTEST, LONGEST)
    }
}

/// Returns true if a patch changes nothing but the time.
fn is_only_time(patch: &Value) -> bool {
    patch.as_object().is_some_and(|members| {
        members.len() == 1
            && members.get("time").and_then(Value::as_object).is_some_and(|time| !time.contains_key("mode"))
    })
}
