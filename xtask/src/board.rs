//! The boards: their images, and what lies where in them.

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::docs::kinds;
use crate::image::Image;

/// Cargo's profile of what is flashed.
pub(crate) const PROFILE: &str = "firmware";

/// A board, with a binary for each kind of drive in its package.
#[derive(Debug)]
pub(crate) struct Board {
    pub(crate) name: &'static str,
    pub(crate) package: &'static str,
    pub(crate) target: &'static str,
    /// Where the vector table is, once the image runs.
    vectors: u64,
    /// Where RAM begins.
    ram: u64,
}

/// Every board.
pub(crate) const BOARDS: [Board; 2] = [
    Board {
        name: "lm3s6965",
        package: "standin-lm3s6965",
        target: "thumbv7m-none-eabi",
        vectors: 0,
        ram: 0x2000_0000,
    },
    Board {
        name: "rp2040",
        package: "standin-rp2040",
        target: "thumbv6m-none-eabi",
        // The image runs from RAM, behind its stack.
        vectors: 0x2000_3000,
        ram: 0x2000_0000,
    },
];

/// Lints the crates that only a board, or a linker, can build.
pub(crate) fn clippy(sh: &Shell, bare: &[&str]) -> Result<()> {
    for Board { package, target, .. } in &BOARDS {
        // A board's crate builds for its processor only.
        let others = BOARDS.iter().map(|board| board.package).filter(|other| other != package);
        let others: Vec<&str> = others.collect();
        let packages = bare.iter().filter(|bare| !others.contains(bare)).flat_map(|bare| ["--package", bare]);
        cmd!(sh, "cargo clippy --release {packages...} --target {target} -- -D warnings").run()?;
    }
    Ok(())
}

impl Board {
    /// Builds the image with a kind of drive, and looks where everything in it lies.
    pub(crate) fn image(&self, sh: &Shell, kind: &str) -> Result<Image> {
        let Self { name, package, target, vectors, ram } = self;
        cmd!(
            sh,
            "cargo build --quiet --profile {PROFILE} --package {package} --bin {kind} --target {target}"
        )
        .run()?;
        let image = Image::of(sh, target, PROFILE, kind)?;
        image.expect_map(*vectors, *ram).with_context(|| format!("{kind} on {name}"))?;
        Ok(image)
    }
}

/// Asks the image under QEMU.
pub(crate) fn run(sh: &Shell) -> Result<()> {
    let [board, _] = &BOARDS;
    board.image(sh, "md3")?;
    let image = target_dir(sh).join(board.target).join(PROFILE).join("md3");
    let test = cmd!(sh, "cargo test --package standin-tests --test qemu -- --ignored");
    Ok(test.env("STANDIN_BOARD", image).run()?)
}

/// Plays the golden traces on the images under QEMU.
pub(crate) fn golden(sh: &Shell) -> Result<()> {
    let [board, _] = &BOARDS;
    for kind in kinds(sh)? {
        board.image(sh, &kind)?;
    }
    let images = target_dir(sh).join(board.target).join(PROFILE);
    let test = cmd!(sh, "cargo test --package standin-tests --test qemu_golden -- --ignored --nocapture");
    Ok(test.env("STANDIN_IMAGES", images).run()?)
}
