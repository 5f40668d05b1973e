//! Detections as expected in flight: some marks are missed and some detections are false, with the probabilities that the
//! flight software assumes.

use super::scene::{CONTRAST, CheckScene, Seen};
use crate::aspect::missed_share;
use crate::fiducial::Detection;
use crate::fiducial::shares::{
    ATYPICAL_SHARE, CONTRAST_RANGE, CONTRAST_SCATTER, CUT_FOUND_SHARE, FALSE_ON_DISC,
    LEAST_CONTRAST, MARK_LIKE_SHARE,
};
use crate::geometry::unit;
use crate::units::SensorPx;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Poisson, StandardNormal};
use std::f64::consts::TAU;

/// Detections among clutter: marks are missed, and false detections lie anywhere on the disc.
pub(super) fn among_clutter(scene: &CheckScene, rng: &mut impl Rng) -> Seen {
    let all = scene.all_found(rng);
    let missed = missed_share(&all.detections);
    let mut seen = Seen::new(scene);
    for mark in &scene.marks {
        let found = match mark.is_sure {
            true => 1.0 - missed,
            false => CUT_FOUND_SHARE,
        };
        if rng.random_bool(found) {
            let detection = Detection {
                contrast: contrast(1.0 - ATYPICAL_SHARE, rng),
                ..scene.detection(mark, rng)
            };
            seen.push(Some(mark.id), detection);
        }
    }
    // The mean is positive, so the distribution exists.
    let count = Poisson::new(FALSE_ON_DISC).map_or(0.0, |count| count.sample(rng));
    for _ in 0..count as usize {
        let radius = scene.radius_px() * rng.random_range(0.0_f64..1.0).sqrt();
        let at = scene.outline.centre + unit(rng.random_range(0.0..TAU)) * radius;
        let at = SensorPx::from(at);
        let detection = Detection {
            at,
            sigma_px: scene.view.sigma_px,
            contrast: contrast(MARK_LIKE_SHARE, rng),
            likeness: 1.0,
            lighting: scene.lighting(at),
        };
        if is_apart(&seen, at, scene) {
            seen.push(None, detection);
        }
    }
    seen
}

/// The contrast of this print with the probability `share_of_print`, otherwise any contrast.
fn contrast(share_of_print: f64, rng: &mut impl Rng) -> f64 {
    match rng.random_bool(share_of_print) {
        true => CONTRAST * (CONTRAST_SCATTER * rng.sample::<f64, _>(StandardNormal)).exp(),
        false => LEAST_CONTRAST * (CONTRAST_RANGE * rng.random_range(0.0..1.0)).exp(),
    }
}

/// Whether a detection is farther from the others than a mark's length; of nearer ones the flight software keeps one.
fn is_apart(seen: &Seen, at: SensorPx, scene: &CheckScene) -> bool {
    let apart_px = 2.0 * scene.view.image.half_length_px;
    let mut others = seen.detections.marks.iter();
    others.all(|other| other.at.distance(at) > apart_px)
}

#[cfg(test)]
mod tests {
    use super::super::scene::PlateView;
    use super::*;
    use crate::aspect::SolverSettings;
    use crate::instrument::builtin;
    use crate::units::PlateMil;
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    #[test]
    fn marks_are_missed_and_detections_false_as_often_as_the_flight_expects() {
        let (demo, solver) = (builtin("demo").unwrap(), SolverSettings::default());
        let view = PlateView::new(&demo, &solver, 5.0 / 205.0).unwrap();
        let scene = CheckScene::new(&view, PlateMil::new(300.0, 200.0), &view.stated);
        let [sure, cut] = [true, false].map(|is_sure| {
            let marks = scene.marks.iter();
            marks.filter(|mark| mark.is_sure == is_sure).count() as f64
        });
        assert!(sure > 3.0 && cut > 0.0);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let (mut found, mut false_ones) = (0, 0);
        for _ in 0..1000 {
            let seen = among_clutter(&scene, &mut rng);
            found += seen.ids.iter().flatten().count();
            false_ones += seen.ids.iter().filter(|id| id.is_none()).count();
        }
        // Some fall on marks, where the flight software keeps one of the two.
        assert!((600..1000).contains(&false_ones), "{false_ones}");
        let found = found as f64 / 1000.0;
        assert!(
            (found - (sure + cut / 2.0)).abs() < 0.1 * sure,
            "{found} of {sure} + {cut}"
        );
    }
}
