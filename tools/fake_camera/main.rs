//! A fake GigE Vision camera with pictures of the simulator's flight: the real protocol, without hardware.
//!
//! ```text
//! fake-camera --interface 127.0.0.1 &
//! solaspect fly --camera gige:127.0.0.1
//! ```
//!
//! In addition to the features of Aravis's fake camera it has Mono12 (or Mono12p), a pre-amplifier and a thermometer. All
//! exposures take the same time; the picture's brightness is proportional to the exposure.

mod fill;

use anyhow::{Context, ensure};
use aravis::{FakeCamera, GvFakeCamera};
use clap::Parser;
use fill::{Painter, Shot};
use jiff::Timestamp;
use solaspect::frame::{Frame, Pixels};
use solaspect::instrument::{self, Instrument};
use solaspect::simulate::{Depth, EXPOSURE, FlightScenes, Trajectory};
use solaspect::sky;
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// A fake GigE Vision camera that sees the simulator's flight
#[derive(Debug, Parser)]
struct Options {
    /// Address or name of the network interface to answer on
    #[arg(long, default_value = "127.0.0.1")]
    interface: String,
    #[arg(long, default_value = "FLIGHT")]
    serial: String,
    /// Packets lost of a thousand
    #[arg(long, value_name = "N", default_value_t = 0.0)]
    lost: f64,
    /// Pictures of the flight, shown over and over
    #[arg(long, default_value_t = 16, overrides_with = "pictures")]
    pictures: u32,
    /// Offers Mono12p instead of Mono12: 12 bits without a gap
    #[arg(long)]
    packed: bool,
    /// Pictures per second of flight
    #[arg(long, default_value_t = 4.0)]
    rate: f64,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Time at which the Sun has the size shown; now by default
    #[arg(long, value_name = "UTC", default_value_t = Timestamp::now())]
    utc: Timestamp,
}

/// Registers of Aravis's fake, from its own description.
mod register {
    pub const SENSOR_HEIGHT: u32 = 0x118;
    pub const SENSOR_WIDTH: u32 = 0x11c;
}

/// Rate at which the fake checks for a trigger.
const CHECKS_HZ: f64 = 500.0;

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let instrument = instrument::builtin("demo")?;
    let film = film(&instrument, &options)?;
    let description = tempfile::NamedTempFile::new()?;
    std::fs::write(&description, described(options.packed)?)?;
    let path = description.path().to_str().context("a path in UTF-8")?;
    let camera =
        GvFakeCamera::new_full(Some(&options.interface), Some(&options.serial), Some(path));
    ensure!(
        camera.is_running(),
        "UDP port 3956 of {} is taken",
        options.interface
    );
    camera.set_gvsp_lost_ratio(options.lost / 1000.0);
    let sensor = camera.fake_camera().context("no camera in the fake")?;
    sensor.write_register(register::SENSOR_WIDTH, instrument.camera.width_px as u32);
    sensor.write_register(register::SENSOR_HEIGHT, instrument.camera.height_px as u32);
    sensor.set_trigger_frequency(CHECKS_HZ);
    fill::paint_with(&sensor, painter(film));
    println!("listening on {}", options.interface);
    std::io::stdout().flush()?;
    loop {
        std::thread::sleep(Duration::from_secs(3600));
    }
}

/// The fake's description of itself, extended. Features that the fake does not use are cells of its memory.
fn described(packed: bool) -> anyhow::Result<String> {
    let (name, code) = match packed {
        true => ("Mono12p", 0x010c_0047),
        false => ("Mono12", 0x0110_0005),
    };
    let deep = format!(
        r#"<EnumEntry Name="{name}" NameSpace="Standard"><Value>{code}</Value></EnumEntry>
		<EnumEntry Name="Mono16""#
    );
    const MORE: &str = r#"<Integer Name="PreAmpRaw" NameSpace="Custom"><pValue>PreAmpRegister</pValue><Min>-3</Min><Max>6</Max></Integer>
	<IntReg Name="PreAmpRegister" NameSpace="Custom"><Address>0x150</Address><Length>4</Length><AccessMode>RW</AccessMode>
		<pPort>Device</pPort><Sign>Signed</Sign><Endianess>BigEndian</Endianess></IntReg>
	<Float Name="DeviceTemperature" NameSpace="Standard"><pValue>Thermometer</pValue></Float>
	<Converter Name="Thermometer" NameSpace="Custom"><FormulaTo>FROM</FormulaTo><FormulaFrom>TO + 20.5</FormulaFrom>
		<pValue>ThermometerRegister</pValue></Converter>
	<IntReg Name="ThermometerRegister" NameSpace="Custom"><Address>0x154</Address><Length>4</Length><AccessMode>RO</AccessMode>
		<pPort>Device</pPort><Sign>Signed</Sign><Endianess>BigEndian</Endianess></IntReg>
	<Port Name="Device""#;
    let (plain, _) = FakeCamera::new("XML").genicam_xml();
    let places = [
        (r#"<EnumEntry Name="Mono16""#, deep.as_str()),
        (r#"<Port Name="Device""#, MORE),
    ];
    let mut text = plain.to_string();
    for (place, more) in places {
        ensure!(text.contains(place), "Aravis's fake has no {place}");
        text = text.replace(place, more);
    }
    Ok(text)
}

/// A sequence of pictures, 12 bits deep.
fn film(instrument: &Instrument, options: &Options) -> anyhow::Result<Vec<Frame>> {
    let radius_arcsec = sky::sun_angular_radius(options.utc)?;
    let radius_mil = instrument.optics.radius_mil(radius_arcsec);
    let trajectory = Trajectory::flight(instrument, radius_mil, options.seed)?;
    let mut scenes = FlightScenes::new(instrument, trajectory, radius_mil, options.seed)?;
    scenes.template.depth = Depth::Twelve;
    let frame = |number: u32| {
        let since_start = Duration::try_from_secs_f64(f64::from(number) / options.rate)?;
        Ok(scenes.scene(number.into(), since_start)?.frame()?)
    };
    (0..options.pictures.max(1)).map(frame).collect()
}

/// Shows the film, one picture for each shot.
fn painter(film: Vec<Frame>) -> Painter {
    let shown = AtomicUsize::new(0);
    Box::new(move |shot, bytes| {
        let frame = &film[shown.fetch_add(1, Ordering::Relaxed) % film.len()];
        if let Pixels::U16(pixels) = frame.pixels() {
            paint(pixels, frame.width(), shot, bytes);
        }
    })
}

/// Writes a shot's part of a 12-bit picture, with a brightness proportional to the exposure.
fn paint(pixels: &[u16], width: usize, shot: &Shot, bytes: &mut [u8]) {
    const DARK_DN: f64 = 64.0;
    let brighter = f64::from(shot.exposure_us) / EXPOSURE.as_micros() as f64;
    let light = |dn: u16| DARK_DN + brighter * (f64::from(dn) - DARK_DN);
    let curve: Vec<u16> = (0..=4095)
        .map(|dn| light(dn).clamp(0.0, 4095.0) as u16)
        .collect();
    let rows = pixels.chunks_exact(width).skip(shot.y0);
    let lines = bytes.chunks_exact_mut(shot.width * shot.bits_per_pixel / 8);
    for (row, line) in rows.zip(lines) {
        let seen = row
            .iter()
            .skip(shot.x0)
            .map(|&dn| curve[usize::from(dn.min(4095))]);
        match shot.bits_per_pixel {
            8 => line
                .iter_mut()
                .zip(seen)
                .for_each(|(byte, dn)| *byte = (dn / 16) as u8),
            12 => pack(seen, line),
            _ => {
                let pairs = line.as_chunks_mut().0.iter_mut();
                pairs
                    .zip(seen)
                    .for_each(|(pair, dn)| *pair = dn.to_le_bytes());
            }
        }
    }
}

/// Packs two pixels into three bytes, the lowest bit first. A last pixel without a neighbour is omitted.
fn pack(mut pixels: impl Iterator<Item = u16>, line: &mut [u8]) {
    let (groups, _) = line.as_chunks_mut::<3>();
    for group in groups {
        let (Some(first), Some(second)) = (pixels.next(), pixels.next()) else {
            return;
        };
        let word = u32::from(first) | u32::from(second) << 12;
        let [a, b, c, _] = word.to_le_bytes();
        *group = [a, b, c];
    }
}
