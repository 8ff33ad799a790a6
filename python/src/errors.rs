//! Exceptions with the sentences of the command line.

use drivetwin_sim::commands::Refusal;
use drivetwin_sim::suggest;
use pyo3::PyErr;

pyo3::import_exception!(drivetwin._errors, Error);
pyo3::import_exception!(drivetwin._errors, UnknownName);

/// The exception for a sentence. The options of the command line are keyword arguments here.
pub(crate) fn wrong(sentence: &str) -> PyErr {
    let sentence = sentence.strip_prefix("--").unwrap_or(sentence).to_owned();
    if suggest::is_unknown(&sentence) { UnknownName::new_err(sentence) } else { Error::new_err(sentence) }
}

/// The exception for a refusal.
pub(crate) fn refused(refusal: Refusal) -> PyErr {
    match refusal {
        Refusal::Unknown(sentence) => UnknownName::new_err(sentence),
        Refusal::Invalid(sentence) | Refusal::Conflict(sentence) => Error::new_err(sentence),
    }
}
