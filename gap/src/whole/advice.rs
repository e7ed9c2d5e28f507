//! What to record next where the data leave something open, in words.

use crate::verdict::{Ambiguous, NextExperiment, Word};
use crate::vocabulary::Effect;

/// What would separate a class; `echoed` where the driver's set-points of its joint were recorded.
pub(super) fn separate_by(effects: &[Effect], echoed: bool) -> &'static str {
    let has = |e: Effect| effects.contains(&e);
    if has(Effect::DampingGain) {
        "turn the joint by hand with its driver off: friction stays, the driver's damping goes"
    } else if has(Effect::Latency)
        || has(Effect::LoopGain)
        || has(Effect::FeedbackDelay)
        || has(Effect::MotorLag)
    {
        if echoed {
            "record a chirp of that joint up to 1 Hz in the air: what a gain loses with the frequency, a delay and a lag lose otherwise"
        } else {
            "record applied_setpoint_rad as the driver echoes it, and a chirp up to 1 Hz in the air"
        }
    } else if has(Effect::TorqueLimit) || has(Effect::CurrentLimit) {
        "load that joint until it stalls, cold and warm: a limit of the current gives less torque once the magnets are warm"
    } else if has(Effect::Backlash) || has(Effect::Compliance) || has(Effect::Deadband) {
        "record link_position_rad, and slow reversals under load"
    } else if has(Effect::Mass) {
        "weigh the robot, or record base_* with a tracker"
    } else if has(Effect::GroundFriction) || has(Effect::FrictionAnisotropy) {
        "record gaits in two headings, the robot turned by 90 degrees on the same spot"
    } else if has(Effect::GroundSlope) || has(Effect::ComOffset) {
        "record the same gait with the robot turned by 180 degrees: a slope stays, a shifted mass turns with it"
    } else if has(Effect::ConnectorCompliance) || has(Effect::ConnectorPlay) {
        "hold the robot as a bridge on its two ends and load the connector both ways"
    } else {
        "record slow triangles of that joint in the air, with current"
    }
}

/// The next experiment; `late` where set-points come otherwise than they were sent and no echo tells how.
pub(super) fn next(classes: &[Ambiguous], word: Word, late: bool) -> Option<NextExperiment> {
    let make = |text: String, separates: Vec<Effect>| {
        Some(NextExperiment {
            text,
            separates,
            gait: None,
        })
    };
    if let Some(c) = classes.first() {
        let joint = c
            .members
            .first()
            .and_then(|m| m.joint)
            .map_or_else(String::new, |k| format!(" (joint {k})"));
        return make(
            format!("To distinguish these{joint}: {}.", c.separate_by),
            c.effects.clone(),
        );
    }
    match word {
        Word::Unknown if late => make(
            "Record applied_setpoint_rad as the driver echoes it: it shows whether set-points are late, jitter or are lost.".into(),
            vec![Effect::Latency, Effect::Jitter, Effect::PacketLoss],
        ),
        Word::Unknown => make(
            "Record each joint alone in the air (slow triangle, then chirp) with current and link angle, three repeats each: it shows whether the remainder lies before or behind the gear.".into(),
            Vec::new(),
        ),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::{next, separate_by};
    use crate::verdict::Word;
    use crate::vocabulary::Effect;

    #[test]
    fn an_unknown_way_of_set_points_asks_for_the_echo_and_nothing_open_for_nothing() {
        let asked = |word, late| next(&[], word, late).map(|n| n.text);
        let echo = asked(Word::Unknown, true).expect("something to record");
        assert!(echo.contains("applied_setpoint_rad"), "{echo}");
        let joint = asked(Word::Unknown, false).expect("something to record");
        assert!(joint.contains("alone in the air"), "{joint}");
        assert_eq!(asked(Word::None, true), None);
    }

    #[test]
    fn nobody_is_asked_to_record_what_he_recorded() {
        let classes = [
            [Effect::LoopGain, Effect::MotorLag],
            [Effect::FeedbackDelay, Effect::LoopGain],
        ];
        for class in classes {
            assert!(separate_by(&class, false).contains("applied_setpoint_rad"));
            assert!(!separate_by(&class, true).contains("applied_setpoint_rad"));
        }
    }
}
