//! Section 6.5, ERROR: what sets each bit, whether the bit stops the motor, and what clears it.

use drivetwin_protocol::time::Span;
use drivetwin_tests::rs434::{Rig, at};

/// A drive whose motor turns.
fn turning() -> Rig {
    let mut rig = Rig::default();
    rig.write(at::START, 1);
    rig.after(1.secs());
    assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (1, 0));
    rig
}

/// RS434-23: bits 0 to 6 and 10 stop the motor and stay until a restart. A write does not clear them, and
/// START has no effect, even after the cause is gone.
#[test]
fn section_6_5_faults_that_stop() {
    for (fault, bit) in [
        ("supply_voltage", 0),
        ("short_circuit", 1),
        ("brake_overheat", 2),
        ("power_overheat", 3),
        ("hall", 4),
        ("mcu_overheat", 6),
        ("switches", 10),
    ] {
        let mut rig = turning();
        rig.fault(fault, true);
        assert_eq!(rig.read(at::ERROR), 1 << bit, "{fault}");
        rig.after(1.secs());
        assert_eq!((rig.read(at::STATUS), rig.motion().speed.to_num::<f64>()), (0, 0.0), "{fault}");
        rig.fault(fault, false);
        rig.write(at::ERROR, 0);
        rig.write(at::START, 1);
        rig.after(1.secs());
        assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (0, 1 << bit), "{fault}");
        rig.restart();
        assert_eq!(rig.read(at::ERROR), 0, "{fault}");
        // RS434-6: the START during the fault does not take effect later.
        assert_eq!(rig.read(at::STATUS), 0);
        rig.write(at::START, 1);
        rig.after(1.secs());
        assert_eq!(rig.read(at::STATUS), 1, "{fault}");
    }
}

/// "Power supply protection, VDC: 8 - 30" (section 3). A supply outside this range sets bit 0, which stops
/// the motor. The bit stays until a restart, even if the supply returns to the range.
#[test]
fn section_3_a_supply_out_of_its_range() {
    for (tenths, error) in
        [(0, 1), (50, 1), (79, 1), (80, 0), (120, 0), (240, 0), (300, 0), (301, 1), (480, 1)]
    {
        let mut rig = turning();
        rig.supply(tenths);
        rig.after(1.secs());
        let stands = (rig.read(at::STATUS), rig.motion().speed == 0);
        assert_eq!(
            (rig.read(at::ERROR), stands),
            (error, if error == 1 { (0, true) } else { (1, false) }),
            "{tenths}"
        );
        rig.supply(240);
        rig.write(at::ERROR, 0);
        assert_eq!(rig.read(at::ERROR), error, "{tenths}");
        rig.restart();
        assert_eq!(rig.read(at::ERROR), 0, "{tenths}");
        rig.write(at::START, 1);
        rig.after(1.secs());
        assert_eq!(rig.read(at::STATUS), 1, "{tenths}");
    }
}

/// A restart does not change the supply. After power-on the supply is 24 V unless it is preset.
#[test]
fn section_3_a_supply_that_stays_out_of_range() {
    let mut rig = turning();
    rig.supply(310);
    rig.restart();
    assert_eq!(rig.read(at::ERROR), 1);
    rig.write(at::START, 1);
    rig.after(1.secs());
    assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (0, 1));
    rig.power_cycle();
    assert_eq!(rig.read(at::ERROR), 0);
}

/// A restart while the cause of a fault persists.
#[test]
fn section_6_5_a_fault_that_stays() {
    let mut rig = turning();
    rig.fault("supply_voltage", true);
    rig.restart();
    rig.after(10.millis());
    assert_eq!(rig.read(at::ERROR), 1);
    rig.write(at::START, 1);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 0);
}

/// A fault while the motor is at rest sets its bit, too.
#[test]
fn section_6_5_a_fault_at_rest() {
    let mut rig = Rig::default();
    rig.fault("short_circuit", true);
    assert_eq!(rig.read(at::ERROR), 2);
}

/// Bit 11, RS434-24: the current is limited, but the motor does not stop. A write clears the bit.
#[test]
fn section_6_5_current_limit() {
    let mut rig = turning();
    rig.fault("current_limit", true);
    assert_eq!(rig.read(at::ERROR), 1 << 11);
    rig.after(1.secs());
    assert_eq!(rig.read(at::STATUS), 1);
    rig.fault("current_limit", false);
    rig.write(at::ERROR, 0);
    assert_eq!((rig.read(at::ERROR), rig.read(at::STATUS)), (0, 1));
}

/// RS434-24: while the fault persists, the limit is half of REF_CURRENT. A blocked shaft draws the whole
/// limit.
#[test]
fn section_6_5_current_limit_halves_the_limit() {
    let mut rig = Rig::default();
    rig.write(at::REF_CURRENT, 4_000);
    rig.fault("stall", true);
    rig.write(at::START, 1);
    for (fault, limit) in [(false, 4_000), (true, 2_000), (false, 4_000)] {
        rig.fault("current_limit", fault);
        rig.after(100.millis());
        let ma = rig.motion().current_ma;
        assert!((limit * 3 / 4..=limit * 21 / 20).contains(&ma), "{ma} mA, and {limit} at most");
        assert_eq!(rig.read(at::ERROR), 1 << 11);
    }
}

/// Temperatures are in 0.1 °C. The limits are 85 °C for the processor, and 100 °C for switches and brake
/// (RS434-24).
#[test]
fn section_6_3_temperatures() {
    for (name, address, limit, bit) in [
        ("TEMPERATURE_MCU", at::TEMPERATURE_MCU, 850, 6),
        ("TEMPERATURE_MOSFET", at::TEMPERATURE_MOSFET, 1_000, 3),
        ("TEMPERATURE_BRAKE", at::TEMPERATURE_BRAKE, 1_000, 2),
    ] {
        let mut rig = turning();
        let row = rig.bench.spec(rig.seat).find(name).expect("a register").row;
        let heat = |rig: &mut Rig, to| {
            rig.bench.poke(rig.seat, row, to).expect("a temperature can be injected");
            rig.after(10.millis());
            assert_eq!(i64::from(rig.read(address)), to, "{name}");
        };
        heat(&mut rig, limit - 1);
        assert_eq!((rig.read(at::ERROR), rig.read(at::STATUS)), (0, 1), "{name}");
        heat(&mut rig, limit);
        rig.after(1.secs());
        assert_eq!((rig.read(at::ERROR), rig.read(at::STATUS)), (1 << bit, 0), "{name}");
        heat(&mut rig, 250);
        assert_eq!(rig.read(at::ERROR), 1 << bit, "{name}");
    }
}

/// A test can inject CURRENT_VALID, too.
#[test]
fn section_6_3_an_injected_current() {
    let mut rig = turning();
    let row = rig.bench.spec(rig.seat).find("CURRENT_VALID").expect("a register").row;
    rig.bench.poke(rig.seat, row, 1_234).expect("a current can be injected");
    rig.after(1.secs());
    assert_eq!((rig.read(at::CURRENT_VALID), rig.read(at::ERROR)), (1_234, 0));
    // REF_CURRENT is 20 A.
    rig.bench.poke(rig.seat, row, 20_001).expect("a current can be injected");
    rig.after(10.millis());
    assert_eq!(rig.read(at::ERROR), 1 << 11);
    assert_eq!(rig.read(at::STATUS), 1);
}

/// RS434-23: a write of ERROR clears the bits where it has a 0. It never sets a bit and is never refused.
#[test]
fn section_6_5_writes_of_error() {
    let mut rig = Rig::default();
    for value in [0xFFFF, 0x0001, 0] {
        rig.write(at::ERROR, value);
        assert_eq!(rig.read(at::ERROR), 0);
    }
    rig.write(at::USE_HALL, 1);
    rig.write(at::MODE_ROTATION, 2);
    rig.write_long(at::OFFSET, 5);
    rig.write(at::START, 1);
    assert_eq!(rig.try_write(at::SPEED, 1), Err(3));
    assert_eq!(rig.read(at::ERROR), 1 << 15 | 1 << 13);
    rig.write(at::ERROR, !(1 << 13));
    assert_eq!(rig.read(at::ERROR), 1 << 15);
    rig.write(at::ERROR, 0xFFFF);
    assert_eq!(rig.read(at::ERROR), 1 << 15);
    rig.write(at::ERROR, 0);
    assert_eq!(rig.read(at::ERROR), 0);
}

/// A restart clears warnings, too.
#[test]
fn section_6_5_warnings_and_a_restart() {
    let mut rig = Rig::default();
    assert_eq!(rig.try_write(at::SPEED, 1), Err(3));
    assert_eq!(rig.read(at::ERROR), 1 << 13);
    rig.restart();
    assert_eq!(rig.read(at::ERROR), 0);
}
