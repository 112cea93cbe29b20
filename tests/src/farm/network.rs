//! Hosts of a network of their own (Linux network namespaces), whose links are cut, lossy or slow.

use crate::processes::Launch;
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::fs::File;
use std::io::{Read, Write};
use std::net::Ipv4Addr;
use std::os::fd::{AsFd, AsRawFd};
use std::process::{Command, Stdio};

/// Addresses for documentation (RFC 5737): nothing outside the network has one.
const NETWORK: [u8; 3] = [192, 0, 2];

/// A host. Its namespace is gone when this is dropped and its last process has ended.
#[derive(Debug)]
pub struct Host {
    space: File,
    address: Ipv4Addr,
}

/// A host in the middle, and hosts that are linked to it alone.
#[derive(Debug)]
pub struct Network {
    /// The host in the middle.
    pub centre: Host,
    /// The others.
    pub hosts: Vec<Host>,
}

impl Network {
    /// Makes a network of one host and `leaves` others.
    ///
    /// # Panics
    /// Where this process may not make namespaces, or `ip`, `nft` or `tc` is not installed.
    #[must_use]
    pub fn new(leaves: u8) -> Self {
        let centre = Host::new(1);
        centre.run("ip", &["link", "add", "bridge", "type", "bridge"]);
        centre.run(
            "ip",
            &["address", "add", &format!("{}/24", centre.address), "dev", "bridge"],
        );
        centre.run("ip", &["link", "set", "bridge", "up"]);
        let leaf = |number: u8| {
            let host = Host::new(number + 2);
            let link = host.link();
            let far = format!("/proc/{}/fd/{}", std::process::id(), host.space.as_raw_fd());
            centre.run(
                "ip",
                &[
                    "link", "add", &link, "type", "veth", "peer", "name", "eth0", "netns", &far,
                ],
            );
            centre.run("ip", &["link", "set", &link, "master", "bridge", "up"]);
            host.run(
                "ip",
                &["address", "add", &format!("{}/24", host.address), "dev", "eth0"],
            );
            host.run("ip", &["link", "set", "eth0", "up"]);
            host
        };
        let hosts = (0..leaves).map(leaf).collect();
        Self { centre, hosts }
    }

    /// What happens to packets from a host to the centre, and from the centre to the host: a verdict of nftables such
    /// as `drop`, or none.
    ///
    /// # Panics
    /// Where nftables refuses.
    pub fn fault(&self, host: &Host, to_centre: &str, from_centre: &str) {
        self.centre.filter(host, host.address, to_centre);
        host.filter(host, self.centre.address, from_centre);
    }

    /// How many packets between a host and the centre were dropped since the last fault began.
    ///
    /// # Panics
    /// Where nftables refuses.
    #[must_use]
    pub fn dropped(&self, host: &Host) -> u64 {
        let list = format!("list table {}", host.table());
        let rules = [&self.centre, host]
            .map(|at| at.feed("nft", &["-f", "-"], &list))
            .concat();
        let counted = rules.lines().filter_map(|rule| {
            let (count, _) = rule
                .trim()
                .strip_suffix("drop")?
                .split_once("counter packets ")?
                .1
                .split_once(' ')?;
            count.parse::<u64>().ok()
        });
        counted.sum()
    }

    /// Nothing passes between a host and the centre.
    ///
    /// # Panics
    /// Where nftables refuses.
    pub fn cut(&self, host: &Host) {
        self.fault(host, "drop", "drop");
    }

    /// Every packet passes again.
    ///
    /// # Panics
    /// Where nftables refuses.
    pub fn heal(&self, host: &Host) {
        self.fault(host, "accept", "accept");
    }

    /// Of the packets to and from a host, so many in a hundred are lost.
    ///
    /// # Panics
    /// Where nftables refuses.
    pub fn lose(&self, host: &Host, percent: u8) {
        let verdict = format!("numgen random mod 100 < {percent} drop");
        self.fault(host, &verdict, &verdict);
    }

    /// The link to a host carries so many bits per second each way, and what waits for it waits long.
    ///
    /// # Panics
    /// Where `tc` refuses.
    pub fn narrow(&self, host: &Host, kilobits: u32) {
        let rate = format!("{kilobits}kbit");
        let queue = ["root", "tbf", "rate", &rate, "burst", "4kb", "latency", "2s"];
        let link = host.link();
        self.centre
            .run("tc", &[&["qdisc", "add", "dev", &link], &queue[..]].concat());
        host.run("tc", &[&["qdisc", "add", "dev", "eth0"], &queue[..]].concat());
    }
}

impl Host {
    fn new(number: u8) -> Self {
        let mut holder = Command::new("unshare")
            .args(["--net", "sh", "-c", "ip link set lo up && echo ready && exec cat"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("unshare runs");
        let mut ready = [0; 6];
        let said = holder.stdout.as_mut().expect("piped").read_exact(&mut ready);
        assert!(
            said.is_ok() && ready == *b"ready\n",
            "a network namespace cannot be made: these tests need the rights of root (CAP_SYS_ADMIN, CAP_NET_ADMIN) and \
             the program `ip` (apt-get install iproute2; tests/run does so)"
        );
        // From now on this file holds the namespace.
        let space = File::open(format!("/proc/{}/ns/net", holder.id())).expect("the namespace");
        drop(holder.stdin.take());
        holder.wait().expect("the holder ends");
        let [a, b, c] = NETWORK;
        Self {
            space,
            address: Ipv4Addr::new(a, b, c, number),
        }
    }

    /// Its address.
    #[must_use]
    pub fn address(&self) -> Ipv4Addr {
        self.address
    }

    /// Name of the link to it, at the centre.
    fn link(&self) -> String {
        format!("to-{}", self.address.octets()[3])
    }

    /// Name of the table with the faults of that link.
    fn table(&self) -> String {
        format!("inet {}", self.link())
    }

    /// Starts programs on this host.
    #[must_use]
    pub fn launch(&self) -> Launch {
        let space = format!("--net=/proc/{}/fd/{}", std::process::id(), self.space.as_raw_fd());
        Launch {
            wrapper: vec!["nsenter".into(), space, "--".into()],
            environment: Vec::new(),
        }
    }

    /// Does something on a thread that is on this host, as are the processes that it starts.
    ///
    /// # Panics
    /// Where the thread may not go there, or panics.
    pub fn inside<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        std::thread::scope(|scope| {
            let thread = scope.spawn(|| {
                let space = self.space.as_fd();
                move_into_link_name_space(space, Some(LinkNameSpaceType::Network)).expect("the thread may go there");
                work()
            });
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    /// Filters what arrives here from an address, with a table for the link of `host`.
    fn filter(&self, host: &Host, from: Ipv4Addr, verdict: &str) {
        let table = host.table();
        let chain = "type filter hook input priority 0; policy accept;";
        let rules = format!(
            "add table {table}\ndelete table {table}\n\
             table {table} {{ chain input {{ {chain} ip saddr {from} counter {verdict}; }}; }}\n"
        );
        let _nothing = self.feed("nft", &["-f", "-"], &rules);
    }

    fn run(&self, program: &str, arguments: &[&str]) {
        let _said = self.feed(program, arguments, "");
    }

    fn feed(&self, program: &str, arguments: &[&str], input: &str) -> String {
        let mut child = self.inside(|| {
            let mut command = Command::new(program);
            command.args(arguments).stdin(Stdio::piped());
            command.stdout(Stdio::piped()).stderr(Stdio::piped());
            command.spawn().unwrap_or_else(|error| {
                panic!("{program} cannot be run: {error} (apt-get install iproute2 nftables; tests/run does so)")
            })
        });
        let mut stdin = child.stdin.take().expect("piped");
        stdin.write_all(input.as_bytes()).expect("the program reads");
        drop(stdin);
        let output = child.wait_with_output().expect("the program ends");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{program} {arguments:?} with {input:?}: {errors}"
        );
        String::from_utf8_lossy(&output.stdout).into_owned()
    }
}
