//! Clients of lines: bytes that wait to be sent, and characters that wait to be read.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use drivetwin_firmware::device::{Duration, Instant, Line};

use super::Sender;
use super::misread::misread;
use crate::ids::DriveId;
use crate::record::effects::FrameEffects;

/// A client of a line, with its bytes in both directions.
#[derive(Default)]
pub(crate) struct ClientState {
    pub(crate) bus: u32,
    /// Arrival order of the last bytes on the bench before the client connected.
    since: u64,
    /// True once the client has left. Only its complete frames are still sent.
    pub(crate) left: bool,
    /// True if the client's port times characters itself, so that replies are delivered at once.
    pub(crate) paces_itself: bool,
    /// True if it receives only answers to its own requests.
    pub(crate) hears_own_answers_only: bool,
    pub(crate) sender: Sender,
    /// Settings with which the client's port receives.
    pub(crate) receiver: Sender,
    /// Bytes that are not on the line yet.
    pub(super) bytes: VecDeque<u8>,
    /// Arrival times of `bytes`; one entry for bytes that arrived together.
    pub(super) arrivals: VecDeque<Arrival>,
    /// Received characters, sorted by the time of their end.
    inbox: VecDeque<RxChar>,
}

/// A character for a client.
#[derive(Clone, Copy)]
struct RxChar {
    /// End of the character.
    end: Instant,
    byte: u8,
    /// The drive that sends it, if any.
    from: Option<DriveId>,
    /// True once the character has collided: a further collision does not change it.
    collided: bool,
}

/// Characters for clients, back to back from `start` on.
#[derive(Clone, Copy)]
pub(crate) struct RxBurst<'a> {
    pub(crate) start: Instant,
    /// Serial settings of the sender.
    pub(crate) line: Line,
    /// Duration of a character; zero if characters take no time.
    pub(crate) character: Duration,
    pub(crate) bytes: &'a [u8],
    /// The drive that sends them, if any.
    pub(crate) from: Option<DriveId>,
}

/// Bytes that arrived together.
#[derive(Clone, Copy)]
pub(super) struct Arrival {
    /// Position in the order of all arrivals on the bench.
    order: u64,
    pub(super) at: Instant,
    /// Latest time at which the client can have sent the bytes.
    latest: Instant,
    pub(super) count: usize,
    flags: CharFlags,
}

/// Flags of a character on a line with timed characters.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct CharFlags {
    /// Noise, which no client has sent.
    pub(crate) noise: bool,
    /// Received with a parity or framing error.
    pub(crate) unreadable: bool,
    /// Effects of faults on the text that it belongs to.
    pub(crate) effects: FrameEffects,
}

impl ClientState {
    /// A client that connects to `bus` after `since` arrivals.
    pub(crate) fn new(bus: u32, since: u64) -> Self {
        Self { bus, since, ..Self::default() }
    }

    /// Queues bytes. The client had sent them by `latest`.
    pub(crate) fn arrive(
        &mut self,
        at: Instant,
        latest: Instant,
        order: u64,
        bytes: &[u8],
        flags: CharFlags,
    ) {
        self.bytes.extend(bytes);
        self.arrivals.push_back(Arrival { order, at, latest, count: bytes.len(), flags });
    }

    /// Earliest and latest time at which the client can have sent the waiting byte at `index`.
    pub(crate) fn sent_between(&self, index: usize) -> Option<(Instant, Instant)> {
        let mut end = 0;
        let arrival = self.arrivals.iter().find(|arrival| {
            end += arrival.count;
            index < end
        })?;
        Some((arrival.at, arrival.latest))
    }

    /// Returns true if the waiting bytes at `length - 1` and at `length` arrived at once.
    pub(crate) fn arrived_at_once(&self, length: usize) -> bool {
        let mut end = 0;
        let arrival = self.arrivals.iter().find(|arrival| {
            end += arrival.count;
            length <= end
        });
        arrival.is_some() && length < end
    }

    /// The first `length` waiting bytes.
    pub(crate) fn first(&self, length: usize) -> Vec<u8> {
        self.bytes.iter().take(length).copied().collect()
    }

    /// The waiting bytes up to the first silence that may be as long as `needs`.
    pub(crate) fn sent_without(&self, needs: Duration) -> Vec<u8> {
        let mut arrivals = self.arrivals.iter().peekable();
        let mut length = 0;
        while let Some(arrival) = arrivals.next() {
            length += arrival.count;
            if arrivals.peek().is_none_or(|next| next.latest >= arrival.at + needs) {
                break;
            }
        }
        self.first(length)
    }

    /// Flags of the first waiting byte.
    pub(crate) fn flags(&self) -> CharFlags {
        self.arrivals.front().map(|arrival| arrival.flags).unwrap_or_default()
    }

    /// Arrival order of the first waiting byte.
    pub(crate) fn order(&self) -> Option<u64> {
        self.arrivals.front().map(|arrival| arrival.order)
    }

    /// Number of waiting bytes.
    pub(crate) fn backlog(&self) -> usize {
        self.bytes.len()
    }

    /// Takes the first `length` waiting bytes.
    pub(crate) fn take(&mut self, length: usize) -> Vec<u8> {
        let mut left = length;
        while let Some(arrival) = self.arrivals.front_mut()
            && left > 0
        {
            let part = left.min(arrival.count);
            (left, arrival.count) = (left - part, arrival.count - part);
            if arrival.count == 0 {
                self.arrivals.pop_front();
            }
        }
        self.bytes.drain(..length).collect()
    }

    /// Adds a received character. If two drives send at the same time, their characters are interleaved.
    fn push(&mut self, rx_char: RxChar) {
        let place = self.inbox.partition_point(|other| other.end <= rx_char.end);
        self.inbox.insert(place, rx_char);
    }

    /// Corrupts the unread characters that are on the line between `from` and `until`.
    pub(crate) fn garble(
        &mut self,
        from: Instant,
        until: Instant,
        character: Duration,
        garbage: impl Fn(Instant, u8) -> u8,
    ) {
        let met = |rx_char: &&mut RxChar| from < rx_char.end && rx_char.end - character < until;
        for rx_char in self.inbox.iter_mut().filter(met).filter(|rx_char| !rx_char.collided) {
            rx_char.byte = garbage(rx_char.end, rx_char.byte);
            rx_char.collided = true;
        }
    }

    /// Drops characters of a drive that end after `at`.
    fn cancel_from(&mut self, drive: DriveId, at: Instant) {
        self.inbox.retain(|rx_char| rx_char.end <= at || rx_char.from != Some(drive));
    }

    /// End of the next character for the client.
    fn due(&self) -> Instant {
        self.inbox.front().map_or(Instant::NEVER, |rx_char| rx_char.end)
    }

    /// Appends the characters that have ended by `now`.
    fn receive(&mut self, now: Instant, into: &mut Vec<u8>) -> usize {
        let count = self.inbox.partition_point(|rx_char| rx_char.end <= now);
        into.extend(self.inbox.drain(..count).map(|rx_char| rx_char.byte));
        count
    }
}

/// All clients of lines, and the time at which each can read a character. There may be thousands of clients,
/// of which few receive characters at a time.
#[derive(Default)]
pub(crate) struct Clients {
    all: BTreeMap<u32, ClientState>,
    /// Time at which each client can read its next character, if there is one.
    readable: BTreeSet<(Instant, u32)>,
}

impl Clients {
    pub(crate) fn get(&self, id: &u32) -> Option<&ClientState> {
        self.all.get(id)
    }

    pub(crate) fn get_mut(&mut self, id: &u32) -> Option<&mut ClientState> {
        self.all.get_mut(id)
    }

    pub(crate) fn insert(&mut self, id: u32, state: ClientState) {
        self.all.insert(id, state);
    }

    pub(crate) fn remove(&mut self, id: &u32) -> Option<ClientState> {
        let state = self.all.remove(id)?;
        self.readable.remove(&(state.due(), *id));
        Some(state)
    }

    /// Returns true if a client connected after the arrival with that number.
    pub(crate) fn came_after(&self, id: u32, order: u64) -> bool {
        self.all.get(&id).is_some_and(|state| state.since >= order)
    }

    /// Disconnects a client. It receives nothing more, and is removed once its complete frames are sent.
    pub(crate) fn leave(&mut self, id: u32) -> Option<&ClientState> {
        self.with_inbox(id, |state| state.inbox.clear());
        let state = self.all.get_mut(&id)?;
        state.left = true;
        Some(state)
    }

    /// Adds characters for a client. If its port times characters itself, it receives all of them at the
    /// start of the first one. `garbage` returns the corrupt byte for a character that collides, otherwise
    /// `None`.
    pub(crate) fn push(&mut self, id: u32, burst: RxBurst<'_>, garbage: impl Fn(Instant, u8) -> Option<u8>) {
        let RxBurst { start, line, character, bytes, from } = burst;
        self.with_inbox(id, |state| {
            let read: Vec<(Instant, u8)> = if state.receiver.fits(line) {
                (1..).zip(bytes).map(|(n, &byte)| (start + character * n, byte)).collect()
            } else {
                let read = misread(line, bytes, state.receiver.or(line)).into_iter();
                let takes_time = character > Duration::ZERO;
                read.map(|(after, byte)| (if takes_time { start + after } else { start }, byte)).collect()
            };
            for (end, byte) in read {
                let garbage = garbage(end, byte);
                state.push(RxChar {
                    end: if state.paces_itself { start } else { end },
                    byte: garbage.unwrap_or(byte),
                    from,
                    collided: garbage.is_some(),
                });
            }
        });
    }

    /// Drops characters of a drive for a client that end after `at`.
    pub(crate) fn cancel_from(&mut self, id: u32, drive: DriveId, at: Instant) {
        self.with_inbox(id, |state| state.cancel_from(drive, at));
    }

    /// Appends the characters that a client can read by `now`. Returns their number.
    pub(crate) fn receive(&mut self, id: u32, now: Instant, into: &mut Vec<u8>) -> usize {
        self.with_inbox(id, |state| state.receive(now, into)).unwrap_or(0)
    }

    /// Time at which a client can read its next character; [`Instant::NEVER`] if there is none.
    pub(crate) fn due_of(&self, id: u32) -> Instant {
        self.all.get(&id).map_or(Instant::NEVER, ClientState::due)
    }

    /// Earliest time at which a client can read a character.
    pub(crate) fn due(&self) -> Instant {
        self.readable.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Clients that can read a character by `now`.
    pub(crate) fn readable(&self, now: Instant) -> impl Iterator<Item = u32> {
        self.readable.iter().take_while(move |&&(at, _)| at <= now).map(|&(_, id)| id)
    }

    /// Calls `act` for a client that has not left, and updates `readable` afterwards.
    fn with_inbox<T>(&mut self, id: u32, act: impl FnOnce(&mut ClientState) -> T) -> Option<T> {
        let state = self.all.get_mut(&id).filter(|state| !state.left)?;
        let before = state.due();
        let result = act(state);
        let after = state.due();
        if before != after {
            self.readable.remove(&(before, id));
            if after < Instant::NEVER {
                self.readable.insert((after, id));
            }
        }
        Some(result)
    }
}
