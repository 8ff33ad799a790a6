//! The checks of `cargo xtask test`: everything that must hold.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::{iter, thread};

use anyhow::{Context, Result, anyhow, bail};
use xshell::{Shell, cmd};

use crate::report::{Outcome, Report, Row, now};
use crate::tools::{self, Tool, Tools};
use crate::{board, crates, docs, host_costs, panic_free, pico, python, size, swarm, uf2, web};

/// Crates that only a board, or a linker, can build.
pub(crate) const BARE: [&str; 7] = [
    "counted",
    "panic-free",
    "drivetwin-lm3s6965",
    "drivetwin-pico",
    "drivetwin-rp2040",
    "drivetwin-rp2350",
    "drivetwin-stm32f4",
];

/// Arguments of cargo that select every crate that the host can build, with PNG (HOST-25). They are always the same:
/// with other packages or features cargo may select other features of their dependencies, and build these again.
pub(crate) fn host() -> Vec<&'static str> {
    let bare = BARE.iter().flat_map(|bare| ["--exclude", bare]);
    ["--workspace", "--features", "drivetwin-cli/png"].into_iter().chain(bare).collect()
}

/// Checks that are run together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Group {
    /// Checks that run on the host.
    Host,
    /// Tests of the binary with third-party masters.
    Foreign,
    /// Checks of code for Cortex-M, and tests in emulators.
    Boards,
    /// Checks of the bench: random runs, and other systems.
    Bench,
    /// The Python package.
    Python,
}

const GROUPS: [(&str, Group); 5] = [
    ("host", Group::Host),
    ("foreign", Group::Foreign),
    ("boards", Group::Boards),
    ("bench", Group::Bench),
    ("python", Group::Python),
];

/// Lanes that run at the same time. Cargo locks the folder of a profile while it builds there. The first lane builds in
/// `debug`, the second one in `firmware` and in the folders of the targets.
const LANES: [&[Group]; 2] = [&[Group::Host, Group::Python], &[Group::Boards, Group::Bench]];

/// The group whose checks build nothing that the lanes have not built. A lane that is done takes the next one.
const LAST: Group = Group::Foreign;

struct Check {
    group: Group,
    name: &'static str,
    needs: &'static [Tool],
    run: fn(&Shell) -> Result<()>,
}

const fn check(
    group: Group,
    name: &'static str,
    needs: &'static [Tool],
    run: fn(&Shell) -> Result<()>,
) -> Check {
    Check { group, name, needs, run }
}

/// Every check. The order is that in which the lanes run the checks of their groups.
const CHECKS: [Check; 32] = [
    check(Group::Host, "format", &[Tool::Rustfmt], |sh| Ok(cmd!(sh, "cargo fmt --all --check").run()?)),
    check(Group::Host, "clippy", &[Tool::Clippy], |sh| {
        let host = host();
        Ok(cmd!(sh, "cargo clippy {host...} --all-targets -- -D warnings").run()?)
    }),
    check(Group::Host, "licences and origins of crates", &[], crates::check),
    check(Group::Host, "rustdoc", &[], |sh| {
        let host = host();
        let doc = cmd!(
            sh,
            "cargo doc {host...} --features drivetwin-board/network --no-deps --document-private-items"
        );
        Ok(doc.env("RUSTDOCFLAGS", "-D warnings").run()?)
    }),
    check(Group::Host, "tests", &[], tests),
    check(Group::Host, "build", &[], build),
    check(Group::Host, "generated documents", &[], docs::check),
    check(Group::Foreign, "foreign masters", &[Tool::Python], |sh| {
        let others = [MBPOLL, MODBUS_SERIAL, SER2NET, PARTY, PCAP, VCD, BOARDS, PICO_USB, DOCUMENTS];
        // Four at a time, because most of the time a test waits for a drive's time to pass.
        let side_by_side = ["--numprocesses", "4", "--dist", "worksteal", "tests/foreign"];
        foreign(sh, &[&side_by_side[..], &others.map(|test| ["--ignore", test]).concat()].concat())
    }),
    check(Group::Foreign, "party line", &[Tool::Python], |sh| foreign(sh, &[PARTY])),
    check(Group::Foreign, "mbpoll", &[Tool::Python, Tool::Mbpoll], |sh| foreign(sh, &[MBPOLL])),
    check(Group::Foreign, "commands in documents", &[Tool::Python, Tool::Mbpoll, Tool::Curl], |sh| {
        foreign(sh, &[DOCUMENTS])
    }),
    check(Group::Foreign, "typos", &[Tool::Python], |sh| {
        let typos = tools::python(sh).with_file_name("typos");
        Ok(cmd!(sh, "{typos}").run()?)
    }),
    check(Group::Foreign, "modbus-serial", &[Tool::Python, Tool::Node], |sh| foreign(sh, &[MODBUS_SERIAL])),
    check(Group::Foreign, "ser2net", &[Tool::Python, Tool::Ser2net], |sh| foreign(sh, &[SER2NET])),
    check(Group::Foreign, "panel in Chromium", &[Tool::Node, Tool::Chromium, Tool::WebTarget], panel),
    check(Group::Foreign, "captures", &[Tool::Python, Tool::Tshark], |sh| foreign(sh, &[PCAP])),
    check(Group::Foreign, "waveforms", &[Tool::Python, Tool::Sigrok], |sh| foreign(sh, &[VCD])),
    check(
        Group::Foreign,
        "emulated Pico at its USB cable",
        &[Tool::ThumbTargets, Tool::Python, Tool::Node],
        pico_usb,
    ),
    check(Group::Boards, "clippy for the boards", &[Tool::Clippy, Tool::ThumbTargets], board::clippy),
    check(Group::Boards, "no panics on Cortex-M", &[Tool::ThumbTargets], panic_free::check),
    check(Group::Boards, "sizes and counts", &size::NEEDS, size::check),
    check(Group::Boards, "images that log", &[Tool::ThumbTargets], board::logging),
    check(Group::Boards, "LM3S6965 under QEMU", &[Tool::ThumbTargets, Tool::Qemu], board::run),
    check(Group::Boards, "golden traces on LM3S6965", &[Tool::ThumbTargets, Tool::Qemu], board::golden),
    check(Group::Boards, "emulator of the Pico", &[Tool::Node], pico::check_emulator),
    check(Group::Boards, "emulated Pico", &[Tool::ThumbTargets, Tool::Node], board::pico),
    check(
        Group::Boards,
        "foreign masters and the boards",
        &[Tool::ThumbTargets, Tool::Python, Tool::Qemu, Tool::Node],
        |sh| pytest(sh, &[BOARDS]),
    ),
    check(Group::Bench, "bench on other systems", &[Tool::OtherSystems], other_systems),
    check(Group::Bench, "size of the site", &[Tool::WebTarget], |sh| web::build(sh).map(|_| ())),
    check(Group::Bench, "swarm", &[], swarm::check),
    check(Group::Bench, "costs of the bench", &[Tool::Valgrind], host_costs::check),
    check(Group::Python, "Python package", &[Tool::Python], python::check),
];

/// Runs the checks of these groups, or of all groups if there are none. Returns whether no check failed.
pub(crate) fn run(groups: &[&str]) -> Result<bool> {
    let groups = chosen(groups)?;
    // In continuous integration a missing tool is a failure; elsewhere the check is skipped.
    let ci = std::env::var("CI").is_ok_and(|ci| ci == "true");
    let this = std::env::current_exe()?;
    let (report, tools) = (Report::new(), Tools::default());
    let of_groups = |lane: &'static [Group]| {
        let groups = &groups;
        let wanted = move |check: &Check| lane.contains(&check.group) && groups.contains(&check.group);
        CHECKS.iter().enumerate().filter(move |(_, check)| wanted(check))
    };
    let last = Mutex::new(of_groups(&[LAST]));
    let run = |lane: &'static [Group]| {
        let sh = crate::shell()?;
        let shared = || last.lock().ok()?.next();
        for (place, check) in of_groups(lane).chain(iter::from_fn(shared)) {
            let name = check.name;
            let missing = tools.missing(&sh, check.needs);
            report.begin(name);
            let start = now();
            let (output, outcome) = match missing {
                Some(remedy) if ci => (String::new(), Outcome::Failed(remedy)),
                Some(remedy) => (String::new(), Outcome::Skipped(remedy)),
                None => run_apart(&sh, &this, name)?,
            };
            report.end(&output, Row { place, name, took: now() - start, outcome });
        }
        anyhow::Ok(())
    };
    thread::scope(|scope| {
        let lanes = LANES.map(|lane| scope.spawn(|| run(lane)));
        lanes.into_iter().try_for_each(|lane| lane.join().map_err(|_| anyhow!("a lane broke off"))?)
    })?;
    Ok(report.finish())
}

/// The groups with these names, or all groups if there are no names.
fn chosen(names: &[&str]) -> Result<Vec<Group>> {
    let named = |name: &&str| {
        let group = GROUPS.iter().find(|(known, _)| known == name).map(|(_, group)| *group);
        group.with_context(|| {
            format!("there is no group `{name}`; there are: {}", GROUPS.map(|(name, _)| name).join(", "))
        })
    };
    if names.is_empty() {
        return Ok(GROUPS.map(|(_, group)| group).to_vec());
    }
    names.iter().map(named).collect()
}

/// Runs a check in a process of its own and collects its output.
fn run_apart(sh: &Shell, this: &Path, name: &str) -> Result<(String, Outcome)> {
    let folder = sh.create_temp_dir()?;
    let path = folder.path().join("output");
    let file = File::create(&path)?;
    let mut check = Command::new(this);
    check.args(["check", name]).current_dir(sh.current_dir());
    let status = check.stdin(Stdio::null()).stderr(file.try_clone()?).stdout(file).status()?;
    let output = String::from_utf8_lossy(&std::fs::read(&path)?).into_owned();
    if status.success() {
        return Ok((output, Outcome::Passed));
    }
    let (output, why) = reason(&output);
    Ok((output.to_owned(), Outcome::Failed(why.to_owned())))
}

/// Splits the output of a failed check into the text and the reason, which is the last line.
fn reason(output: &str) -> (&str, &str) {
    match output.rfind("error: ") {
        Some(begin) if begin == 0 || output[..begin].ends_with('\n') => {
            (&output[..begin], output[begin..].trim_start_matches("error: ").trim_end())
        }
        _ => (output, "it broke off"),
    }
}

/// Runs one check in this process. [`run_apart`] calls this through the command line.
pub(crate) fn run_one(sh: &Shell, name: &str) -> Result<()> {
    let check = CHECKS.iter().find(|check| check.name == name).with_context(|| {
        format!(
            "there is no check `{name}`; there are: {}",
            CHECKS.each_ref().map(|check| check.name).join(", ")
        )
    })?;
    (check.run)(sh)
}

/// Seed of the property tests' cases. With a fixed seed only the commit decides whether they pass. New cases
/// are for [`soak`] and for `cargo test`.
const SEED: &str = "434544";

/// Tests of the process that mostly wait for it. They run apart, with more threads than cores: beside them, the system
/// hands over the bytes of a pty some ms late (HOST-2), and tests of ptys fail.
const WAITING: [&str; 3] = ["ceilings::", "scale::", "machinery::"];

/// Runs every test of the host. Optimising pays for the drives and the bench when whole drives are tested, because
/// these tests run long. The unit tests of the drives and the bench take longer to optimise than to run.
fn tests(sh: &Shell) -> Result<()> {
    let seed = std::env::var("PROPTEST_RNG_SEED").unwrap_or_else(|_| SEED.into());
    let host = &host();
    let plain = ["protocol", "firmware", "sim"]
        .map(|name| format!("--config=profile.dev.package.drivetwin-{name}.opt-level=0"));
    let apart = WAITING.iter().flat_map(|module| ["--skip", module]);
    let tests = [
        cmd!(sh, "cargo test {host...} --no-fail-fast --lib {plain...}"),
        cmd!(sh, "cargo test {host...} --no-fail-fast --bins --test '*' -- {apart...}"),
        cmd!(sh, "cargo test {host...} --no-fail-fast --test program -- {WAITING...} --test-threads 8"),
        cmd!(sh, "cargo test {host...} --no-fail-fast --doc"),
    ];
    // Each test command runs, even if another one fails.
    let results = tests.map(|test| test.env("PROPTEST_RNG_SEED", &seed).run());
    results.into_iter().try_for_each(|result| Ok(result?))
}

/// Runs the property tests with `cases` new cases each.
pub(crate) fn soak(sh: &Shell, cases: &str) -> Result<()> {
    let cases: u32 = cases.parse().with_context(|| format!("`{cases}` is no number of cases"))?;
    let soak = cmd!(sh, "cargo test --profile soak --no-fail-fast");
    Ok(soak.env("PROPTEST_CASES", cases.to_string()).run()?)
}

/// Checks that the bench builds for systems other than this one, all with one command. The profile is that of the
/// lane, so that no lane waits for the other's builds.
fn other_systems(sh: &Shell) -> Result<()> {
    let targets = tools::OTHER_SYSTEMS.iter().flat_map(|target| ["--target", target]);
    Ok(cmd!(sh, "cargo check --profile firmware --package drivetwin-sim {targets...}").run()?)
}

/// Builds the binary like `cargo test`: with overflow checks, and without building again what the tests have
/// built.
pub(crate) fn build(sh: &Shell) -> Result<()> {
    let host = host();
    Ok(cmd!(sh, "cargo build {host...} --test '*' --bin drivetwin --bin own-drive").run()?)
}

const MBPOLL: &str = "tests/foreign/test_mbpoll.py";
const MODBUS_SERIAL: &str = "tests/foreign/test_modbus_serial.py";
const SER2NET: &str = "tests/foreign/test_ser2net.py";
/// A test that must run alone, because its client takes the first piece of a reply for the whole reply.
const PARTY: &str = "tests/foreign/test_mdrive_party.py";
const PCAP: &str = "tests/foreign/test_pcap.py";
const VCD: &str = "tests/foreign/test_vcd.py";
const BOARDS: &str = "tests/foreign/test_boards.py";
const PICO_USB: &str = "tests/foreign/test_pico_usb.py";
const DOCUMENTS: &str = "tests/foreign/test_documents.py";

/// Builds the binary and tests it with third-party masters.
fn foreign(sh: &Shell, which: &[&str]) -> Result<()> {
    build(sh)?;
    pytest(sh, which)
}

/// Tests `drivetwin attach` and the Python package with an emulated Pico: with the images of single kinds, and with the
/// UF2.
fn pico_usb(sh: &Shell) -> Result<()> {
    board::RP2040.all(sh)?;
    uf2::write(sh, &uf2::PICO)?;
    let package = python::with_masters(sh)?;
    let _with_package = sh.push_env("DRIVETWIN_PYTEST", package);
    foreign(sh, &[PICO_USB])
}

/// Uses the panel of a process, and that of the static site, in a browser as a person would.
fn panel(sh: &Shell) -> Result<()> {
    build(sh)?;
    let site = web::write(sh)?.folder;
    let test = cmd!(sh, "npm test --prefix tests/page --silent");
    Ok(test.env("DRIVETWIN", drivetwin(sh)).env("SITE", site).run()?)
}

/// Writes the pictures of the documents.
pub(crate) fn pictures(sh: &Shell) -> Result<()> {
    if let Some(remedy) = Tools::default().missing(sh, &[Tool::Node, Tool::Chromium, Tool::WebTarget]) {
        bail!("{remedy}");
    }
    build(sh)?;
    let site = web::write(sh)?.folder;
    let pictures = cmd!(sh, "node tests/page/pictures.mjs docs/pictures");
    Ok(pictures.env("DRIVETWIN", drivetwin(sh)).env("SITE", site).run()?)
}

fn pytest(sh: &Shell, which: &[&str]) -> Result<()> {
    let python = tools::python(sh);
    // Four at a time, because most of the time a test waits for a drive's time to pass.
    let pytest =
        cmd!(sh, "{python} -B -m pytest -q -p no:cacheprovider --numprocesses 4 --dist worksteal {which...}");
    Ok(pytest.env("DRIVETWIN", drivetwin(sh)).run()?)
}

/// Path of the binary.
pub(crate) fn drivetwin(sh: &Shell) -> PathBuf {
    target_dir(sh).join("debug/drivetwin")
}

/// Folder in which cargo builds.
pub(crate) fn target_dir(sh: &Shell) -> PathBuf {
    sh.current_dir().join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_have_names() {
        assert_eq!(chosen(&[]).expect("all"), GROUPS.map(|(_, group)| group));
        assert_eq!(chosen(&["boards"]).expect("one"), [Group::Boards]);
        assert_eq!(
            chosen(&["host", "nowhere"]).expect_err("no such group").to_string(),
            "there is no group `nowhere`; there are: host, foreign, boards, bench, python"
        );
    }

    #[test]
    fn each_group_is_in_one_lane_or_the_last() {
        let last: &[Group] = &[LAST];
        for (name, group) in GROUPS {
            let places = LANES.iter().chain([&last]).filter(|lane| lane.contains(&group));
            assert_eq!(places.count(), 1, "{name}");
            assert!(CHECKS.iter().any(|check| check.group == group), "{name}");
        }
    }

    #[test]
    fn a_check_says_last_why_it_failed() {
        assert_eq!(
            reason("$ cargo\nerror: no\nerror: 2 are\n  wrong\n"),
            ("$ cargo\nerror: no\n", "2 are\n  wrong")
        );
        assert_eq!(reason("error: no\n"), ("", "no"));
        assert_eq!(reason("an error: no\n"), ("an error: no\n", "it broke off"));
        assert_eq!(reason(""), ("", "it broke off"));
    }
}
