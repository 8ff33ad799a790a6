//! A fuzz target. It runs the body in `drivetwin-tests` that has the same name as this binary.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drivetwin_tests::fuzzed::run(env!("CARGO_BIN_NAME"), bytes));
