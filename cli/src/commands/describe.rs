//! `drivetwin describe`: a kind's ports, pins, registers, and what is not modelled.

use drivetwin_host::describe;
use drivetwin_sim::catalog;

use super::print;

/// Describes a kind of drive: as JSON, as the reference in docs/, or as text.
///
/// # Errors
/// One sentence: there is no such kind.
pub(crate) fn describe(kind: &str, json: bool, markdown: bool) -> Result<(), String> {
    let device = catalog::make(kind)?;
    let spec = device.spec();
    print(&match (json, markdown) {
        (true, _) => describe::json(spec) + "\n",
        (_, true) => describe::markdown(spec),
        _ => describe::text(spec),
    })
}
