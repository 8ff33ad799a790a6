use std::time::Duration;

use drivetwin_firmware::device::{Device as _, Encoder, Fault, Pin, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::motor::stepper::StepperParameters;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span as _;
use drivetwin_sim::bench::{Closed, MotorModel, PinStimulus, PowerAction, Setup};
use drivetwin_sim::catalog;
use drivetwin_sim::line::faults::{FaultRule, LineFaults};
use drivetwin_sim::rsasm;
use proptest::prelude::*;
use serde_json::json;

use super::patch::tests::apply;
use super::*;

/// A reader that applies what it gets.
struct Reader {
    viewer: Viewer,
    state: Value,
}

impl Reader {
    fn new(drive: Option<&str>) -> Self {
        Self { viewer: Viewer::new(drive.map(ToOwned::to_owned)), state: json!({}) }
    }

    /// Looks at a bench long after the last look.
    fn look(&mut self, bench: &Bench) -> Option<Update> {
        self.look_after(bench, LONGEST)
    }

    fn look_after(&mut self, bench: &Bench, since_last: Duration) -> Option<Update> {
        let snapshot = Snapshot::of(bench, TimeMode::Manual, &Places::new(), self.viewer.look());
        let update = self.viewer.update(snapshot, since_last)?;
        if let Some(patch) = &update.state {
            apply(&mut self.state, patch);
        }
        Some(update)
    }
}

/// The first update of a new reader.
fn whole(bench: &Bench, drive: Option<&str>) -> Value {
    let mut reader = Reader::new(drive);
    reader.look(bench);
    reader.state
}

fn add(bench: &mut Bench, name: &str, kind: &str) -> DriveId {
    let setup = Setup { boot_fast: true, ..Setup::default() };
    bench.add_with(name, catalog::make(kind).expect("a kind"), setup).expect("a drive")
}

#[test]
fn the_first_update_is_whole() {
    let mut bench = Bench::new();
    let x = add(&mut bench, "x", "md3");
    let y = add(&mut bench, "y", "md3");
    add(&mut bench, "q", "qsb-d");
    let pin = |name| Md3::default().spec().pin(name).expect("a pin");
    bench.wire((x, pin("STEP")), (y, pin("J2.4")));
    let motor = bench
        .attach_motor(
            "m",
            x,
            drivetwin_firmware::device::Axis(0),
            MotorModel::Stepper(StepperParameters::NOMINAL),
        )
        .expect("a motor");
    bench.encode(motor, 500, [Some((x, pin("J2.10"))), None, Some((x, pin("J2.12")))]);
    bench.switch(motor, Closed { above_rev: Some(1.0), below_rev: None }, (x, pin("J2.2")));
    bench.run_until(100.millis());
    let state = whole(&bench, None);
    assert_eq!(state["time"], json!({"mode": "manual", "seconds": 0.1}));
    assert_eq!(state["cannot"], json!({}));
    assert_eq!(
        state["wires"],
        json!([
            {"from": "x.STEP", "to": "y.J2.4"},
            {"from": "m.switch", "to": "x.J2.2"},
            {"from": "m.a", "to": "x.J2.10"},
            {"from": "m.index", "to": "x.J2.12"},
        ])
    );
    let still = json!({"index": 1, "kind": "md3", "powered": true, "lit": state["drives"]["y"]["lit"], "fault": false,
        "moving": false, "position": 0, "speed": 0.0, "refused": 0, "unanswered": 0});
    assert_eq!(state["drives"]["y"], still);
    assert_eq!(
        state["drives"]["q"],
        json!({"index": 2, "kind": "qsb-d", "powered": true, "lit": "", "fault": false, "count": 0,
            "refused": 0, "unanswered": 0})
    );
    assert_eq!(state["motors"]["m"]["drive"], "x");
    assert_eq!(state["motors"]["m"]["revolutions"], 0.0);
    assert_eq!(state["buses"]["x.rs485"]["line"], "9600 8E1");
    assert_eq!(state["buses"]["x.rs485"]["drives"], json!(["x"]));
    assert_eq!(state["buses"]["x.rs485"]["faults"]["drop"], 0.0);
    assert!(state.get("drive").is_none());
}

#[test]
fn an_adapter_without_an_axis_has_the_count_of_its_encoder() {
    let mut bench = Bench::new();
    let adapter = add(&mut bench, "q", "qsb-d");
    add(&mut bench, "m", "qsb-m");
    bench.run_until(1.secs());
    let mut reader = Reader::new(None);
    reader.look(&bench);
    assert!(reader.state["drives"]["m"].get("count").is_none(), "it has a position");
    // From the factory a QSB counts four edges a cycle, and 0 follows 499.
    bench.encoder(adapter, Encoder(0), 30, 1000.0).expect("an encoder that stands");
    bench.run_until(2.secs());
    let patch = reader.look(&bench).and_then(|update| update.state).expect("a change");
    assert_eq!(patch["drives"], json!({"q": {"count": 30}}));
}

#[test]
fn a_reader_is_told_what_changes_and_nothing_else() {
    let mut bench = Bench::new();
    let x = add(&mut bench, "x", "md3");
    add(&mut bench, "y", "md3");
    let mut reader = Reader::new(None);
    bench.run_until(100.millis());
    reader.look(&bench);
    assert!(reader.look(&bench).is_none());
    bench.fault(x, Fault(0), true);
    bench.run_until(101.millis());
    let update = reader.look(&bench).expect("a fault");
    let patch = update.state.expect("a change");
    assert_eq!(patch["drives"].as_object().map(serde_json::Map::len), Some(1), "{patch}");
    assert_eq!(patch["drives"]["x"]["fault"], true);
    assert_eq!(patch["time"], json!({"seconds": 0.101}));
    bench.power(x, PowerAction::Off);
    bench.set_faults(bench.outlet(x, Port(0)), LineFaults { drop: FaultRule::rate(0.5), ..LineFaults::NONE });
    bench.run_until(102.millis());
    let patch = reader.look(&bench).and_then(|update| update.state).expect("a change");
    assert_eq!(patch["drives"]["x"]["powered"], false);
    assert_eq!(patch["buses"], json!({"x.rs485": {"faults": {"drop": 0.5}}}));
    assert_eq!(reader.state, whole(&bench, None));
}

#[test]
fn messages_without_success_are_counted_for_every_drive() {
    let mut bench = Bench::new();
    let [x, y] = ["x", "y"].map(|name| {
        bench.add_with(name, catalog::make("md3").expect("a kind"), Setup::default()).expect("a drive")
    });
    // An MD3 starts for 2.5 s.
    bench.ask(x, &rtu::write(1, 0x11, 1));
    bench.run_until(2_500.millis());
    // No drive of x's line has address 9. Register 0x0B is reserved.
    bench.ask(x, &rtu::write(9, 0x11, 1));
    bench.ask(x, &rtu::write(1, 0x0B, 5));
    bench.ask(x, &rtu::write(1, 0x15, 5));
    // A fault takes the reply.
    bench.set_faults(bench.outlet(y, Port(0)), LineFaults { mute: FaultRule::rate(1.0), ..LineFaults::NONE });
    bench.ask(y, &rtu::write(1, 0x15, 5));
    let mut reader = Reader::new(Some("x"));
    let update = reader.look(&bench).expect("the first one");
    assert_eq!(reader.state["drives"]["x"]["refused"], 1);
    assert_eq!(reader.state["drives"]["x"]["unanswered"], 2);
    let unanswered: Vec<bool> = update.traffic.iter().map(|frame| frame.unanswered).collect();
    assert_eq!(unanswered, [true, true, false, false]);
    let update = Reader::new(Some("y")).look(&bench).expect("the first one");
    assert!(update.traffic[0].unanswered, "{:?}", update.traffic);
}

#[test]
fn a_refusal_names_the_register_that_is_its_cause() {
    let mut bench = Bench::new();
    let md3 = add(&mut bench, "x", "md3");
    bench.run_until(1.secs());
    let mut reader = Reader::new(None);
    reader.look(&bench);
    let mut registers = |bench: &mut Bench, pdu: &[u8]| {
        bench.ask(md3, &rtu::frame(1, pdu));
        let update = reader.look(bench).expect("a message");
        update.traffic[0].registers.clone()
    };
    // MD3 chapter 7: Speed is 0x14 and 0x15; DeviceAddress, 0x00, takes 1 to 247; 0x0B is reserved.
    assert_eq!(registers(&mut bench, &[6, 0, 0x0B, 0, 5]), ["Reserved"]);
    assert_eq!(registers(&mut bench, &[6, 0, 0, 0, 248]), ["DeviceAddress"]);
    // The drive has no coils, and no functions 16 and 22; a read of 33 registers is too long.
    assert!(registers(&mut bench, &[16, 0, 0, 0, 2, 4, 0, 248, 3, 10]).is_empty());
    assert!(registers(&mut bench, &[5, 0, 0x14, 0xFF, 0]).is_empty());
    assert!(registers(&mut bench, &[22, 0, 0x14, 0, 0, 0, 0]).is_empty());
    assert!(registers(&mut bench, &[3, 0, 0, 0, 33]).is_empty());
    // What a request has written, and what it has only read.
    assert_eq!(registers(&mut bench, &[6, 0, 0x15, 0, 9]), ["Speed"]);
    assert!(registers(&mut bench, &[3, 0, 0x14, 0, 2]).is_empty());
}

#[test]
fn a_message_for_no_drive_of_a_shared_line_is_counted_for_the_line() {
    let mut bench = Bench::new();
    let [x, y] = ["x", "y"].map(|name| add(&mut bench, name, "md3"));
    let line = bench.share("line", &[(x, Port(0)), (y, Port(0))]);
    bench.run_until(100.millis());
    assert!(whole(&bench, None)["buses"]["line"].get("unanswered").is_none());
    bench.ask(x, &rtu::write(9, 0x11, 1));
    let state = whole(&bench, None);
    assert_eq!(state["buses"]["line"]["unanswered"], 1, "{line:?}");
    assert_eq!(state["drives"]["x"]["unanswered"], 0);
}

/// At most 30 updates per second, and no event waits for the next of 30 looks.
#[test]
fn an_event_is_told_at_once_if_the_last_update_is_older_than_a_thirtieth_of_a_second() {
    let ms = Duration::from_millis;
    let mut pace = Pace::default();
    assert_eq!(pace.rest(ms(5)), ms(0));
    pace.looked(ms(5), true, true);
    // An event 10 ms after an update waits for the end of the thirtieth.
    assert_eq!(pace.rest(ms(15)), ms(24));
    assert_eq!(pace.rest(ms(39)), ms(0));
    // Idle looks every 250 ms find nothing. An event 1 ms after one of them is told at once.
    pace.looked(ms(255), false, false);
    assert_eq!(pace.rest(ms(256)), ms(0));
    assert_eq!(pace.since_update(ms(256)), ms(251));
    pace.looked(ms(256), true, true);
    assert_eq!(pace.rest(ms(257)), ms(33));
    // Events that change nothing that is seen do not make looks more frequent.
    pace.looked(ms(300), true, false);
    assert_eq!(pace.rest(ms(301)), ms(33));
    assert_eq!(pace.since_update(ms(301)), ms(45));
}

/// Time alone is told every 250 ms.
#[test]
fn time_alone_is_told_four_times_a_second() {
    let mut bench = Bench::new();
    add(&mut bench, "q", "qsb-d");
    bench.run_until(1.secs());
    let mut reader = Reader::new(None);
    reader.look(&bench);
    bench.run_until(1_034.millis());
    assert!(reader.look_after(&bench, Duration::from_millis(34)).is_none());
    bench.run_until(1_250.millis());
    let update = reader.look_after(&bench, Duration::from_millis(250)).expect("the time");
    assert_eq!(serde_json::to_value(&update).expect("JSON"), json!({"state": {"time": {"seconds": 1.25}}}));
}

#[test]
fn the_details_of_a_drive_are_those_of_its_call() {
    let mut bench = Bench::new();
    let x = add(&mut bench, "x", "md3");
    add(&mut bench, "y", "md3");
    bench.run_until(100.millis());
    let mut reader = Reader::new(Some("x"));
    reader.look(&bench);
    let details = |bench: &Bench| {
        let details = serde_json::to_value(Drive::of_bench(bench, x, &Places::new())).expect("JSON");
        patch::without_nulls(details)
    };
    assert_eq!(reader.state["drive"], details(&bench));
    bench.ask(x, &rtu::write(1, 0x15, 9_000));
    let patch = reader.look(&bench).and_then(|update| update.state).expect("a change");
    assert_eq!(patch["drive"]["registers"], json!({"Speed": 9_000}));
    assert_eq!(reader.state["drive"], details(&bench));
}

#[test]
fn traffic_has_the_newest_messages_with_their_outcomes() {
    let mut bench = Bench::new();
    let x = add(&mut bench, "x", "md3");
    let y = add(&mut bench, "y", "md3");
    bench.run_until(100.millis());
    let mut readers = [Reader::new(None), Reader::new(Some("x"))];
    for reader in &mut readers {
        reader.look(&bench);
    }
    bench.ask(y, &rtu::write(1, 0x15, 8_000));
    // Reserved is read only (7.10).
    bench.ask(x, &rtu::write(1, 0x0B, 5));
    let [all, of_x] = readers.each_mut().map(|reader| reader.look(&bench).expect("traffic").traffic);
    let drives: Vec<_> = all.iter().map(|frame| frame.drive.as_deref()).collect();
    assert_eq!((drives, of_x.len()), (vec![Some("y"), Some("x")], 1));
    assert_eq!(
        serde_json::to_value(&of_x[0]).expect("JSON"),
        json!({"number": 2, "at": of_x[0].at, "drive": "x", "port": "rs485", "text": "write Reserved = 5",
            "outcome": "refused: 0x000B Reserved is read only (02)", "verdict": "refused",
            "reason": "0x000B Reserved is read only (02)", "registers": ["Reserved"],
            "bytes": "0106000B0005380B", "answer": "018602C3A1"})
    );
    for n in 0..130 {
        bench.ask(x, &rtu::write(1, 0x15, n));
    }
    bench.ask(y, &rtu::read(1, 0x15, 1));
    let [all, of_x] = readers.each_mut().map(|reader| reader.look(&bench).expect("traffic"));
    assert_eq!((all.traffic.len(), all.left_out), (100, 31));
    assert_eq!(all.traffic.last().map(|frame| frame.text.as_str()), Some("read SpeedLow"));
    assert_eq!((of_x.traffic.len(), of_x.left_out), (100, 30));
    assert_eq!(of_x.traffic.first().map(|frame| frame.text.as_str()), Some("write SpeedLow = 30"));
    assert!(readers.iter_mut().all(|reader| reader.look(&bench).is_none()));
}

#[test]
fn a_drive_that_is_added_is_told() {
    let mut bench = Bench::new();
    add(&mut bench, "x", "md3");
    let mut reader = Reader::new(Some("y"));
    reader.look(&bench);
    assert!(reader.state.get("drive").is_none());
    add(&mut bench, "y", "md3");
    let patch = reader.look(&bench).and_then(|update| update.state).expect("a change");
    assert!(patch["drives"].get("x").is_none(), "{patch}");
    assert_eq!((&patch["drives"]["y"]["index"], &patch["drive"]["name"]), (&json!(1), &json!("y")));
    assert_eq!(reader.state, whole(&bench, Some("y")));
}

/// A look comes at most 34 ms after the last one while something moves, otherwise when a light changes, at the latest
/// after 250 ms.
#[test]
fn the_next_look_is_when_something_can_have_changed() {
    let mut bench = Bench::new();
    let x = bench.add::<Md3>("x");
    let mut viewer = Viewer::new(None);
    let mut look = |bench: &Bench| {
        let snapshot = Snapshot::of(bench, TimeMode::Times(1), &Places::new(), viewer.look());
        viewer.update(snapshot, LONGEST);
        viewer.wait()
    };
    bench.run_until(3.secs());
    assert_eq!(look(&bench), SHORTEST);
    bench.run_until(3_010.millis());
    let next_light = seen::next_light(&bench, x);
    let expected = match next_light < Instant::NEVER {
        true => {
            Duration::from_nanos(next_light.since(bench.now()).ticks() * 125 / 2).clamp(SHORTEST, LONGEST)
        }
        false => LONGEST,
    };
    assert_eq!(look(&bench), expected);
    bench.ask(x, &rtu::write(1, 0x11, 1));
    bench.run_until(bench.now() + 100.millis());
    look(&bench);
    bench.run_until(bench.now() + 1.millis());
    assert_eq!(look(&bench), SHORTEST);
}

/// An action on a bench of two MD3 on a line, a QSB and an MDrive.
#[derive(Clone, Debug)]
enum Action {
    Write(bool, u16, u16),
    Pin(u8, u8),
    Fault(bool, u8, bool),
    Power(u8, PowerAction),
    Run(u64),
    Disturb(f64),
}

fn actions() -> impl Strategy<Value = Action> {
    let power = prop_oneof![Just(PowerAction::Off), Just(PowerAction::On), Just(PowerAction::Cycle)];
    prop_oneof![
        4 => (any::<bool>(), 0x10_u16..0x24, 0_u16..3_000).prop_map(|(drive, at, value)| Action::Write(drive, at, value)),
        1 => (0_u8..12, 0_u8..3).prop_map(|(pin, level)| Action::Pin(pin, level)),
        1 => (any::<bool>(), 0_u8..4, any::<bool>()).prop_map(|(drive, fault, on)| Action::Fault(drive, fault, on)),
        1 => (0_u8..4, power).prop_map(|(drive, action)| Action::Power(drive, action)),
        3 => (1_u64..400).prop_map(Action::Run),
        1 => (0.0..0.5).prop_map(Action::Disturb),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whenever a reader looks, its state is what a new reader is told.
    #[test]
    fn patches_lead_to_the_whole_state(steps in prop::collection::vec((actions(), any::<bool>()), 1..40)) {
        let mut bench = Bench::new();
        let drives = [("x", "md3"), ("y", "md3-low"), ("q", "qsb-d"), ("m", "mdrive")]
            .map(|(name, kind)| add(&mut bench, name, kind));
        bench.share("line", &[(drives[0], Port(0)), (drives[1], Port(0))]);
        bench.run_until(10.millis());
        let mut readers = [Reader::new(None), Reader::new(Some("x")), Reader::new(Some("m"))];
        for (action, looks) in steps {
            match action {
                Action::Write(first, at, value) => {
                    bench.ask(drives[usize::from(!first)], &rtu::write(1, at, value));
                }
                Action::Pin(pin, level) => {
                    let level = [PinStimulus::Low, PinStimulus::High, PinStimulus::Open][usize::from(level)];
                    bench.set_pin(drives[0], Pin(pin), level);
                }
                Action::Fault(first, fault, on) => bench.fault(drives[usize::from(!first)], Fault(fault), on),
                Action::Power(drive, action) => bench.power(drives[usize::from(drive)], action),
                Action::Run(ms) => bench.run_until(bench.now() + ms.millis()),
                Action::Disturb(rate) => {
                    let faults = LineFaults { corrupt: FaultRule::rate(rate), ..LineFaults::NONE };
                    bench.set_faults(bench.outlet(drives[0], Port(0)), faults);
                }
            }
            for reader in readers.iter_mut().filter(|_| looks) {
                reader.look(&bench);
                let name = reader.viewer.look().drive.clone();
                prop_assert_eq!(&reader.state, &whole(&bench, name.as_deref()));
            }
        }
    }
}

/// IntervalRate 1 is 512 records a second (4.3), stream of ReadEncoder (4.1).
#[test]
fn what_a_drive_sends_by_itself_is_traffic() {
    let mut bench = Bench::new();
    let q = add(&mut bench, "q", "qsb-d");
    bench.run_until(100.millis());
    let mut reader = Reader::new(Some("q"));
    bench.ask(q, b"W0C1\r");
    bench.ask(q, b"S0E\r");
    reader.look(&bench);
    bench.run_until(bench.now() + 100.millis());
    let update = reader.look(&bench).expect("a stream");
    // 100 ms at 512 Hz, each record after the second interval.
    assert!((24..=52).contains(&update.traffic.len()), "{}", update.traffic.len());
    for frame in &update.traffic {
        assert_eq!((frame.text.as_str(), frame.sent, frame.number), ("ReadEncoder = 0", true, None));
        assert_eq!((frame.verdict, frame.port, frame.drive.as_deref()), ("done", "usb", Some("q")));
    }
    assert!(update.traffic.is_sorted_by(|a, b| a.at < b.at));
    bench.run_until(bench.now() + 1.secs());
    let update = reader.look(&bench).expect("a stream");
    assert_eq!(update.traffic.len(), MOST_FRAMES);
    // A command and its answer are one message to the drive, and no message of its own.
    let mut all = Reader::new(None);
    all.look(&bench);
    bench.ask(q, b"S00\r");
    let update = all.look(&bench).expect("traffic");
    let asked: Vec<_> =
        update.traffic.iter().filter(|frame| !frame.sent).map(|frame| frame.text.as_str()).collect();
    assert_eq!(asked, ["stream Mode"]);
}

#[test]
fn an_mdrive_has_its_program_and_what_it_prints() {
    let mut bench = Bench::new();
    let m = add(&mut bench, "m", "mdrive");
    bench.run_until(3.secs());
    let mut reader = Reader::new(Some("m"));
    reader.look(&bench);
    assert_eq!(reader.state["drive"]["program"], json!({"lines": []}));
    let client = bench.connect_to(m, Port(1)).expect("a connection");
    for line in ["PG 100", "LB G1", "PR \"HI\"", "H 100", "BR G1", "E", "PG"] {
        bench.send(client, format!("{line}\r").as_bytes());
        bench.run_until_idle();
    }
    reader.look(&bench);
    let lines = &reader.state["drive"]["program"]["lines"];
    assert_eq!(lines[0], json!({"at": 100, "text": "LB G1"}));
    assert_eq!(lines[1]["text"], "PR \"HI\"");
    assert!(reader.state["drive"]["program"].get("running").is_none());
    bench.send(client, b"EX 100\r");
    bench.run_until(bench.now() + 250.millis());
    let update = reader.look(&bench).expect("a program that runs");
    let at: Vec<_> = lines_at(&reader.state);
    assert!(
        at.contains(&reader.state["drive"]["program"]["running"]),
        "{}",
        reader.state["drive"]["program"]
    );
    let own: Vec<_> =
        update.traffic.iter().filter(|frame| frame.sent).map(|frame| frame.text.as_str()).collect();
    assert_eq!(own, ["HI"; 3]);
    bench.power(m, PowerAction::Off);
    bench.run_until(bench.now() + 1.millis());
    reader.look(&bench);
    assert!(reader.state["drive"]["program"].get("running").is_none());
}

/// The numbers of the lines of the program.
fn lines_at(state: &Value) -> Vec<Value> {
    let lines = state["drive"]["program"]["lines"].as_array().into_iter().flatten();
    lines.map(|line| line["at"].clone()).collect()
}

#[test]
fn an_rs_drive_has_its_program_and_the_line_that_is_next() {
    let program = rsasm::assemble("again: delay 500\n delay 20\n jmp again").expect("a program");
    let setup =
        Setup { boot_fast: true, memory: Some(rsasm::Image::of(&program).memory()), ..Setup::default() };
    let mut bench = Bench::new();
    let r = bench.add_with("r", catalog::make("rs434546").expect("a kind"), setup).expect("a drive");
    bench.run_until(3.secs());
    let mut reader = Reader::new(Some("r"));
    reader.look(&bench);
    let lines = json!([{"at": 0, "text": "line_0: delay 500"}, {"at": 1, "text": "delay 20"}, {"at": 2, "text": "jmp line_0"}]);
    assert_eq!(reader.state["drive"]["program"], json!({"lines": lines}));
    let spec = bench.spec(r);
    let row = spec.find("MODE_USER_PROGRAM").expect("a register").row;
    bench.poke(r, row, 2).expect("a start");
    bench.run_until(bench.now() + 10.millis());
    reader.look(&bench);
    let pc = bench.value(r, spec.find("PC_REG").expect("a register").row);
    assert_eq!(reader.state["drive"]["program"]["running"], serde_json::to_value(pc).expect("JSON"));
}
