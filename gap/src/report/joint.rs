//! What a report shows of one joint: curves over time, and hands under a time slider.

use std::fmt::Write as _;

use super::page::{Evidence, html as page};
use super::plot::{Axes, Curve, plot};
use super::subject::Subject;
use super::words::escape;
use crate::bench::Diagnosis;

/// Points of a curve: what a screen shows.
const POINTS: usize = 600;
/// Enough runs to show evidence, few enough for a phone.
const SHOWN: usize = 4;

/// Measured, before and after of one scored run in mrad or mm, thinned to what a screen shows.
struct Traces {
    name: String,
    t_s: Vec<f64>,
    measured: Vec<f64>,
    before: Vec<f64>,
    after: Vec<f64>,
}

impl Traces {
    fn new(d: &Diagnosis, run: usize) -> Self {
        let scored = d.scored();
        let (_, a) = scored.played(&d.nominal, run);
        let (data, b) = scored.played(&d.found, run);
        let step = data.samples.len().div_ceil(POINTS).max(1);
        let mut out = Self {
            name: data.name.clone(),
            t_s: vec![],
            measured: vec![],
            before: vec![],
            after: vec![],
        };
        for (i, s) in data.samples.iter().enumerate().step_by(step) {
            if s.measured[0].is_finite() {
                out.t_s.push((s.step as f64 + s.part) * d.problem.dt_s);
                out.measured.push(1e3 * s.measured[0]);
                out.before.push(1e3 * a[i][0]);
                out.after.push(1e3 * b[i][0]);
            }
        }
        out
    }

    fn curve<'a>(&self, name: &'a str, colour: usize, y: impl Iterator<Item = f64>) -> Curve<'a> {
        Curve {
            name,
            colour,
            points: self.t_s.iter().copied().zip(y).collect(),
        }
    }

    /// The motion, and below it what both simulations get wrong of it.
    fn plots(&self, unit: &str) -> String {
        let error = |v: &[f64]| -> Vec<f64> {
            let pairs = v.iter().zip(&self.measured);
            pairs.map(|(v, m)| v - m).collect()
        };
        let (position, off) = (format!("position [{unit}]"), format!("error [{unit}]"));
        let axes = |title, y| Axes {
            title,
            x: "time [s]",
            y,
            map: false,
        };
        let motion = [
            self.curve("measured", 0, self.measured.iter().copied()),
            self.curve("simulated before", 1, self.before.iter().copied()),
            self.curve("simulated after", 2, self.after.iter().copied()),
        ];
        let errors = [
            self.curve("before", 1, error(&self.before).into_iter()),
            self.curve("after", 2, error(&self.after).into_iter()),
        ];
        let title = format!("{}: simulated minus measured", self.name);
        plot(&axes(&self.name, &position), &motion) + &plot(&axes(&title, &off), &errors)
    }

    /// Joint and both simulations drawn over each other, under a time slider.
    fn replay(&self, linear: bool) -> String {
        let list = |v: &[f64]| {
            let numbers: Vec<String> = v.iter().map(|x| format!("{x:.1}")).collect();
            numbers.join(",")
        };
        let mut s = format!(
            "<p>{}: <b class=\"k0\">measured</b>, <b class=\"k1\">simulated before</b>, \
             <b class=\"k2\">simulated after</b>.{}</p>",
            escape(&self.name),
            if linear {
                ""
            } else {
                " 0 mrad hangs down; angles are drawn to scale."
            }
        );
        s.push_str("<svg viewBox=\"-120 -120 240 240\" class=\"replay hand\" role=\"img\" aria-label=\"measured, before and after at the chosen time\"><path d=\"M-110 0H110M0 -110V110\"/>");
        let _ = if linear {
            write!(
                s,
                "<text x=\"-116\" y=\"-4\">-<tspan id=\"end\"></tspan></text><text x=\"118\" y=\"-4\" text-anchor=\"end\" id=\"high\"></text>"
            )
        } else {
            write!(
                s,
                "<text x=\"4\" y=\"116\">0</text><text x=\"118\" y=\"-4\" text-anchor=\"end\">1571 mrad</text><text x=\"-118\" y=\"-4\">-1571 mrad</text><text x=\"4\" y=\"-112\">3142 mrad</text>"
            )
        };
        for (k, length) in [(1, 80), (2, 90), (0, 100)] {
            let _ = write!(
                s,
                "<line id=\"r{k}\" class=\"k{k}\" x1=\"0\" y1=\"0\" x2=\"0\" y2=\"{length}\"/>"
            );
        }
        let _ = write!(
            s,
            "</svg><p><button id=\"play\" type=\"button\">Play</button> <output id=\"now\">0.00 s</output></p>\
             <label for=\"time\">Time</label><input id=\"time\" type=\"range\" min=\"0\" max=\"{}\" value=\"0\" step=\"1\">\
             <script>\nconst T=[{}],Y=[[{}],[{}],[{}]],LINEAR={linear};\n{SCRIPT}</script>",
            self.t_s.len().saturating_sub(1),
            list(&self.t_s),
            list(&self.measured),
            list(&self.before),
            list(&self.after),
        );
        s
    }
}

/// One self-contained page on the data set that `subject` describes.
#[must_use]
pub fn html(d: &Diagnosis, subject: &Subject) -> String {
    let shown = d.score_runs.iter().take(SHOWN);
    let all: Vec<Traces> = shown.map(|r| Traces::new(d, *r)).collect();
    let unit = if d.problem.linear { "mm" } else { "mrad" };
    let first = all.first();
    let evidence = Evidence {
        plots: all.iter().map(|t| t.plots(unit)).collect(),
        replay: first.map_or_else(String::new, |t| t.replay(d.problem.linear)),
    };
    page(&d.verdict, subject, &evidence)
}

const SCRIPT: &str = r"const $=i=>document.getElementById(i),s=$('time'),o=$('now'),play=$('play');
const span=Math.max(1e-6,...Y[0].map(Math.abs));
if(LINEAR){$('end').textContent=$('high').textContent=span.toFixed(0)+' mm';}
function show(){const k=+s.value;
o.textContent=T[k].toFixed(2)+' s: measured '+Y[0][k].toFixed(0)+', before '+Y[1][k].toFixed(0)+', after '+Y[2][k].toFixed(0)+(LINEAR?' mm':' mrad');
for(let i=0;i<3;i++){const q=Y[i][k],l=$('r'+i);
if(LINEAR){const x=100*q/span;l.setAttribute('x1',x);l.setAttribute('x2',x);}
else{const r=100-10*i,a=q/1000;l.setAttribute('x2',r*Math.sin(a));l.setAttribute('y2',r*Math.cos(a));}}}
let run=null;play.addEventListener('click',()=>{if(run){clearInterval(run);run=null;play.textContent='Play';return;}
if(+s.value>=+s.max)s.value=0;play.textContent='Pause';const from=performance.now(),t=T[+s.value];
run=setInterval(()=>{const now=t+(performance.now()-from)/1000;while(+s.value<+s.max&&T[+s.value+1]<=now)s.value=+s.value+1;show();
if(+s.value>=+s.max)play.click();},50);});
s.addEventListener('input',show);show();
";
