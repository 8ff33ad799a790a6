//! Drives that are elsewhere: a board reports what its drive receives and does, and the bench records it. All recordings,
//! pictures and files of a bench then show such a drive, too. The bench never calls it.

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Framing, Input, Instant, Port, PresetError, Spec,
};
use drivetwin_firmware::motor::Parameters;

use super::{AddError, Bench, DriveId, Outlet, Setup};
use crate::record::capture::{Frame, Medium, Source};
use crate::record::trace::{Event, InputRecord, OutputRecord};

/// Place of a drive that is elsewhere.
struct Elsewhere(Box<dyn Device>);

impl Device for Elsewhere {
    fn spec(&self) -> &'static Spec {
        self.0.spec()
    }

    fn power_on(&mut self, _at: Instant, _boot: Boot, _out: &mut dyn Context) {}

    fn input(&mut self, _at: Instant, _input: Input<'_>, _out: &mut dyn Context) {}

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Context) {}

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(
        &mut self,
        _at: Instant,
        _row: usize,
        _value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        Err(PresetError::ReadOnly)
    }

    fn internal_motor(&self) -> Option<Parameters> {
        self.0.internal_motor()
    }
}

/// Greatest number of characters of a frame that are one line of the trace.
const LONGEST: usize = 1 << 10;

/// Reported characters of a drive that may not be all of their message.
#[derive(Default)]
pub(super) struct Reported {
    /// A frame of Modbus that is one line of the trace.
    held: Option<Held>,
    /// Frames of other ports that are not in the capture yet.
    frames: Vec<Partial>,
}

/// A frame, as far as it is reported, and the events since its first character. The clock of the bench stands until the
/// frame is over, so that recordings have all in the order of time.
struct Held {
    frame: Partial,
    /// End of the first character.
    at: Instant,
    since: Vec<(Instant, Event)>,
}

/// A frame to a port, as far as it is reported.
struct Partial {
    port: Port,
    begin: Instant,
    end: Instant,
    bytes: Vec<u8>,
}

/// Drives that are elsewhere.
impl Bench {
    /// An empty bench with the settings of this one. Its time, and the numbers of its events and frames, go on where
    /// those of this bench end.
    #[must_use]
    pub fn next_bench(&self) -> Self {
        let mut next = Self::with(self.settings);
        next.now = self.now;
        next.trace.end = self.now;
        next.trace.lost = self.trace.mark();
        next.trace.generation = self.trace.generation + 1;
        next.capture.begin_at(self.capture.seen());
        next
    }

    /// Adds a drive that is elsewhere, in the place of which `device` describes its kind.
    ///
    /// ```
    /// use drivetwin_firmware::device::{Duration, Instant, Pin};
    /// use drivetwin_sim::bench::Bench;
    /// use drivetwin_sim::catalog;
    /// use drivetwin_sim::record::trace::{Event, InputRecord};
    ///
    /// let mut bench = Bench::new();
    /// let x = bench.add_elsewhere("x", catalog::make("md3")?)?;
    /// let at = Instant::ZERO + Duration::secs(3);
    /// bench.report(x, at, Event::Input(InputRecord::Edge { pin: Pin(0), high: false }));
    /// assert_eq!(bench.now(), at);
    /// assert!(bench.trace().to_text().contains("3000.000000 > pin J2.2 low"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// The name is not valid or taken.
    pub fn add_elsewhere(&mut self, name: &str, device: Box<dyn Device>) -> Result<DriveId, AddError> {
        let drive = self.add_with(name, Box::new(Elsewhere(device)), Setup::default())?;
        self.reported.insert(drive, Reported::default());
        Ok(drive)
    }

    /// Returns true if a drive is elsewhere.
    #[must_use]
    pub fn is_elsewhere(&self, drive: DriveId) -> bool {
        self.reported.contains_key(&drive)
    }

    /// Records an event of a drive that is elsewhere. The clock moves to `at`, except for a reply and for settings of a
    /// line, which may begin later than the events behind them. An event from before the present time has the present
    /// time. The characters of a frame of Modbus are one event, which is recorded when the frame is over.
    pub fn report(&mut self, drive: DriveId, at: Instant, event: Event) {
        let at = at.max(self.now);
        if !self.is_elsewhere(drive) {
            return;
        }
        if self.ends_frame(drive, at, &event) {
            self.record_held(drive);
        }
        let begins = self.begins_frame(drive, at, &event);
        let Some(reported) = self.reported.get_mut(&drive) else { return };
        match (&mut reported.held, event) {
            (Some(Held { frame, .. }), Event::Input(InputRecord::Bytes { port, bytes }))
                if frame.port == port =>
            {
                frame.bytes.extend(bytes);
                frame.end = at;
            }
            (Some(held), event) => held.since.push((at, event)),
            (None, event) => match begins {
                Some(frame) => {
                    reported.held = Some(Held { frame, at, since: Vec::new() });
                    self.run_until(at);
                }
                None => self.record_event(drive, at, event),
            },
        }
    }

    /// Moves the clock to `at`, if that is later, because a drive that is elsewhere has reported everything until then.
    pub fn report_time(&mut self, at: Instant) {
        let drives: Vec<DriveId> = self.reported.keys().copied().collect();
        for &drive in &drives {
            if self.is_frame_over(drive, at) {
                self.record_held(drive);
            }
            let over: Vec<Port> = self.reported.get(&drive).map_or_else(Vec::new, |reported| {
                let is_over = |frame: &&Partial| at > frame.end + self.character(drive, frame.port) * 4;
                reported.frames.iter().filter(is_over).map(|frame| frame.port).collect()
            });
            self.capture_received(drive, |frame| over.contains(&frame.port));
        }
        if self.reported.values().all(|reported| reported.held.is_none()) {
            self.run_until(at.max(self.now));
        }
    }

    /// The first character of a frame of Modbus; `None` for any other event.
    fn begins_frame(&self, drive: DriveId, at: Instant, event: &Event) -> Option<Partial> {
        let Event::Input(InputRecord::Bytes { port, bytes }) = event else { return None };
        let framing = self.spec(drive).ports.get(usize::from(port.0))?.framing;
        let begin = Instant::ZERO + at.since(Instant::ZERO + self.character(drive, *port));
        let frame = Partial { port: *port, begin, end: at, bytes: bytes.clone() };
        (framing == Framing::Silence).then_some(frame)
    }

    /// Returns true if the frame that a drive receives is over at `at`, whatever follows.
    fn is_frame_over(&self, drive: DriveId, at: Instant) -> bool {
        let held = self.reported.get(&drive).and_then(|reported| reported.held.as_ref());
        held.is_some_and(|Held { frame, .. }| at > frame.end + self.character(drive, frame.port) * 4)
    }

    /// Returns true if an event ends the frame that a drive receives.
    fn ends_frame(&self, drive: DriveId, at: Instant, event: &Event) -> bool {
        let Some(Held { frame, .. }) = self.reported.get(&drive).and_then(|reported| reported.held.as_ref())
        else {
            return false;
        };
        if self.is_frame_over(drive, at) || frame.bytes.len() >= LONGEST {
            return true;
        }
        match event {
            Event::Input(InputRecord::Idle { port } | InputRecord::RxError { port })
            | Event::Output(OutputRecord::Bytes { port, .. }) => *port == frame.port,
            // The silence within which characters belong to one frame of Modbus RTU.
            Event::Input(InputRecord::Bytes { port, .. }) if *port == frame.port => {
                let character = self.character(drive, *port);
                at.since(frame.end + character) * 2 > character * 3
            }
            Event::Input(InputRecord::Power(_)) => true,
            _ => false,
        }
    }

    /// Records the frame that a drive has received, and the events since it began.
    fn record_held(&mut self, drive: DriveId) {
        let held = self.reported.get_mut(&drive).and_then(|reported| reported.held.take());
        let Some(Held { frame, at, since }) = held else { return };
        let Partial { port, begin, end, bytes } = frame;
        let line = InputRecord::Bytes { port, bytes: bytes.clone() };
        self.trace.record_reported(at, drive.0, Event::Input(line));
        self.capture_frame(drive, port, begin, end, Source::Client, bytes);
        for (at, event) in since {
            self.record_event(drive, at.max(self.now), event);
        }
    }

    fn record_event(&mut self, drive: DriveId, at: Instant, event: Event) {
        if !event.is_ahead() {
            self.run_until(at);
        }
        match &event {
            Event::Input(InputRecord::Bytes { port, bytes }) => self.gather(drive, *port, at, bytes),
            Event::Output(OutputRecord::Bytes { port, bytes }) => {
                self.capture_received(drive, |frame| frame.port == *port);
                self.report_sent(drive, *port, at, bytes);
            }
            Event::Output(OutputRecord::Line { port, line }) => {
                self.at_mut(drive).change_line(at, *port, *line);
            }
            _ => {}
        }
        self.trace.record_reported(at, drive.0, event);
    }

    /// Duration of a character on a port.
    fn character(&self, drive: DriveId, port: Port) -> Duration {
        let serial = self.at(drive).serial(port);
        serial.map_or(Duration::ZERO, |serial| serial.line_at(self.now).character())
    }

    /// Adds characters of which the last one ends at `at` to the frame of a port whose characters are single.
    fn gather(&mut self, drive: DriveId, port: Port, at: Instant, bytes: &[u8]) {
        let character = self.character(drive, port);
        let begin = Instant::ZERO + at.since(Instant::ZERO + character);
        self.capture_received(drive, |frame| {
            frame.port == port && (begin.since(frame.end) * 2 > character * 3 || frame.bytes.len() >= LONGEST)
        });
        let Some(reported) = self.reported.get_mut(&drive) else { return };
        match reported.frames.iter_mut().find(|frame| frame.port == port) {
            Some(frame) => {
                frame.bytes.extend_from_slice(bytes);
                frame.end = at;
            }
            None => reported.frames.push(Partial { port, begin, end: at, bytes: bytes.to_vec() }),
        }
    }

    /// Records frames of clients that are over.
    fn capture_received(&mut self, drive: DriveId, is_over: impl Fn(&Partial) -> bool) {
        let Some(reported) = self.reported.get_mut(&drive) else { return };
        let over: Vec<Partial> = reported.frames.extract_if(.., |frame| is_over(frame)).collect();
        for Partial { port, begin, end, bytes } in over {
            self.capture_frame(drive, port, begin, end, Source::Client, bytes);
        }
    }

    /// Records a frame that a drive begins to send at `at`.
    fn report_sent(&mut self, drive: DriveId, port: Port, at: Instant, bytes: &[u8]) {
        let Some(serial) = self.at_mut(drive).state.serial(port) else { return };
        let (begin, line) = serial.send(at, bytes.len(), false);
        let end = begin + line.character() * bytes.len() as u64;
        self.capture_frame(drive, port, begin, end, Source::Drive(drive), bytes.to_vec());
    }

    fn capture_frame(
        &mut self,
        drive: DriveId,
        port: Port,
        at: Instant,
        end: Instant,
        from: Source,
        bytes: Vec<u8>,
    ) {
        let Outlet::Line(bus) = self.outlet(drive, port) else { return };
        let line = self.line(bus);
        self.capture.record(|| Frame {
            at,
            lasts: end.since(at),
            on: Medium::Line(bus),
            from,
            line: Some(line),
            bytes,
            collided: false,
            received: Vec::new(),
        });
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::{Level, Pin};
    use drivetwin_protocol::time::Span as _;

    use super::*;
    use crate::bench::Settings;
    use crate::catalog;
    use crate::export::pcapng;
    use crate::record::trace::{Power, Retention};

    fn bench() -> (Bench, DriveId) {
        let all = Retention::All;
        let mut bench = Bench::with(Settings { trace: all, capture: all, ..Settings::default() });
        let drive = bench.add_elsewhere("board", catalog::make("md3").unwrap()).unwrap();
        (bench, drive)
    }

    /// Reports characters with a character time of 11 bits at 9600 baud between them.
    fn receive(bench: &mut Bench, drive: DriveId, at: Instant, bytes: &[u8]) {
        for (n, byte) in (0..).zip(bytes) {
            let at = at + Duration::from_ticks(18_333) * n;
            let event = InputRecord::Bytes { port: Port(0), bytes: vec![*byte] };
            bench.report(drive, at, Event::Input(event));
        }
    }

    #[test]
    fn the_characters_of_a_frame_are_one_line_and_one_packet() {
        let (mut bench, drive) = bench();
        let read = [1, 3, 0, 0, 0, 1, 0x84, 0x0A];
        receive(&mut bench, drive, Instant::ZERO + 3_000.millis(), &read);
        let reply = OutputRecord::Bytes { port: Port(0), bytes: vec![1, 3, 2, 0, 1, 0x79, 0x84] };
        bench.report(drive, Instant::ZERO + 3_013.millis(), Event::Output(reply));
        receive(&mut bench, drive, Instant::ZERO + 3_100.millis(), &[2, 3]);
        bench.report_time(Instant::ZERO + 4.secs());
        let text = bench.trace().to_text();
        let lines: Vec<&str> = text.lines().skip(3).collect();
        assert_eq!(
            lines,
            [
                "3000.000000 > rx 01 03 00 00 00 01 84 0A",
                "3013.000000 < tx 01 03 02 00 01 79 84",
                "3100.000000 > rx 02 03",
                "4000.000000 end"
            ]
        );
        let frames: Vec<usize> = bench.capture().since(0).map(|frame| frame.bytes.len()).collect();
        assert_eq!(frames, [8, 7, 2]);
        let mut file = Vec::new();
        pcapng::write(&bench, &mut file).unwrap();
        let text = String::from_utf8_lossy(&file);
        assert!(text.contains("read ") && text.contains("rs485"), "{text}");
    }

    #[test]
    fn an_event_within_a_frame_comes_after_its_line() {
        let (mut bench, drive) = bench();
        receive(&mut bench, drive, Instant::ZERO + 10.millis(), &[1, 3]);
        let level = OutputRecord::Level { pin: Pin(3), level: Level::Low };
        bench.report(drive, Instant::ZERO + 12.millis(), Event::Output(level));
        receive(&mut bench, drive, Instant::ZERO + 12_292.micros(), &[0]);
        bench.report_time(Instant::ZERO + 1.secs());
        let text = bench.trace().to_text();
        let words: Vec<&str> =
            text.lines().skip(3).filter_map(|line| line.split_once(' ')).map(|it| it.1).collect();
        // The line of a frame has the time of its first character.
        assert_eq!(words, ["> rx 01 03 00", "< pin J2.5 low", "end"]);
        assert_eq!(bench.capture().since(0).count(), 1);
    }

    #[test]
    fn what_is_missing_is_a_comment_and_pulses_from_before_it_are_unknown() {
        let (mut bench, drive) = bench();
        let on = || Event::Input(InputRecord::Power(Power::On));
        bench.report(drive, Instant::ZERO + 1.secs(), on());
        assert!(bench.pulses_since_power_on(drive.step()).is_some());
        bench.report(drive, Instant::ZERO + 2.secs(), Event::Missing { events: Some(12) });
        assert!(bench.pulses_since_power_on(drive.step()).is_none());
        bench.report(drive, Instant::ZERO + 3.secs(), on());
        assert!(bench.pulses_since_power_on(drive.step()).is_some());
        let text = bench.trace().to_text();
        assert!(text.contains("\n# 2000.000000: 12 events are missing here\n"), "{text}");
        let again = crate::record::trace::Trace::parse(&text, &|kind| catalog::make(kind).ok()).unwrap();
        assert_eq!(again.events().len(), 2);
    }

    #[test]
    fn numbers_and_time_go_on_in_the_next_bench() {
        let (mut bench, drive) = bench();
        receive(&mut bench, drive, Instant::ZERO + 1.secs(), &[1, 3]);
        bench.report_time(Instant::ZERO + 2.secs());
        let next = bench.next_bench();
        assert_eq!((next.now(), next.trace().mark()), (bench.now(), bench.trace().mark()));
        assert_eq!((next.capture().seen(), next.drives().len()), (1, 0));
    }
}
