//! The program `standin`, started as people start it.

mod control;
mod running;
mod runs;
