//! Sensors, and the files of a data set folder.

use std::fmt::Write as _;

use camera::{Solid, View};
use control::gait::Gait;
use control::kinematics;
use control::linalg::{Pose as CPose, Rot3, Vec3};
use control::robot::RobotModel;
use physics::Pose;

use super::machine::Sample;
use super::reality::CameraTruth;
use super::{CAMERA_HEIGHT_M, JOINTS, Plan, REPEATS, Signal};
use hil_sim::rng::Rng;

/// Noise of a sensor, 1 sigma. Encoder: 10 urad edges and a shaft that trembles. Speed: differences over 10 ms.
/// Current and duty: X-series steps of 2.7 mA and 0.1 %, and noise above them. Torque sensor 0.03 N m, bus 20 mV. Rate
/// gyro and accelerometer: a MEMS sensor at 40 Hz. Base: a tracked marker.
pub(super) const POSITION_RAD: f64 = 2.0e-4;
pub(super) const SPEED_RAD_S: f64 = 0.01;
pub(super) const CURRENT_A: f64 = 5.0e-3;
pub(super) const EFFORT_NM: f64 = 0.03;
pub(super) const DUTY: f64 = 2.0e-3;
pub(super) const BUS_V: f64 = 0.02;
pub(super) const GYRO_RAD_S: f64 = 0.01;
pub(super) const ACCEL_M_S2: f64 = 0.05;
pub(super) const BASE_M: f64 = 1.0e-3;
pub(super) const TURN_RAD: f64 = 4.0e-3;

/// Film: frames per second, size, focal length (a quarter of a Kinect's 640 x 480 at 580 pixels, doubled).
pub(super) const FRAME_HZ: f64 = 5.0;
const WIDTH_PX: usize = 320;
const HEIGHT_PX: usize = 240;
pub(super) const FOCAL_PX: f64 = 290.0;

pub(super) fn run_name(gait: &Gait, repeat: usize) -> String {
    format!("{}_{repeat}", gait.name())
}

pub(super) fn manifest(plan: &Plan, gaits: &[Gait]) -> String {
    let mut s = format!(
        "format = 1\nrobot = \"metamodule\"\nname = \"blind case {}\"\n\n[metamodule]\nmodel = \"model.toml\"\n",
        plan.name
    );
    if plan.seen_by.camera() {
        let _ = write!(
            s,
            "\n[camera]\nheight_m = {{ value = {CAMERA_HEIGHT_M:?}, tolerance = 0.01 }}\nx_m = {{ value = 0.0, tolerance = 0.005 }}\n\
             y_m = {{ value = 0.0, tolerance = 0.005 }}\nyaw_rad = {{ value = 0.0, tolerance = 0.005 }}\n\
             width_px = {{ value = {WIDTH_PX}, tolerance = 0 }}\nheight_px = {{ value = {HEIGHT_PX}, tolerance = 0 }}\n\
             focal_px = {{ value = {FOCAL_PX:?}, tolerance = 0 }}\nrate_hz = {{ value = {FRAME_HZ:?}, tolerance = 0 }}\n\
             clock_offset_s = {{ value = 0.0, tolerance = 0.01 }}\n"
        );
    }
    for gait in gaits {
        for repeat in 0..REPEATS {
            let name = run_name(gait, repeat);
            let _ = write!(
                s,
                "\n[[run]]\nfile = \"{name}.csv\"\ngait = \"{}\"\n",
                gait.name()
            );
            if plan.seen_by.camera() {
                let _ = writeln!(s, "frames = \"{name}_film\"");
            }
        }
    }
    s
}

/// Columns of a joint, and what they belong to; set-points and angles are always recorded.
const COLUMNS: [(&str, Option<Signal>); 8] = [
    ("setpoint_rad", None),
    ("applied_setpoint_rad", Some(Signal::Echo)),
    ("position_rad", None),
    ("velocity_rad_s", Some(Signal::Velocity)),
    ("current_a", Some(Signal::Current)),
    ("duty", Some(Signal::Duty)),
    ("temperature_c", Some(Signal::Temperature)),
    ("effort_nm", Some(Signal::Effort)),
];

/// Rows of a run as `plan` has them recorded. What is not recorded has its noise all the same: the rest stays as it is.
pub(super) fn csv(track: &[Sample], plan: &Plan, noise: &mut Rng) -> String {
    let inertial = !plan.without.contains(&Signal::Inertial);
    let mut s = String::from("t_s");
    if !plan.without.contains(&Signal::Bus) {
        s.push_str(",bus_v");
    }
    for k in 0..JOINTS {
        for (column, signal) in COLUMNS {
            if signal.is_none_or(|x| !plan.without.contains(&x)) {
                let _ = write!(s, ",{column}_{k}");
            }
        }
    }
    if plan.seen_by.tracker() {
        if inertial {
            s.push_str(
                ",gyro_rad_s_x,gyro_rad_s_y,gyro_rad_s_z,accel_m_s2_x,accel_m_s2_y,accel_m_s2_z",
            );
        }
        if !plan.without.contains(&Signal::Pose) {
            s.push_str(",base_x_m,base_y_m,base_z_m,base_qw,base_qx,base_qy,base_qz");
        }
    }
    s.push('\n');
    for (row, sample) in track.iter().enumerate() {
        joints(&mut s, sample, &plan.without, noise);
        if plan.seen_by.tracker() {
            base(&mut s, (row, sample), &plan.without, noise);
        }
        s.push('\n');
    }
    s
}

fn joints(s: &mut String, x: &Sample, without: &[Signal], noise: &mut Rng) {
    let mut n = |sigma: f64| sigma * noise.normal();
    let _ = write!(s, "{:.3}", x.t_s);
    let bus_v = x.bus_v + n(BUS_V);
    if !without.contains(&Signal::Bus) {
        let _ = write!(s, ",{bus_v:.2}");
    }
    for k in 0..JOINTS {
        let values = [
            (x.sent_rad[k], 5),
            (x.applied_rad[k], 5),
            (x.encoder_rad[k] + n(POSITION_RAD), 5),
            (x.speed_rad_s[k] + n(SPEED_RAD_S), 4),
            (x.current_a[k] + n(CURRENT_A), 4),
            ((x.duty[k] + n(DUTY)).clamp(-1.0, 1.0), 3),
            (x.case_c[k], 0),
            (x.effort_nm[k] + n(EFFORT_NM), 4),
        ];
        for ((value, digits), (_, signal)) in values.into_iter().zip(COLUMNS) {
            if signal.is_none_or(|x| !without.contains(&x)) {
                let _ = write!(s, ",{value:.digits$}");
            }
        }
    }
}

fn base(s: &mut String, (row, x): (usize, &Sample), without: &[Signal], noise: &mut Rng) {
    let [inertial, pose] = [Signal::Inertial, Signal::Pose].map(|x| !without.contains(&x));
    let mut n = |sigma: f64| sigma * noise.normal();
    let rates = x.gyro_rad_s.map(|v| (v + n(GYRO_RAD_S), 4));
    let forces = x.accel_m_s2.map(|v| (v + n(ACCEL_M_S2), 3));
    for (value, digits) in rates.into_iter().chain(forces).filter(|_| inertial) {
        let _ = write!(s, ",{value:.digits$}");
    }
    // The tracker runs at half the rate of the rows.
    if row.is_multiple_of(2) {
        let place = x.base.position_m.map(|v| (f64::from(v) + n(BASE_M), 4));
        let turn = [n(TURN_RAD), n(TURN_RAD), n(TURN_RAD)];
        let attitude = turned(x.base.quaternion, turn).map(|v| (v, 5));
        for (value, digits) in place.into_iter().chain(attitude).filter(|_| pose) {
            let _ = write!(s, ",{value:.digits$}");
        }
    } else if pose {
        s.push_str(",,,,,,,");
    }
}

/// A quaternion turned by a small angle, normalised.
fn turned(q: [f32; 4], by: [f64; 3]) -> [f64; 4] {
    let [w, x, y, z] = q.map(f64::from);
    let [a, b, c] = by.map(|t| 0.5 * t);
    let r = [
        w - (a * x + b * y + c * z),
        x + (a * w + b * z - c * y),
        y + (b * w + c * x - a * z),
        z + (c * w + a * y - b * x),
    ];
    let size = r.iter().map(|v| v * v).sum::<f64>().sqrt();
    r.map(|v| v / size)
}

/// Frames and index of one run; the first frame is never lost.
pub(super) fn film(
    camera: &CameraTruth,
    track: &[Sample],
    name: &str,
    noise: &mut Rng,
) -> Vec<(String, Vec<u8>)> {
    let robot = RobotModel::default();
    let solids = Solid::meta_module(&robot);
    let view = View::new(
        camera.height_m as f32,
        (camera.x_m as f32, camera.y_m as f32),
        camera.yaw_rad as f32,
        (WIDTH_PX, HEIGHT_PX),
        FOCAL_PX as f32,
    );
    let Ok(view) = view else {
        return Vec::new();
    };
    let mut index = String::from("t_s,file\n");
    let mut files = Vec::new();
    let last = track.last().map_or(0.0, |s| s.t_s);
    let count = (last * FRAME_HZ) as usize + 1;
    for frame in 0..count {
        let label_s = frame as f64 / FRAME_HZ;
        let lost = noise.chance(camera.drop) && frame > 0;
        let taken_s = label_s + camera.shift_s;
        let Some((links_rad, base)) = stance(track, taken_s) else {
            continue;
        };
        if lost {
            continue;
        }
        let file = format!("{frame:04}.png");
        let picture = view.render(&solids, &bodies(&robot, &links_rad, &base));
        if let Ok(png) = camera::picture::silhouette_png(&picture) {
            let _ = writeln!(index, "{label_s:.3},{file}");
            files.push((format!("{name}_film/{file}"), png));
        }
    }
    files.push((format!("{name}_film/index.csv"), index.into_bytes()));
    files
}

/// Angles of the links and pose of the base at `t_s`, along straight lines between samples; `None` outside the track.
fn stance(track: &[Sample], t_s: f64) -> Option<([f32; JOINTS], Pose)> {
    let after = track.iter().position(|s| s.t_s + 1e-9 >= t_s)?;
    let b = track.get(after)?;
    let a = track.get(after.saturating_sub(1))?;
    if t_s < -1e-9 {
        return None;
    }
    let step_s = b.t_s - a.t_s;
    let share = if step_s > 0.0 {
        ((t_s - a.t_s) / step_s).min(1.0)
    } else {
        1.0
    };
    let mix = |x: f32, y: f32| ((1.0 - share) * f64::from(x) + share * f64::from(y)) as f32;
    let links_rad = std::array::from_fn(|k| mix(a.link_rad[k], b.link_rad[k]));
    let position_m = std::array::from_fn(|k| mix(a.base.position_m[k], b.base.position_m[k]));
    let (q, r) = (a.base.quaternion, b.base.quaternion);
    // Of the two quaternions of a turn, the one beside the other.
    let same = q.iter().zip(&r).map(|(x, y)| x * y).sum::<f32>() >= 0.0;
    let chord: [f32; 4] = std::array::from_fn(|k| mix(if same { q[k] } else { -q[k] }, r[k]));
    let length = libm::sqrtf(chord.iter().map(|x| x * x).sum());
    let quaternion = chord.map(|x| x / length);
    let base = Pose {
        position_m,
        quaternion,
    };
    Some((links_rad, base))
}

/// World poses of the bodies.
fn bodies(robot: &RobotModel, links_rad: &[f32; JOINTS], base: &Pose) -> Vec<CPose> {
    let [x, y, z] = base.position_m;
    let base = CPose {
        position_m: Vec3::new(x, y, z),
        rotation: Rot3::from_quaternion(base.quaternion),
    };
    kinematics::forward(robot, links_rad)
        .rebased(3, &base)
        .bodies()
        .to_vec()
}
