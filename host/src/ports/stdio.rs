//! A serial line that is connected to standard input and output (HOST-17).
//!
//! Other programs, for instance a shell, may share these descriptors and do not expect them to be
//! non-blocking. Therefore two threads copy between them and a socket pair, whose other end belongs to the
//! bench's thread. The bench ends when standard input has ended and all answers are written, or when the
//! reader of standard output closes it.

use std::io::{self, Read as _, Write as _};
use std::net::Shutdown;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use drivetwin_firmware::device::Instant;
use drivetwin_sim::bench::{Bench, Bus, Client};
use rustix::event::epoll::EventFlags;
use tracing::{debug, warn};

use super::unread::{MOST_MIB, Unread};
use super::{Endpoint, READ_BYTES, ROOM, ReadResult, interest, may_read, note_arrival, read_some};
use crate::clock::Clock;

/// Poll interval until all output is written.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Standard input and output as a client of a line.
pub(super) struct Stdio {
    near: UnixStream,
    bus: Bus,
    client: Client,
    /// Characters that the drives sent and that standard output has not taken.
    unread: Unread,
    stage: Stage,
    /// The thread that writes to standard output.
    writer: JoinHandle<()>,
}

/// Stage in the life cycle of standard input and output.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd)]
enum Stage {
    /// Standard input is open.
    Open,
    /// Standard input has ended; the drives still answer requests.
    Asked,
    /// All requests are answered; the answers are still being written.
    Answered,
    /// All answers are written, or standard output is closed.
    Over,
}

impl Stdio {
    /// Connects standard input and output to `bus`.
    ///
    /// # Errors
    /// The system gives no sockets or threads.
    pub(super) fn new(bench: &mut Bench, bus: Bus) -> io::Result<Self> {
        let (near, far) = UnixStream::pair()?;
        near.set_nonblocking(true)?;
        let input = far.try_clone()?;
        Builder::new().name("stdin".into()).spawn(move || copy_in(input))?;
        let writer = Builder::new().name("stdout".into()).spawn(move || copy_out(far))?;
        let client = bench.connect(bus);
        Ok(Self { near, bus, client, unread: Unread::default(), stage: Stage::Open, writer })
    }
}

impl Endpoint for Stdio {
    fn client(&self) -> Option<Client> {
        Some(self.client)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.near.as_fd())
    }

    fn interest(&self, bench: &Bench) -> Option<EventFlags> {
        let reads = self.stage == Stage::Open && may_read(bench, self.client, &self.unread);
        (self.stage < Stage::Answered).then(|| interest(reads, &self.unread))
    }

    fn take(&mut self, bench: &mut Bench, _ready: EventFlags, clock: Option<&Clock>) -> bool {
        if self.stage != Stage::Open {
            return false;
        }
        let mut room = ROOM;
        match read_some(&self.near, &mut room) {
            ReadResult::Bytes(bytes) => {
                note_arrival(bench, clock);
                bench.send(self.client, bytes);
                return true;
            }
            ReadResult::Closed => self.stage = Stage::Asked,
            ReadResult::Nothing => {}
        }
        false
    }

    fn deliver(&mut self, bench: &mut Bench) -> bool {
        self.unread.receive(bench, self.client);
        if self.unread.write(&self.near).is_err() {
            self.stage = Stage::Over;
        } else if self.unread.lose() {
            warn!("stdout has left more than {MOST_MIB} MiB unread; what follows is lost");
        }
        if self.stage == Stage::Asked && self.unread.is_empty() && bench.is_answered(self.bus) {
            // The writing thread ends when it has written everything that was sent before this shutdown.
            let _ = self.near.shutdown(Shutdown::Write);
            self.stage = Stage::Answered;
        }
        false
    }

    fn expires(&self) -> Instant {
        if self.stage == Stage::Over { Instant::ZERO } else { Instant::NEVER }
    }

    fn poll_interval(&self) -> Option<Duration> {
        (self.stage == Stage::Answered).then_some(POLL_INTERVAL)
    }

    fn poll(&mut self, _bench: &mut Bench) {
        if self.writer.is_finished() {
            self.stage = Stage::Over;
        }
    }

    fn leave(&mut self, bench: &mut Bench) {
        bench.disconnect(self.client);
    }
}

/// Copies standard input to the bench, until either ends.
fn copy_in(mut to: UnixStream) {
    let mut buffer = [0; READ_BYTES];
    let mut stdin = io::stdin().lock();
    loop {
        match stdin.read(&mut buffer) {
            Ok(count) if count > 0 && to.write_all(&buffer[..count]).is_ok() => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            _ => break,
        }
    }
    let _ = to.shutdown(Shutdown::Write);
}

/// Copies output of the drives to standard output, until either ends.
fn copy_out(mut from: UnixStream) {
    let mut buffer = [0; READ_BYTES];
    // Flushed each time, because `io::stdout` buffers text that has no line end.
    let write = |bytes: &[u8]| {
        let mut stdout = io::stdout().lock();
        stdout.write_all(bytes).and_then(|()| stdout.flush())
    };
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => {
                if let Err(error) = write(&buffer[..count]) {
                    debug!("stdout is closed: {error}");
                    break;
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
    // The bench's thread learns that standard output is closed, because its further writes fail.
    let _ = from.shutdown(Shutdown::Both);
}
