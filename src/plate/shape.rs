//! Shapes of a plate's marks, dark on white.

use nalgebra::{Matrix2, Rotation2, Vector2};

/// The shape of a plate's marks, the same for all of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MarkShape {
    Cross(Cross),
    /// A filled disc.
    Dot {
        diameter_mil: f64,
    },
}

/// Two arms that cross at right angles in their centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cross {
    /// Length from tip to tip.
    pub arm_length_mil: f64,
    pub arm_width_mil: f64,
    /// Angle of an arm from the plate's +X towards +Y.
    pub arm_angle_deg: f64,
}

impl Cross {
    /// The cross of the plate of 2013 (Cramer 2014, section 4.3.1).
    pub const HEROES: Self = Self {
        arm_length_mil: 90.0,
        arm_width_mil: 12.0,
        arm_angle_deg: 0.0,
    };
}

impl MarkShape {
    /// Size from one end to the other: length of a cross from tip to tip, or a dot's diameter.
    pub fn size_mil(&self) -> f64 {
        match self {
            Self::Cross(cross) => cross.arm_length_mil,
            Self::Dot { diameter_mil } => *diameter_mil,
        }
    }

    /// Line width of a cross, or a dot's radius.
    pub fn line_mil(&self) -> f64 {
        match self {
            Self::Cross(cross) => cross.arm_width_mil,
            Self::Dot { diameter_mil } => diameter_mil / 2.0,
        }
    }

    /// The same shape scaled by a factor.
    pub fn scaled(&self, by: f64) -> Self {
        match self {
            Self::Cross(cross) => Self::Cross(Cross {
                arm_length_mil: cross.arm_length_mil * by,
                arm_width_mil: cross.arm_width_mil * by,
                ..*cross
            }),
            Self::Dot { diameter_mil } => Self::Dot {
                diameter_mil: diameter_mil * by,
            },
        }
    }

    /// Directions of a cross's arms on the plate, as columns; for a dot, which has none, the plate's axes.
    pub fn arms(&self) -> Matrix2<f64> {
        match self {
            Self::Cross(cross) => Rotation2::new(cross.arm_angle_deg.to_radians()).into_inner(),
            Self::Dot { .. } => Matrix2::identity(),
        }
    }

    /// Returns a function that says whether a mark, with a margin, covers an offset from its centre; `to_plate` maps the
    /// offset to one along the plate's axes, mil.
    pub fn covers(
        &self,
        margin_mil: f64,
        to_plate: &Matrix2<f64>,
    ) -> impl Fn(Vector2<f64>) -> bool + use<> {
        let to_arms = self.arms().transpose() * to_plate;
        let half_length = self.size_mil() / 2.0 + margin_mil;
        let half_width = match self {
            Self::Cross(cross) => Some(cross.arm_width_mil / 2.0 + margin_mil),
            Self::Dot { .. } => None,
        };
        move |offset| {
            let along_arms = to_arms * offset;
            let [u, v] = along_arms.abs().into();
            match half_width {
                Some(half_width) => (u.max(v) < half_length) & (u.min(v) < half_width),
                None => along_arms.norm_squared() < half_length * half_length,
            }
        }
    }

    /// The name in the instrument's file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Cross(_) => "cross",
            Self::Dot { .. } => "dot",
        }
    }
}
