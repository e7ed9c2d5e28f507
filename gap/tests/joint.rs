//! The joint model against closed forms, and the search on data from the joint model itself.

mod common;
#[path = "common/diagnosis.rs"]
mod diagnosis;

use files::dataset::{Manifest, Recording, Signal};
use gap::joint::{P, Params, Problem, Trace, simulate};
use gap::report::Subject;
use gap::verdict::Word;
use gap::vocabulary::Compound;

fn run(bench: &str, rows: &str) -> Problem {
    let text =
        format!("format = 1\nrobot = \"bench\"\n[bench]\n{bench}\n[[run]]\nfile = \"a.csv\"\n");
    let (m, _) = Manifest::parse("d.toml", &text).expect("valid");
    let (r, _) = Recording::parse("a.csv", rows, &m).expect("valid");
    Problem::new(&m, &[r], 0).expect("position")
}

fn rows(n: usize, dt: f64, start: f64, enable: u8, setpoint: impl Fn(f64) -> f64) -> String {
    let mut s = String::from("t_s,setpoint_rad,enable,position_rad,velocity_rad_s\n");
    for i in 0..n {
        let t = i as f64 * dt;
        s.push_str(&format!("{t},{},{enable},{start},0\n", setpoint(t)));
    }
    s
}

#[test]
fn a_free_pendulum_swings_at_its_natural_frequency() {
    let p = run(
        "inertia_kg_m2 = 0.02\ngravity_nm = 0.5\n",
        &rows(2000, 0.005, 0.05, 0, |_| 0.0),
    );
    let mut trace = Trace::new();
    simulate(&p.runs[0], &Params::default(), p.dt_s, &mut trace);
    let crossings: Vec<usize> = (1..trace.len())
        .filter(|i| trace[i - 1][0] > 0.0 && trace[*i][0] <= 0.0)
        .collect();
    let period = (crossings[crossings.len() - 1] - crossings[0]) as f64 * 0.005
        / (crossings.len() - 1) as f64;
    // Small swings: 2 pi sqrt(J / m g l) = 1.2566 s.
    assert!((period - 1.2566).abs() < 0.005, "{period}");
}

/// A row shows what was sent since the row before it: 10 ms late every second time, and 20 mrad at 2 rad/s.
#[test]
fn set_points_at_20_hz_move_the_joint_alike_in_logs_of_50_and_100_hz() {
    let bench = "inertia_kg_m2 = 0.08\nmax_effort_nm = 27.0\nmax_speed_rad_s = 9.0\nsupply_v = 12.0\n\
        [bench.controller]\nkind = \"p\"\nkp = 10.0\noutput = \"duty\"\nlimit = 1.0\nperiod_s = 0.001\n";
    let sent = |t: f64| gap::math::sin(2.0 * (20.0 * t + 1e-6).floor() / 20.0);
    let [coarse, fine] = [(200, 0.02), (400, 0.01)].map(|(n, dt)| {
        let p = run(bench, &rows(n, dt, 0.0, 1, sent));
        let mut trace = Trace::new();
        simulate(&p.runs[0], &Params::default(), p.dt_s, &mut trace);
        trace
    });
    for (k, row) in coarse.iter().enumerate() {
        let other = fine[2 * k][0];
        assert!((row[0] - other).abs() < 1e-3, "{k}: {} {other}", row[0]);
    }
}

/// A drive that is asked for more volts than its bus has turns at the no-load speed of that bus; below, the bus is no matter.
#[test]
fn a_drive_that_is_asked_for_a_voltage_reaches_that_of_its_bus() {
    let bench = "inertia_kg_m2 = 0.02\nmax_effort_nm = 5.0\nmax_speed_rad_s = 3.0\nsupply_v = 12.0\n\
        [bench.controller]\nkind = \"p\"\nkp = 100.0\noutput = \"voltage\"\nperiod_s = 0.001\n";
    let top_rad_s = |target: f64, supply: f64, sag_ohm: f64| {
        let p = run(bench, &rows(400, 0.005, 0.0, 1, |_| target));
        let mut trace = Trace::new();
        let params = Params::default()
            .with(P::Supply, supply)
            .with(P::Sag, sag_ohm);
        simulate(&p.runs[0], &params, p.dt_s, &mut trace);
        let speed = |w: &[[f64; gap::joint::data::CHANNELS]]| (w[1][0] - w[0][0]) / 0.005;
        trace.windows(2).map(speed).fold(0.0, f64::max)
    };
    for supply in [0.8, 1.0, 1.2] {
        let top = top_rad_s(4.0, supply, 0.0);
        assert!((top - 3.0 * supply).abs() < 0.01, "{supply}: {top}");
    }
    let below = [(0.8, 0.0), (1.2, 0.0), (1.0, 4.0)];
    let [low, high, sags] = below.map(|(supply, ohm)| top_rad_s(0.05, supply, ohm));
    assert!((low - high).abs() < 1e-9, "{low} {high}");
    assert!((sags / high - 1.0).abs() < 0.01, "{sags} {high}");
}

#[test]
fn dry_friction_stops_a_coasting_joint_after_the_right_angle() {
    let mut text = rows(400, 0.005, 0.0, 0, |_| 0.0);
    text = text.replacen("0,0,0,0,0\n", "0,0,0,0,2.0\n", 1);
    let p = run("inertia_kg_m2 = 0.02\n", &text);
    let mut trace = Trace::new();
    let planted = Params::default().with(P::Coulomb, 0.05);
    let mut first = p.runs[0].clone();
    first.edges[0].velocity = 2.0;
    simulate(&first, &planted, p.dt_s, &mut trace);
    // Energy: J v^2 / 2 = F x.
    let want = 0.5 * 0.02 * 4.0 / 0.05;
    let end = trace[trace.len() - 1][0];
    assert!(
        (end - want).abs() < 0.005 * want + 2.0 * p.dt_s,
        "{end} against {want}"
    );
}

#[test]
fn sticking_friction_balances_where_the_bell_says() {
    let (viscous, stick, width) = (2.0, 0.3, 0.4);
    for speed in [0.2, 0.4, 0.7, 1.5] {
        // Stable: the bell falls by less than the viscous friction rises.
        let bell = libm::exp(-(speed / width) * (speed / width));
        let push = viscous * speed + stick * bell;
        let text = rows(400, 0.005, 0.0, 1, |_| push).replace("_rad,enable", "_nm,enable");
        let p = run("command = \"effort\"\ninertia_kg_m2 = 0.02\n", &text);
        let planted = Params::default()
            .with(P::Viscous, viscous)
            .with(P::Static, stick)
            .with(P::StribeckSpeed, width);
        let mut first = p.runs[0].clone();
        first.edges[0].velocity = speed;
        let mut trace = Trace::new();
        simulate(&first, &planted, p.dt_s, &mut trace);
        let n = trace.len();
        let reached = (trace[n - 1][0] - trace[n - 101][0]) / 0.5;
        assert!((reached - speed).abs() < 1e-3, "{reached} {speed}");
    }
}

#[test]
fn a_delay_moves_the_answer_and_nothing_else() {
    let bench = "inertia_kg_m2 = 0.01\n[bench.controller]\nkind = \"pid\"\nkp = 4.0\nkd = 0.4\noutput = \"effort\"\n";
    let p = run(
        bench,
        &rows(600, 0.005, 0.0, 1, |t| if t >= 0.5 { 1.0 } else { 0.0 }),
    );
    let at = |delay: f64| {
        let mut trace = Trace::new();
        simulate(
            &p.runs[0],
            &Params::default().with(P::Delay, delay),
            p.dt_s,
            &mut trace,
        );
        let i = trace.iter().position(|y| y[0] > 0.5).expect("gets there");
        let (a, b) = (trace[i - 1][0], trace[i][0]);
        (i as f64 - 1.0 + (0.5 - a) / (b - a)) * 0.005
    };
    // Also between two steps.
    for delay in [0.01, 0.0333] {
        assert!(
            (at(delay) - at(0.0) - delay).abs() < 1e-3,
            "{delay}: {}",
            at(delay) - at(0.0)
        );
    }
}

#[test]
fn a_proportional_servo_settles_at_the_balance_of_torque() {
    let bench = "inertia_kg_m2 = 0.01\ngravity_nm = 0.5\n[bench.controller]\nkind = \"pid\"\nkp = 5.0\nkd = 0.4\noutput = \"effort\"\n";
    let p = run(bench, &rows(2000, 0.005, 0.0, 1, |_| 1.0));
    let mut trace = Trace::new();
    simulate(&p.runs[0], &Params::default(), p.dt_s, &mut trace);
    let q = trace[trace.len() - 1][0];
    assert!(
        (5.0 * (1.0 - q) - 0.5 * gap::math::sin(q)).abs() < 1e-4,
        "{q}"
    );
}

/// Angles of the rotor and of its load under a constant effort of 1 N m, from rest.
fn pushed(planted: &Params) -> Vec<[f64; 2]> {
    let text = rows(1200, 0.001, 0.0, 1, |_| 1.0).replace("_rad,enable", "_nm,enable");
    let p = run("command = \"effort\"\ninertia_kg_m2 = 0.02\n", &text);
    let mut trace = Trace::new();
    simulate(&p.runs[0], planted, p.dt_s, &mut trace);
    trace.iter().map(|y| [y[0], y[4]]).collect()
}

#[test]
fn a_load_swings_against_the_rotor_as_two_masses_on_a_spring_do() {
    let (stiffness, behind) = (20.0, 0.25);
    let planted = Params::default()
        .with(P::Flexibility, 1.0 / stiffness)
        .with(P::Behind, behind);
    let all = pushed(&planted);
    // Half of the push per total inertia, whatever swings.
    let mean = (1.0 - behind) * all[1199][0] + behind * all[1199][1];
    assert!(
        (mean / (0.5 * 1.199 * 1.199 / 0.02) - 1.0).abs() < 2e-3,
        "{mean}"
    );
    // The spring pulls the load along: push times its share.
    let twist: Vec<f64> = all.iter().map(|y| y[0] - y[1]).collect();
    let rest = behind / stiffness;
    assert!(
        (twist[1199] - rest).abs() < 0.05 * rest,
        "{} {rest}",
        twist[1199]
    );
    let up: Vec<usize> = (1..600)
        .filter(|i| twist[i - 1] < rest && twist[*i] >= rest)
        .collect();
    let period = (up[3] - up[0]) as f64 * 1e-3 / 3.0;
    // 2 pi sqrt(J_1 J_2 / (J k)), damped by 0.1 of the rotor's, which is 0.2 of both.
    let free = 2.0 * std::f64::consts::PI * (0.02 * behind * (1.0 - behind) / stiffness).sqrt();
    let want = free / (1.0_f64 - 0.04).sqrt();
    assert!((period / want - 1.0).abs() < 0.006, "{period} {want}");
}

#[test]
fn a_load_behind_play_hangs_at_its_edge_and_meets_the_rotor_after_it() {
    let bench = "inertia_kg_m2 = 0.02\ngravity_nm = 0.5\n[bench.controller]\nkind = \"pid\"\nkp = 5.0\nkd = 0.4\noutput = \"effort\"\n";
    let p = run(bench, &rows(2000, 0.005, 0.0, 1, |_| 1.0));
    let mut trace = Trace::new();
    let planted = Params::default().with(P::Play, 0.05);
    simulate(&p.runs[0], &planted, p.dt_s, &mut trace);
    let [q, link] = [trace[1999][0], trace[1999][4]];
    assert!((q - link - 0.05).abs() < 5e-4, "{q} {link}");
    assert!(
        (5.0 * (1.0 - q) - 0.5 * gap::math::sin(link)).abs() < 1e-3,
        "{q}"
    );
    // Half of the inertia moves alone over half of the play, and meets the load at sqrt(2 a x).
    let all = pushed(&planted);
    let first = all.iter().position(|y| y[1] > 1e-4).expect("meets");
    let want = (2.0 * 0.05 * 0.01_f64).sqrt();
    assert!(
        (first as f64 * 1e-3 - want).abs() < 3e-3,
        "{first} ms, {want} s"
    );
    // Then both go on together, but for what the first impact left.
    let apart = all[1199][0] - all[1199][1];
    assert!((apart - 0.05).abs() < 2e-3, "{apart}");
}

/// A set-point `a t^2 / 2` keeps a loop of gains `kp` and `kd` behind by `(J a + kd v) / kp` with the speed `v` that it
/// sees: a speed that is late by `d` takes `kd a d / kp` off, whatever holds and samples.
#[test]
fn a_speed_is_seen_as_late_as_its_delay_says_by_a_slow_controller_too() {
    const A: f64 = 2.0;
    let (kp, kd, period_s) = (10.0, 0.3, 0.005);
    let p = run(
        &format!(
            "inertia_kg_m2 = 0.02\n[bench.controller]\nkind = \"pid\"\noutput = \"effort\"\nkp = {kp}\nkd = {kd}\nlimit = 100.0\nperiod_s = {period_s}"
        ),
        &rows(1000, 0.002, 0.0, 1, |t| 0.5 * A * t * t),
    );
    let end = |periods: f64| {
        let mut trace = Trace::new();
        let late = Params::default().with(P::SpeedDelay, periods);
        simulate(&p.runs[0], &late, p.dt_s, &mut trace);
        trace[trace.len() - 1][0]
    };
    for periods in [1.0, 2.0, 2.5] {
        let ahead = end(periods) - end(0.5);
        let want = kd * A * (periods - 0.5) * period_s / kp;
        assert!(
            (ahead - want).abs() < 0.02 * want,
            "{periods}: {ahead} of {want}"
        );
    }
}

/// A speed servo of stiffness `J / (droop tau)` loses `c droop tau / J` of its speed to a friction `c`, whatever the time
/// constant `tau` of its loop: a ramp is followed that much over the position gain further behind.
#[test]
fn a_speed_servo_droops_by_its_stiffness_and_follows_by_its_time_constant() {
    let (kp, inertia, friction, grip_s) = (8.0, 0.02, 0.1, 0.01);
    let p = run(
        &format!(
            "inertia_kg_m2 = {inertia}\nmax_effort_nm = 100.0\n[bench.controller]\nkind = \"p\"\noutput = \"velocity\"\nkp = {kp}\nlimit = 100.0"
        ),
        &rows(1000, 0.005, 0.0, 1, |t| 0.5 * t),
    );
    let follows = |dry: f64, droop: f64| {
        let mut trace = Trace::new();
        let servo = Params::default()
            .with(P::Grip, grip_s)
            .with(P::Droop, droop)
            .with(P::Coulomb, dry);
        simulate(&p.runs[0], &servo, p.dt_s, &mut trace);
        trace.iter().map(|y| y[0]).collect::<Vec<f64>>()
    };
    let free = follows(0.0, 1.0);
    let tau_s = grip_s + p.dt_s;
    for droop in [0.7, 1.0, 1.5] {
        let unloaded = follows(0.0, droop);
        let apart = free.iter().zip(&unloaded).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-9, "{droop}");
        let behind = free[999] - follows(friction, droop)[999];
        let want = friction * droop * tau_s / (inertia * kp);
        assert!((behind / want - 1.0).abs() < 0.01, "{behind} of {want}");
    }
}

#[test]
fn planted_effects_are_found_inverse_crime() {
    let table = [
        ("joint_sign", Params::default().with(P::Scale, -1.0)),
        ("gravity_load", Params::default().with(P::Gravity, 1.5)),
        ("backlash", Params::default().with(P::Play, 0.03)),
    ];
    let mut wrong = Vec::new();
    for (name, planted) in table {
        let (m, r) = common::data(&planted, 7);
        let d = diagnosis::diagnosed(&m, &r);
        let top = d.verdict.effects.first().map(|e| e.effect.name());
        let class = d
            .verdict
            .ambiguous
            .iter()
            .any(|a| a.effects.iter().any(|e| e.name() == name));
        if top != Some(name) && !class {
            wrong.push((name, top));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn a_payload_is_one_cause_of_two_effects() {
    let planted = Params::default()
        .with(P::Gravity, 1.6)
        .with(P::Inertia, 1.5);
    let (m, r) = common::data(&planted, 7);
    let v = diagnosis::diagnosed(&m, &r).verdict;
    let parts: Vec<_> = v.effects.iter().map(|e| (e.effect, e.part_of)).collect();
    let payload = Compound::Payload;
    assert_eq!(parts, payload.effects().map(|e| (e, Some(payload))));
    assert!(v.sentence.contains(payload.plain()), "{}", v.sentence);
}

/// At 10 ms this loop swings by itself at some 17 Hz: some seventy periods in four seconds, so the whole runs alone lead no start there.
#[test]
fn a_late_encoder_that_makes_the_loop_swing_is_found() {
    let planted = Params::default()
        .with(P::FeedbackDelay, 0.0101)
        .with(P::Inertia, 1.04)
        .with(P::Motor, 0.98);
    let (m, r) = common::data(&planted, 7);
    let d = diagnosis::diagnosed(&m, &r);
    let names: Vec<&str> = (d.verdict.effects.iter())
        .map(|e| e.effect.name())
        .collect();
    assert_eq!(
        names.first(),
        Some(&"feedback_delay"),
        "{}",
        d.verdict.sentence
    );
    // Positions that correct a play over a third of a swing move its phase: the delay is off by a part of a row of 10 ms.
    let delay_s = d.found.params.get(P::FeedbackDelay);
    assert!((delay_s - 0.0101).abs() < 1.5e-3, "{delay_s}");
}

/// A warm motor beside a limit, by what it loses: little or much, it is found at its size.
#[test]
fn a_motor_that_weakens_beside_a_limit_is_found_at_its_size() {
    for share in [0.07, 0.35] {
        let planted = Params::default()
            .with(P::TorqueLimit, 1.2)
            .with(P::DerateShare, share)
            .with(P::DerateTime, 2.5);
        let (m, r) = common::data(&planted, 7);
        let d = diagnosis::diagnosed(&m, &r);
        let effects = &d.verdict.effects;
        let names: Vec<&str> = effects.iter().map(|e| e.effect.name()).collect();
        let limits = |n: &&str| ["torque_limit", "current_limit"].contains(n);
        assert!(names.iter().any(limits), "{share}: {names:?}");
        let weak = (effects.iter()).find(|e| e.effect.name() == "thermal_derating");
        let weak = weak.expect("it is named");
        let fraction = weak.parameters["fraction"].value;
        assert!((fraction - share).abs() < 0.02, "{share}: {fraction}");
    }
}

#[test]
fn no_effect_is_called_none_and_the_answer_repeats() {
    let (m, r) = common::data(
        &Params::default()
            .with(P::Inertia, 1.04)
            .with(P::Gravity, 0.98),
        3,
    );
    let one = diagnosis::diagnosed(&m, &r).verdict;
    assert_eq!(one.verdict, Word::None, "{}", one.sentence);
    assert!(one.effects.is_empty());
    let total: f64 = one.place.iter().map(|w| w.share).sum();
    assert!(total <= 1.0 + 1e-9);
    let two = diagnosis::diagnosed(&m, &r).verdict;
    assert_eq!(
        serde_json::to_string(&one).expect("json"),
        serde_json::to_string(&two).expect("json")
    );
}

/// The servo holds what its encoder reads, so the link goes with a zero that drifts. Inertia and gravity are off within their tolerances: that is no place to look at.
#[test]
fn a_zero_that_drifts_is_unknown_between_encoder_and_link() {
    let nominal = Params::default()
        .with(P::Inertia, 1.06)
        .with(P::Gravity, 0.97);
    let (m, mut recordings) = common::data(&nominal, 7);
    for r in &mut recordings {
        let t_s = r.t_s().to_vec();
        let joint = r.joint_mut(0).expect("one joint");
        let link = joint.get(Signal::LinkPosition).expect("a link").to_vec();
        let moved = link.iter().zip(&t_s).map(|(q, t)| q + 0.003 * t).collect();
        joint.set(Signal::LinkPosition, Some(moved));
    }
    let v = diagnosis::diagnosed(&m, &recordings).verdict;
    assert_eq!(v.verdict, Word::Unknown, "{}", v.sentence);
    // A gear that slips slowly moves the link from the encoder alike.
    let alike = ["conventions", "transmission"];
    let place = v.place[0].stage.as_str();
    assert!(alike.contains(&place), "{:?} {}", v.place, v.sentence);
    let total: f64 = v.place.iter().map(|w| w.share).sum();
    assert!((total - 1.0).abs() < 1e-9, "{total}");
}

#[test]
fn probabilities_and_shares_sum_to_one_and_the_patch_reads_back() {
    let (m, r) = common::data(&Params::default().with(P::Coulomb, 0.8), 5);
    let d = diagnosis::diagnosed(&m, &r);
    let v = &d.verdict;
    let first = v.effects.first().map(|e| e.effect.name());
    assert_eq!(first, Some("coulomb_friction"), "{}", v.sentence);
    let p: f64 = v.effects.iter().map(|e| e.confidence).sum::<f64>()
        + v.probabilities.none
        + v.probabilities.unknown;
    assert!((p - 1.0).abs() < 1e-9, "{p}");
    let shares: f64 = v.place.iter().map(|w| w.share).sum();
    assert!((shares - 1.0).abs() < 1e-9, "{shares}");
    assert_eq!(
        gap::patch::parse(&gap::patch::to_toml(&d)).expect("reads"),
        d.found
    );
    let html = gap::report::html(&d, &Subject::new(&m, None));
    for forbidden in ["http://", "https://", "src=", "@import"] {
        assert!(!html.contains(forbidden), "{forbidden}");
    }
    let csv = gap::predict::csv(&d.scored(), 0, &d.found);
    assert!(Recording::parse("p.csv", &csv, &m).is_ok());
}

#[test]
fn the_diagnosis_depends_on_no_maker_of_test_data() {
    let out = std::process::Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--format-version",
            "1",
            "--offline",
            "--no-deps",
        ])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let v: serde_json::Value = serde_json::from_slice(&out.stdout).expect("json");
    let packages = v["packages"].as_array().expect("packages");
    let depends = |name: &str| -> Vec<String> {
        let p = packages.iter().find(|p| p["name"] == name);
        let list = p
            .and_then(|p| p["dependencies"].as_array())
            .cloned()
            .unwrap_or_default();
        list.iter()
            .filter(|d| d["kind"].is_null())
            .filter_map(|d| d["name"].as_str().map(str::to_string))
            .collect()
    };
    let mut seen = vec!["gap".to_string()];
    let mut i = 0;
    while i < seen.len() {
        for d in depends(&seen[i].clone()) {
            if !seen.contains(&d) {
                seen.push(d);
            }
        }
        i += 1;
    }
    assert!(seen.len() > 3);
    assert!(!seen.iter().any(|n| n == "hil-sim"), "{seen:?}");
}

#[test]
fn a_play_that_is_right_needs_no_correction() {
    let truth = Params::default().with(P::FeedbackDelay, 0.009);
    let (manifest, recordings) = common::data(&truth, 3);
    let problem = Problem::new(&manifest, &recordings, 0).expect("position");
    let mut run = problem.runs[0].clone();
    let (mut free, mut held) = (Trace::new(), Trace::new());
    simulate(&run, &truth, problem.dt_s, &mut free);
    for (sample, row) in run.samples.iter_mut().zip(&free) {
        sample.measured[0] = row[0];
    }
    run.horizon_s = 0.05;
    simulate(&run, &truth, problem.dt_s, &mut held);
    assert_eq!(free, held);
}

#[test]
fn a_joint_that_swings_by_itself_is_predicted_over_a_short_horizon() {
    // The loop sees its encoder 15 ms late and swings; the play has 5 % less inertia, so it swings faster.
    let truth = Params::default().with(P::FeedbackDelay, 0.015);
    let (manifest, recordings) = common::data(&truth, 3);
    let mut problem = Problem::new(&manifest, &recordings, 0).expect("position");
    let near = truth.with(P::Inertia, 0.95);
    let mut left = |horizon_s: f64| {
        let mut errors = Vec::new();
        for run in &mut problem.runs {
            run.horizon_s = horizon_s;
            let mut trace = Trace::new();
            simulate(run, &near, problem.dt_s, &mut trace);
            let each = run.samples.iter().zip(&trace);
            errors.extend(each.map(|(s, y)| s.measured[0] - y[0]));
        }
        gap::math::rms(&errors)
    };
    let [free, held] = [f64::INFINITY, 0.05].map(&mut left);
    assert!(held < 0.5 * free, "{held} of {free}");
}
