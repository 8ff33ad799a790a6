//! The panel: a page that shows a bench, what the control API says as JSON, and the viewer that says what has changed.
//!
//! The crate knows no operating system and no HTTP, so that the page can have its bench in WebAssembly, too.

pub mod describe;
pub mod faults;
pub mod live;
pub mod page;
pub mod requests;
pub mod schema;
pub mod units;
