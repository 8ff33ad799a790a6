//! The end of the flash, for saved registers, accessed by functions of the boot ROM (5.4).
//!
//! The functions, and with them the loop, wait while the flash erases or programs. Interrupts continue,
//! because everything that they need is in RAM. Their events must fit into the queue meanwhile.

use core::arch::global_asm;
use core::mem::transmute_copy;
use core::ops::Range;
use core::ptr;

use drivetwin_board::Sectors;
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::watchdog;

const SECTOR: usize = 4096;
const PAGE: usize = 256;
/// Size of the flash chip in bytes.
const CAPACITY: usize = 4 << 20;
/// Address at which the processor reads the flash.
const WINDOW: usize = 0x1000_0000;

/// Maximum size of a small memory, which is one piece. A memory with more bytes is a large one.
const MOST_SMALL: usize = 256;

/// The last sectors of the flash, for small memories. So a store of a small memory never waits until the
/// pieces of a large one are moved.
const SMALL: Range<u32> = sectors(4, CAPACITY as u32);
/// The sectors before those of [`SMALL`], for large memories.
const LARGE: Range<u32> = sectors(MOST_SECTORS, SMALL.start);
/// Number of sectors of [`LARGE`]. [`SMALL`] has fewer.
pub(crate) const MOST_SECTORS: usize = 8;

/// Sectors for a memory of `bytes` bytes.
pub(crate) const fn place(bytes: usize) -> Range<u32> {
    if bytes <= MOST_SMALL { SMALL } else { LARGE }
}

/// The `count` sectors before `end`.
const fn sectors(count: usize, end: u32) -> Range<u32> {
    end - (count * SECTOR) as u32..end
}

// Symbol for `pico2.x`, where the image must end.
global_asm!(".global __saved", ".set __saved, {}", const WINDOW + LARGE.start as usize);

/// The flash chip.
#[derive(Clone, Copy)]
pub(crate) enum Chip {}

/// The flash of the board.
pub(crate) type Flash = drivetwin_board::Flash<Chip>;

impl Chip {
    /// Calls `act`, which commands the chip by functions of the boot ROM, and makes the chip readable again.
    fn command(act: impl FnOnce()) {
        type Plain = extern "C" fn();
        watchdog::feed();
        // SAFETY: "connect_internal_flash" takes no arguments.
        let connect: Plain = unsafe { rom(*b"IF") };
        connect();
        // SAFETY: "flash_exit_xip" takes no arguments.
        let exit: Plain = unsafe { rom(*b"EX") };
        exit();
        act();
        // SAFETY: "flash_flush_cache" takes no arguments.
        let flush: Plain = unsafe { rom(*b"FC") };
        flush();
        // SAFETY: "flash_enter_cmd_xip" takes no arguments.
        let enter: Plain = unsafe { rom(*b"CX") };
        enter();
    }
}

/// Finds a function of the boot ROM by its two letters (5.4).
///
/// # Safety
/// `F` is a function pointer with the signature that the datasheet declares for this function.
unsafe fn rom<F>(letters: [u8; 2]) -> F {
    /// Half-word of the ROM with the address of the function that searches its table.
    const LOOKUP: *const u16 = ptr::without_provenance(0x16);
    /// The function is to be called by Arm code in the secure state.
    const ARM_SECURE: u32 = 0x0004;
    // SAFETY: the ROM is always mapped.
    let lookup = usize::from(unsafe { LOOKUP.read_volatile() });
    // SAFETY: the function takes the letters and a mask, and returns an address.
    let lookup: extern "C" fn(u32, u32) -> usize = unsafe { transmute_copy(&lookup) };
    let function = lookup(u32::from(u16::from_le_bytes(letters)), ARM_SECURE);
    // SAFETY: an address is as wide as a function pointer; every version of the ROM has these functions.
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
        // SAFETY: the address is in the window of the flash; nothing writes to the chip at the same time.
        unsafe { at.read_volatile() }
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        /// Size of a block, which the ROM erases at once where the range allows, and the chip's command for a
        /// block.
        const BLOCK: (u32, u8) = (1 << 16, 0xD8);
        // SAFETY: "flash_range_erase" takes these arguments.
        let erase: extern "C" fn(u32, usize, u32, u8) = unsafe { rom(*b"RE") };
        Self::command(|| erase(offset, SECTOR, BLOCK.0, BLOCK.1));
        Ok(())
    }

    fn program(offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        // SAFETY: "flash_range_program" takes these arguments, and reads as many bytes as the last one says.
        let program: extern "C" fn(u32, *const u8, usize) = unsafe { rom(*b"RP") };
        // Programming a bit to 1 does not change it.
        let mut page = [0xFF; PAGE];
        let place = offset as usize % PAGE;
        for (byte, new) in page.iter_mut().skip(place).zip(bytes) {
            *byte = *new;
        }
        Self::command(|| program(offset - place as u32, page.as_ptr(), PAGE));
        Ok(())
    }
}
