//! `drivetwin reference`: prints docs/reference/cli.md, the page about the command line.

use std::fmt::Write as _;

use clap::{Arg, Command, CommandFactory as _};

use crate::args::Cli;

use super::print;

/// Text before the commands.
const HEAD: &str = "\
<!-- Made by `drivetwin reference`; not to be edited. -->

# Command line

`drivetwin COMMAND --help` prints the same text in a terminal.
";

/// Text after the commands.
const TAIL: &str = "
## Exit codes

| Code | Meaning |
|---|---|
| 0 | success; also if a signal has ended `run` |
| 1 | `replay` has found a difference |
| 2 | wrong usage, or a file or a port that cannot be used. On stderr is one sentence that begins with `drivetwin: ` |

The log goes to stderr and has one line for each event. By default it contains warnings and errors. With `-v` it also
contains each client that connects or disconnects, and each message to a drive. With `-vv` it contains all events, with `-q`
only errors. The environment variable `RUST_LOG` has priority over these options. With `NO_COLOR` the log has no colours.
";

/// Prints the page.
///
/// # Errors
/// One sentence that says what is wrong: stdout cannot be written.
pub(crate) fn reference() -> Result<(), String> {
    print(&page())
}

fn page() -> String {
    let mut cli = Cli::command();
    cli.build();
    let mut text = HEAD.to_owned();
    let _ = write!(text, "\n## All commands\n\n");
    options("Option", cli.get_arguments().filter(|arg| !is_of_clap(arg)), &mut text);
    for command in cli.get_subcommands_mut().filter(|command| !command.is_hide_set()) {
        section(command, &mut text);
    }
    text + TAIL
}

/// Returns whether clap adds the option by itself.
fn is_of_clap(arg: &Arg) -> bool {
    ["help", "version"].contains(&arg.get_id().as_str())
}

fn section(command: &mut Command, text: &mut String) {
    let usage = command.render_usage().to_string();
    let usage = usage.trim_start_matches("Usage: ");
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let _ = write!(text, "\n## `drivetwin {}`\n\n{about}.\n\n```text\n{usage}\n```\n", command.get_name());
    let mut headings: Vec<Option<&str>> = Vec::new();
    let own = || command.get_arguments().filter(|arg| !is_of_clap(arg) && !arg.is_global_set());
    for arg in own() {
        if !headings.contains(&arg.get_help_heading()) {
            headings.push(arg.get_help_heading());
        }
    }
    headings.sort_by_key(Option::is_some);
    for heading in headings {
        if let Some(heading) = heading {
            let _ = write!(text, "\n{heading}:\n");
        }
        text.push('\n');
        options("Argument", own().filter(|arg| arg.get_help_heading() == heading), text);
    }
}

fn options<'a>(title: &str, args: impl Iterator<Item = &'a Arg>, text: &mut String) {
    let _ = write!(text, "| {title} | What |\n|---|---|\n");
    for arg in args {
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        let possible: Vec<String> = arg
            .get_possible_values()
            .iter()
            .filter(|_| arg.get_num_args().is_some_and(|count| count.takes_values()))
            .map(|value| {
                format!(
                    "`{}`: {}",
                    value.get_name(),
                    value.get_help().map(ToString::to_string).unwrap_or_default()
                )
            })
            .collect();
        let mut cell = help.split_whitespace().collect::<Vec<_>>().join(" ");
        if !possible.is_empty() {
            let _ = write!(cell, "; {}", possible.join(", "));
        }
        let default: Vec<_> = arg.get_default_values().iter().map(|value| value.to_string_lossy()).collect();
        if !default.is_empty() && arg.get_num_args().is_some_and(|count| count.takes_values()) {
            let _ = write!(cell, " [default: {}]", default.join(" "));
        }
        let _ = writeln!(text, "| `{}` | {} |", name(arg).replace('|', "\\|"), cell.replace('|', "\\|"));
    }
}

/// An option as a user types it: `-o, --output <FILE>`.
fn name(arg: &Arg) -> String {
    let values = arg.get_value_names().unwrap_or_default().iter().map(|value| format!("<{value}>"));
    let values = values.collect::<Vec<_>>().join(" ");
    if arg.is_positional() {
        return values;
    }
    let short = arg.get_short().map(|short| format!("-{short}"));
    let long = arg.get_long().map(|long| format!("--{long}"));
    let names: Vec<String> = short.into_iter().chain(long).collect();
    let takes_values = arg.get_num_args().is_some_and(|count| count.takes_values());
    if takes_values { format!("{} {values}", names.join(", ")) } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_every_command_and_option() {
        let page = page();
        let cli = Cli::command();
        for command in cli.get_subcommands().filter(|command| !command.is_hide_set()) {
            let (_, section) =
                page.split_once(&format!("\n## `drivetwin {}`\n", command.get_name())).unwrap();
            let section = section.split("\n## ").next().unwrap();
            for long in command.get_arguments().filter_map(Arg::get_long) {
                assert!(section.contains(&format!("--{long}")), "{} {long}", command.get_name());
            }
        }
        assert!(page.contains("| `-v, --verbose` |") && !page.contains("drivetwin reference`\n"));
    }
}
