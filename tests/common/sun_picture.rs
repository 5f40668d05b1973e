//! The Sun observed by HMI: photons are drawn from the picture, and an image made from them is compared with it.

use nalgebra::{SMatrix, SVector};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::fits;
use solaspect::with_view;
use std::path::Path;

/// Radius and centre of the Sun in the picture, px: tests/data/hmi/README.md.
const RADIUS_PX: f64 = 202.910;
const CENTRE_PX: f64 = 255.5;

/// The picture, scaled to a Sun of any radius, dark beyond the limb.
pub struct SunPicture {
    width: usize,
    light: Vec<f64>,
    brightest: f64,
    pub radius_arcsec: f64,
}

impl SunPicture {
    pub fn of_radius(radius_arcsec: f64) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hmi/continuum.fits");
        let frame = fits::read_frame(&path).unwrap();
        let (width, height) = (frame.width(), frame.height());
        let light: Vec<f64> = with_view!(&frame, view => {
            (0..width * height).map(|n| f64::from(view.dn(n % width, n / width))).collect()
        });
        Self {
            brightest: light.iter().copied().fold(0.0, f64::max),
            width,
            light,
            radius_arcsec,
        }
    }

    /// Brightness at (solar west, solar north) in arcsec, bilinear between pixels.
    pub fn light(&self, [x, y]: [f64; 2]) -> f64 {
        if x.hypot(y) > self.radius_arcsec {
            return 0.0;
        }
        let px = |arcsec: f64| CENTRE_PX + arcsec * RADIUS_PX / self.radius_arcsec;
        let (x, y) = (px(x), px(y));
        let (column, row) = (x.floor() as usize, y.floor() as usize);
        let (right, up) = (x.fract(), y.fract());
        let at = |dx: usize, dy: usize| self.light[(row + dy) * self.width + column + dx];
        let below = at(0, 0) * (1.0 - right) + at(1, 0) * right;
        let above = at(0, 1) * (1.0 - right) + at(1, 1) * right;
        below * (1.0 - up) + above * up
    }

    /// A random origin of a photon, distributed as the brightness.
    pub fn draw(&self, random: &mut Xoshiro256PlusPlus) -> [f64; 2] {
        loop {
            let r = self.radius_arcsec;
            let place = [(); 2].map(|()| random.random_range(-r..r));
            if random.random_range(0.0..self.brightest) < self.light(place) {
                return place;
            }
        }
    }
}

/// An image of the Sun in the tangent plane at the Sun's centre.
pub struct SunImage {
    pub width: usize,
    pub pixel_arcsec: f64,
    /// Position of the Sun's centre by the header; the first pixel is 0.
    pub centre_px: [f64; 2],
    pub counts: Vec<f64>,
    pub exposure_s: Vec<f64>,
}

/// Registration of an image to the picture from which its photons were drawn.
#[derive(Debug, Clone, Copy)]
pub struct Registered {
    pub shift_arcsec: [f64; 2],
    pub turn_deg: f64,
    pub scale: f64,
    /// Centre of the limb, measured independently of the registration.
    pub limb_centre_arcsec: [f64; 2],
}

impl Registered {
    /// Asserts that the registration is within 0.2 arcsec and 0.02 deg, and the limb's centre within 0.3 arcsec.
    pub fn assert_close(&self) {
        let [shift, limb] = [self.shift_arcsec, self.limb_centre_arcsec].map(|[x, y]| x.hypot(y));
        assert!(shift < 0.2 && limb < 0.3, "{self:?}");
        assert!(self.turn_deg.abs() < 0.02, "{self:?}");
        assert!((self.scale - 1.0).abs() < 2e-4, "{self:?}");
    }
}

/// Brightness scale, shift in x and y (arcsec), rotation (rad) and scale.
type Lie = SVector<f64, 5>;

impl SunImage {
    fn place_arcsec(&self, n: usize) -> [f64; 2] {
        let px = [(n % self.width) as f64, (n / self.width) as f64];
        [0, 1].map(|axis| (px[axis] - self.centre_px[axis]) * self.pixel_arcsec)
    }

    /// Expected counts of a pixel.
    fn expected(&self, picture: &SunPicture, n: usize, lie: &Lie) -> f64 {
        const PARTS: usize = 3;
        let [x, y] = self.place_arcsec(n);
        let (sin, cos) = lie[3].sin_cos();
        let mut light = 0.0;
        for part in 0..PARTS * PARTS {
            let along = |n: usize| ((n as f64 + 0.5) / PARTS as f64 - 0.5) * self.pixel_arcsec;
            let dx = x + along(part % PARTS) - lie[1];
            let dy = y + along(part / PARTS) - lie[2];
            let back = [dx * cos + dy * sin, dy * cos - dx * sin];
            light += picture.light(back.map(|arcsec| arcsec / lie[4]));
        }
        lie[0] * self.exposure_s[n] * light / (PARTS * PARTS) as f64
    }

    /// Registers the image to the picture by weighted least squares of the counts.
    pub fn registered(&self, picture: &SunPicture) -> Registered {
        let seen: Vec<usize> = (0..self.counts.len())
            .filter(|n| self.exposure_s[*n] > 0.0)
            .collect();
        let none = Lie::new(1.0, 0.0, 0.0, 0.0, 1.0);
        let sum = |value: &dyn Fn(usize) -> f64| seen.iter().map(|n| value(*n)).sum::<f64>();
        let light = sum(&|n| self.counts[n]) / sum(&|n| self.expected(picture, n, &none));
        let mut lie = Lie::new(light, 0.0, 0.0, 0.0, 1.0);
        // The limb is sharp, so derivatives are taken over several arcsec.
        let steps = Lie::new(light * 0.01, 2.0, 2.0, 2e-3, 2e-3);
        for _ in 0..6 {
            let mut normal = SMatrix::<f64, 5, 5>::zeros();
            let mut towards = Lie::zeros();
            for n in &seen {
                let expected = self.expected(picture, *n, &lie);
                let slopes = Lie::from_fn(|k, _| {
                    let [after, before] = [1.0, -1.0].map(|sign| {
                        let mut moved = lie;
                        moved[k] += sign * steps[k];
                        self.expected(picture, *n, &moved)
                    });
                    (after - before) / (2.0 * steps[k])
                });
                let weight = 1.0 / (expected + 1.0);
                normal += slopes * slopes.transpose() * weight;
                towards += slopes * (self.counts[*n] - expected) * weight;
            }
            lie += normal.cholesky().unwrap().solve(&towards);
        }
        Registered {
            shift_arcsec: [lie[1], lie[2]],
            turn_deg: lie[3].to_degrees(),
            scale: lie[4],
            limb_centre_arcsec: self.limb_centre_arcsec(picture.radius_arcsec),
        }
    }

    /// The centre of the limb. In each direction, the mean brightness of a ring across the limb, divided by that of a ring inside, gives the
    /// distance by which the disc extends beyond the ring's inner radius.
    fn limb_centre_arcsec(&self, radius_arcsec: f64) -> [f64; 2] {
        const SECTORS: usize = 72;
        const INSIDE: f64 = 30.0;
        const OUTSIDE: f64 = 20.0;
        let mut sums = [[[0.0; 2]; 2]; SECTORS];
        for (n, exposure_s) in self
            .exposure_s
            .iter()
            .enumerate()
            .filter(|(_, s)| **s > 0.0)
        {
            let [x, y] = self.place_arcsec(n);
            let from_limb = x.hypot(y) - radius_arcsec;
            let ring = match from_limb {
                d if (-2.0 * INSIDE..-INSIDE).contains(&d) => 0,
                d if (-INSIDE..OUTSIDE).contains(&d) => 1,
                _ => continue,
            };
            let turn = (y.atan2(x) / std::f64::consts::TAU).rem_euclid(1.0);
            let sums = &mut sums[((turn * SECTORS as f64) as usize).min(SECTORS - 1)][ring];
            sums[0] += self.counts[n] / exposure_s;
            sums[1] += 1.0;
        }
        let mut centre = [0.0; 2];
        for (n, [plateau, edge]) in sums.iter().enumerate() {
            let [inside, across] = [plateau, edge].map(|[light, pixels]| light / pixels);
            let reach = across / inside * (INSIDE + OUTSIDE);
            let angle = (n as f64 + 0.5) / SECTORS as f64 * std::f64::consts::TAU;
            centre[0] += 2.0 / SECTORS as f64 * reach * angle.cos();
            centre[1] += 2.0 / SECTORS as f64 * reach * angle.sin();
        }
        centre
    }
}
