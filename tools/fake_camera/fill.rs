//! The library's call for a picture, with everything that is unsafe about it.

use aravis::FakeCamera;
use aravis::glib::translate::ToGlibPtr;
use aravis_sys::{
    ArvBuffer, ArvPixelFormat, arv_buffer_get_data, arv_buffer_get_image_height,
    arv_buffer_get_image_width, arv_buffer_get_image_x, arv_buffer_get_image_y,
    arv_fake_camera_set_fill_pattern,
};
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a picture shall be of: the part of the sensor, the exposure and the depth.
#[derive(Debug, Clone, Copy)]
pub struct Shot {
    pub x0: usize,
    pub y0: usize,
    pub width: usize,
    pub exposure_us: u32,
    /// In memory.
    pub bits_per_pixel: usize,
}

/// Writes the pixels of a shot, row by row.
pub type Painter = Box<dyn Fn(&Shot, &mut [u8]) + Send + Sync>;

/// Lets the painter make every picture of the camera from now on.
pub fn paint_with(camera: &FakeCamera, painter: Painter) {
    // The camera may ask until the program ends.
    let painter: &'static Painter = Box::leak(Box::new(painter));
    // SAFETY: the camera is a live object of the library's; `fill` is called with the pointer given here, and what it
    // points to is never freed.
    unsafe {
        arv_fake_camera_set_fill_pattern(
            camera.to_glib_none().0,
            Some(fill),
            std::ptr::from_ref(painter).cast_mut().cast(),
        );
    }
}

unsafe extern "C" fn fill(
    buffer: *mut ArvBuffer,
    painter: *mut c_void,
    exposure_us: u32,
    _gain: u32,
    format: ArvPixelFormat,
) {
    // SAFETY: the pointer is the one that `paint_with` gave; a painter may be used by several threads.
    let painter = unsafe { &*painter.cast::<Painter>() };
    // SAFETY: the library hands over a live buffer that holds one image.
    let (x0, y0, width, height) = unsafe {
        (
            arv_buffer_get_image_x(buffer),
            arv_buffer_get_image_y(buffer),
            arv_buffer_get_image_width(buffer),
            arv_buffer_get_image_height(buffer),
        )
    };
    let [x0, y0, width, height] = [x0, y0, width, height].map(|n| usize::try_from(n).unwrap_or(0));
    // The format's bits per pixel stand in its third byte.
    let bits_per_pixel = format as usize >> 16 & 0xff;
    let mut length = 0;
    // SAFETY: the buffer is live, and `length` may be written.
    let start = unsafe { arv_buffer_get_data(buffer, &mut length) };
    let size = width * height * bits_per_pixel / 8;
    if start.is_null() || size == 0 {
        return;
    }
    // SAFETY: the library has made the buffer for its registers' width x height x bits per pixel (it reports 0 as long as
    // nothing is filled in), and nobody else uses it during this call.
    let bytes = unsafe { std::slice::from_raw_parts_mut(start, size) };
    let shot = Shot {
        x0,
        y0,
        width,
        exposure_us,
        bits_per_pixel,
    };
    // A panic must not reach the library; the picture is then what it is.
    let _ = catch_unwind(AssertUnwindSafe(|| painter(&shot, bytes)));
}
