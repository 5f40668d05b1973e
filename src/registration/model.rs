//! The picture of the plate on the ideal sensor as a function of parameters, with its slopes.

use crate::geometry::{Handedness, MappingKind, projection_jacobian};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Matrix3, Vector2};

/// The most parameters a mapping has.
pub(super) const MOST: usize = 8;

/// Plate positions are counted in it, which makes the parameters alike in size.
const UNIT_MIL: f64 = 1000.0;

/// A picture of the plate, x = t + L w / (1 + g . w), with w the plate position from the plate's centre, in units of 1000 mil
/// along the axes of the handedness, and L = [a, -b; b, a] + [c, d; d, -c].
///
/// Parameters: tx, ty; a, b; c, d; gx, gy. Every kind of mapping has some of them, and the others are zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    handedness: Handedness,
    parameters: [f64; MOST],
}

/// Which parameters a kind of mapping has.
pub(super) fn parameters_of(kind: MappingKind) -> [bool; MOST] {
    let stretch = matches!(kind, MappingKind::Affine | MappingKind::Homography);
    let divisor = matches!(kind, MappingKind::Keystone | MappingKind::Homography);
    [true, true, true, true, stretch, stretch, divisor, divisor]
}

impl Model {
    pub(super) fn zero(handedness: Handedness) -> Self {
        Self {
            handedness,
            parameters: [0.0; MOST],
        }
    }

    pub(super) fn advanced(mut self, step: &[f64]) -> Self {
        for (parameter, step) in self.parameters.iter_mut().zip(step) {
            *parameter += step;
        }
        self
    }

    pub(super) fn parameters(&self) -> &[f64; MOST] {
        &self.parameters
    }

    /// How far a step moves the picture of what lies 1000 mil from the plate's centre, px, squared.
    pub(super) fn moved_px2(&self, step: &[f64; MOST]) -> f64 {
        let unit_px = self.scale_px_per_mil() * UNIT_MIL;
        let [linear @ .., gx, gy] = step;
        let by_linear: f64 = linear.iter().map(|v| v * v).sum();
        by_linear + unit_px * unit_px * (gx * gx + gy * gy)
    }

    /// At the plate's centre.
    pub(super) fn scale_px_per_mil(&self) -> f64 {
        self.parameters[2].hypot(self.parameters[3]) / UNIT_MIL
    }

    fn shift(&self) -> Vector2<f64> {
        Vector2::new(self.parameters[0], self.parameters[1])
    }

    fn linear(&self) -> Matrix2<f64> {
        let [_, _, a, b, c, d, ..] = self.parameters;
        Matrix2::new(a + c, d - b, d + b, a - c)
    }

    fn divisor(&self) -> Vector2<f64> {
        Vector2::new(self.parameters[6], self.parameters[7])
    }

    /// Takes plate positions, mil, to w.
    fn axes(&self) -> Matrix2<f64> {
        self.handedness.axes() / UNIT_MIL
    }

    /// The homography from plate (mil) to ideal sensor (px).
    pub(super) fn homography(&self) -> Matrix3<f64> {
        let (shift, divisor) = (self.shift(), self.divisor());
        let linear = (self.linear() + shift * divisor.transpose()) * self.axes();
        let last = self.axes() * divisor;
        Matrix3::new(
            linear.m11, linear.m12, shift.x, //
            linear.m21, linear.m22, shift.y, //
            last.x, last.y, 1.0,
        )
    }

    /// Where the model sees a plate position on the ideal sensor, px.
    pub(super) fn picture(&self, at: PlateMil) -> Vector2<f64> {
        let w = self.axes() * at.vector();
        self.shift() + self.linear() * w / (1.0 + self.divisor().dot(&w))
    }

    /// Derivative of [`picture`](Self::picture), px per mil.
    pub(super) fn jacobian(&self, at: PlateMil) -> Matrix2<f64> {
        projection_jacobian(&self.homography(), at.vector())
    }

    /// The plate position seen at a place on the ideal sensor, mil, and its derivative, mil per px.
    pub(super) fn back(&self, seen: Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let back = self.linear().try_inverse()?;
        let straight = back * (seen - self.shift());
        let left = 1.0 / (1.0 - self.divisor().dot(&straight));
        let w = straight * left;
        let slopes = (back + w * (back.transpose() * self.divisor()).transpose()) * left;
        let to_mil = self.handedness.axes() * UNIT_MIL;
        Some((to_mil * w, to_mil * slopes))
    }

    /// Slopes of [`picture`](Self::picture) in the parameters: of its x, and of its y.
    pub(super) fn parameter_slopes(&self, at: PlateMil) -> [[f64; MOST]; 2] {
        let w = self.axes() * at.vector();
        let v = w / (1.0 + self.divisor().dot(&w));
        let q = self.linear() * v;
        [
            [1.0, 0.0, v.x, -v.y, v.x, v.y, -q.x * v.x, -q.x * v.y],
            [0.0, 1.0, v.y, v.x, -v.y, v.x, -q.y * v.x, -q.y * v.y],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Distortion, Mapping};

    fn tilted() -> Model {
        let parameters = [650.0, 480.0, 150.0, 80.0, 0.3, -0.2, 0.02, -0.01];
        Model::zero(Handedness::Mirrored).advanced(&parameters)
    }

    #[test]
    fn a_picture_is_that_of_its_homography_and_leads_back() {
        let model = tilted();
        let at = PlateMil::new(700.0, -400.0);
        let seen = model.picture(at);
        let to_plate = model.homography().try_inverse().unwrap();
        let mapping = Mapping::new(MappingKind::Homography, to_plate, Distortion::NONE).unwrap();
        assert!((mapping.to_sensor(at).vector() - seen).norm() < 1e-9);
        let (back, slopes) = model.back(seen).unwrap();
        assert!((back - at.vector()).norm() < 1e-9);
        assert!((slopes * model.jacobian(at) - Matrix2::identity()).norm() < 1e-12);
    }

    #[test]
    fn slopes_are_those_of_the_picture() {
        let (model, at) = (tilted(), PlateMil::new(700.0, -400.0));
        let slopes = model.parameter_slopes(at);
        for n in 0..MOST {
            let mut step = [0.0; MOST];
            step[n] = 1e-5;
            let plus = model.advanced(&step).picture(at);
            step[n] = -1e-5;
            let slope = (plus - model.advanced(&step).picture(at)) / 2e-5;
            assert!((slope.x - slopes[0][n]).abs() < 1e-4, "{n}");
            assert!((slope.y - slopes[1][n]).abs() < 1e-4, "{n}");
        }
    }
}
