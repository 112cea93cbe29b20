//! The noise of a prefix of a job's iterations: what a noise target is held against.

use super::{Service, ServiceError};
use crate::scheduler::Job;
use photonfarm_core::film::{FilmError, Image, Node};
use photonfarm_proto::id::JobId;
use std::sync::Arc;

impl Service {
    /// Measures the noise at the checkpoint that is due, if there is one; the job goes on or stops.
    pub(super) async fn measure_noise(self: &Arc<Self>, job: JobId) -> Result<bool, ServiceError> {
        let due = self.fresh_farm().await?.farm.job(job).and_then(Job::due_checkpoint);
        let Some((key, image)) = due else { return Ok(false) };
        if let Some(node) = self.child(job, (key, image)).await? {
            let noise = tokio::task::spawn_blocking(move || noise(node))
                .await
                .map_err(|_| ServiceError::Stopping)??;
            tracing::info!(%job, iterations = key.end(), noise, "noise measured");
            self.transact(move |farm, _| Ok(farm.checkpoint(job, key, noise)))
                .await?;
        }
        Ok(true)
    }
}

/// Root mean square of the pixels' standard errors of luminance, over the mean luminance; 0 for a black image. The sum
/// runs from the first pixel to the last at double precision: the same bits give the same noise.
fn noise(node: Node) -> Result<f64, FilmError> {
    let image = Image::average(&[node])?;
    let luminance: f64 = image.pixels.iter().map(|pixel| f64::from(pixel.luminance())).sum();
    let squares: f64 = image.standard_error.iter().map(|error| f64::from(*error).powi(2)).sum();
    if luminance <= 0.0 {
        return Ok(0.0);
    }
    let pixels = image.pixels.len() as f64;
    Ok((squares / pixels).sqrt() / (luminance / pixels))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::spectrum::Spectrum;

    fn prefix(values: [[f32; 2]; 4]) -> Node {
        let leaves = values.iter().enumerate().map(|(index, pixels)| {
            let pixels = pixels.map(Spectrum::splat);
            Node::leaf(index as u32, 2, 1, &pixels).unwrap()
        });
        let mut leaves = leaves.collect::<Vec<_>>().into_iter();
        let mut pair = || leaves.next().unwrap().merge(&leaves.next().unwrap()).unwrap();
        pair().merge(&pair()).unwrap()
    }

    #[test]
    fn noise_is_the_standard_error_over_the_mean() {
        let found = noise(prefix([[1.0, 2.0], [3.0, 2.0], [1.0, 2.0], [3.0, 2.0]])).unwrap();
        let expected = (1.0_f64 / 3.0 / 2.0).sqrt() / 2.0;
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} is not {expected}");
        assert_eq!(noise(prefix([[2.0; 2]; 4])).unwrap(), 0.0);
        assert_eq!(noise(prefix([[0.0; 2]; 4])).unwrap(), 0.0);
    }
}
