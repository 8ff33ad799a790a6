//! The boards: their images, and the memory layout of the images.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use drivetwin_firmware::device::{Device, Framing, Spec};
use drivetwin_protocol::registers::Space;
use xshell::{Shell, cmd};

use crate::checks::{BARE, host, target_dir};
use crate::image::Image;
use crate::tools::{Tool, Tools};
use crate::uf2;

/// Cargo's profile for the images that are flashed.
pub(crate) const PROFILE: &str = "firmware";

/// A board. Its package has a binary for each kind of drive.
#[derive(Debug)]
pub(crate) struct Board {
    pub(crate) name: &'static str,
    pub(crate) package: &'static str,
    pub(crate) target: &'static str,
    /// Address of the vector table while the image runs; `None` if the table follows the stack.
    vectors: Option<u64>,
    /// Address of the start of RAM.
    ram: u64,
    /// Parts of the names of functions that must be in RAM, as interrupts must, because flash cannot be read meanwhile.
    /// `None` if the board runs from flash.
    in_ram: Option<&'static [&'static str]>,
    /// True if the board has Ethernet, and therefore also images of the drives with TCP ports.
    has_ethernet: bool,
}

/// Every board.
pub(crate) const BOARDS: [Board; 4] = [
    Board {
        name: "lm3s6965",
        package: "drivetwin-lm3s6965",
        target: "thumbv7m-none-eabi",
        vectors: Some(0),
        ram: 0x2000_0000,
        in_ram: None,
        has_ethernet: true,
    },
    Board {
        name: "rp2040",
        package: "drivetwin-rp2040",
        target: "thumbv6m-none-eabi",
        // The image runs from RAM, so the vector table is in RAM, after the stack.
        vectors: None,
        ram: 0x2000_0000,
        in_ram: Some(&[]),
        has_ethernet: false,
    },
    Board {
        name: "stm32f4",
        package: "drivetwin-stm32f4",
        target: "thumbv7em-none-eabihf",
        // The vector table is in RAM, as on the rp2040.
        vectors: None,
        ram: 0x2000_0000,
        in_ram: Some(&["flash4Bank7command"]),
        has_ethernet: false,
    },
    Board {
        name: "rp2350",
        package: "drivetwin-rp2350",
        target: "thumbv8m.main-none-eabi",
        vectors: None,
        ram: 0x2000_0000,
        in_ram: Some(&[]),
        has_ethernet: false,
    },
];

/// Target for which the crates are linted.
const LINTED: &str = BOARDS[2].target;

/// The board that QEMU emulates.
pub(crate) const LM3S6965: &Board = &BOARDS[0];
/// The Raspberry Pi Pico.
pub(crate) const RP2040: &Board = &BOARDS[1];
/// The Raspberry Pi Pico 2.
pub(crate) const RP2350: &Board = &BOARDS[3];

/// Arguments of cargo that select all packages that run on a microcontroller with this target. The packages are
/// always the same. For other packages cargo may select other features of the dependencies, and build the
/// dependencies again.
pub(crate) fn bare(target: &'static str) -> Vec<&'static str> {
    let board = BOARDS.iter().filter(|board| board.target == target).map(|board| board.package);
    let packages = board.chain(["panic-free"]);
    ["--profile", PROFILE, "--target", target]
        .into_iter()
        .chain(packages.flat_map(|package| ["--package", package]))
        .collect()
}

/// Lints the crates that only a board, or a linker, can build. All are linted for one processor, which has
/// every instruction of the others, and that of the Pico and the Pico 2 also for the latter, which selects its chip. The
/// profile is that of the boards, so that no other lane's lock on a profile folder has to be waited for.
pub(crate) fn clippy(sh: &Shell) -> Result<()> {
    let lint = |packages: &[&str], target: &str, logging: &[&str]| {
        let packages = packages.iter().flat_map(|package| ["--package", package]);
        let lint = cmd!(sh, "cargo clippy --profile {PROFILE} {packages...} --target {target}");
        let logging = logging.iter().map(|package| format!("{package}/defmt")).collect::<Vec<_>>().join(",");
        lint.args(["--features", &logging, "--", "-D", "warnings"]).run()
    };
    let (package, target) = (RP2350.package, RP2350.target);
    lint(&BARE, LINTED, &[])?;
    lint(&BARE, LINTED, &BOARDS.map(|board| board.package))?;
    // A drive in somebody else's firmware (examples/embassy), and somebody else's drive (examples/own-drive).
    lint(&["md3-embassy"], LINTED, &[])?;
    let own = "--package own-drive --lib --no-default-features".split_whitespace();
    cmd!(sh, "cargo clippy --profile {PROFILE} {own...} --target {LINTED} -- -D warnings").run()?;
    lint(&[package, "drivetwin-pico"], target, &[])?;
    Ok(lint(&[package, "drivetwin-pico"], target, &[package])?)
}

/// Builds one image with logging for each board, because the linker scripts of the boards differ.
pub(crate) fn logging(sh: &Shell) -> Result<()> {
    for board in &BOARDS {
        let (bare, package) = (bare(board.target), board.package);
        cmd!(sh, "cargo build {bare...} --features {package}/defmt --bin md3").run()?;
        // The logging image now has the file name of the one without logging. Building that one again only
        // links the name to cargo's copy.
        board.build(sh, "md3")?;
    }
    Ok(())
}

impl Board {
    /// The kinds of drive for which the board has an image, sorted by name.
    pub(crate) fn kinds(&self, sh: &Shell) -> Result<Vec<String>> {
        let mut kinds: Vec<String> = sh
            .read_dir(format!("firmware/boards/{}/src/bin", self.name))?
            .iter()
            .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
            .collect();
        kinds.sort();
        Ok(kinds)
    }

    /// Folder of the images after they are built. The file name of an image is its kind.
    pub(crate) fn images(&self, sh: &Shell) -> PathBuf {
        target_dir(sh).join(self.target).join(PROFILE)
    }

    /// Builds the image with a kind of drive.
    pub(crate) fn build(&self, sh: &Shell, kind: &str) -> Result<PathBuf> {
        let bare = bare(self.target);
        cmd!(sh, "cargo build --quiet {bare...} --bin {kind}").run()?;
        Ok(self.images(sh).join(kind))
    }

    /// The image with a kind of drive, which must be built. Checks the memory layout of the image.
    pub(crate) fn image(&self, sh: &Shell, kind: &str) -> Result<Image> {
        let image = Image::of(sh, self.target, PROFILE, kind)?;
        let vectors = self.vectors.map_or_else(|| image.symbol("_stack_start"), Ok)?;
        let name = || format!("{kind} on {}", self.name);
        image.expect_map(vectors, self.ram).with_context(name)?;
        if let Some(names) = self.in_ram {
            image.expect_in_ram(self.ram, names).with_context(name)?;
        }
        Ok(image)
    }

    /// Builds the image for interactive use, after installing the tools that are needed.
    ///
    /// # Errors
    ///
    /// There is no image of that kind, it does not build, or a tool is missing.
    pub(crate) fn image_for(&self, sh: &Shell, kind: &str, needed: &[Tool]) -> Result<PathBuf> {
        let kinds = self.kinds(sh)?;
        if !kinds.iter().any(|known| known == kind) {
            bail!("there is no drive `{kind}` for the {}; there are: {}", self.name, kinds.join(", "));
        }
        if let Some(remedy) = Tools::default().missing(sh, needed) {
            bail!("{remedy}");
        }
        self.build(sh, kind)
    }

    /// Returns whether the board must have an image of a kind of drive: if it has the ports of that kind.
    pub(crate) fn carries(&self, kind: &str) -> bool {
        self.has_ethernet || !spec(kind).is_some_and(Spec::is_on_network)
    }

    /// Builds every image of the board with one command.
    pub(crate) fn all(&self, sh: &Shell) -> Result<PathBuf> {
        let kinds = kinds().into_iter().filter(|kind| self.carries(kind));
        let bins = kinds.flat_map(|kind| ["--bin", kind]);
        let bare = bare(self.target);
        cmd!(sh, "cargo build --quiet {bare...} {bins...}").run()?;
        Ok(self.images(sh))
    }
}

/// Specs of every kind of drive.
fn specs() -> Vec<&'static Spec> {
    macro_rules! specs {
        ($($make:expr),* $(,)?) => { vec![$(($make)().spec()),*] };
    }
    drivetwin_firmware::devices!(specs)
}

/// Names of all kinds of drives.
pub(crate) fn kinds() -> Vec<&'static str> {
    specs().into_iter().map(|spec| spec.kind).collect()
}

/// Spec of a kind of drive.
pub(crate) fn spec(kind: &str) -> Option<&'static Spec> {
    specs().into_iter().find(|spec| spec.kind == kind)
}

/// Commands to communicate with a kind of drive whose serial line is at the TCP address `address` of this
/// machine.
pub(crate) fn hint(kind: &str, address: &str) -> String {
    let spec = spec(kind);
    match spec.and_then(|spec| spec.ports.first()).map(|port| port.framing) {
        Some(Framing::Character) => {
            format!("what it counts, with socat:\n  (printf 'R0E\\r'; sleep 1) | socat - tcp:{address}")
        }
        _ => {
            let first = first_register(spec);
            format!(
                "its first 32 registers, with mbpoll, RTU over TCP:\n  \
                 socat pty,raw,echo=0,link={kind}.tty tcp:{address} & \
                 sleep 1; mbpoll -m rtu -a 1 -b 9600 -P none -t 4:hex -r {first} -c 32 -1 {kind}.tty"
            )
        }
    }
}

/// Commands to communicate with a kind of drive whose Modbus and MCode are at these TCP ports of this
/// machine.
pub(crate) fn network_hint(kind: &str, [modbus, mcode]: [u16; 2]) -> String {
    let first = first_register(spec(kind));
    format!(
        "its first register, with mbpoll, and its number, with socat:\n  \
         mbpoll -m tcp -p {modbus} -t 4:hex -r {first} -c 1 -1 127.0.0.1\n  \
         (printf 'PR SN\\r'; sleep 1) | socat - tcp:127.0.0.1:{mcode}"
    )
}

/// Number of the drive's first holding register, counted from 1.
fn first_register(spec: Option<&'static Spec>) -> u32 {
    let holding = spec.into_iter().flat_map(Spec::rows).map(|(_, row)| row);
    let first = holding.filter(|row| row.space == Space::Holding).map(|row| row.address).min();
    1 + u32::from(first.unwrap_or(0))
}

/// Tests an image under QEMU with requests.
pub(crate) fn run(sh: &Shell) -> Result<()> {
    let image = LM3S6965.build(sh, "md3")?;
    let host = host();
    let test = cmd!(sh, "cargo test {host...} --test qemu -- --ignored");
    Ok(test.env("DRIVETWIN_BOARD", image).run()?)
}

/// Replays the golden traces on the images under QEMU.
pub(crate) fn golden(sh: &Shell) -> Result<()> {
    let images = LM3S6965.all(sh)?;
    let host = host();
    let test = cmd!(sh, "cargo test {host...} --test qemu_golden -- --ignored --nocapture");
    Ok(test.env("DRIVETWIN_IMAGES", images).run()?)
}

/// Runs the tests that need the exact time of the emulated Pico.
pub(crate) fn pico(sh: &Shell) -> Result<()> {
    let images = RP2040.all(sh)?;
    let uf2 = uf2::write(sh, &uf2::PICO)?;
    let host = host();
    let test = cmd!(sh, "cargo test {host...} --test pico -- --ignored --nocapture");
    Ok(test.env("DRIVETWIN_IMAGES", images).env("DRIVETWIN_UF2", uf2).run()?)
}
