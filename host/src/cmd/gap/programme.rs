//! What to record for a diagnosis: repeats of gaits, joints one by one in the air, a warm hold.
//!
//! The robot plays gaits and nothing else, so the motions of a joint on a bench are gaits here. A step is an oscillator that starts at its
//! peak with a fast amplitude filter and hardly turns on. A slow sine stands for the triangle, three sines of rising frequency for the chirp.

use control::gait::Gait;
use control::machine::Machine;
use control::robot::{JOINTS, RobotModel};

use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file;

/// One recording to make.
#[derive(Debug, Clone)]
pub(super) struct Item {
    /// File name without its end.
    pub(super) name: String,
    /// What is played.
    pub(super) gait: Gait,
    /// For how long, s.
    pub(super) duration_s: f64,
    /// What the robot should stand on.
    pub(super) place: Place,
}

/// Where the robot is during a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// On the ground.
    Ground,
    /// Held off the ground.
    Air,
}

/// From home to the first set-points and to rest again, s: half a turn at 1 rad/s each way, and a second of rest.
const AROUND_S: f64 = 4.0;

impl Item {
    /// Robot time that it takes, s.
    pub(super) fn cost_s(&self) -> f64 {
        self.duration_s + AROUND_S
    }
}

/// A motion of one joint: name, frequency [Hz], amplitude at most [rad], filter rate [1/s], first phase [deg], length [s].
type Motion = (&'static str, f64, f64, f64, f64, f64);

/// Amplitudes are lowered until the robot's own check passes.
const MOTIONS: [Motion; 5] = [
    // A step: 10 1/s reaches 95 % in 0.3 s; 0.27 rad moves 0.135 rad in the first cycle, what the supervisor lets pass.
    ("step", 0.02, 0.27, 10.0, 90.0, 8.0),
    ("slow", 0.1, 0.6, 2.0, 0.0, 20.0),
    ("sweep1", 0.25, 0.6, 2.0, 0.0, 8.0),
    ("sweep2", 0.5, 0.45, 2.0, 0.0, 6.0),
    ("sweep3", 1.0, 0.25, 2.0, 0.0, 5.0),
];

/// A gait that moves `joint` alone.
fn single(joint: usize, motion: &Motion, amplitude_rad: f64) -> Outcome<Gait> {
    let (name, frequency_hz, _, rate, phase_deg, duration_s) = motion;
    let mut text = format!(
        "format = 1\nname = \"joint{joint}_{name}\"\nfrequency_hz = {frequency_hz:?}\nduration_s = {duration_s:?}\nrate_a_per_s = {rate:?}\n\
         coupling = \"chain\"\nweight = 0.0\nphase_lag_deg = [0, 0, 0, 0, 0]\n"
    );
    for k in 0..JOINTS {
        let (r, phase) = if k == joint {
            (amplitude_rad, *phase_deg)
        } else {
            (0.0, 0.0)
        };
        text.push_str(&format!(
            "[[oscillator]]\namplitude_rad = {r:?}\noffset_rad = 0.0\ninitial_phase_deg = {phase:?}\n"
        ));
    }
    Ok(files::gait::parse("programme", &text)?)
}

/// A motion of one joint, as large as the robot's check lets it be.
fn alone(joint: usize, motion: &Motion, robot: &RobotModel) -> Outcome<Item> {
    let machine = Machine::meta_module(*robot);
    let mut amplitude_rad = motion.2;
    let gait = loop {
        let gait = single(joint, motion, amplitude_rad)?;
        if gait_file::check(&gait, &machine).is_ok() {
            break gait;
        }
        amplitude_rad *= 0.7;
        if amplitude_rad < 0.05 {
            let text =
                format!("joint {joint} cannot move by itself at home; check the robot model");
            return Err(Failure::say(Exit::Refused, text));
        }
    };
    Ok(Item {
        name: gait.name().to_owned(),
        gait,
        duration_s: motion.5,
        place: Place::Air,
    })
}

/// The motion of one joint by name, as `collect` would record it; `None` for a name that is none.
pub(super) fn motion(joint: usize, name: &str, robot: &RobotModel) -> Option<Outcome<Item>> {
    let motion = MOTIONS.iter().find(|m| m.0 == name)?;
    Some(alone(joint, motion, robot))
}

/// A hold of the pose that the first gait swings about: what a motor does when it gets warm.
fn hold(gait: &Gait, duration_s: f64) -> Outcome<Item> {
    let mut raw = gait.raw();
    for o in &mut raw.oscillators {
        o.amplitude_rad = 0.0;
    }
    raw.duration_s = duration_s as f32;
    raw.name.clear();
    let named = raw.name.push_str("warm_hold");
    debug_assert!(named.is_ok(), "a gait's name is longer than nine bytes");
    let gait =
        Gait::try_from(raw).map_err(|e| Failure::say(Exit::Usage, format!("--warm: {e}")))?;
    Ok(Item {
        name: "warm_hold".to_owned(),
        gait,
        duration_s,
        place: Place::Ground,
    })
}

/// What is wanted.
pub(super) struct Wanted<'a> {
    pub(super) gaits: &'a [Gait],
    pub(super) repeats: u32,
    pub(super) duration_s: Option<f64>,
    pub(super) joints: bool,
    pub(super) warm_s: f64,
}

/// The recordings in the order in which the robot changes its place once.
///
/// # Errors
/// A gait that the robot's own check refuses.
pub(super) fn items(wanted: &Wanted<'_>, robot: &RobotModel) -> Outcome<Vec<Item>> {
    let machine = Machine::meta_module(*robot);
    let mut items = Vec::new();
    for gait in wanted.gaits {
        gait_file::check(gait, &machine)
            .map_err(|e| Failure::say(Exit::Refused, format!("{}: {e}", gait.name())))?;
        for repeat in 0..wanted.repeats {
            items.push(Item {
                name: format!("{}_{repeat}", gait.name()),
                gait: gait.clone(),
                duration_s: wanted.duration_s.unwrap_or(f64::from(gait.duration_s())),
                place: Place::Ground,
            });
        }
    }
    if wanted.warm_s > 0.0
        && let Some(first) = wanted.gaits.first()
    {
        items.push(hold(first, wanted.warm_s)?);
    }
    if wanted.joints {
        for joint in 0..JOINTS {
            for motion in &MOTIONS {
                items.push(alone(joint, motion, robot)?);
            }
        }
    }
    Ok(items)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_joint_gets_its_motions_and_the_robot_would_play_them() {
        let robot = RobotModel::default();
        let gaits = super::super::shipped::gaits(2).expect("shipped");
        let wanted = Wanted {
            gaits: &gaits,
            repeats: 3,
            duration_s: Some(12.0),
            joints: true,
            warm_s: 60.0,
        };
        let items = items(&wanted, &robot).expect("all pass the check");
        assert_eq!(items.len(), 2 * 3 + 1 + JOINTS * MOTIONS.len());
        let mut names: Vec<&str> = items.iter().map(|i| i.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), items.len(), "names are file names");
        for item in &items {
            assert!(
                gait_file::check(&item.gait, &Machine::meta_module(robot)).is_ok(),
                "{}",
                item.name
            );
        }
        // The step: most of its height within half a second, then still.
        let step = &items
            .iter()
            .find(|i| i.name == "joint2_step")
            .expect("there")
            .gait;
        let mut state = control::cpg::start(step);
        let at = |state: &mut _| control::cpg::step(step, state, 0.05).as_slice()[2];
        let values: Vec<f32> = (0..60).map(|_| at(&mut state)).collect();
        assert!(values[0].abs() < 1e-6 && values[10] > 0.9 * values[30]);
        assert!((values[59] - values[30]).abs() < 0.2 * values[30]);
    }
}
