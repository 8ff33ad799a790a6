//! The LM3S6965 board: its image, and a run of it under QEMU.

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::image::{self, Image};

const TARGET: &str = "thumbv7m-none-eabi";
const PACKAGE: &str = "standin-lm3s6965";
const IMAGE: &str = "md3";

/// Lints the crates that only a board, or a linker, can build.
pub(crate) fn clippy(sh: &Shell, bare: &[&str]) -> Result<()> {
    Ok(cmd!(sh, "cargo clippy --release {bare...} --target {TARGET} -- -D warnings").run()?)
}

/// Builds the image, which links only if nothing in it can panic, and looks where it lies.
pub(crate) fn build(sh: &Shell) -> Result<()> {
    cmd!(sh, "cargo build --release --package {PACKAGE} --target {TARGET}").run()?;
    let image = Image::of(sh, TARGET, IMAGE)?;
    image.expect_at(".vector_table", 0)?;
    image.expect_at(".data", 0x2000_0000)?;
    print!("{}{}", image::head(), image::row("md3", TARGET, image.sizes()?));
    Ok(())
}

/// Asks the image under QEMU.
pub(crate) fn run(sh: &Shell) -> Result<()> {
    let image = target_dir(sh).join(TARGET).join("release").join(IMAGE);
    let test = cmd!(sh, "cargo test --package standin-tests --test qemu -- --ignored");
    Ok(test.env("STANDIN_BOARD", image).run()?)
}

/// Plays the golden traces on the images under QEMU.
pub(crate) fn golden(sh: &Shell) -> Result<()> {
    let images = target_dir(sh).join(TARGET).join("release");
    let test = cmd!(sh, "cargo test --package standin-tests --test qemu_golden -- --ignored --nocapture");
    Ok(test.env("STANDIN_IMAGES", images).run()?)
}
