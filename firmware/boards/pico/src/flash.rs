//! The flash: images at its beginning, and at its end the chosen kind and saved registers, which functions of the boot ROM
//! (2.8.3.1.3; RP2350: 5.4.8) write.
//!
//! The functions, and with them the loop, wait while the flash erases or programs. Interrupts continue,
//! because everything that they need is in RAM. Their events must fit into the queue meanwhile.

use core::arch::global_asm;
use core::ops::Range;
use core::{ptr, slice};

use drivetwin_board::{Directory, Sectors};
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::chip::{FLASH, rom};
use crate::watchdog;

const SECTOR: usize = 4096;
const PAGE: usize = 256;
/// Address at which the processor reads the flash.
const WINDOW: usize = 0x1000_0000;

/// Maximum size of a small memory, which is one piece. A memory with more bytes is a large one. The format of
/// a small memory's items has not changed since the first image.
const MOST_SMALL: usize = 256;

/// The last sectors of the flash, for small memories. So a store of a small memory never waits until the
/// pieces of a large one are moved.
const SMALL: Range<u32> = sectors(4, FLASH as u32);
/// The sectors before those of [`SMALL`], for large memories.
const LARGE: Range<u32> = sectors(MOST_SECTORS, SMALL.start);
/// Number of sectors of [`LARGE`]. [`SMALL`] has fewer.
pub(crate) const MOST_SECTORS: usize = 8;

/// The sectors before those of [`LARGE`], for the chosen kind.
const CHOICE: Range<u32> = sectors(2, LARGE.start);
/// Offsets of the two sectors of [`CHOICE`].
pub(crate) const CHOICES: [u32; 2] = [CHOICE.start, CHOICE.start + SECTOR as u32];

/// Sectors for a memory of `bytes` bytes.
pub(crate) const fn place(bytes: usize) -> Range<u32> {
    if bytes <= MOST_SMALL { SMALL } else { LARGE }
}

/// The `count` sectors before `end`.
const fn sectors(count: usize, end: u32) -> Range<u32> {
    end - (count * SECTOR) as u32..end
}

/// Offset of the directory of images, one sector behind the beginning of the selector (BOARD-13).
const DIRECTORY: usize = SECTOR;

// Symbols for the linker scripts and `cargo xtask uf2`: where images must end, and where the directory lies.
global_asm!(
    ".global __kept, __directory
     .set __kept, {}
     .set __directory, {}",
    const WINDOW + CHOICE.start as usize,
    const WINDOW + DIRECTORY,
);

/// The part of the flash with images, in words. No image writes there.
pub(crate) fn words() -> &'static [u32] {
    // SAFETY: the window of the flash is always mapped and aligned, and this part of it never changes.
    unsafe { slice::from_raw_parts(ptr::without_provenance(WINDOW), CHOICE.start as usize / 4) }
}

/// The directory of images; `None` if this image was flashed alone.
pub(crate) fn directory() -> Option<Directory<'static>> {
    let at: *const u8 = ptr::without_provenance(WINDOW + DIRECTORY);
    // SAFETY: as for `words`.
    Directory::read(unsafe { slice::from_raw_parts(at, Directory::BYTES) })
}

/// The flash chip.
#[derive(Clone, Copy)]
pub(crate) enum Chip {}

/// The flash of the board.
pub(crate) type Flash = drivetwin_board::Flash<Chip>;

/// Calls `act`, which commands the chip by functions of the boot ROM, and makes the chip readable again.
pub(crate) fn command(act: impl FnOnce()) {
    type Plain = extern "C" fn();
    watchdog::feed();
    // SAFETY: "connect_internal_flash" takes no arguments.
    let connect: Plain = unsafe { rom::function(*b"IF") };
    connect();
    // SAFETY: "flash_exit_xip" takes no arguments.
    let exit: Plain = unsafe { rom::function(*b"EX") };
    exit();
    act();
    // SAFETY: "flash_flush_cache" takes no arguments.
    let flush: Plain = unsafe { rom::function(*b"FC") };
    flush();
    // SAFETY: "flash_enter_cmd_xip" takes no arguments.
    let enter: Plain = unsafe { rom::function(*b"CX") };
    enter();
}

impl Sectors for Chip {
    const OURS: Range<u32> = CHOICE.start..SMALL.end;
    const CAPACITY: usize = FLASH;
    const SECTOR: usize = SECTOR;
    const WORD: usize = 1;
    const PAGE: usize = PAGE;

    fn read(offset: u32) -> u8 {
        let at: *const u8 = ptr::without_provenance(WINDOW + offset as usize);
        // SAFETY: the address is in the window of the flash; nothing writes to the chip at the same time.
        unsafe { at.read_volatile() }
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        /// Size of a block, which the ROM erases at once where the range allows, and the chip's command for a
        /// block.
        const BLOCK: (u32, u8) = (1 << 16, 0xD8);
        // SAFETY: "flash_range_erase" takes these arguments.
        let erase: extern "C" fn(u32, usize, u32, u8) = unsafe { rom::function(*b"RE") };
        command(|| erase(offset, SECTOR, BLOCK.0, BLOCK.1));
        Ok(())
    }

    fn program(offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        // SAFETY: "flash_range_program" takes these arguments, and reads as many bytes as the last one says.
        let program: extern "C" fn(u32, *const u8, usize) = unsafe { rom::function(*b"RP") };
        // Programming a bit to 1 does not change it.
        let mut page = [0xFF; PAGE];
        let place = offset as usize % PAGE;
        for (byte, new) in page.iter_mut().skip(place).zip(bytes) {
            *byte = *new;
        }
        command(|| program(offset - place as u32, page.as_ptr(), PAGE));
        Ok(())
    }
}
