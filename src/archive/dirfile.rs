//! The telemetry as a dirfile, which KST plots while it grows: it holds the same numbers as the solution log.
//!
//! A dirfile (<https://getdata.sourceforge.net/dirfile.html>, Standards Version 8) is a folder with a text file `format`
//! that declares the fields, and one file of plain binary samples per field; here one sample per frame, little-endian.
//! Values of stages that a frame did not reach are NaN, by the convention of dirfiles; the codes, which are integers, have a code for that.
//!
//! `TIME` is the reference field, whose length gives the number of frames, and is written last: a program
//! that reads while it grows never finds an incomplete frame. A frame that the disk stored incompletely is overwritten by the
//! next.

use super::disk::Disk;
use super::growing::Growing;
use super::log::make_new;
use super::store::{ArchiveError, During};
use crate::record::{Field, LoggedRow, Value, fields};
use jiff::Timestamp;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

impl Field {
    fn type_name(&self) -> &'static str {
        match self.value {
            Value::Code(_) => "UINT8",
            _ => "FLOAT64",
        }
    }

    /// Size of a sample, bytes.
    fn size(&self) -> u64 {
        match self.value {
            Value::Code(_) => 1,
            _ => 8,
        }
    }

    /// NaN if it is not known.
    fn bytes(&self, row: &LoggedRow) -> Vec<u8> {
        let number = match self.value {
            Value::Code(value) => return vec![value(row)],
            Value::Number(value) => value(row),
            Value::Count(value) => value(row).map(|count| count as f64),
            Value::Text(_) => None,
        };
        number.unwrap_or(f64::NAN).to_le_bytes().into()
    }
}

/// The text of the file `format`.
fn format_text() -> String {
    let mut text = String::from(
        "# Telemetry of solaspect, one sample per frame. NaN: not known. TIME is written last.\n\
         /VERSION 8\n/ENDIAN little\n/ENCODING none\n",
    );
    for field in fields() {
        let Field {
            name,
            unit,
            meaning,
            ..
        } = field;
        let unit = match *unit {
            "" => String::new(),
            unit => format!(" [{unit}]"),
        };
        // As comments, for a person who reads the file: KST 2.0.8 fails on fields of type STRING.
        text += &format!("# {meaning}{unit}\n{name} RAW {} 1\n", field.type_name());
    }
    text + "/REFERENCE TIME\n"
}

/// The dirfile of one start in one archive: `telemetry_<start>/`.
///
/// After a refusal its files are opened again with the next frame, and continue after the last complete one; if they no longer
/// exist, another folder is begun.
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
    /// The files in the order of the fields; empty after a refusal.
    files: Vec<Growing>,
    /// Number of complete frames.
    frames: u64,
}

impl Dirfile {
    /// A dirfile under an archive's root; its folder is made with the first frame and never replaces another.
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
    /// If the disk refuses; the frame is then not in the dirfile, and the next one may be tried.
    pub fn append(&mut self, row: &LoggedRow) -> Result<(), ArchiveError> {
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
            // Each attempt makes a folder: none may stay without a writer.
            let _ = disk.remove_tree(&folder);
        }
        let files = made?;
        let name = Path::new(folder.file_name().unwrap_or_default());
        // The link is a convenience for readers; not every file system has links.
        let _ = disk.link(&root.join("telemetry"), name);
        Ok(Self {
            folder,
            files,
            frames: 0,
        })
    }

    /// Creates the fields' files, empty, and then `format`: a program that finds `format` finds them all.
    fn fill(disk: &dyn Disk, folder: &Path) -> Result<Vec<Growing>, ArchiveError> {
        let make = |name: &str| {
            let path = folder.join(name);
            Growing::create(disk, &path).during("create a field of the telemetry", &path)
        };
        let files = fields()
            .map(|field| make(field.name))
            .collect::<Result<_, _>>()?;
        let mut format = make("format")?;
        format
            .append(format_text().as_bytes())
            .during("write the telemetry's format", folder)?;
        disk.sync_folder(folder)
            .during("flush the folder to the disk", folder)?;
        Ok(files)
    }

    /// Opens files that were closed; returns whether all exist with their complete frames.
    fn reopen(&mut self, disk: &dyn Disk) -> bool {
        if self.files.is_empty() {
            let open = |field: &Field| {
                let whole = self.frames * field.size();
                Growing::open(disk, &self.folder.join(field.name), whole)
            };
            let files: io::Result<Vec<Growing>> = fields().map(open).collect();
            self.files = files.unwrap_or_default();
        }
        !self.files.is_empty()
    }

    fn append(&mut self, row: &LoggedRow) -> Result<(), ArchiveError> {
        for (field, file) in fields().zip(&mut self.files) {
            file.append(&field.bytes(row))
                .during("add to the telemetry", &self.folder.join(field.name))?;
        }
        self.frames += 1;
        Ok(())
    }
}
