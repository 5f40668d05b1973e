//! The library's callback for a picture, with all of its unsafe code.

use aravis::FakeCamera;
use aravis::glib::translate::ToGlibPtr;
use aravis_sys::{
    ArvBuffer, ArvPixelFormat, arv_buffer_get_data, arv_buffer_get_image_height,
    arv_buffer_get_image_width, arv_buffer_get_image_x, arv_buffer_get_image_y,
    arv_fake_camera_set_fill_pattern,
};
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Parameters of a picture: the part of the sensor, the exposure and the depth.
#[derive(Debug, Clone, Copy)]
pub struct Shot {
    pub x0: usize,
    pub y0: usize,
    pub width: usize,
    pub exposure_us: u32,
    /// Bits per pixel in memory.
    pub bits_per_pixel: usize,
}

/// Writes the pixels of a shot, row by row.
pub type Painter = Box<dyn Fn(&Shot, &mut [u8]) + Send + Sync>;

/// Makes the painter draw every picture of the camera from now on.
pub fn paint_with(camera: &FakeCamera, painter: Painter) {
    // The camera may call it until the program ends.
    let painter: &'static Painter = Box::leak(Box::new(painter));
    // SAFETY: the camera is a live object of the library; `fill` is called with the pointer given here, whose target is
    // never freed.
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
    // SAFETY: the pointer is the one from `paint_with`; a painter may be used by several threads.
    let painter = unsafe { &*painter.cast::<Painter>() };
    // SAFETY: the library passes a live buffer that holds one image.
    let (x0, y0, width, height) = unsafe {
        (
            arv_buffer_get_image_x(buffer),
            arv_buffer_get_image_y(buffer),
            arv_buffer_get_image_width(buffer),
            arv_buffer_get_image_height(buffer),
        )
    };
    let [x0, y0, width, height] = [x0, y0, width, height].map(|n| usize::try_from(n).unwrap_or(0));
    // The third byte of the format is its number of bits per pixel.
    let bits_per_pixel = format as usize >> 16 & 0xff;
    let mut length = 0;
    // SAFETY: the buffer is live, and `length` may be written.
    let start = unsafe { arv_buffer_get_data(buffer, &mut length) };
    let size = width * height * bits_per_pixel / 8;
    if start.is_null() || size == 0 {
        return;
    }
    // SAFETY: the library has allocated the buffer for width x height x bits per pixel of its registers (it reports a
    // length of 0 until data are filled in), and nothing else uses it during this call.
    let bytes = unsafe { std::slice::from_raw_parts_mut(start, size) };
    let shot = Shot {
        x0,
        y0,
        width,
        exposure_us,
        bits_per_pixel,
    };
    // A panic must not reach the library; the picture then stays unfinished.
    let _ = catch_unwind(AssertUnwindSafe(|| painter(&shot, bytes)));
}
