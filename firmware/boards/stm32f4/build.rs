//! Linker arguments for the board. The board has its own linker script, which sets all addresses.

/// Drives whose stack does not have the size that `black_pill.x` gives, and the size in bytes. These drives
/// keep a large memory on the stack.
const STACKS: [(&str, u32); 2] = [("rs434544", 33 << 10), ("rs434546", 33 << 10)];

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo::rustc-link-arg-bins=-T{here}/black_pill.x");
    for (kind, bytes) in STACKS {
        println!("cargo::rustc-link-arg-bin={kind}=--defsym=_stack_length={bytes}");
    }
    // Sections are not padded to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo::rerun-if-changed=black_pill.x");
}
