//! `GET /api/events`: live events.
//!
//! A reader has no queue of its own: it stores only its position in the ring of the trace. It takes the next
//! piece when the trace has grown and its last piece is sent. So a slow reader costs no more than a fast one,
//! and misses only events that the ring has dropped.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Sse;
use axum::response::sse::Event;
use drivetwin_panel::units::seconds;
use drivetwin_sim::bench::{Bench, News, Receiver};
use drivetwin_sim::record::trace::{self, Entry, Trace};
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::timeout;
use utoipa::ToSchema;

use super::guard::QueryParameters;
use super::problem::Problem;
use super::received::ReceivedRequest;
use super::{Api, too_many};
use drivetwin_sim::suggest;

/// Longest time without an event. Then a comment keeps the connection alive.
pub(super) const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Maximum number of events per piece.
const PIECE: usize = 256;

/// Parameters of the call.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EventParameters {
    drive: Option<String>,
}

/// The data of an event `fed` (input of a drive) or `did` (output of a drive).
#[derive(Serialize, ToSchema)]
pub(super) struct Happened {
    /// Bench time in seconds. Outputs of a drive may be in the future.
    #[schema(example = 2.513176875)]
    seconds: f64,
    drive: String,
    /// The event, in the form of a line of a trace.
    #[schema(example = "tx 01 03 02 00 01 79 84")]
    words: String,
}

/// The data of an event `received`: a message that a drive has received, with its outcome.
#[derive(Serialize, ToSchema)]
pub(super) struct ReceivedEvent {
    /// Number of the message on the bench. A missing number belongs to a message to another drive, or to a
    /// message that a slow reader has missed.
    number: u64,
    /// The drive; null for a message on a shared line that was for no drive or corrupt.
    drive: Option<String>,
    /// The shared line of such a message; null for a message to a drive.
    bus: Option<String>,
    #[serde(flatten)]
    request: ReceivedRequest,
}

/// The data of an event `lost`.
#[derive(Serialize, ToSchema)]
pub(super) struct Lost {
    /// Number of events that a slow reader has missed, or that a board could not send; null if it is unknown.
    events: Option<u64>,
    /// The drive on a board whose events are missing; null if the reader was too slow.
    drive: Option<String>,
}

/// Live events, as server-sent events: `fed` (input of a drive) or `did` (output of a drive) with a `Happened` as `data`,
/// and `received` with a `ReceivedEvent`. The `id` has two numbers with a point between them: of the last event of the
/// trace, and of the last received message. A reader that is too slow gets the event `lost` with a `Lost`, and then the
/// following events; so does every reader if a board could not send events. When a board becomes a drive of another kind,
/// the events end; connect again with the last id.
#[utoipa::path(get, path = "/api/events",
    params(
        ("drive" = Option<String>, Query, description = "only what happens to this drive"),
        ("Last-Event-ID" = Option<String>, Header, description = "the id to go on after, 0 for the beginning; from now on if not given"),
    ),
    responses((status = 200, description = "Events without end.", body = String, content_type = "text/event-stream")),
)]
pub(super) async fn events(
    State(api): State<Api>,
    headers: HeaderMap,
    QueryParameters(parameters): QueryParameters<EventParameters>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let permit = api.readers.clone().try_acquire_owned();
    let permit = permit.map_err(|_| too_many("follow the bench"))?;
    // Taken before the first query, so that no later event is missed.
    let grown = api.handle.watch();
    let (outline, received) = api.query(|bench| (bench.trace().outline(), bench.received_count())).await?;
    let drive = parameters.drive.map(|name| drive_index(&outline, &name)).transpose()?;
    let last = headers.get("last-event-id").and_then(|id| Position::parse(id.to_str().ok()?));
    let mark = outline.mark();
    let (mark, received) = match last {
        Some(Position { mark: last, received: first }) => {
            (last.min(mark), first.map_or(received, |first| first.min(received)))
        }
        None => (mark, received),
    };
    let reader =
        Reader { api, grown, outline, drive, mark, received, ready: VecDeque::new(), _permit: permit };
    Ok(Sse::new(stream::unfold(reader, |mut reader| async {
        let event = reader.next().await?;
        Some((Ok(event), reader))
    })))
}

/// The `id` of an event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Position {
    /// Number of the last event of the trace.
    mark: u64,
    /// Number of the last received message; `None` if the reader does not say it.
    received: Option<u64>,
}

impl Position {
    /// Parses an id, or the number of an event alone. The number 0 is the beginning of everything.
    fn parse(id: &str) -> Option<Self> {
        let (mark, received) = match id.split_once('.') {
            Some((mark, received)) => (mark.parse().ok()?, Some(received.parse().ok()?)),
            None => (id.parse().ok()?, None),
        };
        Some(Self { mark, received: received.or((mark == 0).then_some(0)) })
    }
}

/// Index of the drive with that name.
fn drive_index(trace: &Trace, name: &str) -> Result<usize, Problem> {
    let names = || trace.drives.iter().map(|drive| drive.name.as_str());
    let unknown = || Problem::refused(suggest::unknown("drive", name, names()));
    names().position(|other| other == name).ok_or_else(unknown)
}

/// A reader that follows the bench.
struct Reader {
    api: Api,
    grown: watch::Receiver<u64>,
    /// The drives of the trace, to format events.
    outline: Trace,
    /// Index of the drive whose events are wanted; `None` for all.
    drive: Option<usize>,
    /// Position in the trace up to which events were taken.
    mark: u64,
    /// Number of the last received message that was taken.
    received: u64,
    /// Events of the last piece that are still to be sent.
    ready: VecDeque<Event>,
    _permit: OwnedSemaphorePermit,
}

impl Reader {
    /// The next event, or a comment after a long time without an event; `None` when the bench has ended.
    async fn next(&mut self) -> Option<Event> {
        match timeout(KEEP_ALIVE, self.wait()).await {
            Ok(event) => event,
            // A query that was pending is repeated by the next call.
            Err(_) => Some(Event::default().comment("")),
        }
    }

    /// The next wanted event; `None` when the bench has ended.
    async fn wait(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(event);
            }
            let (mark, received, drive) = (self.mark, self.received, self.drive);
            let pieces = self.api.query(move |bench| {
                (Piece::of(bench.trace(), mark, drive), Messages::of(bench, received, drive))
            });
            let (piece, messages) = pieces.await.ok()?;
            if piece.generation != self.outline.generation() {
                return None;
            }
            self.take(piece);
            self.take_messages(messages);
            if (self.mark, self.received) == (mark, received) {
                self.grown.changed().await.ok()?;
            }
        }
    }

    /// Formats the events of a piece.
    fn take(&mut self, piece: Piece) {
        if piece.lost > 0 {
            let id = self.mark + piece.lost;
            self.ready.extend(event(
                "lost",
                (id, self.received),
                &Lost { events: Some(piece.lost), drive: None },
            ));
        }
        let received = self.received;
        self.ready.extend(piece.entries.iter().filter_map(|(id, entry)| {
            let drive = self.outline.drives.get(entry.drive)?.name.clone();
            let kind = match entry.event {
                trace::Event::Input(_) => "fed",
                trace::Event::Output(_) => "did",
                trace::Event::Missing { events } => {
                    return event("lost", (*id, received), &Lost { events, drive: Some(drive) });
                }
                trace::Event::Shaft { .. } | trace::Event::Received(_) => return None,
            };
            let words = self.outline.words(entry);
            event(kind, (*id, received), &Happened { seconds: seconds(entry.at), drive, words })
        }));
        self.mark = piece.end;
    }

    /// Formats received messages.
    fn take_messages(&mut self, messages: Messages) {
        let Messages { news, wanted } = messages;
        for ((_, message), names) in news.messages().zip(wanted) {
            if let Some((drive, bus)) = names {
                let number = message.number;
                let data = ReceivedEvent { number, drive, bus, request: message.into() };
                self.ready.extend(event("received", (self.mark, number), &data));
            }
        }
        self.received = news.last();
    }
}

fn event(kind: &str, (mark, received): (u64, u64), data: &impl Serialize) -> Option<Event> {
    Event::default().event(kind).id(format!("{mark}.{received}")).json_data(data).ok()
}

/// Some events and their numbers.
struct Piece {
    entries: Vec<(u64, Entry)>,
    /// Number of events before them that the reader missed, because the ring had dropped them.
    lost: u64,
    /// Position in the trace after the last event.
    end: u64,
    /// The drives of the trace are others in each generation.
    generation: u32,
}

impl Piece {
    /// At most [`PIECE`] events after the position `mark`, without those of drives that are not wanted.
    fn of(trace: &Trace, mark: u64, drive: Option<usize>) -> Self {
        let from = mark.max(trace.lost);
        let looked_at = trace.since(from).take(PIECE);
        let end = from + looked_at.len() as u64;
        let numbered = (from + 1..).zip(looked_at);
        let wanted = numbered.filter(|(_, entry)| drive.is_none_or(|drive| drive == entry.drive));
        let entries = wanted.map(|(id, entry)| (id, entry.clone())).collect();
        Self { entries, lost: from - mark, end, generation: trace.generation() }
    }
}

/// Some received messages. The thread of the API makes their texts.
struct Messages {
    news: News,
    /// For each message the name of its drive or line; `None` if it is not wanted.
    wanted: Vec<Option<(Option<String>, Option<String>)>>,
}

impl Messages {
    /// At most [`PIECE`] messages after number `after`.
    fn of(bench: &Bench, after: u64, drive: Option<usize>) -> Self {
        let news = bench.recorded_after(after, PIECE);
        let only = drive.and_then(|index| bench.drives().nth(index));
        let names = |receiver: Receiver| match receiver {
            Receiver::Drive(id) if only.is_none_or(|only| only == id) => {
                Some((Some(bench.name(id).to_owned()), None))
            }
            Receiver::Line(bus)
                if only.is_none_or(|only| bench.ports(bus).iter().any(|&(id, _)| id == only)) =>
            {
                Some((None, Some(bench.bus_name(bus).to_owned())))
            }
            _ => None,
        };
        let wanted = news.receivers().map(names).collect();
        Self { news, wanted }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_has_the_numbers_of_the_trace_and_of_the_messages() {
        let position = |mark, received| Some(Position { mark, received });
        assert_eq!(Position::parse("12.5"), position(12, Some(5)));
        assert_eq!(Position::parse("12"), position(12, None));
        assert_eq!(Position::parse("0"), position(0, Some(0)));
        for wrong in ["", "x", "1.", ".1", "1.2.3", "-1"] {
            assert_eq!(Position::parse(wrong), None, "{wrong}");
        }
    }
}
