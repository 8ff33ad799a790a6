//! The link test: the protocol, the shell and each drive link for two Cortex-M only if no panic is left.

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::board::{PROFILE, bare, kinds};
use crate::counted::{PROCESSORS, Processor};
use crate::image::{Image, Sizes};

/// Function that the panic handler calls and that no crate defines, so that linking fails.
const UNDEFINED: &str = "a_panic_can_happen";

/// Programs other than those of the drives.
const PARTS: [&str; 4] = ["protocol", "motion", "counter", "shell"];

/// Proves that a program with a panic does not link, and links every program with drives that report reasons, as on a
/// bench. No board has these drives, so they are linked for one processor. [`link`] with the features of a board is a
/// part of measuring sizes.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    for Processor { target, .. } in &PROCESSORS {
        refuses_a_panic(sh, target)?;
    }
    let [Processor { target, .. }, ..] = PROCESSORS;
    link(sh, target, &["--features", "panic-free/reasons"])
}

/// Links every program with one command and these options. If a panic is left, the linker prints the callers that can
/// reach it.
pub(crate) fn link(sh: &Shell, target: &'static str, options: &[&str]) -> Result<()> {
    let (bare, kinds) = (bare(target), kinds());
    let programs: Vec<String> = PARTS.iter().chain(&kinds).map(|name| format!("proof-{name}")).collect();
    let bins = programs.iter().flat_map(|program| ["--bin", program]);
    if cmd!(sh, "cargo build --quiet {bare...} {bins...} {options...}").run().is_ok() {
        return Ok(());
    }
    let explained = |program: &&str| {
        let link = cmd!(
            sh,
            "cargo rustc --quiet --profile {PROFILE} --package panic-free --bin {program} --target {target} {options...}"
        );
        link.args(["--", "-Clink-arg=--why-live=*panicking*"]).run().is_err()
    };
    let failing: Vec<&str> = programs.iter().map(String::as_str).filter(explained).collect();
    bail!("{} can panic on {target}, or does not build: see above", failing.join(", "))
}

/// Checks that linking fails for this reason, and no other, as soon as a panic is possible.
fn refuses_a_panic(sh: &Shell, target: &'static str) -> Result<()> {
    let bare = bare(target);
    let link = cmd!(sh, "cargo build --quiet {bare...} --bin proof-motion --features panic-free/panic");
    let output = link.ignore_status().output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(!output.status.success(), "a program that can panic links for {target}: the test proves nothing");
    if !errors.contains(&format!("undefined symbol: {UNDEFINED}")) {
        bail!("a program that can panic fails for another reason:\n{errors}");
    }
    println!("{target}: a panic does not link, as it must");
    Ok(())
}

/// Size of a drive without a board. [`link`] must have linked it, without options.
pub(crate) fn sizes(sh: &Shell, target: &str, kind: &str) -> Result<Sizes> {
    let image = Image::of(sh, target, PROFILE, &format!("proof-{kind}"));
    image.with_context(|| format!("tests/panic-free has no program of {kind}"))?.sizes()
}
