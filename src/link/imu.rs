//! Samples of the gondola's inertial measurement unit (IMU), which the aspect system receives as telemetry, one packet each.

use super::fields::{MessageError, Reader, Wire, Writer, fields, unix_time};
use super::packet::{TelemetryPacket, id, telemetry_type};
use jiff::Timestamp;

const KIND: u16 = telemetry_type::IMU as u16;

fields! {
    /// Payload of a sample's packet.
    Sample, format!("IMU sample {counter}: force {force_m_s2:?} m/s^2, rate {rate_rad_s:?} rad/s") => {
        counter: u16, "", "counts the samples (after 65535 comes 0)";
        /// Specific force, m/s^2: acceleration less gravitation.
        force_m_s2: [f32; 3] [
            "force_x_m_s2", "m/s^2", "mean specific force along the IMU's x axis";
            "force_y_m_s2", "m/s^2", "along its y axis";
            "force_z_m_s2", "m/s^2", "along its z axis";
        ];
        /// Rate relative to inertial space, rad/s.
        rate_rad_s: [f32; 3] [
            "rate_x_rad_s", "rad/s", "mean rate against inertial space about the x axis";
            "rate_y_rad_s", "rad/s", "about the y axis";
            "rate_z_rad_s", "rad/s", "about the z axis";
        ];
    }
}

/// Means over the interval that ends at a time, in the IMU's own axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuPacket {
    pub time: Timestamp,
    /// Counter of the samples; after 65535 it wraps to 0.
    pub counter: u16,
    /// Specific force, m/s^2: acceleration less gravitation.
    pub force_m_s2: [f32; 3],
    /// Rate relative to inertial space, rad/s.
    pub rate_rad_s: [f32; 3],
}

impl ImuPacket {
    /// Number of samples missing between this and a later one, by their counters; 0 if they came in another order, or the IMU restarted.
    pub fn missing_before(&self, later: &Self) -> u64 {
        let step = later.counter.wrapping_sub(self.counter);
        match step {
            1..0x8000 => u64::from(step) - 1,
            _ => 0,
        }
    }

    /// The sample without its time.
    pub fn sample(&self) -> Sample {
        Sample {
            counter: self.counter,
            force_m_s2: self.force_m_s2,
            rate_rad_s: self.rate_rad_s,
        }
    }

    /// The packet, as the controller sends it.
    ///
    /// # Errors
    /// Numbers that are not finite, and times that do not fit.
    pub fn packet(&self) -> Result<TelemetryPacket, MessageError> {
        let mut out = Writer::after_key(KIND);
        Sample::write(&self.sample(), &mut out, "sample")?;
        let time = unix_time(KIND, self.time)?;
        let payload = out.finish();
        Ok(TelemetryPacket::new(
            telemetry_type::IMU,
            id::CONTROLLER,
            time,
            payload,
        )?)
    }

    /// Reads a sample.
    ///
    /// # Errors
    /// Another type of telemetry, a payload that is too short, numbers that are not finite, an impossible time.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        if packet.kind() != telemetry_type::IMU {
            let kind = packet.kind();
            return Err(MessageError::UnknownTelemetry { kind });
        }
        let mut input = Reader::after_key(KIND, packet.payload());
        let Sample {
            counter,
            force_m_s2,
            rate_rad_s,
        } = Sample::read(&mut input, "sample")?;
        let (seconds, nanoseconds) = packet.time();
        let time = i32::try_from(nanoseconds).ok();
        let time = time.and_then(|ns| Timestamp::new(seconds.into(), ns).ok());
        let time = time.ok_or_else(|| MessageError::Time {
            key: KIND,
            found: format!("{seconds} s and {nanoseconds} ns"),
        })?;
        Ok(Self {
            time,
            counter,
            force_m_s2,
            rate_rad_s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::packet::{Direction, Packet};

    #[test]
    fn a_sample_is_read_as_it_was_sent_and_a_bad_one_is_an_error() {
        let sample = ImuPacket {
            time: Timestamp::new(1_379_786_400, 250_000_000).unwrap(),
            counter: 65_535,
            force_m_s2: [0.1, -0.2, -9.7],
            rate_rad_s: [1e-5, -7e-5, 4e-3],
        };
        let bytes = sample.packet().unwrap().encode();
        assert_eq!(bytes.len(), 42);
        let Ok(Packet::Telemetry(packet)) = Packet::decode(Direction::ToAspect, &bytes) else {
            panic!("no telemetry");
        };
        assert_eq!(ImuPacket::decode(&packet), Ok(sample));
        let counted = |counter| ImuPacket { counter, ..sample };
        assert_eq!(counted(65_535).missing_before(&counted(2)), 2);
        assert_eq!(counted(7).missing_before(&counted(6)), 0, "out of order");
        for (kind, time, length) in [
            (telemetry_type::IDLE, (0, 0), 26),
            (telemetry_type::IMU, (0, 2_000_000_000), 26),
            (telemetry_type::IMU, (0, 0), 25),
        ] {
            let packet = TelemetryPacket::new(kind, 1, time, vec![0; length]).unwrap();
            assert!(
                ImuPacket::decode(&packet).is_err(),
                "{kind} {time:?} {length}"
            );
        }
        let nan = [&[0, 0][..], &f32::NAN.to_le_bytes(), &[0; 20]].concat();
        let packet = TelemetryPacket::new(telemetry_type::IMU, 1, (0, 0), nan).unwrap();
        assert!(ImuPacket::decode(&packet).is_err());
    }
}
