//! Alarms (p. 9; MDROBOT-31, MDROBOT-32): their causes, effects and resets.

use drivetwin_firmware::device::Level;
use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

/// Bits of CTRL_STATUS.
const ALARM: u16 = 1;
const CTRL_FAIL: u16 = 1 << 1;
const OVER_VOLT: u16 = 1 << 2;
const OVER_TEMP: u16 = 1 << 3;
const OVER_LOAD: u16 = 1 << 4;
const HALL_FAIL: u16 = 1 << 5;
const INV_VEL: u16 = 1 << 6;
const STALL: u16 = 1 << 7;

/// Causes of alarms, with the bits that they set in CTRL_STATUS and in status2. Some raise the alarm at once,
/// others only while the motor turns.
const FAULTS: [(&str, u16, u16); 8] = [
    ("over_voltage", OVER_VOLT, 0),
    ("over_temperature", OVER_TEMP, 0),
    ("overload", OVER_LOAD, 0),
    ("ctrl_fail", CTRL_FAIL, 0),
    ("regen_over_temperature", 0, 1),
    ("hall_fail", HALL_FAIL, 0),
    ("inverse_velocity", INV_VEL, 0),
    ("stall", STALL, 0),
];

/// Waits for an alarm and returns the time until it was raised.
#[track_caller]
fn alarm(rig: &mut Rig, within: Duration) -> Duration {
    let mut came = None;
    rig.watch(within, 5.millis(), |rig, t| {
        if came.is_none() && rig.read(pid::CTRL_STATUS) != 0 {
            came = Some(t);
        }
    });
    came.unwrap_or_else(|| panic!("no alarm within {within:?}; {} rpm, {} A", rig.shaft(), rig.amperes()))
}

#[track_caller]
fn assert_alarm(rig: &mut Rig, bit: u16, status2: u16) {
    assert_eq!(rig.status(), (ALARM | bit, status2), "CTRL_STATUS, status2");
    assert_eq!(rig.level("ALARM"), Level::Low);
}

#[track_caller]
fn assert_none(rig: &mut Rig) {
    assert_eq!(rig.status(), (0, 0), "CTRL_STATUS, status2");
    assert_eq!(rig.level("ALARM"), Level::High);
}

/// Each alarm switches the output off and latches. The bus is still answered, and nothing drives the motor. A
/// reset works only after the cause is gone. Then the next command drives the motor.
#[test]
fn page_9_each_alarm() {
    for (name, bit, status2) in FAULTS {
        for reset in ["12", "CMD 8", "ALARM_RESET"] {
            let mut rig = Rig::armed(&[]);
            let clear = |rig: &mut Rig| match reset {
                "12" => rig.write(pid::ALARM_RESET, 0x1234),
                "CMD 8" => rig.command(8),
                _ => {
                    rig.open("ALARM_RESET");
                    rig.after(10.millis());
                    rig.close("ALARM_RESET");
                    rig.after(10.millis());
                    rig.open("ALARM_RESET");
                }
            };
            rig.velocity(1_000);
            rig.assert_turns(1_000.0);
            assert_none(&mut rig);
            rig.fault(name, true);
            alarm(&mut rig, 6.secs());
            assert_alarm(&mut rig, bit, status2);
            // The output is off: the motor coasts or is blocked.
            rig.after(2.millis());
            assert_eq!(rig.motion().current_ma, 0, "{name}: the output is off");
            rig.after(30.secs());
            rig.assert_stands();
            // A reset fails while the cause persists. Other faults exist only while the motor turns.
            if ["over_voltage", "over_temperature", "overload", "ctrl_fail", "regen_over_temperature"]
                .contains(&name)
            {
                clear(&mut rig);
                rig.after(10.millis());
                assert_alarm(&mut rig, bit, status2);
            }
            // Writes are echoed but do not move the motor.
            rig.velocity(700);
            rig.write_long(pid::POSI_CMD, 0);
            rig.assert_stands();
            assert_eq!(rig.signed(pid::VEL_CMD), 700);
            // The alarm is latched.
            rig.fault(name, false);
            rig.after(1.secs());
            assert_alarm(&mut rig, bit, status2);
            clear(&mut rig);
            rig.after(10.millis());
            assert_none(&mut rig);
            // The alarm has dropped the reference, but START_STOP and UI_COM are unchanged.
            rig.assert_stands();
            rig.velocity(600);
            rig.assert_turns(600.0);
            assert_none(&mut rig);
        }
    }
}

/// Power-off clears an alarm. If the cause exists at power-on, the alarm is raised again.
#[test]
fn page_9_power() {
    for name in ["over_voltage", "over_temperature", "overload", "ctrl_fail", "regen_over_temperature"] {
        let mut rig = Rig::default();
        rig.fault(name, true);
        assert_eq!(rig.read(pid::CTRL_STATUS) & ALARM, ALARM, "{name}, at rest");
        rig.fault(name, false);
        rig.power_cycle();
        assert_none(&mut rig);
        rig.fault(name, true);
        rig.power_cycle();
        assert_eq!(rig.read(pid::CTRL_STATUS) & ALARM, ALARM, "{name} at power-on");
    }
}

/// Several alarms at once. A reset clears those whose cause is gone.
#[test]
fn page_9_several() {
    let mut rig = Rig::default();
    rig.fault("over_temperature", true);
    rig.fault("over_voltage", true);
    assert_alarm(&mut rig, OVER_TEMP | OVER_VOLT, 0);
    rig.fault("over_voltage", false);
    rig.write(pid::ALARM_RESET, 0);
    rig.after(10.millis());
    assert_alarm(&mut rig, OVER_TEMP, 0);
    rig.fault("over_temperature", false);
    rig.write(pid::ALARM_RESET, 0);
    rig.after(10.millis());
    assert_none(&mut rig);
}

/// VOLT_IN shows 61 V, in units of 0.1 V (MDROBOT-32).
#[test]
fn page_13_volt_in() {
    let mut rig = Rig::default();
    rig.fault("over_voltage", true);
    assert_eq!(rig.read(pid::VOLT_IN), 610);
    rig.fault("over_voltage", false);
    assert_eq!(rig.read(pid::VOLT_IN), 240);
}

/// VOLT_IN shows the supply of the motor. More than 60 V raise an alarm (MDROBOT-31, MDROBOT-32).
#[test]
fn page_13_the_supply() {
    let mut rig = Rig::armed(&[]);
    let row = rig.bench.spec(rig.seat).find("VOLT_IN").expect("a PID").row;
    // The motor has 3,820 rpm at 24 V, minus 8 rpm because of 10 mN·m of friction.
    for (volts, rpm) in [(240, 3_812.0), (120, 1_902.0), (360, 5_722.0), (600, 9_542.0)] {
        assert_eq!(rig.bench.poke(rig.seat, row, volts), Ok(()));
        assert_eq!(i64::from(rig.read(pid::VOLT_IN)), volts);
        rig.write(pid::OPEN_VEL_CMD, 1_023);
        rig.after(3.secs());
        assert!((rig.shaft() - rpm).abs() < 5.0, "{} rpm at {volts}", rig.shaft());
    }
    assert_none(&mut rig);
    assert_eq!(rig.bench.poke(rig.seat, row, 601), Ok(()));
    assert_alarm(&mut rig, OVER_VOLT, 0);
    rig.power_cycle();
    assert_none(&mut rig);
    assert_eq!(rig.read(pid::VOLT_IN), 240);
}

/// A load that turns the motor faster than the supply allows charges the supply, with any command. So the
/// speed stays bounded.
#[test]
fn page_13_a_load_beyond_the_supply() {
    // A load of -2 Nm against the friction makes 33.2 A. At 0.3 Ω these are 9.95 V more than 24 V.
    let (mut rig, _) = Rig::turning(&[], |motor| motor.load_unm = -2_000_000);
    rig.velocity(1_000);
    for _ in 0..10 {
        rig.after(1.secs());
        assert!((rig.shaft() - 5_403.0).abs() < 20.0, "{} rpm", rig.shaft());
        assert_eq!((rig.signed(pid::RPM_DATA), rig.signed(pid::TQ_DATA)), (5_000, -332));
    }
}

/// STALL: no Hall edge for 1 s while the output is over half.
#[test]
fn page_9_stall() {
    let mut rig = Rig::armed(&[]);
    rig.fault("stall", true);
    rig.write_signed(pid::OPEN_VEL_CMD, 600);
    let came = alarm(&mut rig, 3.secs());
    assert!((950..=1_100).contains(&(came.ticks() / 16_000)), "{came:?}");
    assert_alarm(&mut rig, STALL, 0);
    // An output of less than half raises no alarm. The current is less than MAX_LOAD: 24 V × 200 / 1,023 at
    // 0.3 Ω make 15.6 A.
    let mut rig = Rig::armed(&[]);
    rig.fault("stall", true);
    rig.write_signed(pid::OPEN_VEL_CMD, 200);
    rig.after(10.secs());
    assert_none(&mut rig);
}

/// OVER_LOAD: the current is at MAX_LOAD for 4 s. A shorter time raises no alarm.
#[test]
fn page_9_over_load() {
    let mut rig = Rig::armed(&[(pid::MAX_LOAD, 20)]);
    rig.fault("stall", true);
    rig.write_signed(pid::TQ_CMD, 1_023);
    let came = alarm(&mut rig, 6.secs());
    assert!((3_950..=4_150).contains(&(came.ticks() / 16_000)), "{came:?}");
    assert_alarm(&mut rig, OVER_LOAD, 0);
    let mut rig = Rig::armed(&[(pid::MAX_LOAD, 20)]);
    rig.fault("stall", true);
    for _ in 0..3 {
        rig.write_signed(pid::TQ_CMD, 1_023);
        rig.after(3_500.millis());
        rig.write_signed(pid::TQ_CMD, 800);
        rig.after(500.millis());
    }
    assert_none(&mut rig);
    // A torque just below MAX_LOAD raises no alarm.
    rig.write_signed(pid::TQ_CMD, 900);
    rig.after(10.secs());
    assert_none(&mut rig);
}

/// CTRL_FAIL: the speed error is more than half of the reference for 3 s.
#[test]
fn page_9_ctrl_fail() {
    let mut rig = Rig::armed(&[(pid::P_GAIN, 0), (pid::I_GAIN, 0)]);
    rig.velocity(1_000);
    let came = alarm(&mut rig, 5.secs());
    assert!((2_950..=3_150).contains(&(came.ticks() / 16_000)), "{came:?}");
    assert_alarm(&mut rig, CTRL_FAIL, 0);
    // A reference of zero raises no alarm, however fast the shaft turns. The drive should hold the shaft, but
    // without gains the load turns it.
    let (mut rig, _) = Rig::turning(&[(pid::STOP_STATUS, 1)], |motor| motor.load_unm = 100_000);
    rig.velocity(500);
    rig.after(1.secs());
    rig.set(&[(pid::P_GAIN, 0), (pid::I_GAIN, 0)]);
    rig.velocity(0);
    rig.after(1.secs());
    rig.watch(10.secs(), 100.millis(), |rig, _| {
        assert!(rig.shaft() < -20.0, "{} rpm", rig.shaft());
        assert_none(rig);
    });
}

/// INV_VEL: the motor turns against the reference for 0.5 s, because the load is stronger than MAX_LOAD
/// allows.
#[test]
fn page_9_inv_vel() {
    // 1 A makes 0.06 Nm. The load is 0.15 Nm.
    let (mut rig, _) = Rig::turning(&[(pid::MAX_LOAD, 10)], |motor| motor.load_unm = 150_000);
    rig.velocity(500);
    let came = alarm(&mut rig, 2.secs());
    assert!((490..=700).contains(&(came.ticks() / 16_000)), "{came:?}");
    assert_alarm(&mut rig, INV_VEL, 0);
}

/// Two wires of the motor are swapped (MDROBOT-32).
#[test]
fn page_9_inverse_velocity() {
    for rpm in [500, -500] {
        let mut rig = Rig::armed(&[]);
        rig.fault("inverse_velocity", true);
        rig.velocity(rpm);
        let came = alarm(&mut rig, 2.secs());
        assert!((490..=750).contains(&(came.ticks() / 16_000)), "{came:?}");
        assert_alarm(&mut rig, INV_VEL, 0);
    }
}

/// A reversal raises no alarm, because the drive brakes first.
#[test]
fn page_9_a_reversal_is_no_alarm() {
    for (slow_start, slow_down) in [(0, 0), (205, 205), (0, 512)] {
        let mut rig = Rig::armed(&[(pid::SLOW_START, slow_start), (pid::SLOW_DOWN, slow_down)]);
        for rpm in [2_000, -2_000, 2_000, -500, 2_500] {
            rig.velocity(rpm);
            rig.watch(8.secs(), 20.millis(), |rig, _| assert_eq!(rig.read(pid::CTRL_STATUS), 0));
            assert!((rig.rpm() - f64::from(rpm)).abs() <= 25.0, "{}", rig.rpm());
        }
    }
}

/// HALL_FAIL: an impossible state of the Hall sensors. A broken wire shows within one electrical turn.
#[test]
fn page_9_hall_fail() {
    let mut rig = Rig::armed(&[]);
    rig.velocity(1_000);
    rig.assert_turns(1_000.0);
    let pin = rig.pin("HU");
    assert_eq!(rig.bench.spec(rig.seat).pins[usize::from(pin.0)].name, "HU");
    rig.fault("hall_fail", true);
    // An electrical turn is half a turn of the shaft: 30 ms.
    let came = alarm(&mut rig, 100.millis());
    assert!(came <= 40.millis(), "{came:?}");
    assert_alarm(&mut rig, HALL_FAIL, 0);
    // After a power cycle the alarm is raised when the motor turns again.
    rig.power_cycle();
    rig.set(&[(pid::UI_COM, 1), (pid::START_STOP, 1)]);
    rig.velocity(1_000);
    alarm(&mut rig, 6.secs());
    assert_eq!(rig.read(pid::CTRL_STATUS) & ALARM, ALARM);
}

/// An alarm ends a function, and a motion by the pins. Before the pins can drive again, START/STOP must be
/// off once (MDROBOT-14).
#[test]
fn page_9_pins_after_an_alarm() {
    let mut rig = Rig::with(&[(pid::TAR_VEL, 500), (pid::STOP_STATUS, 2)]);
    rig.open("START_STOP");
    rig.close("RUN_BRAKE");
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    rig.fault("over_temperature", true);
    rig.after(10.secs());
    rig.fault("over_temperature", false);
    rig.write(pid::ALARM_RESET, 0);
    rig.assert_stands();
    rig.open("START_STOP");
    rig.after(10.millis());
    rig.close("START_STOP");
    rig.assert_turns(500.0);
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, 3)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(1.secs());
    rig.fault("over_temperature", true);
    rig.after(10.secs());
    rig.fault("over_temperature", false);
    rig.write(pid::ALARM_RESET, 0);
    rig.assert_stands();
    rig.write(pid::FUNC_CMD, 0);
    rig.write(pid::FUNC_CMD, 1);
    rig.assert_turns(1_000.0);
}

/// Ordinary commands for a minute raise no alarm.
#[test]
fn page_9_ordinary_work() {
    let mut rig = Rig::armed(&[(pid::SLOW_START, 100), (pid::SLOW_DOWN, 100)]);
    for rpm in [40, 100, -100, 3_000, 0, -3_000, 500, 0] {
        rig.velocity(rpm);
        rig.after(8.secs());
        assert_none(&mut rig);
    }
}
