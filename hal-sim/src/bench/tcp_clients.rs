//! TCP ports of drives: who connects to them, what goes back and forth.
//!
//! A message takes no time, and a drive hears it at the instant at which its last byte came, and what it answers then
//! is there at once. It hears one message of a connection after the other, and those of several in turns. Of a client
//! that leaves its answers unread it hears no more until they are taken, so that there are never many of them. While a
//! drive [takes](drivetwin_firmware::device::Device::takes) nothing all of them wait.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use drivetwin_firmware::device::{Duration, Link, Port};
use drivetwin_protocol::modbus::tcp::{Broken, Splitter};
use drivetwin_protocol::text::next_line;

use super::events::EventKind;
use super::{Bench, Bus, Client, DriveId};
use crate::record::capture::{Frame, Medium, Source};
use crate::record::trace::InputRecord;
use crate::scheduler::Phase;
use crate::slot::{MOST_CONNECTIONS, Tcp, TcpSend};

/// Room that a connection keeps when all is read.
const KEPT_BYTES: usize = 1 << 10;

/// Bytes of answers that a client may leave unread before the drive hears no more of it.
const UNREAD_BYTES: usize = 4 << 10;

/// A line or TCP port that a client connects to.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Outlet {
    /// A serial line.
    Line(Bus),
    /// A TCP port of a drive.
    Tcp(DriveId, Port),
}

/// Reason why a TCP port refuses a connection.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TurnedAway {
    /// The drive has no power.
    NoPower,
    /// The drive does not accept connections yet.
    Booting,
    /// As many are there as a port takes.
    Full,
}

impl fmt::Display for TurnedAway {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPower => f.write_str("the drive has no power"),
            Self::Booting => f.write_str("the drive boots"),
            Self::Full => write!(f, "{MOST_CONNECTIONS} are there"),
        }
    }
}

impl std::error::Error for TurnedAway {}

/// Reason why a connection is closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ended {
    /// The drive has closed it.
    ByDrive,
    /// The drive has lost its power.
    NoPower,
    /// The bytes were no Modbus/TCP.
    Broken(Broken),
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ByDrive => f.write_str("the drive closes the connection"),
            Self::NoPower => f.write_str("the drive has lost its power"),
            Self::Broken(broken) => write!(f, "it has sent {broken}"),
        }
    }
}

/// A client on a TCP connection.
struct Connection {
    seat: DriveId,
    port: Port,
    link: Link,
    /// Splitter of messages, on a port where the length in a header ends one.
    splitter: Option<Splitter>,
    /// Bytes of the client that are not on their way to the drive yet.
    unheard: Vec<u8>,
    /// Count of the client's inputs that are on their way there.
    under_way: usize,
    /// Bytes of the drive that the client has not taken.
    inbox: Vec<u8>,
    /// True while what the client has taken is not read further on.
    held_back: bool,
    /// True if it is gone, and only what it has said before is still to be heard.
    is_gone: bool,
    ended: Option<Ended>,
}

impl Connection {
    /// Returns whether the client takes its answers.
    fn reads(&self) -> bool {
        self.is_gone || (!self.held_back && self.inbox.len() < UNREAD_BYTES)
    }

    /// Puts bytes of the client back, ahead of all else.
    fn put_back(&mut self, mut bytes: Vec<u8>) {
        bytes.append(&mut self.unheard);
        self.unheard = bytes;
    }

    /// The next message of what it has said.
    fn next(&mut self) -> Result<Option<InputRecord>, Broken> {
        let (port, link) = (self.port, self.link);
        let mut rest = self.unheard.as_slice();
        let bytes = match &mut self.splitter {
            Some(splitter) => splitter.next(&mut rest)?.map(<[u8]>::to_vec),
            None => next_line(&mut rest).map(<[u8]>::to_vec),
        };
        let taken = self.unheard.len() - rest.len();
        self.unheard.drain(..taken);
        if self.unheard.is_empty() {
            self.unheard.shrink_to(KEPT_BYTES);
        }
        Ok(bytes.map(|bytes| InputRecord::Message { port, link, bytes }))
    }
}

/// Everybody outside who is on a TCP connection.
#[derive(Default)]
pub(super) struct Connections {
    all: BTreeMap<u32, Connection>,
    /// For whom there is something to read, or an end.
    audible: BTreeSet<u32>,
}

impl Connections {
    pub(super) fn has(&self, client: u32) -> bool {
        self.all.contains_key(&client)
    }

    /// Clients with bytes to read.
    pub(super) fn audible(&self) -> impl Iterator<Item = u32> {
        self.audible.iter().copied()
    }

    /// Bytes that somebody has said and that wait until he has read what is answered.
    pub(super) fn backlog(&self, client: u32) -> usize {
        self.all.get(&client).map_or(0, |connection| connection.unheard.len())
    }

    /// A connection has ended.
    fn end(&mut self, client: u32, ended: Ended) {
        if let Some(connection) = self.all.get_mut(&client) {
            connection.ended.get_or_insert(ended);
            connection.unheard = Vec::new();
            if connection.is_gone {
                self.forget(client);
            } else {
                self.audible.insert(client);
            }
        }
    }

    /// The client has gone.
    fn forget(&mut self, client: u32) {
        self.all.remove(&client);
        self.audible.remove(&client);
    }
}

/// TCP ports.
impl Bench {
    /// Outlet of a device's port: its line or TCP port.
    #[must_use]
    pub fn outlet(&self, seat: DriveId, port: Port) -> Outlet {
        self.bus(seat, port).map_or(Outlet::Tcp(seat, port), Outlet::Line)
    }

    /// All lines with a drive on them, as [`buses`](Self::buses) has them, then all TCP ports, by the names of their
    /// drives.
    #[must_use]
    pub fn outlets(&self) -> Vec<Outlet> {
        let mut seats: Vec<DriveId> = self.drives().collect();
        seats.sort_by_key(|&seat| self.name(seat));
        let ports = seats.into_iter().flat_map(|seat| {
            let ports = (0..).map(Port).zip(self.spec(seat).ports);
            ports.filter(|(_, port)| port.is_tcp()).map(move |(port, _)| Outlet::Tcp(seat, port))
        });
        self.buses().into_iter().map(Outlet::Line).chain(ports).collect()
    }

    /// The name of an outlet: that of the [line](Self::bus_name), or of the TCP port in the same way, `modbus` or
    /// where drives are several `x.modbus`.
    #[must_use]
    pub fn outlet_name(&self, outlet: Outlet) -> String {
        match outlet {
            Outlet::Line(bus) => self.bus_name(bus).to_owned(),
            Outlet::Tcp(seat, port) => {
                let name = self.spec(seat).ports.get(usize::from(port.0)).map_or("", |port| port.name);
                if self.seats.len() == 1 { name.to_owned() } else { format!("{}.{name}", self.name(seat)) }
            }
        }
    }

    /// Returns whether a TCP port has that name, with the name of its drive or without.
    #[must_use]
    pub fn has_tcp_port(&self, name: &str) -> bool {
        let (drive, port) = name.split_once('.').map_or((None, name), |(drive, port)| (Some(drive), port));
        let drives = self.seats.iter().filter(|seat| drive.is_none_or(|drive| drive == seat.name));
        drives.flat_map(|seat| seat.spec.ports).any(|of| of.is_tcp() && of.name == port)
    }

    /// Connects a client to a port of a device: to its TCP port, or to the line that its serial port is on.
    ///
    /// # Errors
    /// A TCP port lets nobody in now. A line always does.
    ///
    /// # Panics
    /// If the device has no such port.
    pub fn connect_to(&mut self, seat: DriveId, port: Port) -> Result<Client, TurnedAway> {
        self.join(self.outlet(seat, port))
    }

    /// Returns whether an outlet accepts connections: the TCP port of a drive that is starting does not. Without power
    /// it does, and closes each at once.
    #[must_use]
    pub fn accepts(&self, outlet: Outlet) -> bool {
        match outlet {
            Outlet::Line(_) => true,
            Outlet::Tcp(seat, port) => !self.powered(seat) || self.at(seat).accepts(port),
        }
    }

    /// Connects a client to an outlet.
    ///
    /// # Errors
    /// As [`connect_to`](Self::connect_to).
    ///
    /// # Panics
    /// If there is no such port.
    pub fn join(&mut self, outlet: Outlet) -> Result<Client, TurnedAway> {
        let (seat, port) = match outlet {
            Outlet::Line(bus) => return Ok(self.connect(bus)),
            Outlet::Tcp(seat, port) => (seat, port),
        };
        if !self.powered(seat) {
            return Err(TurnedAway::NoPower);
        }
        if !self.accepts(outlet) {
            return Err(TurnedAway::Booting);
        }
        let client = self.connected + 1;
        let tcp = self.at_mut(seat).body.tcp(port).expect("the device has such a port");
        let link = tcp.let_in(client).ok_or(TurnedAway::Full)?;
        let splitter = tcp.framed.then(Splitter::new);
        let (unheard, inbox) = (Vec::new(), Vec::new());
        self.connected = client;
        let connection = Connection {
            seat,
            port,
            link,
            splitter,
            unheard,
            under_way: 0,
            inbox,
            held_back: false,
            is_gone: false,
            ended: None,
        };
        self.connections.all.insert(client, connection);
        self.tell(client, seat, InputRecord::Opened { port, link });
        Ok(Client(client))
    }

    /// Reason why the connection of a client is closed; `None` if it is open, or on a line. Bytes that the drive sent
    /// before can still be [received](Self::receive).
    #[must_use]
    pub fn ended(&self, client: Client) -> Option<Ended> {
        self.connections.all.get(&client.0).and_then(|connection| connection.ended)
    }

    /// Returns whether everything from a client is received, and on a line answered.
    #[must_use]
    pub fn is_served(&self, client: Client) -> bool {
        match (self.connections.all.get(&client.0), self.clients.get(&client.0)) {
            (Some(connection), _) => {
                let Connection { seat, port, .. } = *connection;
                let tcp =
                    self.at(seat).body.ports.get(usize::from(port.0)).and_then(|port| port.tcp.as_ref());
                let executed = tcp.is_none_or(|tcp| tcp.busy_with != Some(Some(client.0)));
                executed && connection.under_way == 0 && connection.unheard.is_empty()
            }
            (None, Some(outside)) => self.is_answered(Bus(outside.bus)),
            (None, None) => true,
        }
    }

    /// Returns whether input of a client is on its way to a drive, on a TCP connection.
    #[must_use]
    pub fn is_under_way(&self, client: Client) -> bool {
        self.connections.all.get(&client.0).is_some_and(|connection| connection.under_way > 0)
    }

    /// Sets whether what a client [receives](Self::receive) is not read further on: meanwhile a drive gets no more of
    /// it on a TCP connection. Without effect on a line.
    pub fn hold_back(&mut self, client: Client, held_back: bool) {
        if let Some(connection) = self.connections.all.get_mut(&client.0)
            && std::mem::replace(&mut connection.held_back, held_back) != held_back
        {
            self.go_on(client.0);
        }
    }

    /// Number of clients that are connected to a TCP port now.
    #[must_use]
    pub fn connections(&self, seat: DriveId, port: Port) -> usize {
        let port = self.at(seat).body.ports.get(usize::from(port.0));
        port.and_then(|port| port.tcp.as_ref()).map_or(0, |tcp| tcp.connected())
    }

    /// Bytes of somebody on a TCP connection arrive now.
    pub(super) fn send_messages(&mut self, client: u32, bytes: &[u8]) {
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.ended.is_none() {
            connection.unheard.extend_from_slice(bytes);
            self.go_on(client);
        }
    }

    /// Appends what the drive has said to somebody on a TCP connection; how much.
    pub(super) fn receive_messages(&mut self, client: u32, into: &mut Vec<u8>) -> usize {
        let Some(connection) = self.connections.all.get_mut(&client) else { return 0 };
        self.connections.audible.remove(&client);
        let count = connection.inbox.len();
        into.append(&mut connection.inbox);
        connection.inbox.shrink_to(KEPT_BYTES);
        self.go_on(client);
        count
    }

    /// A drive is to hear the next that somebody on a connection has said, when it has heard all before it, takes more,
    /// and that is read which it has answered; behind the last that he has left, if he has.
    fn go_on(&mut self, client: u32) {
        let Some(connection) = self.connections.all.get(&client) else { return };
        let Connection { seat, port, is_gone, .. } = *connection;
        if connection.under_way > 0 || !connection.reads() {
            return;
        }
        let has_more = is_gone || (connection.ended.is_none() && !connection.unheard.is_empty());
        let tcp = self.at_mut(seat).body.tcp(port);
        match tcp.filter(|tcp| tcp.busy_with.is_some()) {
            Some(tcp) if has_more => tcp.hold(client),
            Some(_) => {}
            None => {
                if !self.tell_next(client) && is_gone {
                    self.hang_up(client);
                    self.connections.forget(client);
                }
            }
        }
    }

    /// After a device has been called: whether its TCP ports take more, and who goes on then.
    pub(super) fn note_taking(&mut self, place: u32) {
        for number in 0..self.seats[place as usize].body.ports.len() {
            let port = Port(number as u8);
            let seated = &mut self.seats[place as usize];
            if seated.body.tcp(port).is_none() {
                continue;
            }
            let takes = seated.takes(port);
            let Some(tcp) = seated.body.tcp(port) else { continue };
            match (takes, tcp.busy_with) {
                (false, None) => {
                    tcp.busy_with = Some(tcp.heard);
                    self.busy += 1;
                }
                (true, Some(_)) => {
                    tcp.busy_with = None;
                    self.busy -= 1;
                    self.release(place, port);
                }
                _ => {}
            }
        }
    }

    /// Whoever waits longest goes on, if the device takes more.
    fn release(&mut self, place: u32, port: Port) {
        while let Some(client) = self.seats[place as usize].body.tcp(port).and_then(Tcp::release) {
            self.go_on(client);
            if self.connections.all.get(&client).is_some_and(|connection| connection.under_way > 0) {
                break;
            }
        }
    }

    /// A drive is to hear the next that somebody on a connection has said; whether there is such.
    fn tell_next(&mut self, client: u32) -> bool {
        let connection = self.connections.all.get_mut(&client);
        let Some(connection) = connection.filter(|connection| connection.ended.is_none()) else {
            return false;
        };
        let (seat, port) = (connection.seat, connection.port);
        match connection.next() {
            Ok(Some(fed)) => {
                self.tell(client, seat, fed);
                true
            }
            Ok(None) => false,
            Err(broken) => {
                self.at_mut(seat).body.ports[usize::from(port.0)].statistics.broken += 1;
                self.hang_up(client);
                self.connections.end(client, Ended::Broken(broken));
                false
            }
        }
    }

    /// Disconnects a client from a TCP port. If it has not read its answers, no more of its input is delivered.
    pub(super) fn disconnect_tcp(&mut self, client: u32) {
        self.connections.audible.remove(&client);
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        if connection.ended.is_some() {
            return self.connections.forget(client);
        }
        if !connection.reads() {
            connection.unheard.clear();
        }
        connection.is_gone = true;
        // Requests have no time, so the drive hears all of them now. Of lines one waits for the other.
        if connection.splitter.is_some() {
            while self.tell_next(client) {}
            self.hang_up(client);
            self.connections.forget(client);
        } else {
            self.go_on(client);
        }
    }

    /// The drive is to hear that a connection is closed, if it is still open to it.
    fn hang_up(&mut self, client: u32) {
        let Some(&Connection { seat, port, link, .. }) = self.connections.all.get(&client) else { return };
        if self.at_mut(seat).body.tcp(port).is_some_and(|tcp| tcp.leave(link, client)) {
            self.tell(client, seat, InputRecord::Closed { port, link });
        }
    }

    /// A drive is to hear something of somebody on a connection, at the first instant at which it still can.
    fn tell(&mut self, client: u32, seat: DriveId, fed: InputRecord) {
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.under_way += 1;
        }
        self.busy += 1;
        let at = self.at(seat).free(self.now, Phase::Line);
        self.schedule(at, Phase::Line, seat.0, EventKind::TcpSend { client, fed });
    }

    /// A drive hears something of somebody on a connection, and then the next that he has said.
    pub(super) fn hear(&mut self, place: u32, client: u32, fed: &InputRecord) {
        self.busy -= 1;
        let (InputRecord::Opened { port, .. }
        | InputRecord::Message { port, .. }
        | InputRecord::Closed { port, .. }) = *fed
        else {
            return;
        };
        let Some(tcp) = self.seats[place as usize].body.tcp(port) else { return };
        let takes = tcp.busy_with.is_none();
        tcp.heard = if takes { Some(client) } else { tcp.heard };
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.under_way -= 1;
            // Somebody else's message of the same instant came first.
            if let (false, InputRecord::Message { bytes, .. }) = (takes, fed) {
                connection.put_back(bytes.clone());
            }
        }
        if takes || !matches!(fed, InputRecord::Message { .. }) {
            self.hear_if_open(place, client, fed);
        }
        self.go_on(client);
        self.release(place, port);
    }

    /// A drive hears something of somebody on a connection, unless that has been closed meanwhile.
    fn hear_if_open(&mut self, place: u32, client: u32, fed: &InputRecord) {
        let (InputRecord::Opened { port, link }
        | InputRecord::Message { port, link, .. }
        | InputRecord::Closed { port, link }) = *fed
        else {
            return;
        };
        let Some(state) = self.seats[place as usize].body.ports.get_mut(usize::from(port.0)) else { return };
        let (Some(tcp), statistics) = (&mut state.tcp, &mut state.statistics) else { return };
        let at = (DriveId(place), port, link);
        match fed {
            InputRecord::Opened { .. } if tcp.hear_opened(link, client) => statistics.connections += 1,
            InputRecord::Closed { .. } if tcp.hear_closed(link, client) => {
                self.record_message(at, Source::Client, &[]);
            }
            InputRecord::Message { bytes, .. } if tcp.known(link) == Some(client) => {
                statistics.messages += 1;
                self.record_message(at, Source::Client, bytes);
            }
            _ => return,
        }
        self.deliver(place, fed);
    }

    /// Carries what a drive says on a connection, or that it closes it.
    pub(super) fn carry_said(&mut self, said: &TcpSend, bytes: &[u8]) {
        let TcpSend { seat, port, link, client, count } = *said;
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        match count {
            Some(0) => return,
            Some(_) if connection.is_gone => {}
            Some(_) => {
                connection.inbox.extend_from_slice(bytes);
                self.connections.audible.insert(client);
            }
            None => self.connections.end(client, Ended::ByDrive),
        }
        self.record_message((DriveId(seat), port, link), Source::Drive(DriveId(seat)), bytes);
    }

    /// Power is gone, and with it all connections to a drive.
    pub(super) fn lose_connections(&mut self, place: u32) {
        let ports = self.seats[place as usize].body.ports.iter_mut();
        let clients: Vec<u32> = ports.filter_map(|port| port.tcp.as_mut()).flat_map(Tcp::close_all).collect();
        for client in clients {
            self.connections.end(client, Ended::NoPower);
            if let Some(&Connection { seat, port, link, .. }) = self.connections.all.get(&client) {
                self.record_message((seat, port, link), Source::Drive(seat), &[]);
            }
        }
    }

    /// Keeps what is on a connection; nothing when that is over.
    fn record_message(&mut self, (seat, port, link): (DriveId, Port, Link), from: Source, bytes: &[u8]) {
        let at = self.now;
        self.capture.record(|| Frame {
            at,
            lasts: Duration::ZERO,
            on: Medium::Tcp(seat, port, link),
            from,
            line: None,
            bytes: bytes.to_vec(),
            collided: false,
        });
    }
}
