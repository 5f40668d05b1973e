//! The least squares: which mounting, and in a drift scan which pointing, puts the Sun where it was seen.

use super::chain::{Chain, Side};
use super::observation::{MountingError, SunObservation};
use super::scatter::{TOLD, advantage, correlation, extra_variance, plain, sizes, tukey};
use super::start::{Start, start};
use crate::calibrate::frames::RejectedFrame;
use crate::instrument::Instrument;
use crate::pointing::{self, Horizontal};
use crate::sky::SunPosition;
use crate::units::{Measured, PlateMil};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// What is known of where the telescope pointed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pointings {
    /// Every sight has its own.
    Known,
    /// One direction for all, unknown: a drift scan.
    Fixed,
}

/// What is fitted, by its place among the unknowns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// Boresight on the plate, mil.
    CentreX,
    CentreY,
    /// deg.
    Clocking,
    /// mm.
    Distance,
    /// The fixed telescope's direction, deg.
    Azimuth,
    Elevation,
}

/// So little is known beforehand, 1 sigma about the start: it only keeps apart what the sights do not.
const CENTRE_PRIOR_MIL: f64 = 500.0;
const LEAST_CENTRE_PRIOR_MIL: f64 = 0.1;
const CLOCKING_PRIOR_DEG: f64 = 180.0;
const DISTANCE_PRIOR: f64 = 0.1;
const POINTING_PRIOR_DEG: f64 = 10.0;

/// Sights farther off than this do not take part: of good ones, one in 800.
const MOST_SIGMAS: f64 = 3.66;
const START_ROUNDS: usize = 4;
const ROBUST_STEPS: usize = 15;
const LAST_STEPS: usize = 10;
/// A sight's part in a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    pub file: std::path::PathBuf,
    pub utc: jiff::Timestamp,
    /// Where the Sun was seen.
    pub at: PlateMil,
    /// Seen minus fitted, mil.
    pub off: Vector2<f64>,
    /// 1 sigma per axis that was taken, mil.
    pub sigma_mil: f64,
    /// Whether it took part.
    pub accepted: bool,
}

/// A mounting fitted to sights.
#[derive(Debug, Clone)]
pub struct Fit {
    pub pointings: Pointings,
    pub chain: Chain,
    /// The fitted unknowns in the order of [`Unknown`]; those of the pointing only in a drift scan.
    pub values: DVector<f64>,
    pub covariance: DMatrix<f64>,
    pub residuals: Vec<Residual>,
    /// Scatter of the accepted sights per axis, rms.
    pub scatter_mil: f64,
    /// By how much the variances grew because neighbouring sights scatter alike; 1 where they do not.
    pub correlation: f64,
}

impl Fit {
    /// An unknown with its sigma; `None` for a pointing that was not fitted.
    pub fn measured(&self, unknown: Unknown) -> Option<Measured> {
        let n = unknown as usize;
        let value = *self.values.get(n)?;
        Some(Measured::new(
            value,
            self.covariance[(n, n)].max(0.0).sqrt(),
        ))
    }

    pub fn accepted(&self) -> usize {
        self.residuals.iter().filter(|r| r.accepted).count()
    }

    /// The frames whose observation does not take part.
    pub(super) fn rejected(&self) -> Vec<RejectedFrame> {
        let far = self.residuals.iter().filter(|r| !r.accepted);
        far.map(|r| {
            let (off, sigmas) = (r.off.norm(), r.off.norm() / r.sigma_mil);
            let reason =
                format!("the Sun is {off:.2} mil ({sigmas:.1} sigma) from where the others put it");
            RejectedFrame::new(&r.file, reason)
        })
        .collect()
    }
}

/// Fits the mounting of an instrument to sights by the chain of the pointing; by the other where the sights tell it apart and
/// suit that better.
pub(super) fn fit(
    sights: &[SunObservation],
    pointings: Pointings,
    stated: &Instrument,
    side: Side,
) -> Result<Fit, MountingError> {
    let by = |chain| {
        let model = Model {
            sights,
            pointings,
            stated,
            side,
            chain,
        };
        model.fit()
    };
    match (by(Chain::AtSun), by(Chain::AtTelescope)) {
        (Ok(at_sun), Ok(rigid)) if advantage(&rigid, &at_sun) > TOLD => Ok(rigid),
        (Err(_), Ok(rigid)) => Ok(rigid),
        (at_sun, _) => at_sun,
    }
}

/// The chain of the pointing with the sights that it has to explain.
struct Model<'a> {
    sights: &'a [SunObservation],
    pointings: Pointings,
    stated: &'a Instrument,
    side: Side,
    chain: Chain,
}

impl Model<'_> {
    fn fit(&self) -> Result<Fit, MountingError> {
        let undetermined = || MountingError::NoAgreement {
            found_mil: f64::INFINITY,
            limit_mil: 200.0,
            instead: "check times, place and pointings",
        };
        let first = self.first().ok_or_else(undetermined)?;
        let mut values = first.clone();
        for _ in 0..ROBUST_STEPS {
            let (residuals, variances) = self.weighed(&values, None);
            let weights = tukey(&residuals, &variances);
            values += self
                .step(&values, &first, &residuals, &weights)
                .ok_or_else(undetermined)?
                .0;
        }
        let (residuals, variances) = self.weighed(&values, None);
        let accepted: Vec<bool> = sizes(&residuals, &variances)
            .map(|u| u < MOST_SIGMAS)
            .collect();
        let mut covariance = DMatrix::zeros(values.len(), values.len());
        for _ in 0..LAST_STEPS {
            let (residuals, variances) = self.weighed(&values, Some(&accepted));
            let weights = plain(&variances, &accepted);
            let (step, inverse) = self
                .step(&values, &first, &residuals, &weights)
                .ok_or_else(undetermined)?;
            values += step;
            covariance = inverse;
        }
        Ok(self.conclude(values, covariance, &accepted))
    }

    /// A first mounting, and in a drift scan the pointing that goes with the stated centre.
    fn first(&self) -> Option<DVector<f64>> {
        let model = (self.chain, self.side);
        if self.pointings == Pointings::Known {
            let known = |sight: &SunObservation| sight.pointing.unwrap_or(at_sun(&sight.sun));
            let start = start(self.sights, known, self.stated, model)?;
            let [clocking, distance] = self.turned(&start);
            let shift = start.shift;
            return Some(DVector::from_vec(vec![
                shift.x, shift.y, clocking, distance,
            ]));
        }
        let centre = self.stated.mounting.boresight_mil;
        let mut towards = at_sun(&self.sights.get(self.sights.len() / 2)?.sun);
        let mut values = DVector::zeros(6);
        // The nearer the assumed direction, the more the chain is a similarity.
        for _ in 0..START_ROUNDS {
            let start = start(self.sights, |_| towards, self.stated, model)?;
            let [clocking, distance] = self.turned(&start);
            values = DVector::from_vec(vec![centre.x, centre.y, clocking, distance]);
            let best = &self.sights[start.best];
            let seen = best.sun_plate.position.vector() - centre.vector();
            let front = centre.vector() + self.side.seen(seen);
            towards = pointing::pointing(front.into(), &self.instrument(&values), &best.sun);
        }
        let pointing = [towards.azimuth_deg, towards.elevation_deg];
        Some(DVector::from_iterator(
            6,
            values.iter().copied().chain(pointing),
        ))
    }

    /// Clocking, within half a turn of the stated one, and distance of a start.
    fn turned(&self, start: &Start) -> [f64; 2] {
        let turn_deg = match self.side {
            Side::Front => start.turn_deg,
            Side::Back => -start.turn_deg,
        };
        let near = self.stated.mounting.clocking_deg.value;
        let clocking = near + (turn_deg - near + 180.0).rem_euclid(360.0) - 180.0;
        [
            clocking,
            self.stated.optics.plate_distance_mm.value * start.stretch,
        ]
    }

    /// The stated instrument with the fitted mounting.
    fn instrument(&self, values: &DVector<f64>) -> Instrument {
        let mut instrument = self.stated.clone();
        instrument.mounting.boresight_mil = PlateMil::new(values[0], values[1]);
        instrument.mounting.clocking_deg.value = values[2];
        instrument.optics.plate_distance_mm.value = values[3];
        instrument
    }

    /// Where every sight's Sun should stand, mil; far away where the chain gives no answer.
    fn expected(&self, values: &DVector<f64>) -> Vec<Vector2<f64>> {
        const NOWHERE_MIL: f64 = 1e6;
        let instrument = self.instrument(values);
        let centre = instrument.mounting.boresight_mil.vector();
        let fixed = (values.len() > 4).then(|| Horizontal {
            azimuth_deg: values[4],
            elevation_deg: values[5],
        });
        let expected = |sight: &SunObservation| {
            let towards = fixed.or(sight.pointing)?;
            let shift = self.chain.shift(towards, &instrument, &sight.sun)?;
            Some(centre + self.side.seen(shift))
        };
        let nowhere = Vector2::new(NOWHERE_MIL, NOWHERE_MIL);
        self.sights
            .iter()
            .map(|s| expected(s).unwrap_or(nowhere))
            .collect()
    }

    /// Residuals (seen minus expected, mil) and the variance per axis of each sight, mil^2: its own, and what those that
    /// take part scatter beyond it.
    fn weighed(
        &self,
        values: &DVector<f64>,
        accepted: Option<&[bool]>,
    ) -> (Vec<Vector2<f64>>, Vec<f64>) {
        let expected = self.expected(values);
        let seen = self.sights.iter().map(|s| s.sun_plate.position.vector());
        let residuals: Vec<_> = seen.zip(&expected).map(|(seen, e)| seen - e).collect();
        let own: Vec<f64> = self
            .sights
            .iter()
            .map(|s| s.sun_plate.covariance.trace() / 2.0)
            .collect();
        let extra = extra_variance(&residuals, &own, accepted);
        (residuals, own.iter().map(|v| v + extra).collect())
    }

    /// The step to better values by weighted least squares, and the covariance there.
    fn step(
        &self,
        values: &DVector<f64>,
        first: &DVector<f64>,
        residuals: &[Vector2<f64>],
        weights: &[f64],
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let slopes = self.slopes(values);
        let known = self.known(first);
        let mut information = DMatrix::from_diagonal(&known);
        let mut right = known.component_mul(&(first - values));
        for (n, residual) in residuals
            .iter()
            .enumerate()
            .filter(|(n, _)| weights[*n] > 0.0)
        {
            let weight = weights[n];
            for (a, by_a) in slopes.iter().enumerate() {
                right[a] += weight * by_a[n].dot(residual);
                for (b, by_b) in slopes.iter().enumerate() {
                    information[(a, b)] += weight * by_a[n].dot(&by_b[n]);
                }
            }
        }
        let cholesky = information.cholesky()?;
        let step = cholesky.solve(&right);
        step.iter()
            .all(|v| v.is_finite())
            .then(|| (step, cholesky.inverse()))
    }

    /// How the expected places change with each unknown.
    fn slopes(&self, values: &DVector<f64>) -> Vec<Vec<Vector2<f64>>> {
        const STEPS: [f64; 6] = [0.1, 0.1, 1e-3, 0.1, 1e-4, 1e-4];
        let slope = |n: usize| {
            let moved = |by: f64| {
                let mut moved = values.clone();
                moved[n] += by;
                self.expected(&moved)
            };
            let (plus, minus) = (moved(STEPS[n]), moved(-STEPS[n]));
            let difference = plus.iter().zip(&minus);
            difference
                .map(|(p, m)| (p - m) / (2.0 * STEPS[n]))
                .collect()
        };
        (0..values.len()).map(slope).collect()
    }

    /// What is known beforehand of each unknown, 1 / variance.
    fn known(&self, first: &DVector<f64>) -> DVector<f64> {
        // A rigid plate's scan tells nothing of the centre, which the clocking leans on.
        let centre_mil = match (self.pointings, self.chain) {
            (Pointings::Fixed, Chain::AtTelescope) => self
                .stated
                .mounting
                .boresight_sigma_mil
                .max(LEAST_CENTRE_PRIOR_MIL),
            _ => CENTRE_PRIOR_MIL,
        };
        let sigmas = [
            centre_mil,
            centre_mil,
            CLOCKING_PRIOR_DEG,
            DISTANCE_PRIOR * first[3],
            POINTING_PRIOR_DEG
                / first
                    .get(5)
                    .map_or(1.0, |el| el.to_radians().cos().max(1e-3)),
            POINTING_PRIOR_DEG,
        ];
        DVector::from_fn(first.len(), |n, _| sigmas[n].powi(-2))
    }

    fn conclude(&self, values: DVector<f64>, covariance: DMatrix<f64>, accepted: &[bool]) -> Fit {
        let (residuals, variances) = self.weighed(&values, Some(accepted));
        let mut residuals: Vec<Residual> = (0..self.sights.len())
            .map(|n| Residual {
                file: self.sights[n].file.clone(),
                utc: self.sights[n].utc,
                at: self.sights[n].sun_plate.position,
                off: residuals[n],
                sigma_mil: variances[n].sqrt(),
                accepted: accepted[n],
            })
            .collect();
        residuals.sort_by_key(|r| r.utc);
        let taken: Vec<&Residual> = residuals.iter().filter(|r| r.accepted).collect();
        let squares: f64 = taken.iter().map(|r| r.off.norm_squared()).sum();
        let scatter_mil = (squares / (2 * taken.len()).max(1) as f64).sqrt();
        let correlation = correlation(&taken);
        Fit {
            pointings: self.pointings,
            chain: self.chain,
            values,
            covariance: covariance * correlation,
            residuals,
            scatter_mil,
            correlation,
        }
    }
}

/// Covariance of the boresight alone.
pub(super) fn centre_covariance(fit: &Fit) -> Matrix2<f64> {
    fit.covariance.fixed_view::<2, 2>(0, 0).into_owned()
}

fn at_sun(sun: &SunPosition) -> Horizontal {
    Horizontal {
        azimuth_deg: sun.azimuth_deg,
        elevation_deg: sun.elevation_deg,
    }
}
