//! A drive, its registers and pins by name.

use std::fmt;

use drivetwin_firmware::device::{Axis, Encoder, Fault, Level, Pin, PinSpec, Port, Role, Spec};
use drivetwin_protocol::registers::Named;
use drivetwin_sim::bench::{
    DriveId, EarlyRequests, Motion, PinStimulus, PowerAction, Received, RequestStatistics, StartingRequests,
};
use drivetwin_sim::blocking::{BlockingPort, SharedBench};
use drivetwin_sim::config::preset::{self, Preset};
use drivetwin_sim::signals::pulses::Pulse;
use drivetwin_sim::suggest;

use crate::{Error, RegisterName};

/// A drive of a [`Bench`](crate::Bench). Clones are the same drive.
#[derive(Clone)]
pub struct Drive {
    bench: SharedBench,
    id: DriveId,
}

impl fmt::Debug for Drive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bench = self.bench.bench();
        write!(f, "{} ({})", bench.name(self.id), bench.spec(self.id).kind)
    }
}

impl Drive {
    pub(crate) fn new(bench: SharedBench, id: DriveId) -> Self {
        Self { bench, id }
    }

    /// Handle of the drive on [`Bench::sim`](crate::Bench::sim).
    #[must_use]
    pub fn id(&self) -> DriveId {
        self.id
    }

    /// Description of the drive.
    #[must_use]
    pub fn spec(&self) -> &'static Spec {
        self.bench.bench().spec(self.id)
    }

    /// Sends a whole message to the drive's first port, lets the bench run until it is answered, and returns
    /// the answer; empty if there is none.
    #[must_use = "the answer says if the drive has accepted the message"]
    pub fn ask(&self, message: &[u8]) -> Vec<u8> {
        self.bench.bench().ask(self.id, message)
    }

    /// Connects a client to a port of the drive, for instance `rs485`. The line of the port may have other
    /// drives, too.
    ///
    /// # Errors
    /// There is no such port, or it refuses connections now.
    pub fn port(&self, name: &str) -> Result<BlockingPort, Error> {
        let ports = self.spec().ports;
        let number = ports.iter().position(|port| port.name == name);
        let number =
            number.ok_or_else(|| suggest::unknown("port", name, ports.iter().map(|port| port.name)))?;
        let port = self.bench.port(self.id, Port(number as u8));
        port.map_err(|error| Error::from(error.to_string()))
    }

    pub(crate) fn first_serial_port(&self) -> Result<Port, Error> {
        let serial = self.spec().ports.iter().position(|port| port.line.is_some());
        serial
            .map(|number| Port(number as u8))
            .ok_or_else(|| Error::from(format!("{self:?} has no serial port")))
    }

    /// The value of a register, by its name, without the side effects of a read over the bus.
    ///
    /// # Errors
    /// There is no such register.
    pub fn get(&self, register: impl Into<RegisterName>) -> Result<i64, Error> {
        let RegisterName(name) = register.into();
        let row = self.find_row(&name)?;
        Ok(self.bench.bench().peek(self.id, row))
    }

    /// Presets a register by its name, not through the bus.
    ///
    /// # Errors
    /// There is no such register, it does not take the value, or the drive has no power.
    pub fn set(&self, register: impl Into<RegisterName>, value: i64) -> Result<(), Error> {
        let RegisterName(name) = register.into();
        let spec = self.spec();
        let presets = Preset::typed(spec, &name, &value.to_string())?;
        let mut bench = self.bench.bench();
        if !bench.powered(self.id) {
            return Err(Error::from(format!("{} has no power", bench.name(self.id))));
        }
        for preset in presets {
            let value = preset.onto(spec, bench.peek(self.id, preset.row));
            bench
                .poke(self.id, preset.row, value)
                .map_err(|refused| preset::refusal(spec, preset.row, &name, refused))?;
        }
        Ok(())
    }

    fn find_row(&self, name: &str) -> Result<usize, Error> {
        Ok(self.find_register(name)?.row)
    }

    fn find_register(&self, name: &str) -> Result<Named, Error> {
        let spec = self.spec();
        let names = spec.registers.rows.iter().map(|row| row.name);
        Ok(spec.find(name).ok_or_else(|| suggest::unknown("register", name, names))?)
    }

    /// The level at a pin, as measured from outside.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn pin(&self, name: &str) -> Result<Level, Error> {
        let (pin, _) = self.find_pin(name)?;
        Ok(self.bench.bench().level(self.id, pin))
    }

    /// Drives an input pin from outside. The change arrives one tick later.
    ///
    /// # Errors
    /// There is no such pin, it is an output, or it takes only voltages, or none.
    pub fn set_pin(&self, name: &str, stimulus: PinStimulus) -> Result<(), Error> {
        let pin = self.input_for(name, stimulus)?;
        self.bench.bench().set_pin(self.id, pin, stimulus);
        Ok(())
    }

    /// Sends `count` pulses into an input pin, away from its present level and back, `hz` of them a second
    /// (0.5 µHz to 8 MHz).
    ///
    /// # Errors
    /// There is no such pin, it is an output or takes only voltages, or a train or an encoder runs on it.
    pub fn pulse(&self, name: &str, count: u32, hz: f64) -> Result<(), Error> {
        let pin = self.input_for(name, PinStimulus::Low)?;
        let begun = self.bench.bench().pulse(self.id, pin, count, hz);
        begun.map_err(|busy| Error::from(busy.to_string()))
    }

    /// Turns the encoder at the drive's inputs A and B by `counts` edges, `hz` of them a second (1 µHz to
    /// 16 MHz); backwards if `counts` is negative.
    ///
    /// # Errors
    /// The drive has no encoder input, or the encoder turns already.
    pub fn encoder(&self, counts: i32, hz: f64) -> Result<(), Error> {
        if self.spec().encoders.is_empty() {
            return Err(Error::from(format!("{self:?} has no encoder input")));
        }
        let begun = self.bench.bench().encoder(self.id, Encoder(0), counts, hz);
        begun.map_err(|busy| Error::from(busy.to_string()))
    }

    pub(crate) fn find_pin(&self, name: &str) -> Result<(Pin, &'static PinSpec), Error> {
        let spec = self.spec();
        let found = spec.pin(name).and_then(|pin| Some((pin, spec.pins.get(usize::from(pin.0))?)));
        let names = spec.pin_names().map(|(name, _)| name);
        found.ok_or_else(|| Error::from(suggest::unknown("pin", name, names)))
    }

    fn input_for(&self, name: &str, stimulus: PinStimulus) -> Result<Pin, Error> {
        let (pin, PinSpec { role, .. }) = self.find_pin(name)?;
        let what = match (role, stimulus) {
            (Role::Output | Role::Led, _) => "is an output",
            (Role::Analogue, PinStimulus::Low | PinStimulus::High) => "takes a voltage, not a level",
            (Role::Input | Role::Both, PinStimulus::Millivolts(_)) => "takes a level, not a voltage",
            _ => return Ok(pin),
        };
        Err(Error::from(format!("{name} {what}")))
    }

    /// Motion of the drive's first axis.
    #[must_use]
    pub fn motion(&self) -> Motion {
        self.bench.bench().motion(self.id, Axis(0))
    }

    /// All pulses of the STEP output since the drive was added.
    ///
    /// # Errors
    /// The drive has no STEP output, or the bench does not keep its whole trace.
    pub fn pulses(&self) -> Result<Vec<Pulse>, Error> {
        if self.spec().axes.first().is_none_or(|axis| axis.step_dir.is_none()) {
            return Err(Error::from(format!("{self:?} has no STEP output")));
        }
        let bench = self.bench.bench();
        if !bench.trace().is_whole() {
            return Err(Error::from(
                "pulses need the whole trace: give the bench `Retention::All`".to_owned(),
            ));
        }
        Ok(bench.pulses(self.id.step()).collect())
    }

    /// Sets the cause of a fault, for instance `over_temperature`.
    ///
    /// # Errors
    /// The drive has no such fault.
    pub fn fault(&self, name: &str) -> Result<(), Error> {
        self.set_fault(name, true)
    }

    /// Clears the cause of a fault.
    ///
    /// # Errors
    /// The drive has no such fault.
    pub fn clear(&self, name: &str) -> Result<(), Error> {
        self.set_fault(name, false)
    }

    fn set_fault(&self, name: &str, on: bool) -> Result<(), Error> {
        let faults = self.spec().faults;
        let number = faults.iter().position(|known| *known == name);
        let number = number.ok_or_else(|| suggest::unknown("fault", name, faults.iter().copied()))?;
        self.bench.bench().fault(self.id, Fault(number as u8), on);
        Ok(())
    }

    /// Switches the power, or cuts it in the middle of the next save.
    pub fn power(&self, action: PowerAction) {
        self.bench.bench().power(self.id, action);
    }

    /// The latest requests that the drive has received, with what came of each.
    #[must_use]
    pub fn received(&self) -> Received {
        self.bench.bench().received(self.id)
    }

    /// Returns true if the drive executed a write of the register `first` before the first write of `then`; false if
    /// `then` was never written.
    ///
    /// ```
    /// use drivetwin::{Bench, Span as _, md3::Reg, rtu};
    ///
    /// let bench = Bench::new();
    /// let x = bench.add("md3", "x")?;
    /// bench.advance(2_500.millis());
    /// // The program under test.
    /// let _ = x.ask(&rtu::write(1, 0x15, 9_000)); // Speed
    /// let _ = x.ask(&rtu::write(1, 0x11, 1)); // Move
    /// // Was Speed written before Move?
    /// assert!(x.wrote_before(Reg::Speed, Reg::MotionControl)?);
    /// # Ok::<(), drivetwin::Error>(())
    /// ```
    ///
    /// # Errors
    /// There is no such register.
    pub fn wrote_before(
        &self,
        first: impl Into<RegisterName>,
        then: impl Into<RegisterName>,
    ) -> Result<bool, Error> {
        let (first, then) = (self.find_register(&first.into().0)?, self.find_register(&then.into().0)?);
        Ok(self.received().wrote_before(first, then))
    }

    /// Statistics of the requests to all drives on the line of this drive's first port: silence, retries, requests that
    /// were too early. If the first port is a TCP port: retries of the requests at this port.
    #[must_use]
    pub fn request_statistics(&self) -> RequestStatistics {
        let bench = self.bench.bench();
        bench.request_statistics(bench.outlet(self.id, Port(0)))
    }

    /// Requests to the drive that it did not receive because it was starting.
    #[must_use]
    pub fn starting_requests(&self) -> StartingRequests {
        self.bench.bench().starting_requests(self.id)
    }

    /// Requests on the line of the drive's first port that came without a silence of t3.5; see
    /// [`Bench::set_strict`](crate::Bench::set_strict).
    #[must_use]
    pub fn early_requests(&self) -> EarlyRequests {
        let bench = self.bench.bench();
        bench.bus(self.id, Port(0)).map(|bus| bench.early_requests(bus)).unwrap_or_default()
    }
}
