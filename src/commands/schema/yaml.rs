//! YAML in block style.

use std::fmt::Write;

/// A node of a document.
#[derive(Debug, Clone)]
pub enum Yaml {
    True,
    Number(i64),
    Text(String),
    /// A text that would be taken for something else.
    Quoted(&'static str),
    List(Vec<Yaml>),
    /// In the order given.
    Map(Vec<(String, Yaml)>),
}

impl From<&str> for Yaml {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Yaml {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<u16> for Yaml {
    fn from(number: u16) -> Self {
        Self::Number(number.into())
    }
}

impl From<Vec<Yaml>> for Yaml {
    fn from(items: Vec<Yaml>) -> Self {
        Self::List(items)
    }
}

/// A map of these keys.
pub fn map<const N: usize>(entries: [(&str, Yaml); N]) -> Yaml {
    Yaml::Map(entries.map(|(key, value)| (key.into(), value)).into())
}

impl Yaml {
    /// With one more entry, if it is a map.
    pub fn with(mut self, key: &str, value: impl Into<Yaml>) -> Self {
        if let Self::Map(entries) = &mut self {
            entries.push((key.into(), value.into()));
        }
        self
    }

    /// The document.
    pub fn document(&self) -> String {
        let mut text = String::new();
        self.write(&mut text, 0);
        text
    }

    /// Writes the node after its key or dash; a block of a list or map begins at the depth.
    fn write(&self, out: &mut String, depth: usize) {
        match self {
            // Writing to a String cannot fail.
            Self::True => out.push_str("true\n"),
            Self::Number(number) => _ = writeln!(out, "{number}"),
            Self::Text(text) => _ = writeln!(out, "{}", scalar(text)),
            Self::Quoted(text) => _ = writeln!(out, "\"{text}\""),
            Self::List(items) if items.is_empty() => out.push_str("[]\n"),
            Self::Map(entries) if entries.is_empty() => out.push_str("{}\n"),
            Self::List(items) => {
                for (number, item) in items.iter().enumerate() {
                    indent(out, depth, number);
                    out.push_str("- ");
                    item.write(out, depth + 2);
                }
            }
            Self::Map(entries) => {
                for (number, (key, value)) in entries.iter().enumerate() {
                    indent(out, depth, number);
                    out.push_str(&scalar(key));
                    out.push(':');
                    match value {
                        Self::List(items) if !items.is_empty() => value.write_below(out, depth),
                        Self::Map(items) if !items.is_empty() => value.write_below(out, depth),
                        _ => {
                            out.push(' ');
                            value.write(out, depth);
                        }
                    }
                }
            }
        }
    }

    fn write_below(&self, out: &mut String, depth: usize) {
        out.push('\n');
        out.push_str(&" ".repeat(depth + 2));
        self.write(out, depth + 2);
    }
}

/// The first entry stands where its key or dash ends.
fn indent(out: &mut String, depth: usize, number: usize) {
    if number > 0 {
        out.push_str(&" ".repeat(depth));
    }
}

/// A text as it is where YAML takes it for one, else quoted.
fn scalar(text: &str) -> String {
    const WORDS: [&str; 9] = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    let first = text.strip_prefix('-').unwrap_or(text).chars().next();
    let begins = first.is_some_and(|first| first.is_ascii_alphabetic());
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    match (begins || is_number) && text.bytes().all(plain) && !WORDS.contains(&text) {
        true => text.into(),
        false => serde_json::Value::from(text).to_string(),
    }
}
