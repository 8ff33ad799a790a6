//! `drivetwin flash`: copies an image to the boot loader of a board.

use drivetwin_host::boot_loader::{Image, PICO, PICO_2, Places};

use crate::args::{Board, Flash};

use super::print;

/// Copies an image to a board, and prints the progress at each quarter.
///
/// # Errors
/// One sentence that says what is wrong with the image, or what to do to get the board's boot loader.
pub(crate) fn flash(options: &Flash) -> Result<(), String> {
    let model = match options.board {
        Board::Pico => PICO,
        Board::Pico2 => PICO_2,
    };
    let image = Image::read(model.clone(), options.image.as_deref())?;
    let disk = Places::default().disk(model, options.device.as_ref(), |place| {
        // The copy goes on, also if nobody reads.
        let _ = print(&format!("the board at {place} starts its boot loader\n"));
    })?;
    let size = image.size();
    print(&format!("{} ({size} bytes) to {}\n", image.path().display(), disk.folder().display()))?;
    let mut quarters = 0;
    disk.flash(&image, |bytes| {
        let now = 4 * bytes / size;
        if now > quarters {
            quarters = now;
            // The copy goes on, also if nobody reads.
            let _ = print(&format!("{} %\n", 25 * quarters));
        }
    })?;
    print("done: the board restarts as the drive that was chosen last, at first an md3\n")
}
