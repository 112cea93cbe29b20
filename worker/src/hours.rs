//! The hours that a worker works in.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Most entries of a list of hours.
const ENTRIES: usize = 32;
/// Names of days, as they are written.
const DAYS: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
/// Minutes of a day.
const DAY: u32 = 24 * 60;
/// Minutes in which the hours change, if they ever do: a week, and a day for clocks that are put forward or back.
const LONGEST: u64 = 8 * DAY as u64;

/// Text that says no hours.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{part:?}: {reason}")]
pub struct HoursError {
    /// What of the text is wrong.
    part: String,
    /// Why.
    reason: String,
}

fn wrong(part: &str, reason: impl Into<String>) -> HoursError {
    HoursError {
        part: part.to_owned(),
        reason: reason.into(),
    }
}

/// Some days, and the time of these.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Entry {
    /// From Monday on.
    days: [bool; 7],
    /// Minutes since midnight; an end that is not later than the beginning is on the day after.
    from: u32,
    to: u32,
}

/// Hours of a week, in local time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hours {
    entries: Vec<Entry>,
    text: String,
}

impl fmt::Display for Hours {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Hours {
    type Err = HoursError;

    /// Reads a list such as `mon-fri 19:00-07:00, sat-sun 00:00-24:00`.
    fn from_str(text: &str) -> Result<Self, HoursError> {
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        if parts.len() > ENTRIES {
            return Err(wrong(text, format!("{} entries, more than {ENTRIES}", parts.len())));
        }
        Ok(Self {
            entries: parts.into_iter().map(entry).collect::<Result<_, _>>()?,
            text: text.to_owned(),
        })
    }
}

fn entry(part: &str) -> Result<Entry, HoursError> {
    let words: Vec<&str> = part.split_whitespace().collect();
    let [days, times] = words[..] else {
        return Err(wrong(part, "expected days and a time, such as mon-fri 19:00-07:00"));
    };
    let (first, last) = days.split_once('-').unwrap_or((days, days));
    let (first, last) = (day(first)?, day(last)?);
    let length = (last + 7 - first) % 7;
    let within = |day: usize| (day + 7 - first) % 7 <= length;
    let (from, to) = times
        .split_once('-')
        .ok_or_else(|| wrong(times, "expected a time such as 19:00-07:00"))?;
    let (from, to) = (time(from)?, time(to)?);
    if from == to || from == DAY {
        let reason = "it has no length, or begins at 24:00: the whole day is 00:00-24:00";
        return Err(wrong(times, reason));
    }
    Ok(Entry {
        days: std::array::from_fn(within),
        from,
        to,
    })
}

fn day(text: &str) -> Result<usize, HoursError> {
    let found = DAYS.iter().position(|name| text.eq_ignore_ascii_case(name));
    found.ok_or_else(|| wrong(text, format!("it is no day: {}", DAYS.join(", "))))
}

/// Minutes since midnight.
fn time(text: &str) -> Result<u32, HoursError> {
    let digits = |text: &str| match text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_digit()) {
        true => text.parse::<u32>().ok(),
        false => None,
    };
    let parts = text.split_once(':');
    let parsed = parts.and_then(|(hours, minutes)| Some((digits(hours)?, digits(minutes)?)));
    let minutes = parsed.filter(|(_, minutes)| *minutes < 60).map(|(h, m)| 60 * h + m);
    let within = minutes.filter(|minutes| *minutes <= DAY);
    within.ok_or_else(|| wrong(text, "it is no time: 00:00 to 24:00"))
}

impl Hours {
    /// Whether a minute of the week lies within them. Days count from Monday, minutes from midnight.
    fn hold_at(&self, day: usize, minute: u32) -> bool {
        let before = (day + 6) % 7;
        self.entries.iter().any(|entry| match entry.from < entry.to {
            true => entry.days[day] && (entry.from..entry.to).contains(&minute),
            false => entry.days[day] && minute >= entry.from || entry.days[before] && minute < entry.to,
        })
    }

    /// Whether a time [minutes since 1970, UTC] lies within them, where local time is ahead of UTC by so many minutes at
    /// any such time. An hour that is left out as clocks are put forward is not there; one that is there twice as they are
    /// put back counts twice.
    #[must_use]
    pub fn are_at(&self, minute: u64, ahead: impl Fn(u64) -> i64) -> bool {
        let local = minute.saturating_add_signed(ahead(minute));
        // The first day of 1970 was a Thursday.
        let day = (local / u64::from(DAY) + 3) % 7;
        self.hold_at(day as usize, (local % u64::from(DAY)) as u32)
    }

    /// When they begin next after a time outside of them [minutes since 1970, UTC].
    #[must_use]
    pub fn next(&self, minute: u64, ahead: impl Fn(u64) -> i64) -> Option<u64> {
        (minute..=minute + LONGEST).find(|later| self.are_at(*later, &ahead))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Monday, 30 November 2026, 00:00 UTC.
    const MONDAY: u64 = 29_933_280;

    fn hours(text: &str) -> Hours {
        text.parse().unwrap()
    }

    fn refused(text: &str) -> String {
        text.parse::<Hours>().unwrap_err().to_string()
    }

    /// Minutes since [`MONDAY`] at which hours begin or end in a week, at UTC.
    fn changes(hours: &Hours) -> Vec<(u64, bool)> {
        let at = |minute: u64| hours.are_at(MONDAY + minute, |_| 0);
        let week = 1..7 * u64::from(DAY);
        week.filter(|minute| at(*minute) != at(minute - 1))
            .map(|minute| (minute, at(minute)))
            .collect()
    }

    #[test]
    fn nights_and_weekends_are_understood() {
        let found = changes(&hours("mon-fri 19:00-07:00, sat-sun 00:00-24:00"));
        let expected: Vec<(u64, bool)> = (0..5)
            .flat_map(|day| [(day * 1440 + 7 * 60, false), (day * 1440 + 19 * 60, true)])
            .collect();
        // Monday begins outside, since the night before was a Sunday's, which ends at midnight.
        assert_eq!(found, expected[1..], "{found:?}");
        assert_eq!(
            changes(&hours("sun-mon 00:00-24:00")),
            [(1440, false), (6 * 1440, true)]
        );
        assert_eq!(changes(&hours("MON-SUN 00:00-24:00")), []);
        assert_eq!(
            changes(&hours("sun 22:00-02:30")),
            [(150, false), (6 * 1440 + 22 * 60, true)]
        );
    }

    #[test]
    fn what_says_no_hours_is_refused_by_the_part_that_is_wrong() {
        assert!(refused("").contains("expected days and a time"));
        assert!(refused("mon-fri 19:00-07:00,").contains("expected days and a time"));
        assert!(refused("mon-fry 19:00-07:00").contains("\"fry\": it is no day: mon, tue"));
        assert!(refused("mon 19:00").contains("\"19:00\": expected a time such as"));
        for bad in ["7:00", "24:01", "12:60", "1200", "ab:cd", "-1:00", "+1:00"] {
            let text = format!("mon {bad}-23:00");
            assert!(text.parse::<Hours>().is_err(), "{text}");
        }
        assert!(refused("mon 25:00-23:00").contains("\"25:00\": it is no time"));
        assert!(refused("mon 08:00-08:00").contains("no length"));
        assert!(refused("mon 24:00-08:00").contains("begins at 24:00"));
        assert!(refused(&vec!["mon 08:00-09:00"; 33].join(",")).contains("33 entries"));
    }

    #[test]
    fn the_next_hours_are_found_in_local_time() {
        let nights = hours("mon-fri 19:00-07:00");
        assert_eq!(nights.next(MONDAY + 600, |_| 0), Some(MONDAY + 19 * 60));
        assert_eq!(nights.next(MONDAY + 600, |_| 120), Some(MONDAY + 17 * 60));
        assert_eq!(nights.next(MONDAY + 600, |_| -330), Some(MONDAY + 19 * 60 + 330));
        let sunday = MONDAY + 6 * 1440;
        assert_eq!(nights.next(sunday, |_| 0), Some(MONDAY + 7 * 1440 + 19 * 60));
    }

    /// Clocks in Berlin are put from 02:00 to 03:00 at 01:00 UTC in spring, and from 03:00 to 02:00 at 01:00 UTC in autumn.
    #[test]
    fn clocks_that_are_put_forward_and_back_are_followed() {
        let sunday = MONDAY + 6 * 1440;
        let spring = |minute: u64| if minute < sunday + 60 { 60 } else { 120 };
        let autumn = |minute: u64| if minute < sunday + 60 { 120 } else { 60 };
        let open = |text: &str, ahead: &dyn Fn(u64) -> i64| {
            let hours = hours(text);
            let day = sunday - 180..sunday + 360;
            day.filter(|minute| hours.are_at(*minute, ahead)).count()
        };
        assert_eq!(open("sun 01:00-04:00", &spring), 120);
        assert_eq!(open("sun 01:00-04:00", &autumn), 240);
        assert_eq!(open("sun 02:00-03:00", &spring), 0, "there is no such hour");
        assert_eq!(open("sun 02:00-03:00", &autumn), 120, "it is there twice");
        let missed = hours("sun 02:00-03:00");
        let next = missed.next(sunday, spring).unwrap();
        assert_eq!(
            next,
            sunday + 7 * 1440,
            "02:00 of the next Sunday, two hours ahead of UTC"
        );
    }
}
