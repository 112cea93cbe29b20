//! Uploads that go on where they broke.
//!
//! What has come of a file is kept in parts of [`PART_BYTES`] in the store of scenes, until the file is whole and has its hash.
//! Their names are made from the owner and the hash of the file, so that nobody can meet the parts of others, and whichever
//! coordinator is asked finds them. No bundle names them: what is abandoned goes with the files of scenes that nobody names.

use super::upload::next_piece;
use super::{Service, ServiceError};
use crate::access::Caller;
use crate::scheduler::record::BlobName;
use crate::store::{StagedBlob, StoreError};
use axum::body::Bytes;
use futures_util::Stream;
use photonfarm_proto::api::UploadState;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};
use tokio::io::AsyncReadExt;
use tokio::sync::{OwnedMutexGuard, Semaphore, watch};

/// Bytes of each part but the last: as many are lost if the coordinator is killed.
const PART_BYTES: u64 = 32 << 20;
/// Parts of unfinished uploads: of each owner, and of all.
const MOST_OF_OWNER: u64 = 256;
const MOST: u64 = 2048;
/// How long an upload counts that nobody has gone on with: longer than its parts are kept.
const FORGOTTEN: Duration = Duration::from_secs(26 * 3600);
/// How long it is remembered that an upload was whole, for a sender that has lost the answer.
const REMEMBERED: Duration = Duration::from_secs(600);
/// Files put together at once.
const JOINED: usize = 2;
/// Bytes that are copied at a time.
const PIECE: usize = 1 << 18;

/// The upload of a file by one owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Upload {
    file: BlobHash,
    /// What the names of its parts have in common.
    key: BlobHash,
    /// Digits of the owner, which the names of parts have too.
    owner: u32,
}

impl Upload {
    fn new(file: BlobHash, caller: &Caller) -> Self {
        let digits = BlobHash::of(caller.name.as_bytes()).0;
        let of = format!("an upload of {file} by {}", caller.name);
        Self {
            file,
            key: BlobHash::of(of.as_bytes()),
            owner: u32::from_be_bytes([digits[0], digits[1], digits[2], digits[3]]),
        }
    }

    /// The name of a part. Files of scenes have copy 0, which no part has.
    fn part(&self, index: u64) -> BlobName {
        BlobName {
            hash: self.key,
            copy: (u64::from(self.owner) << 32) | (index + 1),
        }
    }
}

/// The digits of the owner of a part, if it is the name of one.
pub(super) fn owner_of_part(name: BlobName) -> Option<u32> {
    (name.copy != 0).then_some((name.copy >> 32) as u32)
}

/// What is known of unfinished uploads besides their parts.
pub(super) struct Partials {
    turns: Mutex<HashMap<BlobHash, Weak<Turn>>>,
    counted: Mutex<HashMap<BlobHash, Counted>>,
    /// Sizes of files that were whole a short while ago.
    finished: Mutex<HashMap<BlobHash, (u64, Instant)>>,
    joining: Semaphore,
}

impl Default for Partials {
    fn default() -> Self {
        Self {
            turns: Mutex::default(),
            counted: Mutex::default(),
            finished: Mutex::default(),
            joining: Semaphore::new(JOINED),
        }
    }
}

/// An upload as it counts against the bounds.
struct Counted {
    owner: u32,
    parts: u64,
    touched: Instant,
}

/// One request at a time goes on with an upload; the next one ends it.
#[derive(Default)]
struct Turn {
    busy: Arc<tokio::sync::Mutex<()>>,
    wanted: watch::Sender<()>,
}

struct Hold {
    _turn: Arc<Turn>,
    _busy: OwnedMutexGuard<()>,
    wanted: watch::Receiver<()>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Partials {
    /// Ends the request that goes on with an upload now, if any, and takes its place.
    async fn hold(&self, key: BlobHash) -> Hold {
        let turn = {
            let mut turns = lock(&self.turns);
            turns.retain(|_, turn| turn.strong_count() > 0);
            let known = turns.get(&key).and_then(Weak::upgrade);
            known.unwrap_or_else(|| {
                let turn = Arc::<Turn>::default();
                turns.insert(key, Arc::downgrade(&turn));
                turn
            })
        };
        turn.wanted.send_replace(());
        let busy = turn.busy.clone().lock_owned().await;
        Hold {
            wanted: turn.wanted.subscribe(),
            _turn: turn,
            _busy: busy,
        }
    }

    /// Counts so many parts for an upload, or refuses it.
    fn reserve(&self, upload: &Upload, parts: u64) -> Result<(), Problem> {
        let mut counted = lock(&self.counted);
        counted.retain(|_, upload| upload.touched.elapsed() < FORGOTTEN);
        let others = counted.iter().filter(|(key, _)| **key != upload.key);
        let (mut own, mut all) = (parts, parts);
        for (_, other) in others {
            all += other.parts;
            own += if other.owner == upload.owner { other.parts } else { 0 };
        }
        if own > MOST_OF_OWNER || all > MOST {
            let gigabytes = |parts: u64| (parts * PART_BYTES) >> 30;
            let detail = format!(
                "the unfinished uploads of one token may take {} GiB, those of all {} GiB: finish others first, or send the file in \
                 one piece by PUT",
                gigabytes(MOST_OF_OWNER),
                gigabytes(MOST)
            );
            return Err(Problem::new(ErrorCode::Limit, detail));
        }
        let (owner, touched) = (upload.owner, Instant::now());
        counted.insert(upload.key, Counted { owner, parts, touched });
        Ok(())
    }

    /// Counts parts that were found in the store, where nothing is known of their upload.
    pub(super) fn found(&self, key: BlobHash, owner: u32, parts: u64) {
        let touched = Instant::now();
        let counted = || Counted { owner, parts, touched };
        lock(&self.counted).entry(key).or_insert_with(counted);
    }

    /// Counts an upload no more.
    pub(super) fn release(&self, key: BlobHash) {
        lock(&self.counted).remove(&key);
    }

    fn remember(&self, key: BlobHash, bytes: u64) {
        let mut finished = lock(&self.finished);
        finished.retain(|_, (_, at)| at.elapsed() < REMEMBERED);
        finished.insert(key, (bytes, Instant::now()));
    }

    fn finished(&self, key: BlobHash) -> Option<u64> {
        let finished = lock(&self.finished);
        let (bytes, at) = finished.get(&key)?;
        (at.elapsed() < REMEMBERED).then_some(*bytes)
    }
}

/// A part as it is written.
struct Part {
    staged: Box<dyn StagedBlob>,
    bytes: u64,
    /// Whether there is more in it than what was kept before.
    grown: bool,
}

impl Part {
    async fn keep(self) -> Result<(), StoreError> {
        match self.grown {
            true => self.staged.publish().await,
            false => Ok(()),
        }
    }
}

impl Service {
    /// The size that bundles give for a file.
    pub(super) async fn announced_size(&self, hash: BlobHash) -> Result<u64, ServiceError> {
        let known = self.stores.state.bundled_size(hash).await?;
        Ok(known.ok_or_else(|| {
            let detail = format!("no bundle names a file {hash}: send the manifest first");
            Problem::new(ErrorCode::NotFound, detail)
        })?)
    }

    /// How much is kept of the caller's upload of a file. A request that goes on with it now is ended.
    pub async fn upload_state(&self, hash: BlobHash, caller: &Caller) -> Result<UploadState, ServiceError> {
        self.announced_size(hash).await?;
        let upload = Upload::new(hash, caller);
        let _hold = self.partials.hold(upload.key).await;
        self.state_of(&upload).await
    }

    async fn state_of(&self, upload: &Upload) -> Result<UploadState, ServiceError> {
        if let Some(bytes) = self.partials.finished(upload.key)
            && self.stores.scenes.size(upload.file.into()).await? == Some(bytes)
        {
            let (offset, complete) = (bytes, true);
            return Ok(UploadState { offset, complete });
        }
        let (mut offset, complete) = (0, false);
        for index in 0..MOST {
            match self.stores.scenes.size(upload.part(index)).await? {
                Some(PART_BYTES) => offset += PART_BYTES,
                last => {
                    offset += last.filter(|bytes| *bytes < PART_BYTES).unwrap_or(0);
                    break;
                }
            }
        }
        Ok(UploadState { offset, complete })
    }

    /// Goes on with the caller's upload of a file from `offset`, with `length` bytes if that is known. If the file ends with
    /// them, it is put together and held against its hash. Runs to its end even if the caller is dropped.
    pub async fn append_blob<S, E>(
        self: &Arc<Self>,
        hash: BlobHash,
        (offset, length): (u64, Option<u64>),
        last: bool,
        body: S,
        caller: &Caller,
    ) -> Result<UploadState, ServiceError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin + Send + 'static,
        E: std::fmt::Display + Send + 'static,
    {
        let limit = self.announced_size(hash).await?;
        let upload = Upload::new(hash, caller);
        let mut hold = self.partials.hold(upload.key).await;
        let state = self.state_of(&upload).await?;
        if state.offset != offset {
            let detail = format!(
                "{} bytes of the file are kept, not {offset}: go on from there",
                state.offset
            );
            return Err(Problem::new(ErrorCode::OffsetMismatch, detail).into());
        }
        if state.complete {
            return Ok(state);
        }
        let end = length.map_or(limit, |length| offset.saturating_add(length));
        if end > limit {
            return Err(too_long(limit));
        }
        self.partials.reserve(&upload, end.div_ceil(PART_BYTES).max(1))?;
        let service = self.clone();
        let task = async move {
            let offset = service.receive(&upload, (offset, limit), body, &mut hold).await?;
            let complete = last;
            if complete {
                service.join(&upload, offset).await?;
            }
            Ok(UploadState { offset, complete })
        };
        tokio::spawn(task).await.map_err(|_| ServiceError::Stopping)?
    }

    /// Keeps what comes, to its end or to where it breaks. Returns how much is kept of the file then.
    async fn receive<S, E>(
        &self,
        upload: &Upload,
        (mut offset, limit): (u64, u64),
        mut body: S,
        hold: &mut Hold,
    ) -> Result<u64, ServiceError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin,
        E: std::fmt::Display,
    {
        let mut part = self.open_part(upload, offset).await?;
        loop {
            let next = tokio::select! {
                biased;
                _ = hold.wanted.changed() => Err(taken_over()),
                next = next_piece(&mut body) => next,
            };
            let mut rest = match next {
                Ok(Some(piece)) if piece.len() as u64 <= limit - offset => piece,
                over => {
                    part.keep().await?;
                    return match over? {
                        Some(_) => Err(too_long(limit)),
                        None => Ok(offset),
                    };
                }
            };
            while !rest.is_empty() {
                let now = rest.split_to(rest.len().min((PART_BYTES - part.bytes) as usize));
                part.bytes += now.len() as u64;
                part.grown = true;
                offset += now.len() as u64;
                part.staged.write_pieces(vec![now]).await?;
                if part.bytes == PART_BYTES {
                    part.keep().await?;
                    part = self.open_part(upload, offset).await?;
                }
            }
        }
    }

    /// The part that goes on at `offset`, with what is kept of it.
    async fn open_part(&self, upload: &Upload, offset: u64) -> Result<Part, ServiceError> {
        let name = upload.part(offset / PART_BYTES);
        let mut staged = self.stores.scenes.stage(name).await?;
        staged.trust();
        let bytes = offset % PART_BYTES;
        if bytes > 0 {
            self.copy(name, &mut staged).await?;
        }
        Ok(Part {
            staged,
            bytes,
            grown: false,
        })
    }

    async fn copy(&self, from: BlobName, to: &mut Box<dyn StagedBlob>) -> Result<u64, StoreError> {
        let (bytes, mut reader) = self.stores.scenes.open(from).await?;
        let mut left = bytes;
        while left > 0 {
            let mut piece = vec![0; PIECE.min(left as usize)];
            let read = reader.read_exact(&mut piece).await;
            read.map_err(|source| StoreError::Io {
                path: from.to_string().into(),
                source,
            })?;
            left -= piece.len() as u64;
            to.write_pieces(vec![piece.into()]).await?;
        }
        Ok(bytes)
    }

    /// Makes the file of its parts, if they have its hash; if they do not, they are of no use to anybody.
    async fn join(&self, upload: &Upload, bytes: u64) -> Result<(), ServiceError> {
        let _turn = self
            .partials
            .joining
            .acquire()
            .await
            .map_err(|_| ServiceError::Stopping)?;
        let mut staged = self.stores.scenes.stage(upload.file.into()).await?;
        let (parts, mut copied) = (bytes.div_ceil(PART_BYTES), 0);
        for index in 0..parts {
            copied += self.copy(upload.part(index), &mut staged).await?;
        }
        let placing = self.missing_files.placing().await;
        let joined = staged.publish().await;
        drop(placing);
        if let Err(StoreError::WrongHash { .. }) | Ok(()) = &joined {
            for index in 0..parts {
                self.stores.scenes.remove(upload.part(index)).await?;
            }
            self.partials.release(upload.key);
        }
        match joined {
            Ok(()) => {
                self.partials.remember(upload.key, copied);
                self.note_sent(upload.file);
                Ok(())
            }
            Err(StoreError::WrongHash { expected, found }) => {
                let detail = format!(
                    "the {copied} bytes that came have hash {found}, not {expected}: nothing of them is kept, so that the \
                     upload begins anew"
                );
                Err(Problem::new(ErrorCode::ContentMismatch, detail).into())
            }
            Err(error) => Err(error.into()),
        }
    }
}

/// The answer to a body that goes on beyond the end of its file.
pub(super) fn too_long(limit: u64) -> ServiceError {
    let detail = format!("the file is longer than the {limit} bytes of its manifest");
    Problem::new(ErrorCode::ContentMismatch, detail).into()
}

fn taken_over() -> ServiceError {
    let detail = "another request goes on with this upload";
    Problem::new(ErrorCode::Unavailable, detail).after(1).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unfinished_uploads_are_bounded_for_each_owner_and_for_all() {
        let partials = Partials::default();
        let upload = |owner: u32, file: u8| Upload {
            file: BlobHash([file; 32]),
            key: BlobHash::of(&[owner as u8, file]),
            owner,
        };
        partials.reserve(&upload(1, 1), MOST_OF_OWNER - 1).unwrap();
        partials.reserve(&upload(1, 2), 1).unwrap();
        let refused = partials.reserve(&upload(1, 3), 1).unwrap_err();
        assert_eq!(refused.code, ErrorCode::Limit);
        partials
            .reserve(&upload(1, 1), MOST_OF_OWNER - 1)
            .expect("the same one again");
        for owner in 2..=u32::try_from(MOST / MOST_OF_OWNER).unwrap() {
            partials.reserve(&upload(owner, 1), MOST_OF_OWNER).unwrap();
        }
        partials.reserve(&upload(9, 1), 1).unwrap_err();
        partials.release(upload(1, 2).key);
        partials.reserve(&upload(9, 1), 1).unwrap();
        partials.found(upload(9, 2).key, 9, MOST);
        partials.reserve(&upload(9, 1), 1).expect_err("what was found counts");
    }

    #[test]
    fn parts_of_different_owners_and_files_never_meet() {
        let names = ["", "ann", "bea"].map(|name| {
            let caller = Caller {
                name: name.into(),
                ..Caller::anyone()
            };
            [b"a", b"b"].map(|file| [0, 1, MOST].map(|index| Upload::new(BlobHash::of(file), &caller).part(index)))
        });
        let names: Vec<BlobName> = names.into_iter().flatten().flatten().collect();
        let distinct: std::collections::BTreeSet<_> = names.iter().collect();
        assert_eq!(distinct.len(), names.len());
        assert!(names.iter().all(|name| owner_of_part(*name).is_some()));
        assert_eq!(owner_of_part(BlobHash::of(b"a").into()), None);
    }
}
