//! The kinds of drive that the board can be, the choice of one, and the boot loader.

use core::cell::Cell;

use critical_section::Mutex;
use drivetwin_board::{Choice, Leave};
use drivetwin_control::Refused;

use crate::chip::rom;
use crate::flash::{CHOICES, Chip, directory};
use crate::watchdog;
use crate::wires::LIGHT;

/// Kind of this image.
static OWN: Mutex<Cell<&'static str>> = Mutex::new(Cell::new(""));

/// Stores the kind of this image.
pub(crate) fn this_is(kind: &'static str) {
    critical_section::with(|cs| OWN.borrow(cs).set(kind));
}

/// Name of a kind, as [`Board::kind`](drivetwin_board::Board::kind) gives it. An image that was flashed alone has only its own kind.
pub(crate) fn kind(number: u8) -> Option<&'static str> {
    match directory() {
        Some(directory) => Some(directory.image(number.into())?.kind),
        None => (number == 0).then(|| critical_section::with(|cs| OWN.borrow(cs).get())),
    }
}

/// Stores the choice, as [`Board::choose`](drivetwin_board::Board::choose) does.
pub(crate) fn choose(kind: &str) -> Result<Leave, Refused> {
    Choice::store::<Chip>(CHOICES, kind)?;
    Ok(watchdog::reset)
}

/// Starts the boot loader of the ROM, which takes a UF2. While it receives one, it lights the Pico's own light.
pub(crate) fn start_boot_loader() -> ! {
    rom::start_boot_loader(LIGHT);
    watchdog::reset()
}
