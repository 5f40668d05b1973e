//! Checks whether lens, plate and camera fit each other, so that frames can be solved at all.

use super::Instrument;
use crate::units::{Measured, counted};
use nalgebra::Vector2;

/// The Sun's radius at 1 AU.
pub const MEAN_SUN_ARCSEC: f64 = 959.63;
/// Range of the Sun's radius as seen from the Earth.
pub const SMALLEST_SUN_ARCSEC: f64 = 943.0;
const LARGEST_SUN_ARCSEC: f64 = 977.0;
/// Range of the disc's radius for which the solver is tested, px.
const RADII_PX: std::ops::RangeInclusive<f64> = 15.0..=1000.0;

/// Why no frame of an instrument can be solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LensMisfit {
    #[error(
        "a disc of {diameter_mil:.0} mil before marks of {size_mil:.0} mil: {} fully lit wherever the Sun stands, so no frame can be read; a longer focal length, or a plate for this one",
        counted(*.most as u64, "mark")
    )]
    FewMarks {
        most: usize,
        diameter_mil: f64,
        size_mil: f64,
    },
    #[error(
        "a disc of {diameter_px:.0} px before a sensor of {width_px} x {height_px} px: no frame shows its limb, so none can be read"
    )]
    NoLimb {
        diameter_px: f64,
        width_px: usize,
        height_px: usize,
    },
    #[error("a disc of {radius_px:.1} px radius at the stated scale, so no frame can be read")]
    Size { radius_px: f64 },
}

impl LensMisfit {
    /// A change that would make it fit.
    pub fn expected(&self, least_marks: usize) -> String {
        match self {
            Self::FewMarks { .. } => {
                format!("a lens before which {least_marks} marks are lit at once")
            }
            Self::NoLimb { .. } => "a lens whose disc the sensor holds".into(),
            Self::Size { .. } => {
                let (least, most) = (RADII_PX.start(), RADII_PX.end());
                format!("a lens and a scale that give a disc of {least} to {most} px radius")
            }
        }
    }
}

impl Instrument {
    /// The instrument with another lens that magnifies by the given factor; the plate and the camera's view of it are
    /// scaled as well.
    #[must_use]
    pub fn scaled(mut self, by: f64) -> Self {
        let times = |value: Measured| Measured::new(value.value * by, value.sigma * by);
        let optics = &mut self.optics;
        optics.focal_length_mm = times(optics.focal_length_mm);
        optics.plate_distance_mm = times(optics.plate_distance_mm);
        let mounting = &mut self.mounting;
        mounting.scale_mil_per_px = times(mounting.scale_mil_per_px);
        mounting.boresight_mil = (mounting.boresight_mil.vector() * by).into();
        mounting.boresight_sigma_mil *= by;
        self.plate = self.plate.scaled(by);
        self
    }

    /// The instrument with its camera moved back if necessary to see the whole Sun at any position within `field_mil` of
    /// the plate's centre, which may be 3 sigma from its stated position on the sensor.
    #[must_use]
    pub fn seeing(mut self, field_mil: f64) -> Self {
        let mounting = &mut self.mounting;
        let centre = mounting.plate_centre_px;
        let [width, height] = self.camera.size_px().map(|side| side as f64 - 1.0);
        let to_edge = [centre.x, width - centre.x, centre.y, height - centre.y];
        let reach_px = to_edge.into_iter().fold(f64::INFINITY, f64::min)
            - 3.0 * mounting.plate_centre_sigma_px;
        let scale = mounting.scale_mil_per_px;
        let least = (field_mil + self.optics.radius_mil(LARGEST_SUN_ARCSEC)) / reach_px;
        if reach_px > 0.0 && least > scale.value {
            mounting.scale_mil_per_px = Measured::new(least, scale.sigma * least / scale.value);
        }
        self
    }

    /// Whether a frame can be solved somewhere on the plate, given the required number of marks.
    ///
    /// # Errors
    /// The reason why no frame can be solved.
    pub fn check_lens(&self, least_marks: usize) -> Result<(), LensMisfit> {
        let radius_px = self.radius_px(LARGEST_SUN_ARCSEC);
        if !RADII_PX.contains(&radius_px) {
            return Err(LensMisfit::Size { radius_px });
        }
        let [width_px, height_px] = self.camera.size_px();
        let diagonal_px = (width_px as f64).hypot(height_px as f64);
        if 2.0 * radius_px > diagonal_px {
            return Err(LensMisfit::NoLimb {
                diameter_px: 2.0 * radius_px,
                width_px,
                height_px,
            });
        }
        let (size_mil, sun_mil) = (
            self.plate.shape.size_mil(),
            self.optics.radius_mil(LARGEST_SUN_ARCSEC),
        );
        let marks: Vec<Vector2<f64>> = self.plate.marks().map(|(_, at)| at.vector()).collect();
        let most = most_within(&marks, sun_mil - size_mil / 2.0, least_marks);
        if most < least_marks {
            let diameter_mil = 2.0 * sun_mil;
            return Err(LensMisfit::FewMarks {
                most,
                diameter_mil,
                size_mil,
            });
        }
        Ok(())
    }
}

/// The largest number of positions within a disc, but at most `enough`: in a disc with the largest number, two of them can
/// be on the edge.
fn most_within(places: &[Vector2<f64>], radius: f64, enough: usize) -> usize {
    let mut most = usize::from(radius > 0.0 && !places.is_empty());
    for (n, a) in places.iter().enumerate() {
        let near: Vec<&Vector2<f64>> = places
            .iter()
            .filter(|b| (*b - a).norm() < 2.0 * radius)
            .collect();
        for b in places[n + 1..]
            .iter()
            .filter(|b| (*b - a).norm() < 2.0 * radius)
        {
            let half = (b - a) / 2.0;
            let across = Vector2::new(-half.y, half.x).normalize();
            let height = (radius.powi(2) - half.norm_squared()).max(0.0).sqrt();
            for centre in [a + half + across * height, a + half - across * height] {
                // Positions on the edge count as inside.
                let within = |p: &&&Vector2<f64>| (**p - centre).norm() < radius * (1.0 + 1e-9);
                most = most.max(near.iter().filter(within).count());
                if most >= enough {
                    return most;
                }
            }
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;

    #[test]
    fn a_short_lens_before_the_plate_of_2013_reads_nothing() {
        let mut instrument = builtin("demo").unwrap();
        assert_eq!(instrument.check_lens(3), Ok(()));
        instrument.optics.plate_distance_mm.value = 1000.0;
        let misfit = instrument.check_lens(3).unwrap_err();
        let LensMisfit::FewMarks { most, .. } = misfit else {
            panic!("{misfit}");
        };
        assert!(most < 3, "{misfit}");
        let text = misfit.to_string();
        assert!(text.contains("no frame can be read"), "{text}");
        instrument.optics.plate_distance_mm.value = 300.0;
        let misfit = instrument.check_lens(3).unwrap_err();
        assert!(matches!(misfit, LensMisfit::Size { .. }), "{misfit}");
    }

    #[test]
    fn a_disc_holds_as_many_places_as_the_best_one_does() {
        let places = [[0.0, 0.0], [2.0, 0.0], [1.0, 1.5], [9.0, 0.0]].map(Vector2::from);
        assert_eq!(most_within(&places, 1.2, 9), 3);
        assert_eq!(most_within(&places, 1.0, 9), 2);
        assert_eq!(most_within(&places, 0.5, 9), 1);
    }
}
