//! The cards of one header: keyword and value, in the form of FITS 4.0 (section 4).

use super::Problem;
use super::keyword::Keyword;
use std::fmt;

/// Bytes of a card.
pub(super) const CARD: usize = 80;

/// The value of a keyword.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    Text(String),
    Integer(i64),
    Float(f64),
    Logical(bool),
}

impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => write!(out, "'{text}'"),
            Self::Integer(number) => write!(out, "{number}"),
            Self::Float(number) => write!(out, "{number:?}"),
            Self::Logical(true) => write!(out, "T"),
            Self::Logical(false) => write!(out, "F"),
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Self::Integer(number)
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Float(number)
    }
}

impl From<bool> for Value {
    fn from(truth: bool) -> Self {
        Self::Logical(truth)
    }
}

/// Text after the `= ` of a card.
#[derive(Debug, Clone, PartialEq)]
enum Content {
    Value(Value),
    /// Neither text, number nor logical; kept for the error message.
    Unreadable(String),
}

/// The keywords of one header, in their order. Cards without a value are omitted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Header {
    cards: Vec<(String, Content)>,
}

/// A keyword of the table in [`keyword`](super::keyword) with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    pub keyword: &'static Keyword,
    pub value: Value,
}

impl Card {
    pub fn new(keyword: &'static Keyword, value: impl Into<Value>) -> Self {
        Self {
            keyword,
            value: value.into(),
        }
    }
}

impl Header {
    /// Reads cards up to END. `None` if the bytes end before it.
    pub(super) fn parse(bytes: &[u8]) -> Option<(Self, usize)> {
        let mut header = Self::default();
        for (n, card) in bytes.chunks_exact(CARD).enumerate() {
            if card.starts_with(b"END     ") {
                return Some((header, (n + 1) * CARD));
            }
            header.push(&printable(card));
        }
        None
    }

    fn push(&mut self, card: &str) {
        let (keyword, rest) = card.split_at(8);
        if keyword == "CONTINUE" {
            self.extend_text(rest.trim_ascii());
        } else if let Some(value) = rest.strip_prefix("= ")
            && let Some(content) = parse_value(value.trim_ascii())
        {
            self.cards.push((keyword.trim_end().into(), content));
        }
    }

    /// A long text continues over CONTINUE cards as long as it ends in '&'.
    fn extend_text(&mut self, more: &str) {
        if let Some((_, Content::Value(Value::Text(text)))) = self.cards.last_mut()
            && text.ends_with('&')
            && let Some(Content::Value(Value::Text(more))) = parse_value(more)
        {
            text.pop();
            text.push_str(&more);
        }
    }

    fn content(&self, keyword: &str) -> Option<&Content> {
        let card = self.cards.iter().find(|(name, _)| name == keyword)?;
        Some(&card.1)
    }

    /// Whether a keyword has a value, readable or not.
    pub(super) fn contains(&self, keyword: &str) -> bool {
        self.content(keyword).is_some()
    }

    /// The value of a keyword, unconverted.
    pub fn get(&self, keyword: &str) -> Option<&Value> {
        match self.content(keyword)? {
            Content::Value(value) => Some(value),
            Content::Unreadable(_) => None,
        }
    }

    /// Text that is neither in quotes, number nor logical.
    pub(super) fn unquoted(&self, keyword: &str) -> Option<&str> {
        match self.content(keyword)? {
            Content::Value(_) => None,
            Content::Unreadable(text) => Some(text),
        }
    }

    /// Every keyword that has a readable value.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.cards
            .iter()
            .filter_map(|(name, content)| match content {
                Content::Value(value) => Some((name.as_str(), value)),
                Content::Unreadable(_) => None,
            })
    }

    /// A finite number, integer or not.
    ///
    /// # Errors
    /// An invalid value.
    pub fn number(&self, keyword: &str) -> Result<Option<f64>, Problem> {
        self.typed(keyword, "a finite number", |value| match value {
            Value::Integer(number) => Some(*number as f64),
            Value::Float(number) if number.is_finite() => Some(*number),
            _ => None,
        })
    }

    /// An integer; one written with a decimal point is accepted.
    pub(super) fn integer(&self, keyword: &str) -> Result<Option<i64>, Problem> {
        self.typed(keyword, "a whole number", |value| match value {
            Value::Integer(number) => Some(*number),
            Value::Float(number) if number.fract() == 0.0 && number.abs() < 9e15 => {
                Some(*number as i64)
            }
            _ => None,
        })
    }

    /// A text in quotes.
    ///
    /// # Errors
    /// An invalid value.
    pub fn text(&self, keyword: &str) -> Result<Option<String>, Problem> {
        self.typed(keyword, "a text in quotes", |value| match value {
            Value::Text(text) => Some(text.clone()),
            _ => None,
        })
    }

    fn typed<T>(
        &self,
        keyword: &str,
        expected: &str,
        read: impl Fn(&Value) -> Option<T>,
    ) -> Result<Option<T>, Problem> {
        match self.content(keyword) {
            None => Ok(None),
            Some(Content::Unreadable(text)) => Err(Problem::field(keyword, expected, text)),
            Some(Content::Value(value)) => match read(value) {
                Some(typed) => Ok(Some(typed)),
                None => Err(Problem::field(keyword, expected, value)),
            },
        }
    }

    /// A required integer within a range.
    pub(super) fn size(
        &self,
        keyword: &str,
        range: std::ops::RangeInclusive<i64>,
    ) -> Result<u64, Problem> {
        let expected = || format!("a whole number from {} to {}", range.start(), range.end());
        match self.integer(keyword)? {
            Some(number) if range.contains(&number) => Ok(number.unsigned_abs()),
            Some(number) => Err(Problem::field(keyword, expected(), number)),
            None => Err(Problem::field(keyword, expected(), "nothing")),
        }
    }

    /// Merges image keywords with primary ones; the image's take precedence.
    pub(super) fn over(&self, primary: &Self) -> Self {
        let cards = self.cards.iter().chain(&primary.cards);
        Self {
            cards: cards.cloned().collect(),
        }
    }
}

/// The card as text; characters not allowed in a header become '?', so that messages stay on one line.
pub(super) fn printable(card: &[u8]) -> String {
    let shown = |byte: &u8| match byte {
        b' '..=b'~' => *byte,
        _ => b'?',
    };
    String::from_utf8(card.iter().map(shown).collect()).unwrap_or_default()
}

/// The content of a value field; `None` if the value is undefined.
fn parse_value(field: &str) -> Option<Content> {
    if let Some(quoted) = field.strip_prefix('\'') {
        return Some(match closed_text(quoted) {
            Some(text) => Content::Value(Value::Text(text)),
            None => Content::Unreadable(field.into()),
        });
    }
    let word = field.split('/').next().unwrap_or_default().trim_ascii();
    let value = match word {
        "" => return None,
        "T" => Value::Logical(true),
        "F" => Value::Logical(false),
        _ => match word.parse() {
            Ok(integer) => Value::Integer(integer),
            Err(_) => match number(word) {
                Some(float) => Value::Float(float),
                None => return Some(Content::Unreadable(word.into())),
            },
        },
    };
    Some(Content::Value(value))
}

/// The text up to its closing quote; a doubled quote represents one, trailing blanks do not count.
fn closed_text(quoted: &str) -> Option<String> {
    let (part, rest) = quoted.split_once('\'')?;
    match rest.strip_prefix('\'') {
        Some(rest) => Some(format!("{part}'{}", closed_text(rest)?)),
        None => Some(part.trim_end().into()),
    }
}

/// A floating-point number, whose exponent may be marked with D.
fn number(word: &str) -> Option<f64> {
    let digits = word
        .bytes()
        .all(|byte| b"0123456789+-.eEdD".contains(&byte));
    if !digits {
        return None;
    }
    word.replace(['d', 'D'], "E").parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(cards: &[&str]) -> Header {
        let text: String = cards.iter().map(|card| format!("{card:<80}")).collect();
        Header::parse(format!("{text}{:<80}", "END").as_bytes())
            .unwrap()
            .0
    }

    #[test]
    fn each_kind_of_value_is_read_as_the_standard_writes_it() {
        let header = header(&[
            "A       = 'it''s   '           / comment",
            "B       =                  -12 / comment",
            "C       =              1.5D-03",
            "D       =                    T",
            "E       =                      / undefined",
            "F       = 'long &'",
            "CONTINUE  'text'",
        ]);
        assert_eq!(header.get("A"), Some(&"it's".into()));
        assert_eq!(header.get("B"), Some(&(-12).into()));
        assert_eq!(header.get("C"), Some(&0.0015.into()));
        assert_eq!(header.get("D"), Some(&true.into()));
        assert_eq!(header.get("E"), None);
        assert_eq!(header.get("F"), Some(&"long text".into()));
    }

    #[test]
    fn what_is_not_a_number_is_named_in_the_error() {
        for (card, found) in [
            ("EXPTIME = NaN", "NaN"),
            ("EXPTIME = 'soon'", "'soon'"),
            ("EXPTIME =  1.0E400", "inf"),
            ("EXPTIME = 'open", "'open"),
        ] {
            let message = header(&[card]).number("EXPTIME").unwrap_err().to_string();
            let expected = format!("EXPTIME: expected a finite number, found {found}");
            assert_eq!(message, expected);
        }
    }

    #[test]
    fn a_header_without_end_is_none() {
        assert_eq!(Header::parse(&[b' '; 2880]), None);
    }
}
