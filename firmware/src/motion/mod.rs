//! Motion with constant accelerations, exact to the tick.

mod plan;
mod walker;

pub use plan::{Plan, Rates, Segment};
pub use walker::{Step, Walker};
