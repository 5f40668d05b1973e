//! Positions of pixels relative to an ellipse: distance outwards from it, and sector.

use super::{LANES, WHOLES, smaller};
use multiversion::multiversion;

/// Neighbouring pixels of a row.
pub struct Run<'a> {
    /// Position of the first pixel relative to the ellipse's centre, px.
    pub x: f32,
    pub y: f32,
    pub light_dn: &'a [f32],
    pub masked: &'a [bool],
}

/// The pixels within reach of an ellipse, in sectors.
pub struct Ring {
    /// Inverse of the ellipse's square root: xx, xy, yy, 1/px.
    pub inverse: [f32; 3],
    pub inside_px: f32,
    pub outside_px: f32,
    pub sectors: usize,
}

/// Upper bound of the number of sectors of a ring: a power of 2, so that an index needs no check.
pub const MOST_SECTORS: usize = 1024;

/// Positions of some pixels of a run; the last group is padded with unwanted ones.
#[derive(Clone, Copy)]
pub struct Located {
    /// Distance outwards from the ellipse, to first order.
    pub away_px: [f32; LANES],
    /// Sector, below [`MOST_SECTORS`]; for masked pixels and those out of reach, the number of sectors.
    pub sector: [u32; LANES],
}

/// Locates the pixels of runs.
///
/// Directions are measured by y / (|x| + |y|), which is uniform enough in angle for sectors and needs no arctangent.
#[multiversion(targets("x86_64+avx2"))]
pub fn locate(ring: &Ring, runs: &[Run<'_>], found: &mut Vec<Located>) {
    let [a, b, c] = ring.inverse;
    let (sectors, beyond) = (ring.sectors as i32 as f32, MOST_SECTORS as u32);
    for run in runs {
        let (whole, rest) = run.masked.as_chunks::<LANES>();
        let mut last = [true; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let (first_u, first_v) = (a * run.x + b * run.y, b * run.x + c * run.y);
        for n in 0..run.masked.len().div_ceil(LANES) {
            let masked = whole.get(n).unwrap_or(&last);
            let first = (n * LANES) as i32 as f32;
            let (mut away_px, mut sector) = ([0.0; LANES], [0; LANES]);
            for k in 0..LANES {
                let x = first + k as i32 as f32;
                let (u, v) = (first_u + a * x, first_v + b * x);
                let r2 = u * u + v * v;
                let (nx, ny) = (a * u + b * v, b * u + c * v);
                let per_normal = 1.0 / (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
                let along = v / (u.abs() + v.abs() + f32::MIN_POSITIVE);
                let quarters = if u >= 0.0 { 1.0 + along } else { 3.0 - along };
                away_px[k] = (r2 - r2.sqrt()) * per_normal;
                let is_within = (away_px[k] >= -ring.inside_px) & (away_px[k] < ring.outside_px);
                let nearest = smaller(quarters * (0.25 * sectors) - 0.5, sectors - 1.0);
                let chosen = if is_within & !masked[k] {
                    nearest
                } else {
                    sectors
                };
                // The addition rounds the number, which is then in the last bits of the sum.
                sector[k] = (chosen + WHOLES).to_bits() % beyond;
            }
            found.push(Located { away_px, sector });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_lie_where_plain_arithmetic_puts_them() {
        const SECTORS: usize = 96;
        let ring = Ring {
            inverse: [1.0 / 95.2, 1e-5, 1.0 / 94.9],
            inside_px: 7.0,
            outside_px: 6.0,
            sectors: SECTORS,
        };
        for (y, start, count) in [(-30.3, -98.7, 29), (40.2, 70.1, 21), (-93.0, -31.9, 64)] {
            let masked: Vec<bool> = (0..count).map(|n| n % 5 == 2).collect();
            let light_dn = &vec![0.0; count];
            let run = Run {
                x: start,
                y,
                light_dn,
                masked: &masked,
            };
            let mut found = Vec::new();
            locate(&ring, &[run], &mut found);
            let lanes = || {
                found
                    .iter()
                    .flat_map(|f| f.away_px.into_iter().zip(f.sector))
            };
            assert!(
                lanes()
                    .skip(count)
                    .all(|(_, sector)| sector as usize == SECTORS)
            );
            for (n, (away_px, sector)) in lanes().take(count).enumerate() {
                let (x, y) = (f64::from(start) + n as f64, f64::from(y));
                let [a, b, c] = ring.inverse.map(f64::from);
                let (u, v) = (a * x + b * y, b * x + c * y);
                let normal = (a * u + b * v).hypot(b * u + c * v);
                let expected = (u.hypot(v) - 1.0) * u.hypot(v) / normal;
                assert!((f64::from(away_px) - expected).abs() < 1e-4);
                let along = v / (u.abs() + v.abs());
                let quarters = if u >= 0.0 { 1.0 + along } else { 3.0 - along };
                let is_wanted = !masked[n] && (-7.0..6.0).contains(&expected);
                match is_wanted {
                    true => assert_eq!(sector, (24.0 * quarters) as u32),
                    false => assert_eq!(sector as usize, SECTORS),
                }
            }
        }
    }
}
