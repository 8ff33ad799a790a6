//! Linker arguments for the board. The board has its own linker scripts, which set all addresses.

use std::path::Path;
use std::{env, fs, io};

/// Drives whose stack does not have the size that `pico2.x` gives, and the size in bytes. They keep a large memory on the
/// stack. All have 4 KiB more than on the Pico, because nobody has measured them.
const STACKS: [(&str, u32); 2] = [("rs434544", 33 << 10), ("rs434546", 33 << 10)];

fn main() -> io::Result<()> {
    let here = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo::rustc-link-arg-bin=selector=-T{here}/selector.x");
    // Each other program is the image of a kind.
    for image in fs::read_dir(Path::new(&here).join("src/bin"))? {
        let path = image?.path();
        let Some(kind) = path.file_stem().and_then(|kind| kind.to_str()) else { continue };
        println!("cargo::rustc-link-arg-bin={kind}=-T{here}/pico2.x");
        if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
            println!("cargo::rustc-link-arg-bin={kind}=-Tdefmt.x");
        }
    }
    for (kind, bytes) in STACKS {
        println!("cargo::rustc-link-arg-bin={kind}=--defsym=_stack_length={bytes}");
    }
    // Sections are not padded to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    for input in ["pico2.x", "selector.x", "src/bin"] {
        println!("cargo::rerun-if-changed={input}");
    }
    Ok(())
}
