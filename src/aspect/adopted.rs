//! The mapping of a solution: the frame's own, or a borrowed one.

use crate::geometry::{LocalSimilarity, Mapping};
use crate::instrument::Instrument;
use crate::registration::Registration;
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

/// Drift of a mapping since the frame that it comes from, 1 sigma.
const PRIOR_DRIFT_PX: f64 = 0.5;

/// The mapping of a solution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Adopted {
    /// From this frame's marks.
    Own(Registration),
    /// From the last frame that had marks.
    Prior(Registration),
    /// From the calibration.
    Calibration(Mapping),
}

impl Adopted {
    pub fn mapping(&self) -> &Mapping {
        match self {
            Self::Own(registration) | Self::Prior(registration) => &registration.mapping,
            Self::Calibration(mapping) => mapping,
        }
    }

    /// The registration by a frame's marks, of this frame or of an earlier one.
    pub fn registration(&self) -> Option<&Registration> {
        match self {
            Self::Own(registration) | Self::Prior(registration) => Some(registration),
            Self::Calibration(_) => None,
        }
    }

    /// The registration by this frame's own marks.
    pub fn own(&self) -> Option<&Registration> {
        match self {
            Self::Own(registration) => Some(registration),
            Self::Prior(_) | Self::Calibration(_) => None,
        }
    }

    /// Root mean square residual of the frame's marks per axis; none for a borrowed mapping.
    pub fn residual_px(&self) -> Option<f64> {
        self.own().map(|own| own.residual_px)
    }

    /// The kind of mapping, or its source if borrowed.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Own(registration) => registration.mapping.kind().name(),
            Self::Prior(_) => "prior",
            Self::Calibration(_) => "calibration",
        }
    }

    /// Scale and rotation at a position, from the marks or from the calibration.
    pub(super) fn local_similarity(
        &self,
        at: SensorPx,
        instrument: &Instrument,
    ) -> LocalSimilarity {
        let (mapping, mounting) = match self {
            Self::Own(registration) | Self::Prior(registration) => {
                return registration.local_similarity(at);
            }
            Self::Calibration(mapping) => (mapping, &instrument.mounting),
        };
        let (scale, rotation) = (mounting.scale_mil_per_px, mounting.rotation_deg);
        LocalSimilarity {
            scale_mil_per_px: Measured::new(mapping.scale_mil_per_px(at), scale.sigma),
            rotation_deg: Measured::new(mapping.rotation_deg(at), rotation.sigma),
        }
    }

    /// Covariance of a position on the plate from the mapping alone, mil^2.
    pub(super) fn covariance_mil2(&self, at: PlateMil, instrument: &Instrument) -> Matrix2<f64> {
        match self {
            Self::Own(own) => own.covariance_mil2(at),
            Self::Prior(prior) => {
                let scale = prior.mapping.scale_mil_per_px(prior.mapping.to_sensor(at));
                let drift = (PRIOR_DRIFT_PX * scale).powi(2);
                prior.covariance_mil2(at) + Matrix2::identity() * drift
            }
            Self::Calibration(_) => instrument.nominal_covariance_mil2(at),
        }
    }
}
