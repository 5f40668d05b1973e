//! The pixels of a frame, all of them in memory or each row decoded when somebody first reads it, and typed views of them.

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
}

/// A pixel's value as the algorithms read it.
pub trait Sample: Copy + Default + Ord + Into<u32> + Send + Sync + 'static {
    fn dn(self) -> f32;

    /// The largest value that is not above a number of DN.
    fn floor(dn: f64) -> Self;

    /// The pixels, if they are of this type; else none.
    fn of(pixels: &Pixels) -> &[Self];
}

impl Sample for u8 {
    #[inline]
    fn dn(self) -> f32 {
        f32::from(self)
    }

    fn floor(dn: f64) -> Self {
        dn.floor() as Self
    }

    fn of(pixels: &Pixels) -> &[Self] {
        match pixels {
            Pixels::U8(pixels) => pixels,
            Pixels::U16(_) => &[],
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

    fn of(pixels: &Pixels) -> &[Self] {
        match pixels {
            Pixels::U8(_) => &[],
            Pixels::U16(pixels) => pixels,
        }
    }
}

/// Where the rows of a frame come from.
pub trait RowSource: Send + Sync {
    /// The pixels of row `y`; none where it is damaged.
    fn row(&self, y: usize) -> Option<Pixels>;
}

/// A frame's pixels, each row decoded when it is first asked for.
pub(super) struct OnDemand {
    source: Box<dyn RowSource>,
    /// What stands for a row that is damaged.
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
            let rows = (0..self.rows.len()).map(|y| self.row(y));
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

/// How a frame has its pixels.
#[derive(Debug, Clone)]
pub(super) enum PixelStorage {
    Whole(Pixels),
    OnDemand(Arc<OnDemand>),
}

impl PixelStorage {
    pub fn whole(&self) -> &Pixels {
        match self {
            Self::Whole(pixels) => pixels,
            Self::OnDemand(rows) => rows.whole(),
        }
    }

    pub fn bits(&self) -> u32 {
        match self {
            Self::Whole(pixels) => pixels.bits(),
            Self::OnDemand(rows) => rows.dark.bits(),
        }
    }

    /// A typed view of the pixels. The type must be theirs.
    pub fn view<T: Sample>(&self, width: usize, height: usize) -> View<'_, T> {
        View {
            width,
            height,
            rows: match self {
                Self::Whole(pixels) => Rows::Whole(T::of(pixels)),
                Self::OnDemand(rows) => Rows::OnDemand(rows),
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
            Rows::OnDemand(rows) => T::of(rows.row(y)),
        }
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = T> + 'a {
        let view = *self;
        (0..self.height).flat_map(move |y| view.row(y).iter().copied())
    }

    /// The value at column `x`, row `y`, DN.
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
    use crate::frame::{Frame, FrameInfo, Pixels, RowSource};
    use std::sync::{Arc, Mutex};

    /// Rows of four pixels that have their row's number; row 2 is damaged, row 3 too long.
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
}
