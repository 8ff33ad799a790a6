//! The configuration of a bench: as plain data, as a file, and its values as users write them.

pub mod bench_file;
pub mod board_place;
pub mod layout;
pub mod listen;
pub mod preset;
pub mod time_mode;
mod warnings;
