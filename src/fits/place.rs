//! Place of a frame's exposure, from keywords and to keywords.
//!
//! A [`Place`] is on WGS 84, and LATITUDE, LONGITUD and HEIGHT hold it unchanged. OBSGEO-X, -Y and -Z are the same place
//! in metres from the Earth's centre. OBSGEO-B, -L and -H are on the IAU's ellipsoid of 1976, as in the standard (Rots
//! et al. 2015, section 4.1.3), which makes a height 3 m lower. They are read in this order: files of other programs have the
//! latter two.

use super::keyword::{self, Keyword};
use super::values::Values;
use super::{Card, Problem};
use crate::frame::Warning;
use crate::geometry::earth;
use crate::units::Place;
use sofars::coords::{gc2gde, gd2gce};

const GEODETIC: Triple = [&keyword::LATITUDE, &keyword::LONGITUD, &keyword::HEIGHT];
const GEOCENTRIC: Triple = [&keyword::OBSGEO_X, &keyword::OBSGEO_Y, &keyword::OBSGEO_Z];
const GEODETIC_IAU: Triple = [&keyword::OBSGEO_B, &keyword::OBSGEO_L, &keyword::OBSGEO_H];

/// Three keywords that are only valid together.
type Triple = [&'static Keyword; 3];

/// Equatorial radius (m) and flattening of the IAU's ellipsoid of 1976.
const IAU_1976: (f64, f64) = (6_378_140.0, 1.0 / 298.2577);

/// Reads the place, from the first three keywords that give one; if the header states a place that cannot be used, the reason why there is none.
pub(super) fn read_place(values: &mut Values) -> (Option<Place>, Option<Warning>) {
    values.reading(place)
}

fn place(values: &mut Values) -> Option<Place> {
    type Convert = fn([f64; 3]) -> Result<Place, Problem>;
    let forms: [(Triple, Convert); 3] = [
        (GEODETIC, |[b, l, h]| {
            checked("LATITUDE/LONGITUD/HEIGHT", b, l, h)
        }),
        (GEOCENTRIC, |xyz| from_geocentric("OBSGEO-X/Y/Z", xyz)),
        (GEODETIC_IAU, from_iau),
    ];
    forms.into_iter().find_map(|(keywords, place)| {
        let place = place(triple(values, keywords)?);
        place.map_err(|problem| values.warn(problem.into())).ok()
    })
}

fn from_iau([latitude, longitude, height]: [f64; 3]) -> Result<Place, Problem> {
    let field = "OBSGEO-B/L/H";
    // Checked first: a latitude beyond 90 deg would give a geocentric position too.
    checked(field, latitude, longitude, height)?;
    let (radius, flattening) = IAU_1976;
    let [longitude, latitude] = [longitude, latitude].map(f64::to_radians);
    let xyz = gd2gce(radius, flattening, longitude, latitude, height)
        .map_err(|_| Problem::field(field, "a place on the Earth", "another"))?;
    from_geocentric(field, xyz)
}

/// The keywords of a place.
pub fn place_cards(place: Place) -> Vec<Card> {
    let geodetic = [place.latitude_deg, place.longitude_deg, place.height_m];
    let mut cards = cards(GEODETIC, geodetic);
    // To 0.1 mm: more digits would be noise of the conversion.
    let xyz: [f64; 3] = earth::ecef_m(&place).into();
    let xyz = xyz.map(|metres| (metres * 1e4).round() / 1e4);
    cards.extend(self::cards(GEOCENTRIC, xyz));
    let (radius, flattening) = IAU_1976;
    if let Ok((longitude, latitude, height)) = gc2gde(radius, flattening, xyz) {
        let geodetic = [latitude.to_degrees(), longitude.to_degrees(), height];
        cards.extend(self::cards(GEODETIC_IAU, geodetic));
    }
    cards
}

fn cards(keywords: Triple, values: [f64; 3]) -> Vec<Card> {
    let pairs = keywords.into_iter().zip(values);
    pairs
        .map(|(keyword, value)| Card::new(keyword, value))
        .collect()
}

fn from_geocentric(field: &str, xyz: [f64; 3]) -> Result<Place, Problem> {
    let (longitude, latitude, height) = gc2gde(earth::EQUATOR_M, earth::FLATTENING, xyz)
        .map_err(|_| Problem::field(field, "a geocentric position in m", format!("{xyz:?}")))?;
    checked(field, latitude.to_degrees(), longitude.to_degrees(), height)
}

fn checked(field: &str, latitude: f64, longitude: f64, height: f64) -> Result<Place, Problem> {
    Place::new(latitude, longitude, height).map_err(|error| {
        let found = format!(
            "latitude {latitude:.4} deg, longitude {longitude:.4} deg, height {height:.0} m"
        );
        Problem::field(
            field,
            format!("a place near the Earth's surface ({error})"),
            found,
        )
    })
}

/// Three numbers that are only valid together.
fn triple(values: &mut Values, keywords: Triple) -> Option<[f64; 3]> {
    let keywords = keywords.map(|keyword| keyword.name);
    let stated = keywords.map(|keyword| values.header.contains(keyword));
    let numbers = keywords.map(|keyword| values.number(keyword));
    if let [Some(x), Some(y), Some(z)] = numbers {
        return Some([x, y, z]);
    }
    if stated.contains(&true) && stated.contains(&false) {
        let found = keywords.iter().zip(stated).filter(|(_, stated)| *stated);
        let found: Vec<&str> = found.map(|(keyword, _)| *keyword).collect();
        let expected = "all three or none";
        values.warn(Warning::new(
            keywords.join(", "),
            expected,
            found.join(", "),
        ));
    }
    None
}
