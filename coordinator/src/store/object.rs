//! Blobs as objects of an S3-compatible store: `PREFIX/<first two digits>/<other digits>` of the name.
//!
//! A worker that stores an image itself gets a signed URL to an object of its own below `PREFIX/incoming/`; only once
//! it says that it is done does the store copy the bytes to the place of their name. So a URL never allows anybody to
//! write what counts.

use super::{BlobReader, BlobStore, StagedBlob, StoreError};
use crate::scheduler::record::BlobName;
use async_trait::async_trait;
use axum::http::Method;
use bytes::Bytes;
use futures_util::future::BoxFuture;
use futures_util::{FutureExt, StreamExt, TryStreamExt};
use object_store::aws::{AmazonS3, AmazonS3Builder};
use object_store::path::{Path, PathPart};
use object_store::signer::Signer;
use object_store::{
    ClientOptions, Error, GetOptions, GetRange, MultipartUpload, ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload,
    RetryConfig,
};
use photonfarm_proto::id::BlobHash;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio_util::io::StreamReader;

/// Bytes of an object sent in one request; longer objects are sent in parts of this size.
const PART_BYTES: usize = 8 << 20;
/// How long a signed URL lives.
const SIGNED: Duration = Duration::from_secs(300);
/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// Longest time of one request, its body included.
const REQUEST: Duration = Duration::from_secs(600);
/// A request that fails is tried again this often, for this long at most; then the caller decides.
const RETRIES: usize = 3;
const RETRY: Duration = Duration::from_secs(10);

const INCOMING: &str = "incoming";

/// Objects below a prefix of a bucket.
#[derive(Clone, Debug)]
pub struct ObjectBlobs {
    store: Arc<AmazonS3>,
    prefix: Path,
}

impl ObjectBlobs {
    /// Objects of a bucket. Credentials, endpoint and region come from the usual variables `AWS_...` of the environment.
    pub async fn open(bucket: &str, prefix: &str) -> Result<Self, StoreError> {
        let variables =
            std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
        Self::open_with(bucket, prefix, variables).await
    }

    /// As [`open`](Self::open), with variables of the caller's.
    pub fn open_with<'a>(
        bucket: &'a str,
        prefix: &'a str,
        variables: impl Iterator<Item = (String, String)>,
    ) -> BoxFuture<'a, Result<Self, StoreError>> {
        Self::connect(bucket, prefix, variables.collect()).boxed()
    }

    async fn connect(bucket: &str, prefix: &str, variables: Vec<(String, String)>) -> Result<Self, StoreError> {
        let place = format!("s3://{bucket}/{prefix}");
        let bad = |reason: String| StoreError::Foreign {
            place: place.clone(),
            reason,
        };
        let mut builder = AmazonS3Builder::new();
        let mut plain = false;
        for (name, value) in variables.into_iter().filter(|(name, _)| name.starts_with("AWS_")) {
            if let Ok(key) = name.to_ascii_lowercase().parse() {
                plain |= name.starts_with("AWS_ENDPOINT") && value.starts_with("http://");
                builder = builder.with_config(key, value);
            }
        }
        let options = ClientOptions::new()
            .with_connect_timeout(CONNECT)
            .with_timeout(REQUEST)
            .with_allow_http(plain);
        let retry = RetryConfig {
            max_retries: RETRIES,
            retry_timeout: RETRY,
            ..RetryConfig::default()
        };
        let store = builder
            .with_bucket_name(bucket)
            .with_client_options(options)
            .with_retry(retry)
            .build()
            .map_err(|error| bad(error.to_string()))?;
        let prefix = Path::parse(prefix).map_err(|error| bad(error.to_string()))?;
        let opened = Self {
            store: Arc::new(store),
            prefix,
        };
        opened
            .objects(opened.prefix.clone())
            .next()
            .await
            .transpose()
            .map_err(|error| {
                bad(format!(
                    "the bucket cannot be read; AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT say \
                     who asks whom: {error}"
                ))
            })?;
        Ok(opened)
    }

    /// The same bucket, further below the prefix.
    #[must_use]
    pub fn below(&self, name: &str) -> Self {
        Self {
            store: self.store.clone(),
            prefix: self.prefix.clone().join(PathPart::from(name)),
        }
    }

    fn path(&self, name: BlobName) -> Path {
        let digits = name.to_string();
        self.prefix.clone().join(&digits[..2]).join(&digits[2..])
    }

    fn incoming(&self, place: &str) -> Path {
        self.prefix.clone().join(INCOMING).join(PathPart::from(place))
    }

    fn objects(&self, prefix: Path) -> impl futures_util::Stream<Item = Result<ObjectMeta, Error>> + Unpin {
        self.store.list(Some(&prefix))
    }

    async fn head(&self, path: &Path) -> Result<Option<ObjectMeta>, StoreError> {
        match self.store.head(path).await {
            Ok(found) => Ok(Some(found)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// The time by the store's clock, as an object gets it that is made now.
    async fn clock(&self) -> Result<SystemTime, StoreError> {
        let probe = format!("clock-{:016x}", super::new_copy()?);
        let path = self.prefix.clone().join(probe);
        self.store
            .put(&path, PutPayload::from_static(b"what time is it?"))
            .await?;
        let meta = self.store.head(&path).await?;
        self.delete(&path).await?;
        Ok(meta.last_modified.into())
    }

    async fn delete(&self, path: &Path) -> Result<(), StoreError> {
        match self.store.delete(path).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// The name of the blob that an object is, if it is one of this store.
    fn name_of(&self, path: &Path) -> Option<BlobName> {
        let mut parts = path.prefix_match(&self.prefix)?;
        let (start, end) = (parts.next()?, parts.next()?);
        let digits = format!("{}{}", start.as_ref(), end.as_ref());
        parts.next().is_none().then(|| digits.parse().ok())?
    }
}

/// How old an object is when the store's clock says `now`; one from the future is new.
fn age(now: SystemTime, meta: &ObjectMeta) -> Duration {
    now.duration_since(meta.last_modified.into()).unwrap_or_default()
}

fn missing_or(hash: BlobHash, error: Error) -> StoreError {
    match error {
        Error::NotFound { .. } => StoreError::NoBlob(hash),
        error => error.into(),
    }
}

#[async_trait]
impl BlobStore for ObjectBlobs {
    async fn stage(&self, name: BlobName) -> Result<Box<dyn StagedBlob>, StoreError> {
        Ok(Box::new(StagedObject {
            store: self.store.clone(),
            path: self.path(name),
            expected: name.hash,
            hasher: Some(blake3::Hasher::new()),
            buffer: Vec::new(),
            upload: None,
        }))
    }

    async fn read(&self, name: BlobName, most: u64) -> Result<Vec<u8>, StoreError> {
        let (path, hash) = (self.path(name), name.hash);
        let found = self.store.get(&path).await.map_err(|error| missing_or(hash, error))?;
        let size = found.meta.size;
        if size > most {
            return Err(StoreError::Damaged(format!(
                "{path} has {size} bytes, more than {most}"
            )));
        }
        let bytes = found.bytes().await?;
        let found = BlobHash::of(&bytes);
        if found != hash {
            return Err(StoreError::Damaged(format!("{path} has hash {found}")));
        }
        Ok(bytes.into())
    }

    async fn open_at(&self, name: BlobName, start: u64) -> Result<(u64, BlobReader), StoreError> {
        let range = (start > 0).then_some(GetRange::Offset(start));
        let options = GetOptions {
            range,
            ..GetOptions::default()
        };
        let found = self.store.get_opts(&self.path(name), options).await;
        let found = found.map_err(|error| missing_or(name.hash, error))?;
        let size = found.meta.size;
        Ok((
            size,
            Box::new(StreamReader::new(found.into_stream().map_err(std::io::Error::other))),
        ))
    }

    async fn size(&self, name: BlobName) -> Result<Option<u64>, StoreError> {
        Ok(self.head(&self.path(name)).await?.map(|meta| meta.size))
    }

    async fn remove(&self, name: BlobName) -> Result<(), StoreError> {
        self.delete(&self.path(name)).await
    }

    async fn list(&self) -> Result<Vec<(BlobName, Duration)>, StoreError> {
        let now = self.clock().await?;
        let mut objects = self.objects(self.prefix.clone());
        let mut found = Vec::new();
        while let Some(meta) = objects.try_next().await? {
            found.extend(self.name_of(&meta.location).map(|name| (name, age(now, &meta))));
        }
        Ok(found)
    }

    fn signs(&self) -> bool {
        true
    }

    async fn read_url(&self, name: BlobName) -> Result<Option<String>, StoreError> {
        let url = self.store.signed_url(Method::GET, &self.path(name), SIGNED).await?;
        Ok(Some(url.into()))
    }

    async fn write_url(&self, place: &str) -> Result<Option<String>, StoreError> {
        let url = self
            .store
            .signed_url(Method::PUT, &self.incoming(place), SIGNED)
            .await?;
        Ok(Some(url.into()))
    }

    async fn adopt(&self, place: &str, name: BlobName, bytes: u64) -> Result<(), StoreError> {
        let (from, to) = (self.incoming(place), self.path(name));
        match self.head(&from).await? {
            None => return Err(StoreError::NoBlob(name.hash)),
            Some(meta) if meta.size != bytes => {
                self.delete(&from).await?;
                let detail = format!("{from} has {} bytes, not {bytes}", meta.size);
                return Err(StoreError::Damaged(detail));
            }
            Some(_) => {}
        }
        self.store.copy(&from, &to).await?;
        self.delete(&from).await
    }

    async fn discard(&self, place: &str) -> Result<(), StoreError> {
        self.delete(&self.incoming(place)).await
    }

    async fn tidy(&self, least: Duration) -> Result<(), StoreError> {
        let now = self.clock().await?;
        let mut objects = self.objects(self.prefix.clone().join(INCOMING));
        while let Some(meta) = objects.try_next().await? {
            if age(now, &meta) >= least {
                self.delete(&meta.location).await?;
            }
        }
        Ok(())
    }
}

/// An object that is being written: at most one part of it is in memory.
struct StagedObject {
    store: Arc<AmazonS3>,
    path: Path,
    expected: BlobHash,
    /// None where the caller is trusted.
    hasher: Option<blake3::Hasher>,
    buffer: Vec<u8>,
    /// Begun once there are more bytes than fit into one request.
    upload: Option<Box<dyn MultipartUpload>>,
}

impl StagedObject {
    async fn append(&mut self, mut bytes: &[u8]) -> Result<(), StoreError> {
        if let Some(hasher) = &mut self.hasher {
            hasher.update(bytes);
        }
        while !bytes.is_empty() {
            if self.buffer.len() == PART_BYTES {
                self.send_part().await?;
            }
            let (now, later) = bytes.split_at(bytes.len().min(PART_BYTES - self.buffer.len()));
            self.buffer.extend_from_slice(now);
            bytes = later;
        }
        Ok(())
    }

    async fn send_part(&mut self) -> Result<(), StoreError> {
        let part = PutPayload::from(std::mem::take(&mut self.buffer));
        if self.upload.is_none() {
            self.upload = Some(self.store.put_multipart(&self.path).await?);
        }
        if let Some(upload) = &mut self.upload {
            upload.put_part(part).await?;
        }
        Ok(())
    }
}

#[async_trait]
impl StagedBlob for StagedObject {
    async fn write_pieces(&mut self, pieces: Vec<Bytes>) -> Result<(), StoreError> {
        for piece in pieces {
            self.append(&piece).await?;
        }
        Ok(())
    }

    fn trust(&mut self) {
        self.hasher = None;
    }

    fn hash(&self) -> BlobHash {
        let hash = self.hasher.as_ref().map(|hasher| hasher.finalize().into());
        hash.unwrap_or(self.expected)
    }

    async fn publish(mut self: Box<Self>) -> Result<(), StoreError> {
        let (expected, found) = (self.expected, self.hash());
        if found != expected {
            return Err(StoreError::WrongHash { expected, found });
        }
        if self.upload.is_none() {
            let bytes = PutPayload::from(std::mem::take(&mut self.buffer));
            self.store.put(&self.path, bytes).await?;
            return Ok(());
        }
        self.send_part().await?;
        if let Some(upload) = &mut self.upload {
            upload.complete().await?;
        }
        self.upload = None;
        Ok(())
    }
}

impl Drop for StagedObject {
    /// Parts that will never be an object are removed, as well as that can be done.
    fn drop(&mut self) {
        if let (Some(mut upload), Ok(runtime)) = (self.upload.take(), tokio::runtime::Handle::try_current()) {
            runtime.spawn(async move {
                if let Err(error) = upload.abort().await {
                    tracing::warn!(%error, "parts of an object are left behind");
                }
            });
        }
    }
}
