//! How the camera sees the plate, as eight numbers about a reference, linear in each.

use crate::geometry::{Distortion, Mapping, MappingKind};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

/// Numbers of a view.
pub(super) const STATES: usize = 8;
/// Shift x and y (px); stretch and turn, and the two parts of the shear (px at [`UNIT_MIL`] from the plate's centre); lean of the
/// camera along the plate's X and Y (part at [`UNIT_MIL`]). All from the reference.
pub(super) type State = SVector<f64, STATES>;
pub(super) type Covariance = SMatrix<f64, STATES, STATES>;
pub(super) type Slopes = SMatrix<f64, 2, STATES>;
/// Half of a covariance, column by column: a flight has a hundred thousand, and none has seven digits.
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

/// The plate's unit of length here.
pub(super) const UNIT_MIL: f64 = 1000.0;

/// The view about which others are told: c + M u / (1 + g u), with u = P / [`UNIT_MIL`], on the ideal sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reference {
    centre: Vector2<f64>,
    linear: Matrix2<f64>,
    lean: Vector2<f64>,
    distortion: Distortion,
}

impl Reference {
    /// The straight view that passes nearest to where four corners of a square of [`UNIT_MIL`] about the plate's centre are
    /// seen. `None` where that cannot be inverted.
    pub fn through(corners: &[Vector2<f64>; 4], distortion: Distortion) -> Option<Self> {
        let centre = corners.iter().sum::<Vector2<f64>>() / 4.0;
        let [right, left, down, up] = corners;
        let linear = Matrix2::from_columns(&[(right - left) / 2.0, (down - up) / 2.0]);
        linear.try_inverse().map(|_| Self {
            centre,
            linear,
            lean: Vector2::zeros(),
            distortion,
        })
    }

    /// The corners that [`through`](Self::through) takes.
    pub fn corners() -> [PlateMil; 4] {
        let at = |x: f64, y: f64| PlateMil::new(x * UNIT_MIL, y * UNIT_MIL);
        [at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0), at(0.0, -1.0)]
    }

    /// The same with a state added, from which others are told then.
    pub fn moved(&self, state: &State) -> Self {
        let scale = self.scale_px();
        let (a, b, c, d) = (state[2], state[3], state[4], state[5]);
        let turn = Matrix2::new(a + c, -b + d, b + d, a - c) / scale;
        Self {
            centre: self.centre + state.fixed_rows::<2>(0),
            linear: self.linear + turn * self.linear,
            lean: self.lean + state.fixed_rows::<2>(6),
            distortion: self.distortion,
        }
    }

    /// Length of [`UNIT_MIL`] on the sensor.
    pub fn scale_px(&self) -> f64 {
        self.linear.determinant().abs().sqrt()
    }

    /// Where the reference sees a plate position on the ideal sensor, and the slopes of that in the state.
    pub fn picture(&self, at: PlateMil) -> (Vector2<f64>, Slopes) {
        let u = at.vector() / UNIT_MIL;
        let part = 1.0 / (1.0 + self.lean.dot(&u));
        let q = self.linear * u * part;
        let v = q / self.scale_px();
        let slopes = Slopes::from_columns(&[
            Vector2::x(),
            Vector2::y(),
            v,
            Vector2::new(-v.y, v.x),
            Vector2::new(v.x, -v.y),
            Vector2::new(v.y, v.x),
            -q * (u.x * part),
            -q * (u.y * part),
        ]);
        (self.centre + q, slopes)
    }

    /// The mapping of a state. `None` where it cannot be inverted.
    pub fn mapping(&self, state: &State) -> Option<Mapping> {
        let view = self.moved(state);
        let (c, g) = (view.centre, view.lean / UNIT_MIL);
        let m = view.linear / UNIT_MIL + c * g.transpose();
        let to_sensor = Matrix3::new(
            m.m11, m.m12, c.x, //
            m.m21, m.m22, c.y, //
            g.x, g.y, 1.0,
        );
        Mapping::new(
            MappingKind::Homography,
            to_sensor.try_inverse()?,
            self.distortion,
        )
    }

    /// Covariance of a plate position got through the mapping of a state, mil^2.
    pub fn covariance_mil2(
        &self,
        at: PlateMil,
        mapping: &Mapping,
        covariance: &Covariance,
    ) -> Matrix2<f64> {
        let (_, slopes) = self.picture(at);
        let on_sensor = slopes * covariance * slopes.transpose();
        let to_plate = mapping.plate_jacobian(mapping.to_sensor(at));
        to_plate * on_sensor * to_plate.transpose()
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
    fn half_of_a_covariance_is_all_of_it() {
        let all = Covariance::from_fn(|i, j| (1 + i.min(j) + 10 * i.max(j)) as f64);
        assert_eq!(unpacked(&packed(&all)), all);
    }

    #[test]
    fn the_slopes_are_those_of_the_mapping() {
        let lean = State::from_column_slice(&[0.5, -0.3, 0.2, 0.4, 0.1, -0.2, 2e-3, -1e-3]);
        let reference = reference().moved(&lean);
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
    fn shift_turn_and_stretch_are_exact_however_large() {
        let reference = reference();
        let state = State::from_column_slice(&[30.0, -20.0, 3.0, 9.0, 0.0, 0.0, 0.0, 0.0]);
        let at = PlateMil::new(-1500.0, 400.0);
        let (seen, slopes) = reference.picture(at);
        let moved = reference.mapping(&state).unwrap().to_sensor(at).vector();
        assert!((moved - seen - slopes * state).norm() < 1e-9);
    }
}
