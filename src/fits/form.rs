//! TFORMn: content of a column of a binary table in each row (FITS 4.0, section 7.3.1).

/// The most values of one kind in a row.
const MOST_VALUES: usize = 65_536;

/// The form of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Form {
    pub repeat: usize,
    pub letter: char,
    /// For descriptors (P, Q), the type of the elements to which they point.
    pub pointed_to: Option<char>,
}

impl Form {
    /// Reads repeat count (one if it is omitted) and letter; `None` if the text is no form.
    pub fn parse(form: &str) -> Option<Self> {
        let letters = form.trim_start_matches(|c: char| c.is_ascii_digit());
        let repeat = match &form[..form.len() - letters.len()] {
            "" => 1,
            digits => digits
                .parse()
                .ok()
                .filter(|repeat| *repeat <= MOST_VALUES)?,
        };
        let mut letters = letters.chars();
        Some(Self {
            repeat,
            letter: letters.next()?,
            pointed_to: letters.next(),
        })
    }

    /// Bytes of the column in a row; `None` for kinds that do not occur in files of frames.
    pub fn bytes(self) -> Option<usize> {
        let one = match self.letter {
            'B' | 'A' | 'L' => 1,
            'I' => 2,
            'J' | 'E' => 4,
            'K' | 'D' | 'P' => 8,
            'Q' => 16,
            _ => return None,
        };
        Some(self.repeat * one)
    }
}
