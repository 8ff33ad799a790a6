//! TCP ports of a drive, and the client of each connection.

use std::collections::VecDeque;

use drivetwin_firmware::device::{Framing, Link, PortSpec};

use crate::record::requests::RequestLog;

/// Maximum number of connections of a TCP port; further connections are refused.
pub const MOST_CONNECTIONS: usize = 64;

/// A TCP port.
///
/// The drive receives openings and closings as events, later than they happen. Therefore a connection number
/// may already belong to a new client while the drive still uses it for the previous client.
pub(crate) struct Tcp {
    /// True for Modbus/TCP, whose messages are delivered whole.
    pub(crate) framed: bool,
    numbers: Vec<Number>,
    /// Clients that have connected but are not reported to the drive yet.
    not_reported: Vec<u32>,
    /// `Some` while the drive takes no messages; inside, the client whose message the drive executes.
    pub(crate) busy_with: Option<Option<u32>>,
    /// Client whose message was delivered last.
    pub(crate) last_served: Option<u32>,
    /// Clients that wait until the drive takes messages, because they have sent more or have left; the first
    /// has waited longest.
    waiting: VecDeque<u32>,
    /// Clients with a reply that is not over, on a port with lines of text.
    pub(crate) replied_to: Vec<u32>,
    /// Requests so far, on a Modbus/TCP port, and the client and transaction of the last one.
    pub(crate) requests: RequestLog,
    pub(crate) asked: Option<(u32, u16)>,
    /// Number of the last entry of a journal when the port last took messages.
    pub(crate) entries: u64,
}

/// State of a connection number.
#[derive(Clone, Copy, Default)]
struct Number {
    /// Client that has the number.
    given: Option<u32>,
    /// Client that has the number from the drive's point of view.
    known: Option<u32>,
}

impl Tcp {
    pub(super) fn new(spec: &PortSpec) -> Self {
        Self {
            framed: spec.framing == Framing::Mbap,
            numbers: Vec::new(),
            not_reported: Vec::new(),
            busy_with: None,
            last_served: None,
            waiting: VecDeque::new(),
            replied_to: Vec::new(),
            requests: RequestLog::default(),
            asked: None,
            entries: 0,
        }
    }

    /// Number of connected clients.
    pub(crate) fn connected(&self) -> usize {
        self.numbers.iter().filter(|number| number.given.is_some()).count()
    }

    /// Assigns the lowest free number to a client; `None` if all are in use.
    pub(crate) fn connect(&mut self, client: u32) -> Option<Link> {
        let free = self.numbers.iter().position(|number| number.given.is_none());
        let index = free.unwrap_or(self.numbers.len());
        if index == MOST_CONNECTIONS {
            return None;
        }
        if free.is_none() {
            self.numbers.push(Number::default());
        }
        self.numbers[index].given = Some(client);
        self.not_reported.push(client);
        Some(Link(index as u8))
    }

    /// Removes a client. Returns true if it was still connected.
    pub(crate) fn leave(&mut self, link: Link, client: u32) -> bool {
        self.number(link).is_some_and(|number| number.given.take_if(|given| *given == client).is_some())
    }

    /// Queues a client until the drive takes messages again.
    pub(crate) fn enqueue(&mut self, client: u32) {
        if !self.waiting.contains(&client) {
            self.waiting.push_back(client);
        }
    }

    /// The next client to serve, if the drive takes messages.
    pub(crate) fn next_waiting(&mut self) -> Option<u32> {
        if self.busy_with.is_none() { self.waiting.pop_front() } else { None }
    }

    /// Client that has a connection number from the drive's point of view.
    pub(crate) fn known(&self, link: Link) -> Option<u32> {
        self.numbers.get(usize::from(link.0))?.known
    }

    /// Marks a connection as reported to the drive. Returns false if power has been off since it was opened.
    pub(crate) fn report_opened(&mut self, link: Link, client: u32) -> bool {
        let Some(index) = self.not_reported.iter().position(|&not_reported| not_reported == client) else {
            return false;
        };
        self.not_reported.remove(index);
        self.number(link).is_some_and(|number| number.known.replace(client).is_none())
    }

    /// Marks a closing as reported to the drive. Returns false if the drive closed the connection itself, or
    /// power has been off since.
    pub(crate) fn report_closed(&mut self, link: Link, client: u32) -> bool {
        self.number(link).is_some_and(|number| number.known.take_if(|known| *known == client).is_some())
    }

    /// Closes a connection for the drive. Returns the client of the connection.
    pub(crate) fn close(&mut self, link: Link) -> Option<u32> {
        let client = self.number(link)?.known.take()?;
        self.leave(link, client);
        Some(client)
    }

    /// Closes all connections. Returns their clients.
    pub(crate) fn close_all(&mut self) -> impl Iterator<Item = u32> + use<> {
        self.not_reported.clear();
        self.waiting.clear();
        std::mem::take(&mut self.numbers).into_iter().filter_map(|number| number.given)
    }

    fn number(&mut self, link: Link) -> Option<&mut Number> {
        self.numbers.get_mut(usize::from(link.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_number_that_is_free_is_given_though_the_device_may_not_know() {
        let mut tcp = Tcp::new(&PortSpec { name: "mcode", framing: Framing::Return, line: None });
        let numbers: Vec<_> = (10..13).map(|client| tcp.connect(client)).collect();
        assert_eq!(numbers, [Some(Link(0)), Some(Link(1)), Some(Link(2))]);
        assert!((0..).zip(10..13).all(|(link, client)| tcp.report_opened(Link(link), client)));
        assert!(tcp.leave(Link(1), 11) && !tcp.leave(Link(1), 11) && !tcp.leave(Link(9), 11));
        assert_eq!((tcp.connected(), tcp.connect(20), tcp.connect(21)), (2, Some(Link(1)), Some(Link(3))));
        assert_eq!(tcp.known(Link(1)), Some(11));
        assert!(tcp.report_closed(Link(1), 11) && !tcp.report_closed(Link(1), 11));
        assert!(tcp.report_opened(Link(1), 20) && !tcp.report_opened(Link(1), 20));
        assert_eq!((tcp.close(Link(1)), tcp.close(Link(1)), tcp.known(Link(1))), (Some(20), None, None));
        // The opening of 21 is never reported.
        assert_eq!(tcp.close_all().collect::<Vec<_>>(), [10, 12, 21]);
        assert!(!tcp.report_opened(Link(3), 21));
        assert_eq!((tcp.connected(), tcp.known(Link(0)), tcp.connect(30)), (0, None, Some(Link(0))));
    }
}
