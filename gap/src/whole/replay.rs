//! Robot and simulator side by side: one held-out run as recorded, as the nominal model rolls it out from the measured start,
//! and as the patched model does; drawn under a time slider.

use std::fmt::Write as _;
use std::sync::Arc;

use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::RobotModel;
use files::model::Model;
use physics::{Outcome, Params};

use super::camera::robot;
use super::data::{Data, JOINTS, Run};
use super::{predict, windows};
use crate::report::{Axes, Curve, escape, plot};

/// Pictures per second: a body of 0.44 m at a few cm/s needs no more.
const RATE_HZ: f64 = 10.0;

/// Centres of the four cubes in the world, m.
type Cubes = [Vec3; 4];

/// What is seen of the robot at one instant.
#[derive(Debug, Clone, PartialEq)]
struct Picture {
    cubes: Cubes,
    /// Encoder angles, rad.
    angles_rad: [f32; JOINTS],
}

/// One run three times.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Replay {
    name: String,
    /// Measured, before, after; as many pictures each.
    films: [Vec<Picture>; 3],
}

fn cubes(robot: &RobotModel, base: &physics::Pose, angles: [f32; JOINTS]) -> Cubes {
    let [x, y, z] = base.position_m;
    let pose = Pose {
        position_m: Vec3::new(x, y, z),
        rotation: Rot3::from_quaternion(base.quaternion),
    };
    kinematics::forward(robot, &angles)
        .rebased(3, &pose)
        .cube_centres_m()
}

fn measured(run: &Run, robot: &RobotModel, count: usize) -> Option<Vec<Picture>> {
    let base = run.base.as_ref()?;
    let one = |i: usize| {
        let t_s = i as f64 / RATE_HZ;
        let (mut links, mut angles_rad) = ([0.0; JOINTS], [0.0; JOINTS]);
        for (k, joint) in run.joints.iter().enumerate().take(JOINTS) {
            let (link, encoder) = (joint.link.as_ref(), joint.position.as_ref());
            links[k] = link.or(encoder)?.at(t_s) as f32;
            angles_rad[k] = encoder.or(link)?.at(t_s) as f32;
        }
        let (pose, _) = windows::base_state(base, t_s)?;
        Some(Picture {
            cubes: cubes(robot, &pose, links),
            angles_rad,
        })
    };
    (0..count).map(one).collect()
}

fn simulated(outcome: &Outcome, robot: &RobotModel, count: usize) -> Option<Vec<Picture>> {
    let every = predict::RATE_HZ / RATE_HZ;
    let one = |i: usize| {
        let k = (i as f64 * every) as usize;
        let row = k * JOINTS..(k + 1) * JOINTS;
        let links = outcome.angles_rad.get(row.clone())?.try_into().ok()?;
        Some(Picture {
            cubes: cubes(robot, outcome.poses.get(k)?, links),
            angles_rad: outcome.encoders_rad.get(row)?.try_into().ok()?,
        })
    };
    (0..count).map(one).collect()
}

impl Replay {
    /// The first of `runs` with base pose and all six angles.
    pub(super) fn new(
        data: &Data,
        runs: &[usize],
        model: &Model,
        before: &Arc<Params>,
        after: &Arc<Params>,
    ) -> Option<Self> {
        let robot = robot(model)?;
        runs.iter().find_map(|r| {
            let run = &data.runs[*r];
            // The last pictures would need samples beyond the end.
            let count = ((run.length_s - 0.3).max(0.0) * RATE_HZ) as usize;
            let film = |params| {
                let outcome = predict::rollouts(data, &[*r], params).pop()??;
                simulated(&outcome, &robot, count)
            };
            let films = [measured(run, &robot, count)?, film(before)?, film(after)?];
            (count >= 2).then(|| Self {
                name: run.name.clone(),
                films,
            })
        })
    }

    /// The path from above, and the angles of the joints `named`.
    pub(super) fn plots(&self, named: &[usize]) -> String {
        let curves = |point: &dyn Fn(usize, &Picture) -> (f64, f64)| -> Vec<Curve<'static>> {
            let names = ["measured", "simulated before", "simulated after"];
            let film = |(colour, f): (usize, &Vec<Picture>)| Curve {
                name: names[colour],
                colour,
                points: f.iter().enumerate().map(|(i, p)| point(i, p)).collect(),
            };
            self.films.iter().enumerate().map(film).collect()
        };
        let middle = |p: &Picture, of: fn(&Vec3) -> f32| {
            let sum: f32 = p.cubes.iter().map(of).sum();
            f64::from(sum) / p.cubes.len() as f64
        };
        let path = Axes {
            title: &format!("{}: path of the robot's middle, from above", self.name),
            x: "x [m]",
            y: "y [m]",
            map: true,
        };
        let mut s = plot(
            &path,
            &curves(&|_, p| (middle(p, |c| c.x), middle(p, |c| c.y))),
        );
        for k in named {
            let angle = Axes {
                title: &format!("{}: joint {k}", self.name),
                x: "time [s]",
                y: "encoder angle [rad]",
                map: false,
            };
            let of = |p: &Picture| f64::from(p.angles_rad.get(*k).copied().unwrap_or(0.0));
            let [measured, ..] = &self.films;
            s.push_str(&plot(&angle, &curves(&|i, p| (i as f64 / RATE_HZ, of(p)))));
            let off = Axes {
                title: &format!("{}: joint {k}, simulated minus measured", self.name),
                y: "error [rad]",
                ..angle
            };
            let error = |i: usize, p: &Picture| {
                let real = measured.get(i).map_or(0.0, of);
                (i as f64 / RATE_HZ, of(p) - real)
            };
            let [_, errors @ ..] = &*curves(&error) else {
                continue;
            };
            s.push_str(&plot(&off, errors));
        }
        s
    }

    /// The drawing, with its script.
    pub(super) fn html(&self, s: &mut String) {
        let film = |f: &Vec<Picture>| {
            let numbers: Vec<String> = f
                .iter()
                .flat_map(|p| &p.cubes)
                .flat_map(|c| c.to_array().map(|x| format!("{:.0}", 1000.0 * x)))
                .collect();
            format!("[{}]", numbers.join(","))
        };
        let films: Vec<String> = self.films.iter().map(film).collect();
        let last = self.films[0].len().saturating_sub(1);
        let _ = write!(
            s,
            "<h2>Replay</h2><p>{}, from the measured start: <b class=\"k0\">robot</b>, <b class=\"k1\">simulator before</b>, \
             <b class=\"k2\">simulator with the effects found</b>. Nothing restarts it, so small errors add up.</p>\
             <svg class=\"replay\" viewBox=\"-160 -120 320 200\" role=\"img\" aria-label=\"four cubes of the robot and of both simulations at the chosen time\">",
            escape(&self.name)
        );
        for k in [1, 2, 0] {
            let _ = write!(
                s,
                "<g class=\"k{k}\"><polyline id=\"s{k}\"/><polyline id=\"b{k}\"/>"
            );
            for c in 0..4 {
                let _ = write!(s, "<circle id=\"c{k}{c}\"/>");
            }
            s.push_str("</g>");
        }
        let _ = write!(
            s,
            "</svg><p><button id=\"play\" type=\"button\">Play</button> <output id=\"now\"></output></p>\
             <p><label>Time <input id=\"time\" type=\"range\" min=\"0\" max=\"{last}\" value=\"{last}\"></label></p>\
             <p><label>View from <input id=\"view\" type=\"range\" min=\"-180\" max=\"180\" value=\"-35\"></label></p>\
             <script>const F=[{}];const RATE={RATE_HZ};\n{SCRIPT}</script>",
            films.join(",")
        );
    }
}

/// Orthographic view, 30 degrees from above; scaled to all three films. Millimetres.
const SCRIPT: &str = r"const $=i=>document.getElementById(i),time=$('time'),view=$('view'),play=$('play');
const lo=[1e9,1e9,1e9],hi=[-1e9,-1e9,-1e9];
F.forEach(f=>f.forEach((x,i)=>{lo[i%3]=Math.min(lo[i%3],x);hi[i%3]=Math.max(hi[i%3],x);}));
const mid=lo.map((l,i)=>(l+hi[i])/2),size=Math.max(300,Math.hypot(hi[0]-lo[0],hi[1]-lo[1]))+140,scale=300/size;
function at(p,a){const x=p[0]-mid[0],y=p[1]-mid[1],u=x*Math.cos(a)-y*Math.sin(a),v=x*Math.sin(a)+y*Math.cos(a);
return[scale*u,-scale*(p[2]*Math.cos(Math.PI/6)+v*Math.sin(Math.PI/6))];}
function show(){const k=+time.value,a=view.value*Math.PI/180;$('now').textContent=(k/RATE).toFixed(1)+' s';
F.forEach((f,m)=>{const p=[0,1,2,3].map(c=>f.slice(12*k+3*c,12*k+3*c+3)),q=p.map(x=>at(x,a));
$('b'+m).setAttribute('points',q.join(' '));$('s'+m).setAttribute('points',p.map(x=>at([x[0],x[1],0],a)).join(' '));
q.forEach((x,c)=>{const e=$('c'+m+c);e.setAttribute('cx',x[0]);e.setAttribute('cy',x[1]);e.setAttribute('r',62*scale);});});}
let run=null;play.addEventListener('click',()=>{if(run){clearInterval(run);run=null;play.textContent='Play';return;}
if(+time.value>=+time.max)time.value=0;play.textContent='Pause';
run=setInterval(()=>{if(+time.value>=+time.max){play.click();return;}time.value=+time.value+1;show();},1000/RATE);});
time.addEventListener('input',show);view.addEventListener('input',show);show();
";
