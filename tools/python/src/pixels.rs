//! A NumPy array as a frame, without a copy.

use crate::errors::{type_error, value_error};
use numpy::{
    Element, PyArray2, PyArrayDescrMethods, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use solaspect::fits;
use solaspect::frame::{Frame, FrameInfo, PixelSlice, SharedPixels};

/// The memory of a C-contiguous array.
struct ArrayPixels<T> {
    first: *const T,
    count: usize,
    /// Keeps the memory alive.
    _array: Py<PyArray2<T>>,
}

// SAFETY: the memory lives as long as the array held here, and is only read. The caller must ensure that no other thread
// writes to the array meanwhile, as with NumPy's own functions that release the GIL.
unsafe impl<T: Sync> Send for ArrayPixels<T> {}
unsafe impl<T: Sync> Sync for ArrayPixels<T> {}

impl<T: Element> ArrayPixels<T> {
    fn new(array: &Bound<'_, PyArray2<T>>) -> Self {
        Self {
            first: array.data(),
            count: array.len(),
            _array: array.clone().unbind(),
        }
    }

    fn slice(&self) -> &[T] {
        // SAFETY: NumPy gives the address and number of the array's elements, and `contiguous` ensures that they are
        // aligned and without gaps.
        unsafe { std::slice::from_raw_parts(self.first, self.count) }
    }
}

impl SharedPixels for ArrayPixels<u8> {
    fn pixels(&self) -> PixelSlice<'_> {
        PixelSlice::U8(self.slice())
    }
}

impl SharedPixels for ArrayPixels<u16> {
    fn pixels(&self) -> PixelSlice<'_> {
        PixelSlice::U16(self.slice())
    }
}

/// A frame of an array's pixels: of the array itself if it is uint8 or uint16, C-contiguous and in the machine's byte
/// order, otherwise of a copy. Integers of other types become uint16; negative, large and floating-point values are scaled
/// like those of a file.
pub fn frame(
    array: &Bound<'_, PyAny>,
    saturation_dn: Option<u16>,
    info: FrameInfo,
) -> PyResult<Frame> {
    let untyped = array
        .cast::<PyUntypedArray>()
        .map_err(|_| type_error("array", "a numpy.ndarray of whole numbers", array))?;
    if array.hasattr("mask")? {
        return Err(type_error("array", "an array without a mask", array));
    }
    let &[height, width] = untyped.shape() else {
        let dimensions = untyped.ndim();
        let problem = format!("expected 2 dimensions (rows, columns), found {dimensions}");
        return Err(value_error("array", problem));
    };
    let dtype = untyped.dtype();
    let pixels: Box<dyn SharedPixels> = match (dtype.kind(), dtype.itemsize()) {
        (b'u', 1) => Box::new(ArrayPixels::<u8>::new(&contiguous(array, "uint8")?)),
        (b'u', 2) => Box::new(ArrayPixels::<u16>::new(&contiguous(array, "uint16")?)),
        (b'u' | b'i', _) if are_pixels(array)? => {
            Box::new(ArrayPixels::<u16>::new(&contiguous(array, "uint16")?))
        }
        (b'u' | b'i', _) => {
            return frame_of_values(array, 16, [width, height], saturation_dn, info);
        }
        (b'f', _) => return frame_of_values(array, -32, [width, height], saturation_dn, info),
        _ => {
            let expected = "numbers of an integer or floating-point dtype";
            let problem = format!("array: expected {expected}, found dtype {dtype}");
            return Err(PyTypeError::new_err(problem));
        }
    };
    let assumed = || pixels.pixels().assumed_saturation_dn();
    let saturation_dn = saturation_dn.unwrap_or_else(|| array.py().detach(assumed));
    Frame::shared(width, height, pixels, saturation_dn, info)
        .map_err(|error| value_error("array", error))
}

/// Whether integers of any type can be used as pixels unchanged.
fn are_pixels(array: &Bound<'_, PyAny>) -> PyResult<bool> {
    let numpy = array.py().import("numpy")?;
    let below = numpy.call_method1("less", (array, 0))?;
    let above = numpy.call_method1("greater", (array, u16::MAX))?;
    let bad = numpy.call_method1("logical_or", (below, above))?;
    Ok(!bad.call_method0("any")?.is_truthy()?)
}

/// Any other values, as the program reads them from a file; `bits` is their BITPIX.
fn frame_of_values(
    array: &Bound<'_, PyAny>,
    bits: i64,
    size: [usize; 2],
    saturation_dn: Option<u16>,
    info: FrameInfo,
) -> PyResult<Frame> {
    let array: Bound<'_, PyArray2<f32>> = contiguous(array, "float32")?;
    let py = array.py();
    let values = array.readonly();
    let values = values
        .as_slice()
        .map_err(|error| value_error("array", error))?;
    let saturation = saturation_dn.map(f64::from);
    py.detach(|| fits::frame_of_values(values, bits, size, saturation, info))
        .map_err(|problem| value_error("array", problem))
}

/// The array itself if its rows are contiguous, aligned and in the machine's byte order, otherwise a copy that is.
fn contiguous<'py, T: Element>(
    array: &Bound<'py, PyAny>,
    dtype: &str,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let numpy = array.py().import("numpy")?;
    let array = numpy.call_method1("require", (array, dtype, ["C", "ALIGNED"]))?;
    Ok(array.cast_into()?)
}
