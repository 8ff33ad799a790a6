//! The end of the flash, for saved registers, by the functions of the boot ROM (2.8.3.1.3).
//!
//! They wait while the flash is at work, and so does the loop. Interrupts do not: everything that they need
//! is in RAM. The events that they catch in that time must fit into the queue.

use core::arch::global_asm;
use core::mem::transmute_copy;
use core::ops::Range;
use core::ptr;

use drivetwin_board::Sectors;
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::watchdog;

const SECTOR: usize = 4096;
const PAGE: usize = 256;
/// Bytes of the chip.
const CAPACITY: usize = 2 << 20;
/// Address at which it is read.
const WINDOW: usize = 0x1000_0000;

/// A memory of more bytes, which is more than one piece, is a large one. The items of a small one have kept their
/// format since the first image.
const MOST_SMALL: usize = 256;

/// The last sectors, for small memories: they need not wait until the pieces of a large one are moved.
const SMALL: Range<u32> = sectors(4, CAPACITY as u32);
/// Sectors before those, for other kinds.
const LARGE: Range<u32> = sectors(MOST_SECTORS, SMALL.start);
/// Sectors of the larger of the two.
pub(crate) const MOST_SECTORS: usize = 8;

/// Place of a memory of that many bytes.
pub(crate) const fn place(bytes: usize) -> Range<u32> {
    if bytes <= MOST_SMALL { SMALL } else { LARGE }
}

/// The `count` sectors before `end`.
const fn sectors(count: usize, end: u32) -> Range<u32> {
    end - (count * SECTOR) as u32..end
}

// For `pico.x`, which has the image end there.
global_asm!(".global __saved", ".set __saved, {}", const WINDOW + LARGE.start as usize);

/// The flash chip.
#[derive(Clone, Copy)]
pub(crate) enum Chip {}

/// The flash of the board.
pub(crate) type Flash = drivetwin_board::Flash<Chip>;

impl Chip {
    /// Runs a command of the boot ROM on the chip, and makes the chip readable again.
    fn command(act: impl FnOnce()) {
        type Plain = extern "C" fn();
        watchdog::feed();
        // SAFETY: "connect_internal_flash" takes nothing.
        let connect: Plain = unsafe { rom(*b"IF") };
        connect();
        // SAFETY: nor does "flash_exit_xip".
        let exit: Plain = unsafe { rom(*b"EX") };
        exit();
        act();
        // SAFETY: nor does "flash_flush_cache".
        let flush: Plain = unsafe { rom(*b"FC") };
        flush();
        // SAFETY: nor does "flash_enter_cmd_xip".
        let enter: Plain = unsafe { rom(*b"CX") };
        enter();
    }
}

/// A function of the boot ROM by its two letters (2.8.3).
///
/// # Safety
/// `F` is a pointer to a function as the datasheet declares that one.
unsafe fn rom<F>(letters: [u8; 2]) -> F {
    /// Half-words of the ROM: where its functions are listed, and the function that looks one up.
    const FUNCTIONS: *const u16 = ptr::without_provenance(0x14);
    const LOOKUP: *const u16 = ptr::without_provenance(0x18);
    // SAFETY: the ROM is always there.
    let functions = usize::from(unsafe { FUNCTIONS.read_volatile() });
    // SAFETY: as above.
    let lookup = usize::from(unsafe { LOOKUP.read_volatile() });
    // SAFETY: it takes the list and the letters, and returns an address.
    let lookup: extern "C" fn(usize, u32) -> usize = unsafe { transmute_copy(&lookup) };
    let function = lookup(functions, u32::from(u16::from_le_bytes(letters)));
    // SAFETY: an address is as wide as a pointer to a function; every version of the ROM has these.
    unsafe { transmute_copy(&function) }
}

impl Sectors for Chip {
    const OURS: Range<u32> = LARGE.start..SMALL.end;
    const CAPACITY: usize = CAPACITY;
    const SECTOR: usize = SECTOR;
    const WORD: usize = 1;
    const PAGE: usize = PAGE;

    fn read(offset: u32) -> u8 {
        let at: *const u8 = ptr::without_provenance(WINDOW + offset as usize);
        // SAFETY: it is in the window; nothing writes to the chip at the same time.
        unsafe { at.read_volatile() }
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        /// A block that is erased as a whole where it fits, and the chip's command for that.
        const BLOCK: (u32, u8) = (1 << 16, 0xD8);
        // SAFETY: "flash_range_erase" takes these.
        let erase: extern "C" fn(u32, usize, u32, u8) = unsafe { rom(*b"RE") };
        Self::command(|| erase(offset, SECTOR, BLOCK.0, BLOCK.1));
        Ok(())
    }

    fn program(offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        // SAFETY: "flash_range_program" takes these, and reads so many bytes.
        let program: extern "C" fn(u32, *const u8, usize) = unsafe { rom(*b"RP") };
        // Programming 1 changes nothing.
        let mut page = [0xFF; PAGE];
        let place = offset as usize % PAGE;
        for (byte, new) in page.iter_mut().skip(place).zip(bytes) {
            *byte = *new;
        }
        Self::command(|| program(offset - place as u32, page.as_ptr(), PAGE));
        Ok(())
    }
}
