//! Links a program that begins at `start`, with the drive that `DRIVE` names.

include!("place.rs");

fn main() {
    tell_place_of_drive();
    println!("cargo::rustc-link-arg-bins=--entry=start");
}
