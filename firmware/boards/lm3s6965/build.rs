//! Linker arguments for the board. `link.x` includes the `memory.x` in the root of the workspace, where the
//! linker runs. That file has this board's memory map by default.

/// Size of each image's stack in bytes. The stack holds the drive and its queued output. An MD3 sends one
/// message at a time, and its board takes 8 KiB of RAM; a QSB may send many at once; an RS 434544 holds a
/// program, and an MDrive the index of one.
const STACKS: [(&str, u32); 10] = [
    ("md3", 5_632),
    ("md3-low", 5_632),
    ("qsb-d", 6_656),
    ("qsb-m", 6_656),
    ("qsb-s", 6_656),
    ("rs434544", 14_848),
    ("rs434546", 14_848),
    ("mdrobot", 6_656),
    ("mdrive", 22_016),
    ("mdrive-hybrid", 22_016),
];

/// Images with a network. The linker cannot prove that the TCP/IP stack never panics, so a panic there is a
/// fault.
const ON_NETWORK: [&str; 2] = ["mdrive", "mdrive-hybrid"];

fn main() {
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // Sections are not padded to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    for (kind, bytes) in STACKS {
        println!("cargo::rustc-link-arg-bin={kind}=--defsym=_stack_length={bytes}");
    }
    for kind in ON_NETWORK {
        println!("cargo::rustc-link-arg-bin={kind}=--defsym=a_panic_can_happen=HardFault");
    }
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo::rerun-if-changed=../../../memory.x");
}
