//! Sectors 1 to 3 of the flash, for saved registers (3.5).
//!
//! While the flash is erased or programmed, nothing in it can be fetched, and the loop waits. Interrupts
//! continue, because everything that they need is in RAM. Their events must fit into the queue meanwhile.

use core::arch::global_asm;
use core::ops::Range;
use core::ptr;

use drivetwin_board::Sectors;
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::registers::Register;
use crate::watchdog;

/// Size of each of the first four sectors in bytes.
const SECTOR: usize = 16 << 10;
/// Number of bytes that are programmed at once.
const WORD: usize = 4;
/// Size of the flash in bytes.
const CAPACITY: usize = 512 << 10;
/// Address at which the processor reads the flash.
const WINDOW: usize = 0x0800_0000;

/// Number of sectors for saved registers. The processor starts in the sector before them. The sectors after
/// them are larger, and take at least four times as long to erase.
pub(crate) const SECTORS: usize = 3;
/// Part for saved registers.
pub(crate) const SAVED: Range<u32> = SECTOR as u32..((1 + SECTORS) * SECTOR) as u32;

// Symbols for `black_pill.x`, which puts nothing else between them.
global_asm!(
    ".global __saved, __saved_end
     .set __saved, {}
     .set __saved_end, {}",
    const WINDOW + SAVED.start as usize,
    const WINDOW + SAVED.end as usize
);

/// Registers of the flash interface (3.8).
const INTERFACE: usize = 0x4002_3C00;
const KEY: Register = Register::at(INTERFACE, 0x04);
const STATUS: Register = Register::at(INTERFACE, 0x0C);
const CONTROL: Register = Register::at(INTERFACE, 0x10);

const PROGRAM: u32 = 1 << 0;
const ERASE: u32 = 1 << 1;
/// Programs 32 bits at once. For that the chip needs 2.7 V.
const BY_WORDS: u32 = 0b10 << 8;
const START: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;

/// The flash of the chip.
#[derive(Clone, Copy)]
pub(crate) enum Bank {}

/// The flash of the board.
pub(crate) type Flash = drivetwin_board::Flash<Bank>;

impl Bank {
    /// Runs an operation of the interface with this value of the control register, and waits until it is
    /// done. `act` starts the operation. A function of its own, which the linker script leaves in RAM: if the processor had
    /// to fetch from flash meanwhile, interrupts would wait, too.
    #[inline(never)]
    fn command(control: u32, act: impl FnOnce()) -> Result<(), NorFlashErrorKind> {
        const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
        const BUSY: u32 = 1 << 16;
        // OPERR, WRPERR, PGAERR, PGPERR, PGSERR and RDERR.
        const ERRORS: u32 = 0b1_1111_0010;
        watchdog::feed();
        // Writing the keys while the interface is unlocked would lock it until the next reset.
        if CONTROL.read() & LOCK != 0 {
            for key in KEYS {
                KEY.write(key);
            }
        }
        // Writing ones clears the errors of earlier operations.
        STATUS.write(ERRORS);
        CONTROL.write(control);
        act();
        // The barrier completes the write that starts the operation, before BUSY is read.
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
        // SAFETY: the address is in the flash; nothing writes to the flash at the same time.
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
        // SAFETY: the address is in the sectors for saved registers, as every caller has checked. It is
        // aligned, and is not memory that Rust uses.
        Self::command(PROGRAM | BY_WORDS, || unsafe { at.write_volatile(u32::from_le_bytes(word)) })
    }
}
