//! Quaternions in double precision, Hamilton, w first.

/// `a b`.
pub(super) fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let [aw, ax, ay, az] = a;
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// The turn back.
pub(super) fn conjugate([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w, -x, -y, -z]
}

/// The turn by a rotation vector.
pub(super) fn exp(v: [f64; 3]) -> [f64; 4] {
    let angle = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (s, c) = libm::sincos(0.5 * angle);
    let k = if angle < 1e-9 { 0.5 } else { s / angle };
    [c, k * v[0], k * v[1], k * v[2]]
}

/// Rotation vector of a turn.
pub(super) fn log([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let sine = (x * x + y * y + z * z).sqrt();
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let k = if sine < 1e-9 {
        2.0 * sign
    } else {
        2.0 * sign * libm::atan2(sine, w.abs()) / sine
    };
    [k * x, k * y, k * z]
}

/// Rotation vector from attitude `a` to `b`, world axes.
pub(super) fn between(a: [f64; 4], b: [f64; 4]) -> [f64; 3] {
    log(times(b, conjugate(a)))
}

/// Rotation vector from attitude `a` to `b`, axes of the body.
pub(super) fn body_between(a: [f64; 4], b: [f64; 4]) -> [f64; 3] {
    log(times(conjugate(a), b))
}

/// `v` turned by `q`.
pub(super) fn apply(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let [_, x, y, z] = times(times(q, [0.0, v[0], v[1], v[2]]), conjugate(q));
    [x, y, z]
}
