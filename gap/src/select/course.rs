//! The course of the search from the calibrated model to the end, and how it is left early.

use super::{Considered, Node, Rival, Search, Selection, Step, exact};
use crate::fit::{Model, Stop};
use crate::vocabulary::Effect;

/// Who watches a search.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Told in a few words what comes next.
    pub next: &'a (dyn Fn(&str) + Sync),
    /// Whether the search is to end with what it has; asked before every simulation of a run.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Watch<'_> {
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
}

/// How far a search has come.
struct Course {
    node: Node,
    /// See [`Selection::first`].
    first: f64,
    steps: Vec<Step>,
    log: Vec<Considered>,
    rivals: Vec<Vec<Rival>>,
}

/// One effect more.
struct Advance {
    node: Node,
    first: f64,
    step: Step,
}

impl Search<'_> {
    /// The same search, which ends when `stop` is asked for; what it gives after that means nothing.
    #[must_use]
    pub fn until<'b>(&'b self, stop: Stop<'b>) -> Search<'b> {
        let mut out: Search<'b> = self.clone();
        out.objective.stop = stop;
        if let Some(check) = &mut out.check {
            check.stop = stop;
        }
        out
    }

    /// Runs the search from the calibrated nominal model. When `watch` ends it, what was going on is dropped.
    #[must_use]
    pub fn run(&self, calibrated: Model, watch: Watch<'_>) -> Selection {
        let held = self.held_out(&self.tuned(&calibrated), &calibrated);
        let node = Node {
            model: calibrated,
            found: Vec::new(),
            held,
        };
        let mut course = Course {
            first: node.held_out(),
            steps: vec![step(None, &node)],
            log: Vec::new(),
            rivals: Vec::new(),
            node,
        };
        let search = self.until(Stop::when(watch.stop));
        let whole = search.grow(&mut course, watch) && search.compare(&mut course, watch);
        let (node, mut rivals) = (course.node, course.rivals);
        rivals.resize_with(node.found.len(), Vec::new);
        Selection {
            first: course.first,
            held_out: node.held_out(),
            fitted: self.objective.data_cost(&node.model.params),
            model: node.model,
            found: node.found,
            steps: course.steps,
            considered: course.log,
            rivals,
            partial: !whole,
        }
    }

    /// Adds effects as long as they are believed; whether it came to its end.
    fn grow(&self, course: &mut Course, watch: Watch<'_>) -> bool {
        let mut branches: Vec<Node> = Vec::new();
        while course.node.found.len() < self.options.most
            && (self.room(course.node.held_out(), course.first) || self.is_strained(&course.node))
        {
            if !watch.goes_on(&format!("searching effect {}", course.node.found.len() + 1)) {
                return false;
            }
            let before = course.log.len();
            let next = self.advance(course, &mut branches);
            if (watch.stop)() {
                course.log.truncate(before);
                return false;
            }
            let Some(next) = next else { break };
            course.node = next.node;
            course.first = next.first;
            course.steps.push(next.step);
        }
        true
    }

    /// The next effect that is believed, with what it makes needless taken out.
    fn advance(&self, course: &mut Course, branches: &mut Vec<Node>) -> Option<Advance> {
        let Course {
            node, first, log, ..
        } = course;
        let mut first = *first;
        let o = self.tuned(&node.model);
        let mut tries = self.expand(&o, &node.model, &node.found);
        let mut best = self.believed(&o, node, &mut tries, first, log);
        let open = self.open(node, first);
        for other in branches.drain(..).filter(|_| open) {
            let mut tries = self.expand(&o, &other.model, &other.found);
            let pick = self.believed(&o, &other, &mut tries, first, log);
            let limit = best.as_ref().map_or(f64::INFINITY, |b| 0.97 * b.0);
            let better = |p: &(f64, Node)| p.0 < limit && self.gains(&o, node, &p.1, first);
            best = pick.filter(better).or(best);
        }
        best = self.grown(node, best.as_ref(), first, log).or(best);
        if best.is_none() && node.found.is_empty() && self.options.thorough {
            best = self.hidden(&o, node, &tries, first, log);
        }
        let (_, mut next) = best?;
        if node.found.is_empty() && next.found.len() == 1 {
            let chosen = next.found.last().map(|f| f.candidate.effect);
            *branches = self.branches(node, &tries, chosen);
        }
        self.settle(&mut next);
        if next.found.iter().all(|f| exact(f.candidate.effect)) {
            first = next.held_out();
        }
        let step = step(next.found.last().map(|f| f.candidate.effect), &next);
        self.prune(&mut next, first);
        Some(Advance {
            node: next,
            first,
            step,
        })
    }

    /// Puts what was found to the test against rivals; whether it came to its end.
    fn compare(&self, course: &mut Course, watch: Watch<'_>) -> bool {
        if !watch.goes_on("trying rivals") {
            return false;
        }
        let mut node = course.node.clone();
        let mut rivals = self.exchange(&mut node);
        self.clear(&mut node, course.first);
        if node.found.len() < course.node.found.len() {
            rivals = self.exchange(&mut node);
        }
        if (watch.stop)() {
            return false;
        }
        (course.node, course.rivals) = (node, rivals);
        true
    }
}

fn step(added: Option<Effect>, node: &Node) -> Step {
    Step {
        added,
        model: node.model.clone(),
        held_out: node.held_out(),
    }
}
