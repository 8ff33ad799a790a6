//! Keyword arguments as tables of a bench file, so that both take the same keys and give the same errors.

use std::fmt::Write as _;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::{Added, Layout};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyString, PyTuple};

use crate::errors::Error;

/// Greatest depth of dicts and lists in a value. No table of a bench file is as deep; a list that holds itself has no end.
const DEEPEST: usize = 32;

/// Text of a table `[[name]]` with these keys. A key whose value is `None` is left out.
pub(crate) fn table(name: &str, keys: &Bound<'_, PyDict>) -> PyResult<String> {
    let mut text = format!("[[{name}]]\n");
    for (key, is) in keys.iter().filter(|(_, is)| !is.is_none()) {
        let _ = writeln!(text, "{} = {}", string(&key.extract::<String>()?), value(&is, 0)?);
    }
    Ok(text)
}

/// Adds the tables in `text` to a bench.
///
/// # Errors
/// One sentence, without the place in the text.
pub(crate) fn add(bench: &mut Bench, text: &str) -> Result<Added, String> {
    let layout = bench_file::parse_more(text, Layout::of(bench)).map_err(|error| error.what)?;
    layout.add_to(bench, Vec::new())
}

/// Plays the scenarios in `text` on a bench.
///
/// # Errors
/// One sentence, without the place in the text.
pub(crate) fn play(bench: &mut Bench, text: &str) -> Result<(), String> {
    let scenarios = bench_file::parse_scenarios(text, bench).map_err(|error| error.what)?;
    bench.play_all(scenarios)
}

/// A value in TOML, inside `depth` dicts and lists.
fn value(is: &Bound<'_, PyAny>, depth: usize) -> PyResult<String> {
    if depth > DEEPEST {
        return Err(Error::new_err(format!(
            "a value is too deep: it has more than {DEEPEST} dicts and lists inside each other"
        )));
    }
    if let Ok(flag) = is.cast::<PyBool>() {
        return Ok(flag.is_true().to_string());
    }
    if let Ok(text) = is.cast::<PyString>() {
        return Ok(string(&text.extract::<String>()?));
    }
    if let Ok(keys) = is.cast::<PyDict>() {
        let mut parts = Vec::new();
        for (key, is) in keys.iter() {
            parts.push(format!("{} = {}", string(&key.extract::<String>()?), value(&is, depth + 1)?));
        }
        return Ok(format!("{{ {} }}", parts.join(", ")));
    }
    if is.is_instance_of::<PyList>() || is.is_instance_of::<PyTuple>() {
        let parts = is.try_iter()?.map(|part| value(&part?, depth + 1)).collect::<PyResult<Vec<_>>>()?;
        return Ok(format!("[{}]", parts.join(", ")));
    }
    if let Ok(whole) = is.extract::<i64>() {
        return Ok(whole.to_string());
    }
    if let Ok(number) = is.extract::<f64>() {
        // TOML writes them in small letters.
        return Ok(format!("{number:?}").to_lowercase());
    }
    let kind = is.get_type().name()?;
    Err(PyTypeError::new_err(format!(
        "{kind} is no value of a bench file; use numbers, strings, lists and dicts"
    )))
}

/// A string in TOML.
fn string(text: &str) -> String {
    let mut quoted = String::from('"');
    for char in text.chars() {
        match char {
            '"' | '\\' => quoted.extend(['\\', char]),
            char if char.is_control() => {
                let _ = write!(quoted, "\\U{:08X}", u32::from(char));
            }
            char => quoted.push(char),
        }
    }
    quoted.push('"');
    quoted
}
