//! Clients in this process, for [`Lender`](crate::Lender) and the terminals of the control API.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivetwin_firmware::device::Port;
use drivetwin_sim::bench::{Bench, Client, ConnectError, DriveId, Ended};
use tokio::sync::Notify;

/// Maximum number of bytes that wait in a [`Screen`].
const MOST_SHOWN: usize = 64 << 10;

/// Clients that are in this process, and what has come for each of them. The bench of a run gets rid of it at once, so a
/// client that reads late delays nothing.
#[derive(Default)]
pub struct Streams(HashMap<Client, Stream>);

#[derive(Default)]
struct Stream {
    received: Vec<u8>,
    ended: Option<Ended>,
    /// Takes what is received, if another thread shows it.
    screen: Option<Arc<Screen>>,
}

/// Characters of a drive for a client that another thread shows. If that thread is late, the oldest bytes are dropped.
#[derive(Default)]
pub(crate) struct Screen {
    shown: Mutex<Shown>,
    came: Notify,
}

#[derive(Default)]
struct Shown {
    bytes: VecDeque<u8>,
    ended: bool,
}

impl Screen {
    fn lock(&self) -> MutexGuard<'_, Shown> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds bytes, and notes that no more come if the connection has ended.
    fn add(&self, bytes: &[u8], ended: bool) {
        let mut shown = self.lock();
        shown.bytes.extend(bytes);
        let old = shown.bytes.len().saturating_sub(MOST_SHOWN);
        shown.bytes.drain(..old);
        shown.ended |= ended;
        self.came.notify_one();
    }

    /// Waits until there are bytes, or the connection has ended.
    pub(crate) async fn wait(&self) {
        loop {
            {
                let shown = self.lock();
                if shown.ended || !shown.bytes.is_empty() {
                    return;
                }
            }
            self.came.notified().await;
        }
    }

    /// Takes all bytes; `None` if there are none and the connection has ended.
    pub(crate) fn take(&self) -> Option<Vec<u8>> {
        let mut shown = self.lock();
        if shown.ended && shown.bytes.is_empty() {
            return None;
        }
        Some(shown.bytes.drain(..).collect())
    }
}

impl Streams {
    /// Connects a client to a port of a drive.
    ///
    /// # Errors
    /// The drive refuses the connection.
    pub fn connect(&mut self, bench: &mut Bench, drive: DriveId, port: Port) -> Result<Client, ConnectError> {
        let client = bench.connect_to(drive, port)?;
        self.0.insert(client, Stream::default());
        Ok(client)
    }

    /// Connects a client to a port of a drive, whose bytes `screen` takes.
    ///
    /// # Errors
    /// The drive refuses the connection.
    pub(crate) fn show(
        &mut self,
        bench: &mut Bench,
        drive: DriveId,
        port: Port,
        screen: Arc<Screen>,
    ) -> Result<Client, ConnectError> {
        let client = self.connect(bench, drive, port)?;
        self.0.insert(client, Stream { screen: Some(screen), ..Stream::default() });
        Ok(client)
    }

    /// Appends what has come for a client, and forgets it.
    pub fn receive(&mut self, bench: &mut Bench, client: Client, into: &mut Vec<u8>) {
        if let Some(stream) = self.0.get_mut(&client) {
            into.append(&mut stream.received);
        }
        bench.receive(client, into);
    }

    /// Returns true if something has come for a client, or its connection is closed.
    #[must_use]
    pub fn is_readable(&self, bench: &Bench, client: Client) -> bool {
        let is_held = |stream: &Stream| !stream.received.is_empty() || stream.ended.is_some();
        self.0.get(&client).is_some_and(is_held) || bench.readable().any(|other| other == client)
    }

    /// Reason why the connection of a client is closed; `None` if it is open, or on a line.
    #[must_use]
    pub fn ended(&self, bench: &Bench, client: Client) -> Option<Ended> {
        self.0.get(&client).and_then(|stream| stream.ended).or_else(|| bench.ended(client))
    }

    /// Ends the connection of a client.
    pub fn disconnect(&mut self, bench: &mut Bench, client: Client) {
        if self.0.remove(&client).is_some_and(|stream| stream.ended.is_none()) {
            bench.disconnect(client);
        }
    }

    /// Takes from the bench what has come.
    pub(crate) fn collect(&mut self, bench: &mut Bench) {
        if self.0.is_empty() {
            return;
        }
        let readable: Vec<Client> = bench.readable().collect();
        for client in readable {
            let Some(stream) = self.0.get_mut(&client) else { continue };
            bench.receive(client, &mut stream.received);
            stream.ended = bench.ended(client);
            if let Some(screen) = &stream.screen {
                screen.add(&stream.received, stream.ended.is_some());
                stream.received.clear();
            }
            if stream.ended.is_some() {
                bench.disconnect(client);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_screen_keeps_the_newest_bytes() {
        let screen = Screen::default();
        screen.add(&[b'a'; MOST_SHOWN], false);
        screen.add(b"bc", false);
        let bytes = screen.take().unwrap();
        assert_eq!((bytes.len(), &bytes[MOST_SHOWN - 3..]), (MOST_SHOWN, &b"abc"[..]));
        assert_eq!(screen.take().as_deref(), Some(&b""[..]));
        screen.add(b"d", true);
        assert_eq!(screen.take().as_deref(), Some(&b"d"[..]));
        assert_eq!(screen.take(), None);
    }
}
