//! `drivetwin plot`: draws a trace.

use std::io::{self, Read as _};
use std::path::Path;

use drivetwin_sim::catalog;
use drivetwin_sim::export::plot::{self, Options};

use super::{print, trace};
use crate::args::Plot;
use crate::log;

/// Draws a trace as an SVG, to a file or to stdout.
///
/// # Errors
/// One sentence that names the file or the option, and the error.
pub(crate) fn plot(arguments: Plot) -> Result<(), String> {
    let Plot { file, output, from, to, drive } = arguments;
    if let Some(output) = &output
        && output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("svg"))
    {
        let path = output.display();
        return Err(format!("-o {path}: the name must end in .svg, because only SVG is drawn"));
    }
    let (name, bytes) = if file == "-" {
        let mut bytes = Vec::new();
        io::stdin().lock().read_to_end(&mut bytes).map_err(|error| format!("standard input: {error}"))?;
        ("standard input", bytes)
    } else {
        (file.as_str(), std::fs::read(&file).map_err(|error| format!("{file}: {error}"))?)
    };
    let (trace, is_cut) = trace(name, &bytes)?;
    if is_cut {
        log::write_line(format!("{name}: the last line is incomplete and is ignored\n").as_bytes());
    }
    let title = Path::new(&file).file_name().map(|name| name.to_string_lossy().into_owned());
    let title = title.filter(|_| file != "-").unwrap_or_default();
    let options = Options { title, from, to, drives: drive };
    let make = |kind: &str| catalog::make(kind).ok();
    let picture = plot::svg(&trace, &make, &options).map_err(|error| format!("{name}: {error}"))?;
    match output {
        None => print(&picture),
        Some(path) => {
            std::fs::write(&path, picture).map_err(|error| format!("-o {}: {error}", path.display()))
        }
    }
}
