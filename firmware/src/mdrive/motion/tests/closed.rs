//! EE = 1 (MC 7.3.7, 5-18, 5-56, 5-68 to 5-70).

use super::super::Channel;
use super::*;

/// What the factory's values are in counts.
const COUNTS: Settings =
    Settings { start: 40, speed: 30_720, up: 40_000, down: 40_000, closed: true, settle_ms: 50, ..FACTORY };

impl Bench {
    /// Runs until the built-in encoder shows so many counts.
    fn run_to_count(&mut self, count: i32) {
        self.run(3.millis());
        self.run_to(self.motion.reaches_steps(self.now, 25 * count));
        // The step is made at the nearest tick.
        self.run(Duration::TICK);
        assert_eq!(self.c2(), count);
    }

    /// Makes so many edges of a remote encoder, a millisecond apart, from both channels high.
    fn edges(&mut self, edges: i32) {
        // Forward A falls first.
        let forward = [(Channel::A, false), (Channel::B, false), (Channel::A, true), (Channel::B, true)];
        for _ in 0..edges.unsigned_abs() {
            let back = edges < 0;
            self.edges -= i32::from(back);
            let (channel, level) = forward[self.edges.rem_euclid(4) as usize];
            self.edges += i32::from(!back);
            self.run(MS);
            self.tell(|motion, at, out| motion.channel(at, channel, Some(level != back), out));
        }
    }

    fn plug(&mut self) {
        for channel in [Channel::A, Channel::B] {
            self.tell(|motion, at, out| motion.channel(at, channel, Some(true), out));
        }
    }
}

#[test]
fn all_motion_is_in_counts() {
    let mut bench = Bench::new(COUNTS);
    bench.does(by(7_168));
    bench.run(900.millis());
    // As 768,000 steps/s, which are 30,720 counts/s: 3.5 turns are too few to come there.
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
    bench.tell(|motion, at, _| motion.set_counts(at, 0));
    bench.does(to(-500));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (500 * 25, -500));
    // 2^31 counts are more steps than 32 bits hold.
    assert_eq!(bench.order(by(i32::MAX)), Err(Error::IllegalValue));
}

#[test]
fn with_1000_lines_a_count_is_no_whole_number_of_steps() {
    let mut bench = Bench::new(FACTORY);
    bench.motion = Motion::new(Settings { lines: 1_000, ..FACTORY });
    bench.tell(|motion, at, out| motion.power_on(at, Settings { lines: 1_000, ..COUNTS }, out));
    for (distance, count) in [(1, 1), (3, 4), (-7, -3), (4_003, 4_000), (-4_000, 0)] {
        bench.does(by(distance));
        bench.run_out();
        assert_eq!(bench.c2(), count);
    }
    // 12.8 steps a count; there and back again leaves nothing.
    assert_eq!(bench.c1(), 0);
}

#[test]
fn a_stall_is_told_when_it_is_sf_counts_behind() {
    // "The device reaches a mechanical bind at 2000 counts. The device will keep outputting steps equivalent to 2030
    // counts" (MC 7-23).
    let mut bench = Bench::new(Settings { stall_factor: 30, ..COUNTS });
    bench.does(by(2_048));
    bench.run_to_count(2_000);
    bench.hold(true);
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (2_030 * 25, 2_000));
    assert_eq!((bench.motion.has_stalled(), bench.errors()), (true, [Error::Stall].to_vec()));
    bench.tell(|motion, _, _| motion.set_stalled(false));
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
    bench.does(Order::By { distance: 2_048, announces: true, goes_on: false });
    bench.run_to_count(2_000);
    bench.hold(true);
    while bench.c1() <= 51_200 {
        assert!(bench.is_moving());
        bench.run(MS);
    }
    // MC 9.6, 93.
    assert_eq!(bench.order(to(0)), Err(Error::Correcting));
    assert!(bench.is_positioning());
    bench.run_out();
    // 48 counts are missing, three times.
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

#[test]
fn a_correction_is_at_vi() {
    let settings = Settings { goes_on_stalled: true, ..COUNTS };
    let mut bench = Bench::new(settings);
    bench.does(by(2_048));
    bench.run_to_count(1_000);
    bench.hold(true);
    bench.run(MS);
    bench.hold(false);
    while bench.c1() < 51_200 {
        bench.run(MS);
    }
    // When the field stands the shaft falls in at the place nearest to 25,000: they are 4 full steps apart.
    bench.run(60.millis());
    assert_eq!((bench.v(), bench.c2()), (40, (51_200 - 26 * 1_024) / 25));
    bench.run_out();
    // 1,065 counts more.
    assert_eq!((bench.c1(), bench.c2()), (51_200 + 1_065 * 25, 2_048));
    assert_eq!(bench.errors(), [Error::Stall]);
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
    assert!(!bench.motion.is_on_index(bench.now));
    bench.tell(|motion, at, out| motion.channel(at, Channel::Index, Some(true), out));
    assert!(bench.motion.is_on_index(bench.now));
    bench.tell(|motion, at, _| motion.unplug(at));
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
    // The wrong way.
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
    // 275 steps at 1,000 steps/s; the encoder does not turn with them.
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
    bench.tell(|motion, at, out| motion.halt(at, out));
    bench.run_out();
    assert_eq!((bench.c1(), bench.errors()), (2_500, Vec::new()));
}

/// 1 N·m at 3 A, and no pull but of what is said. 100 rpm of 3,000 take a thirtieth of it.
const LOADED: Settings = Settings {
    run_percent: 25,
    machine: Parameters { holding_unm: 1_000_000, friction_unm: 0, inertia_gcm2: 1, ..Parameters::NOMINAL },
    ..COUNTS
};

/// 40 % of 1 N·m, less a third at 750 rpm of 3,000, which are 12.5 turns/s of 2,048 counts.
#[test]
fn friction_stalls_a_motor_that_is_too_fast() {
    let machine = Parameters { friction_unm: 300_000, ..LOADED.machine };
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

/// 20,000 g·cm² by 40,000 counts/s² are 2 g·m² by 122.7 rad/s²: 245.4 mN·m of the 250 that 25 % are at standstill.
#[test]
fn inertia_stalls_a_motor_that_speeds_up() {
    let settings = |inertia_gcm2, up| Settings {
        start: 1,
        up,
        down: up,
        machine: Parameters { inertia_gcm2, ..LOADED.machine },
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

/// Without EE nobody looks: the shaft falls in again, four full steps or more behind.
#[test]
fn a_load_loses_steps_in_open_loop() {
    let machine = Parameters { load_unm: 200_000, friction_unm: 100_000, ..LOADED.machine };
    let settings = Settings { machine, closed: false, ..FACTORY };
    let mut bench = Bench::new(settings);
    bench.does(by(-51_200));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2()), (-51_200, -2_048), "the load helps");
    bench.does(by(51_200));
    bench.run_out();
    bench.run(MS);
    assert_eq!((bench.c1(), bench.errors()), (0, Vec::new()));
    let lost = -bench.c2() * 25;
    assert!(lost >= 4 * 256, "{lost} steps");
    // The load goes, and nothing more is lost.
    bench.set(Settings { machine: LOADED.machine, ..settings });
    bench.does(by(51_200));
    bench.run_out();
    assert_eq!((bench.c1(), bench.c2() * 25), (51_200, 51_200 - lost));
}
