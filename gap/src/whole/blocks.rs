//! The robot's chain as blocks of prediction errors: each cut at what was measured, each effect a column.

pub(super) mod body;
pub(super) mod camera;
pub(super) mod electrical;
pub(super) mod position;
pub(super) mod torque;
pub(super) mod transmission;

/// Degrees of freedom of errors of which a few are gross (Student's t): a body that rests on an edge falls to either side, a
/// foot is hidden in a frame.
const FREEDOM: f64 = 6.0;

/// Value of a grid of `step_s` at `t_s`, linear between its points.
fn on(grid: &[f64], step_s: f64, t_s: f64) -> f64 {
    let place = t_s / step_s;
    let i = place as usize;
    let a = grid.get(i).copied().unwrap_or(0.0);
    let b = grid.get(i + 1).copied().unwrap_or(a);
    a + (b - a) * (place - i as f64)
}

/// What a test finds: effects with their sizes, and the coefficients by block, column and value.
#[cfg(test)]
mod found {
    use crate::evidence::block::Block;
    use crate::evidence::cause::causes;
    use crate::evidence::search::Problem;
    use crate::vocabulary::Effect;

    pub(super) type Named = Vec<(Option<Effect>, f64)>;

    /// Causes of which each adds 6 nats, each by its first number.
    pub(super) fn named(blocks: &[Block]) -> (Named, Vec<(usize, usize, f64)>) {
        let all = causes(blocks, &[], &[]);
        let problem = Problem {
            blocks,
            causes: &all,
            always: &[],
        };
        let found = problem.search(&vec![6.0; all.len()], 3);
        let posterior = problem.posterior(&found.best.members);
        let members = found.best.members.iter().zip(&posterior.first);
        let named = members
            .map(|(m, first)| {
                let number = &all[*m].numbers[0];
                let by = number.mean + number.of_latents[0].1 * posterior.mean[*first];
                (all[*m].effect, number.neutral + number.scale * by)
            })
            .collect();
        (named, problem.coefficients(&found.best.members))
    }
}
