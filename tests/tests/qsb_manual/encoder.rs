//! MODE: PWM encoders and the analogue input.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::PinStimulus;

use crate::rig::{KINDS, Rig, TICK};

/// Makes cycles of a PWM encoder at a pin, high for `on` of `period` (both in 1/16 µs). Ends with the rising
/// edge that completes the last cycle.
fn pwm(rig: &mut Rig, pin: &str, on: u64, period: u64, cycles: u32) {
    for _ in 0..cycles {
        rig.set(pin, PinStimulus::High);
        rig.after(Duration::from_ticks(on));
        rig.set(pin, PinStimulus::Low);
        rig.after(Duration::from_ticks(period - on));
    }
    rig.set(pin, PinStimulus::High);
    rig.after(1.micros());
}

/// Registers 0E and 00 (MODE) with a steady signal.
fn reads(kind: &str, pin: &str, on: u64, period: u64) -> (u32, u32) {
    let mut rig = Rig::ready(kind);
    rig.write("W0001");
    rig.low(pin);
    pwm(&mut rig, pin, on, period, 4);
    (rig.read("0E"), rig.read("00"))
}

/// QSB-14: the value is floor(on × 1026 / period) − 1, limited to 0 to 1,023. A signal of about 1 kHz has 10
/// bits.
#[test]
fn pwm_of_10_bits() {
    // The cycle of an MA3 is 1,026 µs. An on time of 1 µs reads 0. An on time of 1,025 µs would read 1,024,
    // but the limit is 1,023.
    for (on, value) in
        [(1, 0), (2, 1), (513, 512), (1_000, 999), (1_023, 1_022), (1_024, 1_023), (1_025, 1_023)]
    {
        assert_eq!(reads("qsb-s", "A", on * 16, 1_026 * 16), (value, 1), "{on} µs");
    }
    // 1 kHz: 333 × 1026 / 1000 = 341.658, 500 × 1.026 = 513, 0.5 × 1.026 = 0.513.
    assert_eq!(reads("qsb-s", "A", 333 * 16, 16_000), (340, 1));
    assert_eq!(reads("qsb-s", "A", 500 * 16, 16_000), (512, 1));
    assert_eq!(reads("qsb-s", "A", 8, 16_000), (0, 1));
    // Periods 5 % off, 1.05 ms and 0.95 ms: 500 × 1026 / 1050 = 488.57, 500 × 1026 / 950 = 540.
    assert_eq!(reads("qsb-s", "A", 500 * 16, 16_800), (487, 1));
    assert_eq!(reads("qsb-s", "A", 500 * 16, 15_200), (539, 1));
}

/// A signal of about 250 Hz has 12 bits: the factor is 4098, and bit 4 of MODE is set.
#[test]
fn pwm_of_12_bits() {
    for (on, value) in [(1, 0), (2, 1), (2_049, 2_048), (4_000, 3_999), (4_096, 4_095), (4_097, 4_095)] {
        assert_eq!(reads("qsb-s", "A", on * 16, 4_098 * 16), (value, 0x11), "{on} µs");
    }
    // 250 Hz: 1,234 × 4098 / 4000 = 1264.233.
    assert_eq!(reads("qsb-s", "A", 1_234 * 16, 64_000), (1_263, 0x11));
}

/// QSB-14: signals below 500 Hz have 12 bits. 1,000 × 1026 / 2000 = 513, 1,000 × 4098 / 2001 =
/// 2047.98.
#[test]
fn pwm_between_10_and_12_bits() {
    assert_eq!(reads("qsb-s", "A", 1_000 * 16, 2_000 * 16), (512, 0x01));
    assert_eq!(reads("qsb-s", "A", 1_000 * 16, 2_001 * 16), (2_046, 0x11));
}

/// QSB-14: after a write of MODE the drive waits for a new period.
#[test]
fn a_write_of_mode_begins_anew() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0001");
    rig.low("A");
    pwm(&mut rig, "A", 2_049 * 16, 4_098 * 16, 3);
    assert_eq!((rig.read("0E"), rig.read("00")), (2_048, 0x11));
    rig.write("W0001");
    assert_eq!((rig.read("0E"), rig.read("00")), (0, 0x01));
}

/// PWM works on every variant, at A or at the pin's other name.
#[test]
fn pwm_at_either_pin() {
    for kind in KINDS {
        for pin in ["A", "PWM"] {
            assert_eq!(reads(kind, pin, 513 * 16, 1_026 * 16), (512, 1), "{kind} {pin}");
        }
    }
}

/// QSB-14: the value is 0 before the first full period. After a signal stops, value and resolution stay.
#[test]
fn pwm_begins_and_stops() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0001");
    rig.low("A");
    assert_eq!((rig.read("0E"), rig.read("00")), (0, 1));
    rig.high("A");
    rig.after(2_049.micros());
    rig.low("A");
    rig.after(1.millis());
    assert_eq!((rig.read("0E"), rig.read("00")), (0, 1));
    rig.after(1_049.micros());
    rig.low("A");
    pwm(&mut rig, "A", 2_049 * 16, 4_098 * 16, 3);
    rig.low("A");
    rig.after(10.secs());
    assert_eq!((rig.read("0E"), rig.read("00")), (2_048, 0x11));
    // The drive also recognizes the other kind of encoder.
    pwm(&mut rig, "A", 513 * 16, 1_026 * 16, 3);
    assert_eq!((rig.read("0E"), rig.read("00")), (512, 0x01));
}

/// The counter counts edges of A in any MODE. Register 07 shows the count.
#[test]
fn the_counter_goes_on() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0340");
    rig.write("W0001");
    rig.low("A");
    pwm(&mut rig, "A", 513 * 16, 1_026 * 16, 9);
    // Ten rising edges while B is high.
    assert_eq!((rig.read("0E"), rig.read("07")), (512, 10));
    rig.write("W0000");
    assert_eq!(rig.read("0E"), 10);
}

/// In PWM mode a stream has the PWM value, with THRESHOLD.
#[test]
fn pwm_is_streamed() {
    let mut rig = Rig::ready("qsb-s");
    for command in ["W0001", "W0C1", "W0B5"] {
        rig.write(command);
    }
    rig.low("A");
    pwm(&mut rig, "A", 100 * 16, 1_026 * 16, 3);
    rig.says(&[("S0E", "s 0E 00000063 !")]);
    let mut hear = |on: u64| {
        pwm(&mut rig, "A", on * 16, 1_026 * 16, 8);
        rig.texts(Duration::ZERO)
    };
    assert_eq!(hear(104), [""; 0]);
    assert_eq!(hear(105), ["s 0E 00000068 !"]);
    assert_eq!(hear(101), [""; 0]);
    assert_eq!(hear(100), ["s 0E 00000063 !"]);
}

/// A QSB in analogue mode with `mv` millivolts at a pin.
fn analogue(kind: &str, pin: &str, mv: i32) -> Rig {
    let mut rig = Rig::ready(kind);
    rig.write("W0002");
    rig.drive(pin, PinStimulus::Millivolts(mv));
    rig
}

/// QSB-15: bits 9:0 of the packet are floor(V × 1024 / 5), at most 1,023.
#[test]
fn volts() {
    for (mv, value) in [
        (0, 0),
        (4, 0),
        (5, 1),
        (10, 2),
        (1_000, 204),
        (2_499, 511),
        (2_500, 512),
        (4_995, 1_022),
        (4_996, 1_023),
        (5_000, 1_023),
        (12_000, 1_023),
        (-500, 0),
    ] {
        let mut rig = analogue("qsb-s", "A", mv);
        assert_eq!(rig.read("0E") & 0xFFF, value, "{mv} mV");
    }
}

/// The analogue input works on every variant, at A or at the pin's other name (QSB-16).
#[test]
fn volts_at_either_pin() {
    for kind in KINDS {
        for pin in ["A", "ANALOG"] {
            let mut rig = analogue(kind, pin, 2_500);
            assert_eq!(rig.read("0E") & 0xFFF, 512, "{kind} {pin}");
        }
        let mut rig = Rig::ready(kind);
        rig.write("W0002");
        // An open A is pulled up.
        assert_eq!(rig.read("0E") & 0xFFF, 1_023);
        // A low level is 0 V, a high level is 5 V.
        rig.low("A");
        assert_eq!(rig.read("0E") & 0xFFF, 0);
        rig.high("A");
        assert_eq!(rig.read("0E") & 0xFFF, 1_023);
    }
}

/// The packet: a 16-bit time stamp in units of 500 µs since power-on, bits 3:0 of the port, 00, and
/// the value.
#[test]
fn packets() {
    let mut rig = analogue("qsb-m", "A", 2_500);
    rig.low("DIO2");
    rig.low("DIO0");
    rig.at(100.millis() + 250.micros());
    rig.says(&[("R0E", "r 0E 00C8A200 !")]);
    // The clock is not that of TIME STAMP, which W0D1 clears.
    rig.says(&[("W0D1", "w 0D 00000001 !")]);
    rig.at(1.secs() + 250.micros());
    rig.says(&[("R0E", "r 0E 07D0A200 !")]);
    rig.at(32_767.millis() + 750.micros());
    rig.says(&[("R0E", "r 0E FFFFA200 !")]);
    // The time stamp wraps every 32.768 s.
    rig.at(32_768.millis() + 250.micros());
    rig.says(&[("R0E", "r 0E 0000A200 !")]);
    rig.at(40_000.millis() + 250.micros());
    rig.says(&[("R0E", "r 0E 3880A200 !")]);
}

/// Bits without a pin read 1. A -D has only the lowest bit.
#[test]
fn packets_without_a_port() {
    let mut rig = analogue("qsb-s", "A", 2_500);
    rig.at(100.millis() + 250.micros());
    rig.says(&[("R0E", "r 0E 00C8F200 !")]);
    let mut rig = analogue("qsb-d", "A", 2_500);
    rig.low("DIO0");
    rig.at(100.millis() + 250.micros());
    rig.says(&[("R0E", "r 0E 00C8E200 !")]);
}

/// A stream has packets. THRESHOLD applies to the value (QSB-15).
#[test]
fn volts_are_streamed() {
    let mut rig = analogue("qsb-m", "A", 1_000);
    rig.write("W0C1");
    rig.write("W0B3");
    rig.past_tick(100);
    rig.ask("S0E");
    // A change of the time stamp or of the port sends no record.
    rig.low("DIO0");
    assert_eq!(rig.texts(1.secs()), [""; 0]);
    rig.drive("A", PinStimulus::Millivolts(1_010)); // 206
    assert_eq!(rig.texts(1.secs()), [""; 0]);
    rig.drive("A", PinStimulus::Millivolts(1_011)); // 207.05
    let heard = rig.hear(1.secs());
    assert_eq!(heard.len(), 1);
    let (at, text) = &heard[0];
    let stamp = at.since(rig.power).ticks() / 8_000;
    assert_eq!(*text, format!("s 0E {:08X} !", stamp << 16 | 0xE000 | 207));
    // With threshold 0 every packet is sent.
    rig.write("W0B0");
    let heard = rig.hear(TICK * 100);
    assert!(heard.len() >= 99);
    for (at, text) in heard {
        let stamp = at.since(rig.power).ticks() / 8_000 % 0x1_0000;
        assert_eq!(text, format!("s 0E {:08X} !", stamp << 16 | 0xE000 | 207));
    }
}

/// A voltage above 1,400 mV at A is a high level for the counter.
#[test]
fn volts_are_levels_too() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0340");
    for _ in 0..5 {
        rig.drive("A", PinStimulus::Millivolts(400));
        rig.drive("A", PinStimulus::Millivolts(3_000));
    }
    rig.says(&[("R0E", "r 0E 00000005 !")]);
}
