//! `drivetwin list`: the kinds of drive.

use drivetwin_sim::catalog;

use super::print;

/// Lists the kinds of drive.
///
/// # Errors
/// One sentence that says what is wrong: stdout cannot be written.
pub(crate) fn list(json: bool) -> Result<(), String> {
    print(&if json { as_json() } else { as_text() })
}

fn as_json() -> String {
    let kinds = catalog::specs()
        .map(|spec| serde_json::json!({"kind": spec.kind, "product": spec.product, "manual": spec.manual}));
    format!("{}\n", serde_json::Value::from(kinds.collect::<Vec<_>>()))
}

fn as_text() -> String {
    let width = catalog::specs().map(|spec| spec.kind.len()).max().unwrap_or(0);
    catalog::specs()
        .map(|spec| format!("{:<width$}  {}, after {}\n", spec.kind, spec.product, spec.manual))
        .collect()
}
