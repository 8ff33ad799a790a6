//! The UF2 with every kind of drive: which kind starts, and when.

use std::cell::RefCell;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use drivetwin_board::{Choice, Directory, Sectors};
use drivetwin_control::{Answer, Call, Decoder, FRAME, Hello, Message, Refused, Request, encode};
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::{md3, rs434};
use embedded_storage_async::nor_flash::NorFlashErrorKind;

use crate::motion::{MOVE, STEPS};
use crate::play::{Drive, MS, Nanos, OutputRecord, Run, Script};
use crate::{expect_written, image, pin, value, write};

/// Size of the Pico's flash.
const FLASH: usize = 2 << 20;
/// Size of a sector.
const SECTOR: usize = 4_096;
/// The two sectors with the choice, in front of the 48 KiB of saved registers.
const CHOICES: [u32; 2] = [0x1F_2000, 0x1F_3000];
/// Offset of the directory in the UF2.
const DIRECTORY: usize = 0x1000;

/// Pin of the Pico's own light.
const LIGHT: u8 = 25;
/// The same as a bit.
const LIGHT_BIT: u32 = 1 << 25;

/// Time from the reset, until which every kind is ready: the selector reads an image twice.
const START: Nanos = 150 * MS;
/// Time for a request and its reply.
const TURN: Nanos = 40 * MS;

/// Each kind with its first request, and the reply that only this kind gives (MD3 7.21, QSB R14, RS 6.8, MDROBOT PID 1).
fn kinds() -> [(&'static str, Vec<u8>, Vec<u8>); 8] {
    let product = |value: [u8; 2]| {
        let [high, low] = value;
        (rtu::read(1, md3::at::PRODUCT, 1).to_vec(), rtu::frame(1, &[3, 2, high, low]).to_vec())
    };
    let model = |value: [u8; 2]| {
        let [high, low] = value;
        let [register, place] = rs434::at::HW_MAJOR.to_be_bytes();
        let request = rtu::frame(1, &[4, register, place, 0, 1]);
        (request.to_vec(), rtu::frame(1, &[4, 2, high, low]).to_vec())
    };
    let version = |digits: &str| (b"R14\r".to_vec(), format!("r 14 0000{digits}0E !\r\n").into_bytes());
    let mdrobot = (rtu::read(1, 1, 1).to_vec(), rtu::frame(1, &[3, 2, 0, 81]).to_vec());
    [
        ("md3", product([0xBD, 0x01])),
        ("md3-low", product([0x3D, 0x01])),
        ("qsb-d", version("10")),
        ("qsb-m", version("11")),
        ("qsb-s", version("12")),
        ("rs434544", model([0x03, 0xE9])),
        ("rs434546", model([0x03, 0xEA])),
        ("mdrobot", mdrobot),
    ]
    .map(|(kind, (request, reply))| (kind, request, reply))
}

/// First request and reply of a kind.
fn first(kind: &str) -> (Vec<u8>, Vec<u8>) {
    let (_, request, reply) = kinds().into_iter().find(|(known, ..)| *known == kind).expect(kind);
    (request, reply)
}

fn uf2() -> PathBuf {
    std::env::var_os("DRIVETWIN_UF2").expect("DRIVETWIN_UF2 names the UF2 of all kinds").into()
}

thread_local! {
    /// The flash that a test prepares, and the number of bytes that change before power fails.
    static CHIP: RefCell<(Vec<u8>, usize)> = const { RefCell::new((Vec::new(), usize::MAX)) };
}

/// The chip of this thread.
#[derive(Clone, Copy)]
struct Chip;

/// Changes bytes from `offset` on until power fails. Of the byte at which it fails, only the upper half changes.
fn change(offset: u32, new: impl Iterator<Item = u8>) -> Result<(), NorFlashErrorKind> {
    CHIP.with_borrow_mut(|(bytes, left)| {
        for (byte, new) in bytes[offset as usize..].iter_mut().zip(new).filter(|(byte, new)| **byte != *new) {
            if *left == 0 {
                *byte = new & 0xF0 | *byte & 0x0F;
                return Err(NorFlashErrorKind::Other);
            }
            *left -= 1;
            *byte = new;
        }
        Ok(())
    })
}

impl Sectors for Chip {
    const OURS: Range<u32> = CHOICES[0]..FLASH as u32;
    const CAPACITY: usize = FLASH;
    const SECTOR: usize = SECTOR;
    const WORD: usize = 1;
    const PAGE: usize = 256;

    fn read(offset: u32) -> u8 {
        CHIP.with_borrow(|(bytes, _)| bytes[offset as usize])
    }

    fn erase(offset: u32) -> Result<(), NorFlashErrorKind> {
        change(offset, [0xFF; SECTOR].into_iter())
    }

    fn program(offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let old: Vec<u8> = (offset..).take(bytes.len()).map(Self::read).collect();
        change(offset, bytes.iter().zip(old).map(|(new, old)| new & old))
    }
}

/// Stores a choice as the board does; power fails after `bytes` bytes. Returns whether it was stored.
fn choose(kind: &str, bytes: usize) -> bool {
    CHIP.with_borrow_mut(|(_, left)| *left = bytes);
    Choice::store::<Chip>(CHOICES, kind).is_ok()
}

/// A file with a flash in which these kinds were chosen, one after the other.
fn flash(file: &str, choices: &[&str]) -> PathBuf {
    CHIP.with_borrow_mut(|(bytes, _)| *bytes = vec![0xFF; FLASH]);
    assert!(choices.iter().all(|kind| choose(kind, usize::MAX)));
    stored(file)
}

/// A file with the flash of this thread.
fn stored(file: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    CHIP.with_borrow(|(bytes, _)| fs::write(&path, bytes).expect("a file is written"));
    path
}

/// Plays a kind's first request to the UF2 on a flash. The board must be this kind.
fn expect_kind(kind: &str, flash: &Path, image: &Path) {
    let (request, reply) = first(kind);
    let mut script = Script::fast();
    script.hear(START, &request);
    let run = script.play_on(flash, image, START + TURN);
    assert_eq!(run.sent(START, START + TURN).1, reply, "{kind}");
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn every_kind_of_the_uf2_answers_its_first_request() {
    println!("time from the reset to the first answer, without the drive's start-up delay, in ms:");
    for (kind, request, reply) in kinds() {
        let flash = flash(&format!("first-{kind}"), &[kind]);
        // DE is an output from the instant at which the board listens.
        let ready = |run: &Run| run.edges(pin::DE, Drive::Low).first().copied().expect("it starts");
        let listens = ready(&Script::fast().play_on(&flash, &uf2(), START));
        let mut script = Script::fast();
        script.hear(listens + 5 * MS, &request);
        let run = script.play_on(&flash, &uf2(), START + TURN);
        let (_, sent) = run.sent(listens + 5 * MS, START + TURN);
        assert_eq!(sent, reply, "{kind}");
        // A QSB begins with its banner.
        let (answered, _) = run.sent(0, START + TURN);
        // A QSB has no light, so the board's own is lit. It shows the fan of an MDROBOT, which is off.
        assert_eq!(run.edges(LIGHT, Drive::High).is_empty(), kind == "mdrobot", "{kind}");
        let alone = ready(&Script::fast().play(&crate::image_of(kind), START));
        let ms = |at: Nanos| at as f64 / MS as f64;
        println!(
            "  {kind:<9} listens at {:5.1} (flashed alone: {:4.1}), answers at {:5.1}",
            ms(listens),
            ms(alone),
            ms(answered)
        );
        assert!(listens < 120 * MS, "{kind} listens {listens} ns after the reset");
    }
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn without_a_choice_that_it_has_it_is_an_md3() {
    expect_kind("md3", &flash("no-choice", &[]), &uf2());
    expect_kind("md3", &flash("mdrive", &["qsb-d", "mdrive"]), &uf2());
    CHIP.with_borrow_mut(|(bytes, _)| bytes[CHOICES[0] as usize..][..2 * SECTOR].fill(0x5A));
    expect_kind("md3", &stored("other-data"), &uf2());
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn power_that_fails_while_a_kind_is_chosen_leaves_the_old_or_the_new_one() {
    let mut order = Vec::new();
    for cut in 0.. {
        flash("cut", &["qsb-d", "mdrobot"]);
        let is_done = choose("md3-low", cut);
        let flash = stored("cut");
        let mut script = Script::fast();
        let (request, old) = first("mdrobot");
        let (other, new) = first("md3-low");
        script.hear(START, &request);
        script.hear(START + TURN, &other);
        let run = script.play_on(&flash, &uf2(), START + 2 * TURN);
        let is_old = run.sent(START, START + TURN).1 == old;
        let is_new = run.sent(START + TURN, START + 2 * TURN).1 == new;
        assert!(is_old != is_new, "cut after {cut} bytes");
        order.push(is_new);
        if is_done {
            break;
        }
    }
    let cuts = order.len();
    order.dedup();
    assert_eq!(order, [false, true], "{cuts} cuts");
    println!("power failed at each of {cuts} bytes that a choice erases and programs");
    assert!(cuts > 40, "{cuts} cuts");
}

/// Time from a start until the computer can use the ports of the board's USB cable.
const PLUGGED: Nanos = 300 * MS;
/// Time for a call and its reply.
const CALL: Nanos = 10 * MS;

/// A script of a computer that is there when the board gets power, and makes a call at [`PLUGGED`].
fn calling(call: Call<'_>) -> Script {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    call_on(&mut script, call);
    script
}

/// Lets the computer open the port at [`PLUGGED`], and make a call.
fn call_on(script: &mut Script, call: Call<'_>) {
    script.at(PLUGGED, "usb open control");
    ask(script, PLUGGED + CALL, call);
}

fn ask(script: &mut Script, at: Nanos, call: Call<'_>) {
    let mut frame = [0; FRAME];
    script.send(at, "control", encode(&Request { number: 1, call }, &mut frame).expect("it fits"));
}

/// Passes the reply to a call at `at` to `judge`.
fn reply<T>(run: &Run, at: Nanos, judge: impl FnOnce(Result<Answer<'_>, Refused>) -> T) -> T {
    let mut decoder = Decoder::new();
    for byte in run.got("control", at, at + CALL) {
        if let Some(Message::Reply(reply)) = decoder.push(byte) {
            return judge(reply.answer);
        }
    }
    panic!("no reply at {at} ns: {:?}", run.usb)
}

/// Line of each kind at its first start, as in docs/how-to/each-drive.md.
fn line(kind: &str) -> &'static str {
    match kind {
        "md3" | "md3-low" => "9600 8E1",
        "mdrobot" => "19200 8N1",
        "rs434544" | "rs434546" => "115200 8E1",
        _ => "230400 8N1",
    }
}

/// Times of the first answers of control and of the bus, if a program opens both ports as soon as the computer has
/// configured the device, and the cable is plugged in at `plugged`.
fn first_answers(kind: &str, flash: &Path, plugged: Nanos) -> [Nanos; 2] {
    let mut script = Script::fast();
    script.at(plugged, "usb plug");
    let end = plugged + 2 * PLUGGED;
    let run = script.play_on(flash, &uf2(), end);
    let configured = run.usb.iter().find(|(_, what)| what == "configured").expect("it is configured").0;
    let (request, answer) = first(kind);
    script.at(configured, format_args!("usb line {}", line(kind)));
    script.at(configured, "usb open bus");
    script.at(configured, "usb open control");
    ask(&mut script, configured, Call::Hello);
    // The host makes its requests for the line first, and a master waits until the port is open.
    script.send(configured + 2 * MS, "bus", &request);
    let run = script.play_on(flash, &uf2(), end);
    let came = |port| {
        run.usb
            .iter()
            .find(|(_, what)| what.starts_with(port))
            .unwrap_or_else(|| panic!("{kind}: no answer: {:?}", run.usb))
            .0
    };
    let [control, bus] = ["control ", "bus "].map(came);
    reply(&run, control, |answer| {
        assert!(matches!(answer, Ok(Answer::Hello(Hello { kind: k, board: "pico", .. })) if k == kind));
    });
    assert!(run.got("bus ", bus, end).ends_with(&answer), "{kind}");
    [control - plugged, bus - plugged]
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn the_first_answers_come_soon_after_plugging_in() {
    println!("time from plugging in to the first answers of control and of the bus, in ms:");
    let ms = |at: Nanos| at as f64 / MS as f64;
    for (kind, ..) in kinds() {
        let flash = flash(&format!("plugged-{kind}"), &[kind]);
        let [control, bus] = first_answers(kind, &flash, 0);
        let [later, bus_later] = first_answers(kind, &flash, 1_000 * MS);
        println!(
            "  {kind:<9} {:5.1} and {:5.1} with its power, {:5.1} and {:5.1} if it has power before",
            ms(control),
            ms(bus),
            ms(later),
            ms(bus_later)
        );
        assert!(control <= 210 * MS && bus <= 220 * MS, "{kind}");
        assert!(later <= 130 * MS && bus_later <= 150 * MS, "{kind}");
    }
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn a_board_names_its_kinds_and_refuses_others() {
    let flash = flash("names", &[]);
    for (number, (kind, ..)) in (0..).zip(kinds()) {
        let run = calling(Call::Kind(number)).play_on(&flash, &uf2(), PLUGGED + 2 * CALL);
        reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Ok(Answer::Kind(Some(kind)))));
    }
    let run = calling(Call::Kind(8)).play_on(&flash, &uf2(), PLUGGED + 2 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Ok(Answer::Kind(None))));
    let run = calling(Call::Become("mdrive")).play_on(&flash, &uf2(), PLUGGED + 2 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Err(Refused::Unknown)));
    // An image that was flashed alone.
    let run = calling(Call::Kind(0)).play(&image(), PLUGGED + 2 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Ok(Answer::Kind(Some("md3")))));
    let run = calling(Call::Kind(1)).play(&image(), PLUGGED + 2 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Ok(Answer::Kind(None))));
    let run = calling(Call::Become("qsb-d")).play(&image(), PLUGGED + 2 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Err(Refused::Unknown)));
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn a_kind_that_is_chosen_over_the_cable_starts_at_once_and_after_each_power_on() {
    let flash = flash("over-the-cable", &[]);
    let asked = PLUGGED + CALL;
    let mut script = calling(Call::Become("mdrobot"));
    // The computer finds the board again.
    let again = asked + 2 * PLUGGED;
    ask(&mut script, asked + 70 * MS, Call::Hello);
    script.at(again, "usb open control");
    ask(&mut script, again + CALL, Call::Hello);
    // Until the board starts again, it answers nothing more.
    let run = script.play_on(&flash, &uf2(), again + 2 * CALL);
    let reset = run.did.iter().find(|(_, did)| *did == OutputRecord::Watchdog).expect("it starts again").0;
    let got: Vec<Nanos> =
        run.usb.iter().filter(|(_, what)| what.starts_with("control ")).map(|(at, _)| *at).collect();
    let [replied, ..] = got[..] else { panic!("no reply: {:?}", run.usb) };
    reply(&run, replied, |answer| assert_eq!(answer, Ok(Answer::Done)));
    assert!((45 * MS..55 * MS).contains(&(reset - replied)), "reply at {replied} ns, reset at {reset} ns");
    assert!(!got.iter().any(|at| (replied + 1..reset).contains(at)), "{:?}", run.usb);
    println!(
        "the reply comes {} ms after the call, and the reset {} ms after it",
        (replied - asked) / MS,
        (reset - replied) / MS
    );
    reply(&run, again + CALL, |answer| {
        assert!(matches!(answer, Ok(Answer::Hello(Hello { kind: "mdrobot", .. }))), "{answer:?}");
    });
    expect_kind("mdrobot", &flash, &uf2());
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn a_change_of_the_kind_ends_the_motion() {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    script.at(PLUGGED, "usb open control");
    let asked = write(&mut script, PLUGGED + CALL, &MOVE);
    script.hear(asked, &rtu::write(1, md3::at::MOTION, md3::bit::MOVE));
    let called = asked + 200 * MS;
    ask(&mut script, called, Call::Become("qsb-d"));
    let run = script.play_on(&flash("moving", &[]), &uf2(), called + PLUGGED);
    let replied = run.usb.iter().find(|(_, what)| what.starts_with("control ")).expect("a reply").0;
    let steps = run.edges(pin::STEP, Drive::High);
    let (first, last) = (steps[0], steps[steps.len() - 1]);
    assert!(
        (asked..called).contains(&first) && steps.len() < STEPS as usize,
        "{} steps from {first} ns on",
        steps.len()
    );
    assert!(
        (called..=replied).contains(&last),
        "called at {called} ns, last step at {last}, reply at {replied}"
    );
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn a_kind_that_the_board_has_already_is_stored_and_the_drive_goes_on() {
    let flash = flash("the-same", &[]);
    let (asked, read) = (PLUGGED + CALL, PLUGGED + CALL + 200 * MS);
    let mut script = Script::fast();
    script.at(0, "usb plug");
    script.hear(START, &rtu::write(1, md3::at::USER, 0x1234));
    call_on(&mut script, Call::Become("md3"));
    script.hear(read, &rtu::read(1, md3::at::USER, 1));
    let run = script.play_on(&flash, &uf2(), read + TURN);
    let replied = run.usb.iter().find(|(_, what)| what.starts_with("control ")).expect("a reply").0;
    reply(&run, replied, |answer| assert_eq!(answer, Ok(Answer::Done)));
    assert!(
        asked < replied && !run.did.iter().any(|(_, did)| *did == OutputRecord::Watchdog),
        "{:?}",
        run.did
    );
    assert_eq!(value(&run, read), 0x1234, "the drive has kept its power");
    CHIP.with_borrow_mut(|(bytes, _)| *bytes = fs::read(&flash).expect("the flash"));
    assert_eq!(Choice::last(CHOICES, Chip::read).as_ref().and_then(Choice::kind), Some("md3"));
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn power_that_fails_while_the_board_stores_a_choice_leaves_the_old_or_the_new_kind() {
    let older = flash("before-a-choice", &["qsb-d", "md3"]);
    let mut order = Vec::new();
    // The first sector is erased, of which 40 bytes change, and a page is programmed, of which 40 bytes change.
    for cut in (0..41).chain([4_000, 4_095]).chain(4_096..4_137).chain([4_351, 5_000]) {
        let flash = older.with_file_name("in-a-choice");
        fs::copy(&older, &flash).expect("a file is copied");
        let mut script = Script::fast();
        script.at(0, "usb plug");
        script.at(0, format_args!("cut {cut}"));
        call_on(&mut script, Call::Become("mdrobot"));
        order.push(is_new(&script, cut, &flash));
    }
    let cuts = order.len();
    order.dedup();
    assert_eq!(order, [false, true], "{cuts} cuts");
}

/// Plays a choice, and returns whether the board is an MDROBOT at the next power-on. Otherwise it must be an MD3.
fn is_new(script: &Script, cut: u64, flash: &Path) -> bool {
    script.play_on(flash, &uf2(), PLUGGED + 60 * CALL);
    let (request, old) = first("md3");
    let (other, new) = first("mdrobot");
    let mut script = Script::fast();
    script.hear(START, &request);
    script.hear(START + TURN, &other);
    let run = script.play_on(flash, &uf2(), START + 2 * TURN);
    let is_old = run.sent(START, START + TURN).1 == old;
    let is_new = run.sent(START + TURN, START + 2 * TURN).1 == new;
    assert!(is_old != is_new, "cut after {cut} bytes");
    is_new
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn the_boot_loader_starts_over_the_cable() {
    let run = calling(Call::Bootloader).play(&uf2(), PLUGGED + 300 * CALL);
    reply(&run, PLUGGED + CALL, |answer| assert_eq!(answer, Ok(Answer::Done)));
    assert!(matches!(run.did[..], [.., (_, OutputRecord::BootLoader(LIGHT_BIT))]), "{:?}", run.did);
}

/// The UF2 with one byte changed in the images of these kinds.
fn damaged(file: &str, kinds: &[&str]) -> PathBuf {
    let mut bytes = fs::read(uf2()).expect("the UF2");
    // Each block of 512 bytes has 256 bytes of the flash, behind its header of 32.
    let place = |offset: usize| offset / 256 * 512 + 32 + offset % 256;
    let block = bytes[place(DIRECTORY)..][..Directory::BYTES].to_vec();
    let directory = Directory::read(&block).expect("a directory");
    for kind in kinds {
        let image = directory.find(kind).expect(kind);
        bytes[place(image.offset as usize + image.bytes as usize / 2)] ^= 0x10;
    }
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    fs::write(&path, bytes).expect("a file is written");
    path
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn an_image_that_is_not_whole_does_not_start() {
    let flash = flash("damaged", &["qsb-m"]);
    expect_kind("qsb-m", &flash, &damaged("others.uf2", &["md3", "qsb-d"]));
    expect_kind("md3", &flash, &damaged("chosen.uf2", &["qsb-m"]));
    let run = Script::fast().play_on(&flash, &damaged("both.uf2", &["qsb-m", "md3"]), 3_000 * MS);
    assert!(
        matches!(run.did[..], [.., (_, OutputRecord::BootLoader(LIGHT_BIT))]),
        "the boot loader waits for another UF2: {:?}",
        run.did
    );
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn a_new_uf2_keeps_the_choice_and_saved_registers() {
    let flash = flash("kept", &["md3-low"]);
    let saves = [(md3::at::USER, 0x1234), (md3::at::EEPROM, 1)];
    let mut script = Script::fast();
    write(&mut script, START, &saves);
    let run = script.play_on(&flash, &uf2(), START + 500 * MS);
    expect_written(&run, START, &saves);
    // The emulator puts the UF2 into flash again.
    let mut script = Script::fast();
    script.hear(START, &rtu::read(1, md3::at::USER, 1));
    let run = script.play_on(&flash, &uf2(), START + TURN);
    assert_eq!(value(&run, START), 0x1234);
    expect_kind("md3-low", &flash, &uf2());
}

#[test]
#[ignore = "needs the emulator and the UF2 of all kinds: `cargo xtask test` brings both"]
fn an_image_that_is_flashed_alone_is_its_kind_whatever_was_chosen() {
    let flash = flash("alone", &["qsb-d"]);
    expect_kind("qsb-d", &flash, &uf2());
    expect_kind("md3", &flash, &image());
    expect_kind("qsb-d", &flash, &uf2());
}
