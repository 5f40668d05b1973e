//! The structure of a FITS file: the ranges of each header and its data, checked against the size of the file.
//!
//! No memory is allocated for sizes that a header merely states.

use super::Problem;
use super::header::{CARD, Header};
use std::ops::Range;

/// Bytes of a FITS block: headers and data fill whole blocks.
pub(super) const BLOCK: usize = 2880;

/// The longest side of an image that is read, px.
pub(super) const MAX_SIDE: i64 = 65_536;

/// One header and the data it describes, as ranges of bytes in the file.
#[derive(Debug)]
pub(super) struct Hdu {
    pub header: Header,
    pub header_bytes: Range<usize>,
    pub data_bytes: Range<usize>,
}

/// Content of an HDU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    Image,
    CompressedImage,
    Other,
}

impl Hdu {
    pub fn content(&self) -> Content {
        let extension = match self.header.get("XTENSION") {
            Some(super::Value::Text(name)) => name.as_str(),
            _ => "IMAGE",
        };
        let compressed = self.header.get("ZIMAGE") == Some(&true.into());
        match extension {
            "IMAGE" if self.header.get("NAXIS") != Some(&0.into()) => Content::Image,
            "BINTABLE" if compressed => Content::CompressedImage,
            _ => Content::Other,
        }
    }

    /// The whole HDU: header, data and the fill of their last blocks.
    pub fn bytes(&self, file_bytes: usize) -> Range<usize> {
        let end = self.data_bytes.end.next_multiple_of(BLOCK);
        self.header_bytes.start..end.min(file_bytes)
    }
}

/// Every HDU of a file, each complete; otherwise the first error.
pub(super) fn scan(bytes: &[u8]) -> Result<Vec<Hdu>, Problem> {
    let mut hdus = vec![hdu_at(bytes, 0)?];
    loop {
        let next = hdus
            .last()
            .map_or(0, |hdu| hdu.data_bytes.end.next_multiple_of(BLOCK));
        // Bytes after the last HDU that are no extension do not belong to the file's content (FITS 4.0, 3.5).
        if !bytes
            .get(next..)
            .is_some_and(|b| b.starts_with(b"XTENSION"))
        {
            return Ok(hdus);
        }
        hdus.push(hdu_at(bytes, next)?);
    }
}

/// The HDUs whose headers are in the beginning of a file, without their data.
pub(super) fn begun(bytes: &[u8]) -> Vec<Hdu> {
    let mut hdus = Vec::new();
    let mut start = 0;
    while let Some(rest) = bytes.get(start..)
        && (start == 0 || rest.starts_with(b"XTENSION"))
        && let Some((header, length)) = Header::parse(rest)
    {
        let data = (start + length).next_multiple_of(BLOCK);
        let Ok(promised) = data_size(&header) else {
            break;
        };
        hdus.push(Hdu {
            header,
            header_bytes: start..start + length,
            data_bytes: data..data,
        });
        let end = data.saturating_add(promised as usize);
        start = end.checked_next_multiple_of(BLOCK).unwrap_or(usize::MAX);
    }
    hdus
}

fn hdu_at(bytes: &[u8], start: usize) -> Result<Hdu, Problem> {
    let (header, length) = Header::parse(&bytes[start..]).ok_or_else(|| {
        let expected = format!("an END card to close the header at byte {start}");
        Problem::content(
            expected,
            format!("the end of the file at byte {}", bytes.len()),
        )
    })?;
    // The last header of a file may lack the fill of its last block.
    let data = (start + length).next_multiple_of(BLOCK).min(bytes.len());
    let promised = data_size(&header)?;
    let present = (bytes.len() - data) as u64;
    if promised > present {
        return Err(Problem::field(
            "NAXISn",
            format!("{promised} bytes of data after the header at byte {start}"),
            format!("{present} before the end of the file"),
        ));
    }
    Ok(Hdu {
        header,
        header_bytes: start..start + length,
        data_bytes: data..data + promised as usize,
    })
}

/// Bytes of data that a header states (FITS 4.0, equation 2); saturates instead of overflowing.
pub(super) fn data_size(header: &Header) -> Result<u64, Problem> {
    let axes = header.size("NAXIS", 0..=999)?;
    let bits = header.integer("BITPIX")?;
    let Some(bits @ (8 | 16 | 32 | 64 | -32 | -64)) = bits else {
        let found = bits.map_or("nothing".into(), |bits| bits.to_string());
        return Err(Problem::field("BITPIX", "8, 16, 32, 64, -32 or -64", found));
    };
    if axes == 0 {
        return Ok(0);
    }
    let mut pixels = 1u64;
    for axis in 1..=axes {
        let keyword = format!("NAXIS{axis}");
        pixels = pixels.saturating_mul(header.size(&keyword, 0..=i64::MAX)?);
    }
    let optional = |keyword, default| match header.get(keyword) {
        Some(_) => header.size(keyword, 0..=i64::MAX),
        None => Ok(default),
    };
    let (parameters, groups) = (optional("PCOUNT", 0)?, optional("GCOUNT", 1)?);
    Ok(pixels
        .saturating_add(parameters)
        .saturating_mul(groups)
        .saturating_mul(bits.unsigned_abs() / 8))
}

const _: () = assert!(BLOCK.is_multiple_of(CARD));
