//! The telemetry as a dirfile, which KST plots while it grows: the same numbers as the solution log's.
//!
//! A dirfile (<https://getdata.sourceforge.net/dirfile.html>, Standards Version 8) is a folder with a text file `format`
//! that declares the fields, and one file of plain binary samples per field; here one sample per frame, little-endian.
//! What a frame did not reach is NaN, by the convention of dirfiles; the codes, which are whole numbers, have one for it.
//!
//! `TIME` is the reference field, whose length tells a reader how many frames there are, and is written last: a reader
//! that follows never meets a frame that is there in part. A frame that the disk took in part is written over by the
//! next.

use super::disk::Disk;
use super::growing::Growing;
use super::log::{Row, make_new};
use super::store::{ArchiveError, During};
use crate::aspect::{Quality, Stage};
use jiff::Timestamp;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a sample of a field is.
#[derive(Clone, Copy)]
enum Sample {
    /// UINT8.
    Code(fn(&Row) -> u8),
    /// FLOAT64; NaN where not known.
    Number(fn(&Row) -> Option<f64>),
}

impl Sample {
    fn type_name(self) -> &'static str {
        match self {
            Self::Code(_) => "UINT8",
            Self::Number(_) => "FLOAT64",
        }
    }

    /// In bytes.
    fn size(self) -> u64 {
        match self {
            Self::Code(_) => 1,
            Self::Number(_) => 8,
        }
    }

    fn bytes(self, row: &Row) -> Vec<u8> {
        match self {
            Self::Code(of) => vec![of(row)],
            Self::Number(of) => of(row).unwrap_or(f64::NAN).to_le_bytes().into(),
        }
    }
}

struct Field {
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    sample: Sample,
}

const fn code(name: &'static str, meaning: &'static str, of: fn(&Row) -> u8) -> Field {
    Field {
        name,
        unit: "",
        meaning,
        sample: Sample::Code(of),
    }
}

const fn number(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    of: fn(&Row) -> Option<f64>,
) -> Field {
    Field {
        name,
        unit,
        meaning,
        sample: Sample::Number(of),
    }
}

/// The fields in the order in which they are written; a file of that name holds the samples of each.
#[rustfmt::skip]
const FIELDS: [Field; 39] = [
    number("FRAME", "", "number of the frame", |r| r.number.map(|n| n as f64)),
    code("QUALITY", "quality: 0 none, 1 coarse, 2 fine", |r| quality_code(r.quality)),
    code("STOPPED", "stopped at: 0 nowhere, 1 levels, 2 limb, 3 marks, 4 identification, 5 registration, 6 aspect, 7 pointing",
        |r| r.stopped.map_or(0, stage_code)),
    code("STORED", "picture stored: 0 no, 1 yes", |r| u8::from(!r.record.file.is_empty())),
    number("SUN_X", "mil", "Sun's centre on the plate, x", |r| r.record.sun_plate_mil.map(|p| p[0])),
    number("SUN_Y", "mil", "Sun's centre on the plate, y", |r| r.record.sun_plate_mil.map(|p| p[1])),
    number("SIGMA_X", "mil", "1 sigma of SUN_X", |r| r.record.sun_plate_sigma_mil.map(|p| p[0])),
    number("SIGMA_Y", "mil", "1 sigma of SUN_Y", |r| r.record.sun_plate_sigma_mil.map(|p| p[1])),
    number("PIXEL_X", "px", "Sun's centre on the sensor, x", |r| r.record.sun_px.map(|p| p[0])),
    number("PIXEL_Y", "px", "Sun's centre on the sensor, y", |r| r.record.sun_px.map(|p| p[1])),
    number("RADIUS", "px", "Sun's radius on the sensor", |r| r.record.sun_radius_px),
    number("RADIUS_SIGMA", "px", "1 sigma of RADIUS", |r| r.record.sun_radius_px_sigma),
    number("MARKS", "", "marks with ids", |r| r.record.marks.as_ref().map(|m| m.len() as f64)),
    number("SCALE", "mil/px", "scale of the mapping", |r| r.record.mapping.as_ref().map(|m| m.scale_mil_per_px)),
    number("SCALE_SIGMA", "mil/px", "1 sigma of SCALE", |r| r.record.mapping.as_ref().map(|m| m.scale_sigma_mil_per_px)),
    number("ROTATION", "deg", "rotation of the mapping", |r| r.record.mapping.as_ref().map(|m| m.rotation_deg)),
    number("ROTATION_SIGMA", "deg", "1 sigma of ROTATION", |r| r.record.mapping.as_ref().map(|m| m.rotation_sigma_deg)),
    number("RESIDUAL", "px", "residual of the marks", |r| r.record.mapping.as_ref().and_then(|m| m.residual_px)),
    number("OFFSET_AZ", "deg", "azimuth minus target's", |r| r.record.offset_deg.as_ref().map(|o| o.azimuth)),
    number("OFFSET_EL", "deg", "elevation minus target's", |r| r.record.offset_deg.as_ref().map(|o| o.elevation)),
    number("OFFSET_XEL", "deg", "cross-elevation from the target, true angle",
        |r| r.record.offset_deg.as_ref().map(|o| o.cross_elevation)),
    number("OFFSET_SIGMA", "deg", "1 sigma of the offset per axis, noise", |r| r.record.offset_deg.as_ref().map(|o| o.sigma)),
    number("OFFSET_CALSIGMA", "deg", "1 sigma of the offset per axis, calibration",
        |r| r.record.offset_deg.as_ref().map(|o| o.calibration_sigma)),
    number("ROLL", "deg", "body's roll by the horizon", |r| r.record.roll_deg.as_ref().map(|roll| roll.value)),
    number("ROLL_SIGMA", "deg", "1 sigma of ROLL", |r| r.record.roll_deg.as_ref().map(|roll| roll.sigma)),
    number("MOON_X", "px", "Moon's centre, x", |r| r.record.moon.as_ref().map(|m| m.centre_px[0])),
    number("MOON_Y", "px", "Moon's centre, y", |r| r.record.moon.as_ref().map(|m| m.centre_px[1])),
    number("MOON_SIGMA_X", "px", "1 sigma of MOON_X", |r| r.record.moon.as_ref().map(|m| m.centre_sigma_px[0])),
    number("MOON_SIGMA_Y", "px", "1 sigma of MOON_Y", |r| r.record.moon.as_ref().map(|m| m.centre_sigma_px[1])),
    number("MOON_RADIUS", "px", "Moon's vertical half axis", |r| r.record.moon.as_ref().map(|m| m.radius_px)),
    number("LEVEL_BACKGROUND", "DN", "level of the background", |r| r.levels.map(|l| l.background_dn)),
    number("LEVEL_NOISE", "DN", "1 sigma of the background", |r| r.levels.map(|l| l.noise_dn)),
    number("LEVEL_DISC", "DN", "level of the disc", |r| r.levels.map(|l| l.disc_dn)),
    number("SOLVE_TIME", "s", "wall time of the solver", |r| r.record.solve_us.map(|us| us as f64 * 1e-6)),
    number("DISK1_FREE", "percent", "free space of the first disk", |r| r.upkeep.free_percent[0]),
    number("DISK2_FREE", "percent", "free space of the second disk", |r| r.upkeep.free_percent[1]),
    number("WAITING", "", "pictures that wait for a disk", |r| Some(r.upkeep.waiting as f64)),
    number("UNSTORED", "", "pictures so far that no disk has", |r| Some(r.upkeep.unstored as f64)),
    number("TIME", "s", "mid-exposure, UTC since 1970", |r| r.record.utc.map(|utc| utc.time.as_nanosecond() as f64 * 1e-9)),
];

fn quality_code(quality: Quality) -> u8 {
    match quality {
        Quality::None => 0,
        Quality::Coarse => 1,
        Quality::Fine => 2,
    }
}

fn stage_code(stage: Stage) -> u8 {
    match stage {
        Stage::Levels => 1,
        Stage::Limb => 2,
        Stage::Marks => 3,
        Stage::Identification => 4,
        Stage::Registration => 5,
        Stage::Aspect => 6,
        Stage::Pointing => 7,
    }
}

/// The text of the file `format`.
fn format_text() -> String {
    let mut text = String::from(
        "# Telemetry of solaspect, one sample per frame. NaN: not known. TIME is written last.\n\
         /VERSION 8\n/ENDIAN little\n/ENCODING none\n",
    );
    for Field {
        name,
        unit,
        meaning,
        sample,
    } in &FIELDS
    {
        let unit = match *unit {
            "" => String::new(),
            unit => format!(" [{unit}]"),
        };
        // As comments, for who reads the file: KST 2.0.8 fails on fields of type STRING.
        text += &format!("# {meaning}{unit}\n{name} RAW {} 1\n", sample.type_name());
    }
    text + "/REFERENCE TIME\n"
}

/// The dirfile of one start in one archive: `telemetry_<start>/`.
///
/// After a refusal its files are opened again with the next frame, and go on behind the last whole one; where they are no longer
/// there, another folder is begun.
#[derive(Debug)]
pub struct Dirfile {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    start: Timestamp,
    made: Option<Made>,
}

/// A dirfile's folder.
#[derive(Debug)]
struct Made {
    folder: PathBuf,
    /// In the order of `FIELDS`; none after a refusal.
    files: Vec<Growing>,
    /// Whole frames.
    frames: u64,
}

impl Dirfile {
    /// A dirfile under an archive's root; its folder is made with the first frame and never in place of another.
    pub fn new(disk: Arc<dyn Disk>, root: &Path, start: Timestamp) -> Self {
        Self {
            disk,
            root: root.into(),
            start,
            made: None,
        }
    }

    /// Adds a sample to every field.
    ///
    /// # Errors
    /// Where the disk refuses; the frame is then not in the dirfile, and the next one may be tried.
    pub fn append(&mut self, row: &Row) -> Result<(), ArchiveError> {
        let disk = self.disk.as_ref();
        self.made.take_if(|made| !made.reopen(disk));
        let made = match &mut self.made {
            Some(made) => made,
            none => none.insert(Made::create(disk, &self.root, self.start)?),
        };
        let outcome = made.append(row);
        if outcome.is_err() {
            self.close();
        }
        outcome
    }

    /// Closes the files; the next frame opens them again.
    pub fn close(&mut self) {
        if let Some(made) = &mut self.made {
            made.files.clear();
        }
    }
}

impl Made {
    fn create(disk: &dyn Disk, root: &Path, start: Timestamp) -> Result<Self, ArchiveError> {
        let make = |path: &Path| disk.make_folder(path);
        let (folder, ()) = make_new(root, "telemetry", start, "", make)?;
        let made = Self::fill(disk, &folder);
        if made.is_err() {
            // Each try makes a folder: none may stay that nobody writes to.
            let _ = disk.remove_tree(&folder);
        }
        let files = made?;
        let name = Path::new(folder.file_name().unwrap_or_default());
        // A convenience for who follows; not every file system has links.
        let _ = disk.link(&root.join("telemetry"), name);
        Ok(Self {
            folder,
            files,
            frames: 0,
        })
    }

    /// The fields' files, empty, and then `format`: who finds that finds them all.
    fn fill(disk: &dyn Disk, folder: &Path) -> Result<Vec<Growing>, ArchiveError> {
        let make = |name: &str| {
            let path = folder.join(name);
            Growing::create(disk, &path).during("make a field of the telemetry", &path)
        };
        let files = FIELDS
            .iter()
            .map(|field| make(field.name))
            .collect::<Result<_, _>>()?;
        let mut format = make("format")?;
        format
            .append(format_text().as_bytes())
            .during("write the telemetry's format", folder)?;
        disk.sync_folder(folder)
            .during("bring the folder to the disk", folder)?;
        Ok(files)
    }

    /// Opens files that were closed: whether all stand, with their whole frames.
    fn reopen(&mut self, disk: &dyn Disk) -> bool {
        if self.files.is_empty() {
            let open = |field: &Field| {
                let whole = self.frames * field.sample.size();
                Growing::open(disk, &self.folder.join(field.name), whole)
            };
            let files: io::Result<Vec<Growing>> = FIELDS.iter().map(open).collect();
            self.files = files.unwrap_or_default();
        }
        !self.files.is_empty()
    }

    fn append(&mut self, row: &Row) -> Result<(), ArchiveError> {
        for (field, file) in FIELDS.iter().zip(&mut self.files) {
            file.append(&field.sample.bytes(row))
                .during("add to the telemetry", &self.folder.join(field.name))?;
        }
        self.frames += 1;
        Ok(())
    }
}
