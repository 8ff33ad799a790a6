//! The program `standin`, started as people start it.

mod control;
mod programs;
mod qsb;
mod running;
mod runs;
