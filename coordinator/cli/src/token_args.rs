//! The command line of tokens.

use crate::args::positive;
use crate::farm_args::CredentialArgs;
use clap::{Args, Subcommand, ValueEnum};
use photonfarm_coordinator::store::StatePlace;
use photonfarm_proto::token::Role;
use std::path::PathBuf;

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
