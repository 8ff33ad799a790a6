//! Long runs: `tests/src/bin/endure` in real time, and `tests/tests/years` in virtual time.

use anyhow::{Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::checks::target_dir;

/// Builds the program and its masters as users do, in release mode, and runs them. With `--years N` it lets each kind
/// of drive live so long in virtual time instead.
pub(crate) fn run(sh: &Shell, options: &[&str]) -> Result<()> {
    if let ["--years", years] = options {
        ensure!(years.parse().is_ok_and(|years: u16| (1..=1_000).contains(&years)), "--years takes 1 to 1000");
        let test = cmd!(sh, "cargo test --profile soak --package drivetwin-tests --test years");
        return Ok(test.env("DRIVETWIN_YEARS", years).run()?);
    }
    if !options.len().is_multiple_of(2) || options.iter().step_by(2).any(|option| !OPTIONS.contains(option)) {
        bail!("endure takes --hours N, --minutes N, --rate R, or --years N alone");
    }
    let (cli, tests) = (["--package", "drivetwin-cli"], ["--package", "drivetwin-tests"]);
    cmd!(sh, "cargo build --release {cli...} {tests...} --bin drivetwin --bin endure").run()?;
    let release = target_dir(sh).join("release");
    let (drivetwin, endure) = (release.join("drivetwin"), release.join("endure"));
    Ok(cmd!(sh, "{endure} {drivetwin} {options...}").run()?)
}

/// Options of a run in real time.
const OPTIONS: [&str; 3] = ["--hours", "--minutes", "--rate"];
