//! Scripts with times: what the list says happens, and when.
