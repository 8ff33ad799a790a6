//! Counts instructions: runs programs under QEMU with the plugin `insncount`.

use anyhow::{Context, Result, bail, ensure};
use drivetwin_firmware::device::Spec;
use xshell::{Shell, cmd};

use crate::board::{self, PROFILE};
use crate::checks::target_dir;
use crate::image::Image;

/// A processor that QEMU emulates, and the machine that contains it.
#[derive(Debug)]
pub(crate) struct Processor {
    pub(crate) target: &'static str,
    machine: &'static str,
}

/// A Cortex-M3, and a Cortex-M0, which has the same instructions as a Cortex-M0+.
pub(crate) const PROCESSORS: [Processor; 2] = [
    Processor { target: "thumbv7m-none-eabi", machine: "lm3s6965evb" },
    Processor { target: "thumbv6m-none-eabi", machine: "microbit" },
];

/// Programs other than those of the drives.
pub(crate) const PROGRAMS: [&str; 4] = ["motion", "counter", "program", "turning"];

/// A program that tests the plugin itself.
const KNOWN: &str = "known";

/// Versions of QEMU with a known plugin interface. Versions before 9 take only the first version of the
/// interface, later ones the second.
const TAKES_PLUGIN: std::ops::RangeInclusive<u32> = 6..=10;
const TAKES_SECOND: u32 = 9;

/// Returns whether the installed QEMU takes the plugin.
pub(crate) fn takes_plugin(sh: &Shell) -> bool {
    qemu_version(sh).is_some_and(|version| TAKES_PLUGIN.contains(&version))
}

/// The major version of QEMU.
fn qemu_version(sh: &Shell) -> Option<u32> {
    let text = cmd!(sh, "qemu-system-arm --version").quiet().ignore_stderr().read().ok()?;
    text.split(' ').skip_while(|word| *word != "version").nth(1)?.split('.').next()?.parse().ok()
}

/// The kinds of drives that have a program. The counted requests arrive on a serial port, so kinds on a
/// network have none.
pub(crate) fn kinds() -> impl Iterator<Item = &'static str> {
    board::kinds().into_iter().filter(|kind| !board::spec(kind).is_some_and(Spec::is_on_network))
}

/// A group of parts of a program, with the cost of one part in instructions.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) name: String,
    /// Average cost of a part, rounded up.
    pub(crate) mean: u64,
    pub(crate) most: u64,
}

/// The plugin and the programs, after they are built.
pub(crate) struct Counting<'a> {
    sh: &'a Shell,
    /// Path of the plugin.
    pub(crate) plugin: String,
}

impl<'a> Counting<'a> {
    /// Builds the plugin for the installed QEMU, and every program for each processor.
    pub(crate) fn build(sh: &'a Shell) -> Result<Self> {
        let second = qemu_version(sh).is_some_and(|version| version >= TAKES_SECOND);
        let interface = second.then_some(["--features", "second-interface"]).into_iter().flatten();
        cmd!(sh, "cargo build --quiet --profile {PROFILE} --package insncount {interface...}").run()?;
        for Processor { target, .. } in &PROCESSORS {
            let programs = PROGRAMS.into_iter().chain([KNOWN]).chain(kinds());
            let bins = programs.flat_map(|program| ["--bin".to_owned(), name(program)]);
            cmd!(sh, "cargo build --quiet --profile {PROFILE} --package counted --target {target} {bins...}")
                .run()?;
        }
        let plugin = target_dir(sh).join(PROFILE).join("libinsncount.so");
        let plugin = plugin.into_os_string().into_string().ok().context("a path that is no text")?;
        Ok(Self { sh, plugin })
    }

    /// Runs a program of `tests/counted`.
    pub(crate) fn groups(&self, processor: &Processor, program: &str) -> Result<Vec<Group>> {
        let Run { said, log } = self.run(processor, program, "")?;
        let names = said.lines();
        let counts: Vec<[u64; 3]> = log
            .lines()
            .map(|line| numbers(line, ["group parts", "instructions", "most"]))
            .collect::<Result<_>>()?;
        ensure!(names.clone().count() == counts.len(), "{program} counted something without a name");
        names
            .zip(counts)
            .map(|(name, [parts, instructions, most])| {
                ensure!(parts > 0, "{program} never did what it calls `{name}`");
                Ok(Group { name: name.to_owned(), mean: instructions.div_ceil(parts), most })
            })
            .collect()
    }

    /// Checks the plugin with a program whose counts are known.
    pub(crate) fn check(&self) -> Result<()> {
        for processor in &PROCESSORS {
            let image = Image::of(self.sh, processor.target, PROFILE, &name(KNOWN))?;
            let [low, high] = ["PendSV", "SVCall"].map(|handler| {
                Ok::<_, anyhow::Error>(format!(",handler={handler}:{:#x}", image.symbol(handler)?))
            });
            let Run { log, .. } = self.run(processor, KNOWN, &(low? + &high?))?;
            // The counts are from the comments in the program.
            let known = "handler PendSV calls 2 most 16\nhandler SVCall calls 2 most 4\n";
            ensure!(log == known, "{}: the plugin counts wrong:\n{log}", processor.machine);
        }
        Ok(())
    }

    fn run(&self, processor: &Processor, program: &str, arguments: &str) -> Result<Run> {
        let Self { sh, plugin } = self;
        let Processor { target, machine } = processor;
        let image = target_dir(sh).join(target).join(PROFILE).join(name(program));
        let folder = sh.create_temp_dir()?;
        let log = folder.path().join("log");
        let plugin = format!("{plugin}{arguments}");
        let said = cmd!(
            sh,
            "timeout 60 qemu-system-arm -M {machine} -display none -monitor none -serial null
             -chardev stdio,id=said -semihosting-config enable=on,target=native,chardev=said
             -plugin {plugin} -d plugin -D {log} -kernel {image}"
        );
        let said = said.quiet().read().with_context(|| format!("{program} fails on {machine}"))?;
        Ok(Run { said, log: sh.read_file(log)? })
    }
}

/// Cargo's name of a program.
fn name(program: &str) -> String {
    format!("counted-{program}")
}

/// Results of a run.
struct Run {
    said: String,
    log: String,
}

/// Reads the numbers in a text line of the plugin, each after its word.
fn numbers<const N: usize>(line: &str, words: [&str; N]) -> Result<[u64; N]> {
    let mut rest = line;
    let mut numbers = [0; N];
    for (number, word) in numbers.iter_mut().zip(words) {
        let Some(begin) = rest.trim_start().strip_prefix(word) else {
            bail!("the plugin says `{line}`, not `{word}` and a number")
        };
        let text = begin.trim_start().split(' ').next().unwrap_or_default();
        *number = text.parse().with_context(|| format!("no number in `{line}`"))?;
        rest = begin.trim_start().get(text.len()..).unwrap_or_default();
    }
    Ok(numbers)
}
