//! Folders of a crate use only folders below them, so a cycle of dependencies is possible only within a
//! folder.

use std::fs;
use std::path::{Path, PathBuf};

/// Modules of `hal-sim/src`, lowest first.
const HAL_SIM: [&str; 20] = [
    "ids",
    "rng",
    "suggest",
    "value",
    "catalog",
    "rsasm",
    "programs",
    "record",
    "decode",
    "scheduler",
    "signals",
    "line",
    "slot",
    "bench",
    "blocking",
    "board",
    "replay",
    "export",
    "config",
    "commands",
];

/// Modules of `panel/src`, lowest first.
const PANEL: [&str; 7] = ["units", "faults", "schema", "requests", "describe", "page", "live"];

/// Modules of `host/src`, lowest first.
const HOST: [&str; 16] = [
    "options",
    "clock",
    "milestones",
    "rs_programs",
    "nv_file",
    "output_file",
    "live_file",
    "ports",
    "board",
    "boot_loader",
    "streams",
    "event_loop",
    "lender",
    "api",
    "banner",
    "run",
];

/// Modules of `python/src`, lowest first.
const PYTHON: [&str; 10] =
    ["errors", "server", "shared", "views", "tables", "named", "line", "recording", "drive", "bench"];

/// Crate roots, and modules that only tests use.
const APART: [&str; 2] = ["lib", "testing"];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files
}

/// The modules of the own crate that a source file names, outside comments and tests.
fn used(text: &str) -> Vec<&str> {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines
        .flat_map(|line| line.split("crate::").skip(1))
        .filter_map(|rest| rest.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').next())
        .filter(|module| module.starts_with(|c: char| c.is_ascii_lowercase()))
        .collect()
}

fn check(krate: &str, order: &[&str]) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(krate).join("src");
    let rank = |module: &str| order.iter().position(|other| *other == module);
    let (mut wrong, mut uses) = (Vec::new(), 0);
    for path in sources(&root) {
        let inside = path.strip_prefix(&root).unwrap();
        let is_test = inside.components().any(|part| part.as_os_str().to_string_lossy().starts_with("tests"));
        let first = inside.components().next().unwrap().as_os_str().to_str().unwrap();
        let module = first.trim_end_matches(".rs");
        if is_test || APART.contains(&module) {
            continue;
        }
        let Some(own) = rank(module) else {
            wrong.push(format!("{module} has no place in the order"));
            continue;
        };
        for other in used(&fs::read_to_string(&path).unwrap()) {
            uses += usize::from(other != module);
            if rank(other).is_none_or(|other| other > own) {
                wrong.push(format!("{} uses {other}", inside.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{krate}: {wrong:#?}");
    assert!(uses > 5, "{krate}: the uses were not found");
}

#[test]
fn folders_of_the_bench_use_only_those_below() {
    check("hal-sim", &HAL_SIM);
}

#[test]
fn modules_of_the_panel_use_only_those_below() {
    check("panel", &PANEL);
}

#[test]
fn folders_of_the_host_use_only_those_below() {
    check("host", &HOST);
}

#[test]
fn modules_of_the_python_package_use_only_those_below() {
    check("python", &PYTHON);
}

#[test]
fn uses_in_comments_and_tests_do_not_count() {
    let text = "use crate::bench::Bench;\n// crate::board\nlet a = crate::slot::B::new(crate::line::c());\n#[cfg(test)]\nmod tests {\n    use crate::config;\n}\n";
    assert_eq!(used(text), ["bench", "slot", "line"]);
}
