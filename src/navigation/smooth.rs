//! The attitude at each sample of the IMU from all measurements of the flight: the smoother of Rauch, Tung and Striebel
//! (1965).
//!
//! It runs on a filter that estimates all states: a smoother needs the correlation between the errors of successive
//! instants, and in a Schmidt-Kalman filter this is not given by the transition alone.

use super::estimate::Estimate;
use super::motion::Motion;
use super::run::{Begun, Flight, Phase, Run, Stop};
use super::solve::{NavigationRow, row};
use super::states::{ATTITUDE, Choice, Layout, MOTION, POSITION, VELOCITY};
use super::transition::Transition;
use crate::estimation::{ScaledRoot, symmetrise};
use nalgebra::{DMatrix, DVector, Matrix3};
use std::sync::Arc;

/// Number of measurements between stored states of the run; in between the run is repeated, which needs less memory than
/// storing all states.
const BLOCK: usize = 256;

/// State of the filter at measurements.
struct Node {
    /// Estimates before and after the measurements.
    predicted: Estimate,
    estimate: Estimate,
    covariance: DMatrix<f64>,
    /// Transition of all errors from the previous measurements; `None` if the filter restarted.
    transition: Option<Transition>,
}

/// State of the filter at a sample of the IMU.
struct Sample {
    row: NavigationRow,
    /// Transition since the last measurement.
    since: Transition,
}

enum Entry {
    Node(Box<Node>),
    Sample(Box<Sample>),
}

/// Smoothed estimate of a node.
struct Smoothed {
    estimate: Estimate,
    covariance: DMatrix<f64>,
}

/// Smooths a flight: returns the rows from the last to the first. `None` if a covariance is not positive definite.
pub fn smooth(flight: &Flight, mut each: impl FnMut(NavigationRow)) -> Option<()> {
    let model = flight.model(Choice::AllEstimated);
    let layout = &model.layout;
    let mut kept = vec![Run::new(Arc::clone(&model))];
    let mut run = kept[0].clone();
    let mut nodes = 0;
    while let Some(stop) = run.step(flight, &mut |_| {}) {
        if let Stop::Node(_) = stop {
            nodes += 1;
            if nodes % BLOCK == 0 {
                kept.push(run.clone());
            }
        }
    }
    let mut later = None;
    let mut backwards = Backwards {
        layout,
        later: None,
    };
    for start in kept.into_iter().rev() {
        let entries = entries(flight, start.clone(), later.as_ref());
        backwards.go(&entries, &mut each)?;
        later = Some(start);
    }
    Some(())
}

/// Transitions of the run from one stored state up to and including the next.
fn entries(flight: &Flight, mut run: Run, until: Option<&Run>) -> Vec<Entry> {
    let mut entries = Vec::new();
    if let Phase::Running(filter) = &run.phase {
        // Of the node at which the run was stored, only the input for the following node is needed.
        entries.push(Entry::Node(Box::new(Node {
            predicted: filter.estimate.clone(),
            estimate: filter.estimate.clone(),
            covariance: filter.covariance.clone(),
            transition: None,
        })));
    }
    loop {
        let before = run.clone();
        if until.is_some_and(|until| before.is_at(until)) {
            return entries;
        }
        let Some(stop) = run.step(flight, &mut |_| {}) else {
            return entries;
        };
        match stop {
            Stop::Sample(_) => entries.push(sample(&run)),
            Stop::Node(begun) => entries.extend(node(flight, &before, &run, begun)),
        }
    }
}

fn sample(run: &Run) -> Entry {
    let since = match &run.phase {
        Phase::Running(filter) => filter.since,
        Phase::Waiting(_) => Transition::none(),
    };
    Entry::Sample(Box::new(Sample {
        row: row(run, run.at_s),
        since,
    }))
}

fn node(flight: &Flight, before: &Run, after: &Run, begun: Begun) -> Option<Entry> {
    let Phase::Running(filter) = &after.phase else {
        return None;
    };
    let arrived = before.carried_to(flight, after.at_s);
    let arrived = arrived.filter(|_| begun == Begun::Before);
    Some(Entry::Node(Box::new(Node {
        predicted: match &arrived {
            Some(arrived) => arrived.estimate.clone(),
            None => filter.estimate.clone(),
        },
        estimate: filter.estimate.clone(),
        covariance: filter.covariance.clone(),
        transition: arrived.map(|arrived| Transition {
            opened: after.opened,
            ..arrived.since
        }),
    })))
}

/// The backward pass through a flight.
struct Backwards<'a> {
    layout: &'a Layout,
    /// The previously processed, later node, with its smoothed estimate.
    later: Option<(Later, Smoothed)>,
}

/// Values of a node that earlier nodes need.
struct Later {
    predicted: Estimate,
    transition: Option<Transition>,
}

impl Later {
    fn of(node: &Node) -> Self {
        Self {
            predicted: node.predicted.clone(),
            transition: node.transition,
        }
    }
}

impl Backwards<'_> {
    /// Processes entries backwards: the samples of each node follow it.
    fn go(&mut self, entries: &[Entry], each: &mut impl FnMut(NavigationRow)) -> Option<()> {
        // A block ends with the first node of the following block, which is already smoothed.
        let entries = match (&mut self.later, entries.split_last()) {
            (Some((later, _)), Some((Entry::Node(node), before))) => {
                *later = Later::of(node);
                before
            }
            _ => entries,
        };
        let mut end = entries.len();
        for (at, entry) in entries.iter().enumerate().rev() {
            if let Entry::Node(node) = entry {
                self.pass(node, &entries[at + 1..end], each)?;
                end = at;
            }
        }
        // Before the first node the filter was waiting.
        let rest = entries[..end].iter().rev();
        rest.for_each(|entry| {
            if let Entry::Sample(sample) = entry {
                each(sample.row);
            }
        });
        Some(())
    }

    fn pass(
        &mut self,
        node: &Node,
        samples: &[Entry],
        each: &mut impl FnMut(NavigationRow),
    ) -> Option<()> {
        let step = self.later.as_ref().and_then(|(later, smoothed)| {
            let transition = later.transition.as_ref()?;
            Step::new(self.layout, node, transition, later, smoothed)
        });
        for entry in samples.iter().rev() {
            let Entry::Sample(sample) = entry else {
                continue;
            };
            let smoothed = step.as_ref().and_then(|step| step.sample(node, sample));
            each(smoothed.unwrap_or(sample.row));
        }
        let smoothed = match &step {
            Some(step) => step.node(node),
            None => Smoothed {
                estimate: node.estimate.clone(),
                covariance: node.covariance.clone(),
            },
        };
        self.later = Some((Later::of(node), smoothed));
        Some(())
    }
}

/// The step from a node to the next one, whose smoothed state is known.
struct Step<'a> {
    layout: &'a Layout,
    transition: &'a Transition,
    matrix: DMatrix<f64>,
    noise: DMatrix<f64>,
    later: &'a Smoothed,
    predicted: DMatrix<f64>,
    root: ScaledRoot,
    /// The inverse of the predicted covariance times the innovation.
    gradient: DVector<f64>,
}

impl<'a> Step<'a> {
    fn new(
        layout: &'a Layout,
        node: &Node,
        transition: &'a Transition,
        later: &Later,
        smoothed: &'a Smoothed,
    ) -> Option<Self> {
        let (matrix, noise) = transition.whole(layout);
        let predicted = transition.predicted(layout, &node.covariance);
        let root = ScaledRoot::of(&predicted)?;
        let learnt = smoothed.estimate.minus(&later.predicted, layout);
        let learnt = DMatrix::from_column_slice(learnt.len(), 1, learnt.as_slice());
        let gradient = root.solve(&learnt).column(0).into_owned();
        Some(Self {
            layout,
            transition,
            matrix,
            noise,
            later: smoothed,
            predicted,
            root,
            gradient,
        })
    }

    fn node(&self, node: &Node) -> Smoothed {
        let across = &node.covariance * self.matrix.transpose();
        let gain = self.root.solve(&across.transpose()).transpose();
        let mut estimate = node.estimate.clone();
        estimate.correct(&(&across * &self.gradient), self.layout);
        // The form of a sum of squares stays positive even if the noise exceeds the covariance by many orders of magnitude.
        let n = self.layout.len();
        let kept = DMatrix::identity(n, n) - &gain * &self.matrix;
        let noisy = &self.later.covariance + &self.noise;
        let mut covariance =
            &kept * &node.covariance * kept.transpose() + &gain * noisy * gain.transpose();
        symmetrise(&mut covariance);
        Smoothed {
            estimate,
            covariance,
        }
    }

    /// The row of a sample between the nodes.
    fn sample(&self, node: &Node, sample: &Sample) -> Option<NavigationRow> {
        let (motion, covariance) = sample.row.attitude?;
        let rest = self.transition.since(&sample.since)?;
        let now = sample.since.predicted(self.layout, &node.covariance);
        let across = now.rows(0, MOTION) * rest.whole(self.layout).0.transpose();
        let moved = &across * &self.gradient;
        let part = |first: usize| moved.fixed_rows::<3>(first).into_owned();
        let motion: Motion = motion.corrected(&part(POSITION), &part(VELOCITY), &part(ATTITUDE));
        let across = across.rows(ATTITUDE, 3).transpose();
        let gain = self.root.solve(&across.clone_owned());
        let learnt = &self.later.covariance - &self.predicted;
        let added = gain.transpose() * learnt * &gain;
        let added: Matrix3<f64> = added.fixed_view::<3, 3>(0, 0).into_owned();
        Some(NavigationRow {
            attitude: Some((motion, covariance + added)),
            ..sample.row
        })
    }
}
