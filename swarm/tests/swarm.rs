//! The swarm against the literature, an independent implementation and itself resumed.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::particleswarm::ParticleSwarm;
use swarm::{Purpose, Settings, SettingsError, Swarm, TellError, constriction, stream, unit};

fn sphere(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum()
}

fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2)
        .map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2))
        .sum()
}

fn rastrigin(x: &[f64]) -> f64 {
    let term = |v: &f64| v * v - 10.0 * libm::cos(core::f64::consts::TAU * v) + 10.0;
    x.iter().map(term).sum()
}

fn minimise(
    cost: fn(&[f64]) -> f64,
    dimensions: usize,
    particles: usize,
    iterations: u32,
    seed: u64,
) -> f64 {
    let settings = Settings::new(vec![(-5.12, 5.12); dimensions], particles, seed).unwrap();
    let mut swarm = Swarm::start(settings);
    for _ in 0..iterations {
        let fitness: Vec<f64> = swarm.ask().iter().map(|x| -cost(x)).collect();
        swarm.tell(&fitness).unwrap();
    }
    -swarm.best().unwrap().fitness
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn constriction_is_the_published_value() {
    assert!((constriction(4.1).unwrap() - 0.729_843_788_1).abs() < 1e-10);
    assert_eq!(constriction(4.0), None);
    assert_eq!(constriction(f64::NAN), None);
}

#[test]
fn a_smooth_bowl_is_solved() {
    assert!(minimise(sphere, 17, 60, 400, 1) < 1e-8);
}

struct Problem(fn(&[f64]) -> f64);

impl CostFunction for Problem {
    type Param = Vec<f64>;
    type Output = f64;
    fn cost(&self, x: &Self::Param) -> Result<f64, Error> {
        Ok(self.0(x))
    }
}

/// argmin's inertia form equals equation (4) with w = K and c = K * 2.05.
fn minimise_by_argmin(
    cost: fn(&[f64]) -> f64,
    dimensions: usize,
    particles: usize,
    iterations: u64,
    seed: u64,
) -> f64 {
    use rand_09::SeedableRng;
    let k = constriction(4.1).unwrap();
    let solver = ParticleSwarm::new((vec![-5.12; dimensions], vec![5.12; dimensions]), particles)
        .with_rng_generator(rand_09::rngs::StdRng::seed_from_u64(seed))
        .with_inertia_factor(k)
        .and_then(|s| s.with_cognitive_factor(k * 2.05))
        .and_then(|s| s.with_social_factor(k * 2.05))
        .unwrap();
    let result = Executor::new(Problem(cost), solver)
        .configure(|s| s.max_iters(iterations))
        .run()
        .unwrap();
    result.state().get_best_cost()
}

/// Medians over ten seeds lie within a factor of an implementation nobody here wrote.
#[test]
fn agrees_with_argmin_on_standard_functions() {
    for (name, cost) in [
        ("rastrigin", rastrigin as fn(&[f64]) -> f64),
        ("rosenbrock", rosenbrock),
    ] {
        let ours = median(
            (0..10)
                .map(|seed| minimise(cost, 10, 100, 150, seed))
                .collect(),
        );
        let theirs = median(
            (0..10)
                .map(|seed| minimise_by_argmin(cost, 10, 100, 150, seed))
                .collect(),
        );
        println!("{name}: ours {ours:.3}, argmin {theirs:.3}");
        assert!(
            ours < 1.5 * theirs && theirs < 4.0 * ours,
            "{name}: ours {ours}, argmin {theirs}"
        );
    }
}

#[test]
fn a_search_cut_at_any_iteration_resumes_with_the_same_bits() {
    let settings = Settings::new(vec![(-1.0, 2.0); 5], 12, 99).unwrap();
    let evaluate =
        |swarm: &Swarm| -> Vec<f64> { swarm.ask().iter().map(|x| -rosenbrock(x)).collect() };
    let mut whole = Swarm::start(settings.clone());
    let mut cut = Swarm::start(settings);
    for _ in 0..25 {
        whole.tell(&evaluate(&whole)).unwrap();
        cut = serde_json::from_str(&serde_json::to_string(&cut).unwrap()).unwrap();
        cut.tell(&evaluate(&cut)).unwrap();
    }
    assert_eq!(whole, cut);
}

#[test]
fn particles_stay_inside_and_a_nan_is_never_the_best() {
    let mut swarm = Swarm::start(Settings::new(vec![(0.0, 1.0), (-3.0, -2.0)], 20, 3).unwrap());
    for iteration in 0..50 {
        let fitness: Vec<f64> = swarm
            .ask()
            .iter()
            .enumerate()
            .map(|(i, x)| {
                assert!((0.0..=1.0).contains(&x[0]) && (-3.0..=-2.0).contains(&x[1]));
                if (i + iteration) % 4 == 0 {
                    f64::NAN
                } else {
                    x[0] - x[1]
                }
            })
            .collect();
        swarm.tell(&fitness).unwrap();
    }
    assert_eq!(swarm.refused(), 250);
    assert!((swarm.best().unwrap().fitness - 4.0).abs() < 1e-9);
}

#[test]
fn bad_settings_and_counts_are_refused() {
    assert_eq!(Settings::new(vec![], 3, 0), Err(SettingsError::NoDimension));
    assert_eq!(
        Settings::new(vec![(0.0, 1.0)], 0, 0),
        Err(SettingsError::NoParticle)
    );
    for bounds in [
        (1.0, 1.0),
        (2.0, 1.0),
        (f64::NAN, 1.0),
        (0.0, f64::INFINITY),
    ] {
        assert!(matches!(
            Settings::new(vec![bounds], 1, 0),
            Err(SettingsError::Bounds { .. })
        ));
    }
    let settings = Settings::new(vec![(0.0, 1.0)], 2, 0).unwrap();
    assert!(settings.clone().with_start(vec![vec![1.5]]).is_err());
    assert!(settings.clone().with_attraction(2.0, 2.0).is_err());
    let mut swarm = Swarm::start(settings);
    assert_eq!(
        swarm.tell(&[1.0]),
        Err(TellError::Count {
            told: 1,
            particles: 2
        })
    );
}

#[test]
fn streams_do_not_repeat_each_other() {
    let mut first: Vec<u64> = Vec::new();
    for iteration in 0..20 {
        for particle in 0..20 {
            for purpose in [
                Purpose::Start,
                Purpose::Flight,
                Purpose::Noise(0),
                Purpose::Noise(2),
            ] {
                first.push(unit(&mut stream(5, iteration, particle, purpose)).to_bits());
            }
        }
    }
    let count = first.len();
    first.sort_unstable();
    first.dedup();
    assert_eq!(first.len(), count);
}
