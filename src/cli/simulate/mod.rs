//! `solaspect simulate`: frames of random scenes or a navigation system's flight, with the truth about them.

mod horizon;
mod lamp;
mod moon;
mod navigation;
mod truth;

use super::options;
use super::output::progress_bar;
use crate::clock::parse_utc;
use crate::fits::{self, Compression};
use crate::instrument::Instrument;
use crate::simulate::{
    Conditions, Counts, Covers, Depth, DriftScenes, FORT_SUMNER, Noise, Picture, RandomScenes,
    Readout, Strengths, SunInView, Truth,
};
use crate::sky;
use crate::units::{Place, SensorPx};
use anyhow::Context;
use clap::{Args, ValueEnum};
use jiff::{SignedDuration, Timestamp};
use std::path::PathBuf;
use truth::{TruthFile, write_file};

/// The first line of `truth.csv`, in px, px, mil, mil, px.
const TRUTH_HEADER: &str = "n,sun_x,sun_y,plate_x,plate_y,radius";

/// Make frames of random scenes, with the truth about them in truth.csv
///
/// truth.csv has a row for each frame, which is on the disk when the frame is: its number n; sun_x, sun_y, the image of the Sun's centre
/// on the sensor, px, the middle of the first pixel is 0; plate_x, plate_y, the same on the plate, mil (25.4 um); radius, the disc's
/// radius, px. Without Sun all but n are empty. With --dark or --flat: exposure_s, s; light_dn, the light in the middle of the picture
/// above the dark level, DN of the camera. The columns of other scenes: docs/simulate.md.
#[derive(Debug, Clone, Args)]
#[command(allow_negative_numbers = true)]
pub struct SimulateArgs {
    /// Folder for frame_00000.fits ... and truth.csv; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How many frames
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub frames: u64,
    /// The same seed makes the same frames
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// The instrument: a TOML file, or the name of a built-in one [default: demo]
    #[arg(long, value_name = "FILE|NAME")]
    pub instrument: Option<PathBuf>,
    /// Time of the first frame's mid-exposure
    #[arg(long, value_name = "UTC", default_value = "2013-09-21T18:00:00Z", value_parser = parse_utc)]
    pub utc: Timestamp,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value_t = 4.0, value_parser = Within(1e-3, 1000.0, "Hz"))]
    pub rate: f64,
    /// A drift scan: the gondola stands still, and the Sun crosses the plate as the ephemeris and the instrument's mounting say; its
    /// direction goes to pointing.csv
    #[arg(long, conflicts_with_all = ["partial", "no_sun", "smear"])]
    pub drift: bool,
    /// Where the gondola of the drift scan stands [default: Fort Sumner, at float]
    #[arg(
        long,
        value_name = "LAT,LON,HEIGHT_M",
        allow_hyphen_values = true,
        requires = "drift"
    )]
    pub place: Option<Place>,
    #[command(flatten)]
    pub sun: SunArgs,
    #[command(flatten)]
    pub optics: OpticsArgs,
    #[command(flatten)]
    pub camera: CameraArgs,
    #[command(flatten)]
    pub lamp: lamp::LampArgs,
    #[command(flatten)]
    pub horizon: horizon::HorizonArgs,
    #[command(flatten)]
    pub moon: moon::MoonArgs,
    #[command(flatten)]
    pub navigation: navigation::NavigationArgs,
}

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Sun")]
pub struct SunArgs {
    /// Angular radius of the Sun [default: the ephemeris at --utc]
    #[arg(long, value_name = "ARCSEC", value_parser = Within(900.0, 1000.0, "arcsec"))]
    pub sun_radius: Option<f64>,
    /// Light at the disc's centre, above the background, 8-bit DN
    #[arg(long, value_name = "DN", default_value_t = 205.0, value_parser = Within(0.0, 4000.0, "DN"))]
    pub peak: f64,
    /// Sunspots on the disc, or "hmi": spots, granulation and limb darkening of SDO/HMI's picture of 2023-01-31, turned at random
    #[arg(long, visible_alias = "spots", value_name = "N|hmi", default_value = "0", value_parser = sunspots)]
    pub sunspots: Sunspots,
    /// The part of the Sun's diameter that the Moon covers, from a side drawn at random
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 1.0, ""))]
    pub eclipse: f64,
    /// What a cloud takes from the light, 0 to 1; its edge crosses the disc anywhere
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 1.0, ""))]
    pub cloud_edge: f64,
    /// Width of a dark strut before the disc, in radii of the Sun
    #[arg(long, value_name = "RADII", default_value_t = 0.0, value_parser = Within(0.0, 2.0, "radii"))]
    pub strut: f64,
    /// How far the Sun moves during the exposure, each frame in another direction
    #[arg(long, value_name = "PX", default_value_t = 0.0, value_parser = Within(0.0, 50.0, "px"))]
    pub smear: f64,
    /// The disc cut by the sensor's edge
    #[arg(long, conflicts_with = "no_sun")]
    pub partial: bool,
    /// No Sun
    #[arg(long)]
    pub no_sun: bool,
}

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Plate and optics")]
pub struct OpticsArgs {
    /// Turn of the picture beyond what the instrument states, positive from +x towards +y
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = Within(-360.0, 360.0, "deg"))]
    pub rotation: f64,
    /// Keystone: tilt of the camera against the plate
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = Within(-20.0, 20.0, "deg"))]
    pub keystone: f64,
    /// Plate length per pixel [default: the instrument's]
    #[arg(long, value_name = "MIL_PER_PX", value_parser = Within(0.5, 50.0, "mil/px"))]
    pub scale: Option<f64>,
    /// Where the plate's centre is seen, px [default: the instrument's]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, value_parser = position)]
    pub plate_centre: Option<SensorPx>,
    /// Contrast of the marks: the share of the light that a mark absorbs, 0 to 1
    #[arg(long, value_name = "C", default_value_t = 0.8, value_parser = Within(0.0, 1.0, ""))]
    pub contrast: f64,
    /// Displacement of every mark from the instrument's plate, rms in each axis
    #[arg(long, value_name = "MIL", default_value_t = 0.0, value_parser = Within(0.0, 20.0, "mil"))]
    pub mark_scatter: f64,
    /// Scratches of the plate that cross the disc, on average
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count())]
    pub scratches: u16,
    /// Spots of light past the baffles, near the plate's edge
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count())]
    pub leaks: u16,
    /// Gaussian blur, 1 sigma [default: the instrument's]
    #[arg(long, value_name = "PX", value_parser = Within(0.0, 10.0, "px"))]
    pub blur: Option<f64>,
    /// Share of the light lost in the corners, 0 to 1
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 1.0, ""))]
    pub vignetting: f64,
    /// Stray light that rises across the sensor, in a direction drawn at random, 8-bit DN from corner to corner
    #[arg(long, value_name = "DN", default_value_t = 0.0, value_parser = Within(0.0, 255.0, "DN"))]
    pub gradient: f64,
    /// Stray light that rises across the disc, in a direction drawn at random, 8-bit DN from limb to limb
    #[arg(long, value_name = "DN", default_value_t = 0.0, value_parser = Within(0.0, 255.0, "DN"))]
    pub disc_gradient: f64,
    /// A second image of the Sun, shifted and out of focus: its light relative to the first, 0 to 1
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 1.0, ""))]
    pub ghost: f64,
    /// Share of the light that coma displaces by 1.5 px, 0 to 1
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 1.0, ""))]
    pub coma: f64,
}

#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Camera")]
pub struct CameraArgs {
    /// Bits of a pixel; 12 bits come as 0 to 4095 in 16
    #[arg(long, value_name = "BITS", value_enum, default_value_t = Bits::Eight)]
    pub bits: Bits,
    /// Additive noise, 1 sigma, 8-bit DN
    #[arg(long, value_name = "DN", default_value_t = 5.0, value_parser = Within(0.0, 255.0, "DN"))]
    pub noise: f64,
    /// Adds the noise of photons: photo-electrons of one 8-bit DN
    #[arg(long, visible_alias = "photons", value_name = "E_PER_DN", value_parser = Within(0.1, 1e6, "electrons/DN"))]
    pub electrons: Option<f64>,
    /// Level of a pixel without light, 8-bit DN
    #[arg(long, value_name = "DN", default_value_t = 4.0, value_parser = Within(-50.0, 250.0, "DN"))]
    pub background: f64,
    /// Frame transfer: share of the light of its column that every pixel receives in addition
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = Within(0.0, 0.01, ""))]
    pub column_smear: f64,
    /// By how much the right half of the sensor lies above the left, 8-bit DN
    #[arg(long, value_name = "DN", default_value_t = 0.0, value_parser = Within(-50.0, 50.0, "DN"))]
    pub tap_step: f64,
    /// Saturated pixels
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count())]
    pub hot_pixels: u16,
    /// Specks of dust before the disc, on average
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count())]
    pub dust: u16,
}

/// Structure of the Sun's surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sunspots {
    /// This many spots, drawn at random.
    Drawn(u16),
    /// HMI's picture.
    Hmi,
}

fn sunspots(text: &str) -> Result<Sunspots, String> {
    match text.parse() {
        Ok(number @ 0..=MOST) => Ok(Sunspots::Drawn(number)),
        _ if text == "hmi" => Ok(Sunspots::Hmi),
        _ => Err(format!("expected a number from 0 to {MOST}, or hmi")),
    }
}

/// Depth of a pixel as the option names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Bits {
    #[value(name = "8")]
    Eight,
    #[value(name = "12")]
    Twelve,
}

/// Accepts numbers within a range and names the range when it refuses one: lowest, highest, unit.
#[derive(Debug, Clone, Copy)]
struct Within(f64, f64, &'static str);

impl Within {
    fn parse(self, text: &str) -> Result<f64, String> {
        let Self(low, high, unit) = self;
        match text.parse::<f64>() {
            Ok(value) if (low..=high).contains(&value) => Ok(value),
            _ => Err(format!("expected a number from {low} to {high} {unit}")
                .trim_end()
                .into()),
        }
    }
}

impl clap::builder::IntoResettable<clap::builder::ValueParser> for Within {
    fn into_resettable(self) -> clap::builder::Resettable<clap::builder::ValueParser> {
        clap::builder::ValueParser::new(move |text: &str| self.parse(text)).into_resettable()
    }
}

/// Largest number for any option that is a count.
const MOST: u16 = 10_000;

fn count() -> clap::builder::RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(0..=i64::from(MOST))
}

fn position(text: &str) -> Result<SensorPx, String> {
    let coordinate = |n: &str| Within(-1e5, 1e5, "px").parse(n.trim()).ok();
    text.split_once(',')
        .and_then(|(x, y)| Some(SensorPx::new(coordinate(x)?, coordinate(y)?)))
        .ok_or_else(|| "expected X,Y, each a number from -100000 to 100000 px".into())
}

/// Makes the frames and `truth.csv`.
pub fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    if args.lamp.dark || args.lamp.flat {
        return lamp::run(args);
    }
    if args.horizon.horizon {
        return horizon::run(args);
    }
    if args.moon.moon {
        return moon::run(args);
    }
    if let Some(flies) = args.navigation.navigation {
        return navigation::run(args, flies);
    }
    let mut scenes = args.scenes()?;
    let mut truth = TruthFile::create(&args.out, TRUTH_HEADER)?;
    let progress = progress_bar(args.frames as usize, "frames");
    for (number, picture) in args.pictures(&mut scenes).enumerate() {
        let picture = picture?;
        let file = args.out.join(format!("frame_{number:05}.fits"));
        fits::write_frame(&file, &picture.frame, &[], &[], Compression::Rice)?;
        truth.row(&truth_line(number as u64, &picture.truth))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    match &scenes {
        Scenes::Random(_) => Ok(()),
        Scenes::Drift(drift) => args.write_pointing(drift),
    }
}

/// Source of the frames' scenes.
pub enum Scenes {
    Random(Box<RandomScenes>),
    Drift(Box<DriftScenes>),
}

/// A line of `truth.csv`; without Sun every column except the first is empty.
fn truth_line(number: u64, truth: &Truth) -> String {
    match truth.sun {
        Some(sun) => format!(
            "{number},{:.6},{:.6},{:.6},{:.6},{:.6}",
            sun.px.x, sun.px.y, sun.plate.x, sun.plate.y, sun.radius_px
        ),
        None => format!("{number},,,,,"),
    }
}

impl SimulateArgs {
    /// The scenes of the Sun on the plate for these options.
    ///
    /// # Errors
    /// If the instrument's file is invalid, the Sun's size is not known in the year, or the options give no scene.
    pub fn scenes(&self) -> anyhow::Result<Scenes> {
        let instrument = options::instrument(self.instrument.as_deref())?;
        let radius_arcsec = match self.sun.sun_radius {
            Some(radius) => radius,
            None => sky::sun_angular_radius(self.utc).context("--utc")?,
        };
        let conditions = self.conditions(&instrument, radius_arcsec);
        if self.drift {
            let middle = self.utc_at((self.frames - 1) as f64 / 2.0)?;
            let at = (middle, self.place.unwrap_or(FORT_SUMNER));
            let drift = DriftScenes::new(&instrument, &conditions, at, self.seed)?;
            return Ok(Scenes::Drift(Box::new(drift)));
        }
        let scenes = RandomScenes::new(&instrument, &conditions, self.seed)?;
        Ok(Scenes::Random(Box::new(scenes)))
    }

    /// The frames of these scenes, each with its truth, in the order of their numbers.
    pub fn pictures(&self, scenes: &mut Scenes) -> impl Iterator<Item = anyhow::Result<Picture>> {
        (0..self.frames).map(|number| self.picture(scenes, number))
    }

    fn utc_at(&self, number: f64) -> anyhow::Result<Timestamp> {
        let since_first = SignedDuration::try_from_secs_f64(number / self.rate)?;
        let utc = self.utc.checked_add(since_first);
        utc.context("--utc: the last frame lies after year 9999")
    }

    fn picture(&self, scenes: &mut Scenes, number: u64) -> anyhow::Result<Picture> {
        let utc = self.utc_at(number as f64)?;
        let mut scene = match scenes {
            Scenes::Random(scenes) => scenes.scene(number)?,
            Scenes::Drift(scenes) => scenes.scene(number, utc)?,
        };
        scene.info.mid_exposure = Some(utc);
        Ok(scene.picture()?)
    }

    /// The constant pointing of a drift scan for the time of every frame, without refraction.
    fn write_pointing(&self, drift: &DriftScenes) -> anyhow::Result<()> {
        let (azimuth, elevation) = (drift.pointing.azimuth_deg, drift.pointing.elevation_deg);
        let mut text = String::from("utc,azimuth_deg,elevation_deg\n");
        for number in 0..self.frames {
            let utc = self.utc_at(number as f64)?;
            text += &format!("{utc},{azimuth:.7},{elevation:.7}\n");
        }
        write_file(&self.out, "pointing.csv", &text)
    }

    fn conditions(&self, instrument: &Instrument, sun_radius_arcsec: f64) -> Conditions {
        let stated = Conditions::of(instrument);
        let (sun, optics, camera) = (&self.sun, &self.optics, &self.camera);
        let mut similarity = stated.similarity;
        similarity.rotation_deg += optics.rotation;
        similarity.scale_mil_per_px = optics.scale.unwrap_or(similarity.scale_mil_per_px);
        similarity.plate_centre = optics.plate_centre.unwrap_or(similarity.plate_centre);
        Conditions {
            sun: sun.in_view(),
            sun_radius_arcsec,
            similarity,
            keystone_deg: optics.keystone,
            peak_dn: sun.peak,
            background_dn: camera.background,
            mark_contrast: optics.contrast,
            mark_scatter_mil: optics.mark_scatter,
            blur_px: optics.blur.unwrap_or(stated.blur_px),
            smear_px: sun.smear,
            sunspots: match sun.sunspots {
                Sunspots::Drawn(number) => number.into(),
                Sunspots::Hmi => 0,
            },
            hmi: sun.sunspots == Sunspots::Hmi,
            covers: Covers {
                eclipse: sun.eclipse,
                cloud: sun.cloud_edge,
                strut: sun.strut,
            },
            blemishes: Counts {
                hot_pixels: camera.hot_pixels.into(),
                scratches_per_disc: optics.scratches.into(),
                leaks: optics.leaks.into(),
                dust_per_disc: camera.dust.into(),
                vignetting: optics.vignetting,
            },
            stray: Strengths {
                gradient_dn: optics.gradient,
                disc_gradient_dn: optics.disc_gradient,
                ghost: optics.ghost,
                coma: optics.coma,
            },
            readout: Readout {
                column_smear: camera.column_smear,
                tap_step_dn: camera.tap_step,
            },
            noise: self.noise(),
            depth: self.depth(),
        }
    }

    fn noise(&self) -> Noise {
        Noise {
            read_dn: self.camera.noise,
            electrons_per_dn: self.camera.electrons,
        }
    }

    fn depth(&self) -> Depth {
        match self.camera.bits {
            Bits::Eight => Depth::Eight,
            Bits::Twelve => Depth::Twelve,
        }
    }
}

impl SunArgs {
    fn in_view(&self) -> SunInView {
        if self.no_sun {
            SunInView::Absent
        } else if self.partial {
            SunInView::Partial
        } else {
            SunInView::Whole
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        simulate: SimulateArgs,
    }

    pub(super) fn parse(options: &str) -> Result<SimulateArgs, String> {
        let words = ["simulate"].into_iter().chain(options.split_whitespace());
        match Program::try_parse_from(words) {
            Ok(program) => Ok(program.simulate),
            Err(error) => Err(error.to_string().lines().next().unwrap_or_default().into()),
        }
    }

    #[test]
    fn values_may_begin_with_a_minus() {
        let args = parse("--out a --rotation -3.5 --keystone -2 --plate-centre -10.5,-20").unwrap();
        assert_eq!(args.optics.rotation, -3.5);
        assert_eq!(args.optics.keystone, -2.0);
        assert_eq!(args.optics.plate_centre, Some(SensorPx::new(-10.5, -20.0)));
    }

    #[test]
    fn a_refused_value_names_option_and_range() {
        for (options, wanted) in [
            ("--contrast 1.2", ["--contrast", "from 0 to 1"]),
            ("--noise NaN", ["--noise", "from 0 to 255 DN"]),
            ("--frames 0", ["--frames", "1..=100000"]),
            ("--plate-centre 3", ["--plate-centre", "expected X,Y"]),
            ("--bits 10", ["--bits", "10"]),
            ("--sunspots many", ["--sunspots", "or hmi"]),
            ("--ghost 2", ["--ghost", "from 0 to 1"]),
        ] {
            let message = parse(&format!("--out a {options}")).unwrap_err();
            for part in wanted {
                assert!(message.contains(part), "{message}");
            }
        }
    }

    #[test]
    fn frames_are_numbered_timed_and_listed_with_their_truth() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new");
        let mut args = parse("--out a --frames 2 --rate 2 --utc 2013-09-21T17:59:59.75Z").unwrap();
        args.out.clone_from(&out);
        run(&args).unwrap();
        for (name, utc) in [
            ("frame_00000.fits", "2013-09-21T17:59:59.75Z"),
            ("frame_00001.fits", "2013-09-21T18:00:00.25Z"),
        ] {
            let frame = fits::read_frame(&out.join(name)).unwrap();
            assert_eq!(frame.info.mid_exposure, Some(utc.parse().unwrap()));
        }
        let truth = std::fs::read_to_string(out.join("truth.csv")).unwrap();
        let lines: Vec<&str> = truth.lines().collect();
        assert_eq!(lines[0], "n,sun_x,sun_y,plate_x,plate_y,radius");
        assert_eq!(lines.len(), 3);
        let row: Vec<f64> = lines[2].split(',').map(|v| v.parse().unwrap()).collect();
        // The demo instrument: plate centre at (647.5, 482.5), mirrored, 5.75 mil/px.
        assert!((row[3] - (647.5 - row[1]) * 5.75).abs() < 1e-4);
        assert!((row[4] - (row[2] - 482.5) * 5.75).abs() < 1e-4);
        assert!((row[5] - 95.163).abs() < 1e-3);
        args.sun.no_sun = true;
        run(&args).unwrap();
        let truth = std::fs::read_to_string(out.join("truth.csv")).unwrap();
        assert_eq!(truth.lines().nth(2), Some("1,,,,,"));
    }
}
