//! Characters that the drives sent and that a client has not taken yet.

use std::io;
use std::os::fd::AsFd;

use drivetwin_sim::bench::{Bench, Client};
use rustix::io::Errno;

use super::READ_BYTES;

/// Maximum unread output of a client in MiB. It holds ten minutes of a QSB's stream at 230,400 baud (14 MB),
/// so that a test may advance manual time that far before it reads.
pub(super) const MOST_MIB: usize = 16;

/// Maximum unread output of all clients of a port in MiB (HOST-15).
const MOST_MIB_OF_PORT: usize = 64;

/// Maximum unread output in MiB of each client, if a port has `clients` clients.
pub(super) fn share_mib(clients: usize) -> usize {
    (MOST_MIB_OF_PORT / clients.max(1)).clamp(1, MOST_MIB)
}

/// Unread bytes of a client.
#[derive(Default)]
pub(super) struct Unread {
    bytes: Vec<u8>,
    /// Number of bytes that are already written. They are removed later, because moving the remaining bytes
    /// after each write would take longer than the write.
    taken: usize,
    /// True if bytes were lost since the last time that all bytes were written.
    lost: bool,
}

impl Unread {
    /// Number of unread characters.
    pub(super) fn len(&self) -> usize {
        self.bytes.len() - self.taken
    }

    /// Returns whether no character is unread.
    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns whether there are more unread characters than the maximum.
    pub(super) fn is_too_much(&self) -> bool {
        self.len() > MOST_MIB << 20
    }

    /// Adds the bytes that have arrived at a client by now.
    pub(super) fn receive(&mut self, bench: &mut Bench, client: Client) {
        bench.receive(client, &mut self.bytes);
    }

    /// Adds bytes.
    pub(super) fn extend(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Writes as many bytes as the other end accepts now.
    ///
    /// # Errors
    /// The other end is closed.
    pub(super) fn write(&mut self, to: impl AsFd) -> io::Result<()> {
        while !self.is_empty() {
            match rustix::io::write(&to, &self.bytes[self.taken..]) {
                Ok(written) => self.taken += written,
                Err(Errno::AGAIN) => break,
                Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
        if self.is_empty() {
            self.clear();
        } else if self.taken > self.len() {
            self.bytes.drain(..self.taken);
            self.taken = 0;
        }
        Ok(())
    }

    /// Drops bytes beyond the maximum. Returns true if bytes are lost for the first time since all were
    /// written.
    pub(super) fn lose(&mut self) -> bool {
        let too_much = self.is_too_much();
        if too_much {
            self.bytes.truncate(self.taken + (MOST_MIB << 20));
        }
        too_much && !std::mem::replace(&mut self.lost, true)
    }

    /// Takes all bytes, as a client that reads them.
    #[cfg(test)]
    pub(super) fn take(&mut self) -> Vec<u8> {
        let bytes = self.bytes.split_off(self.taken);
        self.clear();
        bytes
    }

    /// Drops all bytes.
    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        self.bytes.shrink_to(READ_BYTES);
        (self.taken, self.lost) = (0, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read as _;
    use std::os::unix::net::UnixStream;

    #[test]
    fn what_is_taken_in_pieces_comes_whole() {
        let (near, mut far) = UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let sent: Vec<u8> = (0..3_000_000_u32).map(|n| (n % 251) as u8).collect();
        let mut unread = Unread { bytes: sent.clone(), ..Unread::default() };
        let mut came = vec![0; sent.len()];
        for piece in came.chunks_mut(1_000) {
            unread.write(&near).unwrap();
            far.read_exact(piece).unwrap();
        }
        assert!(unread.is_empty() && came == sent);
        drop(far);
        unread.bytes.push(1);
        unread.write(&near).unwrap_err();
    }

    #[test]
    fn all_clients_of_a_port_together_are_bounded() {
        assert_eq!((share_mib(1), share_mib(4)), (16, 16));
        for clients in 5..=64 {
            assert!(share_mib(clients) * clients <= 64 && share_mib(clients) >= 1);
        }
    }

    #[test]
    fn what_is_lost_is_news_once_until_all_is_taken() {
        let full = || vec![0; (MOST_MIB << 20) + 1];
        let mut unread = Unread { bytes: full(), ..Unread::default() };
        assert!(unread.is_too_much() && unread.lose());
        assert_eq!(unread.len(), MOST_MIB << 20);
        assert!(!unread.is_too_much() && !unread.lose());
        unread.bytes.push(0);
        assert!(!unread.lose());
        unread.clear();
        unread.bytes = full();
        assert!(unread.lose());
    }
}
