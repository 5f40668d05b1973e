//! A labelling: one hypothesis of the ids of all detections, and its evidence.
//!
//! # The model
//! The Sun is round on the plate, so its outline maps a position on the sensor to an offset from the Sun's centre on the
//! plate, in mil, up to a rotation. The arms determine that to a quarter turn; for marks without arms it is the stated
//! rotation. A labelling then fixes the position of the Sun's centre on the plate, and small corrections of rotation and
//! scale ([`LocalSimilarity`]). Its score is the logarithm of the evidence: the likelihood of the detections relative to
//! that of all being false. It is summed mark by mark, each compared with the position that the previous marks predict, in
//! order of distance from the first mark:
//!
//! | term | per |
//! |---|---|
//! | ln(found share x density of the position / density of false detections) | detection that is a mark |
//! | ln(missed share) | mark that must have been found and was not |
//! | ln(density of the contrast as a mark's / as a false detection's) | fully lit detection that is a mark |
//!
//! Shares, scatters and densities are those of [`prior`](super::prior).

use super::prior::{
    CUT_FOUND_SHARE, GATE_SIGMAS, IdentificationPrior, LIMB_BIAS_WIDTHS, LIT_LENGTHS,
    USABLE_LENGTHS, contrast_odds,
};
use super::similarity::LocalSimilarity;
use super::{Detection, Lighting};
use crate::geometry::Handedness;
use crate::plate::{MarkId, MarkShape, Plate};
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::TAU;

/// A detection with the mark that it is identified with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Match {
    /// Index of the detection.
    pub detection: usize,
    pub id: MarkId,
    printed: PlateMil,
    /// Whether its position may be used.
    usable: bool,
}

/// Ids of detections.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Labelling {
    /// Every detection that the labelling explains.
    pub matches: Vec<Match>,
    /// Number of fully lit marks among them.
    pub full: usize,
    /// The plate's centre, extrapolated from the marks, and its 1 sigma per axis, px.
    pub plate_centre: SensorPx,
    pub centre_sigma_px: f64,
    /// Rotation of the plate's axes at the Sun's position, and scale there.
    pub rotation_deg: Measured,
    pub scale_mil_per_px: Measured,
    /// Logarithm of the evidence.
    pub score: f64,
    /// Part of the score that comes from the stated position of the plate's centre.
    pub centre_odds: f64,
}

impl Labelling {
    /// The detections with usable positions, with their ids.
    pub(super) fn usable(&self) -> Vec<(usize, MarkId)> {
        let usable = self.matches.iter().filter(|m| m.usable);
        usable.map(|m| (m.detection, m.id)).collect()
    }

    /// The id of a detection.
    pub(super) fn id_of(&self, detection: usize) -> Option<MarkId> {
        let found = self.matches.iter().find(|m| m.detection == detection)?;
        Some(found.id)
    }

    /// Whether two labellings cannot both be true: they give a detection different ids, or have none in common.
    pub(super) fn contradicts(&self, other: &Self) -> bool {
        let mut agree = self
            .matches
            .iter()
            .filter_map(|m| Some(other.id_of(m.detection)? == m.id))
            .peekable();
        agree.peek().is_none() || agree.any(|agrees| !agrees)
    }
}

/// A detection as an offset from the Sun's centre on the plate.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    detection: usize,
    offset: Vector2<f64>,
    /// Variance per axis, mil^2, without the limb's bias.
    variance: f64,
    lighting: Lighting,
}

/// Detections and printed marks at one rotation: the common input of its labellings.
pub(super) struct Scene<'a> {
    pub prior: &'a IdentificationPrior,
    detections: &'a [Detection],
    shape: &'a MarkShape,
    /// Rotation of the plate's axes on the sensor.
    rotation_deg: Measured,
    /// From offsets on the plate, mil, to the unit disc.
    to_disc: Matrix2<f64>,
    /// One candidate per detection.
    candidates: Vec<Candidate>,
    /// Predicted position of the Sun's centre on the plate, from the stated plate centre.
    expected_sun: PlateMil,
    /// The marks that may be in view.
    marks: Vec<(MarkId, PlateMil)>,
}

impl<'a> Scene<'a> {
    /// The detections at one of [`IdentificationPrior::turns`], with the plate's marks within `in_view_mil` of the Sun's
    /// expected position; `None` if the outline has zero size.
    pub(super) fn new(
        prior: &'a IdentificationPrior,
        detections: &'a [Detection],
        plate: &'a Plate,
        (rotation_deg, to_plate): (Measured, Matrix2<f64>),
        in_view_mil: f64,
    ) -> Option<Self> {
        let scatter_mil2 = prior.scatter_mil2(plate.drawing_sigma_mil());
        let offset = |at: SensorPx| to_plate * prior.outline.to_disc(at.vector());
        let candidate = |(n, detection): (usize, &Detection)| Candidate {
            detection: n,
            offset: offset(detection.at),
            variance: scatter_mil2 + (detection.sigma_px * prior.mil_per_px()).powi(2),
            lighting: detection.lighting,
        };
        let expected_sun = PlateMil::from(-offset(prior.plate_centre));
        let in_view = |(_, at): &(MarkId, PlateMil)| at.distance(expected_sun) < in_view_mil;
        let marks = plate.marks_about(expected_sun, in_view_mil).filter(in_view);
        Some(Self {
            prior,
            detections,
            shape: &plate.shape,
            rotation_deg,
            to_disc: to_plate.try_inverse()?,
            candidates: detections.iter().enumerate().map(candidate).collect(),
            expected_sun,
            marks: marks.collect(),
        })
    }

    /// The possible marks of a detection if the plate's centre is less than `reach_mil` from the stated one.
    pub(super) fn marks_about(
        &self,
        detection: usize,
        reach_mil: f64,
    ) -> impl Iterator<Item = (MarkId, PlateMil)> {
        let expected = self.expected_sun.vector() + self.candidates[detection].offset;
        let marks = self.marks.iter().copied();
        marks.filter(move |(_, at)| (at.vector() - expected).norm() < reach_mil)
    }

    /// The possible marks of one detection if another detection is a mark as well, for any plate centre.
    pub(super) fn marks_of_pair(
        &self,
        [first, second]: [usize; 2],
        places: &Places,
    ) -> Vec<(MarkId, PlateMil)> {
        let [first, second] = [first, second].map(|n| &self.candidates[n]);
        let step = second.offset - first.offset;
        let relative = self.prior.radius_mil.sigma / self.prior.radius_mil.value;
        let turned = self.rotation_deg.sigma.to_radians();
        let by_step = step.norm_squared() * (relative.powi(2) + turned.powi(2));
        let reach_mil = GATE_SIGMAS * (first.variance + second.variance + by_step).sqrt();
        let is_pair =
            |(_, at): &&(MarkId, PlateMil)| places.hold_any((at.vector() + step).into(), reach_mil);
        self.marks.iter().filter(is_pair).copied().collect()
    }

    /// The labelling that results if the first of some fully lit detections is the mark `anchor`; the others are tried in
    /// their order, then those that the limb cuts. `None` if it explains fewer than two fully lit detections.
    pub(super) fn follow(
        &self,
        anchor: (MarkId, PlateMil),
        full: &[usize],
        lists: &mut Lists,
    ) -> Option<Labelling> {
        let (first, others) = full.split_first()?;
        let mut hypothesis = Hypothesis::new(self, &self.candidates[*first], anchor, lists);
        for (tried, n) in others.iter().enumerate() {
            let explained = hypothesis.lists.matches.len() - 1;
            if tried == NEAREST_OF_MANY && explained == 0 && full.len() > MANY_DETECTIONS {
                return None;
            }
            hypothesis.explain(&self.candidates[*n]);
        }
        let full = hypothesis.lists.matches.len();
        if full < 2 {
            return None;
        }
        hypothesis.score += hypothesis.contrast_odds();
        let cut = |candidate: &&Candidate| candidate.lighting == Lighting::Cut;
        for candidate in self.candidates.iter().filter(cut) {
            hypothesis.explain(candidate);
        }
        hypothesis.score += hypothesis.missed() as f64 * self.prior.missed_share.ln();
        Some(hypothesis.labelling(full))
    }

    /// Upper bound of the score of any labelling that explains, of the fully lit detections, none but these: each at its
    /// predicted position, with the contrast of the others, and the first without evidence of its own.
    pub(super) fn most_score(&self, full: &[usize]) -> f64 {
        let peak = |candidate: &Candidate| {
            let density = -(TAU * candidate.variance).ln();
            let found = (self.prior.found_share() / self.prior.false_density()).ln();
            (found + density).max(0.0)
        };
        let of_full = full
            .iter()
            .map(|n| peak(&self.candidates[*n]) + contrast_odds(0.0));
        let is_cut = |candidate: &&Candidate| candidate.lighting == Lighting::Cut;
        let of_cut = self.candidates.iter().filter(is_cut).map(peak);
        let least = of_full.clone().fold(f64::INFINITY, f64::min);
        of_full.sum::<f64>() - least + of_cut.sum::<f64>()
    }

    fn to_sensor(&self, offset: Vector2<f64>) -> SensorPx {
        let on_disc = self.to_disc * offset;
        self.prior.outline.from_disc(on_disc).into()
    }

    /// Inward bias of a mark that the limb cuts, 1 sigma, mil.
    fn limb_bias_mil(&self, offset: Vector2<f64>) -> f64 {
        let depth = self.prior.radius_mil.value - offset.norm();
        let lit_depth = LIT_LENGTHS * self.shape.size_mil();
        self.largest_bias_mil() * (1.0 - depth / lit_depth).clamp(0.0, 1.0)
    }

    fn largest_bias_mil(&self) -> f64 {
        LIMB_BIAS_WIDTHS * self.shape.line_mil()
    }
}

/// More fully lit detections than this are many: more than the pattern of 2013 shows.
pub(super) const MANY_DETECTIONS: usize = 24;
/// The nearest eight of them are not all false.
const NEAREST_OF_MANY: usize = 8;

/// The positions of a plate's marks, sorted by x.
pub(super) struct Places(Vec<PlateMil>);

impl Places {
    pub(super) fn of(plate: &Plate) -> Self {
        let mut places: Vec<PlateMil> = plate.marks().map(|(_, at)| at).collect();
        places.sort_by(|a, b| a.x.total_cmp(&b.x));
        Self(places)
    }

    /// Whether any mark lies within `reach_mil` of a position.
    fn hold_any(&self, at: PlateMil, reach_mil: f64) -> bool {
        let first = self.0.partition_point(|place| place.x < at.x - reach_mil);
        let near = self.0[first..]
            .iter()
            .take_while(|place| place.x <= at.x + reach_mil);
        near.into_iter().any(|place| place.distance(at) < reach_mil)
    }
}

/// Buffers of a labelling under construction, reused for the next one.
#[derive(Default)]
pub(super) struct Lists {
    /// The marks on the disc or near it, for the current first mark.
    marks: Vec<(MarkId, PlateMil)>,
    matches: Vec<Match>,
    contrasts: Vec<f64>,
}

/// A labelling under construction.
struct Hypothesis<'a, 'l> {
    scene: &'a Scene<'a>,
    fit: LocalSimilarity,
    lists: &'l mut Lists,
    score: f64,
}

impl<'a, 'l> Hypothesis<'a, 'l> {
    fn new(
        scene: &'a Scene<'a>,
        first: &Candidate,
        (id, printed): (MarkId, PlateMil),
        lists: &'l mut Lists,
    ) -> Self {
        let (radius, rotation) = (scene.prior.radius_mil, scene.rotation_deg);
        let mut fit =
            LocalSimilarity::new(radius.sigma / radius.value, rotation.sigma.to_radians());
        fit.add(first.offset, printed, first.variance);
        let sun = printed.vector() - first.offset;
        let reach = radius.value + GATE_SIGMAS * scene.largest_bias_mil();
        let near = |(_, at): &&(MarkId, PlateMil)| (at.vector() - sun).norm() < reach;
        lists.marks.clear();
        lists.marks.extend(scene.marks.iter().filter(near));
        lists.matches.clear();
        lists.matches.push(Match {
            detection: first.detection,
            id,
            printed,
            usable: true,
        });
        Self {
            scene,
            fit,
            lists,
            score: scene.prior.found_share().ln(),
        }
    }

    /// Adds a candidate if it is the mark that is printed nearest to its predicted position; does nothing if it is not.
    fn explain(&mut self, candidate: &Candidate) {
        let (scene, prior) = (self.scene, self.scene.prior);
        let place = self.fit.place(candidate.offset);
        let Some((id, printed)) = self.nearest_mark(place) else {
            return;
        };
        let full = candidate.lighting == Lighting::Full;
        let bias = match full {
            true => 0.0,
            false => scene.limb_bias_mil(self.fit.offset(printed)),
        };
        let variance = candidate.variance + bias.powi(2);
        let density = self.fit.log_density(candidate.offset, printed, variance);
        let Some(density) = density.filter(|_| self.lists.matches.iter().all(|m| m.id != id))
        else {
            return;
        };
        let found_share = match full || self.must_be_found(printed) {
            true => prior.found_share(),
            false => CUT_FOUND_SHARE,
        };
        let usable = place.distance(printed) < USABLE_LENGTHS * scene.shape.size_mil();
        self.score += density + (found_share / prior.false_density()).ln();
        self.lists.matches.push(Match {
            detection: candidate.detection,
            id,
            printed,
            usable: full || usable,
        });
        if full {
            self.fit.add(candidate.offset, printed, candidate.variance);
        }
    }

    fn nearest_mark(&self, place: PlateMil) -> Option<(MarkId, PlateMil)> {
        let (mut nearest, mut least) = (None, f64::INFINITY);
        for mark in &self.lists.marks {
            let square = (mark.1.vector() - place.vector()).norm_squared();
            if square < least {
                (nearest, least) = (Some(*mark), square);
            }
        }
        nearest
    }

    /// Whether a mark lies deep enough in the disc and far enough from the sensor's edge to be found whatever its contrast.
    fn must_be_found(&self, printed: PlateMil) -> bool {
        let prior = self.scene.prior;
        let offset = self.fit.offset(printed);
        offset.norm() < prior.sure_reach_mil() && prior.on_sensor(self.scene.to_sensor(offset))
    }

    /// Number of marks that must have been found and were not.
    fn missed(&self) -> usize {
        let expected = self.lists.marks.iter().map(|(_, printed)| printed);
        let found = self.lists.matches.iter().map(|m| &m.printed);
        let sure = |printed: &&PlateMil| self.must_be_found(**printed);
        expected.filter(sure).count() - found.filter(sure).count()
    }

    /// Log odds of the contrasts as those of one print against those of false detections. The print's contrast is unknown,
    /// so the first one is no evidence.
    fn contrast_odds(&mut self) -> f64 {
        let detections = self.scene.detections;
        let contrast = |m: &Match| detections[m.detection].contrast.ln();
        let Lists {
            matches, contrasts, ..
        } = &mut *self.lists;
        contrasts.clear();
        contrasts.extend(matches.iter().map(contrast));
        contrasts.sort_by(f64::total_cmp);
        let median = contrasts[contrasts.len() / 2];
        let odds = contrasts.iter().map(|c| contrast_odds(c - median));
        odds.sum::<f64>() - contrast_odds(0.0)
    }

    /// The finished labelling; `full` is its number of fully lit marks.
    fn labelling(self, full: usize) -> Labelling {
        let (prior, fit) = (self.scene.prior, &self.fit);
        let centre = fit.offset(PlateMil::new(0.0, 0.0));
        let on_plate = fit.rotation_deg();
        // A mirror reverses the sense of rotation.
        let on_sensor = match prior.handedness {
            Handedness::Mirrored => on_plate.value,
            Handedness::Direct => -on_plate.value,
        };
        Labelling {
            full,
            plate_centre: self.scene.to_sensor(centre),
            centre_sigma_px: fit.variance(centre).sqrt() / prior.mil_per_px(),
            rotation_deg: Measured::new(self.scene.rotation_deg.value + on_sensor, on_plate.sigma),
            scale_mil_per_px: fit.scale(prior.mil_per_px()),
            matches: self.lists.matches.clone(),
            score: self.score,
            centre_odds: 0.0,
        }
    }
}
