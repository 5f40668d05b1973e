//! Uncertainty of roll and pitch from an edge, by height, field, resolution and atmosphere: Braun and Barf 2022, section 4,
//! figures 19 to 22.

use nalgebra::{UnitVector3, Vector3};
use solaspect::geometry::camera::CameraModel;
use solaspect::horizon::{
    Departure, EdgeHeight, EdgePoint, EdgeRay, EdgeRays, Refraction, Sphere, nadir,
};
use solaspect::report::plot::{Labels, Series, series};
use solaspect::units::{Measured, SensorPx};
use std::f64::consts::TAU;

/// Parameters of a level camera that points forward.
#[derive(Clone, Copy)]
struct Case {
    height_km: f64,
    field_deg: f64,
    rows: f64,
    atmosphere_km: f64,
}

const USUAL: Case = Case {
    height_km: 200.0,
    field_deg: 94.4,
    rows: 1080.0,
    atmosphere_km: 0.0,
};

/// Errors of the edge as in the paper's figure 18: 1 px, correlated over 300 px in a picture of 1080 rows.
const NOISE_PX: f64 = 1.0;
const ALIKE_ROWS: f64 = 300.0 / 1080.0;
/// Number of points around the whole edge, in view or not.
const POINTS: u32 = 4000;

impl Case {
    /// 1 sigma of roll and pitch, deg; `None` if the edge is not in view.
    fn errors_deg(&self) -> Option<[f64; 2]> {
        let width = self.rows * 16.0 / 9.0;
        let focal_px = width / 2.0 / (self.field_deg / 2.0).to_radians().tan();
        let middle = SensorPx::new((width - 1.0) / 2.0, (self.rows - 1.0) / 2.0);
        let camera = CameraModel::rectilinear(focal_px, middle);
        let exact = |km: f64| Measured::new(km * 1e3, 0.0);
        let (height, edge) = (exact(self.height_km), exact(self.atmosphere_km));
        let sphere = Sphere::earth(height, edge, Refraction::None)?;
        let angle = sphere.half_angle_rad.value;
        let point = |n: u32| {
            let around = f64::from(n) / f64::from(POINTS) * TAU;
            let at = |angle: f64| {
                let level = Vector3::new(around.cos(), 0.0, around.sin());
                let ray = Vector3::y() * angle.cos() + level * angle.sin();
                camera.pixel(&UnitVector3::new_normalize(ray))
            };
            let (on, inside) = (at(angle)?, at(angle - 1e-4)?);
            let in_view = (0.0..width).contains(&on.x) && (0.0..self.rows).contains(&on.y);
            let inward = (inside.vector() - on.vector()).normalize();
            let point = EdgePoint {
                at: on,
                inward,
                sigma_px: 0.01,
                of_brightness_px: 0.0,
            };
            in_view.then(|| EdgeRay::of(&point, &camera)).flatten()
        };
        let edge = EdgeRays {
            rays: (0..POINTS).filter_map(point).collect(),
            sigma_rad: 0.0,
        };
        let departure = Departure {
            sigma_rad: NOISE_PX / focal_px,
            length_rad: ALIKE_ROWS * self.rows / focal_px,
        };
        let found = nadir(&[edge], &sphere, EdgeHeight::Given, departure).ok()?;
        let covariance = found.direction.covariance_rad2;
        Some([covariance.m11, covariance.m33].map(|variance| variance.sqrt().to_degrees()))
    }
}

/// Data of a figure of the paper: one case for each value on its axis.
fn figure(name: &str, axis: &str, values: &[f64], case: impl Fn(f64) -> Case) -> Vec<[f64; 2]> {
    let errors: Vec<[f64; 2]> = values
        .iter()
        .map(|v| case(*v).errors_deg().unwrap())
        .collect();
    if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
        let points = |of: usize| values.iter().zip(&errors).map(move |(v, e)| (*v, e[of]));
        let line = |name: &str, of: usize| Series::curve(name, points(of));
        let title = "an edge with errors of 1 px";
        let labels = Labels::new(title, axis, "1 sigma, deg");
        let svg = series(&labels, &[line("roll", 0), line("pitch", 1)]).unwrap();
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/horizon");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("{name}.svg")), svg).unwrap();
    }
    errors
}

fn ratio(errors: &[[f64; 2]], of: usize) -> f64 {
    let (first, last) = (errors.first().unwrap(), errors.last().unwrap());
    last[of] / first[of]
}

#[test]
fn roll_and_pitch_hardly_depend_on_the_height() {
    let heights = [30.0, 50.0, 80.0, 120.0, 200.0, 300.0, 500.0];
    let errors = figure("height", "height, km", &heights, |height_km| Case {
        height_km,
        ..USUAL
    });
    // From 50 km upwards as in the paper; the error of roll decreases slightly.
    assert!((0.5..1.05).contains(&ratio(&errors[1..], 0)), "{errors:?}");
    assert!((0.6..1.5).contains(&ratio(&errors[1..], 1)), "{errors:?}");
}

#[test]
fn a_wider_field_on_as_many_pixels_costs_accuracy() {
    // In the paper, pitch does not depend on the field and roll is best at 118 deg. Here errors are in pixels, whose angle grows with the field,
    // so both get worse.
    let fields = [65.0, 80.0, 94.4, 105.0, 118.0, 130.0, 140.0, 150.0];
    let errors = figure("field", "field across, deg", &fields, |field_deg| Case {
        field_deg,
        ..USUAL
    });
    assert!(
        errors.windows(2).all(|pair| pair[0] < pair[1]),
        "{errors:?}"
    );
}

#[test]
fn errors_fall_as_the_resolution_grows() {
    let rows = [240.0, 480.0, 720.0, 1080.0, 2160.0];
    let errors = figure("resolution", "rows", &rows, |rows| Case { rows, ..USUAL });
    for of in 0..2 {
        assert!((0.1..0.13).contains(&ratio(&errors, of)), "{errors:?}");
    }
}

#[test]
fn the_thickness_of_the_atmosphere_does_not_matter() {
    let thickness = [1.0, 5.0, 10.0, 20.0, 40.0];
    let name = "thickness of the atmosphere, km";
    let errors = figure("atmosphere", name, &thickness, |atmosphere_km| Case {
        atmosphere_km,
        ..USUAL
    });
    for of in 0..2 {
        assert!((0.9..1.1).contains(&ratio(&errors, of)), "{errors:?}");
    }
}
