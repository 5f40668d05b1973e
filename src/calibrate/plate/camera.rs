//! Camera model of a plate calibration: one view for each pose, one lens for all.

use crate::geometry::Distortion;
use crate::geometry::view::{PARAMETERS, ParameterJacobian, UNIT_MIL, View};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Terms of the lens: radial r^2 and r^4, decentring 1 and 2.
pub(super) const LENS: usize = 4;

/// Priors of a view's parameters, 1 sigma about zero: a camera placed by hand is perpendicular within 5 deg, and its pixels are square
/// within 0.5 %.
pub(super) fn prior_sigmas(view: &View) -> [Option<f64>; PARAMETERS] {
    /// Change over the whole plate, 3000 mil.
    const TILT: f64 = 0.01;
    const STRETCH: f64 = 0.005;
    let tilt = Some(TILT * UNIT_MIL / 3000.0);
    let stretch = Some(STRETCH * view.unit_px());
    [None, None, None, None, stretch, stretch, tilt, tilt]
}

/// The lens, each term as its displacement at `reach_px` from the centre, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    pub centre: SensorPx,
    pub reach_px: f64,
    pub terms: SVector<f64, LENS>,
}

impl Lens {
    pub(super) fn of(distortion: &Distortion, centre: SensorPx, reach_px: f64) -> Self {
        let ([k1, k2], [p1, p2]) = (distortion.radial, distortion.decentring);
        let r = reach_px;
        let terms = SVector::from([k1 * r.powi(3), k2 * r.powi(5), p1 * r * r, p2 * r * r]);
        Self {
            centre,
            reach_px,
            terms,
        }
    }

    /// Displacement of one unit of each of [`terms`](Self::terms) in the file's units.
    pub(super) fn units(&self) -> [f64; LENS] {
        let r = self.reach_px;
        [r.powi(-3), r.powi(-5), r.powi(-2), r.powi(-2)]
    }

    pub(super) fn distortion(&self) -> Distortion {
        let unit = self.units();
        let term = |n: usize| self.terms[n] * unit[n];
        Distortion {
            centre: self.centre,
            radial: [term(0), term(1)],
            decentring: [term(2), term(3)],
        }
    }

    /// Derivative of the observed position by the terms, at an ideal position.
    pub(super) fn slopes(&self, ideal: Vector2<f64>) -> SMatrix<f64, 2, LENS> {
        let d = (ideal - self.centre.vector()) / self.reach_px;
        let r2 = d.norm_squared();
        SMatrix::<f64, 2, LENS>::from_columns(&[
            d * r2,
            d * r2 * r2,
            Vector2::new(2.0 * d.x * d.y, r2 + 2.0 * d.y * d.y),
            Vector2::new(r2 + 2.0 * d.x * d.x, 2.0 * d.x * d.y),
        ])
    }
}

/// A predicted position on the sensor (px) with its derivatives by the unknowns.
pub(super) struct Prediction {
    pub at_px: Vector2<f64>,
    pub view: ParameterJacobian,
    pub lens: SMatrix<f64, 2, LENS>,
    pub place: Matrix2<f64>,
}

/// Predicts the sensor position of a mark at a plate position.
pub(super) fn predict(view: &View, lens: &Lens, at: PlateMil) -> Prediction {
    let ideal = view.project(at);
    let distortion = lens.distortion();
    let lens_jacobian = distortion.derivative(ideal.into());
    Prediction {
        at_px: distortion.distort(ideal.into()).vector(),
        view: lens_jacobian * view.parameter_jacobian(at),
        lens: lens.slopes(ideal),
        place: lens_jacobian * view.jacobian(at),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Handedness;
    use crate::geometry::view::Parameters;

    fn view() -> View {
        let parameters = [640.0, 480.0, 170.0, 45.0, 0.5, -0.3, 1.3e-3, -2.3e-3];
        View::zero(Handedness::Mirrored).advanced(&parameters.into())
    }

    fn lens() -> Lens {
        Lens {
            centre: SensorPx::new(647.5, 482.5),
            reach_px: 800.0,
            terms: SVector::from([2.4, -0.3, 0.2, 0.1]),
        }
    }

    #[test]
    fn derivatives_are_those_of_the_prediction() {
        let at = PlateMil::new(900.0, -1400.0);
        let here = predict(&view(), &lens(), at);
        for n in 0..PARAMETERS {
            let step = Parameters::from_fn(|k, _| if k == n { 1e-5 } else { 0.0 });
            let seen = |step| predict(&view().advanced(&step), &lens(), at).at_px;
            let slope = (seen(step) - seen(-step)) / 2e-5;
            assert!((slope - here.view.column(n)).norm() < 1e-3, "{n}");
        }
        for n in 0..LENS {
            let mut moved = lens();
            moved.terms[n] += 1e-4;
            let slope = (predict(&view(), &moved, at).at_px - here.at_px) / 1e-4;
            assert!((slope - here.lens.column(n)).norm() < 1e-6, "{n}");
        }
        for (n, step) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
            let moved = PlateMil::from(at.vector() + step * 1e-3);
            let slope = (predict(&view(), &lens(), moved).at_px - here.at_px) / 1e-3;
            assert!((slope - here.place.column(n)).norm() < 1e-5);
        }
    }
}
