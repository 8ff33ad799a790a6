//! The references of the drives, `docs/<kind>.md`, generated from their tables.

use anyhow::{Result, ensure};
use xshell::{Shell, cmd};

use crate::board::kinds;
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

/// Builds `drivetwin` and compares the references with what it says.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    build(sh)?;
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
    let reference = |kind: &str| {
        let text = cmd!(sh, "{drivetwin} describe {kind} --markdown").quiet().read()?;
        Ok((format!("docs/{kind}.md"), text + "\n"))
    };
    kinds().into_iter().map(reference).collect()
}
