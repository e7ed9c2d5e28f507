//! The wish of a caller that the work ends.

use core::fmt;

/// Whether somebody wants the work to end. It is asked before every simulation of a run; what comes out after it was
/// asked for means nothing.
#[derive(Clone, Copy)]
pub struct Stop<'a>(Option<&'a (dyn Fn() -> bool + Sync)>);

impl<'a> Stop<'a> {
    /// Nobody does.
    pub const NEVER: Self = Self(None);

    /// When `asked` says so. Once it has said so, it must not take it back.
    #[must_use]
    pub fn when(asked: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self(Some(asked))
    }

    /// Whether the work is to end.
    #[must_use]
    pub fn asked(self) -> bool {
        self.0.is_some_and(|asked| asked())
    }
}

impl fmt::Debug for Stop<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() {
            "Stop(when asked)"
        } else {
            "Stop(never)"
        })
    }
}
