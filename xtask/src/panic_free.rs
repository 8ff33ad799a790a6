//! The link test: the protocol, the shell and each drive, for two Cortex-M, without any panic left.

use anyhow::{Result, bail, ensure};
use xshell::{Cmd, Shell, cmd};

use crate::docs::kinds;
use crate::image::{self, Image};
use crate::tools::THUMB_TARGETS;

/// What the panic handler calls and nobody defines.
const UNDEFINED: &str = "a_panic_can_happen";

/// Links everything, proves that a panic would not link, and prints sizes.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let kinds = kinds(sh)?;
    let mut table = image::head();
    for target in THUMB_TARGETS {
        refuses_a_panic(sh, target)?;
        for program in ["protocol", "motion", "shell"] {
            link(sh, target, program, None)?;
            table += &image::row(program, target, Image::of(sh, target, program)?.sizes()?);
        }
        for kind in &kinds {
            link(sh, target, "drive", Some(kind))?;
            table += &image::row(kind, target, Image::of(sh, target, "drive")?.sizes()?);
        }
    }
    print!("{table}");
    Ok(())
}

/// Links a program; where a panic is left, the linker says who can reach it.
fn link(sh: &Shell, target: &str, program: &str, drive: Option<&str>) -> Result<()> {
    let link = || {
        let link = rustc(sh, target, program);
        drive.into_iter().fold(link, |link, kind| link.env("DRIVE", kind))
    };
    if link().run().is_err() {
        let _ = link().arg("--").arg("-Clink-arg=--why-live=*panicking*").run();
        bail!("{} can panic on {target}, or does not build: see above", drive.unwrap_or(program));
    }
    Ok(())
}

/// The link must fail, for that one reason, as soon as one panic can happen.
fn refuses_a_panic(sh: &Shell, target: &str) -> Result<()> {
    let output = rustc(sh, target, "protocol").args(["--features", "panic"]).ignore_status().output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(!output.status.success(), "a program that can panic links for {target}: the test proves nothing");
    if !errors.contains(&format!("undefined symbol: {UNDEFINED}")) {
        bail!("a program that can panic fails for another reason:\n{errors}");
    }
    println!("{target}: a panic does not link, as it must");
    Ok(())
}

fn rustc<'a>(sh: &'a Shell, target: &str, program: &str) -> Cmd<'a> {
    cmd!(sh, "cargo rustc --release --package panic-free --bin {program} --target {target}")
}
