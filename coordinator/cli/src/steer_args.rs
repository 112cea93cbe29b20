//! The command line of what looks at a farm and steers it.

use crate::farm_args::{CredentialArgs, FarmArgs};
use crate::show::ShowArgs;
use anyhow::{Context, Result};
use clap::{Args, Subcommand, ValueEnum};
use photonfarm_proto::id::{JobId, WorkerId};
use photonfarm_proto::schedule::{PRIORITY, Schedule};
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

#[derive(Debug, Args)]
pub(crate) struct JobsArgs {
    /// Number of a job; without it, jobs are listed, newest first
    #[arg(value_name = "JOB")]
    pub(crate) job: Option<JobId>,
    /// Most jobs to list
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) limit: usize,
    /// List jobs of this state only (repeatable)
    #[arg(long, value_name = "STATE", value_parser = ["queued", "running", "paused", "done", "failed", "cancelled"], conflicts_with = "job")]
    pub(crate) state: Vec<String>,
    /// List jobs of this token only
    #[arg(long, value_name = "NAME", conflicts_with = "job")]
    pub(crate) owner: Option<String>,
    /// List jobs only whose name has this in it
    #[arg(long, value_name = "TEXT", conflicts_with = "job")]
    pub(crate) name: Option<String>,
    /// List jobs only that have this label, whatever its value where none is given (repeatable)
    #[arg(long, value_name = "KEY[=VALUE]", conflicts_with = "job")]
    pub(crate) label: Vec<String>,
    /// List them by this; of numbers the largest first, and what is not known last [default: newest first]
    #[arg(long, value_enum, value_name = "FIELD", conflicts_with = "job")]
    pub(crate) sort: Option<SortField>,
    /// List them the other way round
    #[arg(long, conflicts_with = "job")]
    pub(crate) reverse: bool,
    /// List them again and again, until Ctrl-C; where that is no terminal, whenever something has changed
    #[arg(long, conflicts_with = "job")]
    pub(crate) watch: bool,
    /// Print JSON; with --watch a line each time
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

/// What jobs are sorted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SortField {
    /// Name
    Name,
    /// State: what goes on first
    State,
    /// Share of the iterations that are done
    Done,
    /// Time since it was submitted
    Age,
    /// Time until it is done
    Left,
    /// Iterations a second: the slowest job is the last
    Speed,
    /// Workers at it
    Workers,
    /// Priority
    Priority,
    /// Name of the token that it was submitted with
    Owner,
}

impl JobsArgs {
    /// What the farm is asked for.
    pub(crate) fn query(&self) -> Vec<(&'static str, &str)> {
        let states = self.state.iter().map(|state| ("state", state.as_str()));
        let owner = self.owner.iter().map(|owner| ("owner", owner.as_str()));
        let name = self.name.iter().map(|name| ("name", name.as_str()));
        let labels = self.label.iter().map(|label| ("label", label.as_str()));
        states.chain(owner).chain(name).chain(labels).collect()
    }
}

#[derive(Debug, Args)]
pub(crate) struct JobArg {
    /// Number of the job
    #[arg(value_name = "JOB")]
    pub(crate) job: JobId,
    /// Print the job's status as JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

#[derive(Debug, Args)]
pub(crate) struct DrainArgs {
    /// Number of the worker
    #[arg(value_name = "WORKER")]
    pub(crate) worker: WorkerId,
    /// Give it work again
    #[arg(long)]
    pub(crate) undo: bool,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

#[derive(Debug, Args)]
pub(crate) struct DeleteArgs {
    /// Numbers of the jobs
    #[arg(value_name = "JOB", required = true)]
    pub(crate) jobs: Vec<JobId>,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

#[derive(Debug, Args)]
pub(crate) struct WaitArgs {
    /// Numbers of the jobs
    #[arg(value_name = "JOB", required = true)]
    pub(crate) jobs: Vec<JobId>,
    /// Picture to write when the job is done, with a PNG beside it; of one job
    #[arg(short, long, value_name = "OUT.exr")]
    pub(crate) output: Option<PathBuf>,
    /// The farm that has the job, as `submit --wait` and `healthz` name it: another one at the same address is refused
    #[arg(long = "farm", value_name = "FARM")]
    pub(crate) identity: Option<String>,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

#[derive(Debug, Args)]
pub(crate) struct FetchArgs {
    /// Number of the job
    #[arg(value_name = "JOB")]
    pub(crate) job: JobId,
    /// Picture to write, with a PNG beside it
    #[arg(short, long, value_name = "OUT.exr", required_unless_present = "show")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) show: ShowArgs,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
}

#[derive(Debug, Args)]
pub(crate) struct ExtendArgs {
    #[command(flatten)]
    pub(crate) job: JobArg,
    /// Number of iterations from now on
    #[arg(value_name = "N")]
    pub(crate) iterations: NonZeroU32,
}

#[derive(Debug, Args)]
pub(crate) struct PriorityArgs {
    #[command(flatten)]
    pub(crate) job: JobArg,
    /// Weight among the jobs of its owner, from 1 to 100
    #[arg(value_name = "P")]
    pub(crate) priority: u32,
}

#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = false)]
pub(crate) struct WorkersArgs {
    #[command(subcommand)]
    pub(crate) command: Option<WorkersCommand>,
    /// Print JSON
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// The farm's coordinator, such as http://127.0.0.1:7800
    #[arg(long, value_name = "URL", env = "PHOTONFARM_COORDINATOR", global = true)]
    pub(crate) coordinator: Option<String>,
    #[command(flatten)]
    pub(crate) credentials: CredentialArgs,
}

#[derive(Debug, Subcommand)]
pub(crate) enum WorkersCommand {
    /// Give a worker no work, and have its unconfirmed work in jobs that go on done again
    Quarantine {
        /// Number of the worker
        worker: WorkerId,
        /// Why, for people
        #[arg(long, default_value = "by an administrator")]
        reason: String,
    },
    /// Let a worker, and those of its name, out of quarantine
    Release {
        /// Number of the worker
        worker: WorkerId,
    },
}

/// When and where a job is worked on, and when it stops.
#[derive(Debug, Args)]
pub(crate) struct ScheduleArgs {
    /// Weight among the jobs of the same owner, from 1 to 100
    #[arg(long, value_name = "P", default_value_t = PRIORITY)]
    priority: u32,
    /// Tag that a worker must have (repeatable)
    #[arg(long, value_name = "TAG")]
    tag: Vec<String>,
    /// Memory that a worker must have (MiB), until it was measured how much the job takes
    #[arg(long, value_name = "MIB")]
    memory: Option<u32>,
    /// Stop at the first of 4, 8, 16, ... iterations with at most this noise: mean standard error over mean luminance,
    /// without the hundredth of the pixels with the largest errors
    #[arg(long, value_name = "X")]
    noise_target: Option<f64>,
    /// Stop after this time, such as 90s, 30m, 8h or 2d, with the iterations that are complete
    #[arg(long, value_name = "TIME", value_parser = duration)]
    within: Option<Duration>,
}

impl ScheduleArgs {
    /// As the farm wants it.
    pub(crate) fn schedule(&self) -> Result<Schedule> {
        let schedule = Schedule {
            priority: self.priority,
            deadline_ms: self.within.map(deadline).transpose()?,
            noise_target: self.noise_target,
            tags: self.tag.iter().cloned().collect(),
            memory_mb: self.memory,
            ..Schedule::default()
        };
        schedule.check().context("the job cannot be scheduled so")?;
        Ok(schedule)
    }
}

/// When a job ends that is to end so much from now on [milliseconds since 1970, UTC].
pub(crate) fn deadline(within: Duration) -> Result<u64> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
    Ok((now + within).as_millis() as u64)
}

/// A number and a unit: s, m, h or d.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || "expected a time such as 90s, 30m, 8h or 2d".to_owned();
    let unit = text.chars().last().ok_or_else(wrong)?;
    let seconds = match unit {
        's' => 1.0,
        'm' => 60.0,
        'h' => 3_600.0,
        'd' => 86_400.0,
        _ => return Err(wrong()),
    };
    match text[..text.len() - 1].parse::<f64>() {
        Ok(count) if count > 0.0 && count * seconds < 1e10 => Ok(Duration::from_secs_f64(count * seconds)),
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units() {
        let seconds = |text| duration(text).map(|time| time.as_secs_f64());
        assert_eq!(seconds("90s"), Ok(90.0));
        assert_eq!(seconds("1.5h"), Ok(5_400.0));
        assert_eq!(seconds("2d"), Ok(172_800.0));
        for bad in ["", "5", "m", "-1s", "0s", "1e300d", "NaNs", "5é"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }
}
