//! PWM and analogue encoders.

use super::*;

/// Makes `count` periods of a PWM encoder with this on time and period.
fn periods(dut: &mut Dut, pin: Pin, on: Duration, period: Duration, count: usize) {
    for _ in 0..count {
        dut.pin(pin, true);
        dut.wait(on);
        dut.pin(pin, false);
        dut.wait(period - on);
    }
    dut.pin(pin, true);
}

#[test]
fn a_pwm_encoder_reads_by_the_formula_of_its_data_sheet() {
    // MA3: x = on × 1026 / period - 1 with 10 bits, × 4098 with 12 bits; computed by hand.
    for (on, period, mode, value) in [
        (1_u64, 1_026_u64, 0x01, 0),
        (513, 1_026, 0x01, 512),
        (1_024, 1_026, 0x01, 1_023),
        (1_025, 1_026, 0x01, 1_023),
        (500, 1_000, 0x01, 512),
        (1, 4_098, 0x11, 0),
        (2_050, 4_098, 0x11, 2_049),
        (4_096, 4_098, 0x11, 4_095),
        (4_097, 4_098, 0x11, 4_095),
        (1_000, 4_000, 0x11, 1_023),
    ] {
        for make in [Qsb::s, Qsb::m] {
            let mut dut = Dut::ready(make());
            dut.pin(A, false);
            dut.write("W0001");
            periods(&mut dut, A, on.micros(), period.micros(), 2);
            assert_eq!(dut.ask("R0E"), std::format!("r 0E {value:08X} !"), "{on} of {period}");
            assert_eq!(dut.ask("R00"), std::format!("r 00 {mode:08X} !"));
        }
    }
}

#[test]
fn before_a_whole_period_there_is_no_value_and_the_last_one_stays() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0001");
    dut.pin(A, false);
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
    dut.pin(A, true);
    dut.wait(2_050.micros());
    dut.pin(A, false);
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
    dut.run_until(Instant::from(60.millis()));
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0001");
    dut.pin(A, false);
    periods(&mut dut, A, 2_050.micros(), 4_098.micros(), 1);
    assert_eq!(dut.ask("R0E"), "r 0E 00000801 !");
    dut.wait(10.secs());
    assert_eq!(dut.ask("R0E"), "r 0E 00000801 !");
    assert_eq!(dut.ask("R00"), "r 00 00000011 !");
}

#[test]
fn other_modes_look_at_no_pulse_width() {
    let mut dut = Dut::ready(Qsb::m());
    dut.pin(A, false);
    periods(&mut dut, A, 2_050.micros(), 4_098.micros(), 3);
    assert_eq!(dut.ask("R00"), "r 00 00000000 !");
    dut.write("W0001");
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
}

#[test]
fn an_analogue_encoder_reads_10_bits_of_5_volts() {
    for (mv, value) in [
        (0, 0),
        (4, 0),
        (5, 1),
        (2_500, 512),
        (4_995, 1_022),
        (4_996, 1_023),
        (5_000, 1_023),
        (9_000, 1_023),
        (-1, 0),
    ] {
        let mut dut = Dut::ready(Qsb::s());
        dut.write("W0002");
        dut.volts(A, mv);
        dut.run_until(50.millis());
        // 50 ms are 100 units of 500 µs; the QSB-S has no digital lines.
        let packet = 100 << 16 | 0xF << 12 | value;
        assert_eq!(dut.get(Reg::ReadEncoder), packet, "{mv} mV");
    }
}

#[test]
fn the_packet_has_its_own_stamp_and_the_digital_lines() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0002");
    dut.volts(A, 2_500);
    dut.pin(DIO0, false);
    dut.pin(DIO2, false);
    dut.run_until(Duration::micros(999_999));
    dut.write("W0D1");
    assert_eq!(dut.get(Reg::ReadEncoder) >> 16, 0x7D1, "W0D1 leaves it");
    // The timestamp wraps after 65,536 × 500 µs.
    dut.run_until(32_768.millis());
    assert_eq!(dut.get(Reg::ReadEncoder), 0x0000_A200);
    dut.run_until(32_768.millis() - 1.micros() + Duration::millis(40));
    assert_eq!(dut.ask("R0E")[..9], *"r 0E 0050");
}

#[test]
fn a_level_is_0_or_5_volts_and_a_voltage_is_a_level() {
    let mut dut = Dut::ready(Qsb::m());
    assert_eq!(dut.get(Reg::Mode), 0);
    dut.write("W0002");
    assert_eq!(dut.get(Reg::ReadEncoder) & 0x3FF, 1_023, "an open A is pulled up");
    dut.pin(A, false);
    dut.pin(A, true);
    assert_eq!(dut.get(Reg::ReadEncoder) & 0x3FF, 1_023);
    dut.pin(A, false);
    assert_eq!(dut.get(Reg::ReadEncoder) & 0x3FF, 0);
    // The counter also counts edges of A in this mode: B is high, A falls and rises.
    dut.write("W0343");
    dut.write("W0000");
    dut.write("W092");
    dut.volts(A, 1_401);
    dut.wait(1.micros());
    assert_eq!(dut.ask("R0E"), "r 0E FFFFFFFF !");
    dut.volts(A, 1_400);
    dut.wait(1.micros());
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
}
