//! The pixels of the sky in which photons are counted.

use crate::archive::Helioprojection;
use crate::fits::Problem;
use crate::units::{ARCSEC_PER_RAD, SensorPx};
use nalgebra::{Matrix2, Vector3};

/// The largest side of an image, px.
const MOST_PX: f64 = 4096.0;

/// Field of an image: a rectangle along solar west and north.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// Position relative to the Sun's centre, to solar west and north.
    pub centre_arcsec: [f64; 2],
    /// Width and height.
    pub size_arcsec: [f64; 2],
}

impl Default for Field {
    /// The Sun with a margin of a quarter of its radius.
    fn default() -> Self {
        Self {
            centre_arcsec: [0.0; 2],
            size_arcsec: [2400.0; 2],
        }
    }
}

/// Square pixels in the tangent plane of the sky at the Sun's centre, counted from 0; rows run to solar west, and the next row is to the north.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    pub pixel_arcsec: f64,
    pub width_px: usize,
    pub height_px: usize,
    /// Position of the Sun's centre; the first pixel has its centre at 0.
    sun_px: [f64; 2],
}

impl Grid {
    /// # Errors
    /// If the field has too many pixels, or none.
    pub fn new(pixel_arcsec: f64, field: &Field) -> Result<Self, Problem> {
        let size_px = field.size_arcsec.map(|size| (size / pixel_arcsec).ceil());
        let [width, height] = size_px;
        if !size_px.iter().all(|size| (1.0..=MOST_PX).contains(size)) {
            let expected = format!("1 to {MOST_PX} px a side: a larger pixel, or a smaller field");
            return Err(Problem::field(
                "size of the image",
                expected,
                format!("{width} x {height} px"),
            ));
        }
        let [x, y] = field.centre_arcsec.map(|centre| centre / pixel_arcsec);
        Ok(Self {
            pixel_arcsec,
            width_px: width as usize,
            height_px: height as usize,
            sun_px: [(width - 1.0) / 2.0 - x, (height - 1.0) / 2.0 - y],
        })
    }

    /// Position of a direction in the axes about the Sun, px; `None` behind the observer.
    pub fn place_px(&self, towards: &Vector3<f64>) -> Option<[f64; 2]> {
        let scale = ARCSEC_PER_RAD / self.pixel_arcsec / towards.x;
        let [x, y] = self.sun_px;
        (towards.x > 0.0).then_some([x + towards.y * scale, y + towards.z * scale])
    }

    /// The index of the pixel at a position, row by row.
    pub fn pixel(&self, place_px: [f64; 2]) -> Option<usize> {
        let [column, row] = place_px.map(|along| (along + 0.5).floor());
        let is_inside = (0.0..self.width_px as f64).contains(&column)
            && (0.0..self.height_px as f64).contains(&row);
        is_inside.then(|| row as usize * self.width_px + column as usize)
    }

    pub fn pixels(&self) -> usize {
        self.width_px * self.height_px
    }

    pub fn coordinates(&self) -> Helioprojection {
        Helioprojection {
            centre_px: SensorPx::new(self.sun_px[0], self.sun_px[1]),
            arcsec_per_px: Matrix2::from_diagonal_element(self.pixel_arcsec),
        }
    }
}
