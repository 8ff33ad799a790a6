//! The program `drivetwin`, started as users start it.

mod benches;
mod ceilings;
mod control;
mod ends;
mod flash;
mod full_disks;
mod machinery;
mod programs;
mod ptys;
mod qsb;
mod recordings;
mod running;
mod runs;
mod scale;
mod views;
