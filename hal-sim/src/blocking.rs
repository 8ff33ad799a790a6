//! Blocking ports on virtual time: a master that waits for its replies runs in a test unchanged.
//!
//! [`SharedBench`] hands out ports that implement [`std::io::Read`] and [`std::io::Write`] as well as the traits
//! of `embedded_io`, and delays that implement [`DelayNs`]. Bench time advances only while a port or a delay
//! waits, so a test of minutes takes milliseconds, and always the same way.
//!
//! ```
//! use std::io::{Read as _, Write as _};
//!
//! use drivetwin_firmware::device::Port;
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_protocol::modbus::rtu;
//! use drivetwin_protocol::time::Span as _;
//! use drivetwin_sim::bench::Bench;
//! use drivetwin_sim::blocking::SharedBench;
//! use embedded_hal::delay::DelayNs as _;
//!
//! let mut bench = Bench::new();
//! let md3 = bench.add::<Md3>("x");
//! let bench = SharedBench::new(bench);
//! let mut port = bench.port(md3, Port(0)).unwrap();
//! bench.delay().delay_ms(2_500); // the start-up of an MD3
//!
//! port.write_all(&rtu::read(1, 0x14, 2)).unwrap(); // Speed
//! let mut reply = [0; 9];
//! port.read_exact(&mut reply).unwrap();
//! assert_eq!(reply[..7], [1, 3, 4, 0, 0, 0x13, 0x88]); // 5,000 steps/s
//! ```

use std::cell::{RefCell, RefMut};
use std::io;
use std::rc::Rc;

use drivetwin_firmware::device::{Duration, Port};
use embedded_hal::delay::DelayNs;

use crate::bench::{Bench, Client, ConnectError, DriveId, Outlet};

/// A bench that a test, its ports and its delays share. Clones share the same bench.
#[derive(Clone)]
pub struct SharedBench(Rc<RefCell<Bench>>);

impl SharedBench {
    /// Shares a bench.
    #[must_use]
    pub fn new(bench: Bench) -> Self {
        Self(Rc::new(RefCell::new(bench)))
    }

    /// The bench, for everything else: pins, registers, motion. Release it before a port or a delay is used.
    ///
    /// # Panics
    /// If another part of the program has not released the bench.
    #[must_use]
    pub fn bench(&self) -> RefMut<'_, Bench> {
        self.0.borrow_mut()
    }

    /// Connects a client to the line or TCP port of a drive's port.
    ///
    /// # Errors
    /// The TCP port refuses connections now. A serial line never refuses.
    pub fn port(&self, drive: DriveId, port: Port) -> Result<BlockingPort, ConnectError> {
        let outlet = self.bench().outlet(drive, port);
        self.join(outlet)
    }

    /// Connects a client to a line or a TCP port.
    ///
    /// # Errors
    /// The TCP port refuses connections now. A serial line never refuses.
    pub fn join(&self, outlet: Outlet) -> Result<BlockingPort, ConnectError> {
        let client = self.bench().join(outlet)?;
        Ok(BlockingPort { bench: self.clone(), client, timeout: Duration::secs(1), received: Vec::new() })
    }

    /// A delay on bench time.
    #[must_use]
    pub fn delay(&self) -> BlockingDelay {
        BlockingDelay(self.clone())
    }
}

/// A client of a line or a TCP port. A read waits for the first byte, as a serial port with a timeout does. When
/// it is dropped, the client disconnects.
pub struct BlockingPort {
    bench: SharedBench,
    client: Client,
    timeout: Duration,
    /// Bytes that were received and not read yet.
    received: Vec<u8>,
}

impl BlockingPort {
    /// Sets the longest wait of a read, in bench time; default 1 s.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Waits for the first byte. Returns false if none has come after the timeout, or the connection is closed.
    fn wait(&mut self) -> bool {
        if self.received.is_empty() {
            let mut bench = self.bench.bench();
            let until = bench.now() + self.timeout;
            bench.run_until_readable(self.client, until);
            bench.receive(self.client, &mut self.received);
        }
        !self.received.is_empty()
    }
}

impl Drop for BlockingPort {
    fn drop(&mut self) {
        // A panic while the bench is in use drops the port, too.
        if let Ok(mut bench) = self.bench.0.try_borrow_mut() {
            bench.disconnect(self.client);
        }
    }
}

/// Reads what has come, and waits for the first byte. The end of a TCP connection is the end of the file.
///
/// # Errors
/// [`TimedOut`](io::ErrorKind::TimedOut).
impl io::Read for BlockingPort {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if into.is_empty() {
            return Ok(0);
        }
        if !self.wait() {
            let is_closed = self.bench.bench().ended(self.client).is_some();
            return if is_closed { Ok(0) } else { Err(io::ErrorKind::TimedOut.into()) };
        }
        let count = into.len().min(self.received.len());
        into[..count].copy_from_slice(&self.received[..count]);
        self.received.drain(..count);
        Ok(count)
    }
}

/// Sends bytes now, without gaps. A flush waits until a serial line has transmitted them.
///
/// # Errors
/// [`BrokenPipe`](io::ErrorKind::BrokenPipe): the TCP connection is closed.
impl io::Write for BlockingPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut bench = self.bench.bench();
        if bench.ended(self.client).is_some() {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        bench.send(self.client, bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let mut bench = self.bench.bench();
        let until = bench.now() + self.timeout;
        bench.run_until_transmitted(self.client, until);
        Ok(())
    }
}

impl embedded_io::ErrorType for BlockingPort {
    type Error = embedded_io::ErrorKind;
}

impl embedded_io::Read for BlockingPort {
    fn read(&mut self, into: &mut [u8]) -> Result<usize, Self::Error> {
        io::Read::read(self, into).map_err(|error| kind(&error))
    }
}

impl embedded_io::ReadReady for BlockingPort {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        if self.received.is_empty() {
            self.bench.bench().receive(self.client, &mut self.received);
        }
        Ok(!self.received.is_empty())
    }
}

impl embedded_io::Write for BlockingPort {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        io::Write::write(self, bytes).map_err(|error| kind(&error))
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        io::Write::flush(self).map_err(|error| kind(&error))
    }
}

fn kind(error: &io::Error) -> embedded_io::ErrorKind {
    match error.kind() {
        io::ErrorKind::TimedOut => embedded_io::ErrorKind::TimedOut,
        io::ErrorKind::BrokenPipe => embedded_io::ErrorKind::BrokenPipe,
        _ => embedded_io::ErrorKind::Other,
    }
}

/// A delay on bench time, rounded up to whole ticks of 62.5 ns.
pub struct BlockingDelay(SharedBench);

impl DelayNs for BlockingDelay {
    fn delay_ns(&mut self, ns: u32) {
        let ticks = (u64::from(ns) * 2).div_ceil(125);
        let mut bench = self.0.bench();
        let until = bench.now() + Duration::from_ticks(ticks);
        bench.run_until(until);
    }
}
