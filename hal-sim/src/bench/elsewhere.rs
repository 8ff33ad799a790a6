//! Drives that are elsewhere: a board reports what its drive receives and does, and the bench records it. All recordings,
//! pictures and files of a bench then show such a drive, too. The bench never calls it.

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Framing, Input, Instant, Port, PresetError, Spec,
};
use drivetwin_firmware::motor::Parameters;

use super::{AddError, Bench, DriveId, Outlet, Setup};
use crate::record::capture::{Frame, Medium, Source};
use crate::record::trace::{Event, InputRecord, OutputRecord};

/// Place of a drive that is elsewhere, with a device of its kind; `None` if the kind is not known.
struct Elsewhere(Option<Box<dyn Device>>);

impl Device for Elsewhere {
    fn spec(&self) -> &'static Spec {
        self.0.as_ref().map_or(const { &Spec::EMPTY }, |device| device.spec())
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
        self.0.as_ref()?.internal_motor()
    }
}

/// Greatest number of characters of a frame that are one line of the trace.
const LONGEST: usize = 1 << 10;

/// Bench time between two looks at recordings that wait.
const LOOK: Duration = Duration::millis(10);

/// Longest time that a frame holds recordings back: twice that of the longest frame of Modbus at 9600 baud.
const HELD: Duration = Duration::millis(600);

/// Recordings that wait for reports.
pub(super) struct Waits {
    /// Time after which an event has been reported.
    delay: Duration,
    /// Time until which recordings are complete.
    settled: Instant,
    /// Bench time of the next look.
    next: Instant,
    /// Number of messages that drives had received at the last look, and the time until which there are further looks
    /// because of them.
    received: u64,
    until: Instant,
}

/// Reports of a drive so far.
#[derive(Default)]
pub(super) struct Reported {
    /// Time of the last event, except for outputs that may begin later than the events behind them.
    last: Instant,
    /// A frame of Modbus that is one line of the trace.
    held: Option<Held>,
    /// Frames of other ports that are not in the capture yet.
    frames: Vec<Partial>,
}

impl Reported {
    /// Begin of the first frame that is not recorded yet.
    fn began(&self) -> Option<Instant> {
        let held = self.held.as_ref().map(|held| held.at);
        held.into_iter().chain(self.frames.iter().map(|frame| frame.begin)).min()
    }
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
        self.add_place(name, Elsewhere(Some(device)))
    }

    /// Adds a drive that is elsewhere and of an unknown kind, for a look at the rest of the bench.
    ///
    /// # Errors
    /// The name is not valid or taken.
    pub(crate) fn add_unknown(&mut self, name: &str) -> Result<DriveId, AddError> {
        self.add_place(name, Elsewhere(None))
    }

    fn add_place(&mut self, name: &str, place: Elsewhere) -> Result<DriveId, AddError> {
        let drive = self.add_with(name, Box::new(place), Setup::default())?;
        if let Some(of) = self.trace.drives.get_mut(drive.0 as usize) {
            of.elsewhere = true;
        }
        self.reported.insert(drive, Reported::default());
        Ok(drive)
    }

    /// Returns true if a drive is elsewhere.
    #[must_use]
    pub fn is_elsewhere(&self, drive: DriveId) -> bool {
        self.reported.contains_key(&drive)
    }

    /// Lets recordings wait for reports from now on (BENCH-23), for a bench whose clock goes on by itself: they are complete until
    /// `delay` before the present time, and have the events of all drives in the order of their times. Without this call
    /// the clock follows the reports.
    ///
    /// ```
    /// use drivetwin_firmware::device::{Duration, Instant, Pin};
    /// use drivetwin_firmware::md3::Md3;
    /// use drivetwin_sim::bench::{Bench, PinStimulus};
    /// use drivetwin_sim::catalog;
    /// use drivetwin_sim::record::trace::{Event, InputRecord};
    ///
    /// let mut bench = Bench::new();
    /// let (x, b) = (bench.add::<Md3>("x"), bench.add_elsewhere("b", catalog::make("md3")?)?);
    /// bench.wait_for_reports(Duration::millis(500));
    /// let at = |ms| Instant::ZERO + Duration::millis(ms);
    /// bench.run_until(at(3_000));
    /// bench.set_pin(x, Pin(0), PinStimulus::Low);
    /// bench.run_until(at(3_004));
    /// // The edge at the other drive was 1 ms before, and is known 4 ms later.
    /// bench.report(b, at(2_999), Event::Input(InputRecord::Edge { pin: Pin(0), high: false }));
    /// bench.run_until(at(4_000));
    /// assert_eq!(bench.recorded_until(), at(3_500));
    /// let drives: Vec<usize> = bench.trace().events().map(|entry| entry.drive).collect();
    /// assert!(drives.ends_with(&[1, 0]));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn wait_for_reports(&mut self, delay: Duration) {
        self.waits = Some(Waits { delay, settled: self.now, next: self.now, received: 0, until: self.now });
        self.trace.wait();
    }

    /// Time until which recordings are complete.
    #[must_use]
    pub fn recorded_until(&self) -> Instant {
        self.waits.as_ref().map_or(self.now, |waits| waits.settled)
    }

    /// Bench time at which recordings go on without an event; [`Instant::NEVER`] if none waits.
    #[must_use]
    pub fn records_at(&self) -> Instant {
        match &self.waits {
            Some(waits) if self.trace.is_waiting() || self.now < waits.until => waits.next,
            _ => Instant::NEVER,
        }
    }

    /// Completes recordings until the present time, without waiting for reports.
    pub fn complete_recordings(&mut self) {
        if self.waits.is_some() {
            for drive in self.elsewhere() {
                self.record_held(drive);
                self.capture_received(drive, |_| true);
            }
            self.settle_until(Instant::NEVER);
        }
    }

    /// Looks at recordings that wait, if it is time. A frame that is longer than [`HELD`] is several lines.
    pub(super) fn settle(&mut self) {
        let received = self.received_count();
        let Some(waits) = &mut self.waits else { return };
        if self.now < waits.next {
            return;
        }
        waits.next = self.now + LOOK;
        if std::mem::replace(&mut waits.received, received) != received {
            waits.until = self.now + waits.delay + LOOK;
        }
        let until = Instant::ZERO + self.now.since(Instant::ZERO + waits.delay);
        for drive in self.elsewhere() {
            self.end_frames(drive, until);
            let reported = self.reported.get(&drive);
            if reported.and_then(Reported::began).is_some_and(|began| until.since(began) > HELD) {
                self.record_held(drive);
                self.capture_received(drive, |_| true);
            }
        }
        let began = self.reported.values().filter_map(Reported::began).min();
        self.settle_until(until.min(began.unwrap_or(Instant::NEVER)));
    }

    fn settle_until(&mut self, until: Instant) {
        let Some(waits) = &mut self.waits else { return };
        waits.settled = waits.settled.max(until.min(self.now));
        self.trace.settle(until);
        self.trace.end = waits.settled;
    }

    /// The drives that are elsewhere.
    fn elsewhere(&self) -> Vec<DriveId> {
        self.reported.keys().copied().collect()
    }

    /// Records an event of a drive that is elsewhere. The clock moves to `at`, except for a reply and for settings of a
    /// line, which may begin later than the events behind them; if recordings [wait](Self::wait_for_reports), the clock
    /// does not move. An event from before the time until which recordings are complete has that time. The characters of a
    /// frame of Modbus are one event, which is recorded when the frame is over.
    pub fn report(&mut self, drive: DriveId, at: Instant, event: Event) {
        let recorded = self.recorded_until();
        let Some(reported) = self.reported.get_mut(&drive) else { return };
        let at = at.max(recorded).max(reported.last);
        if !event.is_ahead() {
            reported.last = at;
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
                frame.bytes.extend_from_slice(&bytes);
                frame.end = at;
            }
            (Some(held), event) => held.since.push((at, event)),
            (None, event) => match begins {
                Some(frame) => {
                    reported.held = Some(Held { frame, at, since: Vec::new() });
                    self.follow(at);
                }
                None => self.record_event(drive, at, event),
            },
        }
    }

    /// Moves the clock to `at`, unless it goes on by itself.
    fn follow(&mut self, at: Instant) {
        if self.waits.is_none() {
            self.run_until(at);
        }
    }

    /// Records the frames of a drive that are over at `at`, whatever follows.
    fn end_frames(&mut self, drive: DriveId, at: Instant) {
        if self.is_frame_over(drive, at) {
            self.record_held(drive);
        }
        let over: Vec<Port> = self.reported.get(&drive).map_or_else(Vec::new, |reported| {
            let is_over = |frame: &&Partial| at > frame.end + self.character(drive, frame.port) * 4;
            reported.frames.iter().filter(is_over).map(|frame| frame.port).collect()
        });
        self.capture_received(drive, |frame| over.contains(&frame.port));
    }

    /// Moves the clock to `at`, if that is later, because a drive that is elsewhere has reported everything until then. No
    /// effect if the clock goes on by itself.
    pub fn report_time(&mut self, at: Instant) {
        if self.waits.is_some() {
            return;
        }
        for drive in self.elsewhere() {
            self.end_frames(drive, at);
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
        let frame = Partial { port: *port, begin, end: at, bytes: bytes.to_vec() };
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
        let line = InputRecord::Bytes { port, bytes: bytes.as_slice().into() };
        self.trace.record_reported(at, drive.0, Event::Input(line));
        self.capture_frame(drive, port, begin, end, Source::Client, bytes);
        for (at, event) in since {
            self.record_event(drive, at.max(self.recorded_until()), event);
        }
    }

    fn record_event(&mut self, drive: DriveId, at: Instant, event: Event) {
        if !event.is_ahead() {
            self.follow(at);
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
            let event = InputRecord::Bytes { port: Port(0), bytes: [*byte].into() };
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

    /// A bench with its own clock: an emulated drive `x`, and `a` and `b` that are elsewhere.
    fn rack() -> (Bench, [DriveId; 3]) {
        let all = Retention::All;
        let mut bench = Bench::with(Settings { trace: all, capture: all, ..Settings::default() });
        let x = bench.add_with("x", catalog::make("md3").unwrap(), Setup::default()).unwrap();
        let [a, b] = ["a", "b"].map(|name| bench.add_elsewhere(name, catalog::make("md3").unwrap()).unwrap());
        bench.wait_for_reports(500.millis());
        (bench, [x, a, b])
    }

    /// The lines of the events in the trace, each with the name of its drive.
    fn lines(bench: &Bench) -> Vec<String> {
        let text = bench.trace().to_text();
        text.lines()
            .skip_while(|line| !line.starts_with(|c: char| c.is_ascii_digit()))
            .map(str::to_owned)
            .collect()
    }

    #[test]
    fn missing_events_name_their_drive_if_there_are_several() {
        let (mut bench, [_, a, b]) = rack();
        let at = |ms: u64| Instant::ZERO + ms.millis();
        bench.run_until(at(3_000));
        bench.report(b, at(2_900), Event::Missing { events: Some(1) });
        bench.report(a, at(2_950), Event::Missing { events: None });
        bench.complete_recordings();
        let text = bench.trace().to_text();
        let comments: Vec<&str> = text.lines().filter(|line| line.starts_with("# 2")).collect();
        assert_eq!(
            comments,
            ["# 2900.000000 b: an event is missing here", "# 2950.000000 a: events may be missing here"]
        );
    }

    /// BENCH-23.
    #[test]
    fn events_of_drives_elsewhere_and_here_are_in_the_order_of_their_times() {
        let (mut bench, [x, a, b]) = rack();
        let at = |ms: u64| Instant::ZERO + ms.millis();
        bench.run_until(at(3_000));
        let fed = bench.trace().events().len();
        bench.set_pin(x, Pin(0), crate::bench::PinStimulus::Low);
        bench.run_until(at(3_020));
        let level = |level| Event::Output(OutputRecord::Level { pin: Pin(3), level });
        // Each drive reports in its own order; the drives do not wait for each other.
        bench.report(b, at(3_010), level(Level::Low));
        bench.report(a, at(2_990), level(Level::Low));
        bench.report(a, at(3_015), level(Level::High));
        bench.report(b, at(3_016), level(Level::High));
        assert_eq!(
            (bench.now(), bench.trace().events().len()),
            (at(3_020), fed),
            "they wait, and the clock is not theirs"
        );
        assert!(bench.records_at() <= at(3_030));
        bench.run_until(at(3_512));
        assert_eq!((bench.recorded_until(), bench.trace().end), (at(3_012), at(3_012)));
        let order = |bench: &Bench| -> Vec<usize> {
            bench.trace().events().skip(fed).map(|entry| entry.drive).collect()
        };
        assert_eq!(order(&bench), [1, 0, 2]);
        // Without the drives elsewhere, the recording is replayed.
        let make = |kind: &str| catalog::make(kind).ok();
        let text = bench.trace().to_text();
        assert!(text.contains("\ndrive a md3 elsewhere\n"), "{text}");
        let again = crate::record::trace::Trace::parse(&text, &make).unwrap();
        assert_eq!(again.to_text(), text);
        // What comes too late has the time until which the recording is complete.
        bench.report(b, at(1_000), level(Level::Low));
        bench.complete_recordings();
        assert_eq!(order(&bench), [1, 0, 2, 1, 2, 2]);
        assert_eq!((bench.recorded_until(), bench.records_at()), (at(3_512), Instant::NEVER));
        let last = bench.trace().events().last().unwrap().at;
        assert_eq!(last, at(3_016), "a drive's own events keep their order");
    }

    #[test]
    fn messages_of_drives_here_wait_as_long_as_the_recording() {
        let (mut bench, [x, ..]) = rack();
        let at = |ms: u64| Instant::ZERO + ms.millis();
        bench.run_until(at(3_000));
        bench.ask(x, &drivetwin_protocol::modbus::rtu::read(1, 0, 1));
        let asked = bench.now();
        assert_eq!((bench.received_after(0, 10).last(), bench.recorded_after(0, 10).last()), (1, 0));
        // Nothing else happens, and there are looks until the message is recorded.
        while bench.records_at() < Instant::NEVER {
            let next = bench.records_at();
            bench.run_until(next);
        }
        assert_eq!((bench.recorded_after(0, 10).last(), bench.recorded_after(0, 10).lost()), (1, 0));
        assert!(bench.now().since(asked) <= 550.millis());
    }

    #[test]
    fn a_frame_that_is_not_over_holds_the_recording_back() {
        let (mut bench, [_, a, b]) = rack();
        let at = |ms: u64| Instant::ZERO + ms.millis();
        bench.run_until(at(3_000));
        receive(&mut bench, a, at(2_999), &[1, 3, 0, 0, 0, 1, 0x84, 0x0A]);
        let reply = OutputRecord::Bytes { port: Port(0), bytes: vec![1, 3, 2, 0, 1, 0x79, 0x84] };
        bench.report(b, at(3_001), Event::Output(OutputRecord::Level { pin: Pin(3), level: Level::Low }));
        bench.run_until(at(3_500));
        assert_eq!(bench.recorded_until(), at(2_999));
        bench.report(a, at(3_012), Event::Output(reply));
        bench.run_until(at(4_000));
        let tail = lines(&bench);
        assert_eq!(
            &tail[tail.len() - 4..],
            [
                "2999.000000 a > rx 01 03 00 00 00 01 84 0A",
                "3001.000000 b < pin J2.5 low",
                "3012.000000 a < tx 01 03 02 00 01 79 84",
                "3500.000000 end"
            ]
        );
        let mut file = Vec::new();
        pcapng::write(&bench, &mut file).unwrap();
        assert!(String::from_utf8_lossy(&file).contains("read DeviceAddress"));
    }

    #[test]
    fn a_stream_without_silence_does_not_hold_the_recording_back_for_long() {
        let (mut bench, [_, a, _]) = rack();
        for n in 0..3_000_u64 {
            let at = Instant::ZERO + Duration::from_ticks(18_333) * n;
            bench.run_until(at);
            bench.report(a, at, Event::Input(InputRecord::Bytes { port: Port(0), bytes: [0x55].into() }));
            assert!(bench.now().since(bench.recorded_until()) <= 1_150.millis(), "{n}");
        }
        bench.complete_recordings();
        let bytes = bench.trace().events().map(|entry| match &entry.event {
            Event::Input(InputRecord::Bytes { bytes, .. }) => bytes.len(),
            _ => 0,
        });
        assert_eq!(bytes.sum::<usize>(), 3_000);
    }

    #[test]
    fn a_refused_preset_is_not_recorded_while_events_wait() {
        let (mut bench, [x, ..]) = rack();
        bench.run_until(Instant::ZERO + 3.secs());
        let row = bench.spec(x).find("DeviceAddress").unwrap().row;
        assert!(bench.poke(x, row, 1_000).is_err());
        assert!(bench.poke(x, row, 7).is_ok());
        bench.complete_recordings();
        let pokes = bench
            .trace()
            .events()
            .filter(|entry| matches!(entry.event, Event::Input(InputRecord::Poke { .. })));
        assert_eq!(pokes.count(), 1);
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
