//! Handles of drives, lines and clients on a bench.

/// Handle of a drive, valid for the bench that returned it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct DriveId(pub(crate) u32);

impl DriveId {
    /// Position of the drive in [`Bench::drives`](crate::bench::Bench::drives).
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Handle of a serial line, valid for the bench that returned it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Bus(pub(crate) u32);

/// Handle of a client, which sends and receives on a line or on a TCP connection.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Client(pub(crate) u32);
