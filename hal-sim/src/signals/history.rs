//! Motion of an axis over time, from the plans, steps and states of motors in a trace.

use drivetwin_firmware::device::{Axis, Duration, Instant};

use crate::record::trace::{Event, InputRecord, OutputRecord, Power, Trace};
use crate::signals::motion::{Commanded, Motion};

/// Motion of an axis in a trace, from the beginning to `until`, in the order of time. `drive` is an index in
/// [`Trace::drives`].
///
/// The samples are at each begin and end of an acceleration and at each command, and between them at each whole multiple
/// of `every` while the axis moves. If the motion jumps, there are two samples at that instant, before and after.
/// The motion of a motor is as it was recorded, at the times of the recording. While the motion is not known, because its
/// beginning is lost, there are no samples.
///
/// `None` if there are more than `most` samples.
#[must_use]
pub fn history(
    trace: &Trace,
    drive: usize,
    axis: Axis,
    until: Instant,
    every: Duration,
    most: usize,
) -> Option<Vec<(Instant, Motion)>> {
    let Some(of) = trace.drives.get(drive) else { return Some(Vec::new()) };
    let mut history = History {
        samples: Vec::new(),
        every,
        most,
        commanded: Commanded::at_rest(of.from),
        is_known: trace.is_whole() && !of.turns_motor,
        is_recorded: false,
        now: of.from,
    };
    history.sample();
    for entry in trace.events().filter(|entry| entry.drive == drive && entry.at <= until) {
        if history.has_too_many() {
            return None;
        }
        let at = entry.at;
        let commanded = match &entry.event {
            Event::Input(InputRecord::Power(Power::On)) => {
                history.move_to(at);
                history.power(at, !of.turns_motor);
                Commanded::at_rest(at)
            }
            Event::Input(InputRecord::Power(Power::Off)) | Event::Output(OutputRecord::PowerOff) => {
                history.move_to(at);
                let mut halted = history.commanded;
                halted.power_off(at);
                history.power(at, history.is_known);
                halted
            }
            Event::Output(OutputRecord::Plan { axis: other, plan }) if *other == axis => {
                history.move_to(at);
                history.is_known |= !of.turns_motor;
                let mut commanded = history.commanded;
                commanded.follow(plan);
                commanded
            }
            Event::Output(OutputRecord::Step { axis: other, steps }) if *other == axis => {
                history.move_to(at);
                let mut commanded = history.commanded;
                commanded.step(*steps);
                commanded
            }
            Event::Shaft { axis: other, shaft } if *other == axis => {
                (history.is_recorded, history.now) = (true, at);
                history.samples.push((at, (*shaft).into()));
                continue;
            }
            _ => continue,
        };
        history.commanded = commanded;
        history.sample();
    }
    history.move_to(until);
    (!history.has_too_many()).then_some(history.samples)
}

struct History {
    samples: Vec<(Instant, Motion)>,
    every: Duration,
    most: usize,
    commanded: Commanded,
    /// True if the commands show the motion.
    is_known: bool,
    /// True if the recorded motion of a motor is that of the axis.
    is_recorded: bool,
    now: Instant,
}

impl History {
    fn has_too_many(&self) -> bool {
        self.samples.len() > self.most
    }

    /// Adds the motion now, if it is known and differs from the last sample.
    fn sample(&mut self) {
        if !self.is_known || self.is_recorded {
            return;
        }
        let sample = (self.now, self.commanded.motion(self.now));
        if self.samples.last() != Some(&sample) {
            self.samples.push(sample);
        }
    }

    /// Adds the samples up to `at`.
    fn move_to(&mut self, at: Instant) {
        while self.is_known && !self.is_recorded && !self.has_too_many() {
            let next = self.commanded.next_sample(self.now, self.every);
            if next > at {
                break;
            }
            self.now = next;
            self.sample();
        }
        self.now = at;
        if self.is_recorded {
            // A motor that stands is not recorded again.
            let last = self.samples.last().filter(|(since, _)| *since < at);
            self.samples.extend(last.map(|&(_, motion)| (at, motion)));
        }
        self.sample();
    }

    fn power(&mut self, at: Instant, is_known: bool) {
        (self.now, self.is_known, self.is_recorded) = (at, is_known, false);
    }
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Axis;
    use drivetwin_protocol::modbus::rtu;
    use drivetwin_protocol::time::Span as _;

    use super::*;
    use crate::bench::{Bench, DriveId, PowerAction, Settings, Setup};
    use crate::catalog;
    use crate::record::trace::Retention;

    const MOST: usize = 10_000;

    fn bench(kind: &str) -> (Bench, DriveId) {
        let settings = Settings { trace: Retention::All, shafts: true, ..Settings::default() };
        let mut bench = Bench::with(settings);
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let drive = bench.add_with("x", catalog::make(kind).unwrap(), setup).unwrap();
        (bench, drive)
    }

    /// A move that is stopped, another one, a power cycle in the middle of it, and a third one.
    fn run(bench: &mut Bench, x: DriveId, seen: &mut dyn FnMut(&mut Bench, Instant)) {
        for (millis, act) in [(100, 1), (700, 2), (1_500, 1), (2_200, 0), (5_000, 1)] {
            seen(bench, Instant::ZERO + Duration::millis(millis));
            match act {
                0 => bench.power(x, PowerAction::Cycle),
                value => drop(bench.ask(x, &rtu::write(1, 0x11, value))),
            }
        }
        seen(bench, Instant::ZERO + 8.secs());
    }

    #[test]
    fn the_history_is_the_motion_at_each_sample() {
        let (mut once, x) = bench("md3");
        run(&mut once, x, &mut |bench, at| bench.run_until(at));
        let history = |most| history(once.trace(), 0, Axis(0), once.now(), Duration::millis(1), most);
        let samples = history(MOST).unwrap();
        assert_eq!(history(samples.len()).as_ref(), Some(&samples));
        assert_eq!(history(samples.len() - 1), None);
        // Three moves of 0.6 to 2.5 s, a sample in each millisecond.
        assert!((3_500..6_500).contains(&samples.len()), "{}", samples.len());
        assert!(samples.iter().zip(&samples[1..]).all(|(a, b)| a.0 <= b.0 && a != b));
        assert_eq!(samples.last().map(|(at, motion)| (*at, motion.position)), Some((once.now(), 10_000)));
        let (mut again, x) = bench("md3");
        let (mut next, mut compared) = (0, 0);
        run(&mut again, x, &mut |bench, until| {
            while let Some(&(at, motion)) = samples.get(next).filter(|(at, _)| *at < until) {
                next += 1;
                // The motion after a jump is that at the instant. An answer of a request may have moved the clock.
                if samples.get(next).is_none_or(|(later, _)| *later > at) && at >= bench.now() {
                    bench.run_until(at);
                    assert_eq!(
                        bench.motion(x, Axis(0)),
                        Motion { current_ma: 0, ..motion }.with(bench, x),
                        "{at:?}"
                    );
                    compared += 1;
                }
            }
            bench.run_until(until);
        });
        assert!(compared > 3_000, "{compared}");
    }

    impl Motion {
        /// With the current and duty of the drive, which a history has not.
        fn with(self, bench: &Bench, drive: DriveId) -> Self {
            let Self { current_ma, duty, .. } = bench.motion(drive, Axis(0));
            Self { current_ma, duty, ..self }
        }
    }

    #[test]
    fn the_history_of_a_motor_is_as_recorded() {
        let (mut bench, x) = bench("rs434544");
        bench.run_until(1.secs());
        for (name, value) in [("MODE_ROTATION", 2), ("OFFSET", 200), ("START_bit", 1)] {
            let row = bench.spec(x).find(name).unwrap().row;
            bench.poke(x, row, value).unwrap();
        }
        bench.run_until(4.secs());
        let samples = history(bench.trace(), 0, Axis(0), bench.now(), Duration::millis(1), MOST).unwrap();
        assert!(samples.len() > 20);
        assert_eq!(samples.last().map(|(at, _)| *at), Some(bench.now()));
        let last = samples.last().unwrap().1;
        assert_eq!(last.position, bench.motion(x, Axis(0)).position);
        assert!(last.position.abs() >= 190 && samples.iter().any(|(_, motion)| motion.speed != 0));
    }

    #[test]
    fn without_its_beginning_a_history_begins_with_the_next_motion() {
        let settings = Settings { trace: Retention::Ring(4_000), ..Settings::default() };
        let mut bench = Bench::with(settings);
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let x = bench.add_with("x", catalog::make("md3").unwrap(), setup).unwrap();
        for _ in 0..200 {
            bench.ask(x, &rtu::read(1, 0x14, 2));
        }
        assert!(!bench.trace().is_whole());
        let samples = |bench: &Bench| {
            history(bench.trace(), 0, Axis(0), bench.now(), Duration::millis(1), MOST).unwrap()
        };
        assert_eq!(samples(&bench), []);
        assert!(bench.pulses_since_power_on(x.step()).is_none());
        let at = bench.now();
        bench.ask(x, &rtu::write(1, 0x11, 1));
        bench.run_until(at + 3.secs());
        assert!(samples(&bench).first().unwrap().0 >= at);
        bench.power(x, PowerAction::Cycle);
        bench.run_until(bench.now() + 1.millis());
        assert_eq!(bench.pulses_since_power_on(x.step()).unwrap().count(), 0);
    }
}
