//! Which registers run a simulation.
#![allow(unsafe_code)]

use wide::f64x8;

use super::Sink;
use super::simd::LANES;
#[cfg(target_arch = "x86_64")]
use super::simd::x86::{Avx2, Avx512};
use crate::joint::data::RunData;
use crate::joint::param::Params;

/// An instruction set. All give the same bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// What every processor of the architecture has.
    Baseline,
    /// Two registers of four lanes.
    Avx2,
    /// One register of eight lanes.
    Avx512,
}

impl Level {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// The fastest level of this processor.
    #[must_use]
    pub fn detect() -> Self {
        let fastest = Self::ALL.into_iter().rev().find(|l| l.available());
        fastest.unwrap_or(Self::Baseline)
    }

    /// Whether this processor can run it.
    #[must_use]
    pub fn available(self) -> bool {
        match self {
            Self::Baseline => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => std::arch::is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => std::arch::is_x86_feature_detected!("avx512f"),
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }
}

/// [`super::walk`] for all parameter sets on the registers of `level`, or the baseline's where the processor lacks it.
pub(super) fn walk<S: Sink>(
    level: Level,
    run: &RunData,
    params: &[Params],
    dt_s: f64,
    sink: &mut S,
) {
    for (k, p) in params.chunks(LANES).enumerate() {
        let first = k * LANES;
        match level {
            // SAFETY: the processor was asked.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 if level.available() => unsafe { walk_avx2(run, first, p, dt_s, sink) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 if level.available() => unsafe {
                walk_avx512(run, first, p, dt_s, sink);
            },
            _ => super::walk::<f64x8>(run, first, p, dt_s, sink),
        }
    }
}

/// # Safety
/// The processor must have AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn walk_avx2<S: Sink>(
    run: &RunData,
    first: usize,
    params: &[Params],
    dt_s: f64,
    sink: &mut S,
) {
    super::walk::<Avx2>(run, first, params, dt_s, sink);
}

/// # Safety
/// The processor must have AVX-512F.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn walk_avx512<S: Sink>(
    run: &RunData,
    first: usize,
    params: &[Params],
    dt_s: f64,
    sink: &mut S,
) {
    super::walk::<Avx512>(run, first, params, dt_s, sink);
}

#[cfg(test)]
mod tests {
    use files::dataset::{Manifest, Recording};

    use super::*;
    use crate::joint::lanes::simulate_at;
    use crate::joint::{P, Problem};

    const BENCH: &str = "format = 1\nrobot = \"bench\"\nname = \"made\"\n[bench]\ninertia_kg_m2 = { value = 0.08, tolerance = 0.05 }\n\
        gravity_nm = { value = 2.0, tolerance = 0.03 }\nsupply_v = { value = 12.0, tolerance = 0.02 }\n\
        max_speed_rad_s = { value = 2.8, tolerance = 0.03 }\nmax_effort_nm = { value = 27.0, tolerance = 0.03 }\n\
        [bench.controller]\nkind = \"cascade\"\nkp = 10.0\nkv = 0.8\noutput = \"duty\"\nlimit = 1.0\nperiod_s = 0.001\n\
        [[run]]\nfile = \"a.csv\"\ngait = \"a\"\n";

    fn problem() -> Problem {
        let (manifest, _) = Manifest::parse("dataset.toml", BENCH).expect("valid");
        let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
        for k in 0..200 {
            let sp = 0.7 * crate::math::sin(f64::from(k / 5) * 0.2);
            csv += &format!("{:.3},{sp:.6},0\n", f64::from(k) * 0.01);
        }
        let (recording, _) = Recording::parse("a.csv", &csv, &manifest).expect("valid");
        Problem::new(&manifest, &[recording], 0).expect("position is there")
    }

    #[test]
    fn all_registers_give_the_same_bits() {
        let problem = problem();
        let with = |list: &[(P, f64)]| {
            let mut p = Params::default();
            list.iter().for_each(|(q, x)| p.set(*q, *x));
            p
        };
        let sets = [
            with(&[]),
            with(&[(P::Coulomb, 1.0), (P::Give, 1e-3), (P::Static, 0.4)]),
            with(&[
                (P::LoadShare, 0.3),
                (P::RippleSin, 0.2),
                (P::Asymmetry, 0.1),
            ]),
            with(&[
                (P::FeedbackDelay, 0.0043),
                (P::SpeedDelay, 1.7),
                (P::Lag, 0.01),
            ]),
            with(&[(P::Sag, 0.4), (P::TorqueLimit, 2.0), (P::DerateShare, 0.3)]),
            with(&[(P::Play, 0.02), (P::Flexibility, 0.01), (P::SlewLimit, 0.5)]),
        ];
        for p in &sets {
            let trace = |level: Level| {
                let mut out = Vec::new();
                let (one, traces) = (std::slice::from_ref(p), std::slice::from_mut(&mut out));
                simulate_at(level, &problem.runs[0], one, problem.dt_s, traces);
                out.concat()
                    .into_iter()
                    .map(f64::to_bits)
                    .collect::<Vec<u64>>()
            };
            let baseline = trace(Level::Baseline);
            assert_eq!(baseline.len(), 200 * crate::joint::data::CHANNELS);
            for level in Level::ALL.into_iter().filter(|l| l.available()) {
                assert!(trace(level) == baseline, "{level:?} {p:?}");
            }
        }
    }
}
