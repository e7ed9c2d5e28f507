//! What makes a tree of bodies and half-spheres a robot.

use super::{JointClass, RawHalf, RawRobot, RobotError};
use files::structure::Part;

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn check_bodies(raw: &RawRobot) -> Result<(Vec<usize>, Vec<u32>), RobotError> {
    let count = raw.bodies.len();
    let mut body_of_joint = vec![0; count.saturating_sub(1)];
    let mut paths = vec![0u32; count];
    for (index, body) in raw.bodies.iter().enumerate() {
        match (index, body.parent, body.joint) {
            (0, None, None) => {}
            (0, _, _) | (_, None, _) | (_, _, None) => {
                return Err(RobotError::Joints { body: index });
            }
            (_, Some(parent), Some(joint)) => {
                if parent >= index {
                    return Err(RobotError::Reference {
                        part: Part::Body(index),
                        to: parent,
                    });
                }
                let Some(slot) = body_of_joint.get_mut(joint).filter(|s| **s == 0) else {
                    return Err(RobotError::Joints { body: index });
                };
                *slot = index;
                paths[index] = paths[parent] | (1 << index);
                if (dot(body.axis, body.axis) - 1.0).abs() > 1e-9 {
                    return Err(RobotError::NotUnit {
                        part: Part::Body(index),
                    });
                }
            }
        }
    }
    Ok((body_of_joint, paths))
}

pub(super) fn check_shapes(raw: &RawRobot) -> Result<(), RobotError> {
    for (index, half) in raw.halves.iter().enumerate() {
        if half.body >= raw.bodies.len() {
            return Err(RobotError::Reference {
                part: Part::Half(index),
                to: half.body,
            });
        }
        for i in 0..3 {
            for j in 0..3 {
                let expected = if i == j { 1.0 } else { 0.0 };
                if (dot(half.faces[i], half.faces[j]) - expected).abs() > 1e-9 {
                    return Err(RobotError::NotUnit {
                        part: Part::Half(index),
                    });
                }
            }
        }
    }
    let origins = home_origins(raw);
    for (index, cube) in raw.cubes.iter().enumerate() {
        for to in *cube {
            if to >= raw.halves.len() {
                return Err(RobotError::Reference {
                    part: Part::Cube(index),
                    to,
                });
            }
        }
        let [a, b] = cube.map(|h| &raw.halves[h]);
        let sum = |f: &[[f64; 3]; 3]| -> [f64; 3] {
            std::array::from_fn(|i| (f[0][i] + f[1][i] + f[2][i]) / 3.0f64.sqrt())
        };
        let centre = |half: &RawHalf| -> [f64; 3] {
            std::array::from_fn(|k| origins[half.body][k] + half.centre_m[k])
        };
        let apart: [f64; 3] = std::array::from_fn(|k| centre(a)[k] - centre(b)[k]);
        let facing = dot(sum(&a.faces), sum(&b.faces)) + 1.0;
        if facing.abs() > 1e-9 || dot(apart, apart) > 1e-12 {
            return Err(RobotError::Cube { cube: index });
        }
    }
    for (index, pair) in raw.pairs.iter().enumerate() {
        for to in *pair {
            if to >= raw.cubes.len() {
                return Err(RobotError::Reference {
                    part: Part::Pair(index),
                    to,
                });
            }
        }
    }
    Ok(())
}

/// Origins of the bodies at home, from the base's.
pub(super) fn home_origins(raw: &RawRobot) -> Vec<[f64; 3]> {
    let mut origins: Vec<[f64; 3]> = Vec::with_capacity(raw.bodies.len());
    for body in &raw.bodies {
        let parent = body.parent.and_then(|p| origins.get(p)).copied();
        let from = parent.unwrap_or([0.0; 3]);
        origins.push(std::array::from_fn(|k| from[k] + body.offset_m[k]));
    }
    origins
}

/// Every body carries something, every half-sphere is found by the contacts, motors stand before connectors.
pub(super) fn check_whole(
    raw: &RawRobot,
    body_of_joint: &[usize],
    paths: &[u32],
) -> Result<(), RobotError> {
    if raw.bodies.is_empty() {
        return Err(RobotError::Empty);
    }
    for index in 0..raw.bodies.len() {
        let carried = |half: &RawHalf| {
            index == 0 || half.body == index || paths[half.body] & (1 << index) != 0
        };
        if !raw.halves.iter().any(carried) {
            let part = Part::Body(index);
            return Err(RobotError::Massless { part });
        }
    }
    for index in 0..raw.halves.len() {
        let found = raw.cubes.iter().flatten().filter(|h| **h == index).count();
        if found != 1 {
            let part = Part::Half(index);
            return Err(RobotError::Cubeless { part, found });
        }
    }
    let motor = |body: &&usize| raw.bodies[**body].class != JointClass::Connector;
    let first = body_of_joint.iter().position(|body| !motor(&body));
    let behind = body_of_joint
        .iter()
        .skip(first.unwrap_or(body_of_joint.len()));
    behind.clone().find(motor).map_or(Ok(()), |&body| {
        let part = Part::Body(body);
        Err(RobotError::ConnectorFirst { part })
    })
}
