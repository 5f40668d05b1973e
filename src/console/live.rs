//! The stream of one viewer: the newest data of each kind as they arrive, or a replay of the past.
//!
//! Only the events of one update are queued for a viewer. A slow reader skips events, and delays no one else.

use super::history::News;
use super::orders::OrderRow;
use super::request::Console;
use super::shared::Shared;
use super::table::Nanoseconds;
use super::training;
use super::view::{Detail, View, utc};
use axum::response::sse::Event;
use futures_util::stream::{Stream, unfold};
use jiff::Timestamp;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

/// Minimum and maximum time between two updates of a stream.
const LEAST: Duration = Duration::from_millis(40);
const MOST: Duration = Duration::from_secs(1);
/// Time between two updates of a replay.
const STEP: Duration = Duration::from_millis(250);
/// Interval at which a viewer on a slow line is informed of the omitted data.
const REPORT_LEFT_OUT: Duration = Duration::from_secs(10);
const SOON: Duration = Duration::from_secs(2);
/// Overhead of an event: its name, and the headers of the network, bytes.
const OVERHEAD_BYTES: usize = 100;
/// The share of a slow line used by the stream: the rest is for the viewer's requests.
const SHARE: f64 = 0.6;
/// Number of rows of the command log that may have changed since the last update.
const ROWS: usize = 20;

/// A replay: its start time, and its speed relative to real time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Replay {
    pub at: Nanoseconds,
    pub speed: f64,
}

/// Options of a viewer.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wish {
    /// Rate of the line to the viewer.
    pub bits_per_s: Option<f64>,
    pub replay: Option<Replay>,
}

impl Wish {
    fn detail(&self) -> Detail {
        match self.bits_per_s {
            Some(_) => Detail::Main,
            None => Detail::All,
        }
    }
}

/// A stream of events.
pub fn stream(
    console: Console,
    wish: Wish,
) -> impl Stream<Item = Result<Event, Infallible>> + Send {
    let viewer = Viewer::new(console, wish);
    unfold(viewer, |mut viewer| async {
        let (kind, data) = viewer.next().await?;
        let event = Event::default().event(kind).data(data);
        Some((Ok(event), viewer))
    })
}

/// Number of bytes received, for the line's rate.
struct Rate {
    bytes: u64,
    since: Instant,
    bits_per_s: u64,
}

/// A viewer of the stream.
struct Viewer {
    console: Console,
    wish: Wish,
    news: watch::Receiver<News>,
    /// State that was last sent to the viewer.
    seen: Option<News>,
    rows: Vec<OrderRow>,
    events: VecDeque<(&'static str, String)>,
    moment: Instant,
    state_sent: Instant,
    rate: Rate,
    left_out: u64,
    left_out_sent: Instant,
    /// Current position of a replay.
    position: Option<Nanoseconds>,
    has_ended: bool,
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.shared().viewers.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Viewer {
    fn new(console: Console, wish: Wish) -> Self {
        let shared = Arc::clone(console.shared());
        shared.viewers.fetch_add(1, Ordering::Relaxed);
        let now = Instant::now();
        Self {
            news: shared.subscribe(),
            wish,
            seen: None,
            rows: Vec::new(),
            events: VecDeque::new(),
            moment: now,
            state_sent: now,
            rate: Rate {
                bytes: shared.history().line.bytes,
                since: now,
                bits_per_s: 0,
            },
            left_out: 0,
            left_out_sent: now.checked_sub(REPORT_LEFT_OUT - SOON).unwrap_or(now),
            position: wish.replay.map(|replay| replay.at),
            has_ended: false,
            console,
        }
    }

    fn shared(&self) -> &Arc<Shared> {
        self.console.shared()
    }

    /// The next event; `None` at the end of the stream.
    async fn next(&mut self) -> Option<(&'static str, String)> {
        loop {
            if let Some((kind, data)) = self.events.pop_front() {
                self.pace(data.len()).await;
                return Some((kind, data));
            }
            if self.has_ended || self.shared().is_over() {
                return None;
            }
            match self.wish.replay {
                None => self.wait_for_news().await,
                Some(replay) => self.step(replay).await,
            }
        }
    }

    /// Waits for the time that an event takes on a slow line.
    async fn pace(&self, bytes: usize) {
        if let Some(bits_per_s) = self.wish.bits_per_s {
            let bits = 8 * (bytes + OVERHEAD_BYTES);
            let seconds = bits as f64 / (SHARE * bits_per_s);
            sleep(Duration::from_secs_f64(seconds)).await;
        }
    }

    async fn wait_for_news(&mut self) {
        if self.seen.is_some() {
            let since = self.moment.elapsed();
            sleep(LEAST.saturating_sub(since)).await;
            // The state is sent each second, with or without news.
            let left = MOST.saturating_sub(self.state_sent.elapsed());
            let _ = timeout(left, self.news.changed()).await;
        }
        let is_tick = self.seen.is_none() || self.state_sent.elapsed() >= MOST;
        self.moment = Instant::now();
        self.measure();
        let (seen, detail) = (self.seen, self.wish.detail());
        let (events, news) = {
            let history = self.shared().history();
            let view = View {
                history: &history,
                at: None,
                now: Timestamp::now(),
                is_live: self.console.is_live(),
            };
            (self.news_of(&view, seen, is_tick, detail), history.news)
        };
        let come = seen.map_or(0, |seen| news.total() - seen.total());
        let sent = events.iter().filter(|(kind, _)| *kind != "state").count();
        if sent < events.len() {
            self.state_sent = self.moment;
        }
        self.left_out += come.saturating_sub(sent as u64);
        self.events.extend(events);
        let orders_changed = seen.is_none_or(|seen| seen.orders != news.orders);
        if orders_changed {
            self.add_rows();
        }
        if detail == Detail::Main && self.left_out_sent.elapsed() > REPORT_LEFT_OUT {
            self.report_left_out();
        }
        self.seen = Some(news);
    }

    /// Changes since the last update.
    fn news_of(
        &self,
        view: &View,
        seen: Option<News>,
        is_tick: bool,
        detail: Detail,
    ) -> Vec<(&'static str, String)> {
        let news = view.history.news;
        let changed = |of: fn(&News) -> u64| seen.is_none_or(|seen| of(&seen) != of(&news));
        let mut events = Vec::new();
        let mut add = |kind, data: Option<Value>| {
            events.extend(data.map(|data| (kind, data.to_string())));
        };
        let housekeeping = changed(|news| news.housekeeping);
        if housekeeping || is_tick {
            let viewers = self.shared().viewers.load(Ordering::Relaxed);
            add(
                "state",
                Some(view.state(self.rate.bits_per_s, viewers, detail)),
            );
        }
        if changed(|news| news.training) {
            let faults = self.console.parts().training.as_ref();
            add("training", faults.map(training::panel));
        }
        if changed(|news| news.solution) {
            add("solution", view.solution());
        }
        if housekeeping {
            add("housekeeping", view.housekeeping(detail));
        }
        if detail == Detail::Main {
            return events;
        }
        if !housekeeping && changed(|news| news.marks) {
            add("housekeeping", view.housekeeping(detail));
        }
        if changed(|news| news.gyros) {
            add("propagated", view.gyros());
        }
        if changed(|news| news.pictures) {
            view.pictures()
                .into_iter()
                .for_each(|picture| add("picture", Some(picture)));
        }
        if changed(|news| news.frames) {
            add(
                "picture",
                view.frame().filter(|_| view.history.pictures.is_empty()),
            );
        }
        events
    }

    /// Measures the rate of the line over a few seconds.
    fn measure(&mut self) {
        let (elapsed, bytes) = (
            self.rate.since.elapsed(),
            self.shared().history().line.bytes,
        );
        if elapsed > Duration::from_secs(3) {
            let bits = 8 * bytes.saturating_sub(self.rate.bytes);
            self.rate = Rate {
                bytes,
                since: Instant::now(),
                bits_per_s: (bits as f64 / elapsed.as_secs_f64()) as u64,
            };
        }
    }

    fn add_rows(&mut self) {
        let rows: Vec<OrderRow> = self.shared().orders().rows().take(ROWS).cloned().collect();
        let new = rows.iter().rev().filter(|row| !self.rows.contains(row));
        let new: Vec<_> = new
            .filter_map(|row| serde_json::to_string(row).ok())
            .collect();
        self.events
            .extend(new.into_iter().map(|row| ("answer", row)));
        self.rows = rows;
    }

    fn report_left_out(&mut self) {
        self.left_out_sent = Instant::now();
        let words = format!(
            "on this line: no offsets by gyros, the main fields of the housekeeping, pictures and plots only when asked for; {} updates skipped",
            self.left_out
        );
        let data = json!({"updates": self.left_out, "words": words});
        self.events.push_back(("left_out", data.to_string()));
    }

    async fn step(&mut self, replay: Replay) {
        let is_first = self.seen.is_none();
        if !is_first {
            sleep(STEP.saturating_sub(self.moment.elapsed())).await;
        }
        let elapsed = if is_first {
            Duration::ZERO
        } else {
            self.moment.elapsed()
        };
        self.moment = Instant::now();
        let before = self.position.unwrap_or(replay.at);
        let at = before.saturating_add((elapsed.as_nanos() as f64 * replay.speed) as i64);
        self.position = Some(at);
        let detail = self.wish.detail();
        let (events, last) = {
            let history = self.shared().history();
            let view = View {
                history: &history,
                at: Some(at),
                now: Timestamp::now(),
                is_live: false,
            };
            let last = history.span().map_or(at, |(_, last)| last);
            (self.replayed(&view, before, detail, is_first), last)
        };
        self.events.extend(events);
        if at > last {
            self.events
                .push_back(("end", json!({"view": utc(last)}).to_string()));
            self.has_ended = true;
        }
        self.seen = Some(News::default());
    }

    /// State of a replay at its time; housekeeping and frames only if they changed.
    fn replayed(
        &self,
        view: &View,
        before: Nanoseconds,
        detail: Detail,
        is_first: bool,
    ) -> Vec<(&'static str, String)> {
        let viewers = self.shared().viewers.load(Ordering::Relaxed);
        let mut events = vec![("state", Some(view.state(0, viewers, detail)))];
        if is_first || view.history.row(view.at) != view.history.row(Some(before)) {
            events.push(("housekeeping", view.housekeeping(detail)));
        }
        events.push(("solution", view.solution()));
        if detail == Detail::All {
            events.push(("propagated", view.gyros()));
            let earlier = View {
                at: Some(before),
                ..*view
            };
            if is_first || view.frame() != earlier.frame() {
                events.push(("picture", view.frame()));
            }
            if is_first || view.pictures() != earlier.pictures() {
                events.extend(
                    view.pictures()
                        .into_iter()
                        .map(|picture| ("picture", Some(picture))),
                );
            }
        }
        let known = events
            .into_iter()
            .filter_map(|(kind, data)| Some((kind, data?)));
        known.map(|(kind, data)| (kind, data.to_string())).collect()
    }
}
