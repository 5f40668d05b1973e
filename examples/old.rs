//! Fly with a camera of your own: implement `FrameSource` and give it to the service.
//!
//! `cargo run --release --example own_camera`

use anyhow::Context;
use jiff::Timestamp;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::geometry::Mapping;
use solaspect::instrument::{self, Instrument};
use solaspect::service::{Flight, FlightCamera, Service};
use solaspect::simulate::{Scene, Sun};
use solaspect::sky;
use solaspect::units::PlateMil;
use std::time::Duration;

/// Stands for the driver of a real camera: four frames a second of a Sun that drifts over the plate.
struct DriftingSun {
    instrument: Instrument,
    mapping: Mapping,
    number: u64,
}

const FRAMES: u64 = 8;
const PERIOD: Duration = Duration::from_millis(250);
const EXPOSURE: Duration = Duration::from_millis(15);

impl FrameSource for DriftingSun {
    /// Waits for one frame. It must return within a second: `Take::NotYet` where no frame is complete.
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.number == FRAMES {
            return Ok(Take::End);
        }
        std::thread::sleep(PERIOD);
        // The controller is told the time of each exposure before it begins.
        let announced = Timestamp::now();
        starts(announced);
        let x_mil = -300.0 + 50.0 * self.number as f64;
        let radius_arcsec = sky::sun_angular_radius(announced)?;
        let radius_mil = self.instrument.optics.radius_mil(radius_arcsec);
        let mut scene = Scene::new(&self.instrument, self.mapping);
        scene.sun = Some(Sun::new(PlateMil::new(x_mil, 200.0), radius_mil));
        let mut frame = scene.frame()?;
        frame.info.number = Some(self.number);
        // Every time is mid-exposure.
        frame.info.mid_exposure = Some(announced + EXPOSURE / 2);
        frame.info.exposure = Some(EXPOSURE);
        self.number += 1;
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}

fn main() -> anyhow::Result<()> {
    let instrument = instrument::builtin("demo")?;
    let mapping = instrument.nominal_mapping().context("no mapping")?;
    let camera = DriftingSun {
        instrument: instrument.clone(),
        mapping,
        number: 0,
    };
    // `Flight` also takes archives (`stores`), the controller's line and a configuration.
    let flight = Flight::of(vec![FlightCamera::of_plate(instrument, camera)]);
    let (service, answers) = Service::start_watched(flight)?;
    for answer in answers {
        let Some(aspect) = answer.sun().and_then(|sun| sun.solution.aspect.as_ref()) else {
            continue;
        };
        let at = aspect.sun_plate.position;
        println!(
            "{}: Sun at {:.1}, {:.1} mil",
            answer.solved.quality.name(),
            at.x,
            at.y
        );
    }
    println!("{}", service.join()?);
    Ok(())
}
