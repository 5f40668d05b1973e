//! The table of keywords as a page of markdown.

use super::table::{FOREIGN, GROUPS};
use super::{Group, Kind, Use};
use std::fmt::Write;

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
| `^Observation Header 1: Missing Required Attribute: DATE-?[BR]E[GF]$` | no time | the frame's source told no time |

`SOLARNET` is 0.5, not 1, since `WAVEUNIT` is a unit, as sunpy wants it, and not a power of ten.
";

/// The table as a page of markdown.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Keywords of an archived frame\n\n\
         This page is made from the table in `src/fits/keyword/table.rs`.\n\n\
         They stand in the header of the HDU that holds the pixels. On reading, that header goes before the primary \
         one. Times are UTC. A value that is not known has no keyword; a frame without a Sun, a time or a place has no \
         world coordinates.\n",
    );
    GROUPS.iter().for_each(|group| add(&mut page, group));
    FOREIGN.iter().for_each(|group| add(&mut page, group));
    page.push_str(FOREIGN_NOTE);
    page.push_str(COORDINATES);
    page.push_str(TABLES);
    page.push_str(REMARKS);
    page
}

fn add(page: &mut String, group: &Group) {
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
