//! Terminals: clients on the text ports of drives, for a person.
//!
//! Characters of a drive wait in a [`Screen`], which keeps the newest 64 KiB. So a terminal that reads late costs no more,
//! and the thread of the bench never waits for it.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::Sse;
use axum::response::sse::Event;
use drivetwin_firmware::device::Framing;
use drivetwin_panel::requests::Typed;
use drivetwin_sim::bench::Client;
use drivetwin_sim::commands;
use futures_util::stream::{self, Stream};
use serde::Serialize;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::timeout;
use utoipa::ToSchema;

use super::calls::find_drive;
use super::event_stream::KEEP_ALIVE;
use super::guard::Body;
use super::problem::Problem;
use super::{Api, too_many};
use crate::board::reasons;
use crate::streams::Screen;

/// Shortest time between two events of a terminal.
const PACE: Duration = Duration::from_millis(34);

/// Maximum number of typed bytes that wait until the drive takes them.
const MOST_TYPED: usize = 64 << 10;

/// Terminals that are open, by their numbers.
#[derive(Clone, Default)]
pub(super) struct Terminals(Arc<Mutex<Open>>);

#[derive(Default)]
struct Open {
    last: u32,
    clients: BTreeMap<u32, Client>,
}

impl Terminals {
    fn with<T>(&self, act: impl FnOnce(&mut Open) -> T) -> T {
        // A thread that panicked while it had the lock has changed nothing halfway.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn add(&self, client: Client) -> u32 {
        self.with(|open| {
            open.last += 1;
            open.clients.insert(open.last, client);
            open.last
        })
    }
}

/// The data of an event `open`.
#[derive(Serialize, ToSchema)]
pub(super) struct TerminalOpen {
    /// Number of the terminal, for `POST /api/terminals/{id}`.
    #[schema(example = 1)]
    id: u32,
}

/// The data of an event `text`.
#[derive(Serialize, ToSchema)]
pub(super) struct TerminalText {
    /// Characters that the drive has sent, with control characters. A byte above 127 is U+FFFD.
    #[schema(example = "PR P\r\n0\r\n>")]
    text: String,
}

/// A terminal at a port for text, as server-sent events: a client of its own, which is gone when the connection ends. The
/// event `open` has a `TerminalOpen` as `data`, each event `text` a `TerminalText`. The events end when the drive ends the
/// connection.
#[utoipa::path(get, path = "/api/drives/{name}/ports/{port}/terminal", responses(
    (status = 200, description = "Events without end.", body = String, content_type = "text/event-stream"),
    (status = 409, description = "The drive accepts no connection now, or is on a board.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn terminal(
    State(api): State<Api>,
    Path((name, port)): Path<(String, String)>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let permit = api.readers.clone().try_acquire_owned();
    let permit = permit.map_err(|_| too_many("follow the bench"))?;
    let screen = Arc::new(Screen::default());
    let shown = Arc::clone(&screen);
    // If this client leaves meanwhile, the job is dropped, or its result, and the guard with it.
    let guard = api.clone();
    let connect = api.call(move |event_loop| {
        let drive = find_drive(event_loop, &name)?;
        let spec = event_loop.bench.spec(drive);
        let port = commands::port(spec, &port)?;
        let text = |framing| matches!(framing, Framing::Character | Framing::Return);
        if !spec.ports.get(usize::from(port.0)).is_some_and(|port| text(port.framing)) {
            let names: Vec<&str> =
                spec.ports.iter().filter(|port| text(port.framing)).map(|port| port.name).collect();
            let others =
                if names.is_empty() { "it has none".into() } else { format!("it has {}", names.join(", ")) };
            return Err(Problem::refused(format!("a terminal is for a port of {name} with text; {others}")));
        }
        if event_loop.bench.is_elsewhere(drive) {
            return Err(Problem::conflict(reasons::NO_STREAM));
        }
        let client = event_loop.streams.show(&mut event_loop.bench, drive, port, shown);
        let client = client
            .map_err(|refused| Problem::conflict(format!("{name} accepts no connection: {refused}")))?;
        event_loop.begin_idle_run();
        Ok(Connected { client, api: guard })
    });
    let connected = connect.await??;
    let id = api.terminals.add(connected.client);
    let terminal = Terminal { id: Some(id), screen, connected, _permit: permit };
    Ok(Sse::new(stream::unfold(terminal, |mut terminal| async {
        let event = terminal.next().await?;
        Some((Ok(event), terminal))
    })))
}

/// A client of the bench, which is disconnected when this value is dropped.
struct Connected {
    client: Client,
    api: Api,
}

impl Drop for Connected {
    fn drop(&mut self) {
        let client = self.client;
        self.api.terminals.with(|open| open.clients.retain(|_, other| *other != client));
        // The job is done although nobody waits for it.
        let caller = Arc::new(());
        self.api.handle.submit(Arc::downgrade(&caller), move |event_loop| {
            let _caller = caller;
            event_loop.streams.disconnect(&mut event_loop.bench, client);
            event_loop.begin_idle_run();
            || {}
        });
    }
}

/// A terminal that is open.
struct Terminal {
    /// Its number, until it is told.
    id: Option<u32>,
    screen: Arc<Screen>,
    #[expect(dead_code, reason = "dropped with the terminal")]
    connected: Connected,
    _permit: OwnedSemaphorePermit,
}

impl Terminal {
    /// The next event, or a comment after a long time without one; `None` when the connection has ended.
    async fn next(&mut self) -> Option<Event> {
        if let Some(id) = self.id.take() {
            return Event::default().event("open").json_data(TerminalOpen { id }).ok();
        }
        match timeout(KEEP_ALIVE, self.screen.wait()).await {
            Ok(()) => {}
            Err(_) => return Some(Event::default().comment("")),
        }
        // A fast stream gives one event for many characters.
        tokio::time::sleep(PACE).await;
        let bytes = self.screen.take()?;
        let shown = |&byte: &u8| if byte.is_ascii() { char::from(byte) } else { char::REPLACEMENT_CHARACTER };
        let text = bytes.iter().map(shown).collect();
        Event::default().event("text").json_data(TerminalText { text }).ok()
    }
}

/// Types on a terminal.
#[utoipa::path(post, path = "/api/terminals/{id}", request_body = Typed, responses(
    (status = 204),
    (status = 409, description = "The drive has not taken what was typed before.", body = Problem,
        content_type = "application/problem+json"),
))]
pub(super) async fn typed(
    State(api): State<Api>,
    Path(id): Path<u32>,
    Body(Typed { text }): Body<Typed>,
) -> Result<StatusCode, Problem> {
    let client = api.terminals.with(|open| open.clients.get(&id).copied());
    let client = client.ok_or_else(|| {
        Problem::not_found(format!("there is no terminal {id}; it is open while its events are read"))
    })?;
    api.call(move |event_loop| {
        let bench = &mut event_loop.bench;
        if bench.backlog(client) + text.len() > MOST_TYPED {
            return Err(Problem::conflict("the drive has not taken what was typed before; wait"));
        }
        bench.send(client, text.as_bytes());
        event_loop.begin_idle_run();
        Ok(StatusCode::NO_CONTENT)
    })
    .await?
}
