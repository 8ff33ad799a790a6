//! The chip of the board, from the target: the RP2350's processors have the instructions of Armv8-M, the RP2040's those of
//! Armv6-M.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(rp2350)");
    println!("cargo::rerun-if-changed=build.rs");
    let target = std::env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumbv8m") {
        println!("cargo::rustc-cfg=rp2350");
    }
}
