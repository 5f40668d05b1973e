//! Units that FITS knows (FITS 4.0, section 4.3), and the notation of a unit that it does not know.
//!
//! Readers warn of a unit that is not FITS's own, and drop it. So one that FITS knows is written where readers expect it, in
//! TUNITn or in brackets; any other, such as mil and degC, only in the text that explains the value.

/// Units of tables 3 to 5 of the standard that this program may write, some with a metric prefix.
const KNOWN: [&str; 24] = [
    "s", "ms", "us", "ns", "min", "h", "d", "a", "deg", "arcmin", "arcsec", "mas", "rad", "m",
    "mm", "um", "nm", "km", "K", "Hz", "V", "adu", "pixel", "bit",
];

/// The plate's unit of length, with its size.
const MIL: (&str, &str) = ("mil", "25.4 um");

/// Whether FITS knows a unit: every part of a quotient, with or without an exponent of one digit.
pub(super) fn is_known(unit: &str) -> bool {
    let known = |part: &str| {
        let base = part.strip_suffix(|c: char| c.is_ascii_digit());
        KNOWN.contains(&base.unwrap_or(part))
    };
    unit.split('/').all(known)
}

/// The comment of a keyword's value: the unit in brackets before the meaning, or, if FITS does not know it, in
/// parentheses after it.
pub(super) fn keyword_comment(meaning: &str, unit: &str) -> String {
    match unit {
        "" => meaning.into(),
        unit if is_known(unit) => format!("[{unit}] {meaning}"),
        unit => format!("{meaning} ({unit})"),
    }
}

/// The comment of a table's column: the meaning, and the unit if FITS does not know it, the mil with its size.
pub(super) fn column_comment(meaning: &str, unit: &str) -> String {
    let (mil, size) = MIL;
    match unit {
        unit if unit.is_empty() || is_known(unit) => meaning.into(),
        unit if unit == mil => format!("{meaning} ({unit}, {size})"),
        unit if unit.contains(mil) => format!("{meaning} ({unit}, {mil} = {size})"),
        unit => format!("{meaning} ({unit})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_fits_are_distinguished_from_those_it_does_not_know() {
        for unit in ["s", "deg", "arcsec", "pixel", "m/s2", "arcsec/pixel", "mm2"] {
            assert!(is_known(unit), "{unit}");
        }
        for unit in ["mil", "mil2", "mil/s", "mil/pixel", "degC", "DN", "px", ""] {
            assert!(!is_known(unit), "{unit}");
        }
    }

    #[test]
    fn a_comment_gives_the_unit_that_fits_does_not_know() {
        let comments = |unit| [keyword_comment("size", unit), column_comment("size", unit)];
        assert_eq!(comments(""), ["size", "size"]);
        assert_eq!(comments("deg"), ["[deg] size", "size"]);
        assert_eq!(comments("degC"), ["size (degC)", "size (degC)"]);
        assert_eq!(comments("mil"), ["size (mil)", "size (mil, 25.4 um)"]);
        let speed = ["size (mil/s)", "size (mil/s, mil = 25.4 um)"];
        assert_eq!(comments("mil/s"), speed);
    }
}
