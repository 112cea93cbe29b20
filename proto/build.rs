//! Names the renderer: a digest of its sources, of what they depend on, and of what they are compiled for.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// FNV-1a of 128 bits: tells builds apart by accident, not against an adversary.
struct Digest(u128);

impl Digest {
    fn add(&mut self, bytes: &[u8]) {
        let length = (bytes.len() as u64).to_le_bytes();
        for byte in length.iter().chain(bytes) {
            self.0 = (self.0 ^ u128::from(*byte)).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013b);
        }
    }
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("the renderer's sources can be listed") {
        let path = entry.expect("the renderer's sources can be listed").path();
        if path.is_dir() {
            collect(&path, files);
        } else {
            files.push(path);
        }
    }
}

fn main() {
    let root = Path::new("..");
    let sources = root.join("core/src");
    let mut files = vec![root.join("core/Cargo.toml"), root.join("Cargo.lock")];
    collect(&sources, &mut files);
    files.sort();
    let mut digest = Digest(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d);
    for file in &files {
        digest.add(file.to_string_lossy().as_bytes());
        digest.add(&fs::read(file).expect("the renderer's sources can be read"));
    }
    for name in ["CARGO_CFG_TARGET_ARCH", "CARGO_CFG_TARGET_FEATURE"] {
        digest.add(env::var(name).unwrap_or_default().as_bytes());
    }
    let compiler = Command::new(env::var("RUSTC").unwrap_or_else(|_| "rustc".into()))
        .arg("--version")
        .output()
        .expect("the compiler tells its version");
    digest.add(&compiler.stdout);
    println!(
        "cargo:rustc-env=PHOTONFARM_BUILD={:016x}",
        (digest.0 >> 64) as u64 ^ digest.0 as u64
    );
    println!("cargo:rerun-if-changed={}", sources.display());
    println!("cargo:rerun-if-changed=../core/Cargo.toml");
    println!("cargo:rerun-if-changed=../Cargo.lock");
}
