//! Selection of plausible GPS fixes.

use crate::link::GpsFix;

/// Number of successive fixes that contradict the last one, but not each other, after which they are accepted.
const CONFIRMING: usize = 3;

/// The fixes so far. Fixes are only compared with fixes: a configured place may be on another continent.
#[derive(Debug, Clone, Default)]
pub(super) struct Gps {
    last: Option<GpsFix>,
    /// Successive fixes that contradict the last one and agree with each other.
    contradicting: Vec<GpsFix>,
    refused: u64,
}

impl Gps {
    /// Number of fixes rejected as implausible.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Takes a fix from before a restart as the last one.
    pub fn resume(&mut self, fix: GpsFix) {
        self.last = Some(fix);
    }

    /// Accepts the next fix, wherever it is.
    pub fn clear(&mut self) {
        self.last = None;
        self.contradicting.clear();
    }

    /// Whether the fix is plausible, given the previous ones.
    pub fn accepts(&mut self, fix: GpsFix) -> bool {
        let accepted = fix.is_possible() && (fix.may_follow(self.last) || self.is_confirmed(fix));
        if accepted {
            self.last = Some(fix);
            self.contradicting.clear();
        } else {
            self.refused += 1;
        }
        accepted
    }

    fn is_confirmed(&mut self, fix: GpsFix) -> bool {
        self.contradicting.retain(|other| fix.agrees_with(*other));
        self.contradicting.push(fix);
        self.contradicting.len() >= CONFIRMING
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(latitude_deg: f32, longitude_deg: f32) -> GpsFix {
        GpsFix {
            latitude_deg,
            longitude_deg,
        }
    }

    #[test]
    fn the_first_fix_is_believed_and_a_jump_is_not() {
        let mut gps = Gps::default();
        assert!(gps.accepts(fix(-77.85, 166.67)), "wherever it is");
        assert!(!gps.accepts(fix(34.49, -104.25)));
        assert!(!gps.accepts(fix(0.0, 0.0)), "a receiver without a fix");
        assert!(gps.accepts(fix(-77.9, 166.0)));
        assert_eq!(gps.refused(), 2);
    }

    #[test]
    fn three_fixes_in_a_row_that_agree_are_believed() {
        let mut gps = Gps::default();
        gps.resume(fix(34.49, -104.25));
        let far = [fix(-77.85, 166.67), fix(-77.84, 166.9), fix(-77.86, 166.5)];
        assert_eq!(far.map(|fix| gps.accepts(fix)), [false, false, true]);
        assert!(gps.accepts(far[0]), "judged by the new place from now on");
        assert!(!gps.accepts(fix(34.49, -104.25)));
    }

    #[test]
    fn fixes_that_jump_about_are_never_believed() {
        let mut gps = Gps::default();
        gps.resume(fix(34.49, -104.25));
        for n in 0..50 {
            let north = fix(60.0 + 1.5 * (n % 3) as f32, 20.0);
            let west = fix(10.0, -170.0 + 0.1 * n as f32);
            assert!(!gps.accepts(north) && !gps.accepts(fix(0.0, 0.0)) && !gps.accepts(west));
        }
        assert!(gps.accepts(fix(34.5, -104.3)), "a good one still is");
    }
}
