//! Tests of functions, exceptions and addresses (6, 6.1 to 6.8).

use super::*;

#[test]
fn the_four_spaces_are_read_by_their_functions() {
    let mut dut = ready();
    // Only HARD_STOP is closed.
    assert_eq!(dut.pdu(&[2, 0x10, 0, 0, 3]), [2, 1, 0b100]);
    assert_eq!(dut.pdu(&[1, 0x20, 0, 0, 4]), [1, 1, 0]);
    assert_eq!(dut.pdu(&[4, 0x80, 1, 0, 1]), [4, 2, 0x03, 0xE9]); // 1001
    // Address 1, RTU 8E1, 115,200 baud, no delay.
    assert_eq!(dut.pdu(&[3, 0x50, 0, 0, 4]), [3, 8, 0, 1, 0, 3, 0, 9, 0, 0]);
    // The same addresses do not exist in another space.
    assert_eq!(dut.pdu(&[3, 0x10, 0, 0, 1]), [0x83, 2]);
    assert_eq!(dut.pdu(&[4, 0x50, 0, 0, 1]), [0x84, 2]);
    assert_eq!(dut.pdu(&[1, 0x10, 0, 0, 1]), [0x81, 2]);
    assert_eq!(dut.pdu(&[2, 0x20, 0, 0, 1]), [0x82, 2]);
}

#[test]
fn the_whole_of_5000h_is_read_at_once() {
    let mut dut = ready();
    let reply = dut.pdu(&[3, 0x50, 0, 0, 0x27]);
    assert_eq!(reply[..2], [3, 2 * 0x27]);
    // The factory values in the order of the registers. The manual prints the values of the line settings
    // (section 6); the others are our choice (RS434-7).
    let mut words = [0; 0x27];
    words[..0x15]
        .copy_from_slice(&[1, 3, 9, 0, 1, 1, 1, 1, 1, 20_000, 3_000, 1_000, 100, 100, 1, 4, 2, 0, 0, 10, 10]);
    let bytes: Vec<u8> = words.iter().flat_map(|word: &u16| word.to_be_bytes()).collect();
    assert_eq!(reply[2..], bytes);
    assert_eq!(dut.pdu(&[3, 0x50, 0, 0, 0x28]), [0x83, 2]);
}

#[test]
fn the_other_model_has_another_current_and_another_name() {
    let mut dut = without_power();
    dut.drive = Rs434::rs434546();
    dut.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(dut.read(0x5009), 40_000);
    assert_eq!(dut.pdu(&[4, 0x80, 1, 0, 1]), [4, 2, 0x03, 0xEA]); // 1002
    assert_eq!(dut.try_write(0x5009, 1_999), [0x86, 3]);
    dut.write(0x5009, 2_000);
    let mut dut = ready();
    assert_eq!(dut.try_write(0x5009, 999), [0x86, 3]);
    assert_eq!(dut.try_write(0x5009, 20_001), [0x86, 3]);
    dut.write(0x5009, 1_000);
}

#[test]
fn what_is_refused_changes_nothing() {
    let mut dut = ready();
    assert_eq!(dut.pdu(&[7]), [0x87, 1]);
    assert_eq!(dut.pdu(&[3, 0x50, 0, 0, 0]), [0x83, 3]);
    assert_eq!(dut.pdu(&[3, 0x50, 0, 0, 126]), [0x83, 3]);
    assert_eq!(dut.pdu(&[5, 0x20, 0, 0x12, 0x34]), [0x85, 3]);
    assert_eq!(dut.try_write(0x7006, 1), [0x86, 2]); // PC_REG
    assert_eq!(dut.try_write(0x5027, 1), [0x86, 2]);
    assert_eq!(dut.get(Reg::ERROR), 0);
    // If one value is out of range, nothing is written: bit 13.
    assert_eq!(dut.try_write_all(0x500B, &[2_000, 1_001]), [0x90, 3]);
    assert_eq!((dut.get(Reg::SPEED), dut.get(Reg::ERROR)), (1_000, 1 << 13));
    dut.write(0x5023, 0);
    assert_eq!(dut.get(Reg::ERROR), 0);
    assert_eq!(dut.try_write(0x5024, 0x37FB), [0x86, 3], "a wrong key");
    assert_eq!(dut.get(Reg::ERROR), 1 << 13);
    assert!(dut.out.stores.is_empty());
}

#[test]
fn addresses_go_before_values_and_values_before_what_cannot_be_now() {
    let mut dut = ready();
    // 37FBh is a wrong key in 5024h, and there is no register after 5026h.
    assert_eq!(dut.try_write_all(0x5024, &[0x37FB, 0, 0, 0]), [0x90, 2]);
    // FX_REG accepts any value, but PC_REG cannot be written.
    assert_eq!(dut.try_write_all(0x7005, &[1, 1]), [0x90, 2]);
    assert_eq!(dut.get(Reg::ERROR), 0, "no value was looked at");
    // A program that jumps to itself: 8426h is refused while it runs, but 1 is a wrong key.
    dut.set(Reg::CMD_W, 0x85);
    dut.set(Reg::WRITE_CMD, 0);
    dut.set(Reg::FLAG_SAVE_USER_PROGRAM, 0x8426);
    dut.set(Reg::MODE_USER_PROGRAM, 2);
    dut.wait(1.millis());
    assert_eq!(dut.try_write_all(0x5025, &[0x8426, 0]), [0x90, 4]);
    assert_eq!(dut.get(Reg::ERROR), 0);
    assert_eq!(dut.try_write_all(0x5025, &[0x8426, 1]), [0x90, 3]);
    assert_eq!(dut.get(Reg::ERROR), 1 << 13);
}

#[test]
fn values_of_32_bits_have_the_low_word_first() {
    let mut dut = ready();
    assert_eq!(dut.try_write_all(0x501B, &[0x5678, 0x1234])[0], 16);
    assert_eq!(dut.get(Reg::TARGET_POSITION1), 0x1234_5678);
    dut.write(0x501C, 0xFFFF);
    assert_eq!(dut.get(Reg::TARGET_POSITION1), -0x1_0000 + 0x5678);
    dut.write(0x5012, 0xFFF1);
    assert_eq!(dut.get(Reg::OFFSET_COMPENSATION), -15);
}

#[test]
fn a_broadcast_is_carried_out_and_not_answered() {
    let mut dut = ready();
    assert!(dut.ask(&rtu::write(0, 0x500B, 2_000)).is_empty());
    assert_eq!(dut.get(Reg::SPEED), 2_000);
    assert!(dut.ask(&rtu::write(2, 0x500B, 3_000)).is_empty());
    assert_eq!(dut.get(Reg::SPEED), 2_000);
}

#[test]
fn address_0_obeys_broadcasts_and_answers_nothing() {
    let mut dut = saved(&[(Reg::SLAVE_ADDRESS_MODBUS, 0)]);
    assert!(dut.ask(&rtu::write(1, 0x500B, 2_000)).is_empty());
    assert_eq!(dut.get(Reg::SPEED), 1_000);
    assert!(dut.ask(&rtu::write(0, 0x500B, 2_000)).is_empty());
    assert_eq!(dut.get(Reg::SPEED), 2_000);
}

#[test]
fn every_reply_waits_for_the_timeout() {
    let mut dut = saved(&[(Reg::TIMEOUT_BROADCAST_MODBUS, 100)]);
    let sent = dut.now + CHARACTER * 8;
    assert_eq!(dut.read(0x500B), 1_000);
    assert_eq!(dut.out.sent(Port(0))[0].0, sent + 100.millis());
    // A new value takes effect at the next start.
    dut.write(0x5003, 200);
    let sent = dut.now + CHARACTER * 8;
    assert_eq!(dut.read(0x5003), 200);
    assert_eq!(dut.out.sent(Port(0))[2].0, sent + 100.millis());
}

#[test]
fn the_reply_leaves_after_the_silence() {
    let mut dut = ready();
    let first = dut.now + CHARACTER;
    dut.input(first, Input::Bytes { port: Port(0), bytes: &rtu::read(1, 0x500B, 1) });
    // The end is detected after 1.75 ms of silence (above 19,200 baud) and one more character.
    let last = first + CHARACTER * 7;
    let silence = last + 1_750.micros() + CHARACTER;
    dut.run_until(silence - Duration::TICK);
    assert!(dut.out.bytes.is_empty());
    dut.run_until(silence);
    assert_eq!(dut.out.sent(Port(0)), [(silence, rtu::frame(1, &[3, 2, 0x03, 0xE8]).to_vec())]);
    assert_eq!(dut.out.noted(), [LogEvent::Request { port: Port(0), unit: 1, function: 3 }]);
}

/// What is due comes first, whatever tells that the request is over (MODBUS-7).
#[test]
fn a_contact_that_takes_effect_in_the_instant_of_a_request_is_read() {
    let next = Input::Bytes { port: Port(0), bytes: &[9] };
    for over in [None, Some(next), Some(Input::Idle { port: Port(0) })] {
        let mut dut = ready();
        let request = rtu::frame(1, &[2, 0x10, 0, 0, 3]);
        let first = dut.now + 1.secs();
        let end = first + CHARACTER * (request.len() as u64 - 1) + 1_750.micros() + CHARACTER;
        // IN1 is closed for the factory setting of PRESSED_INPUTS_EXTERN, 10 ms.
        dut.run_until(end - 10.millis());
        dut.contact(IN1, true);
        dut.input(first, Input::Bytes { port: Port(0), bytes: &request });
        dut.run_until(end - Duration::TICK);
        assert!(dut.out.bytes.is_empty());
        if let Some(over) = over {
            dut.input(end, over);
        }
        dut.run_until(end);
        assert_eq!(dut.out.sent(Port(0)), [(end, rtu::frame(1, &[2, 1, 0b101]).to_vec())], "{over:?}");
    }
}

#[test]
fn in_ascii_it_answers_in_ascii() {
    let mut dut = saved(&[(Reg::TYPE_MODBUS, 1), (Reg::BITRATE_MODBUS, 5)]);
    let line = dut.out.lines.last().unwrap().2;
    assert_eq!((line.baud, line.data, line.stop), (14_400, 7, 1));
    // The sum 01 + 03 + 50 + 0B + 01 is 60h, so the LRC is A0h.
    let at = dut.now + line.character();
    dut.input(at, Input::Bytes { port: Port(0), bytes: b":0103500B0001A0\r\n" });
    dut.run_until(at + 1.secs());
    // The sum 01 + 03 + 02 + 03 + E8 is F1h, so the LRC is 0Fh.
    assert_eq!(dut.out.sent(Port(0)), [(at + line.character() * 16, b":01030203E80F\r\n".to_vec())]);
}

#[test]
fn a_new_random_number_at_each_read() {
    let mut dut = ready();
    let mut read = || dut.pdu(&[4, 0x30, 8, 0, 1]);
    let numbers = [read(), read(), read(), read()];
    assert!(numbers.windows(2).any(|two| two[0] != two[1]), "{numbers:02X?}");
    assert_eq!(dut.get(Reg::TASK_COUNTER), dut.get(Reg::TASK_COUNTER), "looking is not reading");
}

#[test]
fn wrong_parity_is_bit_14() {
    let mut dut = ready();
    dut.input(dut.now + CHARACTER, Input::RxError { port: Port(0) });
    assert_eq!(dut.get(Reg::ERROR), 1 << 14);
    dut.wait(5.millis());
    assert_eq!(dut.read(0x5023), 1 << 14);
    dut.write(0x5023, !(1 << 14));
    assert_eq!(dut.get(Reg::ERROR), 0);
}

#[test]
fn contacts_show_before_they_are_debounced() {
    let mut dut = ready();
    dut.contact(IN2, true);
    dut.contact(HARD_STOP, false);
    assert_eq!(dut.pdu(&[2, 0x10, 0, 0, 3]), [2, 1, 0b010]);
}

#[test]
fn the_program_buffer_is_written_in_one_request() {
    let mut dut = ready();
    assert_eq!(dut.try_write_all(0x6000, &[1_023, 0xABCD, 0x1234])[0], 16);
    dut.write(0x6003, 1_023);
    assert_eq!(dut.pdu(&[3, 0x60, 3, 0, 3]), [3, 6, 0x03, 0xFF, 0xAB, 0xCD, 0x12, 0x34]);
    assert_eq!(dut.read(0x6000), 1_023);
    assert_eq!(dut.try_write(0x6000, 1_024), [0x86, 3]);
    assert_eq!(dut.try_write(0x6003, 1_024), [0x86, 3]);
    dut.write(0x6003, 1_022);
    assert_eq!(dut.read(0x6004), 0);
}
