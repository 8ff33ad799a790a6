//! User programs of the RS drives in files: `drivetwin asm`, `drivetwin disasm`, `drivetwin run --program`.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::Path;

use drivetwin_firmware::device::Spec;
use drivetwin_firmware::rs434::LINES;
use drivetwin_sim::catalog;
use drivetwin_sim::rsasm::{self, Image};

/// Maximum size of the text of a program, in bytes.
const MOST_TEXT: usize = 1 << 20;

/// Assembles the program in the file `source` into the file `output`, as bytes or as hexadecimal text. Without
/// `output` returns the hexadecimal text.
///
/// # Errors
/// One sentence that names the file and the error.
pub fn asm(source: &Path, output: Option<&Path>, hex: bool) -> Result<String, String> {
    let program = assemble(source)?;
    let as_hex = || program.iter().map(|line| format!("{line:08X}\n")).collect::<String>();
    let Some(output) = output else { return Ok(as_hex()) };
    let path = output.display();
    if let (Ok(from), Ok(to)) = (fs::canonicalize(source), fs::canonicalize(output))
        && from == to
    {
        return Err(format!("{path} is the program's text; -o takes another file"));
    }
    let bytes = if hex { as_hex().into_bytes() } else { rsasm::to_bytes(&program) };
    fs::write(output, bytes).map_err(|error| format!("{path}: {error}"))?;
    Ok(String::new())
}

/// Disassembles a program to text that assembles to the same bytes.
///
/// # Errors
/// One sentence that names the file and the error.
pub fn disasm(file: &Path) -> Result<String, String> {
    let path = file.display();
    let bytes = read(file, 4 * LINES)?;
    let program = rsasm::from_bytes(&bytes).map_err(|sentence| format!("{path}: {sentence}"))?;
    Ok(rsasm::disassemble(&program))
}

/// Assembles a program for a drive.
///
/// # Errors
/// One sentence that says what is wrong: the drive has no user programs, or the error in the program.
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
    let path = source.display();
    let text = read(source, MOST_TEXT)?;
    if text.len() > MOST_TEXT {
        return Err(format!(
            "{path}: a program's text has at most {} KiB, and this is more",
            MOST_TEXT >> 10
        ));
    }
    rsasm::assemble_bytes(&text).map_err(|error| format!("{path}:{error}"))
}

/// Reads at most `most` bytes of a file, and one more byte that shows that the file is longer.
fn read(file: &Path, most: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let opened = File::open(file).and_then(|file| file.take(most as u64 + 1).read_to_end(&mut bytes));
    opened.map(|_| bytes).map_err(|error| format!("{}: {error}", file.display()))
}
