//! HM and HI (MC 5-29 to 5-31).

use super::*;

/// A track with a home switch that is active from `switch.0` up to `switch.1`, and limits that are active
/// below `limits.0` and from `limits.1` on, all in steps.
struct Track {
    bench: Bench,
    switch: (i32, i32),
    limits: (i32, i32),
}

impl Track {
    /// Begins at rest at `from`.
    fn new(settings: Settings, from: i32, switch: (i32, i32)) -> Self {
        let mut bench = Bench::new(settings);
        bench.feed(|motion, at, _| motion.shaft_mut().set_steps(at, from));
        let mut track = Self { bench, switch, limits: (i32::MIN, i32::MAX) };
        track.look();
        track
    }

    fn look(&mut self) {
        let position = self.bench.c1();
        for (contact, active) in [
            (Contact::Home, position >= self.switch.0 && position < self.switch.1),
            (Contact::MinusLimit, position < self.limits.0),
            (Contact::PlusLimit, position >= self.limits.1),
        ] {
            self.bench.contact(contact, active);
        }
    }

    /// Time of the next possible change of a contact, if the plan does not change.
    fn next_change(&self) -> Instant {
        let (switch, limits) = (self.switch, self.limits);
        let edges = [switch.0 - 1, switch.0, switch.1 - 1, switch.1, limits.0, limits.1, limits.1 - 1];
        let edges = edges.into_iter().chain([limits.0.wrapping_sub(1)]);
        edges.map(|edge| self.bench.motion.shaft().reaches(self.bench.now, edge)).min().unwrap()
    }

    /// Runs until the motor is at rest. Returns the lowest and the highest position.
    fn run_out(&mut self) -> (i32, i32) {
        let mut range = (self.bench.c1(), self.bench.c1());
        let end = self.bench.now + 100.secs();
        while self.bench.is_moving() {
            let next = self.next_change().min(self.bench.motion.deadline());
            assert!(next <= end, "{:?}", self.bench.motion.activity);
            self.bench.run_to(next);
            self.look();
            range = (range.0.min(self.bench.c1()), range.1.max(self.bench.c1()));
        }
        range
    }
}

/// End positions of the four kinds: off the switch, on the side to which they creep. Kinds 1 and 2 search
/// backward, kinds 1 and 4 creep forward. The contact of this track changes when a step is made, and the
/// motion ends with the next step.
fn ends(switch: (i32, i32)) -> [(u8, i32); 4] {
    [(1, switch.1 + 1), (2, switch.0 - 2), (3, switch.0 - 2), (4, switch.1 + 1)]
}

/// Start position from which this kind searches towards the switch.
fn start(kind: u8) -> i32 {
    if kind <= 2 { 20_000 } else { -20_000 }
}

#[test]
fn homing_ends_at_the_edge_to_which_it_creeps() {
    // "Deceleration rate is short enough": the ramp has 1,200 steps, the switch 3,000.
    for (kind, end) in ends((0, 3_000)) {
        let mut track = Track::new(SLOW, start(kind), (0, 3_000));
        track.bench.does(Order::Home(kind));
        assert!(track.bench.is_moving() && !track.bench.is_positioning());
        let (least, most) = track.run_out();
        assert_eq!((track.bench.c1(), track.bench.errors()), (end, Vec::new()), "HM {kind}");
        // The motor was never off the switch on the far side.
        let (near, far) = if kind <= 2 { (most, least) } else { (least, most) };
        assert_eq!(near, start(kind), "HM {kind}");
        assert!((-2..=3_001).contains(&far), "HM {kind}: {far}");
    }
}

#[test]
fn what_overshoots_the_switch_comes_back() {
    // The ramp has 1,200 steps, the switch 100.
    for (kind, end) in ends((0, 100)) {
        let mut track = Track::new(Settings { settle_ms: 30, ..SLOW }, start(kind), (0, 100));
        track.bench.does(Order::Home(kind));
        let (least, most) = track.run_out();
        assert_eq!((track.bench.c1(), track.bench.errors()), (end, Vec::new()), "HM {kind}");
        if kind <= 2 {
            // The switch became active at 99.
            assert_eq!((least, most), (99 - 1_200, start(kind)), "HM {kind}");
        } else {
            assert_eq!((least, most), (start(kind), 1_200), "HM {kind}");
        }
    }
}

/// Motions of a homing, in order: direction (true for backward) and maximum speed in steps/s.
fn motions(track: &Track) -> Vec<(bool, i64)> {
    let of = |(.., plan): &(Instant, Axis, Plan)| {
        let most = plan
            .segments()
            .iter()
            .filter(|segment| segment.ticks > 0)
            .max_by_key(|segment| segment.start_speed)?;
        // The end speed of a segment is the start speed of the next one.
        (most.start_speed > 0).then_some((most.reverse, most.start_speed / 16_000_000))
    };
    track.bench.out.plans.iter().filter_map(of).collect()
}

/// Figure 5.1: S is the direction of the search, C the direction of the creep.
#[test]
fn the_motions_are_those_of_figure_5_1() {
    for (kind, s, c) in [(1, true, false), (2, true, true), (3, false, true), (4, false, false)] {
        for settle_ms in [0, 50] {
            // Motions 1 and 2: slew, deceleration. Motions 3 and 4: creep, and the step at its end.
            let mut track = Track::new(Settings { settle_ms, ..SLOW }, start(kind), (0, 3_000));
            track.bench.out.plans.clear();
            track.bench.does(Order::Home(kind));
            track.run_out();
            assert_eq!(motions(&track), [(s, 5_000), (s, 5_000), (c, 1_000), (c, 1_000)], "HM {kind}");

            // After an overshoot the motor searches backward: 1,100 steps at up to √(1,000² + 1,100 · 10,000)
            // steps/s, then continues at VI.
            let mut track = Track::new(Settings { settle_ms, ..SLOW }, start(kind), (0, 100));
            track.bench.out.plans.clear();
            track.bench.does(Order::Home(kind));
            track.run_out();
            let motions = motions(&track);
            let [search, slow, back, seek, meet, creep, end] = motions[..] else { panic!("{motions:?}") };
            assert_eq!([search, slow], [(s, 5_000); 2], "HM {kind}");
            assert!(back.0 != s && (3_400..3_500).contains(&back.1), "HM {kind}: {back:?}");
            assert_eq!([seek, meet], [(!s, 1_000); 2], "HM {kind}");
            assert_eq!([creep, end], [(c, 1_000); 2], "HM {kind}");
        }
    }
}

#[test]
fn the_creep_is_at_vi() {
    let mut track = Track::new(SLOW, 20_000, (0, 3_000));
    track.bench.does(Order::Home(1));
    // To 2,999: a ramp of 1,200 steps in 0.4 s, then 15,801 at 5,000 steps/s. On the switch 0.4 s and 1,200
    // steps.
    let stands = 0.4 + 15_801.0 / 5_000.0 + 0.4;
    track.run_out();
    // Then 1 ms until the switch is checked, 1,201 steps to its edge at 1,000 steps/s, and one more step.
    let seconds = track.bench.now.since(Instant::ZERO).ticks() as f64 / 16e6;
    assert!((seconds - stands - 1.203).abs() < 0.001, "{seconds}");
}

#[test]
fn what_begins_on_the_switch_only_creeps() {
    for (kind, end) in ends((0, 100)) {
        let mut track = Track::new(SLOW, 50, (0, 100));
        track.bench.does(Order::Home(kind));
        track.run_out();
        assert_eq!(track.bench.c1(), end, "HM {kind}");
    }
}

#[test]
fn a_switch_that_is_told_late_is_found_all_the_same() {
    // The debounce time is 20 ms, which are 100 steps at VM.
    for (kind, end) in ends((0, 300)) {
        let mut track = Track::new(SLOW, start(kind), (0, 300));
        track.bench.does(Order::Home(kind));
        let late = 20.millis();
        let mut changes = std::collections::VecDeque::new();
        let mut level = false;
        while track.bench.is_moving() {
            let told = changes.front().map_or(Instant::NEVER, |(at, _)| *at);
            let next = track.next_change().min(track.bench.motion.deadline()).min(told);
            assert!(next <= Instant::from(60.secs()));
            track.bench.run_to(next);
            let now = (track.switch.0..track.switch.1).contains(&track.bench.c1());
            if now != level {
                level = now;
                changes.push_back((next + late, now));
            }
            while let Some((_, active)) = changes.pop_front_if(|(at, _)| *at <= next) {
                track.bench.contact(Contact::Home, active);
            }
        }
        // At VI the last edge is detected 20 steps late.
        let end = if matches!(kind, 1 | 4) { end + 20 } else { end - 20 };
        assert!((track.bench.c1() - end).abs() <= 1, "HM {kind}: {}", track.bench.c1());
    }
}

#[test]
fn a_limit_turns_homing_round_once() {
    for limit_mode in [1, 4] {
        // The switch is behind the start: the search begins away from it.
        let mut track = Track::new(Settings { limit_mode, ..SLOW }, -5_000, (0, 3_000));
        track.limits = (-8_000, 8_000);
        track.bench.does(Order::Home(1));
        let (least, _) = track.run_out();
        assert_eq!((track.bench.c1(), track.bench.errors()), (3_001, Vec::new()), "LM {limit_mode}");
        assert_eq!(least, -8_001 - if limit_mode == 1 { 1_200 } else { 1 });
    }
}

#[test]
fn homing_between_two_limits_without_a_switch_is_error_82() {
    for (limit_mode, furthest) in [(1, 9_200), (4, 8_001)] {
        let mut track = Track::new(Settings { limit_mode, ..SLOW }, 0, (100_000, 100_001));
        track.limits = (-8_000, 8_000);
        track.bench.does(Order::Home(1));
        track.run_out();
        assert_eq!((track.bench.c1(), track.bench.errors()), (furthest, [Error::BothLimits].to_vec()));
    }
}

#[test]
fn other_limit_modes_end_homing() {
    for limit_mode in [2, 3, 5, 6] {
        let mut track = Track::new(Settings { limit_mode, ..SLOW }, 0, (100_000, 100_001));
        track.limits = (-8_000, 8_000);
        track.bench.does(Order::Home(3));
        track.run_out();
        let ramp = if limit_mode < 4 { 1_200 } else { 1 };
        assert_eq!((track.bench.c1(), track.bench.errors()), (8_000 + ramp, [Error::PlusLimit].to_vec()));
    }
}

#[test]
fn homing_from_a_held_limit_goes_the_other_way() {
    let mut track = Track::new(SLOW, -9_000, (0, 3_000));
    track.limits = (-8_000, 8_000);
    track.look();
    track.bench.does(Order::Home(2));
    track.run_out();
    assert_eq!((track.bench.c1(), track.bench.errors()), (-2, Vec::new()));
}

#[test]
fn homing_is_alone() {
    // MC 9.6: errors 85 and 81.
    let mut track = Track::new(SLOW, 20_000, (0, 3_000));
    assert_eq!(track.bench.order(Order::Home(0)), Err(Error::HomeType));
    assert_eq!(track.bench.order(Order::HomeToIndex(5)), Err(Error::HomeType));
    track.bench.does(to(0));
    assert_eq!(track.bench.order(Order::Home(1)), Err(Error::Homing));
    track.bench.does(Order::Slew(0));
    track.bench.does(Order::Home(1));
    for order in [to(0), by(1), Order::Home(1), Order::HomeToIndex(2)] {
        assert_eq!(track.bench.order(order), Err(Error::Homing), "{order:?}");
    }
    track.bench.run(1.secs());
    track.bench.does(Order::Slew(0));
    track.bench.run_out();
    // The ramps and the cruise have 1,200 + 3,000 + 1,200 steps.
    assert_eq!(track.bench.c1(), 20_000 - 5_400);
}

#[test]
fn a_paused_homing_begins_anew() {
    let mut track = Track::new(SLOW, 20_000, (0, 3_000));
    track.bench.does(Order::Home(1));
    track.bench.run(1.secs());
    track.bench.feed(|motion, at, out| motion.pause(at, out));
    track.run_out();
    track.bench.feed(|motion, at, out| motion.resume(at, out));
    track.run_out();
    assert_eq!(track.bench.c1(), 3_001);
}

/// The index is one count wide: 25 steps.
#[test]
fn homing_to_the_index_ends_just_off_it() {
    for kind in 1..=4 {
        for settings in [SLOW, FACTORY] {
            let mut bench = Bench::new(settings);
            bench.does(by(30_000));
            bench.run_out();
            assert!(!bench.motion.shaft().is_on_index(bench.now));
            bench.does(Order::HomeToIndex(kind));
            bench.run_out();
            bench.run(2.millis());
            assert_eq!(bench.errors(), Vec::new());
            // The end is the next step off the index, some revolutions away: forward at 25 or 26, backward at
            // −1 or −2.
            let off = bench.c1().rem_euclid(51_200);
            let off_it = if matches!(kind, 1 | 4) { [25, 26] } else { [51_199, 51_198] };
            assert!(off_it.contains(&off), "HI {kind}: {}", bench.c1());
            assert!(!bench.motion.shaft().is_on_index(bench.now));
        }
    }
}

#[test]
fn the_index_is_a_count_wide() {
    let mut bench = Bench::new(SLOW);
    let mut on = Vec::new();
    for position in [-26, -1, 0, 1, 24, 25, 51_199, 51_200, 51_224, 51_225] {
        bench.does(to(position));
        bench.run_out();
        bench.run(2.millis());
        if bench.motion.shaft().is_on_index(bench.now) {
            on.push(position);
        }
    }
    assert_eq!(on, [0, 1, 24, 51_200, 51_224]);
}
