//! What the checks need beside Rust, and how it gets here.
//!
//! Rust's own parts come by rustup, Debian packages by apt-get where this process may install them,
//! Python packages into an environment of their own under `target/`. What cannot be brought is
//! reported in one line, with what to install.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use crate::checks::target_dir;

/// The Cortex-M targets of the boards.
pub(crate) const THUMB_TARGETS: [&str; 3] =
    ["thumbv6m-none-eabi", "thumbv7m-none-eabi", "thumbv7em-none-eabihf"];

/// Something a check needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Tool {
    /// The formatter.
    Rustfmt,
    /// The linter.
    Clippy,
    /// The standard libraries of [`THUMB_TARGETS`].
    ThumbTargets,
    /// Emulates the LM3S6965 board.
    Qemu,
    /// A Modbus master.
    Mbpoll,
    /// Wireshark without its windows.
    Tshark,
    /// Counts instructions for `cargo bench`.
    Valgrind,
    /// Python with `venv`, and in it what `tests/foreign/requirements.txt` names: masters, and what tries the
    /// control API.
    Python,
    /// Node and npm, and in `node_modules` of each of [`PACKAGES`] what its lock file names.
    Node,
}

const ALL: [Tool; 9] = [
    Tool::Rustfmt,
    Tool::Clippy,
    Tool::ThumbTargets,
    Tool::Qemu,
    Tool::Mbpoll,
    Tool::Tshark,
    Tool::Valgrind,
    Tool::Python,
    Tool::Node,
];

/// The tools that could not be brought, each with what to install.
pub(crate) struct Missing(Vec<(Tool, String)>);

impl Missing {
    /// What to install before a check that needs `tools` can run; `None` if they are all here.
    pub(crate) fn of(&self, tools: &[Tool]) -> Option<String> {
        let remedies: Vec<&str> = self
            .0
            .iter()
            .filter(|(tool, _)| tools.contains(tool))
            .map(|(_, remedy)| remedy.as_str())
            .collect();
        (!remedies.is_empty()).then(|| remedies.join("; "))
    }
}

/// Brings every tool that is not here, as far as it may.
pub(crate) fn bring(sh: &Shell) -> Missing {
    bring_only(sh, &ALL)
}

/// Brings those of `tools` that are not here, as far as it may.
pub(crate) fn bring_only(sh: &Shell, tools: &[Tool]) -> Missing {
    let mut apt = Apt { updated: false };
    let mut missing = Vec::new();
    for &tool in tools {
        if tool.is_here(sh) {
            continue;
        }
        println!("bringing {}", tool.name());
        if let Err(error) = tool.install(sh, &mut apt) {
            println!("{error:#}");
        }
        if !tool.is_here(sh) {
            let remedy = format!("{} is missing; install it with `{}`", tool.name(), tool.remedy());
            println!("{remedy}");
            missing.push((tool, remedy));
        }
    }
    Missing(missing)
}

impl Tool {
    fn name(self) -> &'static str {
        match self {
            Self::Rustfmt => "rustfmt",
            Self::Clippy => "clippy",
            Self::ThumbTargets => "Rust for Cortex-M",
            Self::Qemu => "qemu-system-arm",
            Self::Mbpoll => "mbpoll",
            Self::Tshark => "tshark",
            Self::Valgrind => "valgrind",
            Self::Python => "a Python environment for foreign masters and the control API",
            Self::Node => "Node 20 with the emulator of the Pico and foreign masters",
        }
    }

    /// What a person types to get it.
    fn remedy(self) -> &'static str {
        match self {
            Self::Rustfmt => "rustup component add rustfmt",
            Self::Clippy => "rustup component add clippy",
            Self::ThumbTargets => {
                "rustup target add thumbv6m-none-eabi thumbv7m-none-eabi thumbv7em-none-eabihf"
            }
            Self::Qemu => "apt-get install qemu-system-arm",
            Self::Mbpoll => "apt-get install mbpoll",
            Self::Tshark => "apt-get install tshark",
            Self::Valgrind => "apt-get install valgrind",
            Self::Python => "apt-get install python3 python3-venv",
            Self::Node => "apt-get install nodejs npm",
        }
    }

    fn is_here(self, sh: &Shell) -> bool {
        match self {
            Self::Rustfmt => runs(sh, "cargo-fmt"),
            Self::Clippy => runs(sh, "cargo-clippy"),
            Self::ThumbTargets => THUMB_TARGETS.iter().all(|target| has_target(sh, target)),
            Self::Qemu => runs(sh, "qemu-system-arm"),
            Self::Mbpoll => cmd!(sh, "mbpoll -V").quiet().ignore_status().output().is_ok(),
            Self::Tshark => runs(sh, "tshark"),
            Self::Valgrind => runs(sh, "valgrind"),
            Self::Python => environment_is_current(sh),
            Self::Node => has_node(sh) && PACKAGES.iter().all(|folder| is_current(sh, folder)),
        }
    }

    fn install(self, sh: &Shell, apt: &mut Apt) -> Result<()> {
        match self {
            Self::Rustfmt => Ok(cmd!(sh, "rustup component add rustfmt").run()?),
            Self::Clippy => Ok(cmd!(sh, "rustup component add clippy").run()?),
            Self::ThumbTargets => Ok(cmd!(sh, "rustup target add {THUMB_TARGETS...}").run()?),
            Self::Qemu => apt.install(sh, "qemu-system-arm"),
            Self::Mbpoll => apt.install(sh, "mbpoll"),
            Self::Tshark => apt.install(sh, "tshark"),
            Self::Valgrind => apt.install(sh, "valgrind"),
            Self::Python => {
                if cmd!(sh, "python3 -c").arg("import venv, ensurepip").quiet().ignore_stderr().run().is_err()
                {
                    apt.install(sh, "python3")?;
                    apt.install(sh, "python3-venv")?;
                }
                make_environment(sh)
            }
            Self::Node => {
                if !has_node(sh) || !runs(sh, "npm") {
                    apt.install(sh, "nodejs")?;
                    apt.install(sh, "npm")?;
                }
                // Node knows authorities of its own; what the machine trusts is trusted here, too.
                let trusted = std::env::var_os(TRUSTED).unwrap_or_else(|| AUTHORITIES.into());
                for folder in PACKAGES {
                    let install = cmd!(sh, "npm ci --prefix {folder} --no-audit --no-fund");
                    install.env(TRUSTED, &trusted).run()?;
                }
                Ok(())
            }
        }
    }
}

/// Where Node finds more authorities, and where Debian keeps those that the machine trusts.
const TRUSTED: &str = "NODE_EXTRA_CA_CERTS";
const AUTHORITIES: &str = "/etc/ssl/certs/ca-certificates.crt";

/// Whether Node is here, and new enough for the emulator.
fn has_node(sh: &Shell) -> bool {
    let version = cmd!(sh, "node --version").quiet().ignore_stderr().read().unwrap_or_default();
    let major = version.trim_start_matches('v').split('.').next().and_then(|major| major.parse().ok());
    major.is_some_and(|major: u32| major >= 20)
}

/// Whether a program starts and answers.
fn runs(sh: &Shell, program: &str) -> bool {
    cmd!(sh, "{program} --version").quiet().ignore_stdout().ignore_stderr().run().is_ok()
}

/// Whether the core library of a target is installed, with rustup or without.
fn has_target(sh: &Shell, target: &str) -> bool {
    let libraries = cmd!(sh, "rustc --print target-libdir --target {target}").quiet().read();
    libraries.is_ok_and(|path| sh.path_exists(path))
}

/// Debian's packages, where this process may install them.
struct Apt {
    updated: bool,
}

impl Apt {
    fn install(&mut self, sh: &Shell, package: &str) -> Result<()> {
        let root = cmd!(sh, "id -u").quiet().read()? == "0";
        if !root || !runs(sh, "apt-get") {
            bail!("{package} cannot be installed from here");
        }
        if !self.updated {
            cmd!(sh, "apt-get update -q").run()?;
            self.updated = true;
        }
        let quiet = cmd!(sh, "apt-get install -q -y --no-install-recommends {package}");
        Ok(quiet.env("DEBIAN_FRONTEND", "noninteractive").run()?)
    }
}

const REQUIREMENTS: &str = "tests/foreign/requirements.txt";
/// What is installed without what it asks for.
const ALONE: &str = "tests/foreign/requirements-alone.txt";

/// The interpreter of the environment for foreign masters.
pub(crate) fn python(sh: &Shell) -> PathBuf {
    environment(sh).join("bin/python")
}

fn environment(sh: &Shell) -> PathBuf {
    target_dir(sh).join("foreign-masters")
}

/// Whether the environment was made from the requirements as they are.
fn environment_is_current(sh: &Shell) -> bool {
    let made_from = sh.read_file(environment(sh).join("requirements.txt"));
    made_from.is_ok_and(|made_from| requirements(sh).is_ok_and(|wanted| wanted == made_from))
}

/// Both files of requirements.
fn requirements(sh: &Shell) -> Result<String> {
    Ok(sh.read_file(REQUIREMENTS)? + &sh.read_file(ALONE)?)
}

fn make_environment(sh: &Shell) -> Result<()> {
    let environment = environment(sh);
    cmd!(sh, "python3 -m venv --clear {environment}").run()?;
    let python = python(sh);
    cmd!(sh, "{python} -m pip install -q --disable-pip-version-check -r {REQUIREMENTS}").run()?;
    cmd!(sh, "{python} -m pip install -q --disable-pip-version-check --no-deps -r {ALONE}").run()?;
    // Last, so that an installation that broke off is begun again.
    sh.write_file(environment.join("requirements.txt"), requirements(sh)?)
        .with_context(|| format!("cannot finish {}", environment.display()))
}

/// Programs for Node: the emulated Pico, foreign masters.
const PACKAGES: [&str; 2] = ["tests/pico", "tests/foreign/node"];

/// Whether the packages are those of the lock file: npm notes after an installation what it has installed.
fn is_current(sh: &Shell, folder: &str) -> bool {
    let note = sh.read_file(format!("{folder}/node_modules/.package-lock.json"));
    let wanted = sh.read_file(format!("{folder}/package-lock.json"));
    note.is_ok_and(|note| wanted.is_ok_and(|wanted| integrities(&note) == integrities(&wanted)))
}

/// The check sums of the packages in a lock file.
fn integrities(lock: &str) -> Vec<&str> {
    lock.lines().map(str::trim).filter(|line| line.starts_with("\"integrity\"")).collect()
}
