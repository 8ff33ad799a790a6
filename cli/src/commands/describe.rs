//! `drivetwin describe`: a kind's ports, pins, registers, and what is not modelled.

use drivetwin_host::describe;
use drivetwin_sim::catalog;

use super::print;

/// Describes kinds of drive: as JSON, as the reference in docs/, or as text.
///
/// # Errors
/// One sentence that says what is wrong: there is no such kind.
pub(crate) fn describe(kinds: &[String], json: bool, markdown: bool) -> Result<(), String> {
    let specs: Vec<_> =
        kinds.iter().map(|kind| Ok(catalog::make(kind)?.spec())).collect::<Result<_, String>>()?;
    print(&match (json, markdown) {
        (true, _) => specs.iter().map(|spec| describe::json(spec) + "\n").collect(),
        (_, true) => describe::markdown(&specs),
        _ => specs.iter().map(|spec| describe::text(spec)).collect::<Vec<_>>().join("\n"),
    })
}
