//! Limit switches while the shaft turns (MDROBOT-23).

use super::super::{DIR, START_STOP};
use super::*;

/// For each switch: the direction that it permits, and the other switch.
const WAYS: [(Pin, i16, Pin); 2] = [(START_STOP, 1, DIR), (DIR, -1, START_STOP)];

/// A motor that turns in direction `way` at 1,500 rpm with both switches closed. Its ramp down from there
/// takes 7.5 s.
fn turning(way: i16) -> Dut {
    let mut dut = Dut::armed();
    dut.contact(DIR, true);
    dut.contact(START_STOP, true);
    dut.write(130, (way * 1_500).cast_unsigned());
    dut.wait(2.secs());
    assert!((1_485..=1_515).contains(&(i64::from(way) * dut.rpm())), "{}", dut.rpm());
    dut.write(154, 1_023);
    dut
}

/// The output, word 3 of MONITOR.
fn output(dut: &mut Dut) -> u16 {
    dut.read_words(196, 6)[2]
}

#[test]
fn one_stops_a_shaft_that_still_turns_there_whatever_the_order_is() {
    let orders: [fn(&mut Dut, i16); 4] = [
        |dut, way| dut.write(130, (way * -1_500).cast_unsigned()),
        |dut, _| dut.write(130, 0),
        |dut, _| dut.write(100, 0),
        // Commands a position in the opposite direction.
        |dut, way| dut.write_words(244, if way > 0 { &[0xFF00, 0xFFFF] } else { &[0x0100, 0] }),
    ];
    for (switch, way, _) in WAYS {
        for (which, order) in orders.into_iter().enumerate() {
            let mut dut = turning(way);
            dut.write(40, 1);
            order(&mut dut, way);
            dut.wait(50.millis());
            let rpm = i64::from(way) * dut.rpm();
            assert!(rpm > 200, "{which}: {rpm} rpm");
            dut.contact(switch, false);
            assert_eq!(output(&mut dut), 0, "{which}");
            // The shorted windings stop the shaft at once, and nothing turns it afterwards.
            dut.wait(500.millis());
            let position = dut.get(Pid::POSI_DATA);
            dut.wait(20.secs());
            assert_eq!((dut.get(Pid::POSI_DATA), dut.rpm()), (position, 0), "{which}");
        }
    }
}

#[test]
fn the_other_one_lets_it_slow_down() {
    for (_, way, other) in WAYS {
        for rpm in [0, way * 500] {
            let mut dut = turning(way);
            dut.write(130, rpm.cast_unsigned());
            dut.contact(other, false);
            dut.wait(1.secs());
            assert_ne!(output(&mut dut), 0, "it is driven down its ramp");
            assert!((1_250..=1_350).contains(&(i64::from(way) * dut.rpm())), "{}", dut.rpm());
        }
    }
}

#[test]
fn one_frees_it_if_limit_stop_cond_is_0() {
    for (switch, way, _) in WAYS {
        let mut dut = turning(way);
        dut.write(130, (way * -1_500).cast_unsigned());
        dut.wait(500.millis());
        dut.contact(switch, false);
        dut.wait(10.millis());
        assert_eq!((output(&mut dut), dut.get(Pid::TQ_DATA)), (0, 0));
        assert!(i64::from(way) * dut.rpm() > 500, "{}", dut.rpm());
    }
}

#[test]
fn nothing_drives_it_on_after_it_has_been_freed() {
    for (switch, way, _) in WAYS {
        let mut dut = turning(way);
        dut.contact(switch, false);
        for (pid, value) in [(100, 0), (100, 1), (130, 0)] {
            dut.write(pid, value);
            dut.wait(10.millis());
            assert_eq!((output(&mut dut), dut.get(Pid::TQ_DATA)), (0, 0), "PID {pid} = {value}");
        }
        assert!(i64::from(way) * dut.rpm() > 500, "{}", dut.rpm());
    }
}

#[test]
fn the_way_back_brakes_a_shaft_that_turns_on() {
    let orders: [fn(&mut Dut, i16); 2] = [
        |dut, way| dut.write(130, (way * -300).cast_unsigned()),
        // Commands position 0, at 300 rpm.
        |dut, _| dut.write_words(219, &[0, 0, 300]),
    ];
    for (switch, way, _) in WAYS {
        for (which, order) in orders.into_iter().enumerate() {
            let mut dut = turning(way);
            dut.contact(switch, false);
            dut.wait(100.millis());
            let from = dut.get(Pid::POSI_DATA);
            order(&mut dut, way);
            // With `SLOW_DOWN`, 7.5 s from 1,500 rpm, the shaft would turn 94 turns further.
            dut.wait(1.secs());
            let on = i64::from(way) * (dut.get(Pid::POSI_DATA) - from);
            assert!(on < 12 * 3, "{which}: {on} counts on");
            let back = -i64::from(way) * dut.rpm();
            assert!((285..=315).contains(&back), "{which}: {back} rpm");
            dut.contact(switch, true);
            assert_eq!(dut.get(Pid::IN_POSITION_OK), 0, "{which}");
        }
    }
}

#[test]
fn a_motor_comes_back_out_of_an_open_one() {
    for (switch, way, _) in WAYS {
        let mut dut = turning(way);
        dut.write(40, 1);
        dut.contact(switch, false);
        dut.wait(1.secs());
        let position = dut.get(Pid::POSI_DATA);
        // The way back is slow, and the master writes other registers meanwhile.
        dut.write(130, (way * -100).cast_unsigned());
        for _ in 0..20 {
            dut.wait(100.millis());
            dut.write(154, 0);
            dut.write(130, (way * -100).cast_unsigned());
        }
        let way_back = i64::from(-way) * (dut.get(Pid::POSI_DATA) - position);
        // 100 rpm are 20 counts a second.
        assert!((30..=50).contains(&way_back), "{way_back}");
    }
}
