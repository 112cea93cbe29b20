//! Names the renderer: a digest of all that can change bits.

#[path = "renderer_name.rs"]
mod renderer_name;

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    let root = Path::new("..");
    let variables: Vec<(String, String)> = env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.to_string_lossy().into_owned())))
        .collect();
    let compiler = Command::new(env::var("RUSTC").unwrap_or_else(|_| "rustc".into()))
        .arg("--version")
        .output()
        .expect("the compiler tells its version");
    let name = renderer_name::name(root, &variables, &compiler.stdout).expect("the renderer's sources can be read");
    println!("cargo:rustc-env=PHOTONFARM_BUILD={name}");
    for source in renderer_name::SOURCES {
        println!("cargo:rerun-if-changed={}", root.join(source).display());
    }
}
