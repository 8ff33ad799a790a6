//! Motion with constant accelerations, exact to the tick.

mod plan;

pub use plan::{Plan, Rates, Segment};
