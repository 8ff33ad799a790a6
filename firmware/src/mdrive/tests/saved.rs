//! S, IP, FD, presets, and power failures during a save.

use super::*;
use crate::mdrive::mcode::names::Meaning;

impl Dut {
    fn declare(&mut self, name: &[u8; 2], meaning: Meaning) {
        self.drive.drive.mcode.names.add(*name, meaning).unwrap();
    }

    fn meaning(&self, name: &[u8; 2]) -> Option<Meaning> {
        self.drive.drive.mcode.names.find(*name)
    }

    fn save(&mut self) {
        self.write(0x76, 1, 1);
        self.wait(100.millis());
    }
}

#[test]
fn what_a_save_keeps() {
    for fresh in [Dut::plus, Dut::hybrid] {
        let mut dut = fresh();
        let (hybrid, mut values) =
            (dut.drive.spec().kind == "mdrive-hybrid", vec![(Reg::A, 5_000), (Reg::VM, 70_000)]);
        values.extend([
            (Reg::CE, 0),
            (Reg::D5, 9),
            (Reg::LM, 4),
            (Reg::R4, -5),
            (Reg::EM, 2),
            (Reg::S3, 16 << 32),
        ]);
        values.extend([(Reg::S5, 10 << 16 | 1), (Reg::ES, 2), (Reg::NE, 0), (Reg::HT, 0)]);
        values.push(if hybrid { (Reg::LT, 777) } else { (Reg::SF, 0) });
        for &(reg, value) in &values {
            dut.set(reg, value);
        }
        dut.declare(b"Q1", Meaning::Global(-123_456));
        dut.declare(b"X ", Meaning::Global(7));
        dut.declare(b"Q2", Meaning::Local(1));
        dut.set(Reg::C1, 99);
        dut.save();
        // Values written after the save are not kept.
        dut.set(Reg::R4, 6);
        dut.try_write(0x67, 1, 0);
        dut.cycle();
        for &(reg, value) in &values {
            assert_eq!(dut.get(reg), value, "{reg:?}");
        }
        assert_eq!(dut.meaning(b"Q1"), Some(Meaning::Global(-123_456)));
        assert_eq!(dut.meaning(b"X "), Some(Meaning::Global(7)));
        assert_eq!(dut.meaning(b"Q2"), None);
        assert_eq!((dut.get(Reg::C1), dut.error()), (0, 0));
    }
}

#[test]
fn what_is_not_saved_is_lost() {
    let mut dut = Dut::plus();
    dut.set(Reg::VM, 70_000);
    dut.declare(b"Q1", Meaning::Global(5));
    dut.cycle();
    assert_eq!((dut.get(Reg::VM), dut.meaning(b"Q1"), dut.error()), (768_000, None, 0));
}

#[test]
fn power_that_goes_at_any_byte_of_a_save() {
    let mut dut = Dut::plus();
    dut.set(Reg::R1, 1);
    dut.declare(b"Q1", Meaning::Global(1));
    dut.save();
    let old = dut.out.memory.clone();
    dut.out.stores.clear();
    dut.set(Reg::R1, 2);
    dut.write(0x1F + 2, 1, 0);
    dut.drive.drive.mcode.names.set(*b"Q1", 2).unwrap();
    dut.declare(b"Q9", Meaning::Global(9));
    dut.save();
    let stores = dut.out.stores.iter().flat_map(|(_, offset, bytes)| {
        bytes.iter().enumerate().map(|(n, &byte)| (usize::from(*offset) + n, byte))
    });
    let bytes: Vec<(usize, u8)> = stores.collect();
    let (mut memory, mut bad) = (old, 0);
    for stored in 0..=bytes.len() {
        let mut cut = Dut::off(Mdrive::plus(), memory.clone());
        cut.power_on(true);
        let state = (cut.get(Reg::R1), cut.meaning(b"Q1"), cut.meaning(b"Q9"), cut.get(Reg::ER));
        let (one, two, nine) = (Some(Meaning::Global(1)), Some(Meaning::Global(2)), Some(Meaning::Global(9)));
        match state {
            (1, q, None, 0) if q == one => assert!(stored < 10, "old at {stored}"),
            (2, q, n, 0) if (q, n) == (two, nine) => assert!(stored + 2 >= bytes.len(), "new at {stored}"),
            (0, None, None, 70) => bad += 1,
            other => panic!("{other:?} at {stored}"),
        }
        if let Some(&(place, byte)) = bytes.get(stored) {
            memory[place] = byte;
        }
    }
    assert!(bad > 1_000);
}

/// Content of the memory after each byte that the drive has stored, beginning with `memory`.
fn every_cut(memory: &[u8], stores: &[(Instant, u16, Vec<u8>)]) -> Vec<Vec<u8>> {
    let mut cuts = vec![memory.to_vec()];
    for (_, offset, bytes) in stores {
        for (place, &byte) in (usize::from(*offset)..).zip(bytes) {
            let mut next = cuts.last().unwrap().clone();
            next[place] = byte;
            cuts.push(next);
        }
    }
    cuts
}

#[test]
fn power_that_goes_at_any_byte_of_fd() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "EM=2\rVA Q1=1\rR1=5\rPG 1\rLB K1\rE\rPG\r");
    dut.save();
    let old = dut.out.memory.clone();
    dut.out.stores.clear();
    dut.type_in(CLIENT, "FD\r");
    dut.wait(100.millis());
    let cuts = every_cut(&old, &dut.out.stores);
    let mut outcomes = [0; 3];
    for (n, memory) in cuts.iter().enumerate() {
        let mut cut = Dut::off(Mdrive::plus(), memory.clone());
        cut.power_on(true);
        let state = (cut.get(Reg::R1), cut.meaning(b"Q1"), cut.meaning(b"K1"), cut.error());
        let outcome = match state {
            (5, Some(Meaning::Global(1)), Some(Meaning::Label(1)), 0) => 0,
            (0, None, _, 70) => 1,
            (0, None, None, 0) => 2,
            other => panic!("{other:?} at {n}"),
        };
        outcomes[outcome] += 1;
    }
    assert!(outcomes.iter().all(|&times| times > 0), "old, bad, new: {outcomes:?}");
}

#[test]
fn a_memory_that_does_not_pass() {
    let mut dut = Dut::plus();
    dut.set(Reg::R1, 5);
    dut.save();
    for place in [0, 40, 200, 900] {
        let mut memory = dut.out.memory.clone();
        memory[place] ^= 1;
        let mut bad = Dut::off(Mdrive::plus(), memory);
        assert_eq!(bad.try_set(Reg::R2, 1), Err(PresetError::BadMemory));
        bad.power_on(true);
        assert_eq!((bad.get(Reg::R1), bad.error()), (0, 70), "{place}");
        bad.set(Reg::R1, 6);
        bad.save();
        bad.cycle();
        assert_eq!((bad.get(Reg::R1), bad.error()), (6, 0));
    }
}

#[test]
fn a_memory_of_what_no_write_could_bring() {
    for pair in
        [[(Reg::JE, 1), (Reg::CM, 1)], [(Reg::VI, 5_000), (Reg::VM, 5_000)], [(Reg::HT, 1), (Reg::R1, 7)]]
    {
        let mut dut = Dut::plus();
        for (reg, value) in pair {
            // Written directly, because the drive would refuse it.
            dut.drive.drive.bank.set(reg, value);
        }
        dut.save();
        dut.cycle();
        let factory = pair.map(|(reg, _)| Reg::ENTRIES.list[reg.row()].reset);
        assert_eq!(pair.map(|(reg, _)| dut.get(reg)), factory, "{pair:?}");
    }
}

/// With EE = 1 these values are in counts, 1/25 of the steps for 256 microsteps and an encoder of 512 lines
/// (MC 7.3.7). They may be below the minimum that a write accepts.
#[test]
fn what_ee_made_small_is_kept() {
    let mut dut = Dut::plus();
    let small = [(Reg::A, 91), (Reg::D, 200), (Reg::VI, 26), (Reg::VM, 90)];
    for (reg, value) in small {
        dut.set(reg, value);
    }
    dut.set(Reg::EE, 1);
    let in_counts = small.map(|(reg, _)| dut.get(reg));
    assert!(in_counts[..2].iter().all(|value| (1..91).contains(value)), "{in_counts:?}");
    dut.save();
    dut.cycle();
    assert_eq!(small.map(|(reg, _)| dut.get(reg)), in_counts);
    assert_eq!(dut.get(Reg::EE), 1);
}

/// D has a value that is possible in counts only, but EE is 0.
#[test]
fn a_memory_of_values_too_small_for_steps() {
    let mut dut = Dut::plus();
    dut.drive.drive.bank.set(Reg::D, 6);
    dut.save();
    dut.cycle();
    assert_eq!(dut.get(Reg::D), 1_000_000);
}

#[test]
fn a_save_in_motion() {
    let mut dut = Dut::plus();
    dut.write(0x78, 2, 10_000);
    dut.wait(100.millis());
    dut.refused(&[16, 0, 0x76, 0, 1, 2, 0, 1], 4, 73);
    assert_eq!(dut.out.stores, []);
}

#[test]
fn presets_before_power() {
    let mut dut = Dut::off(Mdrive::plus(), vec![0xFF; MEMORY]);
    dut.set(Reg::VM, 90_000);
    dut.set(Reg::VI, 80_000);
    dut.set(Reg::S2, 16 << 32 | 1 << 16 | 1);
    dut.set(Reg::EE, 1);
    dut.set(Reg::SerialCommands, 1);
    for (reg, value, refused) in [
        (Reg::VI, 4_000, PresetError::OutOfRange),
        (Reg::RC, 101, PresetError::OutOfRange),
        (Reg::RC, 1 << 40, PresetError::OutOfRange),
        (Reg::S1, 22 << 32, PresetError::OutOfRange),
        (Reg::C1, 5, PresetError::ReadOnly),
        (Reg::EF, 1, PresetError::ReadOnly),
        (Reg::LT, 5, PresetError::NoSuchRegister),
    ] {
        assert_eq!(dut.try_set(reg, value), Err(refused), "{reg:?}");
    }
    dut.power_on(true);
    // 90,000 and 80,000 steps/s are 3,600 and 3,200 counts/s.
    assert_eq!([Reg::VM, Reg::VI, Reg::A, Reg::EE].map(|reg| dut.get(reg)), [3_600, 3_200, 40_000, 1]);
    assert_eq!((dut.get(Reg::S2), dut.get(Reg::SerialCommands)), (16 << 32 | 1 << 16 | 1, 1));
    assert_eq!(dut.error(), 0);
}

#[test]
fn presets_later() {
    let mut dut = Dut::plus();
    for (reg, value, refused) in [
        (Reg::MV, 1, PresetError::ReadOnly),
        (Reg::BY, 1, PresetError::ReadOnly),
        (Reg::RC, 0, PresetError::OutOfRange),
        (Reg::R1, 1 << 31, PresetError::OutOfRange),
        (Reg::O1, 1, PresetError::Busy),
        (Reg::V1, 1, PresetError::NoSuchRegister),
        (Reg::LT, 5, PresetError::NoSuchRegister),
        (Reg::S1, 9 << 32, PresetError::OutOfRange),
        (Reg::SerialCommands, 2, PresetError::OutOfRange),
    ] {
        assert_eq!(dut.try_set(reg, value), Err(refused), "{reg:?}");
    }
    dut.set(Reg::S1, 16 << 32);
    dut.set(Reg::O1, 1);
    dut.set(Reg::P, -5);
    assert_eq!((dut.get(Reg::O1), dut.get(Reg::P)), (1, -5));
    assert_eq!(dut.error(), 0, "a preset is no write of the bus");
    let mut dut = Dut::hybrid();
    dut.set(Reg::SS, 198);
    assert_eq!(dut.get(Reg::SS), 198, "the register, not Hz");
}

#[test]
fn ip_brings_back_what_is_saved() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "RC=70\rVA Q1=1\rS1=16,1,0\rS\rRC=80\rQ1=2\rS1=0,0,0\rP=5\rIP\r");
    // IP does not load user variables and counters (MC 3-3).
    let now = (dut.get(Reg::RC), dut.get(Reg::S1), dut.meaning(b"Q1"), dut.get(Reg::P), dut.error());
    assert_eq!(now, (70, 16 << 32 | 1 << 16, Some(Meaning::Global(2)), 5, 0));
    dut.write(0x78, 2, 5_000);
    dut.wait(10.millis());
    dut.type_in(CLIENT, "RC=90\rIP\r");
    assert_eq!((dut.error(), dut.get(Reg::RC)), (74, 90));
}

#[test]
fn fd_is_as_the_factory_made_it() {
    let mut dut = Dut::plus();
    dut.set(Reg::SerialCommands, 1);
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "RC=70\rVA Q1=1\rLK=1\rS\rCP\rPG 1\rLB K1\rE\rPG\rP=5\rEM=2\r");
    assert_eq!(dut.type_in(CLIENT, "FD\r"), "Copyright 2001-2010 by Schneider Electric Motion USA.\r\n>");
    for _ in 0..2 {
        let now = [Reg::RC, Reg::P, Reg::LK, Reg::EM].map(|reg| dut.get(reg));
        assert_eq!(now, [25, 0, 0, 0]);
        assert_eq!((dut.meaning(b"Q1"), dut.meaning(b"K1"), dut.error()), (None, None, 0));
        assert_eq!(dut.get(Reg::SerialCommands), 1);
        dut.wait(100.millis());
        dut.cycle();
    }
    dut.connect(CLIENT);
    assert_eq!(dut.type_in(CLIENT, "L\r"), "L\r\n>");
    dut.write(0x78, 2, 5_000);
    dut.wait(10.millis());
    dut.type_in(CLIENT, "FD\r");
    assert_eq!(dut.error(), 73);
}

#[test]
fn the_lock_holds_until_everything_is_cleared() {
    let mut dut = Dut::plus();
    dut.connect(CLIENT);
    dut.type_in(CLIENT, "LK=1\rLK=0\r");
    assert_eq!((dut.error(), dut.get(Reg::LK)), (44, 1));
    dut.type_in(CLIENT, "CP\r");
    assert_eq!((dut.error(), dut.get(Reg::LK)), (0, 0));
    dut.type_in(CLIENT, "LK=1\r");
    dut.cycle();
    assert_eq!(dut.get(Reg::LK), 0, "it was not saved");
}
