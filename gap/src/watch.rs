//! Who watches a search, and the wish that it ends.

use core::fmt;

/// Who watches a search.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Told in a few words what comes next.
    pub next: &'a (dyn Fn(&str) + Sync),
    /// Whether the search is to end with what it has; asked before every simulation of a run. Once it has said so, it
    /// must not take it back.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Watch<'a> {
    /// Nobody.
    pub const NOBODY: Watch<'static> = Watch {
        next: &|_| {},
        stop: &|| false,
    };

    /// Tells what comes next, unless the search is to end.
    #[must_use]
    pub fn goes_on(&self, next: &str) -> bool {
        let on = !(self.stop)();
        if on {
            (self.next)(next);
        }
        on
    }

    /// The wish that it ends.
    #[must_use]
    pub fn wish(&self) -> Stop<'a> {
        Stop(Some(self.stop))
    }
}

/// Whether somebody wants the work to end. It is asked before every simulation of a run; what comes out after it was
/// asked for means nothing.
#[derive(Clone, Copy)]
pub struct Stop<'a>(Option<&'a (dyn Fn() -> bool + Sync)>);

impl Stop<'_> {
    /// Nobody does.
    pub const NEVER: Self = Self(None);

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
