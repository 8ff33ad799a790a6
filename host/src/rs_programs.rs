//! User programs of the RS drives in files: `drivetwin asm`, `drivetwin disasm`, `drivetwin run --program`.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::Path;

use drivetwin_firmware::device::Spec;
use drivetwin_firmware::rs434::LINES;
use drivetwin_sim::catalog;
use drivetwin_sim::rsasm::{self, Image};

/// More bytes than the text of a program needs.
const MOST_TEXT: usize = 1 << 20;

/// Assembles the program `source` into the file `output`, as bytes or as `hex`; without a file returns the hexadecimal
/// text.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub fn asm(source: &Path, output: Option<&Path>, hex: bool) -> Result<String, String> {
    let program = assemble(source)?;
    let as_hex = || program.iter().map(|line| format!("{line:08X}\n")).collect::<String>();
    let Some(output) = output else { return Ok(as_hex()) };
    let place = output.display();
    if let (Ok(from), Ok(to)) = (fs::canonicalize(source), fs::canonicalize(output))
        && from == to
    {
        return Err(format!("{place} is the program's text; -o takes another file"));
    }
    let bytes = if hex { as_hex().into_bytes() } else { rsasm::to_bytes(&program) };
    fs::write(output, bytes).map_err(|error| format!("{place}: {error}"))?;
    Ok(String::new())
}

/// An assembled program as text.
///
/// # Errors
/// One sentence: what is wrong, and where.
pub fn disasm(file: &Path) -> Result<String, String> {
    let place = file.display();
    let bytes = read(file, 4 * LINES)?;
    let program = rsasm::from_bytes(&bytes).map_err(|sentence| format!("{place}: {sentence}"))?;
    Ok(rsasm::disassemble(&program))
}

/// Assembles a program for a drive.
///
/// # Errors
/// One sentence: the drive has no programs, or what is wrong with it.
pub(crate) fn load(file: &Path, spec: &Spec) -> Result<Image, String> {
    if !rsasm::runs_on(spec) {
        let kinds: Vec<_> =
            catalog::specs().filter(|spec| rsasm::runs_on(spec)).map(|spec| spec.kind).collect();
        let kinds = kinds.join(" and ");
        return Err(format!("{} has no user programs; {kinds} have", spec.kind));
    }
    Ok(Image::of(&assemble(file)?))
}

fn assemble(source: &Path) -> Result<Vec<u32>, String> {
    let place = source.display();
    let text = read(source, MOST_TEXT)?;
    if text.len() > MOST_TEXT {
        return Err(format!(
            "{place}: a program's text has at most {} KiB, and this is more",
            MOST_TEXT >> 10
        ));
    }
    rsasm::assemble_bytes(&text).map_err(|error| format!("{place}:{error}"))
}

/// A file, or a byte more than `most` of it.
fn read(file: &Path, most: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let opened = File::open(file).and_then(|file| file.take(most as u64 + 1).read_to_end(&mut bytes));
    opened.map(|_| bytes).map_err(|error| format!("{}: {error}", file.display()))
}
