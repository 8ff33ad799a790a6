//! *Modbus Protocol on the MD Controller* V1.1 as a test: its PIDs, its commands, its functions, and the causes that
//! drive and stop the motor, over the bus and the pins, as a master sees them. Values are typed from the manual or
//! come from the arithmetic in the comments.
//!
//! Where the manual is silent or contradicts itself docs/decisions holds what the project has decided (`MDROBOT-5`),
//! and the reasons for the tolerances of motion. Numbers like p. 6 are the manual's pages.
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
