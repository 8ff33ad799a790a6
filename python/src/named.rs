//! Registers and pins of a drive, by name.

use std::sync::Arc;

use drivetwin_firmware::device::{Level, Pin, Role, Spec};
use drivetwin_protocol::registers::Named;
use drivetwin_sim::bench::DriveId;
use drivetwin_sim::commands::{self, Contact, Drive, InputLevel, NewValue, Refusal};
use drivetwin_sim::config::preset::Number;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyIterator, PyList};

use crate::errors::{Error, refused, whole, words};
use crate::shared::Shared;
use crate::views::RegisterValue;

/// The registers of a drive, by the names of its manual: a mapping that is read and written past the bus, without the
/// side effects of a request. A value is an int, or a list of words for a register whose words have a meaning each; text
/// may be written to registers of text.
#[pyclass(frozen, mapping, module = "drivetwin")]
pub(crate) struct Registers {
    shared: Arc<Shared>,
    id: DriveId,
    spec: &'static Spec,
}

impl Registers {
    pub(crate) fn new(shared: Arc<Shared>, id: DriveId, spec: &'static Spec) -> Self {
        Self { shared, id, spec }
    }

    fn names(&self) -> Vec<&'static str> {
        self.spec.rows().map(|(_, row)| row.name).collect()
    }
}

/// Value of a register, or of one word of it.
fn read(drive: &mut dyn Drive, name: &str) -> Result<RegisterValue, Refusal> {
    let table = drive.spec().registers;
    let Named { row, word } = commands::register(drive.spec(), name)?;
    match (word, table.rows.get(row)) {
        (Some(word), Some(of)) => {
            let value = drive.peek(row)?;
            Ok(RegisterValue::Number(table.word(of.shape, value, word.into()).into()))
        }
        _ => Ok(drive.value(row)?.into()),
    }
}

#[pymethods]
impl Registers {
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<RegisterValue> {
        self.shared.act(py, self.id, |drive| read(drive, name))
    }

    fn __setitem__(&self, py: Python<'_>, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value = if let Ok(text) = value.extract::<String>() {
            NewValue::Typed(text)
        } else if let Some(words) = words(name, value)? {
            NewValue::Number(Number::Words(words))
        } else {
            NewValue::Number(Number::Decimal(whole(name, value)?))
        };
        self.shared.act(py, self.id, |drive| commands::preset(drive, name, &value))
    }

    fn __contains__(&self, name: &str) -> bool {
        commands::register(self.spec, name).is_ok()
    }

    fn __len__(&self) -> usize {
        self.names().len()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyList::new(py, self.names())?.try_iter()
    }

    /// The names, in the order of the manual.
    fn keys(&self) -> Vec<&'static str> {
        self.names()
    }

    /// The values, in the order of the manual.
    fn values(&self, py: Python<'_>) -> PyResult<Vec<RegisterValue>> {
        Ok(self.items(py)?.into_iter().map(|(_, value)| value).collect())
    }

    /// Names and values, in the order of the manual.
    fn items(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, RegisterValue)>> {
        let values = self.shared.act(py, self.id, |drive| drive.values())?;
        Ok(values.into_iter().map(|(name, value)| (name, value.into())).collect())
    }

    /// The value of a register, or `default` if there is no such register.
    #[pyo3(signature = (name, default = None))]
    fn get(&self, py: Python<'_>, name: &str, default: Option<Py<PyAny>>) -> PyResult<Py<PyAny>> {
        match commands::register(self.spec, name) {
            Ok(_) => Ok(self.__getitem__(py, name)?.into_pyobject(py)?.unbind()),
            Err(_) => Ok(default.unwrap_or_else(|| py.None())),
        }
    }

    fn __repr__(&self) -> String {
        format!("<{} registers of {}>", self.__len__(), self.spec.kind)
    }
}

/// The pins of a drive, by the names of its manual: a mapping to "low", "high" or "open". To an input, one of these may be
/// written, or volts as a number to an analogue one.
#[pyclass(frozen, mapping, module = "drivetwin")]
pub(crate) struct Pins {
    shared: Arc<Shared>,
    id: DriveId,
    spec: &'static Spec,
}

impl Pins {
    pub(crate) fn new(shared: Arc<Shared>, id: DriveId, spec: &'static Spec) -> Self {
        Self { shared, id, spec }
    }

    /// Names and pins without the lights.
    fn all(&self) -> impl Iterator<Item = (&'static str, Pin)> {
        let spec = self.spec;
        spec.pin_names().filter(|(_, pin)| !is_light(spec, *pin))
    }

    fn set(&self, py: Python<'_>, name: &str, level: InputLevel) -> PyResult<()> {
        self.shared.act(py, self.id, |drive| commands::drive_pin(drive, name, level))
    }
}

/// Returns whether a pin is a light.
pub(crate) fn is_light(spec: &Spec, pin: Pin) -> bool {
    spec.pins.get(usize::from(pin.0)).is_some_and(|pin| pin.role == Role::Led)
}

fn level_name(level: Level) -> &'static str {
    match level {
        Level::Low => "low",
        Level::High => "high",
        Level::Float => "open",
    }
}

#[pymethods]
impl Pins {
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<&'static str> {
        self.shared.act(py, self.id, |drive| {
            let (pin, _) = commands::pin(drive.spec(), name)?;
            Ok(level_name(drive.state()?.level(pin)))
        })
    }

    fn __setitem__(&self, py: Python<'_>, name: &str, level: &Bound<'_, PyAny>) -> PyResult<()> {
        commands::input(self.spec, name).map_err(refused)?;
        let level = match level.extract::<String>().as_deref() {
            Ok("low") => InputLevel { level: Some(Contact::Low), ..InputLevel::default() },
            Ok("high") => InputLevel { level: Some(Contact::High), ..InputLevel::default() },
            Ok("open") => InputLevel { level: Some(Contact::Open), ..InputLevel::default() },
            Ok(other) => {
                return Err(Error::new_err(format!("{name} takes 'low', 'high' or 'open', not '{other}'")));
            }
            Err(_) if level.is_instance_of::<PyBool>() => {
                return Err(Error::new_err(format!("{name} takes 'low', 'high' or 'open', not {level}")));
            }
            Err(_) => InputLevel { volts: Some(level.extract()?), ..InputLevel::default() },
        };
        self.set(py, name, level)
    }

    /// Drives a current in mA into an input that measures one.
    fn milliamps(&self, py: Python<'_>, name: &str, milliamps: f64) -> PyResult<()> {
        self.set(py, name, InputLevel { milliamps: Some(milliamps), ..InputLevel::default() })
    }

    fn __contains__(&self, name: &str) -> bool {
        commands::pin(self.spec, name).is_ok()
    }

    fn __len__(&self) -> usize {
        self.all().count()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyList::new(py, self.keys())?.try_iter()
    }

    /// The names.
    fn keys(&self) -> Vec<&'static str> {
        self.all().map(|(name, _)| name).collect()
    }

    /// The levels.
    fn values(&self, py: Python<'_>) -> PyResult<Vec<&'static str>> {
        Ok(self.items(py)?.into_iter().map(|(_, level)| level).collect())
    }

    /// Names and levels.
    fn items(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, &'static str)>> {
        let state = self.shared.act(py, self.id, |drive| drive.state())?;
        Ok(self.all().map(|(name, pin)| (name, level_name(state.level(pin)))).collect())
    }

    /// The level of a pin, or `default` if there is no such pin.
    #[pyo3(signature = (name, default = None))]
    fn get(&self, py: Python<'_>, name: &str, default: Option<Py<PyAny>>) -> PyResult<Py<PyAny>> {
        match commands::pin(self.spec, name) {
            Ok(_) => Ok(self.__getitem__(py, name)?.into_pyobject(py)?.into_any().unbind()),
            Err(_) => Ok(default.unwrap_or_else(|| py.None())),
        }
    }

    fn __repr__(&self) -> String {
        format!("<{} pins of {}>", self.__len__(), self.spec.kind)
    }
}
