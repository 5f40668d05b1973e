//! Fits the plate to the observations: the steps in order.

use super::adjust::{Adjusted, DRIFT, Freedoms, MarkPrior, State};
use super::camera::{LENS, Lens};
use super::choose::{ALL_FREE, Choice, Separation, choose};
use super::correlations::{Correlation, largest};
use super::observation::{FrameObservation, Pose};
use super::robust::{Bundle, Observation};
use crate::geometry::view::{ParameterCovariance, UNIT_MIL, View};
use crate::geometry::{Distortion, Mapping, MappingKind};
use crate::instrument::Instrument;
use crate::observe::RejectedFrame;
use crate::plate::{MarkId, MarkPlace};
use crate::units::{Measured, PlateMil, SensorPx};
use jiff::Timestamp;
use nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet};

/// A measured mark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredMark {
    pub id: MarkId,
    /// Position, without the shift, rotation and scale common to the measured marks.
    pub position: PlateMil,
    pub sigma_mil: [f64; 2],
    /// Number of observations with weight.
    pub observations: usize,
}

/// The camera in one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseFit {
    pub mapping: Mapping,
    /// Sensor position of the plate's centre without the lens's distortion, and 1 sigma per axis.
    pub plate_centre_px: SensorPx,
    pub plate_centre_sigma_px: f64,
    pub scale_mil_per_px: Measured,
    pub rotation_deg: Measured,
    /// Mean rate at which the plate's picture drifts along x and y; none if the frames show no drift.
    pub drift_px_per_h: Option<[Measured; 2]>,
    pub frames: usize,
}

/// The residual of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Index among the frames of all poses, one pose after the other.
    pub frame: usize,
    pub pose: usize,
    pub id: MarkId,
    pub at: SensorPx,
    /// Observed minus predicted.
    pub residual_px: Vector2<f64>,
    /// The same with the start's mark positions, no distortion and only similarities as mappings.
    pub before_px: Vector2<f64>,
    /// 1 sigma of the observation as stated by the frame, per axis.
    pub stated_px: f64,
    /// Robust weight, 0 (rejected) to 1.
    pub weight: f64,
}

/// The plate, the lens and the poses fitted to the observations.
#[derive(Debug, Clone, PartialEq)]
pub struct PlateFit {
    /// Marks in the order of their ids.
    pub marks: Vec<MeasuredMark>,
    pub distortion: Distortion,
    /// 1 sigma of [r^2, r^4, decentring 1, decentring 2], the file's units.
    pub distortion_sigma: [f64; LENS],
    pub choice: Choice,
    pub separation: Separation,
    pub poses: Vec<PoseFit>,
    pub residuals: Vec<Residual>,
    /// Inflation of the observations' stated sigmas.
    pub sigma_factor: f64,
    /// Root mean square of the accepted residuals, px per axis.
    pub residual_px: f64,
    /// Inflation of the marks' prior sigmas to match the displacements found.
    pub prior_factor: f64,
    /// The largest correlations.
    pub correlations: Vec<Correlation>,
    /// Frames that do not agree with the others.
    pub rejected: Vec<RejectedFrame>,
}

/// Number of correlations with lens or poses that are listed, and of those between marks.
const LISTED_CORRELATIONS: usize = 8;

/// Prior of the lens at its reach, 1 sigma of each term, px, wide enough for any lens in use.
pub const LENS_PRIOR_PX: f64 = 5.0;

/// Neither plate nor lens free.
const AS_STATED: Freedoms = Freedoms {
    view: MappingKind::Similarity,
    lens: [false; LENS],
    marks: false,
    drift: 0,
};

impl PlateFit {
    /// The residuals of the observations with weight.
    pub fn kept(&self) -> impl Iterator<Item = &Residual> {
        self.residuals.iter().filter(|r| r.weight > 0.0)
    }

    /// Fraction of the observations without weight.
    pub fn dropped_share(&self) -> f64 {
        1.0 - self.kept().count() as f64 / self.residuals.len().max(1) as f64
    }
}

/// Fits plate, lens and poses to the frames' observations. `None` if these do not determine them.
pub(super) fn fit(poses: &[Pose], start: &Instrument) -> Option<PlateFit> {
    let (mut bundle, ids, first) = gather(poses, start)?;
    let by_drawing = bundle.by_drawing(&first, ALL_FREE)?;
    let full = bundle.in_full(&by_drawing, ALL_FREE)?;
    let prior_factor = bundle.inflate_priors(&full);
    let (choice, chosen) = choose(&bundle, &full.state)?;
    let solved = bundle.in_full(&chosen.state, choice.freedoms())?;
    let before = bundle.adjust(&first, AS_STATED)?.state;
    let residuals = residuals(&bundle, &solved, &before, &ids);
    Some(PlateFit {
        marks: marks(&bundle, &solved, &ids),
        distortion: solved.state.lens.distortion(),
        distortion_sigma: lens_sigmas(&solved),
        separation: Separation::of(&bundle, &solved, choice),
        correlations: largest(&solved, &ids, LISTED_CORRELATIONS),
        poses: pose_fits(&bundle, &solved, choice, poses)?,
        sigma_factor: bundle.variance_factor.sqrt(),
        residual_px: rms_px(&residuals),
        residuals,
        prior_factor,
        choice,
        rejected: disagreeing(poses, &bundle),
    })
}

/// The bundle of all frames, the ids of its marks, and the initial state.
fn gather(poses: &[Pose], start: &Instrument) -> Option<(Bundle, Vec<MarkId>, State)> {
    let views = poses.iter().map(|pose| {
        let view = View::of(&pose.mapping)?;
        Some(view.simplified(MappingKind::Similarity))
    });
    let views: Vec<View> = views.collect::<Option<_>>()?;
    let frames = || poses.iter().flat_map(|pose| &pose.frames);
    let marks = frames().flat_map(|frame| &frame.marks);
    let ids: BTreeSet<MarkId> = marks.map(|mark| mark.id).collect();
    let index: BTreeMap<MarkId, usize> = ids.iter().copied().zip(0..).collect();
    let mut observations = Vec::new();
    let mut frame = 0;
    for (n, pose) in poses.iter().enumerate() {
        let span = Span::of(pose);
        for observed in &pose.frames {
            let time = span.zip(observed.utc);
            let time = time.map_or(0.0, |(span, utc)| span.time(utc));
            observations.extend(observed.marks.iter().map(|mark| Observation {
                frame,
                pose: n,
                mark: index[&mark.id],
                at_px: mark.at.vector(),
                time,
                covariance_px2: mark.covariance_px2,
                weight: 1.0,
            }));
            frame += 1;
        }
    }
    let prior = |id: &MarkId| {
        let MarkPlace { at, sigma_mil } = start.plate.place(*id)?;
        Some(MarkPrior {
            place: at,
            sigma_mil,
            measured: true,
        })
    };
    let bundle = Bundle {
        observations,
        poses: poses.len(),
        frames: frame,
        marks: ids.iter().map(prior).collect::<Option<_>>()?,
        lens_sigma_px: LENS_PRIOR_PX,
        variance_factor: 1.0,
    };
    let state = State {
        views,
        lens: start_lens(start),
        places: bundle.marks.iter().map(|m| m.place).collect(),
        drift_px: vec![[Vector2::zeros(); DRIFT]; poses.len()],
    };
    Some((bundle, ids.into_iter().collect(), state))
}

/// Time span of a pose's frames.
#[derive(Debug, Clone, Copy)]
struct Span {
    first: Timestamp,
    half_h: f64,
}

impl Span {
    /// `None` if some frames do not state their times, or all were taken at once.
    fn of(pose: &Pose) -> Option<Self> {
        let times = pose.frames.iter().map(|frame| frame.utc);
        let times: Vec<Timestamp> = times.collect::<Option<_>>()?;
        let (first, last) = (*times.iter().min()?, *times.iter().max()?);
        let half_h = last.duration_since(first).as_secs_f64() / 7200.0;
        (half_h > 0.0).then_some(Self { first, half_h })
    }

    /// Time within the pose, from -1 at the first frame to 1 at the last.
    fn time(&self, utc: Timestamp) -> f64 {
        utc.duration_since(self.first).as_secs_f64() / 3600.0 / self.half_h - 1.0
    }
}

/// The start's lens about its own centre, or about the sensor's if it states none.
fn start_lens(start: &Instrument) -> Lens {
    let camera = &start.camera;
    let middle = camera.middle_px();
    let reach_px = middle.distance(SensorPx::new(0.0, 0.0));
    let centre = match camera.distortion == Distortion::NONE {
        true => middle,
        false => camera.distortion.centre,
    };
    Lens::of(&camera.distortion, centre, reach_px)
}

/// Frames none of whose observations has weight.
fn disagreeing(poses: &[Pose], bundle: &Bundle) -> Vec<RejectedFrame> {
    let frames = poses.iter().flat_map(|pose| &pose.frames);
    let frames: Vec<&FrameObservation> = frames.collect();
    let mut kept: BTreeMap<usize, f64> = BTreeMap::new();
    for o in &bundle.observations {
        *kept.entry(o.frame).or_default() += o.weight;
    }
    let lost = kept.into_iter().filter(|(_, weight)| *weight == 0.0);
    let reason = "its marks do not agree with those of the other frames";
    lost.map(|(n, _)| RejectedFrame::new(&frames[n].file, reason))
        .collect()
}

fn marks(bundle: &Bundle, solved: &Adjusted, ids: &[MarkId]) -> Vec<MeasuredMark> {
    let count = |mark: usize| {
        let counting = |o: &&Observation| o.mark == mark && o.weight > 0.0;
        bundle.observations.iter().filter(counting).count()
    };
    let measured = |(mark, id): (usize, &MarkId)| {
        let covariance = solved.place_covariance(mark);
        bundle.marks[mark].measured.then(|| MeasuredMark {
            id: *id,
            position: solved.state.places[mark],
            sigma_mil: [0, 1].map(|n| covariance[(n, n)].max(0.0).sqrt()),
            observations: count(mark),
        })
    };
    ids.iter().enumerate().filter_map(measured).collect()
}

fn lens_sigmas(solved: &Adjusted) -> [f64; LENS] {
    let (covariance, units) = (solved.lens_covariance(), solved.state.lens.units());
    std::array::from_fn(|n| covariance[(n, n)].max(0.0).sqrt() * units[n])
}

fn pose_fits(
    bundle: &Bundle,
    solved: &Adjusted,
    choice: Choice,
    poses: &[Pose],
) -> Option<Vec<PoseFit>> {
    let mut counting = vec![BTreeSet::new(); bundle.poses];
    for o in bundle.observations.iter().filter(|o| o.weight > 0.0) {
        counting[o.pose].insert(o.frame);
    }
    let drift = |pose: usize| {
        let span = Span::of(&poses[pose]).filter(|_| choice.drift > 0)?;
        let (terms, covariance) = (solved.state.drift_px[pose], solved.drift_covariance(pose));
        // From the first frame to the last, terms of odd degree move the picture by twice their size, the others by nothing.
        Some([0, 1].map(|axis| {
            let odd_terms = || (0..DRIFT).step_by(2);
            let moved = odd_terms().map(|n| terms[n][axis]).sum::<f64>();
            let variances =
                odd_terms().flat_map(|n| odd_terms().map(move |m| (2 * n + axis, 2 * m + axis)));
            let variance: f64 = variances.map(|at| covariance[at]).sum();
            Measured::new(moved / span.half_h, variance.max(0.0).sqrt() / span.half_h)
        }))
    };
    let distortion = solved.state.lens.distortion();
    let fit = |pose: usize| {
        let (view, covariance) = (&solved.state.views[pose], solved.view_covariance(pose));
        let scale = UNIT_MIL / view.unit_px();
        let centre = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let relative = relative_sigma(view, &covariance);
        Some(PoseFit {
            mapping: view.mapping(choice.kind, distortion)?,
            plate_centre_px: view.project(PlateMil::new(0.0, 0.0)).into(),
            plate_centre_sigma_px: (centre.trace() / 2.0).max(0.0).sqrt(),
            scale_mil_per_px: Measured::new(scale, scale * relative),
            rotation_deg: Measured::new(view.rotation_deg(), relative.to_degrees()),
            drift_px_per_h: drift(pose),
            frames: counting[pose].len(),
        })
    };
    (0..bundle.poses).map(fit).collect()
}

/// 1 sigma of a view's scale, relative, and of its rotation, rad: equal for both.
fn relative_sigma(view: &View, covariance: &ParameterCovariance) -> f64 {
    let spread = covariance.fixed_view::<2, 2>(2, 2).trace() / 2.0;
    spread.max(0.0).sqrt() / view.unit_px()
}

fn residuals(bundle: &Bundle, solved: &Adjusted, before: &State, ids: &[MarkId]) -> Vec<Residual> {
    let one = |o: &Observation| Residual {
        pose: o.pose,
        before_px: o.at_px - before.predict(o.pose, o.mark).at_px,
        frame: o.frame,
        id: ids[o.mark],
        at: o.at_px.into(),
        residual_px: o.at_rest(&solved.state) - solved.state.predict(o.pose, o.mark).at_px,
        stated_px: (o.covariance_px2.trace() / 2.0).max(0.0).sqrt(),
        weight: o.weight,
    };
    bundle.observations.iter().map(one).collect()
}

/// Root mean square of weighted residuals, per axis.
fn rms_px(residuals: &[Residual]) -> f64 {
    let squares = residuals
        .iter()
        .map(|r| r.weight * r.residual_px.norm_squared());
    let weights = residuals.iter().map(|r| 2.0 * r.weight);
    (squares.sum::<f64>() / weights.sum::<f64>().max(1.0)).sqrt()
}
