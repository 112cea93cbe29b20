//! The command line as typed.

use crate::farm_args::{CredentialArgs, FarmArgs};
use crate::steer_args::{
    DeleteArgs, ExtendArgs, FetchArgs, JobArg, JobsArgs, PriorityArgs, ScheduleArgs, WaitArgs, WorkersArgs, duration,
};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use photonfarm_coordinator::store::{BlobPlace, StatePlace};
use photonfarm_core::integrator::{INTEGRATORS, Integrator};
use photonfarm_core::settings::reference;
use photonfarm_proto::token::Role;
use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::time::Duration;

/// Longest name of a submission, which the farm takes as an idempotency key.
const KEY_BYTES: usize = 255;

const EXIT_CODES: &str = "\
Exit codes:
  0    done; the picture, if one was asked for, is complete
  1    failed; the message says why, and files are as they were before
  2    the command line cannot be understood
  3    the job failed
  4    the job was cancelled
  5    no coordinator answers
  6    the farm refuses: no such job, a limit, a token without the right
  130  interrupted by Ctrl-C; files are as they were before, and `render` keeps what it has in
       OUT.partial.exr and OUT.partial.farm";

const RENDER_EXAMPLES: &str = "\
Examples:
  photonfarm render scene.xml -o image.exr
      Renders with the scene's own integrator (pcf where it names none of ours)
      and writes image.exr and image.png.
  photonfarm render scene.xml -o image.exr --integrator pppm --iterations 256
      More iterations: less noise and less blur.
  photonfarm render scene.xml -o image.exr --integrator pcf --set photons=1000000 --set theta1=10
      More light paths per iteration, and a narrower first angle.
  photonfarm render scene.xml -o small.exr -D width=320 -D height=240
      Gives values to the scene's <default> parameters.
  photonfarm render scene.xml -o again.exr --from image.exr
      Repeats a picture, bit for bit, with the settings that it names.
  photonfarm render scene.xml -o image.exr --layer albedo --layer normal --layer lamp:key --layer 'lamp:*'
      Layers for a compositor in the same file: what is seen first, and the light of each lamp.
  photonfarm render scene.xml --sensor floor -o lux.csv
      Writes what a meter measures as a table: of a grid on a rectangle a line for each place.
  photonfarm render scene.xml -o image.exr --from image.partial.exr
      Goes on with a render that was interrupted: image.partial.farm holds what it needs. Without
      that folder it begins anew, to the same bits.

image.exr holds linear Rec. 709 radiance in 32-bit floats, a rough standard error of the luminance
in the channel `standard_error`, and everything that repeats the render in its attributes. Noise is
the mean of these errors over the mean luminance, but for the worst hundredth of the pixels.
image.png is for looking at: exposure and highlights follow the global operator of Reinhard et al.
(2002).
The same scene, settings and seed give the same image.exr on any machine, with any --threads.";

const CHECK_EXAMPLES: &str = "\
Examples:
  photonfarm check scene.xml
      Format, picture size, shapes, lights, materials, textures, bounds; the integrator and the
      settings that `render` would take; warnings; the files that a farm would be sent.
  photonfarm check scene.pbrt --strict
      Fails where anything is left out or replaced.
  photonfarm check scene.xml -v
      Lists also what is accepted and changes nothing in the picture.
  photonfarm check scene.glb --json
      The same for programs; a scene that cannot be loaded gives its errors in `errors`.";

const SUBMIT_EXAMPLES: &str = "\
Examples:
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800 --iterations 256 --wait -o image.exr
      Sends the scene to the farm, shows progress, and fetches image.exr and image.png.
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800
      Prints the number of the job and leaves.
  photonfarm wait 7 --coordinator http://127.0.0.1:7800 -o image.exr
      Waits for job 7, whoever submitted it and however long ago, and fetches its picture.
  photonfarm submit scene.xml --key \"nightly $(date +%F)\" --wait -o image.exr
      For scripts that may be run again: the first run of the day makes a job, later ones take it up.

The scene file and every file that it names are sent; what the farm has already is not sent again.
They may lie anywhere on this machine. --wait goes on through restarts of the
coordinator. Interrupting it leaves the job running on the farm, and says how to go on waiting. Each
submission makes a new job, the same scene and settings as well, unless --key says that it is the same
submission: then the scene and all settings must be the same, and the job may have ended since.";

const SERVE_EXAMPLES: &str = "\
Examples:
  photonfarm serve --listen 127.0.0.1:7800 --data farm
  photonfarm-worker --coordinator http://127.0.0.1:7800
  photonfarm submit scene.xml --coordinator http://127.0.0.1:7800 --wait -o image.exr

Everything that the coordinator knows lies in the data folder: stop it or kill it, start it again
with the same folder, and its jobs go on. Port 0 takes a free port; the first line on
standard output says which. RUST_LOG sets how much is logged (warn, info, debug,
photonfarm_coordinator=trace, ...).

--state and --blobs keep jobs and bytes elsewhere; several coordinators share a farm by the same ones.
For s3:// the usual variables AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY apply:
  photonfarm serve --listen 127.0.0.1:7800 --state postgres://farm:PASSWORD@db/farm --blobs s3://renders/farm

A farm without any token is open to whoever can connect, so it listens on this machine only. Once
there is one, every request needs one. To listen for other machines:
  photonfarm token create boss --role admin --data farm > boss.token
  photonfarm serve --listen 0.0.0.0:7800 --data farm --tls-cert farm.pem --tls-key farm.key";

const BACKUP_EXAMPLES: &str = "\
Examples:
  photonfarm backup --data farm /backup/farm-$(date +%F)
      Saves the farm as it stands at an instant while the command runs.
  photonfarm serve --listen 127.0.0.1:7800 --data /backup/farm-2026-11-27
      Serves what was saved; or copy it to where the farm was, while that is stopped.

A farm that was restored notices, and numbers new jobs beyond all that it can have given since the
backup. Jobs in PostgreSQL are saved by PostgreSQL's own means: see docs/FARM.md.";

const TOKEN_EXAMPLES: &str = "\
Examples:
  photonfarm token create boss --role admin --data farm > boss.token
      Makes the first token of a farm that is not running, on its data folder.
  export PHOTONFARM_COORDINATOR=https://farm.example:7800 PHOTONFARM_TOKEN_FILE=boss.token
  photonfarm token create rack --role worker > rack.token
  photonfarm token create ann --role submit --days 90 --most-jobs 20 --most-gigabytes 50 > ann.token
  photonfarm token list
  photonfarm token revoke ann
      Makes, lists and revokes tokens of a running farm.

Roles: read looks at everything; submit also sends scenes and jobs, and steers its own jobs; worker
renders and sees nothing but the files of scenes; admin does everything. The token goes to standard
output, once: the farm keeps only its hash. Jobs of a revoked token go on.";

/// Renders scenes by photon mapping, alone or on a farm of machines. Of an option that is given twice the last one counts
#[derive(Debug, Parser)]
#[command(name = "photonfarm", version, after_help = EXIT_CODES, arg_required_else_help = true, args_override_self = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  photonfarm completions bash > ~/.local/share/bash-completion/completions/photonfarm
  photonfarm completions zsh > ~/.zfunc/_photonfarm
  photonfarm completions fish > ~/.config/fish/completions/photonfarm.fish";

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Render a scene on this machine
    #[command(after_help = RENDER_EXAMPLES)]
    Render(RenderArgs),
    /// Load a scene and say what it holds, how it would be rendered, and what of it is not rendered as it is written
    #[command(after_help = CHECK_EXAMPLES)]
    Check(CheckArgs),
    /// Run the coordinator of a farm
    #[command(after_help = SERVE_EXAMPLES)]
    Serve(ServeArgs),
    /// Send a scene to a farm
    #[command(after_help = SUBMIT_EXAMPLES)]
    Submit(SubmitArgs),
    /// Wait until jobs of a farm are done, and fetch the picture of one
    #[command(after_help = EXIT_CODES)]
    Wait(WaitArgs),
    /// Fetch the picture of a job as it stands, whether or not it is done
    #[command(after_help = EXIT_CODES)]
    Fetch(FetchArgs),
    /// Save a farm to a folder, while it runs or not
    #[command(after_help = BACKUP_EXAMPLES)]
    Backup(BackupArgs),
    /// Make, list and revoke tokens: who may use a farm
    #[command(after_help = TOKEN_EXAMPLES)]
    Token(TokenArgs),
    /// List the jobs of a farm, or show one
    Jobs(JobsArgs),
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
    /// Ask for more iterations of a job, which may be done already
    Extend(ExtendArgs),
    /// Set the priority of a job
    Priority(PriorityArgs),
    /// List the workers of a farm, put one into quarantine, or let it out
    Workers(WorkersArgs),
    /// Print what a shell needs to complete commands and options by the tabulator key
    #[command(after_help = COMPLETIONS_EXAMPLES)]
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
    /// Stop after this time, such as 90s, 30m or 8h, with the iterations that are complete
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pub(crate) within: Option<Duration>,
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
pub(crate) struct ServeArgs {
    /// Address and port to listen on
    #[arg(long, value_name = "ADDR")]
    pub(crate) listen: String,
    /// Folder for jobs and images; made if it is not there
    #[arg(long, value_name = "DIR", required_unless_present_all = ["state", "blobs"])]
    pub(crate) data: Option<PathBuf>,
    /// Where jobs are kept: sqlite:PATH or postgres://USER:PASSWORD@HOST/DATABASE [default: farm.sqlite in the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_STATE", hide_env_values = true)]
    pub(crate) state: Option<StatePlace>,
    /// Where scenes and images are kept: file:PATH or s3://BUCKET/PREFIX [default: the data folder]
    #[arg(long, value_name = "URL", env = "PHOTONFARM_BLOBS")]
    pub(crate) blobs: Option<BlobPlace>,
    /// Certificate for encrypted connections, with those between it and its authority, as PEM
    #[arg(long, value_name = "FILE", requires = "tls_key", env = "PHOTONFARM_TLS_CERT")]
    pub(crate) tls_cert: Option<PathBuf>,
    /// Private key of the certificate, as PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert", env = "PHOTONFARM_TLS_KEY")]
    pub(crate) tls_key: Option<PathBuf>,
    /// Have nodes of a worker repeated by another one until this many in a row are confirmed, and ever more rarely then;
    /// 10 suits machines of strangers, 0 repeats none
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) verify: u32,
    /// How long a lease should take [s]: longer ones bring fewer images to take in, and a killed worker loses more
    #[arg(long, value_name = "S", default_value = "30")]
    pub(crate) lease_seconds: NonZeroU32,
    /// Requests a second that one token may send from one address
    #[arg(long, value_name = "N", default_value = "1000")]
    pub(crate) rate: NonZeroU32,
    /// Connections at once; more wait until one of them ends
    #[arg(long, value_name = "N", default_value = "4096")]
    pub(crate) connections: NonZeroUsize,
    /// Connections at once from one address; more are closed at once. A proxy in front is one address
    #[arg(long, value_name = "N", default_value = "1024")]
    pub(crate) connections_per_address: NonZeroUsize,
    /// Delete jobs that ended more than so many days ago [default: keep them]
    #[arg(long, value_name = "DAYS", value_parser = positive, env = "PHOTONFARM_KEEP_DAYS")]
    pub(crate) keep_days: Option<f64>,
    /// Delete the oldest jobs that have ended where such jobs take more room, with the scenes that only they name
    /// [default: keep them]
    #[arg(long, value_name = "GB", value_parser = positive, env = "PHOTONFARM_KEEP_GIGABYTES")]
    pub(crate) keep_gigabytes: Option<f64>,
    /// Format of the log; RUST_LOG chooses what it tells
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    pub(crate) log_format: LogFormat,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// Lines for people
    Text,
    /// One JSON object a line
    Json,
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
    /// Wait until the job is done
    #[arg(long)]
    pub(crate) wait: bool,
    /// Picture to write when the job is done, with a PNG beside it
    #[arg(short, long, value_name = "OUT.exr", requires = "wait")]
    pub(crate) output: Option<PathBuf>,
    /// Name of this submission: another one with the same name makes no new job, but takes up the one that the first made
    #[arg(long, value_name = "NAME", value_parser = key, conflicts_with = "within")]
    pub(crate) key: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct TokenArgs {
    #[command(subcommand)]
    pub(crate) command: TokenCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TokenCommand {
    /// Make a token; it is printed once
    Create(CreateTokenArgs),
    /// List the tokens: name, role, and what was used of its quotas
    List {
        #[command(flatten)]
        place: TokenPlace,
    },
    /// Revoke a token; its jobs go on
    Revoke {
        /// Name of the token
        name: String,
        #[command(flatten)]
        place: TokenPlace,
    },
}

#[derive(Debug, Args)]
pub(crate) struct CreateTokenArgs {
    /// Name of the token: 1 to 64 letters, digits, `-`, `_` and `.`; its jobs show it as their owner
    pub(crate) name: String,
    /// What the token allows
    #[arg(long, value_enum)]
    pub(crate) role: RoleName,
    /// Days until the token ends [default: it does not]
    #[arg(long, value_name = "D", value_parser = positive)]
    pub(crate) days: Option<f64>,
    /// Most jobs at once [default: no limit]
    #[arg(long, value_name = "N")]
    pub(crate) most_jobs: Option<u64>,
    /// Most gigabytes of scenes, each distinct file once [default: no limit]
    #[arg(long, value_name = "GB", value_parser = positive)]
    pub(crate) most_gigabytes: Option<f64>,
    /// Most iterations of all jobs, ended ones included [default: no limit]
    #[arg(long, value_name = "N")]
    pub(crate) most_iterations: Option<u64>,
    #[command(flatten)]
    pub(crate) place: TokenPlace,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RoleName {
    /// Look at jobs, images, scenes and workers
    Read,
    /// Also send scenes and jobs, and steer the jobs sent with this token
    Submit,
    /// Render
    Worker,
    /// Everything
    Admin,
}

impl From<RoleName> for Role {
    fn from(name: RoleName) -> Self {
        match name {
            RoleName::Read => Self::Read,
            RoleName::Submit => Self::Submit,
            RoleName::Worker => Self::Worker,
            RoleName::Admin => Self::Admin,
        }
    }
}

/// Where tokens are.
#[derive(Debug, Args)]
pub(crate) struct TokenPlace {
    /// Data folder of a farm that is not running
    #[arg(long, value_name = "DIR")]
    pub(crate) data: Option<PathBuf>,
    /// State of a farm, as `serve --state` has it; a database may be in use, a file may not
    #[arg(long, value_name = "URL", env = "PHOTONFARM_STATE", hide_env_values = true)]
    pub(crate) state: Option<StatePlace>,
    /// A running farm's coordinator, such as http://127.0.0.1:7800
    #[arg(long, value_name = "URL", env = "PHOTONFARM_COORDINATOR")]
    pub(crate) coordinator: Option<String>,
    #[command(flatten)]
    pub(crate) credentials: CredentialArgs,
}

/// What can be the name of a submission: a header holds it.
fn key(text: &str) -> Result<String, String> {
    let plain = text.bytes().all(|byte| byte == b' ' || byte.is_ascii_graphic());
    match plain && !text.trim().is_empty() && text.len() <= KEY_BYTES {
        true => Ok(text.to_owned()),
        false => Err(format!("expected 1 to {KEY_BYTES} letters, digits and signs of ASCII")),
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1e9 => Ok(value),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// What to render.
#[derive(Debug, Args)]
pub(crate) struct JobArgs {
    /// Scene file: Mitsuba's XML of any version, pbrt, or glTF (.gltf, .glb)
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// How to render [default: the scene's own if it is one of these, else pcf]
    #[arg(long, value_name = "NAME", value_parser = integrator_parser())]
    pub(crate) integrator: Option<&'static Integrator>,
    /// Iterations to average [default: 64; for path, those that take the scene's sample_count]
    #[arg(long, value_name = "N")]
    pub(crate) iterations: Option<NonZeroU32>,
    /// Seed of the random numbers
    #[arg(long, value_name = "K", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Give a value to a <default> parameter of the scene (repeatable)
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = pair)]
    pub(crate) define: Vec<(String, String)>,
    /// Frame of an animated scene of glTF, whole or between two: the same as -D frame=N
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub(crate) frame: Option<f64>,
    /// Sensor to see the scene through, by its id or its number from 1 [default: the first]
    #[arg(long, value_name = "N|ID")]
    pub(crate) sensor: Option<String>,
    /// A layer of the picture's file (repeatable): alpha, albedo, normal, depth, position, halves (odd and even iterations),
    /// lamp:NAME for the light of one lamp, lamp:A+B for that of several, lamp:* for that of all the others (`check` lists the lamps),
    /// NAME='L S+ D E' for the light along some paths: light, mirrors or glass, a rough surface, eye; docs/LAYERS.md explains them
    #[arg(long, value_name = "NAME")]
    pub(crate) layer: Vec<String>,
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
    #[arg(long, value_name = "OLD.exr", conflicts_with_all = ["integrator", "iterations", "seed", "define", "frame", "sensor", "layer", "set"])]
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
            "photonfarm submit s.xml --coordinator http://localhost:1 --tag a=b --tag c --priority 3 --noise-target 0.1 --within 2h",
            "photonfarm jobs --coordinator http://localhost:1",
            "photonfarm jobs 3 --json --coordinator http://localhost:1",
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
            "photonfarm render s.xml -o o.exr --iterations 0",
            "photonfarm render s.xml -o o.exr --threads 0",
            "photonfarm render s.xml -o o.exr --integrator magic",
            "photonfarm render s.xml -o o.exr -D name",
            "photonfarm render s.xml -o o.exr --set =1",
            "photonfarm render s.xml -o o.exr --from a.exr --seed 1",
            "photonfarm render s.xml -o o.exr --from a.exr --within 1m",
            "photonfarm submit s.xml --coordinator http://localhost:1 -o o.exr",
            "photonfarm serve --data d",
            "photonfarm serve --listen 127.0.0.1:0 --data d --tls-cert c",
            "photonfarm token create a --data d",
            "photonfarm token create a --role boss --data d",
            "photonfarm token create a --role read --days 0 --data d",
            "photonfarm serve --listen 127.0.0.1:0 --state sqlite:a.sqlite",
            "photonfarm serve --listen 127.0.0.1:0 --data d --blobs http://farm",
            "photonfarm serve --listen 127.0.0.1:0 --data d --keep-days 0",
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
