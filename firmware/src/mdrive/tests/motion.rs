//! What moves the motor, and what it tells: pins and faults.

use super::super::{A, B, INDEX, IO7};
use super::*;
use crate::device::Encoder;

/// Makes so many edges of a remote encoder, forward or backward, from both channels high.
fn edges(bed: &mut Bed, edges: i32) {
    let forward = [(A, false), (B, false), (A, true), (B, true)];
    let backward = [(B, false), (A, false), (B, true), (A, true)];
    let cycle = if edges < 0 { backward } else { forward };
    for (pin, high) in cycle.into_iter().cycle().take(edges.unsigned_abs() as usize) {
        bed.input(Input::Edge { pin, high });
        bed.wait(1.millis());
    }
}

/// "Set filtering for the motion inputs ... and optional encoder" (MC 5-26): the shortest pulse of each FM, in ns. A
/// tick is 62.5 ns.
#[test]
fn a_remote_encoder_is_filtered() {
    let filters = [50, 150, 200, 300, 500, 900, 1_700, 3_300, 6_500, 12_900_u64];
    for (filter, ns) in (0..).zip(filters) {
        let mut bed = Bed::plus();
        bed.set(Reg::FM, filter);
        for pin in [A, B] {
            bed.input(Input::Edge { pin, high: true });
        }
        let mut pulse = |ticks| {
            for high in [false, true] {
                bed.input(Input::Edge { pin: A, high });
                bed.wait(Duration::from_ticks(ticks));
            }
            let counted = bed.get(Reg::C2);
            bed.wait(1.millis());
            assert_eq!(bed.get(Reg::C2), 0, "there and back");
            counted
        };
        let ticks = (ns * 16).div_ceil(1_000);
        assert_eq!(pulse(ticks), 0, "it came, and went");
        bed.input(Input::Edge { pin: A, high: false });
        bed.wait(Duration::from_ticks(ticks - 1));
        assert_eq!(bed.get(Reg::C2), 0, "FM {filter}");
        bed.wait(Duration::TICK);
        assert_eq!(bed.get(Reg::C2), 1, "FM {filter}");
        bed.input(Input::Edge { pin: A, high: true });
        bed.wait(Duration::from_ticks(ticks - 1));
        bed.input(Input::Edge { pin: A, high: false });
        bed.wait(1.millis());
        assert_eq!(bed.get(Reg::C2), 1, "too short for FM {filter}");
    }
}

/// A board may count itself.
#[test]
fn a_board_counts_a_remote_encoder() {
    let mut bed = Bed::plus();
    bed.set(Reg::MR, 1_000);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::C2), 40);
    bed.input(Input::Count { encoder: Encoder(0), steps: -7, a: true, b: false });
    assert_eq!(bed.get(Reg::C2), 33);
    bed.set(Reg::MR, 1_000);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::C2), 33, "the motor's own counts no more");
}

/// A load that RC's share of the torque does not overcome is a stall, and one that it does is none.
#[test]
fn a_load_stalls() {
    let mut bed = Bed::plus();
    bed.set(Reg::HoldingTorque, 1_000);
    // 250 mN·m and friction hold it, and do not turn it.
    bed.set(Reg::HC, 25);
    bed.set(Reg::Load, 255);
    bed.set(Reg::EE, 1);
    bed.set(Reg::MA, 2_048);
    bed.wait(1.secs());
    // 15 counts, SF, are 375 steps. The field that stands there does not take the shaft uphill, but to its next place
    // downhill, four full steps below: 649 steps, 25.96 counts back.
    assert_eq!((bed.get(Reg::ST), bed.get(Reg::MV), bed.error()), (1, 0, 86));
    assert_eq!((bed.get(Reg::C1), bed.get(Reg::P)), (375, -26));
    // Neither FD nor a power failure lightens it.
    bed.type_in(CLIENT, "FD\r");
    bed.cycle();
    bed.set(Reg::EE, 1);
    bed.set(Reg::ST, 0);
    bed.set(Reg::MA, 2_048);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::ST), bed.error()), (1, 86));
    bed.set(Reg::RC, 60);
    bed.set(Reg::HC, 60);
    bed.wait(1.secs());
    let position = bed.get(Reg::P);
    bed.set(Reg::MA, position + 2_048);
    bed.wait(2.secs());
    assert_eq!((bed.get(Reg::P) - position, bed.error()), (2_048, 0));
    assert_eq!(bed.try_set(Reg::Load, 100_001), Err(Refused::OutOfRange));
}

#[test]
fn a_remote_encoder_counts_while_it_is_driven() {
    let mut bed = Bed::plus();
    // The built-in one: 25 steps a count, and it began on its index.
    assert_eq!(bed.get(Reg::I6), 1);
    bed.set(Reg::MR, 1_000);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::C1), bed.get(Reg::C2), bed.get(Reg::I6)), (1_000, 40, 0));
    for pin in [A, B] {
        bed.input(Input::Edge { pin, high: true });
    }
    edges(&mut bed, 8);
    edges(&mut bed, -4);
    assert_eq!(bed.get(Reg::C2), 44);
    bed.input(Input::Edge { pin: INDEX, high: true });
    assert_eq!(bed.get(Reg::I6), 1);
    for pin in [A, B, INDEX] {
        bed.input(Input::Open { pin });
    }
    bed.set(Reg::MR, -1_000);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::C2), bed.get(Reg::I6)), (4, 1));
    // Nobody has told who drives it now.
    bed.input(Input::Edge { pin: A, high: true });
    bed.cycle();
    bed.set(Reg::MR, 1_000);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::C2), 40);
}

#[test]
fn a_held_shaft_is_a_stall() {
    let mut bed = Bed::plus();
    bed.set(Reg::EE, 1);
    bed.fault("stall", true);
    bed.set(Reg::MA, 2_048);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::ST), bed.get(Reg::MV), bed.error()), (1, 0, 86));
    // 15 counts, SF, are 375 steps.
    assert_eq!((bed.get(Reg::C1), bed.get(Reg::P)), (375, 0));
    bed.set(Reg::ST, 0);
    bed.fault("stall", false);
    bed.set(Reg::MA, 2_048);
    bed.wait(2.secs());
    assert_eq!((bed.get(Reg::ST), bed.get(Reg::P), bed.error()), (0, 2_048, 0));
}

#[test]
fn homing_needs_a_switch() {
    let mut bed = Bed::plus();
    bed.refused(&[16, 0, 0x2B, 0, 1, 2, 0, 1], 4, 80);
    bed.drive(1, true);
    bed.set(Reg::S1, 1 << 32);
    bed.write(0x2B, 1, 1);
    bed.wait(1.secs());
    assert_eq!(bed.get(Reg::V), -768_000);
    bed.drive(1, false);
    bed.wait(2.secs());
    // It stood on the switch, creeps forward, and leaves it.
    assert_eq!((bed.get(Reg::V), bed.get(Reg::MV)), (1_000, 1));
    bed.drive(1, true);
    // The next whole step is 1 ms away at most.
    bed.wait(1.millis());
    assert_eq!((bed.get(Reg::V), bed.get(Reg::MV), bed.error()), (0, 0, 0));
}

#[test]
fn limits_and_jog_by_inputs() {
    let mut bed = Bed::plus();
    for (n, (reg, kind)) in [(Reg::S1, 7), (Reg::S2, 2), (Reg::S3, 17)].into_iter().enumerate() {
        bed.drive(n as u8 + 1, true);
        bed.set(reg, kind << 32);
    }
    bed.set(Reg::JE, 1);
    bed.drive(1, false);
    bed.wait(1.secs());
    // Output 3 is active, low, while it moves.
    let io3 =
        |bed: &Bed| bed.world.levels.iter().rfind(|(_, pin, _)| *pin == Pin(2)).map(|(.., level)| *level);
    assert_eq!((bed.get(Reg::V), io3(&bed)), (768_000, Some(Level::Low)));
    bed.drive(2, false);
    assert_eq!(bed.get(Reg::VC), 1);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::MV), bed.error()), (0, 83));
    assert_ne!(io3(&bed), Some(Level::Low));
    bed.set(Reg::SL, 1_000);
    assert_eq!((bed.get(Reg::MV), bed.error()), (0, 83));
}

#[test]
fn what_jogs_while_it_starts_does_not() {
    let mut bed = Bed::plus();
    bed.drive(1, true);
    bed.set(Reg::S1, 7 << 32);
    bed.set(Reg::JE, 1);
    bed.write(0x76, 1, 1);
    bed.wait(1.secs());
    bed.now += 1.secs();
    bed.power_on(false);
    bed.drive(1, false);
    bed.wait(10.secs());
    assert_eq!((bed.get(Reg::JE), bed.get(Reg::C1), bed.get(Reg::MV)), (1, 0, 0));
    bed.drive(1, true);
    bed.drive(1, false);
    assert_eq!(bed.get(Reg::MV), 1);
}

#[test]
fn the_clock_turns_the_motor() {
    let mut bed = Bed::plus();
    bed.set(Reg::CM, 1);
    for _ in 0..100 {
        bed.wait(100.micros());
        bed.input(Input::Edge { pin: IO7, high: false });
        bed.wait(100.micros());
        bed.input(Input::Edge { pin: IO7, high: true });
    }
    assert_eq!((bed.get(Reg::C1).abs(), bed.get(Reg::MV)), (100, 1));
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::C2).abs(), bed.get(Reg::MV)), (4, 0));
    // Half of it, with ramps.
    bed.set(Reg::CR, 500);
    let before = bed.get(Reg::C1);
    for _ in 0..1_000 {
        bed.wait(100.micros());
        bed.input(Input::Edge { pin: IO7, high: false });
        bed.wait(100.micros());
        bed.input(Input::Edge { pin: IO7, high: true });
    }
    assert_eq!(bed.get(Reg::V).abs(), 2_500);
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::C1) - before).abs(), 500);
}
