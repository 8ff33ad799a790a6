//! The references of the drives, `docs/<kind>.md`, generated from their tables.

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use crate::checks::{build, drivetwin};

/// Builds `drivetwin` and writes every reference.
pub(crate) fn write(sh: &Shell) -> Result<()> {
    build(sh)?;
    for (path, text) in references(sh)? {
        sh.write_file(&path, text)?;
        println!("{path}");
    }
    Ok(())
}

/// Compares the references with what the built `drivetwin` says.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    for (path, text) in references(sh)? {
        let same = sh.read_file(&path).is_ok_and(|written| written == text);
        ensure!(same, "{path} is not what the drive says; write it with `cargo xtask docs`");
        println!("{path}");
    }
    Ok(())
}

/// Path and text of each reference.
fn references(sh: &Shell) -> Result<Vec<(String, String)>> {
    let drivetwin = drivetwin(sh);
    let reference = |kind: String| {
        let text = cmd!(sh, "{drivetwin} describe {kind} --markdown").quiet().read()?;
        Ok((format!("docs/{kind}.md"), text + "\n"))
    };
    kinds(sh)?.into_iter().map(reference).collect()
}

/// The kinds of drives: the first word of each line of `drivetwin list`.
pub(crate) fn kinds(sh: &Shell) -> Result<Vec<String>> {
    let drivetwin = drivetwin(sh);
    let list = cmd!(sh, "{drivetwin} list").quiet().read().context("cannot list the drives")?;
    let kinds: Vec<String> =
        list.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
    ensure!(!kinds.is_empty(), "`drivetwin list` names no drive");
    Ok(kinds)
}
