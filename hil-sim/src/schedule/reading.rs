//! What the laws compute again for themselves: where the end cubes are, and what a packet says.

use protocol::bus::Instruction;

/// Edge of a cube, m: cubes 1 and 4 overlap for certain when their centres are closer, for a ball of that diameter
/// lies inside each.
pub(super) const EDGE_M: f64 = 0.110;

/// Distance of the centres of cubes 1 and 4, m, from the angles of A.M2 and B.M0 alone.
/// Each end cube is one edge from the next cube, turned about the diagonal (1, 1, 1) or (1, -1, 1) of that cube.
pub(super) fn end_cubes_apart_m(a_m2_rad: f64, b_m0_rad: f64) -> f64 {
    let first = turned([1.0, 1.0, 1.0], -a_m2_rad, [-EDGE_M, 0.0, 0.0]);
    let last = turned([1.0, -1.0, 1.0], b_m0_rad, [EDGE_M, 0.0, 0.0]);
    let between = [EDGE_M, 0.0, 0.0];
    let square: f64 = (0..3)
        .map(|k| (between[k] + last[k] - first[k]).powi(2))
        .sum();
    libm::sqrt(square)
}

/// Rodrigues' formula about a diagonal of length sqrt 3.
fn turned(diagonal: [f64; 3], angle_rad: f64, v: [f64; 3]) -> [f64; 3] {
    let d = diagonal.map(|x| x / libm::sqrt(3.0));
    let (sin, cos) = (libm::sin(angle_rad), libm::cos(angle_rad));
    let dot: f64 = (0..3).map(|k| d[k] * v[k]).sum();
    let cross = [
        d[1] * v[2] - d[2] * v[1],
        d[2] * v[0] - d[0] * v[2],
        d[0] * v[1] - d[1] * v[0],
    ];
    std::array::from_fn(|k| v[k] * cos + cross[k] * sin + d[k] * dot * (1.0 - cos))
}

/// What a packet of the module says.
pub(super) type Said = (u8, u16, Vec<(usize, i32)>);

/// Instruction, first address and, of a Sync Write, joints and values. Written from the e-manual of Protocol 2.0.
pub(super) fn read_packet(bytes: &[u8]) -> Option<Said> {
    let body = bytes.strip_prefix(&[0xFF, 0xFF, 0xFD, 0x00])?;
    let (head, rest) = body.split_at_checked(4)?;
    let length = usize::from(u16::from_le_bytes([head[1], head[2]]));
    let instruction = head[3];
    if rest.len() + 1 != length {
        return None;
    }
    let data = unstuffed(rest.get(..rest.len().checked_sub(2)?)?);
    if instruction != Instruction::SyncWrite as u8 {
        return Some((instruction, 0, Vec::new()));
    }
    let [a0, a1, s0, s1, entries @ ..] = data.as_slice() else {
        return None;
    };
    let size = usize::from(u16::from_le_bytes([*s0, *s1]));
    let values = entries.chunks_exact(size + 1).map(|entry| {
        let mut value = [0; 4];
        let width = size.min(4);
        value[..width].copy_from_slice(&entry[1..=width]);
        (
            usize::from(entry[0].wrapping_sub(1)),
            i32::from_le_bytes(value),
        )
    });
    Some((
        instruction,
        u16::from_le_bytes([*a0, *a1]),
        values.collect(),
    ))
}

/// Without the FD that follows every FF FF FD.
fn unstuffed(raw: &[u8]) -> Vec<u8> {
    let (mut data, mut since) = (Vec::new(), 0);
    for byte in raw {
        if *byte == 0xFD && data[since..].ends_with(&[0xFF, 0xFF, 0xFD]) {
            since = data.len();
        } else {
            data.push(*byte);
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use super::end_cubes_apart_m;

    /// Rows of the table of forward kinematics that the project was given.
    #[test]
    fn the_end_cubes_are_where_the_table_says() {
        let deg = |a: f64, b: f64| end_cubes_apart_m(a.to_radians(), b.to_radians());
        for (a_m2, b_m0, apart_m) in [
            (0.0, 0.0, 0.330_000),
            (120.0, 0.0, 0.245_967),
            (120.0, -120.0, 0.190_526),
            (60.0, -75.0, 0.272_612),
        ] {
            assert!((deg(a_m2, b_m0) - apart_m).abs() < 1e-6, "{a_m2} {b_m0}");
        }
    }
}
