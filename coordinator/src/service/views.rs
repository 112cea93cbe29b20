//! Pictures of jobs that go on, for all who look at them: whoever asks for one while it is made, or for one that was made since, gets
//! the same bytes. So many viewers of a job cause one reading of its nodes and one conversion for each picture.

use super::image::{ImageFormat, Picture, PictureFile};
use super::section::Wanted;
use axum::body::Bytes;
use photonfarm_proto::id::JobId;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bytes of pictures in memory in all: eight of 1920 x 1080 pixels as plain numbers.
const MOST_BYTES: usize = 256 << 20;
/// Pictures in memory at most.
const MOST_VIEWS: usize = 256;
/// Time after which a picture that nobody has asked for is forgotten.
const FORGOTTEN: Duration = Duration::from_secs(30);

/// A job, and the form of its picture.
type Key = (JobId, ImageFormat);

/// A picture that was made.
pub(super) struct View {
    pub(super) etag: String,
    /// When what it shows was looked up: who asked before that is to have no other one.
    pub(super) begun: Instant,
    /// When it was there.
    pub(super) made: Instant,
    pub(super) bytes: Bytes,
}

impl View {
    /// What is wanted of the picture, or that it is the one which the client has.
    pub(super) fn answer(&self, wanted: &Wanted<'_>) -> Picture {
        let file = match wanted.is_known(&self.etag) {
            true => PictureFile::Known,
            false => wanted.part(&self.etag, &self.bytes),
        };
        let etag = self.etag.clone();
        Picture { etag, file }
    }
}

/// Where the latest picture of a job in a form is. Whoever makes one holds the lock, and others wait for it.
pub(super) type Place = Arc<tokio::sync::Mutex<Option<View>>>;

struct Known {
    key: Key,
    place: Place,
    bytes: usize,
    used: Instant,
}

/// The latest pictures by job and form, those that were asked for last at the end.
#[derive(Default)]
pub(super) struct Views(Mutex<VecDeque<Known>>);

impl Views {
    /// Where the picture of a job in this form is, or is to be.
    pub(super) fn place(&self, job: JobId, format: &ImageFormat) -> Place {
        let mut all = self.all();
        let key = (job, format.clone());
        let known = match all.iter().position(|known| known.key == key) {
            Some(at) => all.remove(at),
            None => None,
        };
        let known = Known {
            used: Instant::now(),
            ..known.unwrap_or_else(|| Known {
                key,
                place: Place::default(),
                bytes: 0,
                used: Instant::now(),
            })
        };
        let place = known.place.clone();
        all.push_back(known);
        bound(&mut all);
        place
    }

    /// Counts the bytes of a picture that was made, and forgets others where they are too many.
    pub(super) fn count(&self, place: &Place, bytes: usize) {
        let mut all = self.all();
        if let Some(known) = all.iter_mut().find(|known| Arc::ptr_eq(&known.place, place)) {
            known.bytes = bytes;
        }
        bound(&mut all);
    }

    /// Forgets pictures that nobody has asked for lately.
    pub(super) fn forget_old(&self) {
        self.all().retain(|known| known.used.elapsed() < FORGOTTEN);
    }

    fn all(&self) -> MutexGuard<'_, VecDeque<Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn bound(all: &mut VecDeque<Known>) {
    let mut bytes: usize = all.iter().map(|known| known.bytes).sum();
    while bytes > MOST_BYTES || all.len() > MOST_VIEWS {
        match all.pop_front() {
            Some(known) => bytes -= known.bytes,
            None => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_bounded_and_what_was_asked_for_lately_stays() {
        let views = Views::default();
        let place = |job| views.place(JobId(job), &ImageFormat::Raw(vec![]));
        let first = place(1);
        views.count(&first, MOST_BYTES / 2);
        views.count(&place(2), MOST_BYTES / 2);
        assert!(Arc::ptr_eq(&place(1), &first));
        views.count(&place(3), MOST_BYTES / 2);
        assert!(
            Arc::ptr_eq(&place(1), &first),
            "the second was forgotten, not the first"
        );
        assert_eq!(
            views.all().iter().map(|known| known.key.0.0).collect::<Vec<_>>(),
            [3, 1]
        );
        views.count(&first, MOST_BYTES + 1);
        assert!(views.all().is_empty(), "what is too large is kept for nobody");
        for job in 0..2 * MOST_VIEWS as u64 {
            place(job);
        }
        assert_eq!(views.all().len(), MOST_VIEWS);
    }
}
