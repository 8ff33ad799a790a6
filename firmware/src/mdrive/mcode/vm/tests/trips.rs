//! Trips (MC 5-71 to 5-76).

use std::format;

use super::*;

#[test]
fn a_position_interrupts_a_hold() {
    let mut bed = Bed::with(
        "LB G1; P=0; R1=0; TP=20000,K1; TE=2; SL 10000; H; R2=P; E
         LB K1; R1=R1+1; SL 0; RT",
    );
    bed.run();
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::PC)), (1, 0, 0));
    // 6.3 steps until SL 0, the third line of the subroutine; 49.5 from 10,000 steps/s down to VI.
    assert_eq!(bed.get(Reg::R2), 20_055);
}

/// It trips where it is passed, and not where it begins.
#[test]
fn a_position_trips_when_it_comes() {
    let mut bed = Bed::with("LB K1; IC R1; RT");
    bed.commands("P=0; TP=0,K1; TE=2");
    bed.wait(10.millis());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::BY)), (2, 0));
    bed.commands("MR -2000");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::R1)), (2, 0));
    bed.commands("MR 3000");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::R1), bed.get(Reg::EF)), (0, 1, 0));
    // A position that is another one now is none of those that were planned.
    bed.commands("TP=5000,K1; TE=2; MR 2000; P=4000");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::R1), bed.get(Reg::P)), (0, 2, 6_000));
}

#[test]
fn a_time_trips_once() {
    let mut bed = Bed::with("LB K1; IC R1; RT; LB G1; IC R2; BR G1");
    assert_eq!(bed.command("TE=8"), Err(Error::TripNotDefined));
    bed.commands("TT=2000,K1; TE=8");
    bed.wait(2.secs() - Duration::TICK);
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::BY)), (8, 0));
    bed.wait(Duration::TICK);
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::BY)), (0, 1));
    bed.lines(3);
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::BY)), (1, 0));
    bed.wait(10.secs());
    assert_eq!(bed.get(Reg::R1), 1);

    // Of a program that runs the line ends first.
    bed.commands("TT=1,K1; EX G1; TE=8");
    bed.wait(1_050.micros() - Duration::TICK);
    assert_eq!(bed.get(Reg::R1), 1);
    bed.lines(2);
    assert_eq!(bed.get(Reg::R1), 1);
    bed.wait(Duration::TICK);
    assert_eq!(bed.get(Reg::R1), 2);
    bed.lines(3);
    assert_eq!(bed.get(Reg::BY), 1);
    bed.commands("E");
}

/// What a time trips is called within an H, whose own time goes on meanwhile.
#[test]
fn the_time_of_a_hold_goes_on_during_a_trip() {
    let mut bed = Bed::with("TT=10,K1; TE=8; H 100; R2=1; E; LB K1; R1=1; RT");
    bed.commands("EX 1");
    bed.wait(210.micros() * 3 + 100.millis() + 210.micros() - Duration::TICK);
    assert_eq!(bed.r(), [1, 0, 0, 0]);
    bed.wait(Duration::TICK);
    assert_eq!(bed.r(), [1, 1, 0, 0]);
}

/// "TE must be re-enabled": within its subroutine it may be (MC 8.2).
#[test]
fn trips_are_defined_before_they_are_enabled() {
    let mut bed = Bed::with("LB K1; RT");
    for (line, error) in [
        ("TE=1", 27),
        ("TE=32", 27),
        ("TE=64", 21),
        ("TI=5,K1", 12),
        ("TI=-1,K1", 12),
        ("TI=1", 38),
        ("TI=1,0", 42),
        ("TT=5", 38),
        ("TT=65536,K1", 21),
        ("TP=5,K9", 30),
        ("TP=5,7", 42),
        ("TP=5,768", 42),
        ("TP=5,2048", 42),
        ("TR=5,K1,65001", 21),
        ("TR=5,K1,-1", 21),
    ] {
        assert_eq!(bed.command(line).map_err(|it| it as u8), Err(error), "{line}");
        assert_eq!(bed.get(Reg::TE), 0);
    }
    bed.commands("TI=1,K1; TP=5,K1; TC=K1; TT=1000,1; TR=100,K1,3; TE=15");
    for line in ["TE=18", "TE=16"] {
        assert_eq!(bed.command(line), Err(Error::TripsTogether), "{line}");
    }
    assert_eq!(bed.get(Reg::TE), 15);
    bed.commands("TE=0; TE=16; TI=0");
    assert_eq!(bed.command("TE=17"), Err(Error::TripNotDefined));
    bed.commands("TE=0; TR=0,0,0");
    assert_eq!(bed.command("TE=16"), Err(Error::TripNotDefined));
    // As PR AL prints it.
    bed.commands("TE=8; TT = 0, 0");
    assert_eq!(bed.get(Reg::TE), 0);
    assert_eq!(bed.command("TE=8"), Err(Error::TripNotDefined));
}

/// "Only the activated trip function needs to be re-enabled, the other trips will still be enabled" (MC 5-73).
#[test]
fn a_trip_is_enabled_beside_others() {
    let mut bed = Bed::with("LB K1; IC R1; TE=8; RT; LB K2; IC R2; RT");
    bed.commands("TI=1,K2; TT=10,K1; TE=9");
    bed.wait(35.millis());
    assert_eq!((bed.r(), bed.get(Reg::TE)), ([3, 0, 0, 0], 9));
    bed.level(IO1, false);
    bed.wait(1.millis());
    assert_eq!((bed.r(), bed.get(Reg::TE)), ([3, 1, 0, 0], 8));
    bed.commands("TE=0");
    assert_eq!(bed.get(Reg::TE), 0);
}

/// "Illegal Trip / Capture" (MC 9.1).
#[test]
fn an_output_does_not_trip() {
    let mut bed = Bed::with("LB K1; RT");
    bed.commands("S1=16,0,0; S2=17,0,0; S13=61,0");
    for line in ["TI=1,K1", "TI=2,K1", "TC=K1"] {
        assert_eq!(bed.command(line), Err(Error::IllegalTrip), "{line}");
    }
    bed.commands("S1=0,0,0; S2=5,0,0; S13=60,0; TI=1,K1; TI=2,K1; TC=K1; S2=16,0,0; S13=61,0");
    for line in ["TE=1", "TE=4"] {
        assert_eq!(bed.command(line), Err(Error::IllegalTrip), "{line}");
        assert_eq!(bed.get(Reg::TE), 0);
    }
    bed.commands("S2=0,0,0; S13=60,0; TE=5");
}

/// "TR=512000,K2,27: Run Sub K2 when at 512000 rel, repeat 27 times" (MC 5-75).
#[test]
fn a_distance_trips_as_often_as_it_is_told() {
    let mut bed = Bed::with("LB K2; IC R1; RT");
    bed.commands("P=500; TR=10000,K2,3; TE=16; SL 100000");
    bed.wait(10.secs());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::PC)), (3, 0, 30_500));
    bed.commands("R1=0; TR=10000,K2; TE=16");
    bed.wait(10.secs());
    assert_eq!(bed.get(Reg::TE), 16);
    assert!((95..=105).contains(&bed.get(Reg::R1)), "{}", bed.get(Reg::R1));
    bed.commands("TE=0; SL 0");
    bed.wait(10.secs());
    bed.commands("R1=0; P=0; TR=-1000,K2,2; TE=16; MR 5000");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE)), (0, 16));
    bed.commands("MA -5000");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::PC)), (2, 0, -2_000));
}

/// A subroutine without an end calls itself again and again: 43, and the program ends (MC 9.3).
#[test]
fn trips_that_never_return_overflow_the_stack() {
    let mut bed = Bed::with("LB K1; TT=1,K1; TE=8; LB K2; BR K2");
    bed.commands("CL K1");
    bed.run_to_end();
    assert_eq!((bed.get(Reg::ER), bed.get(Reg::BY)), (43, 0));
}

/// "Activation will occur upon any trip function EXCEPT a position trip" (MC 5-55); the input is active low.
#[test]
fn inputs_trip_and_capture() {
    let mut bed = Bed::with("LB K1; IC R1; RT");
    bed.commands("TI=2,K1; TC=K1; TE=5; SL 100000");
    bed.wait(1.secs());
    let second = Pin(1);
    bed.level(IO1, false);
    assert_eq!(bed.get(Reg::TE), 5);
    bed.level(second, false);
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::PC)), (4, bed.get(Reg::P)));
    bed.wait(100.millis());
    bed.level(CAPTURE, false);
    let there = bed.get(Reg::P);
    bed.wait(100.millis());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::PC), bed.get(Reg::R1)), (0, there, 2));
    // Only what becomes active trips, and only once.
    bed.commands("TE=1");
    bed.level(second, true);
    bed.wait(10.millis());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::R1)), (1, 2));
    bed.level(second, false);
    bed.level(second, true);
    bed.level(second, false);
    bed.wait(10.millis());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::R1), bed.get(Reg::EF)), (0, 3, 0));
}

/// LM 3: the program ends, and what OE has been told is called (MC 5-43, 5-52).
#[test]
fn a_limit_ends_the_program_and_calls_the_handler() {
    let mut bed = Bed::with("OE K9; SL 50000; H; R2=1; E; LB K9; R1=ER; RT");
    bed.commands("S1=2,0; LM=3; EX 1");
    bed.wait(500.millis());
    bed.level(IO1, false);
    bed.wait(500.millis());
    assert_eq!((bed.r(), bed.get(Reg::BY), bed.get(Reg::V)), ([83, 0, 0, 0], 0, 0));
}

/// TA's flags are additive (MC 5-71).
#[test]
fn the_state_of_a_hybrid_trips() {
    let mut bed = Bed::new(Mdrive::hybrid());
    bed.store(1, "LB K1; IC R1; RT");
    for (line, error) in [("TA=32,K1", 21), ("TA=4", 38), ("TE=32", 27)] {
        assert_eq!(bed.command(line).map_err(|it| it as u8), Err(error), "{line}");
    }
    bed.commands("TA=5,K1; TE=32");
    let mut trip = |flags| {
        let now = bed.now;
        bed.mdrive.drive.trip_on_status(now, flags, &mut bed.world);
        bed.lines(3);
        (bed.get(Reg::TE), bed.get(Reg::R1))
    };
    assert_eq!(trip(2 | 8 | 16), (32, 0));
    assert_eq!(trip(4 | 2), (0, 1));
    assert_eq!(trip(4), (0, 1));
}

/// The output pulses at the very steps, "TR=650000,0,0", and runs nothing (MC 5-75); CW is 10 times 50 ns.
#[test]
fn a_distance_without_a_subroutine_pulses() {
    let mut bed = Bed::new(Mdrive::plus());
    bed.commands("S13=61,1; P=0; SL 100000");
    bed.wait(1.secs());
    let start = bed.get(Reg::P);
    bed.world.trip_output.clear();
    bed.commands("TR=1000,0,5; TE=16");
    bed.wait(1.secs());
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::BY), bed.get(Reg::PC)), (0, 0, start + 5_000));
    let pulses: Vec<_> = bed.world.trip_output.chunks(2).collect();
    assert_eq!(pulses.len(), 5);
    let motion = &bed.drive().motion;
    for (n, pulse) in (1..).zip(pulses) {
        let &[(begin, Level::High), (end, Level::Low)] = pulse else { panic!("{pulse:?}") };
        assert_eq!(end.since(begin), Duration::from_ticks(8));
        let around = [begin - Duration::TICK, begin].map(|at| motion.steps(at));
        assert_eq!(around, [start + 1_000 * n - 1, start + 1_000 * n]);
    }
}

/// A position that is passed within a ramp, to the tick.
#[test]
fn a_position_pulses_at_its_step() {
    let mut bed = Bed::new(Mdrive::plus());
    bed.commands("S13=61,0; TP=-777; TE=2");
    bed.world.trip_output.clear();
    bed.commands("MR -20000");
    bed.wait(100.millis());
    let &[(begin, Level::Low), (_, Level::High)] = bed.world.trip_output.as_slice() else {
        panic!("{:?}", bed.world.trip_output)
    };
    let motion = &bed.drive().motion;
    assert_eq!([begin - Duration::TICK, begin].map(|at| motion.steps(at)), [-776, -777]);
    assert_eq!((bed.get(Reg::TE), bed.get(Reg::PC)), (0, 0));
}

/// TR "will always use motor counts unless the encoder is enabled" (MC 5-75): 512 lines, so that 25 steps are a count.
#[test]
fn a_distance_is_in_counts_with_the_encoder() {
    for sign in [1, -1] {
        let mut bed = Bed::with("LB K1; IC R1; RT");
        // C1 and C2 are apart, also by less than a count.
        bed.commands("MR 70010");
        bed.wait(1.secs());
        bed.commands("EE=1; P=500");
        bed.commands(&format!("TR={},K1,3; TE=16; MR {}", sign * 1_000, sign * 2_999));
        for count in [1, 2] {
            let there = loop {
                bed.wait(Duration::TICK.max(bed.mdrive.deadline().since(bed.now)));
                if bed.get(Reg::PC) == 500 + sign * 1_000 * count {
                    break bed.now;
                }
                assert!(bed.now < Instant::ZERO + 10.secs());
            };
            let motion = &bed.drive().motion;
            assert_eq!(motion.counts(there), 500 + sign * 1_000 * count);
            assert_eq!(motion.counts(there - Duration::TICK), 500 + sign * (1_000 * count - 1));
        }
        bed.wait(2.secs());
        assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE)), (2, 16), "2,999 are not 3,000");
        bed.commands(&format!("MR {sign}"));
        bed.wait(1.secs());
        assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::ER)), (3, 0, 0));
        // A count that is another one now is none of those that were planned.
        bed.commands(&format!("TR={},K1,1; TE=16; P=P{:+}", sign * 1_000, sign * 1_000));
        bed.wait(Duration::ZERO);
        assert_eq!((bed.get(Reg::TE), bed.get(Reg::PC)), (0, 500 + sign * 4_000));
    }
}

/// What stands has no way behind it, whatever the motor's steps say.
#[test]
fn a_distance_waits_for_a_shaft_that_is_held() {
    let mut bed = Bed::with("LB K1; IC R1; RT");
    bed.commands("EE=1; SM=1; SF=65000; TR=100,K1,1; TE=16");
    bed.input(Input::Fault { fault: STALL, on: true });
    bed.commands("SL 1000");
    bed.wait(2.secs());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::P)), (0, 16, 0));
    bed.commands("SL 0");
    bed.wait(2.secs());
    bed.input(Input::Fault { fault: STALL, on: false });
    bed.commands("SL 1000");
    bed.wait(2.secs());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE), bed.get(Reg::PC)), (1, 0, 100));
}

/// A remote encoder counts on its own.
#[test]
fn a_distance_follows_a_remote_encoder() {
    let mut bed = Bed::with("LB K1; IC R1; RT");
    for pin in [A, B] {
        bed.level(pin, true);
    }
    bed.commands("EE=1; P=0; TR=-4,K1,2; TE=16");
    // Backward B falls first.
    let cycle = [(B, false), (A, false), (B, true), (A, true)];
    for (edge, (pin, high)) in (1..=8).zip(cycle.into_iter().cycle()) {
        bed.wait(1.millis());
        bed.level(pin, high);
        // FM lets pass what lasts 200 ns.
        bed.wait(1.micros());
        assert_eq!((bed.get(Reg::P), bed.get(Reg::PC)), (-edge, -(edge / 4 * 4)));
    }
    bed.wait(1.millis());
    assert_eq!((bed.get(Reg::R1), bed.get(Reg::TE)), (2, 0));
}

/// More often than 20 kHz is "the maximum rate of trip" (MC 5-75): they come late, but all of them.
#[test]
fn trips_are_not_faster_than_20_khz() {
    let mut bed = Bed::new(Mdrive::plus());
    bed.commands("S13=61,1; SL 1000000");
    bed.wait(2.secs());
    bed.world.trip_output.clear();
    bed.commands("TR=10,0,1000; TE=16");
    bed.wait(1_000.micros());
    assert_eq!(bed.world.trip_output.len(), 2 * 20);
    bed.wait(1.secs());
    assert_eq!((bed.world.trip_output.len(), bed.get(Reg::TE)), (2 * 1_000, 0));
}

/// Without an end it keeps to its distances, and does not run after a position that has outrun it.
#[test]
fn trips_without_an_end_end_with_the_motion() {
    let mut bed = Bed::new(Mdrive::plus());
    bed.commands("S13=61,1; SL 1000000");
    bed.wait(2.secs());
    bed.commands("P=0; TR=10; TE=16");
    bed.world.trip_output.clear();
    bed.wait(1.millis());
    assert_eq!(bed.world.trip_output.len(), 2 * 20);
    assert_eq!(bed.get(Reg::PC).rem_euclid(10), 0, "{}", bed.get(Reg::PC));
    bed.commands("SL 0");
    bed.wait(2.secs());
    bed.world.trip_output.clear();
    bed.wait(1.secs());
    assert_eq!((bed.world.trip_output.len(), bed.get(Reg::TE)), (0, 16));
    // A position that is written is one more, whatever its way.
    bed.commands("P=P+1000000000");
    bed.wait(1.secs());
    assert_eq!(bed.world.trip_output.len(), 2);
}
