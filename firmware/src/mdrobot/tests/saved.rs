//! What a power cycle leaves, id and baud, presets.

use super::*;

/// PIDs of one word that are saved, with a value that is not the factory's.
const SAVED: [(u8, u16); 21] = [
    (16, 1),
    (17, 0),
    (19, 1),
    (21, 2),
    (24, 3),
    (25, 5),
    (36, 1),
    (37, 1),
    (40, 1),
    (44, 1),
    (45, 1),
    (153, 1),
    (154, 2),
    (155, 3),
    (156, 4),
    (167, 5),
    (168, 6),
    (169, 7),
    (171, 8),
    (183, 4),
    (221, 900),
];

/// And what a new drive has there.
fn factory(pid: u8) -> u16 {
    match pid {
        17 => 1,
        167 => 20,
        168 | 169 => 6_000,
        211 => 200,
        221 => 3_000,
        _ => 0,
    }
}

#[test]
fn every_value_is_saved_as_it_is_written() {
    for (pid, value) in SAVED.into_iter().chain([(157, 9), (158, 513), (181, 10), (211, 11)]) {
        let mut bed = Bed::ready();
        let before = bed.read(pid);
        bed.write(pid, value);
        bed.wait(10.millis());
        bed.cycle();
        let other = if pid == 181 { 200 } else { factory(pid) };
        assert_eq!((before, bed.read(pid)), (other, value), "PID {pid}");
        for (other, _) in SAVED {
            assert!(other == pid || bed.read(other) == factory(other), "PID {other} beside {pid}");
        }
    }
    let mut bed = Bed::ready();
    bed.write_words(222, &[5, 600]);
    bed.write_words(239, &[6, 7]);
    bed.write_words(250, &[8, 9]);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!((bed.read(157), bed.read(158)), (5, 600));
    assert_eq!((bed.read_words(239, 2), bed.read_words(250, 2)), (vec![6, 7], vec![8, 9]));
}

#[test]
fn commands_are_forgotten() {
    let mut bed = Bed::ready();
    for (pid, value) in [(78, 1), (100, 2), (130, 100), (180, 200)] {
        bed.write(pid, value);
        assert_eq!(bed.read(pid), value);
    }
    assert_eq!(bed.world.stores, []);
    bed.wait(1.secs());
    bed.cycle();
    assert_eq!([bed.read(78), bed.read(100), bed.read(130), bed.read(180)], [0; 4]);
    assert_eq!(bed.get(Pid::POSI_DATA), 0);
}

#[test]
fn a_save_takes_10_ms_and_begins_again() {
    let mut bed = Bed::ready();
    bed.set(Pid::PV_GAIN, 7);
    bed.wait(6.millis());
    bed.set(Pid::PV_GAIN, 8);
    bed.wait(1.secs());
    let stores: Vec<_> = bed.world.stores.iter().map(|(at, offset, _)| (*at, *offset)).collect();
    let check_sum = MEMORY as u16 - 2;
    let begun = Instant::from(6.millis());
    assert_eq!(stores, [(Instant::ZERO, 0), (begun, 0), (begun + 10.millis(), check_sum)]);
}

#[test]
fn power_lost_in_a_save_leaves_the_new_values() {
    let mut bed = Bed::ready();
    bed.set(Pid::CONTROLLER_ID, 9);
    bed.wait(1.secs());
    bed.set(Pid::PV_GAIN, 7);
    bed.wait(10.millis() - Duration::TICK);
    bed.cycle();
    assert_eq!((bed.get(Pid::PV_GAIN), bed.get(Pid::CONTROLLER_ID)), (7, 9));
    bed.set(Pid::PV_GAIN, 8);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!((bed.get(Pid::PV_GAIN), bed.get(Pid::CONTROLLER_ID)), (8, 9));
}

#[test]
fn default_set_leaves_id_and_baud() {
    let mut bed = Bed::ready();
    for (pid, value) in SAVED.into_iter().chain([(157, 9), (158, 513), (211, 11)]) {
        bed.write(pid, value);
    }
    bed.write_words(239, &[6, 7]);
    bed.write(78, 1);
    bed.write(133, 0x07AA);
    bed.write(135, 0x05AA);
    bed.set(Pid::INT_VOLUME, 33);
    for key in [0, 0x54, 0x5500, 0x0155, 0xFFFF] {
        bed.write(3, key);
        assert_eq!(bed.read(167), 5, "{key:#06x} is no key");
    }
    bed.write(3, 0x55);
    for again in [false, true] {
        for pid in SAVED.map(|(pid, _)| pid).into_iter().chain([157, 158, 211]) {
            assert_eq!(bed.read(pid), factory(pid), "PID {pid}, {again}");
        }
        assert_eq!(bed.read_words(239, 2), [1_000, 10]);
        assert_eq!(bed.read(78), u16::from(!again), "it is not saved, and so not restored");
        let kept = [Pid::CONTROLLER_ID, Pid::CONTROLLER_BAUD, Pid::INT_VOLUME].map(|pid| bed.get(pid));
        assert_eq!(kept, [7, 5, 33]);
        bed.wait(10.millis());
        if !again {
            bed.cycle();
            bed.id = 7;
        }
    }
}

#[test]
fn id_and_baud_want_a_key_and_a_power_cycle() {
    let mut bed = Bed::ready();
    for word in [0x0500, 0x05AB, 0xAA05, 0x0005] {
        bed.write(133, word);
        bed.write(135, word);
    }
    assert_eq!((bed.get(Pid::CONTROLLER_ID), bed.get(Pid::CONTROLLER_BAUD)), (1, 2));
    for word in [0x00AA, 0xFEAA, 0xFFAA] {
        assert_eq!(bed.try_write(133, word), [0x86, 3]);
    }
    for word in [0x00AA, 0x06AA, 0xFFAA] {
        assert_eq!(bed.try_write(135, word), [0x86, 3]);
    }
    bed.write(133, 0xFDAA);
    bed.write(135, 0x05AA);
    bed.wait(1.secs());
    assert_eq!(bed.read(1), 81, "by the old id and at the old speed");
    assert_eq!(bed.pdu(&[3, 0, 133, 0, 1]), [0x83, 2], "write only");
    bed.cycle();
    assert_eq!(bed.world.lines.last().unwrap().1, line(115_200));
    assert_eq!(bed.pdu(&[3, 0, 1, 0, 1]), [0; 0], "the old id is a stranger's");
    bed.id = 253;
    assert_eq!(bed.read(1), 81);
}

#[test]
fn codes_of_baudrate() {
    for (code, baud) in [(1, 9_600), (2, 19_200), (3, 38_400), (4, 57_600), (5, 115_200)] {
        let mut bed = Bed::new();
        bed.set(Pid::CONTROLLER_BAUD, code);
        bed.power_on();
        assert_eq!(bed.world.lines, [(Instant::ZERO, line(baud))]);
    }
}

#[test]
fn presets_before_power_are_in_the_memory() {
    let mut bed = Bed::new();
    bed.set(Pid::CONTROLLER_ID, 9);
    bed.set(Pid::MAX_RPM, 400);
    bed.set(Pid::FUNC_CMD_TYPE, 0x0102);
    bed.set(Pid::FUNC_SPEED, 3 << 16 | 2);
    assert_eq!(bed.try_set(Pid::UI_COM, 1), Err(Refused::ReadOnly));
    assert_eq!(bed.try_set(Pid::CONTROLLER_ID, 254), Err(Refused::OutOfRange));
    assert_eq!(bed.try_set(Pid::FUNC_CMD_TYPE, 5), Err(Refused::OutOfRange));
    assert_eq!(bed.try_set(Pid::HIGH_SPEED_LIMIT, 511), Err(Refused::OutOfRange));
    bed.power_on();
    bed.id = 9;
    assert_eq!((bed.read(221), bed.read(183), bed.read_words(239, 2)), (400, 2, vec![2, 3]));
    assert_eq!(bed.world.stores.len(), 8, "two for each");
}

#[test]
fn presets_with_power_act_as_writes() {
    let mut bed = Bed::ready();
    bed.set(Pid::MAX_LOAD_181, 44);
    assert_eq!(bed.read(211), 44);
    bed.set(Pid::SPEED_LIMIT, 700 << 16 | 3);
    assert_eq!((bed.read(157), bed.read(158)), (3, 700));
    assert_eq!(bed.try_set(Pid::ID, 0x00AA), Err(Refused::OutOfRange));
    assert_eq!(bed.try_set(Pid::VERSION, 256), Err(Refused::OutOfRange));
    bed.set(Pid::VERSION, 13);
    assert_eq!(bed.read(1), 13);
    assert_eq!(bed.try_set(Pid::MAIN_DATA, 0), Err(Refused::ReadOnly));
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!((bed.read(211), bed.read(157), bed.read(158)), (44, 3, 700));
}

/// Puts a check sum that holds under a memory.
fn sign(memory: &mut [u8]) {
    let (image, sum) = memory.split_at_mut(MEMORY - 2);
    sum.copy_from_slice(&rtu::crc(image).to_be_bytes());
}

/// What is saved after a write.
fn saved(pid: Pid, value: i64) -> Vec<u8> {
    let mut bed = Bed::ready();
    bed.set(pid, value);
    bed.wait(10.millis());
    bed.world.memory
}

#[test]
fn a_memory_of_somebody_else_brings_no_function_that_is_none() {
    let [one, other] = [0, 3].map(|number| saved(Pid::FUNC_CMD_TYPE, number));
    // The low byte, behind the high one.
    let place = (0..MEMORY - 2).find(|&place| one[place] != other[place]).unwrap();
    for (number, brought) in [(0x0004_u16, 4), (0x0005, 0), (0x0104, 0), (0xFFFF, 0)] {
        let mut memory = one.clone();
        memory[place - 1..=place].copy_from_slice(&number.to_be_bytes());
        sign(&mut memory);
        let mut bed = Bed::off(memory);
        bed.power_on();
        assert_eq!(bed.read(183), brought, "{number:#06x}");
    }
}

#[test]
fn a_memory_of_somebody_else_brings_what_may_be() {
    let mut bed = Bed::ready();
    bed.set(Pid::PV_GAIN, 7);
    bed.wait(10.millis());
    // TQ_CTRL, BLUETOOTH and all before it become 0xFFFF.
    bed.world.memory[..22].fill(0xFF);
    sign(&mut bed.world.memory);
    bed.cycle();
    assert_eq!([bed.read(16), bed.read(17), bed.read(25), bed.read(44), bed.read(45)], [0, 1, 0, 0, 0]);
    assert_eq!(bed.read(167), 7);
}

/// A memory of 31 words, before TAR_POSI_VEL, POSI_SS and POSI_SD were there: COM_TAR_SPEED and the gains are found,
/// and the three have their factory values.
#[test]
fn a_memory_without_the_later_pids_is_good() {
    let mut words = [0_u16; 31];
    words[1] = 1;
    // The 18th is PV_GAIN, the 24th MAX_RPM, the last but one the address.
    (words[17], words[18], words[19], words[22], words[23]) = (25, 5_000, 4_000, 150, 2_000);
    (words[24], words[25], words[26], words[27], words[28], words[29]) = (1_000, 10, 1_500, 240, 1, 2);
    let mut memory: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
    memory.extend(standin_protocol::modbus::rtu::crc(&memory).to_be_bytes());
    // The file ends there.
    memory.resize(MEMORY, 0xFF);
    let mut bed = Bed::off(memory);
    bed.power_on();
    assert_eq!([167, 168, 169, 211, 221].map(|pid| bed.read(pid)), [25, 5_000, 4_000, 150, 2_000]);
    assert_eq!([176, 178, 179].map(|pid| bed.read(pid)), [5_000, 0, 0]);
    // It is kept as one with them from the next save on.
    bed.write(178, 7);
    bed.wait(10.millis());
    bed.cycle();
    assert_eq!([167, 178, 221].map(|pid| bed.read(pid)), [25, 7, 2_000]);
}
