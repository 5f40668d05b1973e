//! All keywords of an archived frame, in groups: those of frames, and those of a solution. The page `docs/keywords.md` is made from them.

use crate::fits::keyword::{FOREIGN, GROUPS, Group, Keyword, Kind, Use};
use crate::record;
use std::fmt::Write;

/// The title of the group of a solution.
const SOLUTION: &str = "Solution";

/// All groups except those of [`FOREIGN`], which are never written: titles and keywords.
pub fn groups() -> impl Iterator<Item = (&'static str, Vec<&'static Keyword>)> {
    let of = |group: &'static Group| (group.title, group.keywords.iter().collect());
    let solution = (SOLUTION, record::keywords().collect());
    GROUPS.iter().map(of).chain([solution])
}

/// The row of a keyword.
pub fn find(name: &str) -> Option<&'static Keyword> {
    let frames = GROUPS.iter().flat_map(|group| group.keywords);
    let mut all = frames.chain(record::keywords());
    all.find(|keyword| keyword.name == name)
}

const COORDINATES: &str = "
## World coordinates

Helioprojective longitude and latitude, `HPLN-TAN` and `HPLT-TAN`, with the disc's centre as the reference pixel. `CDELTi` and
`PCi_j` hold scale, rotation and mirror; there is no `CROTAi`. They are computed with the functions for the
offsets, from steps of a solar radius to all four sides, so that the pixel of the boresight has the coordinates
of the pointing. A linear matrix neglects distortion within the picture of the disc: with a
keystone of 3 deg the limb is 0.1 px from its predicted position, and 1 deg from the boresight the disc is longer by 0.0003 of
its radius, 0.03 px. `CRDERi` is the random error of the centre; the errors of clocking and roll rotate the picture
about it, by `CSYERi` at the limb. The observer's position is that of mid-exposure.

In sunpy, use `sunpy.map.Map(file)`. To rotate north up, sunpy needs floating-point pixels:
`sunpy.map.Map(m.data.astype(float), m.meta).rotate()`.
";

const FOREIGN_NOTE: &str = "
Each is read if the keywords above do not give the same quantity. [Input formats](read.md) lists all forms of their values. The pictures of the HEROES flight are in the extension `Raw Frame`, their
keywords in the primary HDU. `CTL_AZIM` and `CTL_ELEV` are the offsets computed in flight, which `solaspect refine` lists with its own;
both zero means no offset.
";

const TABLES: &str = "
## Tables

Binary tables follow the pixels. Positions count from 0 at the centre of the first pixel, `CRPIXj` and FITS from 1.

| extension | column | unit | meaning |
|---|---|---|---|
| `MARKS` | `I`, `J` |  | id of an identified mark |
| `MARKS` | `X`, `Y` | pixel | its measured position |
| `MARKS` | `SIGMA` | pixel | 1 sigma per axis |
| `LIMB` | `X`, `Y` | pixel | point of the limb |
| `LIMB` | `SIGMA` | pixel | 1 sigma along the radius |
";

/// `.ci/check_headers.py` reads the remarks from the page.
const REMARKS: &str = "
## Accepted remarks of validators

In CI astropy, sunpy and `solarnet-metadata` read every file of a demonstration's archive. The first two give no warnings.
The accepted remarks of the last, as regular expressions, with the reasons:

| remark | when | reason |
|---|---|---|
| `^Observation Header 1: Missing Required Attribute: C[A-Z]+[ij]a\\.` | no world coordinates | a frame without a Sun, a time or a \
place has no world coordinates; false ones would do harm |
| `^Observation Header 1: Missing Required Attribute: DATE-?[BR]E[GF]$` | no time | the frame's source gave no time |

`SOLARNET` is 0.5, not 1, since `WAVEUNIT` is a unit, as sunpy requires, and not a power of ten.
";

/// The table as a page of markdown.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Keywords of an archived frame\n\n\
         This page is made from the tables in `src/fits/keyword/table.rs` and `src/record/mod.rs`.\n\n\
         They are in the header of the HDU with the pixels. On reading, this header overrides the primary one. \
         Times are UTC. Unknown values have no keyword; a frame without a Sun, a time or a place has no world \
         coordinates.\n",
    );
    groups().for_each(|(title, keywords)| add(&mut page, title, &keywords));
    for group in FOREIGN {
        add(
            &mut page,
            group.title,
            &group.keywords.iter().collect::<Vec<_>>(),
        );
    }
    page.push_str(FOREIGN_NOTE);
    page.push_str(COORDINATES);
    page.push_str(TABLES);
    page.push_str(REMARKS);
    page
}

fn add(page: &mut String, title: &str, keywords: &[&Keyword]) {
    // Writing to a String cannot fail.
    let _ = write!(
        page,
        "\n## {}\n\n| keyword | value | unit | use | meaning |\n|---|---|---|---|---|\n",
        title
    );
    for keyword in keywords {
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

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Text => "text",
        Kind::Time => "time",
        Kind::Integer => "integer",
        Kind::Float => "float",
        Kind::Logical => "logical",
    }
}

fn use_name(used: Use) -> &'static str {
    match used {
        Use::Written => "written",
        Use::Read => "read",
        Use::Both => "written, read",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_keyword_is_a_legal_and_unique_name_whose_comment_fits_beside_a_number() {
        let foreign = || FOREIGN.iter().flat_map(|group| group.keywords);
        let all = || groups().flat_map(|(_, keywords)| keywords).chain(foreign());
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
