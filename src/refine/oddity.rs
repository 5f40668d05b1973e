//! What may be odd about a frame.

use std::borrow::Cow;
use std::fmt;

/// The part of a uniform distribution's width that is 1 sigma.
pub(super) const SIGMA_PER_WIDTH: f64 = 0.288_675;

/// What orders the frames of one stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Order {
    Monotonic,
    Number,
    Files,
}

impl Order {
    pub fn name(self) -> &'static str {
        match self {
            Self::Monotonic => "the monotonic clock",
            Self::Number => "the frames' numbers",
            Self::Files => "the order of the files",
        }
    }
}

/// What is odd about a frame, seen beside the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Oddity {
    /// The radius is not that of the other frames.
    Radius,
    /// The limb is not as round as the mapping makes it.
    Limb,
    /// The place is off the path between the frames before and after.
    Path,
    /// The plate stands elsewhere on the sensor than in the frames before and after.
    Knocked,
    /// The marks were read wrongly.
    Misread,
    /// Far fewer marks were read than the disc lights.
    FewMarks,
    /// Much more or less light than in the frames before and after.
    Light,
    /// Much more noise than in the frames before and after.
    Noise,
    /// The frame alone showed no disc.
    SecondLook,
    /// UTC had stepped against the monotonic clock.
    Clock,
    /// Frames of one stamp were spread over the step to the next one.
    CoarseTime { step_us: u64, by: Order },
    /// The time contradicts the numbers and times of the other frames.
    AgainstNumbers,
    /// Another frame has the same time, and nothing orders the two.
    SharedTime,
    /// The times of most frames contradict their numbers, and the Sun's motion does, too.
    ShuffledTime,
    /// Other frames have the same time, and it cannot be told how long after it each was taken.
    StoppedClock,
}

impl Oddity {
    /// Whether it spoils the Sun's place; otherwise it is worth knowing and no more.
    pub fn spoils(self) -> bool {
        match self {
            Self::Radius | Self::Limb | Self::Path | Self::Knocked => true,
            Self::Misread | Self::FewMarks | Self::Light | Self::Noise | Self::SecondLook => false,
            _ => !self.is_of_time(),
        }
    }

    /// Whether it is the time that is odd.
    pub fn is_of_time(self) -> bool {
        matches!(
            self,
            Self::Clock
                | Self::CoarseTime { .. }
                | Self::AgainstNumbers
                | Self::SharedTime
                | Self::ShuffledTime
                | Self::StoppedClock
        )
    }

    /// Whether the frame may tell where the smoothed path is at its time.
    pub fn is_of_path(self) -> bool {
        !self.spoils()
            && !matches!(
                self,
                Self::SharedTime | Self::ShuffledTime | Self::StoppedClock
            )
    }

    pub fn text(self) -> Cow<'static, str> {
        let text = match self {
            Self::Radius => "the radius is not that of the flight",
            Self::Limb => "the limb does not fit the flight's mapping",
            Self::Path => "off the path of the frames before and after",
            Self::Knocked => "the plate stands elsewhere than in the frames before and after",
            Self::Misread => "the marks were read wrongly",
            Self::FewMarks => "far fewer marks were read than are lit",
            Self::Light => "the light is not that of the frames before and after",
            Self::Noise => "more noise than in the frames before and after",
            Self::SecondLook => "seen only where the frames before and after have the disc",
            Self::Clock => "the clock had stepped: the time is by the monotonic clock",
            Self::CoarseTime { step_us, by } => {
                let step_s = step_us as f64 / 1e6;
                let to = match step_us {
                    1_000_000 => "whole seconds".into(),
                    _ => format!("steps of {step_s} s"),
                };
                let sigma_s = step_s * SIGMA_PER_WIDTH;
                let by = by.name();
                return format!("time stamped to {to}: spread by {by}, 1 sigma {sigma_s:.2} s")
                    .into();
            }
            Self::AgainstNumbers => {
                "the time contradicts the frames' numbers: it is by the numbers and the frames before and after"
            }
            Self::SharedTime => {
                "another frame has the same time, and nothing orders them: not used for the smoothed path"
            }
            Self::ShuffledTime => {
                "the times contradict the frames' numbers and the motion: not used for the smoothed path"
            }
            Self::StoppedClock => {
                "the clock stood still: other frames have the same time, and the frame's own is not known"
            }
        };
        text.into()
    }
}

impl fmt::Display for Oddity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.text())
    }
}
