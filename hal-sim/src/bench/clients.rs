//! Clients: programs outside the bench that send and receive on a line or a TCP connection.

use drivetwin_firmware::device::{Duration, Instant, Port};

use super::{Bench, Bus, Client, DriveId};
use crate::line::{CharFlags, ClientState, Sender};

/// Clients.
impl Bench {
    /// Sets the longest wait for the rest of a partial frame, in bench time; see
    /// [`Settings::frame_timeout`](super::Settings::frame_timeout) (HOST-3).
    pub fn set_frame_timeout(&mut self, frame_timeout: Duration) {
        self.settings.frame_timeout = frame_timeout;
    }

    /// Connects a client to a line. Several clients may share a line; their requests are sent one after the other.
    pub fn connect(&mut self, bus: Bus) -> Client {
        let id = self.new_client();
        self.clients.insert(id, ClientState::new(bus.0, self.arrivals));
        self.buses[bus.0 as usize].clients.push(id);
        Client(id)
    }

    /// The number of a new client: the next one that no client has. Numbers begin again after the last one, which is not
    /// 0: lines without a client have that.
    pub(super) fn new_client(&mut self) -> u32 {
        loop {
            self.last_client = self.last_client.wrapping_add(1);
            let id = self.last_client;
            if id != 0 && self.clients.get(&id).is_none() && !self.connections.has(id) {
                return id;
            }
        }
    }

    /// Disconnects a client. A partial frame is dropped. Complete requests are still sent, except requests on
    /// a TCP connection that wait because the client has not read its answers.
    pub fn disconnect(&mut self, client: Client) {
        if self.connections.has(client.0) {
            return self.disconnect_tcp(client.0);
        }
        let Some(state) = self.clients.leave(client.0) else { return };
        let bus = state.bus;
        if state.backlog() == 0 {
            self.forget(client.0);
        }
        self.serve(bus);
    }

    /// Sends bytes of a client now: a part of a frame, a frame, or several frames.
    pub fn send(&mut self, client: Client, bytes: &[u8]) {
        self.send_from(client, bytes, Sender::default());
    }

    /// Sends bytes of a client now, from a port with these serial settings. A drive with other settings
    /// receives framing errors.
    pub fn send_from(&mut self, client: Client, bytes: &[u8], sender: Sender) {
        if self.connections.has(client.0) {
            return self.send_messages(client.0, bytes);
        }
        let Some(state) = self.clients.get_mut(&client.0).filter(|state| !state.left) else { return };
        if bytes.is_empty() {
            return;
        }
        let bus = state.bus;
        state.sender = sender;
        if self.framed(bus).is_some() {
            self.queue(client, bytes, CharFlags::default());
        } else {
            self.queue_disturbed(client, bytes);
        }
        self.serve(bus);
    }

    /// Sets the serial settings with which the port of a client receives; by default it has those of the line.
    /// With other settings it reads other characters, as a serial port does. See [`send_from`](Self::send_from)
    /// for the settings with which it sends.
    pub fn set_receiver(&mut self, client: Client, receiver: Sender) {
        if let Some(state) = self.clients.get_mut(&client.0) {
            state.receiver = receiver;
        }
    }

    /// Drops the bytes that a client has sent and that are not on its line yet, as if it had not sent them.
    pub fn drop_backlog(&mut self, client: Client) {
        let Some(state) = self.clients.get_mut(&client.0) else { return };
        let bus = state.bus;
        state.take(state.backlog());
        self.serve(bus);
    }

    /// Queues bytes of a client for the line.
    pub(super) fn queue(&mut self, client: Client, bytes: &[u8], flags: CharFlags) {
        if let Some(state) = self.clients.get_mut(&client.0) {
            self.arrivals += 1;
            state.arrive(self.now, self.now.max(self.arrived_by), self.arrivals, bytes, flags);
        }
    }

    /// Number of bytes of a client that are not on the line yet, or on a TCP connection not delivered to the
    /// drive yet. If a host reads from a client only while this number is small, the host slows down clients
    /// that send faster than the line, or that do not read their answers.
    #[must_use]
    pub fn backlog(&self, client: Client) -> usize {
        let on_a_line = self.clients.get(&client.0).map(ClientState::backlog);
        on_a_line.unwrap_or_else(|| self.connections.backlog(client.0))
    }

    /// Appends the characters that have reached a client by now to `into`. Returns their number.
    pub fn receive(&mut self, client: Client, into: &mut Vec<u8>) -> usize {
        if self.connections.has(client.0) {
            return self.receive_messages(client.0, into);
        }
        self.clients.receive(client.0, self.now, into)
    }

    /// Clients that can read a character now, or whose connection was closed.
    pub fn readable(&self) -> impl Iterator<Item = Client> {
        self.clients.readable(self.now).chain(self.connections.readable()).map(Client)
    }

    /// Sets that the port of a client times characters itself, as a real serial port does. A drive's reply is
    /// then delivered as a whole when its first character begins.
    pub fn set_self_paced(&mut self, client: Client) {
        if let Some(state) = self.clients.get_mut(&client.0) {
            state.paces_itself = true;
        }
    }

    /// Sets that a client on a line receives only answers to its own requests. Others also hear what drives send to
    /// other clients.
    pub fn set_hears_own_answers_only(&mut self, client: Client) {
        if let Some(state) = self.clients.get_mut(&client.0) {
            state.hears_own_answers_only = true;
        }
    }

    /// Runs until a client can read a byte or its connection is closed, but not beyond `until`.
    pub fn run_until_readable(&mut self, client: Client, until: Instant) {
        loop {
            let due = self.clients.due_of(client.0);
            let is_ready = due <= self.now || self.connections.is_readable(client.0);
            if is_ready || self.now >= until {
                return;
            }
            self.run_until(self.next_event().min(due).min(until));
        }
    }

    /// Runs until the bytes that a client has sent are transmitted, but not beyond `until`.
    pub fn run_until_transmitted(&mut self, client: Client, until: Instant) {
        while self.backlog(client) > 0 && self.now < until {
            self.run_until(self.next_event().min(until));
        }
        if let Some(state) = self.clients.get(&client.0) {
            // The last characters are on their way to the drives.
            let free = self.buses[state.bus as usize].free;
            self.run_until(free.min(until));
        }
    }

    /// Sends a whole frame to the first port of a drive, [runs until the bench is
    /// idle](Self::run_until_idle), and returns the reply, or nothing if there is none. If the frame could be
    /// the beginning of a longer one, the bench treats it as complete.
    pub fn ask(&mut self, drive: DriveId, frame: &[u8]) -> Vec<u8> {
        self.ask_at(drive, Port(0), frame)
    }

    /// Like [`ask`](Self::ask), at a port of the drive.
    pub fn ask_at(&mut self, drive: DriveId, port: Port, frame: &[u8]) -> Vec<u8> {
        let mut reply = Vec::new();
        if let Ok(client) = self.connect_to(drive, port) {
            self.send(client, frame);
            let idle_run = self.begin_idle_run_flushing();
            self.continue_idle_run(idle_run, Instant::NEVER);
            self.receive(client, &mut reply);
            self.disconnect(client);
        }
        reply
    }

    /// Removes a client.
    pub(super) fn forget(&mut self, id: u32) {
        if let Some(state) = self.clients.remove(&id) {
            self.buses[state.bus as usize].clients.retain(|&other| other != id);
        }
    }
}
