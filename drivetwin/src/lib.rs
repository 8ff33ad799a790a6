//! Motion drives for tests of masters: five real products on a bench of virtual time.
//!
//! A [`Bench`] has [`Drive`]s. Drives, registers, pins and faults have the names of the manuals; a wrong name is
//! an [`Error`] with the nearest right one. Time passes only when the test says so, or while a [port](Drive::port)
//! or a [delay](Bench::delay) waits, so that minutes take milliseconds, always the same way.
//!
//! ```
//! use drivetwin::{Bench, Span as _, md3, rtu};
//!
//! let bench = Bench::new();
//! let x = bench.add("md3", "x")?;
//! bench.advance(2_500.millis()); // start-up
//! x.set(md3::Reg::Speed, 8_000)?;
//! assert_eq!(x.ask(&rtu::write(1, 0x11, 1)), rtu::write(1, 0x11, 1)[..]); // Move
//! bench.advance(3.secs());
//! assert_eq!((x.motion().position, x.pulses()?.len()), (10_000, 10_000));
//! # Ok::<(), drivetwin::Error>(())
//! ```
//!
//! A motor with a home switch two turns back, from the text of a bench file. The MD3 homes onto it:
//!
//! ```
//! use drivetwin::{Bench, Level, Span as _, md3::{Reg, pin}};
//!
//! let bench = Bench::from_toml(
//!     "
//!     [[drive]]
//!     name = 'x'
//!     kind = 'md3'
//!     fast_boot = true
//!     set = { HomingConfiguration = 0x10 } # backward, stop at once (7.5)
//!
//!     [[motor]]
//!     name = 'm'
//!     drive = 'x'
//!
//!     [[switch]]
//!     motor = 'm'
//!     closed = { below_rev = -2.0 }
//!     to = 'x.J2.2'
//!     ",
//! )?;
//! let x = bench.drive("x")?;
//! assert_eq!(x.pin(pin::J2_2)?, Level::High);
//! x.set(Reg::MotionControl, 0x04)?;
//! bench.advance(5.secs());
//! assert_eq!(x.motion().position, -3_200); // 1,600 steps a turn
//! # Ok::<(), drivetwin::Error>(())
//! ```
//!
//! A blocking master, your own or one of another crate, runs unchanged. A port implements [`std::io::Read`]
//! and [`std::io::Write`], and the traits of embedded-io with these names. A delay implements the trait of
//! embedded-hal.
//!
//! ```
//! use std::io::{Read as _, Write as _};
//!
//! use drivetwin::{Bench, qsb};
//! use embedded_hal::delay::DelayNs as _;
//!
//! let bench = Bench::new();
//! let qsb = bench.add_preset("qsb-d", "encoder", &[(qsb::Reg::Mdr0, 0x43)])?; // four counts a cycle
//! let mut port = qsb.port("usb")?;
//! let mut greeting = [0; 12];
//! port.read_exact(&mut greeting).unwrap();
//! assert_eq!(&greeting, b"QSB-D  0E!\r\n");
//! qsb.encoder(400, 10_000.0)?;
//! bench.delay().delay_ms(50);
//! port.write_all(b"R0E\r").unwrap(); // READ ENCODER
//! let mut reply = [0; 17];
//! port.read_exact(&mut reply).unwrap();
//! assert_eq!(&reply, b"r 0E 00000190 !\r\n");
//! # Ok::<(), drivetwin::Error>(())
//! ```
//!
//! What is not here is in the crates below: [`sim`] (bench, plant, lines, recordings), [`firmware`] (the drives),
//! [`protocol`] (frames, registers, time). [`Bench::sim`] gives access to the bench below.

mod bench;
mod drive;
pub mod kinds;
mod names;

pub use drivetwin_firmware as firmware;
pub use drivetwin_firmware::device::{Duration, Instant, Level};
pub use drivetwin_protocol as protocol;
pub use drivetwin_protocol::modbus::{ascii, rtu, tcp};
pub use drivetwin_protocol::time::Span;
pub use drivetwin_sim as sim;
pub use drivetwin_sim::bench::{
    EarlyRequests, Motion, PinStimulus, PowerAction, Received, RequestStatistics, Settings, StartingRequests,
};
pub use drivetwin_sim::blocking::{BlockingDelay, BlockingPort};
pub use drivetwin_sim::line::faults::{Amount, Direction, FaultRule, LineFaults};
pub use drivetwin_sim::signals::pulses::Pulse;

pub use bench::Bench;
pub use drive::Drive;
pub use kinds::{Kind, add_kinds, md3, mdrive, mdrobot, qsb, rs434};
pub use names::RegisterName;

/// A name, a value or a file that is not valid, in one sentence.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Error(String);

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

impl From<String> for Error {
    fn from(sentence: String) -> Self {
        Self(sentence)
    }
}
