//! Where a frame was taken, from keywords and to keywords.
//!
//! A [`Place`] is on WGS 84, and LATITUDE, LONGITUD and HEIGHT hold it as it is. OBSGEO-X, -Y and -Z are the same place
//! in metres from the Earth's centre. OBSGEO-B, -L and -H are on the IAU's ellipsoid of 1976, as the standard has it (Rots
//! et al. 2015, section 4.1.3), which puts a height 3 m lower. They are read in this order: files of others have the
//! latter two.

use super::header::Header;
use super::{Card, Problem};
use crate::units::Place;
use sofars::consts::WGS84;
use sofars::coords::{gc2gd, gc2gde, gd2gc, gd2gce};

const GEODETIC: [&str; 3] = ["LATITUDE", "LONGITUD", "HEIGHT"];
const GEOCENTRIC: [&str; 3] = ["OBSGEO-X", "OBSGEO-Y", "OBSGEO-Z"];
const GEODETIC_IAU: [&str; 3] = ["OBSGEO-B", "OBSGEO-L", "OBSGEO-H"];

/// Equatorial radius (m) and flattening of the IAU's ellipsoid of 1976.
const IAU_1976: (f64, f64) = (6_378_140.0, 1.0 / 298.2577);

/// Reads the place.
pub(super) fn read_place(header: &Header) -> Result<Option<Place>, Problem> {
    if let Some([latitude, longitude, height]) = triple(header, GEODETIC)? {
        return checked("LATITUDE/LONGITUD/HEIGHT", latitude, longitude, height).map(Some);
    }
    if let Some(xyz) = triple(header, GEOCENTRIC)? {
        return from_geocentric("OBSGEO-X/Y/Z", xyz).map(Some);
    }
    let Some([latitude, longitude, height]) = triple(header, GEODETIC_IAU)? else {
        return Ok(None);
    };
    let field = "OBSGEO-B/L/H";
    // Checked first: a latitude beyond the pole has a geocentric position too.
    checked(field, latitude, longitude, height)?;
    let (radius, flattening) = IAU_1976;
    let [longitude, latitude] = [longitude, latitude].map(f64::to_radians);
    let xyz = gd2gce(radius, flattening, longitude, latitude, height)
        .map_err(|_| Problem::field(field, "a place on the Earth", "another"))?;
    from_geocentric(field, xyz).map(Some)
}

/// The keywords of a place.
pub(super) fn place_cards(place: Place) -> Vec<Card> {
    let geodetic = [place.latitude_deg, place.longitude_deg, place.height_m];
    let mut cards = cards(GEODETIC, geodetic);
    let [latitude, longitude] = [place.latitude_deg, place.longitude_deg].map(f64::to_radians);
    let Ok(xyz) = gd2gc(WGS84, longitude, latitude, place.height_m) else {
        return cards;
    };
    // To a tenth of a millimetre: more would be noise of the conversion.
    let xyz = xyz.map(|metres| (metres * 1e4).round() / 1e4);
    cards.extend(self::cards(GEOCENTRIC, xyz));
    let (radius, flattening) = IAU_1976;
    if let Ok((longitude, latitude, height)) = gc2gde(radius, flattening, xyz) {
        let geodetic = [latitude.to_degrees(), longitude.to_degrees(), height];
        cards.extend(self::cards(GEODETIC_IAU, geodetic));
    }
    cards
}

fn cards(keywords: [&'static str; 3], values: [f64; 3]) -> Vec<Card> {
    let pairs = keywords.into_iter().zip(values);
    pairs
        .map(|(keyword, value)| Card::new(keyword, value))
        .collect()
}

fn from_geocentric(field: &str, xyz: [f64; 3]) -> Result<Place, Problem> {
    let (longitude, latitude, height) = gc2gd(WGS84, xyz)
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

/// Three numbers that only make sense together.
fn triple(header: &Header, keywords: [&str; 3]) -> Result<Option<[f64; 3]>, Problem> {
    let [a, b, c] = keywords;
    match (header.number(a)?, header.number(b)?, header.number(c)?) {
        (Some(x), Some(y), Some(z)) => Ok(Some([x, y, z])),
        (None, None, None) => Ok(None),
        _ => Err(Problem::field(
            keywords.join(", "),
            "all three or none",
            "some of them",
        )),
    }
}
