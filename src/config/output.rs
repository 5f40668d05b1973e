//! The outputs for other programs, by their tables `[[output]]`.

use crate::link::port::BAUD;
use crate::output::{Destination, Format};

defaults! {
    /// An output.
    Output {
        /// `None` if there is no such output.
        to: Option<Destination> = None,
        format: Format = Format::Jsonl,
        baud: u32 = BAUD,
    }
}

/// The outputs of a configuration, in the order of the file. There is always at least one, without a destination unless the file sets one.
#[derive(Debug, Clone, PartialEq)]
pub struct Outputs(Vec<Output>);

impl Default for Outputs {
    fn default() -> Self {
        Self(vec![Output::default()])
    }
}

impl FromIterator<Output> for Outputs {
    fn from_iter<T: IntoIterator<Item = Output>>(outputs: T) -> Self {
        let outputs: Vec<Output> = outputs.into_iter().collect();
        match outputs.is_empty() {
            true => Self::default(),
            false => Self(outputs),
        }
    }
}

impl Outputs {
    /// Name of the table of each output.
    pub const TABLE: &'static str = "output";

    /// All outputs, with their names in error messages: `output`, `output-2` and so on.
    pub fn iter(&self) -> impl Iterator<Item = (String, &Output)> {
        self.0.iter().zip(0..).map(|(output, n)| (name(n), output))
    }

    /// The outputs that have a destination.
    pub fn flying(&self) -> impl Iterator<Item = (String, &Output)> {
        self.iter().filter(|(_, output)| output.to.is_some())
    }

    pub fn named(&self, name: &str) -> Option<&Output> {
        self.0.get(place(name)?)
    }

    pub fn named_mut(&mut self, name: &str) -> Option<&mut Output> {
        self.0.get_mut(place(name)?)
    }

    /// The name of the output of the file's `n`-th table, from 0; the output is added if it does not exist.
    pub(super) fn of_table(&mut self, n: usize) -> String {
        self.0.resize(self.0.len().max(n + 1), Output::default());
        name(n)
    }
}

fn name(n: usize) -> String {
    match n {
        0 => Outputs::TABLE.into(),
        n => format!("{}-{}", Outputs::TABLE, n + 1),
    }
}

fn place(name: &str) -> Option<usize> {
    match name.strip_prefix(Outputs::TABLE)? {
        "" => Some(0),
        rest => rest
            .strip_prefix('-')?
            .parse::<usize>()
            .ok()?
            .checked_sub(1),
    }
}
