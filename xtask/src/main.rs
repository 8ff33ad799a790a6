//! Checks, documents and measurements of the repository.
//!
//! ```text
//! cargo xtask test    everything that must hold, and first whatever the checks need; or a group of it
//! cargo xtask check   one check of it
//! cargo xtask docs    write the generated references in docs/
//! cargo xtask endure  run a bench with drives of every kind in real time, under load, for hours
//! cargo xtask pico    run a drive on an emulated Raspberry Pi Pico
//! cargo xtask qemu    run a drive on an emulated LM3S6965 board
//! cargo xtask shots   write the pictures in docs/pictures
//! cargo xtask size    measure what each drive costs on each board, and print it
//! cargo xtask soak    run the property tests with many new cases
//! cargo xtask structure  print for each drive its structs, their own calls from file to file, imports, cycles
//! cargo xtask swarm   run random benches under an oracle
//! cargo xtask uf2     write a UF2 with an image of each kind for the Raspberry Pi Pico, and one for the Pico 2
//! cargo xtask web     write the static site: the panel with its bench in WebAssembly
//! cargo xtask words   count doc comments whose first word does not say the thing itself
//! ```

mod board;
mod budgets;
mod checks;
mod counted;
mod crates;
mod docs;
mod endure;
mod host_costs;
mod image;
mod interrupts;
mod panic_free;
mod pico;
mod python;
mod qemu;
mod report;
mod size;
mod swarm;
mod tools;
mod uf2;
mod web;
mod words;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

const USAGE: &str = "\
usage: cargo xtask <command>

  test    run every check, or those of groups: `test host`, `test foreign boards`; installs what they
          need, but removes nothing for it, or says what to install
  check   run one check by its name in the summary: `check clippy`
  docs    write the generated references in docs/
  endure  run a bench with drives of every kind for an hour under 10,000 requests/s, with faults; fail if memory or
          handles grow, the clock at rest is off, a reply is wrong, or the load is not reached: `endure --hours 2`,
          `--minutes 10`, `--rate 5000`
  pico    run a drive on an emulated Raspberry Pi Pico, its serial line on a TCP port: `pico md3`; with the
          ports of its USB cable on two more: `pico md3 --usb`
  qemu    run a drive on an LM3S6965 board under QEMU, its serial line on a TCP port: `qemu md3`
  shots   write the pictures of the panel and the view in docs/pictures
  size    print what each drive costs on each board; fail if one costs too much
  soak    run the property tests with so many new cases each: `soak 20000`
  structure  print for each drive its structs, the calls of their own methods from file to file, the imports of its
          files, and cycles; xtask/structure.py says what is counted
  swarm   run random benches under an oracle: `swarm --minutes 10`, `swarm --seed 7`, `swarm --help`;
          `swarm --planted`: how soon it finds each of the defects in tests/swarm/planted
  uf2     write target/drivetwin-pico.uf2 and drivetwin-pico2.uf2, which have every kind of drive for a Raspberry Pi
          Pico and a Pico 2
  web     write the static site, the panel with its bench in WebAssembly, to target/site; `web --out DIR`
  words   print how many doc comments begin with a question or a pronoun, by crate; `words --list`: which
";

/// Prints the structure of each drive. `structure.py` says what it counts.
fn structure(sh: &Shell) -> Result<()> {
    let mut drives = sh.read_dir("firmware/src")?;
    drives.retain(|folder| folder.join("registers.rs").is_file());
    Ok(cmd!(sh, "python3 xtask/structure.py {drives...}").run()?)
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["test", groups @ ..] => checks::run(groups),
        ["check", name] => shell().and_then(|sh| checks::run_one(&sh, name)).map(|()| true),
        ["docs"] => shell().and_then(|sh| docs::write(&sh)).map(|()| true),
        ["endure", options @ ..] => shell().and_then(|sh| endure::run(&sh, options)).map(|()| true),
        ["pico", kind, options @ ..] => shell().and_then(|sh| pico::run(&sh, kind, options)).map(|()| true),
        ["qemu", kind] => shell().and_then(|sh| qemu::run(&sh, kind)).map(|()| true),
        ["shots"] => shell().and_then(|sh| checks::pictures(&sh)).map(|()| true),
        ["size"] => shell().and_then(|sh| size::print(&sh)).map(|()| true),
        ["soak", cases] => shell().and_then(|sh| checks::soak(&sh, cases)).map(|()| true),
        ["structure"] => shell().and_then(|sh| structure(&sh)).map(|()| true),
        ["swarm", "--planted", names @ ..] => {
            shell().and_then(|sh| swarm::planted(&sh, names)).map(|()| true)
        }
        ["swarm", options @ ..] => shell().and_then(|sh| swarm::run(&sh, options)).map(|()| true),
        ["uf2"] => shell().and_then(|sh| uf2::print(&sh)).map(|()| true),
        ["web"] => shell().and_then(|sh| web::print(&sh, None)).map(|()| true),
        ["web", "--out", folder] => shell().and_then(|sh| web::print(&sh, Some(folder))).map(|()| true),
        ["words"] => shell().and_then(|sh| words::print(&sh, false)).map(|()| true),
        ["words", "--list"] => shell().and_then(|sh| words::print(&sh, true)).map(|()| true),
        [] | ["help" | "--help" | "-h"] => {
            print!("{USAGE}");
            Ok(true)
        }
        _ => {
            eprint!("error: unknown command `{}`\n\n{USAGE}", words.join(" "));
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// A shell in the root of the repository.
fn shell() -> Result<Shell> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("xtask lies in the repository")?;
    let sh = Shell::new()?;
    sh.change_dir(root);
    Ok(sh)
}
