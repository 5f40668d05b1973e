//! A FITS file laid out in memory, one HDU after the other (FITS 4.0, sections 3 and 4): a header of cards, the data after it,
//! and the checksums of both.

use super::checksum;
use super::header::CARD;
use super::structure::BLOCK;

/// A file being written.
pub(super) struct Layout {
    bytes: Vec<u8>,
    /// Start of the header and of the data of the last HDU.
    header: usize,
    data: usize,
    /// The card of its CHECKSUM, followed by that of its DATASUM.
    checksum_card: usize,
    /// Whether a text of the header continues in another card.
    continues: bool,
}

/// Most characters of a text between its quotes on one card.
const TEXT: usize = CARD - 12;
/// Cards of the checksums.
pub(super) const CHECKSUM: [&str; 2] = ["CHECKSUM", "checksum of the HDU"];
pub(super) const DATASUM: [&str; 2] = ["DATASUM", "checksum of the data"];
/// Placeholder of a checksum that is not known yet.
pub(super) const NO_CHECKSUM: &str = "0000000000000000";

impl Layout {
    /// An empty file; memory is not reallocated unless it needs more bytes than expected.
    pub fn new(expected_bytes: usize) -> Self {
        Self {
            bytes: Vec::with_capacity(expected_bytes),
            header: 0,
            data: 0,
            checksum_card: 0,
            continues: false,
        }
    }

    /// Begins an HDU.
    pub fn begin(&mut self) {
        self.header = self.bytes.len();
        self.continues = false;
    }

    /// Adds a card. Characters not allowed in a header become '?', and a text that is too long is cut off at the end of the card.
    pub fn card(&mut self, text: &str) {
        let start = self.bytes.len();
        self.bytes.extend(text.chars().take(CARD).map(printable));
        self.bytes.resize(start + CARD, b' ');
    }

    /// Rewrites the nth card of this header.
    pub fn set_card(&mut self, n: usize, text: &str) {
        let start = self.header + n * CARD;
        let end = self.bytes.len();
        self.card(text);
        self.bytes.copy_within(end.., start);
        self.bytes.truncate(end);
    }

    /// Adds a card with a number or a logical value, in the form of FITS.
    pub fn value(&mut self, keyword: &str, value: &str, comment: &str) {
        self.card(&value_card(keyword, value, comment));
    }

    /// Adds a text; one that is longer than a card continues in CONTINUE cards (section 4.2.1.2).
    pub fn text(&mut self, keyword: &str, text: &str, comment: &str) {
        let mut rest = text.replace('\'', "''");
        let mut start = format!("{keyword:<8}= ");
        while rest.chars().count() > TEXT {
            let mut cut = TEXT - 1;
            // A doubled quote represents one.
            let quotes = |rest: &str, cut| rest.chars().take(cut).filter(|c| *c == '\'').count();
            if quotes(&rest, cut) % 2 == 1 && rest.chars().nth(cut) == Some('\'') {
                cut -= 1;
            }
            let part: String = rest.chars().take(cut).collect();
            rest = rest.chars().skip(cut).collect();
            self.card(&format!("{start}'{part}&'"));
            start = "CONTINUE  ".into();
            self.continues = true;
        }
        self.card(&last_text_card(&start, &rest, comment));
    }

    /// Ends the header; the data follow.
    pub fn end_header(&mut self) {
        if self.continues {
            // Readers older than FITS 4.0 expect it.
            self.card(&text_card(
                ["LONGSTRN", "texts may go on in CONTINUE cards"],
                "OGIP 1.0",
            ));
        }
        self.checksum_card = (self.bytes.len() - self.header) / CARD;
        self.card(&text_card(CHECKSUM, NO_CHECKSUM));
        self.card(&text_card(DATASUM, "0"));
        self.card("END");
        self.fill(b' ');
        self.data = self.bytes.len();
    }

    /// The bytes so far: data are added at their end.
    pub fn bytes(&mut self) -> &mut Vec<u8> {
        &mut self.bytes
    }

    /// Ends the HDU: its header must be final before this call.
    pub fn end(&mut self) {
        self.fill(0);
        self.seal(checksum::sum(&self.bytes[self.data..]));
    }

    /// Writes the checksums of an HDU whose data have this sum.
    pub fn seal(&mut self, data: u32) {
        let datasum = text_card(DATASUM, &data.to_string());
        self.set_card(self.checksum_card + 1, &datasum);
        let header = checksum::sum(&self.bytes[self.header..self.data]);
        let encoded = checksum::encoded(!checksum::added(header, data));
        self.set_card(self.checksum_card, &text_card(CHECKSUM, &encoded));
    }

    /// The whole file.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Fills the last block.
    fn fill(&mut self, with: u8) {
        let whole = self.bytes.len().next_multiple_of(BLOCK);
        self.bytes.resize(whole, with);
    }
}

/// A card with a number or a logical value.
pub(super) fn value_card(keyword: &str, value: &str, comment: &str) -> String {
    format!("{keyword:<8}= {value:>20} / {comment}")
}

/// A card with a text that fits on it; keyword and comment.
pub(super) fn text_card([keyword, comment]: [&str; 2], text: &str) -> String {
    last_text_card(&format!("{keyword:<8}= "), text, comment)
}

/// The card that ends a text.
fn last_text_card(start: &str, text: &str, comment: &str) -> String {
    let quoted = format!("'{text:<8}'");
    match comment {
        "" => format!("{start}{quoted}"),
        comment => format!("{start}{quoted:<20} / {comment}"),
    }
}

/// A character as allowed in FITS.
pub(super) fn printable(c: char) -> u8 {
    match c {
        ' '..='~' => c as u8,
        _ => b'?',
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fits::Header;

    #[test]
    fn texts_of_any_length_and_quotes_read_back() {
        let quotes = "'".repeat(200);
        let long = "it's a long text ".repeat(12);
        for text in ["", "short", "&", "it's", &quotes, &long] {
            let mut layout = Layout::new(0);
            layout.begin();
            layout.card("SIMPLE  =                    T");
            layout.text("NAME", text, "a text");
            layout.end_header();
            let (header, _) = Header::parse(&layout.bytes).unwrap();
            assert_eq!(header.get("NAME"), Some(&text.trim_end().into()), "{text}");
        }
    }

    #[test]
    fn the_sum_of_an_hdu_with_its_checksum_is_none() {
        for bytes in [0, 1, 4000] {
            let mut layout = Layout::new(0);
            layout.begin();
            layout.card("SIMPLE  =                    T");
            layout.end_header();
            layout
                .bytes()
                .extend((0..bytes).map(|n| (n * 7919 % 251) as u8));
            layout.end();
            assert_eq!(checksum::sum(&layout.bytes), u32::MAX, "{bytes}");
        }
    }
}
