//! Motion with constant accelerations, exact to the tick.

mod plan;
mod search;
mod walker;

pub use plan::{MAX_ACCELERATION, MAX_SPEED, Plan, Rates, Segment};
pub use walker::{Step, Walker};
