//! The native module of the Python package `drivetwin`: a bench in the caller's process, and the command.
//!
//! | module | what it holds |
//! |---|---|
//! | `errors` | exceptions with the sentences of the command line |
//! | `server` | a run with ports, in a thread |
//! | `shared` | what the objects of a bench share: lock, process, end |
//! | `views` | values that do not change: motion, requests, motors |
//! | `tables` | keyword arguments as tables of a bench file |
//! | `named` | what a drive has by name: registers, pins |
//! | `line` | lines and TCP ports: faults, streams |
//! | `recording` | pulses, motion over time, tracks of a picture |
//! | `drive` | a drive |
//! | `bench` | methods of a bench |
//!
//! A module uses only those above it in this table; `tests/tests/layers.rs` checks it.
//!
//! A closure that holds the lock of a bench creates no Python object: that may run the collector, and with it code that
//! uses the same bench.

mod bench;
mod drive;
mod errors;
mod line;
mod named;
mod recording;
mod server;
mod shared;
mod tables;
mod views;

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the command `drivetwin` and returns its exit code. The first argument is its own name.
#[pyfunction]
fn command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| drivetwin_cli::run(arguments))
}

/// The names of all kinds of drive.
#[pyfunction]
fn kinds() -> Vec<&'static str> {
    drivetwin_sim::catalog::specs().map(|spec| spec.kind).collect()
}

/// Ends all runs that this process has begun; `drivetwin.run` lets the interpreter call it at its end.
#[pyfunction]
fn end_runs(py: Python<'_>) -> PyResult<()> {
    server::end_all(py)
}

/// Panics, so that a test sees what becomes of a panic.
#[pyfunction]
fn panic_for_test(bench: &shared::Bench, py: Python<'_>) -> PyResult<()> {
    bench.shared.with(py, |_| panic!("a test asked for this panic"))
}

/// Native part of the package `drivetwin`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(command, module)?)?;
    module.add_function(wrap_pyfunction!(kinds, module)?)?;
    module.add_function(wrap_pyfunction!(end_runs, module)?)?;
    module.add_function(wrap_pyfunction!(panic_for_test, module)?)?;
    module.add_class::<shared::Bench>()?;
    module.add_class::<drive::Drive>()?;
    module.add_class::<named::Registers>()?;
    module.add_class::<named::Pins>()?;
    module.add_class::<line::Line>()?;
    module.add_class::<line::Port>()?;
    module.add_class::<views::Motion>()?;
    module.add_class::<views::Motor>()?;
    module.add_class::<views::Request>()?;
    module.add_class::<views::RequestRegister>()
}
