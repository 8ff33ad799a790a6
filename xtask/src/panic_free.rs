//! The link test: the protocol, the shell and each drive, for two Cortex-M, without any panic left.

use anyhow::{Result, bail, ensure};
use xshell::{Cmd, Shell, cmd};

use crate::board::PROFILE;
use crate::counted::PROCESSORS;
use crate::docs::kinds;

/// What the panic handler calls and nobody defines.
const UNDEFINED: &str = "a_panic_can_happen";

/// Cargo's profiles in which nothing may panic: what tests build, and what is flashed.
const PROFILES: [&str; 2] = ["release", PROFILE];

/// Links everything, and proves that a panic would not link.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let kinds = kinds(sh)?;
    let targets = PROCESSORS.iter().map(|processor| processor.target);
    for (target, profile) in targets.flat_map(|target| PROFILES.map(|profile| (target, profile))) {
        refuses_a_panic(sh, target, profile)?;
        for program in ["protocol", "motion", "counter", "shell"] {
            link(sh, target, profile, program, None)?;
        }
        for kind in &kinds {
            link(sh, target, profile, "drive", Some(kind))?;
        }
    }
    Ok(())
}

/// Links a program; where a panic is left, the linker says who can reach it.
pub(crate) fn link(
    sh: &Shell,
    target: &str,
    profile: &str,
    program: &str,
    drive: Option<&str>,
) -> Result<()> {
    let link = || {
        let link = rustc(sh, target, profile, program);
        drive.into_iter().fold(link, |link, kind| link.env("DRIVE", kind))
    };
    if link().run().is_err() {
        let _ = link().arg("--").arg("-Clink-arg=--why-live=*panicking*").run();
        bail!("{} can panic on {target}, or does not build: see above", drive.unwrap_or(program));
    }
    Ok(())
}

/// The link must fail, for that one reason, as soon as one panic can happen.
fn refuses_a_panic(sh: &Shell, target: &str, profile: &str) -> Result<()> {
    let output =
        rustc(sh, target, profile, "protocol").args(["--features", "panic"]).ignore_status().output()?;
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
