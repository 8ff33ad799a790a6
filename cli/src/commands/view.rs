//! `drivetwin view`: shows a bench in the terminal.

use std::os::unix::net::UnixStream;
use std::thread;

use drivetwin_host::Running;
use drivetwin_view::Address;

use super::run::signals;
use crate::log;

/// Shows the bench at an address until a key or a signal ends the view.
///
/// # Errors
/// One sentence: there is no address, or no terminal.
pub(crate) fn view(address: Option<Address>) -> Result<(), String> {
    let address = address.ok_or(
        "an address is missing; `drivetwin run` prints it below `control`: drivetwin view http://127.0.0.1:8080",
    )?;
    let stop = signals().map_err(|error| format!("signals cannot be caught: {error}"))?;
    drivetwin_view::show(&address, None, vec![stop.into()])
}

/// Serves a bench and shows it until a key or a signal ends both, or the bench ends. The view has the terminal, so the
/// banner and the log are in a pane of it.
///
/// # Errors
/// One sentence: that of the bench, or else that of the view.
pub(crate) fn serve(running: Running, stop: UnixStream) -> Result<(), String> {
    let control = running.control().ok_or("--view and --control off: the view needs the control API")?;
    let address: Address = control.parse()?;
    let banner = running.text();
    let pair = || UnixStream::pair().map_err(|error| format!("the view cannot start: {error}"));
    let ((end_bench, bench_ends), (bench_ended, view_ends)) = (pair()?, pair()?);
    let lines = log::to_pane();
    banner.lines().for_each(|line| log::write_line(line.as_bytes()));
    let view = thread::Builder::new().name("view".into()).spawn(move || {
        let shown = drivetwin_view::show(&address, Some(lines), vec![stop.into(), view_ends.into()]);
        // Closing this end ends the bench, too.
        drop(end_bench);
        shown
    });
    let view = view.map_err(|error| format!("the view has no thread: {error}"))?;
    let served = running.serve(&bench_ends);
    // Closing this end ends the view.
    drop(bench_ended);
    served.and(view.join().unwrap_or_else(|_| Err("the view has failed".into())))
}
