//! Benches of several drives, from a file.

use crate::running::{Running, Scratch, ask, drivetwin, refused};
use drivetwin_protocol::modbus::rtu;
use serde_json::json;

const USER_REGISTER: u16 = 0x1D;
const EEPROM_CONTROL: u16 = 0x1A;

const TWO: &str = r#"
time = "manual"

[[bus]]
name = "line1"
listen = ["tcp:127.0.0.1:0", "pty:line1.tty"]
drives = ["x", "y"]

[[drive]]
name = "x"
kind = "md3"
nv = "x.nv"
fast_boot = true

[[drive]]
name = "y"
kind = "md3-low"
address = 2
nv = "y.nv"
fast_boot = true

[[drive]]
name = "reader"
kind = "qsb-d"
fast_boot = true
"#;

#[test]
fn drives_on_one_line_keep_a_memory_each_and_one_recording() {
    let scratch = Scratch::new("two");
    let (file, trace) = (scratch.file("bench.toml"), scratch.file("bench.trace"));
    std::fs::write(&file, TWO).unwrap();
    let bench = Running::bench(&file, &["--record", &trace]);
    let devices = bench.ready["devices"].as_array().unwrap();
    let names: Vec<_> = devices.iter().map(|device| (&device["name"], &device["kind"])).collect();
    let expected = [("x", "md3"), ("y", "md3-low"), ("reader", "qsb-d")];
    assert_eq!(json!(names), json!(expected));
    // Drives that share a line have the same addresses.
    let places = &devices[0]["ports"]["rs485"];
    assert_eq!(places, &devices[1]["ports"]["rs485"]);
    let link = scratch.file("line1.tty");
    let pty = std::fs::read_link(&link).unwrap();
    assert_eq!(places[1], format!("pty:{}", pty.display()));

    let mut line = bench.connect();
    for (address, value) in [(1, 11), (2, 22)] {
        ask(&mut line, &rtu::write(address, USER_REGISTER, value), 8);
        ask(&mut line, &rtu::write(address, EEPROM_CONTROL, 1), 8);
    }
    bench.advance(0.1);
    assert_eq!(bench.stop(), Some(0));
    assert!(!std::path::Path::new(&link).is_symlink());
    let replayed = drivetwin(&["replay", &trace]);
    assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");

    // The memory files are in the folder of the bench file, whatever the working directory.
    assert!(std::path::Path::new(&scratch.file("x.nv")).exists());
    let bench = Running::bench(&file, &[]);
    let mut line = bench.connect();
    for (address, value) in [(1, 11), (2, 22)] {
        let reply = ask(&mut line, &rtu::read(address, USER_REGISTER, 1), 7);
        assert_eq!(reply, *rtu::frame(address, &[3, 2, 0, value]));
    }
}

#[test]
fn options_for_the_bench_work_with_a_file() {
    let scratch = Scratch::new("override");
    let file = scratch.file("bench.toml");
    std::fs::write(&file, TWO).unwrap();
    let mode = |options: &[&str]| {
        let bench = Running::bench(&file, options);
        bench.call("GET", "/api/bench", "").ok()["time"]["mode"].clone()
    };
    assert_eq!(mode(&[]), "manual");
    assert_eq!(mode(&["--time", "x10"]), "x10");
}

#[test]
fn an_error_in_a_file_has_its_position() {
    let scratch = Scratch::new("wrong");
    let file = scratch.file("bench.toml");
    let memory = scratch.file("x.nv");
    let said = |text: &str| {
        std::fs::write(&file, text).unwrap();
        refused(&["run", &file])
    };
    let at = |place: &str| format!("{file}: {place}: ");
    let kind = said("[[drive]]\nname = 'x'\nkind = 'md4'\n");
    assert_eq!(kind, at("line 3, column 8") + "there is no kind 'md4'; the nearest is 'md3'");
    assert!(said("[[drive]\n").starts_with(&at("line 1, column 9")), "{}", said("[[drive]\n"));

    // An error that the text of the file does not show is reported with the name of the drive as its
    // position.
    let x = "[[drive]]\nname = 'x'\nkind = 'rs434544'\n";
    std::fs::create_dir(&memory).unwrap();
    let directory = said(&format!("{x}nv = 'x.nv'\n"));
    assert!(directory.starts_with(&format!("{file}: nv of x: {memory}: ")), "{directory}");
    let program = said(&format!("{x}program = 'x.rsasm'\n"));
    assert!(program.starts_with(&format!("{file}: program of x: ")), "{program}");
    std::fs::remove_dir(&memory).unwrap();
    // Two drives use the same memory file by two paths.
    std::os::unix::fs::symlink("x.nv", scratch.file("y.nv")).unwrap();
    let y = x.replace("'x'", "'y'");
    let twice = said(&format!("{x}nv = 'x.nv'\n{y}nv = 'y.nv'\n"));
    assert!(twice.ends_with("another drive keeps its memory there"), "{twice}");
    std::fs::create_dir(scratch.file("a")).unwrap();
    let pty = |link: &str| format!("listen = ['pty:{link}']\n");
    let twice = said(&format!("{x}{}{y}{}", pty("x.tty"), pty("a/../x.tty")));
    assert!(twice.ends_with("are the same path; use two different ones"), "{twice}");
    let stdio = "listen = ['stdio:']\n";
    let stdio = said(&format!("{x}{stdio}{y}{stdio}"));
    assert!(stdio.starts_with(&at("line 8, column 11")), "{stdio}");
}
