//! Work that takes a thread for itself, beside the tasks that wait.

use std::any::Any;
use tokio::task::{JoinError, JoinHandle};

/// A value of some type that only its two ends know. What carries it is compiled once, and not for each type again.
pub(crate) type Parcel = Box<dyn Any + Send>;

/// What a parcel holds.
///
/// # Panics
/// It holds something of another type.
pub(crate) fn unpacked<T: 'static>(parcel: Parcel) -> T {
    *parcel.downcast().expect("both ends of a parcel know its type")
}

/// Does work that waits for disks or computes for long, to its end even if the caller is dropped.
///
/// # Errors
/// The work panicked, or the runtime ends.
pub(crate) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, JoinError> {
    let done = begin(Box::new(move || Box::new(work()))).await?;
    Ok(unpacked(done))
}

fn begin(work: Box<dyn FnOnce() -> Parcel + Send>) -> JoinHandle<Parcel> {
    tokio::task::spawn_blocking(work)
}
