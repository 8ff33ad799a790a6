//! Runs all inputs that the fuzzer has collected. `fuzz/corpus` has a folder of files for each target.
#![allow(missing_docs, reason = "a test")]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use drivetwin_tests::fuzzed;

fn corpus() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus")
}

#[test]
fn every_target_holds_for_its_corpus() {
    for name in fuzzed::names() {
        let files = fs::read_dir(corpus().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut files: Vec<_> = files.map(|file| file.expect("a file").path()).collect();
        files.sort();
        assert!(files.len() >= 5, "{name} has {} files", files.len());
        for file in files {
            let bytes = fs::read(&file).expect("a file");
            let held = std::panic::catch_unwind(|| fuzzed::run(name, &bytes));
            assert!(held.is_ok(), "{} does not hold", file.display());
        }
    }
}

#[test]
fn every_target_is_in_the_folder_of_the_fuzzer() {
    let manifest = include_str!("../../fuzz/Cargo.toml");
    let bins: BTreeSet<_> =
        manifest.lines().filter_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"')).collect();
    let mut wanted: BTreeSet<_> = fuzzed::names().collect();
    wanted.insert("drivetwin-fuzz");
    assert_eq!(bins, wanted);
}
