//! Tests of files that are written while a bench runs. The system may fail at any byte.
#![allow(missing_docs, reason = "a test")]

use std::io::{self, Write};

use drivetwin_firmware::device::Port;
use drivetwin_firmware::md3::Md3;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Bench, Settings};
use drivetwin_sim::catalog;
use drivetwin_sim::export::pcapng::Pcapng;
use drivetwin_sim::export::vcd::Waves;
use drivetwin_sim::record::trace::{Recording, Retention, Trace, whole_lines};
use drivetwin_sim::replay;

/// A file that accepts `takes` bytes, a few at a time, and is interrupted before each write.
struct Failing<'a> {
    content: &'a mut Vec<u8>,
    takes: usize,
    interrupted: bool,
    /// Error of the write after the last accepted byte.
    kind: io::ErrorKind,
}

impl Write for Failing<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.interrupted = !self.interrupted;
        if self.interrupted {
            return Err(io::ErrorKind::Interrupted.into());
        }
        let room = self.takes - self.content.len();
        if room == 0 {
            return Err(self.kind.into());
        }
        let count = bytes.len().min(room).min(7);
        self.content.extend_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An MD3 that moves 100 steps and answers requests meanwhile. Calls `follow` after each part.
fn scene<W>(
    begin: impl FnOnce(&Bench) -> io::Result<W>,
    follow: &mut Follow<'_, W>,
) -> io::Result<(Bench, W)> {
    let settings = Settings { trace: Retention::All, capture: Retention::All, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let md3 = bench.add::<Md3>("md3");
    let client = bench.connect(bench.bus(md3, Port(0)).unwrap());
    let mut writer = begin(&bench)?;
    bench.run_until(bench.now() + 3.secs());
    // MoveSteps is registers 20 and 21, MotionControl is 17 (MD3, 7).
    for request in [rtu::write(1, 20, 0), rtu::write(1, 21, 100), rtu::write(1, 17, 1), rtu::read(1, 0, 4)] {
        bench.send(client, &request);
        bench.run_until_idle();
        follow(&mut writer, &bench)?;
    }
    bench.run_until(bench.now() + 200.millis());
    follow(&mut writer, &bench)?;
    Ok((bench, writer))
}

type Follow<'a, W> = dyn FnMut(&mut W, &Bench) -> io::Result<()> + 'a;

/// Writes a file to its end. Returns `Ok` if nothing failed.
type WriteFile = fn(Failing<'_>) -> io::Result<()>;

fn record(file: Failing<'_>) -> io::Result<()> {
    let begin = |bench: &Bench| Recording::new(bench.trace(), file);
    let (bench, writer) = scene(begin, &mut |writer, bench| writer.follow(bench.trace()))?;
    writer.finish(bench.trace()).map(|_| ())
}

fn waves(file: Failing<'_>) -> io::Result<()> {
    let begin = |bench: &Bench| Waves::new(bench.trace(), file);
    scene(begin, &mut |writer, bench| writer.follow(bench.trace()))?.1.finish()
}

fn frames(file: Failing<'_>) -> io::Result<()> {
    let begin = |bench: &Bench| Pcapng::new(bench, file);
    let (bench, writer) = scene(begin, &mut |writer, bench| writer.follow(bench))?;
    writer.finish(&bench)
}

fn written(write: WriteFile, takes: usize, kind: io::ErrorKind) -> (Vec<u8>, io::Result<()>) {
    let mut content = Vec::new();
    let result = write(Failing { content: &mut content, takes, interrupted: false, kind });
    (content, result)
}

#[test]
fn a_file_on_a_failing_disk_is_the_beginning_of_the_whole_one_and_the_error_is_told() {
    for write in [record as WriteFile, waves, frames] {
        let (whole, result) = written(write, usize::MAX, io::ErrorKind::Other);
        result.expect("short writes and interruptions are no errors");
        assert!(whole.len() > 400, "{} bytes", whole.len());
        let cuts = (0..whole.len()).step_by(whole.len().div_ceil(300));
        for (takes, kind) in cuts.zip([io::ErrorKind::StorageFull, io::ErrorKind::Other].into_iter().cycle())
        {
            let (content, result) = written(write, takes, kind);
            assert_eq!(result.expect_err("it has not all").kind(), kind, "after {takes} bytes");
            assert!(content == whole[..takes], "after {takes} bytes");
        }
    }
}

#[test]
fn a_recording_on_a_failing_disk_replays_as_far_as_it_goes() {
    let make = |kind: &str| catalog::make(kind).ok();
    let (whole, _) = written(record, usize::MAX, io::ErrorKind::Other);
    // Cuts only after the header, because a trace without a drive cannot be replayed.
    let header = whole.windows(4).position(|window| window == b"md3\n").expect("a drive") + 4;
    for takes in header..whole.len() {
        let (content, _) = written(record, takes, io::ErrorKind::StorageFull);
        let text = str::from_utf8(whole_lines(&content).0).expect("text");
        let trace = Trace::parse(text, &make).unwrap_or_else(|error| panic!("{error}: {text}"));
        assert_eq!(replay::run(&trace, &make), Ok(None), "{text}");
    }
}
