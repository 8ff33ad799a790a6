//! `drivetwin replay`: runs a recording again and shows the first difference.

use std::path::Path;

use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Trace, whole_lines};
use drivetwin_sim::replay as replayer;

use super::print;

/// Replays a recording; returns whether the drives did the same.
///
/// # Errors
/// One sentence: the file cannot be read, or is no trace.
pub(crate) fn replay(file: &Path) -> Result<bool, String> {
    let place = file.display();
    let bytes = std::fs::read(file).map_err(|error| format!("{place}: {error}"))?;
    let (lines, is_cut) = whole_lines(&bytes);
    let text = std::str::from_utf8(lines).map_err(|_| format!("{place} is no text"))?;
    let make = |kind: &str| catalog::make(kind).ok();
    let trace = Trace::parse(text, &make).map_err(|error| format!("{place}: {error}"))?;
    if is_cut {
        print(&format!("{place}: its last line has no end, so it is left out\n"))?;
    }
    match replayer::run(&trace, &make).map_err(|error| format!("{place}: {error}"))? {
        None => print(&format!("{place}: as expected\n")).map(|()| true),
        Some(difference) => print(&format!("{place}: {difference}\n")).map(|()| false),
    }
}
