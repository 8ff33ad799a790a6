//! Checks of `docs/decisions`: ids are unique, the index is complete, and every id that the repository cites
//! exists.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Areas of decisions, each with its page.
const AREAS: [(&str, &str); 10] = [
    ("PROJECT", "project.md"),
    ("HOST", "host.md"),
    ("BENCH", "bench.md"),
    ("MODBUS", "modbus.md"),
    ("BOARD", "boards.md"),
    ("MD3", "md3.md"),
    ("QSB", "qsb.md"),
    ("RS434", "rs434.md"),
    ("MDROBOT", "mdrobot.md"),
    ("MDRIVE", "mdrive.md"),
];

/// Extensions of files that may cite a decision.
const EXTENSIONS: [&str; 11] = ["rs", "py", "mjs", "toml", "md", "trace", "x", "sh", "yml", "patch", "rsasm"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

fn page(name: &str) -> String {
    let path = root().join("docs/decisions").join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A decision as in its heading: `### MD3-17 Step counts are microsteps`.
struct Decision {
    page: &'static str,
    id: String,
    title: String,
}

impl Decision {
    /// The decision's row in the index.
    fn row(&self) -> String {
        format!("| {} | [{}]({}) |", self.id, self.title, self.place())
    }

    /// The page with the anchor that GitHub makes from the heading.
    fn place(&self) -> String {
        let anchor: String = format!("{} {}", self.id, self.title)
            .to_lowercase()
            .chars()
            .filter(|&c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
            .map(|c| if c == ' ' { '-' } else { c })
            .collect();
        format!("{}#{anchor}", self.page)
    }
}

/// All decisions, in the order of the areas and pages.
fn decisions() -> Vec<Decision> {
    let mut all = Vec::new();
    for (area, name) in AREAS {
        for heading in page(name).lines().filter_map(|line| line.strip_prefix("### ")) {
            let (id, title) = heading.split_once(' ').expect(heading);
            assert!(ids(id) == [id] && id.starts_with(&format!("{area}-")), "{name}: {heading}");
            all.push(Decision { page: name, id: id.to_owned(), title: title.to_owned() });
        }
    }
    all
}

/// The ids that a text cites: the name of an area, `-` and a number, not as a part of another word.
fn ids(text: &str) -> Vec<&str> {
    let word = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    text.split(|c| !word(c))
        .filter(|token| {
            token.split_once('-').is_some_and(|(area, number)| {
                AREAS.iter().any(|(known, _)| *known == area)
                    && !number.is_empty()
                    && number.bytes().all(|byte| byte.is_ascii_digit())
            })
        })
        .collect()
}

/// Returns true if a text cites a decision by its number without the area.
fn has_bare_number(text: &str) -> bool {
    let text = text.to_ascii_lowercase();
    text.match_indices("decision").any(|(at, word)| {
        let rest = &text[at + word.len()..];
        let rest = rest.strip_prefix('s').unwrap_or(rest);
        let number = rest.trim_start_matches(|c: char| c.is_whitespace() || matches!(c, '/' | '!' | '#'));
        let skipped = &rest[..rest.len() - number.len()];
        let apart = !skipped.is_empty() && !skipped.contains("\n\n");
        apart && number.starts_with(|c: char| c.is_ascii_digit())
    })
}

/// Files of the repository that may cite decisions, except build products.
fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            let hidden = name.starts_with('.') && name != ".ci" && name != ".github";
            if !hidden && name != "target" && name != "node_modules" {
                sources(&path, files);
            }
        } else if path.extension().is_some_and(|extension| EXTENSIONS.iter().any(|known| extension == *known))
        {
            files.push(path);
        }
    }
}

#[test]
fn ids_are_unique_and_without_gaps() {
    let mut numbers = BTreeMap::<_, Vec<u32>>::new();
    for decision in decisions() {
        let (area, number) = decision.id.split_once('-').unwrap();
        numbers.entry(area.to_owned()).or_default().push(number.parse().unwrap());
    }
    assert_eq!(numbers.len(), AREAS.len(), "each area has a decision");
    for (area, numbers) in numbers {
        let expected: Vec<u32> = (1..).take(numbers.len()).collect();
        assert_eq!(numbers, expected, "{area}: ids are never reused or renumbered, and none is left out");
    }
}

#[test]
fn the_index_has_every_decision() {
    let index = page("README.md");
    let rows: Vec<&str> =
        index.lines().filter(|line| ids(line.split('|').nth(1).unwrap_or_default()).len() == 1).collect();
    let expected: Vec<String> = decisions().iter().map(Decision::row).collect();
    for row in &expected {
        assert!(rows.contains(&row.as_str()), "docs/decisions/README.md lacks this row:\n{row}");
    }
    for row in &rows {
        assert!(expected.iter().any(|known| known == row), "no page has this row of the index:\n{row}");
    }
    assert_eq!(rows, expected, "rows in the order of the pages, each once");
}

/// Each note about real drives has a row in the list for hardware, and each row links to its decision.
#[test]
fn the_list_for_hardware_has_every_mark() {
    let all = decisions();
    let list = page("hardware.md");
    let rows: Vec<&str> = list.lines().filter(|line| line.starts_with("| [")).collect();
    for row in &rows {
        let id = ids(row).first().copied().unwrap_or_default();
        let decision = all.iter().find(|decision| decision.id == id).expect(row);
        assert!(row.starts_with(&format!("| [{id}]({}) |", decision.place())), "{row}");
    }
    for (_, name) in AREAS {
        let mut decision = None;
        for line in page(name).lines() {
            if line.starts_with('#') {
                decision = line.strip_prefix("### ").and_then(|heading| ids(heading).first().copied());
            } else if let Some(id) = decision
                && (line.contains("(HW") || line.contains("ardware only"))
            {
                let row = rows.iter().find(|row| row.starts_with(&format!("| [{id}](")));
                assert!(
                    row.is_some_and(|row| row.contains("*Reported*") || row.contains("*Reported.*")),
                    "{id}"
                );
            }
        }
    }
}

#[test]
fn every_cited_id_exists() {
    let known: Vec<String> = decisions().into_iter().map(|decision| decision.id).collect();
    let mut files = Vec::new();
    sources(&root(), &mut files);
    let mut unknown = Vec::new();
    let (mut of_code, mut of_tests) = (0, 0);
    for path in files {
        let text = String::from_utf8_lossy(&fs::read(&path).unwrap()).into_owned();
        let path = path.strip_prefix(root()).unwrap().display().to_string();
        for (number, line) in text.lines().enumerate() {
            for id in ids(line) {
                if !known.iter().any(|known| known == id) {
                    unknown.push(format!("{path}:{}: {id}", number + 1));
                }
                of_code += usize::from(path.starts_with("firmware"));
                of_tests += usize::from(path.starts_with("tests"));
            }
        }
        if has_bare_number(&text) {
            unknown.push(format!("{path}: a decision cited by a number without its area"));
        }
    }
    assert!(unknown.is_empty(), "no such decision:\n{}", unknown.join("\n"));
    assert!(of_code > 100 && of_tests > 300, "files were not found: {of_code} and {of_tests} citations");
}

/// The test builds ids from areas and numbers, so that this file does not cite decisions that do not exist.
#[test]
fn a_wrong_id_is_found() {
    let (wrong, tail) = (format!("QSB-{}", 99), format!("MD3-{}x", 1));
    let text = format!("({wrong}), {tail}, QSB-D, [MD3-17](md3.md), x-MD3-17");
    assert_eq!(ids(&text), [wrong.as_str(), "MD3-17"]);
    assert!(!decisions().iter().any(|decision| decision.id == wrong));
    assert!(has_bare_number(&format!("(decision{}14)", ' ')));
    assert!(has_bare_number(&format!("decisions{}12 and 13", "\n/// ")));
    assert!(!has_bare_number("What the decisions say of 14 registers."));
}
