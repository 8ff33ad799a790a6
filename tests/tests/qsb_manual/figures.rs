//! Figures 8 to 11 of the data sheet, clock by clock, the filter, the index, and examples 1.2 to 1.4.

use drivetwin_protocol::time::Span;

use crate::rig::Rig;

/// "ff ≥ 4 fQA": with 24 MHz a channel may have up to 6 MHz, with B7 up to 3 MHz. One edge at each tick of
/// the bench is 4 MHz per channel.
#[test]
fn the_filter() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0343");
    rig.turn_at(100_000, 16_000_000);
    rig.says(&[("R0E", "r 0E 000186A0 !")]);
    // 2.67 MHz per channel.
    let mut rig = Rig::ready("qsb-s");
    rig.write("W03C3");
    rig.turn_at(100_000, 10_666_667);
    rig.says(&[("R0E", "r 0E 000186A0 !")]);
    // 4 MHz is too fast. Only the last edges may count.
    rig.write("W092");
    rig.turn_at(100_000, 16_000_000);
    let left = rig.read("0E").cast_signed();
    assert!(left.abs() <= 4, "{left} of 100,000 edges are counted");
}

/// Non-quadrature inputs have no filter: a clock pulse of one tick counts.
#[test]
fn no_filter_in_non_quadrature() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0380");
    let a = rig.pin("A");
    rig.bench.pulse(rig.seat, a, 1_000, 8e6).expect("nothing runs there");
    rig.after(1.millis());
    // B is high, so the counter counts up.
    rig.says(&[("R0E", "r 0E 000003E8 !"), ("R06", "r 06 0000002A !")]);
}

/// Figure 9 (32 bits): counts from FFFFFFFC up to 0, with CY. DOWN does not count until a load.
#[test]
fn figure_9_single_cycle() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0304", "W08FFFFFFFC", "W0A0", "W082"] {
        rig.write(command);
    }
    let mut clock = |count: u32, up: bool| {
        rig.hold("B", up);
        for _ in 0..count {
            rig.low("A");
            rig.high("A");
        }
        let read = (rig.read("0E"), rig.read("06"));
        rig.says(&[("W093", "w 09 00000003 !")]);
        read
    };
    assert_eq!(clock(2, true), (0xFFFF_FFFE, 0x0A));
    // CY is set at the count that reaches the limit and at the count that leaves it.
    assert_eq!(clock(1, true), (0xFFFF_FFFF, 0x8A));
    assert_eq!(clock(1, true), (0, 0x82));
    assert_eq!(clock(5, true), (0, 0x02));
    assert_eq!(clock(5, false), (0, 0x00));
    rig.write("W0A0");
    let mut clock = |count: u32| {
        for _ in 0..count {
            rig.low("A");
            rig.high("A");
        }
        (rig.read("0E"), rig.read("06"))
    };
    assert_eq!(clock(1), (1, 0x08));
    assert_eq!(clock(1), (0, 0x49));
    assert_eq!(clock(1), (0xFFFF_FFFF, 0x41));
    assert_eq!(clock(3), (0xFFFF_FFFF, 0x41));
    // CLR STR or a write of the same mode does not enable counting again. CLR CNTR does.
    rig.says(&[("W093", "w 09 00000003 !"), ("W0304", "w 03 00000004 !"), ("R06", "r 06 00000000 !")]);
    rig.says(&[("W092", "w 09 00000002 !"), ("R06", "r 06 00000008 !")]);
}

/// "Re-enabled with reset or load". Leaving the mode enables counting, too (QSB-18).
#[test]
fn what_ends_the_stop_of_single_cycle() {
    for (commands, enabled) in [
        (&["W0347"][..], false),
        (&["W0304"], false),
        (&["W093"], false),
        (&["W0A1"], false),
        (&["W080"], false),
        (&["W092"], true),
        (&["W0A0"], true),
        (&["W0343"], true),
        (&["W034B"], true),
        (&["W034F"], true),
        (&["W090"], true),
        // After the mode is left and set again, the counter counts.
        (&["W0343", "W0347"], true),
    ] {
        let mut rig = Rig::ready("qsb-s");
        rig.write("W0347");
        rig.turn(-4);
        rig.says(&[("R0E", "r 0E FFFFFFFF !"), ("R06", "r 06 00000041 !")]);
        for command in commands {
            rig.write(command);
        }
        assert_eq!(rig.read("06") >> 3 & 1 == 1, enabled, "{commands:?}");
        let before = rig.read("0E");
        rig.turn(4);
        assert_eq!(rig.read("0E") != before, enabled, "{commands:?}");
    }
    // An index that loads or resets enables counting.
    for mode in ["W0317", "W0327"] {
        let mut rig = Rig::ready("qsb-s");
        rig.write(mode);
        rig.turn(-4);
        assert_eq!(rig.read("06"), 0x41);
        rig.high("I");
        assert_eq!(rig.read("06"), 0x59, "{mode}");
    }
}

/// Each clock of Figures 10 and 11 with DTR = 3: the direction, CNTR, and the flag that is set.
#[test]
fn figures_10_and_11() {
    const CMP: u32 = 0x20;
    const BW: u32 = 0x40;
    const MODULO: [(bool, u32, u32); 11] = [
        (true, 1, 0),
        (true, 2, 0),
        (true, 3, CMP),
        (true, 0, 0),
        (true, 1, 0),
        (true, 2, 0),
        (false, 1, 0),
        (false, 0, BW),
        (false, 3, BW),
        (false, 2, 0),
        (false, 1, 0),
    ];
    const RANGE: [(bool, u32, u32); 11] = [
        (true, 1, 0),
        (true, 2, 0),
        (true, 3, CMP),
        (true, 3, CMP),
        (true, 3, CMP),
        (false, 2, 0),
        (false, 1, 0),
        (false, 0, BW),
        (false, 0, BW),
        (false, 0, BW),
        (true, 1, 0),
    ];
    for (mode, clocks) in [("W030C", MODULO), ("W0308", RANGE)] {
        let mut rig = Rig::ready("qsb-s");
        rig.write(mode);
        rig.write("W083");
        for (n, (up, count, flag)) in clocks.into_iter().enumerate() {
            rig.low("A");
            rig.hold("B", up);
            rig.high("A");
            assert_eq!(rig.read("0E"), count, "{mode}, clock {n}");
            assert_eq!(rig.read("06") & 0xF0, flag, "{mode}, clock {n}");
            rig.write("W093");
        }
    }
}

/// Figure 8: free-running with DTR = 1. CY is set next to the upward wrap, CMP at 1, BW next to the downward
/// wrap.
#[test]
fn figure_8_free_running() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0343", "W08FFFFFFFC", "W0A0", "W081"] {
        rig.write(command);
    }
    let up = [(0xFFFF_FFFD, 0), (0xFFFF_FFFE, 0), (0xFFFF_FFFF, 0x80), (0, 0x80), (1, 0x20), (2, 0)];
    let down = [(1, 0), (0, 0x40), (0xFFFF_FFFF, 0x40), (0xFFFF_FFFE, 0)];
    for (edge, script) in [(1, &up[..]), (-1, &down[..])] {
        for &(count, flag) in script {
            rig.turn(edge);
            assert_eq!(rig.read("0E"), count);
            assert_eq!(rig.read("06") & 0xF0, flag, "at {count:X}");
            rig.write("W093");
        }
    }
}

/// S is set with BW and cleared with CY. Load and reset do not change it (QSB-17).
#[test]
fn the_sign() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0343");
    rig.turn(-1);
    assert_eq!(rig.read("06"), 0x49);
    rig.write("W0A0");
    assert_eq!(rig.read("06"), 0x49);
    rig.write("W092");
    assert_eq!(rig.read("06"), 0x49);
    for command in ["W08FFFFFFFD", "W0A0"] {
        rig.write(command);
    }
    rig.turn(1);
    assert_eq!(rig.read("06"), 0x4B);
    rig.turn(1);
    assert_eq!(rig.read("06"), 0xCA);
}

/// Example 1.3: a synchronous index that resets. The index takes effect only while A and B are equal.
#[test]
fn reset_on_a_synchronous_index() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0363");
    rig.turn(101);
    // A is low and B is high.
    rig.high("I");
    rig.says(&[("R0E", "r 0E 00000065 !"), ("R06", "r 06 0000000A !")]);
    // A and B are both low: the edge counts, then the index resets.
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000000 !"), ("R06", "r 06 0000001A !")]);
    // The index resets only once. Its next reset is when A and B are equal again.
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000001 !")]);
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000000 !")]);
    rig.low("I");
    rig.turn(5);
    rig.says(&[("R0E", "r 0E 00000005 !")]);
}

/// An index is asynchronous without B6, and also with B6 if the mode is non-quadrature (register 03).
#[test]
fn an_asynchronous_index() {
    for mode in ["W0313", "W0350"] {
        let mut rig = Rig::ready("qsb-s");
        rig.write(mode);
        rig.low("A");
        rig.says(&[("W082A", "w 08 0000002A !")]);
        rig.high("I");
        rig.says(&[("R0E", "r 0E 0000002A !"), ("W092", "w 09 00000002 !")]);
        rig.says(&[("R0E", "r 0E 00000000 !")]);
        rig.low("I");
        rig.says(&[("R0E", "r 0E 00000000 !")]);
    }
}

/// Bit 3 of 04: the index is active low.
#[test]
fn an_inverted_index() {
    let mut rig = Rig::ready("qsb-s");
    rig.high("I");
    rig.says(&[("W0323", "w 03 00000023 !"), ("W04008", "w 04 00000008 !"), ("W093", "w 09 00000003 !")]);
    rig.turn(10);
    rig.says(&[("R0E", "r 0E 0000000A !")]);
    rig.low("I");
    rig.says(&[("R0E", "r 0E 00000000 !"), ("R06", "r 06 0000001A !")]);
}

/// Example 1.2: the direction bit applies only to quadrature.
#[test]
fn count_down() {
    let mut rig = Rig::ready("qsb-s");
    rig.says(&[("W0343", "w 03 00000043 !"), ("W04100", "w 04 00000100 !")]);
    rig.turn(8);
    rig.says(&[("R0E", "r 0E FFFFFFF8 !"), ("R06", "r 06 00000049 !")]);
    rig.turn(-16);
    rig.says(&[("R0E", "r 0E 00000008 !"), ("W0340", "w 03 00000040 !")]);
    rig.low("A");
    rig.high("A");
    // B is high, so the counter counts up.
    rig.says(&[("R0E", "r 0E 00000009 !")]);
}

/// Example 1.4: counts between 0 and DTR, which has the factory's value.
#[test]
fn count_range() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W034B");
    rig.turn(600);
    rig.says(&[("R0E", "r 0E 000001F3 !")]);
    rig.turn(-1);
    rig.says(&[("R0E", "r 0E 000001F2 !")]);
    rig.turn(-600);
    rig.says(&[("R0E", "r 0E 00000000 !")]);
    // 34F is modulo-n, contrary to the example's title. It counts in cycles of 500.
    rig.write("W034F");
    rig.turn(1_250);
    rig.says(&[("R0E", "r 0E 000000FA !")]);
    rig.turn(-251);
    rig.says(&[("R0E", "r 0E 000001F3 !")]);
}
