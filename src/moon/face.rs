//! The distribution of brightness over a disc and the sky around it.

use super::candidate::View;
use super::sector::{Parameters, circle_of};
use super::shading::{Shading, Sphere};
use crate::units::Measured;
use nalgebra::Vector2;
use std::f64::consts::PI;

/// Outer radius of the sky that is included, in radii.
const AROUND: f64 = 1.25;
/// Half width of the excluded blurred edge, px.
const EDGE_PX: f64 = 1.5;
/// Approximate number of sampled pixels.
const SAMPLED_PX: f64 = 400.0;
/// Spacing of the phases that are tried, deg.
const PHASE_STEP_DEG: usize = 10;
const HALVINGS: usize = 3;
/// 1 sigma of the phase from the limb, rad.
const BY_LIMB_RAD: f64 = 0.8;
/// Maximum earthshine relative to the light of the brightest limb.
const MOST_EARTHSHINE: f64 = 0.2;
/// Number of independent errors of the brightness: bright and dark ground forms about so many pieces on a disc.
const PIECES: f64 = 12.0;

/// A pixel on the disc.
struct Place {
    /// Distance from the centre towards the bright limb, in radii.
    along: f64,
    /// Cosine of the angle between the ground's normal and the observer.
    to_observer: f64,
    /// Brightness above the mean of disc and sky.
    dn: f64,
}

/// The distribution of brightness over a disc and the sky around it.
pub(super) struct Face {
    shading: Shading,
    disc: Vec<Place>,
    /// Number of pixels, including the sky.
    count: f64,
    /// Sum of the squares of their deviations from the mean, DN^2.
    squares: f64,
    /// Expected contribution of the noise to that sum.
    noise: f64,
    /// Share of the disc that is saturated and not used.
    pub saturated: f64,
}

impl Face {
    /// Samples a disc with the given parameters.
    pub fn seen(view: &View, at: &Parameters) -> Self {
        let circle = circle_of(at);
        let bright_limb = Vector2::new(at[5].cos(), at[5].sin());
        let reach = (AROUND * circle.radius).max(1.0);
        let step = (2.0 * reach / SAMPLED_PX.sqrt()).ceil() as usize;
        let (mut disc, mut sky_dn, mut saturated) = (Vec::new(), Vec::new(), 0);
        let depths = circle.radius - reach..circle.radius;
        (view.plane).each_near(view.frame, &circle, &depths, step, |place, dn| {
            let (away, dn) = (place - circle.centre, f64::from(dn));
            let distance = away.norm();
            let is_disc = distance < circle.radius;
            if (distance - circle.radius).abs() < EDGE_PX {
                return;
            }
            if dn >= view.levels.saturated_dn {
                saturated += usize::from(is_disc);
            } else if is_disc {
                disc.push(Place {
                    along: away.dot(&bright_limb) / circle.radius,
                    to_observer: (1.0 - (distance / circle.radius).powi(2)).sqrt(),
                    dn,
                });
            } else {
                sky_dn.push(dn);
            }
        });
        let on_disc = disc.len() + saturated;
        let all_dn = || {
            disc.iter()
                .map(|place| place.dn)
                .chain(sky_dn.iter().copied())
        };
        let count = (disc.len() + sky_dn.len()) as f64;
        let mean_dn = all_dn().sum::<f64>() / count.max(1.0);
        let squares = all_dn().map(|dn| (dn - mean_dn).powi(2)).sum();
        disc.iter_mut().for_each(|place| place.dn -= mean_dn);
        Self {
            shading: view.shading,
            disc,
            count,
            squares,
            noise: count * view.levels.noise_dn.powi(2),
            saturated: saturated as f64 / on_disc.max(1) as f64,
        }
    }

    /// The share of the brightness's variance that is explained neither by noise nor by a sphere at the given phase with
    /// earthshine.
    pub fn unlike(&self, phase_rad: f64) -> f64 {
        let all = (self.squares - self.noise).max(f64::MIN_POSITIVE);
        ((self.left(phase_rad) - self.noise) / all).clamp(0.0, 1.0)
    }

    /// The best-fitting phase angle, 0 to pi, combined with that of the limb; its sigma comes from the variations of bright
    /// and dark ground. The side of the light is that of the limb.
    pub fn phase_rad(&self, of_limb: f64) -> Measured {
        // Twice the negative logarithm of its likelihood, for errors of unknown sigma.
        let tried = |phase_rad: f64| {
            let left = self.left(phase_rad).max(f64::MIN_POSITIVE);
            let off = (phase_rad - of_limb) / BY_LIMB_RAD;
            (PIECES * left.ln() + off * off, phase_rad)
        };
        let better = |one: (f64, f64), other: (f64, f64)| if other.0 < one.0 { other } else { one };
        let phases = (0..180).step_by(PHASE_STEP_DEG);
        let coarse: Vec<(f64, f64)> = phases.map(|deg| tried((deg as f64).to_radians())).collect();
        let mut best = coarse.iter().copied().fold(coarse[0], better);
        let mut step = (PHASE_STEP_DEG as f64).to_radians();
        for _ in 0..HALVINGS {
            step /= 2.0;
            let beside = [best.1 - step, best.1 + step].map(|phase| tried(phase.clamp(0.0, PI)));
            best = beside.into_iter().fold(best, better);
        }
        let (mut sum, mut squares) = (1.0, step * step / 12.0);
        for (unlikely, phase_rad) in coarse {
            let chance = ((best.0 - unlikely) / 2.0).exp();
            sum += chance;
            squares += chance * (phase_rad - best.1).powi(2);
        }
        Measured::new(best.1, (squares / sum).sqrt())
    }

    /// The sum of squares that is explained neither by the light of a sphere nor by a uniform dim earthshine.
    fn left(&self, phase_rad: f64) -> f64 {
        let sphere = Sphere::new(self.shading, phase_rad);
        let (mut light, mut squares, mut along, mut disc_along) = (0.0, 0.0, 0.0, 0.0);
        for place in &self.disc {
            let here = sphere.light_at(place.along, place.to_observer);
            light += here;
            squares += here * here;
            along += here * place.dn;
            disc_along += place.dn;
        }
        let (disc, count) = (self.disc.len() as f64, self.count.max(1.0));
        let light_light = squares - light * light / count;
        let light_disc = light - light * disc / count;
        let disc_disc = disc - disc * disc / count;
        let determinant = light_light * disc_disc - light_disc * light_disc;
        let of_light = along * disc_disc - disc_along * light_disc;
        let of_disc = disc_along * light_light - along * light_disc;
        let earthshine = if determinant > 0.0 && of_light > 0.0 {
            (of_disc / of_light).clamp(0.0, MOST_EARTHSHINE)
        } else if of_disc > 0.0 {
            MOST_EARTHSHINE
        } else {
            0.0
        };
        let norm = light_light + earthshine * (2.0 * light_disc + earthshine * disc_disc);
        let explained =
            (along + earthshine * disc_along).max(0.0).powi(2) / norm.max(f64::MIN_POSITIVE);
        self.squares - explained
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, Pixels};
    use crate::moon::light::Levels;
    use crate::moon::plane::Plane;

    const SIZE: usize = 120;
    const AT: Parameters =
        Parameters::from_array_storage(nalgebra::ArrayStorage([[60.0, 60.0, 40.0, 0.8, 0.0, 0.7]]));

    /// A picture with a brightness as a function of position, in radii from the centre of a disc of 40 px.
    fn frame(light: impl Fn(Vector2<f64>) -> f64) -> Frame {
        let pixels = (0..SIZE * SIZE).map(|n| {
            let at = Vector2::new((n % SIZE) as f64, (n / SIZE) as f64);
            let place = (at - Vector2::repeat(60.0)) / 40.0;
            (10.0 + 150.0 * light(place)).min(255.0) as u8
        });
        Frame::new(
            SIZE,
            SIZE,
            Pixels::U8(pixels.collect()),
            255,
            Default::default(),
        )
        .unwrap()
    }

    fn seen<T>(frame: &Frame, value: impl Fn(&Face) -> T) -> T {
        let levels = Levels {
            dark_dn: 10.0,
            noise_dn: 0.5,
            saturated_dn: 255.0,
        };
        value(&Face::seen(
            &View {
                frame,
                levels: &levels,
                plane: Plane::of_aspect(1.0),
                shading: Shading::LommelSeeliger,
            },
            &AT,
        ))
    }

    /// A sphere lit from the side given by the parameters, computed with vectors.
    fn sphere(phase_deg: f64, place: Vector2<f64>) -> f64 {
        let height = 1.0 - place.norm_squared();
        if height <= 0.0 {
            return 0.0;
        }
        let normal = place.push(height.sqrt());
        let sun = crate::moon::towards_sun(phase_deg, 0.7_f64.to_degrees());
        let (to_sun, to_observer) = (normal.dot(&sun).max(0.0), normal.z);
        to_sun / (to_sun + to_observer)
    }

    #[test]
    fn a_face_shows_its_phase_whatever_seas_it_has() {
        for phase_deg in [5.0, 40.0, 85.0, 120.0, 155.0] {
            let sea = |place: Vector2<f64>| match place.y > 0.2 && place.x < 0.3 {
                true => 0.6,
                false => 1.0,
            };
            let frame = frame(|place| sea(place) * sphere(phase_deg, place));
            let (found, unlike) = seen(&frame, |face| {
                let phase = face.phase_rad(0.5);
                (phase, face.unlike(phase.value))
            });
            let off_deg = found.value.to_degrees() - phase_deg;
            assert!(
                off_deg.abs() < 3.0 * found.sigma.to_degrees(),
                "{phase_deg}: {found:?}"
            );
            assert!(
                off_deg.abs() < 15.0 && unlike < 0.3,
                "{phase_deg}: {found:?}"
            );
        }
    }

    #[test]
    fn a_dark_side_may_have_an_earthshine_and_no_more() {
        let unlike = |shine: f64| {
            let frame = frame(|place| {
                let disc = if place.norm() < 1.0 { shine } else { 0.0 };
                sphere(90.0, place) + disc
            });
            seen(&frame, |face| face.unlike(90_f64.to_radians()))
        };
        assert!(unlike(0.1) < 0.02, "{}", unlike(0.1));
        assert!(unlike(0.6) > 0.1, "{}", unlike(0.6));
    }

    #[test]
    fn the_glow_of_a_cloud_is_unlike_any_phase() {
        let frame = frame(|place| (-2.0 * place.norm_squared()).exp());
        let unlike = seen(&frame, |face| face.unlike(face.phase_rad(0.3).value));
        assert!(unlike > 0.3, "{unlike}");
    }
}
