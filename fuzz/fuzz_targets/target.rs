//! A target: the body of its own name.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| drivetwin_tests::fuzzed::run(env!("CARGO_BIN_NAME"), bytes));
