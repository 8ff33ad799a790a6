//! Captures of lines and TCP connections: frames as a probe on the wires sees them, with their faults. Of frames that
//! collided it keeps the bytes of each sender, and that no receiver could read them (BENCH-16).

use std::collections::VecDeque;

use drivetwin_firmware::device::{Duration, Instant, Line, Link, Port};

use crate::ids::{Bus, DriveId};
use crate::record::trace::{Retention, allocated, make_room};

/// Frames that were on the lines and connections.
#[derive(Clone, Debug)]
pub struct Capture {
    frames: VecDeque<Frame>,
    keep: Retention,
    bytes: usize,
    /// Frames that a full ring has dropped.
    lost: u64,
}

/// Characters that were sent together.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Start of the first one.
    pub at: Instant,
    /// Time that all of them take; on a connection none.
    pub lasts: Duration,
    /// Line or connection.
    pub on: Medium,
    /// Sender.
    pub from: Source,
    /// The settings of the line; `None` on a connection.
    pub line: Option<Line>,
    /// The characters; none when a connection is over.
    pub bytes: Vec<u8>,
    /// True if some of them overlapped others on the line.
    pub collided: bool,
}

/// Medium that carries frames.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Medium {
    /// A line.
    Line(Bus),
    /// A connection of a TCP port.
    Tcp(DriveId, Port, Link),
}

/// Sender of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Source {
    /// A client.
    Client,
    /// A drive.
    Drive(DriveId),
    /// Noise, without a sender.
    Noise,
}

impl Capture {
    /// An empty capture.
    pub(crate) fn new(keep: Retention) -> Self {
        Self { frames: VecDeque::new(), keep, bytes: 0, lost: 0 }
    }

    /// Frames so far, with those that a ring has dropped.
    #[must_use]
    pub fn seen(&self) -> u64 {
        self.lost + self.frames.len() as u64
    }

    /// The frames that are kept, in the order in which they were sent on their way; those after the first `seen`.
    pub fn since(&self, seen: u64) -> impl Iterator<Item = &Frame> {
        let skip = usize::try_from(seen.saturating_sub(self.lost)).unwrap_or(usize::MAX);
        self.frames.iter().skip(skip)
    }

    /// Frames that a full ring has dropped.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// A copy without the frames, which [`copy_on`](Self::copy_on) brings.
    #[must_use]
    pub fn outline(&self) -> Self {
        Self { lost: self.lost, ..Self::new(Retention::All) }
    }

    /// Brings at most `most` more frames of what this is an [outline](Self::outline) of, none beyond the
    /// first `seen`; whether there are more. What the ring has dropped meanwhile is lost here, too, with all
    /// before it.
    pub fn copy_on(&mut self, original: &Self, seen: u64, most: usize) -> bool {
        if original.lost > self.seen() {
            self.frames.clear();
            self.bytes = 0;
            self.lost = original.lost.min(seen);
        }
        let missing = usize::try_from(seen - self.seen()).unwrap_or(usize::MAX);
        self.frames.reserve(missing);
        for frame in original.since(self.seen()).take(missing.min(most)) {
            self.bytes += frame.size();
            self.frames.push_back(frame.clone());
        }
        self.seen() < seen
    }

    /// Ends the frame of a drive on a line at `at`.
    pub(crate) fn cut(&mut self, bus: Bus, seat: DriveId, at: Instant) {
        let said = |frame: &&mut Frame| frame.on == Medium::Line(bus) && frame.from == Source::Drive(seat);
        for frame in self.frames.iter_mut().filter(said).filter(|frame| frame.end() > at) {
            let Some(line) = frame.line else { continue };
            self.bytes -= frame.size();
            let whole = at.since(frame.at) / line.character();
            frame.bytes.truncate(usize::try_from(whole).unwrap_or(usize::MAX));
            frame.lasts = at.since(frame.at);
            self.bytes += frame.size();
        }
    }

    /// Others overlap a frame, the first one being 0.
    pub(crate) fn collide(&mut self, number: u64) {
        let place = number.checked_sub(self.lost).and_then(|place| usize::try_from(place).ok());
        if let Some(frame) = place.and_then(|place| self.frames.get_mut(place)) {
            frame.collided = true;
        }
    }

    /// A frame is on a line.
    pub(crate) fn record(&mut self, frame: impl FnOnce() -> Frame) {
        if self.keep == Retention::Off {
            return;
        }
        let frame = frame();
        self.bytes += frame.size();
        if let Retention::Ring(most) | Retention::Written(most) = self.keep {
            while self.bytes > most
                && let Some(oldest) = self.frames.pop_front()
            {
                self.bytes -= oldest.size();
                self.lost += 1;
            }
            make_room(&mut self.frames);
        }
        self.frames.push_back(frame);
    }
}

impl Frame {
    /// End of the last character.
    #[must_use]
    pub fn end(&self) -> Instant {
        self.at + self.lasts
    }

    /// Bytes of memory that it takes.
    fn size(&self) -> usize {
        size_of::<Self>() + allocated(self.bytes.len())
    }
}
