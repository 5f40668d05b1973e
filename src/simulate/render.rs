//! Rendering: the Sun's light on the plate, sampled more finely than the pixels, blurred and mapped to the sensor.

use super::blur::Kernel;
use super::disc::exposures;
use super::grid::{Grid, Window};
use super::noise::{Readings, read_out};
use super::optics::{Image, images};
use super::prints::prints;
use super::scene::{Picture, Scene, SceneError, Sun};
use crate::frame::Frame;

/// Number of sub-samples per pixel in each axis. Compared with 15, pixels change by at most 0.03 DN, 0.2 DN around a sunspot and
/// 0.5 DN where an arm of a mark runs along the limb.
pub const SAMPLES_PER_PX: usize = 3;

impl Scene {
    /// The frame and the truth about it.
    pub fn picture(&self) -> Result<Picture, SceneError> {
        Ok(Picture {
            frame: self.frame()?,
            truth: self.truth(),
        })
    }

    /// The frame: rendered, with noise, digitised.
    pub fn frame(&self) -> Result<Frame, SceneError> {
        let light = render_exact(self);
        let readings = Readings {
            width_px: self.width_px,
            noise: self.noise,
            depth: self.depth,
            seed: self.seed,
        };
        let mut pixels = read_out(&light, &readings);
        self.blemishes
            .saturate(self.width_px, &mut pixels, self.depth);
        Ok(Frame::new(
            self.width_px,
            self.height_px,
            pixels,
            self.depth.saturation_dn(),
            self.info.clone(),
        )?)
    }
}

/// Light on the sensor in 8-bit DN, row by row: before noise, digitising and hot pixels.
pub fn render_exact(scene: &Scene) -> Vec<f32> {
    render_oversampled(scene, SAMPLES_PER_PX)
}

/// As [`render_exact`], with `samples_per_px` sub-samples per pixel in each axis.
pub fn render_oversampled(scene: &Scene, samples_per_px: usize) -> Vec<f32> {
    let mut light = vec![0.0; scene.width_px * scene.height_px];
    for image in images(scene) {
        add_image(&image, samples_per_px.max(1), &mut light);
    }
    scene.blemishes.shade(scene, &mut light);
    scene.stray.add_gradients(scene, &mut light);
    scene.readout.add(scene, &mut light);
    light
}

/// Adds the light of one image of the plate to that on the sensor.
fn add_image(image: &Image, samples_per_px: usize, light: &mut [f32]) {
    let scene = &image.scene;
    let kernel = Kernel::new(scene.blur_px, samples_per_px);
    let Some(sun) = &scene.sun else { return };
    let Some(window) = Window::around(sun, scene, kernel.margin_px()) else {
        return;
    };
    let grid = Grid::new(scene, sun, &window, kernel.margin_px(), samples_per_px);
    let field = lit_plate(scene, sun, &grid);
    let pixels = kernel.apply(&field, grid.columns, window.width, window.height);
    for (row, values) in pixels.chunks_exact(window.width).enumerate() {
        let start = (window.y + row) * scene.width_px + window.x;
        for (sum, value) in light[start..start + window.width].iter_mut().zip(values) {
            *sum += image.share * value;
        }
    }
}

/// Light that the plate sends to the camera from every sub-sample, above the background.
fn lit_plate(scene: &Scene, sun: &Sun, grid: &Grid) -> Vec<f32> {
    let suns = exposures(sun, grid);
    let prints = prints(scene, grid);
    let (mut xs, mut ys) = (vec![0.0; grid.columns], vec![0.0; grid.columns]);
    let mut light = vec![0.0; grid.columns];
    let mut field = vec![0.0; grid.rows * grid.columns];
    for (row, field) in field.chunks_exact_mut(grid.columns).enumerate() {
        grid.row(row, &mut xs, &mut ys);
        for sun in &suns {
            sun.shine(&xs, &ys, &mut light);
            for (sum, &l) in field.iter_mut().zip(&light) {
                *sum += l;
            }
        }
        for print in prints.iter().filter(|print| print.rows.contains(&row)) {
            let columns = print.columns.clone();
            print.change(
                &xs[columns.clone()],
                &ys[columns.clone()],
                &mut field[columns],
            );
        }
    }
    field
}
