//! Contradictions between values that are allowed individually: the same rules apply to a file, a command and saved values.

use super::{Config, ConfiguredCamera, Refused};
use crate::camera::Source;
use crate::instrument::Role;
use crate::link::PortAddress;
use crate::output::Destination;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

impl Config {
    /// Faults that prevent a flight with this configuration: missing values and contradictions.
    pub fn faults(&self) -> Vec<Refused> {
        let plates = self
            .cameras
            .flying()
            .filter(|camera| camera.role == Role::PitchYaw);
        let contradictions = self.contradictions(plates.count());
        self.missing().into_iter().chain(contradictions).collect()
    }

    /// Missing required values without a default: the first camera, the instrument of every real camera that sees a plate, and the file
    /// of one that sees the Moon.
    fn missing(&self) -> Vec<Refused> {
        let none = |key: String, expected: &str| Refused {
            key: key.into(),
            expected: expected.into(),
            found: "none".into(),
        };
        let mut missing = Vec::new();
        let first = self.cameras.first();
        if first.source.is_none() {
            let expected =
                "a camera, such as \"gige:192.168.1.20\" (\"simulated\" for the simulator)";
            missing.push(none(format!("{}.source", first.name), expected));
        }
        if first.role != Role::PitchYaw {
            missing.push(Refused {
                key: format!("{}.role", first.name).into(),
                expected: "\"pitch_yaw\": the controller receives this camera's solutions".into(),
                found: format!("\"{}\"", first.role.name()),
            });
        }
        for camera in self
            .cameras
            .flying()
            .filter(|camera| camera.instrument.is_none())
        {
            let of_camera =
                |source: &Source| source.is_real() || matches!(source, Source::Followed(..));
            let is_real = camera.source.as_ref().is_some_and(of_camera);
            let expected = camera.role.needed_file(is_real);
            let key = format!("{}.instrument", camera.name);
            missing.extend(expected.map(|expected| none(key, expected)));
        }
        if self.navigation.is_enabled() && self.navigation.settings.is_none() {
            let expected =
                "the file that states IMU, GPS and cameras: NAV.toml (docs/navigation.md)";
            missing.push(none("navigation.settings".into(), expected));
        }
        missing
    }

    /// Contradictions with this number of pitch-yaw cameras.
    pub fn contradictions(&self, pitch_yaw_cameras: usize) -> Vec<Refused> {
        // The first camera always flies.
        let first = self.cameras.first();
        let others = self
            .cameras
            .flying()
            .filter(|camera| camera.name != first.name);
        let cameras = std::iter::once(first).chain(others);
        let mut found: Vec<Refused> = cameras.flat_map(exposure).collect();
        found.extend(self.too_many_cameras());
        found.extend(self.space());
        found.extend(self.sending_camera(pitch_yaw_cameras));
        found.extend(self.shared_ports());
        found.extend(self.shared_destinations());
        found
    }

    /// Cameras for which the line has no number.
    fn too_many_cameras(&self) -> Option<Refused> {
        let roles: Vec<Role> = self.cameras.flying().map(|camera| camera.role).collect();
        let numbers = Role::numbers(&roles).into_iter();
        let (_, camera) = numbers
            .zip(self.cameras.flying())
            .find(|(number, _)| *number > Role::MOST_NUMBERED)?;
        Some(Refused {
            key: format!("{}.source", camera.name).into(),
            expected:
                "at most eight cameras beside five of the plate and the first of each other role"
                    .into(),
            found: format!("{} cameras", roles.len()),
        })
    }

    fn space(&self) -> impl Iterator<Item = Refused> {
        let limits = self.archive.space_limits();
        let above = |key: &'static str, value: f64, limit, most: f64| {
            (value > most).then(|| Refused {
                key: key.into(),
                expected: format!("at most {limit}, {most}"),
                found: value.to_string(),
            })
        };
        let (thin, stop) = (limits.thin_percent, limits.stop_percent);
        let thin_key = "archive.thin_free_percent";
        let stop_key = "archive.stop_free_percent";
        let thin_found = above(thin_key, thin, "warn_free_percent", limits.warn_percent);
        let stop_found = above(stop_key, stop, "thin_free_percent", thin);
        thin_found.into_iter().chain(stop_found)
    }

    fn sending_camera(&self, pitch_yaw_cameras: usize) -> Option<Refused> {
        let sending = self.link.sending_camera;
        (sending as usize > pitch_yaw_cameras.max(1)).then(|| Refused {
            key: "link.sending_camera".into(),
            expected: format!("a pitch-yaw camera that flies: at most {pitch_yaw_cameras}"),
            found: sending.to_string(),
        })
    }

    /// The lines that are read, each with its key: the controller's, and those of sensors that fly.
    fn lines(&self) -> impl Iterator<Item = (&'static str, PortAddress)> {
        let flies = self.navigation.is_enabled();
        let sensor = |address| flies.then_some(address);
        let lines = [
            ("link.port", Some(self.link.address())),
            ("navigation.imu_port", sensor(self.navigation.imu_address())),
            ("navigation.gps_port", sensor(self.navigation.gps_address())),
        ];
        let readable =
            |(key, address): (_, Option<Result<Option<_>, _>>)| Some((key, address?.ok()??));
        lines.into_iter().filter_map(readable)
    }

    /// Lines with a port that another line reads, too.
    fn shared_ports(&self) -> Vec<Refused> {
        let taken = |(key, address): (&'static str, PortAddress)| {
            // A sensor's line takes any free port.
            let local_port = u16::try_from(self.link.udp_local_port).ok();
            let local_port = local_port.filter(|_| key == "link.port");
            Some((key, address.takes(local_port)?))
        };
        let taken: Vec<_> = self.lines().filter_map(taken).collect();
        let shared = |(n, (key, own)): (usize, &(&'static str, String))| {
            let (other, _) = taken[..n].iter().find(|(_, other)| other == own)?;
            Some(Refused {
                key: (*key).into(),
                expected: format!("a port of its own, not that of {other}"),
                found: own.clone(),
            })
        };
        taken.iter().enumerate().filter_map(shared).collect()
    }

    /// Outputs with the same destination as another one, as the controller or as a sensor.
    fn shared_destinations(&self) -> Vec<Refused> {
        let mut taken = Vec::new();
        for (key, address) in self.lines() {
            let ends = [own_end(&address, self.link.udp_local_port), Some(address)];
            let ends = ends.into_iter().flatten().map(Destination::Port);
            taken.extend(ends.map(|end| (key.to_owned(), end)));
        }
        let mut shared = Vec::new();
        for (name, output) in self.outputs.flying() {
            let Some(to) = &output.to else { continue };
            let key = format!("{name}.to");
            let other = taken.iter().find(|(_, other)| to.is_same_place(other));
            shared.extend(other.map(|(other, _)| Refused {
                key: key.clone().into(),
                expected: format!("a place of its own, not that of {other}"),
                found: format!("\"{to}\""),
            }));
            taken.push((key, to.clone()));
        }
        shared
    }
}

/// Local address of a line over UDP, at which datagrams of this computer reach it.
fn own_end(line: &PortAddress, default_port: u32) -> Option<PortAddress> {
    let PortAddress::Udp { peer, local_port } = line else {
        return None;
    };
    let port = local_port.or(u16::try_from(default_port).ok())?;
    let address: IpAddr = match peer {
        SocketAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        SocketAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
    };
    Some(PortAddress::Udp {
        peer: (address, port).into(),
        local_port: None,
    })
}

/// An exposure must end before the next frame, and the automatic exposure's minimum must be below its maximum.
fn exposure(camera: &ConfiguredCamera) -> Vec<Refused> {
    let period_us = 1e6 / camera.rate_hz;
    let (shortest, longest) = (camera.auto_exposure_min_us, camera.auto_exposure_max_us);
    let refused = |name: &str, expected: String, found: u32| Refused {
        key: format!("{}.{name}", camera.name).into(),
        expected,
        found: found.to_string(),
    };
    let mut wrong = Vec::new();
    if f64::from(camera.exposure_us) > period_us {
        let expected = format!("less than the {period_us:.0} us from frame to frame at rate_hz");
        wrong.push(refused("exposure_us", expected, camera.exposure_us));
    }
    if camera.auto_exposure().is_some() && shortest >= longest {
        let expected = format!("less than auto_exposure_max_us, {longest}");
        wrong.push(refused("auto_exposure_min_us", expected, shortest));
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Output, Outputs};

    fn found(link: Option<&str>, outputs: &[&str]) -> Vec<String> {
        let mut config = Config::default();
        config.link.port = link.map(str::to_owned);
        let output = |to: &&str| Output {
            to: Some(to.parse().unwrap()),
            ..Output::default()
        };
        config.outputs = Outputs::from_iter(outputs.iter().map(output));
        let refused = config.shared_destinations();
        refused.iter().map(Refused::to_string).collect()
    }

    #[test]
    fn each_output_has_a_place_of_its_own() {
        let good = [
            "udp:10.0.0.1:5000",
            "udp:10.0.0.2:5000",
            "serial:/dev/ttyS1",
            "tcp-listen:0.0.0.0:5000",
        ];
        assert_eq!(found(Some("/dev/ttyS0"), &good), [""; 0]);
        assert_eq!(found(Some("udp:10.0.0.1:2000"), &good), [""; 0]);
        for (link, outputs, words) in [
            (
                None,
                ["udp:10.0.0.1:5000", "udp:10.0.0.1:5000"],
                "output-2.to: expected a place of its own, not that of output.to, found \"udp:10.0.0.1:5000\"",
            ),
            (
                Some("/dev/../dev/null"),
                ["udp:10.0.0.1:5000", "serial:/dev/null"],
                "output-2.to: expected a place of its own, not that of link.port, found \"serial:/dev/null\"",
            ),
            (
                Some("udp:10.0.0.1:2000"),
                ["udp:10.0.0.1:2000", "udp:10.0.0.1:5000"],
                "output.to: expected a place of its own, not that of link.port, found \"udp:10.0.0.1:2000\"",
            ),
            (
                Some("udp:10.0.0.1:2000@3000"),
                ["udp:127.0.0.1:2000", "udp:127.0.0.1:3000"],
                "output-2.to: expected a place of its own, not that of link.port, found \"udp:127.0.0.1:3000\"",
            ),
        ] {
            assert_eq!(found(link, &outputs), [words]);
        }
    }
}
