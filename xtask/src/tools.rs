//! Tools that the checks need in addition to Rust, and their installation.
//!
//! rustup installs Rust's own components. apt-get installs Debian packages, if this process may do so and no
//! other package is removed for them. Python packages go into an environment of their own under `target/`. A
//! tool that cannot be installed is reported in one text line, with the command to install it.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use xshell::{Cmd, Shell, cmd};

use crate::checks::target_dir;
use crate::{counted, web};

/// The Cortex-M targets of the boards.
pub(crate) const THUMB_TARGETS: [&str; 4] =
    ["thumbv6m-none-eabi", "thumbv7m-none-eabi", "thumbv7em-none-eabihf", "thumbv8m.main-none-eabi"];

/// Other systems that the bench builds for: a browser, Windows, macOS.
pub(crate) const OTHER_SYSTEMS: [&str; 3] =
    ["wasm32-unknown-unknown", "x86_64-pc-windows-msvc", "aarch64-apple-darwin"];

/// A tool that a check needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Tool {
    /// The formatter.
    Rustfmt,
    /// The linter.
    Clippy,
    /// The standard libraries of [`THUMB_TARGETS`].
    ThumbTargets,
    /// The standard libraries of [`OTHER_SYSTEMS`].
    OtherSystems,
    /// The standard library of a browser, one of [`OTHER_SYSTEMS`].
    WebTarget,
    /// Emulates the LM3S6965 board.
    Qemu,
    /// A QEMU that takes the plugin that counts instructions.
    Counting,
    /// Counts instructions and bytes of programs of this machine.
    Valgrind,
    /// A Modbus master.
    Mbpoll,
    /// A server of serial ports, which is also a client of remote ones.
    Ser2net,
    /// Calls the control API, as the documents do.
    Curl,
    /// Wireshark for the command line.
    Tshark,
    /// sigrok for the command line.
    Sigrok,
    /// A browser without a window.
    Chromium,
    /// Python with `venv`. The environment has the packages of `tests/foreign/requirements.txt`: masters, and
    /// programs that test the control API.
    Python,
    /// Node and npm. Each folder of [`PACKAGES`] has the packages of its lock file in `node_modules`.
    Node,
}

/// Tools that the checks of a run have requested so far.
#[derive(Default)]
pub(crate) struct Tools(Mutex<State>);

#[derive(Default)]
struct State {
    apt: Apt,
    /// Each requested tool. If it is missing and could not be installed: how to install it by hand.
    known: Vec<(Tool, Option<String>)>,
}

impl Tools {
    /// Installs the tools that are missing, as far as allowed. Returns how to install by hand the tools that
    /// are still missing; `None` if all are present. Concurrent calls wait.
    pub(crate) fn missing(&self, sh: &Shell, tools: &[Tool]) -> Option<String> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let remedies: Vec<String> = tools.iter().filter_map(|tool| state.remedy(sh, *tool)).collect();
        (!remedies.is_empty()).then(|| remedies.join("; "))
    }
}

impl State {
    fn remedy(&mut self, sh: &Shell, tool: Tool) -> Option<String> {
        if let Some((_, remedy)) = self.known.iter().find(|(known, _)| *known == tool) {
            return remedy.clone();
        }
        let remedy = tool.bring(sh, &mut self.apt);
        self.known.push((tool, remedy.clone()));
        remedy
    }
}

impl Tool {
    /// Installs the tool if it is missing. If that fails, returns how to install it by hand.
    fn bring(self, sh: &Shell, apt: &mut Apt) -> Option<String> {
        if self.is_here(sh) {
            return None;
        }
        println!("bringing {}", self.name());
        if let Err(error) = self.install(sh, apt) {
            println!("{error:#}");
        }
        if self.is_here(sh) {
            return None;
        }
        let remedy = format!("{} is missing; install it with `{}`", self.name(), self.remedy());
        println!("{remedy}");
        Some(remedy)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Rustfmt => "rustfmt",
            Self::Clippy => "clippy",
            Self::ThumbTargets => "Rust for Cortex-M",
            Self::OtherSystems => "Rust for WebAssembly, Windows and macOS",
            Self::WebTarget => "Rust for WebAssembly",
            Self::Qemu => "qemu-system-arm",
            Self::Counting => "QEMU 6 to 10, whose interface for counting instructions is known,",
            Self::Valgrind => "valgrind",
            Self::Mbpoll => "mbpoll",
            Self::Ser2net => "ser2net",
            Self::Curl => "curl",
            Self::Tshark => "tshark",
            Self::Sigrok => "sigrok-cli",
            Self::Chromium => "Chromium",
            Self::Python => "a Python environment for foreign masters and the control API",
            Self::Node => "Node 20 with the emulator of the Pico, foreign masters and a driver of browsers",
        }
    }

    /// Command to install the tool by hand.
    fn remedy(self) -> &'static str {
        match self {
            Self::Rustfmt => "rustup component add rustfmt",
            Self::Clippy => "rustup component add clippy",
            Self::ThumbTargets => {
                "rustup target add thumbv6m-none-eabi thumbv7m-none-eabi thumbv7em-none-eabihf thumbv8m.main-none-eabi"
            }
            Self::OtherSystems => {
                "rustup target add wasm32-unknown-unknown x86_64-pc-windows-msvc aarch64-apple-darwin"
            }
            Self::WebTarget => "rustup target add wasm32-unknown-unknown",
            Self::Qemu | Self::Counting => "apt-get install qemu-system-arm",
            Self::Valgrind => "apt-get install valgrind",
            Self::Mbpoll => "apt-get install mbpoll",
            Self::Ser2net => "apt-get install ser2net",
            Self::Curl => "apt-get install curl",
            Self::Tshark => "apt-get install tshark",
            Self::Sigrok => "apt-get install sigrok-cli",
            Self::Chromium => "apt-get install chromium",
            Self::Python => "apt-get install python3 python3-venv",
            Self::Node => "apt-get install nodejs npm",
        }
    }

    fn is_here(self, sh: &Shell) -> bool {
        match self {
            Self::Rustfmt => runs(sh, "cargo-fmt"),
            Self::Clippy => runs(sh, "cargo-clippy"),
            Self::ThumbTargets => THUMB_TARGETS.iter().all(|target| has_target(sh, target)),
            Self::OtherSystems => OTHER_SYSTEMS.iter().all(|target| has_target(sh, target)),
            Self::WebTarget => has_target(sh, web::TARGET),
            Self::Qemu => runs(sh, "qemu-system-arm"),
            Self::Counting => counted::takes_plugin(sh),
            Self::Valgrind => runs(sh, "valgrind"),
            Self::Mbpoll => cmd!(sh, "mbpoll -V").quiet().ignore_status().output().is_ok(),
            Self::Ser2net => cmd!(sh, "ser2net -v").quiet().ignore_stdout().ignore_stderr().run().is_ok(),
            Self::Curl => runs(sh, "curl"),
            Self::Tshark => runs(sh, "tshark"),
            Self::Sigrok => runs(sh, "sigrok-cli"),
            Self::Chromium => runs(sh, "chromium"),
            Self::Python => environment_is_current(sh),
            Self::Node => has_node(sh) && PACKAGES.iter().all(|folder| is_current(sh, folder)),
        }
    }

    fn install(self, sh: &Shell, apt: &mut Apt) -> Result<()> {
        match self {
            Self::Rustfmt => quietly(cmd!(sh, "rustup component add rustfmt")),
            Self::Clippy => quietly(cmd!(sh, "rustup component add clippy")),
            Self::ThumbTargets => quietly(cmd!(sh, "rustup target add {THUMB_TARGETS...}")),
            Self::OtherSystems => quietly(cmd!(sh, "rustup target add {OTHER_SYSTEMS...}")),
            Self::WebTarget => {
                let target = web::TARGET;
                quietly(cmd!(sh, "rustup target add {target}"))
            }
            Self::Counting if runs(sh, "qemu-system-arm") => bail!("the QEMU that is here is another"),
            Self::Qemu | Self::Counting => apt.install(sh, "qemu-system-arm"),
            Self::Valgrind => apt.install(sh, "valgrind"),
            Self::Mbpoll => apt.install(sh, "mbpoll"),
            Self::Ser2net => apt.install(sh, "ser2net"),
            Self::Curl => apt.install(sh, "curl"),
            Self::Tshark => apt.install(sh, "tshark"),
            Self::Sigrok => apt.install(sh, "sigrok-cli"),
            Self::Chromium => apt.install(sh, "chromium"),
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
                // Node has its own list of certificate authorities. Those that the machine trusts are added.
                let trusted = std::env::var_os(TRUSTED).unwrap_or_else(|| AUTHORITIES.into());
                for folder in PACKAGES {
                    let install = cmd!(sh, "npm ci --prefix {folder} --no-audit --no-fund");
                    quietly(install.env(TRUSTED, &trusted))?;
                }
                Ok(())
            }
        }
    }
}

/// Variable that names further certificate authorities to Node, and Debian's file of the authorities that the
/// machine trusts.
const TRUSTED: &str = "NODE_EXTRA_CA_CERTS";
const AUTHORITIES: &str = "/etc/ssl/certs/ca-certificates.crt";

/// Returns whether Node is installed and new enough for the emulator.
fn has_node(sh: &Shell) -> bool {
    let version = cmd!(sh, "node --version").quiet().ignore_stderr().read().unwrap_or_default();
    let major = version.trim_start_matches('v').split('.').next().and_then(|major| major.parse().ok());
    major.is_some_and(|major: u32| major >= 20)
}

/// Returns whether a program starts and reports its version.
fn runs(sh: &Shell, program: &str) -> bool {
    cmd!(sh, "{program} --version").quiet().ignore_stdout().ignore_stderr().run().is_ok()
}

/// Returns whether the core library of a target is installed, by rustup or otherwise.
fn has_target(sh: &Shell, target: &str) -> bool {
    let libraries = cmd!(sh, "rustc --print target-libdir --target {target}").quiet().read();
    libraries.is_ok_and(|path| sh.path_exists(path))
}

/// Runs a command and shows its output only if it fails, because another check may print at the same time.
fn quietly(command: Cmd<'_>) -> Result<()> {
    let said = command.to_string();
    let output = command.quiet().ignore_status().output()?;
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    ensure!(output.status.success(), "`{said}` fails:\n{out}{err}");
    Ok(())
}

/// Installs Debian packages, where this process may do that. No package is removed for another.
#[derive(Default)]
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
            quietly(cmd!(sh, "apt-get update -q"))?;
            self.updated = true;
        }
        let install = cmd!(sh, "apt-get install -q -y --no-remove --no-install-recommends {package}");
        quietly(install.env("DEBIAN_FRONTEND", "noninteractive"))
    }
}

const REQUIREMENTS: &str = "tests/foreign/requirements.txt";
/// Packages that are installed without their dependencies.
const ALONE: &str = "tests/foreign/requirements-alone.txt";

/// Python interpreter of the environment for third-party masters.
pub(crate) fn python(sh: &Shell) -> PathBuf {
    environment(sh).join("bin/python")
}

fn environment(sh: &Shell) -> PathBuf {
    target_dir(sh).join("foreign-masters")
}

/// Returns whether the environment was made from the present requirements.
fn environment_is_current(sh: &Shell) -> bool {
    let made_from = sh.read_file(environment(sh).join("requirements.txt"));
    made_from.is_ok_and(|made_from| requirements(sh).is_ok_and(|wanted| wanted == made_from))
}

/// The text of both requirements files.
fn requirements(sh: &Shell) -> Result<String> {
    Ok(sh.read_file(REQUIREMENTS)? + &sh.read_file(ALONE)?)
}

fn make_environment(sh: &Shell) -> Result<()> {
    let environment = environment(sh);
    quietly(cmd!(sh, "python3 -m venv --clear {environment}"))?;
    let python = python(sh);
    quietly(cmd!(sh, "{python} -m pip install -q --disable-pip-version-check -r {REQUIREMENTS}"))?;
    quietly(cmd!(sh, "{python} -m pip install -q --disable-pip-version-check --no-deps -r {ALONE}"))?;
    // Written last, so that an interrupted installation is repeated.
    sh.write_file(environment.join("requirements.txt"), requirements(sh)?)
        .with_context(|| format!("cannot finish {}", environment.display()))
}

/// Folders of programs for Node: the emulated Pico, third-party masters, and what drives a browser.
const PACKAGES: [&str; 3] = ["tests/pico", "tests/foreign/node", "tests/page"];

/// Returns whether the installed packages are those of the lock file. npm writes a list of the packages that
/// it has installed.
fn is_current(sh: &Shell, folder: &str) -> bool {
    let note = sh.read_file(format!("{folder}/node_modules/.package-lock.json"));
    let wanted = sh.read_file(format!("{folder}/package-lock.json"));
    note.is_ok_and(|note| wanted.is_ok_and(|wanted| integrities(&note) == integrities(&wanted)))
}

/// The checksums of the packages in a lock file.
fn integrities(lock: &str) -> Vec<&str> {
    lock.lines().map(str::trim).filter(|line| line.starts_with("\"integrity\"")).collect()
}
