//! Pictures of jobs that have ended: each is made once, and kept beside the images of nodes until the job is deleted or
//! goes on.

use super::image::{ImageFormat, PictureFile};
use super::section::Wanted;
use super::{Service, ServiceError, garbage};
use crate::scheduler::Job;
use crate::scheduler::record::Millis;
use crate::store::{self, PictureRecord, StoreError};
use axum::body::Bytes;
use photonfarm_proto::id::JobId;
use std::sync::Arc;

impl Service {
    /// What is wanted of the picture of a job that has ended, if it was kept, is the one that the tag names, and is whole.
    pub(super) async fn kept_picture(
        &self,
        job: &Job,
        format: ImageFormat,
        etag: &str,
        wanted: &Wanted<'_>,
    ) -> Result<Option<PictureFile>, ServiceError> {
        if job.ended_ms().is_none() || !format.is_kept() {
            return Ok(None);
        }
        let kept = self.stores.state.picture(job.id(), format.name()).await?;
        let Some(PictureRecord { image, bytes, .. }) = kept.filter(|kept| kept.etag == etag) else {
            return Ok(None);
        };
        let section = match wanted.section(etag, bytes) {
            Ok(section) => section,
            Err(length) => return Ok(Some(PictureFile::Beyond(length))),
        };
        let nodes = &*self.stores.nodes;
        let opened = match store::hash_of(nodes, image).await {
            Ok(hash) if hash == image.hash => nodes.open_at(image, section.bytes.start).await,
            Ok(_) => Err(StoreError::Damaged(format!("{image} has another hash"))),
            Err(error) => Err(error),
        };
        match opened {
            Ok((_, reader)) => Ok(Some(PictureFile::Kept(section, reader))),
            Err(error @ (StoreError::NoBlob(_) | StoreError::Damaged(_))) => {
                tracing::warn!(job = %job.id(), %error, "a picture that was kept cannot be used: it is made anew");
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Keeps a picture of a job that ended at the time `ended_ms`. Where that fails, it is made anew the next time.
    pub(super) async fn keep_picture(
        self: &Arc<Self>,
        (job, ended_ms): (JobId, Millis),
        format: ImageFormat,
        etag: &str,
        bytes: Bytes,
    ) {
        if let Err(error) = self.try_keep((job, ended_ms), format, etag, bytes).await {
            tracing::warn!(%job, %error, "the picture could not be kept: it is made anew when it is asked for again");
        }
    }

    async fn try_keep(
        self: &Arc<Self>,
        (job, ended_ms): (JobId, Millis),
        format: ImageFormat,
        etag: &str,
        bytes: Bytes,
    ) -> Result<(), ServiceError> {
        let publication = self.publication().await;
        let length = bytes.len() as u64;
        let image = store::put(&*self.stores.nodes, bytes, store::new_copy()?).await?;
        if self.clock.now() > publication.last {
            return Err(garbage::too_late());
        }
        let picture = PictureRecord {
            etag: etag.to_owned(),
            image,
            bytes: length,
        };
        let state = &self.stores.state;
        let unnamed = state.put_picture(job, ended_ms, format.name(), picture).await?;
        self.collect(unnamed.into_iter().collect());
        Ok(())
    }
}
