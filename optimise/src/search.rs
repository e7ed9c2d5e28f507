//! The offline optimisation: swarm, trials, archive; resumable after every iteration.

use crate::score::{Score, ScoreSettings, TrialOutcome};
use crate::space::GaitSpace;
use control::gait::Gait;
use serde::{Deserialize, Serialize};
use swarm::{Settings, SettingsError, Swarm};

/// The paper's search: 300 particles, 200 iterations.
pub const PAPER_PARTICLES: usize = 300;
/// See [`PAPER_PARTICLES`].
pub const PAPER_ITERATIONS: u32 = 200;

/// One trial to simulate.
#[derive(Clone, Copy, Debug)]
pub struct GaitJob<'a> {
    /// The gait to play.
    pub gait: &'a Gait,
    /// Names the stream of its noise.
    pub iteration: u32,
    /// Names the stream of its noise.
    pub particle: usize,
    /// Names the stream of its noise.
    pub repetition: u16,
}

/// Something that simulates trials: one thread, many threads or many machines. The outcome of a job depends on that job alone.
pub trait GaitTrials {
    /// Outcomes in the order of the jobs.
    fn run(&self, jobs: &[GaitJob<'_>]) -> Vec<TrialOutcome>;

    /// Whether somebody wants the search to end. Outcomes mean nothing then, and some may be missing.
    fn stopped(&self) -> bool {
        false
    }
}

/// A gait worth remembering: it was its particle's best when found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The 17 numbers.
    pub position: Vec<f64>,
    /// Its verdict.
    pub score: Score,
    /// Where it went, per repetition: end points relative to the start, m.
    pub ends_m: Vec<[f32; 2]>,
    /// Iteration in which it was found.
    pub iteration: u32,
}

/// The state of a search. Serialise it after an iteration, and it goes on with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    space: GaitSpace,
    scoring: ScoreSettings,
    impact_limit_m_s: f32,
    swarm: Swarm,
    archive: Vec<Found>,
    collisions: u64,
    failures: u64,
    impacts: u64,
    trials: u64,
}

impl Search {
    /// A search over `space` with `particles` and `seed`; harder ground contacts than `impact_limit_m_s` refuse a gait.
    ///
    /// # Errors
    /// When the space is empty or there is no particle.
    pub fn start(
        space: GaitSpace,
        scoring: ScoreSettings,
        impact_limit_m_s: f32,
        particles: usize,
        seed: u64,
    ) -> Result<Self, SettingsError> {
        let settings = Settings::new(space.bounds(), particles, seed)?;
        Ok(Self {
            space,
            scoring,
            impact_limit_m_s,
            swarm: Swarm::start(settings),
            archive: Vec::new(),
            collisions: 0,
            failures: 0,
            impacts: 0,
            trials: 0,
        })
    }

    /// One iteration: every particle, every repetition, then the swarm moves. Gives whether it came to its end; the search stays
    /// as it was when the trials were stopped.
    pub fn iterate(&mut self, trials: &impl GaitTrials) -> bool {
        let positions: Vec<Vec<f64>> = self.swarm.ask().iter().map(|x| x.to_vec()).collect();
        let gaits: Vec<Option<Gait>> = positions
            .iter()
            .map(|x| self.space.gait(x, "searched").ok())
            .collect();
        let iteration = self.swarm.iteration();
        let repetitions = self.scoring.repetitions.max(1);
        let jobs: Vec<GaitJob<'_>> = gaits
            .iter()
            .enumerate()
            .filter_map(|(particle, gait)| gait.as_ref().map(|gait| (particle, gait)))
            .flat_map(|(particle, gait)| {
                (0..repetitions).map(move |repetition| GaitJob {
                    gait,
                    iteration,
                    particle,
                    repetition,
                })
            })
            .collect();
        let outcomes = trials.run(&jobs);
        if trials.stopped() {
            return false;
        }
        let mut fitness = vec![0.0; positions.len()];
        for (jobs, outcomes) in jobs
            .chunks(usize::from(repetitions))
            .zip(outcomes.chunks(usize::from(repetitions)))
        {
            let Some(particle) = jobs.first().map(|job| job.particle) else {
                continue;
            };
            let score = self.scoring.score(outcomes, self.impact_limit_m_s);
            self.count(&score, outcomes.len());
            fitness[particle] = score.fitness;
            self.remember(&positions[particle], particle, score, outcomes);
        }
        // The count is right by construction; a refusal would leave the swarm as it was.
        let _ = self.swarm.tell(&fitness);
        true
    }

    fn count(&mut self, score: &Score, trials: usize) {
        self.trials += trials as u64;
        self.collisions += u64::from(score.collided);
        self.failures += u64::from(score.failed);
        self.impacts += u64::from(score.impact_m_s > self.impact_limit_m_s);
    }

    fn remember(
        &mut self,
        position: &[f64],
        particle: usize,
        score: Score,
        outcomes: &[TrialOutcome],
    ) {
        let known = self.swarm.personal_best(particle);
        if score.fitness > known.unwrap_or(0.0) {
            let end = |trial: &TrialOutcome| match (trial.path_m.first(), trial.path_m.last()) {
                (Some(a), Some(b)) => [b[0] - a[0], b[1] - a[1]],
                _ => [0.0; 2],
            };
            self.archive.push(Found {
                position: position.to_vec(),
                score,
                ends_m: outcomes.iter().map(end).collect(),
                iteration: self.swarm.iteration(),
            });
        }
    }

    /// The swarm: iteration, best, curve.
    #[must_use]
    pub fn swarm(&self) -> &Swarm {
        &self.swarm
    }

    /// Every gait that improved on its particle's best, in the order found.
    #[must_use]
    pub fn archive(&self) -> &[Found] {
        &self.archive
    }

    /// The space searched.
    #[must_use]
    pub fn space(&self) -> &GaitSpace {
        &self.space
    }

    /// How gaits are scored.
    #[must_use]
    pub fn scoring(&self) -> &ScoreSettings {
        &self.scoring
    }

    /// Trials simulated, and gaits refused for collision, for impact and for a lost number.
    #[must_use]
    pub fn counts(&self) -> Counts {
        Counts {
            trials: self.trials,
            collisions: self.collisions,
            impacts: self.impacts,
            failures: self.failures,
        }
    }
}

/// What a search did so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Trials simulated.
    pub trials: u64,
    /// Gaits that collided with themselves.
    pub collisions: u64,
    /// Gaits that hit the ground too hard.
    pub impacts: u64,
    /// Gaits in which a number was lost.
    pub failures: u64,
}
