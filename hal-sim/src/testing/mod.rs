//! Devices for tests.

pub mod echo_device;
pub mod test_device;
