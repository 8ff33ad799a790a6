use drivetwin_firmware::device::Device;

/// Tells the program the place in the list of drives of the one that `DRIVE` names; the first if it is not
/// set. Of more than one build script.
fn tell_place_of_drive() {
    macro_rules! kinds {
        ($($make:expr),* $(,)?) => { [$(($make)().spec().kind),*] };
    }
    let kinds: Vec<&str> = drivetwin_firmware::devices!(kinds).into_iter().collect();
    let place = match std::env::var("DRIVE") {
        Ok(kind) => kinds.iter().position(|&known| known == kind),
        Err(_) => Some(0),
    };
    match place {
        Some(place) => println!("cargo::rustc-env=PLACE={place}"),
        None => println!("cargo::error=DRIVE is one of: {}", kinds.join(" ")),
    }
    println!("cargo::rerun-if-env-changed=DRIVE");
}
