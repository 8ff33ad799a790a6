//! Sectors 1 to 3 of the flash, for saved registers (3.5).
//!
//! While it is erased or programmed nothing in it can be fetched, and the loop waits. Interrupts do not: everything
//! that they need is in RAM. The events that they catch in that time must fit into the queue.

use core::arch::global_asm;
use core::ops::Range;
use core::ptr;

use drivetwin_board::Sectors;
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::registers::Register;
use crate::watchdog;

/// Bytes of each of the first four sectors.
const SECTOR: usize = 16 << 10;
/// Bytes that are programmed at once.
const WORD: usize = 4;
/// Bytes of the flash.
const CAPACITY: usize = 512 << 10;
/// Address at which it is read.
const WINDOW: usize = 0x0800_0000;

/// Sectors for saved registers. The processor begins in the one before; those behind are larger, and take four times
/// as long to erase, or more.
pub(crate) const SECTORS: usize = 3;
/// Part for saved registers.
pub(crate) const SAVED: Range<u32> = SECTOR as u32..((1 + SECTORS) * SECTOR) as u32;

// For `black_pill.x`, which has nothing else lie there.
global_asm!(
    ".global __saved, __saved_end
     .set __saved, {}
     .set __saved_end, {}",
    const WINDOW + SAVED.start as usize,
    const WINDOW + SAVED.end as usize
);

/// The flash interface (3.8).
const INTERFACE: usize = 0x4002_3C00;
const KEY: Register = Register::at(INTERFACE, 0x04);
const STATUS: Register = Register::at(INTERFACE, 0x0C);
const CONTROL: Register = Register::at(INTERFACE, 0x10);

const PROGRAM: u32 = 1 << 0;
const ERASE: u32 = 1 << 1;
/// 32 bits at once, for which the chip needs 2.7 V.
const BY_WORDS: u32 = 0b10 << 8;
const START: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;

/// The chip's flash.
#[derive(Clone, Copy)]
pub(crate) enum Bank {}

/// The flash of the board.
pub(crate) type Flash = drivetwin_board::Flash<Bank>;

impl Bank {
    /// Runs an operation of the interface, which begins with `control`, and waits until it is done.
    fn command(control: u32, act: impl FnOnce()) -> Result<(), NorFlashErrorKind> {
        const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
        const BUSY: u32 = 1 << 16;
        // OPERR, WRPERR, PGAERR, PGPERR, PGSERR and RDERR.
        const ERRORS: u32 = 0b1_1111_0010;
        watchdog::feed();
        // A key to an open lock would jam it.
        if CONTROL.read() & LOCK != 0 {
            for key in KEYS {
                KEY.write(key);
            }
        }
        // Errors of before are cleared by ones.
        STATUS.write(ERRORS);
        CONTROL.write(control);
        act();
        // No read before the write has begun what is waited for.
        cortex_m::asm::dsb();
        while STATUS.read() & BUSY != 0 {}
        CONTROL.write(LOCK);
        if STATUS.read() & ERRORS == 0 { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

impl Sectors for Bank {
    const OURS: Range<u32> = SAVED;
    const CAPACITY: usize = CAPACITY;
    const SECTOR: usize = SECTOR;
    const WORD: usize = WORD;
    const PAGE: usize = WORD;

    fn read(offset: u32) -> u8 {
        let at: *const u8 = ptr::without_provenance(WINDOW + offset as usize);
        // SAFETY: it is in the flash; nothing writes to it at the same time.
        unsafe { at.read_volatile() }
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        let number = offset / SECTOR as u32;
        let control = ERASE | BY_WORDS | number << 3;
        Self::command(control, || CONTROL.write(control | START))
    }

    fn program(offset: u32, word: &[u8]) -> Result<(), NorFlashErrorKind> {
        let word = word.try_into().map_err(|_| NorFlashErrorKind::NotAligned)?;
        let at: *mut u32 = ptr::without_provenance_mut(WINDOW + offset as usize);
        // SAFETY: it is in the sectors for saved registers, as every caller has checked, is aligned, and is no
        // memory.
        Self::command(PROGRAM | BY_WORDS, || unsafe { at.write_volatile(u32::from_le_bytes(word)) })
    }
}
