//! Flags of frames and of their times.

use std::fmt;

/// Standard deviation of a uniform distribution over its width.
pub(super) const SIGMA_PER_WIDTH: f64 = 0.288_675;

/// Order used for the frames of one stamp.
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

/// Reason for which a frame's time is flagged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TimeFlag {
    /// UTC had stepped against the monotonic clock.
    Clock,
    /// Frames of one stamp were spread over the step to the next one.
    CoarseTime { step_us: u64, by: Order },
    /// The time contradicts the numbers and times of the other frames.
    AgainstNumbers,
    /// Another frame has the same time, and the order of the two is not known.
    SharedTime,
    /// The times of most frames contradict their numbers, and the Sun's motion does, too.
    ShuffledTime,
    /// Other frames have the same time, and it is not known how long after it each was taken.
    StoppedClock,
}

impl TimeFlag {
    /// Whether the smoothed path uses the frame at its time.
    pub fn is_of_path(self) -> bool {
        matches!(
            self,
            Self::Clock | Self::CoarseTime { .. } | Self::AgainstNumbers
        )
    }
}

impl fmt::Display for TimeFlag {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Clock => "the clock had stepped: the time is by the monotonic clock",
            Self::CoarseTime { step_us, by } => {
                let step_s = *step_us as f64 / 1e6;
                match step_us {
                    1_000_000 => write!(out, "time stamped to whole seconds")?,
                    _ => write!(out, "time stamped to steps of {step_s} s")?,
                }
                let sigma_s = step_s * SIGMA_PER_WIDTH;
                return write!(out, ": spread by {}, 1 sigma {sigma_s:.2} s", by.name());
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
        })
    }
}

/// Reason for which a frame is flagged in comparison with the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FrameFlag {
    /// The disc was found in the second pass only.
    SecondPass,
    /// The radius differs from that of the other frames.
    Radius,
    /// The limb is less round than the mapping predicts.
    Limb,
    /// Far fewer marks were identified than the disc illuminates.
    FewMarks,
    /// Much more or less light than in the frames before and after.
    Light,
    /// Much more noise than in the frames before and after.
    Noise,
    /// The plate's position on the sensor differs from that in the frames before and after.
    PlateMoved,
    /// The marks were identified wrongly.
    WrongIds,
    /// The Sun's position is off the path between the frames before and after.
    Path,
}

impl FrameFlag {
    const ALL: [Self; 9] = [
        Self::SecondPass,
        Self::Radius,
        Self::Limb,
        Self::FewMarks,
        Self::Light,
        Self::Noise,
        Self::PlateMoved,
        Self::WrongIds,
        Self::Path,
    ];

    /// Whether the flag rejects the Sun's position; otherwise it is only reported.
    fn rejects(self) -> bool {
        match self {
            Self::Radius | Self::Limb | Self::Path | Self::PlateMoved => true,
            Self::WrongIds | Self::FewMarks | Self::Light | Self::Noise | Self::SecondPass => false,
        }
    }
}

impl fmt::Display for FrameFlag {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::SecondPass => "seen only where the frames before and after have the disc",
            Self::Radius => "the radius is not that of the flight",
            Self::Limb => "the limb does not fit the flight's mapping",
            Self::FewMarks => "far fewer marks were read than are lit",
            Self::Light => "the light is not that of the frames before and after",
            Self::Noise => "more noise than in the frames before and after",
            Self::PlateMoved => "the plate stands elsewhere than in the frames before and after",
            Self::WrongIds => "the marks were identified wrongly",
            Self::Path => "off the path of the frames before and after",
        })
    }
}

/// All flags of a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameFlags(u16);

impl FrameFlags {
    pub fn insert(&mut self, flag: FrameFlag) {
        self.0 |= 1 << flag as u16;
    }

    pub fn contains(self, flag: FrameFlag) -> bool {
        self.0 & (1 << flag as u16) != 0
    }

    /// Whether one of them rejects the Sun's position.
    pub fn reject(self) -> bool {
        self.iter().any(FrameFlag::rejects)
    }

    pub fn iter(self) -> impl Iterator<Item = FrameFlag> {
        FrameFlag::ALL
            .into_iter()
            .filter(move |flag| self.contains(*flag))
    }
}

impl FromIterator<FrameFlag> for FrameFlags {
    fn from_iter<I: IntoIterator<Item = FrameFlag>>(flags: I) -> Self {
        let mut all = Self::default();
        flags.into_iter().for_each(|flag| all.insert(flag));
        all
    }
}
