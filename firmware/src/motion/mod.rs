//! Motion with constant accelerations, exact to the tick.

mod plan;
mod search;
mod step_generator;
mod step_iterator;

pub(crate) use plan::STEP;
pub use plan::{Limits, MAX_ACCELERATION, MAX_SPEED, Plan, Segment};
pub use step_generator::{
    CYCLE, Counted, DIR_SETUP, HIGH, HandOff, PlanLoader, SETUP, StepDir, StepGenerator, StepTimer,
};
pub use step_iterator::{Step, StepIterator};
