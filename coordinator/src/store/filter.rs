//! Which jobs are listed, and in which order.

use super::StoreError;
use super::sql::{Statement, Value, integer, json, small};
use crate::scheduler::record::Millis;
use photonfarm_proto::api::ListedState;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use std::collections::BTreeSet;

/// Which jobs are listed, and in which order. What is not said admits all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JobFilter {
    /// Jobs of one of these states; of any if there are none.
    pub states: BTreeSet<ListedState>,
    /// Jobs that were submitted with the token of this name.
    pub owner: Option<String>,
    /// Jobs that have all these labels: of any value where none is given.
    pub labels: Vec<(String, Option<String>)>,
    /// Jobs whose name, or the name of whose scene file if they have none, has this in it.
    pub name: Option<String>,
    /// Jobs that were submitted after this time.
    pub created_after: Option<Millis>,
    /// Jobs that were submitted before this time.
    pub created_before: Option<Millis>,
    /// Whether the oldest come first.
    pub oldest_first: bool,
    /// Jobs behind this one, in that order.
    pub behind: Option<JobId>,
}

/// Whether a job is paused; texts within the JSON have a backslash before each quotation mark.
const PAUSED: &str = "coalesce(control, spec) LIKE '%\"paused\":true%'";

/// Conditions of a query, with their parameters.
#[derive(Default)]
struct Conditions {
    all: Vec<String>,
    values: Vec<Value>,
}

impl Conditions {
    /// A parameter as it is written.
    fn value(&mut self, value: Value) -> String {
        self.values.push(value);
        format!("?{}", self.values.len())
    }

    fn state(&mut self, state: ListedState) -> Result<String, StoreError> {
        let (state, goes_on) = match state {
            ListedState::Paused => return Ok(format!("ended_ms IS NULL AND {PAUSED}")),
            ListedState::Queued => (JobState::Queued, true),
            ListedState::Running => (JobState::Running, true),
            ListedState::Done => (JobState::Done, false),
            ListedState::Failed => (JobState::Failed, false),
            ListedState::Cancelled => (JobState::Cancelled, false),
        };
        let state = self.value(json(&state)?);
        Ok(match goes_on {
            true => format!("state = {state} AND NOT {PAUSED}"),
            false => format!("state = {state}"),
        })
    }
}

impl JobFilter {
    /// The query for these columns of up to `limit` jobs.
    pub(super) fn query(&self, columns: &str, limit: u32) -> Result<Statement, StoreError> {
        let mut only = Conditions::default();
        if !self.states.is_empty() {
            let states = self.states.iter().map(|state| Ok(format!("({})", only.state(*state)?)));
            let states = states.collect::<Result<Vec<_>, StoreError>>()?.join(" OR ");
            only.all.push(format!("({states})"));
        }
        if let Some(owner) = &self.owner {
            let owner = only.value(Value::Text(owner.clone()));
            only.all.push(format!("owner = {owner}"));
        }
        for (name, value) in &self.labels {
            let name = only.value(Value::Text(name.clone()));
            let value = value.as_ref().map(|value| only.value(Value::Text(value.clone())));
            let valued = value.map_or(String::new(), |value| format!(" AND value = {value}"));
            only.all
                .push(format!("id IN (SELECT job FROM label WHERE name = {name}{valued})"));
        }
        if let Some(name) = self.name.as_ref().filter(|name| !name.is_empty()) {
            let name = only.value(Value::Text(name.clone()));
            // What can be taken out of a text is in it: so every SQL database says.
            only.all.push(format!("replace(title, {name}, '') <> title"));
        }
        for (time, comparison) in [(self.created_after, ">"), (self.created_before, "<")] {
            if let Some(time) = time {
                let time = only.value(integer(time)?);
                only.all.push(format!("created_ms {comparison} {time}"));
            }
        }
        let (order, comparison) = if self.oldest_first { ("ASC", ">") } else { ("DESC", "<") };
        // Numbers beyond all that are kept have nothing behind them, or everything.
        let behind = self.behind.map(|behind| i64::try_from(behind.0).unwrap_or(i64::MAX));
        if let Some(behind) = behind {
            let behind = only.value(Value::Integer(behind));
            only.all.push(format!("id {comparison} {behind}"));
        }
        let limit = only.value(small(limit));
        let only_if = if only.all.is_empty() { "" } else { "WHERE " };
        let conditions = only.all.join(" AND ");
        let sql = format!("SELECT {columns} FROM job {only_if}{conditions} ORDER BY id {order} LIMIT {limit}");
        Ok(Statement::new(sql, only.values))
    }
}
