//! Results of the check of a plate: for each place, and as a summary.

use super::Rotations;
use crate::instrument::LensMisfit;
use crate::units::PlateMil;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Result for a position of the Sun.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CheckedPlace {
    pub x_mil: f64,
    pub y_mil: f64,
    /// Number of fully lit marks.
    pub lit: usize,
    /// Fraction of the limb not masked by marks, 0 to 1.
    pub limb_free: f64,
    pub verdict: PlaceVerdict,
    /// Difference between the logarithm of the odds of the true labelling and its limit, the minimum over the draws.
    pub margin: Option<f64>,
    /// The worst verdict of safe draws if marks are missed and detections false as often as the flight software expects.
    pub among_clutter: Option<PlaceVerdict>,
    /// Uncertainty of the Sun's position, 1 sigma per axis.
    pub sigma_mil: Option<f64>,
    /// Error of the Sun's position from misprinted marks, according to the plate's sigmas, 1 sigma per axis.
    pub misprint_mil: Option<f64>,
}

impl CheckedPlace {
    /// A position at which no mark is lit.
    pub(super) fn unlit(at: PlateMil) -> Self {
        Self {
            x_mil: at.x,
            y_mil: at.y,
            lit: 0,
            limb_free: 0.0,
            verdict: PlaceVerdict::FewMarks,
            margin: None,
            among_clutter: None,
            sigma_mil: None,
            misprint_mil: None,
        }
    }

    /// Takes in another draw: keeps the worst verdict and the smallest margin.
    pub(super) fn worsen(&mut self, verdict: PlaceVerdict, margin: f64) {
        let (worst, least) = match self.margin {
            Some(least) => (self.verdict, least),
            None => (verdict, margin),
        };
        (self.verdict, self.margin) = (worst.max(verdict), Some(least.min(margin)));
    }

    pub fn at(&self) -> PlateMil {
        PlateMil::new(self.x_mil, self.y_mil)
    }
}

/// Result of frames with the Sun at a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceVerdict {
    /// Its marks are identified correctly.
    Safe,
    /// Fewer marks are lit on the sensor than a mapping needs.
    FewMarks,
    /// Another labelling is nearly as likely.
    Ambiguous,
    /// The marks fit several places of the plate.
    SeveralPlaces,
    /// Its marks are identified as others.
    Wrong,
}

impl PlaceVerdict {
    /// All verdicts, the best first.
    pub const ALL: [Self; 5] = [
        Self::Safe,
        Self::FewMarks,
        Self::Ambiguous,
        Self::SeveralPlaces,
        Self::Wrong,
    ];

    /// Meaning of the verdict.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Safe => "marks are read, and as no others",
            Self::FewMarks => "too few marks are fully lit",
            Self::Ambiguous => "another labelling is nearly as likely",
            Self::SeveralPlaces => "the marks fit several places of the plate",
            Self::Wrong => "marks are read as others",
        }
    }
}

/// Result of the check of a plate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlateCheck {
    pub instrument: String,
    pub marks: usize,
    pub shape: &'static str,
    pub field_radius_mil: f64,
    pub rotations: Rotations,
    /// Why no frame can be identified at all.
    #[serde(serialize_with = "as_text")]
    pub misfit: Option<LensMisfit>,
    pub places: Vec<CheckedPlace>,
}

impl PlateCheck {
    /// Number of places with a verdict.
    pub fn count(&self, verdict: PlaceVerdict) -> usize {
        let places = self.places.iter();
        places.filter(|place| place.verdict == verdict).count()
    }

    /// Fraction of the field where frames cannot be identified, and the most frequent reason; `None` if they can be
    /// identified everywhere.
    pub fn unreadable(&self) -> Option<(f64, &'static str)> {
        let bad = PlaceVerdict::ALL.into_iter().skip(1);
        let counts = bad.map(|verdict| (self.count(verdict), verdict.meaning()));
        let most = counts.max_by_key(|(count, _)| *count)?;
        let safe = self.count(PlaceVerdict::Safe);
        let part = 1.0 - safe as f64 / self.places.len().max(1) as f64;
        (most.0 > 0).then_some((part, most.1))
    }

    /// Whether frames can be identified all over the field.
    pub fn passes(&self) -> bool {
        self.misfit.is_none() && self.count(PlaceVerdict::Safe) == self.places.len()
    }

    pub fn summary(&self) -> CheckSummary {
        let among_clutter: Vec<_> = (self.places.iter())
            .filter_map(|place| place.among_clutter)
            .collect();
        let read = among_clutter.iter().filter(|v| **v == PlaceVerdict::Safe);
        let read_share = read.count() as f64 / among_clutter.len().max(1) as f64;
        let counts = PlaceVerdict::ALL.map(|verdict| (verdict, self.count(verdict)));
        let sigmas_mil = self.sorted(|place| place.sigma_mil);
        CheckSummary {
            passes: self.passes(),
            places: counts.into_iter().filter(|(_, count)| *count > 0).collect(),
            fewest_lit: self.places.iter().map(|place| place.lit).min(),
            least_limb_free: self.sorted(|place| Some(place.limb_free)).first().copied(),
            least_margin: self.sorted(|place| place.margin).first().copied(),
            read_among_clutter: (!among_clutter.is_empty()).then_some(read_share),
            least_sigma_mil: sigmas_mil.first().copied(),
            median_sigma_mil: sigmas_mil.get(sigmas_mil.len() / 2).copied(),
            most_sigma_mil: sigmas_mil.last().copied(),
            most_misprint_mil: self.sorted(|place| place.misprint_mil).last().copied(),
        }
    }

    /// The values of a quantity at the places that have one, in ascending order.
    fn sorted(&self, of: impl Fn(&CheckedPlace) -> Option<f64>) -> Vec<f64> {
        let mut numbers: Vec<f64> = self.places.iter().filter_map(of).collect();
        numbers.sort_by(f64::total_cmp);
        numbers
    }
}

/// Summary of the check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckSummary {
    /// Whether frames can be identified all over the field.
    pub passes: bool,
    /// Number of places of each verdict that occurs.
    pub places: BTreeMap<PlaceVerdict, usize>,
    pub fewest_lit: Option<usize>,
    /// Unmasked fraction of the limb at the place where marks mask most of it.
    pub least_limb_free: Option<f64>,
    /// Difference between the logarithm of the odds and its limit, at the worst place.
    pub least_margin: Option<f64>,
    /// Share of the safe draws that are safe among clutter as well.
    pub read_among_clutter: Option<f64>,
    /// Uncertainty of the Sun's position from noise, 1 sigma per axis.
    pub least_sigma_mil: Option<f64>,
    pub median_sigma_mil: Option<f64>,
    pub most_sigma_mil: Option<f64>,
    /// Largest error of the Sun's position from misprints, 1 sigma per axis.
    pub most_misprint_mil: Option<f64>,
}

/// An error as its text.
fn as_text<S: Serializer>(misfit: &Option<LensMisfit>, out: S) -> Result<S::Ok, S::Error> {
    misfit.as_ref().map(ToString::to_string).serialize(out)
}
