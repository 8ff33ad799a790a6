//! The lines that are being typed, one on each connection.

use heapless::Vec;

use crate::device::Link;
use crate::mdrive::mcode::program::LINE_BYTES;
use crate::mdrive::mcode::serial::Called;

/// How many there may be.
pub(in crate::mdrive) const MOST: usize = 4;

/// A line as it is typed.
#[derive(Clone, Debug)]
pub(super) struct Console {
    pub(super) link: Link,
    pub(super) line: Vec<u8, LINE_BYTES>,
    /// It was too long, and has been refused: what is left of it is nothing any more.
    pub(super) refused: bool,
    /// CR was the last character: LF belongs to it.
    pub(super) returned: bool,
    pub(super) called: Called,
    /// Of program mode: the address of the next line.
    pub(super) programming: Option<u16>,
}

impl Console {
    pub(super) const fn new(link: Link) -> Self {
        Self {
            link,
            line: Vec::new(),
            refused: false,
            returned: false,
            called: Called::Plain,
            programming: None,
        }
    }
}

/// All of them.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Consoles {
    pub(super) list: Vec<Console, MOST>,
}

impl Consoles {
    pub(in crate::mdrive) const fn new() -> Self {
        Self { list: Vec::new() }
    }

    /// Whether somebody types lines that are stored.
    pub(in crate::mdrive) fn is_programming(&self) -> bool {
        self.list.iter().any(|console| console.programming.is_some())
    }

    /// The drive starts again; its connections stay.
    pub(in crate::mdrive) fn restart(&mut self) {
        for console in &mut self.list {
            *console = Console::new(console.link);
        }
    }

    /// All connections.
    pub(in crate::mdrive) fn links(&self) -> Vec<Link, MOST> {
        let mut links = Vec::new();
        for console in &self.list {
            // There is room for all.
            let _ = links.push(console.link);
        }
        links
    }

    pub(super) fn find(&mut self, link: Link) -> Option<&mut Console> {
        self.list.iter_mut().find(|console| console.link == link)
    }
}
