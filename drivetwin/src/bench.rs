//! A bench of drives, by name.

use std::cell::RefMut;
use std::fmt;

use drivetwin_firmware::device::{Duration, Instant, Pin, Role};
use drivetwin_sim::bench::{self, Bus, DriveId, Settings, Setup};
use drivetwin_sim::blocking::{BlockingDelay, SharedBench};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::{DriveLayout, no_line};
use drivetwin_sim::config::preset::Preset;
use drivetwin_sim::line::faults::LineFaults;
use drivetwin_sim::record::trace::Retention;
use drivetwin_sim::{catalog, export, suggest};

use crate::{Drive, Error, RegisterName};

/// A bench of drives on virtual time. Clones are the same bench.
#[derive(Clone)]
pub struct Bench {
    shared: SharedBench,
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for Bench {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Bench at {} with {} drives", self.now(), self.sim().drives().len())
    }
}

/// Settings that keep the whole trace, as tests want it.
fn settings() -> Settings {
    Settings {
        trace: Retention::All,
        capture: Retention::All,
        shafts: true,
        outcomes: true,
        ..Settings::default()
    }
}

impl Bench {
    /// An empty bench with seed 1, whose characters take their time on the lines.
    #[must_use]
    pub fn new() -> Self {
        Self::with(settings())
    }

    /// An empty bench with these settings.
    #[must_use]
    pub fn with(settings: Settings) -> Self {
        Self { shared: SharedBench::new(bench::Bench::with(settings)) }
    }

    /// A bench from the text of a bench file. The addresses in `listen` are checked, and not opened; files of
    /// `nv` and `program` are not read.
    ///
    /// # Errors
    /// The line in the text, and what is wrong there.
    pub fn from_toml(text: &str) -> Result<Self, Error> {
        let layout = bench_file::parse(text).map_err(|error| Error::from(error.to_string()))?;
        layout.check_emulated()?;
        let Settings { trace, capture, shafts, outcomes, .. } = settings();
        let built =
            layout.build(Settings { trace, capture, shafts, outcomes, ..layout.settings() }, Vec::new())?;
        Ok(Self { shared: SharedBench::new(built.bench) })
    }

    /// Adds a drive with factory settings and switches its power on. `kind` is one of
    /// [`kinds::ALL`](crate::kinds::ALL), for instance `md3`.
    ///
    /// # Errors
    /// There is no such kind, or the name is taken or not a word.
    pub fn add(&self, kind: &str, name: &str) -> Result<Drive, Error> {
        self.add_preset::<RegisterName>(kind, name, &[])
    }

    /// Adds a drive without its start-up delay, with registers that are preset as if they had been saved, for
    /// instance its address, and switches its power on.
    ///
    /// ```
    /// use drivetwin::{Bench, md3::Reg, rtu};
    ///
    /// let bench = Bench::new();
    /// let y = bench.add_preset("md3", "y", &[(Reg::DeviceAddress, 2), (Reg::Speed, 9_000)])?;
    /// assert_eq!(y.ask(&rtu::read(2, 0x15, 1))[..5], [2, 3, 2, 0x23, 0x28]);
    /// # Ok::<(), drivetwin::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`add`](Self::add); there is no such register, or it does not take the value.
    pub fn add_preset<R: Into<RegisterName> + Clone>(
        &self,
        kind: &str,
        name: &str,
        registers: &[(R, i64)],
    ) -> Result<Drive, Error> {
        let spec = catalog::make(kind)?.spec();
        let preset = |(register, value): &(R, i64)| {
            let RegisterName(register) = register.clone().into();
            Preset::typed(spec, &register, &value.to_string())
        };
        let presets = registers.iter().map(preset).collect::<Result<Vec<_>, String>>()?.concat();
        let layout = DriveLayout {
            name: name.to_owned(),
            kind: spec.kind,
            listen: Vec::new(),
            nv: None,
            presets,
            program: None,
            fast_boot: !registers.is_empty(),
            faults: Vec::new(),
            board: None,
        };
        let id = layout.add_to(&mut self.sim(), Setup::default())?;
        Ok(Drive::new(self.shared.clone(), id))
    }

    /// The drive of that name.
    ///
    /// # Errors
    /// There is no such drive.
    pub fn drive(&self, name: &str) -> Result<Drive, Error> {
        let sim = self.sim();
        let found = sim
            .find_drive(name)
            .ok_or_else(|| suggest::unknown("drive", name, sim.drives().map(|drive| sim.name(drive))))?;
        Ok(Drive::new(self.shared.clone(), found))
    }

    /// Present bench time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.sim().now()
    }

    /// Lets the bench run for a span of time.
    pub fn advance(&self, span: Duration) {
        let until = self.now() + span;
        self.run_until(until);
    }

    /// Lets the bench run up to and including an instant. Time never goes back.
    pub fn run_until(&self, at: impl Into<Instant>) {
        self.sim().run_until(at);
    }

    /// A delay on bench time, for code that waits through embedded-hal.
    #[must_use]
    pub fn delay(&self) -> BlockingDelay {
        self.shared.delay()
    }

    /// Connects an output pin to an input pin; both as `DRIVE.PIN`, for instance `x.STEP` and `y.J2.4`.
    ///
    /// # Errors
    /// There is no such drive or pin, the first is not an output, or the second is not an input.
    pub fn wire(&self, from: &str, to: &str) -> Result<(), Error> {
        let (from_id, from_pin, role) = self.end(from)?;
        if matches!(role, Role::Input | Role::Analogue | Role::AnalogueOrDigital) {
            return Err(Error::from(format!("{from} is an input; a wire leads from an output to an input")));
        }
        let (to_id, to_pin, role) = self.end(to)?;
        if matches!(role, Role::Output | Role::Led | Role::Analogue) {
            return Err(Error::from(format!(
                "{to} takes no levels; a wire leads from an output to an input"
            )));
        }
        self.sim().wire((from_id, from_pin), (to_id, to_pin));
        Ok(())
    }

    /// One end of a wire.
    fn end(&self, name: &str) -> Result<(DriveId, Pin, Role), Error> {
        let (drive, pin) = name.split_once('.').ok_or_else(|| {
            Error::from(format!("there is no pin '{name}'; write drive and pin, like x.J2.4"))
        })?;
        let drive = self.drive(drive)?;
        let (pin, spec) = drive.find_pin(pin)?;
        Ok((drive.id(), pin, spec.role))
    }

    /// Connects the first serial ports of several drives to one line, under a name of its own.
    ///
    /// # Errors
    /// The name is taken or not a word, or a drive has no serial port.
    pub fn share(&self, name: &str, drives: &[&Drive]) -> Result<(), Error> {
        let mut ports = Vec::new();
        for drive in drives {
            ports.push((drive.id(), drive.first_serial_port()?));
        }
        let mut sim = self.sim();
        if sim.is_taken(name) || name.is_empty() || name.contains(|c: char| c == '.' || c.is_whitespace()) {
            return Err(Error::from(format!(
                "'{name}' is no name for a line: use one new word without dots"
            )));
        }
        sim.share(name, &ports);
        Ok(())
    }

    /// Sets the faults of a line or TCP port from its next frame on: the line of [`share`](Self::share), or
    /// `DRIVE.PORT`, or `PORT` if only one drive has such a port.
    ///
    /// ```
    /// use drivetwin::{Bench, Direction, FaultRule, LineFaults, md3::Reg, rtu};
    ///
    /// let bench = Bench::new();
    /// let x = bench.add_preset("md3", "x", &[(Reg::DeviceAddress, 1)])?;
    /// let lost = FaultRule::next(1).direction(Direction::Reply).register("Speed");
    /// bench.set_faults("rs485", LineFaults { drop: lost, ..LineFaults::NONE })?;
    /// let write = rtu::write(1, 0x15, 9_000); // the low word of Speed
    /// assert!(x.ask(&write).is_empty());
    /// assert_eq!(x.get(Reg::Speed)?, 9_000); // The request was executed.
    /// assert_eq!(x.ask(&write), write[..]);
    /// let words: Vec<String> = x.received().messages().map(|message| message.to_string()).collect();
    /// assert_eq!(words[0], "rs485 <- write SpeedLow = 9000 -> done; by a fault, the reply was dropped");
    /// # Ok::<(), drivetwin::Error>(())
    /// ```
    ///
    /// # Errors
    /// There is no such line or port, it cannot have such a fault, a value is out of range, or a rule names a
    /// drive or a register that is not there.
    pub fn set_faults(&self, bus: &str, faults: LineFaults) -> Result<(), Error> {
        let mut sim = self.sim();
        let outlet = sim.find_outlet(bus).ok_or_else(|| {
            let names: Vec<String> =
                sim.outlets().into_iter().map(|outlet| sim.outlet_name(outlet)).collect();
            suggest::unknown("bus", bus, names.iter().map(String::as_str))
        })?;
        sim.check_faults(outlet, &faults)?;
        sim.set_faults(outlet, faults);
        Ok(())
    }

    /// Sets whether a line drops requests that are too early, as a drive does: without a silence of t3.5.
    ///
    /// # Errors
    /// There is no such line.
    pub fn set_strict(&self, line: &str, strict: bool) -> Result<(), Error> {
        let bus = self.line(line)?;
        self.sim().set_strict(bus, strict);
        Ok(())
    }

    fn line(&self, name: &str) -> Result<Bus, Error> {
        self.sim().find_bus(name).ok_or_else(|| Error::from(no_line(name)))
    }

    /// The recording so far, as text that `drivetwin replay` reads.
    #[must_use]
    pub fn trace(&self) -> String {
        self.sim().trace().to_text()
    }

    /// The waveforms of pins, motion and messages so far (VCD, for GTKWave).
    #[must_use]
    pub fn vcd(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        // A vector takes all bytes.
        let _ = export::vcd::write(self.sim().trace(), &mut bytes);
        bytes
    }

    /// The bench below, for everything else. Release it before another call of this crate.
    ///
    /// # Panics
    /// If another part of the test has not released it.
    #[must_use]
    pub fn sim(&self) -> RefMut<'_, bench::Bench> {
        self.shared.bench()
    }
}
