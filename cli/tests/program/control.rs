//! The control API: its calls, and requests that it refuses.

use std::io::{Read as _, Write as _};
use std::process::Stdio;

use crate::running::{Answer, Running, ask, drivetwin};
use drivetwin_protocol::modbus::rtu;

/// Starts an MD3 in manual time, without the start-up delay.
fn md3() -> Running {
    Running::md3(&["--time", "manual", "--fast-boot"])
}

#[test]
fn a_move_is_seen_through_the_api() {
    let md3 = md3();
    let mut line = md3.connect();
    ask(&mut line, &rtu::write(1, 0x11, 1), 8);
    let drive = md3.drive();
    assert_eq!((&drive["motion"]["moving"], &drive["registers"]["MotionControl"]), (&true.into(), &1.into()));
    let time = md3.advance(2.5);
    assert_eq!(time["mode"], "manual");
    let drive = md3.drive();
    assert_eq!((&drive["motion"]["position"], &drive["motion"]["moving"]), (&10_000.into(), &false.into()));
    assert_eq!(drive["motion"]["speed"], 0.0);
    assert_eq!(drive["ports"]["rs485"]["requests"], 1);
    assert_eq!(md3.call("GET", "/api/bench", "").ok()["time"], time);
}

#[test]
fn in_manual_time_half_a_request_outlasts_the_wall_clock() {
    let md3 = md3();
    let mut line = md3.connect();
    let request = rtu::read(1, 0x11, 1);
    line.write_all(&request[..3]).expect("a connection");
    // No byte arrives for 60 ms. In real time half a request would be given up after 20 ms.
    let patience = line.read_timeout().expect("a connection");
    line.set_read_timeout(Some(std::time::Duration::from_millis(60))).expect("a connection");
    line.read(&mut [0]).expect_err("half a request is not answered");
    line.set_read_timeout(patience).expect("a connection");
    ask(&mut line, &request[3..], 7);
    assert_eq!(md3.drive()["ports"]["rs485"]["requests"], 1);
    // When bench time passes, the drive drops half a request. The half has arrived, because it was written
    // together with a request that is answered.
    ask(&mut line, &[&request, &request[..3]].concat(), 7);
    md3.advance(0.05);
    ask(&mut line, &request, 7);
}

#[test]
fn a_drive_says_what_it_received_and_what_came_of_it() {
    let md3 = md3();
    let mut line = md3.connect();
    ask(&mut line, &rtu::write(1, 0x15, 9_000), 8);
    md3.advance(1.0);
    // Reserved is read only (7.10).
    ask(&mut line, &rtu::write(1, 0x0B, 5), 5);
    ask(&mut line, &rtu::read(1, 0x14, 2), 9);
    let received = |query: &str| md3.call("GET", &format!("/api/drives/md3/received{query}"), "").ok();
    let all = received("");
    let texts = |received: &serde_json::Value| {
        let requests = received["requests"].as_array().expect("a list").clone();
        requests.iter().map(|one| format!("{} {}", one["text"], one["verdict"])).collect::<Vec<_>>()
    };
    let [speed, reserved, read] = [
        "\"write SpeedLow = 9000\" \"done\"",
        "\"write Reserved = 5\" \"refused\"",
        "\"read Speed\" \"done\"",
    ];
    assert_eq!(texts(&all), [speed, reserved, read]);
    assert_eq!(all["requests"][1]["reason"], "0x000B Reserved is read only (02)");
    assert_eq!(all["requests"][2]["registers"][0]["value"], 9_000);
    assert_eq!(all["lost"], 0);
    let line = serde_json::json!({"requests": 3, "early": 0, "retries": 0, "shortest_silence": null});
    assert_eq!(all["statistics"], serde_json::json!({"starting": 0, "lines": {"rs485": line}}));
    assert_eq!(texts(&received("?since=1.0")), [reserved, read]);
    assert_eq!(texts(&received("?function=3")), [read]);
    assert_eq!(texts(&received("?register=Speed")), [speed, read]);
    assert_eq!(texts(&received("?register=SpeedLow&function=6")), [speed]);
    let refused = |query: &str| md3.call("GET", &format!("/api/drives/md3/received{query}"), "").problem(422);
    assert!(refused("?register=Sped").contains("the nearest is 'Speed'"));
    assert_eq!(refused("?since=-1"), "since is a bench time in seconds, 0 to 1000000000");
    refused("?function=256");
    refused("?sinse=1");
    assert!(md3.call("GET", "/api/drives/md4/received", "").problem(404).contains("nearest is 'md3'"));
}

#[test]
fn the_bench_lists_its_drives_and_lines() {
    let md3 = md3();
    let bench = md3.call("GET", "/api/bench", "").ok();
    assert_eq!(bench["drives"][0]["name"], "md3");
    assert_eq!(bench["buses"][0]["name"], "rs485");
    assert_eq!(bench["buses"][0]["listen"], md3.ready["devices"][0]["ports"]["rs485"]);
    assert_eq!(bench["time"]["seconds"], 0.0);
}

#[test]
fn registers_are_preset_by_name() {
    let md3 = md3();
    let put = |name: &str, value: &str| {
        md3.call("PUT", &format!("/api/drives/md3/registers/{name}"), &format!("{{\"value\":{value}}}"))
    };
    assert_eq!(put("Speed", "-2").status, 204);
    assert_eq!(put("SpeedLow", "7").status, 204);
    assert_eq!(md3.drive()["registers"]["Speed"], -65_536 + 7);
    assert_eq!(put("DeviceAddress", "0").problem(422), "DeviceAddress takes 1 to 247, not 0");
    assert!(put("Speeed", "1").problem(404).contains("the nearest is 'Speed'"));
    put("Speed", "\"fast\"").problem(422);
    put("Speed", "").problem(400);
    md3.call("POST", "/api/drives/md3/power", "{\"action\":\"off\"}");
    assert_eq!(put("Speed", "1").problem(409), "md3 has no power");
}

#[test]
fn pins_are_driven_and_pulsed() {
    let md3 = md3();
    let level = |pin: &str, body: &str| md3.call("PUT", &format!("/api/drives/md3/pins/{pin}"), body);
    assert_eq!(level("J2.2", "{\"level\":\"low\"}").status, 204);
    assert_eq!(md3.drive()["pins"]["J2.2"], "low");
    assert_eq!(level("J2.2", "{\"level\":\"open\"}").status, 204);
    assert_eq!(md3.drive()["pins"]["J2.2"], "high", "it is pulled up");
    level("J2.2", "{\"level\":\"up\"}").problem(422);
    level("J2.2", "{\"volts\":2.5}").problem(422);
    level("J2.2", "{\"level\":\"low\",\"volts\":2.5}").problem(422);
    assert!(level("J2.2", "{}").problem(422).contains("it takes one of {\"level\":\"low\"}"));
    assert_eq!(level("D5", "{\"level\":\"low\"}").problem(422), "D5 is an output");
    assert!(level("J2.22", "{\"level\":\"low\"}").problem(404).contains("nearest is 'J2.2'"));

    let pulses = |body: &str| md3.call("POST", "/api/drives/md3/pins/J2.5/pulses", body);
    assert_eq!(pulses("{\"count\":1000,\"hz\":1000}").status, 204);
    pulses("{\"count\":1,\"hz\":1000}").problem(409);
    md3.advance(1.0);
    assert_eq!(pulses("{\"count\":1,\"hz\":1000}").status, 204);
    for wrong in [
        "{\"count\":0,\"hz\":1}",
        "{\"count\":1,\"hz\":0}",
        "{\"count\":1,\"hz\":1e9}",
        "{\"count\":-1,\"hz\":1}",
    ] {
        pulses(wrong).problem(422);
    }
}

/// Presets a register of the drive, not through its bus.
fn preset(md3: &Running, name: &str, value: u16) {
    let body = format!("{{\"value\":{value}}}");
    assert_eq!(md3.call("PUT", &format!("/api/drives/md3/registers/{name}"), &body).status, 204);
}

#[test]
fn a_driven_pin_shows_its_level_until_it_is_released() {
    /// Bit 12 of PinFunctionAndPolarity (7.8): pins 9, 10 and 12 of J2 are outputs.
    const OUTPUTS: u16 = 1 << 12;
    let md3 = md3();
    let drive = |level: &str| {
        let body = format!("{{\"level\":\"{level}\"}}");
        assert_eq!(md3.call("PUT", "/api/drives/md3/pins/J2.9", &body).status, 204);
    };
    let seen = || {
        let drive = md3.drive();
        let bit = drive["registers"]["IOPortData"].as_u64().unwrap() >> 6 & 1;
        (drive["pins"]["J2.9"].as_str().unwrap().to_owned(), bit)
    };
    assert_eq!(seen(), ("low".into(), 0));
    preset(&md3, "PinFunctionAndPolarity", OUTPUTS);
    drive("high");
    assert_eq!(seen(), ("low".into(), 0));
    preset(&md3, "IOPortData", 1 << 6);
    drive("low");
    assert_eq!(seen(), ("high".into(), 1));
    preset(&md3, "IOPortData", 0);
    drive("high");
    assert_eq!(seen(), ("low".into(), 0));
    preset(&md3, "PinFunctionAndPolarity", 0);
    assert_eq!(seen(), ("high".into(), 1), "it is an input again");
    drive("open");
    assert_eq!(seen(), ("low".into(), 0));
}

#[test]
fn every_fault_that_is_described_can_come_and_go() {
    /// Bit 15 of MotionControl (7.15).
    const FAULT: u16 = 1 << 15;
    let described = drivetwin(&["describe", "md3", "--json"]);
    let described: serde_json::Value = serde_json::from_slice(&described.stdout).unwrap();
    let faults: Vec<&str> =
        described["faults"].as_array().unwrap().iter().filter_map(|f| f.as_str()).collect();
    assert!(faults.contains(&"over_temperature") && faults.contains(&"over_current"), "{faults:?}");
    for fault in faults {
        let md3 = md3();
        let path = format!("/api/drives/md3/faults/{fault}");
        let shown = || {
            let drive = md3.drive();
            let word = drive["registers"]["MotionControl"].as_u64().unwrap();
            (drive["faults"][fault].as_bool().unwrap(), word & u64::from(FAULT) != 0)
        };
        assert_eq!(shown(), (false, false), "{fault}");
        assert_eq!(md3.call("PUT", &path, "").status, 204);
        assert_eq!(shown(), (true, true), "{fault}");
        assert_eq!(md3.call("DELETE", &path, "").status, 204);
        assert_eq!(shown(), (false, true), "{fault} stays until it is cleared (7.15)");
        preset(&md3, "MotionControl", FAULT);
        assert_eq!(shown(), (false, false), "{fault}");
    }
}

/// Levels of pins A (J2.10) and B (J2.12), from bits 5 and 4 of IOPortData (7.9).
fn quadrature(md3: &Running) -> u64 {
    md3.drive()["registers"]["IOPortData"].as_u64().unwrap() >> 4 & 0b11
}

#[test]
fn an_encoder_turns() {
    let md3 = md3();
    let turn = |body: &str| md3.call("POST", "/api/drives/md3/encoder", body);
    assert_eq!(quadrature(&md3), 0b00);
    // A leads B. There is an edge each millisecond, and the first one comes a tick after the call.
    assert_eq!(turn("{\"counts\":6,\"hz\":1000}").status, 204);
    md3.advance(0.000_5);
    let mut seen = Vec::new();
    for _ in 0..8 {
        seen.push(quadrature(&md3));
        md3.advance(0.001);
    }
    assert_eq!(seen, [0b10, 0b11, 0b01, 0b00, 0b10, 0b11, 0b11, 0b11]);
    // Turns backward from the present position.
    assert_eq!(turn("{\"counts\":-3,\"hz\":1000}").status, 204);
    md3.advance(0.000_5);
    let mut seen = Vec::new();
    for _ in 0..4 {
        seen.push(quadrature(&md3));
        md3.advance(0.001);
    }
    assert_eq!(seen, [0b10, 0b00, 0b01, 0b01]);
    assert_eq!(md3.drive()["registers"]["QuadratureEncoderCount"], 6 - 3);
}

#[test]
fn a_scenario_has_the_steps_of_a_bench_file() {
    let md3 = md3();
    md3.advance(3.0);
    let play = |steps: &str| md3.call("POST", "/api/scenario", &format!("{{\"steps\":[{steps}]}}"));
    let powered = || md3.call("GET", "/api/bench", "").ok()["drives"][0]["powered"] == true;
    // After a write of MotionControl, and at a time.
    let when = "{\"drive\":\"md3\",\"register\":\"MotionControl\",\"value\":1}";
    let cut = format!("{{\"when\":{when},\"after_ms\":100,\"drive\":\"md3\",\"power\":\"off\"}}");
    let again = "{\"after_ms\":1e2,\"drive\":\"md3\",\"power\":\"on\"}";
    assert_eq!(play(&format!("{cut},{again}")).status, 204);
    let at = "{\"at_s\":9,\"bus\":\"rs485\",\"faults\":{\"drop\":{\"count\":1}}}";
    assert_eq!(play(at).status, 204);
    let request = rtu::write(1, 0x11, 1);
    ask(&mut md3.connect(), &request, request.len());
    assert!(powered());
    md3.advance(0.15);
    assert!(!powered());
    md3.advance(0.1);
    assert!(powered());
    md3.advance(9.0);
    let drop = &md3.call("GET", "/api/buses", "").ok()[0]["faults"]["drop"];
    assert_eq!(drop.to_string(), "{\"count\":1}");

    let past = play("{\"at_s\":9,\"drive\":\"md3\",\"power\":\"on\"}").problem(422);
    assert!(past.starts_with("step 1: at_s = 9 is past: the bench is at 12.2"), "{past}");
    for (wrong, sentence) in [
        ("", "a scenario needs a step"),
        (
            &format!("{again},{{\"drive\":\"md4\",\"power\":\"on\"}}"),
            "step 2: there is no drive 'md4'; the nearest is 'md3'",
        ),
        ("{\"drive\":null}", "step 1: null is not a value"),
        (
            "{\"drive\":\"\u{7f}\\u0000\",\"power\":\"on\"}",
            "step 1: there is no drive '\u{7f}\0'; available: md3",
        ),
        ("3", "the body has '3' where it takes an object"),
    ] {
        assert_eq!(play(wrong).problem(422), sentence);
    }
}

#[test]
fn an_encoder_is_refused_what_it_cannot_do() {
    let md3 = md3();
    let turn = |body: &str| md3.call("POST", "/api/drives/md3/encoder", body);
    let limits = "an encoder makes 1 to 2147483647 edges, or -1 to -2147483648 the other way, and 0.000001 to 16000000 of them a second";
    for wrong in [
        "{\"counts\":0,\"hz\":1}",
        "{\"counts\":2147483648,\"hz\":1}",
        "{\"counts\":1,\"hz\":0}",
        "{\"counts\":1,\"hz\":-1}",
        "{\"counts\":1,\"hz\":16000001}",
    ] {
        assert_eq!(turn(wrong).problem(422), limits, "{wrong}");
    }
    for wrong in
        ["{}", "{\"counts\":1}", "{\"counts\":1.5,\"hz\":1}", "{\"counts\":1,\"hz\":1,\"pin\":\"A\"}"]
    {
        turn(wrong).problem(422);
    }
    let nobody = md3.call("POST", "/api/drives/md4/encoder", "{\"counts\":1,\"hz\":1}");
    assert!(nobody.problem(404).contains("the nearest is 'md3'"));
    assert_eq!(quadrature(&md3), 0b00);

    // A pin has one source of edges at a time: the encoder or a pulse train, whichever was first.
    let pulses = |pin: &str| {
        md3.call("POST", &format!("/api/drives/md3/pins/{pin}/pulses"), "{\"count\":1,\"hz\":1000}")
    };
    assert_eq!(turn("{\"counts\":4,\"hz\":1000}").status, 204);
    turn("{\"counts\":4,\"hz\":1000}").problem(409);
    for pin in ["J2.10", "J2.12"] {
        pulses(pin).problem(409);
    }
    assert_eq!(pulses("J2.9").status, 204, "the index is a pin of its own");
    md3.advance(0.01);
    for pin in ["J2.10", "J2.12"] {
        assert_eq!(pulses(pin).status, 204);
        turn("{\"counts\":4,\"hz\":1000}").problem(409);
        md3.advance(0.01);
    }
    assert_eq!(turn("{\"counts\":4,\"hz\":1000}").status, 204);
}

#[test]
fn faults_and_power() {
    let md3 = md3();
    let fault = "/api/drives/md3/faults/over_current";
    assert_eq!(md3.call("PUT", fault, "").status, 204);
    assert_eq!(md3.drive()["faults"]["over_current"], true);
    assert_eq!(md3.call("DELETE", fault, "").status, 204);
    assert_eq!(md3.drive()["faults"]["over_current"], false);
    assert!(
        md3.call("PUT", "/api/drives/md3/faults/overcurrent", "").problem(404).contains("'over_current'")
    );

    let power =
        |action: &str| md3.call("POST", "/api/drives/md3/power", &format!("{{\"action\":\"{action}\"}}"));
    for (action, powered) in [("off", false), ("on", true), ("cycle", true)] {
        assert_eq!(power(action).status, 204);
        assert_eq!(md3.drive()["powered"], powered, "{action}");
    }
    power("cut");
    assert_eq!(md3.drive()["powered"], true, "until a save");
    let mut line = md3.connect();
    line.write_all(&rtu::write(1, 0x1A, 1)).unwrap();
    md3.notice();
    md3.advance(0.1);
    assert_eq!(md3.drive()["powered"], false);
    power("maybe").problem(422);
}

#[test]
fn time_runs_in_the_mode_that_is_set() {
    let md3 = md3();
    let pace = |mode: &str| md3.call("PUT", "/api/time", &format!("{{\"mode\":\"{mode}\"}}"));
    let advance =
        |seconds: &str| md3.call("POST", "/api/time/advance", &format!("{{\"seconds\":{seconds}}}"));
    assert_eq!(md3.advance(1.25)["seconds"], 1.25);
    for wrong in ["-1", "86401", "1e300"] {
        assert_eq!(advance(wrong).problem(422), "seconds takes 0 to 86400", "{wrong}");
    }
    assert_eq!(pace("x100").ok()["mode"], "x100");
    assert!(advance("1").problem(409).contains("the time mode is not manual"));
    assert_eq!(pace("manual").ok()["mode"], "manual");
    let there = md3.advance(0.0);
    assert_eq!(md3.advance(0.0), there, "the time stands still");
    pace("soon").problem(422);
}

#[test]
fn where_time_stands_no_request_waits() {
    // A partial frame occupies the line until the frame timeout, and the complete frame after it waits.
    let md3 = md3();
    let (mut half, mut whole) = (md3.connect(), md3.connect());
    half.write_all(&[1, 6, 0]).unwrap();
    md3.notice();
    whole.write_all(&rtu::write(1, 0x1D, 7)).unwrap();
    md3.notice();
    md3.advance(0.021);
    let mut reply = [0; 8];
    whole.read_exact(&mut reply).unwrap();
    assert_eq!(reply, *rtu::write(1, 0x1D, 7));

    // The mode changes to manual time during an exchange, and the exchange is completed.
    let md3 = Running::md3(&["--fast-boot"]);
    let mut line = md3.connect();
    line.write_all(&rtu::write(1, 0x1D, 8)).unwrap();
    md3.notice();
    md3.call("PUT", "/api/time", "{\"mode\":\"manual\"}").ok();
    line.read_exact(&mut reply).unwrap();
    assert_eq!(reply, *rtu::write(1, 0x1D, 8));
}

/// To advance a day with a train of pulses takes long enough for other calls during it.
#[test]
fn an_advance_can_be_given_up_and_is_the_only_one() {
    let md3 = md3();
    let train = "{\"count\":4000000000,\"hz\":50000}";
    assert_eq!(md3.call("POST", "/api/drives/md3/pins/J2.5/pulses", train).status, 204);
    let body = "{\"seconds\":86400}";
    let request = format!(
        "POST /api/time/advance HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let mut first = md3.control();
    first.write_all(request.as_bytes()).unwrap();
    // The first of the two requests to arrive is executed; the other is refused at once.
    let mut second = md3.control();
    second.write_all(request.as_bytes()).unwrap();
    first.set_nonblocking(true).unwrap();
    second.set_nonblocking(true).unwrap();
    let mut answer = [0; 1024];
    let refused = loop {
        let read = [&mut first, &mut second].into_iter().find_map(|stream| stream.read(&mut answer).ok());
        if let Some(length) = read {
            break String::from_utf8_lossy(&answer[..length]).into_owned();
        }
        std::thread::yield_now();
    };
    assert!(refused.starts_with("HTTP/1.1 409"), "{refused}");
    assert!(refused.contains("another call advances the clock"), "{refused}");
    drop((first, second));
    // The call is served only after the advance has been given up.
    let seconds = md3.call("GET", "/api/bench", "").ok()["time"]["seconds"].as_f64().unwrap();
    assert!((0.0..86_400.0).contains(&seconds), "{seconds}");
    assert_eq!(md3.stop(), Some(0));
}

#[test]
fn a_web_page_is_refused() {
    let md3 = md3();
    let request = |head: &str, body: &str| -> Answer {
        let length =
            if body.is_empty() { String::new() } else { format!("Content-Length: {}\r\n", body.len()) };
        md3.request(&format!("{head}\r\n{length}Connection: close\r\n\r\n{body}"))
    };
    let get = "GET /api/bench HTTP/1.1\r\n";
    assert_eq!(request(&format!("{get}Host: 127.0.0.1:80"), "").status, 200);
    assert_eq!(request(&format!("{get}Host: [::1]"), "").status, 200);
    assert!(request(&format!("{get}Host: evil.example"), "").problem(403).contains("Host"));
    assert!(request(&format!("{get}Host: 127.0.0.1.evil.example:80"), "").problem(403).contains("Host"));
    assert!(
        request(&format!("{get}Host: localhost\r\nHost: evil.example"), "").problem(403).contains("Host")
    );
    let target = "GET http://evil.example/api/bench HTTP/1.1\r\nHost: localhost";
    assert!(request(target, "").problem(403).contains("Host"));
    assert!(request("GET /api/bench HTTP/1.0", "").problem(403).contains("Host"));

    // The API refuses a page of another origin, also one on this machine, and a page without an origin.
    for origin in ["http://evil.example", "https://localhost:80", "http://localhost:81", "null"] {
        let ask = format!("{get}Host: localhost:80\r\nOrigin: {origin}");
        assert!(request(&ask, "").problem(403).contains("another origin"), "{origin}");
    }
    assert_eq!(request(&format!("{get}Host: localhost:80\r\nOrigin: http://localhost:80"), "").status, 200);
    for (site, status) in [("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)] {
        let ask = format!("{get}Host: localhost\r\nSec-Fetch-Site: {site}");
        assert_eq!(request(&ask, "").status, status, "{site}");
    }
    // A browser sends a preflight before a request that is not "simple".
    let preflight =
        "OPTIONS /api/drives/md3/power HTTP/1.1\r\nHost: localhost\r\nAccess-Control-Request-Method: POST";
    let answer = request(preflight, "");
    assert_eq!(answer.status, 405);
    assert!(!answer.head.contains("access-control"), "{answer:?}");

    let fault = "/api/drives/md3/faults/stall HTTP/1.1\r\nHost: localhost";
    for method in ["PUT", "DELETE"] {
        assert!(request(&format!("{method} {fault}"), "").problem(403).contains("Content-Type"), "{method}");
    }
    let post = "POST /api/drives/md3/power HTTP/1.1\r\nHost: localhost";
    let off = "{\"action\":\"off\"}";
    assert!(request(post, off).problem(403).contains("Content-Type"));
    assert!(
        request(&format!("{post}\r\nContent-Type: text/plain"), off).problem(403).contains("Content-Type")
    );
    assert_eq!(md3.drive()["powered"], true);
    assert_eq!(request(&format!("{post}\r\nContent-Type: application/json; charset=utf-8"), off).status, 204);
}

#[test]
fn every_error_is_a_problem_document() {
    let md3 = md3();
    md3.call("GET", "/nothing", "").problem(404);
    md3.call("GET", "/api/drives", "").problem(404);
    md3.call("GET", "/api/drives/md4", "").problem(404);
    md3.call("GET", "/api/drives/%FF", "").problem(400);
    let wrong_method = md3.call("DELETE", "/api/bench", "");
    wrong_method.problem(405);
    assert!(wrong_method.head.contains("allow: get"), "{wrong_method:?}");
    md3.call("PUT", "/api/time", "{").problem(400);
    md3.call("PUT", "/api/time", "{\"mode\":5}").problem(422);
    md3.call("PUT", "/api/time", "{\"mode\":\"real\",\"more\":1}").problem(422);
    md3.call("PUT", "/api/time", " [\"manual\"]").problem(422);
    md3.call("PUT", "/api/time", &" ".repeat(70_000)).problem(413);
    let query = |path: &str| md3.call("GET", path, "").problem(422);
    assert_eq!(
        query("/api/trace?format=text"),
        "the query has 'text' where it takes 'trace', 'vcd', 'pcapng'"
    );
    assert_eq!(query("/api/trace?fromat=vcd"), "the query has no parameter 'fromat'; allowed: format");
    assert!(query("/api/trace?format=vcd&format=trace").contains("duplicate field 'format'"));
    assert_eq!(query("/api/drives/md3/received?since=x"), "since in the query takes a number");
    assert!(query("/api/events?drive=md4").contains("the nearest is 'md3'"));
    assert_eq!(query("/api/bench?drive=md3"), "this call takes no query");
    assert_eq!(md3.call("GET", "/api/bench?", "").status, 200);
    let head = md3.call("HEAD", "/api/bench", "");
    assert_eq!((head.status, head.body.as_str()), (200, ""));
    let head = md3.call("HEAD", "/api/drives/md4", "");
    assert_eq!((head.status, head.body.as_str()), (404, ""));
    assert!(head.head.contains("content-type: application/problem+json"));
}

#[test]
fn a_line_is_disturbed_by_what_is_named_and_by_nothing_else() {
    let md3 = md3();
    let put = |bus: &str, faults: &str| md3.call("PUT", &format!("/api/buses/{bus}/faults"), faults);
    let faults = || md3.call("GET", "/api/buses", "").ok()[0]["faults"].clone();
    let quiet = faults();
    assert_eq!(quiet["drop"], 0.0);
    assert_eq!(put("rs485", "{\"drop\":0.25,\"delay_ms\":2.5,\"exception_code\":6}").status, 204);
    let disturbed = faults();
    assert_eq!(disturbed["drop"], 0.25);
    assert_eq!((&disturbed["delay_ms"], &disturbed["exception_code"]), (&2.5.into(), &6.into()));
    assert_eq!(md3.call("GET", "/api/bench", "").ok()["buses"][0]["faults"], disturbed);
    // The faults of a response are valid as a request.
    assert_eq!(put("rs485", &disturbed.to_string()).status, 204);
    assert_eq!(faults(), disturbed);
    assert_eq!(put("md3.rs485", "{\"mute\":true}").status, 204, "its other name");
    assert_eq!((&faults()["drop"], &faults()["mute"]), (&0.0.into(), &true.into()));
    assert_eq!(put("rs485", "{}").status, 204);
    assert_eq!(faults(), quiet);

    assert!(put("rs458", "{}").problem(404).contains("the nearest is 'rs485'"));
    assert!(
        put("rs485", "{\"drops\":1}")
            .problem(422)
            .contains("the body has no member 'drops'; allowed: drop, corrupt")
    );
    for wrong in [
        "\"drop\":1.5",
        "\"noise\":-0.1",
        "\"delay_ms\":60001",
        "\"delay_ms\":-1",
        "\"exception_code\":0",
        "\"baud\":1",
    ] {
        put("rs485", &format!("{{{wrong}}}")).problem(422);
    }
    assert_eq!(faults(), quiet);
}

#[test]
fn a_mute_line_sends_no_answer() {
    let md3 = md3();
    let requests = || md3.drive()["ports"]["rs485"]["requests"].as_u64().unwrap();
    let mut line = md3.connect();
    let mute = |on: bool| md3.call("PUT", "/api/buses/rs485/faults", &format!("{{\"mute\":{on}}}"));
    assert_eq!(mute(true).status, 204);
    line.write_all(&rtu::write(1, 0x11, 0)).unwrap();
    assert!((0..10_000).any(|_| requests() == 1), "it has not come");
    assert_eq!(mute(false).status, 204);
    // The reply to this request is the first one to arrive.
    let request = rtu::read(1, 0x10, 1);
    assert_eq!(ask(&mut line, &request, 7)[..3], [1, 3, 2]);
}

#[test]
fn idle_connections_block_no_other_client() {
    let md3 = md3();
    let mut idle: Vec<_> = (0..200).map(|_| md3.control()).collect();
    assert_eq!(md3.call("GET", "/api/bench", "").status, 200);
    // The first connections were closed to make room, long before their timeout.
    assert_eq!(idle[0].read(&mut [0]).unwrap(), 0);
    assert_eq!(md3.stop(), Some(0));
}

/// A browser that follows a link of another site, or opens a typed address, sends such headers.
fn opens(site: &str, dest: &str) -> String {
    format!("Sec-Fetch-Site: {site}\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: {dest}")
}

#[test]
fn the_page_has_its_files_and_their_headers() {
    let md3 = md3();
    let get = |path: &str, headers: &str| {
        md3.request(&format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n{headers}Connection: close\r\n\r\n"))
    };
    for (path, media) in [
        ("/", "text/html"),
        ("/panel/panel.css", "text/css"),
        ("/panel/main.js", "text/javascript"),
        ("/panel/favicon.svg", "image/svg+xml"),
    ] {
        let file = get(path, "");
        assert_eq!(file.status, 200, "{path}");
        for line in [
            &format!("content-type: {media}; charset=utf-8") as &str,
            "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
            "x-content-type-options: nosniff",
            "referrer-policy: no-referrer",
            "cache-control: no-cache",
        ] {
            assert!(file.head.lines().any(|other| other == line), "{path} has no {line}: {}", file.head);
        }
        let tag = file.head.lines().find_map(|line| line.strip_prefix("etag: ")).expect("a tag");
        let again = get(path, &format!("If-None-Match: {tag}\r\n"));
        assert_eq!((again.status, again.body.as_str()), (304, ""), "{path}");
        assert_eq!(get(path, "If-None-Match: \"0\"\r\n").body, file.body, "{path}");
    }
    assert_eq!(get("/panel/nothing.js", "").problem(404), "the panel has no file 'nothing.js'");
    assert_eq!(get("/panel/../Cargo.toml", "").status, 404);
    assert_eq!(md3.call("POST", "/", "").status, 405);
}

#[test]
fn a_link_of_another_site_opens_the_page_and_nothing_else() {
    let md3 = md3();
    let get = |host: &str, path: &str, headers: &str| {
        let request =
            format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{headers}\r\nConnection: close\r\n\r\n");
        md3.request(&request).status
    };
    for site in ["none", "cross-site", "same-site", "same-origin"] {
        assert_eq!(get("localhost", "/", &opens(site, "document")), 200, "{site}");
    }
    assert_eq!(get("localhost", "/", &opens("cross-site", "iframe")), 403);
    assert_eq!(get("localhost", "/", "Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors"), 403);
    for path in ["/panel/main.js", "/api/bench", "/openapi.json", "/api/live"] {
        assert_eq!(get("localhost", path, &opens("cross-site", "document")), 403, "{path}");
    }
    // A name that another site may have resolved to this machine.
    assert_eq!(get("evil.example", "/", &opens("none", "document")), 403);
}

#[test]
fn a_kind_is_described_as_by_the_command() {
    let described = drivetwin(&["describe", "rs434544", "--json"]);
    let expected: serde_json::Value = serde_json::from_slice(&described.stdout).expect("JSON");
    assert_eq!(md3().call("GET", "/api/kinds/rs434544", "").ok(), expected);
    let unknown = md3().call("GET", "/api/kinds/md4", "").problem(404);
    assert_eq!(unknown, "there is no kind 'md4'; the nearest is 'md3'");
}

#[test]
fn the_api_describes_its_paths() {
    let md3 = md3();
    let description = md3.call("GET", "/openapi.json", "").ok();
    let paths = description["paths"].as_object().unwrap();
    for path in [
        "/api/bench",
        "/api/drives/{name}",
        "/api/drives/{name}/pins/{pin}",
        "/api/drives/{name}/pins/{pin}/pulses",
        "/api/drives/{name}/encoder",
        "/api/drives/{name}/registers/{register}",
        "/api/drives/{name}/faults/{fault}",
        "/api/drives/{name}/power",
        "/api/buses",
        "/api/buses/{name}/faults",
        "/api/time",
        "/api/time/advance",
        "/api/trace",
        "/api/events",
    ] {
        assert!(paths.contains_key(path), "{path}");
    }
}

#[test]
fn long_work_in_manual_time_blocks_neither_queries_nor_the_stop() {
    let md3 = Running::md3(&["--time", "manual", "--fast-boot"]);
    let trace = || md3.call("GET", "/api/trace", "").body;
    assert_eq!(md3.call("PUT", "/api/buses/rs485/faults", "{\"delay_ms\":60000}").status, 204);
    // There are some thousand million edges until the reply.
    let pulses = "{\"count\":4000000000,\"hz\":8000000}";
    assert_eq!(md3.call("POST", "/api/drives/md3/pins/J2.2/pulses", pulses).status, 204);
    let before = trace();
    let mut line = md3.connect();
    line.write_all(&rtu::read(1, 0x1D, 1)).unwrap();
    // In manual time the request runs the clock.
    let mut looks = 0;
    while trace() == before {
        looks += 1;
        assert!(looks < 1_000, "the request is not taken");
    }
    assert_eq!(md3.stop(), Some(0));
    let mut reply = Vec::new();
    let _ = line.read_to_end(&mut reply);
    assert!(reply.is_empty(), "it has ended");
}

/// S5 is the kind of the analogue input; 10 is a current of 0 to 20 mA. I5 is its value, at most 1,023 (MC
/// 5-34, 5-65).
#[test]
fn a_current_is_driven_into_the_input_that_measures_one() {
    let what = ["--time", "manual", "--fast-boot"];
    let mdrive = Running::start("mdrive", &what, Stdio::inherit());
    let pin = |pin: &str, body: &str| mdrive.call("PUT", &format!("/api/drives/mdrive/pins/{pin}"), body);
    let set = mdrive.call("PUT", "/api/drives/mdrive/registers/S5", "{\"value\":[10,0]}");
    assert_eq!(set.status, 204, "{}", set.body);
    for (current, reads) in [("20", 1_023), ("12", 614), ("0", 0), ("5", 256)] {
        assert_eq!(pin("ANALOG", &format!("{{\"milliamps\":{current}}}")).status, 204);
        assert_eq!(mdrive.call("GET", "/api/drives/mdrive", "").ok()["registers"]["I5"], reads);
    }
    assert_eq!(pin("ANALOG", "{\"milliamps\":1001}").problem(422), "milliamps are -1000 to 1000");
    assert_eq!(
        pin("IO1", "{\"milliamps\":12}").problem(422),
        "this pin takes no current; send a level or volts"
    );
    pin("ANALOG", "{\"milliamps\":12,\"volts\":3}").problem(422);
    assert!(pin("ANALOG", "{}").problem(422).contains("{\"milliamps\":12}"));
}

/// "Operation is permitted with closed contact" (RS, 6): the contact at HARD_STOP counts as closed until the
/// input is used; `open` opens it. "Power supply protection, VDC: 8 - 30" (section 3).
#[test]
fn an_emergency_stop_and_a_supply_out_of_its_range() {
    let rs434 = Running::start("rs434544", &["--time", "manual", "--fast-boot"], Stdio::inherit());
    let seen = || {
        let drive = rs434.call("GET", "/api/drives/rs434544", "").ok();
        let number = |name: &str| drive["registers"][name].as_i64().unwrap();
        (drive["pins"]["HARD_STOP"].as_str().unwrap().to_owned(), number("STATUS"), number("ERROR"))
    };
    let put = |what: &str, body: &str| {
        assert_eq!(rs434.call("PUT", &format!("/api/drives/rs434544/{what}"), body).status, 204);
        rs434.advance(1.0);
    };
    put("registers/START_bit", "{\"value\":1}");
    assert_eq!(seen(), ("low".into(), 1, 0));
    put("pins/HARD_STOP", "{\"level\":\"open\"}");
    assert_eq!(seen(), ("high".into(), 0, 1 << 5));
    put("pins/HARD_STOP", "{\"level\":\"low\"}");
    put("registers/FLAG_RESTART", &format!("{{\"value\":{}}}", 0x95AF));
    put("registers/START_bit", "{\"value\":1}");
    assert_eq!(seen(), ("low".into(), 1, 0));
    put("registers/SUPPLY", "{\"value\":305}");
    assert_eq!(seen(), ("low".into(), 0, 1));
}
