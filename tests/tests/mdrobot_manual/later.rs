//! PIDs that V1.1 does not have but public clients use (MDROBOT-10): 66, 176, 178, 179, 210, 216.

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::catalog;

use crate::pid;
use crate::rig::Rig;

const TQ_RATIO: u16 = 66;
const TAR_POSI_VEL: u16 = 176;
const POSI_SS: u16 = 178;
const POSI_SD: u16 = 179;
const PNT_MAIN_DATA: u16 = 210;
const PNT_MONITOR: u16 = 216;

/// Requests for the two monitors, with their CRC, and the number of words in the answer.
#[test]
fn frames_of_the_monitors() {
    let mut rig = Rig::default();
    for (request, words) in [
        ([0x01, 0x03, 0x00, 0xD2, 0x00, 0x09, 0x25, 0xF5], 9),
        ([0x01, 0x03, 0x00, 0xD8, 0x00, 0x07, 0x84, 0x33], 7),
    ] {
        let reply = rig.bench.ask(rig.seat, &request);
        let body = rtu::verify_crc(&reply).expect("a CRC that holds");
        assert_eq!(body[..3], [1, 3, 2 * words]);
        assert_eq!(body[3..], vec![0; 2 * usize::from(words)]);
    }
}

/// PID 210 has speed, current, and low and high word of the position, first for motor 1, then for motor 2.
/// The last word has CTRL_STATUS of motor 2 in the high byte, and of motor 1 in the low byte. PID 216 is the
/// same without currents. An MD400 has one motor.
#[test]
fn what_the_monitors_show() {
    for (rpm, pulls_ma) in [(1_000_i16, 5_000), (-1_000, -5_000)] {
        // A load of 0.3 Nm against the motion. Friction takes 0.17 A more.
        let (mut rig, _) = Rig::turning(&[], |motor| motor.load_unm = pulls_ma * 60);
        rig.velocity(rpm);
        rig.after(3.secs());
        let (main, monitor) = (rig.words(PNT_MAIN_DATA, 9), rig.words(PNT_MONITOR, 7));
        let position = rig.position().cast_unsigned();
        let [low, high] = [position as u16, (position >> 16) as u16];
        assert!(main[0].cast_signed().abs_diff(rpm) <= 10, "{main:?}");
        let tenths = main[1].cast_signed();
        assert!(tenths.abs_diff(rpm.signum() * 52) <= 3, "{tenths} tenths of an ampere");
        assert_eq!((&main[2..4], &main[4..]), (&[low, high][..], &[0; 5][..]));
        assert!(monitor[0].cast_signed().abs_diff(rpm) <= 10, "{monitor:?}");
        assert_eq!((&monitor[1..3], &monitor[3..]), (&[low, high][..], &[0; 4][..]));
        // ALARM and OVER_TEMP, bits 0 and 3 of CTRL_STATUS (p. 9).
        rig.fault("over_temperature", true);
        assert_eq!((rig.words(PNT_MAIN_DATA, 9)[8], rig.words(PNT_MONITOR, 7)[6]), (0b1001, 0b1001));
    }
}

/// "Max speed in position control": limits commands without a speed of their own, up to MAX_RPM.
#[test]
fn tar_posi_vel_limits_positions() {
    let fastest = |rig: &mut Rig| {
        let mut fastest = 0.0_f64;
        rig.watch(2.secs(), 5.millis(), |rig, _| fastest = fastest.max(rig.shaft().abs()));
        fastest
    };
    for (limit, rpm) in [(300, 300.0), (1_110, 400.0), (0, 0.0)] {
        let settings = [(pid::UI_COM, 1), (pid::MAX_RPM, 400), (TAR_POSI_VEL, limit)];
        for pid in [pid::POSI_CMD, pid::INC_POSI_CMD] {
            let mut rig = Rig::with(&settings);
            rig.write_long(pid, 2_400);
            let seen = fastest(&mut rig);
            assert!((seen - rpm).abs() <= rpm * 0.15, "PID {pid}, {limit}: {seen}");
        }
        for pid in [pid::POSI_VEL_CMD, pid::INC_POSI_VEL_CMD] {
            let mut rig = Rig::with(&settings);
            rig.write_move(pid, 2_400, 200);
            let seen = fastest(&mut rig);
            assert!((seen - 200.0).abs() <= 30.0, "PID {pid}, {limit}: {seen}");
        }
    }
}

/// "Stop using the position slow-start parameter", and the same for slow-down: CMD 71, 72.
#[test]
fn position_ramps_are_erased() {
    for (code, left) in [(71, [0, 20]), (72, [10, 0])] {
        let mut rig = Rig::with(&[(POSI_SS, 10), (POSI_SD, 20)]);
        rig.command(code);
        rig.power_cycle();
        assert_eq!([rig.read(POSI_SS), rig.read(POSI_SD)], left, "CMD {code}");
    }
}

/// A public client writes 1 to TQ_RATIO after it has found home, and checks for 0 when it starts. The value
/// is lost at power-off, like the position.
#[test]
fn tq_ratio_keeps_a_flag() {
    let mut rig = Rig::default();
    rig.write(TQ_RATIO, 1);
    rig.write(pid::DEFAULT_SET, 0x55);
    assert_eq!(rig.read(TQ_RATIO), 1);
    rig.power_cycle();
    assert_eq!(rig.read(TQ_RATIO), 0);
}

/// The register table marks these PIDs as missing in the manual.
#[test]
fn pids_missing_in_the_manual_are_marked() {
    let spec = catalog::make("mdrobot").expect("a kind").spec();
    for name in ["TQ_RATIO", "TAR_POSI_VEL", "POSI_SS", "POSI_SD", "PNT_MAIN_DATA", "PNT_MONITOR"] {
        let row = spec.find(name).expect("a register").row;
        assert_eq!(spec.registers.rows[row].section, "not in V1.1", "{name}");
    }
}
