//! Capture of lines and TCP connections: frames as a probe on the wires reads them, including their faults. A
//! frame that collided has the bytes of its sender, and a mark that no receiver could read it (BENCH-16).

use std::collections::VecDeque;

use drivetwin_firmware::device::{Duration, Instant, Line, Link, Port};

use crate::ids::{Bus, DriveId};
use crate::record::journal::Entry;
use crate::record::trace::{Retention, allocated, make_room};

/// Recorded frames of the lines and TCP connections of a bench, see [`Bench::capture`](crate::bench::Bench::capture).
#[derive(Clone, Debug)]
pub struct Capture {
    frames: VecDeque<Frame>,
    retention: Retention,
    bytes: usize,
    /// Number of frames that a full ring has dropped.
    lost: u64,
}

/// A frame: characters of one sender that were sent together.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Bench time of the start of the first character.
    pub at: Instant,
    /// Duration of the frame; zero on a TCP connection.
    pub lasts: Duration,
    /// Line or TCP connection.
    pub on: Medium,
    /// Sender of the frame.
    pub from: Source,
    /// Serial settings of the line; `None` on a TCP connection.
    pub line: Option<Line>,
    /// Bytes of the frame; empty at the end of a TCP connection.
    pub bytes: Vec<u8>,
    /// True if some of its characters overlapped others on the line.
    pub collided: bool,
    /// Entries of journals for the messages that end with this frame of a client.
    pub received: Vec<Entry>,
}

/// Medium of a frame: a serial line or a TCP connection.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Medium {
    /// A line.
    Line(Bus),
    /// A connection of a TCP port.
    Tcp(DriveId, Port, Link),
}

/// Sender of a frame: a client, a drive, or noise.
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
    pub(crate) fn new(retention: Retention) -> Self {
        Self { frames: VecDeque::new(), retention, bytes: 0, lost: 0 }
    }

    /// Lets the numbers of the frames begin at `seen`, in a capture without frames.
    pub(crate) fn begin_at(&mut self, seen: u64) {
        self.lost = seen;
    }

    /// Number of frames so far, including those that a ring has dropped.
    #[must_use]
    pub fn seen(&self) -> u64 {
        self.lost + self.frames.len() as u64
    }

    /// The retained frames after the first `seen` frames, in the order of recording.
    pub fn since(&self, seen: u64) -> impl Iterator<Item = &Frame> {
        let skip = usize::try_from(seen.saturating_sub(self.lost)).unwrap_or(usize::MAX);
        self.frames.iter().skip(skip)
    }

    /// Number of frames that a full ring has dropped.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// A copy without frames; [`copy_on`](Self::copy_on) adds them.
    #[must_use]
    pub fn outline(&self) -> Self {
        Self { lost: self.lost, ..Self::new(Retention::All) }
    }

    /// Copies at most `most` more frames from `original`, of which this must be an [outline](Self::outline),
    /// up to frame number `seen`. Returns true if frames are left to copy. If the ring of `original` has dropped
    /// frames in the meantime, these and all earlier frames are lost here, too.
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

    /// Truncates the frame of a drive on a line at `at`.
    pub(crate) fn cut(&mut self, bus: Bus, drive: DriveId, at: Instant) {
        let is_cut = |frame: &&mut Frame| frame.on == Medium::Line(bus) && frame.from == Source::Drive(drive);
        for frame in self.frames.iter_mut().filter(is_cut).filter(|frame| frame.end() > at) {
            let Some(line) = frame.line else { continue };
            self.bytes -= frame.size();
            let whole = at.since(frame.at) / line.character();
            frame.bytes.truncate(usize::try_from(whole).unwrap_or(usize::MAX));
            frame.lasts = at.since(frame.at);
            self.bytes += frame.size();
        }
    }

    /// Marks the frame with that number as collided. The first frame has number 0.
    pub(crate) fn collide(&mut self, number: u64) {
        let index = number.checked_sub(self.lost).and_then(|index| usize::try_from(index).ok());
        if let Some(frame) = index.and_then(|index| self.frames.get_mut(index)) {
            frame.collided = true;
        }
    }

    /// Returns true if frames are recorded.
    pub(crate) fn is_on(&self) -> bool {
        self.retention != Retention::Off
    }

    /// Adds the entry of a journal to the frame of a client that ended the message, or replaces the entry there. A
    /// message that no frame ended on `is_medium` is not on the wires.
    pub(crate) fn receive(&mut self, is_medium: impl Fn(Medium) -> bool, entry: &Entry) {
        // More frames than drives on a line send between a message and its outcome.
        const RECENT: usize = 1_000;
        let of_client = |frame: &&mut Frame| frame.from == Source::Client && is_medium(frame.on);
        let recent = self.frames.iter_mut().rev().take(RECENT).filter(of_client);
        let ends =
            |frame: &&mut Frame| (frame.at..=frame.end()).contains(&entry.at) && !frame.bytes.is_empty();
        // Frames that collided overlap.
        let ends = |frame: &&mut Frame| ends(frame) && (!frame.collided || frame.end() == entry.at);
        let Some(frame) = recent.into_iter().find(ends) else { return };
        self.bytes -= frame.size();
        match frame.received.iter_mut().find(|known| known.number == entry.number) {
            Some(known) => *known = entry.clone(),
            None => frame.received.push(entry.clone()),
        }
        self.bytes += frame.size();
    }

    /// Records a frame; the ring drops its oldest frames if it is full.
    pub(crate) fn record(&mut self, frame: impl FnOnce() -> Frame) {
        if self.retention == Retention::Off {
            return;
        }
        let frame = frame();
        self.bytes += frame.size();
        if let Retention::Ring(most) | Retention::Written(most) = self.retention {
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

    /// Memory of the frame, in bytes.
    fn size(&self) -> usize {
        size_of::<Self>()
            + allocated(self.bytes.len())
            + allocated(self.received.capacity() * size_of::<Entry>())
    }
}
