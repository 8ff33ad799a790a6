//! The link test: the protocol, the shell and each drive, for two Cortex-M, without any panic left.

use anyhow::{Context, Result, bail, ensure};
use xshell::{Cmd, Shell, cmd};

use crate::board::{PROFILE, kinds};
use crate::counted::PROCESSORS;
use crate::image::{Image, Sizes};

/// Function that the panic handler calls and no crate defines.
const UNDEFINED: &str = "a_panic_can_happen";

/// Cargo's profiles in which nothing may panic: what tests build, and what is flashed.
const PROFILES: [&str; 2] = ["release", PROFILE];

/// The programs beside those of the drives.
const PARTS: [&str; 4] = ["protocol", "motion", "counter", "shell"];

/// Links everything, and proves that a panic would not link.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let targets = PROCESSORS.iter().map(|processor| processor.target);
    for (target, profile) in targets.flat_map(|target| PROFILES.map(|profile| (target, profile))) {
        refuses_a_panic(sh, target, profile)?;
        link(sh, target, profile)?;
    }
    Ok(())
}

/// Links every program at once; where a panic is left, the linker says who can reach it.
pub(crate) fn link(sh: &Shell, target: &str, profile: &str) -> Result<()> {
    let kinds = kinds();
    let programs: Vec<String> = PARTS.iter().chain(&kinds).map(|name| format!("proof-{name}")).collect();
    let bins = programs.iter().flat_map(|program| ["--bin", program]);
    let all =
        cmd!(sh, "cargo build --quiet --profile {profile} --package panic-free --target {target} {bins...}");
    if all.run().is_ok() {
        return Ok(());
    }
    let explained = |program: &&str| {
        let link = rustc(sh, target, profile, program).args(["--", "-Clink-arg=--why-live=*panicking*"]);
        link.run().is_err()
    };
    let failing: Vec<&str> = programs.iter().map(String::as_str).filter(explained).collect();
    bail!("{} can panic on {target}, or does not build: see above", failing.join(", "))
}

/// The link must fail, for that one reason, as soon as one panic can happen.
fn refuses_a_panic(sh: &Shell, target: &str, profile: &str) -> Result<()> {
    let link = rustc(sh, target, profile, "proof-motion").args(["--features", "panic"]);
    let output = link.ignore_status().output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(!output.status.success(), "a program that can panic links for {target}: the test proves nothing");
    if !errors.contains(&format!("undefined symbol: {UNDEFINED}")) {
        bail!("a program that can panic fails for another reason:\n{errors}");
    }
    println!("{target}, {profile}: a panic does not link, as it must");
    Ok(())
}

fn rustc<'a>(sh: &'a Shell, target: &str, profile: &str, program: &str) -> Cmd<'a> {
    cmd!(sh, "cargo rustc --quiet --profile {profile} --package panic-free --bin {program} --target {target}")
}

/// Size of a drive without a board, once [`link`] has linked it as it would be flashed.
pub(crate) fn sizes(sh: &Shell, target: &str, kind: &str) -> Result<Sizes> {
    let image = Image::of(sh, target, PROFILE, &format!("proof-{kind}"));
    image.with_context(|| format!("tests/panic-free has no program of {kind}"))?.sizes()
}
