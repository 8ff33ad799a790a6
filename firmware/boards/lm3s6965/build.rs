//! Links for the board. `link.x` includes the `memory.x` in the root of the workspace, where the
//! linker runs; this board's map is the default one there.

fn main() {
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // Sections are not padded to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    // What a drive says waits on the stack, and a QSB may say more at once.
    for kind in ["qsb-d", "qsb-m", "qsb-s"] {
        println!("cargo::rustc-link-arg-bin={kind}=--defsym=_stack_length=6656");
    }
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo::rerun-if-changed=../../../memory.x");
}
