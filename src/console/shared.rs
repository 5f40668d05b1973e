//! State shared by the threads of the console.

use super::history::{History, News};
use super::orders::Orders;
use crate::link::Packet;
use jiff::Timestamp;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// The flight, the commands to it, and notifications of changes in both.
pub struct Shared {
    history: Mutex<History>,
    orders: Mutex<Orders>,
    news: watch::Sender<News>,
    /// Number of viewers of the live stream.
    pub viewers: AtomicUsize,
    over: AtomicBool,
    /// Time at which an archive or a recording last grew.
    grew: Mutex<Option<Instant>>,
}

/// An archive that has not grown for this time belongs to a finished flight.
const LATELY: Duration = Duration::from_secs(30);

impl Shared {
    pub fn new(history: History, orders: Orders) -> Self {
        Self {
            history: Mutex::new(history),
            orders: Mutex::new(orders),
            news: watch::Sender::new(News::default()),
            viewers: AtomicUsize::new(0),
            over: AtomicBool::new(false),
            grew: Mutex::new(None),
        }
    }

    /// The history; its lock delays the receiver.
    pub fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the history and notifies the viewers.
    pub fn change(&self, change: impl FnOnce(&mut History)) {
        let mut history = self.history();
        let before = history.news;
        change(&mut history);
        let news = history.news;
        drop(history);
        if news != before {
            self.news.send_replace(news);
        }
    }

    /// A receiver that is woken by changes.
    pub fn subscribe(&self) -> watch::Receiver<News> {
        self.news.subscribe()
    }

    /// Checks a packet for answers to commands.
    pub fn hear_answer(&self, packet: &Packet, now: Timestamp) {
        let has_changed = self.orders().hear(packet, now);
        self.notify_of_orders(has_changed);
    }

    /// Closes the rows of unanswered commands.
    pub fn give_up_on_orders(&self) {
        let has_changed = self.orders().give_up(Timestamp::now());
        self.notify_of_orders(has_changed);
    }

    pub fn fail_order(&self, number: u64, why: &str) {
        self.orders().fail(number, why, Timestamp::now());
        self.notify_of_orders(true);
    }

    pub fn notify_of_orders(&self, has_changed: bool) {
        if has_changed {
            self.change(|history| history.news.orders += 1);
        }
    }

    /// Records that an archive or a recording has grown.
    pub fn note_growth(&self) {
        *self.grew.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    pub fn has_grown_lately(&self) -> bool {
        let grew = *self.grew.lock().unwrap_or_else(PoisonError::into_inner);
        grew.is_some_and(|grew| grew.elapsed() < LATELY)
    }

    /// Tells the threads to end.
    pub fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
    }

    pub fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }
}
