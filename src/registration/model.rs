//! The picture of the plate on the ideal sensor as a function of parameters, with its slopes.

use crate::geometry::{Handedness, MappingKind, projection_jacobian};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

/// The most parameters a mapping has; kinds with fewer leave the last ones at zero.
pub(super) const MOST: usize = 8;

/// Parameters of a model.
pub(super) type Parameters = SVector<f64, MOST>;
/// Slopes of a picture in the parameters.
pub(super) type Slopes = SMatrix<f64, 2, MOST>;

/// Plate coordinates about the pairs' middle, scaled to about one, which keeps the normal equations well
/// conditioned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Normalisation {
    middle: Vector2<f64>,
    size_mil: f64,
}

impl Normalisation {
    /// `None` when the positions do not differ.
    pub(super) fn of(positions: impl Iterator<Item = PlateMil> + Clone) -> Option<Self> {
        let count = positions.clone().count() as f64;
        let sum: Vector2<f64> = positions.clone().map(|p| p.vector()).sum();
        let middle = sum / count;
        let square: f64 = positions
            .map(|p| (p.vector() - middle).norm_squared())
            .sum();
        let size_mil = (square / count).sqrt();
        (size_mil > 0.0 && size_mil.is_finite()).then_some(Self { middle, size_mil })
    }

    /// Coordinates about the plate's centre instead, which the keystone is defined by.
    fn about_plate_centre(self) -> Self {
        Self {
            middle: Vector2::zeros(),
            ..self
        }
    }

    fn apply(&self, position: PlateMil) -> Vector2<f64> {
        (position.vector() - self.middle) / self.size_mil
    }

    fn matrix(&self) -> Matrix3<f64> {
        let s = 1.0 / self.size_mil;
        Matrix3::new(
            s,
            0.0,
            -s * self.middle.x, //
            0.0,
            s,
            -s * self.middle.y, //
            0.0,
            0.0,
            1.0,
        )
    }
}

/// A picture of the plate, x = (t + L u) / (1 + g . u) with u the normalised plate position.
///
/// Parameters: similarity tx, ty, a, b with L = [a, -b; b, a] times the axes of the handedness; keystone tx, ty, a, b
/// and g about the plate's centre, x = t + L u / (1 + g . u); affine tx, ty and L by rows; homography the same and g.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    kind: MappingKind,
    handedness: Handedness,
    normalisation: Normalisation,
    parameters: Parameters,
}

impl Model {
    pub(super) fn zero(
        kind: MappingKind,
        handedness: Handedness,
        normalisation: Normalisation,
    ) -> Self {
        Self {
            kind,
            handedness,
            normalisation,
            parameters: Parameters::zeros(),
        }
    }

    pub(super) fn kind(&self) -> MappingKind {
        self.kind
    }

    /// A similarity as one of the richer kinds, an affine model as a homography; itself of its own kind.
    pub(super) fn as_kind(&self, kind: MappingKind) -> Self {
        if kind == self.kind {
            return *self;
        }
        match (self.kind, kind) {
            (MappingKind::Similarity, MappingKind::Keystone) => self.as_keystone(),
            (MappingKind::Similarity, _) => self.without_tilt(kind),
            _ => Self { kind, ..*self },
        }
    }

    /// A similarity as an affine model, or as a homography without tilt.
    fn without_tilt(&self, kind: MappingKind) -> Self {
        let n = self.normalised();
        Self {
            kind,
            parameters: [n.m13, n.m23, n.m11, n.m12, n.m21, n.m22, 0.0, 0.0].into(),
            ..*self
        }
    }

    /// A similarity as a keystone without tilt.
    fn as_keystone(&self) -> Self {
        let normalisation = self.normalisation.about_plate_centre();
        let centre = self.picture(PlateMil::new(0.0, 0.0));
        let (a, b) = (self.parameters[2], self.parameters[3]);
        Self {
            kind: MappingKind::Keystone,
            normalisation,
            parameters: [centre.x, centre.y, a, b, 0.0, 0.0, 0.0, 0.0].into(),
            ..*self
        }
    }

    pub(super) fn advance(&mut self, step: &Parameters) {
        self.parameters += step;
    }

    /// The normalised homography from plate to sensor.
    fn normalised(&self) -> Matrix3<f64> {
        let p = &self.parameters;
        match self.kind {
            MappingKind::Similarity => {
                let axes = self.handedness.axes();
                Matrix3::new(
                    p[2] * axes.m11,
                    -p[3],
                    p[0], //
                    p[3] * axes.m11,
                    p[2],
                    p[1], //
                    0.0,
                    0.0,
                    1.0,
                )
            }
            MappingKind::Keystone => {
                let axes = self.handedness.axes();
                Matrix3::new(
                    p[2] * axes.m11 + p[0] * p[4],
                    -p[3] + p[0] * p[5],
                    p[0], //
                    p[3] * axes.m11 + p[1] * p[4],
                    p[2] + p[1] * p[5],
                    p[1], //
                    p[4],
                    p[5],
                    1.0,
                )
            }
            MappingKind::Affine => Matrix3::new(
                p[2], p[3], p[0], //
                p[4], p[5], p[1], //
                0.0, 0.0, 1.0,
            ),
            MappingKind::Homography => Matrix3::new(
                p[2], p[3], p[0], //
                p[4], p[5], p[1], //
                p[6], p[7], 1.0,
            ),
        }
    }

    /// The homography from plate (mil) to ideal sensor (px).
    pub(super) fn homography(&self) -> Matrix3<f64> {
        self.normalised() * self.normalisation.matrix()
    }

    /// Where the model sees a plate position on the ideal sensor, px.
    pub(super) fn picture(&self, at: PlateMil) -> Vector2<f64> {
        let h = self.normalised() * self.normalisation.apply(at).push(1.0);
        Vector2::new(h.x / h.z, h.y / h.z)
    }

    /// Derivative of [`picture`](Self::picture), px per mil.
    pub(super) fn jacobian(&self, at: PlateMil) -> Matrix2<f64> {
        projection_jacobian(&self.homography(), at.vector())
    }

    /// Slopes of [`picture`](Self::picture) in the parameters.
    pub(super) fn parameter_slopes(&self, at: PlateMil) -> Slopes {
        let u = self.normalisation.apply(at);
        let p = &self.parameters;
        let mut slopes = Slopes::zeros();
        let mut put = |x: &[f64], y: &[f64]| {
            for (n, (x, y)) in x.iter().zip(y).enumerate() {
                slopes[(0, n)] = *x;
                slopes[(1, n)] = *y;
            }
        };
        match self.kind {
            MappingKind::Similarity => {
                let v = self.handedness.axes() * u;
                put(&[1.0, 0.0, v.x, -v.y], &[0.0, 1.0, v.y, v.x]);
            }
            MappingKind::Keystone => {
                let divisor = 1.0 + p[4] * u.x + p[5] * u.y;
                let v = self.handedness.axes() * u / divisor;
                let q = Vector2::new(p[2] * v.x - p[3] * v.y, p[3] * v.x + p[2] * v.y);
                let (gx, gy) = (-q * u.x / divisor, -q * u.y / divisor);
                put(
                    &[1.0, 0.0, v.x, -v.y, gx.x, gy.x],
                    &[0.0, 1.0, v.y, v.x, gx.y, gy.y],
                );
            }
            MappingKind::Affine => {
                put(
                    &[1.0, 0.0, u.x, u.y, 0.0, 0.0],
                    &[0.0, 1.0, 0.0, 0.0, u.x, u.y],
                );
            }
            MappingKind::Homography => {
                let divisor = 1.0 + p[6] * u.x + p[7] * u.y;
                let image = self.picture(at);
                let (one, x, y) = (1.0 / divisor, u.x / divisor, u.y / divisor);
                put(
                    &[one, 0.0, x, y, 0.0, 0.0, -image.x * x, -image.x * y],
                    &[0.0, one, 0.0, 0.0, x, y, -image.y * x, -image.y * y],
                );
            }
        }
        slopes
    }
}
