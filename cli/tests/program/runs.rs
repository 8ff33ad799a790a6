//! Options, exit codes, files, ports.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _, pipe};
use std::net::{Shutdown, TcpListener};
use std::os::fd::OwnedFd;
use std::path::Path;

use crate::running::{Running, Scratch, ask, drivetwin, refused, spawn};
use drivetwin_protocol::modbus::rtu;
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat};
use rustix::process::{Resource, Rlimit, getrlimit, prlimit};
use rustix::termios::{ControlModes, LocalModes, OptionalActions, tcgetattr, tcsetattr};
use serde_json::{Value, json};

const USER_REGISTER: u16 = 0x1D;
const EEPROM_CONTROL: u16 = 0x1A;

#[test]
fn an_error_in_options_is_one_sentence() {
    let in_a_file = Scratch::new("options");
    let file = in_a_file.file("something");
    std::fs::write(&file, "something").unwrap();
    let linked = format!("pty:{file}");
    let both = in_a_file.file("both");
    let boards = in_a_file.file("boards.toml");
    std::fs::write(&boards, "[[drive]]\nname = 'b'\nboard = 'usb:E661'\n").unwrap();
    for (arguments, told) in [
        (
            vec![],
            "a command is missing: run, attach, view, check, list, describe, replay, plot, asm, disasm, flash; see `drivetwin --help`",
        ),
        (vec!["walk"], "unrecognized subcommand 'walk'"),
        (vec!["run"], "<KIND|BENCH.toml>"),
        (vec!["run", "md4"], "there is no kind 'md4'; the nearest is 'md3'"),
        (
            vec!["run", "plotter"],
            "there is no kind 'plotter'; available: md3, md3-low, qsb-d, qsb-m, qsb-s, rs434544, rs434546, mdrobot",
        ),
        (
            vec!["run", "qsb-s", "--set", "MdAccel=1"],
            "MdAccel is a register of other variants; qsb-s does not have it",
        ),
        (vec!["run", "qsb-s", "--set", "Threshhold=1"], "the nearest is 'Threshold'"),
        (vec!["run", "qsb-m", "--set", "Version=1"], "Version cannot be preset"),
        (vec!["run", "qsb-d", "--address", "1"], "qsb-d has no bus address"),
        (vec!["run", "/nowhere/bench.toml"], "/nowhere/bench.toml: No such file"),
        (vec!["run", "bench.toml", "--listen", "pty:"], "--listen is for a single drive only; in bench.toml"),
        (vec!["run", "bench.toml", "--address", "1"], "--address is for a single drive only; in bench.toml"),
        (vec!["run", "bench.toml", "--nv", "x.nv"], "set it in [[drive]], for instance nv = \"x.nv\""),
        (vec!["run", "bench.toml", "--set", "Speed=1"], "--set is for a single drive only; in bench.toml"),
        (vec!["run", "bench.toml", "--program", "x"], "--program is for a single drive only; in bench.toml"),
        (
            vec!["run", "md3", "--listen", "serial:/nowhere/tty"],
            "serial:/nowhere/tty cannot be opened: No such file",
        ),
        (
            vec!["run", "md3", "--listen", "serial:/dev/null"],
            "serial:/dev/null cannot be opened: not a serial",
        ),
        (vec!["run", "md3", "--json", "--listen", "stdio:"], "--json and stdio: cannot share stdout"),
        (vec!["run", "md3", "--listen", "stdio:", "--listen", "stdio:"], "stdio: is given twice"),
        (
            vec!["run", "md3", "--listen", "rs422=pty:"],
            "there is no port of md3 'rs422'; the nearest is 'rs485'",
        ),
        (vec!["run", "md3", "--listen", &linked], "something else than a link is there"),
        (vec!["run", "md3", "--listen", "tcp:203.0.113.1:0"], "cannot listen at tcp:203.0.113.1:0"),
        (
            vec!["run", "md3", "--listen", "rfc2217://127.0.0.1:1"],
            "rfc2217: takes HOST:PORT, like rfc2217:127.0.0.1:5020",
        ),
        (
            vec!["attach", "tcp:127.0.0.1:1", "--bus", "stdio:"],
            "it takes serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT",
        ),
        (vec!["run", "md3", "--listen", "rfc2217:203.0.113.1:0"], "cannot listen at rfc2217:203.0.113.1:0"),
        (
            vec!["run", "mdrive", "--listen", "rfc2217:127.0.0.1:0"],
            "--listen: modbus of mdrive is a TCP port; use tcp:",
        ),
        (vec!["run", "md3", "--control", "loopback"], "--control"),
        (vec!["run", "md3", "--seed", "abc"], "it takes a whole number from 0"),
        (vec!["run", "md3", "--set", "MotionControl=1"], "only bit 5 of MotionControl can be preset"),
        (vec!["run", "md3", "--listen", "pty:a", "--listen", "pty:a"], "pty:a is given twice"),
        (
            vec!["run", "md3", "--nv", &both, "--record", &both],
            "keeps the memory of a drive; use another file",
        ),
        (vec!["run", "md3", "--nv", &both, "--vcd", &both], "keeps the memory of a drive; use another file"),
        (vec!["run", "md3", "--record", &both, "--vcd", &both], "--vcd and --record are the same file"),
        (vec!["run", "md3", "--nv", &both, "--pcap", &both], "keeps the memory of a drive; use another file"),
        (vec!["run", "md3", "--vcd", &both, "--pcap", &both], "--pcap and --vcd are the same file"),
        (vec!["run", "md3", "--time", "x0"], "--time"),
        (
            vec!["run", "mdrive", "--strict"],
            "--strict: mdrive has no Modbus line, where frames need a silence of t3.5",
        ),
        (vec!["run", "qsb-d", "--strict"], "--strict: qsb-d has no Modbus line"),
        (
            vec!["run", &boards, "--fast-boot"],
            "boards.toml has no emulated drive; the image of a board has a start-up delay, or has none",
        ),
        (vec!["check", "md3"], "'md3' is not a bench file"),
        (vec!["check", "/nowhere/x.toml"], "/nowhere/x.toml: No such file"),
        (vec!["run", "-"], "standard input: line 1, column 1: a bench needs a [[drive]]"),
        (vec!["run", "md3", "--address", "248"], "--address: DeviceAddress takes 1 to 247, not 248"),
        (vec!["run", "md3", "--address", "one"], "'one' is not a number"),
        (
            vec!["run", "md3", "--set", "Speeed=1"],
            "there is no register of md3 'Speeed'; the nearest is 'Speed'",
        ),
        (vec!["run", "md3", "--set", "SpeedHigh=65536"], "SpeedHigh takes 0 to 65535, not 65536"),
        (vec!["run", "md3", "--set", "Speed"], "REG=VALUE"),
        (
            vec!["run", "mdrive", "--set", "V1=3"],
            "V1 cannot be preset: it exists only after a client or a program of the drive has declared it",
        ),
        (
            vec!["run", "mdrive", "--set", "HM=1"],
            "HM cannot be preset: other settings or the present state of the drive do not allow it; first preset the registers that it depends on",
        ),
        (vec!["run", "mdrive", "--set", "DN=a"], "DN takes 33 to 122, not 'a'"),
        (vec!["run", "md3", "--nv", "/"], "--nv: /: "),
        (vec!["run", "md3", "--nv", "/nowhere/md3.nv"], "--nv: /nowhere/md3.nv: "),
        (vec!["run", "md3", "--record", "/nowhere/md3.trace"], "--record /nowhere/md3.trace: "),
        (vec!["run", "md3", "--vcd", "/nowhere/md3.vcd"], "--vcd /nowhere/md3.vcd: No such file"),
        (vec!["run", "md3", "--vcd", "/dev/full"], "--vcd /dev/full: No space left"),
        (vec!["describe", "md3", "--json", "--markdown"], "cannot be used with"),
        (vec!["replay", "/nowhere/md3.trace"], "/nowhere/md3.trace: "),
        (vec!["plot", "/nowhere/md3.trace"], "/nowhere/md3.trace: "),
        (vec!["plot", "a.trace", "-o", "a.pdf"], "-o a.pdf: the name must end in .svg or .png"),
        (vec!["plot", "a.trace", "--from", "-1"], "--from"),
        (vec!["plot", "a.trace", "--to", "soon"], "it takes a number of seconds from 0 on, for instance 2.5"),
    ] {
        let said = refused(&arguments);
        assert!(said.contains(told), "{arguments:?}: {said}");
    }
}

#[test]
fn a_port_in_use_is_reported_before_any_change() {
    let scratch = Scratch::new("in-use");
    let (memory, trace) = (scratch.file("md3.nv"), scratch.file("md3.trace"));
    let waves = scratch.file("md3.vcd");
    std::fs::write(&trace, "an old recording").unwrap();
    std::fs::write(&waves, "old waveforms").unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let listen = format!("tcp:{address}");
    let files = ["run", "md3", "--nv", &memory, "--record", &trace, "--vcd", &waves];
    let options = [&files[..], &["--set", "UserRegister=7"]].concat();
    let said = refused(&[&options[..], &["--listen", &listen]].concat());
    assert_eq!(said, format!("{listen} is in use; use another port, or port 0 for any free one"));
    let said = refused(&[&options[..], &["--control", &address]].concat());
    assert!(said.starts_with(&format!("--control {address} is in use")), "{said}");
    assert!(!Path::new(&memory).exists());
    std::fs::create_dir(&memory).unwrap();
    refused(&options);
    assert_eq!(std::fs::read_to_string(&trace).unwrap(), "an old recording");
    assert_eq!(std::fs::read_to_string(&waves).unwrap(), "old waveforms");
}

#[test]
fn kinds_are_listed_and_described() {
    let text = |arguments: &[&str]| {
        let output = drivetwin(arguments);
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let parsed = |arguments: &[&str]| serde_json::from_str::<Value>(&text(arguments)).unwrap();
    let kinds = parsed(&["list", "--json"]);
    assert!(kinds.as_array().unwrap().iter().any(|kind| kind["kind"] == "md3"));
    assert!(text(&["list"]).contains("md3"));

    let md3 = parsed(&["describe", "md3", "--json"]);
    assert_eq!(md3["ports"][0]["line"], "9600 8E1");
    assert_eq!(md3["address_register"], "DeviceAddress");
    let speed = md3["registers"].as_array().unwrap().iter().find(|row| row["name"] == "Speed").unwrap();
    assert_eq!(
        (&speed["address"], &speed["default"], &speed["section"]),
        (&0x14.into(), &5_000.into(), &"7.17".into())
    );
    // 7.22 and 7.15.
    let fields = |name: &str| {
        let rows = md3["registers"].as_array().unwrap();
        rows.iter().find(|row| row["name"] == name).unwrap()["fields"].clone()
    };
    let parity = json!({"bits": "5:4", "name": "parity", "values": {"0": "none", "1": "odd", "2": "even"}});
    assert_eq!(fields("SerialPortConfiguration")[0], parity);
    assert_eq!(fields("MotionControl")[5], json!({"bits": "1", "name": "Jog", "values": {}}));
    for form in ["--json", "--markdown"] {
        assert_eq!(text(&["describe", "md3", form]), text(&["describe", "md3", form]));
    }
    let reference = text(&["describe", "md3", "--markdown"]);
    assert!(reference.contains("| 0x14–0x15 | Speed | 7.17 | i32 | R/W |"), "{reference}");
    assert!(text(&["describe", "md3"]).contains("7.17"));
}

#[test]
fn a_recording_survives_sigterm_and_replays() {
    let scratch = Scratch::new("record");
    let file = scratch.file("md3.trace");
    std::fs::write(&file, "an old recording, which ends").unwrap();
    let md3 =
        Running::md3(&["--time", "manual", "--fast-boot", "--record", &file, "--control", "localhost:0"]);
    // The new recording has begun and has replaced the old one.
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("drivetwin trace 1\n"));
    let reply = ask(&mut md3.connect(), &rtu::write(1, USER_REGISTER, 7), 8);
    assert_eq!(reply, *rtu::write(1, USER_REGISTER, 7));
    assert_eq!(md3.call("GET", "/api/trace?format=trace", "").body.lines().next(), Some("drivetwin trace 1"));
    assert_eq!(md3.stop(), Some(0));

    let replayed = drivetwin(&["replay", &file]);
    assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");
    let trace = std::fs::read_to_string(&file).unwrap();
    let changed = trace.replace("< tx 01 06 00 1D 00 07", "< tx 01 06 00 1D 00 08");
    assert_ne!(changed, trace);
    std::fs::write(&file, changed).unwrap();
    let replayed = drivetwin(&["replay", &file]);
    assert_eq!(replayed.status.code(), Some(1), "{replayed:?}");
    assert!(String::from_utf8(replayed.stdout).unwrap().contains("< tx 01 06 00 1D 00 07"));
    std::fs::write(&file, "drivetwin trace 1\nnonsense\n").unwrap();
    assert!(refused(&["replay", &file]).contains("line 2"));
}

/// The changes of a pin in a file of waveforms, with their times in ticks. The last text line may be
/// incomplete.
fn waves(file: &str, pin: &str) -> Vec<(char, u64)> {
    let text = std::fs::read_to_string(file).unwrap();
    let (text, _) = text.rsplit_once('\n').unwrap();
    let variable = text.lines().find(|line| line.ends_with(&format!(" {pin} $end"))).unwrap();
    let code = variable.split(' ').nth(3).unwrap();
    let (_, changes) = text.split_once("$enddefinitions $end").unwrap();
    let mut at = 0;
    let mut waves = Vec::new();
    for line in changes.lines() {
        if let Some(stamp) = line.strip_prefix('#') {
            // Converts from ns, which were rounded down, to ticks of 62.5 ns.
            at = (stamp.parse::<u64>().unwrap() * 2).div_ceil(125);
        } else if line.get(1..) == Some(code) {
            waves.push((line.chars().next().unwrap(), at));
        }
    }
    waves
}

#[test]
fn waveforms_survive_sigkill() {
    let scratch = Scratch::new("waves");
    let file = scratch.file("md3.vcd");
    std::fs::write(&file, "old waveforms, which end".repeat(1_000)).unwrap();
    let md3 = Running::md3(&["--time", "manual", "--fast-boot", "--vcd", &file]);
    ask(&mut md3.connect(), &rtu::write(1, 0x11, 1), 8);
    md3.call("PUT", "/api/drives/md3/pins/J2.2", "{\"level\":\"low\"}");
    md3.advance(3.0);
    md3.kill();
    assert_eq!(waves(&file, "STEP").iter().filter(|(level, _)| *level == '1').count(), 10_000);
    let busy = waves(&file, "J3_7");
    let [('z', 0), ('0', begins), ('z', ends)] = busy[..] else { panic!("{busy:?}") };
    assert_eq!(ends - begins, 2_500 * 16_000);
    let pulled = waves(&file, "J2_2");
    assert!(matches!(pulled[..], [('1', 0), ('0', 1..)]), "{pulled:?}");
}

#[test]
fn waveforms_follow_time_though_nothing_else_happens() {
    let scratch = Scratch::new("beats");
    let file = scratch.file("md3.vcd");
    let md3 = Running::md3(&["--time", "x100", "--fast-boot", "--control", "127.0.0.1:0", "--vcd", &file]);
    // The green light is on for a quarter of a second in every one and a half seconds.
    let beats = |n: u64| [('1', n * 24_000_000), ('0', n * 24_000_000 + 4_000_000)];
    let expected: Vec<(char, u64)> = (0..20).flat_map(beats).collect();
    while waves(&file, "D6").len() < expected.len() {
        std::thread::yield_now();
    }
    let seconds = md3.call("GET", "/api/bench", "").ok()["time"]["seconds"].as_f64().unwrap();
    assert_eq!(md3.stop(), Some(0));
    let beats = waves(&file, "D6");
    assert_eq!(beats[..expected.len()], expected);
    let text = std::fs::read_to_string(&file).unwrap();
    let end = text.lines().last().unwrap().strip_prefix('#').unwrap();
    assert!((end.parse::<f64>().unwrap() + 1.0) / 1e9 >= seconds, "it goes as far as the drive did");
}

/// Runs an MD3 with its memory in a file, in manual time, until it has started.
fn started(memory: &str, options: &[&str]) -> Running {
    let md3 = Running::md3(&[&["--time", "manual", "--nv", memory], options].concat());
    md3.advance(2.5);
    md3
}

fn register(md3: &Running, name: &str) -> i64 {
    md3.drive()["registers"][name].as_i64().unwrap()
}

#[test]
fn what_is_saved_survives_sigkill_and_presets_are_saved() {
    let scratch = Scratch::new("memory");
    let memory = scratch.file("md3.nv");
    let md3 = started(&memory, &["--address", "17", "--set", "SpeedLow=0x10", "--set", "IOPortData=1"]);
    assert_eq!((register(&md3, "DeviceAddress"), register(&md3, "Speed")), (17, 16));
    let mut line = md3.connect();
    ask(&mut line, &rtu::write(17, USER_REGISTER, 7), 8);
    ask(&mut line, &rtu::write(17, EEPROM_CONTROL, 1), 8);
    md3.advance(0.02);
    md3.kill();

    let md3 = started(&memory, &["--set", "SpeedHigh=1"]);
    assert_eq!((register(&md3, "DeviceAddress"), register(&md3, "UserRegister")), (17, 7));
    assert_eq!(register(&md3, "Speed"), 0x1_0010, "the other half is the one that was saved");
    assert_eq!(register(&md3, "EEPROMControl") >> 8, 0x9A);
}

#[test]
fn a_memory_is_kept_by_one_drive_at_a_time() {
    let scratch = Scratch::new("locked");
    let memory = scratch.file("md3.nv");
    let _md3 = Running::md3(&["--nv", &memory]);
    assert!(refused(&["run", "md3", "--nv", &memory]).contains("another drive keeps its memory there"));
}

#[test]
fn a_memory_of_another_drive_is_logged() {
    let scratch = Scratch::new("longer");
    let memory = scratch.file("mdrive.nv");
    std::fs::write(&memory, [0; 4_096]).unwrap();
    let (log, its_end) = pipe().unwrap();
    let drive = Running::start("mdrobot", &["--nv", &memory], its_end.into());
    assert_eq!(drive.stop(), Some(0));
    let said: Vec<String> = BufReader::new(log).lines().map(Result::unwrap).collect();
    assert!(said.iter().any(|line| line.contains("is longer than the memory of its drive")), "{said:?}");
    assert_eq!(std::fs::read(&memory).unwrap(), [0; 4_096], "no save has replaced it");
}

#[test]
fn an_invalid_memory_acts_as_in_the_manual_and_is_unchanged_until_a_save() {
    let scratch = Scratch::new("bad");
    let memory = scratch.file("md3.nv");
    for bad in [vec![0; 54], vec![0x55; 54], vec![0xFF; 1_000], vec![0; 1_000], vec![7; 10]] {
        std::fs::write(&memory, &bad).unwrap();
        let said = refused(&["run", "md3", "--nv", &memory, "--address", "2"]);
        assert!(said.contains("memory is bad"), "{said}");
        let md3 = started(&memory, &[]);
        // The drive first flashes its red light for 5 s (MD3-13).
        md3.advance(5.0);
        assert_eq!(register(&md3, "EEPROMControl") >> 8, 0xF1, "{bad:?}");
        assert_eq!(std::fs::read(&memory).unwrap(), bad);
        ask(&mut md3.connect(), &rtu::write(1, EEPROM_CONTROL, 1), 8);
        md3.advance(0.02);
        md3.kill();
        let md3 = started(&memory, &[]);
        assert_eq!(register(&md3, "EEPROMControl") >> 8, 0x9A, "{bad:?}");
        drop(md3);
    }
}

fn open(path: &Path) -> OwnedFd {
    rustix::fs::open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap()
}

#[test]
fn a_pty_is_linked_answers_and_is_ready_for_the_next_opener() {
    let scratch = Scratch::new("pty");
    let link = scratch.file("md3.tty");
    // A killed process left this link behind.
    std::os::unix::fs::symlink("/dev/pts/4000000", &link).unwrap();
    let listen = format!("pty:{link}");
    let md3 = Running::md3(&["--time", "manual", "--fast-boot", "--listen", &listen]);
    assert_eq!(std::fs::read_link(&link).unwrap(), md3.pty());
    let waiting = LocalModes::ECHOE | LocalModes::IEXTEN;
    for value in [1, 2, 3] {
        let port = open(Path::new(&link));
        let mut settings = tcgetattr(&port).unwrap();
        assert!(settings.local_modes.contains(waiting));
        assert!(!settings.local_modes.intersects(LocalModes::ECHO | LocalModes::ICANON));
        settings.make_raw();
        settings.local_modes.remove(waiting);
        // The second program sends at the wrong baud rate and gets no answer.
        settings.set_speed(if value == 2 { 19_200 } else { 9_600 }).unwrap();
        tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
        rustix::io::write(&port, &rtu::write(1, USER_REGISTER, value)).unwrap();
        if value != 2 {
            let mut reply = Vec::new();
            while reply.len() < 8 {
                let mut bytes = [0; 8];
                let count = rustix::io::read(&port, &mut bytes).unwrap();
                reply.extend_from_slice(&bytes[..count]);
            }
            assert_eq!(reply, *rtu::write(1, USER_REGISTER, value));
        }
        drop(port);
        md3.notice();
        assert_eq!(register(&md3, "UserRegister"), if value == 2 { 1 } else { value.into() });
    }
    assert_eq!(md3.drive()["ports"]["rs485"]["spoiled"], 1);
    assert_eq!(md3.stop(), Some(0));
    assert!(!Path::new(&link).is_symlink());
}

fn read(port: &OwnedFd, count: usize) -> Vec<u8> {
    let mut bytes = vec![0; count];
    let mut there = 0;
    while there < count {
        there += rustix::io::read(port, &mut bytes[there..]).unwrap();
    }
    bytes
}

#[test]
fn an_opener_of_a_pty_does_not_inherit_the_input_of_the_previous_one() {
    let md3 = Running::md3(&["--fast-boot"]);
    let port = open(&md3.pty());
    let mut settings = tcgetattr(&port).unwrap();
    settings.make_raw();
    settings.set_speed(9_600).unwrap();
    settings.control_modes.insert(ControlModes::PARODD);
    tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    // Writes as much as fits into the buffer, with the wrong parity. On the line this takes a quarter of a
    // minute.
    rustix::fs::fcntl_setfl(&port, OFlags::NONBLOCK).unwrap();
    let much = rtu::write(1, USER_REGISTER, 1).repeat(500);
    let mut sent = 0;
    while let Ok(count) = rustix::io::write(&port, &much) {
        sent += count;
    }
    assert!(sent / 8 > 1_400, "{sent}");
    drop(port);
    md3.notice();

    let port = open(&md3.pty());
    assert!(tcgetattr(&port).unwrap().control_modes.contains(ControlModes::PARODD), "it is the opener's");
    settings.control_modes.remove(ControlModes::PARODD);
    tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    rustix::io::write(&port, &rtu::write(1, USER_REGISTER, 2)).unwrap();
    md3.notice();
    // The switch to manual time handles the remaining characters of the first program at once.
    md3.call("PUT", "/api/time", "{\"mode\":\"manual\"}").ok();
    assert_eq!(read(&port, 8), *rtu::write(1, USER_REGISTER, 2));
    let seen = &md3.drive()["ports"]["rs485"];
    assert_eq!((&seen["requests"], &seen["refused"]), (&1.into(), &0.into()), "{seen}");
    assert!(seen["spoiled"].as_u64().unwrap() < 1_300, "{seen}");
}

#[test]
fn a_verbose_log_has_a_line_for_each_message() {
    let (mut log, stderr) = std::io::pipe().unwrap();
    let md3 = Running::start("md3", &["--fast-boot", "--time", "manual", "-v"], stderr.into());
    let mut line = md3.connect();
    ask(&mut line, &rtu::write(1, USER_REGISTER, 7), 8);
    ask(&mut line, &rtu::write(1, 0x0B, 5), 5);
    ask(&mut line, &rtu::read(1, USER_REGISTER, 1), 7);
    assert_eq!(md3.stop(), Some(0));
    let mut said = String::new();
    log.read_to_string(&mut said).unwrap();
    let lines: Vec<&str> =
        said.lines().filter_map(|line| line.split_once("INFO ")).map(|(_, words)| words).collect();
    let messages: Vec<&str> = lines.into_iter().filter(|line| line.starts_with("rs485 <- ")).collect();
    assert_eq!(
        messages,
        [
            "rs485 <- write UserRegister = 7 -> done",
            "rs485 <- write Reserved = 5 -> refused: 0x000B Reserved is read only (02)",
            "rs485 <- read UserRegister -> UserRegister = 7",
        ]
    );
}

/// Writes two requests at once to an MD3 that runs with these options. Returns the bytes that came back until
/// `count` bytes, the verdicts of its journal, the counter of its line, and the warnings of the log.
fn two_requests_at_once(options: &[&str], count: usize) -> (Vec<u8>, Vec<Value>, Value, Vec<String>) {
    let (mut log, stderr) = std::io::pipe().unwrap();
    let md3 = Running::start("md3", &[&["--fast-boot"], options].concat(), stderr.into());
    let mut line = md3.connect();
    let both = [rtu::write(1, USER_REGISTER, 7), rtu::read(1, USER_REGISTER, 1)].map(|frame| frame.to_vec());
    let answers = ask(&mut line, &both.concat(), count);
    let received = loop {
        let received = md3.call("GET", "/api/drives/md3/received", "").ok()["requests"].clone();
        if received.as_array().unwrap().len() == 2 {
            break received;
        }
    };
    let verdicts = received.as_array().unwrap().iter().map(|request| request["verdict"].clone()).collect();
    let early = md3.call("GET", "/api/bench", "").ok()["buses"][0]["early_requests"].clone();
    assert_eq!(md3.stop(), Some(0));
    let mut text = String::new();
    log.read_to_string(&mut text).unwrap();
    let warnings = text.lines().filter_map(|line| Some(line.split_once("WARN ")?.1.to_owned())).collect();
    (answers, verdicts, early, warnings)
}

#[test]
fn a_strict_line_loses_requests_that_are_too_early() {
    let answers = [rtu::write(1, USER_REGISTER, 7).to_vec(), vec![1, 3, 2, 0, 7, 0xF9, 0x86]].concat();
    let lenient = two_requests_at_once(&[], answers.len());
    assert_eq!((lenient.0, lenient.1, lenient.2), (answers, vec!["done".into(); 2], 1.into()));
    let [warning] = lenient.3.as_slice() else { panic!("{:?}", lenient.3) };
    assert_eq!(
        warning,
        "rs485: a drive may ignore this request on a real line: sent in one write with the request before it; t3.5 is 4.0 ms"
    );
    let strict = two_requests_at_once(&["--strict"], 0);
    assert_eq!((strict.0, strict.1, strict.2), (vec![], vec!["too early".into(); 2], 1.into()));
    assert_eq!(
        strict.3,
        [
            "rs485: dropped a request that was too early: sent in one write with the request before it; t3.5 is 4.0 ms"
        ]
    );
    // In manual time no time passes between a reply and the next request: one write is counted, but nothing is lost.
    let manual = two_requests_at_once(&["--strict", "--time", "manual"], 15);
    assert_eq!((manual.1, manual.2), (vec!["done".into(); 2], 1.into()));
    let counted = "rs485: a drive may ignore this request on a real line: sent in one write with the request before it; \
                   t3.5 is 4.0 ms";
    assert_eq!(manual.3, ["strict has no effect in manual time", counted]);
}

#[test]
fn an_unread_log_blocks_nothing() {
    let (_unread, full) = std::io::pipe().unwrap();
    rustix::fs::fcntl_setfl(&full, OFlags::NONBLOCK).unwrap();
    while rustix::io::write(&full, &[b'.'; 4_096]).is_ok() {}
    rustix::fs::fcntl_setfl(&full, OFlags::empty()).unwrap();
    let md3 = Running::start("md3", &["--fast-boot", "--time", "manual", "-vv"], full.into());
    for value in 1..=20 {
        let reply = ask(&mut md3.connect(), &rtu::write(1, USER_REGISTER, value), 8);
        assert_eq!(reply, *rtu::write(1, USER_REGISTER, value));
    }
    assert_eq!(md3.stop(), Some(0));
}

#[test]
fn a_client_that_has_sent_all_still_receives_its_last_reply() {
    let md3 = Running::md3(&["--fast-boot", "--time", "x10"]);
    // The delay of the reply, which takes half a second of the wall clock at this speed.
    assert_eq!(md3.call("PUT", "/api/buses/rs485/faults", "{\"delay_ms\":5000}").status, 204);
    let mut line = md3.connect();
    let request = rtu::write(1, USER_REGISTER, 7);
    line.write_all(&request).unwrap();
    line.shutdown(Shutdown::Write).unwrap();
    let mut reply = Vec::new();
    line.read_to_end(&mut reply).unwrap();
    assert_eq!(reply, *request);
    assert_eq!(md3.stop(), Some(0));
}

#[test]
fn a_connection_without_a_free_descriptor_is_accepted_later() {
    let (log, its_end) = pipe().unwrap();
    let md3 = Running::start("md3", &["--fast-boot"], its_end.into());
    let mut log = BufReader::new(log).lines().map(Result::unwrap);
    let mut told = || log.any(|line| line.contains("cannot accept connections"));
    // A limit of three descriptors allows no further ones, because the first three stay open.
    let none = Rlimit { current: Some(3), ..getrlimit(Resource::Nofile) };
    let before = prlimit(Some(md3.pid()), Resource::Nofile, none).unwrap();

    let request = rtu::write(1, USER_REGISTER, 7);
    let mut line = md3.connect();
    line.write_all(&request).unwrap();
    assert!(told());
    // The waiting connection is still open, and is served now.
    prlimit(Some(md3.pid()), Resource::Nofile, before).unwrap();
    let mut reply = vec![0; request.len()];
    line.read_exact(&mut reply).unwrap();
    assert_eq!(reply, *request);
    assert_eq!(md3.stop(), Some(0));
    assert!(!told(), "it is said again and again");
}

#[test]
fn a_link_of_another_process_is_kept() {
    let scratch = Scratch::new("links");
    let link = scratch.file("md3.tty");
    let listen = format!("pty:{link}");
    let arguments = ["run", "md3", "--listen", &listen];
    std::os::unix::fs::symlink(scratch.file("elsewhere"), &link).unwrap();
    assert!(refused(&arguments).contains("elsewhere is there, which is not a pty; choose another name"));
    std::fs::remove_file(&link).unwrap();

    let md3 = Running::md3(&["--listen", &listen]);
    let pty = std::fs::read_link(&link).unwrap();
    let said = refused(&arguments);
    assert!(
        said.contains(&format!(
            "a link to {} is there, and a program has it open: end that program, or choose another name",
            pty.display()
        )),
        "{said}"
    );
    assert_eq!(std::fs::read_link(&link).unwrap(), pty);

    // A link that a killed program left behind is not in use.
    md3.kill();
    assert!(Path::new(&link).is_symlink());
    let next = Running::md3(&["--listen", &listen]);
    assert_eq!(std::fs::read_link(&link).unwrap(), next.pty());
}

#[test]
fn sigterm_does_not_wait_for_a_reader_of_the_banner() {
    let (_reader, mut writer) = pipe().unwrap();
    // Fills the buffer of the pipe, so that a further write would block.
    writer.write_all(&[b'x'; 65_536]).unwrap();
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut child = spawn(
        std::process::Command::new(env!("CARGO_BIN_EXE_drivetwin"))
            .args(["run", "md3", "--json", "--listen", &format!("tcp:{free}")])
            .stdout(writer),
    );
    // When the program accepts connections, it also handles SIGTERM.
    while std::net::TcpStream::connect(free).is_err() {
        assert!(child.try_wait().unwrap().is_none(), "it does not listen");
        std::thread::yield_now();
    }
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn every_incomplete_file_is_reported_at_the_end() {
    let scratch = Scratch::new("incomplete");
    let (pipe, log) = (scratch.file("md3.vcd"), scratch.file("log"));
    let record = scratch.file("md3.trace");
    for pipe in [&pipe, &record] {
        mknodat(CWD, pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    }
    let readers = [&pipe, &record].map(|pipe| open(Path::new(pipe)));
    let options = ["--time", "manual", "--vcd", &pipe, "--record", &record];
    let md3 = Running::start("md3", &options, File::create(&log).unwrap().into());
    drop(readers);
    md3.advance(3.0);
    assert_eq!(md3.stop(), Some(2));
    let said = std::fs::read_to_string(&log).unwrap();
    let last = said.lines().last().unwrap();
    assert!(last.contains(&format!("--vcd {pipe} is not complete")), "{said}");
    assert!(last.contains(&format!("--record {record}")), "{said}");
    // If the disk is full at the start, the program reports that and does not run.
    let full = drivetwin(&["run", "md3", "--record", "/dev/full"]);
    let said = String::from_utf8(full.stderr).unwrap();
    assert!(full.status.code() == Some(2) && said.contains("--record /dev/full: No space left"), "{said}");
}
