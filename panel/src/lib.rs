//! The panel: a page that shows a bench, the state of a bench as JSON, and the viewer that says what has changed.
//!
//! The crate knows no operating system and no HTTP, so that the page can have its bench in WebAssembly, too.

pub mod faults;
pub mod live;
pub mod page;
pub mod schema;
pub mod units;
