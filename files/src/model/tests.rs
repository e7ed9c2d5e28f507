use super::*;

#[test]
fn defaults_are_the_hand_tuned_column() {
    let model = Model::hand_tuned();
    assert_eq!(Key::TABLE_II.len(), 22);
    for (row, key) in (1u8..).zip(Key::TABLE_II) {
        assert_eq!(key.info().table_ii, Some(row), "{key:?}");
    }
    assert_eq!(model.value(Key::Cfm), 1e-5);
    assert_eq!(model.value(Key::Mass8), 0.325);
    assert_eq!(model.value(Key::InterTorque), 3.2);
    let total: f64 = Key::MASSES.iter().map(|k| model.value(*k)).sum();
    assert!((total - 2.6).abs() < 1e-12);
}

#[test]
fn written_models_read_back_equal() {
    let mut model = Model::meta_optimised();
    model.set_name("a \"quoted\" name");
    model
        .set_effect(Effect::StribeckFriction, Some(5), &[0.2, 0.04])
        .unwrap();
    model
        .set_effect(Effect::GroundCompliance, None, &[f64::INFINITY, 3.0])
        .unwrap();
    let text = model.to_toml();
    assert_eq!(Model::parse("m.toml", &text).unwrap(), model, "{text}");
}

#[test]
fn errors_name_line_and_remedy() {
    let cases = [
        ("name = \"x\"\n", "m.toml:1: `format` is missing, add it"),
        (
            "format = 2\n",
            "m.toml:1: format = 2, this program reads format = 1",
        ),
        (
            "format = 1\n[environment]\nerp = 0.3\n",
            "m.toml:3: `environment.erp` must be { value = …",
        ),
        (
            "format = 1\n[environment]\nerp = { value = 1.5 }\n",
            "m.toml:3: `environment.erp` is 1.5, allowed is 0 to 1",
        ),
        (
            "format = 1\n[environment]\nerp = { value = nan }\n",
            "m.toml:3: `environment.erp` is NaN",
        ),
        (
            "format = 1\n[environment]\nerp = { tolerance = 1 }\n",
            "m.toml:3: `environment.erp.value` is missing",
        ),
        (
            "format = 1\n[intra]\nspeed = { value = 1 }\n",
            "m.toml:3: unknown key `intra.speed`; known here: max_velocity_rad_s",
        ),
        (
            "format = 1\n[effect.friction]\n",
            "m.toml:2: unknown key `effect.friction`; known here: joint_order",
        ),
        (
            "format = 1\n[effect.backlash]\nhalf_width_rad = { value = 0.1 }\n",
            "exists per joint",
        ),
        (
            "format = 1\n[effect.backlash.joint_6]\nhalf_width_rad = { value = 0.1 }\n",
            "exists per joint",
        ),
        (
            "format = 1\n[effect.mass]\nratio = { value = 0 }\n",
            "`effect.mass.ratio` is 0, allowed is 0.01 to 100",
        ),
        ("format = 1\n[mass\n", "m.toml:2: not valid TOML"),
    ];
    for (text, expected) in cases {
        let message = Model::parse("m.toml", text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text:?} gave {message:?}");
    }
}

#[test]
fn effect_table_is_in_enum_order() {
    for (k, &effect) in Effect::ALL.iter().enumerate() {
        assert_eq!(effect as usize, k);
        assert_eq!(Effect::from_name(effect.info().name), Some(effect));
        for p in effect.info().parameters {
            assert!(p.neutral >= p.min && p.neutral <= p.max, "{}", p.key);
        }
    }
}
