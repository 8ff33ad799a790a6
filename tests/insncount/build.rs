//! Allows undefined symbols: QEMU defines the functions that the plugin calls, and the unit tests never call
//! them.

fn main() {
    println!("cargo::rustc-link-arg=-Wl,--unresolved-symbols=ignore-all");
}
