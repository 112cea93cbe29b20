//! `photonfarm watch`: a job as it goes on, until it ends.

use crate::client::Client;
use crate::farm_args::FarmArgs;
use crate::show::ShowArgs;
use crate::{say, steer, submit};
use anyhow::Result;
use clap::Args;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm watch 7
      Shows a bar with iterations, bandwidths, noise and time left until job 7 ends, then its line
      as `jobs` has it. Ctrl-C stops watching; the job goes on.
  photonfarm watch 7 --json | jq --unbuffered .iterations_done
      For programs: the job's status as a line of JSON whenever it changes.
  photonfarm watch 7 --show
      Shows the picture in the terminal at the end, where that can show pictures.

It ends with 0 if the job is done, 3 if it failed and 4 if it was cancelled, as `wait` does.
`wait` takes several jobs and fetches a picture.";

#[derive(Debug, Args)]
pub(crate) struct WatchArgs {
    /// Number of the job
    #[arg(value_name = "JOB")]
    job: JobId,
    /// Print the job's status as a line of JSON whenever it changes
    #[arg(long, conflicts_with = "show")]
    json: bool,
    #[command(flatten)]
    show: ShowArgs,
    #[command(flatten)]
    farm: FarmArgs,
}

/// Runs the command.
pub(crate) fn run(args: WatchArgs) -> Result<()> {
    let screen = args.show.screen()?;
    tokio::runtime::Runtime::new()?.block_on(async {
        let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
        client.connect().await?;
        let asked = client.status(args.job).await?;
        let watched = async {
            match args.json {
                true => {
                    let tell = |status: &JobStatus| say::line(serde_json::to_string(status)?);
                    client.follow(args.job, tell).await
                }
                false => submit::follow_to_end(&client, &asked, true).await,
            }
        };
        let status = tokio::select! {
            status = watched => status?,
            signal = tokio::signal::ctrl_c() => {
                signal?;
                say::tell(format_args!("interrupted; job {} goes on", args.job));
                return Err(crate::Interrupted.into());
            }
        };
        if !args.json {
            steer::show(&status, false)?;
        }
        if let Some(screen) = screen.filter(|_| status.iterations_done > 0) {
            screen.show(&client.image(status.id, "png").await?)?;
        }
        submit::ended_well(status).map(drop)
    })
}
