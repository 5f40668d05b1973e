//! The binary table of a tile-compressed image: positions of the tiles' streams.

use super::Problem;
use super::form::Form;
use super::header::Header;
use super::structure::Hdu;
use std::ops::Range;

/// Largest ratio of the bytes of all tiles together to those of the data: some tiles may share a stream.
const MOST_SHARING: usize = 4;

/// The table of tiles, with one row for each.
pub(super) struct TileTable<'a> {
    data: &'a [u8],
    /// Start of the data in the file.
    start: usize,
    row_bytes: usize,
    tiles: usize,
    columns: Vec<Column>,
    heap: Range<usize>,
}

impl<'a> TileTable<'a> {
    /// The table of this many tiles, checked against the size of its data.
    pub fn new(bytes: &'a [u8], hdu: &Hdu, tiles: usize) -> Result<Self, Problem> {
        let (header, data) = (&hdu.header, &bytes[hdu.data_bytes.clone()]);
        let row_bytes = header.size("NAXIS1", 1..=1_000_000)? as usize;
        let columns = columns(header)?;
        let width: usize = columns.iter().map(|column| column.bytes).sum();
        if width != row_bytes {
            let expected = format!("{width} bytes, as the columns need");
            return Err(Problem::field("NAXIS1", expected, row_bytes));
        }
        Ok(Self {
            data,
            start: hdu.data_bytes.start,
            row_bytes,
            tiles,
            heap: heap(header, data.len(), row_bytes, tiles)?,
            columns,
        })
    }

    /// A column by its name, and its start in a row.
    fn column(&self, name: &str) -> Option<(&Column, usize)> {
        let index = self.columns.iter().position(|column| column.name == name)?;
        let start = self.columns[..index]
            .iter()
            .map(|column| column.bytes)
            .sum();
        Some((&self.columns[index], start))
    }

    fn rows(&self) -> impl Iterator<Item = &[u8]> {
        self.data.chunks_exact(self.row_bytes).take(self.tiles)
    }

    /// Range in the file of each tile's stream of bytes, from the descriptors of a column.
    pub fn streams(&self, name: &str) -> Result<Option<Vec<Range<usize>>>, Problem> {
        self.streams_of(name, |element_bytes| element_bytes == 1)
    }

    /// The same for tiles that are not compressed: streams of numbers.
    pub fn plain_streams(&self, name: &str) -> Result<Option<Vec<Range<usize>>>, Problem> {
        self.streams_of(name, |_| true)
    }

    fn streams_of(
        &self,
        name: &str,
        allows: impl Fn(usize) -> bool,
    ) -> Result<Option<Vec<Range<usize>>>, Problem> {
        let has_streams = |(column, _): &(&Column, usize)| {
            let element = column.pointer.map(|(_, element_bytes)| element_bytes);
            element.is_some_and(&allows)
        };
        let Some((column, start)) = self.column(name).filter(has_streams) else {
            return Ok(None);
        };
        let streams = self.rows().enumerate().map(|(n, row)| {
            let (length, offset) = column.descriptor(&row[start..]);
            if offset.saturating_add(length) > self.heap.len() {
                let field = format!("tile {}", n + 1);
                let expected = format!("data within the heap of {} bytes", self.heap.len());
                let found = format!("{length} bytes at byte {offset}");
                return Err(Problem::field(field, expected, found));
            }
            let start = self.start + self.heap.start + offset;
            Ok(start..start + length)
        });
        let streams: Vec<Range<usize>> = streams.collect::<Result<_, Problem>>()?;
        // Tiles may share a stream, but a short file must not keep its reader busy for hours.
        let all: usize = streams.iter().map(Range::len).sum();
        let most = MOST_SHARING * self.data.len();
        if all > most {
            let expected = format!("tiles of at most {most} bytes in all");
            return Err(Problem::field(name, expected, format!("{all} bytes")));
        }
        Ok(Some(streams))
    }

    /// Step and value of number 0 of each tile, from columns or keywords; `None` if numbers were not quantised.
    pub fn steps(&self, header: &Header) -> Result<Option<Vec<[f64; 2]>>, Problem> {
        let column = |name: &str| {
            let (_, start) = self.column(name).filter(|(column, _)| column.is_double)?;
            let number = move |row: &[u8]| {
                let bytes = row[start..].first_chunk().copied().unwrap_or_default();
                f64::from_be_bytes(bytes)
            };
            Some(self.rows().map(number).collect::<Vec<f64>>())
        };
        let numbers = |name: &str| match (column(name), header.number(name)?) {
            (Some(numbers), _) => Ok(Some(numbers)),
            (None, Some(number)) => Ok(Some(vec![number; self.tiles])),
            (None, None) => Ok::<_, Problem>(None),
        };
        let pairs = numbers("ZSCALE")?.zip(numbers("ZZERO")?);
        Ok(pairs.map(|(steps, zeros)| steps.into_iter().zip(zeros).map(|(s, z)| [s, z]).collect()))
    }
}

/// Range of the heap in the data, after the table's rows.
fn heap(
    header: &Header,
    data_bytes: usize,
    row_bytes: usize,
    tiles: usize,
) -> Result<Range<usize>, Problem> {
    let table_bytes = row_bytes.saturating_mul(tiles);
    if table_bytes > data_bytes {
        let expected = format!("{tiles} rows of {row_bytes} bytes in the data");
        let found = format!("{} bytes", data_bytes);
        return Err(Problem::field("NAXISn", expected, found));
    }
    let heap_start = match header.get("THEAP") {
        Some(_) => header.size("THEAP", table_bytes as i64..=data_bytes as i64)? as usize,
        None => table_bytes,
    };
    Ok(heap_start..data_bytes)
}

/// A column of the table of tiles.
struct Column {
    name: String,
    /// Bytes in a row.
    bytes: usize,
    /// For a descriptor of a stream: half its bytes, and the bytes of an element of the stream; `None` in any other column.
    pointer: Option<(usize, usize)>,
    /// Whether it holds one floating-point number of 64 bits.
    is_double: bool,
}

impl Column {
    /// Length and offset of a stream in bytes, big-endian, each in half of the descriptor.
    fn descriptor(&self, row: &[u8]) -> (usize, usize) {
        let number = |bytes: &[u8]| bytes.iter().fold(0, |n: usize, b| n << 8 | usize::from(*b));
        let (half, element) = self.pointer.unwrap_or((0, 1));
        let length = number(&row[..half]).saturating_mul(element);
        (length, number(&row[half..2 * half]))
    }
}

fn columns(header: &Header) -> Result<Vec<Column>, Problem> {
    let count = header.size("TFIELDS", 1..=999)?;
    (1..=count).map(|n| column(header, n)).collect()
}

fn column(header: &Header, n: u64) -> Result<Column, Problem> {
    let keyword = format!("TFORM{n}");
    let form = header.text(&keyword)?.unwrap_or_default();
    let name = header.text(&format!("TTYPE{n}"))?.unwrap_or_default();
    column_of(&form, name).ok_or_else(|| {
        let expected = "a column of a compressed image";
        Problem::field(keyword, expected, format!("'{form}'"))
    })
}

/// A column of this form; of descriptors (P, Q) only one per row is allowed.
fn column_of(form: &str, name: String) -> Option<Column> {
    let form = Form::parse(form)?;
    let half = match form.letter {
        'P' => Some(4),
        'Q' => Some(8),
        _ => None,
    };
    if half.is_some() && form.repeat != 1 {
        return None;
    }
    let element = match form.pointed_to {
        Some('B') => Some(1),
        Some('I') => Some(2),
        Some('J' | 'E') => Some(4),
        Some('K' | 'D') => Some(8),
        _ => None,
    };
    Some(Column {
        name,
        bytes: form.bytes()?,
        pointer: half.zip(element),
        is_double: form.letter == 'D' && form.repeat == 1,
    })
}
