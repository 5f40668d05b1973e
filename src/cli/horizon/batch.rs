//! Frames of one camera, or of two at a time.

use super::Method;
use super::pair::matched;
use super::record::{InBody, Record};
use crate::cli::frames::{FramesArgs, Outcome, bad_file};
use crate::frame::Frame;
use crate::horizon::circle::{self, Circle, circle};
use crate::horizon::{self, HorizonSettings, Nadir, Solution, Sphere, Stopped};
use crate::instrument::DirectionCamera;
use anyhow::Context;
use nalgebra::{Rotation3, UnitVector3};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A camera, and the sphere for which it searches.
pub(super) struct Mounted {
    pub camera: DirectionCamera,
    pub body_from_camera: Option<Rotation3<f64>>,
    pub sphere: Sphere,
}

/// Inputs for the pairs of two cameras.
pub(super) struct Pair {
    /// Frames of each camera.
    pub frames: [Vec<PathBuf>; 2],
    /// The sphere in the body's frame.
    pub sphere: Sphere,
}

/// Shared inputs of all frames.
pub(super) struct Batch<'a> {
    /// One camera, or the two of a pair.
    pub cameras: Vec<Mounted>,
    pub pair: Option<Pair>,
    pub method: Method,
    pub settings: HorizonSettings,
    pub edge_m: f64,
    pub args: &'a FramesArgs,
}

/// Result for a frame.
enum Found {
    Cone(Box<Solution>),
    Circle(Result<Circle, Stopped>),
}

/// A frame that was solved, with the number of its camera.
struct Solved {
    camera: usize,
    found: Found,
    record: Record,
}

impl Batch<'_> {
    /// Passes on the answer for every frame, in order.
    pub fn solve(
        &self,
        track: bool,
        mut take: impl FnMut(Outcome<Record>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        match &self.pair {
            Some(Pair { frames, sphere }) => {
                let moments = matched(frames.each_ref().map(Vec::as_slice));
                let solve = |moment: &[Option<PathBuf>; 2]| self.solve_moment(moment, sphere);
                let take =
                    |results: Vec<Outcome<Record>>| results.into_iter().try_for_each(&mut take);
                self.args.in_order(&moments, solve, take)
            }
            None if track => {
                let mut last = None;
                self.args.frames.iter().try_for_each(|path| {
                    let solved = self.solve_file(path, 0, last.as_ref());
                    last = solved.as_ref().ok().and_then(Solved::nadir).or(last);
                    take(outcome(path, solved))
                })
            }
            None => {
                let solve = |path: &PathBuf| outcome(path, self.solve_file(path, 0, None));
                self.args.in_order(&self.args.frames, solve, take)
            }
        }
    }

    /// Solves the frames of two cameras at one moment, each by itself, and determines the body's attitude from both.
    fn solve_moment(&self, paths: &[Option<PathBuf>; 2], sphere: &Sphere) -> Vec<Outcome<Record>> {
        let each = paths.iter().zip(0..);
        let mut solved: Vec<(&Path, anyhow::Result<Solved>)> = each
            .filter_map(|(path, camera)| Some((path.as_deref()?, camera)))
            .map(|(path, camera)| (path, self.solve_file(path, camera, None)))
            .collect();
        let mut seen: Vec<&mut Solved> = solved
            .iter_mut()
            .filter_map(|(_, s)| s.as_mut().ok())
            .collect();
        self.join(&mut seen, sphere);
        solved
            .into_iter()
            .map(|(path, solved)| outcome(path, solved))
            .collect()
    }

    /// Replaces the body's attitude from each of two cameras by that from both.
    fn join(&self, seen: &mut [&mut Solved], sphere: &Sphere) {
        let turn = |solved: &Solved| self.cameras[solved.camera].body_from_camera;
        let body = match self.method {
            Method::Cone => {
                let solutions: Vec<(&Solution, Rotation3<f64>)> = seen
                    .iter()
                    .filter_map(|solved| Some((solved.solution()?, turn(solved)?)))
                    .filter(|(solution, _)| solution.nadir.is_ok())
                    .collect();
                if solutions.len() < 2 {
                    return;
                }
                let nadir = horizon::joint(&self.settings, sphere, &solutions);
                nadir.ok().map(|nadir| InBody::of(&nadir.direction))
            }
            Method::Circle => {
                let circles: Vec<(&Circle, Rotation3<f64>)> = seen
                    .iter()
                    .filter_map(|solved| Some((solved.circle()?, turn(solved)?)))
                    .collect();
                let [one, other] = circles[..] else {
                    return;
                };
                let vertical = circle::vertical([one, other]);
                vertical.map(|unit| InBody::of_circles(&unit))
            }
        };
        for solved in seen {
            solved.record.join(body.as_ref());
        }
    }

    fn solve_file(
        &self,
        path: &Path,
        camera: usize,
        last: Option<&UnitVector3<f64>>,
    ) -> anyhow::Result<Solved> {
        let Mounted {
            camera: optics,
            sphere,
            body_from_camera,
            ..
        } = &self.cameras[camera];
        let frame = self.args.read(path, Some(optics.size_px()))?;
        let size = optics.check(&frame);
        size.with_context(|| path.display().to_string())?;
        let start = Instant::now();
        let found = self.find(&frame, optics, sphere, last);
        let time = start.elapsed();
        let name = path.display().to_string();
        let mut record = match &found {
            Found::Cone(solution) => Record::of(&name, solution, sphere, time),
            Found::Circle(circle) => {
                let edge_m = sphere.viewpoint.map(|_| self.edge_m);
                Record::of_circle(&name, circle, edge_m, time)
            }
        };
        let direction = match &found {
            Found::Cone(solution) => solution.nadir.as_ref().ok().map(|nadir| nadir.direction),
            Found::Circle(_) => None,
        };
        if let (Some(direction), Some(turn)) = (direction, body_from_camera) {
            record.body = InBody::of(&direction.turned(turn));
        }
        self.args.draw(path, |title| match &found {
            Found::Cone(solution) => horizon::overlay(&frame, solution, optics, sphere, title),
            Found::Circle(found) => {
                horizon::overlay_of_circle(&frame, found.as_ref(), optics, title)
            }
        })?;
        Ok(Solved {
            camera,
            found,
            record,
        })
    }

    fn find(
        &self,
        frame: &Frame,
        camera: &DirectionCamera,
        sphere: &Sphere,
        last: Option<&UnitVector3<f64>>,
    ) -> Found {
        match self.method {
            Method::Cone => {
                let solution = horizon::solve(&self.settings, frame, camera, sphere, last);
                Found::Cone(Box::new(solution))
            }
            Method::Circle => Found::Circle(circle(&self.settings, frame, camera, sphere)),
        }
    }
}

impl Solved {
    fn solution(&self) -> Option<&Solution> {
        match &self.found {
            Found::Cone(solution) => Some(solution),
            Found::Circle(_) => None,
        }
    }

    fn circle(&self) -> Option<&Circle> {
        match &self.found {
            Found::Cone(_) => None,
            Found::Circle(circle) => circle.as_ref().ok(),
        }
    }

    fn nadir(&self) -> Option<UnitVector3<f64>> {
        let nadir: &Nadir = self.solution()?.nadir.as_ref().ok()?;
        Some(nadir.direction.unit)
    }
}

fn outcome(path: &Path, solved: anyhow::Result<Solved>) -> Outcome<Record> {
    match solved {
        Ok(solved) => Ok(solved.record),
        Err(error) => bad_file(path, &error),
    }
}
