//! Characters that a UART sends, on their way to the cable.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use crate::queue::Queue;

/// Number of characters that wait until the computer reads them.
const ROOM: usize = 256;

/// Number of characters that a UART has, besides those that it has sent: one that is leaving, and the next one.
const INSIDE: usize = 2;

/// Characters that a UART has got, for the computer at the cable. The computer gets a character when it has left the
/// UART, so that a master which answers at once finds the line free.
#[derive(Debug)]
pub struct Tap {
    characters: Queue<u8, ROOM>,
    /// True if the UART has got a character since the loop has looked.
    has_more: AtomicBool,
    lost: AtomicU32,
}

impl Tap {
    /// A tap without characters.
    #[expect(clippy::new_without_default, reason = "a static needs a constant")]
    pub const fn new() -> Self {
        Self { characters: Queue::new(), has_more: AtomicBool::new(false), lost: AtomicU32::new(0) }
    }

    /// Notes that the UART has got a character. Called in an interrupt.
    pub(crate) fn put(&self, byte: u8) {
        self.has_more.store(true, Ordering::Relaxed);
        if !self.characters.push(byte) {
            self.lost.store(self.lost.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
    }

    /// Returns `true` if the UART has got a character since the last [`look`](Self::look).
    pub(crate) fn has_more(&self) -> bool {
        self.has_more.load(Ordering::Relaxed)
    }

    /// Called when the loop is about to check for characters.
    pub(crate) fn look(&self) {
        self.has_more.store(false, Ordering::Relaxed);
    }

    /// Number of characters that have left; `sends` while the UART still sends.
    pub(crate) fn count(&self, sends: bool) -> usize {
        self.characters.len().saturating_sub(if sends { INSIDE } else { 0 })
    }

    /// Takes the first character.
    pub(crate) fn take(&self) -> Option<u8> {
        self.characters.pop()
    }

    /// Number of characters that were lost because the computer did not read; it wraps.
    pub(crate) fn lost(&self) -> u32 {
        self.lost.load(Ordering::Relaxed)
    }
}
