//! Trips (MC 5-71 to 5-76).

use std::format;

use super::*;

#[test]
fn a_position_interrupts_a_hold() {
    let mut dut = Dut::with(
        "LB G1; P=0; R1=0; TP=20000,K1; TE=2; SL 10000; H; R2=P; E
         LB K1; R1=R1+1; SL 0; RT",
    );
    dut.run();
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::PC)), (1, 0, 0));
    // The motor makes 6.3 steps until SL 0, the third line of the subroutine, takes effect. It makes 49.5
    // steps from 10,000 steps/s down to VI.
    assert_eq!(dut.value(Reg::R2), 20_055);
}

/// The trip occurs when the position is reached, not if the motion begins there.
#[test]
fn a_position_trips_when_it_comes() {
    let mut dut = Dut::with("LB K1; IC R1; RT");
    dut.commands("P=0; TP=0,K1; TE=2");
    dut.wait(10.millis());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::BY)), (2, 0));
    dut.commands("MR -2000");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::R1)), (2, 0));
    dut.commands("MR 3000");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::R1), dut.value(Reg::EF)), (0, 1, 0));
    // A write of P changes the position. The trip uses the new position, not the one of the earlier plan.
    dut.commands("TP=5000,K1; TE=2; MR 2000; P=4000");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::R1), dut.value(Reg::P)), (0, 2, 6_000));
}

#[test]
fn a_time_trips_once() {
    let mut dut = Dut::with("LB K1; IC R1; RT; LB G1; IC R2; BR G1");
    assert_eq!(dut.command("TE=8"), Err(Error::TripNotDefined));
    dut.commands("TT=2000,K1; TE=8");
    dut.wait(2.secs() - Duration::TICK);
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::BY)), (8, 0));
    dut.wait(Duration::TICK);
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::BY)), (0, 1));
    dut.lines(3);
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::BY)), (1, 0));
    dut.wait(10.secs());
    assert_eq!(dut.value(Reg::R1), 1);

    // If a program runs, its present line ends first.
    dut.commands("TT=1,K1; EX G1; TE=8");
    dut.wait(1_050.micros() - Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 1);
    dut.lines(2);
    assert_eq!(dut.value(Reg::R1), 1);
    dut.wait(Duration::TICK);
    assert_eq!(dut.value(Reg::R1), 2);
    dut.lines(3);
    assert_eq!(dut.value(Reg::BY), 1);
    dut.commands("E");
}

/// The subroutine of TT is called during an H. The time of the H continues meanwhile.
#[test]
fn the_time_of_a_hold_goes_on_during_a_trip() {
    let mut dut = Dut::with("TT=10,K1; TE=8; H 100; R2=1; E; LB K1; R1=1; RT");
    dut.commands("EX 1");
    dut.wait(210.micros() * 3 + 100.millis() + 210.micros() - Duration::TICK);
    assert_eq!(dut.r(), [1, 0, 0, 0]);
    dut.wait(Duration::TICK);
    assert_eq!(dut.r(), [1, 1, 0, 0]);
}

/// "TE must be re-enabled": the subroutine may do this (MC 8.2).
#[test]
fn trips_are_defined_before_they_are_enabled() {
    let mut dut = Dut::with("LB K1; RT");
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
        assert_eq!(dut.command(line).map_err(|it| it as u8), Err(error), "{line}");
        assert_eq!(dut.value(Reg::TE), 0);
    }
    dut.commands("TI=1,K1; TP=5,K1; TC=K1; TT=1000,1; TR=100,K1,3; TE=15");
    for line in ["TE=18", "TE=16"] {
        assert_eq!(dut.command(line), Err(Error::TripsTogether), "{line}");
    }
    assert_eq!(dut.value(Reg::TE), 15);
    dut.commands("TE=0; TE=16; TI=0");
    assert_eq!(dut.command("TE=17"), Err(Error::TripNotDefined));
    dut.commands("TE=0; TR=0,0,0");
    assert_eq!(dut.command("TE=16"), Err(Error::TripNotDefined));
    // In the format that PR AL prints.
    dut.commands("TE=8; TT = 0, 0");
    assert_eq!(dut.value(Reg::TE), 0);
    assert_eq!(dut.command("TE=8"), Err(Error::TripNotDefined));
}

/// "Only the activated trip function needs to be re-enabled, the other trips will still be enabled" (MC
/// 5-73).
#[test]
fn a_trip_is_enabled_beside_others() {
    let mut dut = Dut::with("LB K1; IC R1; TE=8; RT; LB K2; IC R2; RT");
    dut.commands("TI=1,K2; TT=10,K1; TE=9");
    dut.wait(35.millis());
    assert_eq!((dut.r(), dut.value(Reg::TE)), ([3, 0, 0, 0], 9));
    dut.level(IO1, false);
    dut.wait(1.millis());
    assert_eq!((dut.r(), dut.value(Reg::TE)), ([3, 1, 0, 0], 8));
    dut.commands("TE=0");
    assert_eq!(dut.value(Reg::TE), 0);
}

/// "Illegal Trip / Capture" (MC 9.1).
#[test]
fn an_output_does_not_trip() {
    let mut dut = Dut::with("LB K1; RT");
    dut.commands("S1=16,0,0; S2=17,0,0; S13=61,0");
    for line in ["TI=1,K1", "TI=2,K1", "TC=K1"] {
        assert_eq!(dut.command(line), Err(Error::IllegalTrip), "{line}");
    }
    dut.commands("S1=0,0,0; S2=5,0,0; S13=60,0; TI=1,K1; TI=2,K1; TC=K1; S2=16,0,0; S13=61,0");
    for line in ["TE=1", "TE=4"] {
        assert_eq!(dut.command(line), Err(Error::IllegalTrip), "{line}");
        assert_eq!(dut.value(Reg::TE), 0);
    }
    dut.commands("S2=0,0,0; S13=60,0; TE=5");
}

/// "TR=512000,K2,27: Run Sub K2 when at 512000 rel, repeat 27 times" (MC 5-75).
#[test]
fn a_distance_trips_as_often_as_it_is_told() {
    let mut dut = Dut::with("LB K2; IC R1; RT");
    dut.commands("P=500; TR=10000,K2,3; TE=16; SL 100000");
    dut.wait(10.secs());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::PC)), (3, 0, 30_500));
    dut.commands("R1=0; TR=10000,K2; TE=16");
    dut.wait(10.secs());
    assert_eq!(dut.value(Reg::TE), 16);
    assert!((95..=105).contains(&dut.value(Reg::R1)), "{}", dut.value(Reg::R1));
    dut.commands("TE=0; SL 0");
    dut.wait(10.secs());
    dut.commands("R1=0; P=0; TR=-1000,K2,2; TE=16; MR 5000");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE)), (0, 16));
    dut.commands("MA -5000");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::PC)), (2, 0, -2_000));
}

/// A subroutine that never returns is called again and again: error 43, and the program ends (MC 9.3).
#[test]
fn trips_that_never_return_overflow_the_stack() {
    let mut dut = Dut::with("LB K1; TT=1,K1; TE=8; LB K2; BR K2");
    dut.commands("CL K1");
    dut.run_to_end();
    assert_eq!((dut.value(Reg::ER), dut.value(Reg::BY)), (43, 0));
}

/// "Activation will occur upon any trip function EXCEPT a position trip" (MC 5-55); the input is active low.
#[test]
fn inputs_trip_and_capture() {
    let mut dut = Dut::with("LB K1; IC R1; RT");
    dut.commands("TI=2,K1; TC=K1; TE=5; SL 100000");
    dut.wait(1.secs());
    let second = Pin(1);
    dut.level(IO1, false);
    assert_eq!(dut.value(Reg::TE), 5);
    dut.level(second, false);
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::PC)), (4, dut.value(Reg::P)));
    dut.wait(100.millis());
    dut.level(CAPTURE, false);
    let there = dut.value(Reg::P);
    dut.wait(100.millis());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::PC), dut.value(Reg::R1)), (0, there, 2));
    // A trip needs a change to active, and occurs once.
    dut.commands("TE=1");
    dut.level(second, true);
    dut.wait(10.millis());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::R1)), (1, 2));
    dut.level(second, false);
    dut.level(second, true);
    dut.level(second, false);
    dut.wait(10.millis());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::R1), dut.value(Reg::EF)), (0, 3, 0));
}

/// LM 3: the program ends, and the handler of OE is called (MC 5-43, 5-52).
#[test]
fn a_limit_ends_the_program_and_calls_the_handler() {
    let mut dut = Dut::with("OE K9; SL 50000; H; R2=1; E; LB K9; R1=ER; RT");
    dut.commands("S1=2,0; LM=3; EX 1");
    dut.wait(500.millis());
    dut.level(IO1, false);
    dut.wait(500.millis());
    assert_eq!((dut.r(), dut.value(Reg::BY), dut.value(Reg::V)), ([83, 0, 0, 0], 0, 0));
}

/// Conditions of TA can be combined by addition (MC 5-71).
#[test]
fn the_state_of_a_hybrid_trips() {
    let mut dut = Dut::new(Mdrive::hybrid());
    dut.store(1, "LB K1; IC R1; RT");
    for (line, error) in [("TA=32,K1", 21), ("TA=4", 38), ("TE=32", 27)] {
        assert_eq!(dut.command(line).map_err(|it| it as u8), Err(error), "{line}");
    }
    dut.commands("TA=5,K1; TE=32");
    let mut trip = |flags| {
        let now = dut.now;
        let Fixture { drive, out, .. } = &mut dut.fixture;
        drive.drive.trip_on_status(now, flags, out);
        dut.lines(3);
        (dut.value(Reg::TE), dut.value(Reg::R1))
    };
    assert_eq!(trip(2 | 8 | 16), (32, 0));
    assert_eq!(trip(4 | 2), (0, 1));
    assert_eq!(trip(4), (0, 1));
}

/// "TR=650000,0,0" makes a pulse exactly at its steps, and calls nothing (MC 5-75). CW is 10, in units of 50
/// ns.
#[test]
fn a_distance_without_a_subroutine_pulses() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("S13=61,1; P=0; SL 100000");
    dut.wait(1.secs());
    let start = dut.value(Reg::P);
    dut.out.levels.clear();
    dut.commands("TR=1000,0,5; TE=16");
    dut.wait(1.secs());
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::BY), dut.value(Reg::PC)), (0, 0, start + 5_000));
    let output = dut.trip_output();
    let pulses: Vec<_> = output.chunks(2).collect();
    assert_eq!(pulses.len(), 5);
    let motion = &dut.drive().motion;
    for (n, pulse) in (1..).zip(pulses) {
        let &[(begin, Level::High), (end, Level::Low)] = pulse else { panic!("{pulse:?}") };
        assert_eq!(end.since(begin), Duration::from_ticks(8));
        let around = [begin - Duration::TICK, begin].map(|at| motion.shaft().steps(at));
        assert_eq!(around, [start + 1_000 * n - 1, start + 1_000 * n]);
    }
}

/// The position is passed within a ramp. The pulse is exact to the tick.
#[test]
fn a_position_pulses_at_its_step() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("S13=61,0; TP=-777; TE=2");
    dut.out.levels.clear();
    dut.commands("MR -20000");
    dut.wait(100.millis());
    let &[(begin, Level::Low), (_, Level::High)] = dut.trip_output().as_slice() else {
        panic!("{:?}", dut.trip_output())
    };
    let motion = &dut.drive().motion;
    assert_eq!([begin - Duration::TICK, begin].map(|at| motion.shaft().steps(at)), [-776, -777]);
    assert_eq!((dut.value(Reg::TE), dut.value(Reg::PC)), (0, 0));
}

/// TR "will always use motor counts unless the encoder is enabled" (MC 5-75). With 512 lines 25 steps are a
/// count.
#[test]
fn a_distance_is_in_counts_with_the_encoder() {
    for sign in [1, -1] {
        let mut dut = Dut::with("LB K1; IC R1; RT");
        // C1 and C2 differ, also by a fraction of a count.
        dut.commands("MR 70010");
        dut.wait(1.secs());
        dut.commands("EE=1; P=500");
        dut.commands(&format!("TR={},K1,3; TE=16; MR {}", sign * 1_000, sign * 2_999));
        for count in [1, 2] {
            let there = loop {
                let time = dut.drive.deadline().since(dut.now);
                dut.wait(Duration::TICK.max(time));
                if dut.value(Reg::PC) == 500 + sign * 1_000 * count {
                    break dut.now;
                }
                assert!(dut.now < Instant::ZERO + 10.secs());
            };
            let motion = &dut.drive().motion;
            assert_eq!(motion.shaft().counts(there), 500 + sign * 1_000 * count);
            assert_eq!(motion.shaft().counts(there - Duration::TICK), 500 + sign * (1_000 * count - 1));
        }
        dut.wait(2.secs());
        assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE)), (2, 16), "2,999 are not 3,000");
        dut.commands(&format!("MR {sign}"));
        dut.wait(1.secs());
        assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::ER)), (3, 0, 0));
        // A write of P changes the count. The trip uses the new count, not the one of the earlier plan.
        dut.commands(&format!("TR={},K1,1; TE=16; P=P{:+}", sign * 1_000, sign * 1_000));
        dut.wait(Duration::ZERO);
        assert_eq!((dut.value(Reg::TE), dut.value(Reg::PC)), (0, 500 + sign * 4_000));
    }
}

/// A blocked shaft makes no counts, so TR does not trip, whatever the motor's steps are.
#[test]
fn a_distance_waits_for_a_shaft_that_is_held() {
    let mut dut = Dut::with("LB K1; IC R1; RT");
    dut.commands("EE=1; SM=1; SF=65000; TR=100,K1,1; TE=16");
    dut.feed(Input::Fault { fault: STALL, on: true });
    dut.commands("SL 1000");
    dut.wait(2.secs());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::P)), (0, 16, 0));
    dut.commands("SL 0");
    dut.wait(2.secs());
    dut.feed(Input::Fault { fault: STALL, on: false });
    dut.commands("SL 1000");
    dut.wait(2.secs());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE), dut.value(Reg::PC)), (1, 0, 100));
}

/// A remote encoder counts independently of the motor.
#[test]
fn a_distance_follows_a_remote_encoder() {
    let mut dut = Dut::with("LB K1; IC R1; RT");
    for pin in [A, B] {
        dut.level(pin, true);
    }
    dut.commands("EE=1; P=0; TR=-4,K1,2; TE=16");
    // In backward motion channel B falls first.
    let cycle = [(B, false), (A, false), (B, true), (A, true)];
    for (edge, (pin, high)) in (1..=8).zip(cycle.into_iter().cycle()) {
        dut.wait(1.millis());
        dut.level(pin, high);
        // FM lets a level pass that lasts 200 ns.
        dut.wait(1.micros());
        assert_eq!((dut.value(Reg::P), dut.value(Reg::PC)), (-edge, -(edge / 4 * 4)));
    }
    dut.wait(1.millis());
    assert_eq!((dut.value(Reg::R1), dut.value(Reg::TE)), (2, 0));
}

/// 20 kHz is "the maximum rate of trip" (MC 5-75). Faster trips are delayed, but none is lost.
#[test]
fn trips_are_not_faster_than_20_khz() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("S13=61,1; SL 1000000");
    dut.wait(2.secs());
    dut.out.levels.clear();
    dut.commands("TR=10,0,1000; TE=16");
    dut.wait(1_000.micros());
    assert_eq!(dut.trip_output().len(), 2 * 20);
    dut.wait(1.secs());
    assert_eq!((dut.trip_output().len(), dut.value(Reg::TE)), (2 * 1_000, 0));
}

/// TR without a limit of repetitions trips at its distances only. It does not make up for positions that it
/// has missed.
#[test]
fn trips_without_an_end_end_with_the_motion() {
    let mut dut = Dut::new(Mdrive::plus());
    dut.commands("S13=61,1; SL 1000000");
    dut.wait(2.secs());
    dut.commands("P=0; TR=10; TE=16");
    dut.out.levels.clear();
    dut.wait(1.millis());
    assert_eq!(dut.trip_output().len(), 2 * 20);
    assert_eq!(dut.value(Reg::PC).rem_euclid(10), 0, "{}", dut.value(Reg::PC));
    dut.commands("SL 0");
    dut.wait(2.secs());
    dut.out.levels.clear();
    dut.wait(1.secs());
    assert_eq!((dut.trip_output().len(), dut.value(Reg::TE)), (0, 16));
    // A write of P trips once, however far P jumps.
    dut.commands("P=P+1000000000");
    dut.wait(1.secs());
    assert_eq!(dut.trip_output().len(), 2);
}
