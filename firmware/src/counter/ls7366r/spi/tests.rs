//! Every instruction of table 1.

use std::vec::Vec;

use super::super::{Channel, Instant, Ls7366r};
use super::Transmission;

/// Sends bytes while SS/ is low. Returns the bytes received.
fn send(counter: &mut Ls7366r, bytes: &[u8]) -> Vec<u8> {
    let mut transmission = Transmission::new(counter);
    bytes.iter().map(|byte| transmission.exchange(*byte)).collect()
}

const OLD: Registers = Registers {
    mdr0: 0x23,
    mdr1: 0xF0,
    dtr: 0x1122_3344,
    cntr: 0x5566_7788,
    otr: 0x99AA_BBCC,
    str: 0b0001_1110, // IDX, CEN, PLS, U/D
};

/// All registers that an instruction can change.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Registers {
    mdr0: u8,
    mdr1: u8,
    dtr: u32,
    cntr: u32,
    otr: u32,
    str: u8,
}

impl Registers {
    fn of(counter: &Ls7366r) -> Self {
        Self {
            mdr0: counter.mdr0(),
            mdr1: counter.mdr1(),
            dtr: counter.dtr(),
            cntr: counter.cntr(),
            otr: counter.otr(),
            str: counter.status(),
        }
    }
}

/// A counter with [`OLD`] in its registers.
fn old() -> Ls7366r {
    let mut counter = Ls7366r::new(false, true, true);
    counter.edge(Instant::ZERO, Channel::Index, false);
    counter.timeout(Instant::from_ticks(1));
    counter.set_dtr(OLD.otr);
    counter.load_cntr();
    counter.load_otr();
    counter.set_dtr(OLD.cntr);
    counter.load_cntr();
    counter.set_dtr(OLD.dtr);
    counter.set_mdr0(OLD.mdr0);
    counter.set_mdr1(OLD.mdr1);
    assert_eq!(Registers::of(&counter), OLD);
    counter
}

#[test]
fn every_instruction() {
    for instruction in 0..=0xFF_u8 {
        // Bytes received after the instruction, and the registers afterwards.
        let (miso, new): ([u8; 5], _) = match instruction & 0b1111_1000 {
            0x08 => ([0; 5], Registers { mdr0: 0, ..OLD }),
            0x10 => ([0; 5], Registers { mdr1: 0, ..OLD }),
            0x20 => ([0; 5], Registers { cntr: 0, ..OLD }),
            0x30 => ([0; 5], Registers { str: 0b0000_1010, ..OLD }),
            0x48 => ([0x23, 0, 0, 0, 0], OLD),
            0x50 => ([0xF0, 0, 0, 0, 0], OLD),
            0x60 => ([0x55, 0x66, 0x77, 0x88, 0], Registers { otr: OLD.cntr, ..OLD }),
            0x68 => ([0x99, 0xAA, 0xBB, 0xCC, 0], OLD),
            0x70 => ([0b0001_1110, 0, 0, 0, 0], OLD),
            0x88 => ([0; 5], Registers { mdr0: 0xA8, ..OLD }),
            0x90 => ([0; 5], Registers { mdr1: 0xA8, ..OLD }),
            0x98 => ([0; 5], Registers { dtr: 0xA8B9_CADB, ..OLD }),
            0xE0 => ([0; 5], Registers { cntr: OLD.dtr, ..OLD }),
            0xE8 => ([0; 5], Registers { otr: OLD.cntr, ..OLD }),
            _ => ([0; 5], OLD),
        };
        let mut counter = old();
        let came = send(&mut counter, &[instruction, 0xA8, 0xB9, 0xCA, 0xDB, 0xEC]);
        assert_eq!(came[1..], miso, "{instruction:#04x}");
        assert_eq!(Registers::of(&counter), new, "{instruction:#04x}");
    }
}

#[test]
fn data_has_as_many_bytes_as_the_counter() {
    #[rustfmt::skip]
    let widths: [(u8, u32, &[u8]); 4] = [
        (0b00, 0x0102_0304, &[1, 2, 3, 4]),
        (0b01, 0x01_0203, &[1, 2, 3]),
        (0b10, 0x0102, &[1, 2]),
        (0b11, 0x01, &[1]),
    ];
    for (mdr1, dtr, bytes) in widths {
        let mut counter = old();
        send(&mut counter, &[0x90, mdr1]);
        send(&mut counter, &[0x98, 1, 2, 3, 4]);
        assert_eq!(counter.dtr(), dtr);
        send(&mut counter, &[0xE0]);
        for read in [0x60, 0x68] {
            let came = send(&mut counter, &[read, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]);
            assert_eq!(came[1..].split_at(bytes.len()), (bytes, &[0; 5][bytes.len()..]));
        }
    }
}

#[test]
fn there_is_one_instruction_while_ss_is_low() {
    let mut counter = old();
    // Clear STR, write MDR0 and read CNTR, each followed by bytes that must have no effect.
    assert_eq!(send(&mut counter, &[0x30, 0x20, 0x60, 0]), [0; 4]);
    assert_eq!(send(&mut counter, &[0x88, 0x03, 0x20, 0x60, 0]), [0; 5]);
    assert_eq!(send(&mut counter, &[0x60, 0x20, 0x88, 0, 0, 0x20, 0]), [0, 0x55, 0x66, 0x77, 0x88, 0, 0]);
    let new = Registers { mdr0: 0x03, str: 0b0000_1010, otr: OLD.cntr, ..OLD };
    assert_eq!(Registers::of(&counter), new);
}

#[test]
fn a_write_that_is_cut_short_changes_nothing() {
    let mut counter = old();
    for cut in [&[][..], &[0x88], &[0x90], &[0x98], &[0x98, 1], &[0x98, 1, 2], &[0x98, 1, 2, 3]] {
        send(&mut counter, cut);
        assert_eq!(Registers::of(&counter), OLD);
    }
}
