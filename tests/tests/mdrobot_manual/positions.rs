//! Position control (p. 11, p. 15, p. 16; MDROBOT-19): 243, 244, 219, 220, 230, 171, 49, 167.

use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

/// Counts per turn of the drive's own motor: 3 counts for each of 4 poles.
const TURN: i32 = 12;

/// Result of a move.
#[derive(Debug)]
struct Way {
    /// Time in s after which the motor was within a count of its goal and stayed there.
    arrived: f64,
    /// Highest speed, in rpm.
    fastest: f64,
    /// Overshoot beyond the goal, in counts.
    beyond: i32,
    goal: i32,
}

/// Watches a move that was just commanded, for this many seconds.
fn watch(rig: &mut Rig, goal: i32, seconds: f64) -> Way {
    let sign = (goal - rig.position()).signum();
    let (mut arrived, mut fastest, mut beyond) = (None, 0.0_f64, 0);
    rig.watch(Duration::from_ticks((seconds * 16e6) as u64), 5.millis(), |rig, t| {
        let error = goal - rig.position();
        beyond = beyond.max(-error * sign);
        fastest = fastest.max(rig.shaft().abs()).max(rig.rpm().abs());
        if error.abs() > 1 {
            arrived = None;
        } else if arrived.is_none() {
            arrived = Some(t.ticks() as f64 / 16e6);
        }
    });
    let arrived = arrived.unwrap_or_else(|| panic!("it is at {}, not at {goal}", rig.position()));
    Way { arrived, fastest, beyond, goal }
}

/// Asserts four things of a move. It is at most 15 % faster than its speed. It goes at most 5 % beyond its goal. It
/// takes one to two times distance/speed. Then the motor stays at the goal.
#[track_caller]
fn assert_moves(rig: &mut Rig, goal: i32, rpm: f64) {
    let distance = f64::from((goal - rig.position()).abs());
    let least = distance / (rpm / 60.0 * f64::from(TURN));
    let way = watch(rig, goal, least * 2.0 + 3.0);
    assert!(way.fastest <= rpm * 1.15, "{way:?}: {rpm} rpm at most");
    assert!(f64::from(way.beyond) <= (distance * 0.05).max(1.0), "{way:?}: {distance} counts");
    // The position at each end is uncertain by one count.
    assert!(way.arrived >= least * (1.0 - 2.0 / distance) - 0.01, "{way:?}: not before {least} s");
    assert!(way.arrived <= least * 2.0, "{way:?}: before {} s", least * 2.0);
}

#[test]
fn page_16_moves_with_a_speed() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
    let moves =
        [(600, 600), (0, 1_000), (-1_200, 300), (-1_140, 60), (2_400, 2_000), (2_280, 100), (0, 2_500)];
    for (goal, rpm) in moves {
        rig.write_move(pid::POSI_VEL_CMD, goal, rpm);
        assert_eq!(rig.long(pid::TAR_POSI), goal);
        assert_moves(&mut rig, goal, f64::from(rpm));
    }
    assert_eq!(rig.status(), (0, 0));
}

/// Commands 243 and 244 move at MAX_RPM.
#[test]
fn page_16_moves_without_a_speed() {
    for max_rpm in [1_000, 500] {
        let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::MAX_RPM, max_rpm)]);
        for goal in [1_200, -600] {
            rig.write_long(pid::POSI_CMD, goal);
            assert_eq!(rig.long(pid::TAR_POSI), goal);
            assert_moves(&mut rig, goal, f64::from(max_rpm));
        }
        for way in [600, -900] {
            let goal = rig.position() + way;
            rig.write_long(pid::INC_POSI_CMD, way);
            assert_eq!(rig.long(pid::TAR_POSI), goal);
            assert_moves(&mut rig, goal, f64::from(max_rpm));
        }
    }
}

/// "Real target posi. = Current posi. + Incremental": an increment counts from the actual position, also
/// while the motor moves (MDROBOT-19).
#[test]
fn page_16_increments() {
    let mut rig = Rig::armed(&[]);
    for (way, rpm) in [(300, 600), (-120, 600), (-600, 1_000)] {
        let goal = rig.position() + way;
        rig.write_move(pid::INC_POSI_VEL_CMD, way, rpm);
        assert_eq!(rig.long(pid::TAR_POSI), goal);
        assert_moves(&mut rig, goal, f64::from(rpm));
    }
    rig.velocity(600);
    rig.after(2.secs());
    let goal = rig.position() + 240;
    rig.write_move(pid::INC_POSI_VEL_CMD, 240, 600);
    assert_eq!(rig.long(pid::TAR_POSI), goal);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(goal) <= 1, "{} is not {goal}", rig.position());
    // An increment during another one replaces the rest of it.
    rig.write_move(pid::INC_POSI_VEL_CMD, 1_200, 600);
    rig.after(2.secs());
    let goal = rig.position() + 120;
    rig.write_move(pid::INC_POSI_VEL_CMD, 120, 600);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(goal) <= 1, "{} is not {goal}", rig.position());
}

/// Short moves end at their goal. A long move needs the high word.
#[test]
fn page_16_distances() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
    let mut goal = 0;
    for way in [1, -1, 2, 3, 5, -7, 12, 24, -48] {
        goal += way;
        rig.write_move(pid::POSI_VEL_CMD, goal, 1_000);
        rig.after(3.secs());
        assert!(rig.position().abs_diff(goal) <= 1, "{} is not {goal}", rig.position());
    }
    // 66,000 counts at 2,500 rpm, which are 500 counts/s.
    rig.write_move(pid::POSI_VEL_CMD, -66_000, 2_500);
    assert_moves(&mut rig, -66_000, 2_500.0);
}

/// The speed of PID 219 is used without its sign (MDROBOT-19), and is limited to MAX_RPM.
#[test]
fn page_16_speeds() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::MAX_RPM, 1_000)]);
    rig.write_move(pid::POSI_VEL_CMD, 600, (-600_i16).cast_unsigned());
    assert_moves(&mut rig, 600, 600.0);
    rig.write_move(pid::POSI_VEL_CMD, 0, 3_000);
    assert_moves(&mut rig, 0, 1_000.0);
    // With speed 0 the motor does not move.
    rig.write_move(pid::POSI_VEL_CMD, 600, 0);
    rig.after(3.secs());
    assert!(rig.position().abs() <= 1, "{}", rig.position());
}

/// "RefSpeed = PV_GAIN*Position Error" (p. 15): with a lower gain the motor arrives later, with 0 never.
#[test]
fn page_15_pv_gain() {
    let mut before = 0.0;
    for gain in [20, 5, 2] {
        let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::PV_GAIN, gain)]);
        rig.write_move(pid::POSI_VEL_CMD, 600, 1_000);
        let way = watch(&mut rig, 600, 60.0);
        assert!(way.arrived > before + 0.02, "{way:?} with {gain}, {before} with more");
        before = way.arrived;
        // While it slows down, the speed is PV_GAIN rpm per count of error, up to the limit. With gain 5, 20
        // counts are 100 rpm.
        let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::PV_GAIN, gain)]);
        rig.write_move(pid::POSI_VEL_CMD, 600, 1_000);
        let most = f64::from(gain);
        rig.watch(10.secs(), 5.millis(), |rig, t| {
            let error = f64::from(600 - rig.position());
            // Allows for one count of resolution, and for the motor's time constant of 42 ms.
            let limit = (most * (error.abs() + 1.0)).min(1_000.0);
            assert!(
                rig.shaft() <= limit * 1.5 + 150.0,
                "{} rpm {error} counts before it, {t:?}",
                rig.shaft()
            );
        });
    }
    let mut rig = Rig::with(&[(pid::UI_COM, 1), (pid::PV_GAIN, 0)]);
    rig.write_long(pid::POSI_CMD, 600);
    rig.assert_stands();
    assert_eq!(rig.position(), 0);
}

/// "If motor position control error is in IN_POSITION, then the result is 1, else 0" (p. 11). The result is
/// always current, and 0 while the drive does not control the position (MDROBOT-19).
#[test]
fn page_11_in_position_ok() {
    let mut rig = Rig::armed(&[(pid::IN_POSITION, 50)]);
    assert_eq!(rig.read(pid::IN_POSITION_OK), 0, "before the first");
    rig.write_move(pid::POSI_VEL_CMD, 600, 600);
    let (mut seen, mut moving) = ([0, 0], 0);
    rig.watch(8.secs(), 3.millis(), |rig, _| {
        let ok = rig.read(pid::IN_POSITION_OK);
        let error = 600 - rig.position();
        assert_eq!(ok, u16::from(error.abs() <= 50), "{error} counts before it");
        seen[usize::from(ok)] += 1;
        moving += u16::from(ok == 1 && rig.shaft() > 30.0);
    });
    assert!(seen[0] > 100 && seen[1] > 100 && moving > 10, "{seen:?}, {moving} while it moved");
    // A change of the window takes effect at once.
    rig.write_move(pid::POSI_VEL_CMD, 600 + 1_200, 600);
    rig.after(3.secs());
    assert_eq!(rig.read(pid::IN_POSITION_OK), 0);
    rig.write(pid::IN_POSITION, 2_000);
    assert_eq!(rig.read(pid::IN_POSITION_OK), 1);
    rig.velocity(100);
    rig.after(10.millis());
    assert_eq!(rig.read(pid::IN_POSITION_OK), 0, "velocity");
    rig.write_long(pid::POSI_CMD, 0);
    rig.write(pid::TQ_OFF, 0);
    assert_eq!(rig.read(pid::IN_POSITION_OK), 0, "free");
}

/// A move by the counts of a turn makes one turn, also with another motor on the bench. The first edge of a
/// Hall sensor counts.
#[test]
fn page_17_counts_are_turns() {
    for (way, poles) in [(TURN, 4), (-TURN, 4), (1, 4), (-1, 4), (30, 10), (-90, 10)] {
        let hall_type = if poles == 4 { 0 } else { 2 };
        let (mut rig, motor) =
            Rig::turning(&[(pid::HALL_TYPE, hall_type)], |motor| motor.hall_pulses = poles / 2);
        rig.write_move(pid::INC_POSI_VEL_CMD, way, 300);
        rig.after(5.secs());
        assert!(rig.position().abs_diff(way) <= 1, "{} is not {way}", rig.position());
        let counts = rig.bench.turn(motor).revolutions * 3.0 * f64::from(poles);
        // The shaft may be anywhere within one count.
        assert!(
            (counts - f64::from(rig.position())).abs() <= 1.01,
            "{counts:.2} counts, and it says {}",
            rig.position()
        );
    }
}

/// The drive holds a position with any STOP_STATUS (MDROBOT-17), also against a load, without a time limit.
#[test]
fn page_16_it_is_held() {
    for stop_status in 0..=3 {
        for load in [0, 60_000, -60_000] {
            let (mut rig, _) =
                Rig::turning(&[(pid::STOP_STATUS, stop_status)], |motor| motor.load_unm = load);
            rig.write_move(pid::POSI_VEL_CMD, 120, 600);
            rig.after(4.secs());
            rig.watch(3.secs(), 10.millis(), |rig, _| {
                assert!(rig.position().abs_diff(120) <= 1, "{load}: {}", rig.position());
            });
        }
    }
}

/// TQ_OFF releases the shaft. The next position command is reached.
#[test]
fn page_6_tq_off_of_a_position() {
    let (mut rig, _) = Rig::turning(&[], |motor| motor.load_unm = 60_000);
    rig.write_move(pid::POSI_VEL_CMD, 120, 600);
    rig.after(4.secs());
    rig.write(pid::TQ_OFF, 0);
    rig.after(1.secs());
    assert!(rig.position() < 60, "the load turns it: {}", rig.position());
    rig.write(pid::BRAKE, 0);
    rig.after(1.secs());
    rig.write_move(pid::POSI_VEL_CMD, 0, 1_000);
    rig.after(5.secs());
    assert!(rig.position().abs() <= 1, "{}", rig.position());
}

/// A new target during a move, in the opposite direction.
#[test]
fn page_16_another_target_on_the_way() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
    rig.write_move(pid::POSI_VEL_CMD, 1_200, 600);
    rig.after(2.secs());
    rig.write_move(pid::POSI_VEL_CMD, -240, 1_000);
    let way = watch(&mut rig, -240, 8.0);
    assert!(way.beyond <= 25, "{way:?}");
    assert_eq!((way.goal, rig.long(pid::TAR_POSI)), (-240, -240));
}

/// The position is 0 after power-on (MDROBOT-6).
#[test]
fn page_16_position_after_power_on() {
    let mut rig = Rig::with(&[(pid::UI_COM, 1)]);
    rig.write_move(pid::POSI_VEL_CMD, 120, 600);
    rig.after(4.secs());
    rig.power_cycle();
    assert_eq!((rig.position(), rig.long(pid::TAR_POSI)), (0, 0));
}
