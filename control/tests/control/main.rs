//! Tests of the law through its public interface.

mod common;
mod cpg;
mod gait;
mod kinematics;
mod machine;
mod math;
mod motion;
mod oracle;
mod precheck;
mod study;
mod supervisor;
