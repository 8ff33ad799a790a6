//! Links for the board. `link.x` includes the `memory.x` in the root of the workspace, where the
//! linker runs; this board's map is the default one there.

fn main() {
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // Sections are not padded to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo::rerun-if-changed=../../../memory.x");
}
