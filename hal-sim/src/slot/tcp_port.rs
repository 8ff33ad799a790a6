//! TCP ports of a device, and the client of each connection.

use std::collections::VecDeque;

use drivetwin_firmware::device::{Framing, Link, PortSpec};

/// Connections that a TCP port takes at once; the next one is turned away.
pub const MOST_CONNECTIONS: usize = 64;

/// A TCP port.
///
/// A device hears of who comes and goes when its turn comes. So a number may be given to somebody while the device
/// still takes it for that of who had it before.
pub(crate) struct Tcp {
    /// The length in a header ends its messages (Modbus/TCP), so they go whole.
    pub(crate) framed: bool,
    numbers: Vec<Number>,
    /// Clients that have connected, and the device does not know yet.
    coming: Vec<u32>,
    /// Client whose message the device is busy with, while it takes no other one.
    pub(crate) busy_with: Option<Option<u32>>,
    /// Client that was heard last.
    pub(crate) heard: Option<u32>,
    /// Clients that have more to say, or want to leave, once the device takes it: the one who waits longest first.
    held: VecDeque<u32>,
}

/// The number of a connection.
#[derive(Clone, Copy, Default)]
struct Number {
    /// Client that has the connection.
    given: Option<u32>,
    /// Client that has the connection as far as the device knows.
    known: Option<u32>,
}

impl Tcp {
    pub(super) fn new(spec: &PortSpec) -> Self {
        Self {
            framed: spec.framing == Framing::Mbap,
            numbers: Vec::new(),
            coming: Vec::new(),
            busy_with: None,
            heard: None,
            held: VecDeque::new(),
        }
    }

    /// Number of connected clients.
    pub(crate) fn connected(&self) -> usize {
        self.numbers.iter().filter(|number| number.given.is_some()).count()
    }

    /// Gives somebody the lowest free number; `None` if there is no room for him.
    pub(crate) fn let_in(&mut self, client: u32) -> Option<Link> {
        let free = self.numbers.iter().position(|number| number.given.is_none());
        let place = free.unwrap_or(self.numbers.len());
        if place == MOST_CONNECTIONS {
            return None;
        }
        if free.is_none() {
            self.numbers.push(Number::default());
        }
        self.numbers[place].given = Some(client);
        self.coming.push(client);
        Some(Link(place as u8))
    }

    /// Removes a client; returns whether it was still connected.
    pub(crate) fn leave(&mut self, link: Link, client: u32) -> bool {
        self.number(link).is_some_and(|number| number.given.take_if(|given| *given == client).is_some())
    }

    /// A client waits until the device takes more.
    pub(crate) fn hold(&mut self, client: u32) {
        if !self.held.contains(&client) {
            self.held.push_back(client);
        }
    }

    /// Next client to be served, if the device takes more.
    pub(crate) fn release(&mut self) -> Option<u32> {
        if self.busy_with.is_none() { self.held.pop_front() } else { None }
    }

    /// Client of a connection number as far as the device knows.
    pub(crate) fn known(&self, link: Link) -> Option<u32> {
        self.numbers.get(usize::from(link.0))?.known
    }

    /// The device hears that somebody has come; not if power was away since.
    pub(crate) fn hear_opened(&mut self, link: Link, client: u32) -> bool {
        let Some(place) = self.coming.iter().position(|&coming| coming == client) else { return false };
        self.coming.remove(place);
        self.number(link).is_some_and(|number| number.known.replace(client).is_none())
    }

    /// The device hears that somebody has left; not if it has closed the connection itself, or power was away since.
    pub(crate) fn hear_closed(&mut self, link: Link, client: u32) -> bool {
        self.number(link).is_some_and(|number| number.known.take_if(|known| *known == client).is_some())
    }

    /// The device closes a connection; whose that was.
    pub(crate) fn close(&mut self, link: Link) -> Option<u32> {
        let client = self.number(link)?.known.take()?;
        self.leave(link, client);
        Some(client)
    }

    /// All connections are gone; who was there.
    pub(crate) fn close_all(&mut self) -> impl Iterator<Item = u32> + use<> {
        self.coming.clear();
        self.held.clear();
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
        let numbers: Vec<_> = (10..13).map(|client| tcp.let_in(client)).collect();
        assert_eq!(numbers, [Some(Link(0)), Some(Link(1)), Some(Link(2))]);
        assert!((0..).zip(10..13).all(|(link, client)| tcp.hear_opened(Link(link), client)));
        assert!(tcp.leave(Link(1), 11) && !tcp.leave(Link(1), 11) && !tcp.leave(Link(9), 11));
        assert_eq!((tcp.connected(), tcp.let_in(20), tcp.let_in(21)), (2, Some(Link(1)), Some(Link(3))));
        assert_eq!(tcp.known(Link(1)), Some(11));
        assert!(tcp.hear_closed(Link(1), 11) && !tcp.hear_closed(Link(1), 11));
        assert!(tcp.hear_opened(Link(1), 20) && !tcp.hear_opened(Link(1), 20));
        assert_eq!((tcp.close(Link(1)), tcp.close(Link(1)), tcp.known(Link(1))), (Some(20), None, None));
        // Of 21 it has not heard, and never does.
        assert_eq!(tcp.close_all().collect::<Vec<_>>(), [10, 12, 21]);
        assert!(!tcp.hear_opened(Link(3), 21));
        assert_eq!((tcp.connected(), tcp.known(Link(0)), tcp.let_in(30)), (0, None, Some(Link(0))));
    }
}
