//! All keywords of an archived frame, in groups: those of frames, and those of a solution. The page `docs/keywords.md` is made from them.

use crate::fits::keyword::{FOREIGN, GROUPS, Group, Keyword, Kind, Use};
use crate::record;
use std::fmt::Write;

/// The title of what a solution says.
const SOLUTION: &str = "Solution";

/// All groups but those of [`FOREIGN`], which are never written: titles and keywords.
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
## What the world coordinates are

Helioprojective longitude and latitude, `HPLN-TAN` and `HPLT-TAN`, with the disc's centre as the reference pixel. Scale,
rotation and mirror stand in `CDELTi` and `PCi_j`; there is no `CROTAi`. They come from the functions that give the
offsets, by steps of a solar radius to all four sides, so the pixel on which the boresight falls has the coordinates
at which the telescope points. One straight matrix leaves out what bends within the picture of the disc: under a
keystone of 3 deg the limb stands 0.1 px from where it says, and 1 deg from the boresight the disc is longer by 0.0003 of
its radius, 0.03 px, than the matrix has it. `CRDERi` is the random error of the centre; clocking and roll turn the picture
about it, by `CSYERi` at the limb. The observer's place is that of mid-exposure.

In sunpy, `sunpy.map.Map(file)` is all it takes. To turn north up it wants other than whole-number pixels:
`sunpy.map.Map(m.data.astype(float), m.meta).rotate()`.
";

const FOREIGN_NOTE: &str = "
Each is read where the keywords above do not give the same. [What is read](read.md) has all forms of their values. The pictures of the HEROES flight stand in the extension `Raw Frame`, their
keywords in the primary HDU. `CTL_AZIM` and `CTL_ELEV` are the answer in flight, which `solaspect refine` puts beside its own;
both zero is no answer.
";

const TABLES: &str = "
## Tables

Binary tables follow the pixels. Positions count from 0 at the centre of the first pixel, `CRPIXj` and FITS from 1.

| extension | column | unit | meaning |
|---|---|---|---|
| `MARKS` | `I`, `J` |  | id of a mark that was read |
| `MARKS` | `X`, `Y` | pixel | where it was seen |
| `MARKS` | `SIGMA` | pixel | 1 sigma per axis |
| `LIMB` | `X`, `Y` | pixel | point of the limb |
| `LIMB` | `SIGMA` | pixel | 1 sigma along the radius |
";

/// `.ci/check_headers.py` reads the remarks from the page.
const REMARKS: &str = "
## Remarks of validators that stand

In CI astropy, sunpy and `solarnet-metadata` read every file of a demonstration's archive. The first two have nothing to say.
What the last may say, as a regular expression, and why it stays so:

| remark | when | reason |
|---|---|---|
| `^Observation Header 1: Missing Required Attribute: C[A-Z]+[ij]a\\.` | no world coordinates | a frame without a Sun, a time or a \
place has no world coordinates, and false ones do harm |
| `^Observation Header 1: Missing Required Attribute: DATE-?[BR]E[GF]$` | no time | the frame's source gave no time |

`SOLARNET` is 0.5, not 1, since `WAVEUNIT` is a unit, as sunpy wants it, and not a power of ten.
";

/// The table as a page of markdown.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Keywords of an archived frame\n\n\
         This page is made from the tables in `src/fits/keyword/table.rs` and `src/record/mod.rs`.\n\n\
         They stand in the header of the HDU that holds the pixels. On reading, that header goes before the primary \
         one. Times are UTC. A value that is not known has no keyword; a frame without a Sun, a time or a place has no \
         world coordinates.\n",
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
