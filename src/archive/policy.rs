//! Rules of the archive for two disks, for a disk that cannot follow, and for one that fills up.

/// Division of the frames between two disks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sharing {
    /// Each frame goes to one of them, in turn; if only one works, it takes all.
    #[default]
    Alternate,
    /// Each frame goes to both.
    Mirror,
}

/// Rule for the pictures that are given up when the disks cannot follow. Rows of the log never are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Overflow {
    /// The picture that has waited longest.
    #[default]
    DropOldest,
    /// All except every n-th, from then on until none waits any more.
    EveryNth,
    /// All, from then on until none waits any more.
    SolutionsOnly,
}

macro_rules! named {
    ($kind:ident, $($variant:ident = $name:literal),+) => {
        impl $kind {
            /// Every kind.
            pub const KINDS: &[Self] = &[$(Self::$variant),+];
            /// The names of the kinds in the configuration.
            pub const NAMES: &[&'static str] = &[$($name),+];

            /// The name of the kind.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name),+
                }
            }
        }
    };
}

named!(Sharing, Alternate = "alternate", Mirror = "mirror");
named!(
    Overflow,
    DropOldest = "drop_oldest",
    EveryNth = "every_nth",
    SolutionsOnly = "solutions_only"
);

/// Limits of the free space, in percent of the disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceLimits {
    pub warn_percent: f64,
    pub thin_percent: f64,
    pub stop_percent: f64,
}

impl SpaceLimits {
    /// State of a disk with this much free space.
    pub fn free_space(&self, free_percent: f64) -> FreeSpace {
        if free_percent < self.stop_percent {
            FreeSpace::None
        } else if free_percent < self.thin_percent {
            FreeSpace::Scarce
        } else if free_percent < self.warn_percent {
            FreeSpace::Low
        } else {
            FreeSpace::Plenty
        }
    }
}

/// State of a disk's free space, from least to most.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum FreeSpace {
    /// Too little for pictures; the rest is for the logs.
    None,
    /// Enough for every n-th picture.
    Scarce,
    /// Enough for all pictures, with a warning.
    Low,
    #[default]
    Plenty,
}

impl FreeSpace {
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Scarce => "scarce",
            Self::Low => "low",
            Self::Plenty => "plenty",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_space_goes_the_archive_warns_then_thins_then_stops() {
        let limits = SpaceLimits {
            warn_percent: 10.0,
            thin_percent: 3.0,
            stop_percent: 1.0,
        };
        let spaces = [50.0, 10.0, 9.9, 3.0, 2.9, 1.0, 0.9, 0.0].map(|free| limits.free_space(free));
        use FreeSpace::{Low, None, Plenty, Scarce};
        assert_eq!(
            spaces,
            [Plenty, Plenty, Low, Low, Scarce, Scarce, None, None]
        );
        assert!(spaces.is_sorted_by(|a, b| a >= b));
    }
}
