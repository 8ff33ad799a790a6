//! A drive of a bench.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::Arc;

use drivetwin_firmware::device::{Instant, Port as PortNumber, Spec};
use drivetwin_host::{OnBoard, reasons};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{DriveId, PowerAction};
use drivetwin_sim::{commands, suggest};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};

use crate::errors::{Error, UnknownName, refused, whole, wrong};
use crate::line::{Line, Port};
use crate::named::{Pins, Registers, is_light};
use crate::recording;
use crate::shared::{Bench, Shared, span};
use crate::views::{Motion, Request};

/// A drive on a bench: what a person at it could see and do, and what a master on its line can ask.
#[pyclass(frozen, module = "drivetwin")]
pub(crate) struct Drive {
    pub(crate) shared: Arc<Shared>,
    pub(crate) id: DriveId,
    pub(crate) spec: &'static Spec,
    pub(crate) name: String,
}

impl Drive {
    /// The port with that name, or the first one.
    fn find_port(&self, name: Option<&str>) -> PyResult<PortNumber> {
        name.map_or(Ok(PortNumber(0)), |name| commands::port(self.spec, name).map_err(refused))
    }

    /// Name of the port with that name, or of the first one.
    fn port_name(&self, name: Option<&str>) -> PyResult<&'static str> {
        let PortNumber(number) = self.find_port(name)?;
        Ok(self.spec.ports.get(usize::from(number)).map_or("", |port| port.name))
    }

    /// Sends a request in real time, and waits until it is answered, or will not be.
    fn ask_and_wait(&self, py: Python<'_>, port: PortNumber, frame: &[u8]) -> PyResult<Vec<u8>> {
        let _turn = self.shared.begin_to_ask(py)?;
        let client = self.shared.with(py, |open| {
            let client = open.streams.connect(open.bench, self.id, port).ok()?;
            open.bench.set_hears_own_answers_only(client);
            open.bench.send(client, frame);
            Some(client)
        })?;
        let Some(client) = client else { return Ok(Vec::new()) };
        let (mut reply, mut patience) = (Vec::new(), None);
        let waited = self.shared.poll(py, |open| {
            open.streams.receive(open.bench, client, &mut reply);
            // The client loses patience some time after the request is on the line.
            if open.bench.backlog(client) > 0 {
                return None;
            }
            let patience = *patience.get_or_insert(open.bench.now() + open.time_mode.frame_timeout() * 2);
            let is_over = !reply.is_empty() || open.bench.now() >= patience;
            let is_over = is_over && !open.bench.is_being_served(client);
            (is_over || open.streams.ended(open.bench, client).is_some()).then_some(())
        });
        // Also after Ctrl-C the connection ends.
        self.shared.with(py, |open| open.streams.disconnect(open.bench, client))?;
        waited.map(|()| reply)
    }

    fn set_fault(&self, py: Python<'_>, name: &str, on: bool) -> PyResult<()> {
        self.shared.act(py, self.id, |drive| commands::fault(drive, name, on))
    }
}

#[pymethods]
impl Drive {
    /// Name of the drive on its bench.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// The bench that the drive is on.
    #[getter]
    fn bench(&self) -> Bench {
        Bench { shared: Arc::clone(&self.shared) }
    }

    /// Place of the board that the drive is on, for instance "/dev/ttyACM1 (usb:E661)"; None if it is emulated here.
    #[getter]
    fn board(&self) -> Option<String> {
        self.shared.board_of(self.id).map(OnBoard::place)
    }

    /// Kind of the drive, for instance "md3".
    #[getter]
    fn kind(&self) -> &'static str {
        self.spec.kind
    }

    /// Names of the ports; the first one is that of `ask` and `line` without a name.
    #[getter]
    fn ports(&self) -> Vec<&'static str> {
        self.spec.ports.iter().map(|port| port.name).collect()
    }

    /// All addresses of a port, the first one if none is named, for instance "tcp:127.0.0.1:40123": those that
    /// `drivetwin.run` has opened.
    #[pyo3(signature = (port = None))]
    fn uris(&self, port: Option<&str>) -> PyResult<Vec<String>> {
        let port = self.find_port(port)?;
        let server = self.shared.server();
        Ok(server.map_or_else(Vec::new, |server| server.uris(&self.name, port).to_vec()))
    }

    /// The first address of a port, the first one if none is named.
    #[pyo3(signature = (port = None))]
    fn uri(&self, port: Option<&str>) -> PyResult<String> {
        let name = self.port_name(port)?;
        self.uris(port)?.into_iter().next().ok_or_else(|| {
            let how = match self.shared.board_of(self.id) {
                Some(_) if self.shared.board().is_none() => {
                    "bus = \"...\" in its [[drive]] takes serial:DEVICE, tcp:HOST:PORT or rfc2217:HOST:PORT"
                }
                Some(_) => {
                    "drivetwin.attach takes bus='serial:DEVICE', 'tcp:HOST:PORT' or 'rfc2217:HOST:PORT'"
                }
                None => "drivetwin.run gives it one",
            };
            Error::new_err(format!("{name} of {} has no address; {how}", self.name))
        })
    }

    /// Path of the first pty of the drive.
    #[getter]
    fn pty(&self) -> PyResult<String> {
        for port in self.spec.ports {
            let uris = self.uris(Some(port.name))?;
            // The port of a board is one, too, for a master.
            let path =
                |uri: &String| uri.strip_prefix("pty:").or(uri.strip_prefix("serial:")).map(str::to_owned);
            let is_port = |uri: &&String| uri.starts_with("pty:") || self.shared.board_of(self.id).is_some();
            if let Some(path) = uris.iter().filter(is_port).find_map(path) {
                return Ok(path);
            }
        }
        Err(Error::new_err(format!(
            "{} has no pty; drivetwin.run gives it one with listen='pty:'",
            self.name
        )))
    }

    /// Sends a whole message to a port, the first one if none is named, and returns the answer. b"" is silence. Bench
    /// time goes on until the drive has answered, or will not; where the clock follows the wall clock, this waits.
    #[pyo3(signature = (frame, port = None))]
    fn ask<'py>(
        &self,
        py: Python<'py>,
        frame: PyBackedBytes,
        port: Option<&str>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let port = self.find_port(port)?;
        if let Some(board) = self.shared.board_of(self.id) {
            let line = py.detach(|| board.drive()?.line()).map_err(refused)?;
            let master = py.import("drivetwin._board")?;
            let reply = master.call_method1("ask", (self.uri(None)?, line, PyBytes::new(py, &frame)))?;
            return Ok(reply.cast_into()?);
        }
        let reply = self
            .shared
            .with(py, |open| open.is_manual().then(|| open.bench.ask_at(self.id, port, &frame)))?;
        let reply = match reply {
            Some(reply) => reply,
            None => self.ask_and_wait(py, port, &frame)?,
        };
        Ok(PyBytes::new(py, &reply))
    }

    /// The registers, by the manual's names.
    #[getter]
    fn registers(&self) -> Registers {
        Registers::new(Arc::clone(&self.shared), self.id, self.spec)
    }

    /// The pins, by the manual's names.
    #[getter]
    fn pins(&self) -> Pins {
        Pins::new(Arc::clone(&self.shared), self.id, self.spec)
    }

    /// The lights at this instant, by the manual's names: True while lit.
    #[getter]
    fn leds(&self, py: Python<'_>) -> PyResult<BTreeMap<&'static str, bool>> {
        use drivetwin_firmware::device::Level;
        let state = self.shared.act(py, self.id, |drive| drive.state())?;
        let lights = self.spec.pin_names().filter(|(_, pin)| is_light(self.spec, *pin));
        Ok(lights.map(|(name, pin)| (name, state.level(pin) == Level::High)).collect())
    }

    /// Motion of the first axis at this instant.
    #[getter]
    fn motion(&self, py: Python<'_>) -> PyResult<Motion> {
        if self.spec.axes.is_empty() {
            return Err(Error::new_err(format!(
                "{} moves nothing: {} has no axis",
                self.name, self.spec.kind
            )));
        }
        let state = self.shared.act(py, self.id, |drive| drive.state())?;
        Ok(Motion::of(state.motion.unwrap_or_default()))
    }

    /// The pulses of the STEP output since the last power-on: a list of (seconds, +1 or -1), or, where numpy is installed,
    /// a structured array with the fields "at" and "step".
    fn pulses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if self.spec.axes.first().is_none_or(|axis| axis.step_dir.is_none()) {
            return Err(Error::new_err(format!("{} has no STEP output", self.name)));
        }
        self.shared.catch_up(py)?;
        let pulses = self.shared.with_detached(py, |open| recording::pulses(open.bench, self.id))?;
        let pulses = pulses.ok_or_else(|| {
            Error::new_err(format!(
                "the pulses of {} are not known: the recording has lost their beginning, or there is none",
                self.name
            ))
        })?;
        if pulses.len() > recording::MOST {
            return Err(Error::new_err(format!(
                "{} has made more than {} pulses since its last power-on; bench.history has the motion",
                self.name,
                recording::MOST
            )));
        }
        recording::rows(py, pulses, vec![("at", "=f8"), ("step", "i1")], |(at, step), bytes| {
            bytes.extend(at.to_ne_bytes());
            bytes.extend(step.to_ne_bytes());
        })
    }

    /// Turns the encoder at the inputs A and B by `counts` edges, four per cycle, `hz` of them per second of bench time
    /// (0.000001 to 16,000,000); backwards if `counts` is negative. The edges come while time advances.
    fn encoder(&self, py: Python<'_>, counts: &Bound<'_, PyAny>, hz: f64) -> PyResult<()> {
        let counts = whole("counts", counts)?;
        self.shared.act(py, self.id, |drive| commands::encoder(drive, counts, hz))
    }

    /// Sends a train of `count` pulses into an input pin, `hz` of them per second of bench time (0.000001 to 8,000,000).
    /// `duty` is the part of its period for which a pulse lasts.
    #[pyo3(signature = (pin, count, hz, duty = 0.5))]
    fn pulse(&self, py: Python<'_>, pin: &str, count: &Bound<'_, PyAny>, hz: f64, duty: f64) -> PyResult<()> {
        let count = whole("count", count)?;
        self.shared.act(py, self.id, |drive| commands::pulse_pin(drive, pin, count, hz, duty))
    }

    /// Sets the cause of a fault, for instance "over_temperature".
    fn fault(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        self.set_fault(py, name, true)
    }

    /// Clears the cause of a fault.
    fn clear(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        self.set_fault(py, name, false)
    }

    /// Faults by name: True while the cause is present.
    #[getter]
    fn faults(&self, py: Python<'_>) -> PyResult<BTreeMap<&'static str, bool>> {
        let state = self.shared.act(py, self.id, |drive| drive.state())?;
        Ok(self.spec.faults.iter().copied().zip(state.faults).collect())
    }

    /// Switches the power: "off", "on", "cycle" (off and on again), or "cut": it fails in the middle of the next save.
    fn power(&self, py: Python<'_>, action: &str) -> PyResult<()> {
        const ACTIONS: [(&str, PowerAction); 4] = [
            ("off", PowerAction::Off),
            ("on", PowerAction::On),
            ("cycle", PowerAction::Cycle),
            ("cut", PowerAction::Cut),
        ];
        let found = ACTIONS.iter().find(|(name, _)| *name == action).ok_or_else(|| {
            let names = ACTIONS.iter().map(|(name, _)| *name);
            UnknownName::new_err(suggest::unknown("power action", action, names))
        })?;
        self.shared.act(py, self.id, |drive| drive.power(found.1))
    }

    /// True while the drive has power.
    #[getter]
    fn powered(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.shared.act(py, self.id, |drive| drive.state())?.powered)
    }

    /// The line or TCP port of a port, the first one if none is named.
    #[pyo3(signature = (port = None))]
    fn line(&self, py: Python<'_>, port: Option<&str>) -> PyResult<Line> {
        let port = self.find_port(port)?;
        self.shared.refuse_on_board_of(self.id, reasons::NO_LINE_FAULTS)?;
        let outlet = self.shared.with(py, |open| open.bench.outlet(self.id, port))?;
        Ok(Line::new(Arc::clone(&self.shared), outlet))
    }

    /// The latest messages that the drive has received, in the order in which their outcomes became known: those from the
    /// first one on that ended at the bench time `since` (seconds) or later, with a Modbus function, or that read or write
    /// a register.
    #[pyo3(signature = (since = 0.0, function = None, register = None))]
    fn received(
        &self,
        py: Python<'_>,
        since: f64,
        function: Option<&Bound<'_, PyAny>>,
        register: Option<&str>,
    ) -> PyResult<Vec<Request>> {
        let since = Instant::ZERO + span("since", since)?;
        let function = function.map(|function| whole("function", function)).transpose()?;
        let register =
            register.map(|name| commands::register(self.spec, name)).transpose().map_err(refused)?;
        self.shared.refuse_on_board_of(self.id, reasons::NO_JOURNAL)?;
        let mut received = self.shared.with(py, |open| open.bench.received(self.id))?.since(since);
        if let Some(function) = function {
            received = received.of_function(function);
        }
        if let Some(register) = register {
            received = received.of_register(register);
        }
        Ok(received.messages().map(Request::from).collect())
    }

    /// Returns whether the drive executed a write of the register `first` before the first write of `then`.
    fn wrote_before(&self, py: Python<'_>, first: &str, then: &str) -> PyResult<bool> {
        let find = |name| commands::register(self.spec, name).map_err(refused);
        let (first, then) = (find(first)?, find(then)?);
        self.shared.refuse_on_board_of(self.id, reasons::NO_JOURNAL)?;
        Ok(self.shared.with(py, |open| open.bench.received(self.id))?.wrote_before(first, then))
    }

    /// Statistics of the requests on a Modbus line or Modbus/TCP port, the first one if none is named: `requests`,
    /// `early` (without a silence of t3.5), `retries`, `shortest_silence` in seconds, and `starting`, the requests to
    /// this drive that it did not receive because it was starting.
    #[pyo3(signature = (port = None))]
    fn statistics<'py>(&self, py: Python<'py>, port: Option<&str>) -> PyResult<Bound<'py, PyDict>> {
        let port = self.find_port(port)?;
        self.shared.refuse_on_board_of(self.id, reasons::NO_JOURNAL)?;
        let (line, starting) = self.shared.with(py, |open| {
            let outlet = open.bench.outlet(self.id, port);
            (open.bench.request_statistics(outlet), open.bench.starting_requests(self.id))
        })?;
        let statistics = PyDict::new(py);
        statistics.set_item("requests", line.requests)?;
        statistics.set_item("early", line.early)?;
        statistics.set_item("retries", line.retries)?;
        let silence = line.shortest_silence.map(|silence| silence.ticks() as f64 / TICKS_PER_SECOND as f64);
        statistics.set_item("shortest_silence", silence)?;
        statistics.set_item("starting", starting.count)?;
        Ok(statistics)
    }

    /// Opens a port as a stream on virtual time.
    fn port(&self, py: Python<'_>, name: &str) -> PyResult<Port> {
        let port = self.find_port(Some(name))?;
        self.shared.refuse_on_board_of(self.id, reasons::NO_STREAM)?;
        let (client, bus) = self.shared.with(py, |open| {
            (open.streams.connect(open.bench, self.id, port), open.bench.bus(self.id, port))
        })?;
        let client =
            client.map_err(|error| wrong(&format!("{} refuses a connection: {error}", self.name)))?;
        Ok(Port::new(Arc::clone(&self.shared), client, bus, format!("{}.{name}", self.name)))
    }

    /// A URL of a port, the first one if none is named, for `serial.serial_for_url` in this process; see the module
    /// `drivetwin.urlhandler.protocol_drivetwin`. It is valid as long as the bench.
    #[pyo3(signature = (port = None))]
    fn url<'py>(&self, py: Python<'py>, port: Option<&str>) -> PyResult<Bound<'py, PyAny>> {
        let name = self.port_name(port)?;
        if self.shared.board_of(self.id).is_some() {
            return py.import("drivetwin._board")?.call_method1("url", (self.uri(port)?,));
        }
        let handler = py.import("drivetwin.urlhandler")?;
        handler.call_method1("url", (self.bench(), &self.name, name))
    }

    fn __eq__(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.shared, &other.shared) && self.id == other.id
    }

    fn __hash__(&self) -> isize {
        // The address is that of the bench as long as a drive of it lives.
        let mut hasher = DefaultHasher::new();
        (Arc::as_ptr(&self.shared).addr(), self.id).hash(&mut hasher);
        hasher.finish().cast_signed() as isize
    }

    fn __repr__(&self) -> String {
        format!("<Drive {} ({})>", self.name, self.spec.kind)
    }
}
