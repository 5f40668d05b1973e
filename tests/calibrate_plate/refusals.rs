//! Sets of frames that give no calibration.

use super::scenes::calibrate;
use solaspect::calibrate::plate::{MissingCoverage, Refusal};
use solaspect::fits::{self, Compression};
use solaspect::instrument::builtin;
use solaspect::simulate::{Conditions, Depth, RandomScenes, Scene};
use solaspect::units::PlateMil;
use std::path::{Path, PathBuf};

/// The message with which a set of frames is refused.
fn refused(given: &[PathBuf]) -> String {
    let start = builtin("demo").unwrap();
    let text = calibrate(given, &start).unwrap_err().to_string();
    assert!(!text.contains('\n'), "{text}");
    text
}

/// Writes frames whose Sun's centre satisfies `sun`, each scene edited by `change`.
fn frames(folder: &Path, count: u64, sun: fn(PlateMil) -> bool, change: impl Fn(u64, &mut Scene)) {
    let demo = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 5).unwrap();
    let mut written = 0;
    for number in 0.. {
        let mut scene = scenes.scene(number).unwrap();
        if !scene.sun.as_ref().is_some_and(|s| sun(s.centre)) {
            continue;
        }
        scene.info.mid_exposure = Some("2013-09-21T18:00:00Z".parse().unwrap());
        change(written, &mut scene);
        let file = folder.join(format!("{written:03}.fits"));
        fits::write_frame(&file, &scene.frame().unwrap(), &[], &[], Compression::Rice).unwrap();
        written += 1;
        if written == count {
            break;
        }
    }
}

#[test]
fn a_set_that_gives_no_calibration_is_refused_with_what_to_take_instead() {
    let root = tempfile::tempdir().unwrap();
    let folder = |name: &str| {
        let folder = root.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        folder
    };
    let few = folder("few");
    frames(&few, 3, |_| true, |_, _| ());
    let text = refused(&[few]);
    assert!(
        text.contains("too few marks") && text.contains("take more frames"),
        "{text}"
    );

    let one_place = folder("one place");
    let central = |sun: PlateMil| sun.x.hypot(sun.y) < 260.0;
    frames(&one_place, 6, central, |_, _| ());
    let text = refused(&[one_place]);
    assert!(
        text.contains("one place") && text.contains("all over the plate"),
        "{text}"
    );

    let timeless = folder("timeless");
    frames(
        &timeless,
        4,
        |_| true,
        |_, scene| scene.info.mid_exposure = None,
    );
    let text = refused(&[timeless]);
    assert!(text.contains("time") && text.contains("DATE-OBS"), "{text}");

    let mixed = folder("mixed");
    let names = |n: u64, scene: &mut Scene| scene.info.camera = Some(format!("camera {}", n % 2));
    frames(&mixed, 4, |_| true, names);
    let text = refused(&[mixed]);
    assert!(
        text.contains("\"camera 0\"") && text.contains("one camera and setting"),
        "{text}"
    );

    let two_depths = folder("two depths");
    let deeper = |n: u64, scene: &mut Scene| {
        if n % 2 == 1 {
            scene.depth = Depth::Twelve;
        }
    };
    frames(&two_depths, 4, |_| true, deeper);
    let text = refused(&[two_depths]);
    assert!(
        text.contains("255 DN") && text.contains("one camera and setting"),
        "{text}"
    );

    let empty = folder("empty");
    let text = refused(&[empty]);
    assert!(text.contains("expected frames"), "{text}");

    let text = refused(&[root.path().join("nowhere")]);
    assert!(
        text.contains("nowhere") && text.contains("cannot read"),
        "{text}"
    );
}

#[test]
fn frames_that_do_not_determine_the_plate_are_named_with_the_parts_to_photograph() {
    let lack = MissingCoverage {
        pose: "folder, pose 2".into(),
        frames: 3,
        marks: 1,
        unseen: vec!["the upper left", "the bottom"],
    };
    let text = Refusal::Undetermined(vec![lack]).to_string();
    assert_eq!(
        text,
        "the frames do not determine the plate: folder, pose 2 has 3 frames that show 1 mark; take frames in it with the Sun in the upper left, the bottom of the plate"
    );
}
