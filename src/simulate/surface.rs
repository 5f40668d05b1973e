//! The Sun's surface in HMI's picture, relative to a linear limb darkening.
//!
//! The limb remains that of the disc: exactly at its true place. Only the part of the picture within 0.98 radii is used; places farther out
//! repeat the value at that radius in the same direction.

use super::scene::{LIMB_DARKENING, Surface};
use image::ImageFormat;
use nalgebra::{Rotation2, Vector2};
use std::sync::OnceLock;

/// A square around the Sun's centre, cut from `tests/data/hmi/continuum.fits` by `tools/hmi/face.py`; the README there
/// states source and licence.
const PICTURE: &[u8] = include_bytes!("hmi.png");
/// Radius of the Sun in the picture, px.
const RADIUS_PX: f64 = 202.910;
/// Radius, in solar radii, beyond which the picture's own limb begins, blurred and with ringing.
const REACH: f64 = 0.98;

/// A surface with its orientation on the disc.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texture {
    picture: &'static Picture,
    /// Transformation from radii on the disc to radii in the picture.
    turn: nalgebra::Matrix2<f32>,
}

/// The picture's light relative to that of the linear limb darkening of [`Sun::new`](super::scene::Sun::new).
#[derive(Debug)]
struct Picture {
    side: usize,
    relative: Vec<f32>,
}

impl Texture {
    /// `None` for a plain surface.
    pub(super) fn of(surface: &Surface) -> Option<Self> {
        let Surface::Hmi { turn_rad, mirrored } = surface else {
            return None;
        };
        let mut turn = Rotation2::new(*turn_rad).into_inner();
        if *mirrored {
            turn.row_mut(0).neg_mut();
        }
        Some(Self {
            picture: picture()?,
            turn: turn.cast(),
        })
    }

    /// Factor on the light of a plain disc, at a place in radii from its centre.
    pub(super) fn at(&self, place: Vector2<f32>) -> f32 {
        let reach = REACH as f32;
        let within = place * (reach / place.norm().max(reach));
        let middle = (self.picture.side as f32 - 1.0) / 2.0;
        let at = (self.turn * within) * RADIUS_PX as f32 + Vector2::repeat(middle);
        self.picture.between(at)
    }
}

impl Picture {
    /// Bilinear interpolation between the four pixels around a place within the disc.
    fn between(&self, at: Vector2<f32>) -> f32 {
        let last = self.side as f32 - 1.001;
        let (x, y) = (at.x.clamp(0.0, last), at.y.clamp(0.0, last));
        let (column, row) = (x as usize, y as usize);
        let (right, down) = (x - column as f32, y - row as f32);
        let start = row * self.side + column;
        let [a, b] = [start, start + self.side].map(|n| {
            let (left, next) = (self.relative[n], self.relative[n + 1]);
            left + right * (next - left)
        });
        a + down * (b - a)
    }
}

/// The picture, decoded once; it is never `None`, which a test checks.
fn picture() -> Option<&'static Picture> {
    static DECODED: OnceLock<Option<Picture>> = OnceLock::new();
    DECODED.get_or_init(decoded).as_ref()
}

fn decoded() -> Option<Picture> {
    let image = image::load_from_memory_with_format(PICTURE, ImageFormat::Png).ok()?;
    let image = image.into_luma8();
    let side = image.width() as usize;
    let middle = (side as f64 - 1.0) / 2.0;
    let places = (0..side * side).map(|n| {
        let offset = Vector2::new((n % side) as f64 - middle, (n / side) as f64 - middle);
        offset.norm() / RADIUS_PX
    });
    let relative: Vec<f32> = places
        .zip(image.into_raw())
        .map(|(radii, dn)| {
            let cosine = (1.0 - radii * radii).max(0.0).sqrt();
            (f64::from(dn) / (1.0 - LIMB_DARKENING * (1.0 - cosine))) as f32
        })
        .collect();
    let (sum, count) = near_middle(&relative, side);
    let bright = sum / count;
    Some(Picture {
        side,
        relative: relative.into_iter().map(|r| r / bright).collect(),
    })
}

/// Sum and number of the pixels within 0.1 radii.
fn near_middle(values: &[f32], side: usize) -> (f32, f32) {
    let reach = (0.1 * RADIUS_PX) as usize;
    let middle = side / 2;
    let near = middle - reach..middle + reach;
    let rows = near.clone().map(|row| &values[row * side..][near.clone()]);
    rows.flatten()
        .fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0))
}
