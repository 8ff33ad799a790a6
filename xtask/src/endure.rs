//! A long run in real time: `tests/src/bin/endure`.

use anyhow::{Result, ensure};
use xshell::{Shell, cmd};

use crate::checks::target_dir;

/// Options of a run, each with a number.
const OPTIONS: [&str; 3] = ["--hours", "--minutes", "--rate"];

/// Builds the program and its masters in release mode, and runs them. They are built together, because a second build
/// would compile the crates of both with other features again.
pub(crate) fn run(sh: &Shell, options: &[&str]) -> Result<()> {
    let is_known =
        |pair: &[&str]| matches!(pair, [option, number] if OPTIONS.contains(option) && is_count(number));
    ensure!(
        options.chunks(2).all(is_known),
        "`endure {}` is not understood; it takes --hours N, --minutes N and --rate R, whole numbers above 0",
        options.join(" ")
    );
    let packages = ["--package", "drivetwin-cli", "--package", "drivetwin-tests"];
    cmd!(sh, "cargo build --release {packages...} --bin drivetwin --bin endure").run()?;
    let release = target_dir(sh).join("release");
    let (drivetwin, endure) = (release.join("drivetwin"), release.join("endure"));
    Ok(cmd!(sh, "{endure} {drivetwin} {options...}").run()?)
}

/// Returns true for a whole number above 0.
fn is_count(word: &str) -> bool {
    word.parse::<u32>().is_ok_and(|number| number > 0)
}
