//! Finding the disc: sparse chords over the whole frame, and a circle that most crossings agree on.

use super::{Crossing, Scan, Settings};
use crate::frame::{Frame, Levels, Region};
use crate::geometry::Circle;
use crate::units::{Rejected, SensorPx};
use crate::with_view;
use nalgebra::Vector2;

/// The disc as the sparse chords see it, to a pixel or so.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseDisc {
    pub centre: SensorPx,
    pub radius_px: f64,
}

impl CoarseDisc {
    pub fn circle(&self) -> Circle {
        Circle {
            centre: self.centre.vector(),
            radius: self.radius_px,
        }
    }
}

/// Distance from the circle within which a crossing agrees with it, px.
const AGREEMENT_PX: f64 = 2.0;
/// Circles that are tried.
const TRIALS: usize = 400;

/// Finds the disc in a region of the frame, whole or in part.
///
/// `radius_px` is the expected radius, `mark_length_px` a mark from tip to tip.
pub fn find_disc(
    frame: &Frame,
    region: Region,
    levels: &Levels,
    radius_px: f64,
    mark_length_px: f64,
    settings: &Settings,
) -> Result<CoarseDisc, Rejected> {
    let scan = Scan::new(
        levels.threshold_dn(settings.level_fraction),
        mark_length_px,
        settings,
    );
    let spacing = settings.search_spacing_px.max(1);
    let lines = |size: usize| (spacing / 2..size).step_by(spacing);
    let crossings = with_view!(frame, view => {
        scan.run(&view, region, lines(frame.height()), lines(frame.width()))
    });
    let enough = settings.min_crossings;
    if crossings.len() < enough {
        return Err(Rejected {
            reason: "too few chords cross a limb",
            measured: crossings.len() as f64,
            limit: enough as f64,
        });
    }
    let (circle, agreeing) = best_circle(&crossings, radius_px, settings);
    match circle {
        Some(circle) if agreeing >= enough => {
            check_filled(frame, &circle, scan.threshold_dn)?;
            Ok(CoarseDisc {
                centre: circle.centre.into(),
                radius_px: circle.radius,
            })
        }
        _ => Err(Rejected {
            reason: "too few crossings lie on a circle of the Sun's size",
            measured: agreeing as f64,
            limit: enough as f64,
        }),
    }
}

/// A disc is bright within and dark about: a circle of noise, or one drawn through anything else, is neither.
fn check_filled(frame: &Frame, circle: &Circle, threshold_dn: f32) -> Result<(), Rejected> {
    const STEP_PX: usize = 5;
    const LEAST_RIGHT: f64 = 0.8;
    let reach = 1.25 * circle.radius;
    let region = Region::around(circle.centre.into(), reach, frame.width(), frame.height());
    let Some(region) = region else {
        return Err(Rejected {
            reason: "the disc is not on the sensor",
            measured: 0.0,
            limit: LEAST_RIGHT,
        });
    };
    let (mut judged, mut right) = (0_usize, 0_usize);
    with_view!(frame, view => {
        for y in (region.y0..region.y1).step_by(STEP_PX) {
            for x in (region.x0..region.x1).step_by(STEP_PX) {
                let out = circle.excess(Vector2::new(x as f64, y as f64)) / circle.radius;
                if out < -0.05 || (0.05..0.25).contains(&out) {
                    judged += 1;
                    right += usize::from((view.dn(x, y) > threshold_dn) == (out < 0.0));
                }
            }
        }
    });
    let share = right as f64 / judged.max(1) as f64;
    if share < LEAST_RIGHT {
        return Err(Rejected {
            reason: "the disc is not bright within and dark about",
            measured: share,
            limit: LEAST_RIGHT,
        });
    }
    Ok(())
}

/// The circle of nearly the expected radius that most crossings agree on, and how many do. Circles through three
/// crossings serve when much of the limb is seen, circles of the expected radius through two when little is. The
/// choice of crossings is a fixed sequence: the same frame always gives the same disc.
fn best_circle(
    crossings: &[Crossing],
    radius_px: f64,
    settings: &Settings,
) -> (Option<Circle>, usize) {
    let mut pick = Sequence::new(crossings.len());
    let mut best = (None, 0, f64::INFINITY);
    for trial in 0..TRIALS {
        let points: [Crossing; 3] = std::array::from_fn(|_| crossings[pick.next_index()]);
        let candidate = if trial % 2 == 0 {
            let [a, b, c] = points.map(|crossing| crossing.at.vector());
            Circle::through(a, b, c)
        } else {
            of_radius_through(&points[0], &points[1], radius_px)
        };
        let Some(circle) = candidate else { continue };
        let deviation = (circle.radius / radius_px - 1.0).abs();
        if deviation > settings.max_radius_deviation {
            continue;
        }
        let (agreeing, cost) = agreement(crossings, &circle);
        if cost < best.2 {
            best = (Some(circle), agreeing, cost);
        }
    }
    (best.0, best.1)
}

/// How many crossings lie on a circle with their bright side inwards, and a cost that the best circle minimises.
fn agreement(crossings: &[Crossing], circle: &Circle) -> (usize, f64) {
    let mut agreeing = 0;
    let mut cost = 0.0;
    for crossing in crossings {
        let excess = circle.excess(crossing.at.vector()).abs();
        let inward = (circle.centre - crossing.at.vector()).dot(&crossing.inward()) > 0.0;
        if excess < AGREEMENT_PX && inward {
            agreeing += 1;
            cost += excess * excess;
        } else {
            cost += AGREEMENT_PX * AGREEMENT_PX;
        }
    }
    (agreeing, cost)
}

/// The circle of a given radius through two crossings whose centre lies on their bright side.
fn of_radius_through(a: &Crossing, b: &Crossing, radius: f64) -> Option<Circle> {
    let (pa, pb) = (a.at.vector(), b.at.vector());
    let half = (pb - pa) / 2.0;
    let height = (radius.powi(2) - half.norm_squared()).max(0.0).sqrt();
    let across = Vector2::new(-half.y, half.x).try_normalize(1e-9)?;
    let inward = a.inward() + b.inward();
    let side = if across.dot(&inward) >= 0.0 {
        1.0
    } else {
        -1.0
    };
    (half.norm() <= radius).then(|| Circle {
        centre: pa + half + across * (side * height),
        radius,
    })
}

/// A fixed pseudo-random sequence of indices (Marsaglia's xorshift64).
struct Sequence {
    state: u64,
    len: usize,
}

impl Sequence {
    fn new(len: usize) -> Self {
        Self {
            state: 0x9E37_79B9_7F4A_7C15,
            len,
        }
    }

    fn next_index(&mut self) -> usize {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        ((self.state >> 16) % self.len as u64) as usize
    }
}
