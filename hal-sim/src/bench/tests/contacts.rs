//! Contacts for which a drive detects whether they are wired: those of an MD controller.

use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::motor::stepper::StepperParameters;

use super::*;

fn controller(bench: &mut Bench) -> (DriveId, impl Fn(&str) -> Pin + use<>) {
    let drive = bench.add_with("c", Box::new(Mdrobot::md400()), Setup::default()).unwrap();
    let spec = bench.spec(drive);
    (drive, move |name: &str| spec.pin(name).unwrap())
}

/// Events of contacts in the trace, from `from` on: ticks since then, and words.
fn contacts(bench: &Bench, from: Instant) -> Vec<String> {
    let entries = bench.trace().events().filter(|entry| {
        entry.at >= from
            && matches!(entry.event, trace::Event::Input(InputRecord::Edge { .. } | InputRecord::Open { .. }))
    });
    let command = |entry: &trace::Entry| (bench.trace().words(entry), entry.at.since(from).ticks());
    entries.map(command).map(|(words, ticks)| format!("{ticks} {words}")).collect()
}

#[track_caller]
fn assert_replays(bench: &Bench) {
    let make = |kind: &str| match kind {
        "mdrobot" => Some(Box::new(Mdrobot::md400()) as Box<dyn Device>),
        kind => make(kind),
    };
    let trace = trace::Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn an_unwired_contact_is_reported_only_after_a_stimulus() {
    let mut bench = Bench::new();
    let (drive, pin) = controller(&mut bench);
    bench.run_until(1.secs());
    assert_eq!(bench.level(drive, pin("START_STOP")), Level::Float);
    assert_eq!(contacts(&bench, Instant::ZERO), [""; 0]);
    for stimulus in [
        PinStimulus::Low,
        PinStimulus::Open,
        PinStimulus::Open,
        PinStimulus::High,
        PinStimulus::Millivolts(1_400),
    ] {
        bench.set_pin(drive, pin("START_STOP"), stimulus);
        bench.run_until(bench.now() + 1.millis());
    }
    assert_eq!(
        contacts(&bench, Instant::from(1.secs())),
        [
            "1 pin START_STOP low",
            "16001 pin START_STOP open",
            "48001 pin START_STOP high",
            "64001 pin START_STOP low"
        ]
    );
    // At power-on an input with a stimulus is reported, and one without a stimulus is not.
    bench.set_pin(drive, pin("START_STOP"), PinStimulus::Open);
    bench.set_pin(drive, pin("DIR"), PinStimulus::High);
    bench.run_until(2.secs());
    bench.power(drive, PowerAction::Cycle);
    bench.run_until(3.secs());
    assert_eq!(contacts(&bench, Instant::from(2.secs())), ["1 pin DIR high"]);
    assert_replays(&bench);
}

#[test]
fn pulses_at_an_open_pin_go_down_from_its_pull_up() {
    let mut bench = Bench::new();
    let (drive, pin) = controller(&mut bench);
    bench.pulse(drive, pin("DIR"), 2, 1_000.0).unwrap();
    bench.run_until(1.secs());
    assert_eq!(
        contacts(&bench, Instant::ZERO),
        [
            "1 pin DIR low",
            "8001 pin DIR high",
            "16001 pin DIR low",
            "24001 pin DIR high",
            "24001 pin DIR open"
        ]
    );
}

#[test]
fn a_wire_pulls_up_what_it_does_not_drive() {
    let mut bench = Bench::new();
    let (drive, pin) = controller(&mut bench);
    let toy = bench.add::<TestDevice>("toy");
    bench.wire((toy, test_device::OUT), (drive, pin("DIR")));
    assert_eq!(bench.level(drive, pin("DIR")), Level::High);
    bench.run_until(1.millis());
    assert_eq!(contacts(&bench, Instant::ZERO), ["0 pin DIR high"]);
    // First a stimulus from outside drives the pin, then the wire alone.
    bench.set_pin(drive, pin("DIR"), PinStimulus::Low);
    bench.run_until(2.millis());
    bench.set_pin(drive, pin("DIR"), PinStimulus::Open);
    bench.run_until(3.millis());
    assert_eq!(contacts(&bench, Instant::from(1.millis())), ["1 pin DIR low", "16001 pin DIR high"]);
    bench.power(drive, PowerAction::Cycle);
    bench.run_until(4.millis());
    assert_eq!(contacts(&bench, Instant::from(3.millis())), ["1 pin DIR high"]);
    assert_eq!(bench.level(drive, pin("DIR")), Level::High);
    assert_replays(&bench);
}

#[test]
fn hands_turn_the_encoder_that_has_no_index() {
    let mut bench = Bench::new();
    let (drive, _) = controller(&mut bench);
    bench.encoder(drive, Encoder(0), 4, 1_000.0).unwrap();
    bench.run_until(1.secs());
    let edges = ["1 pin ENC_A low", "16001 pin ENC_B low", "32001 pin ENC_A high", "48001 pin ENC_B high"];
    assert_eq!(contacts(&bench, Instant::ZERO), edges);
}

#[test]
fn a_switch_is_a_contact_that_is_wired() {
    let mut bench = Bench::new();
    let (drive, pin) = controller(&mut bench);
    let toy = bench.add::<TestDevice>("toy");
    let motor =
        bench.attach_motor("m", toy, Axis(0), MotorModel::Stepper(StepperParameters::NOMINAL)).unwrap();
    // The start position of the shaft is 0.
    for (name, from) in [("DIR", -1.0), ("START_STOP", 1.0)] {
        let closed = Closed { above_rev: Some(from), below_rev: None };
        bench.switch(motor, closed, (drive, pin(name)));
    }
    bench.run_until(1.millis());
    assert_eq!(contacts(&bench, Instant::ZERO), ["0 pin DIR low", "0 pin START_STOP high"]);
}
