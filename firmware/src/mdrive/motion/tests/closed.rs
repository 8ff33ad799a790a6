//! Closed loop, EE = 1 (MC 7.3.7, 5-18, 5-56, 5-68 to 5-70).

use super::super::Channel;
use super::*;

/// The factory's settings in counts.
const COUNTS: Settings =
    Settings { start: 40, speed: 30_720, up: 40_000, down: 40_000, closed: true, settle_ms: 50, ..FACTORY };

impl Bench {
    /// Runs until the built-in encoder shows this count.
    fn run_to_count(&mut self, count: i32) {
        self.run(3.millis());
        self.run_to(self.motion.shaft().reaches_steps(self.now, 25 * count));
        // The plan makes the step at the nearest tick, which may be one tick later.
        self.run(Duration::TICK);
        assert_eq!(self.c2(), count);
    }

    /// Makes this number of edges of a remote encoder, a millisecond apart, starting with both channels high.
    fn edges(&mut self, edges: i32) {
        // In forward motion channel A falls first.
        let forward = [(Channel::A, false), (Channel::B, false), (Channel::A, true), (Channel::B, true)];
        for _ in 0..edges.unsigned_abs() {
            let back = edges < 0;
            self.edges -= i32::from(back);
            let (channel, level) = forward[self.edges.rem_euclid(4) as usize];
            self.edges += i32::from(!back);
            self.run(MS);
            self.feed(|motion, at, out| motion.channel(at, channel, Some(level != back), out));
        }
    }

    fn plug(&mut self) {
        for channel in [Channel::A, Channel::B] {
            self.feed(|motion, at, out| motion.channel(at, channel, Some(true), out));
        }
    }
}

#[test]
fn all_motion_is_in_counts() {
    let mut bench = Bench::new(COUNTS);
    bench.does(by(7_168));
    bench.run(900.millis());
    // Like 768,000 steps/s, which are 30,720 counts/s. In 3.5 revolutions the motor does not reach this
    // speed.
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (7_168 * 25, 7_168, Vec::new()));
    bench.does(Order::Slew(-7_168));
    bench.run(1.secs());
    assert_eq!(bench.v(), -7_168);
    let (c1, c2) = (bench.c1(), bench.c2());
    bench.run(2.secs());
    assert_eq!(bench.c1() - c1, -2 * 7_168 * 25);
    assert!((bench.c2() - c2 + 2 * 7_168).abs() <= 1);
}

#[test]
fn a_move_is_as_long_as_the_same_one_in_steps() {
    let time = |settings: Settings, distance| {
        let mut bench = Bench::new(Settings { settle_ms: 50, ..settings });
        bench.does(by(distance));
        bench.run_out();
        bench.now
    };
    assert_eq!(time(COUNTS, 153_600), time(FACTORY, 3_840_000));
    assert_eq!(time(COUNTS, -3), time(FACTORY, -75));
}

#[test]
fn absolute_moves_go_by_c2() {
    let mut bench = Bench::new(COUNTS);
    bench.does(by(1_000));
    bench.run_out();
    bench.feed(|motion, at, _| motion.shaft_mut().set_counts(at, 0));
    bench.does(to(-500));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (500 * 25, -500));
    // 2³¹ counts are more steps than fit in 32 bits.
    assert_eq!(bench.order(by(i32::MAX)), Err(Error::IllegalValue));
}

#[test]
fn with_1000_lines_a_count_is_no_whole_number_of_steps() {
    let mut bench = Bench::new(FACTORY);
    bench.motion = Motion::new(Settings { lines: 1_000, ..FACTORY });
    bench.feed(|motion, at, out| motion.power_on(at, Settings { lines: 1_000, ..COUNTS }, out));
    for (distance, count) in [(1, 1), (3, 4), (-7, -3), (4_003, 4_000), (-4_000, 0)] {
        bench.does(by(distance));
        bench.run_out();
        assert_eq!(bench.c2(), count);
    }
    // A count is 12.8 steps. After moves there and back the position is 0 again.
    assert_eq!(bench.c1(), 0);
}

#[test]
fn a_stall_is_told_when_it_is_sf_counts_behind() {
    // "The device reaches a mechanical bind at 2000 counts. The device will keep outputting steps equivalent
    // to 2030 counts" (MC 7-23).
    let mut bench = Bench::new(Settings { stall_factor: 30, ..COUNTS });
    bench.does(by(2_048));
    bench.run_to_count(2_000);
    bench.hold(true);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (2_030 * 25, 2_000));
    assert_eq!((bench.motion.has_stalled(), bench.errors()), (true, [Error::Stall].to_vec()));
    bench.feed(|motion, _, _| motion.set_stalled(false));
    assert!(!bench.motion.has_stalled());
}

#[test]
fn a_stall_backward_is_one_too() {
    let mut bench = Bench::new(COUNTS);
    bench.hold(true);
    bench.does(Order::Slew(-1_000));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (-15 * 25, 0, [Error::Stall].to_vec()));
}

#[test]
fn with_sm_it_goes_on_and_is_corrected_three_times() {
    let settings = Settings { stall_factor: 30, goes_on_stalled: true, ..COUNTS };
    let mut bench = Bench::new(settings);
    bench.does(Order::By { distance: 2_048, notify_on_end: true, continuous: false });
    bench.run_to_count(2_000);
    bench.hold(true);
    while bench.c1() <= 51_200 {
        assert!(bench.is_moving());
        bench.run(MS);
    }
    // MC 9.6, error 93.
    assert_eq!(bench.order(to(0)), Err(Error::Correcting));
    assert!(bench.is_positioning());
    bench.run_out();
    // Each of the three corrections makes the 48 counts that are missing.
    assert_eq!((bench.c1(), bench.c2()), (51_200 + 3 * 48 * 25, 2_000));
    assert_eq!(
        bench.errors(),
        [Error::Stall, Error::Stall, Error::Stall, Error::Stall, Error::PositionError]
    );
    assert!(bench.events.iter().all(|(_, event)| *event != Event::Announce));
    // "Axis will continue to function normally."
    bench.hold(false);
    bench.run(2.millis());
    let c2 = bench.c2();
    bench.does(by(100));
    bench.run_out();
    assert_eq!(bench.c2(), c2 + 100);
}

/// "When SM=1, the motor will try to continue the move. In either case ST (Stall Flag) will be set" (MC
/// 5-69).
#[test]
fn with_sm_the_shaft_goes_on_after_each_stall_and_is_corrected_at_vi() {
    let settings = Settings { goes_on_stalled: true, ..COUNTS };
    let mut bench = Bench::new(settings);
    bench.does(by(4_096));
    for (count, lost) in [(1_000, 41), (2_000, 82)] {
        bench.run(3.millis());
        bench.run_to(bench.motion.shaft().reaches_steps(bench.now, 25 * count));
        // 8,944 counts/s and more: 36 to 50 counts in 4 ms. The torque repeats every 40.96 counts.
        bench.hold(true);
        bench.run(4.millis());
        bench.hold(false);
        assert!(bench.motion.has_stalled());
        bench.feed(|motion, _, _| motion.set_stalled(false));
        bench.run(2.millis());
        let behind = bench.c1() / 25 - bench.c2();
        assert!((behind - lost).abs() <= 1, "{behind} counts behind");
        assert!(bench.v() > 8_944 && bench.is_positioning() && !bench.motion.has_stalled());
    }
    assert_eq!(bench.errors(), [Error::Stall, Error::Stall]);
    while bench.c1() < 102_400 {
        bench.run(MS);
    }
    bench.run(60.millis());
    assert_eq!(bench.v(), 40);
    bench.run_out();
    assert_eq!((bench.c1() / 25 - bench.c2(), bench.c2()), (82, 4_096));
    assert_eq!(bench.errors(), [Error::Stall, Error::Stall]);
}

/// A slew has no end at which the shaft could come into step again.
#[test]
fn with_sm_a_slew_goes_on_after_a_stall() {
    // 1 N·m at 25 % can bring 4·10⁻⁵ kg·m² up to 4.4 revolutions/s, 9,000 counts/s, within two full steps
    // (0.0628 rad). With friction it is somewhat less.
    let machine = StepperParameters { holding_unm: 1_000_000, ..StepperParameters::NOMINAL };
    for (speed, continuous) in [(2_048, true), (-8_000, true), (10_000, false), (-10_000, false)] {
        for goes_on_stalled in [false, true] {
            let mut bench = Bench::new(Settings { goes_on_stalled, machine, ..COUNTS });
            bench.does(Order::Slew(speed));
            bench.run(1.secs());
            bench.hold(true);
            bench.run(100.millis());
            assert_eq!((bench.motion.has_stalled(), bench.errors()), (true, [Error::Stall].to_vec()));
            bench.hold(false);
            bench.run(10.millis());
            let c2 = bench.c2();
            bench.run(1.secs());
            let turned = if continuous && goes_on_stalled { speed } else { 0 };
            assert!(
                (bench.c2() - c2 - turned).abs() <= 1,
                "{speed}, SM {goes_on_stalled}: {}",
                bench.c2() - c2
            );
            assert_eq!(bench.v(), if goes_on_stalled { speed } else { 0 });
        }
    }
}

#[test]
fn without_ee_nothing_is_compared() {
    let mut bench = Bench::new(Settings { maintains: true, ..SLOW });
    bench.hold(true);
    bench.does(by(5_000));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (5_000, 0, Vec::new()));
}

#[test]
fn without_its_bridge_it_stalls() {
    let mut bench = Bench::new(Settings { enabled: false, ..COUNTS });
    bench.does(by(100));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (15 * 25, [Error::Stall].to_vec()));
}

#[test]
fn a_move_within_db_is_complete() {
    let mut bench = Bench::new(COUNTS);
    bench.plug();
    bench.set(Settings { stall_factor: 65_000, ..COUNTS });
    bench.does(by(100));
    bench.run(10.millis());
    bench.edges(90);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (2_500, 90, Vec::new()));
}

#[test]
fn a_remote_encoder_counts_once_it_is_driven() {
    let mut bench = Bench::new(SLOW);
    bench.does(to(100));
    bench.run_out();
    assert_eq!(bench.c2(), 4);
    bench.plug();
    assert_eq!(bench.c2(), 4);
    bench.edges(7);
    assert_eq!(bench.c2(), 11);
    bench.edges(-10);
    assert_eq!(bench.c2(), 1);
    bench.does(to(1_100));
    bench.run_out();
    assert_eq!(bench.c2(), 1, "its own shaft does not matter");
    assert!(!bench.motion.shaft().is_on_index(bench.now));
    bench.feed(|motion, at, out| motion.channel(at, Channel::Index, Some(true), out));
    assert!(bench.motion.shaft().is_on_index(bench.now));
    bench.feed(|motion, at, _| motion.shaft_mut().unplug(at));
    bench.does(by(100));
    bench.run_out();
    assert_eq!(bench.c2(), 1 + 4);
}

#[test]
fn a_remote_encoder_that_does_not_count_is_a_stall() {
    let mut bench = Bench::new(COUNTS);
    bench.plug();
    bench.does(Order::Slew(1_000));
    bench.edges(20);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (35 * 25, 20, [Error::Stall].to_vec()));
    // The encoder counts in the wrong direction.
    let mut bench = Bench::new(COUNTS);
    bench.plug();
    bench.does(Order::Slew(40));
    bench.edges(-15);
    assert_eq!((bench.c2(), bench.errors()), (-15, [Error::Stall].to_vec()));
}

#[test]
fn position_maintenance_brings_back_what_was_forced_away() {
    let mut bench = Bench::new(Settings { maintains: true, stall_factor: 50, ..COUNTS });
    bench.plug();
    bench.does(by(0));
    bench.run_out();
    bench.edges(-10);
    assert!(!bench.is_moving(), "it is within DB");
    bench.edges(-1);
    assert_eq!((bench.c2(), bench.is_moving(), bench.is_positioning(), bench.v()), (-11, true, false, 40));
    // The correction makes 275 steps at 1,000 steps/s. The remote encoder does not turn with them.
    bench.run(300.millis());
    assert_eq!(bench.c1(), 11 * 25);
    bench.edges(1);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (11 * 25, -10, Vec::new()));
}

#[test]
fn what_was_forced_away_by_sf_stays_there_unless_sm_says_no() {
    for goes_on_stalled in [false, true] {
        let mut bench = Bench::new(Settings { maintains: true, deadband: 20, goes_on_stalled, ..COUNTS });
        bench.plug();
        bench.edges(21);
        assert_eq!((bench.is_moving(), bench.motion.has_stalled()), (goes_on_stalled, !goes_on_stalled));
        assert_eq!(bench.errors(), if goes_on_stalled { Vec::new() } else { [Error::Stall].to_vec() });
    }
}

#[test]
fn nothing_is_maintained_without_pm() {
    let mut bench = Bench::new(COUNTS);
    bench.plug();
    bench.edges(12);
    assert!(!bench.is_moving());
    bench.set(Settings { maintains: true, ..COUNTS });
    assert!(!bench.is_moving(), "where it stands is what is kept");
    bench.edges(11);
    assert!(bench.is_moving());
}

#[test]
fn a_move_that_began_without_ee_is_not_corrected() {
    let mut bench = Bench::new(Settings { settle_ms: 50, ..FACTORY });
    bench.does(to(51_200));
    bench.run(100.millis());
    bench.set(COUNTS);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2(), bench.errors()), (51_200, 2_048, Vec::new()));
}

#[test]
fn escape_while_it_settles_leaves_it_where_it_is() {
    let mut bench = Bench::new(Settings { stall_factor: 65_000, settle_ms: 500, ..COUNTS });
    bench.hold(true);
    bench.does(by(100));
    while bench.v() != 0 || bench.c1() == 0 {
        bench.run(MS);
    }
    bench.feed(|motion, at, out| motion.halt(at, out));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (2_500, Vec::new()));
}

/// 1 N·m at 3 A, without friction. A speed of 100 rpm takes a thirtieth of the torque, because none is left
/// at 3,000 rpm.
const LOADED: Settings = Settings {
    run_percent: 25,
    machine: StepperParameters {
        holding_unm: 1_000_000,
        friction_unm: 0,
        inertia_gcm2: 1,
        ..StepperParameters::NOMINAL
    },
    ..COUNTS
};

/// The motor has 40 % of 1 N·m, and a quarter less at 750 rpm of 3,000: as much as the friction. 750 rpm are
/// 12.5 revolutions/s of 2,048 counts.
#[test]
fn friction_stalls_a_motor_that_is_too_fast() {
    let machine = StepperParameters { friction_unm: 300_000, ..LOADED.machine };
    let settings = Settings { run_percent: 40, machine, ..LOADED };
    for (speed, stalls) in [(25_500, false), (25_700, true)] {
        let mut bench = Bench::new(settings);
        bench.does(Order::Slew(speed));
        bench.run(3.secs());
        let errors = if stalls { [Error::Stall].to_vec() } else { Vec::new() };
        assert_eq!(
            (bench.motion.has_stalled(), bench.errors(), bench.is_moving()),
            (stalls, errors, !stalls)
        );
        assert_eq!(bench.v(), if stalls { 0 } else { speed });
    }
}

/// 20,000 g·cm² times 40,000 counts/s² is 2 g·m² times 122.7 rad/s²: 245.4 mN·m. At standstill 25 % give 250
/// mN·m.
#[test]
fn inertia_stalls_a_motor_that_speeds_up() {
    let settings = |inertia_gcm2, up| Settings {
        start: 1,
        up,
        down: up,
        machine: StepperParameters { inertia_gcm2, ..LOADED.machine },
        ..LOADED
    };
    for (inertia_gcm2, up, stalls) in
        [(20_500, 40_000, true), (20_500, 20_000, false), (10_000, 40_000, false)]
    {
        let mut bench = Bench::new(settings(inertia_gcm2, up));
        bench.does(by(20_480));
        bench.run_out();
        assert_eq!(bench.motion.has_stalled(), stalls, "{inertia_gcm2} g·cm² by {up} counts/s²");
        assert_eq!(bench.c2() == 20_480, !stalls);
    }
}

/// With EE = 0 the drive does not notice a stall: the shaft is in step again four full steps or more behind.
#[test]
fn a_load_loses_steps_in_open_loop() {
    // Upwards 300 mN·m are needed and 250 are available. At rest friction helps to hold, 350 mN·m.
    let machine = StepperParameters { load_unm: 200_000, friction_unm: 100_000, ..LOADED.machine };
    let settings = Settings { machine, closed: false, hold_percent: 25, ..FACTORY };
    let mut bench = Bench::new(settings);
    bench.does(by(-51_200));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (-51_200, -2_048), "the load helps");
    bench.does(by(51_200));
    bench.run_out();
    bench.run(20.millis());
    assert_eq!((bench.c1(), bench.errors()), (0, Vec::new()));
    let lost = -bench.c2() * 25;
    assert!(lost >= 51_200, "{lost} steps");
    // Without the load no more steps are lost.
    bench.set(Settings { machine: LOADED.machine, ..settings });
    bench.does(by(51_200));
    bench.run_out();
    assert!((bench.c2() * 25 - (51_200 - lost)).abs() <= 25);
}

/// Settings for a shaft at rest, and the torque that holds it, in µN·m: of 1 N·m at 3 A, with 10 mN·m of
/// friction.
fn releases() -> [(Settings, u32); 4] {
    let machine = StepperParameters { holding_unm: 1_000_000, ..StepperParameters::NOMINAL };
    let rests = Settings { machine, ..COUNTS };
    [
        (Settings { hold_percent: 5, ..rests }, 60_000),
        (Settings { hold_percent: 40, ..rests }, 410_000),
        (Settings { hold_percent: 0, ..rests }, 10_000),
        (Settings { enabled: false, ..rests }, 10_000),
    ]
}

/// "The hold current must be sufficient to overcome an outside force" (MC 7-23). DE 0 means no current (MC
/// 5-19).
#[test]
fn a_load_turns_a_shaft_at_rest_that_nothing_holds() {
    for (settings, holds) in releases() {
        for (load, turns) in [(-1, 0), (1, 1), (100_000, 1)] {
            for way in [1, -1] {
                let mut bench = Bench::new(settings);
                let load_unm = way * (holds.cast_signed() + load * 1_000);
                bench.set(Settings {
                    machine: StepperParameters { load_unm, ..settings.machine },
                    ..settings
                });
                bench.run(100.millis());
                // 1 mN·m at 4·10⁻⁵ kg·m² is 25 rad/s²: 40.7 of 2,048 counts in 0.1 s.
                let expected =
                    f64::from(-way * turns * load) * 25.0 * 0.005 / (2.0 * core::f64::consts::PI) * 2_048.0;
                let got = f64::from(bench.c2());
                // The maximum speed is 3,000 rpm, 102,400 counts/s.
                let is_bound = expected.abs() > 5_000.0;
                let expected = if is_bound { got.clamp(-10_240.0, 10_240.0) } else { expected };
                assert!((got - expected).abs() <= 1.0, "{holds} {load_unm}: {got}, not {expected}");
                assert!(
                    (got.abs() > 10_000.0) == is_bound
                        && (got == 0.0) == (turns == 0)
                        && got * f64::from(way) <= 0.0
                );
                assert_eq!((bench.c1(), bench.errors()), (0, Vec::new()), "nobody looks: PM is 0");
            }
        }
    }
}

/// DE is 0 for 40 ms under a load that HC holds. 40 mN·m more than friction at 4·10⁻⁵ kg·m² are 1,000 rad/s²:
/// 0.8 rad, about 260 of 2,048 counts. DE 1 brakes the shaft, and PM brings it back to within DB at VI.
#[test]
fn position_maintenance_brings_back_what_a_load_has_turned() {
    for (maintains, goes_on_stalled, stall_factor, comes_back, stalls) in [
        (true, true, 15, true, false),
        (true, false, 65_000, true, false),
        (true, false, 15, false, true),
        (false, true, 15, false, false),
    ] {
        for load_unm in [50_000, -50_000] {
            let machine =
                StepperParameters { holding_unm: 1_000_000, load_unm, ..StepperParameters::NOMINAL };
            let settings =
                Settings { machine, maintains, goes_on_stalled, stall_factor, start: 1_000, ..COUNTS };
            let settings = Settings { hold_percent: 20, ..settings };
            let mut bench = Bench::new(settings);
            bench.run(1.secs());
            assert_eq!((bench.c1(), bench.c2()), (0, 0), "held");
            bench.set(Settings { enabled: false, ..settings });
            bench.run(40.millis());
            let slid = bench.c2() * -load_unm.signum();
            assert!((258..=262).contains(&slid), "{slid} counts");
            assert_eq!(
                (bench.c1(), bench.is_moving(), bench.errors()),
                (0, false, Vec::new()),
                "without a bridge"
            );
            bench.set(settings);
            bench.run(3.secs());
            let away = bench.c2().abs();
            // With SM 1 the drive may report a stall while the shaft is braked, which takes 65 counts.
            let stalled = !bench.errors().is_empty();
            assert!(bench.errors().iter().all(|error| *error == Error::Stall));
            assert!(stalled == stalls || maintains && goes_on_stalled);
            assert_eq!((bench.motion.has_stalled(), bench.is_moving()), (stalled, false));
            assert!(if comes_back { away <= 10 } else { away > 258 }, "PM {maintains}: {away} counts away");
            // The shaft stays there.
            let c2 = bench.c2();
            bench.run(10.secs());
            assert_eq!(bench.c2(), c2);
        }
    }
}

/// Here DE stays 1, but the load is heavier than HC can hold for 50 ms. At DB + 1 counts the correction uses
/// RC, which is more.
#[test]
fn position_maintenance_takes_rc_against_a_load() {
    for way in [1, -1] {
        let machine = StepperParameters { holding_unm: 1_000_000, ..StepperParameters::NOMINAL };
        let settings =
            Settings { machine, maintains: true, goes_on_stalled: true, run_percent: 25, ..COUNTS };
        let mut bench = Bench::new(settings);
        bench.run(1.secs());
        let pushed =
            Settings { machine: StepperParameters { load_unm: way * 70_000, ..machine }, ..settings };
        bench.set(pushed);
        bench.run(50.millis());
        assert_eq!(bench.out.currents.last().map(|(.., ma)| *ma), Some(750), "RC");
        assert_eq!(bench.v() * way, 40, "it comes back at VI");
        bench.set(settings);
        bench.run(5.secs());
        assert!(bench.c2().abs() <= 10 && bench.errors().is_empty(), "{}", bench.c2());
        assert_eq!(bench.out.currents.last().map(|(.., ma)| *ma), Some(150), "HC");
    }
}

/// A motor of 400 full steps: a revolution is 102,400 steps of 1/256 and 2,048 counts. The minimum of MS is
/// EL x 8 / 400.
#[test]
fn other_full_steps_have_other_steps_in_a_turn() {
    for (steps_per_rev, steps_per_count) in [(400, 50), (100, 12), (48, 6)] {
        let machine = StepperParameters { steps_per_rev, ..StepperParameters::NOMINAL };
        let mut bench = Bench::new(FACTORY);
        bench.set(Settings { machine, ..FACTORY });
        bench.does(by(i32::from(steps_per_rev) * 256));
        bench.run_out();
        bench.run(2.millis());
        assert_eq!(bench.c2(), 2_048, "a turn");
        bench.set(Settings { machine, ..COUNTS });
        bench.does(by(2_048));
        bench.run_out();
        assert_eq!((bench.c2(), bench.errors()), (4_096, Vec::new()));
        assert_eq!(bench.c1(), 2 * i32::from(steps_per_rev) * 256);
        // With a blocked shaft the stall is detected after SF counts.
        bench.hold(true);
        bench.does(by(2_048));
        bench.run_out();
        let made = bench.c1() - 2 * i32::from(steps_per_rev) * 256;
        assert!((15 * steps_per_count..=15 * (steps_per_count + 1)).contains(&made), "{made} steps");
        assert_eq!(bench.errors(), [Error::Stall]);
    }
}
