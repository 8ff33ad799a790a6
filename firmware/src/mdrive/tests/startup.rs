//! Power-on, Ctrl-C and the reset input.

use std::borrow::ToOwned;

use super::*;

const SIGN_ON: &str = "Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

#[test]
fn connections_are_accepted_once_it_has_booted() {
    for drive in [Mdrive::plus(), Mdrive::hybrid()] {
        let mut bed = Bed::off(drive, vec![0xFF; MEMORY]);
        let accepts = |bed: &Bed| [MODBUS, MCODE].map(|port| bed.drive.accepts(port));
        assert_eq!(accepts(&bed), [false; 2]);
        bed.power_on(false);
        bed.wait(300.millis() - Duration::TICK);
        assert_eq!(accepts(&bed), [false; 2]);
        bed.wait(Duration::TICK);
        assert_eq!(accepts(&bed), [true; 2]);
        bed.connect(CLIENT);
        assert_eq!(bed.read(9, 1), 1);
        assert_eq!(bed.type_in(CLIENT, "PR CE\r"), "PR CE\r\n1\r\n>");
        // The Ethernet controller goes on while the drive starts again.
        bed.type_in(CLIENT, "\x03");
        assert_eq!(accepts(&bed), [true; 2]);
    }
}

/// Somebody told too early is not forgotten: a board's network may have more to tell than a bench.
#[test]
fn until_it_hears_the_bus_says_04() {
    let mut bed = Bed::off(Mdrive::plus(), vec![0xFF; MEMORY]);
    bed.power_on(false);
    bed.connect(CLIENT);
    bed.wait(299.millis());
    assert_eq!(bed.ask(&[3, 0, 9, 0, 1]), [0x83, 4]);
    assert_eq!(bed.world.notes, [Note::Refused { port: MODBUS, function: 3, code: 4 }]);
    assert_eq!(bed.type_in(CLIENT, "PR P\r"), "");
    let before = bed.world.said.len();
    bed.wait(1.millis());
    assert_eq!(bed.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
    assert_eq!(bed.read(9, 1), 1);
}

#[test]
fn everything_begins_anew() {
    let mut bed = Bed::plus();
    bed.set(Reg::RC, 70);
    bed.set(Reg::C1, 5);
    bed.try_write(0x67, 1, 0);
    bed.cycle();
    assert_eq!((bed.get(Reg::RC), bed.get(Reg::C1), bed.error()), (25, 0, 0));
}

#[test]
fn without_a_delay_it_hears_at_once() {
    for mut bed in [Bed::plus(), Bed::hybrid()] {
        assert_eq!(bed.now, Instant::ZERO);
        assert_eq!(bed.read(9, 1), 1);
        bed.connect(CLIENT);
        assert_eq!(bed.type_in(CLIENT, "PR CE\r"), "PR CE\r\n1\r\n>");
    }
}

#[test]
fn ctrl_c_starts_anew_and_leaves_connections_open() {
    let mut bed = Bed::plus();
    bed.connect(CLIENT);
    bed.connect(Link(1));
    bed.type_in(CLIENT, "PG 1\rLB SU\rIC R1\rE\rPG\rP=7\rVM=70000\rS\rVM=80000\rRC=0\r");
    bed.write(0x78, 2, 50_000);
    bed.wait(100.millis());
    let before = bed.world.said.len();
    // Whoever types it; half a line is forgotten.
    bed.type_in(Link(1), "RC=9\x03");
    for link in [CLIENT, Link(1)] {
        let said = bed.mcode_said(before, link);
        assert!(said.ends_with(&(SIGN_ON.to_owned() + ">")), "{said:?}");
    }
    assert_eq!([Reg::VM, Reg::RC, Reg::C1, Reg::MV, Reg::ER].map(|reg| bed.get(reg)), [70_000, 25, 0, 0, 0]);
    bed.wait(1.millis());
    assert_eq!(bed.get(Reg::R1), 1, "SU has run");
    assert_eq!(bed.type_in(CLIENT, "PR R1\r"), "PR R1\r\n1\r\n>");
    bed.cycle();
    bed.wait(1.millis());
    assert_eq!(bed.type_in(CLIENT, "PR R1\r"), "", "a power cycle closes connections");
    assert_eq!(bed.get(Reg::R1), 1);
}

#[test]
fn ctrl_c_takes_as_long_as_power_on() {
    let mut bed = Bed::off(Mdrive::plus(), vec![0xFF; MEMORY]);
    bed.power_on(false);
    bed.wait(1.secs());
    bed.connect(CLIENT);
    assert_eq!(bed.type_in(CLIENT, "\x03PR P\r"), "", "what comes behind it is lost");
    bed.wait(299.millis());
    assert_eq!(bed.ask(&[3, 0, 9, 0, 1]), [0x83, 4]);
    let before = bed.world.said.len();
    bed.wait(1.millis());
    assert_eq!(bed.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
}

#[test]
fn ctrl_c_that_is_off() {
    let mut bed = Bed::plus();
    bed.connect(CLIENT);
    bed.write(0x67, 1, 70);
    bed.write(0x09, 1, 0);
    bed.type_in(CLIENT, "\x03");
    assert_eq!(bed.get(Reg::RC), 70);
}

#[test]
fn ctrl_c_in_the_middle_of_a_save_comes_behind_it() {
    let mut bed = Bed::plus();
    bed.connect(CLIENT);
    bed.type_in(CLIENT, "RC=70\rS\r");
    bed.type_in(CLIENT, "\x03");
    assert_eq!((bed.get(Reg::RC), bed.error()), (70, 0));
}

#[test]
fn a_hybrid_signs_on_once_it_is_calibrated() {
    let mut bed = Bed::off(Mdrive::hybrid(), vec![0xFF; MEMORY]);
    // MC 5-9: 3.12 s.
    bed.set(Reg::CT, 250);
    bed.power_on(false);
    bed.connect(CLIENT);
    bed.wait(301.millis());
    assert_eq!(bed.read(0x8F, 1) & 128, 0, "AF: not calibrated, but the bus hears");
    let before = bed.world.said.len();
    bed.refused(&[16, 0, 0x43, 0, 2, 4, 0, 0, 0, 1], 4, 88);
    bed.refused(&[16, 0, 0x8E, 0, 1, 2, 0, 1], 4, 87);
    bed.run_until(Instant::ZERO + 3_419.millis());
    assert_eq!(bed.mcode_said(before, CLIENT), "");
    bed.run_until(Instant::ZERO + 3_421.millis());
    assert_eq!(bed.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
    assert_eq!(bed.read(0x8F, 1) & 128, 128);
}
