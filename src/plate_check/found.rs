//! Results of the check of a plate: place by place, and in few numbers.

use super::Rotations;
use crate::instrument::LensMisfit;
use crate::units::PlateMil;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Result of a place of the Sun.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CheckedPlace {
    pub x_mil: f64,
    pub y_mil: f64,
    /// Marks that are fully lit.
    pub lit: usize,
    /// The part of the limb that no mark hides, 0 to 1.
    pub limb_free: f64,
    pub verdict: PlaceVerdict,
    /// By how much the logarithm of the odds of the true labelling exceeds what is asked, the least of the draws.
    pub margin: Option<f64>,
    /// The worst that becomes of draws that are read when marks are missed and detections false as often as the flight expects.
    pub among_clutter: Option<PlaceVerdict>,
    /// How well the Sun's place would be known, 1 sigma per axis.
    pub sigma_mil: Option<f64>,
    /// By how much marks move it that are misprinted as far as the plate's sigmas say, 1 sigma per axis.
    pub misprint_mil: Option<f64>,
}

impl CheckedPlace {
    /// A place where no mark is lit.
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

    /// The least of the draws so far, and another one.
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

/// Fate of frames with the Sun at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceVerdict {
    /// Its marks are read, and as no others.
    Safe,
    /// Fewer marks are lit on the sensor than make a mapping.
    FewMarks,
    /// Another labelling is nearly as likely.
    Ambiguous,
    /// The marks fit several places of the plate.
    SeveralPlaces,
    /// Its marks are read as others.
    Wrong,
}

impl PlaceVerdict {
    /// All of them, the best first.
    pub const ALL: [Self; 5] = [
        Self::Safe,
        Self::FewMarks,
        Self::Ambiguous,
        Self::SeveralPlaces,
        Self::Wrong,
    ];

    /// Its meaning.
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
    /// Why no frame can be read at all.
    #[serde(serialize_with = "as_text")]
    pub misfit: Option<LensMisfit>,
    pub places: Vec<CheckedPlace>,
}

impl PlateCheck {
    /// How many places have a verdict.
    pub fn count(&self, verdict: PlaceVerdict) -> usize {
        let places = self.places.iter();
        places.filter(|place| place.verdict == verdict).count()
    }

    /// The part of the field where frames cannot be read, and what most of it lacks; `None` where they can be read all over it.
    pub fn unreadable(&self) -> Option<(f64, &'static str)> {
        let bad = PlaceVerdict::ALL.into_iter().skip(1);
        let counts = bad.map(|verdict| (self.count(verdict), verdict.meaning()));
        let most = counts.max_by_key(|(count, _)| *count)?;
        let safe = self.count(PlaceVerdict::Safe);
        let part = 1.0 - safe as f64 / self.places.len().max(1) as f64;
        (most.0 > 0).then_some((part, most.1))
    }

    /// Whether frames can be read all over the field.
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

    /// A number of the places that have it, the least first.
    fn sorted(&self, of: impl Fn(&CheckedPlace) -> Option<f64>) -> Vec<f64> {
        let mut numbers: Vec<f64> = self.places.iter().filter_map(of).collect();
        numbers.sort_by(f64::total_cmp);
        numbers
    }
}

/// The check in few numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckSummary {
    /// Whether frames can be read all over the field.
    pub passes: bool,
    /// How many places have each verdict that any has.
    pub places: BTreeMap<PlaceVerdict, usize>,
    pub fewest_lit: Option<usize>,
    /// The part of the limb that no mark hides, where marks hide most of it.
    pub least_limb_free: Option<f64>,
    /// By how much the logarithm of the odds exceeds what is asked, at the worst place.
    pub least_margin: Option<f64>,
    /// Of the draws that are read when all that must be is found, the share that is read among clutter, too.
    pub read_among_clutter: Option<f64>,
    /// Of the Sun's place by noise, 1 sigma per axis.
    pub least_sigma_mil: Option<f64>,
    pub median_sigma_mil: Option<f64>,
    pub most_sigma_mil: Option<f64>,
    /// The same by misprints.
    pub most_misprint_mil: Option<f64>,
}

/// An error as its text.
fn as_text<S: Serializer>(misfit: &Option<LensMisfit>, out: S) -> Result<S::Ok, S::Error> {
    misfit.as_ref().map(ToString::to_string).serialize(out)
}
