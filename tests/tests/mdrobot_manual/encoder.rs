//! ENC_PPR (p. 14; MDROBOT-27, MDROBOT-29): "The controller uses encoder signals as a speed sensor."

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Motor;

use crate::pid;
use crate::rig::Rig;

/// A motor on the bench, with an encoder of `cycles` per turn.
fn with_encoder(cycles: u32, ppr: u16) -> (Rig, Motor) {
    let (mut rig, motor) = Rig::turning(&[(pid::ENC_PPR, ppr)], |_| ());
    let [a, b] = ["ENC_A", "ENC_B"].map(|name| Some((rig.seat, rig.pin(name))));
    rig.bench.encode(motor, cycles, [a, b, None]);
    rig.after(1.millis());
    (rig, motor)
}

/// With the right ENC_PPR the speed is right. Positions still count edges of the Hall sensors.
#[test]
fn page_14_enc_ppr() {
    for cycles in [100_u16, 500, 2_500] {
        for rpm in [1_000, -300, 60] {
            let (mut rig, motor) = with_encoder(cycles.into(), cycles);
            rig.velocity(rpm);
            rig.assert_turns(f64::from(rpm));
            let (counts, turns) = (rig.position(), rig.bench.turn(motor).revolutions);
            rig.watch(3.secs(), 9.millis(), |rig, _| {
                let within = (f64::from(rpm).abs() / 100.0).max(2.0);
                assert!((rig.rpm() - f64::from(rpm)).abs() <= within, "{} rpm, not {rpm}", rig.rpm());
            });
            let turned = rig.bench.turn(motor).revolutions - turns;
            // 333 samples of 9 ms.
            let expected = f64::from(rpm) / 60.0 * 2.997;
            assert!(
                (turned - expected).abs() <= expected.abs() * 0.02 + 0.1,
                "{turned} turns, not {expected}"
            );
            let counted = f64::from(rig.position() - counts);
            assert!((counted - turned * 12.0).abs() <= 2.0, "{counted} counts in {turned} turns");
            assert_eq!(rig.status(), (0, 0));
        }
    }
}

/// If ENC_PPR is too large by a factor, the motor turns faster by that factor. RPM_DATA does not show the
/// error (MDROBOT-29).
#[test]
fn page_14_a_wrong_enc_ppr() {
    for (ppr, shaft) in [(1_000, 1_000.0), (250, 250.0), (1_500, 1_500.0)] {
        let (mut rig, motor) = with_encoder(500, ppr);
        rig.velocity(500);
        rig.after(3.secs());
        assert!((rig.rpm() - 500.0).abs() <= 5.0, "{}", rig.rpm());
        let turns = rig.bench.turn(motor).revolutions;
        rig.after(6.secs());
        let rpm = (rig.bench.turn(motor).revolutions - turns) * 10.0;
        assert!((rpm - shaft).abs() <= shaft * 0.02, "ENC_PPR {ppr}: {rpm} rpm, not {shaft}");
        assert_eq!(rig.status(), (0, 0));
    }
}

/// With an encoder, positions still count edges of the Hall sensors (MDROBOT-27).
#[test]
fn page_14_positions_with_an_encoder() {
    let (mut rig, motor) = with_encoder(500, 500);
    rig.write_move(pid::POSI_VEL_CMD, 600, 600);
    rig.after(8.secs());
    assert!(rig.position().abs_diff(600) <= 1, "{}", rig.position());
    let turns = rig.bench.turn(motor).revolutions;
    assert!((turns - 50.0).abs() <= 2.0 / 12.0, "{turns} turns are not 600 counts");
}

/// CMD 26 returns to the speed of the Hall sensors.
#[test]
fn page_6_enc_off() {
    let (mut rig, _) = with_encoder(500, 1_000);
    rig.velocity(500);
    rig.after(3.secs());
    assert!((rig.shaft() - 1_000.0).abs() <= 30.0);
    rig.command(26);
    rig.assert_turns(500.0);
}

/// ENC_PPR without an encoder: HALL_FAIL and status2 bit 1 after 0.6 s of turning (MDROBOT-31), but not at
/// rest.
#[test]
fn page_14_no_encoder() {
    let mut rig = Rig::armed(&[(pid::ENC_PPR, 1_000)]);
    rig.after(5.secs());
    assert_eq!(rig.status(), (0, 0), "it is at rest");
    rig.velocity(500);
    rig.after(550.millis());
    assert_eq!(rig.status(), (0, 0));
    rig.after(250.millis());
    assert_eq!(rig.status(), (1 | 1 << 5, 1 << 1));
    assert_eq!((rig.level("ALARM"), rig.motion().current_ma), (Level::Low, 0));
    rig.after(20.secs());
    // ENC_PPR 0 removes the cause.
    rig.write(pid::ENC_PPR, 0);
    rig.write(pid::ALARM_RESET, 0);
    rig.after(10.millis());
    assert_eq!(rig.status(), (0, 0));
    rig.velocity(500);
    rig.assert_turns(500.0);
    assert_eq!(rig.status(), (0, 0));
}

/// The wires of the encoder break while the motor turns.
#[test]
fn page_9_encoder_fail() {
    let (mut rig, _) = with_encoder(500, 500);
    rig.velocity(500);
    rig.assert_turns(500.0);
    rig.fault("encoder_fail", true);
    rig.after(1.secs());
    assert_eq!(rig.status(), (1 | 1 << 5, 1 << 1));
    rig.after(20.secs());
    rig.fault("encoder_fail", false);
    rig.write(pid::ALARM_RESET, 0);
    rig.after(10.millis());
    assert_eq!(rig.status(), (0, 0));
    rig.velocity(500);
    rig.assert_turns(500.0);
    // The fault of an encoder that is not used has no effect.
    let mut rig = Rig::armed(&[]);
    rig.fault("encoder_fail", true);
    rig.velocity(500);
    rig.assert_turns(500.0);
    assert_eq!(rig.status(), (0, 0));
}

/// ENC_PPR survives a power cycle. PID_DI shows the levels of ENC_A and ENC_B (p. 11).
#[test]
fn page_11_encoder_inputs() {
    let (mut rig, _) = with_encoder(100, 100);
    rig.velocity(100);
    let mut seen = [0; 4];
    rig.watch(2.secs(), 1.millis(), |rig, _| seen[usize::from(rig.read(pid::DI) >> 5 & 3)] += 1);
    assert!(seen.iter().all(|&count| count > 100), "{seen:?}");
    rig.power_cycle();
    assert_eq!(rig.read(pid::ENC_PPR), 100);
}
