//! The boot loader of a Raspberry Pi Pico or Pico 2: a disk that takes a UF2, starts it and vanishes.

use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::board::NotStarted;
use crate::options::BoardPlace;
use crate::{board, clock};

/// A board with a boot loader that takes a UF2.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Model {
    /// Name for a user.
    name: &'static str,
    /// Name in `drivetwin flash`, which the board says, too.
    board: &'static str,
    /// Name of the file with all kinds of drive, as `cargo xtask uf2` writes it.
    file: &'static str,
    /// Label of the disk, and what its [`INFO`] says that the board is.
    disk: &'static str,
    /// Family of the chip in a UF2.
    family: u32,
    /// Addresses of the flash.
    flash: Range<u32>,
    /// Addresses of the RAM that a UF2 may fill: the boot loader then starts a program in RAM.
    ram: Range<u32>,
}

/// The Raspberry Pi Pico.
pub const PICO: Model = Model {
    name: "Pico",
    board: board::PICO,
    file: "drivetwin-pico.uf2",
    disk: "RPI-RP2",
    family: 0xE48B_FF56,
    flash: 0x1000_0000..0x1020_0000,
    ram: 0x2000_0000..0x2004_2000,
};

/// The Raspberry Pi Pico 2.
pub const PICO_2: Model = Model {
    name: "Pico 2",
    board: board::PICO_2,
    file: "drivetwin-pico2.uf2",
    disk: "RP2350",
    family: 0xE48B_FF59,
    flash: 0x1000_0000..0x1040_0000,
    ram: 0x2000_0000..0x2008_2000,
};

impl Model {
    /// What to do if the boot loader of a board of this model has not been started, in one sentence.
    fn not_started(&self, why: NotStarted) -> String {
        let Self { name, .. } = self;
        let why = match why {
            NotStarted::Failed(why) => why,
            NotStarted::Other { place, name: other } if other.is_empty() => {
                format!("the board at {place} does not say whether it is a {name}")
            }
            NotStarted::Other { place, name: other } => {
                return match [PICO, PICO_2].into_iter().find(|model| model.board == other) {
                    Some(of) => format!(
                        "the board at {place} is a {}, and not a {name}: use `drivetwin flash {other}`, or name another board",
                        of.name
                    ),
                    None => format!(
                        "the board at {place} says that it is a board {}, and not a {name}: name another board",
                        other.escape_debug()
                    ),
                };
            }
        };
        format!("{why}; to flash it, unplug it, and {BOOTSEL}")
    }
}

/// File on the disk of each boot loader that takes UF2s.
const INFO: &str = "INFO_UF2.TXT";
/// Way to the boot loader, for a user.
const BOOTSEL: &str = "hold its button BOOTSEL while you plug it into USB";

/// Number of bytes that are copied at once.
const PIECE: usize = 64 << 10;
/// Pause between two looks for the disk, and the number of looks: 10 s.
const PAUSE: Duration = Duration::from_millis(100);
const LOOKS: usize = 100;

/// A UF2 for a board.
#[derive(Clone, Debug)]
pub struct Image {
    model: Model,
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Image {
    /// Reads a UF2 for a board from a file; without a file, that which came with the program.
    ///
    /// # Errors
    /// One sentence: where the image was looked for, or why the file is no UF2 for this board.
    pub fn read(model: Model, file: Option<&Path>) -> Result<Self, String> {
        // Twice the flash, because a block of 512 bytes has 256 bytes of it.
        let most = 2 * u64::from(model.flash.end - model.flash.start);
        let path = file.map_or_else(|| beside_program(model.file), |file| Ok(file.to_owned()))?;
        let mut bytes = Vec::new();
        let read = File::open(&path).and_then(|file| file.take(most + 1).read_to_end(&mut bytes));
        read.map_err(|error| format!("{}: {error}", path.display()))?;
        if bytes.len() as u64 > most {
            return Err(format!("{} is larger than the flash of a {}", path.display(), model.name));
        }
        check(&model, &bytes).map_err(|wrong| format!("{} {wrong}", path.display()))?;
        Ok(Self { model, path, bytes })
    }

    /// File of the image.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of bytes of the file.
    #[must_use]
    pub fn size(&self) -> usize {
        self.bytes.len()
    }
}

/// The image that came with the program: in its folder, in the share folder beside that, or in `target` of a clone.
fn beside_program(image: &str) -> Result<PathBuf, String> {
    let program =
        std::env::current_exe().map_err(|error| format!("the program does not find itself: {error}"))?;
    let folder = program.parent().unwrap_or(Path::new("."));
    let above = folder.parent().unwrap_or(folder);
    let places = [folder.join(image), above.join("share/drivetwin").join(image), above.join(image)];
    let found = places.iter().find(|place| place.is_file()).cloned();
    found.ok_or_else(|| {
        let [first, second, third] = places.each_ref().map(|place| place.display());
        format!(
            "there is no image at {first}, {second} or {third}: make one with `cargo xtask uf2` in a clone of drivetwin, \
             and name it with --image"
        )
    })
}

/// Checks that all blocks of a file are those of a UF2 for a board (<https://github.com/microsoft/uf2>).
///
/// # Errors
/// The rest of a sentence about the file.
fn check(Model { name, family: own, flash, ram, .. }: &Model, bytes: &[u8]) -> Result<(), String> {
    const BLOCK: usize = 512;
    const MAGIC: [u32; 2] = [0x0A32_4655, 0x9E5D_5157];
    const LAST_MAGIC: u32 = 0x0AB1_6F30;
    const HAS_FAMILY: u32 = 0x2000;
    let word = |block: &[u8], at: usize| {
        block.get(at..).and_then(|bytes| bytes.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word))
    };
    let is_block =
        |block: &[u8]| [word(block, 0), word(block, 4)] == MAGIC && word(block, BLOCK - 4) == LAST_MAGIC;
    let (blocks, rest) = bytes.as_chunks::<BLOCK>();
    let Some(first) = blocks.first().filter(|first| is_block(*first)) else {
        return Err("is not a UF2".to_owned());
    };
    let count = word(first, 24) as usize;
    if blocks.len() != count || !rest.is_empty() {
        return Err(format!("is not whole: it has {} bytes, and should have {}", bytes.len(), count * BLOCK));
    }
    for (number, block) in blocks.iter().enumerate() {
        if !is_block(block) || word(block, 20) as usize != number {
            return Err(format!("is damaged: its block {number} is not one of a UF2"));
        }
        let family = (word(block, 8) & HAS_FAMILY != 0).then(|| word(block, 28));
        if family != Some(*own) {
            let family = family.map_or("none".to_owned(), |family| format!("{family:#010x}"));
            return Err(format!(
                "is a UF2 for another chip: its family is {family}, that of a {name} is {own:#010x}"
            ));
        }
        let (at, size) = (word(block, 12), word(block, 16));
        let end = at.saturating_add(size);
        let is_in = |memory: &Range<u32>| memory.start <= at && end <= memory.end;
        if !is_in(flash) && !is_in(ram) {
            return Err(format!(
                "does not fit a {name}: its block {number} has the addresses {at:#010x} to {end:#010x}, the flash has {:#010x} to \
                 {:#010x}, and the RAM {:#010x} to {:#010x}",
                flash.start, flash.end, ram.start, ram.end
            ));
        }
        if flash.contains(&at) != flash.contains(&word(first, 12)) {
            return Err(format!(
                "is for the flash and the RAM of a {name}, and its boot loader takes a UF2 for one of them"
            ));
        }
    }
    Ok(())
}

/// Places of the operating system where a boot loader shows itself.
#[derive(Clone, Debug)]
pub struct Places {
    /// Table of mounted disks, as Linux has it.
    pub mounts: PathBuf,
    /// Folder with a device for each label of a disk, as Linux has it.
    pub labels: PathBuf,
    /// Folder with a folder for each mounted disk, as macOS has it.
    pub volumes: PathBuf,
    /// Folder with a folder for each serial port, as Linux has it.
    pub ports: PathBuf,
}

impl Default for Places {
    fn default() -> Self {
        Self {
            mounts: "/proc/self/mounts".into(),
            labels: "/dev/disk/by-label".into(),
            volumes: "/Volumes".into(),
            ports: board::PORTS.into(),
        }
    }
}

impl Places {
    /// Disk of a board's boot loader, which a board that runs a drive is asked to start: the board at a place, or without a
    /// place the only one that is plugged in, if none is in its boot loader. `asked` is called with the place of the board
    /// that was asked. The disk must come within 10 s.
    ///
    /// # Errors
    /// One sentence that says what to do: name a board, press a button, mount a disk, unplug a board.
    pub fn disk(
        &self,
        model: Model,
        board: Option<&BoardPlace>,
        asked: impl FnOnce(&str),
    ) -> Result<Disk, String> {
        self.disk_with(model, board, asked, || clock::sleep(PAUSE))
    }

    fn disk_with(
        &self,
        model: Model,
        board: Option<&BoardPlace>,
        asked: impl FnOnce(&str),
        mut pause: impl FnMut(),
    ) -> Result<Disk, String> {
        let name = model.name;
        let place = match (self.find(&model)?, board) {
            (Some(disk), None) => return Ok(disk),
            (Some(disk), Some(_)) => {
                let folder = disk.folder.display();
                return Err(format!(
                    "a {name} is in its boot loader already, at {folder}: leave out --board, or unplug that {name}"
                ));
            }
            (None, Some(place)) => place.clone(),
            (None, None) => self.running_board(name)?,
        };
        let place = board::start_boot_loader(&self.ports, &place, model.board);
        let place = place.map_err(|why| model.not_started(why))?;
        asked(&place);
        // At first the disk may be there, but not mounted.
        let mut found = Ok(None);
        for _ in 0..LOOKS {
            found = self.find(&model);
            if let Ok(Some(disk)) = found {
                return Ok(disk);
            }
            pause();
        }
        found?;
        Err(format!(
            "the disk of the boot loader of the board at {place} does not come: unplug it, and {BOOTSEL}"
        ))
    }

    /// The only board that is plugged in.
    ///
    /// # Errors
    /// One sentence: there is none, or there are several.
    fn running_board(&self, name: &str) -> Result<BoardPlace, String> {
        match &board::plugged(&self.ports)[..] {
            [] => Err(format!("no {name} is in its boot loader: {BOOTSEL}")),
            [serial] => Ok(BoardPlace::Usb(serial.clone())),
            several => Err(format!(
                "several boards are plugged in: usb:{}; name one of them with --board",
                several.join(", usb:")
            )),
        }
    }

    /// Disk of the only board of a model that is in its boot loader; `None` if there is no boot loader.
    ///
    /// # Errors
    /// One sentence that says what to do: mount a disk, unplug a board.
    fn find(&self, Model { name, disk: label, .. }: &Model) -> Result<Option<Disk>, String> {
        let disks: Vec<(Disk, String)> =
            self.disks().into_iter().filter_map(|disk| disk.board().map(|board| (disk, board))).collect();
        let mut own: Vec<&Disk> =
            disks.iter().filter(|(_, board)| board == label).map(|(disk, _)| disk).collect();
        if let (Some(disk), true) = (own.pop(), own.is_empty()) {
            return Ok(Some(disk.clone()));
        }
        if !own.is_empty() {
            return Err(format!(
                "{} boards are in their boot loaders: leave one of them plugged in",
                own.len() + 1
            ));
        }
        if let Some((disk, board)) = disks.first() {
            let folder = disk.folder.display();
            return Err(format!(
                "the boot loader at {folder} is that of a board {board}, and the image is for a {name}"
            ));
        }
        let device = self.labels.join(label);
        if device.exists() {
            let device = fs::canonicalize(&device).unwrap_or(device);
            let device = device.display();
            return Err(format!(
                "the disk of the boot loader, {device}, is not mounted: mount it, for example with `udisksctl mount -b \
                 {device}`, and try again"
            ));
        }
        Ok(None)
    }

    /// All disks that can be those of boot loaders.
    fn disks(&self) -> Vec<Disk> {
        let table = fs::read(&self.mounts).unwrap_or_default();
        let table = String::from_utf8_lossy(&table);
        let mounted = table.lines().filter_map(|line| {
            let [device, folder, system] = line.split(' ').take(3).collect::<Vec<_>>()[..] else {
                return None;
            };
            // A look into another disk could wait for a network.
            (system == "vfat")
                .then(|| Disk { folder: unescaped(folder).into(), device: Some(unescaped(device).into()) })
        });
        let volumes = fs::read_dir(&self.volumes).into_iter().flatten().flatten();
        mounted.chain(volumes.map(|volume| Disk { folder: volume.path(), device: None })).collect()
    }
}

/// Text of a mount table, in which a backslash and three octal digits are a character.
fn unescaped(text: &str) -> String {
    let mut parts = text.split('\\');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let digits = part.get(..3).and_then(|digits| u8::from_str_radix(digits, 8).ok());
        match digits {
            Some(character) if character.is_ascii() => {
                plain.push(char::from(character));
                plain.push_str(&part[3..]);
            }
            _ => {
                plain.push('\\');
                plain.push_str(part);
            }
        }
    }
    plain
}

/// Disk of a boot loader.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Disk {
    folder: PathBuf,
    /// The device of the disk, if it is known. It vanishes earlier than a folder that is still mounted.
    device: Option<PathBuf>,
}

impl Disk {
    /// Folder where the disk is mounted.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Name of the board, from the boot loader itself; `None` if the disk is not that of a boot loader.
    fn board(&self) -> Option<String> {
        let info = fs::read(self.folder.join(INFO)).ok()?;
        let info = String::from_utf8_lossy(&info);
        let board = info.lines().find_map(|line| line.strip_prefix("Board-ID:"));
        board.map(|board| board.trim().to_owned())
    }

    fn is_gone(&self) -> bool {
        !self.folder.join(INFO).exists() || self.device.as_ref().is_some_and(|device| !device.exists())
    }

    /// Copies an image to the disk, and waits up to 10 s until the board has restarted. `progress` is called with the
    /// number of bytes that the disk has.
    ///
    /// # Errors
    /// One sentence: the copy failed, or the board did not restart.
    pub fn flash(&self, image: &Image, progress: impl FnMut(usize)) -> Result<(), String> {
        self.flash_with(image, progress, || clock::sleep(PAUSE))
    }

    fn flash_with(
        &self,
        image: &Image,
        mut progress: impl FnMut(usize),
        mut pause: impl FnMut(),
    ) -> Result<(), String> {
        let mut written = 0;
        let copied = copy(&image.bytes, &self.folder.join(image.model.file), |bytes, is_synced| {
            written = bytes;
            if is_synced {
                progress(bytes);
            }
        });
        let folder = self.folder.display();
        if let (Err(error), true) = (&copied, written < image.size()) {
            return Err(if self.is_gone() {
                format!("the disk {folder} vanished before the copy was complete: {BOOTSEL}, and try again")
            } else {
                format!("the image cannot be copied to {folder}: {error}")
            });
        }
        // The board restarts as soon as it has the last block, so the end of the copy may have failed.
        for _ in 0..LOOKS {
            if self.is_gone() {
                return Ok(());
            }
            pause();
        }
        Err(match copied {
            Ok(()) => format!(
                "{folder} has the image, but the board does not restart: unplug it, and plug it in again"
            ),
            Err(error) => format!("the image cannot be copied to {folder}: {error}"),
        })
    }
}

/// Copies bytes to a file. Reports the number of written bytes before and after the disk has them.
fn copy(bytes: &[u8], file: &Path, mut report: impl FnMut(usize, bool)) -> io::Result<()> {
    let mut file = File::create(file)?;
    let mut written = 0;
    for piece in bytes.chunks(PIECE) {
        file.write_all(piece)?;
        written += piece.len();
        report(written, false);
        file.sync_data()?;
        report(written, true);
    }
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use drivetwin_control::{Answer, Call, Hello, Refused};

    use super::*;
    use crate::board::tests::{Act, Fake, answer, hello};

    /// A folder of this test, which is removed at its end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let folder =
                std::env::temp_dir().join(format!("drivetwin-boot-loader-{name}-{}", std::process::id()));
            fs::create_dir_all(&folder).unwrap();
            Self(folder)
        }

        fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
            let path = self.0.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, content).unwrap();
            path
        }

        /// Places in this folder.
        fn places(&self) -> Places {
            let [mounts, labels, volumes, ports] =
                ["mounts", "labels", "Volumes", "tty"].map(|name| self.0.join(name));
            Places { mounts, labels, volumes, ports }
        }

        /// The control port of a board.
        fn port(&self, name: &str, serial: &str) {
            let device = format!("usb/{serial}");
            for (file, content) in [("idVendor", "1209"), ("idProduct", "0001"), ("serial", serial)] {
                self.file(&format!("{device}/{file}"), content);
            }
            let interface = self.file(&format!("{device}/1-1:1.2/interface"), "drivetwin control\n");
            let port = self.0.join("tty").join(name);
            fs::create_dir_all(&port).unwrap();
            std::os::unix::fs::symlink(interface.parent().unwrap(), port.join("device")).unwrap();
        }

        /// A mounted disk of a boot loader.
        fn disk(&self, folder: &str, board: &str) -> PathBuf {
            let info = format!("UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: {board}\r\n");
            self.file(&format!("{folder}/{INFO}"), info).parent().unwrap().to_owned()
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    const HOLD: &str = "hold its button BOOTSEL while you plug it into USB";

    /// A UF2, typed from the specification, with the family of an RP2040.
    fn uf2(count: u8) -> Vec<u8> {
        let block = |number: u8| {
            let mut block = [0; 512];
            block[..12].copy_from_slice(b"UF2\n\x57\x51\x5D\x9E\x00\x20\x00\x00");
            block[12..20].copy_from_slice(&[0, number, 0, 0x10, 0, 1, 0, 0]);
            block[20] = number;
            block[24] = count;
            block[28..32].copy_from_slice(&[0x56, 0xFF, 0x8B, 0xE4]);
            block[508..].copy_from_slice(&[0x30, 0x6F, 0xB1, 0x0A]);
            block
        };
        (0..count).flat_map(block).collect()
    }

    fn image(scratch: &Scratch, blocks: u8) -> Image {
        Image::read(PICO, Some(&scratch.file("image.uf2", uf2(blocks)))).unwrap()
    }

    #[test]
    fn a_file_that_is_no_uf2_for_a_pico_is_refused() {
        let scratch = Scratch::new("wrong");
        let whole = uf2(3);
        assert_eq!(check(&PICO, &whole), Ok(()));
        let with = |at: usize, byte: u8| {
            let mut wrong = whole.clone();
            wrong[at] = byte;
            wrong
        };
        for (wrong, expected) in [
            (b"\x7FELF".to_vec(), "is not a UF2"),
            (Vec::new(), "is not a UF2"),
            (with(0, 0), "is not a UF2"),
            (whole[..1_024].to_vec(), "is not whole: it has 1024 bytes, and should have 1536"),
            (whole[..1_535].to_vec(), "is not whole: it has 1535 bytes, and should have 1536"),
            (with(1_024 + 511, 0), "is damaged: its block 2 is not one of a UF2"),
            (with(512 + 20, 7), "is damaged: its block 1 is not one of a UF2"),
            (
                with(28, 0x59),
                "is a UF2 for another chip: its family is 0xe48bff59, that of a Pico is 0xe48bff56",
            ),
            (with(9, 0), "is a UF2 for another chip: its family is none, that of a Pico is 0xe48bff56"),
        ] {
            let path = scratch.file("wrong.uf2", wrong);
            assert_eq!(Image::read(PICO, Some(&path)).unwrap_err(), format!("{} {expected}", path.display()));
        }
        let large = scratch.file("large.uf2", vec![0; (4 << 20) + 1]);
        let said = Image::read(PICO, Some(&large)).unwrap_err();
        assert_eq!(said, format!("{} is larger than the flash of a Pico", large.display()));
        let said = Image::read(PICO, Some(&scratch.0.join("none.uf2"))).unwrap_err();
        assert!(said.ends_with("none.uf2: No such file or directory (os error 2)"), "{said}");
    }

    /// 2 MiB of flash from 0x10000000 on, and 264 KiB of RAM from 0x20000000 on (RP2040 Datasheet, 2.6).
    #[test]
    fn a_uf2_for_other_addresses_is_refused() {
        let with = |addresses: &[u32], size: u32| {
            let mut bytes = uf2(addresses.len() as u8);
            for (block, address) in bytes.chunks_mut(512).zip(addresses) {
                block[12..16].copy_from_slice(&address.to_le_bytes());
                block[16..20].copy_from_slice(&size.to_le_bytes());
            }
            check(&PICO, &bytes)
        };
        for right in [[0x1000_0000, 0x101F_FF00], [0x2000_0000, 0x2004_1F00]] {
            assert_eq!(with(&right, 256), Ok(()));
        }
        let memory = "the flash has 0x10000000 to 0x10200000, and the RAM 0x20000000 to 0x20042000";
        for (wrong, size, block) in [
            ([0x1000_0000, 0x1020_0000], 256, "block 1 has the addresses 0x10200000 to 0x10200100"),
            ([0x1000_0000, 0x101F_FF00], 476, "block 1 has the addresses 0x101fff00 to 0x102000dc"),
            ([0x0800_0000, 0x1000_0000], 256, "block 0 has the addresses 0x08000000 to 0x08000100"),
            ([0x2004_2000, 0x2000_0000], 256, "block 0 has the addresses 0x20042000 to 0x20042100"),
            ([0xFFFF_FF80, 0x2000_0000], 256, "block 0 has the addresses 0xffffff80 to 0xffffffff"),
        ] {
            assert_eq!(with(&wrong, size), Err(format!("does not fit a Pico: its {block}, {memory}")));
        }
        assert_eq!(
            with(&[0x1000_0000, 0x2000_0000], 256),
            Err("is for the flash and the RAM of a Pico, and its boot loader takes a UF2 for one of them"
                .to_owned())
        );
        let mut large = uf2(1);
        (large[14], large[28]) = (0x3F, 0x59);
        assert_eq!(check(&PICO_2, &large), Ok(()), "a Pico 2 has 4 MiB of flash");
    }

    #[test]
    fn a_pico_2_has_a_file_and_a_disk_of_its_own() {
        let scratch = Scratch::new("pico-2");
        let mut bytes = uf2(2);
        for block in bytes.chunks_mut(512) {
            block[28] = 0x59;
        }
        let path = scratch.file("image.uf2", &bytes);
        assert!(Image::read(PICO, Some(&path)).is_err());
        let image = Image::read(PICO_2, Some(&path)).unwrap();
        let said = Image::read(PICO_2, Some(&scratch.file("image-1.uf2", uf2(2)))).unwrap_err();
        assert!(said.ends_with("its family is 0xe48bff56, that of a Pico 2 is 0xe48bff59"), "{said}");
        let said = Image::read(PICO_2, None).unwrap_err();
        assert_eq!(said.matches("/drivetwin-pico2.uf2").count(), 3, "{said}");

        let other = scratch.disk("Volumes/RPI-RP2", "RPI-RP2");
        let said = scratch.places().find(&PICO_2).unwrap_err();
        assert!(said.contains(&format!("{}", other.display())) && said.ends_with("for a Pico 2"), "{said}");
        let folder = scratch.disk("Volumes/RP2350", "RP2350");
        let disk = scratch.places().find(&PICO_2).unwrap().unwrap();
        assert_eq!(disk.folder(), folder);
        let taken = disk.flash_with(&image, |_| (), || drop(fs::remove_file(folder.join(INFO))));
        assert_eq!(taken, Ok(()));
        assert_eq!(fs::read(folder.join("drivetwin-pico2.uf2")).unwrap(), bytes);
    }

    #[test]
    fn without_an_image_it_is_said_where_it_was_looked_for() {
        let said = Image::read(PICO, None).unwrap_err();
        assert_eq!(said.matches("/drivetwin-pico.uf2").count(), 3, "{said}");
        assert!(
            said.ends_with("`cargo xtask uf2` in a clone of drivetwin, and name it with --image"),
            "{said}"
        );
    }

    #[test]
    fn a_disk_is_found_in_the_table_of_mounts_and_among_the_volumes() {
        let scratch = Scratch::new("found");
        let folder = scratch.disk("my disks/RPI-RP2", "RPI-RP2");
        let escaped = folder.display().to_string().replace(' ', "\\040");
        scratch.file("mounts", format!("proc /proc proc rw 0 0\n/dev/sdx1 {escaped} vfat rw,nosuid 0 0\n"));
        let disk = Disk { folder, device: Some("/dev/sdx1".into()) };
        assert_eq!(scratch.places().find(&PICO), Ok(Some(disk)));

        let scratch = Scratch::new("volume");
        let folder = scratch.disk("Volumes/RPI-RP2", "RPI-RP2");
        fs::create_dir_all(scratch.0.join("Volumes/Macintosh HD")).unwrap();
        let disk = Disk { folder, device: None };
        assert_eq!(scratch.places().find(&PICO), Ok(Some(disk.clone())));
        // No board is asked.
        assert_eq!(scratch.places().disk(PICO, None, |place| panic!("{place} was asked")), Ok(disk));
    }

    #[test]
    fn without_the_disk_it_is_said_what_to_do() {
        let scratch = Scratch::new("none");
        let places = scratch.places();
        assert_eq!(places.find(&PICO), Ok(None));
        let disk = || places.disk(PICO, None, |place| panic!("{place} was asked")).unwrap_err();
        assert_eq!(disk(), format!("no Pico is in its boot loader: {HOLD}"));

        // A board that is unplugged in this moment.
        scratch.port("ttyACM9731", "E661");
        let said = disk();
        assert!(said.starts_with("/dev/ttyACM9731 (usb:E661) cannot be opened: "), "{said}");
        assert!(said.ends_with(&format!("; to flash it, unplug it, and {HOLD}")), "{said}");
        scratch.port("ttyACM9733", "E662");
        assert_eq!(
            disk(),
            "several boards are plugged in: usb:E661, usb:E662; name one of them with --board"
        );

        let device = scratch.file("labels/RPI-RP2", "");
        let device = fs::canonicalize(device).unwrap();
        let device = device.display();
        assert_eq!(
            places.find(&PICO),
            Err(format!(
                "the disk of the boot loader, {device}, is not mounted: mount it, for example with `udisksctl mount -b \
                 {device}`, and try again"
            ))
        );

        let folder = scratch.disk("Volumes/RP2350", "RP2350");
        let folder = folder.display();
        assert_eq!(
            places.find(&PICO),
            Err(format!(
                "the boot loader at {folder} is that of a board RP2350, and the image is for a Pico"
            ))
        );

        scratch.disk("Volumes/RPI-RP2", "RPI-RP2");
        assert!(places.find(&PICO).is_ok());
        scratch.disk("Volumes/RPI-RP2 1", "RPI-RP2");
        assert_eq!(
            places.find(&PICO),
            Err("2 boards are in their boot loaders: leave one of them plugged in".to_owned())
        );
    }

    /// A board that runs a drive, and takes the call that starts its boot loader in this way.
    fn running(bootloader: impl Fn(u16) -> Act + Send + 'static) -> Fake {
        let act = move |_, number, call: Call<'_>| match call {
            // Tables of another version, as those of a board that must be flashed.
            Call::Hello => Act::Send(answer(number, Ok(Answer::Hello(Hello { tables: 1, ..hello("md3") })))),
            Call::Bootloader => bootloader(number),
            _ => panic!("{call:?} is not needed"),
        };
        Fake::new(act, 1)
    }

    #[test]
    fn a_board_that_runs_a_drive_starts_its_boot_loader() {
        let scratch = Scratch::new("started");
        let (starts, started) = mpsc::channel();
        let board = running(move |_| {
            starts.send(()).unwrap();
            Act::Hang
        });
        let (mut asked, mut looks) = (Vec::new(), 0);
        let disk = scratch.places().disk_with(
            PICO,
            Some(&board.place),
            |place| asked.push(place.to_owned()),
            || {
                looks += 1;
                match looks {
                    // The disk is there, but not yet mounted.
                    2 => drop(scratch.file("labels/RPI-RP2", "")),
                    4 => drop(scratch.disk("Volumes/RPI-RP2", "RPI-RP2")),
                    _ => {}
                }
            },
        );
        assert_eq!(disk, Ok(Disk { folder: scratch.0.join("Volumes/RPI-RP2"), device: None }));
        let BoardPlace::Tcp(address) = &board.place else { panic!("{:?}", board.place) };
        assert_eq!((asked, looks), (vec![format!("tcp:{address}")], 4));
        assert_eq!(started.try_recv(), Ok(()));

        // A second board would be confused with the first one.
        let said = scratch.places().disk(PICO, Some(&board.place), |_| ()).unwrap_err();
        let folder = scratch.0.join("Volumes/RPI-RP2");
        let expected = "leave out --board, or unplug that Pico";
        let expected = format!("a Pico is in its boot loader already, at {}: {expected}", folder.display());
        assert_eq!(said, expected);
    }

    #[test]
    fn a_boot_loader_whose_disk_does_not_come_is_reported() {
        let scratch = Scratch::new("waits");
        for (label, expected) in [
            (None, format!(" does not come: unplug it, and {HOLD}")),
            (Some("labels/RPI-RP2"), ", and try again".to_owned()),
        ] {
            let board = running(|number| Act::Send(answer(number, Ok(Answer::Done))));
            let mut looks = 0;
            let said = scratch.places().disk_with(
                PICO,
                Some(&board.place),
                |_| (),
                || {
                    looks += 1;
                    if let (Some(label), 7) = (label, looks) {
                        scratch.file(label, "");
                    }
                },
            );
            let said = said.unwrap_err();
            assert!(said.starts_with("the disk of the boot loader") && said.ends_with(&expected), "{said}");
            assert_eq!(looks, 100);
        }
    }

    #[test]
    fn a_board_that_does_not_start_its_boot_loader_is_reported_at_once() {
        let scratch = Scratch::new("refuses");
        let ask = |board: &Fake| {
            let never = || panic!("nothing is waited for");
            scratch.places().disk_with(PICO, Some(&board.place), |_| never(), never).unwrap_err()
        };
        let said = ask(&running(|number| Act::Send(answer(number, Err(Refused::NotHere)))));
        let expected = format!(" has no boot loader that it can start; to flash it, unplug it, and {HOLD}");
        assert!(said.starts_with("the board at tcp:127.0.0.1:") && said.ends_with(&expected), "{said}");

        let other = |_, number, _: Call<'_>| {
            Act::Send(answer(number, Ok(Answer::Hello(Hello { version: 9, ..hello("md3") }))))
        };
        let said = ask(&Fake::new(other, 1));
        assert!(said.contains(" has version 9 of the control protocol, and this drivetwin has 1;"), "{said}");
        let said = ask(&Fake::new(|_, _, _| Act::Send(Vec::new()), 1));
        assert!(said.starts_with("the board at tcp:127.0.0.1:") && said.contains(" is in use"), "{said}");
    }

    #[test]
    fn a_board_of_another_model_goes_on() {
        let scratch = Scratch::new("other");
        for (board, model, expected) in [
            (
                "pico2",
                PICO,
                " is a Pico 2, and not a Pico: use `drivetwin flash pico2`, or name another board".to_owned(),
            ),
            (
                "pico",
                PICO_2,
                " is a Pico, and not a Pico 2: use `drivetwin flash pico`, or name another board".to_owned(),
            ),
            (
                "black-pill",
                PICO,
                " says that it is a board black-pill, and not a Pico: name another board".to_owned(),
            ),
            ("", PICO_2, format!(" does not say whether it is a Pico 2; to flash it, unplug it, and {HOLD}")),
        ] {
            let act = move |_, number, call: Call<'_>| match call {
                Call::Hello => Act::Send(answer(number, Ok(Answer::Hello(Hello { board, ..hello("md3") })))),
                _ => panic!("{call:?} may stop the drive"),
            };
            let fake = Fake::new(act, 1);
            let never = || panic!("nothing is waited for");
            let said = scratch.places().disk_with(model, Some(&fake.place), |_| never(), never).unwrap_err();
            assert!(said.starts_with("the board at tcp:127.0.0.1:") && said.ends_with(&expected), "{said}");
        }
    }

    #[test]
    fn an_image_is_copied_until_the_board_takes_the_disk_away() {
        let scratch = Scratch::new("copied");
        let image = image(&scratch, 200);
        for by_device in [true, false] {
            let folder = scratch.disk("Volumes/RPI-RP2", "RPI-RP2");
            let device = scratch.file("sdx1", "");
            let disk = Disk { folder: folder.clone(), device: by_device.then(|| device.clone()) };
            let (mut steps, mut looks) = (Vec::new(), 0);
            let done = disk.flash_with(
                &image,
                |bytes| steps.push(bytes),
                || {
                    looks += 1;
                    if looks == 3 {
                        fs::remove_file(if by_device { device.clone() } else { folder.join(INFO) }).unwrap();
                    }
                },
            );
            assert_eq!((done, looks), (Ok(()), 3));
            assert_eq!(steps, [65_536, 102_400]);
            assert_eq!(fs::read(folder.join("drivetwin-pico.uf2")).unwrap(), uf2(200));
        }
    }

    #[test]
    fn a_board_that_does_not_restart_is_reported() {
        let scratch = Scratch::new("stays");
        let disk = Disk { folder: scratch.disk("Volumes/RPI-RP2", "RPI-RP2"), device: None };
        let mut looks = 0;
        let said = disk.flash_with(&image(&scratch, 1), |_| (), || looks += 1).unwrap_err();
        assert!(said.ends_with("the board does not restart: unplug it, and plug it in again"), "{said}");
        assert_eq!(looks, 100);
    }

    #[test]
    fn a_disk_that_takes_nothing_is_reported_at_once() {
        let scratch = Scratch::new("full");
        let image = image(&scratch, 1);
        let folder = scratch.disk("Volumes/RPI-RP2", "RPI-RP2");
        // A folder where the file should be.
        fs::create_dir(folder.join("drivetwin-pico.uf2")).unwrap();
        let disk = Disk { folder: folder.clone(), device: None };
        let never = || panic!("nothing is waited for");
        let said = disk.flash_with(&image, |_| (), never).unwrap_err();
        assert!(said.starts_with(&format!("the image cannot be copied to {}: ", folder.display())), "{said}");
        fs::remove_file(folder.join(INFO)).unwrap();
        let said = disk.flash_with(&image, |_| (), never).unwrap_err();
        assert!(said.contains("vanished before the copy was complete: hold its button BOOTSEL"), "{said}");
    }

    #[test]
    fn a_mount_table_has_octal_escapes() {
        assert_eq!(unescaped("/a\\040b\\134c"), "/a b\\c");
        assert_eq!(unescaped("/a\\9b\\"), "/a\\9b\\");
    }
}
