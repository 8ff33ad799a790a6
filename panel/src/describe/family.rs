//! The reference of a family of kinds on one page: first the differences, then each table once for all kinds.

use std::fmt::Write as _;

use drivetwin_firmware::device::Spec;

use super::{NOT_MODELLED, Section, sections};

/// The reference page in docs/ of kinds that share most of their tables.
pub(super) fn markdown(specs: &[&Spec]) -> String {
    let kinds: Vec<&str> = specs.iter().map(|spec| spec.kind).collect();
    let mut text = format!(
        "<!-- Made by `drivetwin describe {} --markdown`; not to be edited. -->\n\n# {}\n\n",
        kinds.join(" "),
        quoted(&kinds)
    );
    let products = specs
        .iter()
        .map(|spec| vec![format!("`{}`", spec.kind), spec.product.to_owned(), spec.manual.to_owned()]);
    table(&["Kind", "Product", "After"], products, &mut text);
    text.push_str("\nThe column § names sections of the manual.\n");
    let merged = merge(specs);
    let differences: Vec<_> = merged.iter().flat_map(|section| section.differences(specs.len())).collect();
    if !differences.is_empty() {
        text.push_str("\n## What differs\n\n");
        let kinds: Vec<String> = kinds.iter().map(|kind| format!("`{kind}`")).collect();
        let columns: Vec<&str> =
            ["Table", "Row"].into_iter().chain(kinds.iter().map(String::as_str)).collect();
        table(&columns, differences.into_iter(), &mut text);
    }
    for section in &merged {
        let _ = write!(text, "\n## {}\n\n", section.title);
        section.markdown(&kinds, &mut text);
    }
    text
}

/// A table that contains the rows of all kinds.
struct Merged {
    title: &'static str,
    /// Column headings; empty for a plain list.
    columns: &'static [&'static str],
    rows: Vec<Row>,
}

/// A row, and the indices of the kinds that have it.
struct Row {
    cells: Vec<String>,
    kinds: Vec<usize>,
}

/// Merges the tables of all kinds. The order is that of the first kind that has the table.
fn merge(specs: &[&Spec]) -> Vec<Merged> {
    let mut all: Vec<Merged> = Vec::new();
    for (kind, spec) in specs.iter().enumerate() {
        let mut behind = 0;
        for Section { title, columns, rows } in sections(spec) {
            let place = all.iter().position(|section| section.title == title).unwrap_or_else(|| {
                all.insert(behind, Merged { title, columns, rows: Vec::new() });
                behind
            });
            behind = place + 1;
            all[place].add(kind, rows);
        }
    }
    all
}

impl Merged {
    /// Adds the rows of a kind. A new row goes after another version of the same row (a row with the same
    /// key), or else after the row that precedes it in this kind.
    fn add(&mut self, kind: usize, rows: Vec<Vec<String>>) {
        let mut behind = 0;
        for cells in rows {
            let place = match self.rows.iter().position(|row| row.cells == cells) {
                Some(place) => {
                    self.rows[place].kinds.push(kind);
                    place
                }
                None => {
                    let version = self.rows.iter().rposition(|row| self.key(&row.cells) == self.key(&cells));
                    let place = version.map_or(behind, |version| version + 1);
                    self.rows.insert(place, Row { cells, kinds: vec![kind] });
                    place
                }
            };
            behind = place + 1;
        }
    }

    /// The cell that identifies a row for readers: its name.
    fn key<'a>(&self, cells: &'a [String]) -> &'a str {
        let place = self.columns.iter().position(|column| *column == "Name").unwrap_or(0);
        cells.get(place).map_or("", String::as_str)
    }

    /// Lines of the table of differences: one for each row that is not the same in all `kinds` kinds, with the
    /// title of its table, the row, and a cell for each kind.
    fn differences(&self, kinds: usize) -> Vec<Vec<String>> {
        let mut told: Vec<&str> = Vec::new();
        let mut rows = Vec::new();
        // The limits of the emulation are left out: they are not properties of the product, and their
        // sentences are too long for a table.
        let rows_that_count = self.rows.iter().filter(|_| self.title != NOT_MODELLED);
        for row in rows_that_count.filter(|row| row.kinds.len() < kinds) {
            let key = self.key(&row.cells);
            if told.contains(&key) {
                continue;
            }
            told.push(key);
            let versions: Vec<&Row> = self.rows.iter().filter(|row| self.key(&row.cells) == key).collect();
            let differ = |column: &usize| {
                versions.iter().any(|version| version.cells.get(*column) != row.cells.get(*column))
            };
            let columns: Vec<usize> = (0..row.cells.len()).filter(differ).collect();
            let names: Vec<&str> = columns.iter().map(|&column| self.columns[column]).collect();
            let what = if names.is_empty() { key.to_owned() } else { format!("{key}: {}", names.join(", ")) };
            let cell = |kind: usize| match versions.iter().find(|version| version.kinds.contains(&kind)) {
                None => "–".to_owned(),
                Some(_) if columns.is_empty() => "yes".to_owned(),
                Some(version) => columns
                    .iter()
                    .map(|&column| version.cells[column].as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            };
            let cells: Vec<String> = (0..kinds).map(cell).collect();
            // Rows that exist in the same kinds only are joined into one line.
            match rows.iter_mut().find(|row: &&mut Vec<String>| columns.is_empty() && row[2..] == cells) {
                Some(row) => row[1] += &format!(", {what}"),
                None => rows.push([self.title.to_owned(), what].into_iter().chain(cells).collect()),
            }
        }
        rows
    }

    fn markdown(&self, kinds: &[&str], text: &mut String) {
        let only = |row: &Row| {
            let names: Vec<&str> = row.kinds.iter().map(|&kind| kinds[kind]).collect();
            (row.kinds.len() < kinds.len()).then(|| quoted(&names))
        };
        if self.columns.is_empty() {
            for row in &self.rows {
                let only = only(row).map(|only| format!(" (only {only})")).unwrap_or_default();
                let _ = writeln!(text, "- {}{only}", row.cells.join(": "));
            }
            return;
        }
        let mut columns = self.columns.to_vec();
        let all_alike = self.rows.iter().all(|row| only(row).is_none());
        if !all_alike {
            columns.push("Only");
        }
        let rows = self.rows.iter().map(|row| {
            let mut cells = row.cells.clone();
            if !all_alike {
                cells.push(only(row).unwrap_or_default());
            }
            cells
        });
        table(&columns, rows, text);
    }
}

/// Names in backticks.
fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}

fn table(columns: &[&str], rows: impl Iterator<Item = Vec<String>>, text: &mut String) {
    let _ = writeln!(text, "| {} |\n|{}", columns.join(" | "), "---|".repeat(columns.len()));
    for row in rows {
        let cells: Vec<String> = row.iter().map(|cell| cell.replace('|', "\\|")).collect();
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_sim::catalog;

    fn page(kinds: &[&str]) -> String {
        let specs: Vec<_> = kinds.iter().map(|kind| catalog::make(kind).unwrap().spec()).collect();
        super::markdown(&specs)
    }

    #[test]
    fn a_row_that_has_other_values_is_there_once_a_version() {
        let page = page(&["rs434544", "rs434546"]);
        assert!(page.contains(
            "| Registers | REF_CURRENT: Values, Default | 1000…20000, 0x4e20 | 2000…40000, 0x9c40 |\n"
        ));
        assert_eq!(page.matches("| 0x5009 | REF_CURRENT |").count(), 2);
        assert_eq!(page.matches("| 0x500b | SPEED |").count(), 1);
    }

    #[test]
    fn a_row_that_a_kind_lacks_is_at_its_place() {
        let page = page(&["qsb-d", "qsb-m", "qsb-s"]);
        let pins = "| Pins | DIO0 | yes | yes | – |\n| Pins | DIO1, DIO2, DIO3 | – | yes | – |\n";
        assert!(page.contains(pins), "{page}");
        let rows = ["| 0x0e | ReadEncoder", "| 0x0f | MdStepRate", "| 0x14 | Version"];
        let places = rows.map(|row| page.find(row).unwrap_or_else(|| panic!("no {row}")));
        assert!(places.is_sorted(), "{places:?}");
        let axes = page.split("\n## ").find(|section| section.starts_with("Axes")).unwrap();
        assert!(axes.contains("| motor | DIO1 | DIO2 | `qsb-m` |"), "{axes}");
    }
}
