//! A wrong name or value gives an error whose text is one sentence, and changes nothing.

use drivetwin::{Bench, FaultRule, LineFaults, PinStimulus, PowerAction, Span as _, md3, mdrive, qsb};

/// The sentence of an error.
#[track_caller]
fn refused<T: std::fmt::Debug>(result: Result<T, drivetwin::Error>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn wrong_names_are_refused_with_the_nearest() {
    let bench = Bench::new();
    assert_eq!(refused(bench.add("md4", "x")), "there is no kind 'md4'; the nearest is 'md3'");
    let x = bench.add("md3", "x").unwrap();
    let y = bench.add("qsb-d", "y").unwrap();
    assert_eq!(refused(bench.add("md3", "x")), "the name x is in use already");
    assert_eq!(refused(bench.drive("z")), "there is no drive 'z'; the nearest is 'x'");
    assert_eq!(refused(x.get("Sped")), "there is no register 'Sped'; the nearest is 'Speed'");
    assert_eq!(refused(x.set(md3::Reg::DeviceAddress, 300)), "DeviceAddress takes 1 to 247, not 300");
    assert_eq!(refused(x.pin("J2.1")), "there is no pin 'J2.1'; the nearest is 'J2.2'");
    assert_eq!(refused(x.set_pin("STEP", PinStimulus::Low)), "STEP is an output");
    assert_eq!(
        refused(x.set_pin("J2.2", PinStimulus::Millivolts(5_000))),
        "J2.2 takes a level, not a voltage"
    );
    assert_eq!(refused(x.port("usb").map(drop)), "there is no port 'usb'; available: rs485");
    assert_eq!(
        refused(x.fault("overheat")),
        "there is no fault 'overheat'; available: over_temperature, over_current"
    );
    assert_eq!(refused(y.pulses()), "y (qsb-d) has no STEP output");
    assert_eq!(
        refused(bench.wire("x.J2.2", "y.A")),
        "x.J2.2 is an input; a wire leads from an output to an input"
    );
    assert_eq!(
        refused(bench.wire("x.STEP", "x.DIR")),
        "x.DIR takes no levels; a wire leads from an output to an input"
    );
    assert_eq!(
        refused(bench.wire("STEP", "y.A")),
        "there is no pin 'STEP'; write drive and pin, like x.J2.4"
    );
    assert_eq!(
        refused(Bench::from_toml("[[drive]]\nkind = 'md3'\n").map(drop)),
        "line 1, column 1: [[drive]] needs 'name'"
    );
    let lost = LineFaults { drop: FaultRule::next(1).register("Sped"), ..LineFaults::NONE };
    assert_eq!(
        refused(bench.set_faults("x.rs485", lost)),
        "drop: there is no register 'Sped' on x; the nearest is 'Speed'"
    );
    assert_eq!(
        refused(bench.set_faults("x.rs485", LineFaults { close: FaultRule::ALL, ..LineFaults::NONE })),
        "close is for TCP ports only, and rs485 is a serial line"
    );
    let foreign = LineFaults { drop: FaultRule::ALL.drive(y.id()), ..LineFaults::NONE };
    assert_eq!(refused(bench.set_faults("x.rs485", foreign)), "drop is for a drive that is not on this bus");
    assert_eq!(
        refused(bench.set_faults("x.rs422", LineFaults::NONE)),
        "there is no bus 'x.rs422'; the nearest is 'x.rs485'"
    );
    // A name of another kind of drive.
    assert_eq!(refused(y.get(mdrive::Reg::EE)), "there is no register 'EE'");
}

#[test]
fn a_drive_without_power_takes_no_presets() {
    let bench = Bench::new();
    let x = bench.add("md3", "x").unwrap();
    x.power(PowerAction::Off);
    bench.advance(1.millis());
    assert_eq!(refused(x.set("Speed", 100)), "x has no power");
    assert_eq!(x.get("Speed").unwrap(), 5_000);
}

#[test]
fn a_bench_has_drives_wires_and_shared_lines() {
    let bench = Bench::new();
    let x = bench.add_preset("md3", "x", &[("MoveSteps", 100)]).unwrap();
    let y = bench.add_preset("md3", "y", &[("DeviceAddress", 2)]).unwrap();
    bench.add_preset("qsb-m", "reader", &[(qsb::Reg::Mdr0, 0x00)]).unwrap();
    bench.share("line1", &[&x, &y]).unwrap();
    assert_eq!(
        refused(bench.share("line1", &[&x, &y])),
        "'line1' is no name for a line: use one new word without dots"
    );
    bench.wire("x.STEP", "reader.A").unwrap();
    bench.wire("x.DIR", "reader.B").unwrap();
    x.set(md3::Reg::MotionControl, 1).unwrap();
    bench.advance(1.secs());
    assert_eq!((x.motion().position, x.pulses().unwrap().len()), (100, 100));
    assert_eq!(bench.drive("reader").unwrap().get(qsb::Reg::ReadEncoder).unwrap(), 100);
    assert!(bench.trace().starts_with("drivetwin trace 1\n"));
    assert_eq!(format!("{bench:?}"), "Bench at 1 s with 3 drives");
}
