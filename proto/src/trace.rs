//! Traces of jobs: what was done when, by which process, from the submission to the image.
//!
//! A job is one trace. Its number follows from farm and job, and that of the span of a lease from its token: coordinators that
//! start again, or share a farm, name the same things alike, and nothing is to be kept of them. What a process has measured goes
//! to a [`Sink`]; without one nothing is measured.

use crate::hex::{Hex, bytes_of};
use crate::id::{JobId, LeaseToken};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Instant, SystemTime, UNIX_EPOCH};
use thiserror::Error;

/// Header of a request that is part of a trace, as of W3C Trace Context.
pub const TRACEPARENT: &str = "traceparent";

/// A span of a trace, as others name it. All zeros: none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Context {
    /// The trace.
    pub trace: [u8; 16],
    /// The span.
    pub span: [u8; 8],
}

/// Not a `traceparent` of version 00.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("expected 00-TRACE-SPAN-FLAGS in lower-case hexadecimal digits, neither of them all zeros")]
pub struct ContextError;

impl Context {
    /// The submission of a job, which is the root of its trace.
    #[must_use]
    pub fn of_job(farm: &str, job: JobId) -> Self {
        let mut bits = [0; 24];
        let mut hasher = blake3::Hasher::new_derive_key("photonfarm trace of a job");
        hasher.update(&job.0.to_le_bytes()).update(farm.as_bytes());
        hasher.finalize_xof().fill(&mut bits);
        let mut context = Self::default();
        context.trace.copy_from_slice(&bits[..16]);
        context.span.copy_from_slice(&bits[16..]);
        context
    }

    /// The span of a lease of this job.
    #[must_use]
    pub fn lease(self, token: LeaseToken) -> Self {
        self.child("lease", token.number)
    }

    /// A span below this one, told from others of the same name by a number.
    #[must_use]
    pub fn child(self, name: &str, number: u64) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("photonfarm span");
        hasher.update(&self.span).update(&number.to_le_bytes());
        hasher.update(name.as_bytes());
        let mut span = [0; 8];
        hasher.finalize_xof().fill(&mut span);
        Self { span, ..self }
    }

    /// Whether it names anything.
    #[must_use]
    pub fn is_some(self) -> bool {
        self.trace != [0; 16] && self.span != [0; 8]
    }
}

/// A `traceparent`.
impl fmt::Display for Context {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "00-{}-{}-01", Hex(&self.trace), Hex(&self.span))
    }
}

impl FromStr for Context {
    type Err = ContextError;

    fn from_str(text: &str) -> Result<Self, ContextError> {
        let mut parts = text.split('-');
        let mut next = || parts.next().ok_or(ContextError);
        let (version, trace, span, flags) = (next()?, next()?, next()?, next()?);
        if version != "00" || parts.next().is_some() || bytes_of::<1>(flags).is_none() {
            return Err(ContextError);
        }
        let (trace, span) = bytes_of(trace).zip(bytes_of(span)).ok_or(ContextError)?;
        let context = Self { trace, span };
        context.is_some().then_some(context).ok_or(ContextError)
    }
}

/// A fact about a span.
#[derive(Clone, Debug, PartialEq)]
pub enum Fact {
    /// In words.
    Text(String),
    /// A count.
    Count(u64),
}

impl From<u64> for Fact {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl From<String> for Fact {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// Something that was done, and when.
#[derive(Clone, Debug, PartialEq)]
pub struct Span {
    /// What others call it.
    pub context: Context,
    /// The span that it is a part of; none for the root of a trace.
    pub parent: Option<[u8; 8]>,
    /// A span of another trace that made it happen.
    pub link: Option<Context>,
    /// What was done.
    pub name: &'static str,
    /// When it began [nanoseconds since 1970].
    pub start_ns: u64,
    /// When it ended [nanoseconds since 1970].
    pub end_ns: u64,
    /// What else is known of it.
    pub facts: Vec<(&'static str, Fact)>,
    /// Why it failed, if it did.
    pub error: Option<String>,
}

/// Takes spans. It never waits: what cannot be taken is dropped.
pub trait Sink: Send + Sync {
    /// Takes a span.
    fn take(&self, span: Span);
}

/// Where a process puts its spans, if anywhere.
#[derive(Clone, Default)]
pub struct Tracer(Option<Arc<dyn Sink>>);

impl fmt::Debug for Tracer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.is_on() { "Tracer(on)" } else { "Tracer(off)" })
    }
}

impl Tracer {
    /// Puts spans into a sink.
    #[must_use]
    pub fn new(sink: Arc<dyn Sink>) -> Self {
        Self(Some(sink))
    }

    /// Whether anybody wants spans.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// Puts a span away that was measured already.
    pub fn put(&self, span: Span) {
        if let Some(sink) = &self.0 {
            sink.take(span);
        }
    }

    /// Begins a span within another one. It ends when what is returned is dropped.
    pub fn begin(&self, within: Context, name: &'static str) -> Open {
        Open(match &self.0 {
            Some(sink) if within.is_some() => Some(Begun::new(sink.clone(), within, name)),
            _ => None,
        })
    }
}

/// Nanoseconds since 1970.
#[must_use]
pub fn now_ns() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX)
}

/// A span that goes on; nothing where nobody wants it.
#[derive(Default)]
#[must_use = "it ends when it is dropped"]
pub struct Open(Option<Begun>);

struct Begun {
    sink: Arc<dyn Sink>,
    since: Instant,
    span: Span,
}

impl Begun {
    fn new(sink: Arc<dyn Sink>, within: Context, name: &'static str) -> Self {
        let start_ns = now_ns();
        let span = Span {
            context: within.child(name, start_ns),
            parent: Some(within.span),
            link: None,
            name,
            start_ns,
            end_ns: start_ns,
            facts: Vec::new(),
            error: None,
        };
        let since = Instant::now();
        Self { sink, since, span }
    }
}

impl Open {
    /// What others call it; all zeros where nobody wants it.
    #[must_use]
    pub fn context(&self) -> Context {
        self.0.as_ref().map(|begun| begun.span.context).unwrap_or_default()
    }

    /// Adds a fact, which is asked for only if somebody wants it.
    pub fn fact<F: Into<Fact>>(&mut self, name: &'static str, fact: impl FnOnce() -> F) {
        if let Some(begun) = &mut self.0 {
            begun.span.facts.push((name, fact().into()));
        }
    }

    /// It failed.
    pub fn failed(&mut self, why: impl fmt::Display) {
        if let Some(begun) = &mut self.0 {
            begun.span.error = Some(why.to_string());
        }
    }

    /// It ends; with a failure, if the result is one.
    pub fn end<T, E: fmt::Display>(mut self, result: &Result<T, E>) {
        if let Err(error) = result {
            self.failed(error);
        }
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        if let Some(Begun { sink, since, mut span }) = self.0.take() {
            let taken = u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
            span.end_ns = span.start_ns.saturating_add(taken);
            sink.take(span);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Kept(Mutex<Vec<Span>>);

    impl Sink for Kept {
        fn take(&self, span: Span) {
            self.0.lock().unwrap().push(span);
        }
    }

    #[test]
    fn a_context_survives_as_a_header_and_others_are_refused() {
        let context = Context::of_job("farm", JobId(3));
        let text = context.to_string();
        assert_eq!((text.len(), text.parse()), (55, Ok(context)));
        let [zero, trace] = ["0".repeat(32), "0af7651916cd43dd8448eb211c80319c".to_owned()];
        for wrong in [
            "",
            "00",
            &text[..54],
            &format!("{text}-00"),
            &text.replacen("00", "ff", 1),
            &format!("00-{zero}-b7ad6b7169203331-01"),
            &format!("00-{trace}-0000000000000000-01"),
            &format!("00-{}-b7ad6b7169203331-01", trace.to_uppercase()),
            &format!("00-{trace}-b7ad6b716920333é-01"),
        ] {
            assert_eq!(wrong.parse::<Context>(), Err(ContextError), "{wrong}");
        }
    }

    #[test]
    fn names_follow_from_farm_job_and_lease_alone() {
        let token = |number| LeaseToken { number, nonce: 7 };
        let job = Context::of_job("a", JobId(1));
        assert_eq!(job.lease(token(5)), Context::of_job("a", JobId(1)).lease(token(5)));
        assert_eq!(job.lease(token(5)).trace, job.trace);
        assert_ne!(job.lease(token(5)).span, job.lease(token(6)).span);
        assert_ne!(job.trace, Context::of_job("b", JobId(1)).trace);
        assert_ne!(job.trace, Context::of_job("a", JobId(2)).trace);
    }

    #[test]
    fn spans_end_where_they_are_dropped_and_nothing_is_asked_without_a_sink() {
        let kept = Arc::new(Kept::default());
        let job = Context::of_job("a", JobId(1));
        let on = Tracer::new(kept.clone());
        let mut span = on.begin(job, "load");
        span.fact("files", || 3);
        let context = span.context();
        span.end(&Err::<(), _>("no scene"));
        drop(on.begin(Context::default(), "load"));
        let spans = kept.0.lock().unwrap();
        let [span] = spans.as_slice() else { panic!("{spans:?}") };
        assert_eq!(
            (span.context, span.parent, span.name),
            (context, Some(job.span), "load")
        );
        assert_eq!(span.facts, [("files", Fact::Count(3))]);
        assert_eq!(span.error.as_deref(), Some("no scene"));
        assert!(span.start_ns <= span.end_ns);

        let mut off = Tracer::default().begin(job, "load");
        off.fact::<u64>("files", || unreachable!("nobody wants it"));
        assert!(!off.context().is_some());
    }
}
