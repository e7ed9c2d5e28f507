//! The paper's measures of likeness: R, R_H (8), W_gait (7), F_meta (6).

use crate::Silhouette;

/// A film: silhouettes at a constant rate.
pub type Film = [Silhouette];

/// Why films could not be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SimilarityError {
    /// Frame sizes differ.
    #[error("frame {frame}: the two films have different frame sizes")]
    FrameSize {
        /// Index of the frame in the hardware film.
        frame: usize,
    },
    /// No frame of one film falls on the other, or none shows the robot.
    #[error(
        "no frame of one film falls inside the other, or none shows the robot, at a shift of {shift_frames} frames"
    )]
    NoCommonFrame {
        /// The shift asked for.
        shift_frames: i64,
    },
    /// Fewer than two trials.
    #[error("repeatability needs at least two trials, {trials} given")]
    Trials {
        /// Trials given.
        trials: usize,
    },
    /// Weights sum to zero.
    #[error("the weights of the gaits sum to zero")]
    Weights,
}

/// Frames of different sizes do not compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SizesDiffer;

/// Overlap over union of two frames; `None` when both are empty, for then there is nothing to compare.
///
/// # Errors
/// When the sizes differ.
pub fn ratio(a: &Silhouette, b: &Silhouette) -> Result<Option<f64>, SizesDiffer> {
    let (overlap, union) = a.overlap_and_union_px(b).ok_or(SizesDiffer)?;
    Ok((union > 0).then(|| f64::from(overlap) / f64::from(union)))
}

/// Mean of R[H(t), S(t + s)] over the frames both films have and at least one shows the robot, with s in frames.
///
/// # Errors
/// See [`SimilarityError`].
pub fn mean_ratio(
    hardware: &Film,
    simulated: &Film,
    shift_frames: i64,
) -> Result<f64, SimilarityError> {
    let (mut sum, mut frames) = (0.0, 0u32);
    for (frame, h) in hardware.iter().enumerate() {
        let at = i64::try_from(frame)
            .ok()
            .and_then(|t| t.checked_add(shift_frames));
        let Some(s) = at
            .and_then(|at| usize::try_from(at).ok())
            .and_then(|at| simulated.get(at))
        else {
            continue;
        };
        if let Some(r) = ratio(h, s).map_err(|_| SimilarityError::FrameSize { frame })? {
            sum += r;
            frames += 1;
        }
    }
    if frames == 0 {
        return Err(SimilarityError::NoCommonFrame { shift_frames });
    }
    Ok(sum / f64::from(frames))
}

/// R_H, equation (8): mean of R over all pairs of trials of one gait on the robot.
///
/// # Errors
/// See [`SimilarityError`].
pub fn repeatability(trials: &[&Film]) -> Result<f64, SimilarityError> {
    let (mut sum, mut pairs) = (0.0, 0u32);
    for (k, a) in trials.iter().enumerate() {
        for b in &trials[k + 1..] {
            sum += mean_ratio(a, b, 0)?;
            pairs += 1;
        }
    }
    if pairs == 0 {
        return Err(SimilarityError::Trials {
            trials: trials.len(),
        });
    }
    Ok(sum / f64::from(pairs))
}

/// W_gait, equation (7): mean speed on the robot times R_H.
#[must_use]
pub fn gait_weight(mean_speed_m_s: f64, repeatability: f64) -> f64 {
    mean_speed_m_s * repeatability
}

/// F_meta, equation (6): weighted mean of the gaits' mean R, given as (weight, mean R).
///
/// # Errors
/// When the weights sum to zero.
pub fn meta_fitness(gaits: &[(f64, f64)]) -> Result<f64, SimilarityError> {
    let weights: f64 = gaits.iter().map(|gait| gait.0).sum();
    if weights <= 0.0 || !weights.is_finite() {
        return Err(SimilarityError::Weights);
    }
    Ok(gaits.iter().map(|(weight, r)| weight * r).sum::<f64>() / weights)
}
