//! Least-squares fit of the mounting, and in a drift scan of the pointing, to the Sun's observed positions.

use super::observation::SunObservation;
use super::scatter::{Residual, correlation, extra_variance};
use super::side::Side;
use super::start::{Start, start};
use crate::estimation::{
    FitError, Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS_2D,
};
use crate::instrument::{Directions, Instrument};
use crate::observe::RejectedFrame;
use crate::pointing::{self, Horizontal, Roll};
use crate::sky::SunPosition;
use crate::units::{Measured, PlateMil};
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2, Vector4, Vector6};

/// Whether the telescope's pointing is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pointings {
    /// Each observation has its own known pointing.
    Known,
    /// All observations have one unknown pointing: a drift scan.
    Fixed,
}

/// Unknowns of the fit, by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// Boresight on the plate, mil.
    CentreX,
    CentreY,
    /// Clocking, deg.
    Clocking,
    /// Plate distance, mm.
    Distance,
    /// The fixed telescope's direction, deg.
    Azimuth,
    Elevation,
}

/// Wide priors, 1 sigma about the start: they only matter where the observations do not separate the unknowns.
const CENTRE_PRIOR_MIL: f64 = 500.0;
const LEAST_CENTRE_PRIOR_MIL: f64 = 0.1;
const CLOCKING_PRIOR_DEG: f64 = 180.0;
const DISTANCE_PRIOR: f64 = 0.1;
const POINTING_PRIOR_DEG: f64 = 10.0;

/// Observations with larger normalised residuals are rejected: one in 800 of good ones.
const MOST_SIGMAS: f64 = 3.66;
const START_PASSES: usize = 4;
/// Greatest number of fits alternating with estimates of the scatter; a median may alternate between two neighbours.
const SCATTER_PASSES: usize = 15;
/// A smaller relative change of the scatter counts as converged.
const CONVERGED: f64 = 1e-6;
/// Convergence of the fits, in sigmas of the unknowns: of the first ones, which only find the outliers, and of the last.
const ROUGH_SIGMAS: f64 = 0.05;
const FINE_SIGMAS: f64 = 1e-6;

/// A mounting fitted to observations of the Sun.
#[derive(Debug, Clone)]
pub struct MountingFit {
    pub pointings: Pointings,
    /// Convention for directions on the plate.
    pub directions: Directions,
    /// The fitted unknowns in the order of [`Unknown`]; the pointing's only in a drift scan.
    pub values: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Residuals in the order of time.
    pub residuals: Vec<Residual>,
    /// Scatter of the accepted observations per axis, rms.
    pub scatter_mil: f64,
    /// Inflation of the variances for the correlation of successive residuals; 1 if there is none.
    pub correlation: f64,
}

/// Two fits are distinguished if their sums of squares differ by more than this.
pub(super) const DISTINGUISHED: f64 = 25.0;

impl MountingFit {
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

    /// Covariance of the boresight alone.
    pub(super) fn centre_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// The frames whose observation was rejected.
    pub(super) fn rejected(&self) -> Vec<RejectedFrame> {
        let far = self.residuals.iter().filter(|r| !r.accepted);
        far.map(|r| {
            let (off_mil, sigmas) = (r.off.norm(), r.normalised());
            let reason = format!(
                "the Sun is {off_mil:.2} mil ({sigmas:.1} sigma) from its position by the others"
            );
            RejectedFrame::new(&r.file, reason)
        })
        .collect()
    }

    /// Difference of the sums of squares, another fit's minus this one's, with the better one's sigmas. The square of each observation is
    /// limited, and correlated neighbours count once.
    pub(super) fn chi2_gain(&self, over: &Self) -> f64 {
        const MOST_SQUARE: f64 = 12.25;
        let better = match self.scatter_mil <= over.scatter_mil {
            true => self,
            false => over,
        };
        let cost = |fit: &Self| -> f64 {
            let sigmas = better.residuals.iter().map(|r| r.sigma_mil);
            let pairs = fit.residuals.iter().zip(sigmas);
            let squares = pairs.map(|(r, sigma)| (r.off.norm() / sigma).powi(2));
            squares.map(|square| square.min(MOST_SQUARE)).sum()
        };
        (cost(over) - cost(self)) / better.correlation
    }
}

/// The fit with the direction convention that the observations support, and the fit with the other convention.
pub(super) struct Fits {
    pub best: MountingFit,
    /// `None` if the observations agree with no mounting by that convention.
    pub other: Option<MountingFit>,
}

/// Fits the mounting of an instrument with its own direction convention and with the other, which is the best only if the observations
/// distinguish the two and support it.
///
/// # Errors
/// If the observations agree with no mounting by either convention.
pub(super) fn fit(
    observations: &[SunObservation],
    pointings: Pointings,
    stated: &Instrument,
    side: Side,
) -> Result<Fits, FitError> {
    let by = |directions| {
        let mut stated = stated.clone();
        stated.mounting.directions = directions;
        let model = Model {
            observations,
            pointings,
            stated: &stated,
            side,
        };
        match pointings {
            Pointings::Known => model.fit(model.first()),
            Pointings::Fixed => model.fit(model.first_with_pointing()),
        }
    };
    let own = stated.mounting.directions;
    let other = match own {
        Directions::Telescope => Directions::Sun2013,
        Directions::Sun2013 => Directions::Telescope,
    };
    let (best, other) = match (by(own), by(other)) {
        (Ok(own), Ok(other)) if other.chi2_gain(&own) > DISTINGUISHED => (other, Some(own)),
        (Ok(own), other) => (own, other.ok()),
        (Err(_), Ok(other)) => (other, None),
        (Err(error), Err(_)) => return Err(error),
    };
    Ok(Fits { best, other })
}

/// An instrument with one direction convention, and the observations to which its mounting is fitted.
struct Model<'a> {
    observations: &'a [SunObservation],
    pointings: Pointings,
    stated: &'a Instrument,
    side: Side,
}

impl Model<'_> {
    fn fit<const N: usize>(&self, first: Option<SVector<f64, N>>) -> Result<MountingFit, FitError> {
        let start = first.ok_or(FitError::Undetermined)?;
        let all = vec![true; self.observations.len()];
        let mut fit = LeastSquares {
            start,
            prior: self.prior(&start),
            loss: Loss::Tukey(TUKEY_SIGMAS_2D),
            scale: Scale::Stated,
            tolerance_sigmas: ROUGH_SIGMAS,
        };
        fit.start = self.fit_scatter(fit, &all)?.parameters;
        (fit.loss, fit.tolerance_sigmas) = (Loss::Squares, FINE_SIGMAS);
        let residuals = self.residuals(&fit.start, &all);
        let accepted: Vec<bool> = residuals
            .iter()
            .map(|r| r.normalised() < MOST_SIGMAS)
            .collect();
        let fitted = self.fit_scatter(fit, &accepted)?;
        Ok(self.conclude(&fitted, &accepted))
    }

    /// Fits the accepted observations. Their variances include the extra scatter, which depends on the fit.
    fn fit_scatter<const N: usize>(
        &self,
        mut fit: LeastSquares<N>,
        accepted: &[bool],
    ) -> Result<Fitted<N>, FitError> {
        let mut pass = 0;
        let mut residuals = self.residuals(&fit.start, accepted);
        loop {
            let sigmas: Vec<f64> = residuals.iter().map(|r| r.sigma_mil).collect();
            let fitted = fit.fit(|values| Some(self.linearised(values, &sigmas, accepted)))?;
            residuals = self.residuals(&fitted.parameters, accepted);
            let mut changes = residuals.iter().zip(&sigmas);
            let converged = changes.all(|(r, sigma)| (r.sigma_mil / sigma - 1.0).abs() < CONVERGED);
            pass += 1;
            if converged || pass == SCATTER_PASSES {
                return Ok(fitted);
            }
            fit.start = fitted.parameters;
        }
    }

    /// An initial mounting.
    fn first(&self) -> Option<Vector4<f64>> {
        let known = |sun: &SunObservation| sun.pointing.unwrap_or(at_sun(&sun.sun));
        let start = self.start(known)?;
        let [clocking, distance] = self.turned(&start);
        Some(Vector4::new(
            start.shift.x,
            start.shift.y,
            clocking,
            distance,
        ))
    }

    /// An initial mounting with the stated centre, and the corresponding pointing.
    fn first_with_pointing(&self) -> Option<Vector6<f64>> {
        let centre = self.stated.mounting.boresight_mil;
        let mut towards = at_sun(&self.observations.get(self.observations.len() / 2)?.sun);
        let mut mounting = Vector4::zeros();
        // The closer the assumed direction, the better plate and sky agree as similar figures.
        for _ in 0..START_PASSES {
            let start = self.start(|_| towards)?;
            let [clocking, distance] = self.turned(&start);
            mounting = Vector4::new(centre.x, centre.y, clocking, distance);
            let best = &self.observations[start.best];
            let shift = best.sun_plate.position.vector() - centre.vector();
            let front = centre.vector() + self.side.view(shift);
            let instrument = self.instrument(mounting.as_slice());
            let sun = &best.sun;
            towards = pointing::pointing(front.into(), Roll::Stated, &instrument, sun).ok()?;
        }
        Some(
            mounting
                .push(towards.azimuth_deg)
                .push(towards.elevation_deg),
        )
    }

    fn start(&self, telescope: impl Fn(&SunObservation) -> Horizontal) -> Option<Start> {
        start(self.observations, telescope, self.stated, self.side)
    }

    /// Clocking, within half a turn of the stated one, and distance from a start.
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
    fn instrument(&self, values: &[f64]) -> Instrument {
        let mut instrument = self.stated.clone();
        instrument.mounting.boresight_mil = PlateMil::new(values[0], values[1]);
        instrument.mounting.clocking_deg.value = values[2];
        instrument.optics.plate_distance_mm.value = values[3];
        instrument
    }

    /// Predicted position of the Sun in each observation, mil; if it is behind the lens, so far away that it is rejected.
    fn expected(&self, values: &[f64]) -> Vec<Vector2<f64>> {
        const NOWHERE_MIL: f64 = 1e6;
        let instrument = self.instrument(values);
        let centre = instrument.mounting.boresight_mil.vector();
        let fixed = (values.len() > 4).then(|| Horizontal {
            azimuth_deg: values[4],
            elevation_deg: values[5],
        });
        let expected = |sun: &SunObservation| {
            let towards = fixed.or(sun.pointing)?;
            let shift = self.side.shift(towards, &instrument, &sun.sun)?;
            Some(centre + shift)
        };
        let nowhere = Vector2::new(NOWHERE_MIL, NOWHERE_MIL);
        let suns = self.observations.iter();
        suns.map(|sun| expected(sun).unwrap_or(nowhere)).collect()
    }

    /// The residual of each observation. The variance per axis is the observation's own plus the extra scatter of the accepted ones.
    fn residuals<const N: usize>(
        &self,
        values: &SVector<f64, N>,
        accepted: &[bool],
    ) -> Vec<Residual> {
        let expected = self.expected(values.as_slice());
        let pairs = self.observations.iter().zip(&expected).zip(accepted);
        let own = pairs.map(|((sun, expected), accepted)| Residual {
            file: sun.file.clone(),
            utc: sun.utc,
            at: sun.sun_plate.position,
            off: sun.sun_plate.position.vector() - expected,
            sigma_mil: (sun.sun_plate.covariance.trace() / 2.0).sqrt(),
            accepted: *accepted,
        });
        let mut residuals: Vec<Residual> = own.collect();
        let extra_mil = extra_variance(&residuals).sqrt();
        for residual in &mut residuals {
            residual.sigma_mil = residual.sigma_mil.hypot(extra_mil);
        }
        residuals
    }

    /// The accepted observations, linearised by differences at some values.
    fn linearised<const N: usize>(
        &self,
        values: &SVector<f64, N>,
        sigmas_mil: &[f64],
        accepted: &[bool],
    ) -> Vec<Linearised<2, N>> {
        const STEPS: [f64; 6] = [0.1, 0.1, 1e-3, 0.1, 1e-4, 1e-4];
        let expected = self.expected(values.as_slice());
        let by: [_; N] = std::array::from_fn(|n| {
            let [plus, minus] = [STEPS[n], -STEPS[n]].map(|step| {
                let mut moved = *values;
                moved[n] += step;
                self.expected(moved.as_slice())
            });
            (plus, minus)
        });
        let linearised = |k: usize| {
            let seen = self.observations[k].sun_plate.position.vector();
            let slope = |n: usize| (by[n].0[k] - by[n].1[k]) / (2.0 * STEPS[n]);
            Linearised {
                residual: (seen - expected[k]) / sigmas_mil[k],
                jacobian: SMatrix::from_fn(|axis, n| slope(n)[axis] / sigmas_mil[k]),
            }
        };
        let accepted = (0..expected.len()).filter(|k| accepted[*k]);
        accepted.map(linearised).collect()
    }

    /// The prior of each unknown, about its start value.
    fn prior<const N: usize>(&self, first: &SVector<f64, N>) -> Prior<N> {
        let mounting = &self.stated.mounting;
        // With directions at the telescope a scan does not determine the centre, which is correlated with the clocking.
        let centre_mil = match (self.pointings, mounting.directions) {
            (Pointings::Fixed, Directions::Telescope) => {
                mounting.boresight_sigma_mil.max(LEAST_CENTRE_PRIOR_MIL)
            }
            _ => CENTRE_PRIOR_MIL,
        };
        let cos_elevation = first.get(5).map_or(1.0, |el| el.to_radians().cos());
        let sigmas = [
            centre_mil,
            centre_mil,
            CLOCKING_PRIOR_DEG,
            DISTANCE_PRIOR * first[3],
            POINTING_PRIOR_DEG / cos_elevation.max(1e-3),
            POINTING_PRIOR_DEG,
        ];
        Prior {
            mean: *first,
            information: SVector::from_fn(|n, _| sigmas[n].powi(-2)),
        }
    }

    fn conclude<const N: usize>(&self, fitted: &Fitted<N>, accepted: &[bool]) -> MountingFit {
        let mut residuals = self.residuals(&fitted.parameters, accepted);
        residuals.sort_by_key(|r| r.utc);
        let taken: Vec<&Residual> = residuals.iter().filter(|r| r.accepted).collect();
        let squares: f64 = taken.iter().map(|r| r.off.norm_squared()).sum();
        let scatter_mil = (squares / (2 * taken.len()).max(1) as f64).sqrt();
        let correlation = correlation(&taken);
        let covariance = fitted.covariance * correlation;
        MountingFit {
            pointings: self.pointings,
            directions: self.stated.mounting.directions,
            values: DVector::from_column_slice(fitted.parameters.as_slice()),
            covariance: DMatrix::from_column_slice(N, N, covariance.as_slice()),
            residuals,
            scatter_mil,
            correlation,
        }
    }
}

fn at_sun(sun: &SunPosition) -> Horizontal {
    Horizontal {
        azimuth_deg: sun.azimuth_deg,
        elevation_deg: sun.elevation_deg,
    }
}
