//! Attitudes with their uncertainty, from measured directions.
//!
//! An attitude takes directions of a reference frame to a body frame: b = R r. Its error is a small rotation vector delta
//! (rad) along the axes of the body: the estimated R is exp(delta) times the true one, so that the estimated b is off by
//! delta x b. All covariances hold to first order in the errors.

use nalgebra::{
    Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, UnitVector3, Vector3, Vector4,
};

/// A direction with the covariance of the unit vector, rad^2: of rank two, across the direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    pub unit: UnitVector3<f64>,
    pub covariance_rad2: Matrix3<f64>,
}

impl Direction {
    /// A direction with the same error along both axes across it, 1 sigma per axis.
    pub fn new(unit: UnitVector3<f64>, sigma_rad: f64) -> Self {
        Self {
            unit,
            covariance_rad2: across(&unit) * sigma_rad.powi(2),
        }
    }

    /// The same direction with an additional error of 1 sigma per axis.
    pub fn loosened(&self, sigma_rad: f64) -> Self {
        Self {
            covariance_rad2: self.covariance_rad2 + Self::new(self.unit, sigma_rad).covariance_rad2,
            ..*self
        }
    }

    /// The same direction in another frame.
    pub fn turned(&self, rotation: &Rotation3<f64>) -> Self {
        Self {
            unit: rotation * self.unit,
            covariance_rad2: rotation * self.covariance_rad2 * rotation.inverse(),
        }
    }

    /// 1 sigma along the axis in which it is largest, rad.
    pub fn sigma_rad(&self) -> f64 {
        self.covariance_rad2
            .symmetric_eigenvalues()
            .max()
            .max(0.0)
            .sqrt()
    }
}

/// One direction, measured in the body frame and known in the reference frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    pub body: Direction,
    pub reference: Direction,
}

impl Observation {
    /// Covariance of the body's direction minus the reference's, transformed to the body frame.
    fn covariance_rad2(&self, rotation: &Rotation3<f64>) -> Matrix3<f64> {
        let reference = rotation * self.reference.covariance_rad2 * rotation.inverse();
        self.body.covariance_rad2 + reference
    }

    /// Inverse of the mean variance per axis, which is invariant under rotation.
    fn weight(&self) -> f64 {
        2.0 / (self.body.covariance_rad2 + self.reference.covariance_rad2).trace()
    }
}

/// The rotation from a reference frame to a body frame, with the covariance of its error about the body's axes, rad^2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    pub rotation: UnitQuaternion<f64>,
    pub covariance_rad2: Matrix3<f64>,
}

impl Attitude {
    /// A direction of the reference frame, transformed to the body frame. The errors of both are assumed independent.
    pub fn rotate(&self, reference: &Direction) -> Direction {
        let rotation = self.rotation.to_rotation_matrix();
        let unit = rotation * reference.unit;
        let cross = unit.cross_matrix();
        Direction {
            unit,
            covariance_rad2: rotation * reference.covariance_rad2 * rotation.inverse()
                + cross * self.covariance_rad2 * cross.transpose(),
        }
    }

    /// The rotation from the body frame to the reference frame; its covariance is about the axes of the latter.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse().to_rotation_matrix();
        Self {
            rotation: self.rotation.inverse(),
            covariance_rad2: rotation * self.covariance_rad2 * rotation.inverse(),
        }
    }
}

/// The attitude from two directions by TRIAD (Shuster and Oh 1981, "Three-Axis Attitude Determination from Vector Observations"): the
/// first is reproduced exactly, the second gives the rotation about it. `None` if the two are parallel in either frame.
pub fn triad(first: &Observation, second: &Observation) -> Option<Attitude> {
    let frame = |first: &Direction, second: &Direction| {
        let (a, b) = (first.unit.into_inner(), second.unit.into_inner());
        let normal = a.cross(&b).try_normalize(LEAST_SIN_ANGLE)?;
        let columns = Matrix3::from_columns(&[a, normal, a.cross(&normal)]);
        Some(Rotation3::from_matrix_unchecked(columns))
    };
    let body = frame(&first.body, &second.body)?;
    let rotation = body * frame(&first.reference, &second.reference)?.inverse();
    let (a, b) = (&first.body.unit, &second.body.unit);
    let (normal, sin) = UnitVector3::new_and_get(a.cross(b));
    // delta = a x e1 + a n . (e2 - (a x e1) x b) / sin, where e1 and e2 are the errors of the two directions.
    let about_a = a.into_inner() * normal.transpose() / sin;
    let by_first = (Matrix3::identity() + about_a * b.cross_matrix()) * a.cross_matrix();
    let part = |by: Matrix3<f64>, observation: &Observation| {
        by * observation.covariance_rad2(&rotation) * by.transpose()
    };
    Some(Attitude {
        rotation: UnitQuaternion::from_rotation_matrix(&rotation),
        covariance_rad2: part(by_first, first) + part(about_a, second),
    })
}

/// The attitude from two or more directions that minimises the sum of w |b - R r|^2 (Wahba 1965), by Davenport's q method
/// (Shuster and Oh 1981, "The QUEST Algorithm"). The weight w is the inverse of a direction's mean variance per axis.
///
/// The covariance is propagated from each direction's own, so it is also valid for anisotropic errors; for isotropic ones it is that of
/// QUEST, (sum of w (1 - b b^T))^-1. `None` if all directions are parallel, or one has no error.
pub fn attitude(observations: &[Observation]) -> Option<Attitude> {
    let mut profile = Matrix3::zeros();
    for observation in observations {
        let (body, reference) = (&observation.body.unit, &observation.reference.unit);
        profile += body.into_inner() * reference.transpose() * observation.weight();
    }
    let rotation = davenport(&profile)?;
    let matrix = rotation.to_rotation_matrix();
    let (mut information, mut scatter) = (Matrix3::zeros(), Matrix3::zeros());
    for observation in observations {
        let (unit, weight) = (&observation.body.unit, observation.weight());
        let cross = unit.cross_matrix() * weight;
        information += across(unit) * weight;
        scatter += cross * observation.covariance_rad2(&matrix) * cross.transpose();
    }
    let eigenvalues = information.symmetric_eigenvalues();
    let determined = eigenvalues.min() > LEAST_SIN_ANGLE.powi(2) * eigenvalues.max();
    let inverse = information.try_inverse().filter(|_| determined)?;
    Some(Attitude {
        rotation,
        covariance_rad2: inverse * scatter * inverse,
    })
}

/// Sine of the least angle between directions that determine an attitude.
const LEAST_SIN_ANGLE: f64 = 1e-6;

/// The rotation R that maximises trace (R^T profile): the eigenvector of the largest eigenvalue of Davenport's matrix.
fn davenport(profile: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let b = profile;
    let twice_skew = Vector3::new(
        b.m32 - b.m23, //
        b.m13 - b.m31,
        b.m21 - b.m12,
    );
    let mut k = Matrix4::zeros();
    k[(3, 3)] = b.trace();
    let symmetric = b + b.transpose() - Matrix3::identity() * b.trace();
    k.fixed_view_mut::<3, 3>(0, 0).copy_from(&symmetric);
    k.fixed_view_mut::<3, 1>(0, 3).copy_from(&twice_skew);
    k.fixed_view_mut::<1, 3>(3, 0)
        .copy_from(&twice_skew.transpose());
    if k.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let eigen = k.symmetric_eigen();
    let best: Vector4<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into();
    Some(UnitQuaternion::from_quaternion(Quaternion::from(best)))
}

/// Projection of vectors onto the plane perpendicular to a direction.
fn across(unit: &UnitVector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - unit.into_inner() * unit.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_xoshiro::Xoshiro256PlusPlus;

    const TRIALS: usize = 4000;

    fn truth() -> UnitQuaternion<f64> {
        UnitQuaternion::from_euler_angles(0.4, -1.1, 2.3)
    }

    fn unit(x: f64, y: f64, z: f64) -> UnitVector3<f64> {
        UnitVector3::new_normalize(Vector3::new(x, y, z))
    }

    /// A direction with different errors along two axes across it.
    fn uneven(unit: UnitVector3<f64>, sigmas_rad: [f64; 2]) -> Direction {
        let first = unit.cross(&Vector3::new(0.3, 0.5, -0.2)).normalize();
        let second = unit.cross(&first);
        let part = |v: Vector3<f64>, sigma: f64| v * v.transpose() * sigma * sigma;
        Direction {
            unit,
            covariance_rad2: part(first, sigmas_rad[0]) + part(second, sigmas_rad[1]),
        }
    }

    /// Error-free observations with their covariances.
    fn observations() -> [Observation; 3] {
        [
            (unit(1.0, 0.2, -0.1), [2e-4, 2e-4], [1e-4, 5e-5]),
            (unit(0.5, 0.8, 0.3), [1e-3, 3e-4], [1e-5, 1e-5]),
            (unit(-0.2, 0.1, 0.9), [5e-4, 2e-4], [1e-4, 4e-4]),
        ]
        .map(|(reference, of_body, of_reference)| Observation {
            body: uneven(truth() * reference, of_body),
            reference: uneven(reference, of_reference),
        })
    }

    struct Noise(Xoshiro256PlusPlus);

    impl Noise {
        fn new() -> Self {
            Self(Xoshiro256PlusPlus::seed_from_u64(7))
        }

        /// A random vector with a covariance, which may be of lower rank.
        fn vector(&mut self, covariance: &Matrix3<f64>) -> Vector3<f64> {
            let eigen = covariance.symmetric_eigen();
            let sigmas = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
            let white = Vector3::from_fn(|_, _| self.0.sample::<f64, _>(StandardNormal));
            eigen.eigenvectors * white.component_mul(&sigmas)
        }

        fn direction(&mut self, true_one: &Direction) -> Direction {
            let error = self.vector(&true_one.covariance_rad2);
            Direction {
                unit: UnitVector3::new_normalize(true_one.unit.into_inner() + error),
                ..*true_one
            }
        }

        fn observation(&mut self, true_one: &Observation) -> Observation {
            Observation {
                body: self.direction(&true_one.body),
                reference: self.direction(&true_one.reference),
            }
        }
    }

    /// Checks the root mean square of error over sigma, along each principal axis of the stated covariance.
    fn assert_honest(errors: impl Iterator<Item = Vector3<f64>>, covariance: &Matrix3<f64>) {
        let eigen = covariance.symmetric_eigen();
        let (mut squares, mut count) = (Vector3::zeros(), 0.0);
        for error in errors {
            let along = eigen.eigenvectors.tr_mul(&error);
            squares += along.component_mul(&along);
            count += 1.0;
        }
        for n in 0..3 {
            // A covariance across a direction has one axis without an error.
            if eigen.eigenvalues[n] < 1e-6 * eigen.eigenvalues.max() {
                assert!(squares[n] / count < 1e-5 * eigen.eigenvalues.max());
                continue;
            }
            let ratio = (squares[n] / count / eigen.eigenvalues[n]).sqrt();
            assert!((0.95..1.05).contains(&ratio), "axis {n}: {ratio}");
        }
    }

    fn error(found: &Attitude) -> Vector3<f64> {
        (found.rotation * truth().inverse()).scaled_axis()
    }

    #[test]
    fn known_rotations_are_found() {
        let [a, b, c] = observations();
        let turn = Vector3::z_axis();
        let quarter = UnitQuaternion::from_axis_angle(&turn, std::f64::consts::FRAC_PI_2);
        let pair = |reference: UnitVector3<f64>, body: UnitVector3<f64>| Observation {
            body: Direction::new(body, 1e-3),
            reference: Direction::new(reference, 0.0),
        };
        let axes = [
            pair(Vector3::x_axis(), Vector3::y_axis()),
            pair(Vector3::z_axis(), Vector3::z_axis()),
        ];
        for (found, true_one) in [
            (triad(&a, &b), truth()),
            (attitude(&[a, b]), truth()),
            (attitude(&[a, b, c]), truth()),
            (triad(&axes[0], &axes[1]), quarter),
            (attitude(&axes), quarter),
        ] {
            assert!(found.unwrap().rotation.angle_to(&true_one) < 1e-7);
        }
    }

    #[test]
    fn parallel_directions_determine_nothing() {
        let [a, ..] = observations();
        assert_eq!(triad(&a, &a), None);
        assert_eq!(attitude(&[a, a]), None);
        assert_eq!(attitude(&[a]), None);
        assert_eq!(attitude(&[]), None);
    }

    #[test]
    fn the_covariance_of_triad_is_that_of_its_errors() {
        let [a, b, _] = observations();
        let stated = triad(&a, &b).unwrap().covariance_rad2;
        let mut noise = Noise::new();
        let errors = (0..TRIALS).map(|_| {
            let (a, b) = (noise.observation(&a), noise.observation(&b));
            error(&triad(&a, &b).unwrap())
        });
        assert_honest(errors, &stated);
    }

    #[test]
    fn the_covariance_of_triad_is_that_of_shuster_and_oh() {
        let of = |reference: UnitVector3<f64>, sigma: f64| Observation {
            body: Direction::new(truth() * reference, sigma),
            reference: Direction::new(reference, 0.0),
        };
        let (s1, s2) = (2e-4, 7e-4);
        let (first, second) = (of(unit(1.0, 0.2, -0.1), s1), of(unit(0.5, 0.8, 0.3), s2));
        let (w1, w2) = (first.body.unit.into_inner(), second.body.unit.into_inner());
        let (v1, v2) = (s1 * s1, s2 * s2);
        let common = w1 * w2.transpose() + w2 * w1.transpose();
        let tied = common * (v1 * w1.dot(&w2)) + w1 * w1.transpose() * (v2 - v1);
        let expected = Matrix3::identity() * v1 + tied / w1.cross(&w2).norm_squared();
        let found = triad(&first, &second).unwrap().covariance_rad2;
        assert!((found - expected).norm() < 1e-12 * expected.norm());
        let quest = attitude(&[first, second]).unwrap().covariance_rad2;
        let information = across(&first.body.unit) / v1 + across(&second.body.unit) / v2;
        assert!((quest * information - Matrix3::identity()).norm() < 1e-9);
    }

    #[test]
    fn the_covariance_of_the_weighted_attitude_is_that_of_its_errors() {
        let observations = observations();
        let stated = attitude(&observations).unwrap().covariance_rad2;
        let mut noise = Noise::new();
        let errors = (0..TRIALS).map(|_| {
            let noisy = observations.map(|one| noise.observation(&one));
            error(&attitude(&noisy).unwrap())
        });
        assert_honest(errors, &stated);
    }

    #[test]
    fn a_rotated_direction_has_the_errors_of_direction_and_rotation() {
        let [a, b, c] = observations();
        let attitude = attitude(&[a, b, c]).unwrap();
        let direction = uneven(unit(0.3, -0.9, 0.2), [3e-4, 1e-4]);
        for attitude in [attitude, attitude.inverse()] {
            let stated = attitude.rotate(&direction);
            let mut noise = Noise::new();
            let errors = (0..TRIALS).map(|_| {
                let delta = noise.vector(&attitude.covariance_rad2);
                let rotation = UnitQuaternion::from_scaled_axis(delta) * attitude.rotation;
                let found = rotation * noise.direction(&direction).unit;
                found.into_inner() - stated.unit.into_inner()
            });
            assert_honest(errors, &stated.covariance_rad2);
        }
    }

    #[test]
    fn the_inverse_of_an_attitude_has_its_errors() {
        let observations = observations();
        let inverse = attitude(&observations).unwrap().inverse();
        let mut noise = Noise::new();
        let errors = (0..TRIALS).map(|_| {
            let noisy = observations.map(|one| noise.observation(&one));
            let found = attitude(&noisy).unwrap().inverse();
            (found.rotation * truth()).scaled_axis()
        });
        assert_honest(errors, &inverse.covariance_rad2);
    }
}
