//! Reads linked programs.

use anyhow::{Result, ensure};
use object::{Object, ObjectSection, SectionFlags, SectionKind, elf};
use xshell::Shell;

use crate::checks::target_dir;

/// A program in the release profile.
pub(crate) struct Image(Vec<u8>);

impl Image {
    /// The program of a target.
    pub(crate) fn of(sh: &Shell, target: &str, program: &str) -> Result<Self> {
        Ok(Self(sh.read_binary_file(target_dir(sh).join(target).join("release").join(program))?))
    }

    /// Bytes of code, of constants, and of RAM.
    pub(crate) fn sizes(&self) -> Result<[u64; 3]> {
        let (mut text, mut constants, mut ram) = (0, 0, 0);
        for section in object::File::parse(self.0.as_slice())?.sections() {
            let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
            let has = |flag: u32| sh_flags & u64::from(flag) != 0;
            match section.kind() {
                _ if !has(elf::SHF_ALLOC) => {}
                SectionKind::Text => text += section.size(),
                _ if has(elf::SHF_WRITE) => ram += section.size(),
                _ => constants += section.size(),
            }
        }
        Ok([text, constants, ram])
    }

    /// Fails unless a section begins at `address`.
    pub(crate) fn expect_at(&self, section: &str, address: u64) -> Result<()> {
        let file = object::File::parse(self.0.as_slice())?;
        let found = file.section_by_name(section).map(|section| section.address());
        ensure!(found == Some(address), "{section} lies at {found:#x?}, not at {address:#x}");
        Ok(())
    }
}

/// The head of a table of sizes.
pub(crate) fn head() -> String {
    format!("{:<16} {:<20} {:>8} {:>8} {:>8}\n", "bytes", "", ".text", ".rodata", "RAM")
}

/// A line of it.
pub(crate) fn row(name: &str, target: &str, [text, constants, ram]: [u64; 3]) -> String {
    format!("{name:<16} {target:<20} {text:>8} {constants:>8} {ram:>8}\n")
}
