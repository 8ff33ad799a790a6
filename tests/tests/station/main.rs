//! A drive on a board with a cable: the computer's calls, the port of the bus, and the trace.
#![allow(missing_docs, reason = "a test")]

mod bad_input;
mod bus_port;
mod calls;
mod golden;
mod power;
