//! What Photonfarm's coordinator, workers and clients say to each other.
//!
//! Public messages are JSON with OpenAPI schemas; worker messages are bincode in a frame with a magic number and a
//! version ([`codec`]); images of the reduction tree are a header and raw planes ([`node`]). Everything that arrives
//! is checked against [`limits::Limits`] before it is believed or allocated for.

pub mod api;
pub mod bundle;
pub mod check;
pub mod codec;
pub mod hex;
pub mod history;
pub mod id;
pub mod job;
pub mod limits;
pub mod memory;
pub mod node;
pub mod planes;
pub mod problem;
pub mod rest;
pub mod schedule;
pub mod time;
pub mod token;
pub mod trace;
pub mod waiting;
pub mod webhook;
pub mod worker;

/// Version of this program: coordinator and workers must have the same.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Name of this build's renderer: the version, and a digest of the renderer's sources, of what they depend on, and of
/// what they are compiled with and for (`proto/renderer_name.rs`). Results of renderers with different names are not mixed in one job.
pub const RENDERER: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("PHOTONFARM_BUILD"));

/// The version within the name of a renderer.
#[must_use]
pub fn version_of(renderer: &str) -> &str {
    renderer.split_once('+').map_or(renderer, |(version, _)| version)
}

#[cfg(test)]
#[path = "../renderer_name.rs"]
mod renderer_name;

#[cfg(test)]
mod tests {
    use crate::renderer_name::{SOURCES, name};
    use std::collections::BTreeSet;
    use std::path::Path;
    use std::{env, fs};

    /// The name of a workspace with this project's `Cargo.toml`s, each changed by `change`, and one source.
    fn name_of(change: impl Fn(&str, &str) -> String, variables: &[(&str, &str)], compiler: &str) -> String {
        let (here, folder) = (Path::new(env!("CARGO_MANIFEST_DIR")), tempfile::tempdir().unwrap());
        fs::create_dir_all(folder.path().join("core/src")).unwrap();
        for file in ["Cargo.toml", "Cargo.lock", "core/Cargo.toml"] {
            let text = fs::read_to_string(here.join("..").join(file)).unwrap();
            fs::write(folder.path().join(file), change(file, &text)).unwrap();
        }
        fs::write(
            folder.path().join("core/src/lib.rs"),
            change("core/src/lib.rs", "fn render() {}"),
        )
        .unwrap();
        fs::write(folder.path().join("README.md"), change("README.md", "")).unwrap();
        let variables: Vec<_> = variables
            .iter()
            .map(|(n, v)| ((*n).to_owned(), (*v).to_owned()))
            .collect();
        name(folder.path(), &variables, compiler.as_bytes()).unwrap()
    }

    #[test]
    fn the_renderers_name_changes_with_whatever_can_change_bits() {
        let same = |_: &str, text: &str| text.to_owned();
        let toggled = |of: &'static str, from: &'static str, to: &'static str| {
            move |file: &str, text: &str| {
                assert!(file != of || text.contains(from), "{of} has no `{from}`");
                if file == of {
                    text.replacen(from, to, 1)
                } else {
                    text.to_owned()
                }
            }
        };
        let name = name_of(same, &[], "rustc 1");
        assert_eq!(
            name,
            name_of(
                |file, text| if file == "README.md" { "x".into() } else { text.into() },
                &[],
                "rustc 1"
            )
        );
        assert_eq!(
            name,
            name_of(same, &[("HOME", "/root"), ("CARGO_PKG_NAME", "x")], "rustc 1")
        );
        let scalar = "features = [\"scalar-math\"]";
        let names = BTreeSet::from([
            name,
            name_of(toggled("Cargo.toml", scalar, "features = []"), &[], "rustc 1"),
            name_of(toggled("Cargo.toml", "lto = \"off\"", "lto = \"fat\""), &[], "rustc 1"),
            name_of(
                toggled("core/Cargo.toml", "[lints]", "[features]\nfast = []\n[lints]"),
                &[],
                "rustc 1",
            ),
            name_of(toggled("Cargo.lock", "version = ", "version  = "), &[], "rustc 1"),
            name_of(toggled("core/src/lib.rs", "{}", "{ }"), &[], "rustc 1"),
            name_of(same, &[("CARGO_FEATURE_FAST", "1")], "rustc 1"),
            name_of(same, &[("CARGO_CFG_TARGET_FEATURE", "fma")], "rustc 1"),
            name_of(same, &[("CARGO_ENCODED_RUSTFLAGS", "-Ctarget-cpu=native")], "rustc 1"),
            name_of(same, &[("PROFILE", "debug")], "rustc 1"),
            name_of(same, &[], "rustc 2"),
        ]);
        assert_eq!(names.len(), 11, "some change leaves the name as it was");
    }

    #[test]
    fn every_source_of_the_name_is_there() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        assert!(SOURCES.iter().all(|source| root.join(source).exists()));
    }
}
