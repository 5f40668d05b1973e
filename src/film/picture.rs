//! A picture of the film: the whole Sun, the surroundings of the target, a strip of text, and the frame beside them.

use super::context::{Context, Words};
use super::panel::{BORESIGHT, INVALID, OLD_PATH, PATH, Panel, TARGET, View};
use super::track::{Point, Track};
use crate::clock::{Utc, utc_text};
use crate::pointing::HelioprojectiveArcsec;
use crate::report::{Canvas, Colour};
use crate::sky::Disc;
use crate::sky::sphere::separation_rad;
use crate::units::{ARCSEC_PER_RAD, SensorPx};
use image::RgbImage;
use image::imageops::{self, FilterType};
use jiff::Timestamp;

/// Side of the square with the Sun, and of the one about the target in its corner.
pub const MAP_PX: u32 = 720;
const INSET_PX: u32 = 240;
/// Width of the picture beside the map.
const FRAME_PX: u32 = 740;
/// Distance from the map's centre to its edge: at least the first number of radii, and up to the extent of the path, but at most the second.
const REACH_RADII: [f64; 2] = [1.2, 3.0];
/// There is an inset if this part of the path is within that part of the map's half side from the target.
const IN_INSET: f64 = 0.9;
const SMALL: f64 = 0.2;
/// Least distance from an inset's centre to its edge.
const LEAST_INSET_ARCSEC: f64 = 5.0;
/// The path of this many pictures is bright.
const RECENT_PICTURES: usize = 20;
/// Lines of text: time, boresight, target, context, legend.
const LINES: u32 = 5;
const LEGEND: [(&str, Colour); 5] = [
    ("boresight", BORESIGHT),
    ("target", TARGET),
    ("path", PATH),
    ("before", OLD_PATH),
    ("not valid", INVALID),
];

/// Elements common to all pictures of a film.
pub struct Layout<'a> {
    pub title: String,
    /// The disc in the middle of the film; so is the target.
    pub disc: Disc,
    pub target: Option<HelioprojectiveArcsec>,
    pub context: Option<&'a Context>,
    /// Description of the context.
    pub words: Words,
    /// Whether a frame is shown beside the map.
    pub shows_frame: bool,
}

/// Time and target of a picture.
pub struct Moment {
    /// Its index in the track.
    pub index: usize,
    pub utc: Timestamp,
    /// Position of the target; else the reason why there is none.
    pub target: Result<HelioprojectiveArcsec, String>,
}

/// Draws the pictures in order.
pub struct Painter<'a> {
    layout: Layout<'a>,
    map: Panel,
    /// The inset, with its upper left corner on the map.
    inset: Option<(Panel, [u32; 2])>,
    /// Number of points of the path drawn permanently on the panels.
    settled: usize,
}

impl<'a> Painter<'a> {
    pub fn new(track: &Track, layout: Layout<'a>) -> Self {
        let panel = |view| Panel::new(view, &layout.disc, layout.context);
        let reach = reach_arcsec(track, &layout.disc);
        let mut map = panel(View::about(HelioprojectiveArcsec::default(), reach, MAP_PX));
        let inset = layout.target.and_then(|target| {
            let reach = inset_reach_arcsec(track, target, reach)?;
            Some((target, View::about(target, reach, INSET_PX)))
        });
        let inset = inset.map(|(target, view)| {
            map.outline(&view, Colour::WHITE);
            let mut inset = panel(view);
            let side_px = INSET_PX - 1;
            inset.outline(&View { side_px, ..view }, Colour::WHITE);
            // In the corner farthest from the target.
            let corner = |is_first| if is_first { 0 } else { MAP_PX - INSET_PX };
            (inset, [corner(target.x > 0.0), corner(target.y < 0.0)])
        });
        let (middle, end) = (f64::from(MAP_PX / 2), f64::from(MAP_PX));
        let mut sign = |x, y, text| map.canvas.label(SensorPx::new(x, y), text, Colour::WHITE);
        sign(middle - 10.0, 20.0, "N");
        sign(end - 22.0, middle + 10.0, "W");
        Self {
            layout,
            map,
            inset,
            settled: 0,
        }
    }

    /// The size of every picture, px.
    pub fn size_px(&self) -> (u32, u32) {
        let width = if self.layout.shows_frame { FRAME_PX } else { 0 };
        (MAP_PX + width, MAP_PX + LINES * Canvas::LINE_PX)
    }

    /// The picture of a moment, with the frame beside it; must be called in the order of time.
    pub fn picture(
        &mut self,
        track: &Track,
        moment: &Moment,
        frame: Option<&RgbImage>,
    ) -> RgbImage {
        let recent = RECENT_PICTURES * track.points_per_picture;
        let settled = moment.index.saturating_sub(recent).max(self.settled);
        let old = &track.points[self.settled..=settled];
        self.map.path(old, OLD_PATH);
        self.inset
            .iter_mut()
            .for_each(|(inset, _)| inset.path(old, OLD_PATH));
        self.settled = settled;
        let path = &track.points[settled..=moment.index];
        let mut whole = RgbImage::new(self.size_px().0, MAP_PX);
        let map = with_path(&self.map, path, moment).into_image();
        imageops::replace(&mut whole, &map, 0, 0);
        if let Some((inset, corner)) = &self.inset {
            let side = inset.view.arcsec_per_px * f64::from(INSET_PX);
            let size = format!("{side:.0} x {side:.0} arcsec");
            let mut canvas = with_path(inset, path, moment);
            let at = SensorPx::new(0.0, f64::from(INSET_PX));
            canvas.label(at, &size, Colour::WHITE);
            let [x, y] = corner.map(i64::from);
            imageops::replace(&mut whole, &canvas.into_image(), x, y);
        }
        let mut canvas = Canvas::of_image(&whole, LINES);
        self.write(&mut canvas, &track.points[moment.index], moment);
        let mut picture = canvas.into_image();
        if let Some(frame) = frame {
            imageops::replace(&mut picture, frame, MAP_PX.into(), 0);
        }
        picture
    }

    /// The strip of text below.
    fn write(&self, canvas: &mut Canvas, now: &Point, moment: &Moment) {
        let utc = Utc {
            time: moment.utc,
            in_leap_second: false,
        };
        let (validity, colour) = match now.invalid {
            None => ("valid".into(), TARGET),
            Some(why) => (format!("not valid: {}", why.name()), BORESIGHT),
        };
        let time = format!("{}   {validity}   {}", utc_text(utc, 2), self.layout.title);
        let at =
            |place: HelioprojectiveArcsec| format!("x {:.1}, y {:.1} arcsec", place.x, place.y);
        let target = moment.target.as_ref();
        let boresight = now.place.map_or("boresight unknown".into(), |place| {
            let off = if self.map.view.holds(place) {
                ""
            } else {
                " (off the map)"
            };
            let apart = target.map_or(String::new(), |target| {
                let apart = separation_rad(&place.direction(), &target.direction());
                format!(", {:.1} from the target", apart * ARCSEC_PER_RAD)
            });
            format!("boresight {}{off}{apart}", at(place))
        });
        let target = match target {
            Ok(target) => format!("target {}", at(*target)),
            Err(why) => format!("no target: {why}"),
        };
        let words = &self.layout.words;
        let context = if words.is_warning {
            Colour::ORANGE
        } else {
            Colour::WHITE
        };
        let lines = [
            (time, colour),
            (boresight, Colour::WHITE),
            (target, Colour::WHITE),
            (words.text.clone(), context),
        ];
        for (line, (text, colour)) in (0..).zip(lines) {
            canvas.caption(line, fitting(&text, MAP_PX), colour);
        }
        canvas.legend(LINES - 1, &LEGEND);
    }

    /// The picture beside the map: a frame's, or the reason why there is none.
    pub fn frame(&self, frame: Result<RgbImage, String>) -> RgbImage {
        let mut place = RgbImage::new(FRAME_PX, self.size_px().1);
        let shown = match frame {
            Ok(frame) => scaled(&frame, place.dimensions()),
            Err(why) => {
                let lines = why.len() as u32 * Canvas::LETTER_PX / FRAME_PX + 1;
                let mut canvas = Canvas::of_image(&RgbImage::new(FRAME_PX, 0), lines);
                let mut rest = why.as_str();
                for line in 0..lines {
                    let text = fitting(rest, FRAME_PX);
                    canvas.caption(line, text, Colour::ORANGE);
                    rest = &rest[text.len()..];
                }
                canvas.into_image()
            }
        };
        imageops::replace(&mut place, &shown, 0, 0);
        place
    }
}

/// A panel with the path, the target and the boresight at a moment.
fn with_path(panel: &Panel, path: &[Point], moment: &Moment) -> Canvas {
    let mut panel = panel.clone();
    panel.path(path, PATH);
    if let Ok(target) = moment.target {
        panel.target(target);
    }
    let now = path.last().and_then(|now| Some((now.place?, now.invalid)));
    if let Some((place, invalid)) = now {
        let colour = if invalid.is_none() {
            BORESIGHT
        } else {
            INVALID
        };
        panel.boresight(place, colour);
    }
    panel.canvas
}

/// Distance from the map's centre to its edge.
fn reach_arcsec(track: &Track, disc: &Disc) -> f64 {
    let farthest = track.valid().map(|place| place.x.hypot(place.y));
    let farthest = farthest.fold(0.0, f64::max);
    let [least, most] = REACH_RADII.map(|radii| radii * disc.radius_arcsec());
    (farthest * 1.05).clamp(least, most)
}

/// Distance from the inset's centre to its edge, if the path is small on the map.
fn inset_reach_arcsec(track: &Track, target: HelioprojectiveArcsec, map: f64) -> Option<f64> {
    let from_target = |place: HelioprojectiveArcsec| (place.x - target.x).hypot(place.y - target.y);
    let mut distances: Vec<f64> = track.valid().map(from_target).collect();
    distances.sort_by(f64::total_cmp);
    let nearly_all = distances.get((distances.len() as f64 * IN_INSET) as usize)?;
    let reach = (1.3 * nearly_all).max(LEAST_INSET_ARCSEC);
    (reach < SMALL * map).then_some(reach)
}

/// The beginning of a text that fits into a line of the strip.
fn fitting(text: &str, width_px: u32) -> &str {
    let letters = (width_px / Canvas::LETTER_PX - 2) as usize;
    let end = text.char_indices().nth(letters);
    end.map_or(text, |(end, _)| &text[..end])
}

/// A picture reduced to fit, but never magnified.
fn scaled(picture: &RgbImage, (width, height): (u32, u32)) -> RgbImage {
    let ratio = |space: u32, side: u32| f64::from(space) / f64::from(side.max(1));
    let scale = ratio(width, picture.width()).min(ratio(height, picture.height()));
    if scale >= 1.0 {
        return picture.clone();
    }
    let side = |px: u32| (f64::from(px) * scale).floor().max(1.0) as u32;
    let (width, height) = (side(picture.width()), side(picture.height()));
    imageops::resize(picture, width, height, FilterType::Triangle)
}
