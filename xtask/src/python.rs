//! The Python package: its wheel, and the tests that run against the installed wheel.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::tools;

/// Packages of the tests, in addition to the wheel.
const REQUIREMENTS: &str = "python/tests/requirements.txt";

/// The tests of the documentation's page for Python, and the packages that it names for them. The first one needs only
/// the wheel and pytest.
const EXAMPLES: &str = "examples/pytest";
const FIRST_EXAMPLE: &str = "examples/pytest/test_axis.py";
const FOR_THE_OTHERS: [&str; 2] = ["pymodbus", "pyserial"];

/// Builds the wheel, installs it in an environment of its own, and runs the tests there. Then runs the examples in an
/// environment that has only what their page says.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let wheel = wheel(sh)?;
    // A board for the tests, in memory.
    cmd!(sh, "cargo build --quiet --package drivetwin-tests --bin virtual-board").run()?;
    let board = target_dir(sh).join("debug/virtual-board");
    let test = |pytest: &Path, tests: &str| {
        let pytest = cmd!(sh, "{pytest} -q -p no:cacheprovider {tests}");
        pytest.env("PYTHONDONTWRITEBYTECODE", "1").env("VIRTUAL_BOARD", &board).run()
    };
    let [pip, pytest] = environment(sh, "python-package")?;
    cmd!(sh, "{pip} install -q --disable-pip-version-check {wheel} -r {REQUIREMENTS}").run()?;
    test(&pytest, "python/tests")?;

    let [pip, pytest] = environment(sh, "python-page")?;
    cmd!(sh, "{pip} install -q --disable-pip-version-check {wheel} pytest").run()?;
    test(&pytest, FIRST_EXAMPLE)?;
    cmd!(sh, "{pip} install -q --disable-pip-version-check {FOR_THE_OTHERS...}").run()?;
    Ok(test(&pytest, EXAMPLES)?)
}

/// Installs the package, and the masters of the examples, in an environment of its own. Returns the path of its pytest.
pub(crate) fn with_masters(sh: &Shell) -> Result<PathBuf> {
    let wheel = wheel(sh)?;
    let [pip, pytest] = environment(sh, "python-board")?;
    cmd!(sh, "{pip} install -q --disable-pip-version-check {wheel} pytest {FOR_THE_OTHERS...}").run()?;
    Ok(pytest)
}

/// Builds the wheel. The profile is that of the other tests, with their overflow checks.
fn wheel(sh: &Shell) -> Result<PathBuf> {
    let wheels = target_dir(sh).join("wheels");
    sh.remove_path(&wheels)?;
    let maturin = tools::python(sh).with_file_name("maturin");
    cmd!(sh, "{maturin} build --quiet --manifest-path python/Cargo.toml --profile dev --out {wheels}")
        .run()?;
    sh.read_dir(&wheels)?.into_iter().next().context("maturin has built no wheel")
}

/// A new environment in a folder of `target`, and its pip and pytest.
fn environment(sh: &Shell, name: &str) -> Result<[PathBuf; 2]> {
    let folder = target_dir(sh).join(name);
    cmd!(sh, "python3 -m venv --clear {folder}").run()?;
    Ok(["pip", "pytest"].map(|program| folder.join("bin").join(program)))
}
