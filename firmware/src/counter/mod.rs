//! What counts edges: the LS7366R.

mod ls7366r;

pub use ls7366r::{Channel, Ls7366r, status};
