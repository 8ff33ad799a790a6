//! Tests of the directory of images, and of the choice of a kind, with power that fails.
#![allow(missing_docs, reason = "a test")]

use std::cell::RefCell;
use std::ops::Range;

use drivetwin_board::{Choice, Directory, Image, Sectors, sum};
use drivetwin_control::Refused;
use embedded_storage_async::nor_flash::NorFlashErrorKind;

/// Size of a sector of the Pico's flash.
const SECTOR: usize = 4_096;
const SECTORS: [u32; 2] = [0, SECTOR as u32];

thread_local! {
    /// Two sectors, and the number of bits that change before power fails.
    static CHIP: RefCell<(Vec<u8>, usize)> = RefCell::new((vec![0xFF; 2 * SECTOR], usize::MAX));
}

/// The chip of this thread.
#[derive(Clone, Copy)]
struct Chip;

/// Changes bytes from `offset` on, one bit after the other, until power fails.
fn change(offset: u32, new: impl Iterator<Item = u8>) -> Result<(), NorFlashErrorKind> {
    CHIP.with_borrow_mut(|(bytes, left)| {
        for (byte, new) in bytes[offset as usize..].iter_mut().zip(new) {
            let changed = *byte ^ new;
            for bit in (0..8).rev().map(|bit| 1 << bit).filter(|bit| changed & bit != 0) {
                *left = left.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
                *byte ^= bit;
            }
        }
        Ok(())
    })
}

impl Sectors for Chip {
    const OURS: Range<u32> = 0..2 * SECTOR as u32;
    const CAPACITY: usize = 2 * SECTOR;
    const SECTOR: usize = SECTOR;
    const WORD: usize = 1;
    const PAGE: usize = 256;

    fn read(offset: u32) -> u8 {
        CHIP.with_borrow(|(bytes, _)| bytes[offset as usize])
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        assert!(SECTORS.contains(&offset), "no sector begins at {offset}");
        change(offset, [0xFF; SECTOR].into_iter())
    }

    fn program(offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let old: Vec<u8> = (offset..).take(bytes.len()).map(Self::read).collect();
        change(offset, bytes.iter().zip(old).map(|(new, old)| new & old))
    }
}

/// The kind that was chosen, after power is back.
fn chosen() -> Option<String> {
    CHIP.with_borrow_mut(|(_, left)| *left = usize::MAX);
    Choice::last(SECTORS, Chip::read).and_then(|choice| choice.kind().map(str::to_owned))
}

fn choose(kind: &str, bits: usize) -> Result<(), Refused> {
    CHIP.with_borrow_mut(|(_, left)| *left = bits);
    Choice::store::<Chip>(SECTORS, kind)
}

#[test]
fn the_last_choice_is_found() {
    assert_eq!(chosen(), None);
    for kind in ["md3", "qsb-d", "qsb-d", "abcdefghijklmnop", "md3", "rs434544"] {
        assert_eq!(choose(kind, usize::MAX), Ok(()));
        assert_eq!(chosen().as_deref(), Some(kind));
    }
    assert_eq!(choose("a-name-of-17-byte", usize::MAX), Err(Refused::Unknown));
    assert_eq!(choose("", usize::MAX), Err(Refused::Unknown));
    assert_eq!(chosen().as_deref(), Some("rs434544"));
}

#[test]
fn the_same_choice_again_wears_nothing() {
    assert_eq!(choose("md3", usize::MAX), Ok(()));
    assert_eq!(choose("md3", 0), Ok(()));
}

#[test]
fn a_choice_is_in_flash_as_an_older_image_reads_it() {
    assert_eq!(choose("md3", usize::MAX), Ok(()));
    let bytes: Vec<u8> = (0..42).map(Chip::read).collect();
    assert_eq!(bytes[..16], [0, 255, 0, 255, 0, 255, 0, 255, b'm', 0x92, b'd', 0x9B, b'3', 0xCC, 0, 255]);
    assert_eq!(bytes[16..40], [0, 255].repeat(12));
    assert_eq!(bytes[40..], [255; 2], "nothing follows");
}

#[test]
fn after_a_power_cut_the_old_or_the_new_kind_is_chosen() {
    // First in a new flash, then over an older choice.
    for older in [None, Some("mdrobot")] {
        let mut order = Vec::new();
        for bits in 0.. {
            CHIP.with_borrow_mut(|(bytes, _)| bytes.fill(0xFF));
            for kind in older.into_iter().chain(["md3"]) {
                assert_eq!(choose(kind, usize::MAX), Ok(()));
            }
            let is_done = choose("qsb-d", bits).is_ok();
            let found = chosen().expect("a power cut leaves a choice");
            // After the cut it can be chosen again.
            assert_eq!(choose("rs434544", usize::MAX), Ok(()));
            assert_eq!(chosen().as_deref(), Some("rs434544"));
            order.push(found);
            if is_done {
                break;
            }
        }
        let cuts = order.len();
        order.dedup();
        assert_eq!(order, ["md3", "qsb-d"], "{cuts} cuts");
        assert!(cuts > 100, "{cuts} cuts");
    }
}

#[test]
fn a_first_choice_that_is_cut_short_is_none() {
    let mut bits = 0;
    while choose("qsb-d", bits).is_err() {
        assert_eq!(chosen(), None, "{bits} bits");
        CHIP.with_borrow_mut(|(bytes, _)| bytes.fill(0xFF));
        bits += 1;
    }
    assert!(bits > 100 && chosen().as_deref() == Some("qsb-d"), "{bits} bits");
}

#[test]
fn other_data_is_no_choice() {
    for byte in [0x00, 0x5A, 0xFF] {
        CHIP.with_borrow_mut(|(bytes, _)| bytes.fill(byte));
        assert_eq!(chosen(), None);
        assert_eq!(choose("md3", usize::MAX), Ok(()));
        assert_eq!(chosen().as_deref(), Some("md3"));
    }
}

const IMAGES: [Image<'static>; 2] = [
    Image { kind: "md3", offset: 8, bytes: 12, sum: 0b1011 },
    Image { kind: "qsb-d", offset: 20, bytes: 4, sum: 7 },
];

#[test]
fn a_directory_is_read_as_it_was_written() {
    let bytes = Directory::write(&IMAGES).expect("two fit");
    let directory = Directory::read(&bytes).expect("a directory");
    assert_eq!([0, 1].map(|number| directory.image(number)), IMAGES.map(Some));
    assert_eq!(directory.image(2), None);
    assert_eq!(directory.find("qsb-d"), Some(IMAGES[1]));
    for unknown in ["", "qsb", "qsb-dd"] {
        assert_eq!(directory.find(unknown), None, "{unknown}");
    }
    assert!(Directory::write(&[IMAGES[0]; 8]).is_some(), "a Pico has eight kinds");
    assert!(Directory::write(&[IMAGES[0]; 9]).is_none());
}

#[test]
fn what_is_no_directory_is_not_read_as_one() {
    let bytes = Directory::write(&IMAGES).expect("two fit");
    assert!(Directory::read(&bytes[..255]).is_none());
    for byte in [0x00, 0xFF] {
        assert!(Directory::read(&[byte; 256]).is_none());
        // A directory of which only the beginning was programmed.
        let mut cut = [byte; 256];
        cut[..8].copy_from_slice(&bytes[..8]);
        assert_eq!(Directory::read(&cut).expect("a directory").image(0), None);
    }
}

#[test]
fn the_words_of_an_image_are_checked() {
    let flash = [9, 9, 1, 2, 3, 7];
    // ((1 · 2) + 2) · 2 + 3 = 11.
    assert_eq!(sum(&[1, 2, 3]), 0b1011);
    let [first, second] = IMAGES;
    assert_eq!(first.words(&flash), Some(&[1, 2, 3][..]));
    assert!(first.is(&[1, 2, 3]) && second.is(&[7]));
    assert!(!first.is(&[1, 3, 2]), "the order counts");
    assert!(!first.is(&[11]) && !first.is(&[0, 1, 2, 3]), "the length counts");
    assert_eq!(second.words(&flash[..5]), None, "beyond the end");
    for wrong in [u32::MAX, !3] {
        assert_eq!(Image { offset: wrong, ..first }.words(&flash), None);
        assert_eq!(Image { bytes: wrong, ..first }.words(&flash), None);
    }
}
