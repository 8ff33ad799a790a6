//! Drives with several variants, whose ports take single characters.

use std::process::Stdio;

use crate::running::{Running, ask, drivetwin, spawn};
use serde_json::Value;

/// Starts a QSB in manual time, without the start-up delay.
fn qsb(kind: &'static str, options: &[&str]) -> Running {
    let options = [&["--time", "manual", "--fast-boot"], options].concat();
    Running::start(kind, &options, Stdio::inherit())
}

fn describe(kind: &str) -> Value {
    serde_json::from_slice(&drivetwin(&["describe", kind, "--json"]).stdout).unwrap()
}

fn names<'a>(of: &'a Value, what: &str) -> Vec<&'a str> {
    of[what].as_array().unwrap().iter().map(|named| named["name"].as_str().unwrap()).collect()
}

#[test]
fn variants_have_their_registers_and_pins_only() {
    let listed = String::from_utf8(drivetwin(&["list"]).stdout).unwrap();
    // The manual lists products for each register: "-D, -M, -S" or some of them.
    for (kind, pins, lacks) in [
        ("qsb-d", 4, &["MdStepRate", "MdAccel", "MdMoveSteps", "MdJogRate", "MdStatus", "MotorDrive"][..]),
        ("qsb-m", 7, &[]),
        ("qsb-s", 3, &["DigIO", "DigIOConfig", "MdStepRate", "MdStatus", "MotorDrive"]),
    ] {
        assert!(listed.contains(kind), "{listed}");
        let described = describe(kind);
        let registers = names(&described, "registers");
        assert_eq!(names(&described, "pins").len(), pins, "{kind}");
        assert!(registers.contains(&"ReadEncoder"), "{kind}");
        assert!(lacks.iter().all(|lacking| !registers.contains(lacking)), "{kind}: {registers:?}");
        let drive = qsb(kind, &[]).drive();
        let shown: Vec<&str> = drive["registers"].as_object().unwrap().keys().map(String::as_str).collect();
        let (mut shown, mut registers) = (shown, registers);
        shown.sort_unstable();
        registers.sort_unstable();
        assert_eq!(shown, registers, "{kind}");
    }
}

#[test]
fn the_reference_has_the_letters_of_a_register() {
    let text = String::from_utf8(drivetwin(&["describe", "qsb-m", "--markdown"]).stdout).unwrap();
    for row in [
        "| 0x00 | Mode | MODE | u8 | R/W |",
        "| 0x01 | DigIO | DIG I/O | u8 | R/W/S |",
        "| 0x06 | Str | STR | u8 | R/S |",
        "| 0x09 | ClearReg | CLEAR REG | u8 | W |",
        "| 0x14 | Version | VERSION | u32 | R |",
        "| A, PWM, ANALOG | digital or analogue input | high |",
    ] {
        assert!(text.contains(row), "{row}\n{text}");
    }
    let str_register = &describe("qsb-m")["registers"][6];
    assert_eq!((&str_register["name"], &str_register["streams"]), (&"Str".into(), &true.into()));
}

#[test]
fn a_contact_takes_levels_and_voltages() {
    let qsb = qsb("qsb-s", &[]);
    let put = |pin: &str, body: &str| qsb.call("PUT", &format!("/api/drives/qsb-s/pins/{pin}"), body);
    let seen = || qsb.drive()["pins"]["A"].as_str().unwrap().to_owned();
    assert_eq!(seen(), "high");
    for (body, level) in [
        ("{\"volts\":1.3}", "low"),
        ("{\"volts\":2.5}", "high"),
        ("{\"level\":\"low\"}", "low"),
        ("{\"level\":\"high\"}", "high"),
        ("{\"volts\":0}", "low"),
        ("{\"level\":\"open\"}", "high"),
    ] {
        assert_eq!(put("A", body).status, 204, "{body}");
        assert_eq!(seen(), level, "{body}");
    }
    let both = put("A", "{\"level\":\"low\",\"volts\":1}").problem(422);
    assert_eq!(both, "this input takes a level (low, high or open) or volts, one of them");
    assert!(put("A", "{}").problem(422).contains("{\"level\":\"open\"} and {\"volts\":2.5}"));
    put("B", "{\"volts\":1}").problem(422);
    let text = qsb.call("GET", "/api/trace", "").body;
    let told: Vec<&str> = text.lines().filter_map(|line| Some(line.split_once("> ")?.1)).collect();
    let expected =
        ["millivolts A 1300", "millivolts A 2500", "pin A low", "pin A high", "millivolts A 0", "pin A high"];
    assert_eq!(told, expected);
}

#[test]
fn a_pwm_encoder_is_a_train_of_pulses_with_a_duty() {
    let qsb = qsb("qsb-s", &["--set", "Mode=1"]);
    let post = |body: &str| qsb.call("POST", "/api/drives/qsb-s/pins/PWM/pulses", body);
    let set = "/api/drives/qsb-s/pins/PWM";
    assert_eq!(qsb.call("PUT", set, "{\"level\":\"low\"}").status, 204);
    // Ten-bit mode, 1 kHz: 0.25 × 1,026 − 1 is 255.5. Twelve-bit mode, 250 Hz: 0.75 × 4,098 − 1 is 3,072.5,
    // and B4.
    for (pulses, mode, value) in [
        ("{\"count\":10,\"hz\":1000,\"duty\":0.25}", 0x01, 255),
        ("{\"count\":10,\"hz\":250,\"duty\":0.75}", 0x11, 3_072),
        ("{\"count\":10,\"hz\":250}", 0x11, 2_048),
    ] {
        assert_eq!(post(pulses).status, 204, "{pulses}");
        qsb.advance(0.05);
        let registers = &qsb.drive()["registers"];
        assert_eq!(
            (&registers["Mode"], &registers["ReadEncoder"]),
            (&mode.into(), &value.into()),
            "{pulses}"
        );
    }
    for wrong in ["0", "1", "-0.5", "1.5"] {
        let told = post(&format!("{{\"count\":1,\"hz\":250,\"duty\":{wrong}}}")).problem(422);
        assert_eq!(told, "the duty of a pulse is between 0 and 1");
    }
}

#[test]
fn a_contact_with_several_names_is_one() {
    let qsb = qsb("qsb-s", &[]);
    let names = ["A", "PWM", "ANALOG"];
    for by in names {
        for (body, level) in [
            ("{\"volts\":0.2}", "low"),
            ("{\"level\":\"high\"}", "high"),
            ("{\"level\":\"low\"}", "low"),
            ("{\"level\":\"open\"}", "high"),
        ] {
            assert_eq!(qsb.call("PUT", &format!("/api/drives/qsb-s/pins/{by}"), body).status, 204);
            let pins = &qsb.drive()["pins"];
            assert!(names.iter().all(|name| pins[name] == level), "{by} {body}: {pins}");
        }
    }
}

#[test]
fn registers_of_other_variants_are_not_there() {
    let qsb = qsb("qsb-s", &["--set", "Threshold=3"]);
    let put = |name: &str| qsb.call("PUT", &format!("/api/drives/qsb-s/registers/{name}"), "{\"value\":1}");
    assert_eq!(put("Dtr").status, 204);
    let told = "MdAccel is a register of other variants; qsb-s does not have it";
    assert_eq!(put("MdAccel").problem(404), told);
    let mut line = qsb.connect();
    let replies = b"r 08 00000001 !\r\nr 0B 00000003 !\r\n";
    assert_eq!(ask(&mut line, b"R08\rR0B\r", replies.len()), replies);
}

#[test]
fn a_terminal_program_is_proposed() {
    use std::io::{BufRead as _, BufReader};
    let mut child = spawn(
        std::process::Command::new(env!("CARGO_BIN_EXE_drivetwin"))
            .args(["run", "qsb-d", "--control", "off"])
            .stdout(Stdio::piped()),
    );
    let said: Vec<String> = BufReader::new(child.stdout.take().unwrap())
        .lines()
        .map(Result::unwrap)
        .take_while(|line| !line.contains("Ctrl-C"))
        .collect();
    child.kill().unwrap();
    child.wait().unwrap();
    let pty = said.iter().find_map(|line| line.trim().strip_prefix("pty:")).unwrap();
    let proposed = said.last().unwrap().trim();
    assert_eq!(proposed, format!("python3 -m serial.tools.miniterm {pty} 230400"));
}
