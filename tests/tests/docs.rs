//! Links in the Markdown files: each relative link leads to an existing file and, if it has an anchor, to a
//! heading there.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Component, Path, PathBuf};

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

/// Folders that contain no pages of this project.
const SKIPPED: [&str; 4] = ["target", "node_modules", ".git", ".pytest_cache"];

/// Markdown files below a folder.
fn pages(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !path.is_symlink() {
            if !SKIPPED.contains(&name) {
                found.extend(pages(&path));
            }
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Targets of links and pictures, and anchors of headings.
fn links_and_anchors(text: &str) -> (Vec<String>, BTreeSet<String>) {
    let (mut links, mut anchors) = (Vec::new(), BTreeSet::new());
    let mut seen: HashMap<String, usize> = HashMap::new();
    let mut heading: Option<String> = None;
    for event in Parser::new_ext(text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                links.push(dest_url.to_string());
            }
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::Text(text) | Event::Code(text) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&text);
                }
            }
            Event::End(TagEnd::Heading(_)) => {
                let anchor = anchor(&heading.take().unwrap_or_default());
                let count = seen.entry(anchor.clone()).or_default();
                anchors.insert(if *count == 0 { anchor } else { format!("{anchor}-{count}") });
                *count += 1;
            }
            _ => {}
        }
    }
    (links, anchors)
}

/// The anchor that GitHub makes from a heading.
fn anchor(heading: &str) -> String {
    let kept = heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .collect::<String>();
    kept.trim().replace(' ', "-")
}

/// A path without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => _ = plain.pop(),
            Component::CurDir => {}
            part => plain.push(part),
        }
    }
    plain
}

/// Relative links with a missing target, each with its page.
fn broken(root: &Path) -> Vec<String> {
    let mut broken = Vec::new();
    for page in pages(root) {
        let (links, _) = links_and_anchors(&fs::read_to_string(&page).unwrap());
        for link in links.iter().filter(|link| !link.contains("://") && !link.starts_with("mailto:")) {
            let (path, anchor) =
                link.split_once('#').map_or((link.as_str(), None), |(path, anchor)| (path, Some(anchor)));
            let target =
                if path.is_empty() { page.clone() } else { plain(&page.parent().unwrap().join(path)) };
            let leads = target.exists()
                && anchor.is_none_or(|anchor| {
                    target.is_file()
                        && links_and_anchors(&fs::read_to_string(&target).unwrap()).1.contains(anchor)
                });
            if !leads {
                broken.push(format!("{}: {link}", page.strip_prefix(root).unwrap().display()));
            }
        }
    }
    broken
}

#[test]
fn every_relative_link_leads_somewhere() {
    let root = plain(&Path::new(env!("CARGO_MANIFEST_DIR")).join(".."));
    assert!(pages(&root).len() > 20);
    assert_eq!(broken(&root), Vec::<String>::new());
}

#[test]
fn the_readme_counts_the_golden_traces() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = fs::read_dir(root.join("traces")).unwrap().map(|folder| folder.unwrap().path());
    let count: usize = folders.map(|folder| fs::read_dir(folder).unwrap().count()).sum();
    let readme = fs::read_to_string(root.join("../README.md")).unwrap();
    assert!(readme.contains(&format!("| {count} golden traces of")), "there are {count}");
}

#[test]
fn a_link_that_leads_nowhere_is_found() {
    let root = std::env::temp_dir().join(format!("drivetwin-{}-links", std::process::id()));
    fs::create_dir_all(root.join("docs")).unwrap();
    let page = "# One\n\n## It's `a` *b*: 2\n\n## One\n\n[x](docs/b.md#two) [x](#its-a-b-2) [x](#one-1) ![x](docs)\n\n\
                [x](no.md) [x](#two) [x](docs/b.md#three) [x](docs/c.md) [x](https://nowhere.invalid) `[x](code.md)`\n";
    fs::write(root.join("a.md"), page).unwrap();
    fs::write(root.join("docs/b.md"), "# Two\n\n[x](../a.md#one) [x][r]\n\n[r]: ../b.md\n").unwrap();
    let found = broken(&root);
    fs::remove_dir_all(&root).unwrap();
    assert_eq!(
        found,
        ["a.md: no.md", "a.md: #two", "a.md: docs/b.md#three", "a.md: docs/c.md", "docs/b.md: ../b.md"]
    );
}

#[test]
fn the_picture_of_the_documentation_is_what_plot_draws() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let make = |kind: &str| drivetwin_sim::catalog::make(kind).ok();
    let text = fs::read_to_string(root.join("tests/traces/md3/7.15-move.trace")).unwrap();
    let trace = drivetwin_sim::record::trace::Trace::parse(&text, &make).unwrap();
    let options = drivetwin_sim::export::plot::Options { title: "move.trace".into(), ..Default::default() };
    let drawn = drivetwin_sim::export::plot::svg(&trace, &make, &options).unwrap();
    let file = fs::read_to_string(root.join("docs/how-to/move.svg")).unwrap();
    assert!(
        drawn == file,
        "copy tests/traces/md3/7.15-move.trace to move.trace, then `drivetwin plot move.trace -o docs/how-to/move.svg`"
    );
}
