//! Sets `start` as the entry point of the linked programs.

fn main() {
    println!("cargo::rustc-link-arg-bins=--entry=start");
    println!("cargo::rerun-if-changed=build.rs");
}
