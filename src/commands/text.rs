//! Texts with gaps, which tables fill.

/// A text in which each `@name@` is what belongs there.
pub fn filled<const N: usize>(text: &str, gaps: [(&str, String); N]) -> String {
    gaps.iter().fold(text.to_owned(), |text, (name, own)| {
        text.replace(&format!("@{name}@"), own)
    })
}
