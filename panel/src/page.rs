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
