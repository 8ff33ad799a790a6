//! A UF2 for the Raspberry Pi Pico with every kind of drive (BOARD-13), and one for the Pico 2.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use drivetwin_board::{Directory, Image, sum};
use xshell::Shell;

use crate::board::{Board, PROFILE, RP2040, RP2350, kinds};
use crate::checks::target_dir;
use crate::image;
use crate::tools::{Tool, Tools};

/// A file for a board.
pub(crate) struct Uf2 {
    board: &'static Board,
    file: &'static str,
    /// Family of the chip, in the list of families of the format.
    family: u32,
}

/// The file for the Pico.
pub(crate) const PICO: Uf2 = Uf2 { board: RP2040, file: "drivetwin-pico.uf2", family: 0xE48B_FF56 };
/// The file for the Pico 2, for its Arm processors in the secure state.
pub(crate) const PICO_2: Uf2 = Uf2 { board: RP2350, file: "drivetwin-pico2.uf2", family: 0xE48B_FF59 };

/// Program before the images, which starts one of them.
const SELECTOR: &str = "selector";
/// Address of the flash.
const FLASH: u32 = 0x1000_0000;
/// Size of a sector. The boot loader erases whole sectors, and does not do so if a UF2 lacks a part of one (RP2040-E14).
const SECTOR: usize = 4_096;
/// Distance of images: they begin with a block of the UF2.
const ALIGNMENT: usize = blocks::PAYLOAD;

/// Installs the tools, and writes the UF2.
pub(crate) fn print(sh: &Shell) -> Result<()> {
    if let Some(remedy) = Tools::default().missing(sh, &[Tool::ThumbTargets]) {
        bail!("{remedy}");
    }
    for uf2 in [PICO, PICO_2] {
        uf2.board.all(sh)?;
        write(sh, &uf2)?;
    }
    Ok(())
}

/// Writes the UF2 of all images of a board, which must be built, and prints the sizes. Returns its path.
pub(crate) fn write(sh: &Shell, &Uf2 { board, file, family }: &Uf2) -> Result<PathBuf> {
    board.build(sh, SELECTOR)?;
    let selector = image::Image::of(sh, board.target, PROFILE, SELECTOR)?;
    let directory_at = offset(&selector, "__directory")?;
    let most = offset(&selector, "__kept")?;
    let mut flash = selector.flashed(FLASH)?;
    ensure!(flash.len() <= directory_at, "the selector reaches into the directory");
    flash.resize(directory_at + Directory::BYTES, 0xFF);

    let mut images = Vec::new();
    for kind in kinds().into_iter().filter(|kind| board.carries(kind)) {
        let words = words(&board.image(sh, kind)?).with_context(|| kind)?;
        flash.resize(flash.len().next_multiple_of(ALIGNMENT), 0xFF);
        let (offset, bytes) = (u32::try_from(flash.len())?, u32::try_from(size_of_val(words.as_slice()))?);
        println!("{kind:<12} {bytes:>8} bytes at {:#010x}", FLASH + offset);
        images.push(Image { kind, offset, bytes, sum: sum(&words) });
        flash.extend(words.into_iter().flat_map(u32::to_le_bytes));
    }
    let directory = Directory::write(&images).context("the directory does not take these images")?;
    flash[directory_at..directory_at + Directory::BYTES].copy_from_slice(&directory);
    flash.resize(flash.len().next_multiple_of(SECTOR), 0xFF);
    ensure!(flash.len() <= most, "the images need {} bytes of flash, and there are {most}", flash.len());

    let path = target_dir(sh).join(file);
    let file = blocks::write(family, FLASH, &flash)?;
    println!("{:<12} {:>8} bytes of {most} bytes of flash", "in all", flash.len());
    println!("{}: {} bytes", path.display(), file.len());
    sh.write_file(&path, file)?;
    Ok(path)
}

/// Offset in flash of the address that a symbol has.
fn offset(image: &image::Image, symbol: &str) -> Result<usize> {
    let offset = image.symbol(symbol)?.checked_sub(FLASH.into());
    Ok(offset.with_context(|| format!("`{symbol}` is not in flash"))?.try_into()?)
}

/// The part of an image that is copied to RAM, as words.
fn words(image: &image::Image) -> Result<Vec<u32>> {
    let begin = offset(image, "__image_load")?;
    let length = image.symbol("__image_end")? - image.symbol("__image_start")?;
    let bytes = image.flashed(FLASH)?;
    let bytes =
        bytes.get(begin..begin + usize::try_from(length)?).context("the image is not all in flash")?;
    let (words, []) = bytes.as_chunks() else { bail!("the image has no whole words") };
    Ok(words.iter().map(|word| u32::from_le_bytes(*word)).collect())
}

/// Blocks of the format UF2 (<https://github.com/microsoft/uf2>).
mod blocks {
    use anyhow::{Context, Result};

    /// Number of bytes of the image in a block.
    pub(super) const PAYLOAD: usize = 256;
    const BLOCK: usize = 512;
    const MAGIC: [u32; 2] = [0x0A32_4655, 0x9E5D_5157];
    const LAST_MAGIC: u32 = 0x0AB1_6F30;
    /// The last word of the header is a family.
    const HAS_FAMILY: u32 = 0x0000_2000;

    /// The blocks with `bytes` from an address on, for a family of chips.
    pub(super) fn write(family: u32, address: u32, bytes: &[u8]) -> Result<Vec<u8>> {
        let pieces = bytes.chunks(PAYLOAD);
        let count = u32::try_from(pieces.len())?;
        let mut blocks = Vec::with_capacity(pieces.len() * BLOCK);
        for (number, piece) in (0..).zip(pieces) {
            let at = address.checked_add(number * PAYLOAD as u32).context("the image is too long")?;
            let [first, second] = MAGIC;
            let header = [first, second, HAS_FAMILY, at, PAYLOAD as u32, number, count, family];
            let mut block = [0; BLOCK];
            for (place, byte) in block.iter_mut().zip(header.into_iter().flat_map(u32::to_le_bytes)) {
                *place = byte;
            }
            block[32..32 + PAYLOAD].fill(0xFF);
            block[32..32 + piece.len()].copy_from_slice(piece);
            block[BLOCK - 4..].copy_from_slice(&LAST_MAGIC.to_le_bytes());
            blocks.extend(block);
        }
        Ok(blocks)
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        /// The bytes are typed from the specification, and the family is that of its list of families.
        #[test]
        fn a_block_has_the_header_of_the_specification() {
            let mut image = vec![0x11; 256];
            image.push(0x22);
            let blocks = write(0xE48B_FF56, 0x1000_0100, &image).expect("two blocks");
            assert_eq!(blocks.len(), 1_024);
            assert_eq!(blocks[..8], *b"UF2\n\x57\x51\x5D\x9E");
            assert_eq!(blocks[8..12], [0x00, 0x20, 0x00, 0x00], "flags");
            assert_eq!(blocks[12..16], [0x00, 0x01, 0x00, 0x10], "address");
            assert_eq!(blocks[16..20], [0x00, 0x01, 0x00, 0x00], "number of bytes");
            assert_eq!(blocks[20..28], [0, 0, 0, 0, 2, 0, 0, 0], "block 0 of 2");
            assert_eq!(blocks[28..32], [0x56, 0xFF, 0x8B, 0xE4], "family");
            assert_eq!(blocks[32..288], [0x11; 256]);
            assert_eq!(blocks[288..508], [0; 220]);
            assert_eq!(blocks[508..512], [0x30, 0x6F, 0xB1, 0x0A]);
            assert_eq!(blocks[524..540], [0, 2, 0, 0x10, 0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
            assert_eq!(blocks[544..546], [0x22, 0xFF], "the rest of a block is as erased");
        }
    }
}
