//! What is said on stderr.
//!
//! Whoever starts a drive may never read its stderr, and a full pipe must not stop the bench. So a
//! thread of its own writes there, and what it cannot keep up with is lost.

use std::ffi::OsStr;
use std::io::{self, IsTerminal as _, Write as _};
use std::sync::OnceLock;
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::time::Duration;

use tracing_subscriber::EnvFilter;

use crate::args::Cli;

/// Lines that wait to be written.
const LINES: usize = 1024;

/// How long the end of the process waits for what was said before.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Something for the writing thread.
enum Said {
    Line(Vec<u8>),
    /// All before it is written: dropped then.
    End(#[expect(dead_code, reason = "its drop is what is waited for")] Sender<()>),
}

/// The way to the writing thread.
fn writer() -> &'static SyncSender<Said> {
    static WRITER: OnceLock<SyncSender<Said>> = OnceLock::new();
    WRITER.get_or_init(|| {
        let (writer, said) = mpsc::sync_channel(LINES);
        // Without a thread nothing is said.
        let _ = std::thread::Builder::new().name("log".into()).spawn(|| write(said));
        writer
    })
}

fn write(said: Receiver<Said>) {
    for said in said {
        if let Said::Line(line) = said {
            // Nobody is left to tell where stderr is closed.
            let _ = io::stderr().write_all(&line);
        }
    }
}

/// Says a line, unless too many wait.
pub(crate) fn say(line: &[u8]) {
    let _ = writer().try_send(Said::Line(line.to_vec()));
}

/// Waits until all is written, but not for somebody who does not read.
pub(crate) fn finish() {
    let (written, wait) = mpsc::channel();
    if writer().try_send(Said::End(written)).is_ok() {
        let _ = wait.recv_timeout(LAST_WORDS);
    }
}

/// Says each line of the log.
struct Lines;

impl io::Write for Lines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        say(line);
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns whether the log has colours: on a terminal, unless NO_COLOR is there and not empty (no-color.org).
fn is_coloured(no_color: Option<&OsStr>, is_terminal: bool) -> bool {
    is_terminal && no_color.is_none_or(OsStr::is_empty)
}

/// Logs warnings, or what `-v`, `-q` or `RUST_LOG` say.
pub(crate) fn start(cli: &Cli) {
    let level = match (cli.quiet, cli.verbose) {
        (true, _) => "error",
        (_, 0) => "warn",
        (_, 1) => "info",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(|| Lines)
        .with_ansi(is_coloured(std::env::var_os("NO_COLOR").as_deref(), io::stderr().is_terminal()))
        .with_target(false)
        .init();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_color_takes_the_colours_of_a_terminal() {
        assert!(is_coloured(None, true) && is_coloured(Some(OsStr::new("")), true));
        assert!(!is_coloured(Some(OsStr::new("1")), true) && !is_coloured(None, false));
    }
}
