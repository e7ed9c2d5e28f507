//! Particle swarm with constriction, ask/tell, counter-based random streams; checkpoints.
//!
//! The update is the paper's equations (4) and (5). The caller owns the objective: [`Swarm::ask`] gives the positions of
//! one iteration, [`Swarm::tell`] takes their fitness (larger is better). Nothing here runs the objective, so the same
//! swarm serves one thread, many threads and many processes, and gives the same bits in each. Every random number is
//! drawn from a stream named by (iteration, particle, purpose), never from a shared generator.
//!
//! ```
//! use swarm::{Settings, Swarm};
//! let settings = Settings::new(vec![(-5.0, 5.0); 3], 30, 7).unwrap();
//! let mut swarm = Swarm::start(settings);
//! for _ in 0..100 {
//!     let fitness: Vec<f64> = swarm.ask().iter().map(|x| -x.iter().map(|v| v * v).sum::<f64>()).collect();
//!     swarm.tell(&fitness).unwrap();
//! }
//! assert!(swarm.best().unwrap().fitness > -1e-6);
//! ```

mod settings;
mod stream;

pub use settings::{Settings, SettingsError, constriction};
pub use stream::{Purpose, stream};

use rand_chacha::rand_core::Rng;
use serde::{Deserialize, Serialize};

/// The state of a search; serialise it after any [`Swarm::tell`] and it resumes with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swarm {
    settings: Settings,
    iteration: u32,
    particles: Vec<Particle>,
    best: Option<Best>,
    history: Vec<Best>,
    refused: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Particle {
    position: Vec<f64>,
    velocity: Vec<f64>,
    best: Option<Known>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Known {
    position: Vec<f64>,
    fitness: f64,
}

/// The best position known after an iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Iteration in which it was found, from 0.
    pub iteration: u32,
    /// Particle that found it, from 0.
    pub particle: u32,
    /// One value per dimension, inside the bounds.
    pub position: Vec<f64>,
    /// As told; larger is better.
    pub fitness: f64,
}

/// Why a [`Swarm::tell`] was refused; the swarm is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TellError {
    /// Not one fitness per particle.
    #[error("{told} fitness values told, {particles} particles asked")]
    Count {
        /// Values given.
        told: usize,
        /// Values needed.
        particles: usize,
    },
}

impl Swarm {
    /// The swarm before its first evaluation: given start positions first, the rest uniform inside the bounds.
    #[must_use]
    pub fn start(settings: Settings) -> Self {
        let particles = (0..settings.particles())
            .map(|index| Particle::start(&settings, index))
            .collect();
        Self {
            settings,
            iteration: 0,
            particles,
            best: None,
            history: Vec::new(),
            refused: 0,
        }
    }

    /// Positions to evaluate now, one per particle.
    #[must_use]
    pub fn ask(&self) -> Vec<&[f64]> {
        self.particles
            .iter()
            .map(|particle| particle.position.as_slice())
            .collect()
    }

    /// Take the fitness of the asked positions and move every particle by equations (4) and (5).
    ///
    /// A fitness that is not finite counts as the worst and is counted in [`Swarm::refused`].
    ///
    /// # Errors
    /// When the number of values is not the number of particles.
    pub fn tell(&mut self, fitness: &[f64]) -> Result<(), TellError> {
        if fitness.len() != self.particles.len() {
            return Err(TellError::Count {
                told: fitness.len(),
                particles: self.particles.len(),
            });
        }
        self.remember(fitness);
        if let Some(best) = &self.best {
            for (index, particle) in self.particles.iter_mut().enumerate() {
                particle.fly(&self.settings, self.iteration, index, &best.position);
            }
            self.history.push(best.clone());
        }
        self.iteration += 1;
        Ok(())
    }

    /// Update personal bests and the global best; the lower particle index wins a tie.
    fn remember(&mut self, fitness: &[f64]) {
        for (index, (particle, &fitness)) in self.particles.iter_mut().zip(fitness).enumerate() {
            if !fitness.is_finite() {
                self.refused += 1;
                continue;
            }
            if particle
                .best
                .as_ref()
                .is_none_or(|best| fitness > best.fitness)
            {
                particle.best = Some(Known {
                    position: particle.position.clone(),
                    fitness,
                });
            }
            if self.best.as_ref().is_none_or(|best| fitness > best.fitness) {
                self.best = Some(Best {
                    iteration: self.iteration,
                    particle: u32::try_from(index).unwrap_or(u32::MAX),
                    position: particle.position.clone(),
                    fitness,
                });
            }
        }
    }

    /// Iterations told so far.
    #[must_use]
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// The best position so far; `None` before the first finite fitness.
    #[must_use]
    pub fn best(&self) -> Option<&Best> {
        self.best.as_ref()
    }

    /// The global best after each iteration: the curve of the paper's figures 3 and 6.
    #[must_use]
    pub fn history(&self) -> &[Best] {
        &self.history
    }

    /// Personal bests `(position, fitness)` of all particles that have one, in particle order.
    pub fn personal_bests(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let known = self
            .particles
            .iter()
            .filter_map(|particle| particle.best.as_ref());
        known.map(|best| (best.position.as_slice(), best.fitness))
    }

    /// Fitness of a particle's own best; `None` before its first finite fitness or for a particle that is not there.
    #[must_use]
    pub fn personal_best(&self, particle: usize) -> Option<f64> {
        let best = self.particles.get(particle)?.best.as_ref()?;
        Some(best.fitness)
    }

    /// Fitness values that were not finite.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The settings the search was started with; a resumed search must be given equal ones.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }
}

impl Particle {
    fn start(settings: &Settings, index: usize) -> Self {
        let mut random = stream(settings.seed(), 0, index, Purpose::Start);
        let uniform: Vec<f64> = settings
            .bounds()
            .iter()
            .map(|&(low, high)| low + (high - low) * unit(&mut random))
            .collect();
        // Half the difference of two points: the usual start velocity, no larger than half the range.
        let velocity = settings
            .bounds()
            .iter()
            .zip(&uniform)
            .map(|(&(low, high), x)| 0.5 * (low + (high - low) * unit(&mut random) - x))
            .collect();
        Self {
            position: settings
                .start_position(index)
                .map_or(uniform, <[f64]>::to_vec),
            velocity,
            best: None,
        }
    }

    /// Equations (4) and (5), then the bounds: a particle that leaves stops at the face it left by.
    fn fly(&mut self, settings: &Settings, iteration: u32, index: usize, global: &[f64]) {
        let mut random = stream(settings.seed(), iteration, index, Purpose::Flight);
        let k = settings.constriction();
        let (c1, c2) = settings.attraction();
        let personal = self
            .best
            .as_ref()
            .map_or(&self.position, |best| &best.position)
            .clone();
        for (d, &(low, high)) in settings.bounds().iter().enumerate() {
            let (r1, r2) = (unit(&mut random), unit(&mut random));
            let x = self.position[d];
            let pull = c1 * r1 * (personal[d] - x) + c2 * r2 * (global[d] - x);
            let limit = settings.velocity_limit() * (high - low);
            let velocity = (k * (self.velocity[d] + pull)).clamp(-limit, limit);
            let next = x + velocity;
            self.position[d] = next.clamp(low, high);
            self.velocity[d] = if next == self.position[d] {
                velocity
            } else {
                0.0
            };
        }
    }
}

/// Uniform in [0, 1) with 53 bits.
pub fn unit(random: &mut impl Rng) -> f64 {
    const SCALE: f64 = 1.0 / (1u64 << 53) as f64;
    (random.next_u64() >> 11) as f64 * SCALE
}
