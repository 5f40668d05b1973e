//! The rows of the table: conditions and requirements.

use super::conditions::{
    COLUMN_SMEAR, LEAST_USABLE_LIMB, TAP_STEP_DN, all_effects, as_noisy_everywhere, blemished,
    clouded, cut, displaced, eclipsed, mixed, moving, noise, photons, strutted, tilted, turned,
};
use super::demand::CALIBRATED;
use super::demand::Demand::{
    self, AllFine, FewUndecided, FineShare, MedianArcsec, MostArcsec, NearShare, NoWrongFine,
    NoWrongId, NoneFine, SigmaRatio, SigmaRatioUpTo, SolvedShare, TimesIdeal,
};
use super::outcome::{About, ENOUGH_LIMB};
use super::recipe::{ANY_MARKS, ENOUGH_MARKS, FEW_MARKS, Vary, View};
use super::trial::Trial;
use crate::instrument::Instrument;
use crate::simulate::Depth;

/// Size of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// For the tests: one minute.
    Small,
    /// For the documentation: an hour on one core.
    Full,
}

impl Size {
    /// Selects one of two values, for the small size and for the full size.
    pub(super) fn of<T: Copy>(self, [small, full]: [T; 2]) -> T {
        match self {
            Self::Small => small,
            Self::Full => full,
        }
    }
}

/// The row whose marks are evaluated one by one.
pub(super) const MARKS_ROW: &str = "standard";
/// The name of the part with all rows of the main table.
pub const ROWS: &str = "rows";
/// The name of the part that draws the figures.
pub const FIGURES: &str = "figures";
/// The name of the part about single marks.
pub const MARKS: &str = "marks";
/// The name of the mixed run.
pub const MIXED: &str = "mixed";
/// The name of the run of frames whose Sun moves during the exposure.
pub const MOTION: &str = "motion";
/// The name of the part about other plates, lenses and cameras: all its rows.
pub const PLATES: &str = "plates";
/// The name of the part about designed plates and the check of plates: all its rows.
pub const DESIGNS: &str = "designs";
/// The name of the part about the Moon.
pub const MOON: &str = "moon";
/// The name of the part about the Earth's limb.
pub const HORIZON: &str = "horizon";

/// A row's n-th instrument in a size, made from the program's.
pub type InstrumentOf = fn(Instrument, u64, Size) -> Instrument;

/// A row of the table.
#[derive(Debug, Clone)]
pub struct AccuracyRow {
    pub name: &'static str,
    pub title: &'static str,
    /// The frames in the error statistics.
    pub about: About,
    /// Number of frames: in the small size, and in the full size.
    pub frames: [u64; 2],
    /// Change of the row's frames from the standard one.
    pub vary: Vary,
    /// Instrument of the row, if it is not the program's.
    pub instrument: Option<InstrumentOf>,
    /// Number of instruments used in turn: in the small size, and in the full size.
    pub instruments: [u64; 2],
    /// The frames with which the errors are compared, with the same seeds.
    pub ideal: Option<Ideal>,
    pub demands: Vec<Demand>,
}

/// Frames without the effect that a row is about.
#[derive(Debug, Clone, Copy)]
pub enum Ideal {
    /// Standard frames.
    Standard,
    /// Frames that differ from the standard one in another respect.
    Of(Vary),
}

/// A series of frames that is searched for events that must never happen.
#[derive(Debug, Clone)]
pub struct Run {
    pub name: &'static str,
    pub title: &'static str,
    /// Number of frames: in the small size, and in the full size.
    pub frames: [u64; 2],
    pub vary: Vary,
}

/// Every run, in the order of the report.
pub fn runs() -> Vec<Run> {
    vec![
        Run {
            name: MIXED,
            title: "Mixed run",
            frames: [300, 20_000],
            vary: mixed,
        },
        Run {
            name: MOTION,
            title: "Motion of 0 to 30 px in the exposure",
            frames: [300, 100_000],
            vary: moving,
        },
    ]
}

/// Number of frames of rows with many requirements: in the small size, and in the full size.
const MANY: [u64; 2] = [150, 3000];
/// Number of frames of rows with a partly covered Sun.
const COVERED: [u64; 2] = [150, 5000];
/// Number of frames of rows whose errors are only reported.
const FEW: [u64; 2] = [60, 1000];
/// Number of frames of rows about one effect that are compared with ideal frames.
const BESIDE_IDEAL: [u64; 2] = [24, 300];

/// A row about fine frames whose errors are only reported.
pub(super) fn row(name: &'static str, title: &'static str, vary: Vary) -> AccuracyRow {
    AccuracyRow {
        name,
        title,
        about: About::Fine,
        frames: FEW,
        vary,
        instrument: None,
        instruments: [1; 2],
        ideal: None,
        demands: vec![NoWrongId],
    }
}

impl AccuracyRow {
    /// The solver's setup for the frame of a seed; `usual` is the program's. The row's instruments are used in turn.
    pub(super) fn trial(&self, usual: &Trial, size: Size, seed: u64) -> Trial {
        let mut trial = usual.clone();
        if let Some(make) = self.instrument {
            let n = seed % size.of(self.instruments).max(1);
            trial.instrument = make(trial.instrument, n, size);
        }
        trial
    }

    /// The row without the limits in arcsec.
    pub(super) fn without_arcsec(mut self) -> Self {
        let in_arcsec = |d: &Demand| matches!(d, MedianArcsec(_) | MostArcsec(_));
        self.demands.retain(|demand| !in_arcsec(demand));
        self
    }

    pub(super) fn demanding(self, demands: &[Demand]) -> Self {
        Self {
            frames: MANY,
            demands: [demands, &[NoWrongId, NoWrongFine]].concat(),
            ..self
        }
    }

    /// Bounds the radial error: its median and 99.7 %, arcsec.
    fn within(self, median: f64, most: f64) -> Self {
        self.demanding(&[MedianArcsec(median), MostArcsec(most), AllFine, SigmaRatio])
    }

    /// Limits the median relative to that of standard frames.
    fn beside_standard(self, most_times: f64) -> Self {
        self.beside(Ideal::Standard, most_times)
    }

    /// Limits the median relative to that of ideal frames.
    fn beside(self, ideal: Ideal, most_times: f64) -> Self {
        Self {
            frames: BESIDE_IDEAL,
            ideal: Some(ideal),
            ..self.demanding(&[TimesIdeal(most_times), SigmaRatioUpTo(CALIBRATED.end)])
        }
    }

    fn coarse(self) -> Self {
        Self {
            about: About::Coarse,
            ..self
        }
    }
}

/// Every row, in the order of the table.
pub fn rows() -> Vec<AccuracyRow> {
    [bounded(), borrowing(), reported(), effects(), covered()].concat()
}

/// Rows with limits on their errors.
fn bounded() -> Vec<AccuracyRow> {
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
        .demanding(&[MostArcsec(3.0), FewUndecided(0.12), SigmaRatio]),
    ]
}

/// Rows about coarse frames, most of which borrow a mapping, which is drawn from its sigmas.
fn borrowing() -> Vec<AccuracyRow> {
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
        .demanding(&[SolvedShare(0.95), NearShare(0.99), SigmaRatio]),
        AccuracyRow {
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
        .demanding(&[SigmaRatio]),
        row(
            "coarse-unmarked",
            "no marks, borrowed mapping off by its sigma",
            |r, instrument, rng| {
                displaced(r, instrument, rng);
                r.conditions.mark_contrast = 0.0;
            },
        )
        .coarse()
        .demanding(&[SigmaRatio]),
    ]
}

/// Rows whose errors are only reported.
fn reported() -> Vec<AccuracyRow> {
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

/// Rows about stray light, readout, photons, the real Sun and strong blur, compared with ideal frames.
fn effects() -> Vec<AccuracyRow> {
    let ghost = "a ghost of 2 % of the light";
    vec![
        row("ghost", ghost, |r, _, _| r.conditions.stray.ghost = 0.02).beside_standard(2.0),
        row("ghost-3", "a ghost of 3 % of the light", |r, _, _| {
            r.conditions.stray.ghost = 0.03;
        })
        .beside_standard(2.0),
        row(
            "column-smear",
            "smear along the columns, 6 DN",
            |r, _, _| {
                r.conditions.readout.column_smear = COLUMN_SMEAR;
            },
        )
        .beside_standard(2.0),
        row(
            "gradient",
            "stray light rising by 13 DN, vignetting 10 %",
            |r, _, _| {
                r.conditions.stray.gradient_dn = 13.0;
                r.conditions.blemishes.vignetting = 0.1;
            },
        )
        .beside_standard(1.3),
        row(
            "disc-gradient",
            "stray light rising by 5 DN across the disc",
            |r, _, _| r.conditions.stray.disc_gradient_dn = 5.0,
        )
        .beside_standard(1.3),
        row(
            "tap-step",
            "2 DN between the sensor's halves, the disc across both",
            |r, _, _| {
                r.view = View::AcrossMiddle;
                r.conditions.readout.tap_step_dn = TAP_STEP_DN;
            },
        )
        .beside(Ideal::Of(|r, _, _| r.view = View::AcrossMiddle), 1.3),
        row("coma", "coma of 10 % of the light", |r, _, _| {
            r.conditions.stray.coma = 0.1;
        })
        .beside_standard(2.0),
        row(
            "photons",
            "photon noise, 39 electrons/DN, read noise 1 DN",
            |r, _, _| photons(r, 39.0),
        )
        .beside(Ideal::Of(|r, _, _| as_noisy_everywhere(r, 39.0)), 1.3),
        row(
            "photons-few",
            "photon noise, 4 electrons/DN, read noise 1 DN",
            |r, _, _| photons(r, 4.0),
        )
        .beside(Ideal::Of(|r, _, _| as_noisy_everywhere(r, 4.0)), 1.3),
        row("hmi", "the Sun's surface as HMI saw it", |r, _, _| {
            r.conditions.hmi = true;
        })
        .beside_standard(1.3),
        AccuracyRow {
            frames: BESIDE_IDEAL,
            ..row("blur", "strong blur (3.5 px)", |r, _, _| {
                r.conditions.blur_px = 3.5;
            })
            .demanding(&[AllFine, SigmaRatioUpTo(CALIBRATED.end)])
        },
        AccuracyRow {
            frames: BESIDE_IDEAL,
            ideal: Some(Ideal::Standard),
            ..row(
                "all-effects",
                "ghost 2 %, column smear, gradient, vignetting, tap step, coma, HMI's surface",
                |r, _, _| all_effects(r),
            )
            .demanding(&[TimesIdeal(3.0), SigmaRatioUpTo(1.3)])
        },
    ]
}

/// Rows with a partly covered Sun.
fn covered() -> Vec<AccuracyRow> {
    let rows = vec![
        row(
            "eclipse",
            "the Moon covers 2 to 9 % of the diameter, up to 15 % of the limb",
            |r, _, rng| eclipsed(r, 0.02..0.09, rng),
        )
        .demanding(&[FineShare(0.95), SigmaRatio]),
        row(
            "eclipse-deep",
            "the Moon covers 9 to 60 % of the diameter",
            |r, _, rng| eclipsed(r, 0.09..0.6, rng),
        )
        .demanding(&[SigmaRatio]),
        row(
            "cloud-edge",
            "a cloud's edge across the disc takes 25 to 90 % of the light",
            |r, _, rng| clouded(r, rng),
        )
        .demanding(&[SigmaRatio]),
        row(
            "strut",
            "a strut before the disc, up to a quarter of the radius wide",
            |r, _, rng| strutted(r, rng),
        )
        .demanding(&[SigmaRatio]),
    ];
    let searched = |row: AccuracyRow| AccuracyRow {
        frames: COVERED,
        ..row
    };
    rows.into_iter().map(searched).collect()
}
