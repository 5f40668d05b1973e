//! Files that describe how a camera's frames were taken and solved, stored beside the frames: the flight's configuration and the instrument, one
//! file of each for every start of the program. Their hashes are in the header of every frame.

use super::store::Encoded;
use crate::fits::keyword::{self, Keyword};
use crate::fits::{Card, Header, Problem, Value};
use crate::instrument::TomlError;
use crate::instrument::toml_file::read_text;
use crate::provenance::sha256;
use jiff::Timestamp;
use std::path::{Path, PathBuf};

/// Kind of a file: the first part of its name, and the keyword of its hash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FlownKind {
    pub name: &'static str,
    pub keyword: &'static Keyword,
}

pub const CONFIGURATION: FlownKind = FlownKind {
    name: "configuration",
    keyword: &keyword::CONFSHA,
};
pub const INSTRUMENT: FlownKind = FlownKind {
    name: "instrument",
    keyword: &keyword::INSTSHA,
};

/// SHA-256 of the configuration and of the instrument's file, as named in a frame's header.
pub fn flown_sha256(header: &Header) -> [Option<String>; 2] {
    [CONFIGURATION, INSTRUMENT].map(|kind| match header.get(kind.keyword.name) {
        Some(Value::Text(sha256)) => Some(sha256.clone()),
        _ => None,
    })
}

/// Files of a camera.
#[derive(Debug, Clone, Default)]
pub struct Flown(Vec<FlownText>);

#[derive(Debug, Clone)]
struct FlownText {
    kind: FlownKind,
    text: String,
    sha256: String,
}

impl Flown {
    /// Verbatim texts of the effective configuration and the instrument's file; an instrument that no file describes has none.
    pub fn new(configuration: String, instrument: Option<String>) -> Self {
        let texts = [
            (CONFIGURATION, Some(configuration)),
            (INSTRUMENT, instrument),
        ];
        let text = |(kind, text): (_, Option<String>)| {
            let text = text?;
            let sha256 = sha256(&text);
            Some(FlownText { kind, text, sha256 })
        };
        Self(texts.into_iter().filter_map(text).collect())
    }

    /// The hashes, for a frame's header.
    pub fn cards(&self) -> impl Iterator<Item = Card> {
        let card = |text: &FlownText| Card::new(text.kind.keyword, text.sha256.as_str());
        self.0.iter().map(card)
    }

    /// The hash of a kind's text.
    pub fn sha256(&self, kind: FlownKind) -> Option<String> {
        let text = self.0.iter().find(|text| text.kind == kind);
        text.map(|text| text.sha256.clone())
    }

    /// The files of one start of the program, in a camera's folder: `configuration_<start>.toml` and
    /// `instrument_<start>.toml`.
    pub fn files(&self, folder: &Path, start: Timestamp) -> impl Iterator<Item = Encoded> {
        let start = start.strftime("%Y%m%dT%H%M%S").to_string();
        self.0.iter().map(move |text| Encoded {
            name: folder.join(format!("{}_{start}.toml", text.kind.name)),
            bytes: text.text.clone().into_bytes(),
        })
    }
}

/// Settings of the navigation for one start of the program: `navigation_<start>.toml`.
pub fn navigation_file(text: &str, start: Timestamp) -> Encoded {
    let start = start.strftime("%Y%m%dT%H%M%S");
    Encoded {
        name: format!("navigation_{start}.toml").into(),
        bytes: text.as_bytes().into(),
    }
}

impl FlownKind {
    /// Whether a file of this name is of this kind.
    pub fn names(self, file: &Path) -> bool {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let rest = name.strip_prefix(self.name);
        rest.is_some_and(|rest| rest.starts_with('_') && rest.ends_with(".toml"))
    }
}

/// A configuration or an instrument that an archive holds.
#[derive(Debug, Clone)]
pub struct FlownFile {
    pub kind: FlownKind,
    pub path: PathBuf,
    pub text: String,
    sha256: String,
}

impl FlownFile {
    /// A file whose name has one of the kinds.
    pub fn new(path: PathBuf, text: String) -> Self {
        Self {
            kind: match INSTRUMENT.names(&path) {
                true => INSTRUMENT,
                false => CONFIGURATION,
            },
            sha256: sha256(&text),
            path,
            text,
        }
    }

    pub fn sha256(&self) -> &str {
        &self.sha256
    }
}

/// The configurations and instruments of an archive.
#[derive(Debug, Clone, Default)]
pub struct FlownFiles(Vec<FlownFile>);

impl FromIterator<FlownFile> for FlownFiles {
    fn from_iter<T: IntoIterator<Item = FlownFile>>(files: T) -> Self {
        Self(files.into_iter().collect())
    }
}

impl FlownFiles {
    /// Reads files whose names each have one of the kinds.
    ///
    /// # Errors
    /// The error of the first file that cannot be read.
    pub fn read(paths: &[PathBuf]) -> Result<Self, TomlError> {
        let read = |path: &PathBuf| Ok(FlownFile::new(path.clone(), read_text(path)?));
        paths.iter().map(read).collect()
    }

    pub fn of(&self, kind: FlownKind) -> impl Iterator<Item = &FlownFile> {
        self.0.iter().filter(move |file| file.kind == kind)
    }

    /// Removes the files of a kind: frames may then name any.
    pub fn without(mut self, kind: FlownKind) -> Self {
        self.0.retain(|file| file.kind != kind);
        self
    }

    /// Refuses a frame that names another configuration or instrument than those here; a kind without files is not checked.
    ///
    /// # Errors
    /// The keyword, with the expected and the found value.
    pub fn check(&self, header: &Header) -> Result<(), Problem> {
        for kind in [CONFIGURATION, INSTRUMENT] {
            let Some(Value::Text(named)) = header.get(kind.keyword.name) else {
                continue;
            };
            let mut known = self.of(kind).peekable();
            if known.peek().is_some() && !known.any(|file| file.sha256 == *named) {
                return Err(Problem::Field {
                    field: kind.keyword.name.into(),
                    expected: format!("the SHA-256 of a file {}_*.toml of the archive", kind.name),
                    found: format!("'{named}'"),
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::Store;
    use crate::archive::check::Tree;
    use crate::fits::{Compression, FitsFile};
    use crate::frame::{Frame, FrameInfo, Pixels};

    const START: &str = "2013-09-21T18:00:00Z";

    fn frame(second: u32) -> Frame {
        let info = FrameInfo {
            mid_exposure: Some(format!("2013-09-21T18:00:{second:02}Z").parse().unwrap()),
            ..FrameInfo::default()
        };
        Frame::new(2, 1, Pixels::U8(vec![0, 255]), 255, info).unwrap()
    }

    fn flown(configuration: &str) -> Flown {
        Flown::new(configuration.into(), Some("name = \"demo\"\n".into()))
    }

    fn fly(root: &Path, configuration: &str, second: u32) -> PathBuf {
        let store = Store::open(root, "demo", Compression::Rice).unwrap();
        let flown = flown(configuration);
        store.add_flight_files(flown.files(Path::new(""), START.parse().unwrap()));
        let cards: Vec<Card> = flown.cards().collect();
        store.write(&frame(second), &cards, &[]).unwrap()
    }

    #[test]
    fn flights_of_one_archive_keep_their_files_apart_even_of_one_second() {
        let root = tempfile::tempdir().unwrap();
        let frames = [fly(root.path(), "a", 1), fly(root.path(), "b", 2)];
        let tree = Tree::of(root.path()).unwrap();
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(
            tree.flown.iter().map(name).collect::<Vec<_>>(),
            [
                "configuration_20130921T180000.toml",
                "configuration_20130921T180000_2.toml",
                "instrument_20130921T180000.toml",
                "instrument_20130921T180000_2.toml",
            ]
        );
        let files = FlownFiles::read(&tree.flown).unwrap();
        let texts: Vec<&str> = files
            .of(CONFIGURATION)
            .map(|file| file.text.as_str())
            .collect();
        assert_eq!(texts, ["a", "b"]);
        for path in &frames {
            let header = FitsFile::open(path).unwrap().keywords().unwrap();
            assert!(files.check(&header).is_ok());
        }
    }

    #[test]
    fn a_frame_that_names_another_configuration_is_refused_unless_there_is_none_to_compare() {
        let root = tempfile::tempdir().unwrap();
        fly(root.path(), "a", 1);
        let files = FlownFiles::read(&Tree::of(root.path()).unwrap().flown).unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        let stranger = fly(elsewhere.path(), "b", 2);
        let header = FitsFile::open(&stranger).unwrap().keywords().unwrap();
        let refused = files.check(&header).unwrap_err().to_string();
        assert!(
            refused.starts_with("CONFSHA: expected the SHA-256 of a file"),
            "{refused}"
        );
        assert!(files.without(CONFIGURATION).check(&header).is_ok());
        assert!(FlownFiles::default().check(&header).is_ok());
    }

    #[test]
    fn a_disk_that_lost_the_files_gets_them_again_when_it_is_mounted_anew() {
        let root = tempfile::tempdir().unwrap();
        let store = Store::open(root.path(), "demo", Compression::Rice).unwrap();
        store.add_flight_files(flown("a").files(Path::new("camera"), START.parse().unwrap()));
        store.write(&frame(1), &[], &[]).unwrap();
        let file = root
            .path()
            .join("camera/configuration_20130921T180000.toml");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "a");
        std::fs::remove_dir_all(root.path().join("camera")).unwrap();
        let mark = root.path().join(crate::archive::MARK);
        std::fs::remove_file(&mark).unwrap();
        std::fs::write(&mark, "").unwrap();
        store.write(&frame(2), &[], &[]).unwrap();
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "a");
        assert_eq!(
            std::fs::read_dir(root.path().join("camera"))
                .unwrap()
                .count(),
            2
        );
    }
}
