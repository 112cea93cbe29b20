//! Everything that arrives from outside, as functions of bytes that must not panic whatever the bytes are.
//!
//! `fuzz/` drives them with libFuzzer, and a test of this package with mutations of the seeds.

mod input;
mod seeds;
mod wire;

/// A reader of bytes from outside.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, that of the program in `fuzz/`.
    pub name: &'static str,
    /// Reads the bytes; panics where the reader does, or where what it read does not survive being written.
    pub run: fn(&[u8]),
    /// Valid inputs to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All of them.
pub const TARGETS: [Target; 14] = [
    Target {
        name: "message",
        run: wire::message,
        seeds: seeds::messages,
    },
    Target {
        name: "node",
        run: wire::node,
        seeds: seeds::nodes,
    },
    Target {
        name: "request",
        run: wire::request,
        seeds: seeds::requests,
    },
    Target {
        name: "reply",
        run: wire::reply,
        seeds: seeds::replies,
    },
    Target {
        name: "scene",
        run: input::scene,
        seeds: seeds::scenes,
    },
    Target {
        name: "pbrt",
        run: input::pbrt,
        seeds: seeds::pbrt,
    },
    Target {
        name: "gltf",
        run: input::gltf,
        seeds: seeds::gltf,
    },
    Target {
        name: "obj",
        run: input::obj,
        seeds: seeds::obj,
    },
    Target {
        name: "ply",
        run: input::ply,
        seeds: seeds::ply,
    },
    Target {
        name: "serialized",
        run: input::serialized,
        seeds: seeds::serialized,
    },
    Target {
        name: "openexr",
        run: input::openexr,
        seeds: seeds::openexr,
    },
    Target {
        name: "image",
        run: input::image,
        seeds: seeds::images,
    },
    Target {
        name: "spectrum",
        run: input::spectrum,
        seeds: seeds::spectra,
    },
    Target {
        name: "volume",
        run: input::volume,
        seeds: seeds::volumes,
    },
];

/// The target of this name.
///
/// # Panics
/// Where there is none.
#[must_use]
pub fn target(name: &str) -> &'static Target {
    let found = TARGETS.iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("there is no target {name:?}"))
}
