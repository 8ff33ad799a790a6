//! Values after a power cycle, id and baud rate, presets.

use super::*;

/// Saved PIDs of one word, each with a value that is not the factory's.
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

/// The factory value of a PID of [`SAVED`].
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
        let mut dut = Dut::ready();
        let before = dut.read(pid);
        dut.write(pid, value);
        dut.cycle();
        let other = if pid == 181 { 200 } else { factory(pid) };
        assert_eq!((before, dut.read(pid)), (other, value), "PID {pid}");
        for (other, _) in SAVED {
            assert!(other == pid || dut.read(other) == factory(other), "PID {other} beside {pid}");
        }
    }
    let mut dut = Dut::ready();
    dut.write_words(222, &[5, 600]);
    dut.write_words(239, &[6, 7]);
    dut.write_words(250, &[8, 9]);
    dut.cycle();
    assert_eq!((dut.read(157), dut.read(158)), (5, 600));
    assert_eq!((dut.read_words(239, 2), dut.read_words(250, 2)), (vec![6, 7], vec![8, 9]));
}

#[test]
fn commands_are_forgotten() {
    let mut dut = Dut::ready();
    for (pid, value) in [(78, 1), (100, 2), (130, 100), (180, 200)] {
        dut.write(pid, value);
        assert_eq!(dut.read(pid), value);
    }
    assert_eq!(dut.out.stored(), []);
    dut.wait(1.secs());
    dut.cycle();
    assert_eq!([dut.read(78), dut.read(100), dut.read(130), dut.read(180)], [0; 4]);
    assert_eq!(dut.get(Pid::POSI_DATA), 0);
}

#[test]
fn saves_take_turns_between_two_copies_and_no_time() {
    let mut dut = Dut::ready();
    for value in 7..10 {
        dut.set(Pid::PV_GAIN, value);
    }
    let half = MEMORY / 2;
    let store = |offset| (Instant::ZERO, offset as u16, half);
    assert_eq!(dut.out.stored(), [store(half), store(0), store(half)]);
    dut.cycle();
    assert_eq!(dut.get(Pid::PV_GAIN), 9);
}

/// `PV_GAIN` and the id of a drive that starts with this memory.
fn loaded(memory: &[u8]) -> [i64; 2] {
    let mut dut = Dut::off(memory.to_vec());
    dut.power_on_fast();
    [Pid::PV_GAIN, Pid::CONTROLLER_ID].map(|pid| dut.get(pid))
}

/// The counter of the saves wraps during this test.
#[test]
fn power_lost_at_any_byte_of_a_save_leaves_the_old_or_the_new_values() {
    let mut dut = Dut::ready();
    let mut old = [20, 1];
    for n in 0..300 {
        let before = dut.out.memory.clone();
        dut.out.stores.clear();
        // The id is stored close to the end of the copy.
        let (pid, value, new) = match n % 2 {
            0 => (Pid::PV_GAIN, 0xFFFF - n * 0x99, [0xFFFF - n * 0x99, old[1]]),
            _ => (Pid::ID, (2 + n % 251) << 8 | 0xAA, [old[0], 2 + n % 251]),
        };
        dut.set(pid, value);
        let [(_, offset, length)] = dut.out.stored()[..] else { panic!("one store for each write") };
        let stored = usize::from(offset)..usize::from(offset) + length;
        for end in stored.clone() {
            let mut memory = before.clone();
            memory[stored.start..end].copy_from_slice(&dut.out.memory[stored.start..end]);
            assert_eq!(loaded(&memory), old, "save {n}, {} of {length} bytes", end - stored.start);
            // The next save replaces the broken copy, not the good one.
            let mut next = Dut::off(memory);
            next.power_on_fast();
            next.set(Pid::MAX_RPM, 400 + n);
            let [(_, offset, length)] = next.out.stored()[..] else { panic!("one store for each write") };
            assert_eq!(
                (usize::from(offset), length),
                (stored.start, stored.len()),
                "over the copy that is broken"
            );
            assert_eq!(loaded(&next.out.memory), old, "save {n}, cut and made good");
        }
        assert_eq!(loaded(&dut.out.memory), new, "save {n}");
        old = new;
    }
}

/// CMD 29 restores the factory values of two PIDs.
#[test]
fn power_lost_in_a_command_of_two_pids_leaves_neither_or_both() {
    let mut dut = Dut::ready();
    dut.write_words(222, &[5, 600]);
    let mut before = dut.out.memory.clone();
    dut.out.stores.clear();
    dut.write(10, 29);
    let (_, offset, length) = dut.out.stored()[0];
    let first = usize::from(offset)..usize::from(offset) + length;
    let limits = |memory: &[u8]| {
        let mut dut = Dut::off(memory.to_vec());
        dut.power_on_fast();
        [dut.read(157), dut.read(158)]
    };
    assert_eq!(limits(&before), [5, 600]);
    // The second save replaces the other copy.
    before[first.clone()].copy_from_slice(&dut.out.memory[first]);
    assert_eq!(limits(&before), [0, 0]);
}

/// A memory written at commit 681fd38 has one image. Power is lost at each byte of the first save after it.
#[test]
fn a_memory_of_one_image_is_left_alone_by_the_first_save() {
    let image = include_bytes!("../../../../tests/recordings/681fd38/mdrobot.nv");
    let mut memory = image.to_vec();
    memory.resize(MEMORY, 0xFF);
    assert_eq!(loaded(&memory), [20, 7]);
    let mut dut = Dut::off(memory.clone());
    dut.power_on_fast();
    dut.id = 7;
    dut.write(167, 33);
    assert_eq!(dut.out.memory[..image.len()], *image);
    let half = MEMORY / 2;
    for length in 0..half {
        let mut cut = memory.clone();
        cut[half..half + length].copy_from_slice(&dut.out.memory[half..half + length]);
        assert_eq!(loaded(&cut), [20, 7], "{length} bytes");
    }
    assert_eq!(loaded(&dut.out.memory), [33, 7]);
    dut.write(167, 34);
    assert_eq!(loaded(&dut.out.memory), [34, 7]);
}

/// A memory of one image with an invalid check sum: power was lost in the 10 ms that a save took at that
/// time.
#[test]
fn an_image_whose_save_did_not_end_is_loaded() {
    let mut memory = include_bytes!("../../../../tests/recordings/681fd38/mdrobot.nv").to_vec();
    let sum = memory.len() - 2;
    memory[sum..].iter_mut().for_each(|byte| *byte = !*byte);
    memory.resize(MEMORY, 0xFF);
    assert_eq!(loaded(&memory), [20, 7]);
}

#[test]
fn default_set_leaves_id_and_baud() {
    let mut dut = Dut::ready();
    for (pid, value) in SAVED.into_iter().chain([(157, 9), (158, 513), (211, 11)]) {
        dut.write(pid, value);
    }
    dut.write_words(239, &[6, 7]);
    dut.write(78, 1);
    dut.write(133, 0x07AA);
    dut.write(135, 0x05AA);
    dut.set(Pid::INT_VOLUME, 33);
    for key in [0, 0x54, 0x5500, 0x0155, 0xFFFF] {
        dut.write(3, key);
        assert_eq!(dut.read(167), 5, "{key:#06x} is no key");
    }
    dut.write(3, 0x55);
    for again in [false, true] {
        for pid in SAVED.map(|(pid, _)| pid).into_iter().chain([157, 158, 211]) {
            assert_eq!(dut.read(pid), factory(pid), "PID {pid}, {again}");
        }
        assert_eq!(dut.read_words(239, 2), [1_000, 10]);
        assert_eq!(dut.read(78), u16::from(!again), "it is not saved, and so not restored");
        let stored_value =
            [Pid::CONTROLLER_ID, Pid::CONTROLLER_BAUD, Pid::INT_VOLUME].map(|pid| dut.get(pid));
        assert_eq!(stored_value, [7, 5, 33]);
        if !again {
            dut.cycle();
            dut.id = 7;
        }
    }
}

#[test]
fn id_and_baud_want_a_key_and_a_power_cycle() {
    let mut dut = Dut::ready();
    for word in [0x0500, 0x05AB, 0xAA05, 0x0005] {
        dut.write(133, word);
        dut.write(135, word);
    }
    assert_eq!((dut.get(Pid::CONTROLLER_ID), dut.get(Pid::CONTROLLER_BAUD)), (1, 2));
    for word in [0x00AA, 0xFEAA, 0xFFAA] {
        assert_eq!(dut.try_write(133, word), [0x86, 3]);
    }
    for word in [0x00AA, 0x06AA, 0xFFAA] {
        assert_eq!(dut.try_write(135, word), [0x86, 3]);
    }
    dut.write(133, 0xFDAA);
    dut.write(135, 0x05AA);
    dut.wait(1.secs());
    assert_eq!(dut.read(1), 81, "by the old id and at the old speed");
    assert_eq!(dut.pdu(&[3, 0, 133, 0, 1]), [0x83, 2], "write only");
    dut.cycle();
    assert_eq!(dut.out.lines.last().unwrap().2, line(115_200));
    assert_eq!(dut.pdu(&[3, 0, 1, 0, 1]), [0; 0], "the old id is a stranger's");
    dut.id = 253;
    assert_eq!(dut.read(1), 81);
}

#[test]
fn codes_of_baudrate() {
    for (code, baud) in [(1, 9_600), (2, 19_200), (3, 38_400), (4, 57_600), (5, 115_200)] {
        let mut dut = Dut::new();
        dut.set(Pid::CONTROLLER_BAUD, code);
        dut.power_on_fast();
        assert_eq!(dut.out.lines, [(Instant::ZERO, Port(0), line(baud))]);
    }
}

#[test]
fn presets_before_power_are_in_the_memory() {
    let mut dut = Dut::new();
    dut.set(Pid::CONTROLLER_ID, 9);
    dut.set(Pid::MAX_RPM, 400);
    dut.set(Pid::FUNC_CMD_TYPE, 0x0102);
    dut.set(Pid::FUNC_SPEED, 3 << 16 | 2);
    assert_eq!(dut.try_set(Pid::UI_COM, 1), Err(PresetError::ReadOnly));
    assert_eq!(dut.try_set(Pid::CONTROLLER_ID, 254), Err(PresetError::OutOfRange));
    assert_eq!(dut.try_set(Pid::FUNC_CMD_TYPE, 5), Err(PresetError::OutOfRange));
    assert_eq!(dut.try_set(Pid::HIGH_SPEED_LIMIT, 511), Err(PresetError::OutOfRange));
    dut.power_on_fast();
    dut.id = 9;
    assert_eq!((dut.read(221), dut.read(183), dut.read_words(239, 2)), (400, 2, vec![2, 3]));
    assert_eq!(dut.out.stores.len(), 4, "one for each");
}

#[test]
fn presets_with_power_act_as_writes() {
    let mut dut = Dut::ready();
    dut.set(Pid::MAX_LOAD_181, 44);
    assert_eq!(dut.read(211), 44);
    dut.set(Pid::SPEED_LIMIT, 700 << 16 | 3);
    assert_eq!((dut.read(157), dut.read(158)), (3, 700));
    assert_eq!(dut.try_set(Pid::ID, 0x00AA), Err(PresetError::OutOfRange));
    assert_eq!(dut.try_set(Pid::VERSION, 256), Err(PresetError::OutOfRange));
    dut.set(Pid::VERSION, 13);
    assert_eq!(dut.read(1), 13);
    assert_eq!(dut.try_set(Pid::MAIN_DATA, 0), Err(PresetError::ReadOnly));
    dut.cycle();
    assert_eq!((dut.read(211), dut.read(157), dut.read(158)), (44, 3, 700));
}

/// Puts a valid check sum at the end of a copy.
fn sign(copy: &mut [u8]) {
    let (summed, [sum @ .., _]) = copy.split_last_chunk_mut::<3>().unwrap();
    sum.copy_from_slice(&rtu::crc(summed).to_be_bytes());
}

/// The copy of its settings that a new drive saves first. This is the second copy in the memory.
fn saved(pid: Pid, value: i64) -> Vec<u8> {
    let mut dut = Dut::ready();
    dut.set(pid, value);
    dut.out.memory.split_off(MEMORY / 2)
}

#[test]
fn a_memory_of_somebody_else_brings_no_function_that_is_none() {
    let [one, other] = [0, 3].map(|number| saved(Pid::FUNC_CMD_TYPE, number));
    // The place of the low byte, which follows the high byte.
    let place = (0..one.len()).find(|&place| one[place] != other[place]).unwrap();
    for (number, brought) in [(0x0004_u16, 4), (0x0005, 0), (0x0104, 0), (0xFFFF, 0)] {
        let mut copy = one.clone();
        copy[place - 1..=place].copy_from_slice(&number.to_be_bytes());
        sign(&mut copy);
        let mut dut = Dut::off([vec![0xFF; MEMORY / 2], copy].concat());
        dut.power_on_fast();
        assert_eq!(dut.read(183), brought, "{number:#06x}");
    }
}

#[test]
fn a_memory_of_somebody_else_brings_what_may_be() {
    let mut dut = Dut::ready();
    dut.set(Pid::PV_GAIN, 7);
    // All PIDs up to `TQ_CTRL` and BLUETOOTH become 0xFFFF.
    let copy = &mut dut.out.memory[MEMORY / 2..];
    copy[1..23].fill(0xFF);
    sign(copy);
    dut.cycle();
    assert_eq!([dut.read(16), dut.read(17), dut.read(25), dut.read(44), dut.read(45)], [0, 1, 0, 0, 0]);
    assert_eq!(dut.read(167), 7);
}

/// A memory of one image with 31 words, from before `TAR_POSI_VEL`, `POSI_SS` and `POSI_SD` existed:
/// `COM_TAR_SPEED` and the gains are found, and the three PIDs have their factory values.
#[test]
fn a_memory_without_the_later_pids_is_good() {
    let mut words = [0_u16; 31];
    words[1] = 1;
    // Word 18 is `PV_GAIN`, word 24 `MAX_RPM`, the last but one the address.
    (words[17], words[18], words[19], words[22], words[23]) = (25, 5_000, 4_000, 150, 2_000);
    (words[24], words[25], words[26], words[27], words[28], words[29]) = (1_000, 10, 1_500, 240, 1, 2);
    let mut memory: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
    memory.extend(drivetwin_protocol::modbus::rtu::crc(&memory).to_be_bytes());
    // The old memory ends at this place.
    memory.resize(MEMORY, 0xFF);
    let mut dut = Dut::off(memory);
    dut.power_on_fast();
    assert_eq!([167, 168, 169, 211, 221].map(|pid| dut.read(pid)), [25, 5_000, 4_000, 150, 2_000]);
    assert_eq!([176, 178, 179].map(|pid| dut.read(pid)), [5_000, 0, 0]);
    // From the next save on, the memory holds these PIDs, too.
    dut.write(178, 7);
    dut.cycle();
    assert_eq!([167, 178, 221].map(|pid| dut.read(pid)), [25, 7, 2_000]);
}
