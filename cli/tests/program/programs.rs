//! User programs of the RS drives: `asm`, `disasm`, `run --program`.

use std::process::Stdio;

use crate::running::{Running, Scratch, drivetwin, refused};

/// Source with a command that takes one line of the program and a command that takes two. The loop never
/// ends.
const SOURCE: &str = "again: mov_modbus_const SPEED, 1500\n jmp again\n";
/// Assembled lines of this source, by 6.9: 0Eh writes a constant to the holding register (type 3) 500Bh; 05h
/// jumps to line 0.
const LINES: [u8; 12] = [0x0E, 0x30, 0x0B, 0x50, 0xDC, 0x05, 0, 0, 0x05, 0, 0, 0];

/// Runs `drivetwin` and asserts that it succeeds. Returns what it prints.
fn prints(arguments: &[&str]) -> String {
    let output = drivetwin(arguments);
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    assert!(output.stderr.is_empty(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_program_goes_to_bytes_or_digits_and_back() {
    let scratch = Scratch::new("asm");
    let [source, binary, digits, again] =
        ["a.rsasm", "a.bin", "a.hex", "b.bin"].map(|name| scratch.file(name));
    std::fs::write(&source, SOURCE).unwrap();
    assert_eq!(prints(&["asm", &source, "-o", &binary]), "");
    assert_eq!(std::fs::read(&binary).unwrap(), LINES);

    let hex = "500B300E\n000005DC\n00000005\n";
    assert_eq!(prints(&["asm", &source, "--hex"]), hex);
    assert_eq!(prints(&["asm", &source, "--hex", "--output", &digits]), "");
    assert_eq!(std::fs::read_to_string(&digits).unwrap(), hex);

    std::fs::write(&source, prints(&["disasm", &binary])).unwrap();
    assert_eq!(prints(&["asm", &source, "-o", &again]), "");
    assert_eq!(std::fs::read(&again).unwrap(), LINES);
}

#[test]
fn an_error_in_a_program_is_one_sentence() {
    let scratch = Scratch::new("asm-wrong");
    let file = |name: &str, content: &[u8]| {
        let path = scratch.file(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let source = file("right.rsasm", SOURCE.as_bytes());
    let binary = scratch.file("never.bin");
    for (path, told) in [
        (
            file("typo.rsasm", b"; one\n  jpm 3\n"),
            "typo.rsasm:2:3: there is no command 'jpm'; the nearest is 'jmp'",
        ),
        (file("empty.rsasm", b""), "empty.rsasm:1:1: there is no command in this program"),
        (file("bytes.rsasm", b"jmp 3 ; \xFF"), "bytes.rsasm:1:9: this is not UTF-8 text"),
        (
            file("huge.rsasm", &vec![b'\n'; (1 << 20) + 1]),
            "huge.rsasm: a program's text has at most 1024 KiB",
        ),
        (scratch.file("nowhere.rsasm"), "nowhere.rsasm: No such file"),
        ("/dev/zero".into(), "/dev/zero: a program's text has at most 1024 KiB"),
        ("/".into(), "/: Is a directory"),
    ] {
        let said = refused(&["asm", &path, "-o", &binary]);
        assert!(said.contains(told), "{said}");
        let said = refused(&["run", "rs434544", "--program", &path]);
        assert!(said.contains(told), "{said}");
    }
    assert!(!std::path::Path::new(&binary).exists());
    for (path, told) in [
        (file("empty.bin", b""), "empty.bin: it is empty; a program has 1 to 1024 lines of 4 bytes"),
        (file("odd.bin", &[0; 7]), "odd.bin: a program has lines of 4 bytes, and 7 are no whole lines"),
        ("/dev/zero".into(), "/dev/zero: a program has at most 1024 lines of 4 bytes, and this is more"),
        (scratch.file("nowhere.bin"), "nowhere.bin: No such file"),
    ] {
        let said = refused(&["disasm", &path]);
        assert!(said.contains(told), "{said}");
    }
    for (arguments, told) in [
        (vec!["asm"], "<SOURCE>"),
        (vec!["asm", &source], "--output <FILE>"),
        (vec!["asm", &source, "-o", &source], "is the program's text; -o takes another file"),
        (vec!["asm", &source, "-o", "/nowhere/a.bin"], "/nowhere/a.bin: No such file"),
        (vec!["disasm"], "<FILE>"),
        (
            vec!["run", "md3", "--program", &source],
            "--program: md3 has no user programs; rs434544 and rs434546 have",
        ),
    ] {
        let said = refused(&arguments);
        assert!(said.contains(told), "{arguments:?}: {said}");
    }
    assert_eq!(std::fs::read_to_string(&source).unwrap(), SOURCE);
}

#[test]
fn a_drive_has_its_program_at_power_on_and_its_memory_keeps_it() {
    let scratch = Scratch::new("program");
    let (source, memory) = (scratch.file("a.rsasm"), scratch.file("a.nv"));
    std::fs::write(&source, SOURCE).unwrap();
    let runs = |options: &[&str]| {
        let manual = ["--time", "manual", "--fast-boot", "--nv", &memory];
        let drive = Running::start("rs434544", &[&manual, options].concat(), Stdio::inherit());
        drive.advance(0.1);
        let registers = &drive.drive()["registers"];
        let state = ["STATUS_USER_PROGRAM", "SPEED"].map(|name| registers[name].as_i64().unwrap());
        drive.kill();
        state
    };
    assert_eq!(runs(&["--program", &source, "--set", "MODE_USER_PROGRAM=3"]), [4, 1_500]);
    let kept = std::fs::read(&memory).unwrap();
    assert!(kept.windows(LINES.len()).any(|part| part == LINES));
    // The presets and the program are saved, so no further options are needed.
    assert_eq!(runs(&[]), [4, 1_500]);
    // Another program replaces the saved one.
    std::fs::write(&source, "mov_modbus_const SPEED, 700\nfor 1, 1").unwrap();
    assert_eq!(runs(&["--program", &source]), [5, 700]);

    // A file that belongs to another drive is not changed.
    let foreign = vec![7; 1 << 16];
    std::fs::write(&memory, &foreign).unwrap();
    let said = refused(&["run", "rs434544", "--program", &source, "--nv", &memory]);
    assert!(said.ends_with("a.nv is longer than the memory of rs434544"), "{said}");
    assert_eq!(std::fs::read(&memory).unwrap(), foreign);
}
