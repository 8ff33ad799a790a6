//! Tests of saved registers in flash. They use the sizes of sectors and words of the boards that have flash,
//! and power fails during stores.
#![allow(missing_docs, reason = "a test")]

use std::cell::RefCell;

use drivetwin_board::Saved;
use embedded_storage::Storage;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

/// A flash chip with `COUNT` sectors of `SECTOR` bytes, programmed in words of `WORD` bytes.
struct Chip<const COUNT: usize, const SECTOR: usize, const WORD: usize> {
    bytes: Vec<u8>,
    /// Number of steps before power fails: each programmed word and each erased half of a sector is a step.
    left: usize,
    erased: usize,
}

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> Chip<COUNT, SECTOR, WORD> {
    fn new(content: u8) -> RefCell<Self> {
        RefCell::new(Self { bytes: vec![content; COUNT * SECTOR], left: usize::MAX, erased: 0 })
    }

    fn spend(&mut self) -> Result<(), NorFlashErrorKind> {
        self.left = self.left.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
        Ok(())
    }
}

struct Flash<'a, const COUNT: usize, const SECTOR: usize, const WORD: usize>(
    &'a RefCell<Chip<COUNT, SECTOR, WORD>>,
);

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> Clone for Flash<'_, COUNT, SECTOR, WORD> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> Copy for Flash<'_, COUNT, SECTOR, WORD> {}

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> ErrorType
    for Flash<'_, COUNT, SECTOR, WORD>
{
    type Error = NorFlashErrorKind;
}

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> ReadNorFlash
    for Flash<'_, COUNT, SECTOR, WORD>
{
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(&self.0.borrow().bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        COUNT * SECTOR
    }
}

impl<const COUNT: usize, const SECTOR: usize, const WORD: usize> NorFlash for Flash<'_, COUNT, SECTOR, WORD> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        assert!([from, to].iter().all(|at| (*at as usize).is_multiple_of(SECTOR)), "no whole sectors");
        let mut chip = self.0.borrow_mut();
        for half in (from as usize..to as usize).step_by(SECTOR / 2) {
            chip.spend()?;
            chip.bytes[half..half + SECTOR / 2].fill(0xFF);
        }
        chip.erased += 1;
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        assert!((offset as usize).is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD), "no whole words");
        let mut chip = self.0.borrow_mut();
        for (at, word) in (offset as usize..).step_by(WORD).zip(bytes.chunks(WORD)) {
            chip.spend()?;
            for (old, new) in chip.bytes[at..at + WORD].iter_mut().zip(word) {
                *old &= new;
            }
        }
        Ok(())
    }
}

/// Number of bytes in a piece.
const PIECE: usize = 256;

/// The content of a memory of `N` bytes after power-on.
fn found<const N: usize, const COUNT: usize, const SECTOR: usize, const WORD: usize>(
    chip: &RefCell<Chip<COUNT, SECTOR, WORD>>,
    kind: &str,
) -> [u8; N] {
    chip.borrow_mut().left = usize::MAX;
    let mut bytes = [0; N];
    Saved::<_, COUNT>::new(Flash(chip), 0..(COUNT * SECTOR) as u32, kind, &mut bytes);
    bytes
}

/// Stores `new` as the whole memory in one call. Power fails after `steps` steps of the chip. Returns whether
/// the store was complete by then.
fn store<const N: usize, const COUNT: usize, const SECTOR: usize, const WORD: usize>(
    chip: &RefCell<Chip<COUNT, SECTOR, WORD>>,
    kind: &str,
    new: [u8; N],
    steps: usize,
) -> bool {
    let mut bytes = [0; N];
    let mut saved = Saved::<_, COUNT>::new(Flash(chip), 0..(COUNT * SECTOR) as u32, kind, &mut bytes);
    chip.borrow_mut().left = steps;
    saved.write(0, &new).is_ok()
}

/// Stores again and again, with power failing at different steps of a store. Each piece that is found then is
/// the old or the new one, and all new ones are before the old ones.
fn survives<const N: usize, const COUNT: usize, const SECTOR: usize, const WORD: usize>(rounds: usize) {
    let chip = Chip::<COUNT, SECTOR, WORD>::new(0xFF);
    // Another kind of drive has saved its registers before.
    assert!(store(&chip, "other", [0xA5; 112], usize::MAX));
    let mut old = [0xFF; N];
    assert_eq!(found(&chip, "kind"), old, "a new drive");
    let (mut done, mut cut) = (0, 0);
    for round in 0..rounds {
        let new = [(round % 255) as u8; N];
        // Power fails after at most 1.5 times as many steps as a store without an erase needs. So some stores
        // are completed.
        let most = 3 * (N / WORD + N / PIECE * 16 + 32) / 2;
        if store(&chip, "kind", new, round * 7_919 % most) {
            done += 1;
            old = new;
            assert_eq!(found(&chip, "kind"), old, "round {round}");
            continue;
        }
        cut += 1;
        let now: [u8; N] = found(&chip, "kind");
        let pieces = now.chunks(PIECE).zip(old.chunks(PIECE)).zip(new.chunks(PIECE));
        let mut is_old = false;
        for (place, ((now, old), new)) in pieces.enumerate() {
            is_old |= now != new;
            assert_eq!(now, if is_old { old } else { new }, "round {round}, piece {place}");
        }
        old = now;
    }
    assert!(done > rounds / 10 && cut > rounds / 10, "{done} stores, {cut} of them cut short");
    assert!(chip.borrow().erased > COUNT, "sectors were erased {} times", chip.borrow().erased);
    assert_eq!(found(&chip, "other"), [0xA5; 112], "of another drive");
}

#[test]
fn a_small_memory_survives_power_that_fails() {
    // The sectors of a Pico, and those of a Black Pill.
    survives::<112, 4, 4_096, 1>(400);
    survives::<112, 3, 16_384, 4>(1_000);
}

#[test]
fn a_large_memory_survives_power_that_fails() {
    survives::<4_352, 8, 4_096, 1>(50);
    survives::<4_352, 3, 16_384, 4>(50);
}

#[test]
fn flash_with_something_else_makes_a_new_drive() {
    for content in [0x00, 0x5A] {
        let chip = Chip::<3, 16_384, 4>::new(content);
        assert_eq!(found(&chip, "kind"), [0xFF; 112]);
        assert!(store(&chip, "kind", [1; 112], usize::MAX));
        assert_eq!(found(&chip, "kind"), [1; 112]);
    }
}

#[test]
fn a_smaller_memory_of_an_earlier_image_is_the_beginning() {
    let chip = Chip::<4, 4_096, 1>::new(0xFF);
    assert!(store(&chip, "kind", [7; 64], usize::MAX));
    let mut larger = [0xFF; 144];
    larger[..64].fill(7);
    assert_eq!(found(&chip, "kind"), larger);
    assert_eq!(found(&chip, "kind"), [0xFF; 32], "of a larger one nothing is taken");
}
