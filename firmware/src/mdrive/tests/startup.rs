//! Power-on, Ctrl-C and the reset input.

use std::borrow::ToOwned;

use super::*;

const SIGN_ON: &str = "Copyright 2001-2010 by Schneider Electric Motion USA.\r\n";

#[test]
fn connections_are_accepted_once_it_has_booted() {
    for drive in [Mdrive::plus(), Mdrive::hybrid()] {
        let mut dut = Dut::off(drive, vec![0xFF; MEMORY]);
        let accepts = |dut: &Dut| [MODBUS, MCODE].map(|port| dut.drive.accepts(port));
        assert_eq!(accepts(&dut), [false; 2]);
        dut.power_on(false);
        dut.wait(300.millis() - Duration::TICK);
        assert_eq!(accepts(&dut), [false; 2]);
        dut.wait(Duration::TICK);
        assert_eq!(accepts(&dut), [true; 2]);
        dut.connect(CLIENT);
        assert_eq!(dut.read(9, 1), 1);
        assert_eq!(dut.type_in(CLIENT, "PR CE\r"), "PR CE\r\n1\r\n>");
        // The Ethernet controller continues to work while the drive restarts.
        dut.type_in(CLIENT, "\x03");
        assert_eq!(accepts(&dut), [true; 2]);
    }
}

/// A connection that is opened before the drive has started is not lost. On a board the network may open one
/// earlier than a bench does.
#[test]
fn until_it_hears_the_bus_says_04() {
    let mut dut = Dut::off(Mdrive::plus(), vec![0xFF; MEMORY]);
    dut.power_on(false);
    dut.connect(CLIENT);
    dut.wait(299.millis());
    assert_eq!(dut.ask(&[3, 0, 9, 0, 1]), [0x83, 4]);
    assert_eq!(dut.out.noted(), [LogEvent::Refused { port: MODBUS, function: 3, code: 4 }]);
    assert_eq!(dut.type_in(CLIENT, "PR P\r"), "");
    let before = dut.out.messages.len();
    dut.wait(1.millis());
    assert_eq!(dut.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
    assert_eq!(dut.read(9, 1), 1);
}

#[test]
fn everything_begins_anew() {
    let mut dut = Dut::plus();
    dut.set(Reg::RC, 70);
    dut.set(Reg::C1, 5);
    dut.try_write(0x67, 1, 0);
    dut.cycle();
    assert_eq!((dut.get(Reg::RC), dut.get(Reg::C1), dut.error()), (25, 0, 0));
}

#[test]
fn without_a_delay_it_hears_at_once() {
    for mut dut in [Dut::plus(), Dut::hybrid()] {
        assert_eq!(dut.now, Instant::ZERO);
        assert_eq!(dut.read(9, 1), 1);
        dut.connect(CLIENT);
        assert_eq!(dut.type_in(CLIENT, "PR CE\r"), "PR CE\r\n1\r\n>");
    }
}

#[test]
fn ctrl_c_starts_anew_and_leaves_connections_open() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.connect(Link(1));
    dut.type_in(CLIENT, "PG 1\rLB SU\rIC R1\rE\rPG\rP=7\rVM=70000\rS\rVM=80000\rRC=0\r");
    dut.write(0x78, 2, 50_000);
    dut.wait(100.millis());
    let before = dut.out.messages.len();
    // Ctrl-C works from any connection. A line that is being typed is dropped.
    dut.type_in(Link(1), "RC=9\x03");
    for link in [CLIENT, Link(1)] {
        let said = dut.mcode_said(before, link);
        assert!(said.ends_with(&(SIGN_ON.to_owned() + ">")), "{said:?}");
    }
    assert_eq!([Reg::VM, Reg::RC, Reg::C1, Reg::MV, Reg::ER].map(|reg| dut.get(reg)), [70_000, 25, 0, 0, 0]);
    dut.wait(1.millis());
    assert_eq!(dut.get(Reg::R1), 1, "SU has run");
    assert_eq!(dut.type_in(CLIENT, "PR R1\r"), "PR R1\r\n1\r\n>");
    dut.cycle();
    dut.wait(1.millis());
    assert_eq!(dut.type_in(CLIENT, "PR R1\r"), "", "a power cycle closes connections");
    assert_eq!(dut.get(Reg::R1), 1);
}

#[test]
fn ctrl_c_takes_as_long_as_power_on() {
    let mut dut = Dut::off(Mdrive::plus(), vec![0xFF; MEMORY]);
    dut.power_on(false);
    dut.wait(1.secs());
    dut.connect(CLIENT);
    assert_eq!(dut.type_in(CLIENT, "\x03PR P\r"), "", "what comes behind it is lost");
    dut.wait(299.millis());
    assert_eq!(dut.ask(&[3, 0, 9, 0, 1]), [0x83, 4]);
    let before = dut.out.messages.len();
    dut.wait(1.millis());
    assert_eq!(dut.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
}

#[test]
fn ctrl_c_that_is_off() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.write(0x67, 1, 70);
    dut.write(0x09, 1, 0);
    dut.type_in(CLIENT, "\x03");
    assert_eq!(dut.get(Reg::RC), 70);
}

#[test]
fn ctrl_c_in_the_middle_of_a_save_comes_behind_it() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "RC=70\rS\r");
    dut.type_in(CLIENT, "\x03");
    assert_eq!((dut.get(Reg::RC), dut.error()), (70, 0));
}

#[test]
fn a_hybrid_signs_on_once_it_is_calibrated() {
    let mut dut = Dut::off(Mdrive::hybrid(), vec![0xFF; MEMORY]);
    // MC 5-9: with CT = 250 a calibration takes 3.12 s.
    dut.set(Reg::CT, 250);
    dut.power_on(false);
    dut.connect(CLIENT);
    dut.wait(301.millis());
    assert_eq!(dut.read(0x8F, 1) & 128, 0, "AF: not calibrated, but the bus hears");
    let before = dut.out.messages.len();
    dut.refused(&[16, 0, 0x43, 0, 2, 4, 0, 0, 0, 1], 4, 88);
    dut.refused(&[16, 0, 0x8E, 0, 1, 2, 0, 1], 4, 87);
    dut.run_until(Instant::ZERO + 3_419.millis());
    assert_eq!(dut.mcode_said(before, CLIENT), "");
    dut.run_until(Instant::ZERO + 3_421.millis());
    assert_eq!(dut.mcode_said(before, CLIENT), SIGN_ON.to_owned() + ">");
    assert_eq!(dut.read(0x8F, 1) & 128, 128);
}
