//! A bench without ports, for programs that have it in their own process.

use std::path::Path;

use drivetwin_sim::bench::{Bench, DriveId, Settings};
use drivetwin_sim::config::bench_file;
use drivetwin_sim::config::layout::{Added, Built, Layout};

use super::Configuration;
use super::memories::{Memory, store_programs};

/// A bench that was built from a [`Configuration`] without its ports, and the files of its memories.
pub struct Offline {
    /// The bench, on virtual time.
    pub bench: Bench,
    /// Files of the memories.
    pub memories: Memories,
}

/// Files of non-volatile memories. Each byte is written when its drive stores it.
#[derive(Default)]
pub struct Memories(Vec<Memory>);

impl Memories {
    /// Waits until the files are on the disk.
    ///
    /// # Errors
    /// One sentence: the files that do not contain everything that their drives stored.
    pub fn sync(&self) -> Result<(), String> {
        let failures: Vec<String> = self.0.iter().filter_map(|memory| memory.sync().err()).collect();
        if failures.is_empty() { Ok(()) } else { Err(failures.join("; ")) }
    }

    /// Adds the files of other drives.
    pub fn extend(&mut self, others: Self) {
        self.0.extend(others.0);
    }
}

impl Configuration {
    /// Builds the bench, with memories and user programs from their files. No port is opened. `settings` changes the
    /// settings of the layout.
    ///
    /// ```
    /// use drivetwin_host::Configuration;
    /// use drivetwin_host::options::RunOptions;
    ///
    /// let options = RunOptions { what: "md3".into(), fast_boot: true, ..RunOptions::default() };
    /// let offline = Configuration::read(options)?.offline(|settings| settings)?;
    /// assert_eq!(offline.bench.drives().len(), 1);
    /// # Ok::<(), String>(())
    /// ```
    ///
    /// # Errors
    /// One sentence that names the file or drive, and the error.
    pub fn offline(&self, settings: impl FnOnce(Settings) -> Settings) -> Result<Offline, String> {
        self.layout.check_emulated().map_err(|sentence| self.wrong(&sentence))?;
        let programs = self.programs()?;
        let memories = self.memories(&programs)?;
        let setups = memories.iter().map(Memory::setup).collect();
        let built = self.layout.build(settings(self.layout.settings()), setups);
        let Built { mut bench, .. } = built.map_err(|sentence| self.wrong(&sentence))?;
        store_programs(&memories, &programs)?;
        // A drive may change its line after it has read its pins.
        bench.run_until(bench.now());
        Ok(Offline { bench, memories: Memories(memories) })
    }

    /// Adds the single drive of these options to a bench, with this name. `motor` is the text of a table `[[motor]]`
    /// for it, or empty.
    ///
    /// # Errors
    /// One sentence that names the option, file or drive, and the error. The bench is then unchanged, unless the error
    /// is in the motor.
    pub fn add_to(
        mut self,
        bench: &mut Bench,
        name: &str,
        motor: &str,
    ) -> Result<(DriveId, Memories), String> {
        let programs = self.programs()?;
        let memories = self.memories(&programs)?;
        let mut layout = Layout::of(bench);
        let index = layout.drives.len();
        for mut drive in self.layout.drives.drain(..) {
            name.clone_into(&mut drive.name);
            layout.drives.push(drive);
        }
        let layout = bench_file::parse_more(motor, layout).map_err(|error| error.what)?;
        let setups = memories.iter().map(Memory::setup).collect();
        let Added { drives, .. } = layout.add_to(bench, setups)?;
        store_programs(&memories, &programs)?;
        bench.run_until(bench.now());
        let drive = drives.get(index).copied().ok_or("a bench file is not a single drive")?;
        Ok((drive, Memories(memories)))
    }

    /// Reads the text of a bench file. Its paths are relative to `folder`.
    ///
    /// # Errors
    /// One sentence with the place in the text, and the error.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, String> {
        let variable = |name: &str| std::env::var(name).ok();
        let mut layout = bench_file::parse_with(text, &variable).map_err(|error| error.to_string())?;
        layout.relative_to(folder);
        Ok(Self::of_layout(layout))
    }
}
