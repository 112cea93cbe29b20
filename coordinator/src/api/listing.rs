//! What the query of a list of jobs asks for.

use crate::service::{PAGE, read_cursor};
use crate::store::JobFilter;
use photonfarm_proto::api::ListedState;
use photonfarm_proto::job::{LABEL_BYTES, NAME_BYTES};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::time;

/// Most labels that are asked for at once.
const LABELS: usize = 8;
/// Longest name of an owner [bytes].
const OWNER_BYTES: usize = 200;

/// Which jobs come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, utoipa::ToSchema)]
#[schema(rename_all = "lowercase")]
pub(super) enum JobOrder {
    /// The last that was submitted.
    Newest,
    /// The first that was submitted.
    Oldest,
}

impl JobOrder {
    const ALL: [(&'static str, Self); 2] = [("newest", Self::Newest), ("oldest", Self::Oldest)];
}

/// Which jobs are asked for, and how many of them.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Listing {
    pub(super) filter: JobFilter,
    pub(super) limit: Option<u32>,
}

impl Listing {
    /// Reads the parameters.
    ///
    /// # Errors
    /// The first parameter that there is not, that is given twice, or that has a value which cannot be.
    pub(super) fn read(given: Vec<(String, String)>) -> Result<Self, Problem> {
        let mut listing = Self::default();
        let (mut order, mut cursor) = (None, None);
        for (name, value) in given {
            let filter = &mut listing.filter;
            match name.as_str() {
                "state" => _ = filter.states.insert(one_of("state", &value, &ListedState::ALL)?),
                "label" => filter.labels.push(label(&value, filter.labels.len())?),
                "owner" => once("owner", &mut filter.owner, short("owner", value, OWNER_BYTES)?)?,
                "name" => once("name", &mut filter.name, short("name", value, NAME_BYTES)?)?,
                "created_after" => once(
                    "created_after",
                    &mut filter.created_after,
                    moment("created_after", &value)?,
                )?,
                "created_before" => {
                    once(
                        "created_before",
                        &mut filter.created_before,
                        moment("created_before", &value)?,
                    )?;
                }
                "order" => once("order", &mut order, one_of("order", &value, &JobOrder::ALL)?)?,
                "limit" => once("limit", &mut listing.limit, limit(&value)?)?,
                "cursor" => once("cursor", &mut cursor, value)?,
                _ => return Err(malformed(&name, "there is no such parameter")),
            }
        }
        listing.filter.oldest_first = order == Some(JobOrder::Oldest);
        let cursor = cursor.map(|cursor| read_cursor(&cursor, listing.filter.oldest_first));
        listing.filter.behind = cursor.transpose()?;
        Ok(listing)
    }
}

fn malformed(parameter: &str, reason: &str) -> Problem {
    Problem::new(ErrorCode::Malformed, format!("{parameter}: {reason}")).at(parameter, None)
}

fn invalid(parameter: &str, reason: &str) -> Problem {
    Problem::new(ErrorCode::Invalid, format!("{parameter}: {reason}")).at(parameter, None)
}

fn once<T>(parameter: &str, place: &mut Option<T>, value: T) -> Result<(), Problem> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err(malformed(parameter, "it is given twice")),
    }
}

fn one_of<T: Copy>(parameter: &str, text: &str, known: &[(&str, T)]) -> Result<T, Problem> {
    let found = known.iter().find(|(name, _)| *name == text);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
        invalid(parameter, &format!("expected one of {}", names.join(", ")))
    })
}

fn short(parameter: &str, text: String, most: usize) -> Result<String, Problem> {
    match text.len() <= most {
        true => Ok(text),
        false => Err(invalid(
            parameter,
            &format!("{} bytes, more than the limit of {most}", text.len()),
        )),
    }
}

fn label(text: &str, before: usize) -> Result<(String, Option<String>), Problem> {
    if before >= LABELS {
        return Err(invalid("label", &format!("more than {LABELS} labels are asked for")));
    }
    let (name, value) = match text.split_once('=') {
        Some((name, value)) => (name, Some(value)),
        None => (text, None),
    };
    match !name.is_empty() && name.len() <= LABEL_BYTES && value.is_none_or(|value| value.len() <= LABEL_BYTES) {
        true => Ok((name.to_owned(), value.map(str::to_owned))),
        false => Err(invalid(
            "label",
            &format!("expected NAME=VALUE or NAME, each of at most {LABEL_BYTES} bytes"),
        )),
    }
}

fn moment(parameter: &str, text: &str) -> Result<u64, Problem> {
    let expected = "expected a time of RFC 3339 since 1970, such as 2026-03-14T09:26:53Z";
    time::parsed(text).ok_or_else(|| invalid(parameter, expected))
}

fn limit(text: &str) -> Result<u32, Problem> {
    let limit = text.parse().map_err(|_| malformed("limit", "expected a number"))?;
    page_limit(limit, "jobs")
}

/// Checks how many of something are asked for on a page.
pub(super) fn page_limit(limit: u32, what: &str) -> Result<u32, Problem> {
    match (1..=PAGE).contains(&limit) {
        true => Ok(limit),
        false => Err(invalid("limit", &format!("a page has 1 to {PAGE} {what}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::id::JobId;

    fn read(given: &[(&str, &str)]) -> Result<Listing, Problem> {
        Listing::read(
            given
                .iter()
                .map(|(name, value)| ((*name).into(), (*value).into()))
                .collect(),
        )
    }

    #[test]
    fn parameters_make_a_filter() {
        assert_eq!(read(&[]).unwrap(), Listing::default());
        let listing = read(&[
            ("state", "done"),
            ("state", "paused"),
            ("label", "shot=a=b"),
            ("label", "draft"),
            ("owner", "ann"),
            ("name", "x"),
            ("created_after", "1970-01-01T01:00:01+01:00"),
            ("created_before", "1970-01-01T00:00:02Z"),
            ("order", "oldest"),
            ("cursor", "o7"),
            ("limit", "100"),
        ]);
        let filter = JobFilter {
            states: [ListedState::Done, ListedState::Paused].into(),
            owner: Some("ann".into()),
            labels: vec![("shot".into(), Some("a=b".into())), ("draft".into(), None)],
            name: Some("x".into()),
            created_after: Some(1000),
            created_before: Some(2000),
            oldest_first: true,
            behind: Some(JobId(7)),
        };
        let limit = Some(100);
        assert_eq!(listing.unwrap(), Listing { filter, limit });
    }

    #[test]
    fn what_cannot_be_is_refused_by_the_name_of_its_parameter() {
        let long = "x".repeat(201);
        let (bad, malformed) = (ErrorCode::Invalid, ErrorCode::Malformed);
        for (name, value, code, reason) in [
            ("state", "ended", bad, "queued, running, paused, done"),
            ("order", "random", bad, "newest, oldest"),
            ("owner", &long, bad, "limit of 200"),
            ("name", &long, bad, "limit of 200"),
            ("label", "=x", bad, "NAME=VALUE"),
            ("label", &long, bad, "200 bytes"),
            ("created_after", "yesterday", bad, "RFC 3339"),
            ("created_before", "1960-01-01T00:00:00Z", bad, "since 1970"),
            ("limit", "0", bad, "1 to 100"),
            ("limit", "101", bad, "1 to 100"),
            ("limit", "-1", malformed, "a number"),
            ("cursor", "7", malformed, "not one that this service gave"),
            ("cursor", "o7", malformed, "in the other order"),
            ("colour", "red", malformed, "no such parameter"),
        ] {
            let problem = read(&[(name, value)]).unwrap_err();
            assert_eq!(
                (problem.code, problem.field.as_deref()),
                (code, Some(name)),
                "{problem}"
            );
            assert!(problem.detail.contains(reason), "{problem}");
        }
        let twice = read(&[("owner", "a"), ("owner", "b")]).unwrap_err();
        assert!(twice.detail.contains("twice"), "{twice}");
        assert_eq!(
            read(&[("label", "a"); 9]).unwrap_err().detail,
            "label: more than 8 labels are asked for"
        );
    }
}
