//! The light of air, clouds and ground along a ray.

use super::super::texture::{AlongLimb, Pattern};
use super::super::{Purpose, generator};
use super::EarthScene;
use super::sunlight::Sunlight;
use crate::units::EARTH_RADIUS_M;
use libm::{erf, erfc};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

/// The ground: an ellipsoid of revolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    pub equator_m: f64,
    pub flattening: f64,
}

impl Shape {
    pub const SPHERE: Self = Self {
        equator_m: EARTH_RADIUS_M,
        flattening: 0.0,
    };
    pub const WGS84: Self = Self {
        equator_m: 6_378_137.0,
        flattening: 1.0 / 298.257_223_563,
    };

    pub fn mean_radius_m(&self) -> f64 {
        self.equator_m * (1.0 - self.flattening / 3.0)
    }

    pub fn polar_m(&self) -> f64 {
        self.equator_m * (1.0 - self.flattening)
    }

    /// A place on longitude 0 from geodetic latitude and height, m from the centre: the ellipse at the reduced latitude, and the height along
    /// its normal.
    pub fn place(&self, latitude_rad: f64, height_m: f64) -> Vector3<f64> {
        let (sine, cosine) = latitude_rad.sin_cos();
        let reduced = ((1.0 - self.flattening) * sine).atan2(cosine);
        Vector3::new(
            self.equator_m * reduced.cos() + height_m * cosine,
            0.0,
            self.polar_m() * reduced.sin() + height_m * sine,
        )
    }
}

/// Air that scatters sunlight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Brightness of optically thick air, DN.
    pub brightness_dn: f64,
    /// Optical depth of a ray that grazes the ground.
    pub depth: f64,
    /// Height over which the air's density falls to 1/e.
    pub scale_m: f64,
    /// A layer that scatters more than the surrounding air.
    pub haze: Option<Haze>,
    /// Brightness of the airglow's layer at 90 km, DN: also without the Sun.
    pub airglow_dn: f64,
    /// Brightness along the limb: 1 sigma, relative.
    pub varies_by: f64,
    /// Height of the limb along it: 1 sigma.
    pub varies_by_m: f64,
    /// The correlation of both falls to 1/e over this angle along the limb.
    pub length_deg: f64,
}

impl Air {
    /// Air as in pictures from 38 and 230 km: half as bright at 20 km.
    pub const CLEAR: Self = Self {
        brightness_dn: 165.0,
        depth: 12.0,
        scale_m: 7_000.0,
        haze: None,
        airglow_dn: 0.0,
        varies_by: 0.0,
        varies_by_m: 0.0,
        length_deg: 10.0,
    };

    /// Height above which a ray contributes less than 0.001 DN.
    fn top_m(&self) -> f64 {
        const SCALES: f64 = 15.0;
        const SIGMAS: f64 = 6.0;
        let air_m = SCALES * self.scale_m + SIGMAS * self.varies_by_m;
        match self.airglow_dn > 0.0 {
            true => air_m.max(AIRGLOW.height_m + SIGMAS * AIRGLOW.thickness_m),
            false => air_m,
        }
    }

    /// Optical depth of haze for a ray with this lowest height that is clear of the ground.
    fn haze_depth(&self, height_m: f64) -> f64 {
        self.haze
            .map_or(0.0, |haze| haze.depth * haze.met(height_m))
    }
}

/// A layer around the Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Haze {
    pub height_m: f64,
    /// Scale of the decrease above it, 1 sigma of a Gaussian.
    pub thickness_m: f64,
    /// Optical depth of a ray that grazes it.
    pub depth: f64,
}

impl Haze {
    /// Volcanic haze in the stratosphere.
    pub const THIN: Self = Self {
        height_m: 20_000.0,
        thickness_m: 2_000.0,
        depth: 0.2,
    };

    /// Path of a ray with this lowest height through the layer, relative to a grazing one: the lower the ray, the more steeply it crosses the shell.
    fn met(&self, height_m: f64) -> f64 {
        let above = (height_m - self.height_m) / self.thickness_m;
        match above {
            0.0.. => (-0.5 * above * above).exp(),
            _ => (1.0 - 2.0 * above).sqrt().recip(),
        }
    }
}

/// Airglow of oxygen, as in photographs from the space station.
const AIRGLOW: Haze = Haze {
    height_m: 90_000.0,
    thickness_m: 5_000.0,
    depth: 0.0,
};

/// Light above the limb: sunlight scattered by air, lens or window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glow {
    /// Brightness at the limb, relative to the limb's.
    pub brightness: f64,
    /// Angle above the limb over which it falls to 1/e.
    pub reach_deg: f64,
}

impl Glow {
    /// Half as bright as the limb, over a few degrees.
    pub const BRIGHT: Self = Self {
        brightness: 0.5,
        reach_deg: 3.0,
    };
}

/// A deck of clouds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clouds {
    /// Fraction of the sky that they cover.
    pub cover: f64,
    pub height_m: f64,
    pub brightness_dn: f64,
}

impl Clouds {
    /// Clouds over half of the ground, up to the height of the air's lower layer.
    pub const BRIGHT: Self = Self {
        cover: 0.5,
        height_m: 10_000.0,
        brightness_dn: 220.0,
    };
}

/// Brightness of ground without clouds, DN.
const GROUND_DN: f64 = 70.0;
/// Size of the largest clouds, m.
const CLOUD_M: f64 = 400_000.0;

/// A scene's sky, ready for its rays.
pub(super) struct Sky<'a> {
    scene: &'a EarthScene,
    /// The camera's place in units of the ellipsoid's half axes: in this scaled frame the ground is the unit sphere.
    place: Vector3<f64>,
    /// Transformation from north, east, down, in metres, to that frame.
    scaled_from_local: Matrix3<f64>,
    pattern: Pattern,
    /// Relative brightness; height, m.
    along_limb: AlongLimb,
    sunlight: Option<Sunlight>,
    /// Angle from the nadir to the ground's edge.
    edge_angle_rad: f64,
}

impl<'a> Sky<'a> {
    pub fn of(scene: &'a EarthScene) -> Self {
        let conditions = &scene.conditions;
        let shape = conditions.shape;
        let latitude = scene.latitude_deg.to_radians();
        let (sine, cosine) = latitude.sin_cos();
        let axes = Vector3::new(1.0, 1.0, 1.0 - shape.flattening) * shape.equator_m;
        let local = Matrix3::from_columns(&[
            Vector3::new(-sine, 0.0, cosine),
            Vector3::y(),
            Vector3::new(-cosine, 0.0, -sine),
        ]);
        let scaled_from_local = Matrix3::from_diagonal(&axes.map(f64::recip)) * local;
        let air = conditions.air;
        let random = [Purpose::LimbBrightness, Purpose::LimbHeight]
            .map(|purpose| generator(scene.seed, purpose, scene.weather));
        let sigmas = [air.varies_by, air.varies_by_m];
        Self {
            scene,
            place: shape
                .place(latitude, conditions.height_m)
                .component_div(&axes),
            scaled_from_local,
            pattern: Pattern::new(Purpose::Clouds, scene.seed, scene.weather),
            along_limb: AlongLimb::new(sigmas, air.length_deg, random),
            sunlight: Sunlight::of(scene),
            edge_angle_rad: scene.edge_angle_rad(),
        }
    }

    /// Light of a ray (north, east, down; unit), DN.
    pub fn light_dn(&self, ray: &Vector3<f64>) -> f64 {
        let glow = self.scene.conditions.glow;
        self.earth_dn(ray) + glow.map_or(0.0, |glow| self.glow_dn(&glow, ray))
    }

    fn glow_dn(&self, glow: &Glow, ray: &Vector3<f64>) -> f64 {
        let above_rad = ray.z.clamp(-1.0, 1.0).acos() - self.edge_angle_rad;
        let falls = (-above_rad.max(0.0) / glow.reach_deg.to_radians()).exp();
        glow.brightness * self.scene.conditions.air.brightness_dn * falls
    }

    fn earth_dn(&self, ray: &Vector3<f64>) -> f64 {
        let conditions = &self.scene.conditions;
        let passage = self.passage(ray);
        if passage.height_m > conditions.air.top_m() {
            return 0.0;
        }
        let along_limb = self.along_limb.at(ray);
        let air = Air {
            brightness_dn: conditions.air.brightness_dn * (1.0 + along_limb.x),
            ..conditions.air
        };
        let passage = Passage {
            height_m: passage.height_m - along_limb.y,
            ..passage
        };
        let depth = passage.depth(&air);
        let haze = air.brightness_dn * (1.0 - (-depth).exp());
        let behind = match passage.hits_ground() {
            true => GROUND_DN * (-depth).exp(),
            false => 0.0,
        };
        let airglow = conditions.air.airglow_dn * AIRGLOW.met(passage.height_m);
        let clear = self.lit(&passage.lowest) * (haze + behind) + airglow;
        match conditions
            .clouds
            .and_then(|clouds| self.cloud(&clouds, &passage, &air))
        {
            Some((cover, cloud_dn)) => clear + cover * (cloud_dn - clear),
            None => clear,
        }
    }

    fn passage(&self, ray: &Vector3<f64>) -> Passage {
        let along = self.scaled_from_local * ray;
        let to_lowest_m = -self.place.dot(&along) / along.norm_squared();
        let lowest = self.place + along * to_lowest_m;
        let radius_m = self.radius_m(&lowest);
        Passage {
            lowest,
            height_m: (lowest.norm() - 1.0) * radius_m,
            camera_m: self.scene.conditions.height_m,
            to_lowest_m,
            radius_m,
            along,
        }
    }

    /// Metres of height per unit of the scaled frame.
    fn radius_m(&self, at: &Vector3<f64>) -> f64 {
        let shape = self.scene.conditions.shape;
        let polar = at.z / at.norm();
        shape.equator_m * (1.0 - shape.flattening * polar * polar)
    }

    /// Fraction of the Sun's light at the lowest point of a ray.
    fn lit(&self, lowest: &Vector3<f64>) -> f64 {
        let Some(sunlight) = &self.sunlight else {
            return 1.0;
        };
        let towards = (self.scaled_from_local * sunlight.towards.into_inner()).normalize();
        sunlight.share(towards.dot(&lowest.normalize()))
    }

    /// The same for a ray (north, east, down; unit).
    pub fn lit_towards(&self, ray: &Vector3<f64>) -> f64 {
        self.lit(&self.passage(ray).lowest)
    }

    /// Fraction of a ray covered by a deck of clouds, and its light; `None` above the clouds.
    fn cloud(&self, clouds: &Clouds, passage: &Passage, air: &Air) -> Option<(f64, f64)> {
        let radius = 1.0 + clouds.height_m / passage.radius_m;
        let lowest = passage.lowest.norm();
        if lowest >= radius || passage.to_lowest_m < 0.0 {
            return None;
        }
        let back = (radius * radius - lowest * lowest).sqrt() / passage.along.norm();
        let top = passage.lowest - passage.along * back;
        const SOFT: f64 = 0.1;
        let pattern = self.pattern.at(&(top * (passage.radius_m / CLOUD_M)));
        // The pattern has a mean of about 0.5, and a sigma of about 0.1.
        let edge = 0.5 + (0.5 - clouds.cover) * 0.4;
        let cover = ((pattern - edge) / SOFT + 0.5).clamp(0.0, 1.0);
        let before = air.depth * (-clouds.height_m / air.scale_m).exp() / 2.0;
        let share = passage.share_to(back * passage.along.norm() * passage.radius_m, air);
        let haze = 1.0 - (-before * share).exp();
        let light = clouds.brightness_dn + haze * (air.brightness_dn - clouds.brightness_dn);
        Some((cover, self.lit(&top) * light))
    }

    /// See [`EarthTruth::edge_m`](super::EarthTruth::edge_m).
    pub fn edge_m(&self) -> f64 {
        let conditions = &self.scene.conditions;
        const STEPS: u32 = 100_000;
        let step_m = (conditions.height_m / f64::from(STEPS)).min(1.0);
        let light = |step: u32| {
            let height_m = f64::from(step) * step_m;
            let passage = Passage::at(height_m, conditions.height_m, &conditions.shape);
            1.0 - (-passage.depth(&conditions.air)).exp()
        };
        let half = light(0) / 2.0;
        let bright = (0..STEPS).rev().find(|step| light(*step) >= half);
        f64::from(bright.unwrap_or_default() + 1) * step_m
    }
}

/// Passage of a straight ray near the Earth.
struct Passage {
    /// Its lowest point, in the scaled frame.
    lowest: Vector3<f64>,
    height_m: f64,
    camera_m: f64,
    /// Distance from the camera; negative for a ray that rises.
    to_lowest_m: f64,
    radius_m: f64,
    along: Vector3<f64>,
}

impl Passage {
    /// The passage of a ray with a lowest height, from a camera at another height.
    fn at(height_m: f64, camera_m: f64, shape: &Shape) -> Self {
        let radius_m = shape.mean_radius_m();
        let (lowest, camera) = (radius_m + height_m, radius_m + camera_m);
        Self {
            lowest: Vector3::z() * (lowest / radius_m),
            height_m,
            camera_m,
            to_lowest_m: (camera * camera - lowest * lowest).max(0.0).sqrt(),
            radius_m,
            along: Vector3::x() / radius_m,
        }
    }

    fn hits_ground(&self) -> bool {
        self.height_m < 0.0 && self.to_lowest_m > 0.0
    }

    /// Optical depth from the camera to the point where the ray leaves the air or meets the ground.
    fn depth(&self, air: &Air) -> f64 {
        // Along a ray, density is a Gaussian about the lowest point, with this 1 sigma.
        let sigma_m = (self.radius_m * air.scale_m).sqrt();
        if self.hits_ground() {
            let u = -self.height_m / air.scale_m;
            return air.depth / 2.0 * scaled_erfc(u.sqrt());
        }
        let before = self.to_lowest_m / sigma_m / 2.0_f64.sqrt();
        if before < 0.0 {
            // The lowest point is behind the camera, deep within the Earth if the ray is steep: only the air from the camera upwards counts.
            let at_camera = (-self.camera_m / air.scale_m).exp();
            return air.depth * at_camera * scaled_erfc(-before) / 2.0;
        }
        let depth = air.depth * (-self.height_m / air.scale_m).exp() * (1.0 + erf(before)) / 2.0;
        depth + air.haze_depth(self.height_m)
    }

    /// Fraction of the air in front of a point at this distance before the lowest one, relative to that on half of a ray with its lowest point there.
    fn share_to(&self, before_m: f64, air: &Air) -> f64 {
        let sigma_m = (self.radius_m * air.scale_m).sqrt();
        scaled_erfc(before_m / sigma_m / 2.0_f64.sqrt())
    }
}

/// exp(x^2) erfc(x), for x of 0 and more.
fn scaled_erfc(x: f64) -> f64 {
    match x {
        // erfc is negligible where its argument squared is still far from overflow.
        ..5.0 => (x * x).exp() * erfc(x),
        _ => (1.0 - 0.5 / (x * x)) / (x * PI.sqrt()),
    }
}
