//! Identification of the marks from their relative positions.
//!
//! The disc's outline and the ephemeris determine the local mapping before any mark is identified, and the crosses' arms
//! its rotation, up to a quarter turn; for marks without arms the stated rotation is used, in steps over its uncertainty.
//! So one detection's id and a rotation fix a labelling, and the labellings that put the plate's centre anywhere near the
//! stated position are few enough to try them all:
//!
//! 1. [`identify`] tries each of them.
//! 2. [`labelling`](super::labelling) extends one to all detections and scores it by its evidence: the detections that it
//!    explains and how closely, and the predicted marks that were not found.
//! 3. [`prior`](super::prior) adds the odds of plate centre and rotation against the stated ones; the printed positions are
//!    the [plate's](crate::plate).
//!
//! A pair, an L or a 2 x 2 block alone is consistent at any quarter turn, a row at any position along the other axis. If
//! the marks leave it open, the plate's centre may decide: a row at the pattern's edge, at another quarter turn, shifts it
//! by 22 px, which is significant if the instrument states it to 5 px. A labelling must be decisively more likely than all
//! that contradict it, and than chance; otherwise all are rejected.
//!
//! The pattern of 2013 has no two places with the same pattern. Another plate may: if the marks in view fit another place
//! equally well, however far away, the stated centre alone would decide, and for a camera that was moved since, all frames
//! would be wrong. Such a labelling is rejected.

use super::labelling::{Labelling, Lists, MANY_DETECTIONS, Places, Scene};
use super::prior::{
    DECISIVE_ODDS, FALSE_MARK_ODDS, FALSE_MARK_ODDS_AMONG_FALSE, IdentificationPrior,
    PREDICTION_ERROR, RIVAL_EXCESS,
};
use super::{Detection, FiducialSettings, Lighting};
use crate::plate::{MarkId, Pattern, Plate};
use crate::reasons::sun;
use crate::units::Rejected;

/// Of many fully lit detections only so many are tried as the first one of a labelling: a labelling that explains none of
/// these is no rival of one that explains most.
const ANCHORS_OF_MANY: usize = 8;
/// Labellings with odds beyond this against them change no decision, even a million of them.
const OVERWHELMING_ODDS: f64 = 25.0;

/// Number of detections that are tried as the first one of a labelling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Anchors {
    /// Stop when no labelling that starts from another detection can matter.
    UntilDecided,
    All,
}

/// Why detections have no ids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unread {
    /// There is no labelling, or more than one.
    Undecided(Rejected),
    /// There is one labelling, which contradicts the stated mounting of the camera.
    Contradicting(Rejected),
}

impl Unread {
    pub fn rejected(self) -> Rejected {
        match self {
            Self::Undecided(rejected) | Self::Contradicting(rejected) => rejected,
        }
    }
}

impl From<Rejected> for Unread {
    fn from(rejected: Rejected) -> Self {
        Self::Undecided(rejected)
    }
}

/// Detections with their ids.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Index of the detection, and id.
    pub ids: Vec<(usize, MarkId)>,
    /// Difference between the logarithm of the odds and its limit, in the closest comparison.
    pub margin: f64,
}

/// Identifies the detections.
///
/// # Errors
/// If there is no labelling, more than one, or one that contradicts the stated mounting.
pub fn identify(
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &FiducialSettings,
) -> Result<Vec<(usize, MarkId)>, Unread> {
    let anchors = Anchors::UntilDecided;
    Ok(identify_by(anchors, detections, prior, plate, settings)?.ids)
}

/// The same with its margin. The margin depends also on the least likely rivals, so all labellings are tried.
///
/// # Errors
/// As [`identify`].
pub fn identify_with_margin(
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &FiducialSettings,
) -> Result<Identified, Unread> {
    identify_by(Anchors::All, detections, prior, plate, settings)
}

fn identify_by(
    anchors: Anchors,
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &FiducialSettings,
) -> Result<Identified, Unread> {
    let full = fully_lit(detections);
    let (count, least) = (full.len() as f64, settings.min_marks as f64);
    Rejected::at_least(least, count, sun::FEW_LIT_MARKS)?;
    let all = near_the_stated_centre(anchors, detections, &full, prior, plate, settings);
    let (best, mut margin) = decide(&all, full.len(), prior, settings)?;
    if plate.pattern() != Pattern::Heroes {
        margin = margin.min(check_place(&best, &full, detections, prior, plate)?);
    }
    Ok(Identified {
        ids: best.usable(),
        margin,
    })
}

/// The ids of the most likely labelling, decisive or not: indices of the detections, with ids.
pub(crate) fn likeliest(
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &FiducialSettings,
) -> Option<Vec<(usize, MarkId)>> {
    let full = fully_lit(detections);
    let anchors = Anchors::All;
    let all = near_the_stated_centre(anchors, detections, &full, prior, plate, settings);
    all.first().map(Labelling::usable)
}

fn fully_lit(detections: &[Detection]) -> Vec<usize> {
    let is_full = |n: &usize| detections[*n].lighting == Lighting::Full;
    (0..detections.len()).filter(is_full).collect()
}

/// The labellings that put the plate's centre near the stated one, the most likely first: all of them, or all that can
/// matter.
fn near_the_stated_centre(
    search: Anchors,
    detections: &[Detection],
    full: &[usize],
    prior: &IdentificationPrior,
    plate: &Plate,
    settings: &FiducialSettings,
) -> Vec<Labelling> {
    let from_sun_px = prior.sun_distance_px(prior.plate_centre);
    let error_px = PREDICTION_ERROR * (from_sun_px + prior.outline.mean_radius());
    let reach_mil = (settings.max_centre_shift_px + error_px) * prior.mil_per_px();
    let in_view_mil = reach_mil + 1.1 * prior.radius_mil.value;
    let scenes: Vec<Scene> = prior
        .turns()
        .filter_map(|turn| Scene::new(prior, detections, plate, turn, in_view_mil))
        .collect();
    // Every labelling, rivals included, explains two fully lit detections: at least one of them is not the last.
    let anchors = match full.len() > MANY_DETECTIONS {
        true => ANCHORS_OF_MANY,
        false => full.len().saturating_sub(1),
    };
    let mut found: Vec<Vec<Labelling>> = vec![Vec::new(); scenes.len()];
    let mut lists = Lists::default();
    for (n, anchor) in full[..anchors].iter().enumerate() {
        let order = nearest_first(*anchor, full, detections);
        for (scene, found) in scenes.iter().zip(&mut found) {
            add_labellings(found, scene, &order, reach_mil, settings, &mut lists);
        }
        let scores = || found.iter().flatten().map(|labelling| labelling.score);
        let best = scores().fold(f64::NEG_INFINITY, f64::max);
        let others = scenes.first().map(|scene| scene.most_score(&full[n + 1..]));
        let is_decided = others.is_none_or(|most| best - most > OVERWHELMING_ODDS);
        if search == Anchors::UntilDecided && is_decided {
            break;
        }
    }
    let mut all: Vec<Labelling> = found.into_iter().flatten().collect();
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    all
}

/// Compares a labelling with those of the same marks anywhere on the plate, whatever the stated centre. Returns the
/// difference between its odds and their limit.
///
/// # Errors
/// If one of them explains as many marks and is not much less likely.
fn check_place(
    best: &Labelling,
    full: &[usize],
    detections: &[Detection],
    prior: &IdentificationPrior,
    plate: &Plate,
) -> Result<f64, Rejected> {
    let explained = best.matches.iter().map(|m| m.detection);
    let explained: Vec<usize> = explained.filter(|n| full.contains(n)).collect();
    // A rival that explains as many marks explains two of any three of these, unless it explains one that the best does
    // not.
    let pairs = match explained[..] {
        [a, b, c, ..] => vec![[a, b], [b, c], [c, a]],
        [a, b] => vec![[a, b]],
        _ => return Ok(f64::INFINITY),
    };
    let own = best.score - best.centre_odds;
    let places = Places::of(plate);
    let mut lists = Lists::default();
    let (mut rivals, mut likelihood): (Vec<Labelling>, f64) = (Vec::new(), 0.0);
    for turn in prior.turns() {
        let Some(scene) = Scene::new(prior, detections, plate, turn, f64::INFINITY) else {
            continue;
        };
        for pair in &pairs {
            let order = nearest_first(pair[0], full, detections);
            for anchor in scene.marks_of_pair(*pair, &places) {
                let Some(mut rival) = scene.follow(anchor, &order, &mut lists) else {
                    continue;
                };
                let known = rivals.iter().any(|other| !other.contradicts(&rival));
                if !known && rival.full >= best.full && rival.contradicts(best) {
                    rival.score += prior.rotation_odds(rival.rotation_deg);
                    likelihood += (rival.score - own).exp();
                    // On a regular plate every place is a rival: the first one is enough.
                    Rejected::at_least(DECISIVE_ODDS, -likelihood.ln(), sun::CENTRE_ALONE)?;
                    rivals.push(rival);
                }
            }
        }
    }
    Ok(-likelihood.ln() - DECISIVE_ODDS)
}

/// Adds the labellings at one rotation that start with the first detection of `order`.
fn add_labellings(
    found: &mut Vec<Labelling>,
    scene: &Scene,
    order: &[usize],
    reach_mil: f64,
    settings: &FiducialSettings,
    lists: &mut Lists,
) {
    let (prior, max_shift_px) = (scene.prior, settings.max_centre_shift_px);
    for (id, printed) in scene.marks_about(order[0], reach_mil) {
        // Another order has led to the same labelling.
        if found.iter().any(|l| l.id_of(order[0]) == Some(id)) {
            continue;
        }
        let Some(mut labelling) = scene.follow((id, printed), order, lists) else {
            continue;
        };
        let (centre, sigma_px) = (labelling.plate_centre, labelling.centre_sigma_px);
        if prior.shift_excess(centre, sigma_px, max_shift_px) < RIVAL_EXCESS {
            labelling.centre_odds = prior.centre_odds(centre, sigma_px, max_shift_px);
            labelling.score += labelling.centre_odds + prior.rotation_odds(labelling.rotation_deg);
            found.push(labelling);
        }
    }
}

/// Accepts the first labelling, the best, if all that contradict it are unlikely together; `full` is the number of fully
/// lit detections. Also returns the difference between its odds and their limit.
fn decide(
    labellings: &[Labelling],
    full: usize,
    prior: &IdentificationPrior,
    settings: &FiducialSettings,
) -> Result<(Labelling, f64), Unread> {
    let Some(best) = labellings.first() else {
        return Err(Unread::Undecided(Rejected {
            reason: sun::NO_LABELLING,
            measured: 0.0,
            limit: settings.min_marks as f64,
        }));
    };
    let reason = sun::FEW_MARKS_EXPLAINED;
    let (marks, least) = (best.full as f64, settings.min_marks as f64);
    Rejected::at_least(least, marks, reason)?;
    let reason = sun::WEAK_LABELLING;
    Rejected::at_least(DECISIVE_ODDS, best.score, reason)?;
    let rivals = || labellings.iter().filter(|rival| rival.contradicts(best));
    let equal = odds(best, rivals().filter(|rival| rival.full >= best.full));
    let reason = sun::TWO_LABELLINGS;
    Rejected::at_least(DECISIVE_ODDS, equal, reason)?;
    let fewer = odds(best, rivals().filter(|rival| rival.full < best.full));
    let least = match best.full < full {
        true => FALSE_MARK_ODDS_AMONG_FALSE,
        false => FALSE_MARK_ODDS,
    };
    let reason = sun::FALSE_DETECTION;
    Rejected::at_least(least, fewer, reason)?;
    let (centre, sigma_px) = (best.plate_centre, best.centre_sigma_px);
    let excess = prior.shift_excess(centre, sigma_px, settings.max_centre_shift_px);
    let reason = sun::CENTRE_FAR_AWAY;
    Rejected::at_most(1.0, excess, reason).map_err(Unread::Contradicting)?;
    let excess = prior.scale_excess(best.scale_mil_per_px);
    let reason = sun::SCALE_OF_LABELLING;
    Rejected::at_most(1.0, excess, reason).map_err(Unread::Contradicting)?;
    let margin = (equal - DECISIVE_ODDS).min(fewer - least);
    Ok((best.clone(), margin.min(best.score - DECISIVE_ODDS)))
}

/// Logarithm of the odds of a labelling against rivals and chance together.
fn odds<'a>(best: &Labelling, rivals: impl Iterator<Item = &'a Labelling>) -> f64 {
    let rivals: f64 = rivals.map(|rival| (rival.score - best.score).exp()).sum();
    -(rivals + (-best.score).exp()).ln()
}

/// Detections ordered by their distance from one of them.
fn nearest_first(from: usize, among: &[usize], detections: &[Detection]) -> Vec<usize> {
    let place = |n: usize| detections[n].at.vector();
    let distance = |n: usize| (place(n) - place(from)).norm_squared();
    let mut order = among.to_vec();
    order.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    order
}
