//! Hall sensors that are broken, or that are switched on or off while the motor turns.

use drivetwin_firmware::motor::Parameters;

use crate::rig::{Drive, Rig};

/// Bit 4 of ERROR: "Hall sensors connecting error" (6.5).
const HALL: i64 = 1 << 4;

/// The drive notices one broken wire of two, at the start or while turning, and stops the motor. With one
/// sensor in use it notices only a break of that sensor's wire, HA.
#[test]
fn a_broken_hall_wire_is_noticed() {
    for pin in ["HA", "HB", "HA and HB"] {
        for halls in [1, 2] {
            for turns in [false, true] {
                for rpm in [30, 1_000] {
                    let mut rig = Rig::nominal(Drive::Rs434544, |motor| motor);
                    rig.write("USE_HALL", halls);
                    if turns {
                        rig.rotate(rpm);
                        rig.run(2.0);
                        assert_eq!(rig.read("ERROR"), 0);
                    }
                    for pin in pin.split(" and ") {
                        rig.ground(pin, true);
                    }
                    rig.rotate(rpm);
                    rig.run(3.0);
                    let noticed = halls == 2 || pin != "HB";
                    let what = format!("{pin} with {halls} sensors at {rpm} rpm, turning before: {turns}");
                    assert_eq!(rig.read("ERROR"), if noticed { HALL } else { 0 }, "{what}");
                    assert_eq!(rig.read("STATUS"), i64::from(!noticed), "{what}");
                }
            }
        }
    }
}

/// The drive also notices a wire that broke before its sensor came into use, or before the number of pulses
/// changed.
#[test]
fn a_wire_that_broke_before_its_sensor_is_used_is_noticed() {
    for (register, before, then) in [("USE_HALL", 0, 2), ("USE_HALL", 1, 2), ("PULSES_PER_REVOLUTION", 4, 8)]
    {
        let mut rig = Rig::nominal(Drive::Rs434544, |motor| motor);
        rig.write(register, before);
        rig.rotate(1_000);
        rig.run(1.0);
        rig.ground("HB", true);
        rig.write(register, then);
        rig.run(2.0);
        assert_eq!((rig.read("ERROR"), rig.read("STATUS")), (HALL, 0), "{register} {before} to {then}");
    }
}

/// A motor that reverses repeatedly does not look like a broken wire.
#[test]
fn reversals_are_no_broken_wire() {
    for ms in [3.0, 7.0, 20.0] {
        let mut rig = Rig::nominal(Drive::Rs434544, |motor| motor);
        rig.rotate(100);
        for n in 0..200 {
            rig.write("DIRECTION", 1 + n % 2);
            rig.run(ms / 1e3);
        }
        assert_eq!(rig.read("ERROR"), 0, "every {ms} ms");
    }
}

/// USE_HALL may be written while the motor turns: the motor continues, and the speed does not oscillate
/// (5010h, 6.5).
#[test]
fn sensors_may_be_used_or_not_on_the_way() {
    for no_load_rpm in [2_000, 3_000, 6_000] {
        let mut rig = Rig::nominal(Drive::Rs434544, |motor| Parameters { no_load_rpm, ..motor });
        rig.write("USE_HALL", 0);
        rig.rotate(1_000);
        rig.write("DEC", 10);
        rig.run(1.0);
        // In open loop the duty is a third of the supply, because RATED_SPEED is 3,000.
        let open = f64::from(no_load_rpm) / 3.0;
        assert!((rig.rpm() / open - 1.0).abs() < 0.03, "{} rpm for {open}", rig.rpm());
        for halls in [2, 1, 2, 0, 1] {
            rig.write("USE_HALL", halls);
            let rpm = if halls == 0 { open } else { 1_000.0 };
            let (slow, fast) = (open.min(1_000.0) * 0.97, open.max(1_000.0) * 1.03);
            for ms in 0..1_500 {
                rig.run(0.001);
                // The speed changes from one value to the other without overshoot: DEC 10 is 100 rps².
                assert!(
                    (slow..fast).contains(&rig.rpm()),
                    "{} rpm after {ms} ms of {halls} sensors",
                    rig.rpm()
                );
                if ms > 1_000 {
                    assert!(rig.amps() < 0.3, "{} A with {halls} sensors", rig.amps());
                    assert!((rig.rpm() / rpm - 1.0).abs() < 0.03, "{} rpm with {halls} sensors", rig.rpm());
                }
            }
            assert_eq!(rig.read("ERROR"), 0, "{halls} sensors");
        }
    }
}

/// SPEED_VALID and RPM_DATA are 0 after the shaft has coasted to rest.
#[test]
fn a_shaft_that_has_coasted_to_rest_shows_no_speed() {
    for (drive, register, stop) in
        [(Drive::Rs434544, "SPEED_VALID", ("HARD_STOP_bit", 1)), (Drive::Mdrobot, "RPM_DATA", ("TQ_OFF", 1))]
    {
        for friction_unm in [2_000, 10_000, 100_000] {
            let mut rig = Rig::nominal(drive, |motor| Parameters { friction_unm, ..motor });
            rig.rotate(500);
            rig.run(1.0);
            assert!((495..=505).contains(&rig.read(register)), "{}", rig.read(register));
            rig.write(stop.0, stop.1);
            rig.run(20.0);
            assert_eq!((rig.rpm(), rig.read(register)), (0.0, 0), "{drive:?}");
        }
    }
    // A load turns the shaft of a drive at rest, then the shaft is held. The drive learns this only from the
    // edges.
    let mut rig = Rig::nominal(Drive::Rs434544, |motor| Parameters { load_unm: -12_000, ..motor });
    rig.run(0.2);
    assert!(rig.rpm() > 0.0);
    rig.hold(true);
    assert!(rig.read("SPEED_VALID") > 0);
    rig.run(1.1);
    assert_eq!(rig.read("SPEED_VALID"), 0);
}

/// STOP ends at rest, with any motor and friction. A friction of 3 mN·m or less is too low to hold the shaft
/// at the least duty.
#[test]
fn a_stop_ends() {
    for friction_unm in [0, 500, 1_000, 3_000, 10_000] {
        for (no_load_rpm, resistance_mohm) in
            [(3_000, 500), (3_000, 1_000), (12_000, 250), (12_000, 100), (700, 2_000)]
        {
            for inertia_gcm2 in [100, 400, 50_000] {
                let mut rig = Rig::nominal(Drive::Rs434544, |motor| Parameters {
                    no_load_rpm,
                    resistance_mohm,
                    inertia_gcm2,
                    friction_unm,
                    ..motor
                });
                rig.rotate(100);
                rig.run(2.0);
                rig.write("STOP_bit", 1);
                rig.run(10.0);
                let what = format!(
                    "{friction_unm} µN·m, {no_load_rpm} rpm, {resistance_mohm} mΩ, {inertia_gcm2} g·cm²"
                );
                assert_eq!((rig.read("STATUS"), rig.read("ERROR")), (0, 0), "{what}");
                assert!(rig.rpm().abs() < 0.01, "{} rpm, {what}", rig.rpm());
            }
        }
    }
}

/// After a power failure the drive shows the present current of its motor, not the one before.
#[test]
fn a_power_failure_leaves_no_current() {
    let mut rig = Rig::nominal(Drive::Mdrobot, |motor| Parameters { inertia_gcm2: 20_000, ..motor });
    rig.rotate(1_000);
    rig.run(3.0);
    rig.rotate(-1_000);
    rig.run(0.02);
    assert!(rig.read("TQ_DATA") < -100, "{}", rig.read("TQ_DATA"));
    rig.cycle(60.0);
    rig.run(1.0);
    assert_eq!((rig.rpm(), rig.read("TQ_DATA")), (0.0, 0));
}

/// After a power failure while the shaft turns, the drive finds the shaft where it has coasted to, and its
/// moves end on their counts.
#[test]
fn a_drive_finds_its_motor_after_a_power_failure() {
    for drive in [Drive::Rs434544, Drive::Mdrobot] {
        let mut rig = Rig::nominal(drive, |motor| Parameters { inertia_gcm2: 20_000, ..motor });
        rig.rotate(1_000);
        rig.run(2.0);
        rig.cycle(0.5);
        rig.run(30.0);
        assert_eq!(rig.rpm(), 0.0);
        if drive == Drive::Mdrobot {
            rig.write("UI_COM", 1);
        }
        let (begin, counts) = (rig.revolutions_in_counts(), 37);
        let position = rig.position();
        rig.go(counts, 600);
        rig.run(6.0);
        assert_eq!((rig.position(), rig.errors()), (position + counts, 0), "{drive:?}");
        assert!((rig.revolutions_in_counts() - begin - counts).abs() <= 1, "{drive:?}");
    }
}

/// The drive's own motor has wires, too: a Hall pin that is pulled to ground from outside acts as a broken
/// wire.
#[test]
fn wires_of_the_own_motor_can_be_pulled_to_ground() {
    for pin in ["HA", "HB"] {
        let mut rig = Rig::own(Drive::Rs434544);
        rig.rotate(1_000);
        rig.run(1.0);
        assert_eq!((rig.read("ERROR"), rig.read("STATUS")), (0, 1));
        rig.ground(pin, true);
        rig.run(1.0);
        assert_eq!((rig.read("ERROR"), rig.read("STATUS")), (HALL, 0), "{pin}");
    }
    // With one of three pins at ground the drive sees a state that three working sensors cannot have (p. 9).
    for pin in ["HU", "HV", "HW"] {
        let mut rig = Rig::own(Drive::Mdrobot);
        rig.rotate(300);
        rig.run(1.0);
        assert_eq!(rig.errors(), 0);
        rig.ground(pin, true);
        rig.run(1.0);
        assert_eq!(rig.errors(), 1 << 5 | 1, "{pin}");
    }
}
