//! A load balancer.

use std::io::copy;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Passes connections on to servers in turn; one that does not answer is passed over. Lasts as long as the process.
/// Returns its URL.
///
/// # Panics
/// Where there is no port.
#[must_use]
pub fn balance(servers: &[&str]) -> String {
    let servers: Vec<String> = servers.iter().map(|url| url.replace("http://", "")).collect();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let url = format!("http://{}", listener.local_addr().expect("the address listened on"));
    let turn = AtomicUsize::new(0);
    std::thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            let first = turn.fetch_add(1, Ordering::Relaxed);
            let order = (0..servers.len()).map(|offset| &servers[(first + offset) % servers.len()]);
            if let Some(server) = order.filter_map(|address| TcpStream::connect(address).ok()).next() {
                join(client, server);
            }
        }
    });
    url
}

/// Copies bytes both ways until either side ends.
fn join(client: TcpStream, server: TcpStream) {
    let (client, server) = (Arc::new(client), Arc::new(server));
    for (from, to) in [(client.clone(), server.clone()), (server, client)] {
        std::thread::spawn(move || {
            let _cut = copy(&mut &*from, &mut &*to);
            let _closed = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
        });
    }
}
