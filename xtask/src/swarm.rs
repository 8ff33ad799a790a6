//! Random benches that an oracle checks: `tests/swarm`.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use xshell::{Shell, cmd};

use crate::checks::{host, target_dir};

/// Seeds that run for every commit, and the number of seeds of its own that each commit has besides. Only the
/// commit decides whether they pass.
const FIRST: &str = "1";
const COUNT: &str = "200";
const OWN_COUNT: &str = "50";

/// Time limit in seconds for finding a planted defect.
const MOST_SECONDS: &str = "60";

/// Folder of the patches that plant a defect each.
const PLANTED: &str = "tests/swarm/planted";

/// Runs the swarm with the given options.
pub(crate) fn run(sh: &Shell, options: &[&str]) -> Result<()> {
    Ok(cmd!(sh, "cargo run --quiet --profile soak --package swarm -- {options...}").run()?)
}

/// Runs the seeds for a commit. The swarm is built like the tests, because optimising takes longer than it
/// saves. With `--test` cargo selects the features of the crates as for the tests, which have built the
/// crates with these features already.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let host = host();
    cmd!(sh, "cargo build --quiet {host...} --test '*' --bin swarm").run()?;
    let swarm = target_dir(sh).join("debug/swarm");
    cmd!(sh, "{swarm} --first {FIRST} --count {COUNT}").run()?;
    let own = first_of_commit(&cmd!(sh, "git rev-parse HEAD").read()?)?;
    Ok(cmd!(sh, "{swarm} --first {own} --count {OWN_COUNT}").run()?)
}

/// The first seed of a commit: the first twelve digits of its hash.
fn first_of_commit(hash: &str) -> Result<String> {
    let digits = hash.get(..12).with_context(|| format!("{hash:?} is no hash of a commit"))?;
    Ok(u64::from_str_radix(digits, 16)?.to_string())
}

/// Plants each defect of `tests/swarm/planted` (or only the `names` given) in a copy of the last commit, and
/// measures the time until the swarm finds it.
pub(crate) fn planted(sh: &Shell, names: &[&str]) -> Result<()> {
    let root = sh.current_dir();
    let mut patches = sh.read_dir(PLANTED)?;
    patches.retain(|patch| names.is_empty() || names.contains(&name(patch).as_str()));
    patches.sort();
    ensure!(!patches.is_empty(), "{PLANTED} has none of these");
    let (tree, commit) = (root.join("target/planted"), cmd!(sh, "git rev-parse HEAD").read()?);
    if !sh.path_exists(&tree) {
        cmd!(sh, "git worktree add --detach --force {tree} HEAD").run()?;
    }
    let target = root.join("target");
    let rows: Vec<(String, Option<Found>)> = {
        let _there = sh.push_dir(&tree);
        let _target = sh.push_env("CARGO_TARGET_DIR", &target);
        cmd!(sh, "git reset --quiet --hard {commit}").run()?;
        let sound = target.join("soak/swarm-without-defects");
        sh.copy_file(build(sh, &target)?, &sound)?;
        let plant = |patch: &PathBuf| {
            cmd!(sh, "git reset --quiet --hard {commit}").run()?;
            Ok((name(patch), plant(sh, &target, &sound, patch)?))
        };
        patches.iter().map(plant).collect::<Result<_>>()?
    };
    cmd!(sh, "git worktree remove --force {tree}").run()?;
    println!("\n| planted | found after | by |\n|---|---|---|");
    for (name, found) in &rows {
        match found {
            Some(Found { after, said }) => println!("| {name} | {:.1} s | {said} |", after.as_secs_f64()),
            None => println!("| {name} | not in {MOST_SECONDS} s | |"),
        }
    }
    let missed = rows.iter().filter(|(_, found)| found.is_none()).count();
    ensure!(missed == 0, "{missed} planted defects were not found");
    Ok(())
}

/// A defect that was found: the time it took, and the message of the swarm.
struct Found {
    after: Duration,
    said: String,
}

fn name(patch: &Path) -> String {
    patch.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Builds the swarm in the folder of the shell. Crates from outside this repository are built in `target`
/// already.
fn build(sh: &Shell, target: &Path) -> Result<PathBuf> {
    cmd!(sh, "cargo build --quiet --profile soak --package swarm").run()?;
    Ok(target.join("soak/swarm"))
}

/// Applies a patch to the tree in the folder of the shell, which is a clone or has no history. `options` are
/// further options of `git apply`.
///
/// # Errors
/// The patch does not fit: the lines that it changes are no longer as they were.
fn apply(sh: &Shell, patch: &Path, options: &[&str]) -> Result<()> {
    let tree = sh.current_dir();
    let above = tree.parent().unwrap_or(&tree);
    // In a folder below a clone of something else, git would skip all files and report no error.
    let apply = cmd!(sh, "git apply {options...} {patch}").env("GIT_CEILING_DIRECTORIES", above);
    apply.run().with_context(|| format!("{PLANTED}/{}.patch does not fit", name(patch)))
}

/// Applies `patch`, which adds one defect, to the source in the current folder of `sh`, and searches for the defect
/// with the swarm. Returns `None` if the swarm does not find the defect. The program `sound` is the swarm without the
/// defect. If `sound` fails with the same seed, the seed shows another defect; this is an error.
fn plant(sh: &Shell, target: &Path, sound: &Path, patch: &Path) -> Result<Option<Found>> {
    println!("=== {}", name(patch));
    apply(sh, patch, &[])?;
    let swarm = build(sh, target)?;
    let start = now();
    let found = cmd!(sh, "timeout {MOST_SECONDS} {swarm} --first {FIRST} --minutes 1 --until-failure");
    let output = found.quiet().ignore_status().output()?;
    let after = now() - start;
    let text = String::from_utf8_lossy(&output.stdout);
    let said = text.lines().find(|line| line.starts_with("seed "));
    println!("{}", said.unwrap_or("not found"));
    let Some(said) = said else { return Ok(None) };
    let seed = said.trim_start_matches("seed ").split(':').next().unwrap_or_default();
    cmd!(sh, "{sound} --first {seed} --count 1")
        .quiet()
        .ignore_stdout()
        .run()
        .with_context(|| format!("seed {seed} fails without the defect of {}, too", name(patch)))?;
    Ok(Some(Found { after, said: said.chars().take(70).collect() }))
}

#[expect(clippy::disallowed_methods, reason = "how soon a defect is found is a matter of the wall clock")]
fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_commit_has_seeds_of_its_own() {
        let first = first_of_commit("0000000001ff0123456789abcdef0123456789ab");
        assert_eq!(first.expect("a hash"), "511");
        assert!(first_of_commit("HEAD").is_err());
    }

    #[test]
    fn each_planted_patch_fits() {
        let sh = crate::shell().expect("the folder of the workspace");
        let patches = sh.read_dir(PLANTED).expect("a folder");
        let stale: Vec<String> = patches
            .iter()
            .filter_map(|patch| apply(&sh, patch, &["--check"]).err())
            .map(|error| format!("{error:#}"))
            .collect();
        assert!(patches.len() >= 16 && stale.is_empty(), "{} patches; {stale:#?}", patches.len());
    }
}
