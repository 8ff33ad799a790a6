//! The static site: the panel, and its bench in WebAssembly, as files for any server of files.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use crate::checks::target_dir;
use crate::tools::{Tool, Tools};

/// The target of the module.
pub(crate) const TARGET: &str = "wasm32-unknown-unknown";

/// Largest size of the module in bytes: a person waits for it.
const MOST: u64 = 2_000_000;

/// Policy of the page for the browser: that of the panel, and WebAssembly. A `meta` takes no `frame-ancestors`.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; \
                      img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'";

/// Name of the module in the site.
const MODULE: &str = "drivetwin.wasm";

/// Module of the panel that the site has no use for: calls of a server.
const CALLS: &str = "http.js";

/// A site that was written.
pub(crate) struct Site {
    /// Folder of its files.
    pub(crate) folder: PathBuf,
    /// Size of its module in bytes.
    size: u64,
}

/// Writes the site to a folder, and prints where it is and how large.
pub(crate) fn print(sh: &Shell, folder: Option<&str>) -> Result<()> {
    if let Some(remedy) = Tools::default().missing(sh, &[Tool::WebTarget]) {
        bail!("{remedy}");
    }
    let folder = match folder {
        Some(folder) => std::env::current_dir()?.join(folder),
        None => place(sh),
    };
    let Site { folder, size } = write_to(sh, folder)?;
    println!("{}: for any server of files; its module has {} kB", folder.display(), size / 1000);
    Ok(())
}

/// Writes the site to the folder of the builds.
pub(crate) fn write(sh: &Shell) -> Result<Site> {
    write_to(sh, place(sh))
}

fn place(sh: &Shell) -> PathBuf {
    target_dir(sh).join("site")
}

/// Builds the module, and checks its size. Returns its path and its size in bytes.
pub(crate) fn build(sh: &Shell) -> Result<(PathBuf, u64)> {
    cmd!(sh, "cargo build --package drivetwin-site --profile web --target {TARGET}").run()?;
    let module = target_dir(sh).join(TARGET).join("web/drivetwin_site.wasm");
    let size = std::fs::metadata(&module).with_context(|| module.display().to_string())?.len();
    ensure!(size <= MOST, "the module of the site has {size} bytes, more than {MOST}");
    Ok((module, size))
}

fn write_to(sh: &Shell, folder: PathBuf) -> Result<Site> {
    let (module, size) = build(sh)?;
    let panel = folder.join("panel");
    // A folder of that name may be anything, for instance the source of the panel.
    ensure!(
        !panel.exists() || panel.join(MODULE).exists(),
        "{} is there and no part of a site; choose another folder",
        panel.display()
    );
    sh.remove_path(&panel)?;
    sh.create_dir(&panel)?;
    sh.copy_file(&module, panel.join(MODULE))?;
    // A module of the site takes the place of the panel's with the same name.
    for source in ["panel/page", "panel/site/page"] {
        for file in sh.read_dir(source)? {
            let name = file.file_name().unwrap_or_default();
            if name != "index.html" && name != CALLS {
                sh.copy_file(&file, panel.join(name))?;
            }
        }
    }
    sh.copy_file("panel/site/bench.toml", panel.join("bench.toml"))?;
    sh.write_file(folder.join("index.html"), index(&sh.read_file("panel/page/index.html")?)?)?;
    Ok(Site { folder, size })
}

/// The first file of the site, from that of the panel.
fn index(panel: &str) -> Result<String> {
    let policy = format!("<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">");
    let preload = |name: &str| format!("<link rel=\"modulepreload\" href=\"panel/{name}\">");
    let modules: Vec<String> =
        ["bench.js", "module.js", "notes.js", "buttons.js", "tries.js"].map(preload).to_vec();
    let style = "<link rel=\"stylesheet\" href=\"panel/panel.css\">";
    let changes = [
        ("<meta charset=\"utf-8\">", format!("<meta charset=\"utf-8\">\n{policy}")),
        (style, format!("{style}\n<link rel=\"stylesheet\" href=\"panel/site.css\">")),
        (&preload(CALLS), modules.join("\n")),
        (" The bench also answers programs: see api/bench and openapi.json.", String::new()),
        ("Connecting to the bench…", "Loading the bench…".to_owned()),
    ];
    let mut page = panel.to_owned();
    for (old, new) in changes {
        ensure!(page.matches(old).count() == 1, "panel/page/index.html has not once: {old}");
        page = page.replacen(old, &new, 1);
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_allows_webassembly_and_nothing_from_elsewhere() {
        let page = index(include_str!("../../panel/page/index.html")).expect("a page");
        assert!(page.contains("script-src 'self' 'wasm-unsafe-eval'"));
        assert!(page.contains("panel/site.css") && page.contains("panel/bench.js"));
        assert!(!page.contains("http.js") && !page.contains("=\"/") && !page.contains("://"));
    }
}
