//! The objective: equation (6) over the training gaits.

use super::MetaError;
use super::film::{Canvas, FilmMaker, FilmedGait, Motion, MotionJob, MotionTrials};
use crate::table2::ROWS;
use camera::similarity::{SimilarityError, meta_fitness, ratio};
use rayon::prelude::*;

/// The comparison of simulated with filmed gaits.
pub struct Likeness<'a> {
    gaits: &'a [FilmedGait],
    maker: FilmMaker,
}

impl<'a> Likeness<'a> {
    /// Compare with `gaits` through `maker`.
    ///
    /// # Errors
    /// When no gait belongs to the training set.
    pub fn new(gaits: &'a [FilmedGait], maker: FilmMaker) -> Result<Self, MetaError> {
        if !gaits.iter().any(|gait| gait.training) {
            return Err(MetaError::NoTraining);
        }
        Ok(Self { gaits, maker })
    }

    /// F_meta over the training gaits for every candidate; a candidate on which the simulator loses a number gets 0.
    pub(super) fn fitness(
        &self,
        candidates: &[[f64; ROWS]],
        trials: &impl MotionTrials,
    ) -> Result<Vec<f64>, MetaError> {
        let training: Vec<&FilmedGait> = self.gaits.iter().filter(|gait| gait.training).collect();
        let stride = self.maker.settings().stride;
        let pairs: Vec<(&[f64; ROWS], &FilmedGait)> = candidates
            .iter()
            .flat_map(|parameters| training.iter().map(move |filmed| (parameters, *filmed)))
            .collect();
        let ratios = self.compare(&pairs, stride, trials);
        let ratios = ratios
            .into_iter()
            .map(|r| r.map(|r| r.unwrap_or(0.0)))
            .collect::<Result<Vec<f64>, _>>()?;
        ratios
            .chunks(training.len().max(1))
            .map(|ratios| {
                let weighted: Vec<(f64, f64)> = training
                    .iter()
                    .map(|filmed| filmed.weight)
                    .zip(ratios.iter().copied())
                    .collect();
                Ok(meta_fitness(&weighted)?)
            })
            .collect()
    }

    /// R of every gait with these parameters at full frame rate, in the order given: the body of Table III.
    ///
    /// # Errors
    /// When films do not compare or the simulator loses a number.
    pub fn ratios(
        &self,
        parameters: &[f64; ROWS],
        trials: &impl MotionTrials,
    ) -> Result<Vec<f64>, MetaError> {
        let pairs: Vec<_> = self.gaits.iter().map(|gait| (parameters, gait)).collect();
        let ratios = self.compare(&pairs, 1, trials).into_iter().enumerate();
        ratios
            .map(|(gait, r)| r?.ok_or(MetaError::Simulation { gait }))
            .collect()
    }

    /// Simulates and compares; `None` where a number was lost.
    fn compare(
        &self,
        pairs: &[(&[f64; ROWS], &FilmedGait)],
        stride: usize,
        trials: &impl MotionTrials,
    ) -> Vec<Result<Option<f64>, MetaError>> {
        let jobs: Vec<MotionJob<'_>> = pairs
            .iter()
            .map(|(parameters, filmed)| MotionJob {
                gait: &filmed.gait,
                parameters,
                times: self.maker.times(parameters, filmed.frames(), stride),
            })
            .collect();
        let motions = trials.run(&jobs);
        pairs
            .par_iter()
            .zip(motions)
            .map_init(Canvas::default, |canvas, ((parameters, filmed), motion)| {
                motion
                    .filter(|_| !trials.stopped())
                    .map(|motion| self.ratio(filmed, &motion, parameters, stride, canvas))
                    .transpose()
            })
            .collect()
    }

    /// Mean over trials and frames of R between the robot's film and the simulation seen through the candidate's camera.
    ///
    /// A frame with one robot counts 0. A frame without any has nothing to compare and is left out; a trial of which nothing is left
    /// counts 0, for nothing speaks for a likeness.
    fn ratio(
        &self,
        filmed: &FilmedGait,
        motion: &Motion,
        parameters: &[f64; ROWS],
        stride: usize,
        canvas: &mut Canvas,
    ) -> Result<f64, MetaError> {
        let stride = stride.max(1);
        let mut sums = vec![(0.0, 0u32); filmed.films.len()];
        let mut odd_size = None;
        let look = |k: usize, simulated: &camera::Silhouette| {
            let frame = k * stride;
            for (hardware, (sum, n)) in filmed.films.iter().zip(&mut sums) {
                match hardware.get(frame).map(|h| ratio(h, simulated)) {
                    Some(Ok(Some(r))) => (*sum, *n) = (*sum + r, *n + 1),
                    Some(Err(_)) => odd_size = Some(frame),
                    Some(Ok(None)) | None => {}
                }
            }
        };
        let start = filmed.start.as_ref();
        self.maker
            .show_motion(motion, parameters, start, canvas, look)?;
        if let Some(frame) = odd_size {
            return Err(SimilarityError::FrameSize { frame }.into());
        }
        let means = sums.iter().map(|(sum, n)| sum / f64::from((*n).max(1)));
        Ok(means.sum::<f64>() / filmed.films.len().max(1) as f64)
    }
}
