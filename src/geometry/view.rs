//! The view of a plane by a pinhole camera, with the derivatives needed for fitting it.
//!
//! x = t + L w / (1 + g . w), with w = A P; P is the position on the plate (mil) and x that on the ideal sensor, free of lens distortion
//! (px). The fixed axes A express the plate in units of [`UNIT_MIL`], which makes the parameters similar in size, and mirror it if the
//! camera does.
//!
//! L = [a, -b; b, a] + [c, d; d, -c] is any linear map, split into a similarity (scale and rotation) and a stretch with shear; g is the
//! tilt, whose effect is keystone. As homography: Hartley and Zisserman, Multiple View Geometry, 2nd ed., section
//! 2.3.

use super::distortion::Distortion;
use super::mapping::{Handedness, Mapping, MappingKind};
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Matrix3, RowSVector, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};

/// Number of parameters of a view.
pub const PARAMETERS: usize = 8;
/// tx, ty (px); a, b; c, d (px per [`UNIT_MIL`]); gx, gy (per [`UNIT_MIL`]).
pub type Parameters = SVector<f64, PARAMETERS>;
/// Derivative of a position on the ideal sensor by the parameters.
pub type ParameterJacobian = SMatrix<f64, 2, PARAMETERS>;
/// Covariance of the parameters.
pub type ParameterCovariance = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Derivative of a number by the parameters.
pub type ParameterSlopes = RowSVector<f64, PARAMETERS>;

/// The plate's unit of length in a view.
pub const UNIT_MIL: f64 = 1000.0;

/// Displacement of a position by a camera tilted by 3 deg, over the square of its distance from the plate's centre, 1/px: tan(3 deg)
/// over four times the width of the sensor. This is the tilt of a camera aligned by hand, 1 sigma.
///
/// Near the Sun, at a distance d (px) from the plate's centre, the tilt rotates the picture by up to this times d (rad) and
/// changes its scale by up to 1.5 times this times d.
pub const TILT_PER_PX: f64 = 1.0e-5;

/// The parameters of a kind of mapping; the others are zero.
pub fn parameters_of(kind: MappingKind) -> [bool; PARAMETERS] {
    let stretch = matches!(kind, MappingKind::Affine | MappingKind::Homography);
    let tilt = matches!(kind, MappingKind::Keystone | MappingKind::Homography);
    [true, true, true, true, stretch, stretch, tilt, tilt]
}

/// An ideal camera's view of the plate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct View {
    pub parameters: Parameters,
    /// Transforms plate positions (mil) to w.
    axes: Matrix2<f64>,
}

/// Scale and rotation of the projected plate at one position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LocalSimilarity {
    /// Plate length per pixel: the square root of the ratio of areas.
    pub scale_mil_per_px: Measured,
    /// Rotation, positive from +x towards +y.
    pub rotation_deg: Measured,
}

/// Derivatives of scale and rotation at one position by the parameters.
pub struct SimilaritySlopes {
    /// Derivative of the natural logarithm of the plate length per pixel.
    pub log_scale: ParameterSlopes,
    pub rotation_rad: ParameterSlopes,
}

impl View {
    /// All parameters zero: the start of a linear fit of a similarity.
    pub fn zero(handedness: Handedness) -> Self {
        Self {
            parameters: Parameters::zeros(),
            axes: handedness.axes() / UNIT_MIL,
        }
    }

    /// The view of a mapping, without its distortion. `None` if the mapping has the plate's centre at infinity.
    pub fn of(mapping: &Mapping) -> Option<Self> {
        let axes = mapping.handedness().axes() / UNIT_MIL;
        Self::along(axes, &mapping.matrix().try_inverse()?)
    }

    /// The view of a homography from plate (mil) to ideal sensor (px), with these axes. `None` if the axes cannot be inverted or the
    /// plate's centre is at infinity.
    pub fn along(axes: Matrix2<f64>, to_sensor: &Matrix3<f64>) -> Option<Self> {
        let h = to_sensor / to_sensor.m33;
        let inverse = axes.try_inverse()?;
        let (t, g) = (Vector2::new(h.m13, h.m23), Vector2::new(h.m31, h.m32));
        let l = (h.fixed_view::<2, 2>(0, 0) - t * g.transpose()) * inverse;
        let g = inverse.tr_mul(&g);
        let (a, b) = ((l.m11 + l.m22) / 2.0, (l.m21 - l.m12) / 2.0);
        let (c, d) = ((l.m11 - l.m22) / 2.0, (l.m21 + l.m12) / 2.0);
        let parameters = Parameters::from([t.x, t.y, a, b, c, d, g.x, g.y]);
        let finite = parameters.iter().all(|v| v.is_finite());
        finite.then_some(Self { parameters, axes })
    }

    /// The parameters changed by a step.
    pub fn advanced(&self, step: &Parameters) -> Self {
        Self {
            parameters: self.parameters + step,
            axes: self.axes,
        }
    }

    /// Sets the parameters that a simpler kind does not have to zero.
    pub fn simplified(mut self, kind: MappingKind) -> Self {
        for (parameter, has) in self.parameters.iter_mut().zip(parameters_of(kind)) {
            *parameter = if has { *parameter } else { 0.0 };
        }
        self
    }

    fn shift(&self) -> Vector2<f64> {
        self.parameters.fixed_rows::<2>(0).into_owned()
    }

    fn linear(&self) -> Matrix2<f64> {
        let p = &self.parameters;
        Matrix2::new(p[2] + p[4], p[5] - p[3], p[5] + p[3], p[2] - p[4])
    }

    fn tilt(&self) -> Vector2<f64> {
        self.parameters.fixed_rows::<2>(6).into_owned()
    }

    /// Length of [`UNIT_MIL`] on the sensor at the plate's centre, px.
    pub fn unit_px(&self) -> f64 {
        self.parameters[2].hypot(self.parameters[3])
    }

    /// Rotation at the plate's centre relative to the axes, positive from +x towards +y, -180 to 180 deg.
    pub fn rotation_deg(&self) -> f64 {
        self.parameters[3].atan2(self.parameters[2]).to_degrees()
    }

    /// Position of a plate position on the ideal sensor, px.
    pub fn project(&self, at: PlateMil) -> Vector2<f64> {
        let w = self.axes * at.vector();
        self.shift() + self.linear() * w / (1.0 + self.tilt().dot(&w))
    }

    /// Derivative of [`project`](Self::project) by the plate position, px per mil.
    pub fn jacobian(&self, at: PlateMil) -> Matrix2<f64> {
        let w = self.axes * at.vector();
        let depth = 1.0 + self.tilt().dot(&w);
        let q = self.linear() * w / depth;
        (self.linear() - q * self.tilt().transpose()) * self.axes / depth
    }

    /// Derivative of [`project`](Self::project) by the parameters.
    pub fn parameter_jacobian(&self, at: PlateMil) -> ParameterJacobian {
        let w = self.axes * at.vector();
        let v = w / (1.0 + self.tilt().dot(&w));
        let q = self.linear() * v;
        ParameterJacobian::from_column_slice(&[
            1.0,
            0.0, //
            0.0,
            1.0, //
            v.x,
            v.y, //
            -v.y,
            v.x, //
            v.x,
            -v.y, //
            v.y,
            v.x, //
            -q.x * v.x,
            -q.y * v.x, //
            -q.x * v.y,
            -q.y * v.y,
        ])
    }

    /// Derivative of [`parameter_jacobian`](Self::parameter_jacobian) by the plate position along a direction, per mil.
    pub fn parameter_jacobian_along(
        &self,
        at: PlateMil,
        direction: Vector2<f64>,
    ) -> ParameterJacobian {
        let w = self.axes * at.vector();
        let depth = 1.0 + self.tilt().dot(&w);
        let v = w / depth;
        let q = self.linear() * v;
        let along = self.axes * direction;
        let dv = (along - v * self.tilt().dot(&along)) / depth;
        let dq = self.linear() * dv;
        let tilt = |axis: usize| -(dq * v[axis] + q * dv[axis]);
        ParameterJacobian::from_columns(&[
            Vector2::zeros(),
            Vector2::zeros(),
            dv,
            Vector2::new(-dv.y, dv.x),
            Vector2::new(dv.x, -dv.y),
            Vector2::new(dv.y, dv.x),
            tilt(0),
            tilt(1),
        ])
    }

    /// Derivatives of scale and rotation at a plate position by the parameters of an invertible view.
    pub fn similarity_slopes(&self, at: PlateMil) -> SimilaritySlopes {
        let jacobian = self.jacobian(at);
        let determinant = jacobian.determinant();
        let axes = match determinant < 0.0 {
            true => Handedness::Mirrored.axes(),
            false => Handedness::Direct.axes(),
        };
        // Twice a and b of the local linear map.
        let doubled = |m: Matrix2<f64>| Vector2::new(m.m11 + m.m22, m.m21 - m.m12);
        let local = doubled(jacobian * axes);
        let [along_x, along_y] =
            [Vector2::x(), Vector2::y()].map(|axis| self.parameter_jacobian_along(at, axis));
        let mut slopes = SimilaritySlopes {
            log_scale: ParameterSlopes::zeros(),
            rotation_rad: ParameterSlopes::zeros(),
        };
        for n in 0..PARAMETERS {
            let (x, y) = (along_x.column(n), along_y.column(n));
            // Jacobi's formula for the derivative of the determinant.
            let grown = jacobian.m22 * x[0] - jacobian.m12 * x[1] - jacobian.m21 * y[0]
                + jacobian.m11 * y[1];
            slopes.log_scale[n] = -0.5 * grown / determinant;
            let moved = doubled(Matrix2::from_columns(&[x, y]) * axes);
            slopes.rotation_rad[n] = local.perp(&moved) / local.norm_squared();
        }
        slopes
    }

    /// Scale and rotation of a mapping near this view at a sensor position, with 1 sigma from the covariance of the view's parameters.
    /// The position is taken as exact.
    pub fn local_similarity(
        &self,
        seen: SensorPx,
        mapping: &Mapping,
        covariance: &ParameterCovariance,
    ) -> LocalSimilarity {
        let slopes = self.similarity_slopes(mapping.to_plate(seen));
        let scale = mapping.scale_mil_per_px(seen);
        let stretch = propagated_sigma(&slopes.log_scale, covariance);
        let turn_rad = propagated_sigma(&slopes.rotation_rad, covariance);
        LocalSimilarity {
            scale_mil_per_px: Measured::new(scale, scale * stretch),
            rotation_deg: Measured::new(mapping.rotation_deg(seen), turn_rad.to_degrees()),
        }
    }

    /// The plate position at a position on the ideal sensor, mil, and its derivative, mil per px. `None` if the view is degenerate.
    pub fn unproject(&self, seen: Vector2<f64>) -> Option<(PlateMil, Matrix2<f64>)> {
        let inverse = (self.linear() * self.axes).try_inverse()?;
        let tilt = self.axes.tr_mul(&self.tilt());
        let straight = inverse * (seen - self.shift());
        let stretch = 1.0 / (1.0 - tilt.dot(&straight));
        let at = straight * stretch;
        let slopes = (inverse + at * inverse.tr_mul(&tilt).transpose()) * stretch;
        Some((at.into(), slopes))
    }

    /// Covariance of a plate position computed with a mapping near this view, from that of the view's parameters; mil^2.
    pub fn covariance_mil2(
        &self,
        at: PlateMil,
        mapping: &Mapping,
        covariance: &ParameterCovariance,
    ) -> Matrix2<f64> {
        let slopes = self.parameter_jacobian(at);
        let on_sensor = slopes * covariance * slopes.transpose();
        let to_plate = mapping.plate_jacobian(mapping.to_sensor(at));
        to_plate * on_sensor * to_plate.transpose()
    }

    /// The homography from plate (mil) to ideal sensor (px).
    pub fn to_sensor(&self) -> Matrix3<f64> {
        let (t, g) = (self.shift(), self.axes.tr_mul(&self.tilt()));
        let m = self.linear() * self.axes + t * g.transpose();
        Matrix3::new(
            m.m11, m.m12, t.x, //
            m.m21, m.m22, t.y, //
            g.x, g.y, 1.0,
        )
    }

    /// The mapping from sensor to plate with a lens. `None` if the view is degenerate.
    pub fn mapping(&self, kind: MappingKind, distortion: Distortion) -> Option<Mapping> {
        Mapping::new(kind, self.to_sensor().try_inverse()?, distortion)
    }
}

/// 1 sigma of a number from its derivative by parameters and their covariance.
pub fn propagated_sigma<const N: usize>(
    slopes: &RowSVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
) -> f64 {
    let variance = (slopes * covariance * slopes.transpose()).x;
    variance.max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: PlateMil = PlateMil::new(700.0, -400.0);

    fn tilted() -> View {
        let parameters = [650.0, 480.0, 150.0, 80.0, 0.3, -0.2, 0.02, -0.01];
        View::zero(Handedness::Mirrored).advanced(&Parameters::from(parameters))
    }

    #[test]
    fn a_view_is_its_mapping_and_leads_back() {
        let (view, seen) = (tilted(), tilted().project(AT));
        let mapping = view
            .mapping(MappingKind::Homography, Distortion::NONE)
            .unwrap();
        assert!((mapping.to_sensor(AT).vector() - seen).norm() < 1e-9);
        assert!((mapping.sensor_jacobian(AT) - view.jacobian(AT)).norm() < 1e-12);
        let (back, slopes) = view.unproject(seen).unwrap();
        assert!(back.distance(AT) < 1e-9);
        assert!((slopes * view.jacobian(AT) - Matrix2::identity()).norm() < 1e-12);
        let again = View::of(&mapping).unwrap();
        assert!((again.parameters - view.parameters).norm() < 1e-9);
    }

    #[test]
    fn a_view_is_the_same_along_other_axes() {
        let (view, axes) = (tilted(), Matrix2::new(2e-3, 1e-4, -3e-4, 5e-4));
        let other = View::along(axes, &view.to_sensor()).unwrap();
        assert!((other.project(AT) - view.project(AT)).norm() < 1e-9);
        assert!((other.jacobian(AT) - view.jacobian(AT)).norm() < 1e-12);
    }

    #[test]
    fn derivatives_by_the_parameters_are_those_of_the_projection() {
        let (view, slopes) = (tilted(), tilted().parameter_jacobian(AT));
        for n in 0..PARAMETERS {
            let step = Parameters::from_fn(|k, _| if k == n { 1e-5 } else { 0.0 });
            let slope = view.advanced(&step).project(AT) - view.advanced(&-step).project(AT);
            assert!((slope / 2e-5 - slopes.column(n)).norm() < 1e-4, "{n}");
        }
    }

    fn mapping(view: &View) -> Mapping {
        view.mapping(MappingKind::Homography, Distortion::NONE)
            .unwrap()
    }

    #[test]
    fn scale_and_rotation_follow_the_parameters_as_their_slopes_say() {
        for axes in [
            Handedness::Mirrored.axes() / UNIT_MIL,
            Handedness::Direct.axes() / UNIT_MIL,
            Matrix2::new(2e-3, 1e-4, -3e-4, 5e-4),
        ] {
            let parameters = Parameters::from([650.0, 480.0, 150.0, 80.0, 0.3, -0.2, 0.02, -0.01]);
            let view = View { parameters, axes };
            let slopes = view.similarity_slopes(AT);
            for n in 0..PARAMETERS {
                let step = Parameters::from_fn(|k, _| if k == n { 1e-5 } else { 0.0 });
                let [plus, minus] = [step, -step].map(|step| mapping(&view.advanced(&step)));
                let log_scale = |m: &Mapping| m.scale_mil_per_px(m.to_sensor(AT)).ln();
                let rotation = |m: &Mapping| m.rotation_deg(m.to_sensor(AT)).to_radians();
                let slope = (log_scale(&plus) - log_scale(&minus)) / 2e-5;
                assert!((slope - slopes.log_scale[n]).abs() < 1e-6, "{n}");
                let slope = (rotation(&plus) - rotation(&minus)) / 2e-5;
                assert!((slope - slopes.rotation_rad[n]).abs() < 1e-6, "{n}");
            }
        }
    }

    #[test]
    fn sigmas_of_scale_and_rotation_are_those_of_a_similarity() {
        let view = View::zero(Handedness::Mirrored).advanced(&Parameters::from([
            650.0, 480.0, 120.0, 90.0, 0.0, 0.0, 0.0, 0.0,
        ]));
        // a and b with sigma 0.3 px; together they are 150 px long.
        let covariance = ParameterCovariance::from_diagonal_element(0.09);
        let found =
            view.local_similarity(SensorPx::new(650.0, 480.0), &mapping(&view), &covariance);
        let scale = found.scale_mil_per_px;
        assert!((scale.sigma / scale.value - 0.002).abs() < 1e-9);
        assert!((found.rotation_deg.sigma.to_radians() - 0.002).abs() < 1e-9);
    }

    #[test]
    fn a_simpler_kind_has_fewer_parameters() {
        for kind in [
            MappingKind::Similarity,
            MappingKind::Keystone,
            MappingKind::Affine,
            MappingKind::Homography,
        ] {
            let has = parameters_of(kind);
            assert_eq!(has.iter().filter(|has| **has).count(), kind.parameters());
            let simple = tilted().simplified(kind).parameters;
            assert!((0..PARAMETERS).all(|n| (simple[n] != 0.0) == has[n]));
        }
    }
}
