//! Values that survive a power-off: saved PIDs, DEFAULT_SET, id and baud rate.

use drivetwin_firmware::device::Line;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;

use crate::pid;
use crate::pids::rows;
use crate::rig::{Rig, SILENCE, line, request, timed};
use crate::table::Row;

/// A value for a saved PID that differs from the factory's. PIDs that are aliases of one value get the same
/// value.
fn changed(row: &Row) -> Vec<u16> {
    match row.pid {
        16 | 19 | 36 | 37 | 40 | 44 | 45 => vec![1],
        17 => vec![0],
        183 => vec![4],
        25 => vec![5],
        24 => vec![2],
        181 | 211 => vec![150],
        157 => vec![33],
        158 => vec![999],
        222 => vec![33, 999],
        239 | 250 => vec![row.pid, 0xFF00 | row.pid],
        pid => vec![pid],
    }
}

fn change_everything(rig: &mut Rig) {
    for row in rows(|row| row.saved) {
        let words = changed(row);
        assert_ne!(words, row.reset, "PID {} {}", row.pid, row.name);
        rig.write_words(row.pid, &words);
    }
}

/// MDROBOT-6: all PIDs except 78, 100, 130 and 180 are saved at once.
#[test]
fn page_6_saved_values_survive_a_power_cycle() {
    let mut rig = Rig::default();
    change_everything(&mut rig);
    rig.set(&[(pid::UI_COM, 1), (pid::START_STOP, 2), (pid::VEL_CMD, 77), (pid::COM_TAR_SPEED, 0)]);
    rig.power_cycle();
    for row in rows(|row| row.saved) {
        assert_eq!(rig.words(row.pid, row.count()), changed(row), "PID {} {}", row.pid, row.name);
    }
    for pid in [78, 100, 130, 180] {
        assert_eq!(rig.read(pid), 0, "PID {pid}");
    }
    // Only one register (PID: parameter ID) is changed at a time.
    for row in rows(|row| row.saved) {
        let mut rig = Rig::default();
        rig.write_words(row.pid, &changed(row));
        rig.power_cycle();
        assert_eq!(rig.words(row.pid, row.count()), changed(row), "PID {} {}", row.pid, row.name);
    }
}

/// MDROBOT-6: a master writes faster than the drive saves. The last value counts.
#[test]
fn page_6_one_write_after_the_other() {
    let mut rig = Rig::default();
    for value in 0..100 {
        rig.write(pid::MAX_RPM, 1_000 + value);
        rig.write(pid::P_GAIN, value);
        rig.after(1.millis());
    }
    rig.power_cycle();
    assert_eq!((rig.read(pid::MAX_RPM), rig.read(pid::P_GAIN)), (1_099, 99));
}

/// MDROBOT-6: power fails between the values and their checksum.
#[test]
fn page_6_power_lost_in_a_save() {
    let mut rig = Rig::default();
    rig.write(pid::MAX_RPM, 1_000);
    rig.write(pid::MAX_RPM, 2_000);
    rig.after(5.millis());
    rig.power_cycle();
    // The drive has the new value, not the old one or the factory's.
    assert_eq!(rig.read(pid::MAX_RPM), 2_000);
    rig.write(pid::MAX_RPM, 2_500);
    rig.power_cycle();
    assert_eq!(rig.read(pid::MAX_RPM), 2_500);
}

/// "DL = 0x55(CHECK)" (p. 6): resets all saved values except id and baud rate.
#[test]
fn page_6_default_set() {
    let mut rig = Rig::default();
    change_everything(&mut rig);
    rig.write(pid::ID, 7 << 8 | 0xAA);
    for wrong in [0, 0x54, 0x56, 0xAA, 0x0155, 0x5500, 0xFF55, 0xFFFF] {
        rig.write(pid::DEFAULT_SET, wrong);
        for row in rows(|row| row.saved) {
            assert_eq!(rig.words(row.pid, row.count()), changed(row), "{wrong:04X}h: PID {}", row.pid);
        }
    }
    rig.write(pid::DEFAULT_SET, 0x55);
    for row in rows(|row| row.saved) {
        assert_eq!(rig.words(row.pid, row.count()), row.reset, "PID {} {}", row.pid, row.name);
    }
    rig.power_cycle();
    assert_eq!(rig.ask(&request(3, pid::VERSION, 1)), SILENCE, "its id is 7 now");
    for row in rows(|row| row.saved) {
        let reply = rig.bench.ask(rig.seat, &rtu::read(7, row.pid, row.count()));
        let words: Vec<u8> = row.reset.iter().flat_map(|word| word.to_be_bytes()).collect();
        assert_eq!(reply[3..reply.len() - 2], words, "PID {} {}", row.pid, row.name);
    }
}

/// "DL = 0xAA, DH = ID of controller to set (1~253)" (p. 12). MDROBOT-5: the id is saved at once and valid
/// from the next power-on.
#[test]
fn page_12_id() {
    for id in [1, 2, 100, 247, 248, 253] {
        let mut rig = Rig::default();
        rig.write(pid::ID, u16::from(id) << 8 | 0xAA);
        assert_eq!(rig.read(pid::VERSION), 81, "still 1");
        rig.power_cycle();
        let reply = rig.bench.ask(rig.seat, &rtu::read(id, pid::VERSION, 1));
        assert_eq!(reply, rtu::frame(id, &[3, 2, 0, 81])[..]);
        if id != 1 {
            assert_eq!(rig.ask(&request(3, pid::VERSION, 1)), SILENCE);
        }
    }
    for id in [0_u16, 254, 255] {
        let mut rig = Rig::default();
        assert_eq!(rig.try_write(pid::ID, id << 8 | 0xAA), Err(3), "id {id}");
        assert_eq!(rig.try_write_words(pid::ID, &[id << 8 | 0xAA]), Err(3), "id {id}");
        rig.power_cycle();
        assert_eq!(rig.read(pid::VERSION), 81);
    }
    // A word with another key is echoed and has no effect, with any DH.
    for word in [0x0200, 0x0255, 0x02AB, 0x00A9, 0xFF00, 0xAA02] {
        let mut rig = Rig::default();
        rig.write(pid::ID, word);
        rig.power_cycle();
        assert_eq!(rig.read(pid::VERSION), 81, "{word:04X}h");
    }
}

/// "DH = Baudrate (1~5)" (p. 12).
#[test]
fn page_12_baudrate() {
    let bauds = [9_600, 19_200, 38_400, 57_600, 115_200];
    assert_eq!(line(&timed()), Line::new(19_200, 8, Parity::None, 1));
    for (code, baud) in (1..).zip(bauds) {
        let mut rig = timed();
        rig.write(pid::BAUDRATE, code << 8 | 0xAA);
        assert_eq!(line(&rig).baud, 19_200);
        assert_eq!(rig.read(pid::VERSION), 81);
        rig.power_cycle();
        assert_eq!(line(&rig), Line::new(baud, 8, Parity::None, 1));
        assert_eq!(rig.read(pid::VERSION), 81, "at {baud}");
    }
    for code in [0_u16, 6, 7, 255] {
        let mut rig = timed();
        assert_eq!(rig.try_write(pid::BAUDRATE, code << 8 | 0xAA), Err(3), "code {code}");
        rig.power_cycle();
        assert_eq!(line(&rig).baud, 19_200);
    }
    for word in [0x0500, 0x0555, 0x00AB, 0xAA05] {
        let mut rig = timed();
        rig.write(pid::BAUDRATE, word);
        rig.power_cycle();
        assert_eq!(line(&rig).baud, 19_200, "{word:04X}h");
    }
}
