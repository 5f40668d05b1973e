//! Opens a camera by its name and prepares it for triggers.

use super::configure::has;
use crate::camera::Device;
use aravis::prelude::*;
use aravis::{Aravis, Camera, DeviceInfo, FakeDevice};
use std::ffi::CStr;
use std::net::IpAddr;
use std::sync::{LazyLock, Mutex, PoisonError};

/// Aravis's name of the protocol of GigE Vision cameras.
const GIGE_VISION: &str = "GigEVision";
/// Rate at which the fake device searches for a buffer to fill, Hz.
const CHECKS_HZ: f64 = 500.0;

/// The library's list of cameras belongs to one thread at a time.
static LIBRARY: LazyLock<Option<Mutex<Aravis>>> =
    LazyLock::new(|| Aravis::initialize().ok().map(Mutex::new));

/// Opens a camera, and sets it to take frames one at a time, each when triggered.
pub(super) fn open(device: &Device) -> Result<Camera, String> {
    let camera = match device.is_fake() {
        true => fake().map_err(|error| error.to_string())?,
        false => find(device)?,
    };
    prepare(&camera)?;
    Ok(camera)
}

/// Aravis's fake device. Opened this way it needs no interface that would be enabled for the whole program, and appears in no list.
fn fake() -> Result<Camera, aravis::glib::Error> {
    let device = FakeDevice::new("1")?;
    if let Some(sensor) = device.fake_camera() {
        sensor.set_trigger_frequency(CHECKS_HZ);
    }
    Camera::with_device(&device)
}

/// Opens a camera by IP address, or by serial number or Aravis's id.
///
/// If a GigE Vision camera is opened by its name without listing first, on some hosts it sends its stream to the wrong interface: so
/// the name is used only to find the address. Other cameras have no address.
fn find(device: &Device) -> Result<Camera, String> {
    let library = LIBRARY.as_ref().ok_or("Aravis is in use already")?;
    let library = library.lock().unwrap_or_else(PoisonError::into_inner);
    let id = device.id();
    if id.parse::<IpAddr>().is_ok() {
        return Camera::new(Some(id))
            .map_err(|error| format!("no camera answers at this address ({error})"));
    }
    let mut listed = library.get_device_list();
    if let Device::Gige(_) = device {
        listed.retain(is_gige_vision);
    }
    let Some(found) = listed.iter().find(|listed| is_named(listed, id)) else {
        let ids: Vec<String> = listed.iter().map(|listed| text(&listed.id)).collect();
        let found = match ids.is_empty() {
            true => "none".into(),
            false => ids.join(", "),
        };
        return Err(format!(
            "no camera has this serial number or id; found {found}"
        ));
    };
    let opened_by = match is_gige_vision(found) {
        true => &found.address,
        false => &found.id,
    };
    Camera::new(Some(&text(opened_by))).map_err(|error| error.to_string())
}

fn text(text: &CStr) -> String {
    text.to_string_lossy().into_owned()
}

fn is_gige_vision(listed: &DeviceInfo) -> bool {
    text(&listed.protocol) == GIGE_VISION
}

/// Ids end with the serial number.
fn is_named(listed: &DeviceInfo, id: &str) -> bool {
    let listed_id = text(&listed.id);
    listed_id == id || listed_id.ends_with(&format!("-{id}")) || text(&listed.physical_id) == id
}

fn prepare(camera: &Camera) -> Result<(), String> {
    let failed = |error: aravis::glib::Error| error.to_string();
    if !has(camera, "TriggerSoftware") {
        return Err("it cannot be triggered by software".into());
    }
    // Values that the camera's own description rules out are not even sent.
    camera.set_range_check_policy(aravis::RangeCheckPolicy::Enable);
    // A camera that was left running takes no settings.
    let _ = camera.stop_acquisition();
    camera
        .set_acquisition_mode(aravis::AcquisitionMode::Continuous)
        .map_err(failed)?;
    camera.set_trigger("Software").map_err(failed)
}
