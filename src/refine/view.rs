//! The flight's view of the plate as deviations from a reference view, linear in each.

use crate::geometry::view::{
    PARAMETERS, ParameterCovariance, ParameterJacobian, Parameters, UNIT_MIL, View,
};
use crate::geometry::{Distortion, Mapping, MappingKind};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Matrix3, Vector2};

pub(super) const STATES: usize = PARAMETERS;
/// Deviation from the reference: shift x and y (px); stretch, rotation and the two parts of the shear (px at [`UNIT_MIL`]
/// from the plate's centre); tilt x and y (per [`UNIT_MIL`], along the sensor's x and y).
pub(super) type State = Parameters;
pub(super) type Covariance = ParameterCovariance;
/// Upper triangle of a covariance, column by column, in single precision to save memory: a flight has a hundred thousand.
pub(super) type UpperTriangle = [f32; STATES * (STATES + 1) / 2];

pub(super) fn packed(covariance: &Covariance) -> UpperTriangle {
    let mut parts = (0..STATES).flat_map(|j| (0..=j).map(move |i| (i, j)));
    std::array::from_fn(|_| parts.next().map_or(0.0, |at| covariance[at] as f32))
}

pub(super) fn unpacked(upper: &UpperTriangle) -> Covariance {
    Covariance::from_fn(|i, j| {
        let (i, j) = (i.min(j), i.max(j));
        f64::from(upper[j * (j + 1) / 2 + i])
    })
}

/// The view that states deviate from. Its axes are rotated with the camera, so that its L is the scale alone and the
/// state's next four parameters are stretch, rotation and shear on the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reference {
    pub view: View,
    distortion: Distortion,
}

impl Reference {
    /// The untilted view that best fits the observed positions of four points of the plate, [`UNIT_MIL`] from its centre along each axis.
    /// `None` where it cannot be inverted.
    pub fn through(corners: &[Vector2<f64>; 4], distortion: Distortion) -> Option<Self> {
        let centre = corners.iter().sum::<Vector2<f64>>() / 4.0;
        let [right, left, down, up] = corners;
        let linear = Matrix2::from_columns(&[(right - left) / 2.0, (down - up) / 2.0]) / UNIT_MIL;
        Self::of(
            &Matrix3::new(
                linear.m11, linear.m12, centre.x, //
                linear.m21, linear.m22, centre.y, //
                0.0, 0.0, 1.0,
            ),
            distortion,
        )
    }

    /// The points that [`through`](Self::through) takes.
    pub fn corners() -> [PlateMil; 4] {
        let at = |x: f64, y: f64| PlateMil::new(x * UNIT_MIL, y * UNIT_MIL);
        [at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0), at(0.0, -1.0)]
    }

    fn of(to_sensor: &Matrix3<f64>, distortion: Distortion) -> Option<Self> {
        let centre = Vector2::new(to_sensor.m13, to_sensor.m23);
        let tilt = to_sensor.fixed_view::<1, 2>(2, 0);
        let linear = to_sensor.fixed_view::<2, 2>(0, 0) - centre * tilt;
        let axes = linear / linear.determinant().abs().sqrt() / UNIT_MIL;
        let view = View::along(axes, to_sensor)?;
        Some(Self { view, distortion })
    }

    /// The reference moved by a state. `None` where it cannot be inverted.
    pub fn moved(&self, state: &State) -> Option<Self> {
        Self::of(&self.view.advanced(state).to_sensor(), self.distortion)
    }

    /// Position of a plate point on the ideal sensor by the reference, and its derivative by the state.
    pub fn picture(&self, at: PlateMil) -> (Vector2<f64>, ParameterJacobian) {
        (self.view.project(at), self.view.parameter_jacobian(at))
    }

    /// The mapping of a state. `None` where it cannot be inverted.
    pub fn mapping(&self, state: &State) -> Option<Mapping> {
        let view = self.view.advanced(state);
        view.mapping(MappingKind::Homography, self.distortion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reference() -> Reference {
        let corner = |p: PlateMil| Vector2::new(640.0 - 0.17 * p.x, 480.0 + 0.17 * p.y);
        Reference::through(&Reference::corners().map(corner), Distortion::NONE).unwrap()
    }

    #[test]
    fn a_packed_covariance_is_unpacked_as_it_was() {
        let all = Covariance::from_fn(|i, j| (1 + i.min(j) + 10 * i.max(j)) as f64);
        assert_eq!(unpacked(&packed(&all)), all);
    }

    #[test]
    fn the_derivatives_are_those_of_the_mapping() {
        let tilted = State::from_column_slice(&[0.5, -0.3, 0.2, 0.4, 0.1, -0.2, 2e-3, -1e-3]);
        let reference = reference().moved(&tilted).unwrap();
        let at = PlateMil::new(700.0, -900.0);
        let (seen, slopes) = reference.picture(at);
        let straight = reference.mapping(&State::zeros()).unwrap().to_sensor(at);
        assert!((straight.vector() - seen).norm() < 1e-9);
        for n in 0..STATES {
            let mut step = State::zeros();
            step[n] = if n < 6 { 1e-3 } else { 1e-6 };
            let moved = reference.mapping(&step).unwrap().to_sensor(at).vector();
            let slope = (moved - seen) / step[n];
            assert!(
                (slope - slopes.column(n)).norm() < 1e-3 * slope.norm(),
                "{n}"
            );
        }
    }

    #[test]
    fn shift_rotation_and_stretch_are_linear_however_large() {
        let reference = reference();
        let state = State::from_column_slice(&[30.0, -20.0, 3.0, 9.0, 0.0, 0.0, 0.0, 0.0]);
        let at = PlateMil::new(-1500.0, 400.0);
        let (seen, slopes) = reference.picture(at);
        let moved = reference.mapping(&state).unwrap().to_sensor(at).vector();
        assert!((moved - seen - slopes * state).norm() < 1e-9);
    }
}
