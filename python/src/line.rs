//! Lines and TCP ports of drives, and streams to them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use drivetwin_protocol::line::Parity;
use drivetwin_sim::bench::{Bench, Bus, Client, Outlet};
use drivetwin_sim::line::faults::LineFaults;
use drivetwin_sim::line::{PortParity, Sender};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};

use crate::errors::{Error, whole, wrong};
use crate::shared::{Shared, span};
use crate::tables;

/// A serial line of one or more drives, or a TCP port of a drive.
#[pyclass(frozen, module = "drivetwin")]
pub(crate) struct Line {
    shared: Arc<Shared>,
    outlet: Outlet,
}

impl Line {
    pub(crate) fn new(shared: Arc<Shared>, outlet: Outlet) -> Self {
        Self { shared, outlet }
    }
}

/// Name of a line in the table of a bench file: unique on every bench.
fn unique_name(bench: &Bench, outlet: Outlet) -> String {
    match outlet {
        Outlet::Line(bus) if bench.shared_buses().any(|shared| shared == bus) => {
            bench.bus_name(bus).to_owned()
        }
        _ => {
            let drive = bench.drives_at(outlet).first().map_or("", |&drive| bench.name(drive));
            format!("{drive}.{}", bench.port_at(outlet).map_or("", |port| port.name))
        }
    }
}

#[pymethods]
impl Line {
    /// Name of the line or TCP port.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        self.shared.with(py, |open| open.bench.outlet_name(self.outlet))
    }

    /// Sets the faults of the line from its next frame on, with the keys of a table `[[fault]]` of a bench file; without
    /// an argument the line has no faults. A rate is a share of the frames, 0 to 1; a dict says which frames and how
    /// many: `drop={"count": 1, "direction": "reply"}`.
    #[pyo3(signature = (**faults))]
    fn faults(&self, py: Python<'_>, faults: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let Some(faults) = faults else {
            return self.shared.with(py, |open| open.bench.set_faults(self.outlet, LineFaults::NONE));
        };
        let keys = faults.copy()?;
        let name = self.shared.with(py, |open| unique_name(open.bench, self.outlet))?;
        if keys.contains("bus")? {
            return Err(Error::new_err("bus is not an argument: these are the faults of one line"));
        }
        keys.set_item("bus", name)?;
        let text = tables::table("fault", &keys)?;
        let set = self.shared.with(py, |open| tables::add(open.bench, &text).map(drop))?;
        set.map_err(|sentence| wrong(&sentence))
    }

    /// True if the line drops requests that are too early, as drives do: without a silence of t3.5 before them.
    #[getter]
    fn strict(&self, py: Python<'_>) -> PyResult<bool> {
        let Outlet::Line(bus) = self.outlet else { return Ok(false) };
        self.shared.with(py, |open| open.bench.is_strict(bus))
    }

    #[setter]
    fn set_strict(&self, py: Python<'_>, strict: bool) -> PyResult<()> {
        let Outlet::Line(bus) = self.outlet else {
            return Err(Error::new_err("a TCP port is not strict: it has no silence between requests"));
        };
        self.shared.with(py, |open| open.bench.set_strict(bus, strict))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Line {}>", self.name(py)?))
    }
}

/// A connection to a port of a drive, without a port of the system. What is written goes out while time passes.
#[pyclass(frozen, module = "drivetwin")]
pub(crate) struct Port {
    shared: Arc<Shared>,
    client: Client,
    /// Line of the port, if it is serial.
    bus: Option<Bus>,
    name: String,
    /// Serial settings with which it sends and receives.
    settings: Mutex<Sender>,
    closed: AtomicBool,
}

/// Bench time in s between two looks for Ctrl-C, while nothing comes.
const PIECE: f64 = 0.1;

impl Port {
    pub(crate) fn new(shared: Arc<Shared>, client: Client, bus: Option<Bus>, name: String) -> Self {
        Self {
            shared,
            client,
            bus,
            name,
            settings: Mutex::new(Sender::default()),
            closed: AtomicBool::new(false),
        }
    }

    fn settings(&self) -> Sender {
        *self.settings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn check(&self) -> PyResult<()> {
        if self.closed.load(Ordering::Relaxed) {
            return Err(Error::new_err(format!("the port {} is closed", self.name)));
        }
        Ok(())
    }
}

#[pymethods]
impl Port {
    /// Sends bytes, without gaps, and returns their number. They arrive while time advances.
    fn write(&self, py: Python<'_>, data: PyBackedBytes) -> PyResult<usize> {
        self.check()?;
        let settings = self.settings();
        let ended = self.shared.with(py, |open| match open.streams.ended(open.bench, self.client) {
            None => {
                // A port of seven data bits has no eighth one.
                let mask = settings.data.map_or(0xFF, |data| 0xFF >> (8 - data.min(8)));
                let characters: Vec<u8> = data.iter().map(|byte| byte & mask).collect();
                open.bench.send_from(self.client, &characters, settings);
                None
            }
            ended => ended,
        })?;
        match ended {
            None => Ok(data.len()),
            Some(ended) => Err(wrong(&format!("the connection to {} has ended: {ended}", self.name))),
        }
    }

    /// Returns what has come until now; b"" if nothing has.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.check()?;
        let mut bytes = Vec::new();
        self.shared.with(py, |open| open.streams.receive(open.bench, self.client, &mut bytes))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Sets the serial settings of this end: `baud` in bits per second, `data` bits, `parity` "N", "E" or "O", `stop` bits. One
    /// that is None fits every line. With other settings than its line's a drive hears errors, and does not answer.
    #[pyo3(signature = (baud = None, data = None, parity = None, stop = None))]
    fn configure(
        &self,
        py: Python<'_>,
        baud: Option<&Bound<'_, PyAny>>,
        data: Option<&Bound<'_, PyAny>>,
        parity: Option<&str>,
        stop: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        self.check()?;
        let baud = baud.map(|baud| whole::<u32>("baud", baud)).transpose()?;
        let data = data.map(|data| whole::<u8>("data", data)).transpose()?;
        let stop = stop.map(|stop| whole::<u8>("stop", stop)).transpose()?;
        if baud == Some(0) {
            return Err(Error::new_err("baud takes a number from 1, not 0"));
        }
        let parity = match parity {
            None => PortParity::Unknown,
            Some("N") => PortParity::Known(Parity::None),
            Some("E") => PortParity::Known(Parity::Even),
            Some("O") => PortParity::Known(Parity::Odd),
            Some(other) => {
                return Err(Error::new_err(format!("parity takes 'N', 'E' or 'O', not '{other}'")));
            }
        };
        if data.is_some_and(|data| !(5..=8).contains(&data))
            || stop.is_some_and(|stop| !(1..=2).contains(&stop))
        {
            return Err(Error::new_err("a port has 5 to 8 data bits, and 1 or 2 stop bits"));
        }
        let settings = Sender { baud, data, parity, stop };
        *self.settings.lock().unwrap_or_else(PoisonError::into_inner) = settings;
        self.shared.with(py, |open| open.bench.set_receiver(self.client, settings))
    }

    /// Switches DTR: tells the drives of the line that a program has opened this end, or closed it. It resets a QSB.
    fn dtr(&self, py: Python<'_>, on: bool) -> PyResult<()> {
        self.check()?;
        let Some(bus) = self.bus else { return Ok(()) };
        self.shared.with(py, |open| open.bench.attach(bus, on))
    }

    /// Lets bench time pass until something can be read, at most `seconds`. Returns whether something can be read.
    fn wait(&self, py: Python<'_>, seconds: f64) -> PyResult<bool> {
        self.check()?;
        let (longest, piece) = (span("wait", seconds)?, span("wait", PIECE)?);
        let mut until = None;
        self.shared.poll(py, |open| {
            let until = *until.get_or_insert(open.bench.now() + longest);
            if open.is_manual() && !open.streams.is_readable(open.bench, self.client) {
                let at = until.min(open.bench.now() + piece);
                open.bench.run_until_readable(self.client, at);
            }
            let is_readable = open.streams.is_readable(open.bench, self.client);
            (is_readable || open.bench.now() >= until).then_some(is_readable)
        })
    }

    /// Lets bench time pass until every complete request is answered, or will not be.
    fn settle(&self, py: Python<'_>) -> PyResult<()> {
        self.check()?;
        self.shared.poll(py, |open| {
            if open.is_manual() {
                open.bench.run_until_idle();
            }
            (open.is_manual() || open.bench.is_served(self.client)).then_some(())
        })
    }

    /// Lets bench time pass until all that was written is on the line, at most `seconds`.
    fn drain(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        self.check()?;
        let longest = span("drain", seconds)?;
        let mut until = None;
        self.shared.poll(py, |open| {
            let until = *until.get_or_insert(open.bench.now() + longest);
            if open.is_manual() {
                open.bench.run_until_transmitted(self.client, until);
                return Some(());
            }
            (open.bench.backlog(self.client) == 0 || open.bench.now() >= until).then_some(())
        })
    }

    /// Number of bytes that are not on the line yet.
    #[getter]
    fn unsent(&self, py: Python<'_>) -> PyResult<usize> {
        self.check()?;
        self.shared.with(py, |open| open.bench.backlog(self.client))
    }

    /// Drops the bytes that are not on the line yet.
    fn drop_unsent(&self, py: Python<'_>) -> PyResult<()> {
        self.check()?;
        self.shared.with(py, |open| open.bench.drop_backlog(self.client))
    }

    /// Closes the connection.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        if self.closed.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        self.shared.with(py, |open| open.streams.disconnect(open.bench, self.client))
    }

    /// True if this end is closed.
    #[getter]
    fn closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_raised))]
    fn __exit__(&self, py: Python<'_>, _raised: &Bound<'_, PyAny>) -> PyResult<()> {
        self.close(py)
    }

    fn __repr__(&self) -> String {
        format!("<Port {}>", self.name)
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        // A bench that is closed, or another process, has no connection to end.
        Python::attach(|py| self.close(py).ok());
    }
}
