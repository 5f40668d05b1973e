//! Requests for drawings: pictures, the Sun on the plate, plots and their numbers.

use super::frames::read_frame;
use super::ground::SunOnPlate;
use super::pictures::camera_name;
use super::plots::{self, FieldName, Numbers};
use super::request::{Answer, Asked, At, Console, Failure, attachment, beside, png, svg, time};
use super::table::{Nanoseconds, row_at};
use super::view::{View, utc};
use crate::units::PlateMil;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use std::ops::Range;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureQuery {
    camera: u8,
    at: Option<String>,
    overlay: Option<u8>,
    /// Distinguishes versions for a browser's cache.
    #[serde(rename = "version")]
    _version: Option<String>,
}

pub async fn picture(
    State(console): State<Console>,
    query: Asked<PictureQuery>,
) -> Answer<Response> {
    let PictureQuery {
        camera,
        at,
        overlay,
        ..
    } = query.0;
    let at = time("at", at.as_ref())?;
    let with_overlay = overlay == Some(1);
    let (picture, file) = {
        let history = console.shared().history();
        (
            history.picture(camera, at).cloned(),
            history.stored_frame(at).map(|frame| frame.file.to_string()),
        )
    };
    let name = camera_name(camera);
    let stored = match (&picture, file) {
        (None, Some(file)) if camera == 1 => {
            Some((console.read(file.clone(), read_frame).await?, file))
        }
        _ => None,
    };
    let _turn = console.turn().await?;
    beside(move || {
        let ground = &console.parts().ground;
        let drawn = match (picture, stored) {
            (Some(picture), _) if picture.width == 0 => {
                return Err(Failure::missing(format!("the {name}: no pixels have come")));
            }
            (Some(picture), _) if !with_overlay => Ok(picture.image()),
            (Some(picture), _) => {
                let frame = picture.frame().ok_or_else(|| {
                    Failure(
                        StatusCode::CONFLICT,
                        format!("the {name}: pixels of its picture are missing"),
                    )
                })?;
                ground.overlay(&frame, &format!("{name}, solved on the ground"))
            }
            (None, Some((frame, file))) => ground.frame(&frame, &file, with_overlay),
            (None, None) => {
                return Err(Failure::missing(format!("the {name}: no picture has come")));
            }
        };
        png(&drawn.map_err(|error| Failure(StatusCode::CONFLICT, format!("{error:#}")))?)
    })
    .await
}

pub async fn plate(State(console): State<Console>, query: Asked<At>) -> Answer<Response> {
    let at = time("at", query.0.at.as_ref())?;
    let sun = console.view(at, sun_on_plate);
    let Some(sun) = sun else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    beside(move || Ok(svg(console.parts().ground.plate(&sun)))).await
}

/// From the housekeeping, else from the log of an archive.
fn sun_on_plate(view: &View) -> Option<SunOnPlate> {
    let history = view.history;
    let place = history.row(view.at).and_then(|row| {
        let housekeeping = history.housekeeping.at_row(row)?;
        let (x, y) = housekeeping.plate_x_mil.zip(housekeeping.plate_y_mil)?;
        Some(SunOnPlate {
            time: history.housekeeping.times[row],
            at: PlateMil::new(x.into(), y.into()),
            sigma_mil: housekeeping.plate_sigma_mil.map(f64::from),
        })
    });
    place.or_else(|| {
        let table = history.tables.get("solutions")?;
        let row = row_at(table.times(), view.at.unwrap_or(Nanoseconds::MAX))?;
        let number = |name| table.value(row, name);
        Some(SunOnPlate {
            time: table.times()[row],
            at: PlateMil::new(number("sun_plate_x_mil")?, number("sun_plate_y_mil")?),
            sigma_mil: number("sun_plate_sigma_x_mil"),
        })
    })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlotQuery {
    fields: Option<String>,
    from: Option<String>,
    to: Option<String>,
}

impl PlotQuery {
    /// The requested range of times; by default all available times.
    fn range(&self, console: &Console) -> Answer<Range<Nanoseconds>> {
        let (from, to) = (
            time("from", self.from.as_ref())?,
            time("to", self.to.as_ref())?,
        );
        let span = console.shared().history().span();
        let (first, last) = span.ok_or_else(|| Failure::missing("nothing has come yet"))?;
        let range = from.unwrap_or(first)..to.unwrap_or(last.saturating_add(1));
        match range.is_empty() {
            true => Err(Failure::bad(
                "from, to: expected a range of times, found none",
            )),
            false => Ok(range),
        }
    }

    fn fields(&self) -> Answer<Vec<FieldName>> {
        let names: Vec<&str> = self
            .fields
            .as_deref()
            .unwrap_or_default()
            .split(',')
            .collect();
        if names.len() > plots::MOST_FIELDS {
            let words = format!(
                "fields: expected {} at most, found {}",
                plots::MOST_FIELDS,
                names.len()
            );
            return Err(Failure::bad(words));
        }
        let field = |name: &&str| {
            let unknown = || Failure::bad(format!("fields: expected TABLE.NAME, found \"{name}\""));
            FieldName::parse(name).ok_or_else(unknown)
        };
        names.iter().map(field).collect()
    }

    fn numbers(&self, console: &Console, range: &Range<Nanoseconds>) -> Answer<Vec<Numbers>> {
        let history = console.shared().history();
        let numbers = |field: &FieldName| {
            let found = plots::numbers(&history, field, range);
            found.ok_or_else(|| {
                Failure::missing(format!(
                    "fields: expected a known one, found \"{}.{}\"",
                    field.table, field.name
                ))
            })
        };
        self.fields()?.iter().map(numbers).collect()
    }
}

pub async fn plot(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let range = query.0.range(&console)?;
        let fields = query.0.numbers(&console, &range)?;
        let stack = plots::panels(fields, &range);
        // The page computes a time from the pointer's position.
        let root = format!(
            "<svg data-from=\"{}\" data-to=\"{}\"",
            utc(range.start),
            utc(range.end)
        );
        Ok(svg(stack.replacen("<svg", &root, 1)))
    })
    .await
}

pub async fn spectrum(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let range = query.0.range(&console)?;
        let runs = plots::offset_runs(&console.shared().history(), &range);
        let runs = runs.ok_or_else(|| Failure::missing("no offsets within these times"))?;
        let drawn = plots::offset_spectrum(&runs);
        Ok(svg(drawn.map_err(|_| {
            Failure::missing("no run of offsets is long enough for a spectrum")
        })?))
    })
    .await
}

pub async fn table(State(console): State<Console>, query: Asked<PlotQuery>) -> Answer<Response> {
    beside(move || {
        let fields = query.0.fields()?;
        if let Some(other) = fields.iter().find(|field| field.table != fields[0].table) {
            let words = format!(
                "fields: expected those of one table, found {} and {}",
                fields[0].table, other.table
            );
            return Err(Failure::bad(words));
        }
        let range = query.0.range(&console)?;
        let text = plots::csv(&query.0.numbers(&console, &range)?, &range);
        let name = fields[0].table.replace('/', "_");
        Ok(attachment(
            "text/csv",
            &format!("{name}.csv"),
            text.into_bytes(),
        ))
    })
    .await
}
