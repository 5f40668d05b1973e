//! The rows of the table: conditions and what is demanded under them.

use super::Row;
use super::conditions::{LEAST_USABLE_LIMB, blemished, cut, displaced, noise, tilted, turned};
use super::outcome::Demand::{
    self, HonestSigma, MedianArcsec, MostArcsec, NearShare, NoWrongFine, NoWrongId, NoneFine,
    NoneMissed, SolvedShare,
};
use super::outcome::{About, ENOUGH_LIMB};
use super::recipe::{ANY_MARKS, ENOUGH_MARKS, FEW_MARKS, View};
use crate::simulate::Depth;

/// Rows with a bound on the error of fine frames.
const BOUNDED: [u64; 2] = [150, 3000];
/// Rows whose errors are told only.
const TOLD: [u64; 2] = [60, 1000];

/// What is demanded of a row with bounded errors, arcsec.
macro_rules! within {
    ($median:expr, $most:expr) => {
        &[
            MedianArcsec($median),
            MostArcsec($most),
            NoneMissed,
            HonestSigma,
            NoWrongId,
            NoWrongFine,
        ]
    };
}

/// Coarse frames say how coarse they are.
const HONEST: &[Demand] = &[HonestSigma, NoWrongId, NoWrongFine];

/// Every row, in the order of the table.
pub fn rows() -> Vec<Row> {
    let bounded = |name, title, demands, vary| Row {
        name,
        title,
        about: About::Fine,
        frames: BOUNDED,
        vary,
        demands,
    };
    let told = |name, title, vary| Row {
        frames: TOLD,
        ..bounded(name, title, &[NoWrongId], vary)
    };
    let about = |about, row| Row { about, ..row };
    vec![
        bounded("noise-1", "noise 1 DN", within!(0.05, 0.15), |r, _, _| {
            noise(r, 1.0)
        }),
        bounded(
            "standard",
            "noise 5 DN (standard)",
            within!(0.15, 0.5),
            |r, _, _| noise(r, 5.0),
        ),
        bounded("noise-15", "noise 15 DN", within!(0.5, 1.6), |r, _, _| {
            noise(r, 15.0)
        }),
        bounded(
            "twelve-bit",
            "12 bit, noise 5 DN of 8 bit",
            within!(0.15, 0.5),
            |r, _, _| r.conditions.depth = Depth::Twelve,
        ),
        bounded("turned", "any rotation", within!(0.2, 0.65), |r, _, g| {
            turned(r, g)
        }),
        bounded(
            "tilted",
            "any rotation, keystone up to 3 deg",
            within!(0.2, 0.65),
            |r, _, g| tilted(r, g),
        ),
        bounded(
            "blemished",
            "60 hot pixels, 12 scratches, 4 leaks",
            within!(0.25, 1.0),
            |r, _, _| blemished(r),
        ),
        bounded(
            "partial-fine",
            "40 % of the limb or more, 3 marks lit",
            &[
                MostArcsec(3.0),
                NoneMissed,
                HonestSigma,
                NoWrongId,
                NoWrongFine,
            ],
            |r, i, g| cut(r, ENOUGH_LIMB..1.0, ENOUGH_MARKS, i, g),
        ),
        about(
            About::Coarse,
            bounded(
                "partial-coarse",
                "15 to 40 % of the limb",
                &[
                    SolvedShare(0.95),
                    NearShare(0.99),
                    HonestSigma,
                    NoWrongId,
                    NoWrongFine,
                ],
                |r, i, g| cut(r, LEAST_USABLE_LIMB..ENOUGH_LIMB, ANY_MARKS, i, g),
            ),
        ),
        about(
            About::Coarse,
            Row {
                frames: TOLD,
                ..bounded(
                    "partial-least",
                    "less than 15 % of the limb",
                    &[NoneFine, NoWrongId, NoWrongFine],
                    |r, i, g| cut(r, 0.01..LEAST_USABLE_LIMB, ANY_MARKS, i, g),
                )
            },
        ),
        about(
            About::Coarse,
            bounded(
                "coarse-few",
                "fewer than 3 marks lit, borrowed mapping off by its sigma",
                HONEST,
                |r, i, g| {
                    displaced(r, i, g);
                    r.view = View::Whole {
                        lit_marks: FEW_MARKS,
                    };
                },
            ),
        ),
        about(
            About::Coarse,
            bounded(
                "coarse-unmarked",
                "no marks, borrowed mapping off by its sigma",
                HONEST,
                |r, i, g| {
                    displaced(r, i, g);
                    r.conditions.mark_contrast = 0.0;
                },
            ),
        ),
        told("vignetting", "vignetting 20 %", |r, _, _| {
            r.conditions.blemishes.vignetting = 0.2
        }),
        told("dust", "dust, 2 on the disc", |r, _, _| {
            r.conditions.blemishes.dust_per_disc = 2.0
        }),
        told(
            "sunspots",
            "8 sunspots, each up to 1 % of the disc",
            |r, _, _| r.sunspots = 8,
        ),
        told("smear", "smear 1.5 px", |r, _, _| {
            r.conditions.smear_px = 1.5
        }),
        told("misprinted", "marks misprinted by 1 mil rms", |r, _, _| {
            r.conditions.mark_scatter_mil = 1.0
        }),
        told("haze", "haze (blur 2.5 px)", |r, _, _| {
            r.conditions.blur_px = 2.5
        }),
        told("low-contrast", "low contrast (peak 60 DN)", |r, _, _| {
            r.conditions.peak_dn = 60.0
        }),
        told("saturated", "saturated core (peak 320 DN)", |r, _, _| {
            r.conditions.peak_dn = 320.0
        }),
    ]
}
