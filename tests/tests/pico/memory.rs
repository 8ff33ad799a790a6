//! Saved registers in the Pico's flash, and power failures.

use std::fs;
use std::path::Path;

use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::at;

use crate::play::{MS, Nanos, OutputRecord, Run, Script};
use crate::{START, TURN, expect_written, image, value, write};

/// Longest duration of a save, including the flash.
const SAVE: Nanos = 500 * MS;
/// Start-up time of a drive with a bad EEPROM (section 2 of the MD3's guide): 5 s of red light, then 2.5 s.
const START_UP: Nanos = 8_000 * MS;

/// Writes the user register and saves (7.20, 7.23); returns the instant at which this is over.
fn save(script: &mut Script, at: Nanos, user: u16) -> Nanos {
    write(script, at, &[(at::USER, user), (at::EEPROM, 1)]) + SAVE
}

/// Switches power off and on, and reads the user register and the state of the EEPROM after the start-up.
/// Returns the instants of the first request and of the end.
fn restart(script: &mut Script, at: Nanos) -> (Nanos, Nanos) {
    script.at(at, "power off");
    script.at(at + MS, "power on");
    let asked = at + START_UP;
    script.hear(asked, &rtu::read(1, at::USER, 1));
    script.hear(asked + TURN, &rtu::read(1, at::EEPROM, 1));
    (asked, asked + 2 * TURN)
}

fn bytes(run: &Run, from: Nanos, to: Nanos) -> u64 {
    let ops = run.did.iter().filter(|(at, _)| (from..to).contains(at));
    ops.map(|(_, did)| match did {
        OutputRecord::Erased(_) => 4_096,
        OutputRecord::Programmed(_, bytes) => u64::from(*bytes),
        _ => 0,
    })
    .sum()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn what_was_saved_is_there_after_the_power_was_off() {
    let mut script = Script::fast();
    let saved = save(&mut script, START, 0x1234);
    // This value is not saved.
    let written = write(&mut script, saved, &[(at::USER, 0x5678)]);
    let (asked, end) = restart(&mut script, written);
    let run = script.play(&image(), end);
    expect_written(&run, START, &[(at::USER, 0x1234), (at::EEPROM, 1)]);
    assert_eq!(value(&run, asked), 0x1234);
    // Section 7.20: the status of a good CRC is 0x9a.
    assert_eq!(value(&run, asked + TURN), 0x9a00);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn power_that_fails_in_a_save_leaves_the_old_the_new_or_a_bad_memory() {
    // A run without a power failure counts the bytes that a save changes in the flash.
    let mut whole = Script::fast();
    let begun = save(&mut whole, START, 0x1111);
    let done = save(&mut whole, begun, 0x2222);
    let all = bytes(&whole.play(&image(), done), begun, done);
    assert!(all > 0, "a save writes to the flash");

    let mut order = Vec::new();
    for cut in (0..=all).step_by(usize::try_from(all / 24).expect("a few bytes").max(1)) {
        let mut script = Script::fast();
        let begun = save(&mut script, START, 0x1111);
        script.at(begun, format_args!("cut {cut}"));
        let done = save(&mut script, begun, 0x2222);
        let (asked, end) = restart(&mut script, done);
        let run = script.play(&image(), end);
        order.push((cut, Memory::of(&run, asked, 0x1111, 0x2222)));
    }
    order.dedup_by_key(|(_, memory)| *memory);
    println!("a save programs {all} bytes; memory by the byte at which the power failed: {order:?}");
    assert!(order.iter().map(|(_, memory)| *memory).eq([Memory::Old, Memory::Bad, Memory::New]));
}

/// State of the memory after a power failure in a save.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Memory {
    /// The old content.
    Old,
    /// The new content.
    New,
    /// A wrong check sum (7.20).
    Bad,
}

impl Memory {
    /// State as read at `asked`, if `old` was saved earlier and power failed while `new` was being saved.
    fn of(run: &Run, asked: Nanos, old: u16, new: u16) -> Self {
        match (value(run, asked), value(run, asked + TURN)) {
            (user, 0x9a00) if user == old => Self::Old,
            (user, 0x9a00) if user == new => Self::New,
            // Section 7.20: 0xf1 means that the CRC was wrong; the registers have their defaults.
            (0x0000, 0xf100) => Self::Bad,
            other => panic!("neither old nor new: {other:04x?}"),
        }
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn power_that_fails_while_a_sector_is_erased_loses_nothing() {
    let saves = |count: u16| {
        let mut script = Script::fast();
        let end = (1..=count).fold(START, |at, n| save(&mut script, at, n));
        (script, end)
    };
    let each = saves(1).1 - START;
    // At first a new flash does not need to erase sectors.
    let (script, end) = saves(100);
    let run = script.play(&image(), end);
    let erased = run.did.iter().find(|(_, did)| matches!(did, OutputRecord::Erased(_)));
    let (first, _) = erased.expect("100 saves fill a sector");
    let before = u16::try_from((first - START) / each).expect("less than 100");
    let flash = Path::new(env!("CARGO_TARGET_TMPDIR")).join("before-an-erase");
    let _ = fs::remove_file(&flash);
    let (script, end) = saves(before);
    script.play_on(&flash, &image(), end);

    let copy = flash.with_extension("cut");
    let mut in_an_erase = 0;
    let mut order = Vec::new();
    for cut in (0..6_000).step_by(400) {
        fs::copy(&flash, &copy).expect("a file is copied");
        let mut script = Script::fast();
        script.at(START, format_args!("cut {cut}"));
        let done = save(&mut script, START, 0x2222);
        let (asked, end) = restart(&mut script, done);
        let run = script.play_on(&copy, &image(), end);
        let memory = Memory::of(&run, asked, before, 0x2222);
        let works = run.did.iter().map(|(_, did)| *did).take_while(|did| *did != OutputRecord::PowerOff);
        if let Some(OutputRecord::Erased(_)) =
            works.filter(|did| matches!(did, OutputRecord::Erased(_) | OutputRecord::Programmed(..))).last()
        {
            in_an_erase += 1;
            assert_ne!(memory, Memory::New, "nothing new was stored yet");
        }
        order.push((cut, memory));
    }
    order.dedup_by_key(|(_, memory)| *memory);
    println!("memory by the byte at which the power failed, {in_an_erase} times in an erase: {order:?}");
    assert!(in_an_erase > 3, "no power fails in an erase");
    assert_eq!(order.first().map(|(_, memory)| *memory), Some(Memory::Old));
    assert_eq!(order.last().map(|(_, memory)| *memory), Some(Memory::New));
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn many_saves_wear_all_sectors_alike() {
    let mut script = Script::fast();
    let mut at = START;
    for n in 0..300 {
        at = save(&mut script, at, n);
    }
    let (asked, end) = restart(&mut script, at);
    let run = script.play(&image(), end);
    assert_eq!(value(&run, asked), 299);
    let mut erased = std::collections::BTreeMap::<u32, u32>::new();
    for (_, did) in &run.did {
        if let OutputRecord::Erased(offset) = did {
            *erased.entry(*offset).or_default() += 1;
        }
    }
    println!("300 saves erased {erased:x?}");
    let (least, most) = (erased.values().min(), erased.values().max());
    assert!(erased.len() >= 4, "{erased:x?}");
    assert!(most <= least.map(|least| least + 1).as_ref(), "{erased:x?}");
}
