//! The telescope's attitude: its Sun determines two axes, its roll the third.

use super::alignment::{Alignment, Roll};
use super::{PointingError, sun_direction};
use crate::instrument::Instrument;
use crate::sky::SunPosition;
use crate::sky::sphere::tangents;
use crate::units::{ARCSEC_PER_RAD, Estimate, PlateMil};
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};

/// The telescope's attitude. Its own axes are forward, right and down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TelescopeAttitude {
    /// Rotation from the telescope's axes to north, east and down.
    pub turn: Rotation3<f64>,
    /// Uncertainty from the frame, rad^2, for small rotations that move the boresight to the telescope's right, up, and about it (right
    /// side low positive).
    pub random_rad2: Matrix3<f64>,
    /// Uncertainty from the calibration, as in [`Offset`](super::Offset), without UT1, which moves Sun and telescope together.
    pub systematic_rad2: Matrix3<f64>,
}

/// The attitude of a telescope from the Sun's position on its plate.
///
/// # Errors
/// [`PointingError::NoBoresight`] if no pointing near the zenith gives this position of the Sun.
pub fn telescope_attitude(
    sun_on_plate: &Estimate<PlateMil>,
    roll: Roll,
    instrument: &Instrument,
    sun: &SunPosition,
) -> Result<TelescopeAttitude, PointingError> {
    let (alignment, centre) = (Alignment::new(instrument, roll), sun_direction(sun));
    let boresight = alignment.boresight(&alignment.on_plane(sun_on_plate.position), &centre)?;
    let telescope = alignment.telescope(&boresight, &centre);
    let errors = Errors::new(sun_on_plate, roll, instrument, sun)?;
    // Convert from across, up and about to right, up and about.
    let (up, across) = tangents(&boresight);
    let (right, own_up) = (telescope.column(1), telescope.column(2));
    #[rustfmt::skip]
    let turn = Matrix3::new(
        right.dot(&across), right.dot(&up), 0.0,
        own_up.dot(&across), own_up.dot(&up), 0.0,
        0.0, 0.0, 1.0,
    );
    // Convert north, east, up to north, east, down; and the telescope's up to its down.
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    Ok(TelescopeAttitude {
        turn: Rotation3::from_matrix_unchecked(flip * telescope * flip),
        random_rad2: turn * errors.frame_rad2 * turn.transpose(),
        systematic_rad2: turn * errors.calibration_rad2 * turn.transpose(),
    })
}

/// Uncertainty from the calibration of a telescope whose roll is measured by other sensors, rad^2, as in
/// [`TelescopeAttitude::systematic_rad2`]: `towards` is the Sun in the telescope's axes, forward, right and down.
pub fn calibration_rad2(towards: &Vector3<f64>, instrument: &Instrument) -> Matrix3<f64> {
    let shift = Vector2::new(towards.y, -towards.z) / towards.x;
    let (mounting, optics) = (&instrument.mounting, &instrument.optics);
    let distance = optics.plate_distance_mm;
    let boresight_rad = mounting.boresight_sigma_mil * optics.arcsec_per_mil() / ARCSEC_PER_RAD;
    let turned = Vector2::new(shift.y, -shift.x) * mounting.clocking_deg.sigma.to_radians();
    let stretched = shift * (distance.sigma / distance.value);
    let covariance = Matrix2::identity() * boresight_rad.powi(2)
        + turned * turned.transpose()
        + stretched * stretched.transpose();
    covariance.fixed_resize(0.0)
}

/// Uncertainty of the attitude, rad^2, for small rotations that move the boresight to larger azimuth, up, and about it.
pub(super) struct Errors {
    pub frame_rad2: Matrix3<f64>,
    pub calibration_rad2: Matrix3<f64>,
    /// Uncertainty from UT1, which moves the Sun: across and up.
    pub ut1_rad2: Matrix2<f64>,
}

impl Errors {
    pub fn new(
        sun_on_plate: &Estimate<PlateMil>,
        roll: Roll,
        instrument: &Instrument,
        sun: &SunPosition,
    ) -> Result<Self, PointingError> {
        let (alignment, centre) = (Alignment::new(instrument, roll), sun_direction(sun));
        let on_plane = alignment.on_plane(sun_on_plate.position);
        let boresight = alignment.boresight(&on_plane, &centre)?;
        let [by_plane, by_sun] = alignment.derivatives(&on_plane, &centre)?;
        let (up, across) = tangents(&boresight);
        let about = |moved: Vector2<f64>, turned_rad: f64| {
            let towards = across * moved.x + up * moved.y;
            let with_it = alignment.turned_about(&boresight, &towards, &centre);
            Vector3::new(moved.x, moved.y, turned_rad + with_it)
        };
        let by_plate = by_plane * alignment.to_plane();
        let by_plate = nalgebra::Matrix3x2::from_columns(&[
            about(by_plate.column(0).into(), 0.0),
            about(by_plate.column(1).into(), 0.0),
        ]);
        let by_turn = by_plane * Vector2::new(on_plane.y, -on_plane.x);
        let mounting = &instrument.mounting;
        let distance = instrument.optics.plate_distance_mm;
        let [across_arcsec, up_arcsec] = sun.ut1_shift_arcsec;
        let roll_sigma_deg = roll.about_boresight_deg(instrument).sigma;
        let plate_turned_rad = alignment.roll_sigma_deg.to_radians();
        let by_roll = squared(about(
            -by_turn * plate_turned_rad,
            roll_sigma_deg.to_radians(),
        ));
        let frame = by_plate * sun_on_plate.covariance * by_plate.transpose();
        let calibration = by_plate * by_plate.transpose() * mounting.boresight_sigma_mil.powi(2)
            + squared(about(
                by_turn * mounting.clocking_deg.sigma.to_radians(),
                0.0,
            ))
            + squared(about(
                by_plane * on_plane * (distance.sigma / distance.value),
                0.0,
            ));
        let ut1 = by_sun * Vector2::new(up_arcsec, across_arcsec) / ARCSEC_PER_RAD;
        let (frame_rad2, calibration_rad2) = match roll {
            Roll::Stated => (frame, calibration + by_roll),
            Roll::Measured(_) => (frame + by_roll, calibration),
        };
        Ok(Self {
            frame_rad2,
            calibration_rad2,
            ut1_rad2: ut1 * ut1.transpose(),
        })
    }
}

/// The part for the boresight's two axes.
pub(super) fn across_and_up(covariance: &Matrix3<f64>) -> Matrix2<f64> {
    covariance.fixed_view::<2, 2>(0, 0).into_owned()
}

/// The covariance of one fully correlated error.
fn squared(error: Vector3<f64>) -> Matrix3<f64> {
    error * error.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::{Directions, builtin};
    use crate::simulate::FORT_SUMNER;
    use crate::sky::Ephemeris;
    use crate::units::Measured;

    const AT: PlateMil = PlateMil {
        x: 700.0,
        y: -400.0,
    };

    fn sun() -> SunPosition {
        let utc = "2013-09-21T18:00:00Z".parse().unwrap();
        Ephemeris::default().sun(utc, FORT_SUMNER).unwrap()
    }

    fn exact(position: PlateMil) -> Estimate<PlateMil> {
        let covariance = Matrix2::zeros();
        Estimate {
            position,
            covariance,
        }
    }

    /// The rotation from one attitude to another: to the right, up and about the boresight.
    fn moved(from: &TelescopeAttitude, to: &TelescopeAttitude) -> Vector3<f64> {
        let turn = (from.turn.inverse() * to.turn).scaled_axis();
        Vector3::new(turn.z, turn.y, turn.x)
    }

    #[test]
    fn each_error_turns_the_telescope_as_its_covariance_says() {
        let mut instrument = builtin("demo").unwrap();
        for directions in [Directions::Telescope, Directions::Sun2013] {
            instrument.mounting.directions = directions;
            instrument.mounting.boresight_sigma_mil = 0.0;
            instrument.mounting.clocking_deg.sigma = 0.0;
            instrument.optics.plate_distance_mm.sigma = 0.0;
            let roll = |deg: f64, sigma: f64| Roll::Measured(Measured::new(deg, sigma));
            let attitude = |sun_on_plate: &Estimate<PlateMil>, roll: Roll| {
                telescope_attitude(sun_on_plate, roll, &instrument, &sun()).unwrap()
            };
            let still = attitude(&exact(AT), roll(2.0, 0.0));
            let close = |covariance: &Matrix3<f64>, error: &Vector3<f64>| {
                let expected = error * error.transpose();
                let off = (covariance - expected).norm() / expected.norm();
                assert!(off < 1e-3, "{directions:?}: {covariance} {expected}");
            };
            for step in [Vector2::new(0.1, 0.0), Vector2::new(0.0, 0.1)] {
                let moved_sun = exact((AT.vector() + step).into());
                let error = moved(&still, &attitude(&moved_sun, roll(2.0, 0.0)));
                let stated = Estimate {
                    position: AT,
                    covariance: step * step.transpose(),
                };
                close(&attitude(&stated, roll(2.0, 0.0)).random_rad2, &error);
            }
            if directions == Directions::Telescope {
                let error = moved(&still, &attitude(&exact(AT), roll(2.01, 0.0)));
                close(&attitude(&exact(AT), roll(2.0, 0.01)).random_rad2, &error);
            }
        }
    }

    #[test]
    fn the_calibration_moves_a_telescope_of_known_roll_as_one_of_stated_roll() {
        let mut instrument = builtin("demo").unwrap();
        instrument.mounting.roll_deg = Measured::new(0.0, 0.0);
        let with_roll = telescope_attitude(&exact(AT), Roll::Stated, &instrument, &sun()).unwrap();
        let towards = crate::pointing::sun_in_telescope(AT, &instrument);
        let alone = calibration_rad2(&towards, &instrument);
        let boresight = |of: &Matrix3<f64>| across_and_up(of);
        let off = boresight(&with_roll.systematic_rad2) - boresight(&alone);
        // With the vertical as reference the roll rotates with the azimuth; the Sun is a hundredth of the plate's distance off the boresight.
        assert!(off.norm() < 0.03 * alone.norm(), "{off}");
    }
}
