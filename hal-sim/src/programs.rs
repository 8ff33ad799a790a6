//! User programs of drives as text, for those who watch a drive.

use drivetwin_firmware::device::{Framing, Spec};
use drivetwin_firmware::{mdrive, rs434};

use crate::rsasm;

/// A line of a user program.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ProgramLine {
    /// Number of the line, or in MCode its address.
    pub at: u16,
    /// The line as text; of a drive of RS with its label in front.
    pub text: String,
}

/// Returns true if a kind of drive runs user programs.
#[must_use]
pub fn runs_on(spec: &Spec) -> bool {
    rsasm::runs_on(spec) || has_mcode(spec)
}

fn has_mcode(spec: &Spec) -> bool {
    spec.ports.iter().any(|port| port.framing == Framing::Return)
}

/// The user program in the content of a drive's memory; `None` if this kind of drive has no user programs.
///
/// ```
/// use drivetwin_sim::{catalog, programs, rsasm};
///
/// let memory = rsasm::Image::of(&rsasm::assemble("again: delay 500\njmp again")?).memory();
/// let spec = catalog::make("rs434544")?.spec();
/// let lines = programs::listing(spec, &memory).expect("it runs user programs");
/// assert_eq!((lines[0].at, lines[0].text.as_str()), (0, "line_0: delay 500"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn listing(spec: &Spec, memory: &[u8]) -> Option<Vec<ProgramLine>> {
    if rsasm::runs_on(spec) {
        let program: Vec<u32> = rs434::program::lines(memory).collect();
        let lines = rsasm::lines(&program).into_iter().map(|rsasm::Line { at, label, words }| {
            let text = match label {
                Some(label) => format!("{label}: {words}").trim_end().to_owned(),
                None => words,
            };
            ProgramLine { at: at as u16, text }
        });
        return Some(lines.collect());
    }
    has_mcode(spec).then(|| {
        let lines = mdrive::program_lines(memory);
        lines.map(|(at, line)| ProgramLine { at, text: String::from_utf8_lossy(line).into_owned() }).collect()
    })
}
