//! The first words of doc comments: counts comments that do not name their subject.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use xshell::{Shell, cmd};

/// First words of comments that ask a question instead of making a statement.
const QUESTIONS: [&str; 8] = ["What", "Whether", "When", "How", "Where", "Who", "Whose", "Why"];

/// First words of comments that refer to something that is not named yet.
const POINTERS: [&str; 13] = [
    "It",
    "Its",
    "Of",
    "That",
    "Those",
    "This",
    "They",
    "Nobody",
    "Somebody",
    "Something",
    "Nothing",
    "One",
    "He",
];

/// Numbers of doc comments in one crate.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Count {
    comments: usize,
    questions: usize,
    pointers: usize,
}

/// Prints the share of such comments in each crate; with `list` also the comments themselves.
pub(crate) fn print(sh: &Shell, list: bool) -> Result<()> {
    let files = cmd!(sh, "git ls-files *.rs").quiet().read()?;
    let mut rows: BTreeMap<String, Count> = BTreeMap::new();
    for file in files.lines() {
        let text = sh.read_file(file)?;
        let mut folders = Path::new(file).ancestors().skip(1);
        let folder =
            folders.find(|folder| sh.path_exists(folder.join("Cargo.toml"))).unwrap_or(Path::new(""));
        let count = rows.entry(folder.display().to_string()).or_default();
        for (line, first) in first_lines(&text) {
            let (is_question, is_pointer) = judge(first);
            count.comments += 1;
            count.questions += usize::from(is_question);
            count.pointers += usize::from(is_pointer);
            if list && (is_question || is_pointer) {
                println!("{file}:{line}: {first}");
            }
        }
    }
    let total = rows.values().fold(Count::default(), |sum, count| Count {
        comments: sum.comments + count.comments,
        questions: sum.questions + count.questions,
        pointers: sum.pointers + count.pointers,
    });
    println!("{:<32} {:>8} {:>18} {:>12}", "", "comments", "What, Whether, …", "It, Of, …");
    for (name, count) in rows.iter().chain([(&"all".to_owned(), &total)]) {
        let share = |part: usize| format!("{:.1} %", 100.0 * part as f64 / count.comments.max(1) as f64);
        println!(
            "{name:<32} {:>8} {:>18} {:>12}",
            count.comments,
            share(count.questions),
            share(count.pointers)
        );
    }
    Ok(())
}

/// The first line of each doc comment, with its number.
fn first_lines(text: &str) -> Vec<(usize, &str)> {
    let mut before = false;
    let mut firsts = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let comment = ["///", "//!"].iter().find_map(|mark| line.trim_start().strip_prefix(mark));
        if let Some(comment) = comment
            && !before
        {
            firsts.push((number, comment.trim()));
        }
        before = comment.is_some();
    }
    firsts
}

/// Returns whether the first word of a comment is a question, and whether it is a pointer.
fn judge(comment: &str) -> (bool, bool) {
    let word = comment.split(|c: char| !c.is_alphabetic()).next().unwrap_or_default();
    (QUESTIONS.contains(&word), POINTERS.contains(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_are_judged_by_their_first_word() {
        let text = "//! Frames.\n//! What else.\n\n/// What a frame is.\n/// More.\nstruct A;\n    /// Its end.\n    b: u8,\n";
        let firsts = first_lines(text);
        assert_eq!(firsts, [(1, "Frames."), (4, "What a frame is."), (7, "Its end.")]);
        let judged: Vec<_> = firsts.iter().map(|(_, first)| judge(first)).collect();
        assert_eq!(judged, [(false, false), (true, false), (false, true)]);
        assert_eq!(judge("Offset of a row."), (false, false));
    }
}
