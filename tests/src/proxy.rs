//! Proxies between client and coordinator: one that refuses large bodies, as those do that stand before services, one that cuts
//! long answers, and one that cuts long uploads.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};

/// What it answers to a body that is too large: no problem document, but a page.
const REFUSAL: &[u8] = b"HTTP/1.1 413 Request Entity Too Large\r\ncontent-type: text/html\r\ncontent-length: 24\r\n\
    connection: close\r\n\r\n<h1>413 Too Large</h1>\r\n";

/// Serves at the URL that comes back, for the coordinator at `url`, which begins with `http://`, as long as the process lives.
///
/// # Panics
/// Where there is no port.
#[must_use]
pub fn refuse_bodies_beyond(bytes: u64, url: &str) -> String {
    serve(url, move |client, address| pass_on(client, address, bytes))
}

/// Gives each client, and the address of the coordinator at `url`, to `handle` on a thread of its own. Returns the proxy's URL.
fn serve(url: &str, handle: impl Fn(TcpStream, &str) -> std::io::Result<()> + Send + Sync + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let own = format!("http://{}", listener.local_addr().expect("it listens"));
    let shared = Arc::new((url.trim_start_matches("http://").to_owned(), handle));
    std::thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            let shared = shared.clone();
            // A client that leaves is no concern of the others.
            std::thread::spawn(move || (shared.1)(client, &shared.0).ok());
        }
    });
    own
}

/// A proxy that passes on so many bytes of each answer, and then cuts the connection or falls silent.
#[derive(Debug)]
pub struct Cutter {
    /// Where it serves.
    pub url: String,
    heads: Arc<Mutex<Vec<String>>>,
}

impl Cutter {
    /// Serves for the coordinator at `url`, which begins with `http://`, as long as the process lives. After `bytes` of an answer the
    /// connection is cut, or stays open without a word.
    ///
    /// # Panics
    /// Where there is no port.
    #[must_use]
    pub fn start(url: &str, bytes: u64, silent: bool) -> Self {
        let heads = Arc::<Mutex<Vec<String>>>::default();
        let noted = heads.clone();
        let url = serve(url, move |client, address| cut(client, address, bytes, silent, &noted));
        Self { url, heads }
    }

    /// The heads of the requests so far.
    #[must_use]
    pub fn heads(&self) -> Vec<String> {
        self.heads.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn cut(
    mut client: TcpStream,
    address: &str,
    bytes: u64,
    silent: bool,
    heads: &Mutex<Vec<String>>,
) -> std::io::Result<()> {
    let Some((head, body)) = read_request(&client)? else {
        return Ok(());
    };
    let mut server = TcpStream::connect(address)?;
    server.write_all(head.as_bytes())?;
    server.write_all(&body)?;
    heads.lock().unwrap_or_else(PoisonError::into_inner).push(head);
    let passed = std::io::copy(&mut server.take(bytes), &mut client)?;
    if silent && passed == bytes {
        // Until the client leaves.
        let _gone = client.read(&mut [0]);
    }
    client.shutdown(Shutdown::Both)
}

/// A proxy that passes on so many bytes of the body of the first `PATCH`, and then cuts the connection or falls silent until the
/// client leaves; what follows passes whole.
#[derive(Debug)]
pub struct UploadCutter {
    /// Where it serves.
    pub url: String,
    sent: Arc<Mutex<Vec<(String, u64)>>>,
}

impl UploadCutter {
    /// Serves for the coordinator at `url`, which begins with `http://`, as long as the process lives.
    ///
    /// # Panics
    /// Where there is no port.
    #[must_use]
    pub fn start(url: &str, bytes: u64, silent: bool) -> Self {
        let sent = Arc::<Mutex<Vec<(String, u64)>>>::default();
        let noted = sent.clone();
        let url = serve(url, move |client, address| {
            pass_body(client, address, bytes, silent, &noted)
        });
        Self { url, sent }
    }

    /// The heads of the `PATCH` requests so far, with the number of bytes of their bodies that passed.
    #[must_use]
    pub fn sent(&self) -> Vec<(String, u64)> {
        self.sent.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn pass_body(
    mut client: TcpStream,
    address: &str,
    bytes: u64,
    silent: bool,
    sent: &Mutex<Vec<(String, u64)>>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(client.try_clone()?);
    let Some((head, length)) = read_head(&mut reader)? else {
        return Ok(());
    };
    let mut server = TcpStream::connect(address)?;
    server.write_all(head.as_bytes())?;
    let patch = head.starts_with("PATCH ");
    let first = patch && sent.lock().unwrap_or_else(PoisonError::into_inner).is_empty();
    let passed = length.min(if first { bytes } else { u64::MAX });
    let passed = std::io::copy(&mut (&mut reader).take(passed), &mut server)?;
    if patch {
        sent.lock().unwrap_or_else(PoisonError::into_inner).push((head, passed));
    }
    if passed < length {
        if silent {
            // Until the client leaves.
            std::io::copy(&mut reader, &mut std::io::sink()).ok();
        }
        server.shutdown(Shutdown::Both)?;
    } else {
        std::io::copy(&mut server, &mut client)?;
    }
    client.shutdown(Shutdown::Both)
}

/// One request and its answer; then the connection ends.
fn pass_on(mut client: TcpStream, address: &str, limit: u64) -> std::io::Result<()> {
    let Some((head, body)) = read_request(&client)? else {
        return Ok(());
    };
    if body.len() as u64 > limit {
        return client.write_all(REFUSAL);
    }
    let mut server = TcpStream::connect(address)?;
    server.write_all(head.as_bytes())?;
    server.write_all(&body)?;
    std::io::copy(&mut server, &mut client)?;
    client.shutdown(Shutdown::Both)
}

/// Head and body of a request, whose connection is to end with its answer; none where there is no whole head.
fn read_request(client: &TcpStream) -> std::io::Result<Option<(String, Vec<u8>)>> {
    let mut reader = BufReader::new(client.try_clone()?);
    let Some((head, length)) = read_head(&mut reader)? else {
        return Ok(None);
    };
    let mut body = Vec::new();
    reader.take(length).read_to_end(&mut body)?;
    Ok(Some((head, body)))
}

/// The head of such a request, and the length of its body.
fn read_head(reader: &mut impl BufRead) -> std::io::Result<Option<(String, u64)>> {
    let (mut head, mut length) = (String::new(), 0);
    reader.read_line(&mut head)?;
    head += "connection: close\r\n";
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 {
            return Ok(None);
        }
        if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
        head += &line;
        if line.trim().is_empty() {
            return Ok(Some((head, length)));
        }
    }
}
