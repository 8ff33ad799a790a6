//! Actions from outside: power, pins, encoders, motion; connections and readers that come and go.

use std::io::Read as _;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;

use crate::control::Control;
use crate::dialect::{Dialect, Exchange};
use crate::layout::POWER_FAILS;
use crate::masters::Power;
use crate::now;
use crate::process::Ready;
use crate::tally::{Gate, Tally};
use crate::wire::Wire;

/// Time without power.
const OFF: Duration = Duration::from_millis(300);
/// Time in which all drives have power, between two power failures.
const ON: Duration = Duration::from_secs(3);
/// Pause between two rounds of visitors.
const PAUSE: Duration = Duration::from_millis(500);
/// Connections of a round of visitors.
const VISITORS: usize = 10;
/// Longest wait of a visitor for a reply.
const PATIENCE: Duration = Duration::from_secs(10);

/// Calls of the control API in turn. A train of pulses or an encoder that still runs is no failure (409).
const CALLS: [(&str, &str, &str); 12] = [
    ("PUT", "/api/drives/step/registers/MotionControl", r#"{"value":1}"#),
    ("PUT", "/api/drives/s1/registers/MotionControl", r#"{"value":1}"#),
    ("PUT", "/api/drives/robot/registers/VEL_CMD", r#"{"value":300}"#),
    ("POST", "/api/drives/single/encoder", r#"{"counts":4000,"hz":10000}"#),
    ("PUT", "/api/drives/brush/registers/START_bit", r#"{"value":1}"#),
    ("PUT", "/api/drives/hybrid2/registers/SL", r#"{"value":2000}"#),
    ("POST", "/api/drives/s2/pins/J2.2/pulses", r#"{"count":100,"hz":1000}"#),
    (
        "POST",
        "/api/scenario",
        r#"{"steps":[{"pin":"s2.J2.3","level":"low"},{"after_ms":200,"pin":"s2.J2.3","level":"open"}]}"#,
    ),
    ("PUT", "/api/drives/robot/registers/VEL_CMD", r#"{"value":-300}"#),
    ("PUT", "/api/drives/brush/registers/STOP_bit", r#"{"value":1}"#),
    ("PUT", "/api/drives/f2/faults/mcu_overheat", ""),
    ("DELETE", "/api/drives/f2/faults/mcu_overheat", ""),
];

/// What visitors read.
const PAGES: [&str; 6] =
    ["/api/bench", "/api/buses", "/api/drives/step", "/api/drives/plus1", "/api/drives/f4", "/openapi.json"];

/// Starts the threads; returns their number.
pub(crate) fn start(ready: &Ready, tally: &Arc<Tally>, gate: &Arc<Gate>, power: &Arc<Power>) -> usize {
    let control = ready.control();
    {
        let (control, tally, gate, power) =
            (control.clone(), Arc::clone(tally), Arc::clone(gate), Arc::clone(power));
        thread::spawn(move || {
            let mut turn = 0;
            // All drives start.
            let longest = POWER_FAILS.iter().map(|(_, boot)| *boot).max().unwrap_or_default();
            thread::park_timeout(Duration::from_secs(longest));
            power.values().for_each(|state| _ = state.fetch_add(1, Ordering::SeqCst));
            loop {
                gate.pass();
                if let Err(sentence) = act(&control, &power, turn) {
                    tally.wrong(&sentence);
                }
                turn += 1;
            }
        });
    }
    let places = ["plus2", "step"].map(|name| ready.places(name));
    let (tally, gate) = (Arc::clone(tally), Arc::clone(gate));
    thread::spawn(move || {
        loop {
            gate.pass();
            if let Err(sentence) = visit(&control, &places, &tally) {
                tally.wrong(&sentence);
            }
            thread::park_timeout(PAUSE);
        }
    });
    2
}

/// Switches the power of the next drive off and on, and makes the next call.
fn act(control: &Control, power: &Power, turn: usize) -> Result<(), String> {
    let (method, path, body) = CALLS[turn % CALLS.len()];
    let (status, answer) = control.call(method, path, body)?;
    if !matches!((status, method), (200..300, _) | (409, "POST")) {
        return Err(format!("{method} {path} of the control API has status {status}: {answer}"));
    }
    let (drive, boot) = POWER_FAILS[turn % POWER_FAILS.len()];
    let state = &power[drive];
    state.fetch_add(1, Ordering::SeqCst);
    let path = format!("/api/drives/{drive}/power");
    control.expect("POST", &path, r#"{"action":"off"}"#)?;
    thread::park_timeout(OFF);
    control.expect("POST", &path, r#"{"action":"on"}"#)?;
    thread::park_timeout(Duration::from_secs(boot));
    state.fetch_add(1, Ordering::SeqCst);
    thread::park_timeout(ON);
    Ok(())
}

/// Opens connections and streams, reads from each of them, and closes them.
fn visit(control: &Control, [asked, silent]: &[Vec<String>; 2], tally: &Tally) -> Result<(), String> {
    let open =
        |place: &String| Wire::open(place).map_err(|error| format!("{place} takes no connection: {error}"));
    let mut visitors = (0..VISITORS).map(|_| open(&asked[0])).collect::<Result<Vec<Wire>, String>>()?;
    // A raw TCP port, a pty and a remote serial port (RFC 2217) of one line.
    let _silent = silent.iter().map(open).collect::<Result<Vec<Wire>, String>>()?;
    let line = tally.line("visitors");
    for (number, wire) in visitors.iter_mut().enumerate() {
        let Exchange { request, reply } = Dialect::TcpConstant.read(number as u16, 768_000);
        let (mut received, sent) = (Vec::new(), now());
        let result = wire.send(&request).and_then(|()| wire.receive(reply.len(), PATIENCE, &mut received));
        if result.is_err() || received != reply {
            return Err(format!("a visitor of plus2.modbus has got {received:02X?} instead of {reply:02X?}"));
        }
        line.answered(sent);
    }
    for path in PAGES {
        control.expect("GET", path, "")?;
    }
    for path in ["/api/live?drive=step", "/api/events", "/api/events?drive=count"] {
        let mut stream = control.request("GET", path, "")?;
        read_until(&mut stream, path, |text| text.contains("event:"))?;
    }
    type_on_terminal(control)
}

/// Opens a terminal at a port without a master, and asks for the maximum velocity, 768,000 steps per second (FB 5).
fn type_on_terminal(control: &Control) -> Result<(), String> {
    let path = "/api/drives/plus2/ports/mcode/terminal";
    let mut stream = control.request("GET", path, "")?;
    let opened = read_until(&mut stream, path, |text| text.contains('}'))?;
    let id = opened.split("\"id\":").nth(1).and_then(|rest| rest.split('}').next()).unwrap_or("0");
    control.expect("POST", &format!("/api/terminals/{id}"), r#"{"text":"PR VM\r"}"#)?;
    // The reply may come in several events.
    let shown = |text: &str| {
        text.split("\"text\":\"").skip(1).filter_map(|rest| rest.split("\"}").next()).collect::<String>()
    };
    read_until(&mut stream, path, |text| shown(text).contains("768000"))?;
    Ok(())
}

/// Reads a stream of events until `is_done` holds for its text.
fn read_until(stream: &mut TcpStream, path: &str, is_done: impl Fn(&str) -> bool) -> Result<String, String> {
    let mut text = String::new();
    while !is_done(&text) {
        let mut bytes = [0; 4_096];
        match stream.read(&mut bytes) {
            Ok(count @ 1..) => text += &String::from_utf8_lossy(&bytes[..count]),
            other => {
                return Err(format!(
                    "GET {path} of the control API has no more events: {other:?} after {text}"
                ));
            }
        }
    }
    Ok(text)
}
