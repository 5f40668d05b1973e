//! The world coordinates of a solar image: conversion from a pixel to a position relative to the Sun's centre, and back.
//!
//! The image is a gnomonic projection (TAN) of helioprojective longitude and latitude about its reference point (Calabretta and Greisen
//! 2002, A&A 395, 1077; Thompson 2006, A&A 449, 791). Missing keywords have the defaults of FITS 4.0.

use crate::fits::{Header, Problem};
use crate::pointing::HelioprojectiveArcsec;
use crate::sky::sphere::tangents;
use crate::units::ARCSEC_PER_RAD;
use nalgebra::{Matrix2, Matrix3, Vector2};

/// CTYPE of each axis, without blanks and dashes: by the standard, and by older usage.
const TYPES: [[&str; 2]; 2] = [["HPLNTAN", "SOLARX"], ["HPLTTAN", "SOLARY"]];
const EXPECTED_TYPES: [&str; 2] = [
    "'HPLN-TAN' or 'SOLARX' of a solar image",
    "'HPLT-TAN' or 'SOLARY' of a solar image",
];

/// Position on the Sun of each pixel of an image. Pixel (0, 0) is the centre of the first, in the lowest row of the picture; y increases
/// upwards.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldCoordinates {
    reference_px: Vector2<f64>,
    /// Conversion from pixels to the plane of projection, rad, and back.
    to_plane: Matrix2<f64>,
    to_pixels: Matrix2<f64>,
    /// The plane's axes: to the reference point, to increasing longitude (west) and latitude (north) there.
    axes: Matrix3<f64>,
}

impl WorldCoordinates {
    /// From the keywords of an image.
    ///
    /// # Errors
    /// The first keyword that is missing or states coordinates other than helioprojective ones.
    pub fn read(header: &Header) -> Result<Self, Problem> {
        let rad = [axis_unit_rad(header, 0)?, axis_unit_rad(header, 1)?];
        let turned = header.number("LONPOLE")?.filter(|deg| *deg != 180.0);
        if let Some(found) = turned {
            return Err(Problem::field("LONPOLE", "180 deg", found));
        }
        let needed = |keyword: &str| match header.number(keyword)? {
            Some(number) => Ok(number),
            None => Err(Problem::field(keyword, "a number", "nothing")),
        };
        let value = HelioprojectiveArcsec {
            x: needed("CRVAL1")? * rad[0] * ARCSEC_PER_RAD,
            y: needed("CRVAL2")? * rad[1] * ARCSEC_PER_RAD,
        };
        let to_plane = Matrix2::from_diagonal(&rad.into()) * steps(header)?;
        let to_pixels = to_plane.try_inverse();
        let reference = value.direction();
        let (north, west) = tangents(&reference);
        Ok(Self {
            reference_px: Vector2::new(needed("CRPIX1")? - 1.0, needed("CRPIX2")? - 1.0),
            to_plane,
            to_pixels: to_pixels.ok_or_else(|| {
                Problem::field("CDELTi, PCi_j, CDi_j", "steps in two directions", "others")
            })?,
            axes: Matrix3::from_columns(&[reference, west, north]),
        })
    }

    /// The position of a pixel.
    pub fn place(&self, pixel: Vector2<f64>) -> HelioprojectiveArcsec {
        let plane = self.to_plane * (pixel - self.reference_px);
        let direction = self.axes * plane.insert_row(0, 1.0);
        HelioprojectiveArcsec::of_direction(&direction.normalize())
    }

    /// The pixel of a position; `None` if it is behind the observer.
    pub fn pixel(&self, place: HelioprojectiveArcsec) -> Option<Vector2<f64>> {
        let direction = self.axes.tr_mul(&place.direction());
        let plane = direction.yz() / direction.x;
        (direction.x > 0.0).then(|| self.reference_px + self.to_pixels * plane)
    }

    /// The size of a pixel at the reference point.
    pub fn arcsec_per_px(&self) -> f64 {
        self.to_plane.determinant().abs().sqrt() * ARCSEC_PER_RAD
    }
}

/// The unit of an axis, rad, if its type is helioprojective.
fn axis_unit_rad(header: &Header, axis: usize) -> Result<f64, Problem> {
    let keyword = format!("CTYPE{}", axis + 1);
    let stated = header.text(&keyword)?;
    let plain = |text: &String| text.to_uppercase().replace([' ', '-', '_'], "");
    let kind = stated.as_ref().map(plain);
    let kind = kind.and_then(|kind| TYPES[axis].iter().position(|known| *known == kind));
    let Some(kind) = kind else {
        let found = stated.map_or("nothing".into(), |text| format!("'{text}'"));
        return Err(Problem::field(keyword, EXPECTED_TYPES[axis], found));
    };
    let keyword = format!("CUNIT{}", axis + 1);
    let unit = header.text(&keyword)?;
    match unit.as_deref().map(str::trim) {
        Some("arcsec") => Ok(1.0 / ARCSEC_PER_RAD),
        Some("deg") => Ok(1f64.to_radians()),
        // Images with the older names use arcsec.
        None if kind == 1 => Ok(1.0 / ARCSEC_PER_RAD),
        other => {
            let found = other.map_or("nothing".into(), |text| format!("'{text}'"));
            Err(Problem::field(keyword, "'arcsec' or 'deg'", found))
        }
    }
}

/// Conversion from pixels to the axes' own units: CDi_j; else CDELTi, rotated by PCi_j or CROTA2.
fn steps(header: &Header) -> Result<Matrix2<f64>, Problem> {
    if let Some(steps) = matrix(header, "CD", Matrix2::zeros())? {
        return Ok(steps);
    }
    let step = |keyword: &str| match header.number(keyword)? {
        Some(number) if number != 0.0 => Ok(number),
        Some(number) => Err(Problem::field(keyword, "a step that is not 0", number)),
        None => Err(Problem::field(keyword, "a number, or CDi_j", "nothing")),
    };
    let (x, y) = (step("CDELT1")?, step("CDELT2")?);
    if let Some(turn) = matrix(header, "PC", Matrix2::identity())? {
        return Ok(Matrix2::from_diagonal(&Vector2::new(x, y)) * turn);
    }
    let turn_deg = header.number("CROTA2")?.unwrap_or(0.0);
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    Ok(Matrix2::new(x * cos, -y * sin, x * sin, y * cos))
}

/// The elements of a matrix, missing ones from `other`; `None` if all are missing.
fn matrix(
    header: &Header,
    name: &str,
    other: Matrix2<f64>,
) -> Result<Option<Matrix2<f64>>, Problem> {
    let (mut matrix, mut is_stated) = (other, false);
    for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        if let Some(number) = header.number(&format!("{name}{}_{}", i + 1, j + 1))? {
            matrix[(i, j)] = number;
            is_stated = true;
        }
    }
    Ok(is_stated.then_some(matrix))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fits::FitsFile;
    use std::path::Path;

    /// The header of an empty image with these cards.
    fn header(cards: &[(&str, &str)]) -> Header {
        let image = ["SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2"];
        let image = image.into_iter().zip(["T", "8", "2", "1", "1"]);
        let mut text = String::new();
        for (keyword, value) in image.chain(cards.iter().copied()) {
            text += &format!("{:<80}", format!("{keyword:<8}= {value:>20}"));
        }
        text += &format!("{:<80}", "END");
        let mut bytes = text.into_bytes();
        bytes.resize(2880, b' ');
        bytes.resize(5760, 0);
        let file = FitsFile::of(Path::new("map.fits"), bytes).unwrap();
        file.keywords().unwrap()
    }

    const SDO: [(&str, &str); 9] = [
        ("CTYPE1", "'HPLN-TAN'"),
        ("CTYPE2", "'HPLT-TAN'"),
        ("CUNIT1", "'arcsec'"),
        ("CUNIT2", "'arcsec'"),
        ("CRPIX1", "2042.6"),
        ("CRPIX2", "2049.9"),
        ("CRVAL1", "0.0"),
        ("CRVAL2", "0.0"),
        ("CDELT1", "0.504"),
    ];

    fn with<'a>(more: &[(&'a str, &'a str)]) -> Vec<(&'a str, &'a str)> {
        let others = SDO
            .iter()
            .filter(|(name, _)| more.iter().all(|(n, _)| n != name));
        others.chain(more).copied().collect()
    }

    /// Pixels, counted from 0, with their positions by astropy 8.0.2's `WCS.wcs_pix2world`, arcsec.
    type Places = [([f64; 2], [f64; 2]); 3];

    #[track_caller]
    fn check(more: &[(&str, &str)], places: Places) {
        let world = WorldCoordinates::read(&header(&with(more))).unwrap();
        for (pixel, [x, y]) in places {
            let place = world.place(pixel.into());
            let off = (place.x - x).hypot(place.y - y);
            assert!(off < 1e-6, "{place:?}");
            let back = world.pixel(place).unwrap() - Vector2::from(pixel);
            assert!(back.norm() < 1e-6, "{back}");
        }
    }

    #[test]
    fn pixels_lie_where_astropy_puts_them_however_the_header_says_it() {
        check(
            &[("CDELT2", "0.504"), ("CROTA2", "179.93")],
            [
                ([0.0, 0.0], [1030.2186795081411, 1031.3662498188855]),
                ([700.0, 33.0], [677.404754412521, 1015.173077162856]),
                ([4000.0, 3000.0], [-987.610957823108, -478.1418161595896]),
            ],
        );
        let tilted = [
            ("CUNIT1", "'deg'"),
            ("CUNIT2", "'deg'"),
            ("CRPIX1", "100.5"),
            ("CRPIX2", "80.0"),
            ("CRVAL1", "0.12"),
            ("CRVAL2", "-0.2"),
            ("CDELT1", "0.0007"),
            ("CDELT2", "0.0008"),
            ("PC1_1", "0.96"),
            ("PC1_2", "-0.25"),
            ("PC2_1", "0.3"),
            ("PC2_2", "0.97"),
        ];
        check(
            &tilted,
            [
                ([0.0, 0.0], [241.05750032156266, -1026.6617341602603]),
                ([700.0, 33.0], [1913.6833534533707, -329.6655601679025]),
                ([4000.0, 3000.0], [8022.995055344177, 10790.852024794944]),
            ],
        );
        let sheared = [
            ("CRPIX1", "512.0"),
            ("CRPIX2", "512.0"),
            ("CRVAL1", "-300.0"),
            ("CRVAL2", "450.0"),
            ("CD1_1", "2.1"),
            ("CD1_2", "0.4"),
            ("CD2_1", "-0.4"),
            ("CD2_2", "2.2"),
        ];
        check(
            &sheared,
            [
                ([0.0, 0.0], [-1577.4742778984205, -469.7848931000145]),
                ([700.0, 33.0], [-94.30203107453963, -677.18844247126]),
                ([4000.0, 3000.0], [8018.366407494841, 4525.986096279118]),
            ],
        );
    }

    #[test]
    fn the_older_names_are_those_of_the_same_axes() {
        let names = [("CTYPE1", "'SOLAR-X '"), ("CTYPE2", "'solar_y'")];
        let cards = with(&[("CDELT2", "0.504"), names[0], names[1]]);
        let of = |cards: &[(&str, &str)]| WorldCoordinates::read(&header(cards)).unwrap();
        let standard = of(&with(&[("CDELT2", "0.504")]));
        assert_eq!(of(&cards), standard);
        let without = cards.iter().filter(|(name, _)| !name.starts_with("CUNIT"));
        assert_eq!(of(&without.copied().collect::<Vec<_>>()), standard);
    }

    #[test]
    fn other_coordinates_are_refused_by_their_keyword() {
        let step = ("CDELT2", "0.504");
        for (card, found) in [
            (
                ("CTYPE1", "'RA---TAN'"),
                "CTYPE1: expected 'HPLN-TAN' or 'SOLARX' of a solar image, found 'RA---TAN'",
            ),
            (("CTYPE2", "'HPLN-TAN'"), "CTYPE2: expected 'HPLT-TAN'"),
            (
                ("CUNIT1", "'pix'"),
                "CUNIT1: expected 'arcsec' or 'deg', found 'pix'",
            ),
            (
                ("CRPIX2", "'middle'"),
                "CRPIX2: expected a finite number, found 'middle'",
            ),
            (
                ("CDELT1", "0.0"),
                "CDELT1: expected a step that is not 0, found 0",
            ),
            (("LONPOLE", "90.0"), "LONPOLE: expected 180 deg, found 90"),
        ] {
            let error = WorldCoordinates::read(&header(&with(&[step, card])));
            let error = error.unwrap_err().to_string();
            assert!(error.contains(found), "{error}");
        }
        let error = WorldCoordinates::read(&header(&SDO))
            .unwrap_err()
            .to_string();
        assert_eq!(error, "CDELT2: expected a number, or CDi_j, found nothing");
        let error = WorldCoordinates::read(&header(&[]))
            .unwrap_err()
            .to_string();
        assert!(
            error.ends_with("of a solar image, found nothing"),
            "{error}"
        );
    }
}
