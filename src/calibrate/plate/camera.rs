//! How the camera sees the plate, as functions of parameters, with their slopes: one view for each pose, one lens for all.

use crate::geometry::{Distortion, Handedness, Mapping, MappingKind};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

/// Parameters of a view, richest kind.
pub(super) const VIEW: usize = 8;
/// Terms of the lens: radial r^2 and r^4, decentring 1 and 2.
pub(super) const LENS: usize = 4;

/// Plate positions count in this unit inside a view, so that all its parameters are alike in size.
const UNIT_MIL: f64 = 3000.0;

/// One pose: the picture of the plate on the ideal sensor, t + L u / (1 + g . u) with u the plate position.
///
/// Parameters: t (px), rotation and scale as the complex number of L, g (the keystone), then what makes L no similarity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    parameters: SVector<f64, VIEW>,
    handedness: Handedness,
}

/// How many of a view's parameters a kind of mapping has.
pub(super) fn view_parameters(kind: MappingKind) -> usize {
    kind.parameters()
}

impl View {
    /// The similarity nearest to a mapping at the plate's centre; its distortion is left out.
    pub(super) fn of(mapping: &Mapping) -> Option<Self> {
        let h = mapping.matrix().try_inverse()?;
        let h = h / h.m33;
        let handedness = mapping.handedness();
        let t = Vector2::new(h.m13, h.m23);
        let slope = h.fixed_view::<2, 2>(0, 0) - t * h.fixed_view::<1, 2>(2, 0);
        let l = slope * handedness.axes() * UNIT_MIL;
        let mut parameters = SVector::<f64, VIEW>::zeros();
        parameters[0] = t.x;
        parameters[1] = t.y;
        parameters[2] = (l.m11 + l.m22) / 2.0;
        parameters[3] = (l.m21 - l.m12) / 2.0;
        parameters.iter().all(|v| v.is_finite()).then_some(Self {
            parameters,
            handedness,
        })
    }

    pub(super) fn advance(&mut self, step: &SVector<f64, VIEW>) {
        self.parameters += step;
    }

    /// Parameters beyond the first `count`, which a simpler kind does not have, become zero.
    pub(super) fn simplified(mut self, count: usize) -> Self {
        self.parameters.rows_mut(count, VIEW - count).fill(0.0);
        self
    }

    pub(super) fn parameters(&self) -> &SVector<f64, VIEW> {
        &self.parameters
    }

    /// What a camera by hand can be expected to be: straight within 5 deg, its pixels square within 0.5 %.
    pub(super) fn prior_sigmas(&self) -> [(usize, f64); 4] {
        const KEYSTONE: f64 = 0.01;
        const STRETCH: f64 = 0.005;
        let size = self.parameters[2].hypot(self.parameters[3]);
        [
            (4, KEYSTONE),
            (5, KEYSTONE),
            (6, STRETCH * size),
            (7, STRETCH * size),
        ]
    }

    fn linear(&self) -> Matrix2<f64> {
        let p = &self.parameters;
        Matrix2::new(p[2] + p[6], p[7] - p[3], p[3] + p[7], p[2] - p[6])
    }

    fn unit(&self, at: Vector2<f64>) -> Vector2<f64> {
        self.handedness.axes() * at / UNIT_MIL
    }

    fn divisor(&self, u: Vector2<f64>) -> f64 {
        1.0 + self.parameters[4] * u.x + self.parameters[5] * u.y
    }

    /// Where the ideal sensor sees a plate position (mil), px.
    pub(super) fn ideal(&self, at: Vector2<f64>) -> Vector2<f64> {
        let u = self.unit(at);
        Vector2::new(self.parameters[0], self.parameters[1]) + self.linear() * u / self.divisor(u)
    }

    /// Slopes of [`ideal`](Self::ideal) in the parameters.
    pub(super) fn parameter_slopes(&self, at: Vector2<f64>) -> SMatrix<f64, 2, VIEW> {
        let u = self.unit(at);
        let d = self.divisor(u);
        let (v, n) = (u / d, self.linear() * u / (d * d));
        SMatrix::<f64, 2, VIEW>::from_columns(&[
            Vector2::x(),
            Vector2::y(),
            v,
            Vector2::new(-v.y, v.x),
            -n * u.x,
            -n * u.y,
            Vector2::new(v.x, -v.y),
            Vector2::new(v.y, v.x),
        ])
    }

    /// Slopes of [`ideal`](Self::ideal) in the plate position, px per mil.
    pub(super) fn place_slopes(&self, at: Vector2<f64>) -> Matrix2<f64> {
        let u = self.unit(at);
        let d = self.divisor(u);
        let g = self.parameters.fixed_rows::<2>(4);
        let bent = self.linear() - self.linear() * u * g.transpose() / d;
        bent / d * self.handedness.axes() / UNIT_MIL
    }

    /// The mapping from sensor to plate.
    pub(super) fn mapping(&self, kind: MappingKind, distortion: Distortion) -> Option<Mapping> {
        let t = Vector2::new(self.parameters[0], self.parameters[1]);
        let g = self.parameters.fixed_rows::<2>(4).transpose();
        let scale = self.handedness.axes() / UNIT_MIL;
        let mut h = Matrix3::identity();
        h.fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&((self.linear() + t * g) * scale));
        h.fixed_view_mut::<2, 1>(0, 2).copy_from(&t);
        h.fixed_view_mut::<1, 2>(2, 0).copy_from(&(g * scale));
        Mapping::new(kind, h.try_inverse()?, distortion)
    }

    /// Plate length per pixel and rotation (deg) at the plate's centre.
    pub(super) fn scale_and_rotation(&self) -> (f64, f64) {
        let p = &self.parameters;
        (UNIT_MIL / p[2].hypot(p[3]), p[3].atan2(p[2]).to_degrees())
    }
}

/// The lens, each term as the displacement it makes at `reach_px` from the centre, px.
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

    /// Slopes of the seen position in the terms, at an ideal position.
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

/// What a prediction of a seen position depends on.
pub(super) struct Prediction {
    pub seen: Vector2<f64>,
    pub view: SMatrix<f64, 2, VIEW>,
    pub lens: SMatrix<f64, 2, LENS>,
    pub place: Matrix2<f64>,
}

/// Where a mark at a plate position is seen, with all slopes.
pub(super) fn predict(view: &View, lens: &Lens, at: PlateMil) -> Prediction {
    let ideal = view.ideal(at.vector());
    let distortion = lens.distortion();
    let bend = distortion.derivative(ideal.into());
    Prediction {
        seen: distortion.distort(ideal.into()).vector(),
        view: bend * view.parameter_slopes(at.vector()),
        lens: lens.slopes(ideal),
        place: bend * view.place_slopes(at.vector()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View {
            parameters: SVector::from([640.0, 480.0, 500.0, 130.0, 0.004, -0.007, 1.5, -0.8]),
            handedness: Handedness::Mirrored,
        }
    }

    fn lens() -> Lens {
        Lens {
            centre: SensorPx::new(647.5, 482.5),
            reach_px: 800.0,
            terms: SVector::from([2.4, -0.3, 0.2, 0.1]),
        }
    }

    #[test]
    fn slopes_are_those_of_the_prediction() {
        let at = PlateMil::new(900.0, -1400.0);
        let here = predict(&view(), &lens(), at);
        for n in 0..VIEW {
            let mut moved = view();
            moved.parameters[n] += 1e-5;
            let slope = (predict(&moved, &lens(), at).seen - here.seen) / 1e-5;
            assert!((slope - here.view.column(n)).norm() < 1e-3, "{n}");
        }
        for n in 0..LENS {
            let mut moved = lens();
            moved.terms[n] += 1e-4;
            let slope = (predict(&view(), &moved, at).seen - here.seen) / 1e-4;
            assert!((slope - here.lens.column(n)).norm() < 1e-6, "{n}");
        }
        for (n, step) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
            let moved = PlateMil::from(at.vector() + step * 1e-3);
            let slope = (predict(&view(), &lens(), moved).seen - here.seen) / 1e-3;
            assert!((slope - here.place.column(n)).norm() < 1e-5);
        }
    }

    #[test]
    fn a_view_is_the_mapping_it_gives() {
        let mapping = view()
            .mapping(MappingKind::Homography, lens().distortion())
            .unwrap();
        let at = PlateMil::new(-700.0, 1100.0);
        let seen = predict(&view(), &lens(), at).seen;
        assert!(mapping.to_sensor(at).distance(seen.into()) < 1e-9);
        let similar = view().simplified(4);
        let mapping = similar
            .mapping(MappingKind::Similarity, Distortion::NONE)
            .unwrap();
        assert!((View::of(&mapping).unwrap().parameters - similar.parameters).norm() < 1e-9);
    }
}
