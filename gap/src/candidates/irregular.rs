//! Effects that only the driver's echo can show.

use crate::joint::Problem;
use crate::vocabulary::Effect;

/// Whether set-points arrive irregularly, by the driver's echo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Irregular {
    jitter: bool,
    loss: bool,
}

/// Looks at the echoes of all runs.
#[must_use]
pub fn irregular(problem: &Problem) -> Irregular {
    let found = crate::joint::arrival::regularity(&problem.runs);
    // One delay falls into one row or, at its edge, two; three rows are no accident, nor are lost ones in a hundred.
    let jitter = found.is_some_and(|r| r.range_s > 1.5 * r.doubt_s);
    Irregular {
        jitter,
        loss: !jitter && found.is_some_and(|r| r.lost > 0.01),
    }
}

impl Irregular {
    /// Whether an effect may be tried.
    #[must_use]
    pub fn admits(self, e: Effect) -> bool {
        match e {
            Effect::Jitter => self.jitter,
            Effect::PacketLoss => self.loss,
            _ => true,
        }
    }
}
