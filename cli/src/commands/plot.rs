//! `drivetwin plot`: draws a trace.

use std::path::Path;

use drivetwin_sim::catalog;
use drivetwin_sim::export::plot::{self, Options};

use super::{print, read_trace};
use crate::args::Plot;
use crate::{log, png};

/// Draws a trace as an SVG to a file or to stdout, or as a PNG to a file.
///
/// # Errors
/// One sentence that names the file or the option, and the error.
pub(crate) fn plot(arguments: Plot) -> Result<(), String> {
    let Plot { file, output, from, to, drive } = arguments;
    let ends_in = |path: &Path, end| path.extension().is_some_and(|is| is.eq_ignore_ascii_case(end));
    let is_png = output.as_ref().is_some_and(|path| ends_in(path, "png"));
    if let Some(path) = &output
        && !is_png
        && !ends_in(path, "svg")
    {
        return Err(format!("-o {}: the name must end in .svg or .png", path.display()));
    }
    let (name, trace, is_cut) = read_trace(&file)?;
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
            let wrong = |error| format!("-o {}: {error}", path.display());
            let picture = if is_png { png::from_svg(&picture).map_err(wrong)? } else { picture.into_bytes() };
            std::fs::write(&path, picture).map_err(|error| wrong(error.to_string()))
        }
    }
}
