//! `--record`, `--vcd` and `--pcap`: files that follow the bench.
//!
//! The bench's thread writes them, so it waits for a disk, or for whoever reads a pipe, that is slow: signals and
//! the control API, too.

use std::fs::File;
use std::io;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::export::pcapng::Pcapng;
use drivetwin_sim::export::vcd::Waves;
use drivetwin_sim::record::trace::Recording;
use tracing::error;

use crate::output_file::Output;

/// Waits until the disk has all of a file.
fn wait_for(file: &File) -> io::Result<()> {
    // A pipe and a device have no disk to wait for.
    if file.metadata()?.is_file() { file.sync_all() } else { Ok(()) }
}

/// What writes such a file.
trait Writer {
    /// Writes what has happened since the last time.
    fn follow(&mut self, bench: &Bench) -> io::Result<()>;
    /// Ends the file where the bench has come to.
    fn finish(self: Box<Self>, bench: &Bench) -> io::Result<()>;
}

impl Writer for Recording<File> {
    fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench.trace())
    }

    fn finish(self: Box<Self>, bench: &Bench) -> io::Result<()> {
        Self::finish(*self, bench.trace()).map(|_| ())
    }
}

impl Writer for Waves<File> {
    fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench.trace())
    }

    fn finish(self: Box<Self>, _: &Bench) -> io::Result<()> {
        Self::finish(*self)
    }
}

impl Writer for Pcapng<File> {
    fn follow(&mut self, bench: &Bench) -> io::Result<()> {
        Self::follow(self, bench)
    }

    fn finish(self: Box<Self>, _: &Bench) -> io::Result<()> {
        Self::finish(*self)
    }
}

/// A file that is written while the bench goes on, from what that still holds.
pub(crate) struct Followed {
    output: Output,
    /// `None` when it has failed.
    writer: Option<Box<dyn Writer>>,
}

impl Followed {
    /// Begins a recording.
    pub(crate) fn recording(output: Output, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Recording::new(bench.trace(), file)?)))
    }

    /// Begins a file of the waveforms of the pins.
    pub(crate) fn waves(output: Output, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Waves::new(bench.trace(), file)?)))
    }

    /// Begins a file of the frames of the lines.
    pub(crate) fn frames(output: Output, bench: &Bench) -> Result<Self, String> {
        Self::begin(output, |file| Ok(Box::new(Pcapng::new(bench, file)?)))
    }

    fn begin(
        output: Output,
        write: impl FnOnce(File) -> io::Result<Box<dyn Writer>>,
    ) -> Result<Self, String> {
        output.begin()?;
        let writer = Some(output.fails(output.file().try_clone().and_then(write))?);
        Ok(Self { output, writer })
    }

    /// Writes what has happened since the last time. A file that cannot be written is told once, and
    /// the drives go on without.
    pub(crate) fn follow(&mut self, bench: &Bench) {
        if let Some(writer) = &mut self.writer
            && let Err(sentence) = self.output.fails(writer.follow(bench))
        {
            error!("{sentence}; the file ends here");
            self.writer = None;
        }
    }

    /// Ends the file where the bench has come to.
    pub(crate) fn finish(mut self, bench: &Bench) -> Result<(), String> {
        self.follow(bench);
        match self.writer {
            // Some systems tell only then that a write has failed.
            Some(writer) => {
                self.output.fails(writer.finish(bench).and_then(|()| wait_for(self.output.file())))
            }
            None => Err(format!("{} {} is not complete", self.output.option(), self.output.path().display())),
        }
    }
}
