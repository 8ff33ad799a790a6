//! Linker arguments for the emulated boards, one for each core.

fn main() {
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    // Stack of 14,336 bytes, because the measured drive is on it.
    println!("cargo::rustc-link-arg-bins=--defsym=_stack_length=14336");
    if std::env::var("TARGET").is_ok_and(|target| target.starts_with("thumbv6m")) {
        // The nRF51822 of a micro:bit. The default map is that of the LM3S6965.
        println!("cargo::rustc-link-arg-bins=--defsym=_ram_length=0x4000");
    }
    println!("cargo::rerun-if-changed=../../memory.x");
}
