//! Motion with constant accelerations, exact to the tick.

mod plan;
mod search;
mod step_generator;
mod walker;

pub(crate) use plan::STEP;
pub use plan::{MAX_ACCELERATION, MAX_SPEED, Plan, Rates, Segment};
pub use step_generator::{CYCLE, DIR_SETUP, Followed, Follower, HIGH, SETUP, StepDir, StepTimer, Stepper};
pub use walker::{Step, Walker};
