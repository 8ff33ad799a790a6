//! Buffer for answers that are too long for the buffer of their connection. The buffer consists of pieces,
//! which all connections share.

use heapless::Vec;

/// Number of bytes in a piece. With its other data a piece takes 128 bytes.
const PIECE: usize = 120;
/// Number of pieces. They hold the listing of the longest program of an MDrive, which has up to 13 KiB.
pub const PIECES: usize = 112;
const _: () = assert!(PIECES * PIECE >= 13 * 1_024);

/// A part of the bytes that wait.
#[derive(Clone, Debug)]
pub struct Piece {
    bytes: Vec<u8, PIECE>,
    next: Option<u8>,
}

impl Piece {
    /// A piece without bytes.
    pub const EMPTY: Self = Self { bytes: Vec::new(), next: None };
}

/// Bytes that wait on one connection: a list of pieces.
#[derive(Debug, Default)]
pub(crate) struct Chain {
    ends: Option<[u8; 2]>,
    /// Number of bytes of the first piece that are already sent.
    gone: usize,
}

impl Chain {
    pub(crate) fn is_empty(&self) -> bool {
        self.ends.is_none()
    }
}

/// The pieces, and a list of those that are free.
pub(crate) struct Long<'a> {
    pieces: &'a mut [Piece; PIECES],
    free: Vec<u8, PIECES>,
}

impl<'a> Long<'a> {
    pub(crate) fn new(pieces: &'a mut [Piece; PIECES]) -> Self {
        let mut free = Vec::new();
        for place in 0..PIECES as u8 {
            let _ = free.push(place);
        }
        Self { pieces, free }
    }

    /// Appends bytes to those that wait. Returns `false`, and changes nothing, if there is no room for all of
    /// them.
    pub(crate) fn put(&mut self, chain: &mut Chain, bytes: &[u8]) -> bool {
        let room = self.last(chain).map_or(0, |last| PIECE.saturating_sub(last.bytes.len()));
        let (front, rest) = bytes.split_at_checked(room).unwrap_or((bytes, &[]));
        if rest.len() > self.free.len() * PIECE {
            return false;
        }
        if let Some(last) = self.last(chain) {
            let _ = last.bytes.extend_from_slice(front);
        }
        for part in rest.chunks(PIECE) {
            let Some(place) = self.free.pop() else { return false };
            if let Some(last) = self.last(chain) {
                last.next = Some(place);
            }
            chain.ends = Some([chain.ends.map_or(place, |[first, _]| first), place]);
            if let Some(piece) = self.last(chain) {
                piece.bytes.clear();
                let _ = piece.bytes.extend_from_slice(part);
                piece.next = None;
            }
        }
        true
    }

    /// Passes waiting bytes to `send`, which returns the number of bytes that it took. Ends when `send` takes
    /// fewer bytes than it was given. Returns true if `send` took any.
    pub(crate) fn leave(&mut self, chain: &mut Chain, mut send: impl FnMut(&[u8]) -> usize) -> bool {
        let mut went = false;
        while let Some([first, last]) = chain.ends
            && let Some(piece) = self.pieces.get(usize::from(first))
        {
            let rest = piece.bytes.get(chain.gone..).unwrap_or_default();
            let sent = send(rest);
            went |= sent > 0;
            if sent < rest.len() {
                chain.gone += sent;
                break;
            }
            *chain = Chain { ends: piece.next.map(|next| [next, last]), gone: 0 };
            let _ = self.free.push(first);
        }
        went
    }

    fn last(&mut self, chain: &Chain) -> Option<&mut Piece> {
        chain.ends.and_then(|[_, last]| self.pieces.get_mut(usize::from(last)))
    }
}
