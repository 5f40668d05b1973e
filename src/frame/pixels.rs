//! The pixels of a frame, either all in memory or decoded row by row on first access, and typed views of them.

use std::fmt;
use std::sync::{Arc, OnceLock};

/// The pixels of a frame, row by row from the first, in digital numbers (DN).
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    U8(Vec<u8>),
    U16(Vec<u16>),
}

impl Pixels {
    pub fn len(&self) -> usize {
        self.as_slice().len()
    }

    pub fn is_empty(&self) -> bool {
        self.as_slice().is_empty()
    }

    /// Bits of a stored pixel.
    pub fn bits(&self) -> u32 {
        self.as_slice().bits()
    }

    pub fn as_slice(&self) -> PixelSlice<'_> {
        match self {
            Self::U8(p) => PixelSlice::U8(p),
            Self::U16(p) => PixelSlice::U16(p),
        }
    }
}

/// Pixels as in [`Pixels`], in memory of the caller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PixelSlice<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
}

impl PixelSlice<'_> {
    pub fn len(&self) -> usize {
        match self {
            Self::U8(p) => p.len(),
            Self::U16(p) => p.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bits of a stored pixel.
    pub fn bits(&self) -> u32 {
        match self {
            Self::U8(_) => 8,
            Self::U16(_) => 16,
        }
    }

    /// The bits that are set in at least one pixel.
    pub fn bits_set(&self) -> u16 {
        match self {
            Self::U8(p) => p.iter().fold(0, |bits, dn| bits | dn).into(),
            Self::U16(p) => p.iter().fold(0, |bits, dn| bits | dn),
        }
    }

    /// Saturation value of pixels whose source does not state it: 16-bit pixels are assumed to range from 0 to 4095 unless
    /// a pixel exceeds that. If no pixel has the lowest bits set, the numbers are left-aligned, and the largest value has
    /// these bits clear as well.
    pub fn assumed_saturation_dn(&self) -> u16 {
        let Self::U16(_) = self else {
            return 255;
        };
        match self.bits_set() {
            ..=4095 => 4095,
            bits => u16::MAX << bits.trailing_zeros().min(8),
        }
    }

    fn to_pixels(self) -> Pixels {
        match self {
            Self::U8(p) => Pixels::U8(p.into()),
            Self::U16(p) => Pixels::U16(p.into()),
        }
    }
}

/// Memory that holds the pixels of a frame, row by row from the first, but is not owned by the frame.
pub trait SharedPixels: Send + Sync {
    /// The pixels; they must never change.
    fn pixels(&self) -> PixelSlice<'_>;
}

/// A pixel's value as used by the algorithms.
pub trait Sample: Copy + Default + Ord + Into<u32> + Send + Sync + 'static {
    fn dn(self) -> f32;

    /// The largest value that is not above `dn`.
    fn floor(dn: f64) -> Self;

    /// The pixels, if they are of this type; otherwise an empty slice.
    fn of(pixels: PixelSlice<'_>) -> &[Self];
}

impl Sample for u8 {
    #[inline]
    fn dn(self) -> f32 {
        f32::from(self)
    }

    fn floor(dn: f64) -> Self {
        dn.floor() as Self
    }

    fn of(pixels: PixelSlice<'_>) -> &[Self] {
        match pixels {
            PixelSlice::U8(pixels) => pixels,
            PixelSlice::U16(_) => &[],
        }
    }
}

impl Sample for u16 {
    #[inline]
    fn dn(self) -> f32 {
        f32::from(self)
    }

    fn floor(dn: f64) -> Self {
        dn.floor() as Self
    }

    fn of(pixels: PixelSlice<'_>) -> &[Self] {
        match pixels {
            PixelSlice::U8(_) => &[],
            PixelSlice::U16(pixels) => pixels,
        }
    }
}

/// Source of the rows of a frame.
pub trait RowSource: Send + Sync {
    /// The pixels of row `y`; `None` if it is damaged.
    fn row(&self, y: usize) -> Option<Pixels>;
}

/// A frame's pixels, each row decoded on first access.
pub(super) struct OnDemand {
    source: Box<dyn RowSource>,
    /// Replacement of a damaged row.
    dark: Pixels,
    rows: Vec<OnceLock<Pixels>>,
    whole: OnceLock<Pixels>,
}

impl OnDemand {
    pub fn new(source: Box<dyn RowSource>, dark: Pixels, height: usize) -> Self {
        Self {
            source,
            dark,
            rows: (0..height).map(|_| OnceLock::new()).collect(),
            whole: OnceLock::new(),
        }
    }

    #[inline(never)]
    fn row(&self, y: usize) -> &Pixels {
        self.rows[y].get_or_init(|| {
            let row = self.source.row(y);
            let has_shape =
                |row: &Pixels| row.len() == self.dark.len() && row.bits() == self.dark.bits();
            row.filter(has_shape).unwrap_or_else(|| self.dark.clone())
        })
    }

    fn whole(&self) -> &Pixels {
        self.whole.get_or_init(|| {
            let rows = (0..self.rows.len()).map(|y| self.row(y).as_slice());
            match self.dark {
                Pixels::U8(_) => Pixels::U8(rows.flat_map(u8::of).copied().collect()),
                Pixels::U16(_) => Pixels::U16(rows.flat_map(u16::of).copied().collect()),
            }
        })
    }
}

impl fmt::Debug for OnDemand {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decoded = self.rows.iter().filter(|row| row.get().is_some()).count();
        write!(out, "{decoded} of {} rows", self.rows.len())
    }
}

/// A frame's pixels in memory of the caller, copied only when they are requested as [`Pixels`].
pub(super) struct Shared {
    source: Box<dyn SharedPixels>,
    whole: OnceLock<Pixels>,
}

impl Shared {
    pub fn new(source: Box<dyn SharedPixels>) -> Self {
        Self {
            source,
            whole: OnceLock::new(),
        }
    }
}

impl fmt::Debug for Shared {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} shared pixels", self.source.pixels().len())
    }
}

/// Storage of a frame's pixels.
#[derive(Debug, Clone)]
pub(super) enum PixelStorage {
    Whole(Pixels),
    OnDemand(Arc<OnDemand>),
    Shared(Arc<Shared>),
}

impl PixelStorage {
    pub fn whole(&self) -> &Pixels {
        match self {
            Self::Whole(pixels) => pixels,
            Self::OnDemand(rows) => rows.whole(),
            Self::Shared(pixels) => pixels
                .whole
                .get_or_init(|| pixels.source.pixels().to_pixels()),
        }
    }

    pub fn bits(&self) -> u32 {
        match self {
            Self::Whole(pixels) => pixels.bits(),
            Self::OnDemand(rows) => rows.dark.bits(),
            Self::Shared(pixels) => pixels.source.pixels().bits(),
        }
    }

    /// A typed view of the pixels. The type must be that of the pixels.
    pub fn view<T: Sample>(&self, width: usize, height: usize) -> View<'_, T> {
        View {
            width,
            height,
            rows: match self {
                Self::Whole(pixels) => Rows::Whole(T::of(pixels.as_slice())),
                Self::OnDemand(rows) => Rows::OnDemand(rows),
                Self::Shared(pixels) => Rows::Whole(T::of(pixels.source.pixels())),
            },
        }
    }
}

impl PartialEq for PixelStorage {
    fn eq(&self, other: &Self) -> bool {
        self.whole() == other.whole()
    }
}

/// A typed view of a frame's pixels, for algorithms that are generic in the pixel's depth.
#[derive(Debug, Clone, Copy)]
pub struct View<'a, T> {
    pub width: usize,
    pub height: usize,
    rows: Rows<'a, T>,
}

#[derive(Debug, Clone, Copy)]
enum Rows<'a, T> {
    Whole(&'a [T]),
    OnDemand(&'a OnDemand),
}

impl<'a, T: Sample> View<'a, T> {
    /// The pixels of row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [T] {
        match self.rows {
            Rows::Whole(pixels) => &pixels[y * self.width..][..self.width],
            Rows::OnDemand(rows) => T::of(rows.row(y).as_slice()),
        }
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = T> + 'a {
        let view = *self;
        (0..self.height).flat_map(move |y| view.row(y).iter().copied())
    }

    /// A pixel, the one to its right, and the two below.
    #[inline(always)]
    pub fn square(&self, x: usize, y: usize) -> [T; 4] {
        let (above, below) = match self.rows {
            Rows::Whole(pixels) => pixels[y * self.width + x..].split_at(self.width),
            Rows::OnDemand(rows) => {
                let row = |y| &T::of(rows.row(y).as_slice())[x..];
                (row(y), row(y + 1))
            }
        };
        [above[0], above[1], below[0], below[1]]
    }

    /// The value at column `x`, row `y`, DN.
    #[inline]
    pub fn dn(&self, x: usize, y: usize) -> f32 {
        self.row(y)[x].dn()
    }
}

/// Runs an expression with `$view` bound to a typed [`View`] of the frame.
#[macro_export]
macro_rules! with_view {
    ($frame:expr, $view:ident => $body:expr) => {{
        let frame: &$crate::frame::Frame = $frame;
        match frame.bits() {
            8 => {
                let $view = frame.view::<u8>();
                $body
            }
            _ => {
                let $view = frame.view::<u16>();
                $body
            }
        }
    }};
}

#[cfg(test)]
mod tests {
    use super::{PixelSlice, SharedPixels};
    use crate::frame::{Frame, FrameInfo, Pixels, RowSource};
    use std::sync::{Arc, Mutex};

    /// Rows of four pixels with the row's number as value; row 2 is damaged, row 3 too long.
    struct Counting(Arc<Mutex<Vec<usize>>>);

    impl RowSource for Counting {
        fn row(&self, y: usize) -> Option<Pixels> {
            self.0.lock().unwrap().push(y);
            let width = if y == 3 { 5 } else { 4 };
            (y != 2).then(|| Pixels::U8(vec![y as u8; width]))
        }
    }

    #[test]
    fn rows_are_decoded_once_when_they_are_read_and_damaged_ones_are_dark() {
        let asked = Arc::default();
        let source = Box::new(Counting(Arc::clone(&asked)));
        let dark = Pixels::U8(vec![9; 4]);
        let frame = Frame::on_demand(dark, 5, source, 255, FrameInfo::default()).unwrap();
        assert_eq!((frame.width(), frame.height(), frame.bits()), (4, 5, 8));
        assert_eq!(frame.dn(1, 4), 4.0);
        assert_eq!(frame.column_dn(0, 0..2), [0.0, 1.0]);
        assert_eq!(frame.row_dn(4, 0..2), [4.0, 4.0]);
        assert_eq!(*asked.lock().unwrap(), [4, 0, 1]);
        assert_eq!(frame.row_dn(2, 0..4), [9.0; 4]);
        let whole: Vec<u8> = [0, 1, 9, 9, 4].iter().flat_map(|dn| [*dn; 4]).collect();
        assert_eq!(*frame.pixels(), Pixels::U8(whole));
        assert_eq!(*asked.lock().unwrap(), [4, 0, 1, 2, 3]);
    }

    impl SharedPixels for Vec<u16> {
        fn pixels(&self) -> PixelSlice<'_> {
            PixelSlice::U16(self)
        }
    }

    #[test]
    fn shared_pixels_are_seen_as_those_of_a_frame_of_its_own() {
        let pixels: Vec<u16> = (0..12).collect();
        let info = FrameInfo::default;
        let shared = Frame::shared(4, 3, Box::new(pixels.clone()), 4095, info()).unwrap();
        let own = Frame::new(4, 3, Pixels::U16(pixels.clone()), 4095, info()).unwrap();
        assert_eq!(shared.bits(), 16);
        assert_eq!(shared.row_dn(2, 0..4), own.row_dn(2, 0..4));
        assert_eq!(shared, own);
        assert!(Frame::shared(5, 3, Box::new(pixels), 4095, info()).is_err());
    }

    #[test]
    fn pixels_of_16_bits_hold_12_unless_one_shows_more() {
        assert_eq!(PixelSlice::U8(&[3]).assumed_saturation_dn(), 255);
        assert_eq!(PixelSlice::U16(&[3, 4095]).assumed_saturation_dn(), 4095);
        assert_eq!(PixelSlice::U16(&[4096, 3]).assumed_saturation_dn(), 65_535);
        let left_aligned = [16, 48, 65_520];
        assert_eq!(
            PixelSlice::U16(&left_aligned).assumed_saturation_dn(),
            65_520
        );
    }
}
