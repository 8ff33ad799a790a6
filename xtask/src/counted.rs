//! Counts instructions: runs programs under QEMU with the plugin `insncount`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::board::PROFILE;
use crate::checks::target_dir;
use crate::image::Image;

/// A processor that QEMU emulates, and the machine around it.
#[derive(Debug)]
pub(crate) struct Processor {
    pub(crate) target: &'static str,
    machine: &'static str,
}

/// A Cortex-M3, and a Cortex-M0, which executes what a Cortex-M0+ does.
pub(crate) const PROCESSORS: [Processor; 2] = [
    Processor { target: "thumbv7m-none-eabi", machine: "lm3s6965evb" },
    Processor { target: "thumbv6m-none-eabi", machine: "microbit" },
];

/// Versions of QEMU that take plugins of version 1.
const TAKES_PLUGIN: std::ops::RangeInclusive<u32> = 6..=8;

/// What a group of a program took, in instructions.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) name: String,
    /// On average, rounded up.
    pub(crate) mean: u64,
    pub(crate) most: u64,
}

/// Builds the plugin. Returns where it is.
///
/// # Errors
///
/// If QEMU is one that does not take plugins of version 1 of their interface.
pub(crate) fn plugin(sh: &Shell) -> Result<PathBuf> {
    let version = cmd!(sh, "qemu-system-arm --version").quiet().read()?;
    let major = version.split(' ').skip_while(|word| *word != "version").nth(1);
    let major: u32 = major.and_then(|version| version.split('.').next()?.parse().ok()).unwrap_or(0);
    ensure!(
        TAKES_PLUGIN.contains(&major),
        "instructions are counted with QEMU 6 to 8, whose plugins have version 1; this is {}",
        version.lines().next().unwrap_or_default()
    );
    cmd!(sh, "cargo build --quiet --release --package insncount").run()?;
    Ok(target_dir(sh).join("release/libinsncount.so"))
}

/// Runs a program of `tests/counted`, with a kind of drive if it is about one.
pub(crate) fn groups(
    sh: &Shell,
    processor: &Processor,
    program: &str,
    kind: Option<&str>,
) -> Result<Vec<Group>> {
    let Run { said, log } = run(sh, processor, program, kind, "")?;
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

/// Lets the plugin count what is known.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    for processor in &PROCESSORS {
        build(sh, processor, "known", None)?;
        let image = Image::of(sh, processor.target, PROFILE, "known")?;
        let [low, high] = ["PendSV", "SVCall"]
            .map(|name| Ok::<_, anyhow::Error>(format!(",handler={name}:{:#x}", image.symbol(name)?)));
        let Run { log, .. } = run(sh, processor, "known", None, &(low? + &high?))?;
        // As the program's comments say.
        let known = "handler PendSV calls 2 most 16\nhandler SVCall calls 2 most 4\n";
        ensure!(log == known, "{}: the plugin counts wrong:\n{log}", processor.machine);
    }
    Ok(())
}

/// What a run has left behind.
struct Run {
    said: String,
    log: String,
}

fn build(sh: &Shell, processor: &Processor, program: &str, kind: Option<&str>) -> Result<()> {
    let target = processor.target;
    let build = cmd!(
        sh,
        "cargo build --quiet --profile {PROFILE} --package counted --bin {program} --target {target}"
    );
    Ok(kind.into_iter().fold(build, |build, kind| build.env("DRIVE", kind)).run()?)
}

fn run(sh: &Shell, processor: &Processor, program: &str, kind: Option<&str>, arguments: &str) -> Result<Run> {
    let Processor { target, machine } = processor;
    let plugin = plugin(sh)?.into_os_string().into_string().ok().context("a path that is no text")?;
    build(sh, processor, program, kind)?;
    let image = target_dir(sh).join(target).join(PROFILE).join(program);
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

/// The numbers of a line of the plugin, each behind its word.
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
