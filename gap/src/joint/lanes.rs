//! The forward model of one joint, eight parameter sets at a time. Steps of second order; friction as a clipped
//! stop-effort, so it holds without chatter. Lanes never mix: a lane gives the same bits whatever its neighbours are.

mod dispatch;
mod errors;
mod laws;
mod observer;
mod resolve;
mod simd;
mod state;

pub use self::dispatch::Level;
pub use self::errors::{Errors, Weights};
pub(super) use self::simd::Eight;

use self::laws::{control, drive, mechanics, ticks, transmission};
use self::observer::Observer;
use self::resolve::{Model, resolve};
use self::simd::Lane;
use self::state::{Memory, State};
use super::command::Commands;
use super::data::{CHANNELS, RunData};
use super::param::Params;
use super::sim::{Channel, Trace};

/// Steps whose set-points are worked out ahead at once: small enough for the fastest cache.
const BLOCK: usize = 128;

/// What is done with the rows of a simulation, in their order.
trait Sink {
    /// Row `at` of the recording; `first` is the number of the parameter set in the first lane.
    fn row<F: Lane>(&mut self, first: usize, at: usize, channels: &[F; CHANNELS]);
}

/// Keeps the rows of every parameter set.
struct Traces<'a>(&'a mut [Trace]);

impl Sink for Traces<'_> {
    #[inline(always)]
    fn row<F: Lane>(&mut self, first: usize, _: usize, channels: &[F; CHANNELS]) {
        for (c, x) in channels.iter().enumerate() {
            for (trace, x) in self.0[first..].iter_mut().zip(x.put().0) {
                if c == 0 {
                    trace.push([x; CHANNELS]);
                } else if let Some(row) = trace.last_mut() {
                    row[c] = x;
                }
            }
        }
    }
}

/// Simulates a run for all parameter sets with step `dt_s` on the registers of `level`; one trace per set, one entry per row.
pub fn simulate_at(
    level: Level,
    run: &RunData,
    params: &[Params],
    dt_s: f64,
    traces: &mut [Trace],
) {
    for trace in traces.iter_mut() {
        trace.clear();
        trace.reserve(run.samples.len());
    }
    dispatch::walk(level, run, params, dt_s, &mut Traces(traces));
}

/// Simulates a run from its start to its end and hands every row to `sink`; `first` is the number of the first parameter set.
#[inline(always)]
fn walk<F: Lane>(run: &RunData, first: usize, params: &[Params], dt_s: f64, sink: &mut impl Sink) {
    let m: Model<F> = resolve(run, params, dt_s);
    let mut s = State::new(run, &m);
    let mut memory = Memory::new(run, &m);
    let start = run.edges.first().map_or(0.0, |e| e.position);
    let mut commands = Commands::new(run, params, dt_s, start);
    let (mut applied, mut followed) = ([Eight::splat(0.0); BLOCK], [Eight::splat(0.0); BLOCK]);
    let (mut row, mut edge) = (0, 0);
    let mut observer = Observer::new(run, dt_s);
    let mut enabled = true;
    let mut before = Before::of(&s);
    let mut fresh = true;
    let mut last = [F::zero(); CHANNELS];
    for block in (0..run.steps).step_by(BLOCK) {
        let count = BLOCK.min(run.steps - block);
        commands.fill(block, &mut applied[..count], &mut followed[..count]);
        for (k, (applied, sp)) in applied.iter().zip(&followed).take(count).enumerate() {
            let step = block + k;
            while let Some(e) = run.edges.get(edge).filter(|e| e.step <= step) {
                s.restart(&m, e.position, e.velocity, step > 0);
                memory.restart(e.position, e.velocity, dt_s);
                observer.restart(step);
                enabled = e.enabled;
                before = Before::of(&s);
                fresh = true;
                edge += 1;
            }
            let effort = if enabled {
                let tick = fresh || ticks(&m, step);
                fresh = false;
                let u = control(&m, &mut s, &mut memory, F::of(*sp), run, tick);
                drive(&m, &mut s, u, run.nominal.output)
            } else {
                (s.duty, s.actuator) = (F::zero(), F::zero());
                [F::zero(); 2]
            };
            mechanics(&m, &mut s, effort, enabled);
            s.stop(&run.nominal.travel);
            transmission(&m, &mut s);
            while let Some(x) = run.samples.get(row).filter(|x| x.step == step) {
                last = channels(&m, &s, F::of(*applied), &before, x.part);
                sink.row(first, row, &last);
                if let Some(g) = observer.gains(x) {
                    let error = (F::splat(x.measured[0]) - last[0]) / m.record_scale;
                    let behind = x.measured[Channel::Link as usize];
                    let behind = if behind.is_finite() {
                        F::splat(behind) - last[Channel::Link as usize]
                    } else {
                        error
                    };
                    let by = error * F::splat(g.position);
                    s.shift(by, error * F::splat(g.speed_hz));
                    s.shift_link(&m, [error, behind], &g);
                    memory.shift(by, g.steps, dt_s);
                }
                row += 1;
            }
            if run.samples.get(row).is_some_and(|x| x.step == step + 1) {
                before = Before::of(&s);
            }
        }
    }
    (row..run.samples.len()).for_each(|row| sink.row(first, row, &last));
}

/// The channels at a row `part` of a step after the start of the present one. Signals run on between steps. A row at the very
/// instant of a step holds the duty that follows; current, voltage and effort were read before the controller acted, after
/// it, or in between: the data format does not say, a parameter does.
#[inline(always)]
fn channels<F: Lane>(
    m: &Model<F>,
    s: &State<F>,
    applied: F,
    before: &Before<F>,
    part: f64,
) -> [F; CHANNELS] {
    // At the start and at the end of the step.
    let [early, late] = s.speeds;
    let effort = |[a, b]: [F; 2]| [a - b * early, a - b * late];
    let (electrical, torque) = (effort(s.electrical), effort(s.driven));
    let current = [electrical[0] / m.kt, electrical[1] / m.kt];
    let (q, link, bus) = (s.output * m.record_scale, s.link + m.mech, s.bus);
    let mix = |early: F, late: F| early + m.read_after * (late - early);
    let between = |early: F, late: F| early + F::splat(part) * (late - early);
    let [current, bus, torque] = if part < AT_STEP {
        [
            mix(before.current / m.kt, current[0]),
            mix(before.bus, bus),
            mix(before.effort, torque[0]),
        ]
    } else {
        [
            between(current[0], current[1]),
            bus,
            between(torque[0], torque[1]),
        ]
    };
    [
        between(before.output * m.record_scale, q),
        current,
        s.duty,
        bus,
        between(before.link + m.mech, link),
        torque,
        applied,
    ]
}

/// A row within this part of a step is at its instant.
const AT_STEP: f64 = 1e-3;

/// Signals at the end of the last step.
struct Before<F> {
    output: F,
    link: F,
    /// Effort that the current shows.
    current: F,
    bus: F,
    effort: F,
}

impl<F: Lane> Before<F> {
    #[inline(always)]
    fn of(s: &State<F>) -> Self {
        Self {
            output: s.output,
            link: s.link,
            current: s.electrical[0] - s.electrical[1] * s.speeds[1],
            bus: s.bus,
            effort: s.driven[0] - s.driven[1] * s.speeds[1],
        }
    }
}
