//! Films as files: pictures in a folder, GIF, APNG. An incomplete film is never visible: pictures go to a temporary file or folder, which
//! is renamed at the end.
//!
//! In GIF and APNG an unchanged pixel is transparent, so that only changes need space.

use super::form::{Destination, Form};
use crate::columns::{folder_of, part_beside, refused};
use crate::fits::FileError;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{Rgb, RgbImage};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};

/// Pictures a second.
pub const RATE_HZ: u16 = 10;

/// A film that is being written.
pub struct Writer {
    path: PathBuf,
    kind: Kind,
}

enum Kind {
    Folder(Folder),
    Gif(Box<Gif>),
    Apng(Box<Apng>),
}

impl Writer {
    /// Begins a film with a number of pictures of a size, px.
    ///
    /// # Errors
    /// If the file or folder cannot be created.
    pub fn begin(
        destination: &Destination,
        size_px: (u32, u32),
        pictures: usize,
    ) -> Result<Self, FileError> {
        let path = destination.path.as_path();
        let kind = match destination.form {
            Form::Folder => Folder::begin(path).map(Kind::Folder),
            Form::Gif => Gif::begin(path, size_px).map(|gif| Kind::Gif(gif.into())),
            Form::Apng => Apng::begin(path, size_px, pictures).map(|png| Kind::Apng(png.into())),
        };
        Ok(Self {
            kind: kind.map_err(|cause| refused(path, cause))?,
            path: path.into(),
        })
    }

    /// Adds a picture.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn add(&mut self, picture: &RgbImage) -> Result<(), FileError> {
        let added = match &mut self.kind {
            Kind::Folder(folder) => folder.add(picture),
            Kind::Gif(gif) => gif.add(picture),
            Kind::Apng(apng) => apng.add(picture),
        };
        added.map_err(|cause| refused(&self.path, cause))
    }

    /// Moves the film to its destination.
    ///
    /// # Errors
    /// If the file cannot be written or renamed.
    pub fn finish(self) -> Result<(), FileError> {
        let path = self.path.as_path();
        let finished = match self.kind {
            Kind::Folder(folder) => folder.finish(path),
            Kind::Gif(gif) => gif.finish(path),
            Kind::Apng(apng) => apng.finish(path),
        };
        finished.map_err(|cause| refused(path, cause))
    }
}

/// The temporary file of a film.
fn part_of(path: &Path) -> io::Result<(NamedTempFile, BufWriter<File>)> {
    fs::create_dir_all(folder_of(path))?;
    let part = part_beside(path)?;
    let file = BufWriter::with_capacity(1 << 16, part.as_file().try_clone()?);
    Ok((part, file))
}

fn persist(part: NamedTempFile, path: &Path) -> io::Result<()> {
    part.as_file().sync_all()?;
    part.persist(path)?;
    Ok(())
}

/// Numbered pictures.
struct Folder {
    part: TempDir,
    pictures: usize,
}

impl Folder {
    fn begin(path: &Path) -> io::Result<Self> {
        let folder = folder_of(path);
        fs::create_dir_all(folder)?;
        let part = tempfile::Builder::new()
            .prefix(".film-")
            .suffix(".part")
            .tempdir_in(folder)?;
        Ok(Self { part, pictures: 0 })
    }

    fn name(number: usize) -> String {
        format!("film_{number:05}.png")
    }

    fn is_picture(name: &str) -> bool {
        let digits = name.strip_prefix("film_");
        let digits = digits.and_then(|rest| rest.strip_suffix(".png"));
        digits.is_some_and(|digits| digits.len() >= 5 && digits.bytes().all(|b| b.is_ascii_digit()))
    }

    fn add(&mut self, picture: &RgbImage) -> io::Result<()> {
        self.pictures += 1;
        let path = self.part.path().join(Self::name(self.pictures));
        let mut file = BufWriter::new(File::create(path)?);
        let (compression, filter) = (CompressionType::Fast, FilterType::Up);
        let encoder = PngEncoder::new_with_quality(&mut file, compression, filter);
        picture
            .write_with_encoder(encoder)
            .map_err(io::Error::other)?;
        file.flush()
    }

    /// Replaces an existing film.
    fn finish(self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)?;
        for entry in fs::read_dir(path)? {
            let entry = entry?;
            if Self::is_picture(&entry.file_name().to_string_lossy()) {
                fs::remove_file(entry.path())?;
            }
        }
        for number in 1..=self.pictures {
            let name = Self::name(number);
            fs::rename(self.part.path().join(&name), path.join(&name))?;
        }
        self.part.close()
    }
}

/// Number of levels of grey and of each colour in the palette: the same in all pictures to avoid flicker.
const GREYS: u16 = 128;
const LEVELS: u16 = 5;
/// Palette index of an unchanged pixel.
const TRANSPARENT: u8 = 255;

struct Gif {
    part: NamedTempFile,
    encoder: gif::Encoder<BufWriter<File>>,
    size_px: [u16; 2],
    before: Vec<u8>,
}

impl Gif {
    fn begin(path: &Path, (width, height): (u32, u32)) -> io::Result<Self> {
        let (part, file) = part_of(path)?;
        let size_px = [width as u16, height as u16];
        let encoder = gif::Encoder::new(file, size_px[0], size_px[1], &palette());
        let mut encoder = encoder.map_err(io::Error::other)?;
        let endless = encoder.set_repeat(gif::Repeat::Infinite);
        endless.map_err(io::Error::other)?;
        Ok(Self {
            part,
            encoder,
            size_px,
            before: Vec::new(),
        })
    }

    fn add(&mut self, picture: &RgbImage) -> io::Result<()> {
        let now: Vec<u8> = picture.pixels().map(in_palette).collect();
        let moved = |(n, now): (usize, &u8)| match self.before.get(n) == Some(now) {
            true => TRANSPARENT,
            false => *now,
        };
        let frame = gif::Frame {
            width: self.size_px[0],
            height: self.size_px[1],
            // Unit: hundredths of a second.
            delay: 100 / RATE_HZ,
            dispose: gif::DisposalMethod::Keep,
            transparent: Some(TRANSPARENT),
            buffer: now.iter().enumerate().map(moved).collect(),
            ..gif::Frame::default()
        };
        self.before = now;
        let written = self.encoder.write_frame(&frame);
        written.map_err(io::Error::other)
    }

    fn finish(self, path: &Path) -> io::Result<()> {
        let mut file = self.encoder.into_inner().map_err(io::Error::other)?;
        file.flush()?;
        persist(self.part, path)
    }
}

/// Greys, followed by a cube of colours.
fn palette() -> Vec<u8> {
    let grey = |n: u16| [(n * 255 / (GREYS - 1)) as u8; 3];
    let level = |n: u16| (n % LEVELS * 255 / (LEVELS - 1)) as u8;
    let colour = |n: u16| [level(n / LEVELS / LEVELS), level(n / LEVELS), level(n)];
    let greys = (0..GREYS).flat_map(grey);
    greys.chain((0..LEVELS.pow(3)).flat_map(colour)).collect()
}

/// The nearest colour of the palette.
fn in_palette(Rgb(rgb): &Rgb<u8>) -> u8 {
    let nearest = |v: u8, levels: u16| (u16::from(v) * (levels - 1) + 127) / 255;
    let [red, green, blue] = rgb.map(|v| nearest(v, LEVELS));
    let is_grey = rgb[0].abs_diff(rgb[1]) < 8 && rgb[1].abs_diff(rgb[2]) < 8;
    match is_grey {
        true => nearest(rgb[1], GREYS) as u8,
        false => (GREYS + (red * LEVELS + green) * LEVELS + blue) as u8,
    }
}

struct Apng {
    part: NamedTempFile,
    writer: png::Writer<BufWriter<File>>,
    before: Vec<u8>,
}

impl Apng {
    fn begin(path: &Path, (width, height): (u32, u32), pictures: usize) -> io::Result<Self> {
        let (part, file) = part_of(path)?;
        let mut encoder = png::Encoder::new(file, width, height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        encoder.set_animated(u32::try_from(pictures).unwrap_or(u32::MAX), 0)?;
        encoder.set_frame_delay(1, RATE_HZ)?;
        encoder.set_blend_op(png::BlendOp::Over)?;
        Ok(Self {
            part,
            writer: encoder.write_header()?,
            before: Vec::new(),
        })
    }

    fn add(&mut self, picture: &RgbImage) -> io::Result<()> {
        let now = picture.as_raw();
        let before = self.before.chunks_exact(3).map(Some);
        let before = before.chain(std::iter::repeat(None));
        let moved = |(now, before): (&[u8], Option<&[u8]>)| match before == Some(now) {
            true => [0; 4],
            false => [now[0], now[1], now[2], 255],
        };
        let pixels = now.chunks_exact(3).zip(before).flat_map(moved);
        self.writer.write_image_data(&pixels.collect::<Vec<u8>>())?;
        self.before.clone_from(now);
        Ok(())
    }

    fn finish(self, path: &Path) -> io::Result<()> {
        self.writer.finish()?;
        persist(self.part, path)
    }
}
