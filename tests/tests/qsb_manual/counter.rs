//! Counting against the slow model, at 1 MHz and at random, and the figures that the model does not tell.

use proptest::prelude::*;
use standin_protocol::time::Span;
use standin_sim::bench::{Driving, Setup};
use standin_sim::bus::LineMode;

use crate::rig::Rig;
use crate::slow::Slow;

/// A QSB whose registers of the counter are written, and the model of it.
struct Pair {
    rig: Rig,
    slow: Slow,
}

impl Pair {
    fn new() -> Self {
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let mut rig = Rig::new("qsb-s", LineMode::Fast, setup);
        rig.until_banner("qsb-s");
        Self { rig, slow: Slow::new() }
    }

    fn mdr0(&mut self, value: u8) {
        self.rig.write(&format!("W03{value:X}"));
        self.slow.set_mdr0(value);
    }

    fn mdr1(&mut self, value: u16) {
        self.rig.write(&format!("W04{value:X}"));
        self.slow.set_mdr1(value);
    }

    fn dtr(&mut self, value: u32) {
        self.rig.write(&format!("W08{value:X}"));
        self.slow.dtr = value;
    }

    fn clear(&mut self, what: u8) {
        self.rig.write(&format!("W09{what}"));
        match what {
            0 => self.slow.set_mdr0(0),
            1 => self.slow.set_mdr1(0),
            2 => self.slow.reset(),
            _ => self.slow.clear_str(),
        }
    }

    fn load(&mut self) {
        self.rig.write("W0A0");
        self.slow.load();
    }

    /// Loads CNTR, and leaves DTR at another value.
    fn preset(&mut self, cntr: u32, dtr: u32) {
        self.dtr(cntr);
        self.load();
        self.dtr(dtr);
    }

    /// Turns the encoder at 1 MHz.
    fn turn(&mut self, edges: i32) {
        self.rig.turn(edges);
        for _ in 0..edges.unsigned_abs() {
            self.slow.turn(edges > 0);
        }
    }

    fn set(&mut self, pin: &str, high: bool) {
        self.rig.set(pin, if high { Driving::High } else { Driving::Low });
    }

    fn a(&mut self) {
        self.slow.toggle_a();
        let high = self.slow.a;
        self.set("A", high);
    }

    fn b(&mut self) {
        self.slow.toggle_b();
        let high = self.slow.b;
        self.set("B", high);
    }

    fn i(&mut self, high: bool) {
        self.slow.set_i(high);
        self.set("I", high);
    }

    /// Everything that the bus shows of the counter.
    #[track_caller]
    fn assert_same(&mut self, when: &str) {
        let (str, sure) = self.slow.str();
        let is = self.rig.read("06");
        assert_eq!(is & sure, str & sure, "STR {is:02X}, not {str:02X}, {when}: {:02X?}", self.slow);
        for (register, expected) in [
            ("0E", self.slow.cntr),
            ("07", self.slow.cntr),
            ("05", self.slow.capture),
            ("03", u32::from(self.slow.mdr0)),
            ("04", u32::from(self.slow.mdr1)),
            ("08", self.slow.dtr),
        ] {
            let is = self.rig.read(register);
            assert_eq!(is, expected, "{register} {is:X}, not {expected:X}, {when}: {:02X?}", self.slow);
        }
    }
}

/// A second of edges at 1 MHz, forward.
#[test]
fn a_second_at_1_mhz() {
    let mut pair = Pair::new();
    pair.mdr0(0x43);
    pair.rig.turn(1_000_000);
    pair.rig.says(&[("R0E", "r 0E 000F4240 !"), ("R06", "r 06 0000002A !")]);
    pair.rig.says(&[("W093", "w 09 00000003 !")]);
    pair.rig.turn(-1_000_001);
    // Borrow and sign; down.
    pair.rig.says(&[("R0E", "r 0E FFFFFFFF !"), ("R06", "r 06 00000049 !")]);
}

/// 1 MHz in every quadrature and count mode, up and down: forward, back and reversals across both limits.
#[test]
fn every_mode_at_1_mhz() {
    for mode in 0..16 {
        for reversed in [0x000, 0x100] {
            let mut pair = Pair::new();
            pair.mdr0(mode);
            pair.mdr1(reversed);
            for (cntr, dtr) in [(0, 499), (0xFFFF_FFF0, 7), (5, 0xFFFF_FFFF), (1_000, 3), (0, 0)] {
                pair.preset(cntr, dtr);
                pair.clear(3);
                for edges in [40, -83, 2_001, -3_000, 1, -1, 2, -2, 3, -3, 997] {
                    pair.turn(edges);
                    pair.assert_same(&format!("mode {mode:X} after {edges} from {cntr:X}, {dtr:X}"));
                    // Single-cycle stops; go on.
                    if !pair.slow.counts() {
                        pair.load();
                    }
                }
            }
        }
    }
}

/// "ff ≥ 4 fQA": with 24 MHz a channel may have 6 MHz, with B7 3 MHz; one edge each tick of the bench is 4
/// MHz a channel.
#[test]
fn the_filter() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0343");
    rig.turn_at(100_000, 16_000_000);
    rig.says(&[("R0E", "r 0E 000186A0 !")]);
    // 2.67 MHz a channel.
    let mut rig = Rig::ready("qsb-s");
    rig.write("W03C3");
    rig.turn_at(100_000, 10_666_667);
    rig.says(&[("R0E", "r 0E 000186A0 !")]);
    // 4 MHz is lost, but for the last edges.
    rig.write("W092");
    rig.turn_at(100_000, 16_000_000);
    let left = rig.read("0E").cast_signed();
    assert!(left.abs() <= 4, "{left} of 100,000 edges are counted");
}

/// Non-quadrature is not filtered: a clock a tick long counts.
#[test]
fn no_filter_in_non_quadrature() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0380");
    let a = rig.pin("A");
    rig.bench.pulse(rig.seat, a, 1_000, 8e6).expect("nothing runs there");
    rig.after(1.millis());
    // B is high: up.
    rig.says(&[("R0E", "r 0E 000003E8 !"), ("R06", "r 06 0000002A !")]);
}

/// Figure 9 (32 bits): FFFFFFFC up to 0 with CY; DOWN is not counted until a load.
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
    // CY at the count that ends there, and at the one that leaves.
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
    // Neither CLR STR nor a write of the same mode starts it again; CLR CNTR does.
    rig.says(&[("W093", "w 09 00000003 !"), ("W0304", "w 03 00000004 !"), ("R06", "r 06 00000000 !")]);
    rig.says(&[("W092", "w 09 00000002 !"), ("R06", "r 06 00000008 !")]);
}

/// "Re-enabled with reset or load"; leaving the mode does, too (decision 22).
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
        // And back: it counts.
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
    // By index: load, and reset.
    for mode in ["W0317", "W0327"] {
        let mut rig = Rig::ready("qsb-s");
        rig.write(mode);
        rig.turn(-4);
        assert_eq!(rig.read("06"), 0x41);
        rig.high("I");
        assert_eq!(rig.read("06"), 0x59, "{mode}");
    }
}

/// Each clock of Figures 10 and 11 with DTR = 3: CNTR and the flag that it sets.
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

/// Figure 8: free-running with DTR = 1; CY about the wrap, CMP at 1, BW about the wrap.
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

/// S: set with BW, cleared with CY; load and reset leave it (decision 21).
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

/// Example 1.3: synchronous, reset on index. With A and B unlike the index waits for them.
#[test]
fn reset_on_a_synchronous_index() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0363");
    rig.turn(101);
    // A low, B high.
    rig.high("I");
    rig.says(&[("R0E", "r 0E 00000065 !"), ("R06", "r 06 0000000A !")]);
    // Both low: the edge counts, then the index resets.
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000000 !"), ("R06", "r 06 0000001A !")]);
    // Once; the next time when they are alike again.
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000001 !")]);
    rig.turn(1);
    rig.says(&[("R0E", "r 0E 00000000 !")]);
    rig.low("I");
    rig.turn(5);
    rig.says(&[("R0E", "r 0E 00000005 !")]);
}

/// Asynchronous, and in non-quadrature in spite of B6 (easily missed 20).
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

/// Bit 3 of 04: active low.
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

/// 1.2: the direction is of quadrature only.
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
    // B is high: up.
    rig.says(&[("R0E", "r 0E 00000009 !")]);
}

/// 1.4: between 0 and DTR, the factory's setting.
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
    // 34F is modulo-n, whatever the example's title: 500 counts round.
    rig.write("W034F");
    rig.turn(1_250);
    rig.says(&[("R0E", "r 0E 000000FA !")]);
    rig.turn(-251);
    rig.says(&[("R0E", "r 0E 000001F3 !")]);
}

/// Something that happens to the counter.
#[derive(Clone, Debug)]
enum Op {
    A,
    B,
    I(bool),
    /// The index becomes active at the very instant of an edge of A, or of B; either is done first.
    Together {
        a: bool,
        first: bool,
    },
    Turn(i32),
    Mdr0(u8),
    Mdr1(u16),
    Dtr(u32),
    /// DTR at so much from CNTR.
    Near(i32),
    Clear(u8),
    Load,
}

fn op() -> impl Strategy<Value = Op> {
    prop_oneof![
        4 => Just(Op::A),
        4 => Just(Op::B),
        3 => any::<bool>().prop_map(Op::I),
        2 => (any::<bool>(), any::<bool>()).prop_map(|(a, first)| Op::Together { a, first }),
        6 => (-30..=30).prop_map(Op::Turn),
        3 => any::<u8>().prop_map(Op::Mdr0),
        2 => (0..0x200_u16).prop_map(Op::Mdr1),
        1 => prop_oneof![0..4_u32, u32::MAX - 3..=u32::MAX].prop_map(Op::Dtr),
        2 => (-6..=6).prop_map(Op::Near),
        1 => (0..4_u8).prop_map(Op::Clear),
        2 => Just(Op::Load),
    ]
}

impl Pair {
    fn carry_out(&mut self, op: &Op) {
        match *op {
            Op::A => self.a(),
            Op::B => self.b(),
            Op::I(high) => self.i(high),
            Op::Together { a, first } => {
                let active = self.slow.mdr1 >> 3 & 1 == 0;
                if self.slow.i == active {
                    return;
                }
                if first {
                    self.set("I", active);
                }
                if a {
                    self.a();
                } else {
                    self.b();
                }
                self.i(active);
            }
            Op::Turn(edges) => {
                if edges != 0 {
                    self.turn(edges);
                }
            }
            Op::Mdr0(value) => self.mdr0(value),
            Op::Mdr1(value) => self.mdr1(value),
            Op::Dtr(value) => self.dtr(value),
            Op::Near(far) => {
                let value = self.slow.cntr.wrapping_add_signed(far);
                self.dtr(value);
            }
            Op::Clear(what) => self.clear(what),
            Op::Load => self.load(),
        }
        self.rig.after(1.micros());
    }

    /// Whether a write of MDR0 would open the gate of an index that is active, which nobody has decided.
    /// A write of the polarity is an edge at the chip's INDEX/.
    fn in_doubt(&self, op: &Op) -> bool {
        match *op {
            Op::Mdr0(value) => self.slow.would_act(value),
            Op::Clear(0) => self.slow.would_act(0),
            _ => false,
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens, all that the bus shows is what the model says.
    #[test]
    fn random_edges_and_writes(ops in prop::collection::vec(op(), 1..60)) {
        let mut pair = Pair::new();
        for (n, op) in ops.iter().enumerate() {
            if !pair.in_doubt(op) {
                pair.carry_out(op);
                pair.assert_same(&format!("after {n}: {op:?}"));
            }
        }
    }
}
