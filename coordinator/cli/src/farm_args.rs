//! The command line of which farm is meant, and of what is shown to it.

use clap::Args;
use photonfarm_worker::{Credentials, CredentialsError};
use std::path::PathBuf;

/// A running farm.
#[derive(Debug, Args)]
pub(crate) struct FarmArgs {
    /// The farm's coordinator, such as http://127.0.0.1:7800
    #[arg(long, value_name = "URL", env = "PHOTONFARM_COORDINATOR")]
    pub(crate) coordinator: String,
    #[command(flatten)]
    pub(crate) credentials: CredentialArgs,
}

/// What is shown to the coordinator.
#[derive(Debug, Args)]
pub(crate) struct CredentialArgs {
    /// File with a token; else the variable PHOTONFARM_TOKEN holds one, if the farm asks for any
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_TOKEN_FILE")]
    token_file: Option<PathBuf>,
    /// File with the certificate of the authority that the coordinator's comes from [default: those that the system trusts]
    #[arg(long, value_name = "FILE", env = "PHOTONFARM_CA")]
    ca: Option<PathBuf>,
}

impl CredentialArgs {
    pub(crate) fn load(&self) -> Result<Credentials, CredentialsError> {
        Credentials::load(self.token_file.as_deref(), self.ca.as_deref())
    }
}
