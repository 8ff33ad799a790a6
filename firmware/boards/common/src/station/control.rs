//! The port of control: requests and replies as frames, and events when the cable has room.

use drivetwin_control::{Decoder, FRAME, Message, PIECE, Reply, Request, encode};

use super::calls::Calls;
use super::trace::MESSAGE;
use crate::cable::{Cable, CablePort};

/// Number of bytes that are read in one turn of the loop.
const BURST: usize = 64;

/// The port of control.
pub(crate) struct Control {
    decoder: Decoder,
    /// A frame that is being sent: its bytes, its end, and the place of the next byte.
    frame: [u8; FRAME],
    end: usize,
    sent: usize,
    is_open: bool,
}

impl Control {
    pub(crate) const fn new() -> Self {
        Self { decoder: Decoder::new(), frame: [0; FRAME], end: 0, sent: 0, is_open: false }
    }

    /// Sends what waits, executes a request, or sends events. Returns `true` if there may be more to do.
    pub(crate) fn serve(&mut self, cable: &mut impl Cable, calls: &mut impl Calls) -> bool {
        let is_open = cable.is_open(CablePort::Control);
        if self.is_open != is_open {
            // Each program begins anew.
            *self = Self { is_open, ..Self::new() };
            calls.hang_up();
        }
        if !self.flush(cable) {
            return false;
        }
        let mut byte = [0];
        for _ in 0..BURST {
            if calls.leaves() || cable.read(CablePort::Control, &mut byte) == 0 {
                return self.send_events(cable, calls);
            }
            let [byte] = byte;
            if let Some(request) = self.decoder.push(byte) {
                (self.sent, self.end) = (0, answer(request, calls, &mut self.frame));
                self.flush(cable);
                return true;
            }
        }
        true
    }

    /// Sends the next events. Returns `true` if there were any.
    fn send_events(&mut self, cable: &mut impl Cable, calls: &mut impl Calls) -> bool {
        let mut bytes = [0; MESSAGE];
        let Some(events) = calls.events(&mut bytes) else { return false };
        (self.sent, self.end) = (0, message(&Message::Events(events), &mut self.frame));
        self.flush(cable)
    }

    /// Sends what waits. Returns `false` if the cable has no room for all of it.
    fn flush(&mut self, cable: &mut impl Cable) -> bool {
        while let Some(bytes) = self.frame.get(self.sent..self.end).filter(|bytes| !bytes.is_empty()) {
            match cable.write(CablePort::Control, bytes) {
                0 => return false,
                count => self.sent += count,
            }
        }
        true
    }
}

/// Executes a request, and makes the frame of its reply. Returns the frame's length.
#[inline(never)]
fn answer(request: Request<'_>, calls: &mut impl Calls, frame: &mut [u8; FRAME]) -> usize {
    let mut piece = [0; PIECE];
    let Request { number, call } = request;
    let answer = calls.execute(call, &mut piece);
    message(&Message::Reply(Reply { number, answer }), frame)
}

/// Makes a frame. Returns its length. No message is too long.
fn message(message: &Message<'_>, frame: &mut [u8; FRAME]) -> usize {
    encode(message, frame).map_or(0, <[u8]>::len)
}
