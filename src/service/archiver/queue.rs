//! The pictures that wait for a disk.
//!
//! One disk, or several that alternate, take from one queue; each of two that mirror has its own. A disk that refuses a
//! picture gives it back and pauses, so that another may take it at once; pictures are dropped only by the
//! rules of overflow and of space, or when the flight ends.

use crate::archive::{FreeSpace, Overflow};
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Number of refusals after which the picture itself is considered the cause.
const MOST_REFUSALS: u32 = 5;

/// Rules by which pictures are dropped.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// Pictures that may wait.
    pub bound: usize,
    pub overflow: Overflow,
    /// One in this many is stored when pictures are thinned out.
    pub every: u64,
}

/// Counts of a queue.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct QueueTally {
    /// Pictures dropped because the disks were too slow.
    pub overflowed: u64,
    /// Pictures dropped because the disks are nearly full.
    pub disk_full: u64,
    /// Pictures refused too often, or still waiting when the last disk ended.
    pub failed: u64,
}

/// Picture dropped when another is queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dropped {
    Nothing,
    /// This picture or an older one, because the disks are too slow; with their number so far.
    DiskSlow(u64),
    /// This picture, because the disks are nearly full; with their number so far.
    DiskFull(u64),
}

/// A picture, and the number of times that disks have refused it.
pub(super) struct Waiting<P> {
    pub picture: P,
    refusals: u32,
}

/// Answer to a disk that asks for a picture.
pub(super) enum Taken<P> {
    Picture(Waiting<P>),
    /// No picture in time.
    Nothing,
    /// No picture will come any more.
    Closed,
}

pub(super) struct Queue<P> {
    state: Mutex<State<P>>,
    changed: Condvar,
}

struct State<P> {
    rules: Rules,
    pictures: VecDeque<Waiting<P>>,
    disks: Vec<DiskState>,
    closed: bool,
    /// The disk that took the last picture.
    last: Option<usize>,
    /// Whether the queue was full and has not been empty since.
    overflowing: bool,
    offered: u64,
    tally: QueueTally,
}

#[derive(Debug, Clone, Copy, Default)]
struct DiskState {
    space: FreeSpace,
    activity: Activity,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Activity {
    #[default]
    Writing,
    Waiting,
    /// After a refusal.
    Pausing,
    Ended,
}

impl<P> Queue<P> {
    pub fn new(rules: Rules, disks: usize) -> Self {
        Self {
            state: Mutex::new(State {
                rules,
                pictures: VecDeque::new(),
                disks: vec![DiskState::default(); disks],
                closed: false,
                last: None,
                overflowing: false,
                offered: 0,
                tally: QueueTally::default(),
            }),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<P>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn tally(&self) -> QueueTally {
        self.lock().tally
    }

    /// Pictures that wait.
    pub fn length(&self) -> usize {
        self.lock().pictures.len()
    }

    /// Queues the picture, or gives up this or an older one by the rules.
    pub fn offer(&self, picture: P) -> Dropped {
        let waiting = Waiting {
            picture,
            refusals: 0,
        };
        let given_up = self.lock().offer(waiting);
        self.changed.notify_all();
        given_up
    }

    /// Sets the fraction stored when pictures are thinned out, to one in `every`.
    pub fn set_every(&self, every: u64) {
        self.lock().rules.every = every;
    }

    /// Notes how much free space a disk has.
    pub fn set_space(&self, disk: usize, space: FreeSpace) {
        self.lock().disks[disk].space = space;
        self.changed.notify_all();
    }

    /// The next picture for a disk; waits for one until `deadline`.
    pub fn take(&self, disk: usize, deadline: Instant) -> Taken<P> {
        let mut state = self.lock();
        state.disks[disk].activity = Activity::Waiting;
        // A disk that stops waiting may have been the one to which another left the picture.
        self.changed.notify_all();
        let taken = loop {
            if let Some(picture) = state.next_for(disk) {
                state.last = Some(disk);
                break Taken::Picture(picture);
            }
            let has_space = state.disks[disk].space > FreeSpace::None;
            if state.closed && (!has_space || state.pictures.is_empty()) {
                break Taken::Closed;
            }
            let timeout = deadline.saturating_duration_since(Instant::now());
            if timeout.is_zero() {
                break Taken::Nothing;
            }
            let waited = self.changed.wait_timeout(state, timeout);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        };
        state.disks[disk].activity = Activity::Writing;
        drop(state);
        self.changed.notify_all();
        taken
    }

    /// Puts back a picture that a disk has refused.
    pub fn give_back(&self, disk: usize, mut waiting: Waiting<P>) {
        waiting.refusals += 1;
        let mut state = self.lock();
        state.disks[disk].activity = Activity::Pausing;
        let other_is_working = state.other_is_working(disk);
        if waiting.refusals >= MOST_REFUSALS {
            state.tally.failed += 1;
        } else if other_is_working {
            state.pictures.push_front(waiting);
        } else {
            // The disk's next attempt is with another picture: this one may be the cause itself.
            state.pictures.push_back(waiting);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Whether another disk takes pictures from this queue now.
    pub fn other_is_working(&self, disk: usize) -> bool {
        self.lock().other_is_working(disk)
    }

    /// Waits until `deadline`, or until the queue is closed; returns whether it is closed.
    pub fn pause(&self, disk: usize, deadline: Instant) -> bool {
        let mut state = self.lock();
        state.disks[disk].activity = Activity::Pausing;
        loop {
            let timeout = deadline.saturating_duration_since(Instant::now());
            if state.closed || timeout.is_zero() {
                return state.closed;
            }
            let waited = self.changed.wait_timeout(state, timeout);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Counts a picture that is itself the cause of refusals.
    pub fn fail(&self) {
        self.lock().tally.failed += 1;
    }

    /// No picture will be offered any more.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// A disk ends. With the last one, the waiting pictures are dropped.
    pub fn end(&self, disk: usize) {
        let mut state = self.lock();
        state.disks[disk].activity = Activity::Ended;
        let all = |disk: &DiskState| disk.activity == Activity::Ended;
        if state.disks.iter().all(all) {
            state.tally.failed += state.pictures.len() as u64;
            state.pictures.clear();
        }
        drop(state);
        self.changed.notify_all();
    }
}

impl<P> State<P> {
    fn other_is_working(&self, disk: usize) -> bool {
        let others = self.disks.iter().enumerate().filter(|(n, _)| *n != disk);
        let mut activities = others.map(|(_, other)| other.activity);
        activities.any(|activity| matches!(activity, Activity::Waiting | Activity::Writing))
    }

    fn offer(&mut self, waiting: Waiting<P>) -> Dropped {
        let rules = self.rules;
        let nth = self.offered.is_multiple_of(rules.every);
        self.offered += 1;
        let space = self.best_space();
        if space == FreeSpace::None || (space == FreeSpace::Scarce && !nth) {
            self.tally.disk_full += 1;
            return Dropped::DiskFull(self.tally.disk_full);
        }
        let full = self.pictures.len() >= rules.bound;
        self.overflowing = full || (self.overflowing && !self.pictures.is_empty());
        let (takes, gives_up) = match rules.overflow {
            _ if !self.overflowing => (true, false),
            Overflow::DropOldest => (rules.bound > 0, full),
            Overflow::EveryNth if nth && !full => (true, false),
            Overflow::EveryNth | Overflow::SolutionsOnly => (false, true),
        };
        if takes {
            if gives_up {
                self.pictures.pop_front();
            }
            self.pictures.push_back(waiting);
        }
        if !gives_up {
            return Dropped::Nothing;
        }
        self.tally.overflowed += 1;
        Dropped::DiskSlow(self.tally.overflowed)
    }

    /// Best state of free space among the disks that take pictures; unknown while none does.
    fn best_space(&self) -> FreeSpace {
        let working =
            |disk: &&DiskState| matches!(disk.activity, Activity::Waiting | Activity::Writing);
        let spaces = self.disks.iter().filter(working).map(|disk| disk.space);
        spaces.max().unwrap_or_default()
    }

    fn next_for(&mut self, disk: usize) -> Option<Waiting<P>> {
        let space = self.disks[disk].space;
        if space == FreeSpace::None || (!self.closed && self.yields(disk)) {
            return None;
        }
        self.pictures.pop_front()
    }

    /// Whether a disk leaves the next picture to another one: to one that waits, if it took the last itself; and to
    /// one with more space, unless that one cannot follow.
    fn yields(&self, disk: usize) -> bool {
        let own = self.disks[disk].space;
        let others = self.disks.iter().enumerate();
        others.filter(|&(n, _)| n != disk).any(|(_, other)| {
            let has_more_space = own <= FreeSpace::Scarce && other.space > own;
            match other.activity {
                Activity::Waiting if other.space <= FreeSpace::Scarce && own > other.space => false,
                Activity::Waiting => {
                    has_more_space || self.last == Some(disk) && other.space > FreeSpace::None
                }
                Activity::Writing => has_more_space && 2 * self.pictures.len() < self.rules.bound,
                Activity::Pausing | Activity::Ended => false,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn queue(bound: usize, overflow: Overflow, disks: usize) -> Queue<u32> {
        let every = 3;
        let rules = Rules {
            bound,
            overflow,
            every,
        };
        Queue::new(rules, disks)
    }

    fn offer(queue: &Queue<u32>, pictures: std::ops::Range<u32>) {
        for picture in pictures {
            queue.offer(picture);
        }
    }

    /// The picture that a disk gets without waiting.
    fn take(queue: &Queue<u32>, disk: usize, space: FreeSpace) -> Option<Waiting<u32>> {
        queue.set_space(disk, space);
        match queue.take(disk, Instant::now()) {
            Taken::Picture(waiting) => Some(waiting),
            Taken::Nothing | Taken::Closed => None,
        }
    }

    fn all(queue: &Queue<u32>) -> Vec<u32> {
        let next = || take(queue, 0, FreeSpace::Plenty);
        std::iter::from_fn(next).map(|w| w.picture).collect()
    }

    #[test]
    fn pictures_leave_in_the_order_in_which_they_came() {
        let queue = queue(8, Overflow::DropOldest, 1);
        offer(&queue, 0..8);
        assert_eq!(all(&queue), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(queue.tally(), QueueTally::default());
    }

    #[test]
    fn of_too_many_the_oldest_is_given_up() {
        let queue = queue(4, Overflow::DropOldest, 1);
        offer(&queue, 0..10);
        assert_eq!(queue.tally().overflowed, 6);
        assert_eq!(all(&queue), [6, 7, 8, 9]);
    }

    #[test]
    fn from_when_the_queue_was_full_until_none_waits_only_every_nth_is_taken_in() {
        let queue = queue(4, Overflow::EveryNth, 1);
        offer(&queue, 0..5);
        let first = [0, 1, 2].map(|_| take(&queue, 0, FreeSpace::Plenty).unwrap().picture);
        assert_eq!(first, [0, 1, 2]);
        offer(&queue, 5..10);
        assert_eq!(all(&queue), [3, 6, 9]);
        offer(&queue, 10..13);
        assert_eq!(all(&queue), [10, 11, 12]);
        assert_eq!(queue.tally().overflowed, 4);
    }

    #[test]
    fn from_when_the_queue_was_full_until_none_waits_there_are_solutions_only() {
        let queue = queue(2, Overflow::SolutionsOnly, 1);
        offer(&queue, 0..3);
        take(&queue, 0, FreeSpace::Plenty).unwrap();
        offer(&queue, 3..6);
        assert_eq!(all(&queue), [1]);
        offer(&queue, 6..7);
        assert_eq!(all(&queue), [6]);
        assert_eq!(queue.tally().overflowed, 4);
    }

    #[test]
    fn a_queue_for_nothing_gives_everything_up() {
        for &overflow in Overflow::KINDS {
            let queue = queue(0, overflow, 1);
            offer(&queue, 0..3);
            assert_eq!((queue.tally().overflowed, all(&queue)), (3, vec![]));
        }
    }

    #[test]
    fn as_space_goes_pictures_are_thinned_and_then_stopped_and_come_back() {
        let queue = queue(8, Overflow::DropOldest, 1);
        let now_with = |space| take(&queue, 0, space).map(|w| w.picture);
        assert_eq!(now_with(FreeSpace::Low), None);
        offer(&queue, 0..3);
        assert_eq!(
            [now_with(FreeSpace::Low), now_with(FreeSpace::Low)],
            [Some(0), Some(1)]
        );
        assert_eq!(now_with(FreeSpace::Scarce), Some(2));
        offer(&queue, 3..9);
        assert_eq!(
            [now_with(FreeSpace::Scarce), now_with(FreeSpace::Scarce)],
            [Some(3), Some(6)]
        );
        assert_eq!(now_with(FreeSpace::None), None);
        offer(&queue, 9..12);
        assert_eq!(now_with(FreeSpace::Plenty), None);
        offer(&queue, 12..14);
        assert_eq!(
            [now_with(FreeSpace::Plenty), now_with(FreeSpace::Plenty)],
            [Some(12), Some(13)]
        );
        assert_eq!(queue.tally().disk_full, 4 + 3);
    }

    #[test]
    fn two_disks_that_wait_take_turns() {
        let queue = queue(8, Overflow::DropOldest, 2);
        let taken = Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            for disk in 0..2 {
                let (queue, taken) = (&queue, &taken);
                scope.spawn(move || {
                    let soon = || Instant::now() + Duration::from_secs(60);
                    while let Taken::Picture(w) = queue.take(disk, soon()) {
                        taken.lock().unwrap().push((w.picture, disk));
                    }
                });
            }
            let waiting = |disk: &DiskState| disk.activity == Activity::Waiting;
            for picture in 0..6 {
                // Both disks wait for more.
                while !(queue.lock().disks.iter().all(waiting) && queue.length() == 0) {
                    std::thread::yield_now();
                }
                queue.offer(picture);
            }
            while queue.length() > 0 {
                std::thread::yield_now();
            }
            queue.close();
        });
        let mut taken = taken.into_inner().unwrap();
        taken.sort_unstable();
        let turns = |first: usize| {
            (0..6)
                .map(|n| (n as u32, (n + first) % 2))
                .collect::<Vec<_>>()
        };
        assert!(taken == turns(0) || taken == turns(1), "{taken:?}");
    }

    #[test]
    fn a_refused_picture_goes_to_the_other_disk_at_once() {
        let queue = queue(8, Overflow::DropOldest, 2);
        offer(&queue, 0..3);
        let refused = take(&queue, 0, FreeSpace::Plenty).unwrap();
        queue.give_back(0, refused);
        assert_eq!(take(&queue, 1, FreeSpace::Plenty).unwrap().picture, 0);
        assert_eq!(take(&queue, 1, FreeSpace::Plenty).unwrap().picture, 1);
    }

    #[test]
    fn a_disk_alone_tries_another_picture_first_and_gives_one_up_after_five_refusals() {
        let queue = queue(8, Overflow::DropOldest, 1);
        offer(&queue, 0..2);
        for expected in [0, 1, 0, 1, 0, 1, 0, 1, 0, 1] {
            let refused = take(&queue, 0, FreeSpace::Plenty).unwrap();
            assert_eq!(refused.picture, expected);
            queue.give_back(0, refused);
        }
        assert_eq!((queue.length(), queue.tally().failed), (0, 2));
    }

    #[test]
    fn a_disk_with_little_space_leaves_pictures_to_one_with_more_that_can_follow() {
        let queue = queue(8, Overflow::DropOldest, 2);
        assert!(take(&queue, 1, FreeSpace::Plenty).is_none());
        offer(&queue, 0..3);
        assert!(
            take(&queue, 0, FreeSpace::Scarce).is_none(),
            "disk 1 can follow"
        );
        offer(&queue, 3..6);
        assert_eq!(
            take(&queue, 0, FreeSpace::Scarce).unwrap().picture,
            0,
            "it cannot"
        );
        assert!(take(&queue, 0, FreeSpace::None).is_none(), "whatever waits");
    }

    #[test]
    fn what_waits_when_the_last_disk_ends_is_counted() {
        let queue = queue(8, Overflow::DropOldest, 2);
        offer(&queue, 0..3);
        queue.close();
        queue.end(0);
        assert_eq!((queue.length(), queue.tally().failed), (3, 0));
        queue.end(1);
        assert_eq!((queue.length(), queue.tally().failed), (0, 3));
        assert!(queue.pause(0, Instant::now() + Duration::from_secs(60)));
    }
}
