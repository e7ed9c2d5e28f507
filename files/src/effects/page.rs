//! The reference page of effects, made from the registry.

use super::{Effect, EffectInfo, EffectParam, Kind, Prior, Scale, Scope, Stage};
use std::fmt::Write as _;

const HEAD: &str = "# Effects

Generated from `files/src/effects` by `cargo run -p files --example docs`; a test holds the page to the table.

An effect is switched on in `model.toml` under `[effect.NAME]`, or `[effect.NAME.joint_K]` where every joint has its own. A structural effect is one that the
nominal model lacks; a parametric one is another value of a parameter that the model holds.
**Off** is the neutral value. **Typical** is what is believed about the size of an effect that is there, before any data. **Worth a name** is the smallest
distance from off that a diagnosis should report; where off is infinite, the largest value. A share `x largest torque` is taken of the joint's own figures.
";

/// The page as Markdown.
#[must_use]
pub fn page() -> String {
    let mut out = HEAD.to_owned();
    let mut stage: Option<Stage> = None;
    for effect in Effect::ALL {
        let info = effect.info();
        if stage != Some(info.stage) {
            stage = Some(info.stage);
            let _ = write!(out, "\n## {}\n", info.stage.name());
        }
        section(&mut out, info);
    }
    out
}

fn section(out: &mut String, info: &EffectInfo) {
    let kind = match info.kind {
        Kind::Structural => "structural",
        Kind::Parametric => "parametric",
    };
    let scope = match info.scope {
        Scope::Joint => "one per joint",
        Scope::Robot => "one per robot",
    };
    let plants: Vec<&str> = info.plants.iter().map(|p| p.name()).collect();
    let signals: Vec<String> = info.signals.iter().map(|s| code(s.columns())).collect();
    let rivals: Vec<String> = info.confounded.iter().map(|e| code(e.name())).collect();
    let _ = write!(
        out,
        "\n### {}\n\n{}: {kind}, {scope}; {}.\n\n    {}\n\nShown by {}. Confounded with {}.\n\n\
         | key | unit | off | range | typical | worth a name |\n|---|---|---|---|---|---|\n",
        info.name,
        capital(info.plain),
        plants.join(", "),
        info.law,
        signals.join(", "),
        rivals.join(", "),
    );
    for p in info.parameters {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} to {} | {} | {} |",
            code(p.key),
            p.unit,
            number(p.neutral),
            number(p.min),
            number(p.max),
            typical(p),
            worth(p)
        );
    }
}

fn typical(p: &EffectParam) -> String {
    let of = of(p.scale);
    let size = match p.prior {
        Prior::LogNormal { median, ln_sigma } => {
            let factor = libm::round(100.0 * libm::exp(ln_sigma)) / 100.0;
            format!("{}{of}, within a factor of {factor}", number(median))
        }
        Prior::Normal { mean: 0.0, sigma } => format!("± {}{of}", number(sigma)),
        Prior::Normal { mean, sigma } => format!("{} ± {}{of}", number(mean), number(sigma)),
        Prior::Uniform { low, high } => format!("{low:.4} to {high:.4}"),
        Prior::OneOf(count) => format!("one of {count}"),
    };
    format!("{size} ({})", p.prior_source)
}

fn worth(p: &EffectParam) -> String {
    p.resolution.map_or_else(
        || "-".to_owned(),
        |r| format!("{}{} ({})", number(r.size), of(p.scale), r.source),
    )
}

fn of(scale: Scale) -> String {
    match scale {
        Scale::Unit => String::new(),
        other => format!(" x {}", other.plain()),
    }
}

fn number(x: f64) -> String {
    if x.is_infinite() {
        "infinite".to_owned()
    } else {
        format!("{x}")
    }
}

fn code(text: &str) -> String {
    format!("`{text}`")
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}
