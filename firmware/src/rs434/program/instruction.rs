//! The lines of a program: their fields, and the table of commands (6.9).
