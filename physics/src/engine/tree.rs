//! The robot's structure as the engine walks it: fixed-size tables, parents before children.

use crate::robot::{MAX_BODIES, MAX_CUBES, MAX_HALVES, MAX_PAIRS, Robot};

/// Contact points per cube: the ball's lowest point, or three points on the rim of a face.
pub(crate) const SLOTS_PER_CUBE: usize = 3;
/// Most contact points.
pub(crate) const MAX_SLOTS: usize = MAX_CUBES * SLOTS_PER_CUBE;

#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub bodies: usize,
    pub parent: [usize; MAX_BODIES],
    pub offset: [[f64; 3]; MAX_BODIES],
    /// Whether `offset` is not zero.
    pub apart: [bool; MAX_BODIES],
    pub axis: [[f64; 3]; MAX_BODIES],
    /// Bit k: body k is on the path to the base.
    pub path: [u32; MAX_BODIES],
    pub halves: usize,
    pub half_body: [usize; MAX_HALVES],
    pub half_centre: [[f64; 3]; MAX_HALVES],
    /// Whether the half's centre is not its body's origin.
    pub half_apart: [bool; MAX_HALVES],
    pub half_diagonal: [[f64; 3]; MAX_HALVES],
    pub half_faces: [[[f64; 3]; 3]; MAX_HALVES],
    pub cubes: usize,
    /// Halves of a cube.
    pub cube: [[usize; 2]; MAX_CUBES],
    pub pairs: usize,
    pub pair: [[usize; 2]; MAX_PAIRS],
    pub ball_m: f64,
    pub face_m: f64,
    pub rim_m: f64,
    pub com_m: f64,
    pub centre_inertia_m2: f64,
    pub fixed_base: bool,
    /// Height of the base's origin over the ground at home.
    pub home_height_m: f64,
}

impl Tree {
    pub(crate) fn new(robot: &Robot) -> Tree {
        let raw = robot.raw();
        let shape = robot.shape();
        let mut tree = Tree {
            bodies: raw.bodies.len(),
            parent: [0; MAX_BODIES],
            offset: [[0.0; 3]; MAX_BODIES],
            apart: [false; MAX_BODIES],
            axis: [[0.0; 3]; MAX_BODIES],
            path: [0; MAX_BODIES],
            halves: raw.halves.len(),
            half_body: [0; MAX_HALVES],
            half_centre: [[0.0; 3]; MAX_HALVES],
            half_apart: [false; MAX_HALVES],
            half_diagonal: [[0.0; 3]; MAX_HALVES],
            half_faces: [[[0.0; 3]; 3]; MAX_HALVES],
            cubes: raw.cubes.len(),
            cube: [[0; 2]; MAX_CUBES],
            pairs: raw.pairs.len(),
            pair: [[0; 2]; MAX_PAIRS],
            ball_m: raw.ball_radius_m,
            face_m: shape.face_m,
            rim_m: shape.rim_m,
            com_m: shape.com_m,
            centre_inertia_m2: shape.centre_inertia_m2,
            fixed_base: raw.fixed_base,
            home_height_m: robot.home_height_m(),
        };
        for (b, body) in raw.bodies.iter().enumerate() {
            tree.parent[b] = body.parent.unwrap_or(0);
            tree.offset[b] = body.offset_m;
            tree.apart[b] = body.offset_m != [0.0; 3];
            tree.axis[b] = body.axis;
            tree.path[b] = robot.path(b);
        }
        for (h, half) in raw.halves.iter().enumerate() {
            tree.half_body[h] = half.body;
            tree.half_centre[h] = half.centre_m;
            tree.half_apart[h] = half.centre_m != [0.0; 3];
            tree.half_diagonal[h] = robot.diagonal(h);
            tree.half_faces[h] = half.faces;
        }
        tree.cube[..raw.cubes.len()].copy_from_slice(&raw.cubes);
        tree.pair[..raw.pairs.len()].copy_from_slice(&raw.pairs);
        tree
    }
}
