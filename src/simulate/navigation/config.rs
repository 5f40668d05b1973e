//! The file that describes a flight's instruments to the navigation.

use super::cameras::TargetCamera;
use super::plan::FlightPlan;

/// The text of `NAV.toml`.
pub(super) fn config_toml(plan: &FlightPlan) -> String {
    let cameras: String = plan.cameras.iter().map(camera_toml).collect();
    format!(
        "{}\n[gps]\nposition_sigma_m = {:?}\nvelocity_sigma_m_s = {:?}\n\n[sun]\ncorrelated_sigma_deg = {:?}\n\n[nadir]\n\
         correlated_sigma_deg = {:?}\n{cameras}",
        imu_toml(plan),
        plan.gps.position_sigma_m,
        plan.gps.velocity_sigma_m_s,
        plan.sun.correlated_sigma_deg,
        plan.nadir.correlated_sigma_deg,
    )
}

fn imu_toml(plan: &FlightPlan) -> String {
    let imu = &plan.imu;
    let values = [
        ("velocity_random_walk", imu.velocity_random_walk),
        ("angular_random_walk", imu.angular_random_walk),
        (
            "accelerometer_bias_sigma",
            imu.accelerometer_bias_sigma_m_s2,
        ),
        ("gyro_bias_sigma", imu.gyro_bias_sigma_rad_s),
        (
            "misalignment_sigma_deg",
            imu.misalignment_sigma_rad.to_degrees(),
        ),
        (
            "accelerometer_scale_sigma_ppm",
            imu.accelerometer_scale_sigma_ppm,
        ),
        ("gyro_scale_sigma_ppm", imu.gyro_scale_sigma_ppm),
    ];
    let line = |(name, value): (&str, f64)| format!("{name} = {value:?}\n");
    let lines: String = values.into_iter().map(line).collect();
    format!("[imu]\n{lines}")
}

fn camera_toml(camera: &TargetCamera) -> String {
    let matrix = &camera.body_from_camera;
    let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
    format!(
        "\n[[camera]]\nname = \"{}\"\nbody_from_camera = {rows:?}\nmisalignment_sigma_deg = {:?}\ncorrelation_time_s = {:?}\n",
        camera.name, camera.misalignment_sigma_deg, camera.correlation_time_s,
    )
}
