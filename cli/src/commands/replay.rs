//! `drivetwin replay`: runs a recording again and shows the first difference.

use std::path::Path;

use drivetwin_sim::catalog;
use drivetwin_sim::replay as replayer;

use super::{print, trace};

/// Replays a recording. Returns whether the drives did the same as in the recording.
///
/// # Errors
/// One sentence that says what is wrong: the file cannot be read or is not a trace.
pub(crate) fn replay(file: &Path) -> Result<bool, String> {
    let path = file.display();
    let bytes = std::fs::read(file).map_err(|error| format!("{path}: {error}"))?;
    let (trace, is_cut) = trace(&path.to_string(), &bytes)?;
    let make = |kind: &str| catalog::make(kind).ok();
    if is_cut {
        print(&format!("{path}: the last line is incomplete and is ignored\n"))?;
    }
    match replayer::run(&trace, &make).map_err(|error| format!("{path}: {error}"))? {
        None => print(&format!("{path}: as expected\n")).map(|()| true),
        Some(difference) => print(&format!("{path}: {difference}\n")).map(|()| false),
    }
}
