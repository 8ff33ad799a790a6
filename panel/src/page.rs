//! Files of the page, embedded in the program.

use std::borrow::Cow;

use rust_embed::Embed;

#[derive(Embed)]
#[folder = "page"]
struct Files;

/// A file of the page.
pub struct File {
    /// Its content.
    pub bytes: Cow<'static, [u8]>,
    /// Its media type, for instance `text/css; charset=utf-8`.
    pub media: String,
    /// Tag that changes with the content: hexadecimal digits.
    pub tag: String,
}

/// Name of the file that a browser opens first.
pub const FIRST: &str = "index.html";

/// Policy of the page for the browser: everything comes from where the page is.
pub const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
                          connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The file with that name.
#[must_use]
pub fn file(name: &str) -> Option<File> {
    let found = Files::get(name)?;
    let media = found.metadata.mimetype();
    let is_text = media.starts_with("text/") || media == "image/svg+xml";
    let media = if is_text { format!("{media}; charset=utf-8") } else { media.to_owned() };
    let hash = found.metadata.sha256_hash();
    let tag = hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    Some(File { bytes: found.data, media, tag })
}

/// Names of all files.
pub fn names() -> impl Iterator<Item = Cow<'static, str>> {
    Files::iter()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names of the modules that a module imports.
    fn imports(module: &str) -> Vec<String> {
        let file = file(module).unwrap_or_else(|| panic!("there is no {module}"));
        let text = String::from_utf8(file.bytes.into_owned()).expect("text");
        let names = text.lines().filter_map(|line| {
            let is_import = line.starts_with("import ") || line.starts_with("export {");
            line.split_once("from \"./")
                .filter(|_| is_import)?
                .1
                .split_once('"')
                .map(|(name, _)| name.to_owned())
        });
        names.collect()
    }

    /// A browser asks for all modules at once, and needs three files for its first picture.
    #[test]
    fn the_first_picture_needs_little() {
        let page = file(FIRST).expect("the page");
        let text = String::from_utf8(page.bytes.into_owned()).expect("text");
        let mut preloaded: Vec<&str> = text
            .split("rel=\"modulepreload\" href=\"panel/")
            .skip(1)
            .filter_map(|rest| rest.split('"').next())
            .collect();
        let mut used = vec!["main.js".to_owned()];
        let mut at = 0;
        while let Some(module) = used.get(at).cloned() {
            for name in imports(&module) {
                if !used.contains(&name) {
                    used.push(name);
                }
            }
            at += 1;
        }
        preloaded.sort_unstable();
        used.sort_unstable();
        assert_eq!(preloaded, used);
        // Only the sheet and the choice of light or dark hold the first picture up.
        let blocking = text.matches("rel=\"stylesheet\"").count() + text.matches("<script src").count();
        assert_eq!(blocking, 2);
        let bytes: usize = ["index.html", "panel.css", "theme.js"]
            .map(|name| file(name).map_or(0, |file| file.bytes.len()))
            .iter()
            .sum();
        assert!(bytes < 48 << 10, "{bytes} bytes until the first picture");
        let all: usize = names().filter_map(|name| file(&name)).map(|file| file.bytes.len()).sum();
        assert!(all < 200_000, "the page has {all} bytes");
    }

    #[test]
    fn browsers_execute_modules_and_apply_styles_by_their_media_types() {
        for (name, media) in [
            ("index.html", "text/html; charset=utf-8"),
            ("panel.css", "text/css; charset=utf-8"),
            ("main.js", "text/javascript; charset=utf-8"),
            ("favicon.svg", "image/svg+xml; charset=utf-8"),
        ] {
            assert_eq!(file(name).map(|file| file.media).as_deref(), Some(media), "{name}");
        }
        assert!(file("../Cargo.toml").is_none() && file("").is_none());
    }
}
