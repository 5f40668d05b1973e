//! Output of `solaspect sky`: for one instant, or for a span of time for planning a flight.

use crate::sky::sphere::direction;
use crate::sky::{Air, Ephemeris, Rising, SkyError, crossings, horizon_deg, spells};
use crate::units::Place;
use anyhow::ensure;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use std::time::Duration;

#[derive(Serialize)]
pub(super) struct Report {
    utc: String,
    sun: SunReport,
    moon: MoonReport,
}

#[derive(Serialize)]
pub(super) struct SunReport {
    azimuth_deg: f64,
    elevation_deg: f64,
    radius_arcsec: f64,
    p_deg: f64,
    b0_deg: f64,
    l0_deg: f64,
    zenith_to_north_deg: f64,
}

#[derive(Serialize)]
pub(super) struct MoonReport {
    azimuth_deg: f64,
    elevation_deg: f64,
    radius_arcsec: f64,
    phase_angle_deg: f64,
    bright_limb_deg: f64,
    /// Only in the output for people.
    #[serde(skip)]
    zenith_to_bright_limb_deg: f64,
}

#[derive(Serialize)]
pub(super) struct Plan {
    rows: Vec<Report>,
    events: Vec<Event>,
    #[serde(skip_serializing_if = "Option::is_none")]
    band: Option<Band>,
}

#[derive(Serialize)]
pub(super) struct Event {
    utc: String,
    event: &'static str,
    azimuth_deg: f64,
    elevation_deg: f64,
}

#[derive(Serialize)]
pub(super) struct Band {
    low_deg: f64,
    high_deg: f64,
    hours: f64,
    spells: Vec<[String; 2]>,
}

/// The sky from one place.
pub(super) struct View {
    pub ephemeris: Ephemeris,
    pub place: Place,
    /// The air for the refraction of elevations, if it is wanted.
    pub air: Option<Air>,
}

impl View {
    fn lifted(&self, elevation_deg: f64) -> f64 {
        elevation_deg + self.air.map_or(0.0, |air| air.lift_deg(elevation_deg))
    }

    /// Sun and Moon at an instant.
    pub fn report(&mut self, utc: Timestamp) -> Result<Report, SkyError> {
        let sun = self.ephemeris.sun(utc, self.place)?;
        let moon = self.ephemeris.moon(utc, self.place)?;
        Ok(Report {
            utc: format!("{utc:.3}"),
            sun: SunReport {
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: self.lifted(sun.elevation_deg),
                radius_arcsec: sun.radius_arcsec,
                p_deg: sun.p_deg,
                b0_deg: sun.b0_deg,
                l0_deg: sun.l0_deg,
                zenith_to_north_deg: sun.zenith_to_north_deg,
            },
            moon: MoonReport {
                azimuth_deg: moon.azimuth_deg,
                elevation_deg: self.lifted(moon.elevation_deg),
                radius_arcsec: moon.radius_arcsec,
                phase_angle_deg: moon.phase_angle_deg,
                bright_limb_deg: moon.bright_limb_deg,
                zenith_to_bright_limb_deg: moon.zenith_to_bright_limb_deg,
            },
        })
    }

    /// Rows, events and hours between two instants.
    pub fn plan(
        &mut self,
        from: Timestamp,
        to: Timestamp,
        step: Duration,
        band: Option<[f64; 2]>,
    ) -> anyhow::Result<Plan> {
        /// Enough for a row every minute of two months.
        const MOST_ROWS: f64 = 1e5;
        let length_s = to.duration_since(from).as_secs_f64();
        ensure!(
            length_s >= 0.0,
            "--to: expected a time after --from, found {to}"
        );
        ensure!(
            step.as_secs_f64() * MOST_ROWS > length_s.max(1.0),
            "--step: expected at most {MOST_ROWS} rows from --from to --to, found a step of {step:?}"
        );
        let step = SignedDuration::try_from(step)?;
        let mut rows = Vec::new();
        let mut utc = from;
        while utc <= to {
            rows.push(self.report(utc)?);
            utc = utc.checked_add(step)?;
        }
        Ok(Plan {
            rows,
            events: self.events(from, to)?,
            band: band.map(|band| self.band(from, to, band)).transpose()?,
        })
    }

    fn events(&mut self, from: Timestamp, to: Timestamp) -> Result<Vec<Event>, SkyError> {
        let (place, horizon) = (self.place, horizon_deg(self.place));
        let above = crossings(from, to, |utc| {
            Ok(self.ephemeris.sun(utc, place)?.elevation_deg - horizon)
        })?;
        let east = crossings(from, to, |utc| {
            let sun = self.ephemeris.sun(utc, place)?;
            Ok(direction(sun.azimuth_deg, sun.elevation_deg).y)
        })?;
        let rises = above.iter().map(|crossing| match crossing.rising {
            Rising::Up => (crossing.utc, "rise"),
            Rising::Down => (crossing.utc, "set"),
        });
        // The Sun moves from east to west above the pole; below it, at night, it moves back.
        let noons = east
            .iter()
            .filter(|crossing| crossing.rising == Rising::Down)
            .map(|crossing| (crossing.utc, "transit"));
        let mut found: Vec<_> = rises.chain(noons).collect();
        found.sort();
        let event = |(utc, event)| {
            let sun = self.ephemeris.sun(utc, place)?;
            Ok(Event {
                utc: format!("{utc:.0}"),
                event,
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: self.lifted(sun.elevation_deg),
            })
        };
        found.into_iter().map(event).collect()
    }

    fn band(
        &mut self,
        from: Timestamp,
        to: Timestamp,
        [low_deg, high_deg]: [f64; 2],
    ) -> Result<Band, SkyError> {
        let found = spells(from, to, [low_deg, high_deg], |utc| {
            let sun = self.ephemeris.sun(utc, self.place)?;
            Ok(self.lifted(sun.elevation_deg))
        })?;
        let length = |spell: &[Timestamp; 2]| spell[1].duration_since(spell[0]).as_secs_f64();
        Ok(Band {
            low_deg,
            high_deg,
            hours: found.iter().map(length).sum::<f64>() / 3600.0,
            spells: found
                .iter()
                .map(|spell| spell.map(|utc| format!("{utc:.0}")))
                .collect(),
        })
    }
}

/// A report for people.
pub(super) fn card(report: &Report) -> String {
    let Report { utc, sun, moon } = report;
    let pair = |name, sun, moon, unit| format!("{name:24} {sun:15.5} {moon:12.5} {unit}");
    let of_sun = |name, value| format!("{name:24} {value:15.5} {:12} deg", "");
    let of_moon = |name, value| format!("{name:24} {value:28.5} deg");
    [
        format!("{utc:24} {:>15} {:>12}", "Sun", "Moon"),
        pair("azimuth", sun.azimuth_deg, moon.azimuth_deg, "deg"),
        pair("elevation", sun.elevation_deg, moon.elevation_deg, "deg"),
        pair("radius", sun.radius_arcsec, moon.radius_arcsec, "arcsec"),
        of_sun("zenith to solar north", sun.zenith_to_north_deg),
        of_sun("P", sun.p_deg),
        of_sun("B0", sun.b0_deg),
        of_sun("L0", sun.l0_deg),
        of_moon("phase angle", moon.phase_angle_deg),
        of_moon("bright limb from north", moon.bright_limb_deg),
        of_moon("bright limb from zenith", moon.zenith_to_bright_limb_deg),
    ]
    .join("\n")
}

/// A plan for people.
pub(super) fn table(plan: &Plan) -> String {
    let mut lines = vec![format!(
        "{:24} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "UTC; angles in deg", "Sun az", "el", "to north", "Moon az", "el"
    )];
    lines.extend(plan.rows.iter().map(|Report { utc, sun, moon }| {
        format!(
            "{utc:24} {:10.4} {:10.4} {:10.3} {:10.4} {:10.4}",
            sun.azimuth_deg,
            sun.elevation_deg,
            sun.zenith_to_north_deg,
            moon.azimuth_deg,
            moon.elevation_deg
        )
    }));
    lines.extend(plan.events.iter().map(|event| {
        let name = event.event;
        let (utc, azimuth, elevation) = (&event.utc, event.azimuth_deg, event.elevation_deg);
        format!("{utc:24} {azimuth:10.4} {elevation:10.4} {name:>10}")
    }));
    if let Some(band) = &plan.band {
        let (low, high, hours) = (band.low_deg, band.high_deg, band.hours);
        lines.push(format!("{hours:.2} h between {low} and {high} deg:"));
        lines.extend(
            band.spells
                .iter()
                .map(|[from, to]| format!("{from} to {to}")),
        );
    }
    lines.join("\n")
}
