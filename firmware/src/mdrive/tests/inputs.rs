//! Inputs that act on the whole drive (MC 5-63).

use super::*;

/// Runs a program that counts R1 up while the motor turns at 50,000 steps/s. Input 1 has this type and is
/// active low.
fn busy(kind: i64) -> Dut {
    let mut dut = Dut::plus();
    dut.drive(1, true);
    dut.set(Reg::S1, kind << 32);
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "PG 1\rLB G1\rIC R1\rBR G1\rE\rPG\rSL 50000\rEX G1\r");
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::V), dut.get(Reg::BY), dut.error()), (50_000, 1, 0));
    dut
}

#[test]
fn soft_stop() {
    let mut dut = busy(5);
    dut.drive(1, false);
    assert_eq!((dut.get(Reg::BY), dut.get(Reg::VC)), (0, 1));
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::MV), dut.error()), (0, 91));
    dut.drive(1, true);
    // While the motor is at rest, the input ends a program, too.
    dut.type_in(CLIENT, "EX G1\r");
    dut.drive(1, false);
    assert_eq!((dut.get(Reg::BY), dut.error()), (0, 48));
    dut.drive(1, true);
    dut.drive(1, false);
    assert_eq!(dut.error(), 0, "there was nothing to stop");
}

#[test]
fn soft_stop_of_a_program_that_pauses() {
    let mut dut = busy(5);
    dut.type_in(CLIENT, "PS\r");
    dut.wait(1.secs());
    dut.drive(1, false);
    assert_eq!(dut.error(), 0);
    dut.type_in(CLIENT, "RS\r");
    dut.wait(1.secs());
    assert_eq!((dut.get(Reg::V), dut.get(Reg::BY)), (50_000, 1));
}

#[test]
fn pause_and_resume() {
    let mut dut = busy(6);
    for _ in 0..2 {
        dut.drive(1, false);
        let counted = dut.get(Reg::R1);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::MV), dut.get(Reg::R1)), (0, counted));
        dut.drive(1, true);
        dut.wait(1.secs());
        assert_eq!(dut.get(Reg::MV), 0, "it is the edge that counts");
        dut.drive(1, false);
        dut.wait(1.secs());
        assert!(dut.get(Reg::V) == 50_000 && dut.get(Reg::R1) > counted);
        dut.drive(1, true);
        assert_eq!(dut.error(), 0);
    }
}

#[test]
fn reset() {
    let mut dut = busy(11);
    dut.set(Reg::RC, 70);
    dut.drive(1, false);
    assert_eq!([Reg::MV, Reg::BY, Reg::RC, Reg::C1, Reg::S1].map(|reg| dut.get(reg)), [0, 0, 25, 0, 0]);
    assert_eq!(dut.error(), 0);
}

#[test]
fn go() {
    let mut dut = Dut::plus();
    dut.drive(1, true);
    dut.set(Reg::S1, 4 << 32);
    dut.connect(CLIENT);
    dut.drive(1, false);
    assert_eq!(dut.error(), 42, "there is no program");
    dut.drive(1, true);
    dut.type_in(CLIENT, "PG 1\rIC R1\rE\rPG\r");
    dut.drive(1, false);
    dut.wait(1.millis());
    assert_eq!((dut.get(Reg::R1), dut.get(Reg::BY), dut.error()), (1, 0, 0));
}
