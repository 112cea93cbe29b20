//! Settings that a job leaves to its scene: the coordinator loads none, so that workers say how it decides, and must agree.

use super::record::{Change, JobControl};
use super::{Decision, Farm, Job, Refusal};
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_proto::worker::SettingsReport;

impl Farm {
    /// A worker has loaded the scene of a lease, and says how that decides. What the first one said holds while anything is in
    /// the image or lent to others; whoever says something else is not believed and not blamed, since the first may be wrong.
    pub fn report_settings(&self, report: &SettingsReport) -> Result<Decision<()>, Refusal> {
        let job = self.live_job(report.job)?;
        job.lease(report.token, report.worker)?;
        let (settings, known) = (&report.integrator, &job.control.integrator);
        let asked = &job.head.spec.integrator;
        let valid = settings.validate().is_ok() && asked.allows(settings);
        // Nothing was rendered with settings of which nothing is in the image or lent.
        let binds = !job.nodes.live.is_empty() || job.leases.len() > 1;
        let differs = known.as_ref().is_some_and(|known| known != settings) && binds;
        if !valid {
            let reason =
                "the scene decides over the settings as the job does not allow: other files or another program";
            return Err(Refusal::Invalid(reason.into()));
        }
        if differs {
            return Err(Refusal::Disagreement(job.id()));
        }
        let changes = match known.as_ref() == Some(settings) || asked.complete().is_some() {
            true => vec![],
            false => vec![Change::JobChanged {
                job: job.id(),
                control: JobControl {
                    integrator: Some(settings.clone()),
                    ..job.control.clone()
                },
            }],
        };
        Ok(Decision::new((), changes))
    }
}

impl Job {
    /// The integrator with all its settings, once they are known.
    #[must_use]
    pub fn integrator(&self) -> Option<&IntegratorSettings> {
        self.head
            .spec
            .integrator
            .complete()
            .or(self.control.integrator.as_ref())
    }
}
