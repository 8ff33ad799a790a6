//! The log on stderr.
//!
//! A program that starts a drive may never read its stderr, and a full pipe must not stop the bench.
//! Therefore a separate thread writes to stderr, and lines are dropped if too many wait (HOST-22).

use std::ffi::OsStr;
use std::io::{self, IsTerminal as _, Write as _};
use std::sync::OnceLock;
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::time::Duration;

use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::args::{Cli, Command};

/// Maximum number of lines that wait to be written.
const LINES: usize = 1024;

/// Longest wait at the end of the process until all lines are written.
const FLUSH_LIMIT: Duration = Duration::from_secs(1);

/// A message to the writing thread.
enum Message {
    Line(Vec<u8>),
    /// Lines go to a pane from here on.
    ToPane(Sender<String>),
    /// End of the log: the writing thread drops this sender when it has written all lines before it.
    End(#[expect(dead_code, reason = "its drop is what is waited for")] Sender<()>),
}

/// The channel to the writing thread.
fn writer() -> &'static SyncSender<Message> {
    static WRITER: OnceLock<SyncSender<Message>> = OnceLock::new();
    WRITER.get_or_init(|| {
        let (writer, messages) = mpsc::sync_channel(LINES);
        // If the system gives no thread, nothing is logged.
        let _ = std::thread::Builder::new().name("log".into()).spawn(|| write(messages));
        writer
    })
}

fn write(messages: Receiver<Message>) {
    let mut pane: Option<Sender<String>> = None;
    let is_terminal = io::stderr().is_terminal();
    for message in messages {
        match message {
            Message::Line(line) => {
                let text = || String::from_utf8_lossy(&line).trim_end().to_owned();
                let is_shown = pane.as_ref().is_some_and(|pane| pane.send(text()).is_ok());
                // A pane and stderr may be the same terminal.
                if !(is_shown && is_terminal) {
                    // If stderr is closed, the error cannot be reported anywhere.
                    let _ = io::stderr().write_all(&line);
                }
            }
            Message::ToPane(lines) => pane = Some(lines),
            Message::End(_) => {}
        }
    }
}

/// Sends all further lines to a pane of the terminal, until the pane has gone; and to stderr, if it is not a terminal.
pub(crate) fn to_pane() -> Receiver<String> {
    let (pane, lines) = mpsc::channel();
    let _ = writer().try_send(Message::ToPane(pane));
    lines
}

/// Gives a line to the writing thread; drops the line if too many wait.
pub(crate) fn write_line(line: &[u8]) {
    let _ = writer().try_send(Message::Line(line.to_vec()));
}

/// Waits until all lines are written, but no longer than `FLUSH_LIMIT`.
pub(crate) fn finish() {
    let (written, wait) = mpsc::channel();
    if writer().try_send(Message::End(written)).is_ok() {
        let _ = wait.recv_timeout(FLUSH_LIMIT);
    }
}

/// Writer of the lines of the log.
struct Lines;

impl io::Write for Lines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        write_line(line);
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns whether the log has colours: only on a terminal, and not if `NO_COLOR` is set and not empty
/// (no-color.org).
fn is_coloured(no_color: Option<&OsStr>, is_terminal: bool) -> bool {
    is_terminal && no_color.is_none_or(OsStr::is_empty)
}

/// Starts the log. `-v` and `-q` set its level, if `RUST_LOG` does not; by default it has warnings.
pub(crate) fn start(cli: &Cli) {
    let level = match (cli.quiet, cli.verbose) {
        (true, _) => LevelFilter::ERROR,
        (_, 0) => LevelFilter::WARN,
        (_, 1) => LevelFilter::INFO,
        _ => LevelFilter::TRACE,
    };
    let wanted = std::env::var("RUST_LOG").ok().filter(|text| !text.is_empty());
    let wanted: Option<Targets> = wanted.and_then(|text| text.parse().ok());
    // A pane of the view has its own colours.
    let has_pane = matches!(&cli.command, Command::Run(run) if run.view);
    let is_terminal = io::stderr().is_terminal() && !has_pane;
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(|| Lines)
        .with_ansi(is_coloured(std::env::var_os("NO_COLOR").as_deref(), is_terminal))
        .with_target(false)
        .with_filter(wanted.unwrap_or_else(|| Targets::new().with_default(level)));
    tracing_subscriber::registry().with(lines).init();
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
