//! The times of a flight's measurements.

/// Start and duration of a flight.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub start_s: u64,
    pub duration_s: f64,
}

impl Span {
    /// Times at a constant rate, from the start to the end. Each is the double nearest to its decimal number, whatever the rate.
    pub fn ticks_s(&self, rate_hz: u64) -> impl Iterator<Item = f64> + use<> {
        // A duration of 0.29 s contains 29 hundredths, though the product is smaller by rounding.
        let last = (self.duration_s * rate_hz as f64 + 1e-6) as u64;
        let start = self.start_s * rate_hz;
        (0..=last).map(move |tick| (start + tick) as f64 / rate_hz as f64)
    }
}
