//! Requests for the Moon that wait for a picture.

use super::Line;
use crate::link::moon::NO_PICTURE;
use crate::link::{MoonAnswer, MoonOutcome, MoonRequest};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// More requests than a platform sends while a picture is taken; beyond them the oldest is answered at once.
const MOST: usize = 16;

/// Requests in the order in which they came.
#[derive(Default)]
pub(super) struct MoonRequests(VecDeque<Waiting>);

struct Waiting {
    sequence: u16,
    since: Instant,
}

impl MoonRequests {
    /// The requests to be answered now: those with a picture begun since they came, and those that have waited too long.
    fn answers(
        &mut self,
        result: Option<(Instant, MoonOutcome)>,
        most: Duration,
        now: Instant,
    ) -> Vec<MoonAnswer> {
        let too_many = self.0.len().saturating_sub(MOST);
        let mut at = 0;
        let mut answers = Vec::new();
        self.0.retain(|request| {
            at += 1;
            let fresh = result.filter(|(began, _)| *began >= request.since);
            let is_late = now.saturating_duration_since(request.since) > most || at <= too_many;
            let outcome = match fresh {
                Some((_, outcome)) => outcome,
                None if is_late => MoonOutcome::NotFound { code: NO_PICTURE },
                None => return true,
            };
            answers.push(MoonAnswer {
                request: request.sequence,
                outcome,
            });
            false
        });
        answers
    }
}

impl Line<'_> {
    /// Queues requests; a picture that begins from now on answers them.
    pub(super) fn request_moon(&mut self, requests: &[(u16, MoonRequest)]) {
        for (sequence, request) in requests {
            self.tally.lock().moon_requests += 1;
            if let Ok(place) = request.place() {
                self.moon_state.lock().requested_from = Some(place);
            }
            self.moon_requests.0.push_back(Waiting {
                sequence: *sequence,
                since: Instant::now(),
            });
        }
    }

    /// Answers the requests that can be answered.
    pub(super) fn answer_moon_requests(&mut self) {
        if self.moon_requests.0.is_empty() {
            return;
        }
        let result = self.moon_state.lock().result;
        let most = self.controls.config().moon.answer_within();
        let result = result.map(|result| (result.began, result.outcome));
        for answer in self.moon_requests.answers(result, most, Instant::now()) {
            match self.responder.moon(answer) {
                Ok(packet) => {
                    self.send(&packet);
                }
                Err(error) => self.note_unsent(&error, "a request for the Moon was not answered"),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOT_VISIBLE: MoonOutcome = MoonOutcome::NotVisible { code: 1 };
    const NO_PICTURE_CAME: MoonOutcome = MoonOutcome::NotFound { code: NO_PICTURE };

    fn waiting(since: &[Instant]) -> MoonRequests {
        let waiting = (1..).zip(since);
        MoonRequests(
            waiting
                .map(|(sequence, &since)| Waiting { sequence, since })
                .collect(),
        )
    }

    fn outcomes(answers: Vec<MoonAnswer>) -> Vec<(u16, MoonOutcome)> {
        let outcomes = answers
            .iter()
            .map(|answer| (answer.request, answer.outcome));
        outcomes.collect()
    }

    #[test]
    fn a_picture_answers_the_requests_that_came_before_it_was_begun() {
        let start = Instant::now();
        let after = |s| start + Duration::from_secs(s);
        let mut requests = waiting(&[after(1), after(2), after(3)]);
        let most = Duration::from_secs(60);
        assert!(requests.answers(None, most, after(4)).is_empty());
        let result = Some((after(2), NOT_VISIBLE));
        let answers = outcomes(requests.answers(result, most, after(4)));
        assert_eq!(answers, [(1, NOT_VISIBLE), (2, NOT_VISIBLE)]);
        assert!(requests.answers(result, most, after(4)).is_empty());
    }

    #[test]
    fn a_request_without_a_picture_is_answered_in_time_and_the_oldest_of_too_many_at_once() {
        let start = Instant::now();
        let after = |s| start + Duration::from_secs(s);
        let mut requests = waiting(&[start, after(5)]);
        let most = Duration::from_secs(4);
        let answers = outcomes(requests.answers(None, most, after(5)));
        assert_eq!(answers, [(1, NO_PICTURE_CAME)]);
        let mut requests = waiting(&[start; MOST + 2]);
        let answers = outcomes(requests.answers(None, most, start));
        assert_eq!(answers, [(1, NO_PICTURE_CAME), (2, NO_PICTURE_CAME)]);
    }
}
