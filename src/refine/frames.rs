//! The dated frames' own results, as far as they are needed to judge other frames.

use super::drift::MarkObservation;
use super::record::{FrameRecord, Grade, MarkRecord, symmetric, upper};
use super::timeline::{Content, Entry, Timeline};
use crate::aspect::Stage;
use crate::instrument::Instrument;
use crate::observe::JournalError;
use crate::sky::sun_angular_radius;
use crate::units::{PlateMil, SensorPx};
use jiff::Timestamp;
use nalgebra::{Matrix3, Vector2};
use std::collections::BTreeMap;

/// If fewer frames contradict the instrument, they are taken for misidentified.
const LEAST_CONTRADICTING: usize = 3;

/// Result of a frame on its own.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    pub quality: Grade,
    pub disc: Option<OwnDisc>,
    /// Background, noise and disc, DN.
    pub levels_dn: Option<[f32; 3]>,
    /// Number of identified marks.
    pub marks: u16,
    pub temperature_c: Option<f64>,
    /// The disc's radius from ephemeris and plate distance.
    pub expected_radius_mil: Option<f64>,
}

/// The disc found in a single frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct OwnDisc {
    pub centre_px: SensorPx,
    /// Visible part of the limb, 0 to 1.
    pub limb_part: f64,
    /// Motion of the Sun's image during the exposure, px, if it exceeds the limit of the limb fit.
    pub motion_px: Option<f64>,
}

/// The dated frames of a flight, in the order of time.
pub(super) struct Frames {
    pub frames: Vec<Frame>,
    /// The marks of the fine frames, and the end of each frame's marks among them.
    pub marks: Vec<MarkObservation>,
    pub marks_end: Vec<u32>,
    /// Plate (mil) to ideal sensor (px), from the fine frames.
    pub mappings: Vec<Matrix3<f64>>,
    /// Contradiction between most frames and the instrument, in words: they are from another camera.
    pub contradiction: Option<String>,
}

impl Frames {
    /// Reads the results of all dated frames.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn read(
        timeline: &Timeline<FrameRecord>,
        instrument: &Instrument,
    ) -> Result<Self, JournalError> {
        let mut all = Self {
            frames: Vec::with_capacity(timeline.dated()),
            marks: Vec::new(),
            marks_end: Vec::with_capacity(timeline.dated()),
            mappings: Vec::new(),
            contradiction: None,
        };
        let mut against = Against::default();
        let read = |n: usize| Ok((n, timeline.entry(n)?));
        timeline.each(timeline.len(), read, |(n, Entry { file, data })| {
            let Content::Frame(record) = data else { return };
            against.note(&file, &record);
            if let Some(utc_ns) = timeline.utc_ns(n) {
                all.add(utc_ns, &record, instrument);
            }
        })?;
        all.contradiction = against.contradiction().or_else(|| against.unidentified());
        Ok(all)
    }

    fn add(&mut self, utc_ns: i64, record: &FrameRecord, instrument: &Instrument) {
        let utc = Timestamp::from_nanosecond(utc_ns.into()).ok();
        let angular = utc.and_then(|utc| sun_angular_radius(utc).ok());
        if record.quality == Grade::Fine {
            let marks = record.marks.iter();
            self.marks
                .extend(marks.filter_map(|mark| observation(mark, instrument)));
            let own = record.disc.as_ref().and_then(|disc| disc.to_plate);
            let inverse = own.and_then(|m| Matrix3::from_row_slice(&m).try_inverse());
            self.mappings.extend(inverse);
        }
        self.marks_end.push(self.marks.len() as u32);
        self.frames.push(Frame {
            quality: record.quality,
            disc: record.disc.as_ref().map(|disc| OwnDisc {
                centre_px: SensorPx::new(disc.centre_px[0], disc.centre_px[1]),
                limb_part: disc.limb_fraction,
                motion_px: disc.motion_px,
            }),
            levels_dn: record.levels_dn.map(|levels| levels.map(|dn| dn as f32)),
            marks: record.marks.len() as u16,
            temperature_c: record.facts.temperature_c,
            expected_radius_mil: angular.map(|angular| instrument.optics.radius_mil(angular)),
        });
    }
}

fn observation(mark: &MarkRecord, instrument: &Instrument) -> Option<MarkObservation> {
    let information = symmetric(mark.covariance_px2).try_inverse()?;
    Some(MarkObservation {
        observed: instrument.camera.distortion.correct(mark.at()).vector(),
        printed: instrument.plate.position(mark.id())?,
        information: upper(&information).map(|part| part as f32),
        weight: 1.0,
    })
}

/// Contradictions between frames and the instrument.
#[derive(Default)]
struct Against {
    fine: usize,
    bright: usize,
    contradicting: usize,
    /// The first frame that contradicts it: file and contradiction.
    first: Option<[String; 2]>,
    /// Reasons for which marks could not be identified, with the number of frames of each.
    unidentified: BTreeMap<String, usize>,
}

impl Against {
    fn note(&mut self, file: &str, record: &FrameRecord) {
        self.fine += usize::from(record.quality == Grade::Fine);
        self.bright += usize::from(record.levels_dn.is_some());
        if let Some(what) = &record.contradiction {
            self.contradicting += 1;
            self.first
                .get_or_insert_with(|| [file.into(), what.clone()]);
        }
        let stage = format!("{}: ", Stage::Identification.name());
        let reason = record
            .reason
            .as_deref()
            .and_then(|why| why.strip_prefix(&stage));
        if let Some(reason) = reason {
            *self.unidentified.entry(reason.into()).or_default() += 1;
        }
    }

    /// Set if most of the fine frames contradict the instrument: it is another camera's, or the camera was moved.
    fn contradiction(&self) -> Option<String> {
        let ([file, what], frames, fine) = (self.first.as_ref()?, self.contradicting, self.fine);
        (2 * frames > fine && frames >= LEAST_CONTRADICTING).then(|| {
            format!(
                "{frames} of {fine} fine frames contradict the instrument; expected its camera's frames, found in {file} {what}. Name the camera's \
                 own instrument, or one whose sigmas allow for this"
            )
        })
    }

    /// Set if no frame is fine, and in most frames that show something bright the marks do not match the plate as seen by
    /// this instrument: a mirrored picture, or another plate.
    fn unidentified(&self) -> Option<String> {
        let (frames, bright) = (self.unidentified.values().sum::<usize>(), self.bright);
        let (reason, _) = self
            .unidentified
            .iter()
            .max_by_key(|(_, frames)| **frames)?;
        (self.fine == 0 && 2 * frames > bright && frames >= LEAST_CONTRADICTING).then(|| {
            format!(
                "the marks of {frames} of {bright} frames cannot be identified, and no frame is fine; expected the plate as the instrument sees it, found, in most, \
                 that {reason}. Name the camera's own instrument, and see that the pictures are not mirrored (mounting.handedness)"
            )
        })
    }
}

/// Median sensor position of a plate point by the fine frames' own mappings, px; `None` without any.
pub(super) fn middle_of(mappings: &[Matrix3<f64>], place: PlateMil) -> Option<Vector2<f64>> {
    let seen = |axis: usize| {
        let at = mappings.iter().map(|m| {
            let h = m * place.vector().push(1.0);
            h[axis] / h.z
        });
        crate::estimation::median(at)
    };
    Some(Vector2::new(seen(0)?, seen(1)?))
}
