//! Bodies without an end, and what is no HTTP.

use super::{JSON, Target};
use photonfarm_proto::codec::MESSAGE_MEDIA_TYPE;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Sends raw bytes, then `filler` again and again until the service answers or hangs up; returns what it answered.
fn raw(target: &Target, head: &[u8], filler: &[u8]) -> String {
    let address = target.coordinator.url.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut reader = stream.try_clone().unwrap();
    let answer = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        let length = reader.read(&mut bytes).unwrap_or(0);
        String::from_utf8_lossy(&bytes[..length]).into_owned()
    });
    let mut sent = stream.write_all(head);
    while sent.is_ok() && !filler.is_empty() && !answer.is_finished() {
        sent = stream.write_all(filler);
    }
    answer.join().unwrap()
}

#[test]
fn huge_and_endless_bodies() {
    let target = Target::start();
    let post = |path: &str, kind: &str, length: &str| {
        format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {kind}\r\n{length}\r\n\r\n").into_bytes()
    };
    let chunk = [b"10000\r\n".as_slice(), &[b' '; 0x10000], b"\r\n"].concat();
    for (path, kind) in [
        ("/v1/jobs", JSON),
        ("/v1/bundles", JSON),
        ("/v1/worker/lease", MESSAGE_MEDIA_TYPE),
    ] {
        let announced = raw(&target, &post(path, kind, "content-length: 1000000000000"), b"");
        assert!(announced.starts_with("HTTP/1.1 413"), "{path}: {announced:?}");
        let endless = raw(&target, &post(path, kind, "transfer-encoding: chunked"), &chunk);
        assert!(endless.starts_with("HTTP/1.1 413"), "{path}: {endless:?}");
    }
    let endless = raw(
        &target,
        &post("/v1/worker/nodes", MESSAGE_MEDIA_TYPE, "transfer-encoding: chunked"),
        &chunk,
    );
    assert!(endless.starts_with("HTTP/1.1 4"), "{endless:?}");
    target.finish();
}

#[test]
fn what_is_not_http() {
    let target = Target::start();
    for head in [
        &b"\0\0\0\0\r\n\r\n"[..],
        b"GET / HTTP/9.9\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET",
    ] {
        let address = target.coordinator.url.trim_start_matches("http://");
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(head).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let _ = stream.read_to_end(&mut Vec::new());
    }
    let endless = raw(&target, b"GET /v1/jobs HTTP/1.1\r\nx: ", &[b'y'; 4096]);
    assert!(endless.is_empty() || endless.starts_with("HTTP/1.1 4"), "{endless:?}");
    target.finish();
}
