//! `docs/CONFIGURATION.md` says what the programs and the list of integrators say. With the variable UPDATE set, the test writes it.

use photonfarm_core::integrator::INTEGRATORS;
use photonfarm_core::settings::reference;
use photonfarm_tests::processes::program;
use std::path::Path;
use std::process::Command;

const HEAD: &str = "# Configuration\n\n\
    Integrators with their settings, and what the programs say of themselves (`--help`), written by\n\
    `UPDATE=1 cargo test --release --test configuration`.\n\
    Options that show `[env: NAME=]` can be given by that variable as well. `PHOTONFARM_TOKEN` holds a token where no file does;\n\
    `RUST_LOG` chooses what the log tells.\n";

/// Programs and subcommands.
const COMMANDS: [(&str, &[&str]); 17] = [
    ("photonfarm", &["serve"]),
    ("photonfarm-worker", &[]),
    ("photonfarm", &["submit"]),
    ("photonfarm", &["jobs"]),
    ("photonfarm", &["watch"]),
    ("photonfarm", &["wait"]),
    ("photonfarm", &["logs"]),
    ("photonfarm", &["doctor"]),
    ("photonfarm", &["delete"]),
    ("photonfarm", &["resubmit"]),
    ("photonfarm", &["render"]),
    ("photonfarm", &["check"]),
    ("photonfarm", &["compare"]),
    ("photonfarm", &["converge"]),
    ("photonfarm", &["mix"]),
    ("photonfarm", &["token", "create"]),
    ("photonfarm", &["backup"]),
];

fn help(name: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(program(name));
    for (variable, _) in std::env::vars().filter(|(name, _)| name.starts_with("PHOTONFARM_")) {
        command.env_remove(variable);
    }
    // The width that lines are wrapped at.
    command.env_remove("COLUMNS");
    let output = command.args(arguments).arg("--help").output().unwrap();
    assert!(output.status.success(), "{name} {arguments:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

/// The integrators, and a table of their settings.
fn integrators() -> String {
    let mut page = "\n## Integrators\n\n\
        `--integrator` names one; so do `type` in a job's `integrator` and in a scene's `<integrator>`.\n\n\
        | integrator | what it is |\n| --- | --- |\n"
        .to_owned();
    for integrator in INTEGRATORS {
        page += &format!("| `{}` | {} |\n", integrator.name, integrator.summary);
    }
    page += "\n## Settings of integrators\n\n\
        `--set NAME=VALUE` sets one; so do a job's `integrator` and the properties of a scene's `<integrator>`, by the same names.\n\
        Lists are separated by commas or spaces; in JSON they are arrays.\n\n\
        | setting | integrators | what it means | values | default |\n| --- | --- | --- | --- | --- |\n";
    for entry in reference() {
        page += &format!(
            "| `{}` | {} | {} | {} | {} |\n",
            entry.setting.name,
            entry.integrators(),
            entry.setting.help,
            entry.setting.expected(),
            entry.default()
        );
    }
    page
}

#[test]
fn the_reference_is_that_of_the_programs() {
    let mut page = HEAD.to_owned() + &integrators();
    for (name, arguments) in COMMANDS {
        let title = [&[name], arguments].concat().join(" ");
        page += &format!("\n## {title}\n\n```text\n{}```\n", help(name, arguments));
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/CONFIGURATION.md");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &page).unwrap();
    }
    let written = std::fs::read_to_string(&path).unwrap();
    assert!(
        written == page,
        "docs/CONFIGURATION.md is out of date: set UPDATE=1 and run this test again"
    );
}
