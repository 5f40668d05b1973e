//! Texts with placeholders, which tables fill.

/// A text with each `@name@` replaced by its value.
pub fn filled<const N: usize>(text: &str, gaps: [(&str, String); N]) -> String {
    gaps.iter().fold(text.to_owned(), |text, (name, own)| {
        text.replace(&format!("@{name}@"), own)
    })
}
