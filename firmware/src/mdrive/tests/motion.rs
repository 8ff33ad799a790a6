//! Motion by pins and faults, and the values that show it.

use super::super::{A, B, INDEX, IO7};
use super::*;
use crate::device::Encoder;

/// Makes this number of edges of a remote encoder, forward or backward, starting with both channels high.
fn edges(dut: &mut Dut, edges: i32) {
    let forward = [(A, false), (B, false), (A, true), (B, true)];
    let backward = [(B, false), (A, false), (B, true), (A, true)];
    let cycle = if edges < 0 { backward } else { forward };
    for (pin, high) in cycle.into_iter().cycle().take(edges.unsigned_abs() as usize) {
        dut.feed(Input::Edge { pin, high });
        dut.wait(1.millis());
    }
}

/// "Set filtering for the motion inputs ... and optional encoder" (MC 5-26). `filters` holds, for each value of FM,
/// the shortest pulse in ns that passes the filter, which the drive rounds up to whole ticks of 62.5 ns.
#[test]
fn a_remote_encoder_is_filtered() {
    let filters = [50, 150, 200, 300, 500, 900, 1_700, 3_300, 6_500, 12_900_u64];
    for (filter, ns) in (0..).zip(filters) {
        let mut dut = Dut::plus();
        dut.set(Reg::FM, filter);
        for pin in [A, B] {
            dut.feed(Input::Edge { pin, high: true });
        }
        let mut pulse = |ticks| {
            for high in [false, true] {
                dut.feed(Input::Edge { pin: A, high });
                dut.wait(Duration::from_ticks(ticks));
            }
            let counted = dut.get(Reg::C2);
            dut.wait(1.millis());
            assert_eq!(dut.get(Reg::C2), 0, "there and back");
            counted
        };
        let ticks = (ns * 16).div_ceil(1_000);
        assert_eq!(pulse(ticks), 0, "it came, and went");
        dut.feed(Input::Edge { pin: A, high: false });
        dut.wait(Duration::from_ticks(ticks - 1));
        assert_eq!(dut.get(Reg::C2), 0, "FM {filter}");
        dut.wait(Duration::TICK);
        assert_eq!(dut.get(Reg::C2), 1, "FM {filter}");
        dut.feed(Input::Edge { pin: A, high: true });
        dut.wait(Duration::from_ticks(ticks - 1));
        dut.feed(Input::Edge { pin: A, high: false });
        dut.wait(1.millis());
        assert_eq!(dut.get(Reg::C2), 1, "too short for FM {filter}");
    }
}

/// A board may count the edges of a remote encoder itself.
#[test]
fn a_board_counts_a_remote_encoder() {
    let mut dut = Dut::plus();
    dut.set(Reg::MR, 1_000);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::C2), 40);
    dut.feed(Input::Count { encoder: Encoder(0), steps: -7, a: true, b: false });
    assert_eq!(dut.get(Reg::C2), 33);
    dut.set(Reg::MR, 1_000);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::C2), 33, "the motor's own counts no more");
}

/// A load that is too heavy for the torque at RC causes a stall. A lighter load does not.
#[test]
fn a_load_stalls() {
    let mut dut = Dut::plus();
    dut.set(Reg::HoldingTorque, 1_000);
    // 250 mN·m and friction hold this load at rest, but cannot turn it.
    dut.set(Reg::HC, 25);
    dut.set(Reg::Load, 255);
    dut.set(Reg::EE, 1);
    dut.set(Reg::MA, 2_048);
    dut.wait(1.secs());
    // SF = 15 counts are 375 steps. The field at rest does not pull the shaft uphill. It pulls the shaft into
    // step at the next position downhill, four full steps below: 649 steps, 25.96 counts back.
    assert_eq!((dut.get(Reg::ST), dut.get(Reg::MV), dut.error()), (1, 0, 86));
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::P)), (375, -26));
    // Neither FD nor a power cycle changes the load.
    dut.type_in(CLIENT, "FD\r");
    dut.cycle();
    dut.set(Reg::EE, 1);
    dut.set(Reg::ST, 0);
    dut.set(Reg::MA, 2_048);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::ST), dut.error()), (1, 86));
    dut.set(Reg::RC, 60);
    dut.set(Reg::HC, 60);
    dut.wait(1.secs());
    let position = dut.get(Reg::P);
    dut.set(Reg::MA, position + 2_048);
    dut.wait(2.secs());
    assert_eq!((dut.get(Reg::P) - position, dut.error()), (2_048, 0));
    assert_eq!(dut.try_set(Reg::Load, 100_001), Err(PresetError::OutOfRange));
}

#[test]
fn a_remote_encoder_counts_while_it_is_driven() {
    let mut dut = Dut::plus();
    // The built-in encoder has 25 steps per count, and began on its index.
    assert_eq!(dut.get(Reg::I6), 1);
    dut.set(Reg::MR, 1_000);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::C2), dut.get(Reg::I6)), (1_000, 40, 0));
    for pin in [A, B] {
        dut.feed(Input::Edge { pin, high: true });
    }
    edges(&mut dut, 8);
    edges(&mut dut, -4);
    assert_eq!(dut.get(Reg::C2), 44);
    dut.feed(Input::Edge { pin: INDEX, high: true });
    assert_eq!(dut.get(Reg::I6), 1);
    for pin in [A, B, INDEX] {
        dut.feed(Input::Open { pin });
    }
    dut.set(Reg::MR, -1_000);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::C2), dut.get(Reg::I6)), (4, 1));
    // After a power cycle the levels of the channels are unknown again, so the built-in encoder counts.
    dut.feed(Input::Edge { pin: A, high: true });
    dut.cycle();
    dut.set(Reg::MR, 1_000);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::C2), 40);
}

#[test]
fn a_held_shaft_is_a_stall() {
    let mut dut = Dut::plus();
    dut.set(Reg::EE, 1);
    dut.fault("stall", true);
    dut.set(Reg::MA, 2_048);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::ST), dut.get(Reg::MV), dut.error()), (1, 0, 86));
    // SF = 15 counts are 375 steps.
    assert_eq!((dut.get(Reg::C1), dut.get(Reg::P)), (375, 0));
    dut.set(Reg::ST, 0);
    dut.fault("stall", false);
    dut.set(Reg::MA, 2_048);
    dut.wait(2.secs());
    assert_eq!((dut.get(Reg::ST), dut.get(Reg::P), dut.error()), (0, 2_048, 0));
}

#[test]
fn homing_needs_a_switch() {
    let mut dut = Dut::plus();
    dut.refused(&[16, 0, 0x2B, 0, 1, 2, 0, 1], 4, 80);
    dut.drive(1, true);
    dut.set(Reg::S1, 1 << 32);
    dut.write(0x2B, 1, 1);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::V), -768_000);
    dut.drive(1, false);
    dut.wait(2.secs());
    // The shaft has stopped on the switch. Now it creeps forward until it leaves the switch.
    assert_eq!((dut.get(Reg::V), dut.get(Reg::MV)), (1_000, 1));
    dut.drive(1, true);
    // The next whole step is at most 1 ms away.
    dut.wait(1.millis());
    assert_eq!((dut.get(Reg::V), dut.get(Reg::MV), dut.error()), (0, 0, 0));
}

#[test]
fn limits_and_jog_by_inputs() {
    let mut dut = Dut::plus();
    for (n, (reg, kind)) in [(Reg::S1, 7), (Reg::S2, 2), (Reg::S3, 17)].into_iter().enumerate() {
        dut.drive(n as u8 + 1, true);
        dut.set(reg, kind << 32);
    }
    dut.set(Reg::JE, 1);
    dut.drive(1, false);
    dut.wait(1.secs());
    // Output 3 is active (low) during motion.
    let io3 = |dut: &Dut| dut.out.level(Pin(2));
    assert_eq!((dut.get(Reg::V), io3(&dut)), (768_000, Some(Level::Low)));
    dut.drive(2, false);
    assert_eq!(dut.get(Reg::VC), 1);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::MV), dut.error()), (0, 83));
    assert_ne!(io3(&dut), Some(Level::Low));
    dut.set(Reg::SL, 1_000);
    assert_eq!((dut.get(Reg::MV), dut.error()), (0, 83));
}

#[test]
fn what_jogs_while_it_starts_does_not() {
    let mut dut = Dut::plus();
    dut.drive(1, true);
    dut.set(Reg::S1, 7 << 32);
    dut.set(Reg::JE, 1);
    dut.write(0x76, 1, 1);
    dut.wait(1.secs());
    dut.now += 1.secs();
    dut.power_on(false);
    dut.drive(1, false);
    dut.wait(10.secs());
    assert_eq!((dut.get(Reg::JE), dut.get(Reg::C1), dut.get(Reg::MV)), (1, 0, 0));
    dut.drive(1, true);
    dut.drive(1, false);
    assert_eq!(dut.get(Reg::MV), 1);
}

/// Nothing moves because power returns (MDRIVE-20), whatever the filter, also without a start-up delay.
#[test]
fn inputs_that_are_active_at_power_on_turn_nothing() {
    let jogs = |ms| (Pin(0), [(Reg::S1, 7 << 32), (Reg::D1, ms), (Reg::JE, 1)]);
    let follows = |filter| (IO7, [(Reg::S7, 33 << 16), (Reg::FM, filter), (Reg::CM, 1)]);
    for (pin, settings) in [jogs(0), jogs(255), follows(0), follows(9)] {
        for fast in [false, true] {
            let mut dut = Dut::plus();
            dut.feed(Input::Edge { pin, high: true });
            for (reg, value) in settings {
                dut.set(reg, value);
            }
            dut.write(0x76, 1, 1);
            dut.wait(1.secs());
            dut.now += 1.secs();
            dut.fixture.power_on(Boot { fast, ..Boot::default() });
            dut.feed(Input::Edge { pin, high: false });
            dut.wait(1.secs());
            assert_eq!((dut.get(Reg::C1), dut.get(Reg::MV)), (0, 0), "{settings:?}, {fast}");
            dut.feed(Input::Edge { pin, high: true });
            dut.wait(1.secs());
            dut.feed(Input::Edge { pin, high: false });
            dut.wait(1.secs());
            assert_ne!(dut.get(Reg::C1), 0, "{settings:?}, {fast}");
        }
    }
}

#[test]
fn the_clock_turns_the_motor() {
    let mut dut = Dut::plus();
    dut.set(Reg::CM, 1);
    for _ in 0..100 {
        dut.wait(100.micros());
        dut.feed(Input::Edge { pin: IO7, high: false });
        dut.wait(100.micros());
        dut.feed(Input::Edge { pin: IO7, high: true });
    }
    assert_eq!((dut.get(Reg::C1).abs(), dut.get(Reg::MV)), (100, 1));
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::C2).abs(), dut.get(Reg::MV)), (4, 0));
    // At half the ratio the motor follows with ramps.
    dut.set(Reg::CR, 500);
    let before = dut.get(Reg::C1);
    for _ in 0..1_000 {
        dut.wait(100.micros());
        dut.feed(Input::Edge { pin: IO7, high: false });
        dut.wait(100.micros());
        dut.feed(Input::Edge { pin: IO7, high: true });
    }
    assert_eq!(dut.get(Reg::V).abs(), 2_500);
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::C1) - before).abs(), 500);
}
