//! Tests of the register ERROR (6.5).

use super::*;

/// A fault, its bit, and true if it stops the motor.
const FAULTS: [(&str, u16, bool); 8] = [
    ("supply_voltage", 0, true),
    ("short_circuit", 1, true),
    ("brake_overheat", 2, true),
    ("power_overheat", 3, true),
    ("hall", 4, true),
    ("mcu_overheat", 6, true),
    ("switches", 10, true),
    ("current_limit", 11, false),
];

#[test]
fn faults_raise_their_bits() {
    for (name, bit, stops) in FAULTS {
        let mut dut = ready();
        dut.fault(name, true);
        assert_eq!(dut.get(Reg::ERROR), 1 << bit, "{name}");
        assert_eq!(dut.light(RED), stops, "{name}");
        dut.fault(name, false);
        dut.write(0x5023, 0);
        assert_eq!(dut.get(Reg::ERROR), if stops { 1 << bit } else { 0 }, "{name}");
        dut.write(0x5026, 0x95AF);
        dut.wait(1.secs());
        assert_eq!((dut.get(Reg::ERROR), dut.light(RED)), (0, false), "{name}");
    }
}

#[test]
fn a_cause_that_stays_comes_back() {
    let mut dut = ready();
    dut.fault("hall", true);
    dut.fault("current_limit", true);
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 1 << 4 | 1 << 11, "a warning comes back at once");
    dut.write(0x5026, 0x95AF);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::ERROR), 1 << 4 | 1 << 11);
}

#[test]
fn a_write_never_sets_a_bit() {
    let mut dut = ready();
    dut.write(0x5023, 0xFFFF);
    assert_eq!(dut.read(0x5023), 0);
}

#[test]
fn temperatures_raise_their_bits_at_their_limits() {
    for (reg, limit, bit) in [
        (Reg::TEMPERATURE_MCU, 850, 6),
        (Reg::TEMPERATURE_MOSFET, 1_000, 3),
        (Reg::TEMPERATURE_BRAKE, 1_000, 2),
    ] {
        let mut dut = ready();
        assert_eq!(dut.get(reg), 250);
        dut.set(reg, limit - 1);
        dut.wait(1.secs());
        assert_eq!((dut.get(reg), dut.get(Reg::ERROR)), (limit - 1, 0));
        dut.set(reg, limit);
        assert_eq!(dut.get(Reg::ERROR), 1 << bit);
        dut.set(reg, 250);
        dut.write(0x5023, 0);
        assert_eq!(dut.get(Reg::ERROR), 1 << bit, "it stays until a restart");
    }
}

#[test]
fn an_injected_current_stays_and_raises_what_it_would() {
    let mut dut = saved(&[(Reg::REF_CURRENT, 5_000)]);
    dut.set(Reg::CURRENT_VALID, 5_000);
    assert_eq!((dut.get(Reg::CURRENT_VALID), dut.get(Reg::ERROR)), (5_000, 0));
    dut.set(Reg::CURRENT_VALID, 5_001);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11);
    dut.set(Reg::CURRENT_VALID, 29_999);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11);
    dut.set(Reg::CURRENT_VALID, 30_000);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11 | 1 << 1);
    assert_eq!(dut.pdu(&[4, 0x30, 1, 0, 1]), [4, 2, 0x75, 0x30]);
}

#[test]
fn an_injected_current_is_looked_at_again() {
    let mut dut = ready();
    dut.set(Reg::CURRENT_VALID, 5_000);
    dut.write(0x5009, 5_000);
    assert_eq!(dut.get(Reg::ERROR), 0);
    dut.write(0x5009, 4_999);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11);
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11, "it is still there");
    dut.write(0x5009, 5_000);
    assert_eq!(dut.get(Reg::ERROR), 1 << 11, "it stays until it is cleared");
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 0);
}

#[test]
fn the_emergency_stop_is_latched_until_a_restart() {
    let mut dut = ready();
    dut.contact(HARD_STOP, false);
    assert_eq!((dut.get(Reg::ERROR), dut.light(RED)), (1 << 5, true));
    dut.contact(HARD_STOP, true);
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 1 << 5);
    dut.contact(HARD_STOP, false);
    dut.write(0x5026, 0x95AF);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::ERROR), 1 << 5, "it is open still");
    dut.contact(HARD_STOP, true);
    dut.write(0x5026, 0x95AF);
    dut.wait(1.secs());
    assert_eq!(dut.get(Reg::ERROR), 0);
}
