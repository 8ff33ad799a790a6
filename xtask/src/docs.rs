//! The register references in `docs/registers/`, generated from the tables of the drives.

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use crate::checks::{build, standin};

const FOLDER: &str = "docs/registers";

/// Builds `standin` and writes every reference.
pub(crate) fn write(sh: &Shell) -> Result<()> {
    build(sh)?;
    sh.remove_path(FOLDER)?;
    for (path, text) in references(sh)? {
        sh.write_file(&path, text)?;
        println!("{path}");
    }
    Ok(())
}

/// Compares the references with what the built `standin` says.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let references = references(sh)?;
    for (path, text) in &references {
        if sh.read_file(path).ok().as_ref() != Some(text) {
            bail!("{path} is not what the drive says; write it with `cargo xtask docs`");
        }
        println!("{path}");
    }
    for file in sh.read_dir(FOLDER)? {
        let known = references.iter().any(|(path, _)| file.ends_with(path));
        if !known {
            bail!("{} belongs to no drive; remove it", file.display());
        }
    }
    Ok(())
}

/// Path and text of each reference.
fn references(sh: &Shell) -> Result<Vec<(String, String)>> {
    let standin = standin(sh);
    let mut references = Vec::new();
    for kind in kinds(sh)? {
        let text = cmd!(sh, "{standin} describe {kind} --markdown").quiet().read()?;
        references.push((format!("{FOLDER}/{kind}.md"), text + "\n"));
    }
    Ok(references)
}

/// The kinds of drives: the first word of each line of `standin list`.
pub(crate) fn kinds(sh: &Shell) -> Result<Vec<String>> {
    let standin = standin(sh);
    let list = cmd!(sh, "{standin} list").quiet().read().context("cannot list the drives")?;
    let kinds: Vec<String> =
        list.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
    if kinds.is_empty() {
        bail!("`standin list` names no drive");
    }
    Ok(kinds)
}
