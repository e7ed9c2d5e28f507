//! Emulated motors, drivers and bus against closed forms and their own promises.

mod instruments;
mod joint;
mod on_ground;
mod position_loop;
mod recording;
mod scenario_file;
mod switches;
mod wire;
