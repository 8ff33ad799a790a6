//! *Modbus Protocol on the MD Controller* V1.1 as a test. A master on the bus and drivers at the pins check
//! the PIDs, the commands, the functions, and everything that drives or stops the motor. Values are typed
//! from the manual or computed in the comments.
//!
//! Where the manual is silent or contradicts itself, docs/decisions has the project's decision (`MDROBOT-5`),
//! and the reasons for the tolerances of motion. Numbers like p. 6 are pages of the manual.
#![allow(missing_docs, reason = "a test")]

mod alarms;
mod arming;
mod bus;
mod commands;
mod ctrl;
mod encoder;
mod functions;
mod later;
mod limits;
mod motion;
mod pid;
mod pids;
mod positions;
mod rig;
mod saved;
mod speed_inputs;
mod table;
mod velocity;
