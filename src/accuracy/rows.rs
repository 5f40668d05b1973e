//! The rows of the table: conditions and what is demanded under them.

use super::conditions::{LEAST_USABLE_LIMB, blemished, cut, displaced, noise, tilted, turned};
use super::outcome::{
    About,
    Demand::{
        self, FewUndecided, HonestSigma, MedianArcsec, MostArcsec, NearShare, NoWrongFine,
        NoWrongId, NoneFine, NoneMissed, SolvedShare,
    },
    ENOUGH_LIMB,
};
use super::recipe::{ANY_MARKS, ENOUGH_MARKS, FEW_MARKS, Vary, View};
use crate::simulate::Depth;

/// How many frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// For the tests: a minute.
    Small,
    /// For the documentation: an hour of one core.
    Full,
}

impl Size {
    /// Of a number for the small size and one for the full.
    pub(super) fn of<T: Copy>(self, [small, full]: [T; 2]) -> T {
        match self {
            Self::Small => small,
            Self::Full => full,
        }
    }
}

/// The row whose marks are judged one by one.
pub(super) const MARKS_ROW: &str = "standard";
/// The name of the part about single marks.
pub const MARKS: &str = "marks";
/// The name of the mixed run.
pub const MIXED: &str = "mixed";

/// A row of the table.
#[derive(Debug, Clone)]
pub struct Row {
    pub name: &'static str,
    pub title: &'static str,
    /// The frames that the errors are of.
    pub about: About,
    /// How many frames: in the small size, in the full.
    pub frames: [u64; 2],
    /// How the row's frames depart from the standard one.
    pub vary: Vary,
    pub demands: Vec<Demand>,
}

/// Frames of rows of which much is demanded: in the small size, in the full.
const MANY: [u64; 2] = [150, 3000];
/// Frames of rows whose errors are reported only.
const FEW: [u64; 2] = [60, 1000];

/// A row about fine frames whose errors are reported only.
fn row(name: &'static str, title: &'static str, vary: Vary) -> Row {
    Row {
        name,
        title,
        about: About::Fine,
        frames: FEW,
        vary,
        demands: vec![NoWrongId],
    }
}

impl Row {
    fn demanding(self, demands: &[Demand]) -> Self {
        Self {
            frames: MANY,
            demands: [demands, &[NoWrongId, NoWrongFine]].concat(),
            ..self
        }
    }

    /// Bounds the radial error: its median and 99.7 %, arcsec.
    fn within(self, median: f64, most: f64) -> Self {
        self.demanding(&[
            MedianArcsec(median),
            MostArcsec(most),
            NoneMissed,
            HonestSigma,
        ])
    }

    fn coarse(self) -> Self {
        Self {
            about: About::Coarse,
            ..self
        }
    }
}

/// Every row, in the order of the table.
pub fn rows() -> Vec<Row> {
    [bounded(), borrowing(), reported()].concat()
}

/// The name of every part of the program: the rows, the marks, the mixed run.
pub fn names() -> Vec<&'static str> {
    let rows = rows().into_iter().map(|row| row.name);
    rows.chain([MARKS, MIXED]).collect()
}

/// Rows whose errors are bounded.
fn bounded() -> Vec<Row> {
    vec![
        row("noise-1", "noise 1 DN", |r, _, _| noise(r, 1.0)).within(0.05, 0.15),
        row("standard", "noise 5 DN (standard)", |r, _, _| noise(r, 5.0)).within(0.15, 0.5),
        row("noise-15", "noise 15 DN", |r, _, _| noise(r, 15.0)).within(0.5, 1.6),
        row("twelve-bit", "12 bit, noise 5 DN of 8 bit", |r, _, _| {
            r.conditions.depth = Depth::Twelve;
        })
        .within(0.15, 0.5),
        row("turned", "any rotation", |r, _, rng| turned(r, rng)).within(0.2, 0.65),
        row(
            "tilted",
            "any rotation, keystone up to 3 deg",
            |r, _, rng| tilted(r, rng),
        )
        .within(0.2, 0.65),
        row(
            "blemished",
            "60 hot pixels, 12 scratches, 4 leaks",
            |r, _, _| blemished(r),
        )
        .within(0.25, 1.0),
        row(
            "partial-fine",
            "40 % of the limb or more, 3 marks lit",
            |r, instrument, rng| cut(r, ENOUGH_LIMB..1.0, ENOUGH_MARKS, instrument, rng),
        )
        .demanding(&[MostArcsec(3.0), FewUndecided(0.12), HonestSigma]),
    ]
}

/// Rows about coarse frames, most of which borrow a mapping. It is off as far as its sigmas say.
fn borrowing() -> Vec<Row> {
    vec![
        row(
            "partial-coarse",
            "15 to 40 % of the limb",
            |r, instrument, rng| {
                cut(
                    r,
                    LEAST_USABLE_LIMB..ENOUGH_LIMB,
                    ANY_MARKS,
                    instrument,
                    rng,
                );
            },
        )
        .coarse()
        .demanding(&[SolvedShare(0.95), NearShare(0.99), HonestSigma]),
        Row {
            demands: vec![NoneFine, NoWrongId],
            ..row(
                "partial-least",
                "less than 15 % of the limb",
                |r, instrument, rng| cut(r, 0.01..LEAST_USABLE_LIMB, ANY_MARKS, instrument, rng),
            )
            .coarse()
        },
        row(
            "coarse-few",
            "fewer than 3 marks lit, borrowed mapping off by its sigma",
            |r, instrument, rng| {
                displaced(r, instrument, rng);
                r.view = View::Whole {
                    lit_marks: FEW_MARKS,
                };
            },
        )
        .coarse()
        .demanding(&[HonestSigma]),
        row(
            "coarse-unmarked",
            "no marks, borrowed mapping off by its sigma",
            |r, instrument, rng| {
                displaced(r, instrument, rng);
                r.conditions.mark_contrast = 0.0;
            },
        )
        .coarse()
        .demanding(&[HonestSigma]),
    ]
}

/// Rows whose errors are reported only.
fn reported() -> Vec<Row> {
    vec![
        row("vignetting", "vignetting 20 %", |r, _, _| {
            r.conditions.blemishes.vignetting = 0.2;
        }),
        row("dust", "dust, 2 on the disc", |r, _, _| {
            r.conditions.blemishes.dust_per_disc = 2.0;
        }),
        row(
            "sunspots",
            "8 sunspots, each up to 1 % of the disc",
            |r, _, _| r.sunspots = 8,
        ),
        row("smear", "smear 1.5 px", |r, _, _| {
            r.conditions.smear_px = 1.5;
        }),
        row("misprinted", "marks misprinted by 1 mil rms", |r, _, _| {
            r.conditions.mark_scatter_mil = 1.0;
        }),
        row("haze", "haze (blur 2.5 px)", |r, _, _| {
            r.conditions.blur_px = 2.5;
        }),
        row("low-contrast", "low contrast (peak 60 DN)", |r, _, _| {
            r.conditions.peak_dn = 60.0;
        }),
        row("saturated", "saturated core (peak 320 DN)", |r, _, _| {
            r.conditions.peak_dn = 320.0;
        }),
    ]
}
