//! An RS 434544: a memory of 4 KiB in the flash, characters of seven bits, and a user program that runs while
//! the bus is read.

use std::fmt::Write as _;

use drivetwin_protocol::modbus::rtu;

use crate::image_of;
use crate::play::{Drive, MS, Nanos, OutputRecord, Run, Script};

/// Time of the first request. Before, the board copies itself to RAM.
const START: Nanos = 60 * MS;
/// Time longer than a request and its reply at 115,200 baud.
const TURN: Nanos = 10 * MS;
/// Number of lines of a user program (6.6).
const LINES: u16 = 1_024;

// Registers and keys, from chapter 6 of the manual.
const SPEED: u16 = 0x500B;
const ERROR: u16 = 0x5023;
const FLAG_SAVE_INI: u16 = 0x5024;
const FLAG_SAVE_USER_PROGRAM: u16 = 0x5025;
const FLAG_RESTART: u16 = 0x5026;
const WRITE_CMD: u16 = 0x6000;
const READ_CMD: u16 = 0x6003;
const CMD_R: u16 = 0x6004;
const AX: u16 = 0x7000;
const SAVE_INI: u16 = 0x37FA;
const SAVE_PROGRAM: u16 = 0x8426;
const LOAD_PROGRAM: u16 = 0x9346;

fn play(script: &Script, end: Nanos) -> Run {
    script.play(&image_of("rs434544"), end)
}

/// A request that writes a line of the program to the buffer: function 16 to WRITE_CMD and CMD_W.
fn line(place: u16, command: u16, data: u16) -> Vec<u8> {
    let [high, low] = WRITE_CMD.to_be_bytes();
    let mut pdu = vec![16, high, low, 0, 3, 6];
    pdu.extend([place, command, data].iter().flat_map(|word| word.to_be_bytes()));
    rtu::frame(1, &pdu).to_vec()
}

/// Sends requests one after the other, starting at `at`; returns the instant at which all are answered.
fn ask(script: &mut Script, mut at: Nanos, requests: &[Vec<u8>]) -> Nanos {
    for request in requests {
        script.hear(at, request);
        at += TURN;
    }
    at
}

/// Words in the reply to a read at `at`.
fn words(run: &Run, at: Nanos) -> Vec<u16> {
    let (_, reply) = run.sent(at, at + TURN);
    let pdu = rtu::verify_crc(&reply).unwrap_or_else(|| panic!("{reply:02x?} at {at} ns"));
    let [1, 3, _, words @ ..] = pdu else { panic!("{pdu:02x?} at {at} ns") };
    words.chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect()
}

/// Loads the program from flash, and requests line `place` and ERROR. Returns the instants of these two
/// requests and of the end.
fn look(script: &mut Script, at: Nanos, place: u16) -> [Nanos; 3] {
    let load = rtu::write(1, FLAG_SAVE_USER_PROGRAM, LOAD_PROGRAM).to_vec();
    let show = rtu::write(1, READ_CMD, place).to_vec();
    let asked = ask(script, at, &[load, show]);
    let error = ask(script, asked, &[rtu::read(1, CMD_R, 2).to_vec()]);
    [asked, error, ask(script, error, &[rtu::read(1, ERROR, 1).to_vec()])]
}

/// Switches power off and on; returns the instant from which the drive answers again.
fn restart(script: &mut Script, at: Nanos) -> Nanos {
    script.at(at, "power off");
    script.at(at + MS, "power on");
    at + 400 * MS
}

/// Pins of CLR_FLASH, RED and GREEN on this board.
const CLR_FLASH: u8 = 8;
const RED: u8 = 14;
const GREEN: u8 = 15;

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_contact_that_is_closed_when_power_comes_counts_from_there() {
    for closed in [true, false] {
        let mut script = Script::default();
        if closed {
            script.at(0, format_args!("pin {CLR_FLASH} low"));
        }
        let run = play(&script, 900 * MS);
        let lit = [RED, GREEN].map(|light| run.edges(light, Drive::High));
        // With the contact closed the lights are on for 250 ms in turn, red first (section 7). Otherwise
        // green shows after 500 ms that the drive is ready.
        let turns: [&[Nanos]; 2] = if closed { [&[0, 500], &[250, 750]] } else { [&[], &[500]] };
        for (lit, turns) in lit.iter().zip(turns) {
            assert_eq!(lit.len(), turns.len(), "{lit:?}");
            for (lit, turn) in lit.iter().zip(turns) {
                assert!((turn * MS..turn * MS + START).contains(lit), "{lit} ns");
            }
        }
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_program_is_stored_before_the_answer_and_outlasts_the_power() {
    // Every piece of the memory changes with each save, so that sectors must be erased in the end.
    const SAVES: u16 = 16;
    const STEP: u16 = 64;
    /// Limit that firmware/boards/rp2040/README.md promises.
    const LONGEST: Nanos = 300 * MS;
    let mut script = Script::fast();
    let mut at = START;
    let mut saves = Vec::new();
    for n in 1..=SAVES {
        let places = (0..LINES).step_by(usize::from(STEP));
        at = ask(&mut script, at, &places.map(|place| line(place, n, place)).collect::<Vec<_>>());
        script.hear(at, &rtu::write(1, FLAG_SAVE_USER_PROGRAM, SAVE_PROGRAM));
        saves.push(at);
        at += LONGEST + 100 * MS;
    }
    let back = restart(&mut script, at);
    let [first, _, next] = look(&mut script, back, 0);
    let [last, error, end] = look(&mut script, next, LINES - STEP);
    let run = play(&script, end);

    let answer = rtu::write(1, FLAG_SAVE_USER_PROGRAM, SAVE_PROGRAM);
    let mut longest = 0;
    for save in saves {
        let (begins, reply) = run.sent(save, save + LONGEST);
        assert_eq!(reply, answer.as_slice(), "at {save} ns");
        longest = longest.max(begins - save);
    }
    let erased = run.did.iter().filter(|(_, did)| matches!(did, OutputRecord::Erased(_))).count();
    println!("a program is stored within {} ms, with {erased} sectors erased for {SAVES}", longest / MS);
    assert!(erased > 0, "no sector was erased");
    assert_eq!(words(&run, first), [SAVES, 0]);
    assert_eq!(words(&run, last), [SAVES, LINES - STEP]);
    assert_eq!(words(&run, error), [0]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_program_that_is_stored_again_costs_next_to_nothing() {
    let mut script = Script::fast();
    let save = rtu::write(1, FLAG_SAVE_USER_PROGRAM, SAVE_PROGRAM);
    script.hear(START, &save);
    let again = START + 300 * MS;
    script.hear(again, &save);
    let end = again + 300 * MS;
    let run = play(&script, end);
    let programmed = |from, to| {
        let within = run.did.iter().filter(|(at, _)| (from..to).contains(at));
        within.filter(|(_, did)| matches!(did, OutputRecord::Programmed(..))).count()
    };
    let (first, second) = (programmed(START, again), programmed(again, end));
    println!("pages programmed: {first}, then {second}");
    assert!(first > 16, "4 KiB are 16 pages");
    assert!((1..=6).contains(&second), "a sum that is wrong, and the right one");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn power_that_fails_while_a_program_is_stored_leaves_the_old_the_new_or_a_bad_one() {
    const LAST: u16 = LINES - 1;
    let saves = |script: &mut Script, mut at, command| {
        for place in [0, 512, LAST] {
            at = ask(script, at, &[line(place, command, 0)]);
        }
        script.hear(at, &rtu::write(1, FLAG_SAVE_USER_PROGRAM, SAVE_PROGRAM));
        at + 400 * MS
    };
    let whole = |cut: Option<u64>| {
        let mut script = Script::fast();
        let begun = saves(&mut script, START, 0x01);
        if let Some(cut) = cut {
            script.at(begun, format_args!("cut {cut}"));
        }
        let done = saves(&mut script, begun, 0x02);
        let back = restart(&mut script, done);
        let [first, _, next] = look(&mut script, back, 0);
        let [last, error, end] = look(&mut script, next, LAST);
        let run = play(&script, end);
        let programmed = run
            .did
            .iter()
            .filter(|(at, did)| (begun..done).contains(at) && matches!(did, OutputRecord::Programmed(..)));
        let bytes = 256 * programmed.count() as u64;
        // ERROR bit 7: the program in flash is bad (6.5).
        let is_bad = words(&run, error) == [1 << 7];
        assert!(is_bad || words(&run, error) == [0]);
        (bytes, (!is_bad).then(|| [words(&run, first)[0], words(&run, last)[0]]))
    };
    let (all, new) = whole(None);
    assert_eq!(new, Some([2, 2]));
    let mut found = Vec::new();
    for cut in (0..=all).step_by(usize::try_from(all / 16).expect("a few bytes").max(1)) {
        found.push((cut, whole(Some(cut)).1));
    }
    found.dedup_by_key(|(_, program)| *program);
    println!("a save programs {all} bytes; the program by the byte at which the power failed: {found:?}");
    assert!(found.iter().map(|(_, program)| *program).eq([Some([1, 1]), None, Some([2, 2])]));
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn every_request_is_received_while_a_program_runs() {
    const REQUESTS: u64 = 200;
    /// t3.5, 8 characters, a reply of 27 characters and the wait before it, and some reserve.
    const PACE: Nanos = 7 * MS;
    let mut script = Script::fast();
    // ADD AX, 1; ADD BX, SPEED; MOV 7002h, AX; JMP 0 (6.9).
    let program = [line(0, 0x0019, 1), line(1, 0x3121, SPEED), line(2, 0x3002, 0x7002), line(3, 0x0005, 0)];
    let save = ask(&mut script, START, &program);
    script.hear(save, &rtu::write(1, FLAG_SAVE_USER_PROGRAM, SAVE_PROGRAM));
    let begin = ask(&mut script, save + 200 * MS, &[rtu::write(1, 0x5005, 2).to_vec()]);
    let asked: Vec<Nanos> = (0..REQUESTS).map(|n| begin + n * PACE).collect();
    for at in &asked {
        script.hear(*at, &rtu::read(1, AX, 11));
    }
    let run = play(&script, begin + REQUESTS * PACE);
    let mut counts = Vec::new();
    for at in asked {
        let (_, reply) = run.sent(at, at + PACE);
        let pdu = rtu::verify_crc(&reply).unwrap_or_else(|| panic!("{reply:02x?} at {at} ns"));
        assert_eq!((pdu[..3].to_vec(), pdu.len()), (vec![1, 3, 22], 25));
        counts.push(u16::from_be_bytes([pdu[3], pdu[4]]));
    }
    // A round of four lines takes 400 µs, so 17.5 rounds take 7 ms.
    for pair in counts.windows(2) {
        let rounds = pair[1].wrapping_sub(pair[0]);
        assert!((17..=18).contains(&rounds), "{rounds} rounds in 7 ms");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn every_request_is_received_while_the_motor_turns_and_its_edges_show_at_the_pins() {
    const REQUESTS: u64 = 60;
    /// Time for a request of 8 characters, a reply of 75 characters, and silences.
    const PACE: Nanos = 13 * MS;
    let mut script = Script::fast();
    let coil =
        |coil: u16| rtu::frame(1, &[5, coil.to_be_bytes()[0], coil.to_be_bytes()[1], 0xFF, 0]).to_vec();
    let begin = ask(&mut script, START, &[rtu::write(1, SPEED, 2_800).to_vec(), coil(0x2000)]);
    let asked: Vec<Nanos> = (0..REQUESTS).map(|n| begin + n * PACE).collect();
    for at in &asked {
        script.hear(*at, &rtu::read(1, 0x5000, 35));
    }
    // Reads STATUS, CURRENT_VALID, SPEED_VALID, and CURRENT_POSITION of two words.
    let state = rtu::frame(1, &[4, 0x30, 0, 0, 5]).to_vec();
    let turning = ask(&mut script, begin + REQUESTS * PACE, &[state.clone(), coil(0x2001)]);
    let stood = turning + 1_000 * MS;
    let end = ask(&mut script, stood, &[state]);
    let run = play(&script, end);
    for at in asked {
        let (_, reply) = run.sent(at, at + PACE);
        assert!(reply.len() == 75 && rtu::verify_crc(&reply).is_some(), "{reply:02x?} at {at} ns");
    }
    let state = |at| {
        let (_, reply) = run.sent(at, at + TURN);
        let pdu = rtu::verify_crc(&reply).unwrap_or_else(|| panic!("{reply:02x?} at {at} ns")).to_vec();
        let word = |n: usize| u32::from(u16::from_be_bytes([pdu[3 + 2 * n], pdu[4 + 2 * n]]));
        (word(0), word(2), word(3) | word(4) << 16)
    };
    let (status, speed, _) = state(turning - 2 * TURN);
    assert!(status == 1 && speed.abs_diff(2_800) < 56, "status {status}, {speed} rpm");
    let (status, speed, position) = state(stood);
    assert_eq!((status, speed), (0, 0));
    // HA and HB: both edges of both signals are counted (6.3).
    let edges = [9, 10].map(|pin| {
        let edges = [Drive::Low, Drive::High].map(|drive| run.edges(pin, drive));
        edges.iter().flatten().filter(|at| **at > begin - TURN).count()
    });
    assert!(position > 500, "{position} counts");
    assert_eq!(edges[0] + edges[1], position as usize);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn ascii_has_seven_bits_and_their_parity() {
    // ":", address, function, first register, quantity, LRC, CR LF (modbus-serial, 2.5.2).
    let ascii = |bytes: &[u8]| {
        let mut text = String::from(":");
        let lrc = bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_sub(*byte));
        for byte in bytes.iter().chain([&lrc]) {
            let _ = write!(text, "{byte:02X}");
        }
        text + "\r\n"
    };
    let mut script = Script::fast();
    // Sets ASCII 7E1 at 9,600 baud (6.4), and saves it.
    let settings = [(0x5001, 1), (0x5002, 4), (FLAG_SAVE_INI, SAVE_INI)]
        .map(|(register, value)| rtu::write(1, register, value).to_vec());
    let saved = ask(&mut script, START, &settings) + 200 * MS;
    let restarted = ask(&mut script, saved, &[rtu::write(1, FLAG_RESTART, 0x95AF).to_vec()]) + 1_000 * MS;
    const LONG: Nanos = 200 * MS;
    // Reads HW_MAJOR; reads it after a character with wrong parity; reads ERROR.
    let question = ascii(&[1, 4, 0x80, 0x01, 0, 1]);
    script.hear(restarted, question.as_bytes());
    let spoiled = restarted + LONG;
    script.at(spoiled, "spoiled parity 3a");
    let error = spoiled + LONG;
    script.hear(error, ascii(&[1, 3, 0x50, 0x23, 0, 1]).as_bytes());
    let end = error + LONG;
    let run = play(&script, end);
    let said = |from, to| String::from_utf8(run.sent(from, to).1).expect("it says ASCII");
    assert_eq!(said(restarted, spoiled), ascii(&[1, 4, 2, 0x03, 0xE9]));
    assert_eq!(said(spoiled, error), "");
    // Bit 14: "RS-485 transmitting parity error" (6.5).
    assert_eq!(said(error, end), ascii(&[1, 3, 2, 0x40, 0x00]));
    // A character has ten bits at 9,600 baud.
    let times = run.times_sent(restarted, spoiled);
    let character = (times[14] - times[0]) / 14;
    assert!(character.abs_diff(10_000_000_000 / 9_600) < 2_000, "{character} ns");
}
