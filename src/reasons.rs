//! Reasons for stopping the processing of a frame, each defined once with a code for programs and a sentence for people.
//!
//! A code never changes; its sentence may be reworded. A reason is given with the stage that stopped, the measured value
//! and the limit that it fails ([`Stopped`]).

use crate::units::{Reason, Rejected};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;

/// A stage of a solver.
pub trait Stage: Copy {
    fn name(self) -> &'static str;
}

/// A stage given by its name, for any solver.
impl Stage for &'static str {
    fn name(self) -> &'static str {
        self
    }
}

/// Why processing of a frame stopped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stopped<S> {
    pub stage: S,
    pub rejected: Rejected,
}

impl<S: Stage> fmt::Display for Stopped<S> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.stage.name(), self.rejected.reason)
    }
}

impl<S: Stage> Stopped<S> {
    pub fn new(stage: S, reason: Reason, measured: f64, limit: f64) -> Self {
        let rejected = Rejected::new(reason, measured, limit);
        Self { stage, rejected }
    }

    /// The same, with the name of the stage.
    pub fn named(&self) -> Stopped<&'static str> {
        let (stage, rejected) = (self.stage.name(), self.rejected);
        Stopped { stage, rejected }
    }

    /// The text with the measured value and its limit.
    pub fn in_full(&self) -> String {
        let Rejected {
            measured, limit, ..
        } = self.rejected;
        format!("{self}: {measured:.3}, limit {limit:.3}")
    }
}

/// A [`Rejected`] with its stage.
pub fn at<S: Stage>(stage: S) -> impl Fn(Rejected) -> Stopped<S> {
    move |rejected| Stopped { stage, rejected }
}

macro_rules! reasons {
    ($(#[$docs:meta])* $solver:ident: $($name:ident $code:literal $sentence:literal)*) => {
        $(#[$docs])*
        pub mod $solver {
            use super::Reason;

            $(pub const $name: Reason = Reason { code: $code, sentence: $sentence };)*

            /// All reasons of this solver.
            pub const ALL: &[Reason] = &[$($name),*];
        }
    };
}

reasons! {
    /// Reasons for frames of the Sun on the plate.
    sun:
    LOW_CONTRAST "low_contrast" "nothing outshines the background by enough"
    FEW_BRIGHT_PIXELS "few_bright_pixels" "too few pixels are brighter than the background"
    NO_BRIGHT_PATCH "no_bright_patch" "nothing is as bright and as wide as a disc"
    MANY_BRIGHT_PLACES "many_bright_places" "the frame is bright in too many places"
    FEW_CHORDS "few_chords" "too few chords cross a limb"
    NO_CIRCLE "no_circle" "too few crossings lie on a circle of the Sun's size"
    CIRCLE_UNDETERMINED "circle_undetermined" "the crossings determine no circle"
    NO_LIMB "no_limb" "the edges near the circle are no limb"
    LITTLE_LIMB "little_limb" "too little of the limb is seen"
    DISC_UNDETERMINED "disc_undetermined" "the limb does not determine where the disc is"
    DARK_INSIDE "dark_inside" "the inside of the disc is not bright"
    BRIGHT_OUTSIDE "bright_outside" "the surroundings of the disc are not dark"
    FEW_LIMB_POINTS "few_limb_points" "too few points lie on the limb"
    LIMB_DIVERGED "limb_diverged" "limb fit diverged from the disc that was found"
    MOVED "moved" "the Sun moved too far during the exposure"
    OFF_OUTLINE "off_outline" "too much of the limb is off its outline"
    NOT_ROUND "not_round" "the bright area is not round"
    FEW_LIT_MARKS "few_lit_marks" "too few fully lit marks"
    NO_LABELLING "no_labelling" "the marks' spacings allow no labelling"
    FEW_MARKS_EXPLAINED "few_marks_explained" "the best labelling explains too few fully lit marks"
    WEAK_LABELLING "weak_labelling" "poor identification: the best labelling's evidence is too weak"
    TWO_LABELLINGS "two_labellings" "two labellings of the marks fit equally well"
    CENTRE_ALONE "centre_alone" "the marks fit several places of the plate: its stated centre alone decides between them"
    FALSE_DETECTION "false_detection" "the best labelling may rest on a false detection"
    CENTRE_FAR_AWAY "centre_far_away" "the best labelling puts the plate's centre too far away"
    SCALE_OF_LABELLING "scale_of_labelling" "the best labelling's scale contradicts the stated one"
    MIRROR_IMAGE "mirror_image" "the marks are those of the plate's mirror image"
    CENTRE_ELSEWHERE "centre_elsewhere" "the marks put the plate's centre far from where it is stated"
    FEW_MARKS "few_marks" "too few marks have an id"
    NO_MAPPING "no_mapping" "the marks determine no mapping"
    MARKS_OFF_MAPPING "marks_off_mapping" "the marks do not fit a mapping"
    SCALE "scale" "the marks' scale contradicts the stated one"
    RADIUS_OF_DISC "radius_of_disc" "the disc's radius contradicts the expected one"
    BORROWED_CONTRADICTED "borrowed_contradicted" "the frame's marks contradict the mapping that it would borrow"
    CALIBRATION_SINGULAR "calibration_singular" "the calibration's mapping cannot be inverted"
    SIZE "size" "the disc is not of the Sun's size"
    PART_OF_LIMB "part_of_limb" "only part of the limb is seen"
}

reasons! {
    /// Reasons for the pointing, from the plate to the sky.
    pointing:
    DATE "date" "date outside the Earth's ephemeris"
    ORIENTATION "orientation" "date outside the table of Earth orientation"
    LATITUDE "latitude" "latitude of the place"
    LONGITUDE "longitude" "longitude of the place"
    HEIGHT "height" "height of the place"
    PLACE "place" "place not understood"
    NEAR_ZENITH "near_zenith" "too near the zenith for azimuths"
    NO_BORESIGHT "no_boresight" "too near the zenith for any pointing"
    BEHIND_LENS "behind_lens" "Sun behind the lens"
    OFF_DISC "off_disc" "target off the disc"
    BEHIND_LIMB "behind_limb" "target behind the limb"
}

reasons! {
    /// Reasons for frames of the Earth's horizon.
    horizon:
    TOO_BRIGHT "too_bright" "the frame is bright all over"
    TOO_DARK "too_dark" "the frame is dark all over"
    NO_HORIZON "no_horizon" "too few sharp edges agree on a horizon"
    NO_LIMB "no_limb" "nothing is bright before the sky along the edge"
    SOFT_EDGE "soft_edge" "the edge is softer than that of the air"
    SHARP_EDGE "sharp_edge" "the edge is sharper than that of the air"
    UNEVEN_EDGE "uneven_edge" "the light falls off differently from place to place"
    LITTLE_EDGE "little_edge" "too little of the edge is seen"
    UNDETERMINED "undetermined" "the edge does not determine the fit"
    NOT_CONVERGED "not_converged" "the fit does not converge"
    RADIUS "radius" "the radius is not the Earth's"
    UNCERTAIN "uncertain" "the edge determines the nadir too poorly"
    LIGHT_ENDS "light_ends" "the light within the edge ends as sharply as it began"
    NO_CONE "no_cone" "the edge is not that of a sphere, or the camera's file is wrong"
    EDGE_HEIGHT "edge_height" "the edge has no height that air can have: the camera's file is wrong"
    RIVAL "rival" "another edge in the frame is nearly as good"
    DARK_INSIDE "dark_inside" "the Earth is not bright within its edge"
    BRIGHT_OUTSIDE "bright_outside" "the sky is not dark outside the Earth's edge"
    WRONG_SIZE "wrong_size" "the frame is of another size than the camera's"
    NOT_ABOVE_LIMB "not_above_the_limb" "the camera is not above the limb of the atmosphere"
}

reasons! {
    /// Reasons for frames of the Moon.
    moon:
    BELOW_HORIZON "below_horizon" "the Moon is below the horizon"
    NEAR_SUN "near_sun" "the Moon is too near to the Sun, and the Sun is up"
    WRONG_SIZE "wrong_size" "the frame is of another size than the camera's"
    TOO_BRIGHT "too_bright" "the sky is too bright"
    MANY_LIGHTS "too_many_lights" "too many places are bright"
    NO_MOON "no_moon" "nothing bright is as large as the Moon"
    NO_CIRCLE "no_circle" "the outline is no circle"
    NO_DISC "no_disc" "nothing bright has the shape of the Moon's disc"
    BEYOND_LENS "beyond_lens" "the disc lies where the lens shows nothing"
    LITTLE_LIMB "little_limb" "too little of the lit limb is seen"
    NO_FIT "no_fit" "the limb determines no circle"
    GLARE "glare" "the light around the disc is too uneven"
    UNLIKE "unlike" "the light is not shaded as the Moon's"
    OVAL "oval" "the limb is oval"
    ROUGH "rough" "the limb is rough"
    UNCERTAIN "uncertain" "the limb determines the centre too poorly"
    BLUNT "blunt" "too much of the limb is blunt"
    RADIUS "radius" "the radius is not the Moon's"
    LIT "lit" "another part of the disc is lit than the Moon's phase says"
}

/// Reasons of all solvers.
fn all() -> impl Iterator<Item = &'static Reason> {
    [sun::ALL, pointing::ALL, horizon::ALL, moon::ALL]
        .into_iter()
        .flatten()
}

/// Serialised with code and sentence: solvers share codes.
impl Serialize for Reason {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.code, self.sentence).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Reason {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (code, sentence) = <(String, String)>::deserialize(deserializer)?;
        let named = all().find(|reason| reason.code == code && reason.sentence == sentence);
        named.copied().ok_or_else(|| {
            de::Error::custom(format_args!(
                "expected a reason of this version, found {code}"
            ))
        })
    }
}

/// The page of the documentation that lists the reasons.
#[cfg(test)]
fn page() -> String {
    use std::fmt::Write as _;
    let mut page = String::from(
        "# Reasons\n\nWhy a frame has no solution, or a coarse one: `reason` in the output of `solve`, `horizon` and `moon` has the stage that\nstopped, the `code` of the reason, the reason as a sentence, what was `measured` and the `limit` that it fails, in the unit of what was\ntested. Codes stay as they are from version to version; sentences may be worded better. FITS headers and CSV have \"stage: reason\".\n",
    );
    for (title, reasons) in [
        ("The Sun on the plate: `solve`", sun::ALL),
        ("From the plate to the sky: `solve`", pointing::ALL),
        ("The horizon: `horizon`", horizon::ALL),
        ("The Moon: `moon`", moon::ALL),
    ] {
        let _ = write!(page, "\n## {title}\n\n| code | reason |\n|---|---|\n");
        for Reason { code, sentence } in reasons {
            let _ = writeln!(page, "| `{code}` | {sentence} |");
        }
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// If SOLASPECT_WRITE_DOCS is set, the page is written instead.
    #[test]
    fn the_page_on_reasons_is_the_table() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reasons.md");
        if std::env::var_os("SOLASPECT_WRITE_DOCS").is_some() {
            std::fs::write(path, page()).unwrap();
        }
        assert!(
            std::fs::read_to_string(path).unwrap() == page(),
            "docs/reasons.md is not the table: run this test with SOLASPECT_WRITE_DOCS=1"
        );
    }

    #[test]
    fn every_code_of_a_solver_is_one_word_of_its_own() {
        for reasons in [sun::ALL, pointing::ALL, horizon::ALL, moon::ALL] {
            let codes: BTreeSet<_> = reasons.iter().map(|reason| reason.code).collect();
            assert_eq!(codes.len(), reasons.len());
            let is_snake = |c: char| c.is_ascii_lowercase() || c == '_';
            assert!(codes.iter().all(|code| code.chars().all(is_snake)));
        }
    }
}
