//! Saved registers in flash.
//!
//! The drive stores bytes here and there. What is written is always the whole memory, as one item behind the
//! last one: so a power cut leaves it as it was before that store or as it is after it, and all sectors wear
//! alike. Only where a store fails is everything erased for another try. Each kind of drive has an item
//! of its own.

use core::pin::pin;
use core::task::{Context, Poll, Waker};

use embedded_storage::{ReadStorage, Storage};
use sequential_storage::cache::Cache;
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::page_pointers::ArrayPagePointers;
use sequential_storage::cache::page_states::ArrayPageStates;
use sequential_storage::map::{MapConfig, MapStorage};

use crate::flash::{self, Flash, SECTORS};

/// The kind of drive, as far as it fits.
type Key = [u8; 16];

/// What is known of the flash: without it, making room in a sector takes a search for each of its items.
type Known = Cache<ArrayPageStates<SECTORS>, ArrayPagePointers<SECTORS>, ArrayKeyPointers<Key, KINDS>, Key>;
type Map = MapStorage<Key, Flash, Known>;
/// Kinds of drives whose items are found without a search. Those of more take longer to find, and are found.
const KINDS: usize = 2;

/// Bytes that an item takes at most.
const ITEM: usize = 128;

/// The non-volatile memory of a drive.
pub(crate) struct Saved<const MEMORY: usize> {
    map: Map,
    key: Key,
    bytes: [u8; MEMORY],
}

impl<const MEMORY: usize> Saved<MEMORY> {
    /// What a drive of that kind saved; all `0xFF` if it never did, or if the flash holds something else
    /// than saved registers.
    pub(crate) fn new(kind: &str) -> Self {
        const { assert!(MEMORY + size_of::<Key>() <= ITEM, "the memory does not fit into an item") };
        let mut key = [0; _];
        for (place, letter) in key.iter_mut().zip(kind.bytes()) {
            *place = letter;
        }
        let mut saved = Self { map: open(), key, bytes: [0xFF; MEMORY] };
        match saved.find() {
            Ok(Some(bytes)) => saved.bytes = bytes,
            Ok(None) => {}
            Err(Unreadable) => {
                let _ = saved.erase();
            }
        }
        saved
    }

    /// What lies in flash, if it is a memory of that kind: as found after a reset, with nothing known.
    fn find(&mut self) -> Result<Option<[u8; MEMORY]>, Unreadable> {
        self.map = open();
        let mut item = [0; ITEM];
        let found = wait(self.map.fetch_item::<&[u8]>(&mut item, &self.key)).map_err(|_| Unreadable)?;
        Ok(found.and_then(|bytes| bytes.try_into().ok()))
    }

    /// Writes the memory, and looks whether it is found again.
    fn store(&mut self) -> Result<(), Unreadable> {
        let stored = wait(self.map.store_item(&mut [0; ITEM], &self.key, &self.bytes.as_slice()));
        let found = stored.map_err(|_| Unreadable).and_then(|()| self.find())?;
        if found == Some(self.bytes) { Ok(()) } else { Err(Unreadable) }
    }

    fn erase(&mut self) -> Result<(), Unreadable> {
        wait(self.map.erase_all()).map_err(|_| Unreadable)
    }
}

fn open() -> Map {
    let config = const { MapConfig::new(flash::RANGE) };
    let known = Known::new(ArrayPageStates::new(), ArrayPagePointers::new(), ArrayKeyPointers::new());
    Map::new(Flash, config, known)
}

/// The flash holds something else than saved registers, or is broken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unreadable;

impl<const MEMORY: usize> ReadStorage for Saved<MEMORY> {
    type Error = Unreadable;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for (byte, stored) in bytes.iter_mut().zip(self.bytes.iter().skip(offset as usize)) {
            *byte = *stored;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        MEMORY
    }
}

impl<const MEMORY: usize> Storage for Saved<MEMORY> {
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        for (stored, byte) in self.bytes.iter_mut().skip(offset as usize).zip(bytes) {
            *stored = *byte;
        }
        // Worn out, or not ours: erased as a whole it may take the memory after all.
        self.store().or_else(|Unreadable| {
            self.erase()?;
            self.store()
        })
    }
}

/// The end of a future that nobody need wake: the flash has done a thing when its function returns.
fn wait<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
    }
}
