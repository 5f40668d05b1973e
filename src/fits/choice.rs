//! Choice of the picture that is read from a file.

use super::header::Header;
use super::structure::{Content, Hdu, MAX_SIDE};
use super::{MAX_PIXELS, Problem};
use crate::frame::Warning;

/// A width and a height, px.
pub(super) type Size = [usize; 2];

/// An HDU's picture, or the first of several in it.
pub(super) struct Shape {
    pub size: Size,
    pub planes: usize,
}

impl Shape {
    /// Axes of length one do not count. `None` if it is no picture.
    fn of(hdu: &Hdu) -> Option<Self> {
        let prefix = match hdu.content() {
            Content::Image => "",
            Content::CompressedImage => "Z",
            Content::Other => return None,
        };
        let whole = |keyword: String| hdu.header.integer(&keyword).ok().flatten();
        let axes = whole(format!("{prefix}NAXIS"))?;
        let sides = (1..=axes.min(999)).map(|n| whole(format!("{prefix}NAXIS{n}")));
        let sides: Vec<usize> = sides
            .map(|side| usize::try_from(side?).ok())
            .collect::<Option<_>>()?;
        let counting = sides.iter().copied().filter(|side| *side != 1);
        let counting: Vec<usize> = counting.collect();
        match (counting.as_slice(), sides.as_slice()) {
            ([width, height, planes @ ..], _) | ([_] | [], [width, height, planes @ ..]) => {
                Some(Self {
                    size: [*width, *height],
                    planes: planes.iter().fold(1, |all, n| all.saturating_mul(*n)),
                })
            }
            _ => None,
        }
    }
}

/// The picture that is read.
pub(super) struct Chosen<'a> {
    pub hdu: &'a Hdu,
    /// Keywords of its HDU and, where these lack one, of the primary HDU.
    pub header: Header,
    pub shape: Shape,
    /// Warning of other pictures in the file.
    pub left_out: Option<Warning>,
}

/// The first picture of the wanted size, else the first.
pub(super) fn choose(hdus: &[Hdu], wanted: Option<Size>) -> Result<Chosen<'_>, Problem> {
    let first = hdus.first().map(|hdu| &hdu.header);
    if first.and_then(|header| header.get("SIMPLE")) != Some(&true.into()) {
        return Err(Problem::field("SIMPLE", "T", "something else"));
    }
    let shapes = hdus.iter().map(Shape::of).enumerate();
    let mut pictures: Vec<(usize, Shape)> =
        shapes.filter_map(|(n, shape)| Some((n, shape?))).collect();
    let all: usize = pictures
        .iter()
        .fold(0, |all, (_, shape)| shape.planes.saturating_add(all));
    if pictures.is_empty() {
        let axes = |hdu: &Hdu| match hdu.content() {
            Content::Image => hdu.header.integer("NAXIS").ok().flatten(),
            Content::CompressedImage => hdu.header.integer("ZNAXIS").ok().flatten(),
            Content::Other => None,
        };
        return Err(match hdus.iter().find_map(axes) {
            Some(axes) => {
                Problem::field("NAXIS", "an image with 2 axes, each with its length", axes)
            }
            None => Problem::content("an image in a FITS file", "none in any of its HDUs"),
        });
    }
    let is_wanted = |(_, shape): &(usize, Shape)| Some(shape.size) == wanted;
    let (n, shape) = pictures.swap_remove(pictures.iter().position(is_wanted).unwrap_or(0));
    let [width, height] = shape.size;
    let left_out = (all > 1).then(|| {
        let found = format!("{all}; read the first of {width} x {height} pixels, in HDU {n}");
        Warning::new("file", "one picture", found)
    });
    Ok(Chosen {
        hdu: &hdus[n],
        header: hdus[n].header.over(&hdus[0].header),
        shape,
        left_out,
    })
}

/// The size of a picture; an error if it is too large.
pub(super) fn checked_size(shape: &Shape, prefix: &str) -> Result<Size, Problem> {
    let [width, height] = shape.size;
    for (n, side) in [(1, width), (2, height)] {
        if !(1..=MAX_SIDE as usize).contains(&side) {
            let expected = format!("a whole number from 1 to {MAX_SIDE}");
            return Err(Problem::field(format!("{prefix}NAXIS{n}"), expected, side));
        }
    }
    if (width * height) as u64 > MAX_PIXELS {
        let field = format!("{prefix}NAXISn");
        let expected = format!("at most {MAX_PIXELS} pixels");
        return Err(Problem::field(
            field,
            expected,
            format!("{width} x {height}"),
        ));
    }
    Ok(shape.size)
}
