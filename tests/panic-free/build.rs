//! Links programs that begin at `start`.

fn main() {
    println!("cargo::rustc-link-arg-bins=--entry=start");
    println!("cargo::rerun-if-changed=build.rs");
}
