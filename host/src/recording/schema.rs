//! Topics and their message definitions, as `ros2msg` text.

/// A topic with its schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// Topic name.
    pub topic: &'static str,
    /// Full type name.
    pub schema: &'static str,
    /// `ros2msg` text, dependencies appended.
    pub text: &'static str,
}

/// Positions and speeds, for any ROS tool.
pub const JOINT_STATES: Topic = Topic {
    topic: "/joint_states",
    schema: "sensor_msgs/msg/JointState",
    text: include_str!("msg/JointState.msg"),
};
/// Everything the drivers told, with the set-points.
pub const MOTORS: Topic = Topic {
    topic: "/rb/motors",
    schema: "rb_msgs/msg/Motors",
    text: include_str!("msg/Motors.msg"),
};
/// Set-points of the same gait computed on the host: what the module should have computed.
pub const CPG: Topic = Topic {
    topic: "/rb/cpg",
    schema: "rb_msgs/msg/Cpg",
    text: include_str!("msg/Cpg.msg"),
};
/// What happened, on the module and on the host.
pub const EVENTS: Topic = Topic {
    topic: "/rb/events",
    schema: "rb_msgs/msg/Event",
    text: include_str!("msg/Event.msg"),
};

/// All topics in the order of their channel ids.
pub const TOPICS: [Topic; 4] = [JOINT_STATES, MOTORS, CPG, EVENTS];
