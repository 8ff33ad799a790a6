//! The program `standin`, started as people start it.

mod control;
mod qsb;
mod running;
mod runs;
