//! What the tests of several crates share.

pub mod on_shell;
pub mod toy;
