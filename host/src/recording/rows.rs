//! What a recording holds, as values: one row per sample, event and run. Independent of the wire.

use control::robot::JOINT_NAMES;

/// One telemetry sample of all joints.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleRow {
    /// Run within the recording, from 0.
    pub run: u32,
    /// CPG cycles whose set-points had been sent before this sample; its set-points are those of the last of them.
    pub cycle: u32,
    /// Device clock at the begin of the sample's cycle, microseconds since boot. No two samples share it.
    pub t_us: u64,
    /// Whether the collision pre-check held the joints.
    pub hold: bool,
    /// Whether the joints were still moving to the start pose: t = 0 of the gait is not yet reached.
    pub approach: bool,
    /// Whether torque was on.
    pub torque: bool,
    /// Whether the set-points are new in this sample (at 100 Hz: in one of five).
    pub new_setpoint: bool,
    /// Joints in order.
    pub joints: Vec<JointRow>,
}

/// Names of the joints of a robot with so many: those of a meta-module, else `J0` and so on.
#[must_use]
pub fn joint_names(joints: usize) -> Vec<String> {
    if joints == JOINT_NAMES.len() {
        JOINT_NAMES.map(str::to_owned).to_vec()
    } else {
        (0..joints).map(|joint| format!("J{joint}")).collect()
    }
}

/// One joint of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointRow {
    /// Set-point of the CPG, rad.
    pub setpoint_rad: f64,
    /// What the driver told, if it answered.
    pub feedback: Option<Feedback>,
}

/// What a driver told about its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feedback {
    /// Device clock at the instant of the measurement, microseconds since boot.
    pub t_us: u64,
    /// Set-point that the driver applied, rad.
    pub applied_setpoint_rad: f64,
    /// Motor-side position divided by the gear ratio, rad.
    pub position_rad: f64,
    /// Speed, rad/s.
    pub velocity_rad_s: f64,
    /// Motor current, A.
    pub current_a: f64,
    /// Duty, -1 to 1 of the bus voltage.
    pub duty: f64,
    /// Bus voltage at the driver, V.
    pub voltage_v: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Driver status bits.
    pub status: u16,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventRow {
    /// Run within the recording.
    pub run: u32,
    /// The module's event number, or 0 for an event of the host.
    pub seq: u32,
    /// Device clock, microseconds since boot.
    pub t_us: u64,
    /// Who saw it: `module` or `host`.
    pub source: String,
    /// Stable short name, such as `hold` or `link_lost`.
    pub kind: String,
    /// For people.
    pub text: String,
}

/// Start of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunStart {
    /// Run within the recording.
    pub run: u32,
    /// Gait name.
    pub gait: String,
    /// Digest of the gait as the module stored it, hexadecimal.
    pub digest: String,
    /// Length of the lease, s.
    pub duration_s: f64,
    /// Samples per second asked for.
    pub rate_hz: f64,
}

/// End of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RunEndRow {
    /// Run within the recording.
    pub run: u32,
    /// Why it ended.
    pub reason: String,
    /// CPG cycles.
    pub cycles: u32,
    /// Cycles held by the pre-check.
    pub holds: u32,
    /// Samples the module took.
    pub samples: u32,
    /// Samples the module had no room for.
    pub dropped_by_module: u32,
    /// Samples recorded.
    pub recorded: u32,
    /// Samples lost on the way: taken, not dropped by the module, not recorded.
    pub lost_on_link: u32,
    /// Times the link was lost and found again.
    pub reconnects: u32,
    /// CRC-32C over the set-points as the module computed them.
    pub setpoint_crc32c: u32,
}
