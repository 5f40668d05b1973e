//! Positions of marks during the design.

use super::{DesignError, DesignSettings, Generator};
use crate::geometry::unit;
use crate::instrument::{Instrument, SMALLEST_SUN_ARCSEC};
use crate::plate::{LEAST_APART_SIZES, MOST_MARKS, MarkId, MarkPlace, Pattern, Plate};
use crate::units::PlateMil;
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::{PI, TAU};

/// Minimum distance of marks in their size: more than the minimum of a plate.
const APART_SIZES: f64 = 1.1 * LEAST_APART_SIZES;
/// Largest displacement of a mark from its lattice node, in the lattice's spacing.
const JITTER: f64 = 0.28;

/// Positions of marks, and the lattice that they come from.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// Lattice node and position of each mark.
    marks: Vec<(Vector2<f64>, Vector2<f64>)>,
    spacing_mil: f64,
    /// Marks within this distance of the Sun's centre are fully lit.
    lit_mil: f64,
    least_apart_mil: f64,
    field_mil: f64,
    marks_in_view: usize,
}

impl Layout {
    pub fn no_space(instrument: &Instrument, settings: &DesignSettings) -> DesignError {
        DesignError::NoSpace {
            marks_in_view: settings.marks_in_view,
            size_mil: settings.shape.size_mil(),
            radius_mil: instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC),
        }
    }

    /// The layout of the widest lattice that gives every position of the Sun in the field enough marks, without superfluous
    /// marks.
    pub fn widest(
        instrument: &Instrument,
        settings: &DesignSettings,
        rng: &mut Generator,
    ) -> Result<Self, DesignError> {
        /// Margin between a fully lit mark and the limb, px.
        const BLUR_PX: f64 = 3.0;
        const STEPS: usize = 60;
        /// Ratio of the spacings of successive lattices.
        const NARROWER: f64 = 0.97;
        let size_mil = settings.shape.size_mil();
        let blur_mil = BLUR_PX * instrument.mounting.scale_mil_per_px.value;
        let sun_mil = instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC);
        let mut layout = Self {
            marks: Vec::new(),
            spacing_mil: sun_mil,
            lit_mil: sun_mil - size_mil / 2.0 - blur_mil,
            least_apart_mil: APART_SIZES * size_mil,
            field_mil: settings.field_mil,
            marks_in_view: settings.marks_in_view,
        };
        for _ in 0..STEPS {
            // Some of them will be removed as superfluous.
            layout.check_count(layout.expected_count() / 1.5)?;
            layout.fill(rng);
            // Marks so close to each other could not be displaced.
            if layout.spacing_mil * (1.0 - JITTER) < layout.least_apart_mil {
                break;
            }
            if layout.are_apart() && layout.least_in_view() >= settings.marks_in_view {
                layout.prune(settings.least_marks);
                layout.check_count(layout.marks.len() as f64)?;
                return Ok(layout);
            }
            layout.spacing_mil *= NARROWER;
        }
        Err(Self::no_space(instrument, settings))
    }

    fn expected_count(&self) -> f64 {
        let reach_mil = self.field_mil + self.lit_mil;
        PI * reach_mil.powi(2) / (self.spacing_mil.powi(2) * 0.75_f64.sqrt())
    }

    fn check_count(&self, count: f64) -> Result<(), DesignError> {
        match count > MOST_MARKS as f64 {
            true => Err(DesignError::TooMany {
                count,
                field_mil: self.field_mil,
            }),
            false => Ok(()),
        }
    }

    /// Puts marks on the lattice, each randomly displaced.
    fn fill(&mut self, rng: &mut Generator) {
        let reach = self.field_mil + self.lit_mil;
        let rows = (reach / (self.spacing_mil * 0.75_f64.sqrt())).ceil() as i32 + 1;
        let columns = (reach / self.spacing_mil).ceil() as i32 + 1;
        self.marks.clear();
        for row in -rows..=rows {
            for column in -columns..=columns {
                let shift = if row % 2 == 0 { 0.0 } else { 0.5 };
                let (x, y) = (f64::from(column) + shift, f64::from(row) * 0.75_f64.sqrt());
                let node = Vector2::new(x, y) * self.spacing_mil;
                if node.norm() < reach {
                    let at = self.apart_about(node, rng);
                    self.marks.push((node, at));
                }
            }
        }
    }

    /// A position near a node, apart from the marks so far; the node itself if none is found in a few tries.
    fn apart_about(&self, node: Vector2<f64>, rng: &mut Generator) -> Vector2<f64> {
        const TRIES: usize = 20;
        for _ in 0..TRIES {
            let at = self.about(node, rng);
            if self.is_apart(at, &self.marks) {
                return at;
            }
        }
        node
    }

    fn about(&self, node: Vector2<f64>, rng: &mut Generator) -> Vector2<f64> {
        let distance = JITTER * self.spacing_mil * rng.random_range(0.0_f64..1.0).sqrt();
        node + unit(rng.random_range(0.0..TAU)) * distance
    }

    fn are_apart(&self) -> bool {
        let mut marks = self.marks.iter().enumerate();
        marks.all(|(n, (_, at))| self.is_apart(*at, &self.marks[..n]))
    }

    fn is_apart(&self, at: Vector2<f64>, others: &[(Vector2<f64>, Vector2<f64>)]) -> bool {
        let mut others = others.iter();
        others.all(|(_, other)| (other - at).norm() > self.least_apart_mil)
    }

    /// Positions of the Sun all over the field, closer than the marks.
    fn suns(&self) -> Vec<Vector2<f64>> {
        let step = self.spacing_mil / 5.0;
        let count = (self.field_mil / step).ceil() as i32;
        let along = move || (-count..=count).map(move |n| f64::from(n) * step);
        let all = along().flat_map(|x| along().map(move |y| Vector2::new(x, y)));
        // Includes the edge itself.
        let edge = (0..360).map(|n| unit(f64::from(n).to_radians()) * self.field_mil);
        all.filter(|at| at.norm() < self.field_mil)
            .chain(edge)
            .collect()
    }

    fn lit(&self, sun: &Vector2<f64>) -> usize {
        let near = |(_, at): &&(Vector2<f64>, Vector2<f64>)| (at - sun).norm() < self.lit_mil;
        self.marks.iter().filter(near).count()
    }

    fn least_in_view(&self) -> usize {
        self.suns()
            .iter()
            .map(|sun| self.lit(sun))
            .min()
            .unwrap_or(0)
    }

    /// Removes marks, the outermost first, if every position keeps the requested number without them, while more than
    /// `least` remain.
    fn prune(&mut self, least: usize) {
        let mut left = self.marks.len();
        let suns = self.suns();
        let mut lit: Vec<usize> = suns.iter().map(|sun| self.lit(sun)).collect();
        self.marks.sort_by(|a, b| b.1.norm().total_cmp(&a.1.norm()));
        let mut kept = Vec::new();
        for mark in std::mem::take(&mut self.marks) {
            let near = |n: &usize| (mark.1 - suns[*n]).norm() < self.lit_mil;
            let near: Vec<usize> = (0..suns.len()).filter(near).collect();
            // Removes all marks that are lit from no position.
            if left > least && near.iter().all(|n| lit[*n] > self.marks_in_view) {
                left -= 1;
                near.iter().for_each(|n| lit[*n] -= 1);
            } else {
                kept.push(mark);
            }
        }
        self.marks = kept;
    }

    /// The layout with one mark in view of a position displaced again, and the mark's positions before and after; `None` if
    /// the marks would be too close or too few somewhere.
    pub fn displaced(
        &self,
        sun: PlateMil,
        rng: &mut Generator,
    ) -> Option<(Self, [Vector2<f64>; 2])> {
        let near = |n: &usize| (self.marks[*n].1 - sun.vector()).norm() < self.lit_mil;
        let near: Vec<usize> = (0..self.marks.len()).filter(near).collect();
        if near.is_empty() {
            return None;
        }
        let chosen = near[rng.random_range(0..near.len())];
        let mut changed = self.clone();
        let (node, before) = self.marks[chosen];
        let at = self.about(node, rng);
        changed.marks[chosen].1 = at;
        let (before_it, after_it) = (&self.marks[..chosen], &self.marks[chosen + 1..]);
        let is_apart = self.is_apart(at, before_it) && self.is_apart(at, after_it);
        let suits = is_apart && changed.least_in_view() >= self.marks_in_view;
        suits.then_some((changed, [before, at]))
    }

    /// The instrument with this plate.
    pub fn instrument(&self, instrument: &Instrument, settings: &DesignSettings) -> Instrument {
        let sigma_mil = instrument.plate.drawing_sigma_mil();
        let mut places: Vec<Vector2<f64>> = self.marks.iter().map(|(_, at)| *at).collect();
        places.sort_by(|a, b| {
            (a.y, a.x)
                .partial_cmp(&(b.y, b.x))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        // The plate is made as it was checked: rounded to 0.001 mil.
        let rounded = |v: f64| (v * 1e3).round() / 1e3;
        let mark = |(i, at): (i32, Vector2<f64>)| {
            let at = PlateMil::new(rounded(at.x), rounded(at.y));
            (MarkId { i, j: 0 }, MarkPlace::new(at, sigma_mil))
        };
        let marks = (1..).zip(places).map(mark);
        let mut plate = Plate::new(Pattern::Table, settings.shape, sigma_mil, marks);
        plate.field_radius_mil = settings.field_mil;
        Instrument {
            plate,
            ..instrument.clone()
        }
    }
}
