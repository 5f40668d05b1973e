//! `solaspect events`: assigns photons to places on the Sun.

use super::options::interrupted;
use super::output::{Follower, say};
use crate::events::{
    Energies, Exposure, Field, Files, ImageRequest, Imaged, Placed, place_photons,
};
use crate::units::counted;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Put the photons of an event list on the Sun, by the pointing of a refined flight
///
/// With --out, copies a FITS file (OGIP: a table EVENTS with TIME, X and Y) and adds the columns HPX, HPY, HP_SIGMA, HP_SYS and HP_VALID. Good
/// time intervals (GTI, STDGTI) are intersected with those in which the pointing is valid. All else stays byte for byte. With --image, counts the
/// photons in squares of the sky: a FITS image with solar coordinates, an exposure map, and an image of the photons that are not to be used.
/// docs/events.md has the columns, the image and DET.toml.
#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("written").args(["out", "image"]).required(true).multiple(true))]
pub struct EventsArgs {
    /// The folder that `solaspect refine` wrote: pointing.fits is read
    #[arg(value_name = "REFINED")]
    refined: PathBuf,
    /// The event list, FITS, plain or gzipped
    #[arg(value_name = "EVENTS.fits")]
    events: PathBuf,
    /// How the detectors are mounted (docs/events.md)
    #[arg(long, value_name = "DET.toml")]
    detectors: PathBuf,
    /// The copy with the photons' places; replaced if it exists
    #[arg(long, value_name = "OUT.fits")]
    out: Option<PathBuf>,
    #[command(flatten)]
    image: ImageArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Image", allow_negative_numbers = true)]
struct ImageArgs {
    /// Write an image of the valid photons, north up: COUNTS, EXPOSURE in s of live time, and INVALID, the other photons
    #[arg(long, value_name = "IMAGE.fits")]
    image: Option<PathBuf>,
    /// Side of a pixel
    #[arg(long, value_name = "ARCSEC", requires = "image", default_value = "5", value_parser = parse_pixel)]
    pixel_arcsec: f64,
    /// Middle of the image from the Sun's centre, to solar west and north, arcsec
    #[arg(long, value_name = "X,Y", requires = "image", default_value = "0,0", value_parser = parse_pair, allow_hyphen_values = true)]
    image_centre: [f64; 2],
    /// Width and height of the image, arcsec
    #[arg(long, value_name = "W,H", requires = "image", default_value = "2400,2400", value_parser = parse_pair)]
    image_size: [f64; 2],
    /// The column of the photons' energy or channel, such as PI or ENERGY
    #[arg(long, value_name = "NAME", requires_all = ["image", "range"])]
    energy_column: Option<String>,
    /// Count only photons whose energy is from A to B, both included, in the column's unit
    #[arg(long, value_name = "A,B", requires = "energy_column", value_parser = parse_range, allow_hyphen_values = true)]
    range: Option<[f64; 2]>,
}

/// Two numbers with a comma between them.
fn parse_pair(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| {
        text.trim()
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
    };
    let pair = text.split_once(',');
    let pair = pair.and_then(|(a, b)| Some([number(a)?, number(b)?]));
    pair.ok_or_else(|| format!("expected two numbers with a comma, such as 0,10, found \"{text}\""))
}

fn parse_range(text: &str) -> Result<[f64; 2], String> {
    let [low, high] = parse_pair(text)?;
    match low <= high {
        true => Ok([low, high]),
        false => Err(format!(
            "expected the smaller number first, found \"{text}\""
        )),
    }
}

fn parse_pixel(text: &str) -> Result<f64, String> {
    let pixel: Option<f64> = text.parse().ok();
    pixel
        .filter(|pixel| (0.01..=1000.0).contains(pixel))
        .ok_or_else(|| format!("expected a number from 0.01 to 1000 arcsec, found \"{text}\""))
}

impl ImageArgs {
    fn request(&self) -> Option<ImageRequest> {
        let energies = self.energy_column.clone().zip(self.range);
        Some(ImageRequest {
            path: self.image.clone()?,
            pixel_arcsec: self.pixel_arcsec,
            field: Field {
                centre_arcsec: self.image_centre,
                size_arcsec: self.image_size,
            },
            energies: energies.map(|(column, range)| Energies { column, range }),
        })
    }
}

pub fn run(args: &EventsArgs) -> anyhow::Result<ExitCode> {
    args.run(&interrupted()?)
}

impl EventsArgs {
    /// Assigns the photons to places on the Sun, and prints their number.
    ///
    /// # Errors
    /// If files are invalid, or the run was cancelled.
    pub fn run(&self, cancelled: &Arc<AtomicBool>) -> anyhow::Result<ExitCode> {
        let follower = Follower::new("events", cancelled);
        let image = self.image.request();
        let files = Files {
            refined: &self.refined,
            events: &self.events,
            detectors: &self.detectors,
            out: self.out.as_deref(),
            image: image.as_ref(),
        };
        print(&place_photons(files, &follower)?)?;
        Ok(ExitCode::SUCCESS)
    }
}

fn print(placed: &Placed) -> anyhow::Result<()> {
    let Placed {
        photons,
        valid,
        invalid,
        exposures,
        image,
    } = placed;
    say(format_args!(
        "{}, {valid} of them valid",
        counted(*photons, "photon")
    ))?;
    for (why, count) in invalid {
        say(format_args!("  {count} not valid: {why}"))?;
    }
    for Exposure {
        extension,
        before_s,
        after_s,
    } in exposures
    {
        say(format_args!(
            "{extension}: {before_s:.3} s, {after_s:.3} s of them with a valid pointing"
        ))?;
    }
    image.as_ref().map_or(Ok(()), print_image)
}

fn print_image(image: &Imaged) -> anyhow::Result<()> {
    let Imaged {
        width_px,
        height_px,
        photons,
        invalid,
        outside,
        unplaced,
        other_energies,
        live_s,
    } = image;
    say(format_args!(
        "image of {width_px} x {height_px} px: {}, live time {live_s:.3} s",
        counted(*photons, "photon")
    ))?;
    for (count, what) in [
        (
            invalid,
            "not valid, not in a good time or not in a detector's field: in INVALID",
        ),
        (outside, "outside the image"),
        (unplaced, "without a place"),
        (other_energies, "of other energies"),
    ] {
        if *count > 0 {
            say(format_args!("  {count} {what}"))?;
        }
    }
    Ok(())
}
