//! When a worker takes work: within its hours, and while nobody else uses its machine.

use crate::hours::Hours;
use crate::others::{LOOK, Others, Ticks};
use chrono::{Local, Offset, TimeZone};
use photonfarm_proto::rest::{RestReason, Resting};
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::sync::watch;

/// Milliseconds of a minute.
const MINUTE_MS: u64 = 60_000;

/// When a worker takes work.
#[derive(Clone, Debug)]
pub struct Attendance {
    hours: Option<Hours>,
    others: Option<Others>,
    /// What was found of the hours in a minute.
    found: Option<(u64, Option<Resting>)>,
}

/// What is known at a time.
struct Moment<A> {
    /// Minutes since 1970, UTC.
    minute: u64,
    ticks: Option<Ticks>,
    /// Minutes by which local time is ahead of UTC at a minute.
    ahead: A,
}

impl Attendance {
    /// Within these hours, and while others use no more than a share of the processors \[percent\].
    #[must_use]
    pub fn new(hours: Option<Hours>, others_percent: Option<f64>) -> Self {
        Self {
            hours,
            others: others_percent.map(Others::beyond),
            found: None,
        }
    }

    /// Whether a worker is to rest, and why.
    fn look<A: Fn(u64) -> i64>(&mut self, now: Moment<A>) -> Option<Resting> {
        // Others are looked at outside of the hours as well, so that they are known when these begin.
        let busy = match (&mut self.others, now.ticks) {
            (Some(others), Some(ticks)) => others.look(ticks),
            _ => false,
        };
        if let Some(hours) = &self.hours
            && self.found.is_none_or(|(minute, _)| minute != now.minute)
        {
            let rest = || Resting {
                reason: RestReason::Hours,
                until_ms: hours.next(now.minute, &now.ahead).map(|minute| minute * MINUTE_MS),
            };
            let open = hours.are_at(now.minute, &now.ahead);
            self.found = Some((now.minute, (!open).then(rest)));
        }
        let outside = self.found.and_then(|(_, rest)| rest);
        outside.or_else(|| {
            busy.then_some(Resting {
                reason: RestReason::Busy,
                until_ms: None,
            })
        })
    }

    /// Looks now, in local time.
    fn look_now(&mut self) -> Option<Resting> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.look(Moment {
            minute: since.as_secs() / 60,
            ticks: Ticks::now(),
            ahead: local_ahead,
        })
    }

    /// What a worker is to do, from now on: the receiver has its rest whenever that changes.
    #[must_use]
    pub fn begin(mut self) -> watch::Receiver<Option<Resting>> {
        let (sender, receiver) = watch::channel(self.look_now());
        tokio::spawn(async move {
            while !sender.is_closed() {
                tokio::time::sleep(LOOK).await;
                let now = self.look_now();
                sender.send_if_modified(|known| std::mem::replace(known, now) != now);
            }
        });
        receiver
    }
}

/// Minutes by which local time is ahead of UTC at a time [minutes since 1970, UTC].
fn local_ahead(minute: u64) -> i64 {
    let seconds = i64::try_from(60 * minute).unwrap_or_default();
    let time = Local.timestamp_opt(seconds, 0).earliest();
    time.map_or(0, |time| {
        i64::from(time.offset().fix().local_minus_utc()).div_euclid(60)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Monday, 30 November 2026, 00:00 UTC.
    const MONDAY: u64 = 29_933_280;

    fn at(minute: u64, ticks: Option<Ticks>) -> Moment<impl Fn(u64) -> i64> {
        Moment {
            minute: MONDAY + minute,
            ticks,
            ahead: |_| 60,
        }
    }

    #[test]
    fn hours_come_and_go_with_the_clock() {
        let hours = "mon-fri 19:00-07:00".parse().unwrap();
        let mut attendance = Attendance::new(Some(hours), None);
        let evening = MONDAY + 18 * 60;
        let resting = Some(Resting {
            reason: RestReason::Hours,
            until_ms: Some(evening * MINUTE_MS),
        });
        assert_eq!(attendance.look(at(0, None)), resting);
        assert_eq!(attendance.look(at(18 * 60 - 1, None)), resting);
        assert_eq!(attendance.look(at(18 * 60, None)), None);
        assert_eq!(attendance.look(at(24 * 60 + 6 * 60 - 1, None)), None);
        let again = attendance.look(at(24 * 60 + 6 * 60, None)).unwrap();
        assert_eq!(again.until_ms, Some((evening + 24 * 60) * MINUTE_MS));
        // The clock is set back.
        assert_eq!(attendance.look(at(18 * 60, None)), None);
    }

    #[test]
    fn others_send_a_worker_to_rest_within_its_hours() {
        let mut attendance = Attendance::new(None, Some(10.0));
        let mut busy = 0;
        let mut look = |foreign: u64| {
            busy += foreign;
            attendance.look(at(0, Some(Ticks::of_others(busy))))
        };
        assert_eq!([look(0), look(50), look(50)], [None; 3]);
        let rest = look(50).unwrap();
        assert_eq!((rest.reason, rest.until_ms), (RestReason::Busy, None));
    }

    #[tokio::test]
    async fn without_rules_there_is_no_rest() {
        let receiver = Attendance::new(None, None).begin();
        assert_eq!(*receiver.borrow(), None);
    }

    #[test]
    fn local_time_is_ahead_by_less_than_a_day() {
        assert!(local_ahead(MONDAY).abs() <= 14 * 60);
    }
}
