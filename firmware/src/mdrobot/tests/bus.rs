//! Checks of requests, and values that PIDs read.

use super::*;

#[test]
fn functions_quantities_and_pids_are_judged_in_this_order() {
    let mut dut = Dut::ready();
    for (pdu, reply) in [
        (&[4, 0, 1, 0, 1][..], [0x84, 1]),
        (&[5, 0, 16, 0xFF, 0], [0x85, 1]),
        (&[3, 0, 2, 0, 0], [0x83, 3]),
        (&[3, 0, 2, 0, 126], [0x83, 3]),
        (&[3, 0, 2, 0, 2], [0x83, 2]),
        (&[3, 0, 3, 0, 2], [0x83, 2]),
        (&[3, 0, 4, 0, 2], [0x83, 2]),
        (&[3, 1, 130, 0, 1], [0x83, 2]),
        (&[3, 0, 1, 0, 2], [0x83, 3]),
        (&[3, 0, 197, 0, 1], [0x83, 3]),
        (&[6, 0, 1, 0, 1], [0x86, 2]),
        (&[6, 0, 14, 0, 1], [0x86, 2]),
        (&[6, 0, 243, 0, 1], [0x86, 3]),
        (&[16, 0, 243, 0, 1, 2, 0, 1], [0x90, 3]),
        (&[16, 0, 219, 0, 2, 4, 0, 1, 0, 1], [0x90, 3]),
        (&[16, 0, 130, 0, 2, 4, 0, 1, 0, 1], [0x90, 3]),
        (&[6, 0, 16, 0, 2], [0x86, 3]),
        (&[6, 0, 16, 1, 0], [0x86, 3]),
        (&[6, 0, 10, 1, 2], [0x86, 3]),
    ] {
        assert_eq!(dut.pdu(pdu), reply, "{pdu:?}");
    }
    assert_eq!(dut.pdu(&[16, 0, 16, 0, 1, 2, 0, 1]), [16, 0, 16, 0, 1], "a word by function 16");
    assert_eq!(dut.read(16), 1);
}

#[test]
fn the_header_names_32_more() {
    let mut dut = Dut::ready();
    let header = [
        4, 7, 14, 15, 18, 30, 31, 131, 137, 146, 147, 149, 150, 152, 159, 162, 163, 164, 193, 194, 198, 202,
        203, 205, 217, 225, 226, 227, 231, 234, 238, 241,
    ];
    assert_eq!(header.len(), 32);
    for pid in header {
        assert_eq!(dut.pdu(&[3, 0, pid, 0, 1]), [0x83, 2], "PID {pid}");
        assert_eq!(dut.try_write(pid, 0), [0x86, 2], "PID {pid}");
    }
    let table = dut.drive.spec().registers.rows;
    let known = table.iter().filter(|row| !row.access.reads() && !row.access.writes());
    assert_eq!(known.map(|row| row.address).collect::<Vec<_>>(), header.map(u16::from));
}

#[test]
fn everybody_s_id_is_obeyed_and_not_answered() {
    let mut dut = Dut::ready();
    assert_eq!(dut.ask(&rtu::frame(0xFE, &[6, 0, 16, 0, 1])), [0; 0]);
    assert_eq!(dut.read(16), 1);
    for id in [0, 2, 255] {
        assert_eq!(dut.ask(&rtu::frame(id, &[6, 0, 16, 0, 0])), [0; 0]);
    }
    assert_eq!(dut.read(16), 1);
}

#[test]
fn ranges_are_of_the_whole_word() {
    let mut dut = Dut::ready();
    for (pid, least, greatest) in [
        (17, 0, 1),
        (19, 0, 1),
        (24, 0, 3),
        (36, 0, 1),
        (37, 0, 1),
        (40, 0, 1),
        (44, 0, 1),
        (45, 0, 1),
        (78, 0, 1),
        (100, 0, 2),
        (153, 0, 1_023),
        (154, 0, 1_023),
        (155, 0, 5_000),
        (157, 0, 512),
        (158, 512, 1_023),
    ] {
        dut.write(pid, least);
        dut.write(pid, greatest);
        for value in [greatest + 1, 0x100 | greatest, 0xFFFF] {
            if value > greatest {
                assert_eq!(dut.try_write(pid, value), [0x86, 3], "PID {pid} = {value}");
            }
        }
        assert_eq!(dut.read(pid), greatest);
    }
    for pid in [130, 156, 167, 168, 169, 171, 180, 211, 221] {
        dut.write(pid, 0xFFFF);
        assert_eq!(dut.read(pid), 0xFFFF, "PID {pid}");
    }
    for value in [1_024, 0xFFFF - 1_023] {
        assert_eq!(dut.try_write(134, value), [0x86, 3]);
        assert_eq!(dut.try_write(140, value), [0x86, 3]);
    }
    assert_eq!((dut.try_write(158, 511), dut.try_write(158, 0)), (vec![0x86, 3], vec![0x86, 3]));
    assert_eq!((dut.try_write(25, 4), dut.try_write(25, 6)), (vec![0x86, 3], vec![0x86, 3]));
}

#[test]
fn of_func_cmd_type_dl_counts() {
    let mut dut = Dut::ready();
    dut.write(183, 0xAB03);
    assert_eq!(dut.read(183), 3);
    assert_eq!(dut.try_write(183, 0x0005), [0x86, 3]);
    assert_eq!(dut.read(183), 3);
}

#[test]
fn two_pids_are_one_value() {
    let mut dut = Dut::ready();
    assert_eq!((dut.read(181), dut.read(211)), (200, 200));
    dut.write(181, 55);
    assert_eq!((dut.read(181), dut.read(211)), (55, 55));
    dut.write(211, 66);
    assert_eq!((dut.read(181), dut.read(211)), (66, 66));

    assert_eq!(dut.read_words(222, 2), [0, 0]);
    dut.write_words(222, &[100, 900]);
    assert_eq!((dut.read(157), dut.read(158)), (100, 900));
    dut.write(157, 200);
    dut.write(158, 800);
    assert_eq!(dut.read_words(222, 2), [200, 800]);
    for words in [[513, 800], [300, 511], [300, 1_024], [300, 0]] {
        assert_eq!(dut.try_write_words(222, &words), [0x90, 3]);
        assert_eq!(dut.read_words(222, 2), [200, 800], "nothing has changed");
    }
}

#[test]
fn two_words_have_the_low_one_first() {
    let mut dut = Dut::ready();
    assert_eq!(dut.read_words(239, 2), [1_000, 10]);
    assert_eq!(dut.read_words(250, 2), [1_500, 240]);
    dut.write_words(239, &[700, 25]);
    assert_eq!((dut.read_words(239, 2), dut.get(Pid::FUNC_SPEED)), (vec![700, 25], 25 << 16 | 700));
}

#[test]
fn what_is_measured_reads_as_it_is() {
    let mut dut = Dut::ready();
    assert_eq!((dut.read(1), dut.read(34), dut.read(143)), (81, 0, 240));
    assert_eq!((dut.read(138), dut.read(139), dut.read(49)), (0, 0, 0));
    dut.write(78, 1);
    // -100,000 counts is 0xFFFE_7960.
    dut.write_words(219, &[0x7960, 0xFFFE, 1_200]);
    assert_eq!(dut.read_words(230, 2), [0x7960, 0xFFFE]);
    dut.wait(3.secs());
    let monitor = dut.read_words(196, 6);
    assert!((-1_212..=-1_188).contains(&monitor[0].cast_signed()), "{monitor:?}");
    // The output is 1,200/3,820 of full scale, and some more because of friction.
    assert!((-400..=-310).contains(&monitor[2].cast_signed()), "{monitor:?}");
    assert_eq!((monitor[4], monitor[5]), (0xFFFF, 0));
    let words: Vec<u16> = (0..7).map(|n| dut.drive.peek_word(dut.now, Pid::MONITOR.row(), n)).collect();
    assert_eq!(words[..2], [dut.get(Pid::RPM_DATA) as u16, dut.get(Pid::TQ_DATA) as u16]);
    let position = dut.get(Pid::POSI_DATA) as u32;
    assert_eq!(words[3..], [position as u16, (position >> 16) as u16, 0, 0]);
}

#[test]
fn in_position_is_live() {
    let mut dut = Dut::ready();
    dut.write(78, 1);
    dut.write(171, 3);
    assert_eq!(dut.read(49), 0, "before the first position");
    dut.write_words(243, &[3, 0]);
    assert_eq!(dut.read(49), 1, "three counts are within the window");
    dut.write_words(243, &[240, 0]);
    assert_eq!(dut.read(49), 0);
    dut.wait(5.secs());
    assert_eq!(dut.read(49), 1);
    dut.write(13, 0xABCD);
    let near = |words: Vec<u16>| (u32::from(words[1]) << 16 | u32::from(words[0])).wrapping_add(3) <= 6;
    assert!(near(dut.read_words(197, 2)) && near(dut.read_words(230, 2)), "the target moves along");
    assert_eq!(dut.read(49), 1);
    dut.write(5, 0);
    assert_eq!(dut.read(49), 0, "nothing controls the position");
}
