//! `photonfarm token`: makes, lists and revokes tokens, on a running farm or on the state of one that is stopped.

use crate::client::Client;
use crate::say;
use crate::token_args::{TokenArgs, TokenCommand, TokenPlace};
use anyhow::{Context, Result, bail};
use photonfarm_coordinator::Config;
use photonfarm_coordinator::access::Tokens;
use photonfarm_coordinator::store::StatePlace;
use photonfarm_proto::token::{NewToken, Quota, TokenRequest, TokenStatus};

/// Runs the command.
pub(crate) fn run(args: TokenArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(command(args.command))
}

async fn command(command: TokenCommand) -> Result<()> {
    match command {
        TokenCommand::Create(args) => {
            let gigabytes = |count: f64| (count * 1e9) as u64;
            let request = TokenRequest {
                name: args.name,
                role: args.role.into(),
                expires_in_s: args.days.map(|days| (days * 86_400.0) as u64),
                quota: Quota {
                    jobs: args.most_jobs,
                    bundle_bytes: args.most_gigabytes.map(gigabytes),
                    iterations: args.most_iterations,
                },
            };
            let made = TokenStore::open(&args.place).await?.create(request).await?;
            say::line(&made.token)?;
            say::tell(format_args!(
                "the token {:?} with the role `{}`: keep it, it is not shown again",
                made.status.name, made.status.role
            ));
        }
        TokenCommand::List { place } => {
            for token in TokenStore::open(&place).await?.list().await? {
                say::line(line(&token))?;
            }
        }
        TokenCommand::Revoke { name, place } => TokenStore::open(&place).await?.revoke(&name).await?,
    }
    Ok(())
}

fn line(token: &TokenStatus) -> String {
    let of = |used: u64, most: Option<u64>| most.map_or(used.to_string(), |most| format!("{used} of {most}"));
    let TokenStatus { quota, usage, .. } = token;
    let mut line = format!("{}  {}", token.name, token.role);
    line += &format!("  jobs: {}", of(usage.jobs, quota.jobs));
    line += &format!("  bundle bytes: {}", of(usage.bundle_bytes, quota.bundle_bytes));
    line += &format!("  iterations: {}", of(usage.iterations, quota.iterations));
    if let Some(end) = token.expires_ms {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let now = now.map_or(0, |since| since.as_millis() as u64);
        line += &match end.checked_sub(now) {
            Some(left) => format!("  expires in {:.1} days", left as f64 / 86_400_000.0),
            None => "  expired".to_owned(),
        };
    }
    line
}

/// Where the tokens are.
enum TokenStore {
    Farm(Client),
    State(Tokens),
}

impl TokenStore {
    async fn open(place: &TokenPlace) -> Result<Self> {
        let given = place.data.as_ref().map(|data| Config::new(data).state);
        match (given, &place.coordinator, &place.state) {
            (Some(state), _, _) => Self::of(&state).await,
            (None, Some(url), _) => {
                let client = Client::new(url, place.credentials.load()?)?;
                client.connect().await?;
                Ok(Self::Farm(client))
            }
            (None, None, Some(state)) => Self::of(state).await,
            (None, None, None) => {
                bail!("say where the farm is: --data DIR while it is stopped, --state URL, or --coordinator URL")
            }
        }
    }

    async fn of(state: &StatePlace) -> Result<Self> {
        let opened = state.open().await.with_context(|| {
            format!(
                "cannot use {state}; while a coordinator runs on it, give --coordinator and an administrator's token"
            )
        })?;
        Ok(Self::State(Tokens::new(opened)))
    }

    async fn create(&self, request: TokenRequest) -> Result<NewToken> {
        match self {
            Self::Farm(client) => client.create_token(&request).await,
            Self::State(tokens) => Ok(tokens.create(request).await?),
        }
    }

    async fn list(&self) -> Result<Vec<TokenStatus>> {
        match self {
            Self::Farm(client) => Ok(client.tokens().await?.tokens),
            Self::State(tokens) => Ok(tokens.list().await?),
        }
    }

    async fn revoke(&self, name: &str) -> Result<()> {
        match self {
            Self::Farm(client) => client.revoke_token(name).await,
            Self::State(tokens) => Ok(tokens.revoke(name).await?),
        }
    }
}
