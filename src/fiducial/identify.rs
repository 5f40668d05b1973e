//! Identification of the marks from the code in their spacings.
//!
//! The disc's outline and the ephemeris tell the local mapping before any mark is read, the crosses' arms its rotation,
//! but for the quarter turn. So a labelling is fixed by one detection's id and a quarter turn, and those that put the
//! plate's centre anywhere near the instrument's value are few enough to try them all. Each is followed over all
//! detections and scored by its evidence: what it explains and how closely, and what it would show and does not
//! ([`labelling`](super::labelling)).
//!
//! A pair, an L or a 2 x 2 block alone reads consistently at any quarter turn, a row at any place along the other
//! axis. Where the marks leave it open, where the plate's centre comes to lie may decide: a row at the pattern's edge, at
//! another quarter turn, is off by 22 px, which tells where the instrument states its centre to 5 px. A labelling
//! must beat all that contradict it, and chance, decisively; else all are refused.

use super::fit::Candidate;
use super::labelling::{Evidence, Id, Labelling, Partial, Turned};
use super::prior::IdentificationPrior;
use super::{Detection, Lighting, Settings};
use crate::geometry::TILT_PER_PX;
use crate::plate::{MarkId, Plate};
use crate::units::Rejected;

impl IdentificationPrior {
    /// Logarithm of the odds of the place where a labelling puts the plate's centre against the stated place: normally
    /// distributed about it, but for the cameras that were moved, whose plate may be anywhere within the largest shift.
    fn centre_odds(&self, labelling: &Labelling, settings: &Settings) -> f64 {
        let shift_px = labelling.plate_centre.distance(self.plate_centre);
        let variance = self.plate_centre_sigma_px.powi(2) + labelling.centre_sigma_px.powi(2);
        let narrower = settings.max_centre_shift_px.powi(2) / (2.0 * variance);
        let density =
            |fall: f64| MOVED_SHARE + (1.0 - MOVED_SHARE) * narrower.max(1.0) * (-fall).exp();
        (density(shift_px.powi(2) / (2.0 * variance)) / density(0.0)).ln()
    }

    /// Logarithm of the odds of a labelling's rotation against the stated one: normally distributed about it, but for the
    /// cameras that were turned, whose rotation may be any.
    fn rotation_odds(&self, labelling: &Labelling) -> f64 {
        let tilt_deg = (TILT_PER_PX * self.centre_distance_px()).to_degrees();
        let sigma_deg = self.rotation_deg.sigma.hypot(labelling.rotation_deg.sigma);
        let off_deg = labelling.rotation_deg.value - self.rotation_deg.value;
        let off_deg = (off_deg + 180.0).rem_euclid(360.0) - 180.0;
        let sigmas = off_deg / sigma_deg.hypot(tilt_deg);
        (TURNED_SHARE + (1.0 - TURNED_SHARE) * (-0.5 * sigmas * sigmas).exp()).ln()
    }

    /// How far a labelling's scale is from the stated one, in parts of what is allowed: five sigma, and what a tilted camera
    /// changes it by at the Sun.
    fn scale_off(&self, labelling: &Labelling) -> f64 {
        let stated = self.scale_mil_per_px;
        let sigma = stated.sigma.hypot(labelling.scale_mil_per_px.sigma);
        let tilted = 1.5 * TILT_PER_PX * self.centre_distance_px() * stated.value;
        (labelling.scale_mil_per_px.value - stated.value).abs() / (SCALE_SIGMAS * sigma + tilted)
    }

    /// Distance of the stated plate's centre from the Sun's.
    fn centre_distance_px(&self) -> f64 {
        (self.plate_centre.vector() - self.outline.centre).norm()
    }

    /// How far beyond the largest shift a labelling puts the plate's centre, px, in parts of what the marks on the disc
    /// leave open: it lies far outside.
    fn beyond(&self, labelling: &Labelling, settings: &Settings) -> f64 {
        let shift_px = labelling.plate_centre.distance(self.plate_centre);
        let from_sun = (labelling.plate_centre.vector() - self.outline.centre).norm();
        let open_px = 3.0 * labelling.centre_sigma_px + TILT_PER_PX * from_sun.powi(2);
        (shift_px - settings.max_centre_shift_px) / open_px
    }
}

/// Detections with their ids.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// Index into the detections, and the id.
    pub ids: Vec<(usize, MarkId)>,
    /// Logarithm of the odds against all other labellings together.
    pub odds: f64,
}

/// A labelling must beat all that contradict it together by this much, logarithm of the odds.
const DECISIVE_ODDS: f64 = 7.0;
/// The same for those that take one of its fully lit marks for a false detection: where they would show no other mark,
/// as at the pattern's edge, that detection alone decides. More is asked when the labelling itself leaves a fully lit
/// detection unexplained: where one is false another may be.
const SOUND_ODDS: f64 = 9.0;
const SOUND_ODDS_AMONG_FALSE: f64 = 11.0;
/// A labelling that is less likely than another by this is as good as none.
const NEGLIGIBLE_ODDS: f64 = 20.0;
/// Labellings are held against one another up to this much beyond the largest shift of the plate's centre: were the true
/// one left out, a wrong one would stand unrivalled.
const RIVALS_BEYOND: f64 = 2.0;
/// Share of the cameras that were moved since their mounting was stated.
const MOVED_SHARE: f64 = 0.01;
/// A rotation far from the stated one needs evidence a million times stronger.
const TURNED_SHARE: f64 = 1e-6;
/// A scale farther from the stated one, in sigma, is refused: nothing changes it as a turn of the camera changes the rotation.
const SCALE_SIGMAS: f64 = 5.0;
/// What rotation and scale leave open of a place before any mark is read, in parts of its distance.
const GUESS_ERROR: f64 = 0.03;

/// Names the detections. Rejected when they allow no labelling, or more than one.
pub fn identify(
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &Settings,
) -> Result<Identification, Rejected> {
    let full = detections
        .iter()
        .filter(|d| d.lighting == Lighting::Full)
        .count();
    if full < settings.min_marks {
        return Err(Rejected {
            reason: "too few fully lit marks",
            measured: full as f64,
            limit: settings.min_marks as f64,
        });
    }
    decide(
        &labellings(detections, prior, plate, settings),
        full,
        prior,
        settings,
    )
}

/// The best labelling of so many fully lit detections, if all that contradict it are unlikely together.
fn decide(
    labellings: &[Labelling],
    full: usize,
    prior: &IdentificationPrior,
    settings: &Settings,
) -> Result<Identification, Rejected> {
    let reject = |reason, measured, limit| {
        Err(Rejected {
            reason,
            measured,
            limit,
        })
    };
    let mut labellings: Vec<&Labelling> = labellings.iter().collect();
    labellings.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = settings.min_marks as f64;
    let Some(&best) = labellings.first() else {
        return reject("the marks' spacings allow no labelling", 0.0, least);
    };
    if best.full < settings.min_marks {
        let reason = "the best labelling explains too few fully lit marks";
        return reject(reason, best.full as f64, least);
    }
    if best.score < DECISIVE_ODDS {
        let reason = "the best labelling leaves too much unexplained";
        return reject(reason, best.score, DECISIVE_ODDS);
    }
    let odds = |against: &dyn Fn(&Labelling) -> bool| {
        let rivals = labellings
            .iter()
            .filter(|r| against(r) && r.contradicts(best));
        let rivals: f64 = rivals.map(|rival| (rival.score - best.score).exp()).sum();
        -(rivals + (-best.score).exp()).ln()
    };
    let alike = odds(&|rival| rival.full >= best.full);
    if alike < DECISIVE_ODDS {
        let reason = "two labellings of the marks fit alike";
        return reject(reason, alike, DECISIVE_ODDS);
    }
    let sound = odds(&|rival| rival.full < best.full);
    let asked = if best.full < full {
        SOUND_ODDS_AMONG_FALSE
    } else {
        SOUND_ODDS
    };
    if sound < asked {
        let reason = "the best labelling may rest on a false detection";
        return reject(reason, sound, asked);
    }
    let beyond = prior.beyond(best, settings);
    if beyond > 1.0 {
        let reason = "the best labelling puts the plate's centre too far away";
        return reject(reason, beyond, 1.0);
    }
    let scale_off = prior.scale_off(best);
    if scale_off > 1.0 {
        let reason = "the best labelling's scale contradicts the stated one";
        return reject(reason, scale_off, 1.0);
    }
    Ok(Identification {
        ids: best.named(),
        odds: alike.min(sound),
    })
}

/// Every labelling that some fully lit mark, some id for it and some quarter turn lead to.
fn labellings(
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &Settings,
) -> Vec<Labelling> {
    let full = |n: &usize| detections[*n].lighting == Lighting::Full;
    let full: Vec<usize> = (0..detections.len()).filter(full).collect();
    // A labelling, rivals included, has two of them: one is among all but the last.
    let anchors = &full[..full.len().saturating_sub(1)];
    let from_sun = (prior.plate_centre.vector() - prior.outline.centre).norm();
    let open_px = GUESS_ERROR * (from_sun + prior.outline.mean_radius());
    let reach_mil = (settings.max_centre_shift_px + open_px) * prior.mil_per_px();
    let in_view_mil = reach_mil + 1.1 * prior.radius_mil.value;
    let evidence = Evidence::new(prior, detections, &plate.cross);
    let mut marks = Vec::new();
    // Quicker than to collect them one by one.
    plate.marks().for_each(|mark| marks.push(mark));
    let turned =
        |(rotation_deg, turn)| Turned::new(&evidence, rotation_deg, turn, &marks, in_view_mil);
    let turns: Vec<Turned> = prior.turns().filter_map(turned).collect();
    let mut named = vec![Vec::new(); turns.len()];
    let mut labellings = Vec::new();
    for (tried, anchor) in anchors.iter().enumerate() {
        // What is not found yet names none of the anchors tried.
        if evidence.most_of(full.len() - tried) < least_that_counts(&labellings) {
            break;
        }
        let order = nearest_first(*anchor, &full, detections);
        let mut partial = Vec::new();
        for (turned, named) in turns.iter().zip(&mut named) {
            let here = partial_labellings(turned, &order, reach_mil, named).into_iter();
            let near = here.filter(|b| prior.beyond(&b.labelling, settings) < RIVALS_BEYOND);
            for labelling in near {
                named.extend_from_slice(&labelling.labelling.ids);
                partial.push((turned, labelling));
            }
        }
        // The likeliest first: many that can no longer count beside it end here.
        partial.sort_by(|(_, a), (_, b)| b.labelling.score.total_cmp(&a.labelling.score));
        for (turned, partial) in partial {
            if turned.most(&partial) > least_that_counts(&labellings) {
                let mut labelling = turned.complete(partial);
                labelling.score +=
                    prior.centre_odds(&labelling, settings) + prior.rotation_odds(&labelling);
                labellings.push(labelling);
            }
        }
    }
    labellings
}

/// The score below which a labelling is as good as none beside the best of others.
fn least_that_counts(labellings: &[Labelling]) -> f64 {
    let scores = labellings.iter().map(|labelling| labelling.score);
    scores.fold(f64::NEG_INFINITY, f64::max) - NEGLIGIBLE_ODDS
}

/// The labellings at one quarter turn that begin with the first detection of an order, where those that are named already
/// do not.
fn partial_labellings(
    turned: &Turned,
    order: &[usize],
    reach_mil: f64,
    named: &[Id],
) -> Vec<Partial> {
    let full: Vec<Candidate> = order.iter().map(|n| turned.candidate(*n)).collect();
    let from = full[0].offset + turned.stated_sun().vector();
    let known = named.iter().filter(|id| id.detection == order[0]);
    let known: Vec<MarkId> = known.map(|id| id.id).collect();
    let mut partial = Vec::new();
    for &(id, at) in &turned.printed.marks {
        let near = (at.vector() - from).norm_squared() < reach_mil * reach_mil;
        if near && !known.contains(&id) {
            partial.extend(turned.follow((id, at), &full));
        }
    }
    partial
}

/// Detections ordered by their distance from one of them.
fn nearest_first(from: usize, among: &[usize], detections: &[Detection]) -> Vec<usize> {
    let place = |n: usize| detections[n].at.vector();
    let distance = |n: usize| (place(n) - place(from)).norm_squared();
    let mut order = among.to_vec();
    order.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    order
}
