//! The table of keywords: everything that is written to or read from a header, with its unit and meaning.
//!
//! What is not in the table cannot be written, and the page `docs/keywords.md` is made from it. To add a keyword, add
//! a row. Structural keywords that the library writes itself (SIMPLE, NAXISn, ZTILEn, TFORMn ...) are not rows.

use std::fmt::Write;

/// What a keyword's value is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Text,
    /// A text: UTC, ISO 8601 as FITS writes it, without Z.
    Time,
    Integer,
    Float,
    Logical,
}

/// Whether a keyword is written only, or read too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    Written,
    Both,
    /// Understood in files of others.
    Read,
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Keyword {
    pub name: &'static str,
    pub kind: Kind,
    /// Unit, as FITS writes it; empty for a value without.
    pub unit: &'static str,
    pub meaning: &'static str,
    pub used: Use,
}

impl Keyword {
    /// The comment of a card: the unit in brackets, then the meaning.
    pub fn comment(&self) -> String {
        match self.unit {
            "" => self.meaning.into(),
            unit => format!("[{unit}] {}", self.meaning),
        }
    }
}

/// Keywords that belong together, under a title.
pub struct Group {
    pub title: &'static str,
    pub keywords: &'static [Keyword],
}

const fn row(
    name: &'static str,
    kind: Kind,
    unit: &'static str,
    used: Use,
    meaning: &'static str,
) -> Keyword {
    Keyword {
        name,
        kind,
        unit,
        meaning,
        used,
    }
}

use Kind::{Float, Integer, Logical, Text, Time};
use Use::{Both, Read, Written};

/// The file and who wrote it.
const FILE: Group = Group {
    title: "File",
    keywords: &[
        row("ORIGIN", Text, "", Written, "where the file was made"),
        row("CREATOR", Text, "", Written, "program that wrote the file"),
        row("DATE", Time, "", Written, "when the file was written, UTC"),
        row("EXTNAME", Text, "", Written, "name of this extension"),
        row("CHECKSUM", Text, "", Both, "checksum of the HDU"),
        row("DATASUM", Text, "", Both, "checksum of the data"),
    ],
};

/// When the frame was taken.
const TIME: Group = Group {
    title: "Time",
    keywords: &[
        row("TIMESYS", Text, "", Both, "time scale of every time here"),
        row("DATE-OBS", Time, "", Both, "start of the exposure"),
        row("DATE-BEG", Time, "", Both, "start of the exposure"),
        row("DATE-AVG", Time, "", Both, "middle of the exposure"),
        row("DATE-END", Time, "", Written, "end of the exposure"),
        row("EXPTIME", Float, "s", Both, "length of the exposure"),
        row("XPOSURE", Float, "s", Both, "length of the exposure"),
        row(
            "MONOTIME",
            Float,
            "s",
            Both,
            "mid-exposure on the monotonic clock",
        ),
        row(
            "FRAMENUM",
            Integer,
            "",
            Both,
            "number of the frame in its sequence",
        ),
    ],
};

/// The camera and its pixels.
const CAMERA: Group = Group {
    title: "Camera",
    keywords: &[
        row("CAMERA", Text, "", Both, "name of the camera"),
        row(
            "INSTRUME",
            Text,
            "",
            Read,
            "name of the camera, without CAMERA",
        ),
        row("GAIN", Float, "", Both, "analogue gain, camera's unit"),
        row(
            "PREAMP",
            Float,
            "",
            Both,
            "pre-amplifier gain, camera's unit",
        ),
        row("CAMTEMP", Float, "degC", Both, "temperature of the camera"),
        row("BITDEPTH", Integer, "bit", Both, "depth of the pixels"),
        row(
            "SATURATE",
            Integer,
            "DN",
            Both,
            "value at which a pixel saturates",
        ),
        row(
            "BUNIT",
            Text,
            "",
            Written,
            "unit of the pixels: digital numbers",
        ),
    ],
};

/// Where the frame was taken.
const PLACE: Group = Group {
    title: "Place",
    keywords: &[
        row("OBSGEO-B", Float, "deg", Both, "geodetic latitude, WGS 84"),
        row(
            "OBSGEO-L",
            Float,
            "deg",
            Both,
            "geodetic longitude, east positive",
        ),
        row("OBSGEO-H", Float, "m", Both, "height above the ellipsoid"),
        row("OBSGEO-X", Float, "m", Both, "geocentric position"),
        row("OBSGEO-Y", Float, "m", Both, "geocentric position"),
        row("OBSGEO-Z", Float, "m", Both, "geocentric position"),
    ],
};

/// What the solver found.
const SOLUTION: Group = Group {
    title: "Solution",
    keywords: &[
        row("QUALITY", Text, "", Written, "fine, coarse or none"),
        row(
            "REASON",
            Text,
            "",
            Written,
            "stage and reason that the frame went no further",
        ),
        row(
            "SUNPX-X",
            Float,
            "pixel",
            Written,
            "image of the disc's centre, first pixel is 0",
        ),
        row(
            "SUNPX-Y",
            Float,
            "pixel",
            Written,
            "image of the disc's centre, first pixel is 0",
        ),
        row("SUNPX-SX", Float, "pixel", Written, "1 sigma of SUNPX-X"),
        row("SUNPX-SY", Float, "pixel", Written, "1 sigma of SUNPX-Y"),
        row(
            "SUNPX-R",
            Float,
            "pixel",
            Written,
            "radius of the disc at the mapping's scale",
        ),
        row(
            "SUNMIL-X",
            Float,
            "mil",
            Written,
            "disc's centre on the plate, from its centre",
        ),
        row(
            "SUNMIL-Y",
            Float,
            "mil",
            Written,
            "disc's centre on the plate, from its centre",
        ),
        row("SUNMILSX", Float, "mil", Written, "1 sigma of SUNMIL-X"),
        row("SUNMILSY", Float, "mil", Written, "1 sigma of SUNMIL-Y"),
        row("NMARKS", Integer, "", Written, "marks that were read"),
        row(
            "MAPKIND",
            Text,
            "",
            Written,
            "mapping from sensor to plate, or its origin",
        ),
        row(
            "MAPSCALE",
            Float,
            "mil/pixel",
            Written,
            "plate length per pixel at the Sun",
        ),
        row(
            "MAPROT",
            Float,
            "deg",
            Written,
            "rotation of the picture, from +x towards +y",
        ),
        row(
            "MAPRES",
            Float,
            "pixel",
            Written,
            "rms residual of the marks per axis",
        ),
        row(
            "OFFSETAZ",
            Float,
            "deg",
            Written,
            "azimuth of the pointing minus the target",
        ),
        row(
            "OFFSETEL",
            Float,
            "deg",
            Written,
            "elevation of the pointing minus the target",
        ),
        row(
            "OFFSETSG",
            Float,
            "deg",
            Written,
            "1 sigma of the offset per axis of true angle",
        ),
    ],
};

/// The whole table.
pub const GROUPS: &[Group] = &[FILE, TIME, CAMERA, PLACE, SOLUTION];

/// Every row of the table.
pub fn all() -> impl Iterator<Item = &'static Keyword> {
    GROUPS.iter().flat_map(|group| group.keywords)
}

/// The row of a keyword.
pub fn find(name: &str) -> Option<&'static Keyword> {
    all().find(|keyword| keyword.name == name)
}

/// The table as a page of markdown.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Keywords of an archived frame\n\n\
         This page is made from the table in `src/fits/keyword.rs`.\n\n\
         They stand in the header of the HDU that holds the pixels. On reading, that header goes before the primary \
         one. Times are UTC. A value that is not known has no keyword.\n",
    );
    for group in GROUPS {
        // Writing to a String cannot fail.
        let _ = write!(
            page,
            "\n## {}\n\n| keyword | value | unit | use | meaning |\n|---|---|---|---|---|\n",
            group.title
        );
        for keyword in group.keywords {
            let _ = writeln!(
                page,
                "| `{}` | {} | {} | {} | {} |",
                keyword.name,
                kind_name(keyword.kind),
                keyword.unit,
                use_name(keyword.used),
                keyword.meaning
            );
        }
    }
    page
}

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Text => "text",
        Time => "time",
        Integer => "integer",
        Float => "float",
        Logical => "logical",
    }
}

fn use_name(used: Use) -> &'static str {
    match used {
        Written => "written",
        Both => "written, read",
        Read => "read",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_keyword_is_a_legal_and_unique_name_whose_comment_fits_beside_a_number() {
        let names: BTreeSet<&str> = all().map(|keyword| keyword.name).collect();
        assert_eq!(names.len(), all().count());
        for keyword in all() {
            let legal = |b: u8| b.is_ascii_uppercase() || b.is_ascii_digit() || b"-_".contains(&b);
            assert!(keyword.name.bytes().all(legal), "{keyword:?}");
            assert!((1..=8).contains(&keyword.name.len()), "{keyword:?}");
            assert!(!keyword.meaning.is_empty(), "{keyword:?}");
            assert!(keyword.comment().len() <= 47, "{keyword:?}");
        }
    }

    /// With SOLASPECT_WRITE_DOCS set, the page is written instead.
    #[test]
    fn the_page_of_keywords_is_the_table() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/keywords.md");
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(page, markdown()).unwrap();
        }
        let committed = std::fs::read_to_string(page).unwrap();
        assert!(
            committed == markdown(),
            "docs/keywords.md is not the table: run this test with SOLASPECT_WRITE_DOCS=1"
        );
    }
}
