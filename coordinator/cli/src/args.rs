//! The command line as typed.

use crate::compare::{self, CompareArgs};
use crate::converge::{self, ConvergeArgs};
use crate::doctor::{self, DoctorArgs};
use crate::farm_args::FarmArgs;
use crate::frames::{Frames, frames};
use crate::help;
use crate::input::SceneFormat;
use crate::logs::{self, LogsArgs};
use crate::mix::{self, MixArgs};
use crate::serve_args::ServeArgs;
use crate::show::ShowArgs;
use crate::steer_args::{
    DeleteArgs, DrainArgs, ExtendArgs, FetchArgs, JobArg, JobsArgs, PriorityArgs, ScheduleArgs, WaitArgs, WorkersArgs,
    duration,
};
use crate::token_args::TokenArgs;
use crate::watch::{self, WatchArgs};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use photonfarm_coordinator::store::{BlobPlace, StatePlace};
use photonfarm_core::film::Window;
use photonfarm_core::integrator::{INTEGRATORS, Integrator};
use photonfarm_core::settings::reference;
use photonfarm_proto::id::JobId;
use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::time::Duration;

/// Longest name of a submission, which the farm takes as an idempotency key.
const KEY_BYTES: usize = 255;

/// Renders scenes by photon mapping, alone or on a farm of machines. Of an option that is given twice the last one counts
#[derive(Debug, Parser)]
#[command(name = "photonfarm", version, after_help = help::EXIT_CODES, arg_required_else_help = true, args_override_self = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Render a scene on this machine
    #[command(after_help = help::RENDER)]
    Render(RenderArgs),
    /// Load a scene and say what it holds, how it would be rendered, and what of it is not rendered as it is written
    #[command(after_help = help::CHECK)]
    Check(CheckArgs),
    /// Say how far two pictures are from each other: MSE, relMSE, SSIM, and where
    #[command(after_help = compare::EXAMPLES)]
    Compare(CompareArgs),
    /// Render a scene and write its error against a reference after 1, 2, 4, ... iterations
    #[command(after_help = converge::EXAMPLES)]
    Converge(ConvergeArgs),
    /// Multiply the light of a picture's lamps, each by its own colour and power
    #[command(after_help = mix::EXAMPLES)]
    Mix(MixArgs),
    /// Run the coordinator of a farm
    #[command(after_help = help::SERVE)]
    Serve(ServeArgs),
    /// Send a scene to a farm
    #[command(after_help = help::SUBMIT)]
    Submit(SubmitArgs),
    /// Wait until jobs of a farm are done, and fetch the picture of one
    #[command(after_help = help::EXIT_CODES)]
    Wait(WaitArgs),
    /// Fetch the picture of a job as it stands, whether or not it is done
    #[command(after_help = help::EXIT_CODES)]
    Fetch(FetchArgs),
    /// Save a farm to a folder, while it runs or not
    #[command(after_help = help::BACKUP)]
    Backup(BackupArgs),
    /// Make, list and revoke tokens: who may use a farm
    #[command(after_help = help::TOKEN)]
    Token(TokenArgs),
    /// List the jobs of a farm, or show one
    #[command(after_help = help::JOBS)]
    Jobs(JobsArgs),
    /// Watch a job as it goes on, until it ends
    #[command(after_help = watch::EXAMPLES)]
    Watch(WatchArgs),
    /// Say what happened to a job, and when
    #[command(after_help = logs::EXAMPLES)]
    Logs(LogsArgs),
    /// Look at a deployment and say what is wrong with it
    #[command(after_help = doctor::EXAMPLES)]
    Doctor(DoctorArgs),
    /// Hand out no new work of a job; what is at work goes on and counts
    Pause(JobArg),
    /// Go on with a job that was paused
    Resume(JobArg),
    /// End a job; what has arrived stays
    Cancel(JobArg),
    /// Delete jobs that have ended, with their pictures; one that goes on is to be cancelled first
    Delete(DeleteArgs),
    /// Submit what a job asks for again, as a new job, and cancel the old one if it goes on: for one that failed, was
    /// cancelled, or is bound to a renderer that no worker has any more. Its deadline is left out
    Resubmit(JobArg),
    /// Give iterations of a job that were given up new attempts; a job that failed goes on then
    Retry(JobArg),
    /// Give a worker no new work: what it holds it finishes, and that counts
    #[command(after_help = help::DRAIN)]
    Drain(DrainArgs),
    /// Ask for more iterations of a job, which may be done already
    Extend(ExtendArgs),
    /// Set the priority of a job
    Priority(PriorityArgs),
    #[command(after_help = help::WORKERS)]
    /// List the workers of a farm, put one into quarantine, or let it out
    Workers(WorkersArgs),
    /// Print what a shell needs to complete commands and options by the tabulator key
    #[command(after_help = help::COMPLETIONS)]
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Write manual pages, one for each command
    Man {
        /// Folder to write them to, such as ~/.local/share/man/man1
        folder: PathBuf,
    },
}

#[derive(Debug, Args)]
pub(crate) struct RenderArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
    /// Picture to write; the PNG beside it has the same name with the extension png. A name that ends in csv asks for a table
    /// in its place
    #[arg(short, long, value_name = "OUT.exr")]
    pub(crate) output: PathBuf,
    /// Table to write beside the picture: a line for each pixel with its row, column, red, green, blue and luminance
    #[arg(long, value_name = "FILE")]
    pub(crate) csv: Option<PathBuf>,
    /// Write the picture as it stands every so many seconds while it is rendered, in place of what is there
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub(crate) preview: Option<f64>,
    /// Threads to render with [default: one per processor]
    #[arg(long, value_name = "T")]
    pub(crate) threads: Option<NonZeroUsize>,
    /// Stop after this time, such as 90s, 30m or 8h, with the iterations that are complete. Time before an interruption counts
    /// where the same command goes on
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pub(crate) within: Option<Duration>,
    /// Stop at the first of 4, 8, 16, ... iterations with at most this noise: mean standard error over mean luminance,
    /// without the hundredth of the pixels with the largest errors
    #[arg(long, value_name = "X", value_parser = positive, conflicts_with = "from")]
    pub(crate) noise_target: Option<f64>,
    #[command(flatten)]
    pub(crate) show: ShowArgs,
    /// Write what the render took as JSON: seconds by phase, light paths, records, rays, peak memory
    #[arg(long, value_name = "FILE")]
    pub(crate) stats: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct BackupArgs {
    /// Folder to save to; made if it is not there, and empty
    #[arg(value_name = "TO")]
    pub(crate) to: PathBuf,
    /// Folder with jobs and images of the farm
    #[arg(long, value_name = "DIR", required_unless_present_all = ["state", "blobs"])]
    pub(crate) data: Option<PathBuf>,
    /// Where jobs are kept: sqlite:PATH [default: farm.sqlite in the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_STATE", hide_env_values = true)]
    pub(crate) state: Option<StatePlace>,
    /// Where scenes and images are kept: file:PATH or s3://BUCKET/PREFIX [default: the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_BLOBS")]
    pub(crate) blobs: Option<BlobPlace>,
}

#[derive(Debug, Args)]
pub(crate) struct SubmitArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
    #[command(flatten)]
    pub(crate) farm: FarmArgs,
    #[command(flatten)]
    pub(crate) schedule: ScheduleArgs,
    /// Name of the job for people [default: that of the scene file, or of its folder where that is `scene`]
    #[arg(long, value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Label of the job, which `jobs --label` finds (repeatable)
    #[arg(long, value_name = "KEY=VALUE", value_parser = pair)]
    pub(crate) label: Vec<(String, String)>,
    /// Begin once this job is done; where that fails or is cancelled, this one is cancelled
    #[arg(long, value_name = "JOB")]
    pub(crate) after: Option<JobId>,
    /// Make a job of each of these frames, such as 1..24 or 1,5,9-12: as --frame of each, with the label frame=N. The picture of
    /// frame 7 is OUT.0007.exr
    #[arg(long, value_name = "FRAMES", value_parser = frames, conflicts_with_all = ["frame", "from"])]
    pub(crate) frames: Option<Frames>,
    /// URL that the farm tells when the job ends, where its operator allows it (docs/WEBHOOKS.md)
    #[arg(long, value_name = "URL")]
    pub(crate) webhook: Option<String>,
    /// Wait until the job is done
    #[arg(long)]
    pub(crate) wait: bool,
    /// Print the job's status as JSON in place of its number: as the farm has taken it, or with --wait as it ended
    #[arg(long)]
    pub(crate) json: bool,
    /// Picture to write when the job is done, with a PNG beside it
    #[arg(short, long, value_name = "OUT.exr", requires = "wait")]
    pub(crate) output: Option<PathBuf>,
    /// Name of this submission: another one with the same name makes no new job, but takes up the one that the first made
    #[arg(long, value_name = "NAME", value_parser = key, conflicts_with = "within")]
    pub(crate) key: Option<String>,
}

/// What can be the name of a submission: a header holds it.
fn key(text: &str) -> Result<String, String> {
    let plain = text.bytes().all(|byte| byte == b' ' || byte.is_ascii_graphic());
    match plain && !text.trim().is_empty() && text.len() <= KEY_BYTES {
        true => Ok(text.to_owned()),
        false => Err(format!("expected 1 to {KEY_BYTES} letters, digits and signs of ASCII")),
    }
}

pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1e9 => Ok(value),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// What to render.
#[derive(Clone, Debug, Args)]
pub(crate) struct JobArgs {
    /// Scene file: Mitsuba's XML of any version, pbrt, or glTF (.gltf, .glb); a folder or an archive (zip, tar, tar.gz) with one in it;
    /// or - for standard input, whose scene may name files of the current folder
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// Format of the scene on standard input [default: as its content shows]
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub(crate) format: Option<SceneFormat>,
    /// How to render [default: the scene's own if it is one of these, else pcf]
    #[arg(long, value_name = "NAME", value_parser = integrator_parser())]
    pub(crate) integrator: Option<&'static Integrator>,
    /// Iterations to average [default: 64; for path, those that take the scene's sample_count]
    #[arg(long, value_name = "N")]
    pub(crate) iterations: Option<NonZeroU32>,
    /// Seed of the random numbers
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Give a value to a `<default>` parameter of the scene (repeatable)
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = pair)]
    pub(crate) define: Vec<(String, String)>,
    /// Frame of an animated scene of glTF, whole or between two: the same as -D frame=N
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub(crate) frame: Option<f64>,
    /// Sensor to see the scene through, by its id or its number from 1 [default: the first]
    #[arg(long, value_name = "N|ID")]
    pub(crate) sensor: Option<String>,
    /// A layer of the picture's file (repeatable): alpha, albedo, normal, depth, position, halves (odd and even iterations),
    /// samples, cryptomatte:object, cryptomatte:material, lamp:NAME for the light of one lamp, lamp:A+B for that of several, lamp:* for that of all the others (`check` lists the lamps),
    /// NAME='L S+ D E' for the light along some paths: light, mirrors or glass, a rough surface, eye; docs/LAYERS.md explains them
    #[arg(long, value_name = "NAME")]
    pub(crate) layer: Vec<String>,
    /// Render a window of the picture alone: columns to its left, rows above it, pixels across and down. Its pixels are those of the whole
    /// picture, bit for bit
    #[arg(long, value_name = "X,Y,WxH")]
    pub(crate) crop: Option<Window>,
    #[arg(long, value_name = "NAME=VALUE", value_parser = pair, help = "Set an integrator's setting (repeatable)", long_help = set_help())]
    pub(crate) set: Vec<(String, String)>,
    /// Refuse a scene of which something is left out or replaced, or that is probably not meant so: warnings of the scene are errors
    #[arg(long)]
    pub(crate) strict: bool,
    /// List also what the scene file says and changes nothing in the picture
    #[arg(short, long)]
    pub(crate) verbose: bool,
    /// Repeat this picture of the scene, or go on with a partial one: integrator, settings, iterations, seed and parameters
    /// are those that it names. Refused where scene or renderer are others
    #[arg(long, value_name = "OLD.exr", conflicts_with_all = ["integrator", "iterations", "seed", "define", "frame", "sensor", "layer", "crop", "set"])]
    pub(crate) from: Option<PathBuf>,
}

/// Reads the name of an integrator in the list of all.
fn integrator_parser() -> impl TypedValueParser<Value = &'static Integrator> {
    let names = INTEGRATORS.map(|integrator| PossibleValue::new(integrator.name).help(integrator.summary));
    PossibleValuesParser::new(names).try_map(|name| Integrator::find(&name).ok_or("there is no such integrator"))
}

/// All settings with the integrators that have them, their values and defaults.
fn set_help() -> String {
    let mut text = "Set an integrator's setting (repeatable), by its name in the job's JSON:".to_owned();
    for entry in reference() {
        text += &format!(
            "\n  {} ({}): {}\n      Values: {}\n      Default: {}",
            entry.setting.name,
            entry.integrators(),
            entry.setting.help,
            entry.setting.expected(),
            entry.default()
        );
    }
    text
}

fn pair(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected NAME=VALUE".to_owned()),
    }
}

/// The pairs by name; a name given twice is an error, since one of the values would be lost.
pub(crate) fn unique(option: &str, pairs: &[(String, String)]) -> anyhow::Result<BTreeMap<String, String>> {
    let mut map = BTreeMap::new();
    for (name, value) in pairs {
        if let Some(first) = map.insert(name.clone(), value.clone()) {
            anyhow::bail!("{option} {name} is given twice, as `{first}` and as `{value}`: leave one of them out");
        }
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_last_of_an_option_counts_and_settings_add_up() {
        let line = "photonfarm submit a.xml --coordinator http://a --set x=1 --coordinator http://b --set y=2";
        let Command::Submit(submit) = Cli::try_parse_from(line.split(' ')).unwrap().command else {
            panic!("another command");
        };
        assert_eq!(
            (submit.farm.coordinator.as_str(), submit.job.set.len()),
            ("http://b", 2)
        );
    }

    #[test]
    fn promised_names_are_understood() {
        for line in [
            "photonfarm render s.xml -o o.exr --integrator path --iterations 4 --seed 7 -D a=b -D c=d=e \
             --set samples=2 --set max_depth=-1 --threads 3 --stats s.json",
            "photonfarm render s.xml -o o.exr --within 90s -v",
            "photonfarm render s.xml -o o.exr --csv o.csv",
            "photonfarm render s.xml -o o.exr --from a.exr --threads 2",
            "photonfarm serve --listen 127.0.0.1:0 --data d --log-format json",
            "photonfarm serve --listen [::]:0 --data d --tls-cert c --tls-key k --rate 5 --connections 9 --connections-per-address 3",
            "photonfarm serve --listen 127.0.0.1:0 --data d --keep-days 0.5 --keep-gigabytes 200",
            "photonfarm token create a --role submit --days 0.5 --most-jobs 1 --most-gigabytes 2 --data d",
            "photonfarm token list --coordinator http://localhost:1 --token-file t --ca c",
            "photonfarm token revoke a --data d",
            "photonfarm token list --state postgres://farm@localhost/farm",
            "photonfarm serve --listen 127.0.0.1:0 --data d --verify 10 --lease-seconds 600",
            "photonfarm serve --listen 127.0.0.1:0 --data d --webhook http://a --webhook https://b --webhook-secret-file s --public-url http://c",
            "photonfarm submit s.xml --coordinator http://localhost:1 --webhook https://a/b",
            "photonfarm submit s.xml --coordinator http://localhost:1 --tag a=b --tag c --priority 3 --noise-target 0.1 --within 2h",
            "photonfarm jobs --coordinator http://localhost:1",
            "photonfarm jobs 3 --json --coordinator http://localhost:1",
            "photonfarm jobs --sort left --reverse --watch --coordinator http://localhost:1",
            "photonfarm logs 3 --json --coordinator http://localhost:1",
            "photonfarm doctor --data d --json --coordinator http://localhost:1",
            "photonfarm jobs --label shot=3 --label draft --coordinator http://localhost:1",
            "photonfarm submit s.glb --frames 1..24 --label a=b --label c=d --after 7 --json --coordinator http://localhost:1",
            "photonfarm submit - --format pbrt --coordinator http://localhost:1",
            "photonfarm compare a.exr b.exr --difference d.png --epsilon 0.1 --json",
            "photonfarm converge s.xml --reference r.exr --probe 1,2 --probe 3,4 -o a.csv --plot a.png --within 9s",
            "photonfarm mix a.exr --lamp a=#ffcc88*1.5EV --lamp *=0 -o b.exr",
            "photonfarm watch 3 --json --coordinator http://localhost:1",
            "photonfarm render s.xml --show -o o.exr",
            "photonfarm fetch 3 --show=sixel --coordinator http://localhost:1",
            "photonfarm retry 3 --coordinator http://localhost:1",
            "photonfarm drain 3 --undo --json --coordinator http://localhost:1",
            "photonfarm extend 3 100 --coordinator http://localhost:1",
            "photonfarm priority 3 20 --coordinator http://localhost:1",
            "photonfarm workers --coordinator http://localhost:1",
            "photonfarm workers release 3 --coordinator http://localhost:1",
            "photonfarm workers quarantine 3 --reason broken --coordinator http://localhost:1",
            "photonfarm serve --listen 127.0.0.1:0 --data d --blobs s3://farm/images",
            "photonfarm serve --listen 127.0.0.1:0 --state sqlite:a.sqlite --blobs file:b",
            "photonfarm submit s.xml --coordinator http://localhost:1 --wait -o o.exr --integrator pcf -Dx=1",
        ] {
            Cli::try_parse_from(line.split_whitespace()).unwrap_or_else(|e| panic!("{line}: {e}"));
        }
    }

    #[test]
    fn what_cannot_be_meant_is_refused() {
        for line in [
            "photonfarm render s.xml",
            "photonfarm render s.xml -o o.exr --show=paper",
            "photonfarm fetch 3 --coordinator http://localhost:1",
            "photonfarm render s.xml -o o.exr --iterations 0",
            "photonfarm render s.xml -o o.exr --threads 0",
            "photonfarm render s.xml -o o.exr --integrator magic",
            "photonfarm render s.xml -o o.exr -D name",
            "photonfarm render s.xml -o o.exr --set =1",
            "photonfarm render s.xml -o o.exr --from a.exr --seed 1",
            "photonfarm render s.xml -o o.exr --from a.exr --within 1m",
            "photonfarm submit s.xml --coordinator http://localhost:1 -o o.exr",
            "photonfarm serve --data d",
            "photonfarm submit s.glb --frames 3..1 --coordinator http://localhost:1",
            "photonfarm submit s.glb --frames 1..3 --frame 2 --coordinator http://localhost:1",
            "photonfarm submit s.xml --label shot --coordinator http://localhost:1",
            "photonfarm converge s.xml",
            "photonfarm mix a.exr --lamp a=red -o b.exr",
            "photonfarm jobs 3 --watch --coordinator http://localhost:1",
            "photonfarm serve --listen 127.0.0.1:0 --data d --tls-cert c",
            "photonfarm token create a --data d",
            "photonfarm token create a --role boss --data d",
            "photonfarm token create a --role read --days 0 --data d",
            "photonfarm serve --listen 127.0.0.1:0 --state sqlite:a.sqlite",
            "photonfarm serve --listen 127.0.0.1:0 --data d --blobs http://farm",
            "photonfarm serve --listen 127.0.0.1:0 --data d --keep-days 0",
            "photonfarm serve --listen 127.0.0.1:0 --data d --webhook http://a",
            "photonfarm serve --listen 127.0.0.1:0 --data d --log-format xml",
        ] {
            assert!(Cli::try_parse_from(line.split_whitespace()).is_err(), "{line}");
        }
    }

    #[test]
    fn a_name_given_twice_is_refused() {
        let pairs = [("a".to_owned(), "1".to_owned()), ("a".to_owned(), "2".to_owned())];
        let message = unique("-D", &pairs).unwrap_err().to_string();
        assert!(message.contains("-D a is given twice"), "{message}");
    }
}
