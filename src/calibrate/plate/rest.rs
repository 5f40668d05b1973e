//! Checks with the fitted plate whether the camera was at rest in each pose.
//!
//! If the camera moved, and the times of the frames do not show when (all equal, or of several runs at once), a pose mixes frames of several
//! positions, and the fit matches none of them. The marks of a frame then have a common displacement from their positions predicted by the
//! pose, and so do those of all frames taken before the camera moved, or after: these are the poses.

use super::fit::{PlateFit, Residual};
use super::motion::{Displacement, motion};
use crate::calibrate::numbers::median;
use crate::estimation::MEDIAN_LENGTH_2D;
use crate::plate::MarkId;
use crate::units::PlateMil;
use nalgebra::{Matrix4, Vector2, Vector4};
use std::collections::BTreeMap;

/// A frame displaced by more sigmas is not at rest.
const OFF_SIGMAS: f64 = 5.0;
/// A pose counts as at rest if at most this part of its frames is displaced.
const FEW: f64 = 0.1;
/// Fewest frames of a part.
const LEAST_FRAMES: usize = 3;
/// Least mean number of frames in a part: a pose that splits into more parts is never at rest.
const LEAST_MEAN: usize = 8;
/// Number of iterations of fitting a motion to the frames that agree with it, and of assigning frames to the nearest motion.
const ROUNDS: usize = 3;
/// Greatest number of frames, and of pairs of them, whose motions are tried.
const TRIED: usize = 200;
/// 1 sigma of the median of normally distributed values, relative to that of their mean.
const MEDIAN_SIGMA: f64 = 1.25;

/// A mark that other frames observed too, and the factor by which its residual grows if these alone determine its position.
#[derive(Debug, Clone, Copy)]
struct Checked<'a> {
    residual: &'a Residual,
    growth: f64,
}

/// The frames of a fit with their displacements.
pub(super) struct Shifts<'a> {
    fit: &'a PlateFit,
    /// The marks of each frame, by pose.
    frames: Vec<BTreeMap<usize, Vec<Checked<'a>>>>,
    /// Scatter of the marks within the frames, relative to their stated sigmas.
    scatter: f64,
}

/// The frames of some poses, split into parts that are each at rest.
pub(super) struct Parts {
    pub parts: Vec<Vec<usize>>,
    /// Frames whose part is not determined.
    pub unassigned: Vec<usize>,
}

impl<'a> Shifts<'a> {
    pub fn of(fit: &'a PlateFit) -> Self {
        let counts: BTreeMap<MarkId, usize> =
            fit.marks.iter().map(|m| (m.id, m.observations)).collect();
        let mut frames: Vec<BTreeMap<usize, Vec<Checked>>> = vec![BTreeMap::new(); fit.poses.len()];
        for residual in &fit.residuals {
            let marks = frames[residual.pose].entry(residual.frame).or_default();
            let count = counts.get(&residual.id).copied().unwrap_or(0);
            let by_others = count.saturating_sub(usize::from(residual.weight > 0.0));
            if by_others > 0 {
                let growth = count as f64 / by_others as f64;
                marks.push(Checked { residual, growth });
            }
        }
        let within = frames.iter().flat_map(BTreeMap::values).flat_map(|marks| {
            let shift = from_own_pose(marks).map_or(Vector2::zeros(), |s| s.moved_px);
            let freedom = (1.0 - 1.0 / marks.len().max(2) as f64).sqrt();
            marks.iter().map(move |Checked { residual, growth }| {
                let off_px = residual.residual_px * *growth - shift;
                off_px.norm() / (residual.stated_px * growth.sqrt() * freedom)
            })
        });
        let scatter = (median(within) / MEDIAN_LENGTH_2D).max(1.0);
        Self {
            fit,
            frames,
            scatter,
        }
    }

    /// Number of displaced frames in the poses that are not at rest.
    pub fn moving(&self) -> usize {
        (0..self.frames.len()).map(|pose| self.off(pose)).sum()
    }

    /// Number of displaced frames of a pose; 0 if it is at rest.
    pub fn off(&self, pose: usize) -> usize {
        let frames = &self.frames[pose];
        let is_off = |marks: &&Vec<Checked>| {
            from_own_pose(marks).is_some_and(|shift| {
                shift.moved_px.norm() > OFF_SIGMAS * self.scatter * shift.sigma_px
            })
        };
        let off = frames.values().filter(is_off).count();
        let few = LEAST_FRAMES.max((FEW * frames.len() as f64) as usize);
        if off < few { 0 } else { off }
    }

    /// Splits the frames of poses with nearly the same mapping into parts that are each at rest. `None` if there are no such parts.
    pub fn parts(&self, poses: &[usize]) -> Option<Parts> {
        let mapping = self.fit.poses[*poses.first()?].mapping;
        let marks = self.fit.marks.iter();
        let places: BTreeMap<MarkId, PlateMil> =
            marks.map(|mark| (mark.id, mark.position)).collect();
        let own_pose = |r: &Residual| {
            r.at.vector() - r.residual_px - mapping.to_sensor(places[&r.id]).vector()
        };
        let frames = || poses.iter().flat_map(|pose| &self.frames[*pose]);
        let shifts: BTreeMap<usize, Displacement> = frames()
            .filter_map(|(frame, marks)| {
                let mut shift = shift(marks, own_pose)?;
                shift.sigma_px *= self.scatter;
                Some((*frame, shift))
            })
            .collect();
        let mut parts = split(&shifts)?;
        let is_assigned = |n: &usize| parts.iter().any(|part| part.contains(n));
        let others = frames().map(|(n, _)| *n).filter(|n| !is_assigned(n));
        let mut unassigned: Vec<usize> = others.collect();
        if let [only] = parts.as_mut_slice() {
            only.append(&mut unassigned);
            only.sort_unstable();
        }
        Some(Parts { parts, unassigned })
    }
}

fn from_own_pose(marks: &[Checked]) -> Option<Displacement> {
    shift(marks, |_| Vector2::zeros())
}

/// Common displacement of a frame's marks: their median, which a few misidentified marks do not affect. `pose_px` is the displacement of
/// the frame's pose there. `None` if no other frame determines the positions of the marks.
fn shift(marks: &[Checked], pose_px: impl Fn(&Residual) -> Vector2<f64>) -> Option<Displacement> {
    let off_px = |m: &Checked| pose_px(m.residual) + m.residual.residual_px * m.growth;
    let middle = |of: &dyn Fn(&Checked) -> f64| median(marks.iter().map(of));
    let sigma_px = middle(&|m| m.residual.stated_px * m.growth.sqrt());
    (!marks.is_empty()).then(|| Displacement {
        at: Vector2::new(middle(&|m| m.residual.at.x), middle(&|m| m.residual.at.y)),
        moved_px: Vector2::new(middle(&|m| off_px(m).x), middle(&|m| off_px(m).y)),
        sigma_px: MEDIAN_SIGMA * sigma_px / (marks.len() as f64).sqrt(),
    })
}

/// Splits frames by the motions that most of them agree with, each to the motion with the smallest residual.
fn split(shifts: &BTreeMap<usize, Displacement>) -> Option<Vec<Vec<usize>>> {
    let (mut rest, mut motions) = (shifts.clone(), Vec::new());
    while let Some(motion) = most_agreed(&rest) {
        let agreeing = agreeing(&rest, &motion, OFF_SIGMAS);
        if agreeing.len() < LEAST_FRAMES {
            break;
        }
        agreeing.iter().for_each(|n| _ = rest.remove(n));
        motions.push(motion);
    }
    if motions.is_empty() || LEAST_MEAN * motions.len() > shifts.len() {
        return None;
    }
    let distance = |shift: &Displacement, motion: &Vector4<f64>| shift.residual(motion).norm();
    let mut parts: Vec<Vec<usize>> = Vec::new();
    for _ in 0..ROUNDS {
        parts = vec![Vec::new(); motions.len()];
        for (n, shift) in shifts {
            let distances = motions.iter().map(|motion| distance(shift, motion));
            let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
            parts[nearest.0].push(*n);
        }
        parts.retain(|part| part.len() >= LEAST_FRAMES);
        let fitted = parts.iter().map(|part| fitted(shifts, part));
        motions = fitted.collect::<Option<_>>()?;
    }
    let off = shifts.values().filter(|shift| {
        let distances = motions.iter().map(|motion| distance(shift, motion));
        distances.fold(f64::INFINITY, f64::min) > OFF_SIGMAS
    });
    (off.count() as f64 <= FEW * shifts.len() as f64).then_some(parts)
}

/// The motion that most frames agree with, among those of single frames and of successive pairs.
fn most_agreed(shifts: &BTreeMap<usize, Displacement>) -> Option<Vector4<f64>> {
    let frames: Vec<&Displacement> = shifts.values().collect();
    let of_frame = |one: &&Displacement| Vector4::new(one.moved_px.x, one.moved_px.y, 0.0, 0.0);
    let of_pair = |pair: &[&Displacement]| {
        let mut slopes = Matrix4::zeros();
        let mut moved = Vector4::zeros();
        for (n, one) in pair.iter().enumerate() {
            slopes
                .fixed_view_mut::<2, 4>(2 * n, 0)
                .copy_from(&one.slopes());
            moved.fixed_rows_mut::<2>(2 * n).copy_from(&one.moved_px);
        }
        slopes.lu().solve(&moved)
    };
    let tried = frames.len().div_ceil(TRIED).max(1);
    let single = frames.iter().step_by(tried).map(of_frame);
    let in_pairs = frames.windows(2).step_by(tried).filter_map(of_pair);
    // Such a motion has the errors of its frames: use a wider limit.
    let with = |motion: &Vector4<f64>| agreeing(shifts, motion, 2.0 * OFF_SIGMAS);
    let mut part = single
        .chain(in_pairs)
        .map(|motion| with(&motion))
        .max_by_key(Vec::len)?;
    let mut motion = fitted(shifts, &part)?;
    for _ in 1..ROUNDS {
        part = agreeing(shifts, &motion, OFF_SIGMAS);
        motion = fitted(shifts, &part)?;
    }
    Some(motion)
}

fn agreeing(
    shifts: &BTreeMap<usize, Displacement>,
    motion: &Vector4<f64>,
    sigmas: f64,
) -> Vec<usize> {
    let agree = shifts
        .iter()
        .filter(|(_, shift)| shift.residual(motion).norm() < sigmas);
    agree.map(|(n, _)| *n).collect()
}

fn fitted(shifts: &BTreeMap<usize, Displacement>, part: &[usize]) -> Option<Vector4<f64>> {
    let slopes = part.iter().map(|n| (&shifts[n], shifts[n].slopes()));
    Some(motion(slopes).ok()?.parameters)
}
