//! `--record`: the content of the file, and the time at which it is written.

use std::io::Write as _;
use std::path::Path;

use drivetwin_protocol::modbus::rtu;
use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Trace, whole_lines};
use drivetwin_sim::replay;
use rustix::process::{Signal, kill_process};

use crate::running::{Running, Scratch, ask, drivetwin, refused, spawn};

/// Path of a file that the program at commit 681fd38 made. These files are never regenerated.
fn old(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/recordings/681fd38");
    folder.join(name).to_str().unwrap().to_owned()
}

fn assert_replays(file: &str) {
    let replayed = drivetwin(&["replay", file]);
    assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");
}

#[test]
fn old_recordings_replay() {
    // The whole file is read, but the replay differs: in this recording an MDrive takes no time for a typed
    // text line, which it does since MDRIVE-34.
    let bench = drivetwin(&["replay", &old("bench.trace")]);
    let said = String::from_utf8(bench.stdout).unwrap();
    assert!(bench.status.code() == Some(1) && said.contains("mdrive < message:mcode"), "{said}");
    assert_replays(&old("answers-ahead.trace"));
    assert_replays(&old("preset-at-start.trace"));
}

#[test]
fn old_memories_are_loaded() {
    let scratch = Scratch::new("old-memories");
    for (kind, register, value) in [
        ("md3", "UserRegister", 78),
        ("md3-low", "UserRegister", 78),
        ("mdrive", "VM", 400_000),
        ("mdrive-hybrid", "VM", 400_000),
        ("rs434544", "", 7),
        ("rs434546", "", 7),
        ("mdrobot", "", 7),
    ] {
        let file = scratch.file(kind);
        std::fs::copy(old(&format!("{kind}.nv")), &file).unwrap();
        let options = ["--time", "manual", "--fast-boot", "--control", "localhost:0", "--nv", &file];
        let drive = Running::start(kind, &options, std::process::Stdio::inherit());
        let registers = &drive.drive()["registers"];
        // Every memory with a bus address was saved with address 7.
        let described: serde_json::Value =
            serde_json::from_slice(&drivetwin(&["describe", kind, "--json"]).stdout).unwrap();
        let register =
            described["address_register"].as_str().filter(|_| register.is_empty()).unwrap_or(register);
        assert_eq!(registers[register], value, "{kind} {register}");
    }
}

#[test]
fn whatever_ends_it_the_recording_is_there() {
    let scratch = Scratch::new("ends");
    for signal in [Signal::HUP, Signal::QUIT, Signal::TERM, Signal::KILL] {
        if is_ignored(signal) {
            // If this test runs with `nohup`, the program ignores the signal, too.
            continue;
        }
        let file = scratch.file("md3.trace");
        std::fs::write(&file, "an old recording, which ends".repeat(10_000)).unwrap();
        let md3 = Running::md3(&["--time", "manual", "--fast-boot", "--record", &file]);
        ask(&mut md3.connect(), &rtu::write(1, 0x1D, 7), 8);
        md3.advance(0.5);
        kill_process(md3.pid(), signal).unwrap();
        let killed = signal == Signal::KILL;
        assert_eq!(md3.wait(), if killed { None } else { Some(0) }, "{signal:?}");
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains("< tx 01 06 00 1D 00 07"), "{signal:?}: {text}");
        assert_eq!(text.trim_end().ends_with(" end"), !killed, "{signal:?}: {text}");
        assert_replays(&file);
    }
}

/// Returns whether this process, and therefore its children, ignores a signal.
fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    u64::from_str_radix(mask.trim(), 16).unwrap() >> (signal.as_raw() - 1) & 1 == 1
}

#[test]
fn a_kill_leaves_whole_lines_of_waveforms_and_whole_blocks_of_frames() {
    let scratch = Scratch::new("killed");
    let (waves, frames) = (scratch.file("md3.vcd"), scratch.file("md3.pcapng"));
    let md3 = Running::md3(&["--time", "manual", "--fast-boot", "--vcd", &waves, "--pcap", &frames]);
    // MotionControl 1: move (MD3 7.15).
    let request = rtu::write(1, 0x11, 1);
    ask(&mut md3.connect(), &request, 8);
    md3.advance(0.5);
    kill_process(md3.pid(), Signal::KILL).unwrap();
    assert_eq!(md3.wait(), None);
    let text = std::fs::read_to_string(&waves).unwrap();
    // 1,250 steps, each with a rising and a falling edge.
    assert!(text.ends_with('\n') && text.lines().count() > 2_500, "{} lines", text.lines().count());
    let file = std::fs::read(&frames).unwrap();
    let (mut rest, mut said) = (&file[..], 0);
    while let Some(&length) = rest.get(4..).and_then(<[u8]>::first_chunk) {
        let (block, behind) =
            rest.split_at_checked(u32::from_le_bytes(length) as usize).expect("a whole block");
        assert!(block.ends_with(&length), "{block:02x?}");
        said += usize::from(block.windows(8).any(|part| part == &request[..]));
        rest = behind;
    }
    assert_eq!((rest, said), (&[][..], 2), "the request and its reply");
}

/// A process that is killed during a write leaves an incomplete text line, and perhaps only some events of an
/// instant.
#[test]
fn a_recording_replays_wherever_it_is_cut() {
    for name in ["answers-ahead", "preset-at-start"] {
        let file = std::fs::read(old(&format!("{name}.trace"))).unwrap();
        let first_line = file.iter().position(|&byte| byte == b'\n').unwrap();
        for length in first_line + 1..file.len() {
            let (lines, is_cut) = whole_lines(&file[..length]);
            assert_eq!(
                is_cut,
                file[length - 1] != b'\n' && length < file.len() - 1,
                "{name}, {length} bytes"
            );
            let trace = Trace::parse(std::str::from_utf8(lines).unwrap(), &|kind| catalog::make(kind).ok());
            let difference = replay::run(&trace.unwrap(), &|kind| catalog::make(kind).ok());
            assert_eq!(difference, Ok(None), "{name}, {length} bytes");
        }
    }
}

#[test]
fn half_a_line_is_left_out_at_the_end_of_a_recording_only() {
    let scratch = Scratch::new("half");
    let file = scratch.file("md3.trace");
    let text =
        "drivetwin trace 1\ndrive md3 md3 fast\ncompare tx\n1000.000000 > rx 01 03 00 14 00 01 C4 0E\n";
    std::fs::write(&file, format!("{text}1006.1 < tx 01 0")).unwrap();
    let replayed = drivetwin(&["replay", &file]);
    let said = String::from_utf8(replayed.stdout).unwrap();
    let expected = format!("{file}: the last line is incomplete and is ignored\n{file}: as expected\n");
    assert_eq!((replayed.status.code(), said), (Some(0), expected));
    // The incomplete line ends with a half of a character of two bytes.
    std::fs::write(&file, [text.as_bytes(), b"# \xC3"].concat()).unwrap();
    assert_replays(&file);
    std::fs::write(&file, format!("{text}1006.1 < tx 01 0\n2000 end\n")).unwrap();
    assert!(refused(&["replay", &file]).contains("line 5"));
    std::fs::write(&file, format!("{text}2000 end")).unwrap();
    let replayed = drivetwin(&["replay", &file]);
    assert_eq!(replayed.status.code(), Some(1), "the answer is missing: {replayed:?}");
}

#[test]
fn a_recording_is_a_picture() {
    let scratch = Scratch::new("picture");
    let (trace, picture) = (scratch.file("x.trace"), scratch.file("x.svg"));
    let text = "drivetwin trace 1\ndrive x md3 fast\n100 > rx 01 06 00 11 00 01 18 0F\n3000 end\n";
    std::fs::write(&trace, text).unwrap();
    let drawn = drivetwin(&["plot", &trace, "-o", &picture]);
    assert_eq!((drawn.status.code(), drawn.stdout.len()), (Some(0), 0), "{drawn:?}");
    let file = std::fs::read_to_string(&picture).unwrap();
    for words in ["<svg", "x.trace", "position", "write MotionControl = 1", "data-pin=\"STEP\""] {
        assert!(file.contains(words), "{words}");
    }
    let drawn = drivetwin(&["plot", &trace]);
    assert_eq!(String::from_utf8(drawn.stdout).unwrap(), file);
    let part = drivetwin(&["plot", &trace, "--from", "0.2", "--to", "0.3", "--drive", "x"]);
    let part = String::from_utf8(part.stdout).unwrap();
    assert!(part.contains("time in ms") && !part.contains("write MotionControl"));

    // HOST-25.
    let image = scratch.file("x.png");
    if cfg!(feature = "png") {
        assert_eq!(drivetwin(&["plot", &trace, "-o", &image]).status.code(), Some(0));
        assert!(std::fs::read(&image).unwrap().starts_with(b"\x89PNG\r\n"));
    } else {
        let said = refused(&["plot", &trace, "-o", &image]);
        assert!(
            said.contains(&format!("-o {image}: this program was built without PNG; install it with")),
            "{said}"
        );
        assert!(!std::path::Path::new(&image).exists());
    }

    assert!(refused(&["plot", &trace, "--drive", "y"]).contains("there is no drive 'y'"));
    assert!(refused(&["plot", &trace, "--from", "5"]).contains("the trace ends at 3 s"));
    std::fs::write(&trace, format!("{text}nonsense")).unwrap();
    let cut = drivetwin(&["plot", &trace, "-o", &picture]);
    let said = String::from_utf8(cut.stderr).unwrap();
    assert!(cut.status.code() == Some(0) && said.contains("the last line is incomplete"), "{said}");
    std::fs::write(&trace, format!("{text}nonsense\n")).unwrap();
    assert!(refused(&["plot", &trace]).contains("line 5"));
    std::fs::write(&trace, text.replace("drive x", "lost 5\ndrive x")).unwrap();
    assert!(refused(&["plot", &trace]).contains("the first 5 events of this trace were dropped"));
}

#[test]
fn a_trace_from_standard_input_is_a_picture() {
    let mut child = spawn(
        std::process::Command::new(env!("CARGO_BIN_EXE_drivetwin"))
            .args(["plot", "-"])
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped()),
    );
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(b"drivetwin trace 1\ndrive r qsb-d fast\n100 > rx \"R0E\\r\"\n200 end\n").unwrap();
    drop(stdin);
    let drawn = child.wait_with_output().unwrap();
    assert!(drawn.status.success());
    assert!(String::from_utf8(drawn.stdout).unwrap().contains("read ReadEncoder = 0"));
}
