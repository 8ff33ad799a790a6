//! Each register: default, limits, variants, letters, and whether it is saved.

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::Setup;
use drivetwin_sim::line::LineMode;

use crate::rig::{KINDS, Rig};

/// A register as described in the command list.
struct Register {
    number: u8,
    letters: &'static str,
    /// Letters of the variants that have the register.
    on: &'static str,
    /// Value in a new QSB.
    default: u32,
    /// Legal values, each with the value that is then read back.
    takes: &'static [(u32, u32)],
    /// Illegal values, including those next to each limit.
    refuses: &'static [u32],
    /// True if command 3 saves the register.
    saved: bool,
}

/// A register without special cases.
const fn plain(number: u8, on: &'static str, default: u32, takes: &'static [(u32, u32)]) -> Register {
    Register { number, letters: "RW", on, default, takes, refuses: &[], saved: true }
}

const fn shown(number: u8, letters: &'static str, on: &'static str, default: u32) -> Register {
    Register { number, letters, on, default, takes: &[], refuses: &[], saved: false }
}

/// The table of factory defaults and the command list. VERSION is tested in examples.rs. The last legal value
/// of a register is the one that the tests save.
const REGISTERS: [Register; 22] = [
    // QSB-9: 3 in bits 1:0 is not a mode, and bits 2 to 4 of a write are ignored.
    Register {
        refuses: &[0x03, 0x07, 0x0B, 0x0F, 0x13, 0x20, 0xFFFF_FFFF],
        ..plain(0x00, "DMS", 0x00, &[(0x12, 2), (0x10, 0), (0x0E, 2), (0x04, 0), (0x00, 0), (0x01, 1)])
    },
    // A read returns the levels of the pins, which are inputs here, not the written bits (QSB-23).
    Register {
        letters: "RWS",
        refuses: &[0x10, 0xFFFF_FFFF],
        ..plain(0x01, "DM", 0x0F, &[(0x00, 0x0F), (0x0F, 0x0F)])
    },
    Register {
        refuses: &[0x2000, 0xFFFF_FFFF],
        ..plain(0x02, "DM", 0, &[(0, 0), (0x1FFF, 0x1FFF), (0x0A5A, 0x0A5A)])
    },
    Register { refuses: &[0x100], ..plain(0x03, "DMS", 0x4F, &[(0, 0), (0xFF, 0xFF), (0xA5, 0xA5)]) },
    // QSB-9: bits 1:0 always read 0.
    Register {
        refuses: &[0x200],
        ..plain(0x04, "DMS", 0, &[(0, 0), (0x1FF, 0x1FC), (0x003, 0), (0x154, 0x154)])
    },
    shown(0x05, "RS", "DMS", 0),
    shown(0x06, "RS", "DMS", 0x0A),
    shown(0x07, "R", "DMS", 0),
    plain(0x08, "DMS", 0x1F3, &[(0, 0), (0xFFFF_FFFF, 0xFFFF_FFFF), (0x1234_ABCD, 0x1234_ABCD)]),
    Register { refuses: &[4], ..shown(0x09, "W", "DMS", 0) },
    Register { refuses: &[2], ..shown(0x0A, "W", "DMS", 0) },
    Register { refuses: &[0x1_0000], ..plain(0x0B, "DMS", 0, &[(0, 0), (0xFFFF, 0xFFFF), (0x1234, 0x1234)]) },
    Register { refuses: &[0x1_0000], ..plain(0x0C, "DMS", 0xFFFF, &[(0, 0), (0xFFFF, 0xFFFF), (7, 7)]) },
    Register {
        refuses: &[0x1F, 0, 0x32C9],
        ..plain(0x0F, "M", 0x20, &[(0x20, 0x20), (0x32C8, 0x32C8), (0x3E8, 0x3E8)])
    },
    Register {
        refuses: &[0x3F, 0, 0x5_7E41],
        ..plain(0x10, "M", 0x1_86A0, &[(0x40, 0x40), (0x5_7E40, 0x5_7E40), (0x1_0001, 0x1_0001)])
    },
    Register {
        refuses: &[0x8000_0000],
        ..plain(0x11, "M", 0, &[(0x8000_0001, 0x8000_0001), (0x7FFF_FFFF, 0x7FFF_FFFF), (0x7D0, 0x7D0)])
    },
    // The manual prints its range as FFFFCD38 to 000032C8. With fewer than eight digits, CD38 is +52,536.
    Register {
        refuses: &[0xFFFF_CD37, 0x32C9, 0xCD38],
        ..plain(
            0x12,
            "M",
            0x20,
            &[(0xFFFF_CD38, 0xFFFF_CD38), (0x32C8, 0x32C8), (0, 0), (0xFFFF_FC18, 0xFFFF_FC18)],
        )
    },
    shown(0x13, "RS", "M", 1),
    shown(0x14, "R", "DMS", 0),
    // Registers 15 and 16 are tested below and in replies.rs. Higher registers do not exist.
    shown(0x17, "", "DMS", 0),
    shown(0x80, "", "DMS", 0),
    shown(0xFF, "", "DMS", 0),
];

/// The letter of a variant in the tables above.
fn letter(kind: &str) -> char {
    kind.to_uppercase().chars().last().expect("a kind has a letter")
}

impl Register {
    fn is_on(&self, kind: &str) -> bool {
        self.on.contains(letter(kind))
    }

    /// Number of the register as in commands.
    fn name(&self) -> String {
        format!("{:02X}", self.number)
    }

    fn unsupported(&self) -> String {
        format!("x {:02X} 00000000 !", self.number)
    }
}

#[test]
fn factory_defaults() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        for register in &REGISTERS {
            let name = register.name();
            if register.is_on(kind) && register.letters.contains('R') && register.number != 0x14 {
                assert_eq!(rig.read(&name), register.default, "{kind}: {name}");
            }
        }
        assert_eq!(rig.read("15"), 0x0B);
    }
}

/// QSB-2: the drive answers `x` if the register does not exist, is not on this variant, or does not support the
/// letter of the command (R, W or S). The data of the command has no influence.
#[test]
fn letters() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        for register in &REGISTERS {
            let name = register.name();
            for (letter, data) in [("R", ""), ("W", "0"), ("W", "FFFFFFFF"), ("S", "")] {
                let reply = rig.ask(&format!("{letter}{name}{data}"));
                if register.is_on(kind) && register.letters.contains(letter) {
                    assert!(!reply.starts_with('x'), "{kind}: {letter}{name}{data} is answered {reply}");
                } else {
                    assert_eq!(reply, register.unsupported(), "{kind}: {letter}{name}{data}");
                }
            }
        }
        rig.says(&[
            ("S0B", "x 0B 00000000 !"),
            ("S0D", "x 0D 00000000 !"),
            ("W0E0", "x 0E 00000000 !"),
            ("S15", "x 15 00000000 !"),
            ("R16", "x 16 00000000 !"),
            ("S16", "x 16 00000000 !"),
        ]);
    }
}

/// The reply to a write repeats its data, even if the register reads back differently.
#[test]
fn values_in_range() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        for register in REGISTERS.iter().filter(|register| register.is_on(kind)) {
            let name = register.name();
            for (value, reads) in register.takes {
                let reply = rig.ask(&format!("W{name}{value:08X}"));
                assert_eq!(reply, format!("w {name} {value:08X} !"), "{kind}");
                assert_eq!(rig.read(&name), *reads, "{kind}: {name} after {value:X}");
            }
        }
    }
}

/// The reply to a refused write repeats its data. Nothing is written.
#[test]
fn values_out_of_range() {
    for kind in KINDS {
        let mut rig = Rig::ready(kind);
        for register in REGISTERS.iter().filter(|register| register.is_on(kind)) {
            let name = register.name();
            for value in register.refuses {
                let reply = rig.ask(&format!("W{name}{value:X}"));
                assert_eq!(reply, format!("e {name} {value:08X} !"), "{kind}");
                if register.letters.contains('R') {
                    assert_eq!(rig.read(&name), register.default, "{kind}: {name} after {value:X}");
                }
            }
        }
        rig.says(&[("W1510", "e 15 00000010 !"), ("R15", "r 15 0000000B !")]);
    }
}

/// Data: "leading zeros are ignored", fewer than eight digits are positive, upper and lower case are equal.
#[test]
fn data_of_one_to_eight_digits() {
    let mut rig = Rig::ready("qsb-m");
    rig.says(&[
        ("W081", "w 08 00000001 !"),
        ("W0801", "w 08 00000001 !"),
        ("W08001", "w 08 00000001 !"),
        ("W080000001", "w 08 00000001 !"),
        ("W0800000001", "w 08 00000001 !"),
        ("W08FFFFFFF", "w 08 0FFFFFFF !"),
        ("W08ffFFffFE", "w 08 FFFFFFFE !"),
        ("R08", "r 08 FFFFFFFE !"),
        ("W0c0a", "w 0C 0000000A !"),
        ("R0c", "r 0C 0000000A !"),
        // -1,000 needs eight digits.
        ("W12FFFFFC18", "w 12 FFFFFC18 !"),
        ("W12FFFFC18", "e 12 0FFFFC18 !"),
        ("R12", "r 12 FFFFFC18 !"),
    ]);
}

/// Register 16 takes 1, 3 and x0A on every variant, and 0 to 9 on the -M (as printed beside it).
#[test]
fn commands() {
    for kind in KINDS {
        for number in 0..=9 {
            let mut rig = Rig::ready(kind);
            // Commands 8 and 9 are refused while the motor drive is inactive (QSB-27).
            let taken = match number {
                1 | 3 => true,
                8 | 9 => false,
                _ => kind == "qsb-m",
            };
            let letter = if taken { 'w' } else { 'e' };
            assert_eq!(rig.ask(&format!("W16{number}")), format!("{letter} 16 {number:08X} !"), "{kind}");
        }
        for number in [0x00B, 0x010, 0x0F, 0x80A, 0x70B, 0x100, 0x1_0A0A, 0x8000_000A, 0xFFFF_FFFF_u32] {
            let reply = Rig::ready(kind).ask(&format!("W16{number:X}"));
            assert_eq!(reply, format!("e 16 {number:08X} !"), "{kind}");
        }
        for rate in 0..=7 {
            let reply = Rig::ready(kind).ask(&format!("W16{rate}0A"));
            assert_eq!(reply, format!("w 16 00000{rate}0A !"), "{kind}");
        }
    }
}

/// Values that command 3 has saved are restored. Without command 3 no value is.
#[test]
fn saved_or_not() {
    for kind in KINDS {
        for save in [false, true] {
            let mut rig = Rig::ready(kind);
            let mine = || REGISTERS.iter().filter(|register| register.is_on(kind));
            for register in mine() {
                if let Some((value, _)) = register.takes.last() {
                    rig.write(&format!("W{}{value:08X}", register.name()));
                }
            }
            if save {
                rig.save();
            }
            rig.restart(kind);
            for register in mine() {
                let name = register.name();
                let Some((_, reads)) = register.takes.last() else { continue };
                let expected = if save && register.saved { *reads } else { register.default };
                // DIO3 and DIO1 are outputs after the restart, and high.
                assert_eq!(rig.read(&name), expected, "{kind}: {name}, saved: {save}");
            }
        }
    }
}

/// 05, 06, 07, 0D and CNTR are not saved.
#[test]
fn registers_that_are_never_saved() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0343");
    rig.write("W04010");
    rig.write("W08FFFFFFFE");
    rig.write("W0A0");
    rig.turn(4);
    rig.high("I");
    rig.says(&[("R0E", "r 0E 00000002 !"), ("R05", "r 05 00000002 !"), ("R06", "r 06 0000009A !")]);
    rig.save();
    rig.low("I");
    rig.restart("qsb-m");
    rig.says(&[
        ("R0E", "r 0E 00000000 !"),
        ("R07", "r 07 00000000 !"),
        ("R05", "r 05 00000000 !"),
        ("R06", "r 06 0000000A !"),
    ]);
    rig.assert_time_stamp(0);
}

/// CLEAR 0 and 1 set MDR0 and MDR1 to 0, which is not MDR0's factory value (QSB-9).
#[test]
fn clear_mdr0_and_mdr1() {
    let mut rig = Rig::ready("qsb-s");
    rig.says(&[
        ("W04154", "w 04 00000154 !"),
        ("W090", "w 09 00000000 !"),
        ("R03", "r 03 00000000 !"),
        ("R04", "r 04 00000154 !"),
        ("W091", "w 09 00000001 !"),
        ("R04", "r 04 00000000 !"),
    ]);
}

/// CLEAR 2 and 3, LOAD 0 and 1. None of them sets a flag (QSB-17).
#[test]
fn clear_and_load() {
    let mut rig = Rig::ready("qsb-s");
    rig.write("W0343");
    rig.turn(-5);
    rig.says(&[
        ("R0E", "r 0E FFFFFFFB !"),
        // STR shows borrow, sign, and direction down.
        ("R06", "r 06 00000049 !"),
        ("W092", "w 09 00000002 !"),
        ("R0E", "r 0E 00000000 !"),
        ("R06", "r 06 00000049 !"),
        ("W093", "w 09 00000003 !"),
        ("R06", "r 06 00000008 !"),
        ("W0A0", "w 0A 00000000 !"),
        ("R0E", "r 0E 000001F3 !"),
        ("R06", "r 06 00000008 !"),
        ("W0A1", "w 0A 00000001 !"),
        ("R07", "r 07 000001F3 !"),
    ]);
    rig.turn(-1);
    // R07 takes a new snapshot and does not return the one of W0A1 (QSB-9).
    rig.says(&[("R07", "r 07 000001F2 !"), ("R0E", "r 0E 000001F2 !")]);
}

/// Register 0D counts at 512 Hz. Only the value 1 clears it, and clearing does not shift its ticks (QSB-10).
#[test]
fn time_stamp() {
    let mut rig = Rig::ready("qsb-s");
    rig.at(1.secs());
    rig.after(1.micros());
    rig.says(&[("R0D", "r 0D 00000200 !")]);
    rig.at(2.secs());
    rig.after(1.micros());
    rig.says(&[("W0D0", "w 0D 00000000 !"), ("W0D2", "w 0D 00000002 !"), ("W0DFFFFFFFF", "w 0D FFFFFFFF !")]);
    rig.assert_time_stamp(0);
    // Clears the register when 30,000 of the 31,250 parts of a tick have passed.
    rig.past_tick(30_000);
    let cleared = rig.number();
    rig.says(&[("W0D1", "w 0D 00000001 !"), ("R0D", "r 0D 00000000 !")]);
    rig.assert_time_stamp(cleared);
    rig.after(10.secs());
    rig.assert_time_stamp(cleared);
}

/// The time stamp wraps at 2^32 ticks, or 97.1 days.
#[test]
fn time_stamp_wraps() {
    let mut rig = Rig::ready("qsb-s");
    rig.past_tick(50);
    rig.poke("TimeStamp", 0xFFFF_FFFF);
    rig.says(&[("R0D", "r 0D FFFFFFFF !")]);
    rig.past_tick(50);
    rig.says(&[("R0D", "r 0D 00000000 !")]);

    let mut rig = Rig::ready("qsb-s");
    rig.after((98 * 86_400).secs());
    rig.past_tick(50);
    // 98 days are 4,335,206,400 ticks. The test takes a few ticks more.
    let bit = rig.number() - 98 * 86_400 * 512;
    assert_eq!(u64::from(rig.read("0D")), 4_335_206_400 - 0x1_0000_0000 + bit);
}

/// Register 14 has the serial number in five decimal digits.
#[test]
fn serial_numbers() {
    for (serial, reply) in [(12_345, "r 14 1234510E !"), (99_999, "r 14 9999910E !"), (0, "r 14 0000010E !")]
    {
        let mut rig = Rig::ready("qsb-m");
        let row = rig.bench.spec(rig.seat).find("SerialNumber").expect("a register").row;
        let setup = Setup { presets: vec![(row, serial)], ..Setup::default() };
        rig = Rig::new("qsb-m", LineMode::Fast, setup);
        rig.until_banner("qsb-m");
        rig.says(&[("R14", reply)]);
    }
}

/// QSB-8: a preset of a powered drive lasts until a reset, unless command 3 saves it.
#[test]
fn presets_with_power() {
    for save in [false, true] {
        let mut rig = Rig::ready("qsb-d");
        rig.poke("SerialNumber", 12_345);
        rig.poke("BaudRate", 4);
        assert_eq!(rig.bench.line(rig.bus).baud, 115_200);
        rig.says(&[("R14", "r 14 1234500E !")]);
        if save {
            rig.save();
        }
        rig.restart("qsb-d");
        assert_eq!(rig.bench.line(rig.bus).baud, if save { 115_200 } else { 230_400 });
        rig.says(&[("R14", if save { "r 14 1234500E !" } else { "r 14 0000100E !" })]);
    }
}

impl Rig {
    /// Asserts just after the next tick that register 0D reads the ticks since it was cleared. It was cleared
    /// `cleared` ticks after power-on.
    #[track_caller]
    pub(crate) fn assert_time_stamp(&mut self, cleared: u64) {
        self.past_tick(50);
        let number = self.number();
        assert_eq!(u64::from(self.read("0D")), number - cleared);
    }
}
