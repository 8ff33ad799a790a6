//! Pictures as PNG, with the feature `png` (HOST-25).

/// Converts a picture from SVG to PNG, at twice its size in pixels.
///
/// # Errors
/// One sentence: the picture is too high.
#[cfg(feature = "png")]
pub(crate) fn from_svg(svg: &str) -> Result<Vec<u8>, String> {
    use resvg::tiny_skia::{Pixmap, Transform};
    use resvg::usvg::{Options, Tree};

    /// Pixels of a PNG for one of the SVG.
    const SCALE: f32 = 2.0;
    /// Greatest height in pixels, so that a picture takes at most 160 MB of memory.
    const HIGHEST: u32 = 16_384;

    let mut options = Options::default();
    let fonts = options.fontdb_mut();
    fonts.load_font_data(epaint_default_fonts::UBUNTU_LIGHT.to_vec());
    fonts.set_sans_serif_family("Ubuntu");
    // The font has no arrow.
    let tree = Tree::from_str(&svg.replace('→', "-&gt;"), &options).map_err(|error| error.to_string())?;
    let size = tree.size().to_int_size().scale_by(SCALE).filter(|size| size.height() <= HIGHEST);
    let map = size.and_then(|size| Pixmap::new(size.width(), size.height()));
    let mut map = map.ok_or_else(|| {
        let most = HIGHEST as f32 / SCALE;
        let height = tree.size().height();
        format!(
            "the picture is {height} px high, and a PNG has at most {most}; choose drives with --drive, or draw an \
             SVG"
        )
    })?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut map.as_mut());
    map.encode_png().map_err(|error| error.to_string())
}

/// Reports that this program cannot draw a PNG.
///
/// # Errors
/// One sentence, always.
#[cfg(not(feature = "png"))]
pub(crate) fn from_svg(_svg: &str) -> Result<Vec<u8>, String> {
    Err("this program was built without PNG; install it with '--features png', or draw an SVG".to_owned())
}

#[cfg(all(test, feature = "png"))]
mod tests {
    use super::from_svg;
    use drivetwin_sim::catalog;
    use drivetwin_sim::export::plot::{self, Options};
    use drivetwin_sim::record::trace::Trace;
    use resvg::tiny_skia::Pixmap;

    const CURVE: [u8; 3] = [0x25, 0x63, 0xEB];

    #[test]
    fn a_picture_has_curves_and_words() {
        let make = |kind: &str| catalog::make(kind).ok();
        let text = "drivetwin trace 1\ndrive x md3 fast\n100 > rx 01 06 00 11 00 01 18 0F\n3000 end\n";
        let trace = Trace::parse(text, &make).unwrap();
        let options = Options { title: "A move".to_owned(), ..Options::default() };
        let svg = plot::svg(&trace, &make, &options).unwrap();
        let picture = Pixmap::decode_png(&from_svg(&svg).unwrap()).unwrap();
        assert_eq!(picture.width(), 2_400);
        let colours = |from: (u32, u32), to: (u32, u32)| {
            let rows = (from.1..to.1).flat_map(|y| (from.0..to.0).map(move |x| (x, y)));
            let pixels = rows.map(|(x, y)| picture.pixel(x, y).unwrap());
            pixels.map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]).collect::<Vec<_>>()
        };
        assert_eq!(colours((0, 0), (1, 1)), [[0xFF; 3]]);
        let is_dark = |pixel: &&[u8; 3]| pixel.iter().all(|part| *part < 0x60);
        // The heading begins at (24, 30) of the SVG.
        assert!(colours((48, 34), (140, 62)).iter().filter(is_dark).count() > 100, "the heading");
        // The move lasts from the left end of the axis to five sixths of it.
        let position = colours((340, 172), (2_352, 364));
        assert!(position.iter().filter(|pixel| **pixel == CURVE).count() > 1_000, "the position");
    }

    #[test]
    fn a_picture_that_is_too_high_is_refused() {
        let svg = "<svg xmlns='http://www.w3.org/2000/svg' width='10' height='8193'/>";
        let told = "the picture is 8193 px high, and a PNG has at most 8192; choose drives with --drive, or draw \
                    an SVG";
        assert_eq!(from_svg(svg), Err(told.to_owned()));
        assert!(from_svg(&svg.replace("8193", "8192")).is_ok());
    }
}
