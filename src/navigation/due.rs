//! Selection of rows at a given rate.

/// Selects rows at a rate; the rows come in the order of time. It starts over if the time runs backwards.
#[derive(Debug, Clone, Copy, Default)]
pub struct Due {
    /// Time from which the next row is due.
    from_s: Option<f64>,
}

impl Due {
    /// Whether a row at a time is due.
    pub fn takes(&mut self, t_s: f64, rate_hz: f64) -> bool {
        let period_s = 1.0 / rate_hz;
        // A row may be early by 1 % of a period: times are rounded.
        let early_s = 0.01 * period_s;
        let is_due = |from_s: f64| t_s >= from_s - early_s || t_s < from_s - period_s - early_s;
        let takes = self.from_s.is_none_or(is_due);
        if takes {
            self.from_s = Some((t_s / period_s + 0.01).floor() * period_s + period_s);
        }
        takes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_taken_at_the_rate_and_at_once_where_the_time_runs_back() {
        let mut due = Due::default();
        let taken = (0..100).filter(|n| due.takes(7.0 + f64::from(*n) * 0.01, 20.0));
        assert_eq!(taken.count(), 20);
        assert!(due.takes(3.0, 20.0));
        assert!(!due.takes(3.01, 20.0) && due.takes(3.05, 20.0));
    }
}
