//! Names of registers.

use std::borrow::Cow;

use drivetwin_protocol::registers::Register;

use crate::kinds::{md3, mdrive, mdrobot, qsb, rs434};

/// Name of a register: text as in the manual, or an entry of a drive's `Reg` (of an
/// MDROBOT `Pid`, as its manual says), for instance [`md3::Reg::Speed`].
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RegisterName(pub(crate) Cow<'static, str>);

impl From<&'static str> for RegisterName {
    fn from(name: &'static str) -> Self {
        Self(Cow::Borrowed(name))
    }
}

impl From<String> for RegisterName {
    fn from(name: String) -> Self {
        Self(Cow::Owned(name))
    }
}

impl RegisterName {
    /// Name of a register in the register map of a drive, also of one from another crate.
    #[must_use]
    pub fn of<R: Register>(register: R) -> Self {
        Self(Cow::Borrowed(R::TABLE.rows.get(register.row()).map_or("", |row| row.name)))
    }
}

impl From<md3::Reg> for RegisterName {
    fn from(register: md3::Reg) -> Self {
        Self::of(register)
    }
}

impl From<qsb::Reg> for RegisterName {
    fn from(register: qsb::Reg) -> Self {
        Self::of(register)
    }
}

impl From<rs434::Reg> for RegisterName {
    fn from(register: rs434::Reg) -> Self {
        Self::of(register)
    }
}

impl From<mdrobot::Pid> for RegisterName {
    fn from(register: mdrobot::Pid) -> Self {
        Self::of(register)
    }
}

impl From<mdrive::Reg> for RegisterName {
    fn from(register: mdrive::Reg) -> Self {
        Self::of(register)
    }
}
