//! Saved registers in flash.
//!
//! A drive stores bytes at various offsets. Its memory is divided into pieces, and each piece is an item in
//! flash. A store writes each changed piece as a new item after the existing ones, in the order of the
//! pieces. Therefore, after a power cut, all pieces from some piece on are as they were before that store,
//! and all sectors wear equally. If a store fails, everything is erased and written again. Each kind of
//! drive has items of its own (BOARD-5).

use core::ops::Range;
use core::pin::pin;
use core::task::{Context, Poll, Waker};

use embedded_storage::{ReadStorage, Storage};
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::Cache;
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::page_pointers::ArrayPagePointers;
use sequential_storage::cache::page_states::ArrayPageStates;
use sequential_storage::map::{MapConfig, MapStorage};

/// Key of an item: the name of the kind, cut to 15 bytes, and in the last byte the number of the piece.
type Key = [u8; 16];

/// Cache of the state of the flash. Without it, making room in a sector needs a search for each item of the
/// sector.
type Known<const SECTORS: usize> =
    Cache<ArrayPageStates<SECTORS>, ArrayPagePointers<SECTORS>, ArrayKeyPointers<Key, KNOWN_ITEMS>, Key>;
type Map<F, const SECTORS: usize> = MapStorage<Key, F, Known<SECTORS>>;
/// Number of items that are found without a search. Further items are found, too, but that takes longer.
const KNOWN_ITEMS: usize = 2;

/// Number of bytes in a piece. The last piece may have fewer.
const PIECE: usize = 256;
/// Maximum number of bytes of an item.
const ITEM: usize = size_of::<Key>() + PIECE;

/// The items of a kind of drive.
struct Items<F: NorFlash, const SECTORS: usize> {
    map: Map<F, SECTORS>,
    flash: F,
    place: Range<u32>,
    kind: Key,
}

impl<F: NorFlash + Copy, const SECTORS: usize> Items<F, SECTORS> {
    /// Items of the kind of drive with the name `kind`, in the part `place` of the flash.
    fn of(kind: &str, flash: F, place: Range<u32>) -> Self {
        let mut key = [0; _];
        for (place, letter) in key.iter_mut().take(size_of::<Key>() - 1).zip(kind.bytes()) {
            *place = letter;
        }
        Self { map: open(flash, place.clone()), flash, place, kind: key }
    }

    fn key(&self, number: u8) -> Key {
        let mut key = self.kind;
        key[size_of::<Key>() - 1] = number;
        key
    }

    /// The piece with this number, if it was ever stored.
    fn find<'a>(&mut self, number: u8, item: &'a mut [u8; ITEM]) -> Result<Option<&'a [u8]>, Unreadable> {
        let key = self.key(number);
        wait(self.map.fetch_item(item, &key)).map_err(|_| Unreadable)
    }

    /// Writes a piece, and checks that it is found again, as after a reset.
    fn store(&mut self, number: u8, piece: &[u8]) -> Result<(), Unreadable> {
        let key = self.key(number);
        let mut item = [0; ITEM];
        wait(self.map.store_item(&mut item, &key, &piece)).map_err(|_| Unreadable)?;
        self.forget();
        if self.find(number, &mut item)? == Some(piece) { Ok(()) } else { Err(Unreadable) }
    }

    /// Drops all cached state of the flash. The stack that this needs is free again when it returns.
    #[inline(never)]
    fn forget(&mut self) {
        self.map = open(self.flash, self.place.clone());
    }

    fn erase(&mut self) -> Result<(), Unreadable> {
        wait(self.map.erase_all()).map_err(|_| Unreadable)
    }
}

fn open<F: NorFlash, const SECTORS: usize>(flash: F, place: Range<u32>) -> Map<F, SECTORS> {
    let known = Known::new(ArrayPageStates::new(), ArrayPagePointers::new(), ArrayKeyPointers::new());
    Map::new(flash, MapConfig::new(place), known)
}

/// The non-volatile memory of a drive, in up to `SECTORS` sectors of a flash. The functions of the flash
/// return when their operation is done.
pub struct Saved<'a, F: NorFlash, const SECTORS: usize> {
    items: Items<F, SECTORS>,
    /// Content of the memory, which the drive reads (PROJECT-11).
    bytes: &'a mut [u8],
}

impl<'a, F: NorFlash + Copy, const SECTORS: usize> Saved<'a, F, SECTORS> {
    /// Reads into `bytes` what a drive of this kind saved at `place` in the flash. All bytes are `0xFF` if it
    /// never saved anything, or if the flash has other data than saved registers. The stack that this needs
    /// is free again when it returns.
    ///
    /// # Panics
    /// The place has fewer than two sectors, or does not consist of whole ones.
    #[inline(never)]
    pub fn new(flash: F, place: Range<u32>, kind: &str, bytes: &'a mut [u8]) -> Self {
        let mut saved = Self { items: Items::of(kind, flash, place), bytes };
        if saved.recall().is_err() {
            saved.bytes.fill(0xFF);
            let _ = saved.items.erase();
        }
        saved
    }

    fn recall(&mut self) -> Result<(), Unreadable> {
        let mut item = [0; ITEM];
        for (number, piece) in (0..).zip(self.bytes.chunks_mut(PIECE)) {
            piece.fill(0xFF);
            // An image with a smaller memory may have stored only the beginning of this piece.
            let stored = self.items.find(number, &mut item)?.unwrap_or_default();
            if let Some(begin) = piece.get_mut(..stored.len()) {
                begin.copy_from_slice(stored);
            }
        }
        Ok(())
    }

    /// Erases the flash, and writes all pieces.
    fn restore(&mut self) -> Result<(), Unreadable> {
        self.items.erase()?;
        let mut pieces = (0..).zip(self.bytes.chunks(PIECE));
        pieces.try_for_each(|(number, piece)| self.items.store(number, piece))
    }
}

/// The flash has other data than saved registers, or is broken.
#[derive(Clone, Copy, Debug)]
pub struct Unreadable;

impl<F: NorFlash, const SECTORS: usize> AsRef<[u8]> for Saved<'_, F, SECTORS> {
    fn as_ref(&self) -> &[u8] {
        self.bytes
    }
}

impl<F: NorFlash, const SECTORS: usize> ReadStorage for Saved<'_, F, SECTORS> {
    type Error = Unreadable;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for (byte, stored) in bytes.iter_mut().zip(self.bytes.iter().skip(offset as usize)) {
            *byte = *stored;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<F: NorFlash + Copy, const SECTORS: usize> Storage for Saved<'_, F, SECTORS> {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let offset = offset as usize;
        let mut result = Ok(());
        for (number, piece) in (0..).zip(self.bytes.chunks_mut(PIECE)) {
            let begin = usize::from(number) * PIECE;
            let new = bytes.iter().skip(begin.saturating_sub(offset));
            let mut is_changed = false;
            for (stored, byte) in piece.iter_mut().skip(offset.saturating_sub(begin)).zip(new) {
                is_changed |= stored != byte;
                *stored = *byte;
            }
            if is_changed && result.is_ok() {
                result = self.items.store(number, piece);
            }
        }
        // The flash may be worn out or have other data. After a full erase it may accept the memory.
        result.or_else(|Unreadable| self.restore())
    }
}

/// Runs a future that never waits: an operation of the flash is done when its function returns.
fn wait<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
    }
}
