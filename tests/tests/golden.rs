//! Golden traces: replayed on the bench, and once more through the shell of a board.
//!
//! `UPDATE=1 cargo test -p standin-tests --test golden` rewrites what the drives do; read the
//! difference before you keep it.
#![allow(missing_docs, reason = "a test")]

use std::path::{Path, PathBuf};

use standin_firmware::device::Device;
use standin_firmware::md3::Md3;
use standin_sim::replay;
use standin_sim::trace::{Event, Fed, Power, Trace};
use standin_tests::on_shell;

fn make(kind: &str) -> Option<Box<dyn Device>> {
    (kind == "md3").then(|| Box::new(Md3::new()) as Box<dyn Device>)
}

/// The traces of a kind, with their texts.
fn traces(kind: &str) -> Vec<(PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("traces").join(kind);
    let files = std::fs::read_dir(&folder).expect("the traces are part of the project");
    let mut paths: Vec<PathBuf> = files.map(|file| file.expect("a file has a name").path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "no traces in {}", folder.display());
    paths.into_iter().map(|path| (path.clone(), std::fs::read_to_string(path).expect("text"))).collect()
}

#[test]
fn on_the_bench() {
    let update = std::env::var_os("UPDATE").is_some();
    for (path, text) in traces("md3") {
        if update {
            std::fs::write(&path, replay::rewrite(&text, &make).expect("a playable trace")).expect("written");
            continue;
        }
        let trace = Trace::parse(&text, &make).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert!(trace.events().any(|entry| matches!(entry.event, Event::Did(_))), "{}", path.display());
        let difference = replay::run(&trace, &make).expect("a playable trace");
        assert_eq!(difference, None, "{}", path.display());
    }
}

#[test]
fn on_the_shell_of_a_board() {
    const MEMORY: usize = 54;
    assert_eq!(usize::from(Md3::new().spec().memory), MEMORY);
    let mut played = 0;
    for (path, text) in traces("md3") {
        let trace = Trace::parse(&text, &make).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        // Where the power fails in a save is counted in stores; a board counts bytes.
        let cut = |fed: &Fed| matches!(fed, Fed::Power(Power::Cut(_)));
        if trace.events().any(|entry| matches!(&entry.event, Event::Fed(fed) if cut(fed))) {
            continue;
        }
        let seen = on_shell::play::<_, MEMORY>(&trace, Md3::new);
        let expected = on_shell::expected(&trace);
        for (seen, expected) in seen.iter().zip(&expected) {
            assert_eq!(seen, expected, "{}", path.display());
        }
        assert_eq!(seen.len(), expected.len(), "{}", path.display());
        played += 1;
    }
    assert!(played > 10);
}
