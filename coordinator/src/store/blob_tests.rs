//! One conformance suite for every blob store, and what is special to each.

use super::*;
use bytes::Bytes;
use photonfarm_test_servers::S3;
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::AsyncReadExt;

/// The stores, and what keeps them.
struct World {
    folder: TempDir,
    s3: S3,
}

impl World {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            s3: S3::start(),
        }
    }

    async fn objects(&self) -> ObjectBlobs {
        let variables = self.s3.environment().map(|(name, value)| (name.to_owned(), value));
        let all = ObjectBlobs::open_with("farm", "a/b", variables.into_iter())
            .await
            .unwrap();
        all.below("nodes")
    }

    async fn stores(&self) -> [(&'static str, Box<dyn BlobStore>); 3] {
        let folder = |name: &str, shared| FolderStore::open(&self.folder.path().join(name), shared).unwrap();
        [
            ("folder", Box::new(folder("own", false))),
            ("shared folder", Box::new(folder("shared", true))),
            ("objects", Box::new(self.objects().await)),
        ]
    }
}

async fn read_all(mut reader: BlobReader) -> Vec<u8> {
    let mut read = Vec::new();
    reader.read_to_end(&mut read).await.unwrap();
    read
}

#[tokio::test]
async fn blobs_are_there_whole_or_not_at_all() {
    let world = World::new();
    for (name, store) in world.stores().await {
        let [hash, another] = [5, 6].map(|copy| BlobName {
            hash: BlobHash::of(b"light"),
            copy,
        });
        assert!(
            matches!(store.read(hash, 5).await, Err(StoreError::NoBlob(_))),
            "{name}"
        );
        assert!(matches!(store.open(hash).await, Err(StoreError::NoBlob(_))), "{name}");

        let mut staged = store.stage(hash).await.unwrap();
        staged.write(b"li").await.unwrap();
        assert_eq!(store.size(hash).await.unwrap(), None, "{name}");
        staged.write(b"ght").await.unwrap();
        assert_eq!(store.list().await.unwrap(), [], "{name}");
        staged.publish().await.unwrap();
        assert_eq!(
            store.read(hash, 5).await.unwrap(),
            Bytes::from_static(b"light"),
            "{name}"
        );
        assert_eq!(store.size(hash).await.unwrap(), Some(5), "{name}");
        assert!(
            matches!(store.read(hash, 4).await, Err(StoreError::Damaged(_))),
            "{name}"
        );

        let mut wrong = store.stage(BlobHash::of(b"dark").into()).await.unwrap();
        wrong.write(b"dork").await.unwrap();
        assert!(
            matches!(wrong.publish().await, Err(StoreError::WrongHash { .. })),
            "{name}"
        );
        assert_eq!(store.size(BlobHash::of(b"dark").into()).await.unwrap(), None, "{name}");
        drop(store.stage(BlobHash::of(b"dark").into()).await.unwrap());

        assert_eq!(
            put(&*store, Bytes::from_static(b"light"), 5).await.unwrap(),
            hash,
            "{name}"
        );
        assert_eq!(store.size(another).await.unwrap(), None, "{name}");
        assert_eq!(
            put(&*store, Bytes::from_static(b"light"), 6).await.unwrap(),
            another,
            "{name}"
        );
        let (bytes, reader) = store.open(hash).await.unwrap();
        assert_eq!((bytes, read_all(reader).await), (5, b"light".to_vec()), "{name}");
        let (bytes, reader) = store.open_at(hash, 2).await.unwrap();
        assert_eq!((bytes, read_all(reader).await), (5, b"ght".to_vec()), "{name}");
        store.remove(hash).await.unwrap();
        store.remove(hash).await.unwrap();
        assert_eq!(store.size(hash).await.unwrap(), None, "{name}");
        assert_eq!(
            store.read(another, 5).await.unwrap(),
            b"light",
            "{name}: a copy of its own"
        );
    }
}

/// Ages are those by the store's clock: what the time is on this machine does not matter to them.
#[tokio::test]
async fn blobs_are_listed_with_their_age() {
    let world = World::new();
    for (name, store) in world.stores().await {
        let mut names = Vec::new();
        for (blob, copy) in [(b"a".as_slice(), 0), (b"b", 1), (b"c", u64::MAX)] {
            names.push(put(&*store, Bytes::copy_from_slice(blob), copy).await.unwrap());
        }
        names.sort_unstable();
        let mut listed = store.list().await.unwrap();
        listed.sort_unstable();
        assert!(listed.iter().map(|(name, _)| *name).eq(names), "{name}");
        let most = Duration::from_secs(600);
        assert!(listed.iter().all(|(_, age)| *age < most), "{name}: {listed:?}");
    }
    let names = ["own", "shared"].map(|folder| world.folder.path().join(folder));
    crate::service::tests::age(&names[0]);
    let listed = FolderStore::open(&names[0], false).unwrap().list().await.unwrap();
    assert!(
        listed.iter().all(|(_, age)| *age >= Duration::from_secs(7000)),
        "{listed:?}"
    );
}

/// More than one request takes: parts of an object that fails leave nothing that can be seen.
#[tokio::test]
async fn long_blobs_are_whole_as_well() {
    let world = World::new();
    let bytes: Vec<u8> = (0..20_000_000u32).map(|i| (i / 7) as u8).collect();
    let hash = BlobName {
        hash: BlobHash::of(&bytes),
        copy: 1,
    };
    for (name, store) in world.stores().await {
        let mut staged = store.stage(hash).await.unwrap();
        staged.write(&bytes[..17_000_000]).await.unwrap();
        assert_eq!(store.list().await.unwrap(), [], "{name}");
        assert!(
            matches!(staged.publish().await, Err(StoreError::WrongHash { .. })),
            "{name}"
        );
        assert_eq!(store.size(hash).await.unwrap(), None, "{name}");

        let mut staged = store.stage(hash).await.unwrap();
        for piece in bytes.chunks(1_234_567) {
            staged.write(piece).await.unwrap();
        }
        staged.publish().await.unwrap();
        assert!(store.read(hash, bytes.len() as u64).await.unwrap() == bytes, "{name}");
    }
}

#[tokio::test]
async fn signed_urls_read_a_blob_and_write_what_is_none_before_it_is_adopted() {
    let world = World::new();
    let store = world.objects().await;
    let http = reqwest::Client::builder().no_proxy().build().unwrap();
    let hash = put(&store, Bytes::from_static(b"light"), 0).await.unwrap();
    let url = store.read_url(hash).await.unwrap().unwrap();
    let get = async |url: &str| http.get(url).send().await.unwrap();
    assert_eq!(get(&url).await.bytes().await.unwrap(), b"light".as_slice());
    let other = BlobHash::of(b"other").to_string();
    let digits = hash.to_string();
    let forged = url.replace(&digits[2..], &other[2..]);
    assert_eq!(get(&forged).await.status(), 403, "the signature is for one object");
    assert_eq!(get(url.split('?').next().unwrap()).await.status(), 403);

    let hash = BlobName {
        hash: BlobHash::of(b"image"),
        copy: 3,
    };
    assert!(matches!(store.adopt("1", hash, 5).await, Err(StoreError::NoBlob(_))));
    let put_image = async |bytes: &'static [u8]| {
        let url = store.write_url("1").await.unwrap().unwrap();
        assert!(http.put(url).body(bytes).send().await.unwrap().status().is_success());
    };
    put_image(b"imag").await;
    assert!(matches!(store.adopt("1", hash, 5).await, Err(StoreError::Damaged(_))));
    assert!(matches!(store.adopt("1", hash, 5).await, Err(StoreError::NoBlob(_))));
    put_image(b"image").await;
    assert_eq!(store.size(hash).await.unwrap(), None);
    store.adopt("1", hash, 5).await.unwrap();
    assert_eq!(store.read(hash, 5).await.unwrap(), b"image");

    let other = BlobName { copy: 4, ..hash };
    put_image(b"imaga").await;
    store.adopt("1", other, 5).await.unwrap();
    assert_eq!(store.read(hash, 5).await.unwrap(), b"image", "another copy");
    put_image(b"imaga").await;
    store.tidy(Duration::MAX).await.unwrap();
    store.adopt("1", other, 5).await.unwrap();
    assert!(matches!(store.read(other, 5).await, Err(StoreError::Damaged(_))));
    put_image(b"image").await;
    store.tidy(Duration::ZERO).await.unwrap();
    assert!(matches!(store.adopt("1", hash, 5).await, Err(StoreError::NoBlob(_))));
    put_image(b"image").await;
    store.discard("1").await.unwrap();
    store.discard("1").await.unwrap();
    assert!(matches!(store.adopt("1", hash, 5).await, Err(StoreError::NoBlob(_))));
}

#[tokio::test]
async fn an_object_store_that_is_away_fails_for_now_and_wrong_keys_for_good() {
    let mut world = World::new();
    let store = world.objects().await;
    let hash = put(&store, Bytes::from_static(b"light"), 0).await.unwrap();
    world.s3.stop();
    let error = store.read(hash, 5).await.unwrap_err();
    assert!(error.retryable(), "{error}");
    world.s3.restart();
    assert_eq!(store.read(hash, 5).await.unwrap(), b"light");
    let wrong = world.s3.environment().map(|(name, value)| match name {
        "AWS_SECRET_ACCESS_KEY" => (name.to_owned(), "guessed".to_owned()),
        _ => (name.to_owned(), value),
    });
    let error = ObjectBlobs::open_with("farm", "", wrong.into_iter()).await.unwrap_err();
    assert!(
        error.to_string().starts_with("s3://farm/: the bucket cannot be read"),
        "{error}"
    );
}

#[tokio::test]
async fn half_written_blobs_are_gone_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let store = FolderStore::open(folder.path(), false).unwrap();
    let mut staged = store.stage(BlobHash::of(b"half").into()).await.unwrap();
    staged.write(b"half").await.unwrap();
    std::mem::forget(staged);
    let store = FolderStore::open(folder.path(), false).unwrap();
    assert_eq!(std::fs::read_dir(folder.path().join("staging")).unwrap().count(), 0);
    assert_eq!(store.list().await.unwrap(), []);
}

#[tokio::test]
async fn damaged_blobs_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let store = FolderStore::open(folder.path(), false).unwrap();
    let hash = put(&store, Bytes::from_static(b"light"), 0).await.unwrap();
    let digits = hash.to_string();
    std::fs::write(folder.path().join(&digits[..2]).join(&digits[2..]), b"lighs").unwrap();
    assert!(matches!(store.read(hash, 5).await, Err(StoreError::Damaged(_))));
}
