//! Limits (MC 5-43) and jog (MC 5-39).

use super::*;

/// Reaction to a limit during a slew at 5,000 steps/s: true if it brakes with a ramp, true if the program
/// ends.
fn hit(limit_mode: u8) -> (bool, bool) {
    let mut bench = Bench::new(Settings { limit_mode, ..SLOW });
    bench.does(Order::Slew(5_000));
    bench.run(600.millis());
    bench.contact(Contact::PlusLimit, true);
    bench.run(1.millis());
    let brakes = bench.v() != 0;
    bench.run(400.millis());
    // Without a ramp the motion ends with the next step.
    assert_eq!((bench.is_moving(), bench.c1()), (false, 2_200 + if brakes { 1_200 } else { 1 }));
    assert_eq!(bench.errors(), [Error::PlusLimit]);
    (brakes, bench.events.iter().any(|(_, event)| *event == Event::StopsProgram))
}

#[test]
fn modes_brake_or_not_and_end_the_program_or_not() {
    let all = [1, 2, 3, 4, 5, 6].map(hit);
    assert_eq!(
        all,
        [(true, false), (true, false), (true, true), (false, false), (false, false), (false, true)]
    );
}

#[test]
fn a_limit_acts_in_its_direction_only() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(-2_000));
    bench.contact(Contact::PlusLimit, true);
    bench.run(1.secs());
    assert_eq!((bench.v(), bench.errors()), (-2_000, Vec::new()));
    bench.contact(Contact::MinusLimit, true);
    bench.run(1.secs());
    assert_eq!((bench.v(), bench.errors()), (0, [Error::MinusLimit].to_vec()));
}

#[test]
fn towards_a_held_limit_nothing_moves() {
    let mut bench = Bench::new(SLOW);
    bench.contact(Contact::PlusLimit, true);
    for order in [to(100), by(1), Order::Slew(2_000)] {
        bench.events.clear();
        bench.does(order);
        assert_eq!(bench.errors(), [Error::PlusLimit]);
        assert!(!bench.is_moving());
    }
    bench.run(1.secs());
    assert_eq!(bench.c1(), 0);
    bench.events.clear();
    bench.does(to(-100));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (-100, Vec::new()));
}

#[test]
fn a_slew_that_would_turn_towards_a_held_limit_only_stops() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(-2_000));
    bench.contact(Contact::PlusLimit, true);
    bench.run(1.secs());
    bench.does(Order::Slew(2_000));
    assert_eq!(bench.errors(), [Error::PlusLimit]);
    bench.run_out();
    // 1,950 steps in the first second, 150 in the ramp.
    assert_eq!(bench.c1(), -1_950 - 150);
}

#[test]
fn a_limit_that_closes_before_a_slew_turns_towards_it_stops_it() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(-5_000));
    bench.run(1.secs());
    bench.does(Order::Slew(5_000));
    bench.run(200.millis());
    bench.contact(Contact::PlusLimit, true);
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (-4_200 - 1_200, [Error::PlusLimit].to_vec()));
}

#[test]
fn a_limit_behind_a_turn_does_not_matter_any_more() {
    let mut bench = Bench::new(SLOW);
    bench.does(Order::Slew(5_000));
    bench.run(1.secs());
    bench.does(Order::Slew(-5_000));
    bench.run(1.secs());
    bench.contact(Contact::PlusLimit, true);
    assert_eq!((bench.v(), bench.errors()), (-5_000, Vec::new()));
}

#[test]
fn a_limit_drops_what_waits() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(50_000));
    bench.does(to(0));
    bench.run(1.secs());
    bench.contact(Contact::PlusLimit, true);
    bench.run_out();
    let there = bench.c1();
    bench.run(1.secs());
    assert_eq!(bench.c1(), there);
}

#[test]
fn a_limit_in_the_way_of_what_paused_leaves_what_waited_behind_it() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(5_000));
    bench.does(to(0));
    bench.run(500.millis());
    bench.feed(|motion, at, out| motion.pause(at, out));
    bench.run_out();
    bench.contact(Contact::PlusLimit, true);
    bench.feed(|motion, at, out| motion.resume(at, out));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (0, [Error::PlusLimit].to_vec()));
}

#[test]
fn in_clock_mode_limits_do_nothing() {
    let mut bench = Bench::new(Settings { follows_clock: true, ..SLOW });
    bench.contact(Contact::PlusLimit, true);
    bench.does(to(100));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (100, Vec::new()));
}

#[test]
fn a_jog_lasts_as_long_as_its_contact() {
    let mut bench = Bench::new(Settings { jogs: true, ..SLOW });
    bench.contact(Contact::JogMinus, true);
    bench.run(600.millis());
    assert_eq!((bench.c1(), bench.v(), bench.is_positioning()), (-2_200, -5_000, false));
    // The other contact has no effect during a jog.
    bench.contact(Contact::JogPlus, true);
    bench.contact(Contact::JogPlus, false);
    bench.contact(Contact::JogMinus, false);
    bench.run(400.millis());
    assert_eq!((bench.c1(), bench.is_moving()), (-3_400, false));
}

/// "Will Jog motor in the positive direction …. The Jog Enable (JE) Flag must be set for this to function"
/// (MC 5-63). If the contact is active already, the jog begins as soon as JE is 1.
#[test]
fn je_permits_a_jog() {
    let jogs = Settings { jogs: true, ..SLOW };
    let mut bench = Bench::new(SLOW);
    bench.contact(Contact::JogPlus, true);
    assert!(!bench.is_moving());
    bench.set(jogs);
    bench.run(1.secs());
    assert_eq!(bench.v(), 5_000);
    bench.set(SLOW);
    bench.run(400.millis());
    assert!(!bench.is_moving());
    // The contact is active all the time.
    bench.set(jogs);
    bench.run(1.secs());
    assert_eq!(bench.v(), 5_000);
    // With both contacts active no jog begins. A change of JE does not stop another motion.
    bench.set(SLOW);
    bench.run(1.secs());
    bench.contact(Contact::JogMinus, true);
    bench.set(jogs);
    assert!(!bench.is_moving());
    bench.set(SLOW);
    bench.contact(Contact::JogMinus, false);
    bench.order(Order::Slew(-3_000)).unwrap();
    bench.run(1.secs());
    bench.set(jogs);
    bench.run(1.secs());
    assert_eq!(bench.v(), -3_000);
}

/// A contact that is active at the end of a jog begins the next jog.
#[test]
fn a_jog_follows_another() {
    for (next, speed) in [(Contact::JogPlus, 5_000), (Contact::JogMinus, -5_000)] {
        let mut bench = Bench::new(Settings { jogs: true, ..SLOW });
        bench.contact(Contact::JogPlus, true);
        bench.run(600.millis());
        bench.contact(Contact::JogPlus, false);
        bench.run(100.millis());
        bench.contact(next, true);
        // First the motor slows down to standstill.
        bench.run(200.millis());
        assert!((0..5_000).contains(&bench.v()), "{}", bench.v());
        bench.run(1.secs());
        assert_eq!(bench.v(), speed);
    }
    // Both contacts were active. The one that still is active begins the next jog.
    let mut bench = Bench::new(Settings { jogs: true, ..SLOW });
    bench.contact(Contact::JogPlus, true);
    bench.run(600.millis());
    bench.contact(Contact::JogMinus, true);
    bench.contact(Contact::JogPlus, false);
    bench.run(2.secs());
    assert_eq!(bench.v(), -5_000);
}

/// After any other stop, a contact that is still active begins no jog.
#[test]
fn a_jog_that_was_ended_does_not_begin_again() {
    let jogs = |end: &dyn Fn(&mut Bench)| {
        let mut bench = Bench::new(Settings { jogs: true, ..SLOW });
        bench.contact(Contact::JogPlus, true);
        bench.run(600.millis());
        end(&mut bench);
        bench.run(2.secs());
        bench.is_moving()
    };
    assert!(jogs(&|_| {}));
    assert!(!jogs(&|bench| bench.does(Order::Slew(0))));
    assert!(!jogs(&|bench| bench.feed(|motion, at, out| motion.stop(at, out))));
    assert!(!jogs(&|bench| bench.contact(Contact::PlusLimit, true)));
    // The contact is released, and active again while a command stops the motor.
    assert!(!jogs(&|bench| {
        bench.contact(Contact::JogPlus, false);
        bench.contact(Contact::JogPlus, true);
        bench.does(Order::Slew(0));
    }));
}

#[test]
fn a_jog_is_no_motion_where_it_must_not_be() {
    let mut bench = Bench::new(Settings { jogs: true, follows_clock: true, ..SLOW });
    bench.contact(Contact::JogPlus, true);
    assert_eq!((bench.is_moving(), bench.errors()), (false, [Error::JogInClockMode].to_vec()));
    let mut bench = Bench::new(Settings { jogs: true, ..SLOW });
    bench.contact(Contact::PlusLimit, true);
    bench.contact(Contact::JogPlus, true);
    assert_eq!((bench.is_moving(), bench.errors()), (false, [Error::PlusLimit].to_vec()));
    bench.run(1.secs());
    assert_eq!(bench.errors().len(), 1);
}
