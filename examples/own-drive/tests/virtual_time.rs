//! The drive on the bench, in virtual time.

use std::sync::Once;

use drivetwin::{Bench, Drive, Level, Span as _, rtu};
use own_drive::Vfd;

/// A bench with a started drive.
fn vfd() -> (Bench, Drive) {
    static KINDS: Once = Once::new();
    KINDS.call_once(|| drivetwin::add_kinds(&[|| Box::new(Vfd::new())]).unwrap());
    let bench = Bench::new();
    let drive = bench.add("own-vfd", "v").unwrap();
    bench.advance(1.secs());
    (bench, drive)
}

#[test]
fn the_ramp_takes_its_time_and_the_relay_closes_at_its_end() {
    let (bench, drive) = vfd();
    // 25 Hz, at 5 s from standstill to 50 Hz: 2.5 s.
    assert_eq!(drive.ask(&rtu::write(1, 0, 1)), rtu::write(1, 0, 1)[..]);
    let start = bench.now();
    bench.advance(1.secs());
    assert!((1_000..1_010).contains(&drive.get("Frequency").unwrap()), "{:?}", drive.get("Frequency"));
    assert_eq!(drive.pin("RELAY").unwrap(), Level::Float);
    bench.run_until(start + 2_500.millis());
    assert_eq!((drive.get("Frequency").unwrap(), drive.pin("RELAY").unwrap()), (2_500, Level::Low));
}

#[test]
fn wrong_values_and_registers_are_refused() {
    let (_bench, drive) = vfd();
    assert_eq!(drive.ask(&rtu::write(1, 1, 5_001)), rtu::frame(1, &[0x86, 3])[..]);
    assert_eq!(drive.ask(&rtu::write(1, 3, 0)), rtu::frame(1, &[0x86, 2])[..]);
    assert_eq!(drive.ask(&rtu::read(1, 3, 3)), rtu::frame(1, &[0x83, 2])[..]);
    assert!(drive.set("Frequency", 1).is_err() && drive.set("RampTime", 0).is_err());
}

#[test]
fn an_overload_stops_it_until_a_stop_clears_it() {
    let (bench, drive) = vfd();
    assert_eq!(drive.ask(&rtu::write(1, 0, 2)), rtu::write(1, 0, 2)[..]);
    bench.advance(3.secs());
    assert_eq!(drive.get("Frequency").unwrap(), -2_500);
    drive.fault("overload").unwrap();
    bench.advance(1.millis());
    assert_eq!((drive.get("Frequency").unwrap(), drive.get("Status").unwrap()), (0, 4));
    // A start has no effect until the cause is gone and a stop has cleared the fault.
    drive.clear("overload").unwrap();
    assert_eq!(drive.ask(&rtu::write(1, 0, 1)), rtu::write(1, 0, 1)[..]);
    assert_eq!(drive.get("Status").unwrap(), 4);
    assert_eq!(drive.ask(&rtu::write(1, 0, 0)), rtu::write(1, 0, 0)[..]);
    assert_eq!(drive.get("Status").unwrap(), 0);
}
