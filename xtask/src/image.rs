//! Reads linked programs (ELF files).

use anyhow::{Context, Result, bail, ensure};
use object::read::elf::{ElfFile32, ProgramHeader as _};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind, SymbolKind, elf};
use xshell::Shell;

use crate::checks::target_dir;

/// A program for a Cortex-M, as an ELF file.
pub(crate) struct Image(Vec<u8>);

/// Size of a program, in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    /// Code, constants, and initial values of variables.
    pub(crate) flash: u64,
    /// Variables, and the stack if one is reserved.
    pub(crate) ram: u64,
    /// Size of the stack.
    pub(crate) stack: u64,
}

impl Image {
    /// The program that cargo has built for a target, in a profile.
    pub(crate) fn of(sh: &Shell, target: &str, profile: &str, program: &str) -> Result<Self> {
        let path = target_dir(sh).join(target).join(profile).join(program);
        Ok(Self(sh.read_binary_file(path)?))
    }

    pub(crate) fn sizes(&self) -> Result<Sizes> {
        let (mut flash, mut ram) = (0, 0);
        let file = self.file()?;
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
            let has = |flag: u32| sh_flags & u64::from(flag) != 0;
            if !has(elf::SHF_ALLOC) {
                continue;
            }
            if section.kind() != SectionKind::UninitializedData {
                flash += section.size();
            }
            if has(elf::SHF_WRITE) {
                ram += section.size();
            }
        }
        let stack = match (self.symbol("_stack_start"), self.symbol("_stack_end")) {
            (Ok(top), Ok(bottom)) => top.saturating_sub(bottom),
            // A program that is linked but never flashed reserves no stack.
            _ => 0,
        };
        Ok(Sizes { flash, ram: ram + stack, stack })
    }

    /// Fails unless the vector table is at `vectors`, the stack is at the bottom of the RAM at `ram`, and no
    /// section lies in the stack.
    pub(crate) fn expect_map(&self, vectors: u64, ram: u64) -> Result<()> {
        let file = self.file()?;
        let table = self.symbol("__vector_table")?;
        ensure!(table == vectors, "the vector table is at {table:#x}, not at {vectors:#x}");
        let (bottom, top) = (self.symbol("_stack_end")?, self.symbol("_stack_start")?);
        ensure!(
            bottom == ram && bottom < top,
            "the stack is {bottom:#x}..{top:#x}, not the RAM from {ram:#x}"
        );
        let mut begins_with = None;
        for section in file.sections().filter(|section| section.size() > 0) {
            let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
            if sh_flags & u64::from(elf::SHF_ALLOC) == 0 {
                continue;
            }
            let (name, begin) = (section.name()?, section.address());
            let end = begin + section.size();
            ensure!(end <= bottom || begin >= top, "{name} lies in the stack");
            ensure!(sh_flags & u64::from(elf::SHF_WRITE) == 0 || begin >= top, "{name} does not lie in RAM");
            begins_with = begins_with.or(section.data_range(vectors, 4)?);
        }
        let begins_with = begins_with.and_then(|bytes| bytes.first_chunk()).copied().map(u32::from_le_bytes);
        ensure!(begins_with.map(u64::from) == Some(top), "the processor does not begin with that stack");
        Ok(())
    }

    /// Fails if an interrupt, or a function with one of `names` in its name, calls a function outside RAM: its call would wait
    /// while flash is erased. Only calls by name are seen.
    pub(crate) fn expect_in_ram(&self, ram: u64, names: &[&str]) -> Result<()> {
        let file = self.file()?;
        let functions: Vec<_> = file
            .symbols()
            .filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.size() > 0)
            .map(|symbol| (symbol.address() & !1, symbol.size(), symbol.name().unwrap_or_default()))
            .collect();
        let table = self.symbol("__vector_table")?;
        let code = |at: u64, size: u64| {
            file.sections().find_map(|section| section.data_range(at, size).ok().flatten())
        };
        // Vectors begin behind the stack pointer and the reset; the code begins behind them.
        let first = self.symbol("Reset")? & !1;
        let vectors = code(table, first.saturating_sub(table)).context("there is no vector table")?;
        let vectors =
            vectors.as_chunks().0.iter().skip(2).map(|word| u64::from(u32::from_le_bytes(*word)) & !1);
        let mut waiting: Vec<u64> = vectors.filter(|vector| *vector != 0).collect();
        for name in names {
            let before = waiting.len();
            waiting.extend(functions.iter().filter(|(.., of)| of.contains(name)).map(|(at, ..)| *at));
            ensure!(waiting.len() > before, "there is no function `{name}`");
        }
        let mut seen = Vec::new();
        while let Some(at) = waiting.pop() {
            let within = |(begin, size, _): &&(u64, u64, &str)| (*begin..*begin + *size).contains(&at);
            let Some(&(begin, size, name)) = functions.iter().find(within) else {
                bail!("there is no function at {at:#x}, which an interrupt calls")
            };
            ensure!(
                begin >= ram && !name.contains("Thunk"),
                "{name} does not run from RAM, and an interrupt calls it"
            );
            if seen.contains(&begin) {
                continue;
            }
            seen.push(begin);
            let bytes = code(begin, size).with_context(|| format!("{name} has no code"))?;
            let calls = (begin..).step_by(2).zip(bytes.windows(4).step_by(2));
            let inside = begin..begin + size;
            let calls = calls.filter_map(|(at, code)| branch(at, code)).filter(|to| !inside.contains(to));
            // A constant within the code may look like a call, but hardly like one of the beginning of a function.
            waiting.extend(calls.filter(|to| functions.iter().any(|(begin, ..)| begin == to)));
        }
        Ok(())
    }

    /// The value of a symbol.
    pub(crate) fn symbol(&self, name: &str) -> Result<u64> {
        let file = self.file()?;
        let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name));
        Ok(symbol.with_context(|| format!("there is no symbol `{name}`"))?.address())
    }

    /// The bytes that are flashed, from the address `base` on. Bytes between them are `0xFF`.
    pub(crate) fn flashed(&self, base: u32) -> Result<Vec<u8>> {
        let file = ElfFile32::<Endianness>::parse(self.0.as_slice())?;
        let mut flash = Vec::new();
        for header in file.elf_program_headers() {
            let endian = file.endian();
            let bytes =
                header.data(endian, self.0.as_slice()).ok().context("a segment is not in the file")?;
            if header.p_type(endian) != elf::PT_LOAD || bytes.is_empty() {
                continue;
            }
            let at = header.p_paddr(endian).checked_sub(base).context("a segment is not in flash")? as usize;
            flash.resize(flash.len().max(at + bytes.len()), 0xFF);
            flash[at..at + bytes.len()].copy_from_slice(bytes);
        }
        Ok(flash)
    }

    /// Number of places in the code that call a function that panics.
    pub(crate) fn panic_sites(&self) -> Result<u64> {
        let file = self.file()?;
        // `unwrap_failed`, `slice_index_fail` and similar functions panic on behalf of their callers.
        let panics =
            |name: &str| name.contains("4core") && (name.contains("9panicking") || name.contains("_fail"));
        let panics: Vec<u64> = file
            .symbols()
            .filter(|symbol| symbol.name().is_ok_and(panics))
            .map(|symbol| symbol.address() & !1)
            .collect();
        let mut sites = 0;
        for section in file.sections().filter(|section| section.kind() == SectionKind::Text) {
            let code = section.data()?;
            let here = (section.address()..).step_by(2);
            let targets = here.zip(code.windows(4).step_by(2)).filter_map(|(at, code)| branch(at, code));
            sites += targets.filter(|target| panics.contains(target)).count() as u64;
        }
        Ok(sites)
    }

    fn file(&self) -> Result<object::File<'_>> {
        Ok(object::File::parse(self.0.as_slice())?)
    }
}

/// Target of a `bl` or a `b.w` at this address (ARM DDI 0403, A7.7.12 and A7.7.18).
fn branch(at: u64, code: &[u8]) -> Option<u64> {
    let [a, b, c, d] = *code else { return None };
    let (first, second) = (u32::from(u16::from_le_bytes([a, b])), u32::from(u16::from_le_bytes([c, d])));
    if first & 0xF800 != 0xF000 || second & 0x9000 != 0x9000 {
        return None;
    }
    let sign = first >> 10 & 1;
    let [high, low] = [second >> 13 & 1, second >> 11 & 1].map(|bit| bit ^ sign ^ 1);
    let offset = sign << 24 | high << 23 | low << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
    // Extends the sign of the 25-bit offset.
    let offset = i64::from((offset << 7).cast_signed() >> 7);
    Some((at + 4).wrapping_add_signed(offset))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expected values are from `arm-none-eabi-objdump`.
    #[test]
    fn branches_lead_where_a_disassembler_says() {
        assert_eq!(branch(0x218, &[0x02, 0xF0, 0x17, 0xFE]), Some(0x2E4A), "bl");
        assert_eq!(branch(0x100, &[0xFF, 0xF7, 0xFE, 0xFF]), Some(0x100), "bl to itself");
        assert_eq!(branch(0x100, &[0xFF, 0xF7, 0x7E, 0xBF]), Some(0), "b.w");
        assert_eq!(branch(0x100, &[0x00, 0xF0, 0x02, 0x80]), None, "beq.w");
        assert_eq!(branch(0x100, &[0xBF, 0xF3, 0x4F, 0x8F]), None, "dsb");
    }
}
