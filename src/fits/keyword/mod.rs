//! The table of keywords: every keyword that is written to or read from a header, with its unit and meaning.
//!
//! Each is a constant, so that no other can be written. To add a keyword, add a row to `table.rs`; those of a solution are defined with its
//! [numbers](crate::record). Structural keywords that the library writes itself (SIMPLE, NAXISn, ZTILEn, TFORMn ...) are not rows.

mod table;

use super::unit;
pub use table::*;

/// Type of a keyword's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Text,
    /// A text: UTC, ISO 8601 in the form of FITS, without Z.
    Time,
    Integer,
    Float,
    Logical,
}

/// Whether a keyword is written, read or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    Written,
    Read,
    Both,
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Keyword {
    pub name: &'static str,
    pub kind: Kind,
    /// Unit in the form of FITS, if FITS knows it; empty for a value without.
    pub unit: &'static str,
    pub meaning: &'static str,
    pub used: Use,
}

impl Keyword {
    /// The comment of a card: the meaning with the unit.
    pub fn comment(&self) -> String {
        unit::keyword_comment(self.meaning, self.unit)
    }
}

/// Keywords that belong together, under a title.
pub struct Group {
    pub title: &'static str,
    pub keywords: &'static [Keyword],
}

/// A row of the table.
pub const fn row(
    name: &'static str,
    kind: Kind,
    unit: &'static str,
    used: Use,
    meaning: &'static str,
) -> Keyword {
    Keyword {
        name,
        kind,
        unit,
        meaning,
        used,
    }
}

/// Groups of keywords, each a constant; if its name is no identifier, the name follows an equals sign.
macro_rules! keywords {
    ($(#[$docs:meta])* $groups:ident: $($title:literal: $($name:ident $(= $text:literal)?, $kind:ident, $unit:literal, $used:ident, $meaning:literal;)*)*) => {
        $($(pub const $name: Keyword = row(keywords!(@name $name $($text)?), $kind, $unit, $used, $meaning);)*)*

        $(#[$docs])*
        pub const $groups: &[Group] = &[$(Group { title: $title, keywords: &[$($name),*] }),*];
    };
    (@name $name:ident) => { stringify!($name) };
    (@name $name:ident $text:literal) => { $text };
}

use keywords;
