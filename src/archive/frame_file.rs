//! The keywords and tables of a frame's file that are not numbers of its record.

use crate::aspect::Solution;
use crate::fits::{Card, Column, Table, Values, keyword};
use crate::instrument::Instrument;
use crate::limb::LimbPoint;
use crate::pointing::{Roll, Target};

/// The keywords of the telescope's target, as far as they do not change with the Sun.
pub fn target_cards(target: &Target) -> Vec<Card> {
    match target {
        Target::Fixed(place) => vec![
            Card::new(&keyword::OBJECT, "Sun"),
            Card::new(&keyword::TARGETX, place.x),
            Card::new(&keyword::TARGETY, place.y),
        ],
        Target::Feature(_) => vec![Card::new(&keyword::OBJECT, "a feature of the Sun")],
    }
}

/// The keywords of the instrument, and of the roll on which the directions rest.
pub fn instrument_cards(instrument: &Instrument, roll: Roll) -> Vec<Card> {
    let mounting = &instrument.mounting;
    let roll_deg = roll.about_boresight_deg(instrument);
    vec![
        Card::new(&keyword::OBSRVTRY, instrument.name.as_str()),
        Card::new(&keyword::TELESCOP, instrument.name.as_str()),
        Card::new(&keyword::INSTRUME, "solar aspect camera"),
        Card::new(&keyword::WAVELNTH, instrument.optics.wavelength_nm),
        Card::new(&keyword::WAVEUNIT, "nm"),
        Card::new(&keyword::CLOCKANG, mounting.clocking_deg.value),
        Card::new(&keyword::PLATEDIR, mounting.directions.name()),
        Card::new(&keyword::ROLLANG, roll_deg.value),
        Card::new(&keyword::ROLLANSG, roll_deg.sigma),
        Card::new(&keyword::BORE_X, mounting.boresight_mil.x),
        Card::new(&keyword::BORE_Y, mounting.boresight_mil.y),
        Card::new(
            &keyword::PLATEDST,
            instrument.optics.plate_distance_mm.value,
        ),
    ]
}

/// The marks and the limb points of a frame, as tables for its file. Empty ones are omitted.
pub fn tables(solution: &Solution) -> Vec<Table> {
    const SEEN: &str = "where it was seen, first pixel is 0";
    const EDGE: &str = "point of the limb, first pixel is 0";
    let column = |name: &str, unit: &str, meaning: &str, values: Values| Column {
        name: name.into(),
        unit: unit.into(),
        meaning: meaning.into(),
        values,
    };
    let mut tables = Vec::new();
    let marks = &solution.marks;
    if !marks.is_empty() {
        let floats =
            |of: fn(&crate::aspect::Mark) -> f64| Values::Float(marks.iter().map(of).collect());
        let whole = |of: fn(&crate::aspect::Mark) -> i32| {
            Values::Integer(marks.iter().map(|mark| i64::from(of(mark))).collect())
        };
        tables.push(Table {
            name: "MARKS".into(),
            columns: vec![
                column("I", "", "id of an identified mark", whole(|mark| mark.id.i)),
                column("J", "", "id of an identified mark", whole(|mark| mark.id.j)),
                column("X", "pixel", SEEN, floats(|mark| mark.at.x)),
                column("Y", "pixel", SEEN, floats(|mark| mark.at.y)),
                column(
                    "SIGMA",
                    "pixel",
                    "1 sigma per axis",
                    floats(|mark| mark.sigma_px()),
                ),
            ],
        });
    }
    if !solution.limb.is_empty() {
        let floats =
            |of: fn(&LimbPoint) -> f64| Values::Float(solution.limb.iter().map(of).collect());
        tables.push(Table {
            name: "LIMB".into(),
            columns: vec![
                column("X", "pixel", EDGE, floats(|point| point.at.x)),
                column("Y", "pixel", EDGE, floats(|point| point.at.y)),
                column(
                    "SIGMA",
                    "pixel",
                    "1 sigma along the radius",
                    floats(|point| point.sigma_px),
                ),
            ],
        });
    }
    tables
}
