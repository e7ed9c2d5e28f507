//! Schema of `robot.toml`.

use super::{closed, described, document, number};
use crate::model::Key;
use crate::structure::{FORMAT, LENGTH_LIMIT_M, MASS_KG, SPEED_RAD_S};
use protocol::bus::Profile;
use serde_json::{Map, Value, json};

fn triple(of: Value) -> Value {
    json!({ "type": "array", "items": of, "minItems": 3, "maxItems": 3 })
}

fn index() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn two() -> Value {
    json!({ "type": "array", "items": index(), "minItems": 2, "maxItems": 2 })
}

fn object<const N: usize>(required: &[&str], keys: [(&str, Value); N]) -> Value {
    let keys: Map<String, Value> = keys.into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
    closed(required, keys).into()
}

fn list(of: Value, least: usize) -> Value {
    json!({ "type": "array", "items": of, "minItems": least })
}

fn body() -> Value {
    let place = triple(number(-LENGTH_LIMIT_M, LENGTH_LIMIT_M));
    let direction = triple(number(f64::NEG_INFINITY, f64::INFINITY));
    object(
        &[],
        [
            (
                "parent",
                described(index(), "a body before this one; absent for the base alone"),
            ),
            (
                "offset_m",
                described(
                    place,
                    "from the parent's origin to this one's at home; the hinge goes through this origin",
                ),
            ),
            (
                "axis",
                described(
                    direction,
                    "direction about which this body turns against its parent",
                ),
            ),
            ("joint", described(index(), "index in gaits and recordings")),
            ("motor", json!({ "enum": ["intra", "inter", "connector"] })),
            (
                "no_load_speed_rad_s",
                described(
                    number(SPEED_RAD_S.0, SPEED_RAD_S.1),
                    "of the real joint, as the firmware checks it; absent: that of the motor",
                ),
            ),
        ],
    )
}

fn half() -> Value {
    let place = triple(number(-LENGTH_LIMIT_M, LENGTH_LIMIT_M));
    let direction = triple(number(f64::NEG_INFINITY, f64::INFINITY));
    object(
        &["body", "centre_m", "faces"],
        [
            ("body", index()),
            (
                "centre_m",
                described(place, "the cube's centre in the body's frame"),
            ),
            (
                "faces",
                described(triple(direction), "outward normals of the three faces"),
            ),
            (
                "mass_kg",
                described(
                    number(MASS_KG.0, MASS_KG.1),
                    "absent: the model's mass of the half-sphere with this index",
                ),
            ),
        ],
    )
}

fn driver() -> Value {
    let names = Profile::ALL.map(|profile| profile.info().name);
    described(
        json!({ "enum": names }),
        "kind of all motor drivers of the real robot",
    )
}

pub(super) fn schema() -> Value {
    let size = |key: Key| number(key.info().min, key.info().max);
    let keys: Map<String, Value> = [
        ("format", json!({ "const": FORMAT })),
        ("name", json!({ "type": "string" })),
        ("cube_m", size(Key::Cube)),
        ("ball_radius_m", size(Key::BallRadius)),
        ("fixed_base", json!({ "type": "boolean" })),
        (
            "self_collision",
            described(
                json!({ "const": "unchecked" }),
                "nothing checks whether the parts of the real robot meet, and its user knows; without it only the meta-module and one module run",
            ),
        ),
        ("bus", object(&["driver"], [("driver", driver())])),
        ("body", list(body(), 1)),
        ("half", list(half(), 1)),
        ("cube", list(object(&["halves"], [("halves", two())]), 1)),
        ("pair", list(object(&["cubes"], [("cubes", two())]), 0)),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_owned(), value))
    .collect();
    document(
        "robot.toml",
        &["format", "name", "body", "half", "cube"],
        keys,
    )
    .into()
}
