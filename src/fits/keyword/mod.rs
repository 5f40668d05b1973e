//! The table of keywords: everything that is written to or read from a header, with its unit and meaning.
//!
//! What is not in the table cannot be written, and the page `docs/keywords.md` is made from it. To add a keyword, add
//! a row to `table.rs`. Structural keywords that the library writes itself (SIMPLE, NAXISn, ZTILEn, TFORMn ...) are not rows.

mod page;
mod table;

use super::unit;
pub use page::markdown;
pub use table::{FOREIGN, GROUPS};

/// What a keyword's value is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Text,
    /// A text: UTC, ISO 8601 as FITS writes it, without Z.
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
    /// Unit, as FITS writes it where it knows it; empty for a value without.
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

const fn row(
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

/// Every row of the table but [`FOREIGN`]'s, which are never written.
pub fn all() -> impl Iterator<Item = &'static Keyword> {
    GROUPS.iter().flat_map(|group| group.keywords)
}

/// The row of a keyword.
pub fn find(name: &str) -> Option<&'static Keyword> {
    all().find(|keyword| keyword.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_keyword_is_a_legal_and_unique_name_whose_comment_fits_beside_a_number() {
        let all = || all().chain(FOREIGN.iter().flat_map(|group| group.keywords));
        let names: BTreeSet<&str> = all().map(|keyword| keyword.name).collect();
        assert_eq!(names.len(), all().count());
        for keyword in all() {
            let legal = |b: u8| b.is_ascii_uppercase() || b.is_ascii_digit() || b"-_".contains(&b);
            assert!(keyword.name.bytes().all(legal), "{keyword:?}");
            assert!((1..=8).contains(&keyword.name.len()), "{keyword:?}");
            assert!(!keyword.meaning.is_empty(), "{keyword:?}");
            assert!(keyword.comment().len() <= 47, "{keyword:?}");
        }
    }

    /// With SOLASPECT_WRITE_DOCS set, the page is written instead.
    #[test]
    fn the_page_of_keywords_is_the_table() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/keywords.md");
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(page, markdown()).unwrap();
        }
        let committed = std::fs::read_to_string(page).unwrap();
        assert!(
            committed == markdown(),
            "docs/keywords.md is not the table: run this test with SOLASPECT_WRITE_DOCS=1"
        );
    }
}
