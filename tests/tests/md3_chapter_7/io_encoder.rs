//! Sections 7.9 to 7.14: the I/O port and the encoder.

use drivetwin_firmware::device::{Duration, Level};
use drivetwin_protocol::time::Span;

use crate::rig::{Rig, at};

const A: &str = "J2.10";
const B: &str = "J2.12";
const INDEX: &str = "J2.9";

/// Bits of QuadratureEncoderConfiguration (7.11).
const CLEAR: u16 = 1;
const X2_INDEX: u16 = 0;
const X2_MAX: u16 = 1 << 1;
const X4_INDEX: u16 = 2 << 1;
const X4_MAX: u16 = 3 << 1;
const SWAP: u16 = 1 << 3;
const FILTER: u16 = 1 << 9;

/// An encoder on the pins of an MD3. It makes an edge every 10 µs unless a test gives another interval.
struct Encoder {
    rig: Rig,
    /// Position in quarter cycles.
    phase: i32,
}

impl Encoder {
    fn new(configuration: u16) -> Self {
        let mut rig = Rig::ready();
        rig.write(at::ENCODER, configuration);
        Self { rig, phase: 0 }
    }

    /// Turns the encoder by `quarters` quarter cycles. Forward, A leads B: (A, B) = 00, 10, 11, 01.
    fn turn(&mut self, quarters: i32) {
        self.turn_at(quarters, 10.micros());
    }

    fn turn_at(&mut self, quarters: i32, edge: Duration) {
        for _ in 0..quarters.abs() {
            self.phase += quarters.signum();
            let (a, b) = [(false, false), (true, false), (true, true), (false, true)]
                [self.phase.rem_euclid(4) as usize];
            for (pin, high) in [(A, a), (B, b)] {
                if high { self.rig.high(pin) } else { self.rig.low(pin) }
            }
            self.rig.after(edge - Duration::TICK * 2);
        }
    }

    /// Makes an index pulse at the present position.
    fn index(&mut self, lasts: Duration) {
        self.rig.high(INDEX);
        self.rig.after(lasts - Duration::TICK);
        self.rig.low(INDEX);
        self.rig.after(1.millis());
    }

    fn count(&mut self) -> u16 {
        self.rig.read(at::ENCODER_COUNT)
    }

    fn indices(&mut self) -> i32 {
        self.rig.read_long(at::INDEX_COUNT)
    }
}

/// MD3-11: bits 3:0 show the raw levels of pins 2, 3, 4, 5; writes do not change them.
#[test]
fn section_7_9_inputs() {
    let mut rig = Rig::ready();
    rig.write(at::PINS, 0xf << 4 | 3 << 8);
    for (pin, without) in [("J2.2", 0x7), ("J2.3", 0xb), ("J2.4", 0xd), ("J2.5", 0xe)] {
        assert_eq!(rig.read(at::IO_PORT), 0xf);
        rig.low(pin);
        assert_eq!(rig.read(at::IO_PORT), without, "{pin}");
        rig.write(at::IO_PORT, 0xf);
        assert_eq!(rig.read(at::IO_PORT), without, "{pin}");
        rig.open(pin);
    }
    rig.write(at::IO_PORT, 0);
    assert_eq!(rig.read(at::IO_PORT), 0xf);
}

/// The manual describes bit 12 of 0x09 the wrong way round (7.8). 0 makes pins 9, 10, 12 inputs, and reads
/// show their levels. Open pins read low.
#[test]
fn section_7_9_encoder_pins_as_inputs() {
    let mut rig = Rig::ready();
    for (pin, bit) in [("J2.9", 6), ("J2.10", 5), ("J2.12", 4)] {
        assert_eq!(rig.read(at::IO_PORT), 0xf);
        rig.high(pin);
        assert_eq!(rig.read(at::IO_PORT), 0xf | 1 << bit, "{pin}");
        rig.open(pin);
    }
    // MD3-11: a write sets the latch, not the readings of inputs.
    rig.write(at::IO_PORT, 0x70);
    assert_eq!(rig.read(at::IO_PORT), 0xf);
    assert_eq!(rig.level("J2.9"), Level::Low);
}

#[test]
fn section_7_9_outputs() {
    let mut rig = Rig::ready();
    rig.write(at::IO_PORT, 0x50); // the pins are still inputs: only the latch changes
    rig.write(at::PINS, 1 << 12);
    assert_eq!(rig.read(at::IO_PORT), 0x5f);
    let levels = |rig: &Rig| ["J2.9", "J2.10", "J2.12"].map(|pin| rig.level(pin));
    assert_eq!(levels(&rig), [Level::High, Level::Low, Level::High]);
    rig.write(at::IO_PORT, 0x20);
    assert_eq!(rig.read(at::IO_PORT), 0x2f);
    assert_eq!(levels(&rig), [Level::Low, Level::High, Level::Low]);
}

/// A save stores the latch even while the pins are inputs and read differently (MD3-12).
#[test]
fn section_7_9_the_latch_is_saved() {
    let mut rig = Rig::ready();
    rig.write(at::IO_PORT, 0x50);
    assert_eq!(rig.read(at::IO_PORT), 0x0f);
    rig.save();
    rig.power_cycle();
    rig.after(2_501.millis());
    assert_eq!(rig.read(at::IO_PORT), 0x0f);
    rig.write(at::PINS, 1 << 12);
    assert_eq!(rig.read(at::IO_PORT), 0x5f);
}

/// MD3-11: J3 pin 8 is bit 7; 1 switches it to ground.
#[test]
fn section_7_9_j3_pin_8() {
    let mut rig = Rig::ready();
    assert_eq!(rig.level("J3.8"), Level::Float);
    rig.write(at::IO_PORT, 0x80);
    assert_eq!((rig.level("J3.8"), rig.read(at::IO_PORT)), (Level::Low, 0x8f));
    rig.write(at::IO_PORT, 0x00);
    assert_eq!((rig.level("J3.8"), rig.read(at::IO_PORT)), (Level::Float, 0x0f));
}

/// Register 0x0b reads 0, also in a read of several registers (MD3-2), and cannot be written (MD3-1).
#[test]
fn section_7_10_reserved() {
    let mut rig = Rig::ready();
    assert_eq!(rig.read(0x0b), 0);
    assert!(!rig.accepts(0x0b, 0));
    assert_eq!(rig.words(0x0a, 3), [0x000f, 0x0000, 0x0005]);
}

/// MD3-33: if A leads B, each edge of both signals counts up.
#[test]
fn section_7_11_x4() {
    let mut encoder = Encoder::new(X4_INDEX);
    for n in 1..=8 {
        encoder.turn(1);
        assert_eq!(encoder.count(), n);
    }
    encoder.turn(-3);
    assert_eq!(encoder.count(), 5);
    encoder.turn(400);
    assert_eq!(encoder.count(), 405);
    encoder.turn(-406);
    assert_eq!(encoder.count(), 0xFFFF); // 16 bits
}

/// MD3-33: x2 counts only the edges of A.
#[test]
fn section_7_11_x2() {
    let mut encoder = Encoder::new(X2_INDEX);
    for counts in [1, 1, 2, 2, 3, 3, 4, 4] {
        encoder.turn(1); // A up, B up, A down, B down
        assert_eq!(encoder.count(), counts);
    }
    encoder.turn(-8);
    assert_eq!(encoder.count(), 0);
}

#[test]
fn section_7_11_swpab() {
    let mut encoder = Encoder::new(X4_INDEX | SWAP);
    encoder.turn(-40);
    assert_eq!(encoder.count(), 40);
    // With x2 and swapped signals the edges of B count.
    let mut encoder = Encoder::new(X2_INDEX | SWAP);
    for counts in [0, 0xFFFF, 0xFFFF, 0xFFFE] {
        encoder.turn(1);
        assert_eq!(encoder.count(), counts);
    }
}

/// A and B are swapped before gating, as in Microchip's unit (MD3-33). Gating 1 is B = 0, A = 1 of the
/// swapped inputs, so here pin B is high.
#[test]
fn section_7_11_swpab_before_gating() {
    let mut encoder = Encoder::new(CLEAR | X4_INDEX | SWAP | 1 << 4);
    encoder.turn(-5); // up by 5, at (A, B) = 01
    encoder.index(100.micros());
    assert_eq!((encoder.count(), encoder.indices()), (0, 1));
}

/// Asserts that an index pulse clears the count at the phases (A, B) = 00, 10, 11, 01 for which `valid` is
/// `true`, and not at the others.
fn index_is_valid_at(configuration: u16, valid: [bool; 4]) {
    for (phase, valid) in (4..).zip(valid) {
        let mut encoder = Encoder::new(configuration);
        encoder.turn(phase);
        let before = encoder.count();
        assert_ne!(before, 0);
        encoder.index(100.micros());
        let expected = if valid { (0, 1) } else { (before, 0) };
        assert_eq!((encoder.count(), encoder.indices()), expected, "{configuration:#06x}, {phase}");
    }
}

/// MD3-34: an index pulse outside the gate neither clears the count nor counts.
#[test]
fn section_7_11_index_gating_x4() {
    let x4 = CLEAR | X4_INDEX;
    index_is_valid_at(x4, [true, false, false, false]); // B=0, A=0
    index_is_valid_at(x4 | 1 << 4, [false, true, false, false]); // B=0, A=1
    index_is_valid_at(x4 | 2 << 4, [false, false, false, true]); // B=1, A=0
    index_is_valid_at(x4 | 3 << 4, [false, false, true, false]); // B=1, A=1
}

/// x2 has another gating table.
#[test]
fn section_7_11_index_gating_x2() {
    let x2 = CLEAR | X2_INDEX;
    index_is_valid_at(x2, [true, false, false, true]); // A=0
    index_is_valid_at(x2 | 1 << 4, [false, true, true, false]); // A=1
    index_is_valid_at(x2 | 2 << 4, [true, true, false, false]); // B=0
    index_is_valid_at(x2 | 3 << 4, [false, false, true, true]); // B=1
}

/// MD3-34: a long index pulse clears when A and B reach the gate, and only once.
#[test]
fn section_7_11_a_wide_index() {
    let mut encoder = Encoder::new(CLEAR | X4_INDEX);
    encoder.turn(5);
    encoder.rig.high(INDEX);
    encoder.turn(2);
    assert_eq!((encoder.count(), encoder.indices()), (7, 0));
    encoder.turn(1); // A and B low
    assert_eq!((encoder.count(), encoder.indices()), (0, 1));
    encoder.turn(8); // A and B pass the gate again during the same pulse
    assert_eq!((encoder.count(), encoder.indices()), (8, 1));
    encoder.rig.low(INDEX);
    encoder.index(100.micros());
    assert_eq!((encoder.count(), encoder.indices()), (0, 2));
}

/// "Do not clear counter on index pulse"; the index count still changes.
#[test]
fn section_7_11_enable_index_0() {
    for configuration in [X4_INDEX, X2_INDEX] {
        let mut encoder = Encoder::new(configuration);
        encoder.turn(8);
        let before = encoder.count();
        encoder.index(100.micros());
        assert_eq!((encoder.count(), encoder.indices()), (before, 1));
    }
}

/// If the count goes down, the index loads MaxCount (MD3-34). Only then does the 4·CPR − 1 of 7.12 make
/// sense.
#[test]
fn section_7_11_the_index_going_down() {
    let mut encoder = Encoder::new(CLEAR | X4_INDEX);
    encoder.rig.write(at::MAX_COUNT, 3_999);
    encoder.turn(8);
    encoder.turn(-4);
    encoder.index(100.micros());
    assert_eq!((encoder.count(), encoder.indices()), (3_999, -1));
    encoder.turn(-4);
    assert_eq!(encoder.count(), 3_995);
}

/// Modes 1 and 3: "index ignored". MD3-34: the index counts, and does not clear.
#[test]
fn section_7_11_max_count_modes_ignore_the_index() {
    for configuration in [X2_MAX | CLEAR, X4_MAX | CLEAR] {
        let mut encoder = Encoder::new(configuration);
        encoder.turn(8);
        let before = encoder.count();
        encoder.index(100.micros());
        assert_eq!((encoder.count(), encoder.indices()), (before, 1));
    }
}

/// Three periods of the filter clocks of 7.11, in ticks of 62.5 ns, from code 2 on. The tick is too long to
/// distinguish codes 0 and 1 (40 and 20 MHz).
const THREE_PERIODS: [f64; 6] = [
    48.0 / 10.0,     // 10 MHz
    48.0 / 2.5,      // 2.5 MHz
    48.0 / 1.25,     // 1.25 MHz
    48.0 / 0.625,    // 625 kHz
    48.0 / 0.3125,   // 312.5 kHz
    48.0 / 0.156_25, // 156.25 kHz
];

/// "Will ignore pulses less than 3 clock periods in duration": tested with index pulses. The filter does not
/// divide the frequency.
#[test]
fn section_7_11_noise_filter() {
    for (code, periods) in (2..).zip(THREE_PERIODS) {
        let ticks = |share: f64| Duration::from_ticks((periods * share) as u64);
        let mut encoder = Encoder::new(FILTER | code << 6 | CLEAR | X4_INDEX);
        encoder.turn_at(8, 50.micros());
        encoder.rig.after(1.millis());
        encoder.index(ticks(0.9));
        assert_eq!((encoder.count(), encoder.indices()), (8, 0), "code {code}");
        encoder.index(ticks(1.1));
        assert_eq!((encoder.count(), encoder.indices()), (0, 1), "code {code}");
        // Without the filter the short pulse counts.
        encoder.rig.write(at::ENCODER, code << 6 | CLEAR | X4_INDEX);
        encoder.index(ticks(0.9));
        assert_eq!(encoder.indices(), 2, "code {code}");
    }
}

/// The filter on A and B with code 7 (19.2 µs). An edge every 5 µs makes pulses of 10 µs, which are too
/// short; an edge every 15 µs makes pulses of 30 µs, which count.
#[test]
fn section_7_11_noise_filter_on_a_and_b() {
    let mut encoder = Encoder::new(FILTER | 7 << 6 | X4_INDEX);
    encoder.turn_at(100, 5.micros());
    encoder.rig.after(1.millis());
    assert_eq!(encoder.count(), 0);
    encoder.turn_at(100, 15.micros());
    encoder.rig.after(1.millis());
    assert_eq!(encoder.count(), 100);
}

/// "Maximum input frequency on A/B quadrature input is 3.3 MHz". The test uses 1 MHz, an edge every four
/// ticks.
#[test]
fn section_7_11_fast() {
    let mut encoder = Encoder::new(X4_INDEX);
    encoder.turn_at(4_000, Duration::from_ticks(4));
    assert_eq!(encoder.count(), 4_000);
    encoder.turn_at(-1_000, Duration::from_ticks(4));
    assert_eq!(encoder.count(), 3_000);
}

/// Going up, MaxCount is followed by 0; going down, 0 is followed by MaxCount.
#[test]
fn section_7_12_max_count() {
    let mut encoder = Encoder::new(X4_MAX);
    encoder.rig.write(at::MAX_COUNT, 99);
    encoder.turn(99);
    assert_eq!(encoder.count(), 99);
    encoder.turn(1);
    assert_eq!(encoder.count(), 0);
    encoder.turn(-1);
    assert_eq!(encoder.count(), 99);
    encoder.turn(1_000);
    assert_eq!(encoder.count(), 99);

    let mut encoder = Encoder::new(X2_MAX);
    encoder.rig.write(at::MAX_COUNT, 49);
    encoder.turn(100);
    assert_eq!(encoder.count(), 0);
    encoder.turn(-2);
    assert_eq!(encoder.count(), 49);
}

/// The default 0x0f9f = 3,999 = 4·1,000 − 1: an encoder of 1,000 cycles per revolution.
#[test]
fn section_7_12_default_max_count() {
    let mut encoder = Encoder::new(X4_MAX);
    encoder.turn(3_999);
    assert_eq!(encoder.count(), 3_999);
    encoder.turn(1);
    assert_eq!(encoder.count(), 0);
}

/// "5 CW rotations will increase the count by 5 and 3 CCW rotations will decrease the count by 3." The
/// encoder has ten cycles a revolution.
#[test]
fn section_7_13_index_count() {
    let mut encoder = Encoder::new(CLEAR | X4_INDEX);
    encoder.rig.write(at::MAX_COUNT, 39);
    for _ in 0..5 {
        encoder.turn(40);
        encoder.index(10.micros());
    }
    assert_eq!((encoder.indices(), encoder.count()), (5, 0));
    for _ in 0..3 {
        encoder.turn(-40);
        encoder.index(10.micros());
    }
    assert_eq!((encoder.indices(), encoder.count()), (2, 39));
    for _ in 0..4 {
        encoder.turn(-40);
        encoder.index(10.micros());
    }
    assert_eq!((encoder.indices(), encoder.rig.words(at::INDEX_COUNT, 2)), (-2, vec![0xFFFF, 0xFFFE]));
}

/// MD3-33: both counters can be written and continue from the written value.
#[test]
fn section_7_13_and_7_14_counters_can_be_written() {
    let mut encoder = Encoder::new(X4_INDEX);
    encoder.rig.write(at::ENCODER_COUNT, 1_000);
    encoder.rig.write_long(at::INDEX_COUNT, -70_000);
    assert_eq!((encoder.count(), encoder.indices()), (1_000, -70_000));
    encoder.turn(8);
    encoder.index(100.micros());
    assert_eq!((encoder.count(), encoder.indices()), (1_008, -69_999));
    encoder.rig.write(at::ENCODER_COUNT, 0);
    assert_eq!(encoder.count(), 0);
}

/// MD3-33: a write to 0x0c or 0x0d does not change the count.
#[test]
fn section_7_14_configuration_does_not_touch_the_count() {
    let mut encoder = Encoder::new(X4_INDEX);
    encoder.turn(500);
    encoder.rig.write(at::MAX_COUNT, 99);
    assert_eq!(encoder.count(), 500);
    for configuration in [X2_INDEX, X2_MAX, X4_MAX, X4_MAX | CLEAR | SWAP, FILTER | X4_INDEX] {
        encoder.rig.write(at::ENCODER, configuration);
        assert_eq!(encoder.count(), 500);
    }
}

/// MD3-33: with bit 12 of 0x09 = 1 the counter does not change.
#[test]
fn section_7_14_no_count_while_the_pins_are_outputs() {
    let mut encoder = Encoder::new(CLEAR | X4_INDEX);
    encoder.turn(8);
    encoder.rig.write(at::PINS, 1 << 12);
    encoder.turn(8);
    encoder.index(100.micros());
    encoder.rig.write(at::IO_PORT, 0x70);
    encoder.rig.write(at::IO_PORT, 0x00);
    assert_eq!((encoder.count(), encoder.indices()), (8, 0));
    encoder.rig.write(at::PINS, 0);
    encoder.turn(8);
    assert_eq!(encoder.count(), 16);
}
