//! What workers say of a job's scene, which the coordinator does not load: how it decides over settings that the job leaves to it, in
//! which they must agree, and what it was warned about.

use super::record::Change;
use super::{Decision, Farm, Job, Refusal};
use photonfarm_core::picture::NAMES_BYTES;
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_proto::worker::{MOST_WARNINGS, SceneReport, TEXT_BYTES};

impl Farm {
    /// A worker has loaded the scene of a lease, and says how that decides and what it was warned about. What the first one said holds while anything is in
    /// the image or lent to others; whoever says something else is not believed and not blamed, since the first may be wrong.
    pub fn report_scene(&self, report: &SceneReport) -> Result<Decision<()>, Refusal> {
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
        let told = &report.warnings;
        if told.len() > MOST_WARNINGS || told.iter().any(|text| text.len() > TEXT_BYTES) {
            let reason = format!("a scene has at most {MOST_WARNINGS} warnings of {TEXT_BYTES} bytes each");
            return Err(Refusal::Invalid(reason));
        }
        if !report.facts.is_valid() {
            let reason = format!("a picture's file names objects and materials in {NAMES_BYTES} bytes each at most");
            return Err(Refusal::Invalid(reason));
        }
        if differs {
            return Err(Refusal::Disagreement(job.id()));
        }
        let mut control = job.control.clone();
        if asked.complete().is_none() {
            control.integrator = Some(settings.clone());
        }
        if control.warnings.is_empty() || !binds {
            control.warnings = told.clone();
        }
        if control.facts.is_empty() || !binds {
            control.facts = report.facts.clone();
        }
        let changes = match control == job.control {
            true => vec![],
            false => vec![Change::JobChanged { job: job.id(), control }],
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
