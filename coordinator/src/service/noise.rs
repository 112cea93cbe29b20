//! The noise of a prefix of a job's iterations: what a noise target is held against.

use super::{Service, ServiceError};
use crate::background::in_background;
use crate::scheduler::Job;
use photonfarm_core::film::Image;
use photonfarm_core::picture::PictureError;
use photonfarm_proto::id::JobId;
use std::sync::Arc;

impl Service {
    /// Measures the noise at the checkpoint that is due, if there is one; the job goes on or stops.
    pub(super) async fn measure_noise(self: &Arc<Self>, job: JobId) -> Result<bool, ServiceError> {
        let read = |found: &Job| found.due_checkpoint().map(|due| (due, found.layers().clone()));
        let due = self.fresh_farm().await?.farm.job(job).and_then(read);
        let Some(((key, image), layers)) = due else {
            return Ok(false);
        };
        if let Some(node) = self.child(job, (key, image)).await? {
            let measure = move || -> Result<Option<f64>, ServiceError> {
                let stack = Image::average(&[node])?;
                Ok(layers.picture(stack).map_err(PictureError::from)?.noise())
            };
            let noise = in_background(measure).await.map_err(|_| ServiceError::Stopping)??;
            self.histories.measured(job, self.clock.now(), key.end(), noise);
            tracing::info!(%job, iterations = key.end(), noise, "noise measured");
            self.transact(move |farm, _| Ok(farm.checkpoint(job, key, noise)))
                .await?;
        }
        Ok(true)
    }
}
