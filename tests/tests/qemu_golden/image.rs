//! A linked image and addresses in it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use object::{Object, ObjectSection, ObjectSymbol};

/// The code of the instruction WFI (ARMv7-M, A7.7.261).
const WFI: [u8; 2] = 0xBF30_u16.to_le_bytes();

/// An image of the board.
pub(crate) struct Image {
    /// File of the image.
    pub(crate) path: PathBuf,
    /// Address of the instruction after the only WFI, in which the loop sleeps.
    pub(crate) wakes_at: u32,
    symbols: BTreeMap<String, u32>,
}

impl Image {
    /// Reads a linked image whose loop sleeps in a function that is exported as `sleep_until`.
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let file = object::File::parse(bytes.as_slice()).expect("an ELF file");
        let sleep = file.symbol_by_name("sleep_until").expect("the image exports sleep_until");
        // Bit 0 of a function's address marks Thumb code.
        let begin = sleep.address() & !1;
        let section = file.section_by_index(sleep.section_index().expect("it lies in a section"));
        let code = section.and_then(|section| section.data_range(begin, sleep.size()));
        let code = code.expect("readable").expect("it has code");
        let places: Vec<u64> = (begin..)
            .step_by(WFI.len())
            .zip(code.chunks_exact(WFI.len()))
            .filter(|(_, halfword)| *halfword == WFI)
            .map(|(place, _)| place)
            .collect();
        let [place] = places.as_slice() else { panic!("sleep_until has one WFI, not {places:x?}") };
        let symbols = file
            .symbols()
            .filter_map(|symbol| Some((symbol.name().ok()?.to_owned(), symbol.address() as u32)))
            .collect();
        Self { path: path.to_owned(), wakes_at: (*place + WFI.len() as u64) as u32, symbols }
    }

    /// Address of a symbol, given by its exported name or by the last part of its path in Rust.
    pub(crate) fn symbol(&self, name: &str) -> u32 {
        let mangled = format!("{}{name}17h", name.len());
        let found = self.symbols.iter().find(|(symbol, _)| *symbol == name || symbol.contains(&mangled));
        *found.unwrap_or_else(|| panic!("{} has {name}", self.path.display())).1
    }
}
