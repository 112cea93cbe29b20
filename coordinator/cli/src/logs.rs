//! `photonfarm logs`: what happened to a job.

use crate::client::Client;
use crate::farm_args::FarmArgs;
use crate::say;
use anyhow::Result;
use chrono::{DateTime, SecondsFormat};
use clap::Args;
use photonfarm_proto::api::JobLogEntry;
use photonfarm_proto::id::JobId;

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm logs 7
      When job 7 was submitted, began, failed at which iteration on which worker and why, what its noise
      was at checkpoints, what people changed, and how it ended.
  photonfarm logs 7 --json | jq -r '.[] | select(.text | contains(\"failed\")) | .at'

Submission, failed attempts and the end are kept for as long as the job is. The rest is what the
coordinator remembers since its start, up to 200 lines for a job. Times are UTC.";

#[derive(Debug, Args)]
pub(crate) struct LogsArgs {
    /// Number of the job
    #[arg(value_name = "JOB")]
    job: JobId,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    farm: FarmArgs,
}

/// Runs the command.
pub(crate) fn run(args: LogsArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(async {
        let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
        client.connect().await?;
        let log = client.job_log(args.job).await?;
        match args.json {
            true => say::json(&log.entries),
            false => log.entries.iter().try_for_each(|entry| say::line(line(entry))),
        }
    })
}

fn line(entry: &JobLogEntry) -> String {
    let time = i64::try_from(entry.at_ms)
        .ok()
        .and_then(DateTime::from_timestamp_millis);
    let time = time.map(|time| time.to_rfc3339_opts(SecondsFormat::Secs, true));
    let text: String = entry
        .text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    format!("{}  {text}", time.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_lines_with_their_time() {
        let entry = JobLogEntry {
            at_ms: 784_111_777_123,
            text: "it failed:\nfor a reason".into(),
        };
        assert_eq!(line(&entry), "1994-11-06T08:49:37Z  it failed: for a reason");
    }
}
