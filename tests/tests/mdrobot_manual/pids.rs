//! Every PID of the table over the bus: its access, length, range and factory value.

use drivetwin_firmware::device::Port;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Setup;
use drivetwin_sim::line::LineMode;

use crate::pid;
use crate::rig::{ALL, BOOT, Rig, SILENCE, request};
use crate::table::{HEADER_ONLY, Row, TABLE, Type};

/// FUNC_CMD_TYPE ignores DH (p. 15), so only its DL can be illegal. It has its own test.
const FUNC_CMD_TYPE: u16 = 183;

pub(crate) fn rows(of: impl Fn(&Row) -> bool) -> impl Iterator<Item = &'static Row> {
    TABLE.iter().filter(move |row| of(row))
}

#[test]
fn page_6_the_table_has_every_pid_once() {
    let mut pids: Vec<u16> = TABLE.iter().map(|row| row.pid).chain(HEADER_ONLY).collect();
    pids.sort_unstable();
    pids.dedup();
    assert_eq!(pids.len(), TABLE.len() + HEADER_ONLY.len());
    // 48 numbered rows in the manual's tables (row 36 occurs twice), and the other PIDs that are known.
    assert_eq!(TABLE.len(), 63);
}

#[test]
fn page_6_names() {
    let rig = Rig::default();
    let spec = rig.bench.spec(rig.seat);
    for row in TABLE {
        assert!(spec.find(row.name).is_some(), "there is no {}", row.name);
    }
}

#[test]
fn page_6_factory_values() {
    let mut rig = Rig::default();
    for row in rows(Row::is_read) {
        assert_eq!(
            rig.try_words(row.pid, row.count()),
            Ok(row.reset.to_vec()),
            "PID {} {}",
            row.pid,
            row.name
        );
    }
}

/// MDROBOT-2: a drive first refuses quantities of 0 and of more than 125. Then it checks that the PID exists
/// and can be read, and then the PID's own length.
#[test]
fn page_3_quantities_of_a_read() {
    let mut rig = Rig::default();
    for row in TABLE {
        for words in (1..=10).chain([124, 125]) {
            let right = words == row.count();
            let expected = match (row.is_read(), right) {
                (false, _) => Err(2),
                (true, false) => Err(3),
                (true, true) => Ok(row.reset.to_vec()),
            };
            assert_eq!(
                rig.try_words(row.pid, words),
                expected,
                "{words} words of PID {} {}",
                row.pid,
                row.name
            );
        }
    }
    for pid in (0..=260).chain([0x0182, 0xFFFF]) {
        for words in [0, 126, 0x0100, 0x0101, 0xFFFF] {
            assert_eq!(rig.try_words(pid, words), Err(3), "{words} words of PID {pid}");
        }
    }
}

/// MDROBOT-2: an unknown PID is refused with exception 02, for every function and every quantity that Modbus
/// allows. PID_H is part of the number.
#[test]
fn page_3_pids_that_are_not_there() {
    let mut rig = Rig::default();
    let known = |pid| TABLE.iter().any(|row| row.pid == pid);
    let others = (0..=260).filter(|&pid| !known(pid));
    let elsewhere = (1..=255).map(|high: u16| high << 8 | 130);
    let mut seen = 0;
    for pid in others.chain(elsewhere).chain([0x0101, 0x0103, 0x01C5, 0xFFFF]) {
        for words in [1, 2, 6, 125] {
            assert_eq!(rig.try_words(pid, words), Err(2), "read of PID {pid}");
        }
        assert_eq!(rig.try_write(pid, 1), Err(2), "write to PID {pid}");
        for words in [1, 2, 3] {
            assert_eq!(rig.try_write_words(pid, &vec![1; words]), Err(2), "{words} words to PID {pid}");
        }
        seen += 1;
    }
    // 261 PIDs without the 63 of the table. PIDs that only the header has are among them.
    assert_eq!(seen, 261 - 63 + 255 + 4);
}

#[test]
fn header_pids_without_a_row_are_refused() {
    let mut rig = Rig::default();
    for pid in HEADER_ONLY {
        assert_eq!(rig.try_words(pid, 1), Err(2), "read of PID {pid}");
        assert_eq!(rig.try_write(pid, 0), Err(2), "write to PID {pid}");
    }
}

#[test]
fn page_3_read_only_pids_refuse_writes() {
    let mut rig = Rig::default();
    for row in rows(|row| row.kind == Type::R) {
        assert_eq!(rig.try_write(row.pid, 0), Err(2), "PID {} {}", row.pid, row.name);
        for words in [1, 2, 3, 6] {
            assert_eq!(rig.try_write_words(row.pid, &vec![0; words]), Err(2), "PID {} {}", row.pid, row.name);
        }
        assert_eq!(
            rig.try_words(row.pid, row.count()),
            Ok(row.reset.to_vec()),
            "PID {} {}",
            row.pid,
            row.name
        );
    }
}

/// The least and the greatest value of each range are accepted, by both functions where both are possible.
#[test]
fn page_6_least_and_greatest_values_are_accepted() {
    for row in rows(Row::is_written) {
        let mut rig = Rig::default();
        for words in row.legal() {
            if row.count() == 1 {
                assert_eq!(
                    rig.try_write(row.pid, words[0]),
                    Ok(()),
                    "{words:?} to PID {} {}",
                    row.pid,
                    row.name
                );
                assert_reads(&mut rig, row, &words);
            }
            assert_eq!(
                rig.try_write_words(row.pid, &words),
                Ok(()),
                "{words:?} to PID {} {}",
                row.pid,
                row.name
            );
            assert_reads(&mut rig, row, &words);
        }
    }
}

#[track_caller]
fn assert_reads(rig: &mut Rig, row: &Row, words: &[u16]) {
    let expected = if row.is_read() { Ok(words.to_vec()) } else { Err(2) };
    assert_eq!(rig.try_words(row.pid, row.count()), expected, "PID {} {}", row.pid, row.name);
}

/// MDROBOT-2 and MDROBOT-3: an illegal value is refused with exception 03, and nothing changes.
#[test]
fn page_6_values_out_of_range_are_refused() {
    for row in rows(|row| row.is_written() && row.pid != FUNC_CMD_TYPE) {
        let mut rig = Rig::default();
        let before = row.legal().pop().expect("a legal value");
        rig.write_words(row.pid, &before);
        let everything = image(&mut rig);
        for words in row.illegal() {
            if row.count() == 1 {
                assert_eq!(
                    rig.try_write(row.pid, words[0]),
                    Err(3),
                    "{words:?} to PID {} {}",
                    row.pid,
                    row.name
                );
            }
            assert_eq!(
                rig.try_write_words(row.pid, &words),
                Err(3),
                "{words:?} to PID {} {}",
                row.pid,
                row.name
            );
            assert_reads(&mut rig, row, &before);
        }
        assert_eq!(image(&mut rig), everything, "PID {} {}", row.pid, row.name);
    }
}

/// Values of all PIDs that can be read and written.
fn image(rig: &mut Rig) -> Vec<(u16, Vec<u16>)> {
    rows(|row| row.kind == Type::RW).map(|row| (row.pid, rig.words(row.pid, row.count()))).collect()
}

/// MDROBOT-2: refuses function 6 for a PID of several words, and function 16 with a wrong quantity.
#[test]
fn page_5_quantities_of_a_write() {
    for row in rows(Row::is_written) {
        let mut rig = Rig::default();
        let everything = image(&mut rig);
        let words = row.legal().remove(1);
        if row.count() > 1 {
            assert_eq!(rig.try_write(row.pid, words[0]), Err(3), "one word to PID {} {}", row.pid, row.name);
        }
        for count in (1..=8).chain([122, 123]).filter(|&count| count != row.words.len()) {
            let words = vec![words[0]; count];
            assert_eq!(
                rig.try_write_words(row.pid, &words),
                Err(3),
                "{count} words to PID {} {}",
                row.pid,
                row.name
            );
        }
        assert_eq!(image(&mut rig), everything, "PID {} {}", row.pid, row.name);
    }
}

/// MDROBOT-2: quantities of 0 and of more than 123 are refused with exception 03, for any PID.
#[test]
fn page_5_structure_of_function_16() {
    let mut rig = Rig::default();
    for pid in [0, 2, pid::UI_COM, pid::FUNC_SPEED, pid::VERSION, 260] {
        assert_eq!(rig.ask(&[&request(16, pid, 0)[..], &[0]].concat()), [0x90, 3], "nothing to PID {pid}");
        let long = [&request(16, pid, 124)[..], &[248], &[0; 248]].concat();
        if long.len() <= 253 {
            assert_eq!(rig.ask(&long), [0x90, 3], "124 words to PID {pid}");
        }
    }
    // The byte count does not match the quantity.
    for (quantity, bytes) in [(1, 4), (2, 2), (1, 0), (2, 6), (1, 3)] {
        let mut pdu = request(16, pid::UI_COM, quantity).to_vec();
        pdu.push(bytes);
        pdu.extend(vec![0; usize::from(bytes)]);
        assert_eq!(rig.ask(&pdu), [0x90, 3], "quantity {quantity}, {bytes} bytes");
    }
    assert_eq!(rig.read(pid::UI_COM), 0);
}

/// "We just use Word read/write and Word write2 function" (p. 3).
#[test]
fn page_3_other_functions() {
    let mut rig = Rig::default();
    for function in (0..=0x7F_u8).filter(|function| ![3, 6, 16].contains(function)) {
        assert_eq!(rig.ask(&[function, 0, 130, 0, 1]), [function | 0x80, 1], "function {function:02X}h");
    }
}

/// "FUNC_TYPE = DL, DH is ignored" (p. 15).
#[test]
fn page_15_func_cmd_type_keeps_dl() {
    let mut rig = Rig::default();
    for (word, kept) in [(0x0002, 2), (0x0100, 0), (0xFF04, 4), (0x8003, 3), (0x7F01, 1)] {
        rig.write(pid::FUNC_CMD_TYPE, word);
        assert_eq!(rig.read(pid::FUNC_CMD_TYPE), kept, "{word:04X}h");
    }
    for word in [5, 0x0105, 0x00FF, 0x0480] {
        assert_eq!(rig.try_write(pid::FUNC_CMD_TYPE, word), Err(3), "{word:04X}h");
        assert_eq!(rig.try_write_words(pid::FUNC_CMD_TYPE, &[word]), Err(3), "{word:04X}h");
        assert_eq!(rig.read(pid::FUNC_CMD_TYPE), 1);
    }
}

/// PIDs 181 and 211 are the same MAX_LOAD. The speed limits have one PID each, and SPEED_LIMIT for both
/// (MDROBOT-8).
#[test]
fn page_14_values_with_two_pids() {
    let mut rig = Rig::default();
    rig.write(pid::MAX_LOAD_181, 55);
    assert_eq!(rig.read(pid::MAX_LOAD), 55);
    rig.write(pid::MAX_LOAD, 66);
    assert_eq!(rig.read(pid::MAX_LOAD_181), 66);
    rig.write(pid::LOW_SPEED_LIMIT, 100);
    assert_eq!(rig.words(pid::SPEED_LIMIT, 2), [100, 0]);
    rig.write(pid::HIGH_SPEED_LIMIT, 900);
    assert_eq!(rig.words(pid::SPEED_LIMIT, 2), [100, 900]);
    rig.write_words(pid::SPEED_LIMIT, &[512, 1_023]);
    assert_eq!((rig.read(pid::LOW_SPEED_LIMIT), rig.read(pid::HIGH_SPEED_LIMIT)), (512, 1_023));
    // A write of both limits is stored completely or not at all (MODBUS-4), also if no limit was set before.
    let mut rig = Rig::default();
    for words in [[0, 0], [100, 511], [513, 600], [100, 1_024]] {
        assert_eq!(rig.try_write_words(pid::SPEED_LIMIT, &words), Err(3), "{words:?}");
        assert_eq!(rig.words(pid::SPEED_LIMIT, 2), [0, 0]);
    }
    rig.power_cycle();
    assert_eq!(rig.words(pid::SPEED_LIMIT, 2), [0, 0]);
}

/// "0xfe(254): ID ALL" (p. 3): the drive obeys and does not answer. Id 0 is treated as another drive's
/// (MDROBOT-4).
#[test]
fn page_3_id_all() {
    let mut rig = Rig::default();
    let silent = |rig: &mut Rig, frame: &[u8]| assert_eq!(rig.bench.ask(rig.seat, frame), SILENCE);
    silent(&mut rig, &rtu::write(ALL, pid::MAX_RPM, 2_000));
    assert_eq!(rig.read(pid::MAX_RPM), 2_000);
    silent(&mut rig, &rtu::frame(ALL, &[16, 0, 239, 0, 2, 4, 0x01, 0x02, 0x03, 0x04]));
    assert_eq!(rig.words(pid::FUNC_SPEED, 2), [0x0102, 0x0304]);
    for refused in [rtu::read(ALL, pid::VERSION, 1), rtu::write(ALL, pid::UI_COM, 2), rtu::write(ALL, 2, 0)] {
        silent(&mut rig, &refused);
    }
    for id in [0, 2, 247, 253, 255] {
        silent(&mut rig, &rtu::write(id, pid::MAX_RPM, 1_000));
        silent(&mut rig, &rtu::read(id, pid::MAX_RPM, 1));
    }
    assert_eq!((rig.read(pid::MAX_RPM), rig.read(pid::UI_COM)), (2_000, 0));
}

/// MDROBOT-11: for 300 ms after power-on no request is received.
#[test]
fn page_3_power_on() {
    let mut rig = Rig::new(LineMode::Fast, Setup::default());
    rig.after(BOOT - 1.millis());
    assert_eq!(rig.ask(&request(3, pid::VERSION, 1)), SILENCE);
    rig.after(2.millis());
    assert_eq!(rig.read(pid::VERSION), 81);
}

/// The bytes of 2.3 to 2.6, with CRCs computed from the polynomial, low byte first. VERSION is read, P_GAIN
/// is written, FUNC_SPEED is written and read with D1 (1,500) before D2 (20).
#[test]
fn page_3_frames() {
    let mut rig = Rig::default();
    let exchanges: [(&[u8], &[u8]); 4] = [
        (&[0x01, 0x03, 0x00, 0x01, 0x00, 0x01, 0xD5, 0xCA], &[0x01, 0x03, 0x02, 0x00, 0x51, 0x79, 0xB8]),
        (
            &[0x01, 0x06, 0x00, 0xA8, 0x13, 0x88, 0x05, 0x7C],
            &[0x01, 0x06, 0x00, 0xA8, 0x13, 0x88, 0x05, 0x7C],
        ),
        (
            &[0x01, 0x10, 0x00, 0xEF, 0x00, 0x02, 0x04, 0x05, 0xDC, 0x00, 0x14, 0x7C, 0x9E],
            &[0x01, 0x10, 0x00, 0xEF, 0x00, 0x02, 0x70, 0x3D],
        ),
        (
            &[0x01, 0x03, 0x00, 0xEF, 0x00, 0x02, 0xF5, 0xFE],
            &[0x01, 0x03, 0x04, 0x05, 0xDC, 0x00, 0x14, 0x3B, 0x0A],
        ),
    ];
    for (request, reply) in exchanges {
        assert_eq!(rig.bench.ask(rig.seat, request), reply, "{request:02X?}");
    }
    let bus = rig.bench.bus(rig.seat, Port(0)).expect("a line");
    assert_eq!(rig.bench.ports(bus).len(), 1);
}
