//! The whole robot: six joints, body, camera, from recordings to verdict.
//!
//! Three tiers, each cut out of the loop by measured signals: every joint alone against loads replayed from the measured motion
//! ([`joints`]), the body in short windows led along the measured angles ([`body`]), the camera against the measured pose. Where no
//! tracker recorded a pose, it is read off the film first ([`film`]).

mod answer;
mod belief;
mod body;
mod body_answer;
mod body_library;
mod camera;
mod conventions;
pub mod data;
mod direct;
mod echo;
pub mod experiment;
mod film;
mod found;
mod gaits;
pub mod inertial;
mod joint_library;
mod joints;
mod least;
mod loads;
mod open;
mod page;
mod patch;
mod places;
mod predict;
mod regime;
mod replay;
mod rivals;
mod rough;
mod score;
mod search;
mod servo;
mod steady;
mod terms;
mod traffic;
mod turn;
mod unseen;
mod windows;

use std::sync::Arc;

use control::gait::Gait;
use files::dataset::{Manifest, Recording, Role};
use files::model::{Key, Model};
use physics::{Params, ParamsError};
use rayon::prelude::*;

use crate::verdict::Verdict;
use crate::vocabulary::{self, Effect};
pub use camera::Film;
use conventions::Conventions;
use data::{Data, JOINTS};
use joints::{Found, Tier};
pub use predict::predict;
use score::Score;

/// Settings of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Seed of the bootstraps.
    pub seed: u64,
    /// Effects the library must not contain (leave-one-out checks).
    pub withhold: Vec<Effect>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            withhold: Vec::new(),
        }
    }
}

/// Why a data set cannot be diagnosed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WholeError {
    /// Neither joints nor base can be compared.
    #[error(
        "no run has set-points and positions of a joint, and none has all six positions and the base pose; record setpoint_rad_k and position_rad_k"
    )]
    Nothing,
    /// The nominal model cannot be simulated.
    #[error("the nominal model: {0}")]
    Model(#[from] ParamsError),
}

/// Runs that are fitted, runs that are scored, and how they were chosen.
fn split(data: &Data) -> (Vec<usize>, Vec<usize>, String) {
    let usable: Vec<usize> = (0..data.runs.len())
        .filter(|r| data.runs[*r].joints.iter().any(|j| j.position.is_some()))
        .collect();
    let check = |r: &usize| data.runs[*r].role == Some(Role::Check);
    if usable.iter().any(check) && !usable.iter().all(check) {
        let (score, fit) = usable.into_iter().partition(check);
        return (fit, score, "roles of the data set".into());
    }
    let mut gaits: Vec<usize> = usable.iter().map(|r| data.runs[*r].gait).collect();
    gaits.sort_unstable();
    gaits.dedup();
    if gaits.len() < 3 {
        return (
            usable.clone(),
            usable,
            "nothing held out: fewer than three gaits".into(),
        );
    }
    // Every third gait is held out, beginning with the third.
    let held = |r: &usize| {
        gaits
            .iter()
            .position(|g| *g == data.runs[*r].gait)
            .is_some_and(|i| i % 3 == 2)
    };
    let (score, fit) = usable.into_iter().partition(held);
    (fit, score, "every third gait held out".into())
}

/// A diagnosis.
pub struct Diagnosis {
    model: Model,
    verdict: Verdict,
    joints: Vec<score::JointRow>,
    replay: Option<replay::Replay>,
    /// What a further experiment on the ground should decide.
    question: Option<experiment::Question>,
}

/// Everything found, before it is put into words.
struct Parts {
    data: Arc<Data>,
    conventions: Conventions,
    direct: Vec<direct::Reading>,
    /// What explains the loads of all joints as well as the reading that is named.
    twin: Option<direct::Reading>,
    /// Effects that must not be named.
    withhold: Vec<Effect>,
    split: String,
    joints: Vec<Found>,
    body: Option<body::Found>,
    camera: Option<camera::Found>,
    /// Friction of the nominal ground.
    friction: f64,
}

impl Diagnosis {
    /// The verdict.
    #[must_use]
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The nominal model with the effects found switched on, those that the simulator has.
    #[must_use]
    pub fn patch(&self) -> Model {
        patch::patched(&self.model, &self.verdict.effects)
    }

    /// The report as one page.
    #[must_use]
    pub fn html(&self) -> String {
        page::html(&self.verdict, &self.joints, self.replay.as_ref())
    }

    /// Adds the error of whole runs, which no window restarts: nominal, and with the patch.
    fn add_rollouts(&mut self, data: &Data, runs: &[usize], nominal: &Arc<Params>) {
        let Ok(patched) = Params::try_from(&self.patch()).map(Arc::new) else {
            return;
        };
        self.replay = replay::Replay::new(data, runs, &self.model, nominal, &patched);
        let mean = |params, which: usize| {
            let v: Vec<f64> = predict::errors(data, runs, params)
                .iter()
                .map(|e| e[which])
                .collect();
            (!v.is_empty()).then(|| crate::math::mean(&v))
        };
        for (which, name) in [(0, "pose_rollout_rmse_m"), (1, "speed_error")] {
            if let (Some(before), Some(after)) = (mean(nominal, which), mean(&patched, which)) {
                let metrics = &mut self.verdict.metrics;
                metrics.insert(name.into(), [before, before, after]);
            }
        }
    }

    /// The gait to play next where the body holds what is open: of `menu`, of the gaits on record and of variations of both, those that
    /// `accepts` lets pass. `None` where nothing is open about the body or no gait passes.
    #[must_use]
    pub fn experiment(
        &self,
        menu: &[Gait],
        accepts: &dyn Fn(&Gait) -> bool,
    ) -> Option<experiment::Experiment> {
        let question = self.question.as_ref()?;
        question.experiment(menu, accepts)
    }

    /// The verdict, to add provenance.
    pub fn verdict_mut(&mut self) -> &mut Verdict {
        &mut self.verdict
    }
}

/// Diagnoses a whole robot.
///
/// # Errors
/// When nothing can be compared, or the nominal model cannot be simulated.
pub fn diagnose(
    manifest: &Manifest,
    recordings: &[Recording],
    films: &[Film],
    model: &Model,
    settings: &Settings,
) -> Result<Diagnosis, WholeError> {
    let params = Arc::new(Params::try_from(model)?);
    let mut data = Data::new(manifest, recordings);
    film::track(&mut data, films, manifest, model, &params);
    let data = Arc::new(data);
    let (fit_runs, score_runs, split) = split(&data);
    if fit_runs.is_empty() {
        return Err(WholeError::Nothing);
    }
    let mut conventions = conventions::find(&data);
    let mut direct = direct::read(&data, &mut conventions, &settings.withhold);
    let mut body = body::Tier::new(&data, model, &params, &fit_runs)
        .map(|tier| body::diagnose(&data, tier, &settings.withhold));
    // Where readings stand in another order too, all that follows looks at each joint's own.
    let order = body.as_ref().map(|b| b.tier.order);
    let moved = order.filter(|o| o.iter().enumerate().any(|(k, from)| k != *from));
    let data = match moved {
        Some(order) => Arc::new(data.reordered(&order)),
        None => data,
    };
    if moved.is_some() {
        conventions = conventions::find(&data);
        direct = direct::read(&data, &mut conventions, &settings.withhold);
    }
    let mut replayed = windows::cut(&data, 1.0, 0.9);
    if let Some(body) = &mut body {
        loads::doubt(body, |with| {
            let loads = loads::replay(&data, &mut replayed.clone(), with);
            (0..JOINTS)
                .filter_map(|k| Tier::new(&data, model, k, &fit_runs, &conventions, &loads))
                .filter_map(|tier| joints::load_ratio(&tier, model, &conventions))
                .collect()
        });
    }
    // Loads on the joints come from the body as it was found to be.
    let (found, links) = match &body {
        Some(b) => {
            let theta = &b.answer.last().theta;
            (Arc::new(b.tier.params(theta)), b.tier.links(theta))
        }
        None => (Arc::clone(&params), Default::default()),
    };
    let loads = loads::weighed(&data, &mut replayed, (&found, &links));
    let mut tiers: Vec<Tier> = (0..JOINTS)
        .filter_map(|k| Tier::new(&data, model, k, &fit_runs, &conventions, &loads))
        .collect();
    joints::calibrate(&mut tiers, model, &conventions);
    let mut joints: Vec<Found> = tiers
        .into_par_iter()
        .map(|tier| joints::diagnose(tier, model, &conventions, &settings.withhold))
        .collect();
    joints::mark(&mut joints);
    let loads_together = loads::Replay {
        data: &data,
        model,
        fit_runs: &fit_runs,
        conventions: &conventions,
        joints: &joints,
    };
    let named = |effect| {
        body.as_ref().is_some_and(|b| {
            let members = &b.answer.last().members;
            members
                .iter()
                .any(|c| b.answer.candidates[*c].effect == effect)
        })
    };
    let other = body.as_ref().is_some_and(|b| {
        let of = |c: &usize| b.answer.candidates[*c].effect.stage();
        let members = &b.answer.last().members;
        // A slope only turns gravity, which the replay does too.
        let level = |c: &usize| b.answer.candidates[*c].effect != Effect::GroundSlope;
        members
            .iter()
            .any(|c| of(c) == vocabulary::Stage::Body && level(c))
    });
    let cause = loads_together.cause(body.as_ref(), &mut replayed);
    direct.extend(
        cause
            .named
            // A replay on a ground or of a body that is another one is too rough for torques to show a mass besides.
            .filter(|r| !named(r.effect))
            .filter(|r| r.effect != Effect::Mass || !other),
    );
    if joints.is_empty() && body.is_none() {
        return Err(WholeError::Nothing);
    }
    let camera = camera::Tier::new(&data, manifest, model, films, &fit_runs)
        .map(|tier| camera::diagnose(tier, manifest, model, &settings.withhold));
    let filmed = camera::Tier::new(&data, manifest, model, films, &score_runs);
    let mut scored = body::Tier::new(&data, model, &params, &score_runs);
    if let (Some(s), Some(b)) = (&mut scored, &body) {
        s.adopt(&b.tier);
        if moved.is_some() {
            s.order = std::array::from_fn(|k| k);
        }
        s.measure(&data, &b.answer.last().theta);
    }
    let mut score = Score::new(
        &data,
        &joints,
        scored.filter(|_| body.is_some()),
        &score_runs,
        &conventions,
        &loads,
    );
    score.camera = filmed.filter(|_| camera.is_some());
    let parts = Parts {
        body,
        camera,
        data,
        conventions,
        direct,
        twin: cause.instead,
        withhold: settings.withhold.clone(),
        split,
        joints,
        friction: model.value(Key::Friction),
    };
    let (verdict, joints) = answer::verdict(&parts, &score, settings);
    let mut out = Diagnosis {
        model: model.clone(),
        verdict,
        joints,
        replay: None,
        question: None,
    };
    let open = rivals::open(&parts, &out.verdict, model);
    out.question = open.map(|open| experiment::Question::new(open, &parts));
    out.add_rollouts(&parts.data, &score_runs, &params);
    let similar = |params: &Arc<Params>| {
        film::similarity(&parts.data, films, manifest, model, &score_runs, params)
    };
    if let (Some(before), Ok(patched)) = (similar(&params), Params::try_from(&out.patch()))
        && let Some(after) = similar(&Arc::new(patched))
    {
        let metrics = &mut out.verdict.metrics;
        metrics.insert("similarity_r".into(), [before, before, after]);
    }
    Ok(out)
}
