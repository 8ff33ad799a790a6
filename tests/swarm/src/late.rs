//! Drives that are called late: by the library's own loop, with inputs that have waited. What they do is the same as
//! when they are called at each deadline.

use fastrand::Rng;
use standin_firmware::device::{Boot, Device, Duration, Input, Instant, Output, Sink, advance, feed};
use standin_sim::kinds;
use standin_sim::trace::{Did, Event, Fed, Power, Trace};

use crate::oracle::Failure;

/// All that a drive puts, as text.
struct Log {
    memory: Vec<u8>,
    lines: Vec<String>,
}

impl Sink for Log {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        if let Output::Store { offset, bytes } = output {
            let place = usize::from(offset);
            self.memory[place..place + bytes.len()].copy_from_slice(bytes);
        }
        self.lines.push(format!("{} {output:?}", at.ticks()));
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// Timeouts of a drive at one instant.
const MOST_TIMEOUTS: u32 = 100_000;

/// A drive, its deadlines watched.
struct Watched {
    device: Box<dyn Device>,
    log: Log,
    name: String,
}

impl Watched {
    /// Wakes it at each deadline before `at`, or at it, too.
    fn wake(&mut self, at: Instant, inclusive: bool) -> Result<(), Failure> {
        let mut again = 0;
        loop {
            let due = self.device.deadline();
            if due == Instant::NEVER || due > at || (due == at && !inclusive) {
                return Ok(());
            }
            self.device.timeout(due, &mut self.log);
            again = if self.device.deadline() > due { 0 } else { again + 1 };
            if again > MOST_TIMEOUTS {
                return Err(Failure::new(
                    "stuck clock",
                    format!("{}: a deadline at {due:?} again and again", self.name),
                ));
            }
            self.look(due)?;
        }
    }

    /// Whether it wants to be woken in the past.
    fn look(&self, at: Instant) -> Result<(), Failure> {
        let due = self.device.deadline();
        if due >= at {
            return Ok(());
        }
        Err(Failure::new("deadline in the past", format!("{}: {due:?}, set at {at:?}", self.name)))
    }
}

/// Plays each drive of a trace by itself, punctually and late.
pub(crate) fn judge(trace: &Trace) -> Result<(), Failure> {
    (0..trace.drives.len()).try_for_each(|place| {
        let punctual = play(trace, place, None)?;
        let late = play(trace, place, Some(Rng::with_seed(trace.seed)))?;
        if punctual == late {
            return Ok(());
        }
        let differ = punctual.iter().zip(&late).find(|(punctual, late)| punctual != late);
        let name = &trace.drives[place].name;
        Err(Failure::new("a late call changes something", format!("{name}: {differ:?}")))
    })
}

/// Feeds a drive what a trace says, punctually, or `late`, and returns what it puts.
fn play(trace: &Trace, place: usize, mut late: Option<Rng>) -> Result<Vec<String>, Failure> {
    let drive = &trace.drives[place];
    let device = kinds::make(drive.spec.kind).map_err(|error| Failure::new("no such kind", error))?;
    let log = Log { memory: drive.memory.clone(), lines: Vec::new() };
    let mut watched = Watched { device, log, name: drive.name.clone() };
    if drive.apart {
        watched.device.part();
    }
    let boot = Boot { seed: trace.seed, fast: drive.boot_fast };
    watched.device.power_on(drive.from, boot, &mut watched.log);
    let mut powered = true;
    let mut waiting: Vec<(Instant, Input<'_>)> = Vec::new();
    for entry in trace.events().filter(|entry| entry.drive == place) {
        let at = entry.at;
        let power = match &entry.event {
            Event::Fed(Fed::Power(Power::On)) => Some(true),
            Event::Fed(Fed::Power(Power::Off)) | Event::Did(Did::PowerOff) => Some(false),
            _ => None,
        };
        let preset = match entry.event {
            Event::Fed(Fed::Poke { row, value }) => Some((row, value)),
            _ => None,
        };
        let input = match &entry.event {
            Event::Fed(fed) if powered => fed.input(),
            _ => None,
        };
        // What has waited is heard now, or waits on.
        let ends = power.is_some() || preset.is_some();
        if late.as_mut().is_some_and(|rng| powered && (ends || (input.is_some() && rng.u8(..4) == 0))) {
            let last = waiting.last().map_or(drive.from, |(at, _)| *at);
            if preset.is_some() {
                advance(&mut *watched.device, at, waiting.drain(..), &mut watched.log);
            } else if at > last {
                advance(&mut *watched.device, at - Duration::TICK, waiting.drain(..), &mut watched.log);
            } else if ends {
                for (at, input) in waiting.drain(..) {
                    let due = watched.device.deadline();
                    feed(&mut *watched.device, due, at, input, &mut watched.log);
                }
            }
        }
        match (power, preset, input) {
            (Some(true), ..) if !powered => {
                watched.device.power_on(at, boot, &mut watched.log);
                powered = true;
            }
            (Some(false), ..) => {
                if powered && late.is_none() {
                    watched.wake(at, false)?;
                }
                powered = false;
            }
            (_, Some((row, value)), _) if powered => {
                if late.is_none() {
                    watched.wake(at, true)?;
                }
                let _ = watched.device.poke(at, row, value, &mut watched.log);
            }
            (.., Some(input)) => {
                if late.is_some() {
                    waiting.push((at, input));
                } else {
                    watched.wake(at, false)?;
                    watched.device.input(at, input, &mut watched.log);
                    watched.look(at)?;
                }
            }
            _ => {}
        }
    }
    if powered && late.is_some() {
        advance(&mut *watched.device, trace.end, waiting.into_iter(), &mut watched.log);
    } else if powered {
        watched.wake(trace.end, true)?;
    }
    Ok(watched.log.lines)
}
