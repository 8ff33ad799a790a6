//! The kinds of drive, from the list in the firmware.

use drivetwin_firmware::device::{Device, Spec};

use crate::suggest;

/// Function that makes a drive of one kind.
type Make = fn() -> Box<dyn Device>;

macro_rules! boxed {
    ($($make:expr),* $(,)?) => {
        const ALL: &[Make] = &[$(|| Box::new($make())),*];
    };
}
drivetwin_firmware::devices!(boxed);

/// Descriptions of all kinds, in the order of the list.
pub fn specs() -> impl Iterator<Item = &'static Spec> {
    ALL.iter().map(|make| make().spec())
}

/// Makes a new drive of a kind, for instance `md3`.
///
/// # Errors
/// One sentence that says that there is no such kind, and names the nearest kind.
pub fn make(kind: &str) -> Result<Box<dyn Device>, String> {
    let found = ALL.iter().map(|make| make()).find(|device| device.spec().kind == kind);
    found.ok_or_else(|| suggest::unknown("kind", kind, specs().map(|spec| spec.kind)))
}
