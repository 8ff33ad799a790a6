//! Calls drives late, through the library's own loop, with inputs that have waited. A drive must make the
//! same outputs as if it were called at each deadline.

use drivetwin_firmware::device::{Boot, Device, Duration, Input, Instant, advance, feed};
use drivetwin_firmware::testing::Transcript;
use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Power, Trace};
use fastrand::Rng;

use crate::oracle::Failure;

/// Most timeouts of a drive at one instant. More mean that its clock is stuck.
const MOST_TIMEOUTS: u32 = 100_000;

/// A drive without a bench.
struct Alone<'a> {
    device: Box<dyn Device>,
    log: Transcript,
    name: &'a str,
    powered: bool,
    /// Source of the delays, if the drive is called late.
    late: Option<Rng>,
    /// Inputs that the drive has not received yet.
    waiting: Vec<(Instant, Input<'a>)>,
    /// Instant of the last input.
    last: Instant,
}

impl<'a> Alone<'a> {
    /// Passes an input to the drive, or queues it for later.
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

    /// Handles everything that is due before `at`, and with `inclusive` also at `at`.
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

    /// Calls the drive at each deadline before `at`, and with `inclusive` also at `at`.
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

    /// Fails if the deadline of the drive is before `at`, the current time.
    fn look(&self, at: Instant) -> Result<(), Failure> {
        let due = self.device.deadline();
        if due >= at {
            return Ok(());
        }
        Err(Failure::new("deadline in the past", format!("{}: {due:?}, set at {at:?}", self.name)))
    }
}

/// Runs each drive of a trace twice without a bench, punctually and late, and compares the outputs.
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

/// Passes the inputs of a trace to a drive, punctually or `late`, and returns its outputs.
fn play(trace: &Trace, place: usize, late: Option<Rng>) -> Result<Vec<String>, Failure> {
    let drive = &trace.drives[place];
    let device = catalog::make(drive.spec.kind).map_err(|error| Failure::new("no such kind", error))?;
    let log = Transcript::with_memory(drive.memory.to_vec());
    let (powered, waiting, last) = (true, Vec::new(), drive.from);
    let mut alone = Alone { device, log, name: &drive.name, powered, late, waiting, last };
    if drive.external_motor {
        alone.device.detach_motor();
    }
    // Any seed will do, as long as both runs have the same.
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
            // A preset takes effect after all other events of its instant.
            &Event::Input(InputRecord::Poke { row, value }) => {
                alone.come_to(at, true)?;
                let _ = alone.device.poke(at, row, value, &mut alone.log);
                alone.last = at;
            }
            Event::Input(fed) => fed.input().map_or(Ok(()), |input| alone.hear(at, input))?,
            Event::Output(_) | Event::Shaft { .. } | Event::Received(_) | Event::Missing { .. } => {}
        }
    }
    if alone.powered {
        alone.come_to(trace.end, true)?;
    }
    Ok(alone.log.outputs)
}
