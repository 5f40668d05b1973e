//! Labels of a figure, and the reason why it cannot be drawn.

/// Why a figure cannot be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlotError {
    #[error("expected values to draw in figure \"{0}\", found none")]
    Empty(String),
}

/// Quantity of a horizontal axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Horizontal {
    /// A number, with its name and unit.
    Number(String),
    /// Time: seconds since 1970-01-01, UTC, labelled as hours and minutes of the day.
    Utc,
}

/// Labels of every figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Labels {
    pub title: String,
    pub x: Horizontal,
    pub y: String,
}

impl Labels {
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x: Horizontal::Number(x.into()),
            y: y.into(),
        }
    }

    /// Labels of a figure over time: x in seconds since 1970-01-01, UTC.
    pub fn over_utc(title: impl Into<String>, y: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x: Horizontal::Utc,
            y: y.into(),
        }
    }

    pub(super) fn empty(&self) -> PlotError {
        PlotError::Empty(self.title.clone())
    }
}
