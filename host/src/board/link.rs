//! A control port that is open: messages over a stream of bytes.

use std::io;
use std::ops::{ControlFlow, Range};
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::time::{Duration, Instant as WallInstant};

use drivetwin_control::{Call, Decoder, FRAME, Message, Request, encode};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::{Errno, retry_on_intr};

use super::answer::{Answered, Failure, reply};
use crate::clock::wall;

/// Longest wait until the port takes a request.
const WRITTEN: Duration = Duration::from_secs(1);

/// End of all waits for a board, from another thread.
#[derive(Clone)]
pub(super) struct Stop(Arc<OwnedFd>);

impl Stop {
    /// A stop that has not come yet.
    ///
    /// # Errors
    /// One sentence: the system gives no event descriptor.
    pub(super) fn new() -> Result<Self, String> {
        let event = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK);
        let event = event.map_err(|error| format!("an event descriptor cannot be created: {error}"))?;
        Ok(Self(Arc::new(event)))
    }

    /// Ends all waits, also those that begin later.
    pub(super) fn stop(&self) {
        // A write of 1 fails only after 2⁶⁴ writes.
        let _ = rustix::io::write(&self.0, &1_u64.to_ne_bytes());
    }

    /// Returns true if the stop has come.
    pub(super) fn has_come(&self) -> bool {
        poll(&mut [PollFd::new(&self.0, PollFlags::IN)], Some(&Timespec::default()))
            .is_ok_and(|ready| ready > 0)
    }

    /// Waits until a descriptor is ready, the stop has come, or `span` has passed.
    ///
    /// # Errors
    /// The stop has come, or the system cannot wait.
    pub(super) fn wait(&self, on: &OwnedFd, flags: PollFlags, span: Duration) -> io::Result<()> {
        wait(&mut [PollFd::new(on, flags), PollFd::new(&self.0, PollFlags::IN)], span)?;
        if self.has_come() { Err(io::Error::other("it is no longer attached")) } else { Ok(()) }
    }
}

/// A control port that is open.
pub(super) struct Link {
    port: OwnedFd,
    stop: Stop,
    decoder: Decoder,
    /// Bytes that have come, and the part of them that is not decoded.
    bytes: Vec<u8>,
    unread: Range<usize>,
}

impl Link {
    /// A link over a port, which is non-blocking, until `stop`.
    ///
    /// # Errors
    /// The port takes nothing.
    pub(super) fn new(port: OwnedFd, stop: Stop) -> io::Result<Self> {
        let link = Self { port, stop, decoder: Decoder::new(), bytes: vec![0; 4_096], unread: 0..0 };
        // A zero byte ends what another program may have begun.
        link.write(&[0])?;
        Ok(link)
    }

    /// Waits until the port has bytes, or `waker` is readable, or the stop has come, or `span` has passed.
    ///
    /// # Errors
    /// The system cannot wait.
    pub(super) fn wait(&self, waker: &OwnedFd, span: Duration) -> io::Result<()> {
        let span = if self.unread.is_empty() { span } else { Duration::ZERO };
        let mut all = [&self.port, waker, &*self.stop.0].map(|on| PollFd::new(on, PollFlags::IN));
        wait(&mut all, span)
    }

    /// Takes what has come, and calls `take` with each message, until it returns [`ControlFlow::Break`]. The messages behind
    /// that one are taken by the next call.
    ///
    /// # Errors
    /// The port is closed, or gone.
    pub(super) fn read(&mut self, mut take: impl FnMut(Message<'_>) -> ControlFlow<()>) -> io::Result<()> {
        let Self { port, decoder, bytes, unread, .. } = self;
        if Range::is_empty(unread) {
            *unread = match rustix::io::read(&*port, bytes.as_mut_slice()) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => 0..count,
                Err(Errno::AGAIN | Errno::INTR) => return Ok(()),
                Err(error) => return Err(error.into()),
            };
        }
        for place in unread {
            if let Some(message) = decoder.push(bytes[place])
                && take(message).is_break()
            {
                break;
            }
        }
        Ok(())
    }

    /// Writes bytes.
    ///
    /// # Errors
    /// The port is closed, gone, or takes nothing for a second, or the stop has come.
    pub(super) fn write(&self, mut bytes: &[u8]) -> io::Result<()> {
        let until = wall() + WRITTEN;
        while !bytes.is_empty() {
            match rustix::io::write(&self.port, bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => {
                    let left = until.saturating_duration_since(wall());
                    if left == Duration::ZERO {
                        return Err(io::ErrorKind::TimedOut.into());
                    }
                    self.stop.wait(&self.port, PollFlags::OUT, left)?;
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Makes a call, and waits for its answer until `until`. Events that come before the answer are ignored.
    ///
    /// # Errors
    /// The board refuses the call or does not answer, or the stop has come.
    pub(super) fn ask(
        &mut self,
        number: u16,
        call: Call<'_>,
        until: WallInstant,
    ) -> Result<Answered, Failure> {
        let away = |error: io::Error| {
            Failure::Away(match error.kind() {
                io::ErrorKind::UnexpectedEof | io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => {
                    "it closes the connection".into()
                }
                _ => error.to_string(),
            })
        };
        self.write(&frame(number, call)?).map_err(away)?;
        loop {
            let mut answer = None;
            self.read(|message| {
                answer = reply(&message).filter(|(other, _)| *other == number);
                if answer.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
            .map_err(away)?;
            if let Some((_, answer)) = answer {
                return answer;
            }
            let left = until.saturating_duration_since(wall());
            if left == Duration::ZERO {
                return Err(Failure::Away("it does not answer".into()));
            }
            self.stop.wait(&self.port, PollFlags::IN, left).map_err(away)?;
        }
    }
}

/// The frame of a request.
///
/// # Errors
/// The call is too long.
pub(super) fn frame(number: u16, call: Call<'_>) -> Result<Vec<u8>, Failure> {
    let mut frame = [0; FRAME];
    let encoded = encode(&Request { number, call }, &mut frame);
    encoded.map(<[u8]>::to_vec).map_err(|error| Failure::Away(error.to_string()))
}

/// Waits until one of the descriptors is ready, or `span` has passed.
fn wait(on: &mut [PollFd<'_>], span: Duration) -> io::Result<()> {
    let span = Timespec::try_from(span).ok();
    retry_on_intr(|| poll(on, span.as_ref()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn a_stop_ends_the_wait_for_a_board_that_is_silent() {
        let (port, _silent) = UnixStream::pair().unwrap();
        port.set_nonblocking(true).unwrap();
        let stop = Stop::new().unwrap();
        let mut link = Link::new(port.into(), stop.clone()).unwrap();
        assert!(!stop.has_come());
        stop.stop();
        let until = wall() + Duration::from_secs(86_400);
        let failure = link.ask(1, Call::Hello, until).unwrap_err();
        assert_eq!(failure, Failure::Away("it is no longer attached".into()));
        assert!(stop.has_come());
        // Also if the port takes nothing more.
        let full = std::iter::repeat_with(|| link.write(&[0; 65_536])).find_map(Result::err).unwrap();
        assert_eq!(full.to_string(), "it is no longer attached");
    }
}
