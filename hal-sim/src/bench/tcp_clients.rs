//! TCP ports of drives: connections and messages.
//!
//! A message takes no time: a drive receives it when its last byte arrives, and the answer is available at
//! once. A drive receives the messages of one connection one after the other, and serves several connections
//! in turn. While a client has unread answers above a limit, its further messages wait, which bounds the
//! memory for answers. While a drive does not [take](drivetwin_firmware::device::Device::takes) messages, all
//! clients wait.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use drivetwin_firmware::device::{Duration, Link, Port, PortSpec};
use drivetwin_protocol::modbus::tcp::{self, Broken, Splitter};
use drivetwin_protocol::text::next_line;

use super::events::EventKind;
use super::tcp_faults::{DisturbedStream, ends_line};
use super::{Bench, Bus, Client, DriveId};
use crate::line::ClientState;
use crate::line::faults::Disturbance;
use crate::record::capture::{Frame, Medium, Source};
use crate::record::journal::NoMessage;
use crate::record::trace::InputRecord;
use crate::scheduler::Phase;
use crate::slot::{MOST_CONNECTIONS, Tcp, TcpSend};

/// Buffer capacity in bytes that a connection keeps when its buffer is empty.
const KEPT_BYTES: usize = 1 << 10;

/// Bytes of unread answers above which the messages of a client wait.
const UNREAD_BYTES: usize = 4 << 10;

/// A line or TCP port that a client connects to.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Outlet {
    /// A serial line.
    Line(Bus),
    /// A TCP port of a drive.
    Tcp(DriveId, Port),
}

impl From<Bus> for Outlet {
    fn from(bus: Bus) -> Self {
        Self::Line(bus)
    }
}

/// Reason why a TCP port refuses a connection.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ConnectError {
    /// The drive has no power.
    NoPower,
    /// The drive does not accept connections yet.
    Booting,
    /// The port has its maximum number of connections.
    Full,
}

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPower => f.write_str("the drive has no power"),
            Self::Booting => f.write_str("the drive is starting"),
            Self::Full => write!(f, "the port has its maximum of {MOST_CONNECTIONS} connections"),
        }
    }
}

impl std::error::Error for ConnectError {}

/// Reason why the connection of a client was closed, returned by [`Bench::ended`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ended {
    /// The drive closed the connection.
    ByDrive,
    /// The drive lost its power.
    NoPower,
    /// The client sent bytes that are not Modbus/TCP.
    Broken(Broken),
    /// A fault of the port changed a request so that it is not Modbus/TCP.
    BrokenByFault(Broken),
    /// A fault of the port closed the connection in the middle of a message.
    ByFault,
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ByDrive => f.write_str("the drive closes the connection"),
            Self::NoPower => f.write_str("the drive has lost its power"),
            Self::Broken(broken) => write!(f, "it has sent {broken}"),
            Self::BrokenByFault(broken) => write!(f, "a fault has turned a request into {broken}"),
            Self::ByFault => f.write_str("a fault closes the connection"),
        }
    }
}

/// A client on a TCP connection.
pub(super) struct Connection {
    pub(super) drive: DriveId,
    pub(super) port: Port,
    pub(super) link: Link,
    /// Splitter of requests, on a Modbus/TCP port.
    pub(super) splitter: Option<Splitter>,
    /// Bytes of the client that are not scheduled for delivery to the drive yet.
    pub(super) pending: Vec<u8>,
    /// State of the faults of the port on this connection.
    pub(super) disturbed: DisturbedStream,
    /// Number of inputs of the client that are scheduled for delivery to the drive.
    scheduled: usize,
    /// Bytes from the drive that the client has not received.
    pub(super) inbox: Vec<u8>,
    /// True while the host cannot forward the bytes that the client received.
    held_back: bool,
    /// True if the client has left. Only its earlier input is still delivered.
    pub(super) has_left: bool,
    pub(super) ended: Option<Ended>,
}

impl Connection {
    /// Returns true if the client reads its answers, or has left.
    pub(super) fn reads(&self) -> bool {
        let unread = self.inbox.len() + self.disturbed.late_bytes;
        self.has_left || (!self.held_back && unread < UNREAD_BYTES)
    }

    /// Returns true if all bytes of the client are scheduled for delivery to the drive.
    fn is_drained(&self) -> bool {
        self.pending.is_empty() && self.disturbed.passed.is_empty()
    }

    /// The bytes at which the stream to the drive is no longer Modbus/TCP.
    fn broken_bytes(&self) -> Vec<u8> {
        let DisturbedStream { splitter, passed, .. } = &self.disturbed;
        [(&self.splitter, &self.pending), (splitter, passed)]
            .into_iter()
            .filter_map(|(splitter, rest)| Some([splitter.as_ref()?.broken()?, rest].concat()))
            .next()
            .unwrap_or_default()
    }

    /// Puts a message back in front of the bytes from which it was taken.
    fn put_back(&mut self, mut bytes: Vec<u8>, disturbed: bool) {
        let front = if disturbed { &mut self.disturbed.passed } else { &mut self.pending };
        bytes.append(front);
        *front = bytes;
    }

    /// The next complete message of the client, if there is one.
    pub(super) fn next(&mut self) -> Result<Option<Vec<u8>>, Broken> {
        split_off(&mut self.splitter, &mut self.pending)
    }
}

/// Removes the next message from the front of `bytes`: a Modbus/TCP frame, or a part of a line if there is no
/// splitter.
pub(super) fn split_off(
    splitter: &mut Option<Splitter>,
    bytes: &mut Vec<u8>,
) -> Result<Option<Vec<u8>>, Broken> {
    let mut rest = bytes.as_slice();
    let message = match splitter {
        Some(splitter) => splitter.next(&mut rest).map(|message| message.map(<[u8]>::to_vec)),
        None => Ok(next_line(&mut rest).map(<[u8]>::to_vec)),
    };
    let taken = bytes.len() - rest.len();
    bytes.drain(..taken);
    let message = message?;
    if bytes.is_empty() {
        bytes.shrink_to(KEPT_BYTES);
    }
    Ok(message)
}

/// All clients on TCP connections.
#[derive(Default)]
pub(super) struct Connections {
    pub(super) all: BTreeMap<u32, Connection>,
    /// Clients that have bytes to read or whose connection was closed.
    pub(super) readable: BTreeSet<u32>,
    /// Faults of ports that have had a client or faults.
    pub(super) disturbances: BTreeMap<(DriveId, Port), Disturbance>,
}

impl Connections {
    pub(super) fn has(&self, client: u32) -> bool {
        self.all.contains_key(&client)
    }

    /// Clients that have bytes to read or whose connection was closed.
    pub(super) fn readable(&self) -> impl Iterator<Item = u32> {
        self.readable.iter().copied()
    }

    /// Returns true if a client has bytes to read, or its connection was closed.
    pub(super) fn is_readable(&self, client: u32) -> bool {
        self.readable.contains(&client)
    }

    /// Returns true if the connection of a client is open.
    fn is_open(&self, client: u32) -> bool {
        self.all.get(&client).is_some_and(|connection| connection.ended.is_none() && !connection.has_left)
    }

    /// Number of bytes of a client that are not delivered yet.
    pub(super) fn backlog(&self, client: u32) -> usize {
        self.all.get(&client).map_or(0, |connection| connection.pending.len())
    }

    /// Marks a connection as closed.
    pub(super) fn end(&mut self, client: u32, ended: Ended) {
        if let Some(connection) = self.all.get_mut(&client) {
            connection.ended.get_or_insert(ended);
            connection.pending = Vec::new();
            connection.disturbed.passed = Vec::new();
            connection.disturbed.reply = None;
            if connection.has_left {
                self.forget(client);
            } else {
                self.readable.insert(client);
            }
        }
    }

    /// Removes a client.
    fn forget(&mut self, client: u32) {
        self.all.remove(&client);
        self.readable.remove(&client);
    }
}

/// TCP ports.
impl Bench {
    /// Outlet of a drive's port: its line or TCP port.
    #[must_use]
    pub fn outlet(&self, drive: DriveId, port: Port) -> Outlet {
        self.bus(drive, port).map_or(Outlet::Tcp(drive, port), Outlet::Line)
    }

    /// All lines with a drive, in the order of [`buses`](Self::buses), then all TCP ports, sorted by the names of
    /// their drives.
    #[must_use]
    pub fn outlets(&self) -> Vec<Outlet> {
        let mut slots: Vec<DriveId> = self.drives().collect();
        slots.sort_by_key(|&drive| self.name(drive));
        let ports = slots.into_iter().flat_map(|drive| {
            let ports = (0..).map(Port).zip(self.spec(drive).ports);
            ports.filter(|(_, port)| port.is_tcp()).map(move |(port, _)| Outlet::Tcp(drive, port))
        });
        self.buses().into_iter().map(Outlet::Line).chain(ports).collect()
    }

    /// The name of an outlet: the name of the [line](Self::bus_name) or of the TCP port, for instance
    /// `modbus`; on a bench of several drives `x.modbus`.
    #[must_use]
    pub fn outlet_name(&self, outlet: Outlet) -> String {
        match outlet {
            Outlet::Line(bus) => self.bus_name(bus).to_owned(),
            Outlet::Tcp(drive, port) => {
                let name = self.spec(drive).ports.get(usize::from(port.0)).map_or("", |port| port.name);
                if self.slots.len() == 1 { name.to_owned() } else { format!("{}.{name}", self.name(drive)) }
            }
        }
    }

    /// The drives on a line, sorted by name, or the drive with a TCP port.
    #[must_use]
    pub fn drives_at(&self, outlet: Outlet) -> Vec<DriveId> {
        match outlet {
            Outlet::Line(bus) => self.ports(bus).iter().map(|&(drive, _)| drive).collect(),
            Outlet::Tcp(drive, _) => vec![drive],
        }
    }

    /// Description of the first port on a line, or of a TCP port.
    #[must_use]
    pub fn port_at(&self, outlet: Outlet) -> Option<&'static PortSpec> {
        let (drive, port) = match outlet {
            Outlet::Line(bus) => *self.ports(bus).first()?,
            Outlet::Tcp(drive, port) => (drive, port),
        };
        self.spec(drive).ports.get(usize::from(port.0))
    }

    /// The line or TCP port with the name `name`. `name` may leave out the drive of a port, provided that no other
    /// port has the same name.
    #[must_use]
    pub fn find_outlet(&self, name: &str) -> Option<Outlet> {
        let line = self.find_bus(name).map(Outlet::Line);
        let port = |outlet: &Outlet| match *outlet {
            Outlet::Line(_) => None,
            Outlet::Tcp(drive, port) => {
                let port = self.spec(drive).ports.get(usize::from(port.0))?.name;
                Some((self.name(drive), port))
            }
        };
        let outlets = self.outlets();
        let ports = || outlets.iter().filter_map(|outlet| Some((*outlet, port(outlet)?)));
        line.or_else(|| match name.split_once('.') {
            Some(whole) => ports().find(|(_, port)| *port == whole).map(|(outlet, _)| outlet),
            None => {
                let mut alike = ports().filter(|(_, (_, port))| *port == name);
                alike.next().filter(|_| alike.next().is_none()).map(|(outlet, _)| outlet)
            }
        })
    }

    /// Connects a client to a port of a drive: to its TCP port, or to the line of its serial port.
    ///
    /// # Errors
    /// The TCP port refuses connections now. A line never refuses.
    ///
    /// # Panics
    /// If the drive has no such port.
    pub fn connect_to(&mut self, drive: DriveId, port: Port) -> Result<Client, ConnectError> {
        self.join(self.outlet(drive, port))
    }

    /// Returns true if an outlet accepts connections. The TCP port of a drive that is starting does not. If
    /// power is off the result is true, because [`join`](Self::join) refuses at once and nobody has to wait.
    #[must_use]
    pub fn accepts(&self, outlet: Outlet) -> bool {
        match outlet {
            Outlet::Line(_) => true,
            Outlet::Tcp(drive, port) => !self.powered(drive) || self.at(drive).accepts(port),
        }
    }

    /// Connects a client to an outlet.
    ///
    /// # Errors
    /// As [`connect_to`](Self::connect_to).
    ///
    /// # Panics
    /// If there is no such port.
    pub fn join(&mut self, outlet: Outlet) -> Result<Client, ConnectError> {
        let (drive, port) = match outlet {
            Outlet::Line(bus) => return Ok(self.connect(bus)),
            Outlet::Tcp(drive, port) => (drive, port),
        };
        if !self.powered(drive) {
            return Err(ConnectError::NoPower);
        }
        if !self.accepts(outlet) {
            return Err(ConnectError::Booting);
        }
        let client = self.new_client();
        let tcp = self.at_mut(drive).state.tcp(port).expect("the device has such a port");
        let link = tcp.connect(client).ok_or(ConnectError::Full)?;
        let splitter = tcp.framed.then(Splitter::new);
        let disturbed = DisturbedStream::new(tcp.framed);
        let (pending, inbox) = (Vec::new(), Vec::new());
        let connection = Connection {
            drive,
            port,
            link,
            splitter,
            pending,
            disturbed,
            scheduled: 0,
            inbox,
            held_back: false,
            has_left: false,
            ended: None,
        };
        self.connections.all.insert(client, connection);
        self.schedule_tcp_input(client, drive, InputRecord::Opened { port, link });
        Ok(Client(client))
    }

    /// Reason why the connection of a client is closed; `None` if it is open, or on a line. Bytes that the drive sent
    /// before can still be [received](Self::receive).
    #[must_use]
    pub fn ended(&self, client: Client) -> Option<Ended> {
        self.connections.all.get(&client.0).and_then(|connection| connection.ended)
    }

    /// Returns true if all input of a client is executed, and on a line also answered.
    #[must_use]
    pub fn is_served(&self, client: Client) -> bool {
        match (self.connections.all.get(&client.0), self.clients.get(&client.0)) {
            (Some(connection), _) => {
                let Connection { drive, port, .. } = *connection;
                let tcp =
                    self.at(drive).state.ports.get(usize::from(port.0)).and_then(|port| port.tcp.as_ref());
                let executed = tcp.is_none_or(|tcp| tcp.busy_with != Some(Some(client.0)));
                let answered = executed && connection.disturbed.late == 0;
                answered && connection.scheduled == 0 && connection.is_drained()
            }
            (None, Some(state)) => self.is_answered(Bus(state.bus)),
            (None, None) => true,
        }
    }

    /// Returns true if bytes of a client wait, or are executed or answered now; answers to other clients on the line do not
    /// count.
    #[must_use]
    pub fn is_being_served(&self, client: Client) -> bool {
        let has_turn = |state: &ClientState| {
            let line = &self.buses[state.bus as usize];
            line.served == client.0 && line.turn.is_busy()
        };
        self.backlog(client) > 0
            || self.clients.get(&client.0).map_or_else(|| !self.is_served(client), has_turn)
    }

    /// Returns true if input of a client on a TCP connection is scheduled for delivery to the drive.
    #[must_use]
    pub fn is_under_way(&self, client: Client) -> bool {
        self.connections.all.get(&client.0).is_some_and(|connection| connection.scheduled > 0)
    }

    /// Sets whether the host is unable to forward the bytes that a client [receives](Self::receive). While
    /// this is true, further messages of a client on a TCP connection wait. On a line this has no effect.
    pub fn hold_back(&mut self, client: Client, held_back: bool) {
        if let Some(connection) = self.connections.all.get_mut(&client.0)
            && std::mem::replace(&mut connection.held_back, held_back) != held_back
        {
            self.resume_client(client.0);
        }
    }

    /// Number of clients that are connected to a TCP port of a drive now.
    #[must_use]
    pub fn connections(&self, drive: DriveId, port: Port) -> usize {
        let port = self.at(drive).state.ports.get(usize::from(port.0));
        port.and_then(|port| port.tcp.as_ref()).map_or(0, |tcp| tcp.connected())
    }

    /// Handles bytes that a client on a TCP connection sends now.
    pub(super) fn send_messages(&mut self, client: u32, bytes: &[u8]) {
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.ended.is_none() {
            connection.pending.extend_from_slice(bytes);
            self.resume_client(client);
        }
    }

    /// Appends the bytes that the drive sent to a client on a TCP connection to `into`. Returns their number.
    pub(super) fn receive_messages(&mut self, client: u32, into: &mut Vec<u8>) -> usize {
        let Some(connection) = self.connections.all.get_mut(&client) else { return 0 };
        self.connections.readable.remove(&client);
        let count = connection.inbox.len();
        into.append(&mut connection.inbox);
        connection.inbox.shrink_to(KEPT_BYTES);
        self.resume_client(client);
        count
    }

    /// Schedules the next message of a client if the drive has received all earlier ones and takes more, and
    /// the client reads its answers. If the client has left, schedules the end of the connection after its
    /// last message.
    pub(super) fn resume_client(&mut self, client: u32) {
        let Some(connection) = self.connections.all.get(&client) else { return };
        let Connection { drive, port, has_left, .. } = *connection;
        if connection.scheduled > 0 || !connection.reads() {
            return;
        }
        let has_more = has_left || (connection.ended.is_none() && !connection.is_drained());
        if !has_more {
            return;
        }
        let tcp = self.at_mut(drive).state.tcp(port);
        match tcp.filter(|tcp| tcp.busy_with.is_some()) {
            Some(tcp) => tcp.enqueue(client),
            None => {
                if !self.schedule_next_message(client) && has_left {
                    self.close_connection(client);
                    self.connections.forget(client);
                }
            }
        }
    }

    /// After a call of a drive, updates which of its TCP ports take messages, and resumes the clients of
    /// ports that do so again.
    pub(super) fn update_tcp_busy(&mut self, index: u32) {
        for number in 0..self.slots[index as usize].state.ports.len() {
            let port = Port(number as u8);
            let slot = &mut self.slots[index as usize];
            if slot.state.tcp(port).is_none() {
                continue;
            }
            let takes = slot.takes(port);
            if takes {
                self.end_text_replies(DriveId(index), port);
            }
            let slot = &mut self.slots[index as usize];
            let Some(tcp) = slot.state.tcp(port) else { continue };
            match (takes, tcp.busy_with) {
                (false, None) => {
                    tcp.busy_with = Some(tcp.last_served);
                    self.busy += 1;
                }
                (true, Some(_)) => {
                    tcp.busy_with = None;
                    self.busy -= 1;
                    self.release(index, port);
                }
                _ => {}
            }
        }
    }

    /// Resumes the client that has waited longest, if the drive takes messages.
    fn release(&mut self, index: u32, port: Port) {
        while let Some(client) = self.slots[index as usize].state.tcp(port).and_then(Tcp::next_waiting) {
            self.resume_client(client);
            if self.connections.all.get(&client).is_some_and(|connection| connection.scheduled > 0) {
                break;
            }
        }
    }

    /// Schedules the next message of a client. Returns true if there is one.
    fn schedule_next_message(&mut self, client: u32) -> bool {
        let connection = self.connections.all.get(&client);
        let Some(connection) = connection.filter(|connection| connection.ended.is_none()) else {
            return false;
        };
        let &Connection { drive, port, link, .. } = connection;
        match self.next_disturbed(client) {
            Ok(Some(bytes)) => {
                self.schedule_tcp_input(client, drive, InputRecord::Message { port, link, bytes });
                true
            }
            Ok(None) => false,
            Err(ended) => {
                if let Ended::Broken(_) | Ended::BrokenByFault(_) = ended {
                    self.at_mut(drive).state.ports[usize::from(port.0)].statistics.broken += 1;
                }
                self.break_off(client, ended);
                self.close_connection(client);
                match ended {
                    Ended::ByFault => self.end_from_drive(client, ended),
                    _ => self.connections.end(client, ended),
                }
                false
            }
        }
    }

    /// Records the bytes of a client that are not Modbus/TCP.
    fn break_off(&mut self, client: u32, ended: Ended) {
        let Some(connection) = self.connections.all.get(&client) else { return };
        let &Connection { drive, port, link, .. } = connection;
        let why = match ended {
            Ended::Broken(why) => why,
            // The request that a fault itself changed has an entry already.
            Ended::BrokenByFault(why) if !connection.disturbed.has_changed => why,
            _ => return,
        };
        let bytes = connection.broken_bytes();
        self.record_message((drive, port, link), Source::Client, &bytes);
        self.enter_broken(drive, port, &bytes, NoMessage::Header(why));
    }

    /// Disconnects a client from a TCP port. If the client has not read its answers, none of its pending
    /// input is delivered.
    pub(super) fn disconnect_tcp(&mut self, client: u32) {
        self.connections.readable.remove(&client);
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.ended.is_some() {
            return self.connections.forget(client);
        }
        if !connection.reads() {
            connection.pending.clear();
            connection.disturbed.passed.clear();
        }
        connection.has_left = true;
        // Modbus requests take no time, so the drive receives all of them now. Lines of text wait for each
        // other.
        if connection.splitter.is_some() {
            while self.schedule_next_message(client) {}
            self.cut_short(client);
            self.close_connection(client);
            self.connections.forget(client);
        } else {
            self.resume_client(client);
        }
    }

    /// Records the first part of a request that a client leaves incomplete.
    fn cut_short(&mut self, client: u32) {
        let Some(connection) = self.connections.all.get(&client) else { return };
        let &Connection { drive, port, link, .. } = connection;
        let part = connection.splitter.as_ref().map_or(&[][..], Splitter::partial).to_vec();
        if connection.ended.is_none() && !part.is_empty() {
            self.record_message((drive, port, link), Source::Client, &part);
            self.enter_broken(drive, port, &part, NoMessage::Disconnected);
        }
    }

    /// Schedules the end of a connection for the drive, unless the drive has closed the connection itself.
    pub(super) fn close_connection(&mut self, client: u32) {
        let Some(&Connection { drive, port, link, .. }) = self.connections.all.get(&client) else { return };
        if self.at_mut(drive).state.tcp(port).is_some_and(|tcp| tcp.leave(link, client)) {
            self.schedule_tcp_input(client, drive, InputRecord::Closed { port, link });
        }
    }

    /// Schedules an input of a client for the drive, at the earliest possible instant.
    fn schedule_tcp_input(&mut self, client: u32, drive: DriveId, input: InputRecord) {
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.scheduled += 1;
        }
        self.busy += 1;
        let at = self.at(drive).free(self.now, Phase::Line);
        self.schedule(at, Phase::Line, drive.0, EventKind::TcpInput { client, input });
    }

    /// Delivers an input of a client to the drive, and schedules the next one.
    pub(super) fn tcp_input_arrives(&mut self, index: u32, client: u32, input: &InputRecord) {
        self.busy -= 1;
        let (InputRecord::Opened { port, .. }
        | InputRecord::Message { port, .. }
        | InputRecord::Closed { port, .. }) = *input
        else {
            return;
        };
        let Some(tcp) = self.slots[index as usize].state.tcp(port) else { return };
        let takes = tcp.busy_with.is_none();
        tcp.last_served = if takes { Some(client) } else { tcp.last_served };
        let disturbed = self.is_disturbed(client);
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.scheduled -= 1;
            // A message of another client at the same instant was delivered first, so this message has to
            // wait.
            if let (false, InputRecord::Message { bytes, .. }) = (takes, input) {
                connection.put_back(bytes.clone(), disturbed);
            }
        }
        if takes || !matches!(input, InputRecord::Message { .. }) {
            self.deliver_if_open(index, client, input);
        }
        self.resume_client(client);
        self.release(index, port);
    }

    /// Delivers an input of a client to the drive, unless the connection has been closed in the meantime.
    fn deliver_if_open(&mut self, index: u32, client: u32, input: &InputRecord) {
        let (InputRecord::Opened { port, link }
        | InputRecord::Message { port, link, .. }
        | InputRecord::Closed { port, link }) = *input
        else {
            return;
        };
        let Some(state) = self.slots[index as usize].state.ports.get_mut(usize::from(port.0)) else { return };
        let (Some(tcp), statistics) = (&mut state.tcp, &mut state.statistics) else { return };
        let at = (DriveId(index), port, link);
        match input {
            InputRecord::Opened { .. } if tcp.report_opened(link, client) => statistics.connections += 1,
            InputRecord::Closed { .. } if tcp.report_closed(link, client) => {
                // A fault that closes a connection keeps it until the client has left.
                if !self.connections.has(client) {
                    self.enter_unfinished(DriveId(index), port, link);
                }
                self.record_message(at, Source::Client, &[]);
            }
            InputRecord::Message { bytes, .. } if tcp.known(link) == Some(client) => {
                statistics.messages += 1;
                self.record_message(at, Source::Client, bytes);
            }
            _ => return,
        }
        self.note_disturbed(index, client, input);
        self.deliver(index, input);
    }

    /// Notes the effects of faults on a message that a drive receives now, for the entry of the message. Parts of a
    /// line have one entry.
    fn note_disturbed(&mut self, index: u32, client: u32, input: &InputRecord) {
        let InputRecord::Message { port, bytes, .. } = input else { return };
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.splitter.is_some() || ends_line(bytes) {
            let stream = &mut connection.disturbed;
            let effects = std::mem::replace(&mut stream.on_requests, std::mem::take(&mut stream.on_copy));
            if let Some(port) = self.slots[index as usize].state.ports.get_mut(usize::from(port.0)) {
                port.on_request = effects;
            }
        }
    }

    /// Delivers a message of a drive to its client, or closes the connection.
    pub(super) fn receive_from_drive(&mut self, send: &TcpSend, bytes: &[u8]) {
        let TcpSend { client, count, .. } = *send;
        match count {
            Some(_) if bytes.is_empty() => {}
            Some(_) => self.reply_to_client(client, bytes),
            None => self.end_after_replies(client, Ended::ByDrive),
        }
    }

    /// Delivers a part of the stream from a drive to its client now.
    pub(super) fn deliver_to_client(&mut self, client: u32, from: Source, bytes: &[u8]) {
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.ended == Some(Ended::ByFault) {
            return;
        }
        let at = (connection.drive, connection.port, connection.link);
        let is_reply = connection.splitter.is_some() && matches!(from, Source::Drive(_));
        if !connection.has_left {
            connection.inbox.extend_from_slice(bytes);
            self.connections.readable.insert(client);
        }
        if is_reply {
            self.note_answer(client, bytes);
        }
        self.record_message(at, from, bytes);
    }

    /// Ends a connection from the side of its drive now.
    pub(super) fn end_from_drive(&mut self, client: u32, ended: Ended) {
        let Some(&Connection { drive, port, link, .. }) = self.connections.all.get(&client) else { return };
        self.connections.end(client, ended);
        self.record_message((drive, port, link), Source::Drive(drive), &[]);
    }

    /// Closes all connections of a drive whose power is off.
    pub(super) fn lose_connections(&mut self, index: u32) {
        let ports = self.slots[index as usize].state.ports.iter_mut();
        let clients: Vec<u32> =
            ports.filter_map(|port| port.tcp.as_deref_mut()).flat_map(Tcp::close_all).collect();
        for client in clients {
            self.connections.end(client, Ended::NoPower);
            if let Some(connection) = self.connections.all.get_mut(&client) {
                let Connection { drive, port, link, .. } = *connection;
                let lost = std::mem::take(&mut connection.disturbed.late_entries);
                self.note_lost_replies(drive, lost.into_iter().flatten());
                self.record_message((drive, port, link), Source::Drive(drive), &[]);
            }
        }
    }

    /// Notes a request of a client on a Modbus/TCP port, for statistics. A request repeats the one before it also if its
    /// transaction is another one, or if the client has connected anew.
    pub(super) fn note_request(&mut self, client: u32, bytes: &[u8]) {
        let Some(&Connection { drive, port, .. }) = self.connections.all.get(&client) else { return };
        let Some((header, _)) = tcp::parse(bytes) else { return };
        let connections = &self.connections;
        let Some(tcp) = self.slots[drive.0 as usize].state.tcp(port) else { return };
        // Other clients may ask the same.
        if tcp.asked.is_some_and(|(other, _)| other != client && connections.is_open(other)) {
            tcp.requests.answer();
        }
        // From the unit on.
        tcp.requests.request(&bytes[tcp::HEADER_BYTES - 1..]);
        tcp.asked = Some((client, header.transaction));
    }

    /// Notes a reply to a client on a Modbus/TCP port, for statistics.
    fn note_answer(&mut self, client: u32, bytes: &[u8]) {
        let Some(&Connection { drive, port, .. }) = self.connections.all.get(&client) else { return };
        let Some((header, _)) = tcp::parse(bytes) else { return };
        let Some(tcp) = self.slots[drive.0 as usize].state.tcp(port) else { return };
        let is_own = tcp.asked == Some((client, header.transaction));
        if is_own && tcp.requests.address() == Some(&[header.unit]) {
            tcp.requests.answer();
        }
    }

    /// Records a message on a connection; a message without bytes is the end of the connection.
    pub(super) fn record_message(
        &mut self,
        (drive, port, link): (DriveId, Port, Link),
        from: Source,
        bytes: &[u8],
    ) {
        let at = self.now;
        self.capture.record(|| Frame {
            at,
            lasts: Duration::ZERO,
            on: Medium::Tcp(drive, port, link),
            from,
            line: None,
            bytes: bytes.to_vec(),
            collided: false,
            received: Vec::new(),
        });
    }
}
