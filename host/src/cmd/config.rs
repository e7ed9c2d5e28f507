//! `rb-host config`

use std::path::PathBuf;

use protocol::link::ToModule;
use serde_json::json;

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::{LinkError, keys};
use crate::settings::{self, Key, PORTS_FILE, PROJECT_FILE};

/// Show settings with their origins, write a settings file, manage robot keys
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Show every setting and where its value comes from
    Show,
    /// Show the files that are read
    Path,
    /// Write a commented rb.toml into this folder
    Init {
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
    /// Keys that prove an order comes from you
    Key {
        #[command(subcommand)]
        action: KeyAction,
    },
}

#[derive(Debug, clap::Subcommand)]
enum KeyAction {
    /// Make a new key, set it in the robot over its wire port, and keep it here
    Set,
    /// Show where the key of this robot is kept
    Path,
}

const TEMPLATE: &str = "\
# Settings of rb-host for this project. Flag > RB_* variable > rb_ports.toml > this file > user file > default.
format = 1

# Ports belong into rb_ports.toml (keep it out of version control):
# port = \"/dev/ttyACM0\"

# baud = 115200
# timeout = \"2s\"
# telemetry_hz = 20        # 20 or 100
# key_file = \"robot.key\"   # default: one file per robot in the user folder
";

/// Manages settings and keys.
///
/// # Errors
/// Exit codes 1, 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.action {
        Action::Show => show(context),
        Action::Path => paths(context),
        Action::Init { force } => {
            let path = PathBuf::from(PROJECT_FILE);
            disk::write_new(&path, TEMPLATE.as_bytes(), *force)?;
            context.out.say(format_args!("wrote {}", path.display()));
            Ok(())
        }
        Action::Key {
            action: KeyAction::Set,
        } => set_key(context),
        Action::Key {
            action: KeyAction::Path,
        } => key_path(context),
    }
}

fn show(context: &Context) -> Outcome {
    let rows: Vec<_> = Key::ALL
        .into_iter()
        .map(|key| (key, context.settings.get(key)))
        .collect();
    let settings: serde_json::Map<_, _> = rows
        .iter()
        .map(|(key, s)| {
            (
                key.name().to_owned(),
                json!({ "value": s.value, "origin": s.origin.to_string() }),
            )
        })
        .collect();
    context
        .out
        .result("rb.config/1", json!({ "settings": settings }), || {
            let line = |(key, s): &(Key, settings::Setting)| {
                let value = if s.value.is_empty() {
                    "(none)"
                } else {
                    &s.value
                };
                format!("{:14} {:24} {}", key.name(), value, s.origin)
            };
            rows.iter().map(line).collect::<Vec<_>>().join("\n")
        });
    Ok(())
}

fn paths(context: &Context) -> Outcome {
    let files = [
        ("ports", settings::upward(PORTS_FILE)),
        ("project", settings::upward(PROJECT_FILE)),
        ("user", settings::user_file()),
        (
            "keys",
            settings::user_folder().map(|folder| folder.join("keys")),
        ),
    ];
    let map: serde_json::Map<_, _> = files
        .iter()
        .map(|(k, v)| ((*k).to_owned(), json!(v)))
        .collect();
    context
        .out
        .result("rb.config_paths/1", json!({ "paths": map }), || {
            let line = |(name, path): &(&str, Option<PathBuf>)| {
                let shown = path
                    .as_ref()
                    .map_or("(none)".to_owned(), |p| p.display().to_string());
                let absent = if path.as_ref().is_some_and(|p| !p.exists()) {
                    " (absent)"
                } else {
                    ""
                };
                format!("{name:8} {shown}{absent}")
            };
            files.iter().map(line).collect::<Vec<_>>().join("\n")
        });
    Ok(())
}

fn key_path(context: &Context) -> Outcome {
    let robot = context.connect()?;
    let path = context.keys().path(robot.hello().robot_id);
    let present = robot.has_key();
    let value = json!({ "robot_id": robot.hello().robot_id, "path": path, "present": present, "robot_keyed": robot.hello().keyed });
    context.out.result("rb.key/1", value, || {
        let shown = path.map_or("(none)".to_owned(), |p| p.display().to_string());
        format!("{shown} ({})", if present { "present" } else { "absent" })
    });
    Ok(())
}

fn set_key(context: &Context) -> Outcome {
    let mut robot = context.connect_to_change()?;
    let id = robot.hello().robot_id;
    if robot.hello().keyed {
        super::confirm(
            context,
            &format!("robot {id} has a key already; replace it?"),
        )?;
    }
    let key = keys::new_key()
        .map_err(|error| Failure::say(Exit::Other, format!("cannot make a key: {error}")))?;
    // The file is written first: a key that only the robot knows would lock everyone out of its radio.
    let path = context
        .keys()
        .save(id, &key)
        .map_err(|e| Failure::new(Exit::Other, e).hint("nothing was changed in the robot"))?;
    let request = ToModule::SetKey { key };
    robot.order(&request).map_err(|error| {
        let hint = match &error {
            LinkError::Refused { .. } => "connect by USB: keys are never set over radio",
            _ => "the robot may or may not have the new key; set it again",
        };
        Failure::from(error).hint(hint)
    })?;
    robot.set_key(key);
    let value = json!({ "robot_id": id, "path": path, "present": true, "robot_keyed": true });
    context.out.result("rb.key/1", value, || {
        format!("key of robot {id} set; kept in {}", path.display())
    });
    Ok(())
}
