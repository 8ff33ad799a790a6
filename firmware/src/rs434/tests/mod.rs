//! Scripts with times: what the manual says happens, and when.
