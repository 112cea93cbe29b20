//! Every request passes here: who sends it, and whether the route is for them.

use super::extract::Id;
use super::{ApiError, App, local, request, session};
use crate::access::{Caller, Gate, network};
use crate::audit::{Audit, Entry};
use crate::scheduler::record::Origin;
use crate::server::Peer;
use axum::extract::{FromRequestParts, MatchedPath, Request, State};
use axum::http::header::{AUTHORIZATION, LOCATION};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use photonfarm_proto::api::FARM;
use photonfarm_proto::id::JobId;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::Role;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

/// What every request passes.
pub(super) struct Door {
    pub(super) gate: Arc<Gate>,
    pub(super) audit: Option<Arc<Audit>>,
}

/// The name of what an answer says was made, for the audit log.
#[derive(Clone, Debug)]
pub(super) struct Made(pub(super) String);

/// Finds out who sends the request, and writes down what it changes.
pub(super) async fn identify(State(door): State<Arc<Door>>, mut request: Request, next: Next) -> Response {
    let peer = address(request.extensions().get::<Peer>());
    let asked = changes_something(&request).then(|| Asked::of(&request));
    let (caller, response) = match admit(&door.gate, request.method(), request.headers(), peer).await {
        Ok(caller) => {
            if let Some(caller) = caller.clone() {
                request.extensions_mut().insert(caller);
            }
            let response = next.run(request).await;
            if let Some(Asked { method, path, .. }) = &asked {
                let name = caller.as_ref().map_or("", |caller| &caller.name);
                let who = if name.is_empty() { "somebody" } else { name };
                tracing::info!("{who} at {peer}: {method} {path}: {}", response.status());
            }
            (caller, response)
        }
        Err(error) => (None, error.into_response()),
    };
    if let (Some(asked), Some(audit)) = (asked, &door.audit) {
        audit.note(asked.entry(caller.as_ref(), peer, &response)).await;
    }
    response
}

async fn admit(gate: &Gate, method: &Method, headers: &HeaderMap, peer: IpAddr) -> Result<Option<Caller>, ApiError> {
    let header = headers.get(AUTHORIZATION);
    let header = match header.map(|value| value.to_str().unwrap_or("").to_owned()) {
        None => session::authorization(method, headers)?,
        header => header,
    };
    let caller = gate.admit(header.as_deref(), peer).await?;
    if caller.as_ref().is_some_and(Caller::is_anyone) {
        local::check(method, headers)?;
    }
    Ok(caller)
}

/// What a request asks for that changes something.
struct Asked {
    method: Method,
    route: Option<MatchedPath>,
    path: String,
}

impl Asked {
    fn of(request: &Request) -> Self {
        Self {
            method: request.method().clone(),
            route: request.extensions().get::<MatchedPath>().cloned(),
            path: request.uri().path().to_owned(),
        }
    }

    fn entry<'a>(&'a self, caller: Option<&'a Caller>, address: IpAddr, response: &'a Response) -> Entry<'a> {
        let location = response.headers().get(LOCATION).and_then(|value| value.to_str().ok());
        Entry {
            caller,
            address,
            request_id: request::current(),
            method: self.method.as_str(),
            route: self.route.as_ref().map(MatchedPath::as_str),
            path: &self.path,
            job: job_of(&self.path).or_else(|| job_of(location?)),
            made: response.extensions().get::<Made>().map(|made| made.0.as_str()),
            status: response.status().as_u16(),
        }
    }
}

/// The job that a path is of.
fn job_of(path: &str) -> Option<JobId> {
    path.strip_prefix("/v1/jobs/")?.split('/').next()?.parse().ok()
}

/// Says in each answer which farm gives it.
pub(super) async fn name_farm(State(farm): State<Option<HeaderValue>>, request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    if let Some(farm) = farm {
        response.headers_mut().insert(FARM, farm);
    }
    response
}

/// Whether a request belongs into the logs: it changes something, and is none of those that workers, or files of a scene,
/// come with by the thousand.
fn changes_something(request: &Request) -> bool {
    let path = request.uri().path();
    let often = path.starts_with("/v1/worker/") || path.starts_with("/v1/blobs/");
    let rarely = ["/v1/worker/register", "/v1/worker/leave"].contains(&path);
    !request.method().is_safe() && (rarely || !often)
}

fn address(peer: Option<&Peer>) -> IpAddr {
    peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |peer| peer.0)
}

/// Lets those pass who have one of the roles.
pub(super) async fn need(
    State(roles): State<&'static [Role]>,
    request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let caller = request.extensions().get::<Caller>();
    if caller.is_some_and(|caller| roles.iter().any(|role| caller.role.includes(*role))) {
        return Ok(next.run(request).await);
    }
    let names: Vec<String> = roles.iter().map(|role| format!("`{role}`")).collect();
    let needed = format!("this needs a token with the role {}", names.join(" or "));
    Err(match caller {
        Some(caller) => {
            let detail = format!("{needed}; the token {:?} has the role `{}`", caller.name, caller.role);
            Problem::new(ErrorCode::Forbidden, detail)
        }
        None => {
            let detail = format!("{needed}, sent as `Authorization: Bearer TOKEN`");
            Problem::new(ErrorCode::Unauthorized, detail)
        }
    }
    .into())
}

/// Who sent the request, on a route that asks for a role.
pub(super) struct By(pub(super) Caller);

impl FromRequestParts<App> for By {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> Result<Self, ApiError> {
        let unknown = || Problem::new(ErrorCode::Unauthorized, "this needs a token");
        Ok(Self(parts.extensions.get::<Caller>().cloned().ok_or_else(unknown)?))
    }
}

/// Where a worker sends its request from.
pub(super) struct From(pub(super) Origin);

impl FromRequestParts<App> for From {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &App) -> Result<Self, ApiError> {
        let By(caller) = By::from_request_parts(parts, service).await?;
        Ok(Self(Origin {
            token: caller.name,
            machine: network(address(parts.extensions.get::<Peer>())).to_string(),
        }))
    }
}

/// The job of the path, which the sender may steer: its own, or any for an administrator.
pub(super) struct Steered(pub(super) JobId);

impl FromRequestParts<App> for Steered {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &App) -> Result<Self, ApiError> {
        let Id(id) = Id::<JobId>::from_request_parts(parts, service).await?;
        let By(caller) = By::from_request_parts(parts, service).await?;
        if caller.role != Role::Admin && service.owner(id).await? != caller.name {
            let detail = format!("job {id} was not submitted with the token {:?}", caller.name);
            return Err(Problem::new(ErrorCode::Forbidden, detail).into());
        }
        Ok(Self(id))
    }
}
