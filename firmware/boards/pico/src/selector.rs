//! The first program of a UF2 with an image of each kind: it copies the image of the chosen kind to RAM and starts it
//! (BOARD-13).

use core::mem::transmute;
use core::{ptr, slice};

use drivetwin_board::{Choice, Image, Sectors};

use crate::chip::RAM;
use crate::flash::{CHOICES, Chip, directory, words};
use crate::kinds::start_boot_loader;

/// Starts the image of the chosen kind. Without a choice, or if that image is not whole, it starts the first image; if that
/// one is not whole either, the boot loader.
pub extern "C" fn select() -> ! {
    let choice = Choice::last(CHOICES, Chip::read);
    if let Some(directory) = directory() {
        let chosen = choice.as_ref().and_then(|choice| directory.find(choice.kind()?));
        for image in chosen.into_iter().chain(directory.image(0)) {
            start(&image);
        }
    }
    start_boot_loader()
}

/// Copies an image to RAM and starts it. Returns if the image is not whole. An image begins with its own address, because
/// that is where its stack begins, and the address of its reset handler (`pico.x`, `pico2.x`).
fn start(image: &Image<'_>) {
    let Some(words @ [address, reset, ..]) = image.words(words()) else { return };
    let (address, reset) = (*address as usize, *reset as usize);
    let is_in_ram = RAM.contains(&address) && size_of_val(words) <= RAM.end - address;
    if !is_in_ram || !address.is_multiple_of(align_of::<u32>()) {
        return;
    }
    let copy: *mut u32 = ptr::without_provenance_mut(address);
    // SAFETY: this RAM is aligned, and not in use.
    unsafe { ptr::copy_nonoverlapping(words.as_ptr(), copy, words.len()) };
    // The copy is checked, because a read of the flash takes longer than a read of RAM.
    // SAFETY: all words were copied.
    if !image.is(unsafe { slice::from_raw_parts(copy, words.len()) }) {
        return;
    }
    // SAFETY: the reset handler of an image takes no arguments; it sets the stack and the vectors.
    let reset: extern "C" fn() -> ! = unsafe { transmute(reset) };
    reset()
}
