//! Counting compared with the slow model: at 1 MHz in every mode, and with random events.

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{PinStimulus, Setup};
use drivetwin_sim::line::LineMode;
use proptest::prelude::*;

use crate::rig::Rig;
use crate::slow::Slow;

/// A QSB with its counter registers written, and the model of its counter.
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

    /// Loads `cntr` into CNTR, then sets DTR to `dtr`.
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
        self.rig.set(pin, if high { PinStimulus::High } else { PinStimulus::Low });
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

    /// Asserts that every register of the counter is as in the model.
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
    // STR shows borrow, sign, and direction down.
    pair.rig.says(&[("R0E", "r 0E FFFFFFFF !"), ("R06", "r 06 00000049 !")]);
}

/// 1 MHz in every quadrature and count mode, in both directions, with reversals across both limits.
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
                    // Single-cycle mode stops the counter. A load starts it again.
                    if !pair.slow.counts() {
                        pair.load();
                    }
                }
            }
        }
    }
}

/// A random event.
#[derive(Clone, Debug)]
enum Op {
    A,
    B,
    I(bool),
    /// The index becomes active at the same instant as an edge of A or of B. With `first` the index is set
    /// first.
    Together {
        a: bool,
        first: bool,
    },
    Turn(i32),
    Mdr0(u8),
    Mdr1(u16),
    Dtr(u32),
    /// Sets DTR to CNTR plus this number.
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
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// After any events every register on the bus is as in the model.
    #[test]
    fn random_edges_and_writes(ops in prop::collection::vec(op(), 1..60)) {
        let mut pair = Pair::new();
        for (n, op) in ops.iter().enumerate() {
            pair.carry_out(op);
            pair.assert_same(&format!("after {n}: {op:?}"));
        }
    }
}
