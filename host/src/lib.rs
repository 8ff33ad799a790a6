//! A bench of drives in a process: paced by the wall clock, on ptys, TCP and serial ports, with a control API.
//!
//! A run has three steps: [`Configuration`] reads options and files, [`Prepared`] has reserved ports and a bench,
//! [`Running`] serves until its `stop` descriptor becomes readable.
//!
//! ```
//! use std::io::Write as _;
//! use std::os::unix::net::UnixStream;
//!
//! use drivetwin_host::Configuration;
//! use drivetwin_host::options::RunOptions;
//!
//! // Without `listen` the MD3 gets a free loopback TCP port and a pty.
//! let options = RunOptions { what: "md3".into(), ..RunOptions::default() };
//! let prepared = Configuration::read(options)?.prepare()?;
//! let running = prepared.open()?;
//! assert!(running.json()?.contains("tcp:127.0.0.1:"));
//! let (stop, mut stopper) = UnixStream::pair()?;
//! stopper.write_all(b"x")?;
//! running.serve(&stop)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | what it holds |
//! |---|---|
//! | `run` | the three steps |
//! | [`options`] | options of a run as plain data |
//! | `event_loop` | the thread that owns the bench and paces it by the wall clock |
//! | `streams`, `lender` | other threads of this process that use the bench |
//! | `ports` | ptys, TCP and serial ports, standard input and output |
//! | `board` | boards at this computer |
//! | `api` | the control API (HTTP, JSON), and the page of the panel |
//! | `nv_file` | non-volatile memory in a file |
//! | `output_file`, `live_file` | recordings, waveforms and frames, written while the bench runs |
//! | `banner` | text and JSON with the addresses of a running bench |
//! | [`rs_programs`] | user programs of the RS drives in files |
//! | [`boot_loader`] | the boot loader of a Raspberry Pi Pico, which takes a UF2 |

mod api;
mod banner;
mod board;
pub mod boot_loader;
mod clock;
mod event_loop;
mod lender;
mod live_file;
mod milestones;
mod nv_file;
pub mod options;
mod output_file;
mod ports;
pub mod rs_programs;
mod run;
mod streams;

pub use board::{Drive as BoardDrive, OnBoard, reasons};
pub use drivetwin_panel::describe;
pub use lender::{Lender, Loan, Possession, Wait, Waited};
pub use run::{Configuration, Memories, Offline, Prepared, Running, attach};
pub use streams::Streams;
