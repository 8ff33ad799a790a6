//! Table of the cost of each drive, measured and compared with its [budgets](crate::budgets).

use anyhow::{Result, bail, ensure};
use xshell::Shell;

use crate::board::{BOARDS, kinds};
use crate::budgets::{BUDGETS, Budget, NO_BUDGET, PLACES};
use crate::counted::{self, Counting, Group, PROCESSORS, PROGRAMS, Processor};
use crate::image::Sizes;
use crate::tools::{Tool, Tools};
use crate::{interrupts, panic_free, uf2};

/// Tools for measuring.
pub(crate) const NEEDS: [Tool; 3] = [Tool::ThumbTargets, Tool::Counting, Tool::Node];

/// Installs the tools for measuring, and measures.
pub(crate) fn print(sh: &Shell) -> Result<()> {
    if let Some(remedy) = Tools::default().missing(sh, &NEEDS) {
        bail!("{remedy}");
    }
    check(sh)
}

/// Measures everything, prints the table, and fails if a value exceeds its budget.
pub(crate) fn check(sh: &Shell) -> Result<()> {
    for board in &BOARDS {
        board.all(sh)?;
    }
    // No test needs this file, so its sizes are checked here.
    uf2::write(sh, &uf2::PICO_2)?;
    for Processor { target, .. } in &PROCESSORS {
        panic_free::link(sh, target, &[])?;
    }
    let counting = Counting::build(sh)?;
    counting.check()?;
    let mut table = Table::default();
    for kind in kinds() {
        sizes(sh, kind, &mut table)?;
    }
    for work in &interrupts::WORKS {
        let kind = work.kind;
        for (place, worst) in interrupts::worst(sh, &counting, work)?.into_iter().enumerate() {
            table.put(place, format!("{kind}: stack in use, bytes"), worst.stack);
            for (interrupt, most) in worst.interrupts {
                table.put(place, format!("{kind}: {interrupt}, at worst"), most);
            }
        }
    }
    for (place, processor) in PROCESSORS.iter().enumerate() {
        for program in PROGRAMS {
            for group in counting.groups(processor, program)? {
                table.instructions(place, &group.name, &group);
            }
        }
        for kind in counted::kinds() {
            for group in counting.groups(processor, kind)? {
                table.instructions(place, &format!("{kind}: {}", group.name), &group);
            }
        }
    }
    table.print();
    table.judge()
}

/// Measures the images with a kind of drive, and the drive without a board.
fn sizes(sh: &Shell, kind: &str, table: &mut Table) -> Result<()> {
    for (place, board) in BOARDS.iter().enumerate().filter(|(_, board)| board.carries(kind)) {
        let image = board.image(sh, kind)?;
        let Sizes { flash, ram, stack } = image.sizes()?;
        table.put(place, format!("{kind}: flash, bytes"), flash);
        table.put(place, format!("{kind}: RAM with its stack, bytes"), ram);
        table.put(place, format!("{kind}: stack, bytes"), stack);
        table.put(place, format!("{kind}: calls of a panic"), image.panic_sites()?);
    }
    for (place, processor) in PROCESSORS.iter().enumerate() {
        let Sizes { flash, ram, .. } = panic_free::sizes(sh, processor.target, kind)?;
        table.put(place, format!("{kind} without a board: flash, bytes"), flash);
        table.put(place, format!("{kind} without a board: RAM, bytes"), ram);
    }
    Ok(())
}

/// Measured values in the order of measurement, on each board or its processor: see [`Budget`].
#[derive(Default)]
struct Table(Vec<(String, [Option<u64>; PLACES])>);

/// Headings of the table's columns.
const HEADS: [&str; PLACES] = ["M3, lm3s6965", "M0+, rp2040", "M4F, stm32f4", "M33, rp2350"];

impl Table {
    fn put(&mut self, place: usize, what: String, value: u64) {
        let row = self.0.iter().position(|(known, _)| *known == what).unwrap_or_else(|| {
            self.0.push((what, [None; PLACES]));
            self.0.len() - 1
        });
        self.0[row].1[place] = Some(value);
    }

    fn instructions(&mut self, place: usize, what: &str, group: &Group) {
        self.put(place, what.to_owned(), group.mean);
        if group.most != group.mean {
            self.put(place, format!("{what}, at worst"), group.most);
        }
    }

    fn print(&self) {
        let heads: String = HEADS.iter().map(|head| format!(" {head:>19}")).collect();
        println!("{:<66}{heads}", "instructions, or what is said");
        println!("{:<66}{}", "", format!(" {:>9} {:>9}", "measured", "at most").repeat(PLACES));
        for (what, values) in &self.0 {
            print!("{what:<66}");
            for (place, value) in values.iter().enumerate() {
                print!(
                    " {:>9} {:>9}",
                    shown(*value),
                    shown(budget(what).map(|budget| budget.most[place]).filter(|most| *most != NO_BUDGET))
                );
            }
            println!();
        }
    }

    /// Fails if a value exceeds its budget, was not measured, or has no budget.
    fn judge(&self) -> Result<()> {
        let mut wrong = Vec::new();
        for (what, values) in &self.0 {
            for (place, value) in values.iter().enumerate() {
                match (value, budget(what)) {
                    (Some(value), Some(budget)) if *value <= budget.most[place] => {}
                    (Some(value), Some(Budget { most, why, .. })) => {
                        wrong.push(format!(
                            "{what} on the {}: {value}, at most {} ({why})",
                            name(place),
                            most[place]
                        ));
                    }
                    (Some(_), None) => wrong.push(format!("{what}: it has no budget")),
                    (None, Some(Budget { most, .. })) if most[place] == NO_BUDGET => {}
                    (None, _) => wrong.push(format!("{what} was not measured on the {}", name(place))),
                }
            }
        }
        let measured = |what| self.0.iter().any(|(known, _)| known == what);
        wrong.extend(
            BUDGETS
                .iter()
                .filter(|budget| !measured(budget.what))
                .map(|budget| format!("{}: it has a budget, but nobody measured it", budget.what)),
        );
        ensure!(wrong.is_empty(), "xtask/src/budgets.rs does not hold:\n  {}", wrong.join("\n  "));
        Ok(())
    }
}

fn budget(what: &str) -> Option<&'static Budget> {
    BUDGETS.iter().find(|budget| budget.what == what)
}

fn name(place: usize) -> &'static str {
    BOARDS[place].name
}

fn shown(value: Option<u64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}
