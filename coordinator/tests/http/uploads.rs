//! Uploads that go on where they broke.

use crate::access::{Closed, request};
use crate::support::{Farm, expect_problem};
use photonfarm_proto::api::{UPLOAD_COMPLETE, UPLOAD_OFFSET, UploadState};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::token::Role;
use reqwest::{Method, RequestBuilder, Response, StatusCode};
use std::fs;
use std::path::Path;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Longer than one part of it that is kept.
const LONG: usize = (32 << 20) + 1000;

fn manifest(bytes: &[u8]) -> BundleManifest {
    let files = [("scene.xml".to_owned(), FileEntry::of(bytes))].into();
    BundleManifest { files }
}

async fn announce(farm: &Farm, bytes: &[u8]) -> String {
    let manifest = serde_json::to_value(manifest(bytes)).unwrap();
    assert_eq!(farm.post_json("bundles", &manifest).await.status(), StatusCode::OK);
    format!("blobs/{}/upload", BlobHash::of(bytes))
}

async fn send(request: RequestBuilder, offset: usize, bytes: &[u8]) -> Response {
    let request = request.header(UPLOAD_OFFSET, offset).body(bytes.to_vec());
    request.send().await.unwrap()
}

async fn state(request: RequestBuilder) -> (u64, bool) {
    let reply = request.send().await.unwrap();
    assert_eq!(reply.status(), StatusCode::OK);
    let said = reply.headers()[UPLOAD_OFFSET].to_str().unwrap().to_owned();
    let UploadState { offset, complete } = reply.json().await.unwrap();
    assert_eq!(said, offset.to_string());
    (offset, complete)
}

/// Sizes of the files of scenes below a folder: those in the making, or those that are there.
fn sizes(farm: &Farm, staged: bool) -> Vec<u64> {
    let scenes = fs::read_dir(farm._folder.path().join("scenes")).unwrap();
    let folders = scenes.map(|folder| folder.unwrap().path());
    let folders = folders.filter(|path| path.is_dir() && (path.ends_with("staging") == staged));
    let files = |path: &Path| {
        let files: Vec<_> = fs::read_dir(path).unwrap().collect();
        files
            .into_iter()
            .filter_map(|file| Some(file.ok()?.metadata().ok()?.len()))
    };
    folders.flat_map(|path| files(&path).collect::<Vec<_>>()).collect()
}

async fn until(what: &str, condition: impl Fn() -> bool) {
    let wait = async {
        while !condition() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    let waited = tokio::time::timeout(Duration::from_secs(60), wait).await;
    waited.unwrap_or_else(|_| panic!("{what}: not within a minute"));
}

/// Begins to send a file of `length` bytes, and sends these.
async fn begin(farm: &Farm, path: &str, length: usize, bytes: &[u8]) -> TcpStream {
    let url = farm.coordinator.url();
    let mut stream = TcpStream::connect(url.trim_start_matches("http://")).await.unwrap();
    let head =
        format!("PATCH /v1/{path} HTTP/1.1\r\nhost: localhost\r\nupload-offset: 0\r\ncontent-length: {length}\r\n\r\n");
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    stream
}

#[tokio::test]
async fn an_upload_goes_on_where_it_ended_even_after_a_restart() {
    let farm = Farm::start().await;
    let file: Vec<u8> = (0..LONG + 500).map(|i| (i % 251) as u8).collect();
    let path = announce(&farm, &file).await;
    let patch = |farm: &Farm| farm.request(Method::PATCH, &path);
    let get = |farm: &Farm| farm.request(Method::GET, &path);
    assert_eq!(state(get(&farm)).await, (0, false));
    let part = send(patch(&farm).header(UPLOAD_COMPLETE, "?0"), 0, &file[..LONG]).await;
    assert_eq!(part.status(), StatusCode::OK);
    for offset in [0, LONG - 1, LONG + 1] {
        let reply = send(patch(&farm), offset, &file[offset..]).await;
        let problem = expect_problem(reply, ErrorCode::OffsetMismatch).await;
        assert!(problem.detail.contains(&LONG.to_string()), "{problem}");
    }
    let reply = send(patch(&farm), LONG, &[0; 501]).await;
    expect_problem(reply, ErrorCode::ContentMismatch).await;
    let farm = farm.restart_with(|_| {}).await;
    assert_eq!(state(get(&farm)).await, (LONG as u64, false));
    let rest = send(patch(&farm), LONG, &file[LONG..]).await;
    assert_eq!(rest.status(), StatusCode::CREATED);
    assert_eq!(sizes(&farm, false), [file.len() as u64], "no part is left");
    let blob = farm.get(path.trim_end_matches("/upload")).await.bytes().await.unwrap();
    assert!(blob == file, "the file is another");
    // The sender may have lost the answer.
    assert_eq!(state(get(&farm)).await, (file.len() as u64, true));
    let again = send(patch(&farm), file.len(), &[]).await;
    assert_eq!(again.status(), StatusCode::CREATED);
}

#[tokio::test]
async fn what_came_before_a_connection_broke_is_kept() {
    let farm = Farm::start().await;
    let file = vec![7; 100_000];
    let path = announce(&farm, &file).await;
    drop(begin(&farm, &path, file.len(), &file[..60_000]).await);
    until("the part is kept", || sizes(&farm, false) == [60_000]).await;
    assert_eq!(state(farm.request(Method::GET, &path)).await, (60_000, false));
    let rest = send(farm.request(Method::PATCH, &path), 60_000, &file[60_000..]).await;
    assert_eq!(rest.status(), StatusCode::CREATED);
}

#[tokio::test]
async fn whoever_asks_takes_the_place_of_a_connection_that_is_silent() {
    let farm = Farm::start().await;
    let file = vec![7; 100_000];
    let path = announce(&farm, &file).await;
    let mut silent = begin(&farm, &path, file.len(), &file[..60_000]).await;
    until("the part has come", || sizes(&farm, true) == [60_000]).await;
    assert_eq!(state(farm.request(Method::GET, &path)).await, (60_000, false));
    let mut answer = [0; 12];
    silent.read_exact(&mut answer).await.unwrap();
    assert_eq!(&answer, b"HTTP/1.1 503");
}

#[tokio::test]
async fn nobody_meets_the_upload_of_another_and_bad_bytes_are_not_kept() {
    let closed = Closed::start().await;
    let file = b"<scene>of bea</scene>";
    let path = format!("blobs/{}/upload", BlobHash::of(file));
    let [ann, bea] = ["ann", "bea"].map(|name| request(name, Role::Submit));
    let [ann, bea] = [closed.token(&ann).await, closed.token(&bea).await];
    let missing = closed.by(&ann, Method::GET, &path).send().await.unwrap();
    expect_problem(missing, ErrorCode::NotFound).await;
    let announced = closed.by(&bea, Method::POST, "bundles").json(&manifest(file)).send();
    assert_eq!(announced.await.unwrap().status(), StatusCode::OK);
    let patch = |token: &str| closed.by(token, Method::PATCH, &path);
    let get = |token: &str| closed.by(token, Method::GET, &path);
    let bad = send(patch(&ann).header(UPLOAD_COMPLETE, "?0"), 0, b"<scene>of ann").await;
    assert_eq!(bad.status(), StatusCode::OK);
    assert_eq!(state(get(&bea)).await, (0, false));
    let half = send(patch(&bea).header(UPLOAD_COMPLETE, "?0"), 0, &file[..10]).await;
    assert_eq!(half.status(), StatusCode::OK);
    let refused = send(patch(&ann), 13, b"</scene>").await;
    let problem = expect_problem(refused, ErrorCode::ContentMismatch).await;
    assert!(problem.detail.contains("nothing of them is kept"), "{problem}");
    assert_eq!(state(get(&ann)).await, (0, false));
    assert_eq!(send(patch(&bea), 10, &file[10..]).await.status(), StatusCode::CREATED);
    for (offset, complete) in [("-1", "?1"), ("", "?1"), ("0", "yes")] {
        let request = patch(&ann)
            .header(UPLOAD_OFFSET, offset)
            .header(UPLOAD_COMPLETE, complete);
        expect_problem(request.send().await.unwrap(), ErrorCode::Malformed).await;
    }
}
