//! Exceptions with the sentences of the command line.

use drivetwin_sim::commands::Refusal;
use drivetwin_sim::suggest;
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};

pyo3::import_exception!(drivetwin._errors, Error);
pyo3::import_exception!(drivetwin._errors, NotOnBoard);
pyo3::import_exception!(drivetwin._errors, UnknownName);

/// The exception for a sentence. The options of the command line are keyword arguments here.
pub(crate) fn wrong(sentence: &str) -> PyErr {
    let sentence = sentence.strip_prefix("--").unwrap_or(sentence).to_owned();
    if suggest::is_unknown(&sentence) { UnknownName::new_err(sentence) } else { Error::new_err(sentence) }
}

/// A whole number, which the argument or register `name` gets.
pub(crate) fn whole<T>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<T>
where
    T: for<'a, 'py> FromPyObject<'a, 'py, Error = PyErr>,
{
    value.extract::<T>().map_err(|error| {
        if error.is_instance_of::<PyOverflowError>(value.py()) {
            Error::new_err(format!("{name}: {value} is out of range"))
        } else {
            error
        }
    })
}

/// Words of a register; `None` if it is no sequence of numbers.
pub(crate) fn words(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Option<Vec<i64>>> {
    if !value.is_instance_of::<PyList>() && !value.is_instance_of::<PyTuple>() {
        return Ok(value.extract().ok());
    }
    let words = value.try_iter()?.map(|word| whole(name, &word?)).collect::<PyResult<Vec<i64>>>()?;
    if words.is_empty() {
        return Err(Error::new_err(format!("{name} takes a number or words, not an empty list")));
    }
    Ok(Some(words))
}

/// The exception for a refusal.
pub(crate) fn refused(refusal: Refusal) -> PyErr {
    match refusal {
        Refusal::Unknown(sentence) => UnknownName::new_err(sentence),
        Refusal::Invalid(sentence) | Refusal::Conflict(sentence) | Refusal::Away(sentence) => {
            Error::new_err(sentence)
        }
    }
}
