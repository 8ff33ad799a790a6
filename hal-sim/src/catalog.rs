//! The kinds of drive: those of the firmware, and those of other crates that a program adds.

use std::sync::OnceLock;

use drivetwin_firmware::device::{Device, Spec};

use crate::suggest;

/// Constructor of a kind of drive, without power. Its memory is new, so all instances are alike.
pub type Kind = fn() -> Box<dyn Device>;

macro_rules! boxed {
    ($($make:expr),* $(,)?) => {
        const OWN: &[Kind] = &[$(|| Box::new($make())),*];
    };
}
drivetwin_firmware::devices!(boxed);

/// Kinds of other crates. A process has one list, because a kind is a name in files and on the command line.
static ADDED: OnceLock<&'static [Kind]> = OnceLock::new();

/// Adds kinds of drive of other crates to this process, once, before a bench is made.
///
/// # Errors
/// One sentence: kinds were added before, the name of a kind is not one word or is in use, or a kind has no memory for
/// its saved registers.
pub fn add(kinds: &'static [Kind]) -> Result<(), String> {
    let mut names: Vec<&str> = OWN.iter().map(|make| make().spec().kind).collect();
    for spec in kinds.iter().map(|make| make().spec()) {
        let kind = spec.kind;
        if !is_name(kind) {
            return Err(format!(
                "\"{kind}\" is no name of a kind: use lower-case letters, digits and hyphens"
            ));
        }
        if names.contains(&kind) {
            return Err(format!("there are two kinds with the name {kind}"));
        }
        check_memory(spec)?;
        names.push(kind);
    }
    ADDED.set(kinds).map_err(|_| "kinds can be added once to a process".to_owned())
}

/// Checks that the memory has a word for each saved register, because a store beside it is lost.
fn check_memory(spec: &Spec) -> Result<(), String> {
    let saved = spec.registers.rows.iter().filter(|row| row.saved != 0).count();
    if usize::from(spec.memory) < 2 * saved {
        return Err(format!(
            "{} saves {saved} registers, but its memory has {} bytes: set `memory` in its Spec",
            spec.kind, spec.memory
        ));
    }
    Ok(())
}

fn is_name(kind: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    kind.starts_with(|c: char| c.is_ascii_lowercase()) && kind.chars().all(is_letter)
}

fn all() -> impl Iterator<Item = &'static Kind> {
    OWN.iter().chain(ADDED.get().copied().unwrap_or_default())
}

/// Descriptions of all kinds, in the order of the lists.
pub fn specs() -> impl Iterator<Item = &'static Spec> {
    all().map(|make| make().spec())
}

/// Makes a new drive of a kind, for instance `md3`.
///
/// # Errors
/// One sentence that says that there is no such kind, and names the nearest kind.
pub fn make(kind: &str) -> Result<Box<dyn Device>, String> {
    let found = all().map(|make| make()).find(|device| device.spec().kind == kind);
    found.ok_or_else(|| suggest::unknown("kind", kind, specs().map(|spec| spec.kind)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::test_device::TestDevice;

    #[test]
    fn a_kind_has_memory_for_its_saved_registers() {
        assert!(specs().all(|spec| check_memory(spec).is_ok()));
        let registers = TestDevice::default().spec().registers;
        let with = |memory| check_memory(&Spec { kind: "toy", memory, registers, ..Spec::EMPTY });
        assert_eq!(with(2), Ok(()));
        let error = "toy saves 1 registers, but its memory has 1 bytes: set `memory` in its Spec";
        assert_eq!(with(1), Err(error.to_owned()));
    }

    #[test]
    fn names_of_added_kinds_are_new_words() {
        let md3: &'static [Kind] = &[|| Box::new(drivetwin_firmware::md3::Md3::new())];
        assert_eq!(add(md3), Err("there are two kinds with the name md3".to_owned()));
        let twice: &'static [Kind] =
            &[|| Box::new(TestDevice::default()), || Box::new(TestDevice::default())];
        assert!(add(twice).is_err());
        assert!(
            is_name("own-vfd2") && !is_name("") && !is_name("2vfd") && !is_name("my vfd") && !is_name("VFD")
        );
    }
}
