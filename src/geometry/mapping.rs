//! The mapping from sensor to plate: a plane homography, with affine and similarity as simple kinds, and the lens's distortion.

use super::distortion::Distortion;
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Parameters of a [`View`](super::view::View) that a mapping has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum MappingKind {
    /// Shift, rotation and one scale: 4 parameters.
    Similarity,
    /// A similarity with tilt, conformal at the plate's centre: 6 parameters.
    Keystone,
    /// Shift and any linear map: 6 parameters.
    Affine,
    /// A view of the plate from any direction: 8 parameters.
    Homography,
}

impl MappingKind {
    pub fn parameters(self) -> usize {
        match self {
            Self::Similarity => 4,
            Self::Keystone | Self::Affine => 6,
            Self::Homography => 8,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Similarity => "similarity",
            Self::Keystone => "keystone",
            Self::Affine => "affine",
            Self::Homography => "homography",
        }
    }
}

/// Handedness of the camera's view, without rotation: signs of the plate's axes on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Handedness {
    /// x decreases with X, y increases with Y: the camera sees the plate mirrored (HEROES).
    Mirrored,
    /// x increases with X, y increases with Y.
    Direct,
}

impl Handedness {
    /// Name in the instrument's file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mirrored => "mirrored",
            Self::Direct => "direct",
        }
    }

    /// Handedness of the mirror image.
    pub fn other(self) -> Self {
        match self {
            Self::Mirrored => Self::Direct,
            Self::Direct => Self::Mirrored,
        }
    }

    /// The plate's axes projected at rotation 0, without scale.
    pub fn axes(self) -> Matrix2<f64> {
        match self {
            Self::Mirrored => Matrix2::new(-1.0, 0.0, 0.0, 1.0),
            Self::Direct => Matrix2::identity(),
        }
    }
}

/// The parameters of a similarity in conventional terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimilarityParameters {
    /// Sensor position of the plate's centre.
    pub plate_centre: SensorPx,
    /// Plate length per pixel.
    pub scale_mil_per_px: f64,
    /// Rotation of the plate's [`axes`](Handedness::axes), positive from +x towards +y.
    pub rotation_deg: f64,
    pub handedness: Handedness,
}

/// The mapping from sensor to plate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mapping {
    kind: MappingKind,
    to_plate: Matrix3<f64>,
    to_sensor: Matrix3<f64>,
    distortion: Distortion,
}

impl Mapping {
    /// A mapping from the homography of ideal sensor positions (px) to the plate (mil).
    /// `None` if it cannot be inverted or contains a number that is not finite.
    pub fn new(kind: MappingKind, to_plate: Matrix3<f64>, distortion: Distortion) -> Option<Self> {
        let to_sensor = to_plate.try_inverse()?;
        let finite = to_plate
            .iter()
            .chain(to_sensor.iter())
            .all(|v| v.is_finite());
        finite.then_some(Self {
            kind,
            to_plate,
            to_sensor,
            distortion,
        })
    }

    /// A similarity from its parameters. `None` if the scale is zero or a parameter is not finite.
    pub fn similarity(parameters: SimilarityParameters, distortion: Distortion) -> Option<Self> {
        let (sin, cos) = parameters.rotation_deg.to_radians().sin_cos();
        let linear = Matrix2::new(cos, -sin, sin, cos) * parameters.handedness.axes()
            / parameters.scale_mil_per_px;
        let centre = parameters.plate_centre;
        let to_sensor = Matrix3::new(
            linear.m11, linear.m12, centre.x, //
            linear.m21, linear.m22, centre.y, //
            0.0, 0.0, 1.0,
        );
        Self::new(
            MappingKind::Similarity,
            to_sensor.try_inverse()?,
            distortion,
        )
    }

    pub fn kind(&self) -> MappingKind {
        self.kind
    }

    /// The homography from ideal sensor positions to the plate.
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.to_plate
    }

    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The plate position at a sensor position.
    pub fn to_plate(&self, seen: SensorPx) -> PlateMil {
        project(&self.to_plate, self.distortion.correct(seen).vector()).into()
    }

    /// The sensor position of a plate position.
    pub fn to_sensor(&self, position: PlateMil) -> SensorPx {
        self.distortion
            .distort(project(&self.to_sensor, position.vector()).into())
    }

    /// Derivative of [`to_sensor`](Self::to_sensor), px per mil.
    pub fn sensor_jacobian(&self, position: PlateMil) -> Matrix2<f64> {
        let ideal = project(&self.to_sensor, position.vector());
        self.distortion.derivative(ideal.into())
            * projection_jacobian(&self.to_sensor, position.vector())
    }

    /// Derivative of [`to_plate`](Self::to_plate), mil per px.
    pub fn plate_jacobian(&self, seen: SensorPx) -> Matrix2<f64> {
        let ideal = self.distortion.correct(seen);
        let lens = self.distortion.derivative(ideal);
        let inverse_lens = lens.try_inverse().unwrap_or_else(Matrix2::identity);
        projection_jacobian(&self.to_plate, ideal.vector()) * inverse_lens
    }

    /// Plate length per pixel at a sensor position: the square root of the ratio of areas.
    pub fn scale_mil_per_px(&self, seen: SensorPx) -> f64 {
        self.plate_jacobian(seen).determinant().abs().sqrt()
    }

    /// Handedness of the view.
    pub fn handedness(&self) -> Handedness {
        let linear = self.to_plate.fixed_view::<2, 2>(0, 0);
        if linear.determinant() < 0.0 {
            Handedness::Mirrored
        } else {
            Handedness::Direct
        }
    }

    /// Rotation of the projected plate at a sensor position, positive from +x towards +y, -180 to 180 deg.
    pub fn rotation_deg(&self, seen: SensorPx) -> f64 {
        let local = self.sensor_jacobian(self.to_plate(seen)) * self.handedness().axes();
        (local.m21 - local.m12)
            .atan2(local.m11 + local.m22)
            .to_degrees()
    }
}

/// A position projected by a plane homography.
fn project(homography: &Matrix3<f64>, p: Vector2<f64>) -> Vector2<f64> {
    let h = homography * Vector3::new(p.x, p.y, 1.0);
    Vector2::new(h.x / h.z, h.y / h.z)
}

/// Derivative of a projection by a plane homography.
fn projection_jacobian(homography: &Matrix3<f64>, p: Vector2<f64>) -> Matrix2<f64> {
    let h = homography * Vector3::new(p.x, p.y, 1.0);
    let image = Vector2::new(h.x / h.z, h.y / h.z);
    let numerator = homography.fixed_view::<2, 2>(0, 0).into_owned();
    let denominator = homography.fixed_view::<1, 2>(2, 0).into_owned();
    (numerator - image * denominator) / h.z
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted() -> Mapping {
        let similarity = Mapping::similarity(
            SimilarityParameters {
                plate_centre: SensorPx::new(650.0, 480.0),
                scale_mil_per_px: 5.75,
                rotation_deg: 37.0,
                handedness: Handedness::Mirrored,
            },
            Distortion::NONE,
        )
        .unwrap();
        let keystone = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1e-5, 0.0, 1.0);
        let lens = Distortion {
            centre: SensorPx::new(647.5, 482.5),
            radial: [5e-9, 0.0],
            decentring: [0.0; 2],
        };
        Mapping::new(
            MappingKind::Homography,
            similarity.matrix() * keystone,
            lens,
        )
        .unwrap()
    }

    #[test]
    fn a_position_goes_to_the_plate_and_back() {
        let mapping = tilted();
        for (x, y) in [(0.0, 0.0), (1295.0, 965.0), (648.0, 483.0)] {
            let seen = SensorPx::new(x, y);
            assert!(mapping.to_sensor(mapping.to_plate(seen)).distance(seen) < 1e-8);
        }
    }

    #[test]
    fn jacobians_are_the_derivatives_of_the_mapping() {
        let mapping = tilted();
        let (seen, h) = (SensorPx::new(200.0, 700.0), 1e-3);
        let slope = |dx: f64, dy: f64| {
            let plus = mapping.to_plate(SensorPx::new(seen.x + dx, seen.y + dy));
            let minus = mapping.to_plate(SensorPx::new(seen.x - dx, seen.y - dy));
            (plus.vector() - minus.vector()) / (2.0 * h)
        };
        let numeric = Matrix2::from_columns(&[slope(h, 0.0), slope(0.0, h)]);
        let jacobian = mapping.plate_jacobian(seen);
        assert!((numeric - jacobian).norm() < 1e-6);
        let round = mapping.sensor_jacobian(mapping.to_plate(seen)) * jacobian;
        assert!((round - Matrix2::identity()).norm() < 1e-9);
    }

    #[test]
    fn a_similarity_reports_its_own_parameters() {
        for handedness in [Handedness::Mirrored, Handedness::Direct] {
            for rotation_deg in [-170.0, -7.0, 0.0, 45.0, 123.0] {
                let parameters = SimilarityParameters {
                    plate_centre: SensorPx::new(640.0, 480.0),
                    scale_mil_per_px: 5.75,
                    rotation_deg,
                    handedness,
                };
                let mapping = Mapping::similarity(parameters, Distortion::NONE).unwrap();
                let at = SensorPx::new(100.0, 200.0);
                assert!((mapping.rotation_deg(at) - rotation_deg).abs() < 1e-9);
                assert!((mapping.scale_mil_per_px(at) - 5.75).abs() < 1e-9);
                assert_eq!(mapping.handedness(), handedness);
            }
        }
    }

    #[test]
    fn an_unrotated_mirrored_camera_sees_x_fall_with_plate_x() {
        let parameters = SimilarityParameters {
            plate_centre: SensorPx::new(640.0, 480.0),
            scale_mil_per_px: 5.0,
            rotation_deg: 0.0,
            handedness: Handedness::Mirrored,
        };
        let mapping = Mapping::similarity(parameters, Distortion::NONE).unwrap();
        let seen = mapping.to_sensor(PlateMil::new(100.0, 50.0));
        assert!(seen.distance(SensorPx::new(620.0, 490.0)) < 1e-9);
    }
}
