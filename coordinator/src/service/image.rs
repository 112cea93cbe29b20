//! The image of a job at any time: the average over the nodes that count.

use super::preview::encode_preview;
use super::raw::{encode_raw, planes};
use super::section::{Section, Wanted};
use super::views::View;
use super::{Service, ServiceError, VERSION};
use crate::background::in_background;
use crate::scheduler::Job;
use crate::store::BlobReader;
use axum::body::Bytes;
use photonfarm_core::film::Image;
use photonfarm_core::picture::{self, Beside, PictureError, PictureMetadata};
use photonfarm_core::tree::Average;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often a picture is begun anew because its nodes were merged meanwhile.
const ATTEMPTS: usize = 8;

/// Least time between two pictures of a job that goes on, of the formats that people watch it by.
const PAUSE: Duration = Duration::from_millis(500);

/// A file format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// OpenEXR with metadata: linear radiance.
    Exr,
    /// PNG by a tone curve.
    Png,
    /// Small JPEG as the PNG shows it.
    Jpeg,
    /// Plain numbers ([`encode_raw`]): the picture, and the layers at these places in the job's list.
    Raw(Vec<usize>),
}

impl ImageFormat {
    /// Its name in the state.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::Raw(_) => "raw",
        }
    }

    /// Whether the picture of a job that has ended is kept. Plain numbers take more room than they take time to make.
    pub(super) fn is_kept(&self) -> bool {
        !matches!(self, Self::Raw(_))
    }

    /// Whether people follow a job by it.
    fn is_watched(&self) -> bool {
        matches!(self, Self::Raw(_) | Self::Jpeg)
    }

    /// Refuses layers that the job has not.
    fn check(&self, job: &Job) -> Result<(), Problem> {
        let count = job.head().spec.layers.len();
        let Self::Raw(chosen) = self else { return Ok(()) };
        match chosen.iter().find(|place| **place >= count) {
            Some(place) => {
                let detail = format!(
                    "layers: job {} has {count} layers, and none with number {}",
                    job.id(),
                    place + 1
                );
                Err(Problem::new(ErrorCode::Invalid, detail).at("layers", None))
            }
            None => Ok(()),
        }
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
        let asked = Instant::now();
        for _ in 0..ATTEMPTS {
            let begun = Instant::now();
            let job = self.find_job(id).await?;
            format.check(&job)?;
            let etag = etag(&job, &format);
            if wanted.is_known(&etag) {
                let file = PictureFile::Known;
                return Ok(Picture { etag, file });
            }
            let picture = match job.ended_ms().is_some() && format.is_kept() {
                true => self.last_picture(&job, &format, etag, wanted).await?,
                false => self.view((&job, &format, etag), wanted, (asked, begun)).await?,
            };
            if let Some(picture) = picture {
                return Ok(picture);
            }
        }
        Err(Problem::new(ErrorCode::Internal, "nodes of the image are missing").into())
    }

    /// A picture that was made since it was `asked` for, or is still right, or is made now; nothing if it is to be looked for once
    /// more. `begun` is when the job was looked up.
    async fn view(
        self: &Arc<Self>,
        (job, format, etag): (&Job, &ImageFormat, String),
        wanted: &Wanted<'_>,
        (asked, begun): (Instant, Instant),
    ) -> Result<Option<Picture>, ServiceError> {
        let place = self.views.place(job.id(), format);
        let (mut view, waited) = match place.try_lock() {
            Ok(view) => (view, false),
            Err(_) => (place.lock().await, true),
        };
        if let Some(found) = view.as_mut() {
            if found.etag == etag {
                found.begun = found.begun.max(begun);
            }
            if found.begun >= asked {
                return Ok(Some(found.answer(wanted)));
            }
            let rest = PAUSE.checked_sub(found.made.elapsed());
            if let Some(rest) = rest.filter(|_| format.is_watched() && job.ended_ms().is_none()) {
                tokio::time::sleep(rest).await;
                return Ok(None);
            }
        }
        if waited {
            return Ok(None);
        }
        let Some(bytes) = self.make_picture(job, format).await? else {
            return Ok(None);
        };
        self.views.count(&place, bytes.len());
        let made = Instant::now();
        let view = view.insert(View {
            etag,
            begun,
            made,
            bytes,
        });
        Ok(Some(view.answer(wanted)))
    }

    /// The picture of a job that has ended, which is made once and kept; nothing if a node was given up meanwhile.
    async fn last_picture(
        self: &Arc<Self>,
        job: &Job,
        format: &ImageFormat,
        etag: String,
        wanted: &Wanted<'_>,
    ) -> Result<Option<Picture>, ServiceError> {
        if let Some(file) = self.kept_picture(job, format, &etag, wanted).await? {
            return Ok(Some(Picture { etag, file }));
        }
        let _once = self.finishing.lock().await;
        if let Some(file) = self.kept_picture(job, format, &etag, wanted).await? {
            return Ok(Some(Picture { etag, file }));
        }
        let Some(bytes) = self.make_picture(job, format).await? else {
            return Ok(None);
        };
        if let Some(ended_ms) = job.ended_ms() {
            self.keep_picture((job.id(), ended_ms), format, &etag, bytes.clone())
                .await;
        }
        let file = wanted.part(&etag, &bytes);
        Ok(Some(Picture { etag, file }))
    }

    /// Makes the picture of a job; nothing if a node was merged or given up meanwhile.
    async fn make_picture(self: &Arc<Self>, job: &Job, format: &ImageFormat) -> Result<Option<Bytes>, ServiceError> {
        let _permit = self.pictures.acquire().await.map_err(|_| ServiceError::Stopping)?;
        let Some(image) = self.average(job).await? else {
            return Ok(None);
        };
        let (metadata, layers, format) = (metadata(job), job.layers().clone(), format.clone());
        let facts = job.control().facts.clone();
        let iterations = image.iterations;
        let encode = move || {
            let planes = match &format {
                ImageFormat::Raw(chosen) => planes(&image, &metadata.layers, chosen)?,
                ImageFormat::Exr | ImageFormat::Png | ImageFormat::Jpeg => vec![],
            };
            let beside = match format {
                ImageFormat::Exr => Beside {
                    channels: layers.channels(&image)?,
                    attributes: layers.attributes(&facts.objects, &facts.materials),
                    whole: facts.picture,
                },
                ImageFormat::Raw(_) | ImageFormat::Png | ImageFormat::Jpeg => Beside::default(),
            };
            let image = layers.picture(image)?;
            let noise = image.noise();
            let bytes = match format {
                ImageFormat::Raw(_) => encode_raw(&image, noise, &planes),
                ImageFormat::Exr => picture::encode_exr(&image, beside, &PictureMetadata { noise, ..metadata })?,
                ImageFormat::Png => picture::encode_png(&image)?,
                ImageFormat::Jpeg => encode_preview(&image)?,
            };
            Ok::<_, PictureError>((bytes, noise))
        };
        let (bytes, noise) = in_background(encode).await.map_err(|_| ServiceError::Stopping)??;
        self.histories.measured(job.id(), self.clock.now(), iterations, noise);
        Ok(Some(Bytes::from(bytes)))
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
            average = in_background(add).await.map_err(|_| ServiceError::Stopping)??;
            empty = false;
        }
        if empty {
            let detail = format!("no iteration of job {} has arrived yet", job.id());
            return Err(Problem::new(ErrorCode::NoImageYet, detail).into());
        }
        Ok(Some(average.finish()?))
    }
}

fn etag(job: &Job, format: &ImageFormat) -> String {
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
        crop: spec.crop,
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
