"""The meta-module at home along x, from the design: cubes, half-spheres, axes."""

import math

import numpy as np

EDGE_M, BALL_M = 0.110, 0.062
DIAGONAL = np.ones(3) / math.sqrt(3.0)
PLACES = np.array([[k * EDGE_M, 0, 0] for k in range(4)])
ORIGINS = np.array([PLACES[0], PLACES[0], PLACES[1], 0.5 * (PLACES[1] + PLACES[2]), PLACES[2], PLACES[3], PLACES[3]])
HALVES = [[0], [1], [2], [3, 4], [5], [6], [7]]


def turn_x(angle):
    """Rotation about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def half_points(h, n):
    """Surface points of half-sphere `h`: a ball cut by its cube's faces and by the diagonal plane."""
    diagonal = DIAGONAL if h < 4 else turn_x(math.pi / 2) @ DIAGONAL
    side = 1.0 if h % 2 else -1.0
    flat = 0.5 * EDGE_M
    rim = math.sqrt(BALL_M**2 - flat**2)
    k = np.arange(n)
    z = 1.0 - 2.0 * (k + 0.5) / n
    a, r = 2.399963 * k, np.sqrt(1.0 - z * z)
    v = np.stack([r * np.cos(a), r * np.sin(a), z], 1)
    points = [v * np.minimum(BALL_M, flat / np.abs(v).max(axis=1))[:, None]]
    ring = np.linspace(0, 2 * math.pi, 72, endpoint=False)
    for axis in range(3):
        for face in (-flat, flat):
            p = np.full((72, 3), face)
            p[:, (axis + 1) % 3], p[:, (axis + 2) % 3] = rim * np.cos(ring), rim * np.sin(ring)
            points.append(p)
    points = np.concatenate(points)
    points = points[side * (points @ diagonal) > 0.0]
    u = np.cross(diagonal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    w = np.cross(diagonal, u)
    ring = np.linspace(0, 2 * math.pi, 96, endpoint=False)[:, None]
    v = np.cos(ring) * u + np.sin(ring) * w
    cut = v * np.minimum(BALL_M, flat / np.abs(v).max(axis=1))[:, None]
    return np.concatenate([points, cut, np.zeros((1, 3))])


def joints_at_home():
    """Axes of the joints, and points on them."""
    twisted = turn_x(math.pi / 2) @ DIAGONAL
    x = np.array([1.0, 0, 0])
    axes = [DIAGONAL, x, DIAGONAL, twisted, x, twisted]
    return axes, [PLACES[0], 0.5 * (PLACES[0] + PLACES[1]), PLACES[1], PLACES[2], 0.5 * (PLACES[2] + PLACES[3]), PLACES[3]]


def half_solid(h, step=0.001):
    """Centre of mass and inertia about it of half-sphere `h` of 1 kg, from its cube's centre."""
    diagonal = DIAGONAL if h < 4 else turn_x(math.pi / 2) @ DIAGONAL
    side = 1.0 if h % 2 else -1.0
    a = np.arange(-0.5 * EDGE_M + 0.5 * step, 0.5 * EDGE_M, step)
    p = np.stack(np.meshgrid(a, a, a, indexing="ij"), -1).reshape(-1, 3)
    p = p[(np.einsum("ij,ij->i", p, p) < BALL_M**2) & (side * (p @ diagonal) > 0)]
    centre = p.mean(axis=0)
    d = p - centre
    second = d.T @ d / len(d)
    return centre, np.trace(second) * np.eye(3) - second


def stand(angles, yaw):
    """Places and rotations of the bodies' frames with these angles, body 0 at the origin, turned by `yaw` about z."""
    axes, anchors = joints_at_home()
    c, s = math.cos(yaw), math.sin(yaw)
    rotation, shift = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.zeros(3)
    places, rotations = [shift + rotation @ ORIGINS[0]], [rotation]
    for k in range(6):
        # The motion of the distal side: about the joint's axis at home, then what all before it do.
        a = np.array(axes[k])
        x = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
        own = np.eye(3) + math.sin(angles[k]) * x + (1 - math.cos(angles[k])) * (x @ x)
        shift = shift + rotation @ (anchors[k] - own @ anchors[k])
        rotation = rotation @ own
        places.append(shift + rotation @ ORIGINS[k + 1])
        rotations.append(rotation)
    return places, rotations


def quaternion(r):
    """Of a rotation, w first."""
    w = 0.5 * math.sqrt(max(1 + np.trace(r), 0))
    if w > 1e-3:
        return np.array([w, (r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w)])
    # About half a turn: the axis is the largest column of r + 1.
    columns = r + np.eye(3)
    axis = columns[:, np.argmax(np.linalg.norm(columns, axis=0))]
    return np.concatenate([[w], axis / np.linalg.norm(axis)])
