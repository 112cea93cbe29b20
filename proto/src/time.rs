//! Times in JSON: RFC 3339 outside (`2026-03-14T09:26:53.589Z`), milliseconds since 1970 inside.
//!
//! Milliseconds are read as well: farms of earlier versions kept them.

use chrono::{DateTime, SecondsFormat};
use serde::de::{Error, Visitor};
use serde::{Deserializer, Serializer};
use std::fmt;

/// The last millisecond of the year 9999, which is the last with four digits.
const LATEST: u64 = 253_402_300_799_999;

/// A time [milliseconds since 1970, UTC] as RFC 3339 has it. Times beyond the year 9999 are its last millisecond.
#[must_use]
pub fn rfc3339(at_ms: u64) -> String {
    let time = DateTime::from_timestamp_millis(at_ms.min(LATEST) as i64).unwrap_or_default();
    time.to_rfc3339_opts(SecondsFormat::Millis, true)
}

/// Milliseconds since 1970 of a time of RFC 3339, in any time zone; nothing for another text, or a time before 1970.
#[must_use]
pub fn parsed(text: &str) -> Option<u64> {
    let time = DateTime::parse_from_rfc3339(text).ok()?;
    u64::try_from(time.timestamp_millis()).ok()
}

/// For `#[serde(with)]`.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer>(at_ms: &u64, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&rfc3339(*at_ms))
}

/// For `#[serde(with)]`.
///
/// # Errors
/// Neither a time of RFC 3339 nor a number of milliseconds.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    deserializer.deserialize_any(TimeVisitor)
}

struct TimeVisitor;

impl Visitor<'_> for TimeVisitor {
    type Value = u64;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a time of RFC 3339 since 1970, such as 2026-03-14T09:26:53Z")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<u64, E> {
        parsed(text).ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(text), &self))
    }

    fn visit_u64<E: Error>(self, at_ms: u64) -> Result<u64, E> {
        Ok(at_ms)
    }
}

/// The same for times that may be absent.
pub mod option {
    use serde::{Deserialize, Deserializer, Serializer};

    #[derive(Deserialize)]
    struct Time(#[serde(with = "super")] u64);

    /// For `#[serde(with)]`.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(at_ms: &Option<u64>, serializer: S) -> Result<S::Ok, S::Error> {
        match at_ms {
            Some(at_ms) => serializer.serialize_some(&super::rfc3339(*at_ms)),
            None => serializer.serialize_none(),
        }
    }

    /// For `#[serde(with)]`.
    ///
    /// # Errors
    /// As [`super::deserialize`].
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
        Ok(Option::<Time>::deserialize(deserializer)?.map(|time| time.0))
    }
}

#[cfg(test)]
mod tests {
    use crate::schedule::Schedule;
    use serde_json::json;

    #[test]
    fn times_are_told_by_rfc_3339_and_read_in_any_zone() {
        let read = |deadline: serde_json::Value| serde_json::from_value::<Schedule>(json!({ "deadline": deadline }));
        let noon = 1_773_489_600_123;
        for written in [
            json!("2026-03-14T12:00:00.123Z"),
            json!("2026-03-14T13:00:00.123+01:00"),
            json!(noon),
        ] {
            let schedule = read(written).unwrap();
            assert_eq!(schedule.deadline_ms, Some(noon));
            assert_eq!(
                serde_json::to_value(&schedule).unwrap()["deadline"],
                "2026-03-14T12:00:00.123Z"
            );
        }
        assert_eq!(read(json!(null)).unwrap().deadline_ms, None);
        for wrong in [
            json!("soon"),
            json!("1969-12-31T23:59:59Z"),
            json!(-1),
            json!(1.5),
            json!([]),
        ] {
            let error = read(wrong.clone()).unwrap_err().to_string();
            assert!(error.contains("RFC 3339"), "{wrong}: {error}");
        }
        assert_eq!(super::rfc3339(u64::MAX), "9999-12-31T23:59:59.999Z");
        let old = serde_json::from_value::<Schedule>(json!({ "deadline_ms": noon })).unwrap();
        assert_eq!(old.deadline_ms, Some(noon));
    }
}
