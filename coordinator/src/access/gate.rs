//! Who is let in: bearers of valid tokens, at a bounded rate.

use super::rate::Buckets;
use super::tokens::{no_token, wall_clock};
use super::{AccessError, Caller, Tokens, token};
use crate::store::{StoreError, TokenRecord};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::{NewToken, Role, TokenRequest, TokenStatus};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long tokens are remembered: a token revoked at another coordinator of the farm is refused after this time.
const REMEMBERED: Duration = Duration::from_secs(1);
/// How long the tokens that were valid at last go on while the store does not answer; clients give up after as long.
const GRACE: Duration = Duration::from_secs(15 * 60);
/// How long a request waits for a store that does not answer, where it can go on without.
const PATIENCE: Duration = Duration::from_secs(2);
/// Requests a second that one address may send without a valid token.
const VISITS_PER_SECOND: u32 = 20;

/// The door of a farm.
pub(crate) struct Gate {
    tokens: Tokens,
    /// Whether a farm without any token is open: only where nobody but this machine can knock.
    loopback: bool,
    remembered: tokio::sync::Mutex<Option<Remembered>>,
    callers: Mutex<Buckets<(String, IpAddr)>>,
    visitors: Mutex<Buckets<IpAddr>>,
}

/// The tokens as the store had them.
struct Remembered {
    /// When the store was last asked, whether it answered or not.
    asked: Instant,
    /// When it last answered.
    answered: Instant,
    tokens: Arc<[TokenRecord]>,
}

impl Gate {
    /// `rate` is the number of requests a second that one token may send from one address.
    pub(crate) fn new(tokens: Tokens, loopback: bool, rate: u32) -> Self {
        Self {
            tokens,
            loopback,
            remembered: tokio::sync::Mutex::default(),
            callers: Mutex::new(Buckets::new(rate)),
            visitors: Mutex::new(Buckets::new(VISITS_PER_SECOND)),
        }
    }

    /// Whether there is any token, valid or not.
    pub(crate) async fn has_tokens(&self) -> Result<bool, AccessError> {
        Ok(!self.remembered().await?.is_empty())
    }

    /// The tokens. While the store is away those go on that it had at last: a revocation needs the store as well.
    async fn remembered(&self) -> Result<Arc<[TokenRecord]>, AccessError> {
        let mut remembered = self.remembered.lock().await;
        let Some(known) = &mut *remembered else {
            let tokens: Arc<[TokenRecord]> = self.tokens.records().await?.into();
            let now = Instant::now();
            *remembered = Some(Remembered {
                asked: now,
                answered: now,
                tokens: tokens.clone(),
            });
            return Ok(tokens);
        };
        if known.asked.elapsed() < REMEMBERED {
            return Ok(known.tokens.clone());
        }
        let late = |_| Err(StoreError::Connection("it does not answer".into()).into());
        let answer = tokio::time::timeout(PATIENCE, self.tokens.records())
            .await
            .unwrap_or_else(late);
        known.asked = Instant::now();
        match answer {
            Ok(tokens) => (known.answered, known.tokens) = (known.asked, tokens.into()),
            Err(AccessError::Store(error)) if error.retryable() && known.answered.elapsed() < GRACE => {
                tracing::warn!(%error, "the store does not tell the tokens: those that were valid go on");
            }
            Err(error) => return Err(error),
        }
        Ok(known.tokens.clone())
    }

    async fn forget(&self) {
        *self.remembered.lock().await = None;
    }

    /// Who sent a request with this `Authorization` header from this address; none for a visitor without one.
    ///
    /// # Errors
    /// A token that is not valid; too many requests.
    pub(crate) async fn admit(&self, header: Option<&str>, peer: IpAddr) -> Result<Option<Caller>, AccessError> {
        let tokens = self.remembered().await?;
        if tokens.is_empty() && self.loopback {
            return Ok(Some(Caller::anyone()));
        }
        let known = header.and_then(bearer).and_then(|token| find(&tokens, token));
        let Some(record) = known else {
            let mut visitors = self.visitors.lock().unwrap_or_else(PoisonError::into_inner);
            let allowed = visitors.take(network(peer), Instant::now());
            drop(visitors);
            allowed.map_err(|seconds| too_many("without a valid token", seconds))?;
            return match header {
                Some(_) => Err(Problem::new(ErrorCode::Unauthorized, "the token is not valid on this farm").into()),
                None => Ok(None),
            };
        };
        if record.expires_ms.is_some_and(|end| end <= wall_clock()) {
            let detail = format!("the token {:?} has expired", record.name);
            return Err(Problem::new(ErrorCode::Unauthorized, detail).into());
        }
        let mut callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
        let allowed = callers.take((record.name.clone(), peer), Instant::now());
        drop(callers);
        allowed.map_err(|seconds| too_many(&format!("with the token {:?}", record.name), seconds))?;
        Ok(Some(Caller {
            name: record.name.clone(),
            role: record.role,
            quota: record.quota,
        }))
    }

    /// Makes a token. The first one must be an administrator's, who can make others.
    pub(crate) async fn create(&self, request: TokenRequest) -> Result<NewToken, AccessError> {
        if request.role != Role::Admin && self.tokens.records().await?.is_empty() {
            let detail = "the first token of a farm has the role `admin`: without it nobody could make others";
            return Err(Problem::new(ErrorCode::Invalid, detail).at("role", None).into());
        }
        let made = self.tokens.create(request).await;
        self.forget().await;
        made
    }

    /// What is known of each token.
    pub(crate) async fn list(&self) -> Result<Vec<TokenStatus>, AccessError> {
        self.tokens.list().await
    }

    /// Revokes a token. The last administrator's stays: revoking it would leave nobody who can make others.
    pub(crate) async fn revoke(&self, name: &str) -> Result<(), AccessError> {
        let records = self.tokens.records().await?;
        if !records.iter().any(|record| record.name == name) {
            return Err(no_token(name).into());
        }
        let admins = |record: &&TokenRecord| record.role == Role::Admin && record.expires_ms.is_none();
        if records.iter().filter(admins).all(|record| record.name == name) {
            let detail = "this is the last token with the role `admin` that does not expire: make another one first, or \
                          use `photonfarm token revoke` on the state store";
            return Err(Problem::new(ErrorCode::Invalid, detail).into());
        }
        let revoked = self.tokens.revoke(name).await;
        self.forget().await;
        revoked
    }
}

/// The token of an `Authorization` header.
fn bearer(header: &str) -> Option<&str> {
    let (scheme, token) = header.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// Compares with every token in constant time (`blake3::Hash` does), so that time tells nothing about any of them.
fn find<'a>(tokens: &'a [TokenRecord], token: &str) -> Option<&'a TokenRecord> {
    let sent = blake3::Hash::from_bytes(token::hash(token).0);
    let same = |record: &TokenRecord| blake3::Hash::from_bytes(record.hash.0) == sent;
    tokens
        .iter()
        .fold(None, |found, record| if same(record) { Some(record) } else { found })
}

/// What counts as one visitor and one machine: an IPv4 address, or the network that one holder of IPv6 addresses usually has.
/// All loopback addresses are this machine.
pub(crate) fn network(peer: IpAddr) -> IpAddr {
    match peer.to_canonical() {
        address if address.is_loopback() => std::net::Ipv4Addr::LOCALHOST.into(),
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => std::net::Ipv6Addr::from(u128::from(address) >> 64 << 64).into(),
    }
}

fn too_many(who: &str, seconds: u16) -> Problem {
    let detail = format!("too many requests {who}: try again after {seconds} s");
    Problem::new(ErrorCode::TooManyRequests, detail).after(seconds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::StateStore;
    use crate::store::memory::MemoryStore;
    use photonfarm_proto::token::Quota;
    use std::net::Ipv4Addr;
    use std::sync::atomic::Ordering;

    /// The tokens that were valid at last go on while the store is away, for as long as clients have patience.
    #[tokio::test]
    async fn tokens_go_on_while_the_store_is_away() {
        let store = Arc::new(MemoryStore::default());
        let gate = Gate::new(Tokens::new(store.clone()), false, 1000);
        let request = TokenRequest {
            name: "boss".into(),
            role: Role::Admin,
            expires_in_s: None,
            quota: Quota::default(),
        };
        let header = format!("Bearer {}", gate.create(request).await.unwrap().token);
        let admit = async |header: &str| gate.admit(Some(header), Ipv4Addr::LOCALHOST.into()).await;
        assert_eq!(admit(&header).await.unwrap().unwrap().name, "boss");
        let pass = async |time: Duration| {
            let mut remembered = gate.remembered.lock().await;
            let known = remembered.as_mut().unwrap();
            (known.asked, known.answered) = (known.asked - time, known.answered - time);
        };
        store.away.store(true, Ordering::Relaxed);
        pass(GRACE / 2).await;
        assert_eq!(admit(&header).await.unwrap().unwrap().name, "boss");
        assert!(
            matches!(admit("Bearer x").await, Err(AccessError::Problem(_))),
            "no other token is let in"
        );
        pass(GRACE / 2).await;
        assert!(matches!(admit(&header).await, Err(AccessError::Store(_))));
        store.away.store(false, Ordering::Relaxed);
        pass(REMEMBERED).await;
        assert!(store.remove_token("boss".into()).await.unwrap());
        assert!(admit(&header).await.is_err(), "a token that was revoked meanwhile");
    }

    #[test]
    fn only_the_bearer_scheme_is_read() {
        assert_eq!(bearer("Bearer x"), Some("x"));
        assert_eq!(bearer("bearer  x"), Some("x"));
        for other in ["Bearer", "Basic x", "x", "", "BearerX x"] {
            assert_eq!(bearer(other), None, "{other:?}");
        }
    }

    #[test]
    fn neighbours_of_one_network_are_one_visitor() {
        let network = |text: &str| network(text.parse().unwrap()).to_string();
        assert_eq!(network("2001:db8:1:2:3:4:5:6"), "2001:db8:1:2::");
        assert_eq!(network("::ffff:10.0.0.7"), "10.0.0.7");
        assert_ne!(network("10.0.0.7"), network("10.0.0.8"));
        assert_eq!([network("::1"), network("127.0.0.9")], ["127.0.0.1"; 2]);
    }
}
