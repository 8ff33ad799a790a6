//! Values that do not change.

use std::borrow::Cow;

use drivetwin_sim::bench::{self, ReceivedMessage, ShaftState};
use drivetwin_sim::value::Value;
use pyo3::prelude::*;

use crate::shared::seconds;

/// Motion of a drive's first axis at one instant.
#[pyclass(frozen, get_all, module = "drivetwin")]
pub(crate) struct Motion {
    /// Position in steps or counts.
    position: i32,
    /// Speed in steps or counts per second, signed.
    speed: f64,
    /// True while the motor moves.
    moving: bool,
    /// Current in A.
    current: f64,
    /// Duty of a motor that has no steps, -1 to 1.
    duty: f64,
}

impl Motion {
    pub(crate) fn of(motion: bench::Motion) -> Self {
        Self {
            position: motion.position,
            speed: motion.speed.to_num(),
            moving: motion.moving,
            current: f64::from(motion.current_ma) / 1_000.0,
            duty: f64::from(motion.duty) / 65_536.0,
        }
    }
}

#[pymethods]
impl Motion {
    fn __repr__(&self) -> String {
        let Self { position, speed, current, duty, .. } = self;
        let moving = if self.moving { "True" } else { "False" };
        // In the notation of Python: 0.0.
        format!(
            "Motion(position={position}, speed={speed:?}, moving={moving}, current={current:?}, duty={duty:?})"
        )
    }
}

/// A motor on a bench at one instant.
#[pyclass(frozen, get_all, module = "drivetwin")]
pub(crate) struct Motor {
    /// Name of the motor.
    pub(crate) name: String,
    /// Name of the drive that turns it.
    drive: String,
    /// Revolutions since the start, signed.
    revolutions: f64,
    /// Speed in revolutions per minute, signed.
    rpm: f64,
    /// True if the shaft cannot follow the commands of its drive.
    stalled: bool,
    /// Current in A.
    current: f64,
}

impl Motor {
    pub(crate) fn of(bench: &bench::Bench, motor: bench::Motor) -> Self {
        let ShaftState { revolutions, rpm, stalled, ma } = bench.turn(motor);
        let (drive, _) = bench.turned_by(motor);
        Self {
            name: bench.motor_name(motor).to_owned(),
            drive: bench.name(drive).to_owned(),
            revolutions,
            rpm,
            stalled,
            current: f64::from(ma) / 1_000.0,
        }
    }
}

#[pymethods]
impl Motor {
    fn __repr__(&self) -> String {
        let Self { name, drive, revolutions, rpm, .. } = self;
        format!("<Motor {name} of {drive}: {revolutions} revolutions, {rpm} rpm>")
    }
}

/// Value of a register: a number, or words in bus order.
#[derive(Clone, IntoPyObject, IntoPyObjectRef)]
pub(crate) enum RegisterValue {
    Number(i64),
    Words(Vec<i64>),
}

impl From<Value> for RegisterValue {
    fn from(value: Value) -> Self {
        match value {
            Value::Number(number) => Self::Number(number),
            Value::Words(words) => Self::Words(words),
        }
    }
}

/// A register in a request.
#[pyclass(frozen, get_all, module = "drivetwin")]
#[derive(Clone)]
pub(crate) struct RequestRegister {
    /// The manual's name; one word of a register of two ends in `High` or `Low`.
    name: String,
    /// The value that is written, or that the answer to a read has; None if there is none.
    value: Option<RegisterValue>,
    /// True if the request writes the register.
    written: bool,
}

#[pymethods]
impl RequestRegister {
    fn __repr__(&self) -> String {
        format!("RequestRegister({}, {})", self.name, if self.written { "written" } else { "read" })
    }
}

/// A message that a drive has received: a Modbus request, or a line of text.
#[pyclass(frozen, module = "drivetwin")]
pub(crate) struct Request {
    bytes: Vec<u8>,
    answer: Vec<u8>,
    /// Bench time of its end, in seconds.
    #[pyo3(get)]
    at: f64,
    /// The port of the drive.
    #[pyo3(get)]
    port: &'static str,
    /// The request in the names of the manual: `write SpeedLow = 200`.
    #[pyo3(get)]
    text: String,
    /// Outcome: `done`, `refused`, `without effect`, `not for it`, `bad frame`, `too early`, `not listening`, `lost`.
    #[pyo3(get)]
    verdict: &'static str,
    /// Reason of the verdict; None if there is no more to say.
    #[pyo3(get)]
    reason: Option<String>,
    /// The outcome in one clause.
    #[pyo3(get)]
    outcome: String,
    /// Address of the request; None on a port for text.
    #[pyo3(get)]
    address: Option<u8>,
    /// Modbus function; None on a port for text.
    #[pyo3(get)]
    function: Option<u8>,
    /// Registers of the request, in its order.
    #[pyo3(get)]
    registers: Vec<RequestRegister>,
}

impl From<ReceivedMessage> for Request {
    fn from(message: ReceivedMessage) -> Self {
        let ReceivedMessage { at, port, bytes, answer, exchange, .. } = message;
        let registers = exchange.request.registers.into_iter().map(|register| RequestRegister {
            name: register.name,
            value: register.value.map(RegisterValue::from),
            written: register.written,
        });
        Self {
            at: seconds(at),
            port,
            bytes,
            answer,
            text: exchange.request.text,
            verdict: exchange.verdict.as_str(),
            reason: exchange.reason,
            outcome: exchange.outcome,
            address: exchange.request.address,
            function: exchange.request.function,
            registers: registers.collect(),
        }
    }
}

#[pymethods]
impl Request {
    /// Its bytes, without characters that had an error; at most 1,024.
    #[getter]
    fn bytes(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    /// The bytes of the answer; None if there was none.
    #[getter]
    fn answer(&self) -> Option<Cow<'_, [u8]>> {
        (!self.answer.is_empty()).then_some(Cow::Borrowed(&self.answer))
    }

    fn __repr__(&self) -> String {
        format!("{} <- {} -> {}", self.port, self.text, self.outcome)
    }
}
