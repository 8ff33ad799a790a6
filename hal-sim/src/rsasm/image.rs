//! A program in the memory of a drive, where a save stores it (6.6).

use drivetwin_firmware::rs434::{MEMORY, program};

/// A program as it is stored in a drive's memory.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Image {
    /// Offset of the first byte in the memory.
    pub offset: u16,
    /// Lines of the program and their checksum, up to the end of the memory.
    pub bytes: Vec<u8>,
}

impl Image {
    /// The image of an assembled program, one word per line.
    #[must_use]
    pub fn of(program: &[u32]) -> Self {
        let bytes = program::image(program.iter().copied()).to_vec();
        Self { offset: (MEMORY - bytes.len()) as u16, bytes }
    }

    /// Writes the image to the content of a drive's memory.
    pub fn put_into(&self, memory: &mut [u8]) {
        for (place, byte) in memory.iter_mut().skip(self.offset.into()).zip(&self.bytes) {
            *place = *byte;
        }
    }

    /// The memory of a factory-new drive with only this program in it, for [`Setup`](crate::bench::Setup).
    #[must_use]
    pub fn memory(&self) -> Vec<u8> {
        let mut memory = vec![0xFF; MEMORY];
        self.put_into(&mut memory);
        memory
    }
}
