//! The trace: events that wait in a ring until the computer gets them.

use drivetwin_control::{Event, Events};
use drivetwin_firmware::device::Instant;

/// Greatest number of bytes of an event with its time.
const EVENT: usize = 200;

/// Greatest number of bytes of events in one message.
pub(crate) const MESSAGE: usize = 224;

/// Bytes of an event that are characters or saved registers. A longer output is several events.
pub(crate) const PART: usize = 128;

/// Events in a ring: for each the number of its bytes, and the bytes.
pub(crate) struct Trace<'a> {
    ring: &'a mut [u8],
    /// Place of the first byte, and number of bytes.
    first: usize,
    used: usize,
    is_on: bool,
    /// Number of the first event.
    number: u32,
    /// Time from which the first event counts its own, and time of the last event, in ticks.
    begin: u64,
    end: u64,
    /// Number of events left out since the last event.
    missing: u32,
    /// Number of events that were left out.
    lost: u32,
}

/// An end of the trace.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mark {
    used: usize,
    end: u64,
    missing: u32,
    lost: u32,
}

impl<'a> Trace<'a> {
    /// A trace that is off.
    pub(crate) fn new(ring: &'a mut [u8]) -> Self {
        Self { ring, first: 0, used: 0, is_on: false, number: 0, begin: 0, end: 0, missing: 0, lost: 0 }
    }

    /// Begins a new trace, or ends the trace.
    pub(crate) fn set(&mut self, on: bool) {
        (self.first, self.used, self.is_on) = (0, 0, on);
        (self.number, self.begin, self.end, self.missing) = (0, 0, 0, 0);
    }

    /// Returns true while events are recorded.
    pub(crate) fn is_on(&self) -> bool {
        self.is_on
    }

    /// Number of events that were left out since the start, because too many waited; it wraps.
    pub(crate) fn lost(&self) -> u32 {
        self.lost
    }

    /// Records an event. If there is no room, it is counted, and a later event says so.
    pub(crate) fn put(&mut self, at: Instant, event: &Event<'_>) {
        if !self.is_on {
            return;
        }
        let at = at.ticks();
        if self.missing > 0 && self.push(self.end, &Event::Lost(self.missing)) {
            self.missing = 0;
        }
        if self.missing > 0 || !self.push(at, event) {
            self.missing = self.missing.saturating_add(1);
            self.lost = self.lost.wrapping_add(1);
        }
    }

    /// The present end of the trace, for [`rewind`](Self::rewind).
    pub(crate) fn mark(&self) -> Mark {
        Mark { used: self.used, end: self.end, missing: self.missing, lost: self.lost }
    }

    /// Forgets the events since a mark. None may have been taken since then.
    pub(crate) fn rewind(&mut self, mark: Mark) {
        (self.used, self.end, self.missing, self.lost) = (mark.used, mark.end, mark.missing, mark.lost);
    }

    /// Returns `false` if there is no room.
    fn push(&mut self, at: u64, event: &Event<'_>) -> bool {
        let mut bytes = [0; EVENT];
        let after = at.wrapping_sub(self.end).cast_signed();
        let Ok(bytes) = postcard::to_slice(&(after, event), &mut bytes) else { return false };
        if bytes.len() >= self.ring.len() - self.used {
            return false;
        }
        let head = [bytes.len() as u8];
        for byte in head.iter().chain(&*bytes) {
            let place = wrapped(self.first + self.used, self.ring.len());
            if let Some(place) = self.ring.get_mut(place) {
                *place = *byte;
            }
            self.used += 1;
        }
        self.end = at;
        true
    }

    /// Takes the first events, as many as fit into `bytes`. Returns `None` if no event waits.
    pub(crate) fn take<'b>(&mut self, bytes: &'b mut [u8; MESSAGE]) -> Option<Events<'b>> {
        let (number, at) = (self.number, self.begin);
        let mut count = 0;
        while self.used > 0 {
            let length = usize::from(self.byte(0));
            let Some(place) = bytes.get_mut(count..count + length) else { break };
            for (behind, byte) in (1..).zip(&mut *place) {
                *byte = self.byte(behind);
            }
            let after = postcard::take_from_bytes::<i64>(place).map_or(0, |(after, _)| after);
            self.begin = self.begin.wrapping_add_signed(after);
            self.first = wrapped(self.first + 1 + length, self.ring.len());
            self.used = self.used.saturating_sub(1 + length);
            self.number = self.number.wrapping_add(1);
            count += length;
        }
        let bytes = bytes.get(..count).filter(|bytes| !bytes.is_empty())?;
        Some(Events { number, at, bytes })
    }

    /// The byte at this distance from the first one.
    fn byte(&self, behind: usize) -> u8 {
        self.ring.get(wrapped(self.first + behind, self.ring.len())).copied().unwrap_or(0)
    }
}

/// A place in a ring. It is less than twice the length.
fn wrapped(place: usize, length: usize) -> usize {
    if place < length { place } else { place - length }
}
