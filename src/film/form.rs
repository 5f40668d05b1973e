//! Destination and format of a film.

use std::ffi::OsStr;
use std::path::PathBuf;
use std::str::FromStr;

/// File format of a film.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// Pictures `film_00001.png` and so on.
    Folder,
    Gif,
    Apng,
}

/// Destination of a film: a file that ends in .gif, .apng or .png, or a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Destination {
    pub path: PathBuf,
    pub form: Form,
}

impl FromStr for Destination {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
        let ending = ending.as_ref().map(|ending| ending.to_string_lossy());
        let expected = "a file that ends in .gif, .apng or .png, or a folder";
        let form = match ending.as_deref() {
            None if path.is_file() => return Err(format!("expected {expected}, found a file")),
            _ if text.ends_with('/') || path.is_dir() => Form::Folder,
            None => Form::Folder,
            Some("gif") => Form::Gif,
            Some("apng" | "png") => Form::Apng,
            Some(other) => {
                return Err(format!("expected {expected}, found \".{other}\""));
            }
        };
        Ok(Self { path, form })
    }
}

impl Destination {
    /// Destination for one of several cameras: a folder of its own, or a file with its label in the name.
    pub fn of_camera(&self, label: &str) -> Self {
        let path = match self.form {
            Form::Folder => self.path.join(label),
            Form::Gif | Form::Apng => {
                let part =
                    |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
                let (stem, ending) = (part(self.path.file_stem()), part(self.path.extension()));
                self.path.with_file_name(format!("{stem}_{label}.{ending}"))
            }
        };
        Self { path, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_ending_says_what_a_film_is_and_each_camera_has_its_own() {
        for (path, form, of_camera) in [
            ("a/film.gif", Form::Gif, "a/film_demo-2.gif"),
            ("film.APNG", Form::Apng, "film_demo-2.APNG"),
            ("film.png", Form::Apng, "film_demo-2.png"),
            ("best/film", Form::Folder, "best/film/demo-2"),
            ("v1.2/", Form::Folder, "v1.2/demo-2"),
        ] {
            let destination: Destination = path.parse().unwrap();
            assert_eq!(destination.form, form, "{path}");
            let path = destination.of_camera("demo-2").path;
            assert_eq!(path, Path::new(of_camera));
        }
        let error = "film.mp4".parse::<Destination>().unwrap_err();
        assert!(
            error.ends_with(".apng or .png, or a folder, found \".mp4\""),
            "{error}"
        );
    }
}
