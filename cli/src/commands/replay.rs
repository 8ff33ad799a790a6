//! `drivetwin replay`: runs a recording again and shows the first difference.

use drivetwin_sim::catalog;
use drivetwin_sim::replay as replayer;

use super::{print, read_trace};

/// Replays a recording. Returns whether the drives did the same as in the recording.
///
/// # Errors
/// One sentence that says what is wrong: the file cannot be read or is not a trace.
pub(crate) fn replay(file: &str) -> Result<bool, String> {
    let (name, trace, is_cut) = read_trace(file)?;
    let make = |kind: &str| catalog::make(kind).ok();
    if is_cut {
        print(&format!("{name}: the last line is incomplete and is ignored\n"))?;
    }
    match replayer::run(&trace, &make).map_err(|error| format!("{name}: {error}"))? {
        None => print(&format!("{name}: as expected\n")).map(|()| true),
        Some(difference) => print(&format!("{name}: {difference}\n")).map(|()| false),
    }
}
