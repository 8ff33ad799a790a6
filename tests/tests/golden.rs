//! Golden traces of every kind of drive, replayed on the bench and on the shell of a board.
//!
//! `UPDATE=1 cargo test -p drivetwin-tests --test golden` replaces the outputs in the traces by the present
//! ones. Read the difference before you keep it.
#![allow(missing_docs, reason = "a test")]

use std::fs;
use std::path::{Path, PathBuf};

use drivetwin_firmware::device::{Device, Instant};
use drivetwin_sim::record::trace::{Event, InputRecord, Power, Trace};
use drivetwin_sim::replay;
use drivetwin_tests::on_shell::{self, Seen};

/// Functions that make a drive of a kind, and that play its traces on the shell.
struct Kind {
    make: fn() -> Box<dyn Device>,
    play: fn(&Trace) -> Vec<(Instant, Seen)>,
}

macro_rules! kinds {
    ($($new:expr,)*) => {
        &[$(Kind { make: || Box::new($new()), play: |trace| on_shell::play(trace, $new) },)*]
    };
}

static KINDS: &[Kind] = drivetwin_firmware::devices!(kinds);

fn make(kind: &str) -> Option<Box<dyn Device>> {
    KINDS.iter().map(|kind| (kind.make)()).find(|device| device.spec().kind == kind)
}

fn parse(path: &Path, text: &str) -> Trace {
    Trace::parse(text, &make).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The traces of a kind with their texts. Every kind must have some.
fn traces(kind: &Kind) -> Vec<(PathBuf, String)> {
    let name = (kind.make)().spec().kind;
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("traces").join(name);
    let files = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = files.map(|file| file.expect("a file has a name").path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "no traces in {}", folder.display());
    paths.into_iter().map(|path| (path.clone(), fs::read_to_string(path).expect("text"))).collect()
}

#[test]
fn on_the_bench() {
    let update = std::env::var_os("UPDATE").is_some();
    for (path, text) in KINDS.iter().flat_map(traces) {
        if update {
            fs::write(&path, replay::rewrite(&text, &make).expect("a playable trace")).expect("written");
            continue;
        }
        let trace = parse(&path, &text);
        assert!(trace.events().any(|entry| matches!(entry.event, Event::Output(_))), "{}", path.display());
        let difference = replay::run(&trace, &make).expect("a playable trace");
        assert_eq!(difference, None, "{}", path.display());
    }
}

#[test]
fn on_the_shell_of_a_board() {
    // A trace counts stores until a power failure in a save, but a board counts bytes.
    let cut = |event: &Event| matches!(event, Event::Input(InputRecord::Power(Power::Cut(_))));
    for kind in KINDS {
        let mut played = 0;
        for (path, text) in traces(kind) {
            let trace = parse(&path, &text);
            if trace.events().any(|entry| cut(&entry.event)) {
                continue;
            }
            let seen = (kind.play)(&trace);
            let expected = on_shell::expected(&trace);
            for (seen, expected) in seen.iter().zip(&expected) {
                assert_eq!(seen, expected, "{}", path.display());
            }
            assert_eq!(seen.len(), expected.len(), "{}", path.display());
            played += 1;
        }
        assert!(played > 0, "{} plays nothing on a board", (kind.make)().spec().kind);
    }
}
