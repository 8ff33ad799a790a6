//! Clients in this process, for [`Lender`](crate::Lender).

use std::collections::HashMap;

use drivetwin_firmware::device::Port;
use drivetwin_sim::bench::{Bench, Client, ConnectError, DriveId, Ended};

/// Clients that are in this process, and what has come for each of them. The bench of a run gets rid of it at once, so a
/// client that reads late delays nothing.
#[derive(Default)]
pub struct Streams(HashMap<Client, Stream>);

#[derive(Default)]
struct Stream {
    received: Vec<u8>,
    ended: Option<Ended>,
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
            if stream.ended.is_some() {
                bench.disconnect(client);
            }
        }
    }
}
