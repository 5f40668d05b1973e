//! Fly with a camera and a controller of your own: docs/own-gondola.md. `cargo run --release --example own_gondola`

use jiff::Timestamp;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::link::{Connection, Controller, InProcess, Message};
use solaspect::plan::{Options, Plan, Replay};
use solaspect::service::{Flight, Service};
use solaspect::simulate::{Scene, Sun};
use solaspect::{instrument::builtin, sky, units::PlateMil};
use std::{path::Path, thread, time::Duration};

/// Stands for the driver of a real camera: four frames per second of a Sun that drifts over the plate.
struct MyCamera(Scene, u64);

impl FrameSource for MyCamera {
    /// Waits for one frame, for at most one second; returns `Take::NotYet` if there is none.
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let Self(scene, number) = self;
        if *number == 8 {
            return Ok(Take::End);
        }
        thread::sleep(Duration::from_millis(250));
        let announced = Timestamp::now();
        starts(announced); // The controller gets notice of each exposure before it begins.
        scene.sun.iter_mut().for_each(|sun| sun.centre.x += 50.0);
        let mut frame = scene.frame()?;
        frame.info.number = Some(*number);
        frame.info.mid_exposure = Some(announced + Duration::from_micros(7_500));
        *number += 1;
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}

fn open_my_camera() -> Result<MyCamera, CameraError> {
    let demo = builtin("demo").map_err(CameraError::own)?;
    let mapping = demo.nominal_mapping().ok_or("no mapping");
    let mut scene = Scene::new(&demo, mapping.map_err(CameraError::own)?);
    let radius_mil = demo
        .optics
        .radius_mil(sky::sun_angular_radius(Timestamp::now())?);
    scene.sun = Some(Sun::new(PlateMil::new(-300.0, 200.0), radius_mil));
    Ok(MyCamera(scene, 0))
}

/// Stands for the gondola's controller: it starts tracking, and prints the offsets that it would use for steering.
struct MyController(Option<Message>);

impl Controller for MyController {
    fn hear(&mut self, message: &Message) {
        if let Message::Solution(offset) = message {
            println!("{offset:?}");
        }
    }

    fn say(&mut self) -> Option<Message> {
        self.0.take()
    }
}

fn main() -> anyhow::Result<()> {
    let configuration = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/own_gondola.toml");
    let (plan, remarks) = Plan::survey(Some(Path::new(configuration)), &Options::default());
    remarks.without_errors()?;
    let mut flight = Flight::of_plan(&plan, Replay::default())?;
    flight.bring_camera("camera", open_my_camera)?;
    flight.line = Connection::over(InProcess::new(MyController(Some(Message::StartTracking))));
    flight.claim()?; // Two programs never write to one archive.
    flight.open_cameras()?;
    println!("{}", Service::start(flight)?.join()?);
    Ok(())
}
