//! Two-dimensional images that are no frames: numbers that were counted or computed, one image in each HDU (FITS 4.0, sections 4.4 and 5).

use super::Problem;
use super::header::Card;
use super::layout::Layout;
use super::write::{program, put_cards};

/// The numbers of an image, row by row from its lowest row.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    Whole(Vec<i32>),
    Real(Vec<f32>),
}

impl Samples {
    fn bits(&self) -> &'static str {
        match self {
            Self::Whole(_) => "32",
            Self::Real(_) => "-32",
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Whole(numbers) => numbers.len(),
            Self::Real(numbers) => numbers.len(),
        }
    }

    fn put(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Whole(numbers) => bytes.extend(numbers.iter().flat_map(|n| n.to_be_bytes())),
            Self::Real(numbers) => bytes.extend(numbers.iter().flat_map(|n| n.to_be_bytes())),
        }
    }
}

/// An image with the cards of its header.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    pub name: &'static str,
    /// Length of a row.
    pub width_px: usize,
    pub samples: Samples,
    pub cards: Vec<Card>,
}

/// The bytes of a file of images: the first one is the primary HDU, so that every viewer shows it. `history` is written to each header.
///
/// # Errors
/// A card whose value is not of its keyword's kind.
pub fn encode_images(images: &[Image], history: &[String]) -> Result<Vec<u8>, Problem> {
    let samples: usize = images.iter().map(|image| image.samples.len()).sum();
    let mut file = Layout::new(4 * samples + images.len() * HEADER_BYTES);
    for (n, image) in images.iter().enumerate() {
        file.begin();
        match n {
            0 => file.value("SIMPLE", "T", "a FITS file"),
            _ => file.text("XTENSION", "IMAGE", "an image"),
        }
        let height_px = image.samples.len() / image.width_px.max(1);
        file.value("BITPIX", image.samples.bits(), "bits of a value");
        file.value("NAXIS", "2", "axes");
        file.value("NAXIS1", &image.width_px.to_string(), "width");
        file.value("NAXIS2", &height_px.to_string(), "height");
        match n {
            0 => file.value("EXTEND", "T", "extensions follow"),
            _ => {
                file.value("PCOUNT", "0", "no more data");
                file.value("GCOUNT", "1", "one group");
            }
        }
        file.text("EXTNAME", image.name, "name of this image");
        put_cards(&mut file, &program())?;
        put_cards(&mut file, &image.cards)?;
        history
            .iter()
            .for_each(|line| file.card(&format!("HISTORY {line}")));
        file.end_header();
        image.samples.put(file.bytes());
        file.end();
    }
    Ok(file.into_bytes())
}

/// Space for a header, and for the fill after its data.
const HEADER_BYTES: usize = 1 << 14;
