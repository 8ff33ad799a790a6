//! Links for an emulated board with either core, and finds the place of the drive that `DRIVE` names in
//! the list of drives; the first if it is not set.

use standin_firmware::device::Device;

fn main() {
    macro_rules! kinds {
        ($($make:expr),* $(,)?) => { [$(($make)().spec().kind),*] };
    }
    let kinds: Vec<&str> = standin_firmware::devices!(kinds).into_iter().collect();
    let place = match std::env::var("DRIVE") {
        Ok(kind) => kinds.iter().position(|&known| known == kind),
        Err(_) => Some(0),
    };
    match place {
        Some(place) => println!("cargo::rustc-env=PLACE={place}"),
        None => println!("cargo::error=DRIVE is one of: {}", kinds.join(" ")),
    }
    println!("cargo::rerun-if-env-changed=DRIVE");
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    if std::env::var("TARGET").is_ok_and(|target| target.starts_with("thumbv6m")) {
        // The nRF51822 of a micro:bit. The default map is that of the LM3S6965.
        println!("cargo::rustc-link-arg-bins=--defsym=_ram_length=0x4000");
    }
    println!("cargo::rerun-if-changed=../../memory.x");
}
