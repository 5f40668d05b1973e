//! The lit limb to a part of a pixel: the circle whose shaded, blurred light the pixels along the limb show.
//!
//! How bright the ground is at a place nobody knows, and how bright the sky before it: each few pixels of the limb have a brightness and a sky
//! of their own. What is left is the shape of the light across the limb.

use super::light::Levels;
use super::plane::Plane;
use super::profile::{Blur, Depths, PIXEL_VARIANCE, Profile};
use super::shading::{Shading, Sphere};
use crate::estimation::{
    FitError, Fitted, LeastSquares, Linearised, Loss, Prior, SIGMA_PER_MEDIAN, Scale, median,
};
use crate::frame::Frame;
use crate::geometry::Circle;
use crate::units::Measured;
use nalgebra::{SMatrix, SVector, Vector1, Vector2};
use std::f64::consts::{PI, TAU};

/// Pixels of the limb that share a brightness, and how many such sectors a limb has at least.
const SECTOR_PX: f64 = 3.0;
const LEAST_SECTORS: f64 = 24.0;
/// Fewer pixels tell nothing of a sector.
const LEAST_PIXELS: usize = 6;
/// A sector is seen where its brightest pixel stands so many sigmas of a pixel's noise above the sky.
const SEEN_SIGMAS: f64 = 4.0;
/// Pixels count so far before and behind the limb, px: further behind it the ground's own light and shade would move it.
const PIXELS: Depths = -4.0..3.0;
/// A fit moves the limb by at most so much, px, and turns the light, in whose phase and side it is linear, by so much; then the limb is read anew.
const SLACK_PX: f64 = 2.0;
const SLACK_RAD: f64 = 0.3;
/// The limb is lit where the sphere shows this share of the light in the middle of the bright limb, this far behind the limb. Further on it is
/// the terminator that is seen, and mountains move that.
const LIT_SHARE: f64 = 0.2;
const LIT_DEPTH_PX: f64 = 1.5;
const LIT_DEPTH: f64 = 0.1;
/// A sector lies off the circle by so many sigmas, or so many times the usual.
const OFF_SIGMAS: f64 = 5.0;
/// What the circle leaves of the ground along the limb is alike over so much, px.
const ALIKE_PX: f64 = 12.0;
/// An outline's circle lies about so far off the disc's, towards the light, px: it runs outside of the bright limb, and inside of the dim horns.
const OUTLINE_PX: f64 = 0.5;
/// Blur of the optics beside that of the pixels, px, as far as it is known before.
const BLUR_PX: Measured = Measured::new(0.8, 0.4);
const POSSIBLE_BLUR_PX: std::ops::Range<f64> = 0.05..3.0;
/// The derivative by the phase is taken over so much, rad.
const PHASE_STEP_RAD: f64 = 0.02;
/// A phase that is known as well as this is not fitted, rad.
const KNOWN_PHASE_RAD: f64 = 0.01;

/// Centre x and y (round px), radius (px), blur (px), phase angle, and angle of the bright limb's middle (rad).
pub(super) const PARAMETERS: usize = 6;
pub(super) type Parameters = SVector<f64, PARAMETERS>;
type Row = Linearised<1, PARAMETERS>;
type RowVector = SMatrix<f64, 1, PARAMETERS>;

/// What is known of a limb before it is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    pub radius: Option<Measured>,
    pub phase_rad: Measured,
    pub bright_limb_rad: Measured,
}

/// A pixel near the limb.
struct Pixel {
    /// In round px.
    at: Vector2<f64>,
    /// How its light differs from that of its sector, and changes by blur, phase and side of the light, as the circle was when it was read.
    beside: f64,
    by_others: [f64; 3],
    light_dn: f64,
}

/// Pixels of a few px of the limb.
struct Sector {
    /// From +x towards +y.
    angle_rad: f64,
    light: SectorLight,
    pixels: Vec<Pixel>,
}

/// The pixels along a lit limb.
pub(super) struct Limb {
    known: Known,
    start: Parameters,
    lights: Lights,
    sectors: Vec<Sector>,
    noise_dn: f64,
    /// Sectors of the lit limb, whether they are seen or not.
    pub lit: usize,
    /// Share of its pixels on the disc that tell nothing.
    pub saturated: f64,
}

/// A circle with what its limb shows.
pub(super) struct LimbFit {
    pub fitted: Fitted<PARAMETERS>,
    pub points: Vec<LimbPoint>,
    pub radius_contradiction: Option<Contradiction>,
}

/// How far the radius that the picture tells lies from the one that was known: px, and sigmas of both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contradiction {
    pub off_px: f64,
    pub sigmas: f64,
}

/// A few pixels' limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LimbPoint {
    /// From +x towards +y, in round px.
    pub angle_rad: f64,
    /// How far the limb lies outwards of the circle there.
    pub excess_px: Measured,
}

impl Limb {
    /// Reads the pixels along the lit limb of a disc.
    pub fn read(
        frame: &Frame,
        plane: &Plane,
        start: Parameters,
        levels: &Levels,
        shading: Shading,
        known: Known,
    ) -> Self {
        let circle = circle_of(&start);
        let lit_rad = lit_rad(shading, &start);
        let lights = Lights::new(shading, &start, &known);
        let count = (circle.radius * TAU / SECTOR_PX).max(LEAST_SECTORS) as usize;
        let width = TAU / count as f64;
        let angle = |n: usize| (n as f64 + 0.5) * width;
        let from_middle = |n: usize| from_middle(angle(n), start[5]);
        // Of the lit sectors, and one further.
        let profile = |n: usize| {
            let is_needed = from_middle(n).abs() <= lit_rad + 1.01 * width;
            is_needed.then(|| lights.profile(&lights.here, from_middle(n)))
        };
        let profiles: Vec<Option<Profile>> = (0..count).map(profile).collect();
        let sector = |n: usize| {
            let here = profiles[n].as_ref()?;
            let next = profiles[(n + 1) % count].as_ref()?;
            (from_middle(n).abs() <= lit_rad).then(|| Sector {
                angle_rad: angle(n),
                light: SectorLight {
                    here: here.clone(),
                    by_angle: next.change_from(here, width),
                    by_phase: lights.by_phase(here, from_middle(n)),
                },
                pixels: Vec::new(),
            })
        };
        let mut lit: Vec<Option<Sector>> = (0..count).map(sector).collect();
        let (mut on_disc, mut saturated) = (0_u32, 0_u32);
        each_near(frame, plane, &circle, |at, dn| {
            let away = at - circle.centre;
            let angle_rad = away.y.atan2(away.x);
            let around = if angle_rad < 0.0 {
                angle_rad + TAU
            } else {
                angle_rad
            };
            let Some(sector) = &mut lit[((around / width) as usize).min(count - 1)] else {
                return;
            };
            let distance = away.norm();
            on_disc += u32::from(distance < circle.radius);
            if f64::from(dn) >= levels.saturated_dn {
                saturated += 1;
                return;
            }
            let depth = circle.radius - distance - lights.shrinks(distance);
            let (beside, by_others) =
                (sector.light).others(around - sector.angle_rad, depth, start[3], distance);
            sector.pixels.push(Pixel {
                at,
                beside,
                by_others,
                light_dn: f64::from(dn) - levels.dark_dn,
            });
        });
        let mut sectors: Vec<Sector> = lit.into_iter().flatten().collect();
        let lit = sectors.len();
        sectors.retain(|sector| sector.is_seen(SEEN_SIGMAS * levels.noise_dn));
        Self {
            known,
            start,
            lights,
            sectors,
            noise_dn: levels.noise_dn,
            lit,
            saturated: f64::from(saturated) / f64::from(on_disc.max(1_u32)),
        }
    }

    /// Sectors in which the limb is seen.
    pub fn seen(&self) -> usize {
        self.sectors.len()
    }

    /// The circle of least squares, with the blur, the phase and the side of the light. Sectors that lie far off it count no longer: a star is
    /// there, or a piece of the vehicle.
    ///
    /// # Errors
    /// A limb that does not determine it.
    pub fn fit(&self) -> Result<LimbFit, FitError> {
        let all: Vec<&Sector> = self.sectors.iter().collect();
        let first = self.fit_through(&all)?;
        let off = |point: &LimbPoint| point.excess_px.value / point.excess_px.sigma;
        let sizes = first.points.iter().map(|point| off(point).abs());
        let most = OFF_SIGMAS * (SIGMA_PER_MEDIAN * median(sizes).unwrap_or(0.0)).max(1.0);
        let kept = all.iter().zip(&first.points);
        let kept: Vec<&Sector> = kept
            .filter(|(_, point)| off(point).abs() < most)
            .map(|(sector, _)| *sector)
            .collect();
        match kept.len() == all.len() {
            true => Ok(first),
            false => self.fit_through(&kept),
        }
    }

    fn fit_through(&self, sectors: &[&Sector]) -> Result<LimbFit, FitError> {
        let rows_at = |at: &Parameters| {
            let pixels = sectors.iter().map(|sector| sector.pixels.len());
            let mut rows = Vec::with_capacity(pixels.sum());
            for sector in sectors {
                sector.add_rows(at, &self.lights, self.noise_dn, &mut rows);
            }
            rows
        };
        let fit = LeastSquares {
            start: self.start,
            prior: self.prior(),
            loss: Loss::Squares,
            scale: Scale::Inflated,
            tolerance_sigmas: 0.3,
        };
        let mut fitted = fit.fit(|at: &Parameters| {
            let moved = at - self.start;
            let is_possible = moved.fixed_rows::<3>(0).amax() < SLACK_PX
                && moved.fixed_rows::<2>(4).amax() < SLACK_RAD
                && POSSIBLE_BLUR_PX.contains(&at[3]);
            is_possible.then(|| rows_at(at))
        })?;
        let rows = rows_at(&fitted.parameters);
        let mut rest = &rows[..];
        let pull = |sector: &&Sector| {
            let (of_sector, others) = rest.split_at(sector.pixels.len());
            rest = others;
            Pull::of(of_sector)
        };
        let pulls: Vec<Pull> = sectors.iter().map(pull).collect();
        let points = sectors.iter().zip(&pulls).map(|(sector, pull)| LimbPoint {
            angle_rad: sector.angle_rad,
            excess_px: pull.excess(fitted.scatter),
        });
        let points: Vec<LimbPoint> = points.collect();
        let radius_contradiction = self.radius_contradiction(&fitted);
        // A sector of no light tells nothing of the ground.
        let telling = points.iter().copied().zip(pulls);
        let (telling, pulls): (Vec<LimbPoint>, Vec<Pull>) = telling
            .filter(|(point, _)| point.excess_px.sigma < SLACK_PX)
            .unzip();
        fitted.covariance += of_rough_limb(&telling, &pulls, &fitted);
        Ok(LimbFit {
            fitted,
            points,
            radius_contradiction,
        })
    }

    /// What is known and what comes out differ by as much as the variance shrinks, where they agree.
    fn radius_contradiction(&self, fitted: &Fitted<PARAMETERS>) -> Option<Contradiction> {
        let known = self.known.radius?;
        let off = (fitted.parameters[2] - known.value).abs();
        let shrinks = known.sigma.powi(2) - fitted.covariance[(2, 2)];
        (shrinks > 0.0).then(|| Contradiction {
            off_px: off * known.sigma.powi(2) / shrinks,
            sigmas: off / shrinks.sqrt(),
        })
    }

    fn prior(&self) -> Prior<PARAMETERS> {
        let Known {
            radius,
            phase_rad,
            bright_limb_rad,
        } = self.known;
        let mut prior = Prior::none();
        let known = [
            radius,
            Some(BLUR_PX),
            Some(phase_rad),
            Some(bright_limb_rad),
        ];
        for (n, known) in (2..).zip(known) {
            if let Some(known) = known {
                prior.mean[n] = known.value;
                prior.information[n] = known.sigma.powi(-2);
            }
        }
        prior
    }
}

/// What the ground adds to the covariance. Mountains, and ground that grows brighter or darker across the limb, move it, and neighbours alike: a process
/// of first order along the limb. Its variance is what the excess shows beyond the noise; of what such a process has, the circle takes a part away.
fn of_rough_limb(
    points: &[LimbPoint],
    pulls: &[Pull],
    fitted: &Fitted<PARAMETERS>,
) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
    // How the parameters move with each sector's limb, and the limb with the parameters.
    let inverse = fitted.covariance / fitted.scatter.powi(2);
    let moves: Vec<Parameters> = pulls.iter().map(|pull| inverse * pull.by_excess).collect();
    let follows = |n: usize| pulls[n].by_excess / pulls[n].information;
    let radius = fitted.parameters[2];
    let mut covariance = SMatrix::zeros();
    let (mut shown, mut noise, mut expected) = (0.0, 0.0, 0.0);
    for (n, point) in points.iter().enumerate() {
        let together: Parameters = (points.iter().zip(&moves))
            .map(|(other, moves)| moves * alike(point.angle_rad - other.angle_rad, radius))
            .sum();
        covariance += moves[n] * together.transpose();
        let kept = 1.0 - follows(n).dot(&moves[n]);
        shown += point.excess_px.value.powi(2);
        noise += point.excess_px.sigma.powi(2) * kept;
        expected += 1.0 - 2.0 * follows(n).dot(&together);
    }
    for n in 0..points.len() {
        expected += follows(n).dot(&(covariance * follows(n)));
    }
    covariance * ((shown - noise) / expected.max(1.0)).max(0.0)
}

/// How well the ground agrees at two places of the limb.
fn alike(apart_rad: f64, radius: f64) -> f64 {
    let apart = (apart_rad + PI).rem_euclid(TAU) - PI;
    (-apart.abs() * radius / ALIKE_PX).exp()
}

/// How far from the middle of the bright limb it is lit, rad.
fn lit_rad(shading: Shading, at: &Parameters) -> f64 {
    const STEPS: u32 = 180;
    let sphere = Sphere::new(shading, at[4]);
    let depth = LIT_DEPTH.min(LIT_DEPTH_PX / at[2]);
    let light = |angle: f64| sphere.light(1.0 - depth, angle);
    let least = LIT_SHARE * light(0.0);
    let angles = (0..=STEPS).map(|n| f64::from(n) / f64::from(STEPS) * PI);
    let lit = angles.take_while(|angle| light(*angle) > least);
    lit.last().unwrap_or(0.0)
}

/// An angle from the middle of the bright limb, -pi to pi.
fn from_middle(angle_rad: f64, bright_limb_rad: f64) -> f64 {
    (angle_rad - bright_limb_rad + PI).rem_euclid(TAU) - PI
}

/// The light along a limb about some parameters: linear in blur, phase and the side of the light.
struct Lights {
    here: Sphere,
    /// At a phase that is a step further; none where the phase is known.
    stepped: Option<Sphere>,
    blur: Blur,
    radius: f64,
    blur_px: f64,
    phase_rad: f64,
    bright_limb_rad: f64,
}

impl Lights {
    fn new(shading: Shading, at: &Parameters, known: &Known) -> Self {
        let is_fitted = known.phase_rad.sigma > KNOWN_PHASE_RAD;
        Self {
            here: Sphere::new(shading, at[4]),
            stepped: is_fitted.then(|| Sphere::new(shading, at[4] + PHASE_STEP_RAD)),
            blur: Blur::new(at[3]),
            radius: at[2],
            blur_px: at[3],
            phase_rad: at[4],
            bright_limb_rad: at[5],
        }
    }

    /// A blurred circle looks smaller than a blurred straight edge does, by so many px at a distance from its centre.
    fn shrinks(&self, distance: f64) -> f64 {
        (self.blur_px.powi(2) + PIXEL_VARIANCE) / (2.0 * distance.max(1.0))
    }

    /// The light across the limb at an angle from the middle of the bright limb.
    fn profile(&self, sphere: &Sphere, angle_rad: f64) -> Profile {
        let depths = PIXELS.start - SLACK_PX..PIXELS.end + SLACK_PX;
        Profile::new(sphere, self.radius, &self.blur, &depths, angle_rad)
    }

    /// How it changes with the phase, 1/rad.
    fn by_phase(&self, here: &Profile, angle_rad: f64) -> Option<Profile> {
        let stepped = self.profile(self.stepped.as_ref()?, angle_rad);
        Some(stepped.change_from(here, PHASE_STEP_RAD))
    }
}

/// The light across the limb in the middle of a sector, and how it changes.
struct SectorLight {
    here: Profile,
    by_angle: Profile,
    by_phase: Option<Profile>,
}

impl SectorLight {
    /// How the light at an angle from the sector's middle differs from that there, and how it changes with blur, phase and side.
    fn others(&self, angle_rad: f64, depth: f64, blur_px: f64, distance: f64) -> (f64, [f64; 3]) {
        let here = self.here.at(depth);
        let by_angle = self.by_angle.at(depth).light;
        let by_phase = self.by_phase.as_ref();
        let by_others = [
            // Blurred light obeys the heat equation.
            blur_px * (here.curve - here.slope / distance.max(1.0)),
            by_phase.map_or(0.0, |by_phase| by_phase.at(depth).light),
            -by_angle,
        ];
        (by_angle * angle_rad, by_others)
    }
}

pub(super) fn circle_of(at: &Parameters) -> Circle {
    Circle {
        centre: at.fixed_rows::<2>(0).into_owned(),
        radius: at[2],
    }
}

/// Where a search begins: at a circle with its radius, if that is known, and the middle of its bright limb where it is.
pub(super) fn begin(circle: &Circle, known: &Known) -> Parameters {
    let radius = known.radius.map_or(circle.radius, |radius| radius.value);
    let (sin, cos) = known.bright_limb_rad.value.sin_cos();
    let centre = circle.centre + Vector2::new(cos, sin) * (circle.radius - OUTLINE_PX - radius);
    Parameters::from([
        centre.x,
        centre.y,
        radius,
        BLUR_PX.value,
        known.phase_rad.value,
        known.bright_limb_rad.value,
    ])
}

impl Sector {
    fn is_seen(&self, least_dn: f64) -> bool {
        let brightest = self
            .pixels
            .iter()
            .map(|pixel| pixel.light_dn)
            .fold(0.0, f64::max);
        self.pixels.len() >= LEAST_PIXELS && brightest > least_dn
    }

    /// Adds the pixels without what the sector's own sky and brightness explain.
    fn add_rows(&self, at: &Parameters, lights: &Lights, noise_dn: f64, rows: &mut Vec<Row>) {
        let pixels = self.pixels.iter();
        let first = rows.len();
        rows.extend(pixels.map(|pixel| pixel.modelled(at, lights, &self.light.here)));
        let rows = &mut rows[first..];
        let count = rows.len() as f64;
        let (mut light, mut by, mut dn) = (0.0, RowVector::zeros(), 0.0);
        for (row, pixel) in rows.iter().zip(&self.pixels) {
            light += row.residual[0];
            by += row.jacobian;
            dn += pixel.light_dn;
        }
        let (light, by, dn) = (light / count, by / count, dn / count);
        let (mut norm, mut product, mut along) = (f64::MIN_POSITIVE, 0.0, RowVector::zeros());
        for (row, pixel) in rows.iter_mut().zip(&self.pixels) {
            row.residual[0] -= light;
            row.jacobian -= by;
            let light = row.residual[0];
            norm += light * light;
            product += light * (pixel.light_dn - dn);
            along += row.jacobian * light;
        }
        let brightness_dn = (product / norm).max(0.0);
        along /= norm;
        for (row, pixel) in rows.iter_mut().zip(&self.pixels) {
            let light = row.residual[0];
            row.residual[0] = (pixel.light_dn - dn - brightness_dn * light) / noise_dn;
            row.jacobian = (row.jacobian - along * light) * (brightness_dn / noise_dn);
        }
    }
}

impl Pixel {
    /// The pixel's light where the ground's brightness is 1, in the residual's place, and its derivatives.
    fn modelled(&self, at: &Parameters, lights: &Lights, profile: &Profile) -> Row {
        let away = self.at - Vector2::new(at[0], at[1]);
        let distance = away.norm().max(1.0);
        let unit = away / distance;
        let depth = at[2] - distance - lights.shrinks(distance);
        let here = profile.at(depth);
        let [by_blur, by_phase, by_side] = self.by_others;
        let light = here.light
            + self.beside
            + by_blur * (at[3] - lights.blur_px)
            + by_phase * (at[4] - lights.phase_rad)
            + by_side * (at[5] - lights.bright_limb_rad);
        let slope = here.slope;
        Row {
            residual: Vector1::new(light),
            jacobian: RowVector::from([
                slope * unit.x,
                slope * unit.y,
                slope,
                by_blur,
                by_phase,
                by_side,
            ]),
        }
    }
}

/// How a sector pulls at the parameters.
struct Pull {
    /// At the radius alone.
    radial: f64,
    /// By how much that changes with the limb's place, 1/px^2.
    information: f64,
    /// How the pulls at all parameters change with the limb's place, 1/px.
    by_excess: Parameters,
}

impl Pull {
    fn of(rows: &[Row]) -> Self {
        let (mut radial, mut by_excess) = (0.0, Parameters::zeros());
        for row in rows {
            radial += row.jacobian[2] * row.residual[0];
            by_excess += row.jacobian.transpose() * row.jacobian[2];
        }
        Self {
            radial,
            information: by_excess[2].max(1e-9),
            by_excess,
        }
    }

    /// How far the limb lies outwards of the circle.
    fn excess(&self, scatter: f64) -> Measured {
        Measured::new(
            self.radial / self.information,
            scatter / self.information.sqrt(),
        )
    }
}

/// Takes the pixels near a circle, in round px, with their DN.
fn each_near(
    frame: &Frame,
    plane: &Plane,
    circle: &Circle,
    mut take: impl FnMut(Vector2<f64>, f32),
) {
    let outer = circle.radius - PIXELS.start;
    let inner = (circle.radius - PIXELS.end).max(0.0);
    let Some(region) = plane.region(circle, outer, frame) else {
        return;
    };
    for y in region.y0..region.y1 {
        let row = frame.row_dn(y, region.x0..region.x1);
        for (x, dn) in (region.x0..region.x1).zip(row) {
            let at = plane.round(x as f64, y as f64);
            let square = (at - circle.centre).norm_squared();
            if (inner * inner..outer * outer).contains(&square) {
                take(at, dn);
            }
        }
    }
}
