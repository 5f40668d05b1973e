//! Record of one frame, reduced to what the flight needs: a row of the journal.

use super::timeline::Dated;
use crate::aspect::{Adopted, Aspect, Mark, Solution};
use crate::calibrate::check;
use crate::fits::{Header, Value};
use crate::frame::FrameInfo;
use crate::instrument::Instrument;
use crate::limb::LimbPoint;
use crate::observe::FrameFacts;
use crate::plate::MarkId;
use crate::reasons::sun;
use crate::units::{Estimate, PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Record of one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    pub facts: FrameFacts,
    /// Results in flight, from the header.
    pub in_flight: InFlight,
    pub quality: Grade,
    pub reason: Option<String>,
    /// Contradiction between the fine frame and the instrument's file, in words.
    pub contradiction: Option<String>,
    /// Background, noise and disc, DN.
    pub levels_dn: Option<[f64; 3]>,
    pub disc: Option<DiscRecord>,
    pub marks: Vec<MarkRecord>,
    pub limb: Vec<PackedPoint>,
}

/// Quality of a frame's own solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Grade {
    None,
    Coarse,
    Fine,
}

impl Grade {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Coarse => "coarse",
            Self::Fine => "fine",
        }
    }
}

/// The results in flight, from the keywords that the archive wrote.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct InFlight {
    pub sun_mil: Option<[f64; 2]>,
    pub sigma_mil: Option<[f64; 2]>,
    pub offset_deg: Option<[f64; 2]>,
    /// The body's roll, and 1 sigma.
    pub roll_deg: Option<[f64; 2]>,
    pub quality: Option<String>,
}

/// The disc found in the frame alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DiscRecord {
    pub centre_px: [f64; 2],
    pub radius_px: f64,
    pub on_plate_mil: [f64; 2],
    /// Covariance of the position on the plate: xx, xy, yy.
    pub covariance_mil2: [f64; 3],
    pub limb_fraction: f64,
    /// Motion of the Sun's image during the exposure, px, if it exceeds the limit of the limb fit.
    pub motion_px: Option<f64>,
    /// The mapping from the ideal sensor (px) to the plate (mil), row by row, where the frame's own marks determined one.
    pub to_plate: Option<[f64; 9]>,
}

/// A mark that was identified.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MarkRecord {
    pub id: [i16; 2],
    pub px: [f64; 2],
    /// Covariance: xx, xy, yy.
    pub covariance_px2: [f64; 3],
}

/// A point of the limb, relative to the disc's centre in steps of 1/256 px, with its sigma in steps of 1/10000 px.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PackedPoint([i16; 2], u16);

const STEPS_PER_PX: f64 = 256.0;
const SIGMA_STEPS_PER_PX: f64 = 1e4;

impl DiscRecord {
    pub fn on_plate(&self) -> Estimate<PlateMil> {
        Estimate {
            position: PlateMil::new(self.on_plate_mil[0], self.on_plate_mil[1]),
            covariance: symmetric(self.covariance_mil2),
        }
    }
}

impl PackedPoint {
    pub(super) fn of(point: &LimbPoint, centre: Vector2<f64>) -> Self {
        let steps = ((point.at.vector() - centre) * STEPS_PER_PX).map(f64::round);
        let sigma = (point.sigma_px * SIGMA_STEPS_PER_PX).round();
        Self([steps.x as i16, steps.y as i16], sigma.max(1.0) as u16)
    }

    /// Position of the point, and 1 sigma along the radius, px.
    pub fn unpack(self, centre: [f64; 2]) -> (SensorPx, f64) {
        let [x, y] = self.0.map(|v| f64::from(v) / STEPS_PER_PX);
        let at = SensorPx::new(centre[0] + x, centre[1] + y);
        (at, f64::from(self.1) / SIGMA_STEPS_PER_PX)
    }
}

impl MarkRecord {
    fn of(mark: &Mark) -> Self {
        Self {
            id: [mark.id.i as i16, mark.id.j as i16],
            px: [mark.at.x, mark.at.y],
            covariance_px2: upper(&mark.covariance_px2),
        }
    }

    pub fn id(&self) -> MarkId {
        let [i, j] = self.id.map(i32::from);
        MarkId { i, j }
    }

    pub fn at(&self) -> SensorPx {
        SensorPx::new(self.px[0], self.px[1])
    }
}

/// The elements xx, xy and yy.
pub(super) fn upper(m: &Matrix2<f64>) -> [f64; 3] {
    [m.m11, m.m12, m.m22]
}

/// The matrix of elements xx, xy and yy.
pub(super) fn symmetric([xx, xy, yy]: [f64; 3]) -> Matrix2<f64> {
    Matrix2::new(xx, xy, xy, yy)
}

impl FrameRecord {
    /// Makes the record of a frame, with its file's facts.
    pub fn new(
        info: &FrameInfo,
        header: &Header,
        solution: &Solution,
        instrument: &Instrument,
    ) -> Self {
        let aspect = solution.aspect.as_ref();
        let centre = aspect.map(|aspect| aspect.sun_px.position.vector());
        let limb = centre.map_or(Vec::new(), |centre| {
            let packed = |point| PackedPoint::of(point, centre);
            solution.limb.iter().map(packed).collect()
        });
        Self {
            facts: FrameFacts::of(info),
            in_flight: InFlight::of(header),
            quality: match solution.quality {
                crate::aspect::Quality::None => Grade::None,
                crate::aspect::Quality::Coarse => Grade::Coarse,
                crate::aspect::Quality::Fine => Grade::Fine,
            },
            reason: solution.stopped.map(|stopped| stopped.to_string()),
            contradiction: check::contradictions(solution, instrument)
                .first()
                .map(ToString::to_string),
            levels_dn: solution
                .levels
                .map(|levels| [levels.background_dn, levels.noise_dn, levels.disc_dn]),
            disc: aspect.map(|aspect| disc(aspect, solution)),
            marks: solution.marks.iter().map(MarkRecord::of).collect(),
            limb,
        }
    }
}

impl Dated for FrameRecord {
    fn facts(&self) -> &FrameFacts {
        &self.facts
    }

    fn place(&self) -> Option<[f64; 2]> {
        Some(self.disc.as_ref()?.on_plate_mil)
    }
}

fn disc(aspect: &Aspect, solution: &Solution) -> DiscRecord {
    let (sensor, plate) = (aspect.sun_px.position, aspect.sun_plate);
    let own = solution.mapping.as_ref().and_then(Adopted::own);
    DiscRecord {
        centre_px: [sensor.x, sensor.y],
        radius_px: aspect.sun_radius_px.value,
        on_plate_mil: [plate.position.x, plate.position.y],
        covariance_mil2: upper(&plate.covariance),
        limb_fraction: aspect.limb_fraction,
        motion_px: solution
            .stopped
            .map(|stopped| stopped.rejected)
            .filter(|rejected| rejected.reason == sun::MOVED)
            .map(|rejected| rejected.measured),
        to_plate: own.map(|own| {
            let m = own.mapping.matrix();
            std::array::from_fn(|n| m[(n / 3, n % 3)])
        }),
    }
}

impl InFlight {
    pub(super) fn of(header: &Header) -> Self {
        let number = |keyword| header.number(keyword).ok().flatten();
        let pair = |x, y| Some([number(x)?, number(y)?]);
        Self {
            sun_mil: pair("SUNMIL-X", "SUNMIL-Y"),
            sigma_mil: pair("SUNMILSX", "SUNMILSY"),
            offset_deg: pair("OFFSETAZ", "OFFSETEL").or_else(|| {
                // The offset that HEROES sent; two zeroes if there was none.
                pair("CTL_AZIM", "CTL_ELEV").filter(|offset| *offset != [0.0; 2])
            }),
            roll_deg: pair("BODYROLL", "BODYRLSG"),
            quality: match header.get("QUALITY") {
                Some(Value::Text(text)) => Some(text.clone()),
                _ => None,
            },
        }
    }
}
