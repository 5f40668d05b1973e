//! The filter's estimate, and the correction of its errors.

use super::model::Model;
use super::motion::{Interval, Motion};
use super::states::{ATTITUDE, Layout, POSITION, VELOCITY};
use nalgebra::{DVector, UnitQuaternion, Vector3};

/// Motion, and the errors of the sensors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Estimate {
    pub motion: Motion,
    /// In the order of [`Layout::imu`].
    pub imu: [Vector3<f64>; 6],
    /// Misalignments, rad.
    pub cameras: Vec<Vector3<f64>>,
    pub correlated: Vec<[Vector3<f64>; 3]>,
}

impl Estimate {
    /// A motion, with sensors without errors except for the stated biases.
    pub fn new(motion: Motion, model: &Model) -> Self {
        let Model { settings, layout } = model;
        let (imu, zero) = (&settings.imu, Vector3::zeros());
        let biases = [imu.accelerometer_bias_m_s2, imu.gyro_bias_rad_s];
        Self {
            motion,
            imu: [biases[0], biases[1], zero, zero, zero, zero],
            cameras: vec![zero; layout.cameras.len()],
            correlated: vec![[zero; 3]; layout.correlated.len()],
        }
    }

    /// Corrected specific force and rate of the body from the IMU's measurements.
    pub fn felt(&self, said: &Interval) -> Interval {
        let [
            force_bias,
            rate_bias,
            force_scale,
            rate_scale,
            force_axes,
            rate_axes,
        ] = &self.imu;
        let (f, w) = (said.force_m_s2, said.rate_rad_s);
        Interval {
            force_m_s2: f - force_bias - f.component_mul(force_scale) - force_axes.cross(&f),
            rate_rad_s: w - rate_bias - w.component_mul(rate_scale) - rate_axes.cross(&w),
            ..*said
        }
    }

    /// Propagates over an interval with corrected force and rate; correlated errors decay.
    pub fn advance(&mut self, felt: &Interval, layout: &Layout) {
        self.motion = self.motion.advanced(felt);
        for (own, layout) in self.correlated.iter_mut().zip(&layout.correlated) {
            for (error, correlated) in own.iter_mut().zip(layout) {
                if let Some(correlated) = correlated {
                    *error *= (-felt.length_s() / correlated.time_s).exp();
                }
            }
        }
    }

    /// Subtracts estimated errors.
    pub fn correct(&mut self, errors: &DVector<f64>, layout: &Layout) {
        let part = |first| errors.fixed_rows::<3>(first).into_owned();
        let motion = [POSITION, VELOCITY, ATTITUDE].map(part);
        self.motion = self.motion.corrected(&motion[0], &motion[1], &motion[2]);
        self.each_triad(layout, |first, triad| *triad += part(first));
    }

    /// The error of `other` relative to this estimate.
    pub fn minus(&self, other: &Self, layout: &Layout) -> DVector<f64> {
        let mut errors = DVector::zeros(layout.len());
        let mut set = |first: usize, part: &Vector3<f64>| {
            errors.fixed_rows_mut::<3>(first).copy_from(part);
        };
        let (own, before) = (&self.motion, &other.motion);
        set(POSITION, &(own.position_m - before.position_m));
        set(VELOCITY, &(own.velocity_m_s - before.velocity_m_s));
        let turn: UnitQuaternion<f64> = own.attitude * before.attitude.inverse();
        set(ATTITUDE, &turn.scaled_axis());
        let mut apart = self.clone();
        let mut triads = Vec::new();
        let mut others = other.clone();
        others.each_triad(layout, |_, triad| triads.push(*triad));
        let mut triads = triads.into_iter();
        apart.each_triad(layout, |first, triad| {
            let before = triads.next().unwrap_or_default();
            set(first, &(*triad - before));
        });
        errors
    }

    /// The estimated errors of sensors, each with the index of its first state.
    pub fn each_triad(&mut self, layout: &Layout, mut each: impl FnMut(usize, &mut Vector3<f64>)) {
        for (own, triad) in self.imu.iter_mut().zip(&layout.imu) {
            triad.iter().for_each(|triad| each(triad.first, own));
        }
        for (own, triad) in self.cameras.iter_mut().zip(&layout.cameras) {
            triad.iter().for_each(|triad| each(triad.first, own));
        }
        for (own, of_camera) in self.correlated.iter_mut().zip(&layout.correlated) {
            for (own, correlated) in own.iter_mut().zip(of_camera) {
                correlated
                    .iter()
                    .for_each(|correlated| each(correlated.triad.first, own));
            }
        }
    }
}
