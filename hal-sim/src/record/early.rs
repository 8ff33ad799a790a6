//! Requests that are too early: sent without the silence that a Modbus line needs between two frames.

use std::fmt;

use drivetwin_firmware::device::Duration;

/// A request without the silence that its line needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EarlyRequest {
    /// The silence around the request.
    pub cause: EarlyCause,
    /// The silence that the line needs: t3.5, or zero in Modbus ASCII, where characters mark the ends of a frame.
    pub needs: Duration,
}

/// Silence around a request that is too early.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EarlyCause {
    /// The request began this long after a reply.
    AfterReply(Duration),
    /// The request began this long after another request, which had no reply.
    AfterRequest(Duration),
    /// The request began while the line was in use.
    InUse,
    /// The client sent the request in one write with the request before it.
    OneWrite,
    /// The next request of the client follows without silence, as when one write has two frames.
    Followed,
}

/// Requests on a line that were too early.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EarlyRequests {
    /// Number of requests that were too early.
    pub count: u64,
    /// The last request that was too early.
    pub last: Option<EarlyRequest>,
}

impl fmt::Display for EarlyRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.cause {
            EarlyCause::AfterReply(silence) => write!(f, "sent {} after a reply", milliseconds(silence))?,
            EarlyCause::AfterRequest(silence) => write!(f, "sent {} after a request", milliseconds(silence))?,
            EarlyCause::InUse => f.write_str("sent while the line was in use")?,
            EarlyCause::OneWrite => f.write_str("sent in one write with the request before it")?,
            EarlyCause::Followed => f.write_str("the next request follows without silence")?,
        }
        match self.needs {
            Duration::ZERO => Ok(()),
            needs => write!(f, "; t3.5 is {}", milliseconds(needs)),
        }
    }
}

/// A duration in milliseconds, rounded to a tenth.
fn milliseconds(duration: Duration) -> String {
    let tenth = Duration::micros(100).ticks();
    let tenths = (duration.ticks() + tenth / 2) / tenth;
    format!("{}.{} ms", tenths / 10, tenths % 10)
}
