//! Where the stores are: URLs of the configuration.

use super::{
    BlobStore, FolderStore, ObjectBlobs, PostgresStore, SqliteStore, StateStore, StoreError, check_folder, not_writable,
};
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use thiserror::Error;
use tokio_postgres::config::Host;

/// Where the state is.
#[derive(Clone, PartialEq, Eq)]
pub enum StatePlace {
    /// `sqlite:PATH`: a file, for one coordinator.
    Sqlite(PathBuf),
    /// `postgres://USER:PASSWORD@HOST:PORT/DATABASE`: a database that several coordinators share; with `?sslmode=require` over
    /// encrypted connections.
    Postgres(Box<tokio_postgres::Config>),
}

/// Where the bytes are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BlobPlace {
    /// `file:PATH`: a folder with `scenes` and `nodes`.
    Folder(PathBuf),
    /// `s3://BUCKET/PREFIX`: a bucket of an S3-compatible store.
    S3 {
        /// The bucket.
        bucket: String,
        /// What the names of all objects begin with; may be empty.
        prefix: String,
    },
}

/// Not the URL of a store.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{url:?} is not the URL of a store: {reason}")]
pub struct PlaceError {
    url: String,
    reason: &'static str,
}

fn error<T>(url: &str, reason: &'static str) -> Result<T, PlaceError> {
    let url = url.to_owned();
    Err(PlaceError { url, reason })
}

/// A path after `sqlite:` or `file:`, with or without the empty host of `file:///`.
fn path(url: &str, rest: &str) -> Result<PathBuf, PlaceError> {
    let path = match rest.strip_prefix("//") {
        Some(path) if path.starts_with('/') => path,
        Some(_) => return error(url, "a path has no host: write file:PATH or file:///PATH"),
        None => rest,
    };
    if path.is_empty() {
        return error(url, "the path is missing");
    }
    Ok(path.into())
}

impl FromStr for StatePlace {
    type Err = PlaceError;

    fn from_str(url: &str) -> Result<Self, PlaceError> {
        match url.split_once(':') {
            Some(("sqlite", rest)) => path(url, rest).map(Self::Sqlite),
            Some(("postgres" | "postgresql", _)) => match url.parse::<tokio_postgres::Config>() {
                Ok(config) if config.get_hosts().is_empty() => error("postgres:", "the host is missing"),
                Ok(config) => Ok(Self::Postgres(Box::new(config))),
                Err(_) => error("postgres:", "write postgres://USER:PASSWORD@HOST:PORT/DATABASE"),
            },
            _ => error(
                url,
                "state is kept at sqlite:PATH or postgres://USER:PASSWORD@HOST:PORT/DATABASE",
            ),
        }
    }
}

impl FromStr for BlobPlace {
    type Err = PlaceError;

    fn from_str(url: &str) -> Result<Self, PlaceError> {
        match url.split_once(':') {
            Some(("file", rest)) => path(url, rest).map(Self::Folder),
            Some(("s3", rest)) => {
                let Some(rest) = rest.strip_prefix("//") else {
                    return error(url, "write s3://BUCKET/PREFIX");
                };
                let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
                let prefix = prefix.trim_end_matches('/');
                if bucket.is_empty() || bucket.contains(['@', ':', '?', '#']) {
                    return error(url, "a bucket's name comes first, and nothing of user, port or query");
                }
                if prefix.contains(['?', '#']) || prefix.split('/').any(|part| part == "." || part == "..") {
                    return error(url, "a prefix has no `?`, no `#` and no part `.` or `..`");
                }
                Ok(Self::S3 {
                    bucket: bucket.into(),
                    prefix: prefix.into(),
                })
            }
            _ => error(url, "bytes are kept at file:PATH or s3://BUCKET/PREFIX"),
        }
    }
}

impl fmt::Display for StatePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sqlite(path) => write!(f, "sqlite:{}", path.display()),
            Self::Postgres(config) => {
                let hosts = config.get_hosts().iter().map(|host| match host {
                    Host::Tcp(name) => name.clone(),
                    #[cfg(unix)]
                    Host::Unix(path) => path.display().to_string(),
                });
                let hosts: Vec<String> = hosts.collect();
                write!(
                    f,
                    "postgres://{}/{}",
                    hosts.join(","),
                    config.get_dbname().unwrap_or_default()
                )
            }
        }
    }
}

impl fmt::Debug for StatePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for BlobPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder(path) => write!(f, "file:{}", path.display()),
            Self::S3 { bucket, prefix } => write!(f, "s3://{bucket}/{prefix}"),
        }
    }
}

fn make_folder(path: &Path) -> Result<(), StoreError> {
    std::fs::create_dir_all(path).map_err(|error| not_writable(path, &error))
}

impl StatePlace {
    /// Opens the state, or makes it.
    pub fn open(&self) -> BoxFuture<'_, Result<Arc<dyn StateStore>, StoreError>> {
        self.open_or_make().boxed()
    }

    async fn open_or_make(&self) -> Result<Arc<dyn StateStore>, StoreError> {
        match self {
            Self::Sqlite(path) => {
                let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
                let folder = folder.unwrap_or(Path::new("."));
                make_folder(folder)?;
                check_folder(folder)?;
                Ok(Arc::new(SqliteStore::open(path)?))
            }
            Self::Postgres(config) => Ok(Arc::new(
                PostgresStore::open((**config).clone(), &self.to_string()).await?,
            )),
        }
    }
}

impl BlobPlace {
    /// Opens the stores of scenes and of nodes, or makes them. If other coordinators may use them at the same time,
    /// they are `shared`.
    pub fn open(&self, shared: bool) -> BoxFuture<'_, Result<[Arc<dyn BlobStore>; 2], StoreError>> {
        self.open_or_make(shared).boxed()
    }

    async fn open_or_make(&self, shared: bool) -> Result<[Arc<dyn BlobStore>; 2], StoreError> {
        match self {
            Self::Folder(path) => {
                make_folder(path)?;
                let open = |name| FolderStore::open(&path.join(name), shared);
                Ok([Arc::new(open("scenes")?), Arc::new(open("nodes")?)])
            }
            Self::S3 { bucket, prefix } => {
                let all = ObjectBlobs::open(bucket, prefix).await?;
                Ok([Arc::new(all.below("scenes")), Arc::new(all.below("nodes"))])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_name_stores() {
        let state = |url: &str| url.parse::<StatePlace>();
        assert_eq!(state("sqlite:a/b.sqlite"), Ok(StatePlace::Sqlite("a/b.sqlite".into())));
        assert_eq!(state("sqlite:///a/b"), Ok(StatePlace::Sqlite("/a/b".into())));
        for url in ["postgres://me:secret@db/farm", "postgresql://me:secret@db/farm"] {
            let place = state(url).unwrap();
            assert_eq!(place.to_string(), "postgres://db/farm", "a password is not shown");
        }
        let blobs = |url: &str| url.parse::<BlobPlace>();
        assert_eq!(blobs("file:/a"), Ok(BlobPlace::Folder("/a".into())));
        let s3 = |bucket: &str, prefix: &str| {
            let (bucket, prefix) = (bucket.into(), prefix.into());
            Ok(BlobPlace::S3 { bucket, prefix })
        };
        assert_eq!(blobs("s3://farm"), s3("farm", ""));
        assert_eq!(blobs("s3://farm/a/b/"), s3("farm", "a/b"));
    }

    #[test]
    fn other_urls_are_refused_with_a_reason() {
        for url in ["", "farm", "sqlite:", "mysql://a", "file:/a", "sqlite://host/a"] {
            assert!(url.parse::<StatePlace>().is_err(), "{url}");
        }
        for url in [
            "postgres:",
            "postgres://me:secret@",
            "postgres://me:secret@db:port/farm",
            "postgres://me:secret@db/farm?sslmode=sometimes",
            "postgres://me:secret@db/farm?mode=x",
        ] {
            let text = url.parse::<StatePlace>().unwrap_err().to_string();
            assert!(!text.contains("secret"), "{text}");
        }
        for url in [
            "",
            "farm",
            "file:",
            "file://host/a",
            "s3:farm",
            "s3://",
            "s3:///a",
            "s3://u@b",
            "s3://b?x",
            "s3://b/../c",
            "sqlite:a",
        ] {
            assert!(url.parse::<BlobPlace>().is_err(), "{url}");
        }
        let text = "s3://".parse::<BlobPlace>().unwrap_err().to_string();
        assert!(text.contains("s3://") && text.contains("bucket"), "{text}");
    }
}
