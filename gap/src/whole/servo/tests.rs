//! What is compared of a joint.

use super::*;

#[test]
fn a_joint_at_its_limit_is_not_compared_until_it_has_caught_up() {
    // 10 s of rest, in rows of 25 ms; the torque is `nm` from 4 to 6 s.
    let track = |nm: f64| {
        let t_s: Vec<f64> = (0..400).map(|i| f64::from(i) * 0.025).collect();
        let between = |t: &f64| if (4.0..6.0).contains(t) { nm } else { 0.1 };
        let v = t_s.iter().map(between).collect();
        Track { t_s, v }
    };
    let cases: [(&str, f64, bool); 4] = [
        ("far below", 2.0, true),
        ("at the limit", 4.6, false),
        ("the same backward", -4.6, false),
        ("a motor that gives more has another", 6.0, true),
    ];
    for (what, nm, compared) in cases {
        let still = track(0.1);
        let run = JointRun::new(&still, &still, None, Some(&track(nm)), Load::default());
        let below = run.clone().below([4.35, 5.25]);
        for (all, kept) in [
            (&run.position, &below.position),
            (&run.effort, &below.effort),
        ] {
            for s in all {
                let t_s = s.step() as f64 * STEP_S;
                // On its way up and down a strong motor passes the limit.
                if (4.7..5.8).contains(&t_s) {
                    assert_eq!(kept.contains(s), compared, "{what} at {t_s} s");
                } else if !(3.8..6.6).contains(&t_s) {
                    assert!(kept.contains(s), "{what} at {t_s} s");
                }
            }
        }
    }
    let held = JointRun::new(
        &track(4.6),
        &track(4.6),
        None,
        Some(&track(4.6)),
        Load::default(),
    );
    let always = held.clone().below([0.0, 5.25]);
    assert_eq!(
        always.position, held.position,
        "a joint that never leaves it"
    );
}
