//! Where a solver's answers go, besides the line: to the archive, the ground, the camera's exposure.

use super::answer::{Answer, Recent};
use super::archiver::Archive;
use super::flight::Station;
use super::line::LinkEvent;
use super::navigation::Inputs;
use super::shared::Shared;
use super::shutter::Glimpse;
use crate::camera::Brightness;
use crate::commands::controls::Controls;
use crate::frame::FrameInfo;
use crate::instrument::Instrument;
use crate::link::Picture;
use crate::link::picture::{Tag, TagValue};
use crossbeam_channel::Sender;
use jiff::Timestamp;

#[derive(Clone)]
pub(super) struct Outlet {
    pub controls: Controls,
    pub archive: Archive,
    pub to_line: Sender<LinkEvent>,
    pub watcher: Option<Sender<Answer>>,
    /// Where the camera learns of its frames' brightness.
    pub glimpse: Glimpse,
    pub recent: Shared<Recent>,
    /// `None` where no filter flies.
    pub navigation: Option<Inputs>,
}

impl Outlet {
    /// Whether a camera's pictures go to the archive.
    pub fn stores(&self, station: &Station) -> bool {
        self.controls.stores(station.seat.role())
    }

    pub fn hand_on(&self, answer: Answer, seen: Brightness) {
        if self.controls.takes_picture(answer.station.seat.role()) {
            self.send_picture(&answer);
        }
        if let Some(exposure) = answer.exposure.frame.info.exposure {
            *self.glimpse.lock() = Some((seen, exposure.as_micros() as u32));
        }
        if let Some(navigation) = &self.navigation {
            navigation.tell_seen(&answer);
        }
        self.recent.lock().note(&answer);
        self.archive.offer(&answer);
        if let Some(watcher) = &self.watcher {
            // A watcher that has left misses nothing that matters.
            let _ = watcher.send(answer);
        }
    }

    /// What the ground has asked for.
    fn send_picture(&self, answer: &Answer) {
        let info = &answer.exposure.frame.info;
        let tags = picture_tags(&answer.station.instrument, info);
        let time = info.mid_exposure.unwrap_or_else(Timestamp::now);
        match Picture::new(
            &answer.exposure.frame,
            answer.station.picture_number(),
            tags,
            time,
        ) {
            Ok(Some(picture)) => {
                // A line that is stuck carries no pictures.
                let _ = self.to_line.try_send(LinkEvent::Picture(Box::new(picture)));
            }
            Ok(None) => tracing::warn!("the frame is too large for a picture"),
            Err(error) => tracing::warn!(%error, "no picture"),
        }
    }
}

fn picture_tags(instrument: &Instrument, info: &FrameInfo) -> Vec<Tag> {
    let tag = |name: &str, value, comment: &str| Tag {
        name: name.into(),
        value,
        comment: comment.into(),
    };
    let mut tags = vec![tag(
        "INSTRUME",
        TagValue::Text(instrument.name.clone()),
        "instrument",
    )];
    if let Some(exposure) = info.exposure {
        let seconds = TagValue::Number(exposure.as_secs_f64());
        tags.push(tag("EXPTIME", seconds, "exposure, s"));
    }
    if let Some(camera) = &info.camera {
        tags.push(tag("CAMERA", TagValue::Text(camera.clone()), "camera"));
    }
    if let Some(number) = info.number {
        let number = TagValue::Whole(number as i32);
        tags.push(tag("FRAMENUM", number, "number of the frame"));
    }
    tags
}
