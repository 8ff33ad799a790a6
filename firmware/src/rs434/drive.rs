//! An RS 434544 without its serial port: its registers, and what happens when one is written.

use standin_protocol::registers::Bank;

use super::registers::{Model, Reg};
use crate::motor::Parameters;

/// The drive behind the serial port.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) model: Model,
    pub(super) bank: Bank<Reg, { Reg::WORDS }>,
}

impl Drive {
    pub(super) fn new(model: Model) -> Self {
        Self { model, bank: Bank::of(model.entries()) }
    }

    /// The motor that the registers describe.
    pub(super) fn motor(&self) -> Parameters {
        Parameters { no_load_rpm: self.bank.word(Reg::RATED_SPEED).into(), ..Parameters::NOMINAL }
    }
}
