//! A bench in a terminal: a client of the control API that shows drives, lights, registers, motion and traffic, and
//! takes keys for pins, faults, power and time (HOST-26).
//!
//! Small machines, each with a state of its own:
//!
//! | module | what it does |
//! |---|---|
//! | `address` | the address of a control API |
//! | `events`, `patch` | bytes to events, events to a state |
//! | `client` | calls and the live state, on a thread |
//! | `bench` | what is known of the bench |
//! | `keys` | the table of keys |
//! | `entry` | an input line, and the words in it |
//! | `app` | what is shown, and what a key does |
//! | `draw` | from that to cells |
//! | `terminal` | the terminal, and the clock |

mod address;
mod app;
mod bench;
mod client;
mod draw;
mod entry;
mod events;
mod keys;
mod patch;
mod terminal;
#[cfg(test)]
mod tests;

use std::io;
use std::os::fd::{AsFd as _, OwnedFd};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;

use ratatui::crossterm::event::{self as input, Event as Input, KeyEventKind};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::retry_on_intr;

pub use address::Address;
use app::{App, Effect};
use client::{Client, News};
use terminal::{Clock, Screen};

/// Maximum number of events that wait to be shown. A source that has more waits.
const WAITING: usize = 256;

/// Something that happens to the view.
enum Event {
    News(News),
    Input(Input),
    Log(String),
    Stop,
}

/// Shows the bench at an address in this terminal, until a key ends it or one of `stops` becomes readable. Lines of
/// `log` are shown in a pane.
///
/// # Errors
/// One sentence: there is no terminal, or it cannot be used.
pub fn show(address: &Address, log: Option<Receiver<String>>, stops: Vec<OwnedFd>) -> Result<(), String> {
    let mut screen = Screen::take()?;
    let (sender, events) = sync_channel(WAITING);
    let client = start_client(address, &sender)?;
    let mut app = App::new(address, log.is_some());
    spawn("stop", &sender, move |events| {
        if wait_for_any(&stops).is_ok() {
            let _ = events.send(Event::Stop);
        }
    })?;
    spawn("keys", &sender, read_input)?;
    if let Some(log) = log {
        spawn("lines", &sender, move |events| {
            let mut lines = log.into_iter();
            while lines.next().is_some_and(|line| events.send(Event::Log(line)).is_ok()) {}
        })?;
    }
    drop(sender);
    run(&mut app, &mut screen, &client, &events)
}

/// Starts the client; its news become events.
fn start_client(address: &Address, events: &SyncSender<Event>) -> Result<Client, String> {
    let (sender, news) = sync_channel(1);
    let client = Client::start(address.clone(), sender, client::RETRIES)?;
    spawn("news", events, move |events| {
        let mut news = news.into_iter();
        while news.next().is_some_and(|news| events.send(Event::News(news)).is_ok()) {}
    })?;
    Ok(client)
}

fn spawn(
    name: &str,
    events: &SyncSender<Event>,
    work: impl FnOnce(SyncSender<Event>) + Send + 'static,
) -> Result<(), String> {
    let events = events.clone();
    let thread = thread::Builder::new().name(name.into()).spawn(move || work(events));
    thread.map(drop).map_err(|error| format!("the view has no thread: {error}"))
}

/// Waits until one of these becomes readable.
fn wait_for_any(stops: &[OwnedFd]) -> io::Result<()> {
    let mut polled: Vec<PollFd> =
        stops.iter().map(|stop| PollFd::from_borrowed_fd(stop.as_fd(), PollFlags::IN)).collect();
    retry_on_intr(|| poll(&mut polled, None))?;
    Ok(())
}

/// Reads keys and sizes until the terminal is gone.
fn read_input(events: SyncSender<Event>) {
    loop {
        let event = match input::read() {
            Ok(input) => Event::Input(input),
            Err(_) => Event::Stop,
        };
        let is_last = matches!(event, Event::Stop);
        if events.send(event).is_err() || is_last {
            return;
        }
    }
}

fn run(app: &mut App, screen: &mut Screen, client: &Client, events: &Receiver<Event>) -> Result<(), String> {
    let clock = Clock::start();
    // no-color.org
    let has_colours = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let mut effects = vec![app.start()];
    loop {
        for effect in effects.drain(..) {
            match effect {
                Effect::Ask(ask) => client.ask(ask),
                Effect::Redraw => screen.redraw().map_err(|error| unwritable(&error))?,
                Effect::Quit => return Ok(()),
            }
        }
        let now = clock.now();
        let Some(terminal) = screen.get() else { return Err("the view has failed".to_owned()) };
        let drawn = terminal.draw(|frame| draw::draw(frame, app, now, has_colours));
        drawn.map_err(|error| unwritable(&error))?;
        let first = match app.wake(now) {
            Some(at) => events.recv_timeout(at.saturating_sub(clock.now())),
            None => events.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match first {
            Ok(event) => {
                // All that has come meanwhile is drawn at once.
                for event in [event].into_iter().chain(events.try_iter().take(WAITING)) {
                    match handle(app, event, &clock) {
                        Some(more) => effects.extend(more),
                        None => return Ok(()),
                    }
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        effects.extend(app.tick(clock.now()));
    }
}

fn unwritable(error: &io::Error) -> String {
    format!("the terminal cannot be written: {error}")
}

/// Takes an event. Returns `None` if it ends the view.
fn handle(app: &mut App, event: Event, clock: &Clock) -> Option<Vec<Effect>> {
    let now = clock.now();
    Some(match event {
        Event::News(news) => app.hear(news, now),
        Event::Input(Input::Key(key)) if key.kind != KeyEventKind::Release => app.key(key, now),
        Event::Input(Input::Paste(text)) => {
            app.paste(&text);
            Vec::new()
        }
        // A new size needs only a new drawing.
        Event::Input(_) => Vec::new(),
        Event::Log(line) => {
            app.add_log(line);
            Vec::new()
        }
        Event::Stop => return None,
    })
}
