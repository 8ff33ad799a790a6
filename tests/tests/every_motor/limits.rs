//! The current limit, and the bits that show it.

use drivetwin_firmware::motor::Parameters;

use crate::rig::{Drive, Rig};

/// Bit 11 of ERROR: "consumption current limit is exceeded" (6.5).
const CURRENT_LIMIT: i64 = 1 << 11;

/// Section 6.5, 5009h: a start at the limit is not an error, however long it takes. CURRENT_VALID never shows
/// more than REF_CURRENT. 1 A of this motor gives 76.4 mN·m, so with 400 g·cm² to 0.1 kg·m² it reaches 1,000
/// rpm in up to 27 s.
#[test]
fn a_start_at_the_limit_is_no_error() {
    for (ref_current, inertia_gcm2) in [(1_000, 400), (5_000, 400), (5_000, 20_000), (5_000, 1_000_000)] {
        let mut rig = Rig::nominal(Drive::Rs434544, |motor| Parameters { inertia_gcm2, ..motor });
        rig.write("REF_CURRENT", ref_current);
        rig.rotate(1_000);
        let (mut most, mut limited) = (0, 0);
        for _ in 0..35_000 {
            rig.run(0.001);
            most = most.max(rig.read("CURRENT_VALID"));
            limited += i32::from((rig.amps() * 1e3) as i64 >= ref_current);
        }
        assert!(most > 0 && most <= ref_current, "{most} mA of {ref_current}");
        assert!(limited > 10, "the winding was at its limit for {limited} ms only");
        assert!((rig.rpm() - 1_000.0).abs() <= 10.0, "{} rpm", rig.rpm());
        assert_eq!(rig.read("ERROR"), 0, "{ref_current} mA, {inertia_gcm2} g·cm²");
    }
}

/// Bit 11 is set if the limit stops the motor: if the shaft is held, or if the load is too high at rest or
/// while turning. The limit that the user sets is the limit of the winding's current (section 2).
#[test]
fn a_motor_that_is_held_back_shows_bit_11() {
    for halls in [0, 1, 2] {
        for ref_current in [1_000, 5_000, 20_000] {
            let mut rig = Rig::nominal(Drive::Rs434544, |motor| motor);
            rig.write("USE_HALL", halls);
            rig.write("REF_CURRENT", ref_current);
            rig.hold(true);
            rig.rotate(2_900);
            rig.run(1.0);
            let amps = ref_current as f64 / 1e3;
            assert!((rig.amps() - amps).abs() < 0.002, "{} A of {amps} with {halls} sensors", rig.amps());
            assert_eq!(rig.read("ERROR"), CURRENT_LIMIT, "{amps} A with {halls} sensors");
            // 24 V and 0.5 Ω: the supply gives I²·R/U.
            let supplied = amps * amps * 0.5 / 24.0 * 1e3;
            assert!((rig.read("CURRENT_VALID") as f64 - supplied).abs() <= 2.0, "{supplied} mA");
            rig.hold(false);
            rig.run(2.0);
            rig.write("ERROR", 0);
            rig.run(1.0);
            assert_eq!(rig.read("ERROR"), 0, "it turns");
        }
    }
    // 400 mN·m need 5.2 A.
    for (ref_current, error) in [(5_000, CURRENT_LIMIT), (6_000, 0)] {
        let mut rig = Rig::nominal(Drive::Rs434544, |motor| Parameters { load_unm: 400_000, ..motor });
        rig.write("REF_CURRENT", ref_current);
        rig.rotate(1_000);
        rig.run(3.0);
        assert_eq!(rig.read("ERROR"), error, "{ref_current} mA");
        assert_eq!(rig.rpm() > 990.0, error == 0, "{} rpm", rig.rpm());
    }
}

/// p. 16: the motor can use the whole of MAX_LOAD; OVER_LOAD is reported at MAX_LOAD and not below.
#[test]
fn velocity_control_reaches_the_whole_of_max_load() {
    // With 0.06 N·m/A and 10 mN·m of friction, the loads need 19.92 A of 20 A, and 5.17 A and 5.25 A of 5.3
    // A.
    for (max_load, load_unm) in [(200, 1_185_000), (53, 300_000), (53, 305_000)] {
        let mut rig = Rig::nominal(Drive::Mdrobot, |motor| Parameters { load_unm, ..motor });
        rig.hold(true);
        rig.run(0.5);
        rig.write("MAX_LOAD", max_load);
        rig.rotate(100);
        rig.run(0.3);
        rig.hold(false);
        rig.run(15.0);
        assert!((rig.rpm() - 100.0).abs() <= 1.0, "{} rpm at {max_load}", rig.rpm());
        assert_eq!(rig.errors(), 0, "{load_unm} µN·m at {max_load}");
    }
}
