//! `GET /api/live`: the state of the bench and its traffic, for a page that shows it.
//!
//! A reader has no queue: its [`Viewer`] looks at the bench when the connection can take an update, at most 30 times a
//! second. The thread of the bench copies numbers; this thread makes JSON of what has changed.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant as WallInstant};

use axum::extract::State;
use axum::response::Sse;
use axum::response::sse::Event;
use drivetwin_panel::live::{Pace, Snapshot, Viewer};
use drivetwin_panel::schema::{BoardView, Drive};
use drivetwin_sim::{commands, programs};
use futures_util::stream::{self, Stream};
use serde::Deserialize;
use tokio::sync::{Mutex, OwnedSemaphorePermit, watch};
use tokio::time::{sleep, timeout};

use super::board_state::{board_view, drive_of_board};
use super::event_stream::KEEP_ALIVE;
use super::guard::QueryParameters;
use super::problem::Problem;
use super::{Api, too_many};
use crate::board::reasons;
use crate::clock::wall;

/// Shortest time between two polls of a board.
const POLL: Duration = Duration::from_millis(100);

/// Parameters of the call.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LiveParameters {
    drive: Option<String>,
}

/// The state of the bench and the messages to its drives, as server-sent events. An event `update` has a `LiveUpdate` as
/// `data`: first the whole state, then what has changed. There are at most 30 of them per second. An update is made
/// when the reader can take it, so a slow reader gets fewer of them, and each is complete.
#[utoipa::path(get, path = "/api/live",
    params(("drive" = Option<String>, Query, description = "with the details of this drive, and only its messages")),
    responses((status = 200, description = "Events without end.", body = String, content_type = "text/event-stream")),
)]
pub(super) async fn live(
    State(api): State<Api>,
    QueryParameters(LiveParameters { drive }): QueryParameters<LiveParameters>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let permit = api.readers.clone().try_acquire_owned();
    let permit = permit.map_err(|_| too_many("follow the bench"))?;
    // Taken before the first look, so that no later change is missed.
    let grown = api.handle.watch();
    let name = drive.clone();
    // Of a rack the emulated drives can do what its boards cannot.
    let found = api.query(move |bench| match name {
        Some(name) => commands::drive(bench, &name)
            .map(|id| (bench.is_elsewhere(id), programs::runs_on(bench.spec(id)))),
        None => Ok((bench.drives().all(|id| bench.is_elsewhere(id)), false)),
    });
    let (is_elsewhere, has_program) =
        found.await?.map_err(|refusal| Problem::refused(refusal.to_string()))?;
    let mut viewer = Viewer::new(drive.clone());
    if !api.boards.is_empty() {
        viewer = viewer.without("time", reasons::NO_TIME).without("advance", reasons::NO_TIME);
    }
    if is_elsewhere {
        viewer = viewer
            .without("line_faults", reasons::NO_LINE_FAULTS)
            .without("scenario", reasons::NO_SCENARIO)
            .without("traffic", reasons::NO_JOURNAL);
    }
    if is_elsewhere && has_program {
        viewer = viewer.without("program", reasons::NO_PROGRAM);
    }
    let reader = Reader { api, grown, drive, viewer, pace: Pace::default(), opened: wall(), _permit: permit };
    Ok(Sse::new(stream::unfold(reader, |mut reader| async {
        let event = reader.next().await?;
        Some((Ok(event), reader))
    })))
}

/// A reader that follows the bench.
struct Reader {
    api: Api,
    grown: watch::Receiver<u64>,
    /// The drive whose details are wanted.
    drive: Option<String>,
    viewer: Viewer,
    pace: Pace,
    /// Time from which `pace` counts.
    opened: WallInstant,
    _permit: OwnedSemaphorePermit,
}

impl Reader {
    /// The next update, or a comment after a long time without one; `None` when the bench has ended.
    async fn next(&mut self) -> Option<Event> {
        match timeout(KEEP_ALIVE, self.wait()).await {
            Ok(event) => event,
            // A look that was pending is repeated by the next call.
            Err(_) => Some(Event::default().comment("")),
        }
    }

    /// The next update; `None` when the bench has ended.
    async fn wait(&mut self) -> Option<Event> {
        loop {
            sleep(self.pace.rest(self.now())).await;
            let has_news = if self.pace.has_looked() {
                match timeout(self.viewer.wait(), self.grown.changed()).await {
                    Ok(ended) => {
                        ended.ok()?;
                        true
                    }
                    Err(_) => false,
                }
            } else {
                true
            };
            let snapshot = self.look().await.ok()?;
            let now = self.now();
            let update = self.viewer.update(snapshot, self.pace.since_update(now));
            self.pace.looked(now, has_news, update.is_some());
            if let Some(update) = update {
                return Event::default().event("update").json_data(update).ok();
            }
        }
    }

    /// Time since the reader was opened.
    fn now(&self) -> Duration {
        wall().duration_since(self.opened)
    }

    /// Looks at the bench and at the boards.
    async fn look(&self) -> Result<Snapshot, Problem> {
        let (look, places, boards) =
            (self.viewer.look().clone(), self.api.places.clone(), self.api.boards.clone());
        let seen = self.api.see(move |event_loop| {
            let bench = &event_loop.bench;
            let snapshot = Snapshot::of(bench, event_loop.time_mode(), &places, &look);
            let drives = boards.keys().filter_map(|name| {
                let id = bench.find_drive(name)?;
                Some((name.clone(), id, bench.spec(id)))
            });
            (snapshot, drives.collect::<Vec<_>>())
        });
        let (mut snapshot, drives) = seen.await?;
        for (name, id, spec) in drives {
            let details = self.drive.as_ref() == Some(&name);
            let Polled { view, state, drive, .. } = self.api.polls.get(&self.api, name, details).await?;
            snapshot.add_board(id, spec, view, state.as_ref(), drive);
        }
        Ok(snapshot)
    }
}

/// The latest answers of the boards, for all readers together.
#[derive(Clone, Default)]
pub(super) struct Polls(Arc<Mutex<BTreeMap<(String, bool), Polled>>>);

/// A board as it was at one time.
#[derive(Clone)]
struct Polled {
    at: WallInstant,
    view: BoardView,
    /// State of its drive, and details if they are wanted; `None` if it cannot be reached.
    state: Option<commands::State>,
    drive: Option<Drive>,
}

impl Polls {
    /// A board, with or without the details of its drive, as it was at most [`POLL`] ago.
    async fn get(&self, api: &Api, name: String, details: bool) -> Result<Polled, Problem> {
        let mut known = self.0.lock().await;
        let key = (name, details);
        if let Some(polled) = known.get(&key).filter(|polled| wall().duration_since(polled.at) < POLL) {
            return Ok(polled.clone());
        }
        let poll = api.on_board(key.0.clone(), move |board| {
            let (view, _) = board_view(board);
            let mut on_board = board.drive().ok();
            let state = on_board.as_mut().and_then(|drive| commands::Drive::state(drive).ok());
            let drive = on_board.filter(|_| details).and_then(|mut drive| drive_of_board(&mut drive).ok());
            Ok((view, state, drive))
        });
        let (view, state, drive) = poll.await?;
        let polled = Polled { at: wall(), view, state, drive };
        known.insert(key, polled.clone());
        Ok(polled)
    }
}
