//! Connections: encrypted, slow, and too many.

use crate::support::Farm;
use photonfarm_coordinator::{Config, Coordinator, StartError, TlsError, TlsFiles};
use reqwest::{Certificate, Client, StatusCode};
use std::path::Path;
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// Within which everything here must happen.
const DEADLINE: Duration = Duration::from_secs(20);

/// A certificate for 127.0.0.1 that is its own authority.
fn certificate(folder: &Path) -> (TlsFiles, Certificate) {
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    let files = TlsFiles {
        certificate: folder.join("farm.pem"),
        key: folder.join("farm.key"),
    };
    std::fs::write(&files.certificate, made.cert.pem()).unwrap();
    std::fs::write(&files.key, made.signing_key.serialize_pem()).unwrap();
    let authority = Certificate::from_pem(made.cert.pem().as_bytes()).unwrap();
    (files, authority)
}

fn client(authority: Option<&Certificate>) -> Client {
    let builder = Client::builder().no_proxy().tls_built_in_root_certs(false);
    match authority {
        Some(authority) => builder.add_root_certificate(authority.clone()),
        None => builder,
    }
    .build()
    .unwrap()
}

async fn encrypted() -> (TempDir, Farm, Certificate) {
    let folder = tempfile::tempdir().unwrap();
    let (files, authority) = certificate(folder.path());
    let farm = Farm::start_with(|config| config.tls = Some(files)).await;
    (folder, farm, authority)
}

#[tokio::test]
async fn an_encrypted_farm_is_known_by_its_certificate() {
    let (_folder, farm, authority) = encrypted().await;
    let url = format!("{}/v1/healthz", farm.coordinator.url());
    assert!(url.starts_with("https://"));
    let reply = client(Some(&authority)).get(&url).send().await.unwrap();
    assert_eq!(reply.status(), StatusCode::OK);
    let (_other, stranger) = certificate(tempfile::tempdir().unwrap().path());
    for client in [client(None), client(Some(&stranger))] {
        assert!(client.get(&url).send().await.unwrap_err().is_connect());
    }
    let plain = url.replacen("https", "http", 1);
    assert!(client(None).get(plain).send().await.is_err());
    assert_eq!(
        client(Some(&authority)).get(&url).send().await.unwrap().status(),
        StatusCode::OK
    );
}

#[tokio::test]
async fn an_encrypted_farm_ends_in_good_order() {
    let (_folder, farm, authority) = encrypted().await;
    let url = format!("{}/v1/jobs", farm.coordinator.url());
    let job = farm_job(&farm, &client(Some(&authority))).await;
    let events = client(Some(&authority))
        .get(format!("{url}/{job}/events"))
        .send()
        .await
        .unwrap();
    farm.coordinator.shutdown().await;
    let text = events.text().await.expect("the stream has an end, and was not cut off");
    assert!(text.starts_with("event: status"), "{text}");
    assert!(client(Some(&authority)).get(url).send().await.is_err());
}

async fn farm_job(farm: &Farm, client: &Client) -> u64 {
    let url = farm.coordinator.url();
    let hash = photonfarm_proto::id::BlobHash::of(b"x");
    let manifest = serde_json::json!({"files": {"scene.xml": {"hash": hash, "bytes": 1}}});
    let reply = client
        .post(format!("{url}/v1/bundles"))
        .json(&manifest)
        .send()
        .await
        .unwrap();
    let reply: serde_json::Value = reply.json().await.unwrap();
    let put = client
        .put(format!("{url}/v1/blobs/{hash}"))
        .body("x")
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), StatusCode::CREATED);
    let spec = serde_json::json!({"scene": reply["bundle"], "main": "scene.xml", "integrator": {"type": "path"},
        "iterations": 1});
    let job = client.post(format!("{url}/v1/jobs")).json(&spec).send().await.unwrap();
    job.json::<serde_json::Value>().await.unwrap()["id"].as_u64().unwrap()
}

#[tokio::test]
async fn certificates_that_cannot_be_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (files, _) = certificate(folder.path());
    let other = tempfile::tempdir().unwrap();
    let (others, _) = certificate(other.path());
    std::fs::write(folder.path().join("empty"), "").unwrap();
    let start = async |certificate: &Path, key: &Path| {
        let tls = TlsFiles {
            certificate: certificate.to_owned(),
            key: key.to_owned(),
        };
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let config = Config {
            tls: Some(tls),
            ..Config::new(folder.path().join("farm"))
        };
        match Coordinator::start(config, listener).await {
            Err(StartError::Tls(error)) => error,
            Err(error) => panic!("{error}"),
            Ok(_) => panic!("started"),
        }
    };
    for (certificate, key, named) in [
        (&folder.path().join("none"), &files.key, "none"),
        (&folder.path().join("empty"), &files.key, "empty"),
        (&files.certificate, &folder.path().join("empty"), "empty"),
        (&files.certificate, &files.certificate, "farm.pem"),
        (&files.key, &files.key, "farm.key"),
    ] {
        let error = start(certificate, key).await;
        assert!(
            matches!(&error, TlsError::File { .. }) && error.to_string().contains(named),
            "{error}"
        );
    }
    assert!(matches!(
        start(&files.certificate, &others.key).await,
        TlsError::Pair { .. }
    ));
}

/// Sends bytes and waits until the farm closes the connection; returns what it said.
async fn hang(farm: &Farm, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(farm.coordinator.address()).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    let mut said = Vec::new();
    let closed = tokio::time::timeout(DEADLINE, stream.read_to_end(&mut said)).await;
    assert!(closed.is_ok(), "the connection was held open");
    String::from_utf8_lossy(&said).into_owned()
}

fn impatient(config: &mut Config) {
    config.timeouts.head = Duration::from_millis(300);
    config.timeouts.stall = Duration::from_millis(300);
    config.timeouts.handshake = Duration::from_millis(300);
}

#[tokio::test]
async fn peers_that_dawdle_are_cut_off() {
    let farm = Farm::start_with(impatient).await;
    hang(&farm, b"").await;
    hang(&farm, b"GET /v1/healthz HT").await;
    hang(&farm, b"GET /v1/healthz HTTP/1.1\r\nhost: x\r\nx: ").await;
    hang(&farm, b"GET /v1/healthz HTTP/1.1\r\nhost: x\r\n\r\n").await;
    let post = "POST /v1/jobs HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n";
    let said = hang(&farm, format!("{post}content-length: 100\r\n\r\n{{").as_bytes()).await;
    assert!(said.starts_with("HTTP/1.1 400") && said.contains("malformed"), "{said}");
    let said = hang(
        &farm,
        format!("{post}transfer-encoding: chunked\r\n\r\n1\r\n{{\r\n").as_bytes(),
    )
    .await;
    assert!(said.starts_with("HTTP/1.1 400"), "{said}");
    // On a busy machine this client may dawdle as well.
    let others = async { while farm.request(reqwest::Method::GET, "healthz").send().await.is_err() {} };
    assert!(
        tokio::time::timeout(DEADLINE, others).await.is_ok(),
        "nobody is served any more"
    );
}

#[tokio::test]
async fn handshakes_that_dawdle_are_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let (files, _) = certificate(folder.path());
    let farm = Farm::start_with(|config| {
        impatient(config);
        config.tls = Some(files);
    })
    .await;
    hang(&farm, b"").await;
    hang(&farm, &[0x16, 0x03, 0x01, 0x02]).await;
}

#[tokio::test]
async fn connections_beyond_the_limit_wait_for_a_place() {
    let farm = Farm::start_with(|config| config.connections = 2).await;
    let request = b"GET /v1/healthz HTTP/1.1\r\nhost: x\r\n\r\n";
    let mut held = Vec::new();
    for _ in 0..2 {
        let mut stream = TcpStream::connect(farm.coordinator.address()).await.unwrap();
        stream.write_all(request).await.unwrap();
        let mut said = [0; 12];
        stream.read_exact(&mut said).await.unwrap();
        assert_eq!(&said, b"HTTP/1.1 200");
        held.push(stream);
    }
    let mut third = TcpStream::connect(farm.coordinator.address()).await.unwrap();
    third.write_all(request).await.unwrap();
    let mut said = [0; 12];
    let early = tokio::time::timeout(Duration::from_millis(300), third.read_exact(&mut said)).await;
    assert!(early.is_err(), "a third connection was served");
    held.pop();
    let served = tokio::time::timeout(DEADLINE, third.read_exact(&mut said)).await;
    assert!(
        served.is_ok_and(|read| read.is_ok()),
        "a place that is free again was not given"
    );
    assert_eq!(&said, b"HTTP/1.1 200");
}

/// A connection too many of an address is closed at once; the others go on, and there is room again when one ends.
#[tokio::test]
async fn an_address_has_a_bounded_number_of_connections() {
    let farm = Farm::start_with(|config| config.connections_per_address = 2).await;
    let request = b"GET /v1/healthz HTTP/1.1\r\nhost: localhost\r\n\r\n";
    let connect = async || TcpStream::connect(farm.coordinator.address()).await.unwrap();
    let served = async |stream: &mut TcpStream| {
        let mut said = [0; 12];
        let asked = stream.write_all(request).await.is_ok() && stream.read_exact(&mut said).await.is_ok();
        asked && &said == b"HTTP/1.1 200"
    };
    let mut held = [connect().await, connect().await];
    for stream in &mut held {
        assert!(served(stream).await);
    }
    assert!(!served(&mut connect().await).await, "a third connection was served");
    for stream in &mut held {
        let mut rest = [0; 4096];
        assert!(stream.read(&mut rest).await.unwrap() > 0);
        assert!(served(stream).await, "a connection that was there before");
    }
    drop(held);
    let again = async {
        while !served(&mut connect().await).await {
            tokio::task::yield_now().await;
        }
    };
    assert!(
        tokio::time::timeout(DEADLINE, again).await.is_ok(),
        "a place that is free again was not given"
    );
}

/// A reader that stops is cut off, so that its place is free again; what it was being sent is not kept in memory.
#[tokio::test]
async fn readers_that_stop_are_cut_off() {
    let farm = Farm::start_with(|config| {
        config.connections = 1;
        config.timeouts.stall = Duration::from_millis(100);
        config.timeouts.bytes_per_second = u64::MAX;
    })
    .await;
    let text = vec![b'x'; 64 << 20];
    let hash = photonfarm_proto::id::BlobHash::of(&text);
    let manifest = serde_json::json!({"files": {"scene.xml": {"hash": hash, "bytes": text.len()}}});
    let once = |method, path: &str| farm.request(method, path).header("connection", "close");
    let announce = once(reqwest::Method::POST, "bundles").json(&manifest);
    assert_eq!(announce.send().await.unwrap().status(), StatusCode::OK);
    let put = once(reqwest::Method::PUT, &format!("blobs/{hash}")).body(text);
    assert_eq!(put.send().await.unwrap().status(), StatusCode::CREATED);
    let coordinator = &farm.coordinator;
    let mut reader = TcpStream::connect(coordinator.address()).await.unwrap();
    let get = format!("GET /v1/blobs/{hash} HTTP/1.1\r\nhost: localhost\r\n\r\n");
    reader.write_all(get.as_bytes()).await.unwrap();
    let fresh = Client::builder().no_proxy().build().unwrap();
    let next = fresh.get(format!("{}/v1/healthz", coordinator.url())).send();
    let next = tokio::time::timeout(DEADLINE, next).await;
    assert!(next.is_ok_and(|reply| reply.is_ok()), "the reader held its place");
    drop(reader);
}

#[tokio::test]
async fn a_certificate_is_renewed_while_the_farm_runs() {
    let (folder, farm, old) = encrypted().await;
    let url = format!("{}/v1/healthz", farm.coordinator.url());
    let knows = async |authority: &Certificate| client(Some(authority)).get(&url).send().await.is_ok();
    std::fs::write(folder.path().join("farm.pem"), "nonsense").unwrap();
    let error = farm.coordinator.renew_certificates().unwrap_err();
    assert!(error.to_string().contains("farm.pem"), "{error}");
    assert!(
        knows(&old).await,
        "a certificate that cannot be used took the place of one that can"
    );
    let (_files, new) = certificate(folder.path());
    assert!(farm.coordinator.renew_certificates().unwrap());
    assert!(knows(&new).await && !knows(&old).await);
    assert!(!Farm::start().await.coordinator.renew_certificates().unwrap());
}
