//! The part of the sensor that a picture shows, and its orientation.

use super::values::Values;
use crate::frame::{Pixels, Warning};

/// Position and orientation of a picture on the sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Section {
    /// Column and row of the sensor at the first pixel, if the file states them.
    pub corner_px: Option<(usize, usize)>,
    /// Whether columns and rows run opposite to those of the sensor.
    pub reversed: [bool; 2],
}

impl Section {
    /// Reads the position of a picture of this size.
    pub fn read(values: &mut Values, size: [usize; 2]) -> Self {
        let corner = |values: &mut Values, keywords: [&str; 2]| {
            let [x, y] = keywords.map(|keyword| values.whole(keyword));
            let corner_px = x.zip(y).map(|(x, y)| (x as usize, y as usize))?;
            Some(Self {
                corner_px: Some(corner_px),
                reversed: [false; 2],
            })
        };
        let mut section = corner(values, ["CORNER-X", "CORNER-Y"])
            .or_else(|| corner(values, ["XORGSUBF", "YORGSUBF"]))
            .or_else(|| section(values, "DETSEC", size))
            .or_else(|| section(values, "CCDSEC", size))
            .unwrap_or_default();
        if !values.header.contains("ROWORDER") {
            return section;
        }
        let order = values.text("ROWORDER").unwrap_or_default();
        match order.trim().to_ascii_uppercase().as_str() {
            "TOP-DOWN" => {}
            "BOTTOM-UP" => section.reversed[1] = !section.reversed[1],
            _ => {
                let expected = "'TOP-DOWN' or 'BOTTOM-UP'";
                values.warn(Warning::new("ROWORDER", expected, format!("'{order}'")));
            }
        }
        section
    }

    /// The picture in the orientation of the sensor.
    pub fn upright(self, pixels: Pixels, unusable: Vec<bool>, width: usize) -> (Pixels, Vec<bool>) {
        if self.reversed == [false; 2] {
            return (pixels, unusable);
        }
        let pixels = match pixels {
            Pixels::U8(pixels) => Pixels::U8(self.turned(pixels, width)),
            Pixels::U16(pixels) => Pixels::U16(self.turned(pixels, width)),
        };
        (pixels, self.turned(unusable, width))
    }

    fn turned<T: Copy>(self, mut pixels: Vec<T>, width: usize) -> Vec<T> {
        let [columns, rows] = self.reversed;
        if columns {
            pixels.chunks_exact_mut(width).for_each(<[T]>::reverse);
        }
        match rows {
            true => pixels.rchunks_exact(width).flatten().copied().collect(),
            false => pixels,
        }
    }
}

/// A section of the sensor in NOAO's notation: "[x0:x1,y0:y1]", counted from 1, both ends included, opposite to the direction of
/// reading if the second is less than the first.
fn section(values: &mut Values, keyword: &str, size: [usize; 2]) -> Option<Section> {
    let text = values.text(keyword)?;
    let found = parse(&text).filter(|ends| {
        let lengths = ends.map(|[first, last]| first.abs_diff(last) + 1);
        lengths == size
    });
    let Some(ends) = found else {
        let expected = "a section [x0:x1,y0:y1] of the picture's size";
        values.warn(Warning::new(keyword, expected, format!("'{text}'")));
        return None;
    };
    let [x, y] = ends.map(|[first, last]| first.min(last) - 1);
    Some(Section {
        corner_px: Some((x, y)),
        reversed: ends.map(|[first, last]| last < first),
    })
}

fn parse(text: &str) -> Option<[[usize; 2]; 2]> {
    let (x, y) = text
        .trim()
        .strip_prefix('[')?
        .strip_suffix(']')?
        .split_once(',')?;
    let ends = |text: &str| {
        let (first, last) = text.split_once(':')?;
        let number = |text: &str| text.trim().parse().ok().filter(|n: &usize| *n >= 1);
        Some([number(first)?, number(last)?])
    };
    Some([ends(x)?, ends(y)?])
}
