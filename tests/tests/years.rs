//! Ten years of virtual time on every kind of drive: it answers each month, its timers keep their lengths, and its
//! counters and positions pass every wrap. The expected values are computed by hand from the manuals. The positions of
//! an RS drive and an MDROBOT cannot be preset, so their ends are tested beside their counters.
#![allow(missing_docs, reason = "a test")]

use std::io::{Read as _, Write as _};

use drivetwin::sim::record::trace::Retention;
use drivetwin::{Bench, Drive, Duration, Instant, Level, PowerAction, Settings, Span as _, kinds, rtu, tcp};

/// A month, and ten years of 365.25 days.
const MONTH: Duration = Duration::secs(2_629_800);
const MONTHS: u64 = 120;
const TEN_YEARS: Duration = Duration::secs(315_576_000);

/// A bench that keeps a little of its recordings, with a drive that has started.
fn started(kind: &str) -> (Bench, Drive) {
    let recordings = Retention::Ring(1 << 16);
    let bench = Bench::with(Settings { trace: recordings, capture: recordings, ..Settings::default() });
    let drive = bench.add(kind, "x").unwrap();
    bench.advance(10.secs());
    (bench, drive)
}

/// A drive that has been on for ten years.
fn old(kind: &str) -> (Bench, Drive) {
    let (bench, drive) = started(kind);
    bench.run_until(TEN_YEARS);
    (bench, drive)
}

/// A request to a drive, and its reply.
fn exchange(kind: &str) -> (Vec<u8>, Vec<u8>) {
    let write =
        |register, value| (rtu::write(1, register, value).to_vec(), rtu::write(1, register, value).to_vec());
    match kind {
        // UserRegister (MD3 7.23).
        "md3" | "md3-low" => write(0x1D, 0x1234),
        // The low word of TARGET_POSITION1 (RS 6.5).
        "rs434544" | "rs434546" => write(0x501B, 0x1234),
        // TQ_RATIO.
        "mdrobot" => write(66, 0x34),
        // VM is 768,000 = 0xBB800 from the factory, high word first (MC 5, FB 5).
        "mdrive" | "mdrive-hybrid" => {
            let request = tcp::read(tcp::Header { transaction: 7, unit: 1 }, 0x8B, 2);
            (request.to_vec(), vec![0, 7, 0, 0, 0, 7, 1, 3, 4, 0x00, 0x0B, 0xB8, 0x00])
        }
        // READ ENCODER.
        _ => (b"R0E\r".to_vec(), b"r 0E 00000000 !\r\n".to_vec()),
    }
}

/// Sends a request, and compares the reply.
#[track_caller]
fn ask(drive: &Drive, request: &[u8], reply: &[u8]) {
    assert_eq!(drive.ask(request).escape_ascii().to_string(), reply.escape_ascii().to_string(), "{drive:?}");
}

#[test]
fn each_kind_answers_each_month_in_the_same_time() {
    for kind in kinds::ALL {
        let (bench, drive) = started(kind);
        let (request, reply) = exchange(kind);
        let mut first = None;
        for month in 1..=MONTHS {
            let begin = Instant::ZERO + MONTH * month;
            bench.run_until(begin);
            ask(&drive, &request, &reply);
            let span = bench.now().since(begin);
            assert_eq!(*first.get_or_insert(span), span, "{kind} in month {month}");
        }
        // 8 characters of 11 bits at 9600 baud each way, and 3.5 to 4.5 of silence.
        if kind == "md3" {
            let character = Duration::of_bits(11, 9_600);
            let span = first.unwrap();
            assert!(span >= character * 19 && span <= character * 21, "{span}");
        }
        // The stamp of the last output, in milliseconds: the last reply took less than a second.
        let trace = bench.trace();
        let last = trace.lines().rev().find(|line| line.contains(" < ")).unwrap();
        let stamp: f64 = last.split(' ').next().unwrap().parse().unwrap();
        assert!((315_576_000_000.0..315_576_001_000.0).contains(&stamp), "{kind}: {last}");
    }
}

#[test]
fn an_md3_jogs_for_ten_years() {
    for kind in ["md3", "md3-low"] {
        let (bench, drive) = started(kind);
        drive.set("Speed", 40_000).unwrap();
        drive.set("MotionControl", 0x02).unwrap();
        bench.advance(TEN_YEARS);
        // 40,000 steps per second, without the 80,000 that the ramp of 10,000 steps/s² lacks in its 4 s:
        // 12,623,039,920,000 steps, which is 2,939 times 2³² and 131,037,056.
        assert_eq!(drive.motion().position, 131_037_056, "{kind}");
        // Decel-stop: 80,000 steps in 4 s.
        drive.set("MotionControl", 0x10).unwrap();
        bench.advance(4_001.millis());
        assert_eq!((drive.motion().position, drive.motion().moving), (131_117_056, false), "{kind}");
        // A move of 10,000 steps at 5,000 steps/s takes 2 s, and half of each of its ramps of 0.5 s.
        drive.set("Speed", 5_000).unwrap();
        drive.set("MotionControl", 0x01).unwrap();
        bench.advance(2_499.millis());
        assert!(drive.motion().moving, "{kind}");
        bench.advance(2.millis());
        assert_eq!((drive.motion().position, drive.motion().moving), (131_127_056, false), "{kind}");
    }
}

/// The shaft of a motor turns with the drive, and a switch on it stays closed, also where the reported turns wrap.
#[test]
fn a_motor_turns_for_ten_years() {
    let bench = Bench::from_toml(
        "
        [[drive]]
        name = 'x'
        kind = 'md3'
        fast_boot = true
        set = { Speed = 40_000 }
        [[motor]]
        name = 'm'
        drive = 'x'
        [[switch]]
        motor = 'm'
        closed = { above_rev = 2.5 }
        to = 'x.J2.2'
        ",
    )
    .unwrap();
    let drive = bench.drive("x").unwrap();
    drive.set("MotionControl", 0x02).unwrap();
    bench.advance(TEN_YEARS);
    // 12,623,039,920,000 steps of which a turn has 1,600 are 7,889,399,950 turns, of which 2 · 2³² leaves −700,534,642.
    let sim = bench.sim();
    let turned = sim.turn(sim.motors().next().unwrap());
    assert!((turned.revolutions + 700_534_642.0).abs() < 0.001, "{turned:?}");
    assert_eq!((turned.rpm, turned.stalled), (1_500.0, false));
    drop(sim);
    assert_eq!(drive.pin("J2.2").unwrap(), Level::Low);
}

#[test]
fn an_mdrive_slews_for_ten_years() {
    for kind in ["mdrive", "mdrive-hybrid"] {
        let (bench, drive) = started(kind);
        drive.set("P", 0).unwrap();
        drive.set("SL", 700_000).unwrap();
        bench.advance(TEN_YEARS);
        // 700,000 steps per second, without the 244,300.5 that the ramp from VI 1,000 with A 1,000,000 lacks:
        // 220,903,199,755,699.5 steps, which is 51,433 times 2³² and 146,820,531.5.
        assert_eq!(["P", "C1"].map(|register| drive.get(register).unwrap()), [146_820_531; 2], "{kind}");
        drive.set("SL", 0).unwrap();
        bench.advance(2.secs());
        // Up from 1,000 to 100,005 steps/s and down again is 10,000 steps in 198 ms. A command takes 5 ms at most
        // (MDRIVE-34).
        let before = drive.get("P").unwrap();
        drive.set("MR", 10_000).unwrap();
        bench.advance(197.millis());
        assert!(drive.get("P").unwrap() < before + 10_000, "{kind}");
        bench.advance(6.millis());
        assert_eq!(drive.get("P").unwrap(), before + 10_000, "{kind}");
    }
}

#[test]
fn an_old_md3_starts_and_counts() {
    for kind in ["md3", "md3-low"] {
        let (bench, drive) = old(kind);
        // The start-up takes 2.5 s (4).
        drive.power(PowerAction::Cycle);
        let (request, reply) = exchange(kind);
        bench.advance(2_400.millis());
        ask(&drive, &request, b"");
        bench.advance(100.millis());
        ask(&drive, &request, &reply);
        // Four counts a cycle, reset by the index only: 0 follows 0xFFFF (7.11, 7.14).
        drive.set("QuadratureEncoderConfiguration", 2 << 1).unwrap();
        drive.set("QuadratureEncoderCount", 0xFFFA).unwrap();
        for (edges, count) in [(10, 4), (-10, 0xFFFA)] {
            drive.encoder(edges, 1_000.0).unwrap();
            bench.advance(1.secs());
            assert_eq!(drive.get("QuadratureEncoderCount").unwrap(), count, "{kind}");
        }
    }
}

#[test]
fn an_old_qsb_stamps_counts_and_streams() {
    for kind in ["qsb-d", "qsb-m", "qsb-s"] {
        let (bench, drive) = started(kind);
        ask(&drive, b"W0D1\r", b"w 0D 00000001 !\r\n");
        bench.advance(TEN_YEARS);
        // 512 ticks a second are 161,574,912,000, which is 37 times 2³² and 0x9E9D8000 (QSB-10).
        ask(&drive, b"R0D\r", b"r 0D 9E9D8000 !\r\n");
        // The counter counts on and on, four counts a cycle (MDR0), from 6 before its wrap.
        ask(&drive, b"W0343\r", b"w 03 00000043 !\r\n");
        ask(&drive, b"W08FFFFFFFA\r", b"w 08 FFFFFFFA !\r\n");
        ask(&drive, b"W0A0\r", b"w 0A 00000000 !\r\n");
        for (edges, reply, latch) in [(10, b"r 0E 00000004 !\r\n", 0x80), (-10, b"r 0E FFFFFFFA !\r\n", 0x40)]
        {
            drive.encoder(edges, 10_000.0).unwrap();
            bench.advance(1.secs());
            ask(&drive, b"R0E\r", reply);
            // The latches CY and BW of a carry and a borrow (LS7366R).
            assert_eq!(drive.get("Str").unwrap() & latch, latch, "{kind}");
        }
        // INTERVAL 5 streams a value each 5/512 s.
        ask(&drive, b"W0C5\r", b"w 0C 00000005 !\r\n");
        let mut port = drive.port("usb").unwrap();
        port.write_all(b"S0E\r").unwrap();
        let mut record = [0; 17];
        let stamps = [0; 4].map(|_| {
            port.read_exact(&mut record).unwrap();
            assert_eq!(&record, b"s 0E FFFFFFFA !\r\n", "{kind}");
            bench.now()
        });
        assert_eq!(stamps[3].since(stamps[1]).ticks(), 2 * 5 * 16_000_000 / 512, "{kind}");
    }
}

#[test]
fn an_old_rs_starts_and_turns() {
    for kind in ["rs434544", "rs434546"] {
        let (bench, drive) = old(kind);
        // 1,000 rpm (SPEED) of 16 edges a turn in a minute, less the start.
        drive.set("START_bit", 1).unwrap();
        bench.advance(60.secs());
        let edges = drive.get("CURRENT_POSITION").unwrap();
        assert!((15_980..=16_000).contains(&edges), "{kind}: {edges}");
    }
}

#[test]
fn an_old_mdrobot_ramps() {
    let (bench, drive) = old("mdrobot");
    for (name, value) in [("SLOW_START", 1_023), ("UI_COM", 1), ("START_STOP", 1), ("VEL_CMD", 3_000)] {
        drive.set(name, value).unwrap();
    }
    // SLOW_START 1,023 is 15 s from 0 to MAX_RPM, 3,000 (p. 13).
    bench.advance(7_500.millis());
    let half = drive.get("RPM_DATA").unwrap();
    assert!((1_480..=1_520).contains(&half), "{half}");
    bench.advance(60.secs());
    assert_eq!(drive.get("RPM_DATA").unwrap(), 3_000);
    // 15 s of 1,500 rpm and 52.5 s of 3,000 rpm are 3,000 turns of 12 counts.
    let counts = drive.get("POSI_DATA").unwrap();
    assert!((35_950..=36_000).contains(&counts), "{counts}");
}

#[test]
fn an_old_mdrive_wraps_and_waits() {
    for (kind, error) in [("mdrive", 0), ("mdrive-hybrid", 105)] {
        let (bench, drive) = old(kind);
        for counter in ["C1", "C2"] {
            drive.set(counter, 2_147_483_640).unwrap();
        }
        // A turn is 51,200 steps; the counters have 32 bits with sign.
        drive.set("MR", 51_200).unwrap();
        bench.advance(5.secs());
        assert_eq!(drive.get("P").unwrap(), -2_147_432_456, "{kind}");
        assert!(drive.get("C2").unwrap() < -2_147_400_000, "{kind}");
        // "Maximum position count reached" is an error of a Hybrid (MC 9.7).
        assert_eq!(drive.get("ER").unwrap(), error, "{kind}");
        drive.set("MR", -51_200).unwrap();
        bench.advance(5.secs());
        assert_eq!(["P", "C2"].map(|counter| drive.get(counter).unwrap()), [2_147_483_640; 2], "{kind}");
        // H 1000 holds a program for a second (MC 5).
        let mut port = drive.port("mcode").unwrap();
        port.write_all(b"PG 100\rH 1000\rPR \"x\"\rE\rPG\r").unwrap();
        bench.advance(1.secs());
        let mut bytes = [0; 256];
        let _ = port.read(&mut bytes).unwrap();
        port.set_timeout(2.secs());
        let begin = bench.now();
        port.write_all(b"EX 100\r").unwrap();
        let mut read = Vec::new();
        while !read.contains(&b'x') {
            let count = port.read(&mut bytes).unwrap();
            read.extend_from_slice(&bytes[..count]);
        }
        let span = bench.now().since(begin);
        assert!(span >= 1.secs() && span <= 1_020.millis(), "{kind}: {span}");
    }
}
