//! A small data set of one joint on a bench, for tests of what is done with one.

use std::fmt::Write as _;

use crate::rig::Folder;

/// Rows per second of the recordings.
const RATE_HZ: f64 = 50.0;

/// A joint that follows triangles of 0.8 rad with a lag of 0.1 s.
#[derive(Default)]
pub(crate) struct Joint {
    /// Half the play between motor and link, rad.
    pub(crate) play_rad: f64,
    /// Width of the uniform noise of its encoder, rad.
    pub(crate) noise_rad: f64,
}

impl Joint {
    /// Ten seconds at every frequency, as the folder `joint`.
    pub(crate) fn record(&self, folder: &Folder, frequencies_hz: &[f64]) {
        std::fs::create_dir(folder.path("joint")).unwrap();
        let mut manifest =
            String::from("format = 1\nrobot = \"bench\"\n[bench]\ncommand = \"position\"\n");
        let mut noise = 1u32;
        for (run, hz) in frequencies_hz.iter().enumerate() {
            let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
            let mut q = 0.0;
            for i in 0..500 {
                let t = f64::from(i) / RATE_HZ;
                let sp = 0.8 * (1.0 - 4.0 * ((hz * t).fract() - 0.5).abs());
                let error: f64 = sp - q;
                q += 0.2 * (error - error.clamp(-self.play_rad, self.play_rad));
                // Numerical Recipes' linear congruence.
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let read = q + self.noise_rad * (f64::from(noise) / f64::from(u32::MAX) - 0.5);
                writeln!(csv, "{t:.3},{sp:.5},{read:.5}").unwrap();
            }
            folder.write(&format!("joint/run{run}.csv"), csv);
            let row = format!("[[run]]\nfile = \"run{run}.csv\"\ngait = \"g{run}\"\n");
            manifest.push_str(&row);
        }
        folder.write("joint/dataset.toml", manifest);
    }
}
