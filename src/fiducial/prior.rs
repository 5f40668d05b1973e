//! Priors before any mark is identified: the prior of a frame, and the statistics of scenes and cameras.

use crate::estimation::CONTRADICTION_SIGMAS;
use crate::geometry::{Ellipse, Handedness, TILT_PER_PX};
use crate::units::{Measured, SensorPx};
use nalgebra::{Matrix2, Rotation2};
use std::f64::consts::{PI, TAU};

// Scene statistics. Positions: distance of an observed mark from its predicted position, 1 sigma per axis.

/// Fully lit mark: the keystone over the disc that a similarity leaves, px. The print's scatter is added to it.
const KEYSTONE_PX: f64 = 0.144_463;
/// Mark cut by the limb: its inward bias at the limb, in widths of its lines; from there it falls linearly to zero for a
/// fully lit mark. An upper bound: on simulated frames it is 1, 0.33, 0.12 and 0.03 at depths of 0, 0.17, 0.3 and 0.5
/// lengths of an arm.
pub(super) const LIMB_BIAS_WIDTHS: f64 = 1.0;
/// Depth inside the limb at which a mark is fully lit, in lengths of an arm, tip to tip: a half, plus the limb's blur.
pub(super) const LIT_LENGTHS: f64 = 0.7;
/// Largest residual of a mark that keeps its id, in lengths of an arm: beyond it the limb leaves no usable position.
pub(super) const USABLE_LENGTHS: f64 = 0.1;
/// A detection whose residual is larger, in sigma, is not that mark.
pub(super) const GATE_SIGMAS: f64 = 4.0;
/// Spacing of the rotations that are tried for marks without arms, and the uncertainty of each, 1 sigma.
const ROTATION_STEP_DEG: f64 = 1.2;
const ROTATION_STEP_SIGMA_DEG: f64 = 0.6;
/// Range of these rotations on either side of the stated one, in its sigma.
const ROTATION_REACH_SIGMAS: f64 = 4.0;
/// Error of a position predicted by scale and rotation alone, relative to its distance.
pub(super) const PREDICTION_ERROR: f64 = 0.03;

// Scene statistics. Detections: shares and contrasts.

/// Share of the marks found among those so cut by the limb that they may be missed: unknown, so an even chance.
pub const CUT_FOUND_SHARE: f64 = 0.5;
/// Expected number of false detections on a disc.
pub const FALSE_ON_DISC: f64 = 1.0;
/// Scatter of the contrasts of one print, 1 sigma of the logarithm.
pub const CONTRAST_SCATTER: f64 = 0.12;
/// Share of the marks with an atypical contrast, because a scratch or a sunspot lies on them.
pub const ATYPICAL_SHARE: f64 = 0.02;
/// Share of the false detections with a mark's contrast. That of the others is uniform in the logarithm from 0.12 to 1.2.
pub const MARK_LIKE_SHARE: f64 = 0.4;
pub const LEAST_CONTRAST: f64 = 0.12;
/// From the smallest to the largest contrast, in the logarithm.
pub const CONTRAST_RANGE: f64 = 2.3;

// Scene statistics. Cameras: how far the stated mounting holds.

/// Share of the cameras that were moved since their mounting was stated.
const MOVED_SHARE: f64 = 0.01;
/// Share of the cameras that were rotated: a rotation far from the stated one needs evidence a million times stronger.
const TURNED_SHARE: f64 = 1e-6;

// Odds that decide, logarithms.

/// Minimum odds of a labelling against all that contradict it, and against chance: 1 in 1100.
pub(super) const DECISIVE_ODDS: f64 = 7.0;
/// The same against labellings that treat one of its fully lit marks as a false detection: where they predict no other
/// mark, as at the pattern's edge, that one detection decides. The limit is higher if the labelling itself leaves a fully
/// lit detection unexplained: where one is false another may be.
pub(super) const FALSE_MARK_ODDS: f64 = 9.0;
pub(super) const FALSE_MARK_ODDS_AMONG_FALSE: f64 = 11.0;
/// Labellings are compared up to this much beyond the largest shift of the plate's centre
/// ([`IdentificationPrior::shift_excess`]): a wrong one must not win because the true one is not among them.
pub(super) const RIVAL_EXCESS: f64 = 2.0;

/// Prior from limb, ephemeris, arms and instrument before any mark is identified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentificationPrior {
    /// The disc's outline on the sensor.
    pub outline: Ellipse,
    /// Radius of the outline on the plate; its sigma is that of the scale.
    pub radius_mil: Measured,
    /// Rotation of the plate's axes modulo a quarter turn, from the arms of the crosses, in the outline's own coordinates
    /// ([`Ellipse::to_disc`]). `None` for marks without arms, whose rotation is the stated one, within its sigma.
    pub quarter_rotation_deg: Option<Measured>,
    pub handedness: Handedness,
    /// Stated position of the plate's centre on the sensor, and 1 sigma of it per axis.
    pub plate_centre: SensorPx,
    pub plate_centre_sigma_px: f64,
    /// Stated rotation of the plate's axes on the sensor, positive from +x towards +y, deg.
    pub rotation_deg: Measured,
    /// Stated scale.
    pub scale_mil_per_px: Measured,
    /// Depth inside the limb from which a mark must have been found, px.
    pub sure_depth_px: f64,
    /// Distance from the sensor's edge from which a mark must have been found, px.
    pub sure_margin_px: f64,
    /// Width and height of the sensor, px.
    pub sensor_px: [f64; 2],
    /// Share of the marks that must have been found and were not.
    pub missed_share: f64,
}

impl IdentificationPrior {
    /// The rotations that the arms allow, or the stated ones, each with the map from the unit disc to offsets from the
    /// Sun's centre on the plate (mil).
    pub(super) fn turns(&self) -> impl Iterator<Item = (Measured, Matrix2<f64>)> {
        let axes = self.handedness.axes() * self.radius_mil.value;
        self.rotations().into_iter().map(move |rotation_deg| {
            let rotation = Rotation2::new(rotation_deg.value.to_radians());
            (rotation_deg, axes * rotation.matrix().transpose())
        })
    }

    fn rotations(&self) -> Vec<Measured> {
        if let Some(Measured { value, sigma }) = self.quarter_rotation_deg {
            let quarters = [0.0, 90.0, 180.0, 270.0];
            return quarters
                .map(|quarter| Measured::new(value + quarter, sigma))
                .into();
        }
        let stated = self.rotation_deg;
        let reach_deg = ROTATION_REACH_SIGMAS * stated.sigma.hypot(self.tilt_deg());
        let all = (180.0 / ROTATION_STEP_DEG) as i32;
        let most = ((reach_deg / ROTATION_STEP_DEG).ceil() as i32).min(all);
        // Over a full turn, the last rotation equals the first.
        let first = if most == all { 1 - most } else { -most };
        let rotation = |n: i32| {
            let value = stated.value + f64::from(n) * ROTATION_STEP_DEG;
            Measured::new(value, ROTATION_STEP_SIGMA_DEG)
        };
        (first..=most).map(rotation).collect()
    }

    /// Variance of a mark's observed position about the predicted one, per axis, mil^2; `print_mil` is the 1 sigma of the
    /// printed positions.
    pub(super) fn scatter_mil2(&self, print_mil: f64) -> f64 {
        print_mil.powi(2) + (KEYSTONE_PX * self.scale_mil_per_px.value).powi(2)
    }

    /// Rotation of the image at the Sun's position by a camera's tilt.
    fn tilt_deg(&self) -> f64 {
        (TILT_PER_PX * self.sun_distance_px(self.plate_centre)).to_degrees()
    }

    /// Mean scale on the disc.
    pub(super) fn mil_per_px(&self) -> f64 {
        self.radius_mil.value / self.outline.mean_radius()
    }

    /// Share of the marks that must have been found and were.
    pub(super) fn found_share(&self) -> f64 {
        1.0 - self.missed_share
    }

    /// Distance from the Sun's centre within which a mark must have been found, mil.
    pub(super) fn sure_reach_mil(&self) -> f64 {
        (self.radius_mil.value - self.sure_depth_px * self.mil_per_px()).max(0.0)
    }

    /// Whether a mark at this position lies far enough from the sensor's edge.
    pub(super) fn on_sensor(&self, at: SensorPx) -> bool {
        let margin = self.sure_margin_px;
        let inside = |v: f64, size: f64| v > margin && v < size - 1.0 - margin;
        inside(at.x, self.sensor_px[0]) && inside(at.y, self.sensor_px[1])
    }

    /// False detections per mil^2 on the plate.
    pub(super) fn false_density(&self) -> f64 {
        FALSE_ON_DISC / (PI * self.radius_mil.value.powi(2))
    }

    /// Log odds of a plate centre (1 sigma per axis) against the stated one: normally distributed about it, but uniform
    /// within the largest shift for the cameras that were moved.
    pub(super) fn centre_odds(&self, at: SensorPx, sigma_px: f64, max_shift_px: f64) -> f64 {
        let variance = self.plate_centre_sigma_px.powi(2) + sigma_px.powi(2);
        let peak = (max_shift_px.powi(2) / (2.0 * variance)).max(1.0);
        let density =
            |half_chi2: f64| MOVED_SHARE + (1.0 - MOVED_SHARE) * peak * (-half_chi2).exp();
        let shift_px = at.distance(self.plate_centre);
        (density(shift_px.powi(2) / (2.0 * variance)) / density(0.0)).ln()
    }

    /// Log odds of a rotation against the stated one: normally distributed about it, allowing for a tilt, and uniform for
    /// the cameras that were rotated.
    pub(super) fn rotation_odds(&self, rotation_deg: Measured) -> f64 {
        let sigma_deg = self.rotation_deg.sigma.hypot(rotation_deg.sigma);
        let change_deg = rotation_deg.value - self.rotation_deg.value;
        let change_deg = (change_deg + 180.0).rem_euclid(360.0) - 180.0;
        let sigmas = change_deg / sigma_deg.hypot(self.tilt_deg());
        (TURNED_SHARE + (1.0 - TURNED_SHARE) * (-0.5 * sigmas * sigmas).exp()).ln()
    }

    /// Difference of a scale from the stated one relative to the largest allowed: the limit of a contradiction, since no
    /// handling of a camera changes the scale, plus the change by a tilted camera at the Sun's position.
    pub(super) fn scale_excess(&self, scale_mil_per_px: Measured) -> f64 {
        let stated = self.scale_mil_per_px;
        let sigma = stated.sigma.hypot(scale_mil_per_px.sigma);
        let tilt = 1.5 * TILT_PER_PX * self.sun_distance_px(self.plate_centre) * stated.value;
        (scale_mil_per_px.value - stated.value).abs() / (CONTRADICTION_SIGMAS * sigma + tilt)
    }

    /// Distance of a plate centre (1 sigma per axis) beyond the largest shift, relative to the uncertainty of its
    /// extrapolation from the marks on the disc: 3 sigma, and the keystone.
    pub(super) fn shift_excess(&self, at: SensorPx, sigma_px: f64, max_shift_px: f64) -> f64 {
        let uncertainty_px = 3.0 * sigma_px + TILT_PER_PX * self.sun_distance_px(at).powi(2);
        (at.distance(self.plate_centre) - max_shift_px) / uncertainty_px
    }

    /// Distance of a position from the Sun's centre.
    pub(super) fn sun_distance_px(&self, at: SensorPx) -> f64 {
        (at.vector() - self.outline.centre).norm()
    }
}

/// Log odds of a contrast as a mark's against a false detection's; `deviation` is that of its logarithm from the median.
pub(super) fn contrast_odds(deviation: f64) -> f64 {
    let sigmas = deviation / CONTRAST_SCATTER;
    let print = (-0.5 * sigmas * sigmas).exp() / (CONTRAST_SCATTER * TAU.sqrt());
    let mark = (1.0 - ATYPICAL_SHARE) * print + ATYPICAL_SHARE / CONTRAST_RANGE;
    let other = MARK_LIKE_SHARE * print + (1.0 - MARK_LIKE_SHARE) / CONTRAST_RANGE;
    (mark / other).ln()
}
