//! The only unsafe code of this room: cfitsio writing a file in memory.
//!
//! The file lives in memory so that no file name ever reaches cfitsio, which would read `[`, `(` and `+` in it as
//! instructions, and so that bringing the bytes to the disk, whole or not at all, is in our hands. Every call's status is
//! checked. The message is the status's own text: the library's stack of messages is shared by all threads and may
//! hold another file's.

use super::Problem;
use super::structure::BLOCK;
use crate::frame::Pixels;
use fitsio_sys as sys;
use std::alloc::{Layout, alloc_zeroed, dealloc};
use std::ffi::{CStr, CString, c_char, c_int, c_long, c_void};
use std::ptr;
use std::sync::{Mutex, PoisonError};

/// cfitsio initialises itself at the first opening, and not safely if two threads are first at once.
static OPENING: Mutex<()> = Mutex::new(());

/// Stands before each piece of memory that cfitsio has. A multiple of any alignment that C asks for.
#[repr(C, align(16))]
struct Size {
    /// What cfitsio may use.
    usable: usize,
    /// What there is. All beyond the usable bytes is zero.
    capacity: usize,
}

/// The whole of a piece of memory with so many bytes for cfitsio.
fn layout(capacity: usize) -> Option<Layout> {
    let bytes = capacity.checked_add(size_of::<Size>())?;
    Layout::from_size_align(bytes, align_of::<Size>()).ok()
}

/// Memory of zeros of which none is usable yet; null where there is none.
fn allocate(capacity: usize) -> *mut c_void {
    let Some(layout) = layout(capacity) else {
        return ptr::null_mut();
    };
    // SAFETY: the layout is not empty, and has room for the size first.
    unsafe {
        let whole = alloc_zeroed(layout).cast::<Size>();
        if whole.is_null() {
            return ptr::null_mut();
        }
        whole.write(Size {
            usable: 0,
            capacity,
        });
        whole.add(1).cast()
    }
}

/// A `realloc` that fills what it adds with zeros. When cfitsio extends a file within the memory that it has, it
/// takes that memory to be zero, which C's `realloc` does not promise. It asks for a block more or less very often, so
/// memory moves only when it must, and is then at least doubled.
unsafe extern "C" fn grow(memory: *mut c_void, bytes: usize) -> *mut c_void {
    let memory = match memory.is_null() {
        true => allocate(bytes),
        false => memory,
    };
    if memory.is_null() {
        return memory;
    }
    // SAFETY: `memory` is a result of `allocate`, with its size before it. What is filled or copied lies within the capacity of
    // each piece.
    unsafe {
        let size = &mut *memory.cast::<Size>().sub(1);
        if bytes <= size.capacity {
            if bytes < size.usable {
                memory
                    .cast::<u8>()
                    .add(bytes)
                    .write_bytes(0, size.usable - bytes);
            }
            size.usable = bytes;
            return memory;
        }
        let larger = allocate(bytes.max(2 * size.capacity));
        if larger.is_null() {
            return larger;
        }
        ptr::copy_nonoverlapping(memory.cast::<u8>(), larger.cast(), size.usable);
        release(memory);
        grow(larger, bytes)
    }
}

/// Gives back what [`allocate`] or [`grow`] returned.
unsafe fn release(memory: *mut c_void) {
    if memory.is_null() {
        return;
    }
    // SAFETY: the caller's memory is a result of `allocate`, whose size stands before it.
    unsafe {
        let whole = memory.cast::<Size>().sub(1);
        if let Some(layout) = layout((*whole).capacity) {
            dealloc(whole.cast(), layout);
        }
    }
}

/// How the pixels of an image extension are compressed. All are lossless.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// Rice, row by row: about half the size, and fast.
    #[default]
    Rice,
    /// Deflate, row by row.
    Gzip,
    None,
}

impl Compression {
    /// The names of the kinds, as files and commands give them.
    pub const NAMES: [&str; 3] = ["rice", "none", "gzip"];
    /// Every kind.
    pub const KINDS: [Self; 3] = [Self::Rice, Self::None, Self::Gzip];

    /// The name of the kind.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rice => "rice",
            Self::None => "none",
            Self::Gzip => "gzip",
        }
    }
}

/// A buffer whose place and size cfitsio keeps pointers to.
struct Memory {
    start: *mut c_void,
    bytes: usize,
}

/// An open FITS file in memory; closed when dropped.
pub(super) struct MemoryFile {
    handle: *mut sys::fitsfile,
    memory: Box<Memory>,
}

impl Drop for MemoryFile {
    fn drop(&mut self) {
        let mut status = 0;
        if !self.handle.is_null() {
            // SAFETY: the handle is open, and not used again.
            unsafe { sys::ffclos(self.handle, &mut status) };
        }
        // SAFETY: the memory came from `grow`, and the file that used it is closed.
        unsafe { release(self.memory.start) };
    }
}

/// An error unless the call went well.
fn check(status: c_int, action: &'static str) -> Result<(), Problem> {
    if status == 0 {
        return Ok(());
    }
    let mut text = [0 as c_char; 81];
    // SAFETY: `ffgerr` writes at most 30 characters and a zero; `text` is longer, and its last stays zero.
    let message = unsafe {
        sys::ffgerr(status, text.as_mut_ptr());
        sys::ffcmsg();
        CStr::from_ptr(text.as_ptr())
    };
    Err(Problem::Library {
        action,
        status,
        message: message.to_string_lossy().into_owned(),
    })
}

/// A C string; what cannot be in one, or in a FITS header, becomes '?'.
fn c_string(text: &str) -> CString {
    let shown = |c| if (' '..='~').contains(&c) { c } else { '?' };
    CString::new(text.chars().map(shown).collect::<String>()).unwrap_or_default()
}

/// Runs a cfitsio function with the file's handle and a status, and checks it.
macro_rules! call {
    ($file:expr, $action:expr, $function:ident $(, $argument:expr)*) => {{
        let mut status = 0;
        // SAFETY: the handle is open, and each pointer lives through the call and has the length it is given with.
        unsafe { sys::$function($file.handle $(, $argument)*, &mut status) };
        check(status, $action)
    }};
}

impl MemoryFile {
    /// A new, empty file, which is quickest if it will be of at most the expected size.
    pub fn create(expected_bytes: usize) -> Result<Self, Problem> {
        let mut file = Self {
            handle: ptr::null_mut(),
            memory: Box::new(Memory {
                start: allocate(expected_bytes),
                bytes: 0,
            }),
        };
        let memory = &mut *file.memory;
        let mut status = 0;
        let _one_at_a_time = OPENING.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the boxed memory outlives the handle, and grows by `grow` alone.
        unsafe {
            sys::ffimem(
                &mut file.handle,
                &mut memory.start,
                &mut memory.bytes,
                BLOCK,
                Some(grow),
                &mut status,
            )
        };
        check(status, "create a file in memory")?;
        Ok(file)
    }

    /// Writes a primary header without data.
    pub fn create_primary(&self) -> Result<(), Problem> {
        call!(
            self,
            "write a primary header",
            ffcrim,
            8,
            0,
            ptr::null_mut()
        )
    }

    /// Begins an image, whose pixels are to follow.
    pub fn create_image(
        &self,
        [width, height]: [usize; 2],
        pixels: &Pixels,
        compression: Compression,
    ) -> Result<(), Problem> {
        let algorithm = match compression {
            Compression::Rice => sys::RICE_1,
            Compression::Gzip => sys::GZIP_1,
            Compression::None => 0,
        };
        call!(
            self,
            "set the compression",
            fits_set_compression_type,
            algorithm as c_int
        )?;
        let kind = match pixels {
            Pixels::U8(_) => sys::BYTE_IMG,
            Pixels::U16(_) => sys::USHORT_IMG,
        };
        let mut axes = [width as c_long, height as c_long];
        call!(
            self,
            "create an image",
            ffcrim,
            kind as c_int,
            2,
            axes.as_mut_ptr()
        )
    }

    /// Makes room for so many further keywords in the header, so that none of them moves the data behind it.
    pub fn reserve_keywords(&self, count: usize) -> Result<(), Problem> {
        let count = c_int::try_from(count).unwrap_or(0);
        call!(self, "make room for keywords", ffhdef, count)
    }

    /// Writes the pixels of the image begun last.
    pub fn put_pixels(&self, pixels: &Pixels) -> Result<(), Problem> {
        let count = pixels.len() as i64;
        let action = "write the pixels";
        // cfitsio's signatures lack `const`: it only reads the pixels.
        match pixels {
            Pixels::U8(p) => call!(self, action, ffpprb, 1, 1, count, p.as_ptr().cast_mut()),
            Pixels::U16(p) => call!(self, action, ffpprui, 1, 1, count, p.as_ptr().cast_mut()),
        }
    }

    /// Adds a card of 80 characters.
    pub fn put_card(&self, card: &str) -> Result<(), Problem> {
        let card = c_string(card);
        call!(self, "write a keyword", ffprec, card.as_ptr())
    }

    /// Adds a text that may need more than one card.
    pub fn put_text(&self, keyword: &str, text: &str, comment: &str) -> Result<(), Problem> {
        let [keyword, text, comment] = [keyword, text, comment].map(c_string);
        call!(
            self,
            "write a text keyword",
            ffpkls,
            keyword.as_ptr(),
            text.as_ptr(),
            comment.as_ptr()
        )
    }

    /// Writes an empty binary table; each column has a name, a TFORM and a unit.
    pub fn create_table(&self, name: &str, columns: &[[String; 3]]) -> Result<(), Problem> {
        let name = c_string(name);
        let strings = |n: usize| -> Vec<CString> {
            columns.iter().map(|column| c_string(&column[n])).collect()
        };
        let [names, forms, units] = [strings(0), strings(1), strings(2)];
        let pointers = |strings: &[CString]| -> Vec<*mut c_char> {
            strings
                .iter()
                .map(|string| string.as_ptr().cast_mut())
                .collect()
        };
        let [mut names, mut forms, mut units] = [&names, &forms, &units].map(|s| pointers(s));
        call!(
            self,
            "create a table",
            ffcrtb,
            sys::BINARY_TBL as c_int,
            0,
            columns.len() as c_int,
            names.as_mut_ptr(),
            forms.as_mut_ptr(),
            units.as_mut_ptr(),
            name.as_ptr()
        )
    }

    /// Writes a column of the current table, counted from 1.
    pub fn put_floats(&self, column: usize, values: &[f64]) -> Result<(), Problem> {
        let (count, start) = (values.len() as i64, values.as_ptr().cast_mut());
        call!(
            self,
            "write a column",
            ffpcld,
            column as c_int,
            1,
            1,
            count,
            start
        )
    }

    /// Writes a column of the current table, counted from 1.
    pub fn put_integers(&self, column: usize, values: &[i64]) -> Result<(), Problem> {
        let (count, start) = (values.len() as i64, values.as_ptr().cast_mut());
        call!(
            self,
            "write a column",
            ffpcljj,
            column as c_int,
            1,
            1,
            count,
            start
        )
    }

    /// Writes a column of the current table, counted from 1.
    pub fn put_texts(&self, column: usize, values: &[String]) -> Result<(), Problem> {
        let texts: Vec<CString> = values.iter().map(|text| c_string(text)).collect();
        let mut starts: Vec<*mut c_char> =
            texts.iter().map(|text| text.as_ptr().cast_mut()).collect();
        let (count, start) = (starts.len() as i64, starts.as_mut_ptr());
        call!(
            self,
            "write a column",
            ffpcls,
            column as c_int,
            1,
            1,
            count,
            start
        )
    }

    /// Writes CHECKSUM and DATASUM of the current HDU: the last thing to do with it.
    pub fn put_checksums(&self) -> Result<(), Problem> {
        call!(self, "write the checksums", ffpcks)
    }

    /// Writes DATASUM of the current HDU alone: beside a CHECKSUM cfitsio notes the day. Before it is finished, cfitsio does not
    /// count the rows of a table.
    pub fn put_datasum(&self) -> Result<(), Problem> {
        let (mut data, mut hdu) = (0, 0);
        call!(self, "finish the data", ffflus)?;
        call!(self, "add up the data", ffgcks, &mut data, &mut hdu)?;
        self.put_text("DATASUM", &data.to_string(), "checksum of the data")
    }

    /// Closes the file after its last HDU and returns its bytes.
    pub fn into_bytes(mut self) -> Result<Vec<u8>, Problem> {
        let (mut header, mut data, mut end) = (0, 0, 0);
        call!(self, "finish the file", ffflus)?;
        call!(
            self,
            "measure the file",
            ffghadll,
            &mut header,
            &mut data,
            &mut end
        )?;
        let closed = call!(self, "close the file", ffclos);
        self.handle = ptr::null_mut();
        closed?;
        let bytes = usize::try_from(end).unwrap_or(0).min(self.memory.bytes);
        if self.memory.start.is_null() {
            return Ok(Vec::new());
        }
        // SAFETY: cfitsio has written the file's `end` bytes to the memory, which is that large at least.
        let written = unsafe { std::slice::from_raw_parts(self.memory.start.cast::<u8>(), bytes) };
        Ok(written.to_vec())
    }
}
