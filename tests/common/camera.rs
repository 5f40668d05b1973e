//! The next exposure of a camera, after any number of errors.

use solaspect::camera::{Exposure, FrameSource, Take};
use solaspect::frame::Frame;
use std::time::{Duration, Instant};

/// Timeout for the slowest machine; no result depends on it.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// The next exposure; errors before it are appended to `errors`.
pub fn next(camera: &mut dyn FrameSource, errors: &mut Vec<String>) -> Exposure {
    let begun = Instant::now();
    let mut announced = Vec::new();
    while begun.elapsed() < TIMEOUT {
        match camera.next(&mut |time| announced.push(time)) {
            Ok(Take::Exposure(exposure)) => {
                assert_eq!(announced.last(), Some(&exposure.announced));
                return *exposure;
            }
            Ok(Take::NotYet) => {}
            Ok(Take::End) => panic!("a camera has no end"),
            Err(error) => errors.push(error.to_string()),
        }
    }
    panic!("no frame: {errors:?}");
}

pub fn frame(camera: &mut dyn FrameSource) -> Frame {
    next(camera, &mut Vec::new()).frame
}

/// The first error of an absent camera.
pub fn absent(camera: &mut dyn FrameSource) -> String {
    let begun = Instant::now();
    loop {
        match camera.next(&mut |_| panic!("nothing begins")) {
            Err(error) => return error.to_string(),
            Ok(take) => assert!(matches!(take, Take::NotYet), "{take:?}"),
        }
        assert!(begun.elapsed() < TIMEOUT);
    }
}
