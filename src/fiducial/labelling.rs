//! A labelling: one way to give the marks their ids, and how well it explains what is seen.
//!
//! # The model
//! The Sun is round on the plate, so its outline turns a position on the sensor into an offset from the Sun's centre on
//! the plate, in mil, but for a rotation; the arms give that to a quarter turn. A labelling then says where on the plate
//! the Sun's centre lies, and by how much rotation and scale differ from what arms and ephemeris say. Its score is the
//! logarithm of the evidence: how much likelier the detections are under it than if all were false, every place of the
//! Sun, rotation and scale being weighed as far as it was likely beforehand. It is summed mark by mark, each held
//! against the place that the marks before it predict, the nearest to the first mark first.

use super::fit::{Candidate, Explained, GATE_SIGMAS, LocalSimilarity, Printed};
use super::prior::IdentificationPrior;
use super::{Detection, Lighting};
use crate::geometry::Handedness;
use crate::plate::{Cross, MarkId};
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{PI, TAU};

/// Scatter of a mark about its place, 1 sigma per axis: print (1 mil rms) and what keystone leaves over the disc.
const SCATTER_MIL: f64 = 1.3;
/// The limb pulls a mark that it cuts inwards: 1 sigma at the limb itself, from where it falls to none for a mark that
/// is fully lit. Measured on simulated frames it falls faster: 12, 4, 1.5 and 0.4 mil at depths of 0, 15, 27 and 45 mil.
const PULL_MIL: f64 = 12.0;
/// Depth at which a mark is fully lit, in half lengths from tip to tip; the limb's blur included.
const LIT_HALF_LENGTHS: f64 = 1.4;
/// Farthest that a mark with an id is seen from its place, mil: one that the limb pulls farther has no position to give.
const NAMED_WITHIN_MIL: f64 = 9.0;
/// The same where the limb cuts more than a mark may lose.
const CUT_FOUND_SHARE: f64 = 0.5;
/// False detections on a disc.
const FALSE_ON_DISC: f64 = 1.0;
/// Contrasts of a print scatter by this, 1 sigma of the logarithm.
const CONTRAST_SCATTER: f64 = 0.12;
/// Part of the marks whose contrast is another: a scratch or a sunspot lies on them.
const ATYPICAL_SHARE: f64 = 0.02;
/// Part of the false detections that look like marks; the contrast of the others is any from 0.12 to 1.2.
const LIKE_MARKS: f64 = 0.4;
const ANY_CONTRAST: f64 = 2.3;

/// An id given to a detection (by index).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Id {
    pub detection: usize,
    pub id: MarkId,
    /// Where the mark of that id is printed.
    printed: PlateMil,
    /// Whether it is seen where it should be.
    in_place: bool,
}

impl Explained {
    fn id(&self, in_place: bool) -> Id {
        Id {
            detection: self.candidate.detection,
            id: self.id,
            printed: self.at,
            in_place,
        }
    }
}

/// Ids given to detections.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Labelling {
    /// Every detection that the labelling explains.
    pub ids: Vec<Id>,
    /// Fully lit marks among them.
    pub full: usize,
    /// Where the labelling puts the plate's centre, and how well the marks on the disc tell it, px.
    pub plate_centre: SensorPx,
    pub centre_sigma_px: f64,
    /// Rotation of the plate's axes at the Sun, and scale there.
    pub rotation_deg: Measured,
    pub scale_mil_per_px: Measured,
    /// Logarithm of how much likelier the detections are under the labelling than if all were false.
    pub score: f64,
}

/// A labelling of the fully lit marks alone; its score counts these as they are placed and no more.
pub(super) struct Partial {
    pub labelling: Labelling,
    fit: LocalSimilarity,
    /// Where it puts the Sun's centre on the plate, mil.
    sun: Vector2<f64>,
}

impl Labelling {
    /// The detections that lie where they should.
    pub(super) fn named(&self) -> Vec<(usize, MarkId)> {
        let ids = self.ids.iter().filter(|id| id.in_place);
        ids.map(|id| (id.detection, id.id)).collect()
    }

    /// Whether two labellings cannot both be true: they name a detection differently, or have none in common.
    pub(super) fn contradicts(&self, other: &Self) -> bool {
        let mut shared = self.ids.iter().filter_map(|here| {
            let mut there = other.ids.iter();
            let there = there.find(|there| there.detection == here.detection)?;
            Some(there.id == here.id)
        });
        match shared.next() {
            None => true,
            Some(first_agrees) => !first_agrees || shared.any(|agrees| !agrees),
        }
    }
}

/// What all labellings share.
pub(super) struct Evidence<'a> {
    prior: &'a IdentificationPrior,
    detections: &'a [Detection],
    /// What is known of scale and rotation before any mark is read.
    fit: LocalSimilarity,
    /// Of the detections' positions, were they fully lit marks, mil^2.
    variances: Vec<f64>,
    /// Logarithms of the detections' contrasts.
    contrasts: Vec<f64>,
    by_contrast: Vec<usize>,
    /// Depth inside the limb at which a mark is fully lit, mil.
    lit_depth_mil: f64,
    /// Distance from the Sun's centre within which a mark must have been found, mil.
    sure_reach_mil: f64,
    /// Whether all of the disc so near to its centre is far enough from the sensor's edge.
    sure_on_sensor: bool,
    /// Logarithms of the shares of marks that are found, found where the limb cuts too much, and missed.
    found: f64,
    cut_found: f64,
    missed: f64,
    /// False detections per mil^2, logarithm.
    false_density: f64,
}

impl<'a> Evidence<'a> {
    pub(super) fn new(
        prior: &'a IdentificationPrior,
        detections: &'a [Detection],
        cross: &Cross,
    ) -> Self {
        let radius_mil = prior.radius_mil.value;
        let variance = |detection: &Detection| {
            SCATTER_MIL.powi(2) + (detection.sigma_px * prior.mil_per_px()).powi(2)
        };
        let sure_reach_mil = radius_mil - prior.sure_depth_px * prior.mil_per_px();
        let sure_reach_mil = sure_reach_mil.max(0.0);
        let corner =
            prior.outline.root().map(f64::abs).column_sum() * (sure_reach_mil / radius_mil);
        let on_sensor = |at: Vector2<f64>| prior.on_sensor(at.into());
        let contrasts: Vec<f64> = detections
            .iter()
            .map(|detection| detection.contrast.ln())
            .collect();
        let mut by_contrast: Vec<usize> = (0..detections.len()).collect();
        by_contrast.sort_by(|a, b| contrasts[*a].total_cmp(&contrasts[*b]));
        Self {
            prior,
            detections,
            fit: LocalSimilarity::new(prior),
            variances: detections.iter().map(variance).collect(),
            contrasts,
            by_contrast,
            lit_depth_mil: LIT_HALF_LENGTHS * cross.arm_length_mil / 2.0,
            sure_reach_mil,
            sure_on_sensor: on_sensor(prior.outline.centre - corner)
                && on_sensor(prior.outline.centre + corner),
            found: prior.found_share().ln(),
            cut_found: CUT_FOUND_SHARE.ln(),
            missed: prior.missed_share.ln(),
            false_density: (FALSE_ON_DISC / (PI * radius_mil.powi(2))).ln(),
        }
    }

    /// The highest score that a labelling may come to that explains so many fully lit marks.
    pub(super) fn most_of(&self, full: usize) -> f64 {
        let cut = (0..self.detections.len()).filter(|n| !self.is_full(*n));
        full as f64 * gain(0.0) + (full + cut.count()) as f64 * self.most_per_mark()
    }

    /// The most that the place of a mark adds to a score.
    fn most_per_mark(&self) -> f64 {
        -TAU.ln() - (SCATTER_MIL * SCATTER_MIL).ln() - self.false_density
    }

    fn is_full(&self, n: usize) -> bool {
        self.detections[n].lighting == Lighting::Full
    }

    /// How far the limb may pull a mark inwards, 1 sigma, mil.
    fn pull_mil(&self, offset: Vector2<f64>) -> f64 {
        let depth = self.prior.radius_mil.value - offset.norm();
        PULL_MIL * (1.0 - depth / self.lit_depth_mil).clamp(0.0, 1.0)
    }

    /// Whether a mark that explains a detection is printed on the disc or near it and is no other detection's.
    fn allows(&self, explained: &Explained, ids: &[Id], sun: Vector2<f64>) -> bool {
        let reach = self.prior.radius_mil.value + GATE_SIGMAS * PULL_MIL;
        (explained.at.vector() - sun).norm_squared() < reach * reach
            && ids.iter().all(|taken| taken.id != explained.id)
    }

    /// How much likelier the contrasts are as those of one print than as false ones'; the first tells nothing, since
    /// the print's contrast is not known beforehand.
    fn contrast_odds(&self, ids: &[Id]) -> f64 {
        let named = |n: &&usize| ids.iter().any(|id| id.detection == **n);
        let mut ordered = self.by_contrast.iter().filter(named);
        let median = ordered
            .nth(ids.len() / 2)
            .map_or(0.0, |n| self.contrasts[*n]);
        let gains = ids
            .iter()
            .map(|id| gain(self.contrasts[id.detection] - median));
        gains.sum::<f64>() - gain(0.0)
    }
}

/// How much likelier a contrast so far from the median one is as a mark's than as a false detection's; all of them logarithms.
fn gain(off: f64) -> f64 {
    let off = off / CONTRAST_SCATTER;
    let print = (-0.5 * off * off).exp() / (CONTRAST_SCATTER * TAU.sqrt());
    let mark = (1.0 - ATYPICAL_SHARE) * print + ATYPICAL_SHARE / ANY_CONTRAST;
    let other = LIKE_MARKS * print + (1.0 - LIKE_MARKS) / ANY_CONTRAST;
    (mark / other).ln()
}

/// The picture at one quarter turn, as offsets from the Sun's centre on the plate.
pub(super) struct Turned<'a> {
    evidence: &'a Evidence<'a>,
    /// Rotation of the plate's axes on the sensor, deg.
    rotation_deg: f64,
    /// From offsets on the plate, mil, to the unit disc.
    from_plate: Matrix2<f64>,
    /// Of the detections, mil.
    offsets: Vec<Vector2<f64>>,
    /// Those that the limb cuts and may have pulled inwards.
    cut: Vec<Candidate>,
    /// Offset of the place where the instrument says the plate's centre is seen, mil.
    centre: Vector2<f64>,
    /// The marks that may be in view.
    pub printed: Printed,
}

impl<'a> Turned<'a> {
    /// With those of some marks that lie about the place where the Sun should be; `None` when the outline has no size.
    pub(super) fn new(
        evidence: &'a Evidence<'a>,
        rotation_deg: f64,
        to_plate: Matrix2<f64>,
        marks: &[(MarkId, PlateMil)],
        in_view_mil: f64,
    ) -> Option<Self> {
        let offset = |at: SensorPx| to_plate * evidence.prior.outline.to_disc(at.vector());
        let centre = offset(evidence.prior.plate_centre);
        let mut turned = Self {
            evidence,
            rotation_deg,
            from_plate: to_plate.try_inverse()?,
            offsets: evidence.detections.iter().map(|d| offset(d.at)).collect(),
            cut: Vec::new(),
            centre,
            printed: Printed::about((-centre).into(), in_view_mil, marks),
        };
        turned.cut = turned.cut_candidates();
        Some(turned)
    }

    /// Where the Sun's centre would be on the plate if the instrument were right about the plate's centre.
    pub(super) fn stated_sun(&self) -> PlateMil {
        (-self.centre).into()
    }

    fn to_sensor(&self, offset: Vector2<f64>) -> SensorPx {
        let outline = &self.evidence.prior.outline;
        outline.from_disc(self.from_plate * offset).into()
    }

    /// Where a detection is.
    pub(super) fn candidate(&self, detection: usize) -> Candidate {
        Candidate {
            detection,
            offset: self.offsets[detection],
            variance: self.evidence.variances[detection],
        }
    }

    /// Where the detections are that the limb cuts and may have pulled inwards.
    fn cut_candidates(&self) -> Vec<Candidate> {
        let cut = (0..self.offsets.len()).filter(|n| !self.evidence.is_full(*n));
        cut.map(|n| self.candidate(n)).collect()
    }

    /// The labelling that follows when the first of the fully lit detections is the mark `anchor`; the others are tried in
    /// their order. `None` when it explains fewer than two of them.
    pub(super) fn follow(&self, anchor: (MarkId, PlateMil), full: &[Candidate]) -> Option<Partial> {
        let (evidence, printed) = (self.evidence, &self.printed);
        let (first, others) = full.split_first()?;
        let mut fit = evidence.fit;
        fit.add(first.offset, anchor.1, first.variance);
        let variance = |candidate: &Candidate, _| candidate.variance;
        // Most anchors explain no other: they end here.
        let mut next = Some(printed.explain(others, &fit, variance)?);
        let sun = anchor.1.vector() - first.offset;
        let mut score = evidence.found;
        let mut ids = Vec::with_capacity(evidence.detections.len());
        ids.push(Id {
            detection: first.detection,
            id: anchor.0,
            printed: anchor.1,
            in_place: true,
        });
        while let Some((explained, rest)) = next {
            if evidence.allows(&explained, &ids, sun) {
                fit.add(
                    explained.candidate.offset,
                    explained.at,
                    explained.candidate.variance,
                );
                ids.push(explained.id(true));
                score += evidence.found + explained.likelihood - evidence.false_density;
            }
            next = printed.explain(rest, &fit, variance);
        }
        if ids.len() < 2 {
            return None;
        }
        let centre = fit.offset(PlateMil::new(0.0, 0.0));
        let labelling = Labelling {
            full: ids.len(),
            score,
            ids,
            plate_centre: self.to_sensor(centre),
            centre_sigma_px: fit.variance(centre).sqrt() / evidence.prior.mil_per_px(),
            rotation_deg: self.rotation_deg(&fit),
            scale_mil_per_px: fit.scale(evidence.prior.mil_per_px()),
        };
        Some(Partial {
            labelling,
            fit,
            sun,
        })
    }

    /// Rotation of the plate's axes on the sensor by a fit.
    fn rotation_deg(&self, fit: &LocalSimilarity) -> Measured {
        let on_plate = fit.rotation_deg();
        // A mirror turns the other way round.
        let on_sensor = match self.evidence.prior.handedness {
            Handedness::Mirrored => on_plate.value,
            Handedness::Direct => -on_plate.value,
        };
        Measured::new(self.rotation_deg + on_sensor, on_plate.sigma)
    }

    /// A labelling with all that it explains and leaves unexplained.
    pub(super) fn complete(&self, partial: Partial) -> Labelling {
        let Partial {
            mut labelling,
            fit,
            sun,
        } = partial;
        labelling.score += self.evidence.contrast_odds(&labelling.ids);
        self.add_cut(&mut labelling, &fit, sun);
        labelling.score += self.absences(&fit, &labelling.ids);
        labelling
    }

    /// The highest score that a labelling may come to.
    pub(super) fn most(&self, partial: &Partial) -> f64 {
        let contrast_odds = partial.labelling.full as f64 * gain(0.0);
        partial.labelling.score
            + contrast_odds
            + self.cut.len() as f64 * self.evidence.most_per_mark()
    }

    /// Adds to a labelling what it explains of the detections that the limb cuts.
    fn add_cut(&self, labelling: &mut Labelling, fit: &LocalSimilarity, sun: Vector2<f64>) {
        let evidence = self.evidence;
        let variance = |candidate: &Candidate, at| {
            candidate.variance + evidence.pull_mil(fit.offset(at)).powi(2)
        };
        let mut candidates = &self.cut[..];
        while let Some((explained, rest)) = self.printed.explain(candidates, fit, variance) {
            candidates = rest;
            if evidence.allows(&explained, &labelling.ids, sun) {
                let seen_at = fit.place(explained.candidate.offset);
                let in_place = seen_at.distance(explained.at) < NAMED_WITHIN_MIL;
                labelling.ids.push(explained.id(in_place));
                let found = match self.must_be_found(fit)(explained.at) {
                    true => evidence.found,
                    false => evidence.cut_found,
                };
                labelling.score += found + explained.likelihood - evidence.false_density;
            }
        }
    }

    /// Tells of a mark at a place whether it lies deep enough in the disc and far enough from the sensor's edge to be found.
    fn must_be_found(&self, fit: &LocalSimilarity) -> impl Fn(PlateMil) -> bool {
        let evidence = self.evidence;
        let sun = fit.place(Vector2::zeros()).vector();
        let reach2 = evidence.sure_reach_mil.powi(2) * fit.stretch2();
        let on_sensor = move |at| evidence.prior.on_sensor(self.to_sensor(fit.offset(at)));
        move |at: PlateMil| {
            (at.vector() - sun).norm_squared() < reach2
                && (evidence.sure_on_sensor || on_sensor(at))
        }
    }

    /// What the marks that must have been found and are not take from the score.
    fn absences(&self, fit: &LocalSimilarity, ids: &[Id]) -> f64 {
        let must_be_found = self.must_be_found(fit);
        let expected = self
            .printed
            .marks
            .iter()
            .filter(|(_, at)| must_be_found(*at))
            .count();
        let found = ids.iter().filter(|id| must_be_found(id.printed)).count();
        (expected - found) as f64 * self.evidence.missed
    }
}
