//! Drives that are called late: by the library's own loop, with inputs that have waited. What they do is the same as
//! when they are called at each deadline.

use drivetwin_firmware::device::{Boot, Device, Duration, Input, Instant, advance, feed};
use drivetwin_firmware::testing::Transcript;
use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Power, Trace};
use fastrand::Rng;

use crate::oracle::Failure;

/// Timeouts of a drive at one instant.
const MOST_TIMEOUTS: u32 = 100_000;

/// A drive by itself.
struct Alone<'a> {
    device: Box<dyn Device>,
    log: Transcript,
    name: &'a str,
    powered: bool,
    /// Chances of a drive that is called late.
    late: Option<Rng>,
    /// Inputs that the drive gets late.
    waiting: Vec<(Instant, Input<'a>)>,
    /// The last instant at which something came to it.
    last: Instant,
}

impl<'a> Alone<'a> {
    /// Feeds an input, or delays it.
    fn hear(&mut self, at: Instant, input: Input<'a>) -> Result<(), Failure> {
        if let Some(rng) = &mut self.late {
            if at > self.last && rng.u8(..4) == 0 {
                self.come_to(at, false)?;
            }
            self.waiting.push((at, input));
        } else {
            self.come_to(at, false)?;
            self.device.input(at, input, &mut self.log);
            self.look(at)?;
        }
        self.last = at;
        Ok(())
    }

    /// Handles all that is due before `at`, with `inclusive` also at it.
    fn come_to(&mut self, at: Instant, inclusive: bool) -> Result<(), Failure> {
        let device = &mut *self.device;
        if self.late.is_none() {
            return self.wake(at, inclusive);
        }
        if inclusive {
            advance(device, at, self.waiting.drain(..), &mut self.log);
        } else if at > self.last {
            advance(device, at - Duration::TICK, self.waiting.drain(..), &mut self.log);
        } else {
            for (at, input) in self.waiting.drain(..) {
                let due = device.deadline();
                feed(device, due, at, input, &mut self.log);
            }
        }
        Ok(())
    }

    /// Calls it at each deadline before `at`, or at it, too.
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
                let detail = format!("{}: a deadline at {due:?} again and again", self.name);
                return Err(Failure::new("stuck clock", detail));
            }
            self.look(due)?;
        }
    }

    /// Fails if its deadline is before `at`, which is now.
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

/// Feeds a drive the inputs of a trace, punctually or `late`, and returns its outputs.
fn play(trace: &Trace, place: usize, late: Option<Rng>) -> Result<Vec<String>, Failure> {
    let drive = &trace.drives[place];
    let device = catalog::make(drive.spec.kind).map_err(|error| Failure::new("no such kind", error))?;
    let log = Transcript::with_memory(drive.memory.clone());
    let (powered, waiting, last) = (true, Vec::new(), drive.from);
    let mut alone = Alone { device, log, name: &drive.name, powered, late, waiting, last };
    if drive.external_motor {
        alone.device.detach_motor();
    }
    // Any seed will do, as long as both times have the same one.
    let boot = Boot { seed: trace.seed, fast: drive.boot_fast, fast_line: drive.fast_line };
    alone.device.power_on(drive.from, boot, &mut alone.log);
    for entry in trace.events().filter(|entry| entry.drive == place) {
        let at = entry.at;
        match &entry.event {
            Event::Input(InputRecord::Power(Power::On)) if !alone.powered => {
                alone.device.power_on(at, boot, &mut alone.log);
                (alone.powered, alone.last) = (true, at);
            }
            _ if !alone.powered => {}
            Event::Input(InputRecord::Power(Power::Off)) | Event::Output(OutputRecord::PowerOff) => {
                alone.come_to(at, false)?;
                alone.powered = false;
            }
            // It comes behind all else of its instant.
            &Event::Input(InputRecord::Poke { row, value }) => {
                alone.come_to(at, true)?;
                let _ = alone.device.poke(at, row, value, &mut alone.log);
                alone.last = at;
            }
            Event::Input(fed) => fed.input().map_or(Ok(()), |input| alone.hear(at, input))?,
            Event::Output(_) => {}
        }
    }
    if alone.powered {
        alone.come_to(trace.end, true)?;
    }
    Ok(alone.log.outputs)
}
