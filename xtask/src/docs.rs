//! The generated pages of `docs/reference`: of the drives, from their tables, and of the command line.

use std::collections::BTreeSet;

use anyhow::{Result, ensure};
use xshell::{Shell, cmd};

use crate::board::kinds;
use crate::checks::{build, drivetwin};

/// Pages about drives, with the kinds on each page.
const PAGES: [(&str, &[&str]); 5] = [
    ("md3", &["md3", "md3-low"]),
    ("qsb", &["qsb-d", "qsb-m", "qsb-s"]),
    ("rs434", &["rs434544", "rs434546"]),
    ("mdrobot", &["mdrobot"]),
    ("mdrive", &["mdrive", "mdrive-hybrid"]),
];

/// Builds `drivetwin` and writes every generated page.
pub(crate) fn write(sh: &Shell) -> Result<()> {
    build(sh)?;
    for (path, text) in references(sh)? {
        sh.write_file(&path, text)?;
        println!("{path}");
    }
    Ok(())
}

/// Builds `drivetwin` and compares the committed pages with its output.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    build(sh)?;
    for (path, text) in references(sh)? {
        let same = sh.read_file(&path).is_ok_and(|written| written == text);
        ensure!(same, "{path} is not what the program says; write it with `cargo xtask docs`");
        println!("{path}");
    }
    Ok(())
}

/// Path and text of each generated page.
fn references(sh: &Shell) -> Result<Vec<(String, String)>> {
    let drivetwin = drivetwin(sh);
    let mut pages =
        vec![("docs/reference/cli.md".to_owned(), cmd!(sh, "{drivetwin} reference").quiet().read()? + "\n")];
    for (page, kinds) in PAGES {
        let text = cmd!(sh, "{drivetwin} describe {kinds...} --markdown").quiet().read()?;
        pages.push((format!("docs/reference/{page}.md"), text + "\n"));
    }
    let on_pages: BTreeSet<&str> = PAGES.iter().flat_map(|(_, kinds)| *kinds).copied().collect();
    let missing: Vec<&str> = kinds().into_iter().filter(|kind| !on_pages.contains(kind)).collect();
    ensure!(missing.is_empty(), "no page has {}; add it to PAGES in xtask/src/docs.rs", missing.join(", "));
    Ok(pages)
}
