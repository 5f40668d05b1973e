//! A frame's own marks outweigh the calibration: no position is computed with a borrowed mapping that they contradict.

use solaspect::aspect::{Expected, Quality, Solution, Stage, solve};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::builtin;
use solaspect::reasons::sun as reasons;
use solaspect::simulate::{Conditions, RandomScenes, SUN_RADIUS_ARCSEC};
use solaspect::units::PlateMil;

const EXPECTED: Option<Expected> = Some(Expected {
    radius_arcsec: SUN_RADIUS_ARCSEC,
});

/// Frames of the demo instrument that are fine without changes, and the position of the Sun on the plate.
fn frames() -> Vec<(Frame, PlateMil)> {
    let demo = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 1).unwrap();
    let frames = (0..24).map(|number| {
        let picture = scenes.scene(number).unwrap().picture().unwrap();
        (picture.frame, picture.truth.sun.unwrap().plate)
    });
    let fine =
        |(frame, _): &(Frame, _)| solve(frame, &demo, EXPECTED, None).quality == Quality::Fine;
    frames.filter(fine).collect()
}

/// The frame with its pixels rearranged.
fn reordered(frame: &Frame, place: impl Fn(usize, usize) -> (usize, usize)) -> Frame {
    let (width, height) = (frame.width(), frame.height());
    let Pixels::U8(pixels) = frame.pixels() else {
        panic!("the demo's pixels have 8 bits");
    };
    let pixel = |n: usize| {
        let (x, y) = place(n % width, n / width);
        pixels[y * width + x]
    };
    let pixels = Pixels::U8((0..width * height).map(pixel).collect());
    Frame::new(width, height, pixels, 255, FrameInfo::default()).unwrap()
}

fn has_no_place(solution: &Solution) {
    assert_eq!(solution.quality, Quality::None);
    assert!(solution.aspect.is_none());
    assert!(solution.track.is_none());
}

#[test]
fn a_mirrored_picture_is_called_so_and_has_no_place() {
    let demo = builtin("demo").unwrap();
    let frames = frames();
    assert!(frames.len() > 15, "{}", frames.len());
    let mut counts = [0; 2];
    for (frame, _) in &frames {
        let (last_x, last_y) = (frame.width() - 1, frame.height() - 1);
        let images = [
            reordered(frame, |x, y| (x, last_y - y)),
            reordered(frame, |x, y| (last_x - x, y)),
        ];
        for (image, count) in images.iter().zip(&mut counts) {
            let solution = solve(image, &demo, EXPECTED, None);
            assert_ne!(solution.quality, Quality::Fine);
            let stopped = solution.stopped.unwrap();
            if stopped.rejected.reason == reasons::MIRROR_IMAGE {
                assert_eq!(stopped.stage, Stage::Identification);
                has_no_place(&solution);
                *count += 1;
            }
        }
    }
    // A short row of marks may be its own mirror image.
    for count in counts {
        assert!(
            count * 10 >= frames.len() * 9,
            "{count} of {}",
            frames.len()
        );
    }
}

#[test]
fn a_camera_moved_farther_than_it_may_be_has_no_place_by_the_calibration() {
    for by_px in [160.0, 300.0, 900.0] {
        let mut instrument = builtin("demo").unwrap();
        instrument.mounting.plate_centre_px.x += by_px;
        let frames = frames();
        let mut none = 0;
        for (frame, sun) in &frames {
            let solution = solve(frame, &instrument, EXPECTED, None);
            match solution.quality {
                // A tilt of the camera could explain the shift.
                Quality::Fine => {
                    let found = solution.aspect.unwrap().sun_plate.position;
                    assert!(found.distance(*sun) < 1.0, "{found:?} {sun:?}");
                }
                Quality::Coarse => {}
                Quality::None => {
                    has_no_place(&solution);
                    none += 1;
                }
            }
        }
        // A short row of marks does not determine its place.
        let all = frames.len();
        assert!(none * 10 >= all * 8, "{none} of {all} at {by_px} px");
    }
}
