//! The Python package: its wheel, and the tests that run against the installed wheel.

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::tools;

/// Packages of the tests, in addition to the wheel.
const REQUIREMENTS: &str = "python/tests/requirements.txt";

/// Builds the wheel, installs it in an environment of its own, and runs the tests there. The profile is that of the
/// other tests, with their overflow checks.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    let wheels = target_dir(sh).join("wheels");
    sh.remove_path(&wheels)?;
    let maturin = tools::python(sh).with_file_name("maturin");
    cmd!(sh, "{maturin} build --quiet --manifest-path python/Cargo.toml --profile dev --out {wheels}")
        .run()?;
    let wheel = sh.read_dir(&wheels)?.into_iter().next().context("maturin has built no wheel")?;

    let environment = target_dir(sh).join("python-package");
    cmd!(sh, "python3 -m venv --clear {environment}").run()?;
    let [pip, pytest] = ["pip", "pytest"].map(|program| environment.join("bin").join(program));
    cmd!(sh, "{pip} install -q --disable-pip-version-check {wheel} -r {REQUIREMENTS}").run()?;
    Ok(cmd!(sh, "{pytest} -q -p no:cacheprovider python/tests").env("PYTHONDONTWRITEBYTECODE", "1").run()?)
}
