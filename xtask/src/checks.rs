//! Everything that must hold.

use std::path::PathBuf;

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use crate::report::Report;
use crate::tools::{self, Tool};
use crate::{board, crates, docs, panic_free, pico, size, swarm};

/// The crates that only a board, or a linker, can build.
const BARE: [&str; 5] =
    ["counted", "panic-free", "drivetwin-lm3s6965", "drivetwin-rp2040", "drivetwin-stm32f4"];

/// Runs every check; whether none failed.
pub(crate) fn all(sh: &Shell) -> Result<bool> {
    let ci = std::env::var("CI").is_ok_and(|ci| ci == "true");
    let mut report = Report::new(sh, tools::bring(sh), ci);

    report.check("format", &[Tool::Rustfmt], |sh| Ok(cmd!(sh, "cargo fmt --all --check").run()?));
    report.check("clippy", &[Tool::Clippy], |sh| {
        let host = bare("--exclude");
        Ok(cmd!(sh, "cargo clippy --workspace {host...} --all-targets -- -D warnings").run()?)
    });
    report.check("clippy for the boards", &[Tool::Clippy, Tool::ThumbTargets], |sh| board::clippy(sh, &BARE));
    report.check("licences and origins of crates", &[], crates::check);
    report.check("rustdoc", &[], |sh| {
        let host = bare("--exclude");
        let doc = cmd!(sh, "cargo doc --workspace {host...} --features drivetwin-board/network --no-deps --document-private-items");
        Ok(doc.env("RUSTDOCFLAGS", "-D warnings").run()?)
    });
    report.check("tests", &[], |sh| {
        let seed = std::env::var("PROPTEST_RNG_SEED").unwrap_or_else(|_| SEED.into());
        Ok(cmd!(sh, "cargo test --no-fail-fast").env("PROPTEST_RNG_SEED", seed).run()?)
    });
    report.check("tests of the tools", &[], |sh| {
        Ok(cmd!(sh, "cargo test --package insncount --package swarm --package xtask").run()?)
    });
    report.check("swarm", &[], swarm::check);
    report.check("build", &[], build);
    report.check("generated documents", &[], docs::check);
    report.check("foreign masters", &[Tool::Python], |sh| {
        let others = [MBPOLL, MODBUS_SERIAL, PCAP, BOARDS].map(|test| ["--ignore", test]).concat();
        pytest(sh, &[&["tests/foreign"], &others[..]].concat())
    });
    report.check("mbpoll", &[Tool::Python, Tool::Mbpoll], |sh| pytest(sh, &[MBPOLL]));
    report.check("modbus-serial", &[Tool::Python, Tool::Node], |sh| pytest(sh, &[MODBUS_SERIAL]));
    report.check("captures", &[Tool::Python, Tool::Tshark], |sh| pytest(sh, &[PCAP]));
    report.check("example of pytest", &[Tool::Python], |sh| pytest(sh, &["examples/pytest"]));
    report.check("no panics on Cortex-M", &[Tool::ThumbTargets], panic_free::check);
    report.check("sizes and counts", &size::NEEDS, size::check);
    report.check("LM3S6965 under QEMU", &[Tool::ThumbTargets, Tool::Qemu], board::run);
    report.check("golden traces on LM3S6965", &[Tool::ThumbTargets, Tool::Qemu], board::golden);
    report.check("emulator of the Pico", &[Tool::Node], pico::check_emulator);
    report.check("emulated Pico", &[Tool::ThumbTargets, Tool::Node], board::pico);
    report.check(
        "foreign masters and the boards",
        &[Tool::ThumbTargets, Tool::Python, Tool::Qemu, Tool::Node],
        |sh| pytest(sh, &[BOARDS]),
    );
    report.check("images that log", &[Tool::ThumbTargets], board::logging);
    Ok(report.finish())
}

/// `flag` before each crate that the host cannot build.
fn bare(flag: &str) -> Vec<&str> {
    BARE.iter().flat_map(|package| [flag, package]).collect()
}

/// Of the cases of the property tests: whether a commit passes depends on it alone. New ones are for
/// [`soak`] and for `cargo test`.
const SEED: &str = "434544";

/// Runs the property tests with `cases` new cases each.
pub(crate) fn soak(sh: &Shell, cases: &str) -> Result<()> {
    let cases: u32 = cases.parse().with_context(|| format!("`{cases}` is no number of cases"))?;
    let soak = cmd!(sh, "cargo test --profile soak --no-fail-fast");
    Ok(soak.env("PROPTEST_CASES", cases.to_string()).run()?)
}

/// Builds the binary as `cargo run --release` does.
pub(crate) fn build(sh: &Shell) -> Result<()> {
    Ok(cmd!(sh, "cargo build --release --bin drivetwin").run()?)
}

const MBPOLL: &str = "tests/foreign/test_mbpoll.py";
const MODBUS_SERIAL: &str = "tests/foreign/test_modbus_serial.py";
const PCAP: &str = "tests/foreign/test_pcap.py";
const BOARDS: &str = "tests/foreign/test_boards.py";

/// Lets masters that we did not write talk to the binary.
fn pytest(sh: &Shell, which: &[&str]) -> Result<()> {
    let python = tools::python(sh);
    let pytest = cmd!(sh, "{python} -B -m pytest -q -p no:cacheprovider {which...}");
    Ok(pytest.env("DRIVETWIN", drivetwin(sh)).run()?)
}

/// The binary as users get it.
pub(crate) fn drivetwin(sh: &Shell) -> PathBuf {
    target_dir(sh).join("release/drivetwin")
}

/// Where cargo builds.
pub(crate) fn target_dir(sh: &Shell) -> PathBuf {
    sh.current_dir().join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()))
}
