//! Points that lie on one circle of the plate, and how far their errors are correlated.

use crate::geometry::Ellipse;
use crate::units::{Measured, SensorPx};
use nalgebra::{SMatrix, SVector, Vector2};

/// Points of the sensor that lie on one circle of the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline<'a> {
    /// An ellipse close to it.
    pub ellipse: Ellipse,
    /// Points, and 1 sigma across the outline, px.
    pub points: &'a [(SensorPx, f64)],
    /// Prior of the circle's radius.
    pub radius_mil: Measured,
}

/// Harmonics of the azimuth: the image of a circle departs from an ellipse near it by those up to the second.
const ELLIPSE_TERMS: usize = 5;
/// Those up to the sixth show errors that neighbouring points share.
const TERMS: usize = 13;
/// Chi^2 of the third to sixth harmonic that independent errors exceed once in 500 frames.
const MOST_INDEPENDENT: f64 = 24.0;

impl Outline<'_> {
    /// The factor of the points' sigmas that allows for correlated errors: unevenly scattered light or the Sun's motion shift
    /// neighbouring points alike. Their amplitude in the low harmonics that an ellipse does not have is taken for that in the
    /// harmonics that it has; 1 where independent errors explain it.
    pub(super) fn correlated_inflation(&self) -> f64 {
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        for (at, sigma_px) in self.points {
            let w = self.ellipse.to_disc(at.vector());
            let terms = harmonics(w.normalize()) / *sigma_px;
            matrix.ger(1.0, &terms, &terms, 1.0);
            right.axpy(self.ellipse.excess_at(w) / sigma_px, &terms, 1.0);
        }
        let of_all = matrix.cholesky().map(|root| root.solve(&right).dot(&right));
        let right = right.fixed_rows::<ELLIPSE_TERMS>(0).into_owned();
        let matrix = matrix
            .fixed_view::<ELLIPSE_TERMS, ELLIPSE_TERMS>(0, 0)
            .into_owned();
        let of_ellipse = matrix.cholesky().map(|root| root.solve(&right).dot(&right));
        match (of_all, of_ellipse) {
            (Some(all), Some(ellipse)) if all - ellipse > MOST_INDEPENDENT => {
                ((all - ellipse) / (TERMS - ELLIPSE_TERMS) as f64).sqrt()
            }
            _ => 1.0,
        }
    }
}

/// 1, then cosine and sine of the multiples of a direction's angle.
fn harmonics(direction: Vector2<f64>) -> SVector<f64, TERMS> {
    let mut terms = SVector::<f64, TERMS>::zeros();
    terms[0] = 1.0;
    let (cos, sin) = (direction.x, direction.y);
    let mut multiple = direction;
    for pair in terms.as_mut_slice()[1..].chunks_exact_mut(2) {
        pair.copy_from_slice(&[multiple.x, multiple.y]);
        multiple = Vector2::new(
            multiple.x * cos - multiple.y * sin,
            multiple.y * cos + multiple.x * sin,
        );
    }
    terms
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;

    /// The inflation of a circle's points that lie off it by a function of number and azimuth, in sigma.
    fn inflation(off: impl Fn(i32, f64) -> f64) -> f64 {
        let ellipse = Ellipse::new(Vector2::new(400.0, 300.0), Matrix2::identity() * 95.0).unwrap();
        let points: Vec<(SensorPx, f64)> = (0..90)
            .map(|n| {
                let angle = f64::from(n) * 0.0698;
                let r = 1.0 + 0.1 * off(n, angle) / 95.0;
                let at = ellipse.from_disc(Vector2::new(angle.cos(), angle.sin()) * r);
                (at.into(), 0.1)
            })
            .collect();
        let outline = Outline {
            ellipse,
            points: &points,
            radius_mil: Measured::new(547.0, 1.0),
        };
        outline.correlated_inflation()
    }

    #[test]
    fn errors_that_neighbouring_points_share_inflate_their_sigmas_and_no_others() {
        assert_eq!(inflation(|n, _| f64::from(n % 2 * 2 - 1)), 1.0);
        assert_eq!(inflation(|_, angle| 3.0 * (2.0 * angle + 0.3).cos()), 1.0);
        let shared = inflation(|_, angle| 3.0 * (3.0 * angle + 0.3).cos());
        assert!((6.0..8.0).contains(&shared), "{shared}");
    }
}
