//! The image of a job at any time: the average over the nodes that count.

use super::raw::encode_raw;
use super::section::{Section, Wanted};
use super::{Service, ServiceError, VERSION};
use crate::scheduler::Job;
use crate::store::BlobReader;
use axum::body::Bytes;
use photonfarm_core::film::Image;
use photonfarm_core::picture::{self, PictureError, PictureMetadata};
use photonfarm_core::tree::Average;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::sync::Arc;

/// How often a picture is begun anew because its nodes were merged meanwhile.
const ATTEMPTS: usize = 8;

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// OpenEXR with metadata: linear radiance.
    Exr,
    /// PNG by a tone curve.
    Png,
    /// Plain numbers ([`encode_raw`]).
    Raw,
}

impl ImageFormat {
    /// Its name in the state.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
            Self::Raw => "raw",
        }
    }

    /// Whether the picture of a job that has ended is kept. Plain numbers take more room than they take time to make.
    pub(super) fn is_kept(self) -> bool {
        self != Self::Raw
    }
}

/// A picture as a file.
pub struct Picture {
    /// Names these bytes: the same tag, the same picture.
    pub etag: String,
    /// The file.
    pub file: PictureFile,
}

/// Where a picture is.
pub enum PictureFile {
    /// The client has it: it sent the same tag.
    Known,
    /// It has so many bytes, and none where the client wants them.
    Beyond(u64),
    /// It was just made.
    Made(Section, Bytes),
    /// It was kept. The reader begins where the section does, and may go on behind it.
    Kept(Section, BlobReader),
}

impl Service {
    /// The image as it stands, unless the client knows it; or a part of it.
    pub async fn picture(
        self: &Arc<Self>,
        id: JobId,
        format: ImageFormat,
        wanted: &Wanted<'_>,
    ) -> Result<Picture, ServiceError> {
        for _ in 0..ATTEMPTS {
            let job = self.find_job(id).await?;
            let etag = etag(&job, format);
            if wanted.is_known(&etag) {
                let file = PictureFile::Known;
                return Ok(Picture { etag, file });
            }
            let file = match self.kept_picture(&job, format, &etag, wanted).await? {
                None => self.make_picture(&job, format, &etag, wanted).await?,
                kept => kept,
            };
            if let Some(file) = file {
                return Ok(Picture { etag, file });
            }
        }
        Err(Problem::new(ErrorCode::Internal, "nodes of the image are missing").into())
    }

    /// Makes the picture of a job, and keeps it if the job has ended; nothing if a node was merged or given up meanwhile.
    async fn make_picture(
        self: &Arc<Self>,
        job: &Job,
        format: ImageFormat,
        etag: &str,
        wanted: &Wanted<'_>,
    ) -> Result<Option<PictureFile>, ServiceError> {
        let kept_ms = job.ended_ms().filter(|_| format.is_kept());
        let _once = match kept_ms {
            Some(_) => Some(self.finishing.lock().await),
            None => None,
        };
        if let Some(kept) = self.kept_picture(job, format, etag, wanted).await? {
            return Ok(Some(kept));
        }
        let _permit = self.pictures.acquire().await.map_err(|_| ServiceError::Stopping)?;
        let Some(image) = self.average(job).await? else {
            return Ok(None);
        };
        let (metadata, layers) = (metadata(job), job.layers().clone());
        let iterations = image.iterations;
        let encode = move || {
            let channels = match format {
                ImageFormat::Exr => layers.channels(&image)?,
                ImageFormat::Png | ImageFormat::Raw => Vec::new(),
            };
            let image = layers.picture(image)?;
            let noise = image.noise();
            let bytes = match format {
                ImageFormat::Raw => encode_raw(&image, noise),
                ImageFormat::Exr => picture::encode_exr(&image, channels, &PictureMetadata { noise, ..metadata })?,
                ImageFormat::Png => picture::encode_png(&image)?,
            };
            Ok::<_, PictureError>((bytes, noise))
        };
        let (bytes, noise) = tokio::task::spawn_blocking(encode)
            .await
            .map_err(|_| ServiceError::Stopping)??;
        self.histories.measured(job.id(), self.clock.now(), iterations, noise);
        let bytes = Bytes::from(bytes);
        if let Some(ended_ms) = kept_ms {
            self.keep_picture((job.id(), ended_ms), format, etag, bytes.clone())
                .await;
        }
        Ok(Some(match wanted.section(etag, bytes.len() as u64) {
            Ok(section) => {
                let part = bytes.slice(section.bytes.start as usize..section.bytes.end as usize);
                PictureFile::Made(section, part)
            }
            Err(length) => PictureFile::Beyond(length),
        }))
    }

    /// The average, with layers below the picture; nothing if a node was merged or given up meanwhile.
    async fn average(self: &Arc<Self>, job: &Job) -> Result<Option<Image>, ServiceError> {
        let mut average = Average::default();
        let mut empty = true;
        for (node, image) in job.live_images() {
            let Some(node) = self.node(job.header(node), image).await? else {
                return Ok(None);
            };
            let add = move || -> Result<Average, ServiceError> {
                average.push(node)?;
                Ok(average)
            };
            average = tokio::task::spawn_blocking(add)
                .await
                .map_err(|_| ServiceError::Stopping)??;
            empty = false;
        }
        if empty {
            let detail = format!("no iteration of job {} has arrived yet", job.id());
            return Err(Problem::new(ErrorCode::NoImageYet, detail).into());
        }
        Ok(Some(average.finish()?))
    }
}

fn etag(job: &Job, format: ImageFormat) -> String {
    let mut hasher = blake3::Hasher::new();
    let asked = job.control().iterations;
    hasher.update(format!("{VERSION} {format:?} {} {asked}", job.id()).as_bytes());
    job.live_nodes().for_each(|(_, digest)| _ = hasher.update(&digest.0));
    format!("\"{}\"", &BlobHash::from(hasher.finalize()).to_string()[..32])
}

fn metadata(job: &Job) -> PictureMetadata {
    let spec = &job.head().spec;
    let bandwidth = job.totals().bandwidth;
    let integrator = job.integrator().unwrap_or(spec.integrator.with_defaults());
    let has_angle = integrator.integrator().has_angle();
    PictureMetadata {
        version: VERSION.to_owned(),
        renderer: job.control().renderer.clone().unwrap_or_default(),
        scene_hash: spec.scene.to_string(),
        main: spec.main.clone(),
        defines: spec.defines.clone(),
        sensor: spec.sensor.clone(),
        layers: spec.layers.clone(),
        integrator: integrator.clone(),
        warnings: job.control().warnings.clone(),
        seed: spec.seed,
        iterations: job.done(),
        iterations_asked: Some(job.control().iterations).filter(|asked| job.done() < u64::from(*asked)),
        sigma: bandwidth.map(|range| range.sigma),
        theta: bandwidth.and_then(|range| range.theta).filter(|_| has_angle),
        noise: None,
    }
}
