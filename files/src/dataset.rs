//! The data set folder: `dataset.toml` and one CSV per run, as a lab writes it by hand and the diagnosis reads it.
//!
//! Units are SI throughout. `t_s` is the device clock at the instant of measurement. A set-point holds from its row until
//! the next one. An empty cell means "no sample at this instant"; a missing column means "never measured". Rows whose
//! `enable` is 0 carry no command. The caller reads the files; this module only sees their text.
//!
//! ```
//! let text = "format = 1\nrobot = \"bench\"\nname = \"demo\"\n[bench]\n[[run]]\nfile = \"a.csv\"\ngait = \"g1\"\n";
//! let (manifest, warnings) = files::dataset::Manifest::parse("dataset.toml", text).unwrap();
//! assert!(warnings.is_empty());
//! let csv = "t_s,setpoint_rad,position_rad\n0.0,0.1,0.0\n0.1,,0.05\n";
//! let (recording, _) = files::dataset::Recording::parse("a.csv", csv, &manifest).unwrap();
//! assert_eq!(recording.len(), 2);
//! ```

mod error;
mod manifest;
mod repeats;
mod table;
mod walk;

pub(crate) use manifest::bounds;

pub use error::{DatasetError, Warning};
pub use manifest::{
    Bench, Camera, Command, Controller, ControllerKind, Manifest, Motion, Output, Quantity, Robot,
    Role, Run,
};
pub use repeats::{quantum, repeat_groups};
pub use table::{Body, JointColumns, Recording, Signal, header_name};
pub use walk::is_inside;
