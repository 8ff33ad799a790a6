//! Inputs that act on the whole drive (MC 5-63).

use super::*;

/// A program that counts R1 up, while the motor turns at 50,000 steps/s, and input 1 of this type, active when low.
fn busy(kind: i64) -> Bed {
    let mut bed = Bed::plus();
    bed.drive(1, true);
    bed.set(Reg::S1, kind << 32);
    bed.connect(CLIENT);
    bed.type_in(CLIENT, "PG 1\rLB G1\rIC R1\rBR G1\rE\rPG\rSL 50000\rEX G1\r");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::V), bed.get(Reg::BY), bed.error()), (50_000, 1, 0));
    bed
}

#[test]
fn soft_stop() {
    let mut bed = busy(5);
    bed.drive(1, false);
    assert_eq!((bed.get(Reg::BY), bed.get(Reg::VC)), (0, 1));
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::MV), bed.error()), (0, 91));
    bed.drive(1, true);
    // At rest it ends a program, too.
    bed.type_in(CLIENT, "EX G1\r");
    bed.drive(1, false);
    assert_eq!((bed.get(Reg::BY), bed.error()), (0, 48));
    bed.drive(1, true);
    bed.drive(1, false);
    assert_eq!(bed.error(), 0, "there was nothing to stop");
}

#[test]
fn soft_stop_of_a_program_that_pauses() {
    let mut bed = busy(5);
    bed.type_in(CLIENT, "PS\r");
    bed.wait(1.secs());
    bed.drive(1, false);
    assert_eq!(bed.error(), 0);
    bed.type_in(CLIENT, "RS\r");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::V), bed.get(Reg::BY)), (50_000, 1));
}

#[test]
fn pause_and_resume() {
    let mut bed = busy(6);
    for _ in 0..2 {
        bed.drive(1, false);
        let counted = bed.get(Reg::R1);
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::MV), bed.get(Reg::R1)), (0, counted));
        bed.drive(1, true);
        bed.wait(1.secs());
        assert_eq!(bed.get(Reg::MV), 0, "it is the edge that counts");
        bed.drive(1, false);
        bed.wait(1.secs());
        assert!(bed.get(Reg::V) == 50_000 && bed.get(Reg::R1) > counted);
        bed.drive(1, true);
        assert_eq!(bed.error(), 0);
    }
}

#[test]
fn reset() {
    let mut bed = busy(11);
    bed.set(Reg::RC, 70);
    bed.drive(1, false);
    assert_eq!([Reg::MV, Reg::BY, Reg::RC, Reg::C1, Reg::S1].map(|reg| bed.get(reg)), [0, 0, 25, 0, 0]);
    assert_eq!(bed.error(), 0);
}

#[test]
fn go() {
    let mut bed = Bed::plus();
    bed.drive(1, true);
    bed.set(Reg::S1, 4 << 32);
    bed.connect(CLIENT);
    bed.drive(1, false);
    assert_eq!(bed.error(), 42, "there is no program");
    bed.drive(1, true);
    bed.type_in(CLIENT, "PG 1\rIC R1\rE\rPG\r");
    bed.drive(1, false);
    bed.wait(1.millis());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::BY), bed.error()), (1, 0, 0));
}
