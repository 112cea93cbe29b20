// What the renderer's name is made of; the build script and a test of it share this file.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

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

/// What can change bits, below the folder of the workspace: the renderer's sources, what they depend on, with which features, and the
/// profiles that they are compiled with.
pub(crate) const SOURCES: [&str; 4] = ["Cargo.lock", "Cargo.toml", "core/Cargo.toml", "core/src"];

/// Whether a variable of a build script says something that can change bits: the processor, what it may be asked for, flags of
/// the compiler, the profile in use, and features of the crate.
pub(crate) fn matters(variable: &str) -> bool {
    [
        "CARGO_CFG_TARGET_ARCH",
        "CARGO_CFG_TARGET_FEATURE",
        "CARGO_ENCODED_RUSTFLAGS",
        "OPT_LEVEL",
        "PROFILE",
    ]
    .contains(&variable)
        || variable.starts_with("CARGO_FEATURE_")
}

/// The name: a digest of the [`SOURCES`] in the workspace `root`, of the `variables` that matter, and of the compiler's version.
pub(crate) fn name(root: &Path, variables: &[(String, String)], compiler: &[u8]) -> io::Result<String> {
    let mut files = Vec::new();
    for source in SOURCES {
        collect(&root.join(source), &mut files)?;
    }
    files.sort();
    let mut digest = Digest(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d);
    for file in &files {
        let inside = file.strip_prefix(root).unwrap_or(file);
        digest.add(inside.to_string_lossy().as_bytes());
        digest.add(&fs::read(file)?);
    }
    let mut variables: Vec<_> = variables.iter().filter(|(name, _)| matters(name)).collect();
    variables.sort();
    for (name, value) in variables {
        digest.add(name.as_bytes());
        digest.add(value.as_bytes());
    }
    digest.add(compiler);
    Ok(format!("{:016x}", (digest.0 >> 64) as u64 ^ digest.0 as u64))
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        for entry in fs::read_dir(path)? {
            collect(&entry?.path(), files)?;
        }
    } else {
        files.push(path.to_owned());
    }
    Ok(())
}
