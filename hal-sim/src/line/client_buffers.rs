//! Clients of lines: bytes that wait to be sent, characters that wait to be read.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use drivetwin_firmware::device::{Duration, Instant};

use super::Sender;
use crate::ids::DriveId;

/// A client of a line, with its bytes in both directions.
#[derive(Default)]
pub(crate) struct ClientState {
    pub(crate) bus: u32,
    /// The place of what arrived last before it came.
    since: u64,
    /// True once it has left, and only its whole messages are still sent.
    pub(crate) left: bool,
    /// True if its port paces characters itself, so that it gets what a drive sends at once.
    pub(crate) paces_itself: bool,
    pub(crate) sender: Sender,
    /// Bytes that are not on the line yet.
    pub(super) bytes: VecDeque<u8>,
    /// Arrival of the bytes, in pieces.
    pub(super) arrivals: VecDeque<Arrival>,
    /// Characters for it, as they end.
    inbox: VecDeque<RxChar>,
}

/// A character for somebody outside.
#[derive(Clone, Copy)]
struct RxChar {
    /// End of the character.
    end: Instant,
    byte: u8,
    /// The drive that says it, if one does.
    from: Option<DriveId>,
    /// True once it has collided: it stays corrupt as it is, whatever else it meets.
    spoiled: bool,
}

/// Characters for clients that follow each other from `start` on.
#[derive(Clone, Copy)]
pub(crate) struct RxBurst<'a> {
    pub(crate) start: Instant,
    pub(crate) character: Duration,
    pub(crate) bytes: &'a [u8],
    /// The drive that says them, if one does.
    pub(crate) from: Option<DriveId>,
}

/// Bytes that came together.
#[derive(Clone, Copy)]
pub(super) struct Arrival {
    /// Their place in the order of arrival.
    order: u64,
    pub(super) at: Instant,
    pub(super) count: usize,
    mark: CharFlags,
}

/// Kind of a character that a client has for a line on which each character has its time.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct CharFlags {
    /// Noise: no client has sent it.
    pub(crate) noise: bool,
    /// A drive finds that it is wrong.
    pub(crate) unreadable: bool,
}

impl ClientState {
    /// A client on `bus` that comes when so much has arrived.
    pub(crate) fn new(bus: u32, since: u64) -> Self {
        Self { bus, since, ..Self::default() }
    }

    /// Bytes arrive.
    pub(crate) fn arrive(&mut self, at: Instant, order: u64, bytes: &[u8], mark: CharFlags) {
        self.bytes.extend(bytes);
        self.arrivals.push_back(Arrival { order, at, count: bytes.len(), mark });
    }

    /// Mark of its first waiting byte.
    pub(crate) fn mark(&self) -> CharFlags {
        self.arrivals.front().map(|arrival| arrival.mark).unwrap_or_default()
    }

    /// The place of its first waiting byte in the order of arrival.
    pub(crate) fn order(&self) -> Option<u64> {
        self.arrivals.front().map(|arrival| arrival.order)
    }

    /// Number of waiting bytes.
    pub(crate) fn backlog(&self) -> usize {
        self.bytes.len()
    }

    /// Takes the first bytes that wait.
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

    /// A character for it. Two drives that send at once are mixed.
    fn hear(&mut self, heard: RxChar) {
        let place = self.inbox.partition_point(|other| other.end <= heard.end);
        self.inbox.insert(place, heard);
    }

    /// Characters of that length that are on their way to it, and on the line in that time, become others.
    pub(crate) fn garble(
        &mut self,
        from: Instant,
        until: Instant,
        character: Duration,
        garbage: impl Fn(Instant, u8) -> u8,
    ) {
        let met = |heard: &&mut RxChar| from < heard.end && heard.end - character < until;
        for heard in self.inbox.iter_mut().filter(met).filter(|heard| !heard.spoiled) {
            heard.byte = garbage(heard.end, heard.byte);
            heard.spoiled = true;
        }
    }

    /// Characters of a drive that end after `at` never came.
    fn hush(&mut self, seat: DriveId, at: Instant) {
        self.inbox.retain(|heard| heard.end <= at || heard.from != Some(seat));
    }

    /// End of the next character for it.
    fn due(&self) -> Instant {
        self.inbox.front().map_or(Instant::NEVER, |heard| heard.end)
    }

    /// Appends the characters that have ended by `now`.
    fn receive(&mut self, now: Instant, into: &mut Vec<u8>) -> usize {
        let count = self.inbox.partition_point(|heard| heard.end <= now);
        into.extend(self.inbox.drain(..count).map(|heard| heard.byte));
        count
    }
}

/// Everybody outside, and who can read something when. There may be thousands of them, of whom few hear
/// something at a time.
#[derive(Default)]
pub(crate) struct Clients {
    all: BTreeMap<u32, ClientState>,
    /// Time at which each one can read its next character, if there is one.
    audible: BTreeSet<(Instant, u32)>,
}

impl Clients {
    pub(crate) fn get(&self, id: &u32) -> Option<&ClientState> {
        self.all.get(id)
    }

    pub(crate) fn get_mut(&mut self, id: &u32) -> Option<&mut ClientState> {
        self.all.get_mut(id)
    }

    pub(crate) fn insert(&mut self, id: u32, outside: ClientState) {
        self.all.insert(id, outside);
    }

    pub(crate) fn remove(&mut self, id: &u32) -> Option<ClientState> {
        let outside = self.all.remove(id)?;
        self.audible.remove(&(outside.due(), *id));
        Some(outside)
    }

    /// Returns whether a client came behind that place in the order of arrival.
    pub(crate) fn came_after(&self, id: u32, order: u64) -> bool {
        self.all.get(&id).is_some_and(|outside| outside.since >= order)
    }

    /// A client hears nothing more, and is here only until its whole messages are sent.
    pub(crate) fn leave(&mut self, id: u32) -> Option<&ClientState> {
        self.listening(id, |outside| outside.inbox.clear());
        let outside = self.all.get_mut(&id)?;
        outside.left = true;
        Some(outside)
    }

    /// Characters for a client, all of them as the first one begins if its port paces itself. `garbage`: what
    /// is heard of one that ends then and collides with what is on the line already.
    pub(crate) fn hear(&mut self, id: u32, told: RxBurst<'_>, garbage: impl Fn(Instant, u8) -> Option<u8>) {
        let RxBurst { start, character, bytes, from } = told;
        self.listening(id, |outside| {
            for (n, &byte) in (1..).zip(bytes) {
                let end = start + character * n;
                let garbage = garbage(end, byte);
                outside.hear(RxChar {
                    end: if outside.paces_itself { start } else { end },
                    byte: garbage.unwrap_or(byte),
                    from,
                    spoiled: garbage.is_some(),
                });
            }
        });
    }

    /// Characters of a drive for a client that end after `at` never came.
    pub(crate) fn hush(&mut self, id: u32, seat: DriveId, at: Instant) {
        self.listening(id, |outside| outside.hush(seat, at));
    }

    /// Appends the characters that a client can read by `now`; returns how many.
    pub(crate) fn receive(&mut self, id: u32, now: Instant, into: &mut Vec<u8>) -> usize {
        self.listening(id, |outside| outside.receive(now, into)).unwrap_or(0)
    }

    /// Earliest time at which a client can read a character.
    pub(crate) fn due(&self) -> Instant {
        self.audible.first().map_or(Instant::NEVER, |&(at, _)| at)
    }

    /// Clients that can read a character by `now`.
    pub(crate) fn audible(&self, now: Instant) -> impl Iterator<Item = u32> {
        self.audible.iter().take_while(move |&&(at, _)| at <= now).map(|&(_, id)| id)
    }

    /// Does something with what a client that has not left hears.
    fn listening<T>(&mut self, id: u32, act: impl FnOnce(&mut ClientState) -> T) -> Option<T> {
        let outside = self.all.get_mut(&id).filter(|outside| !outside.left)?;
        let before = outside.due();
        let result = act(outside);
        let after = outside.due();
        if before != after {
            self.audible.remove(&(before, id));
            if after < Instant::NEVER {
                self.audible.insert((after, id));
            }
        }
        Some(result)
    }
}
