//! Clients: somebody outside who talks and listens on a line, or on a TCP connection.

use drivetwin_firmware::device::{Duration, Instant, Port};

use super::{Bench, Bus, Client, DriveId};
use crate::line::{CharFlags, ClientState, Sender};

/// Clients.
impl Bench {
    /// Sets the longest wait for the rest of half a message, in time of the bench (HOST-3).
    pub fn set_patience(&mut self, patience: Duration) {
        self.settings.patience = patience;
    }

    /// Connects a client to a line.
    pub fn connect(&mut self, bus: Bus) -> Client {
        self.connected += 1;
        self.clients.insert(self.connected, ClientState::new(bus.0, self.arrivals));
        self.buses[bus.0 as usize].clients.push(self.connected);
        Client(self.connected)
    }

    /// A client leaves, and takes its half message along. What was complete is still sent, on a TCP connection unless
    /// it waits because answers were not read.
    pub fn disconnect(&mut self, client: Client) {
        if self.connections.has(client.0) {
            return self.disconnect_tcp(client.0);
        }
        let Some(outside) = self.clients.leave(client.0) else { return };
        let bus = outside.bus;
        if outside.backlog() == 0 {
            self.forget(client.0);
        }
        self.serve(bus);
    }

    /// A client's bytes arrive now.
    pub fn send(&mut self, client: Client, bytes: &[u8]) {
        self.send_from(client, bytes, Sender::default());
    }

    /// A client's bytes arrive now, from a port with these settings. A drive whose line they do not
    /// fit hears characters that nobody can read.
    pub fn send_from(&mut self, client: Client, bytes: &[u8], sender: Sender) {
        if self.connections.has(client.0) {
            return self.send_messages(client.0, bytes);
        }
        let Some(outside) = self.clients.get_mut(&client.0).filter(|outside| !outside.left) else { return };
        if bytes.is_empty() {
            return;
        }
        let bus = outside.bus;
        outside.sender = sender;
        if self.framed(bus).is_some() {
            self.queue(client, bytes, CharFlags::default());
        } else {
            self.queue_disturbed(client, bytes);
        }
        self.serve(bus);
    }

    /// Bytes of a client wait for the line.
    pub(super) fn queue(&mut self, client: Client, bytes: &[u8], mark: CharFlags) {
        if let Some(outside) = self.clients.get_mut(&client.0) {
            self.arrivals += 1;
            outside.arrive(self.now, self.arrivals, bytes, mark);
        }
    }

    /// Bytes of a client that are not on the line yet, or on a TCP connection not on their way to the drive. A host
    /// that reads only while this is small holds back who sends faster than the line, or does not read what is
    /// answered.
    #[must_use]
    pub fn backlog(&self, client: Client) -> usize {
        let on_a_line = self.clients.get(&client.0).map(ClientState::backlog);
        on_a_line.unwrap_or_else(|| self.connections.backlog(client.0))
    }

    /// Appends the characters that have reached a client by now; returns how many.
    pub fn receive(&mut self, client: Client, into: &mut Vec<u8>) -> usize {
        if self.connections.has(client.0) {
            return self.receive_messages(client.0, into);
        }
        self.clients.receive(client.0, self.now, into)
    }

    /// The clients that can read something now, or that their connection is closed.
    pub fn audible(&self) -> impl Iterator<Item = Client> {
        self.clients.audible(self.now).chain(self.connections.audible()).map(Client)
    }

    /// A client's port gives characters their time itself, as a real serial port does: what a drive says
    /// reaches it whole, as the first character begins.
    pub fn set_self_paced(&mut self, client: Client) {
        if let Some(outside) = self.clients.get_mut(&client.0) {
            outside.paces_itself = true;
        }
    }

    /// Sends a whole frame to the first port of a device, [settles](Self::settle), and returns what came. Silence ends
    /// a frame that could be half of a longer one.
    pub fn ask(&mut self, seat: DriveId, frame: &[u8]) -> Vec<u8> {
        let mut reply = Vec::new();
        if let Ok(client) = self.connect_to(seat, Port(0)) {
            self.send(client, frame);
            let settling = self.begin_to_settle_halves();
            self.settle_until(settling, Instant::NEVER);
            self.receive(client, &mut reply);
            self.disconnect(client);
        }
        reply
    }

    /// A client is gone for good.
    pub(super) fn forget(&mut self, id: u32) {
        if let Some(outside) = self.clients.remove(&id) {
            self.buses[outside.bus as usize].clients.retain(|&other| other != id);
        }
    }
}
