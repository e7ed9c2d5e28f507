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
                y: "encoder angle [mrad]",
                map: false,
            };
            let of = |p: &Picture| 1e3 * f64::from(p.angles_rad.get(*k).copied().unwrap_or(0.0));
            let [measured, ..] = &self.films;
            s.push_str(&plot(&angle, &curves(&|i, p| (i as f64 / RATE_HZ, of(p)))));
            let off = Axes {
                title: &format!("{}: joint {k}, simulated minus measured", self.name),
                y: "error [mrad]",
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
            "<p>{}, from the measured start: <b class=\"k0\">robot</b>, <b class=\"k1\">simulator before</b>, \
             <b class=\"k2\">simulator with the effects found</b>. Nothing restarts the simulation, so small errors add up. The view follows the robot; the grid on the ground has squares of 0.2 m.</p>\
             <svg class=\"replay\" viewBox=\"-160 -100 320 200\" role=\"img\" aria-label=\"four cubes of the robot and of both simulations at the chosen time\"><path id=\"grid\"/>",
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
            "<path class=\"axis\" id=\"axes\"/><text id=\"x\">x</text><text id=\"y\">y</text><text id=\"z\">z</text>\
             <path class=\"axis\" id=\"bar\"/><text x=\"-150\" y=\"84\">0.2 m</text>\
             </svg><p><button id=\"play\" type=\"button\">Play</button> <output id=\"now\"></output></p>\
             <p><label for=\"time\">Time</label><input id=\"time\" type=\"range\" min=\"0\" max=\"{last}\" value=\"0\"></p>\
             <p><label for=\"view\">View from <output id=\"angle\"></output></label><input id=\"view\" type=\"range\" min=\"-180\" max=\"180\" value=\"-35\"></p>\
             <script>const F=[{}];const RATE={RATE_HZ};\n{SCRIPT}</script>",
            films.join(",")
        );
    }
}

/// Orthographic view, 30 degrees from above, which follows the measured robot; so wide that all three films fit. Millimetres.
const SCRIPT: &str = r"const $=i=>document.getElementById(i),time=$('time'),view=$('view'),play=$('play');
const COS=Math.cos(Math.PI/6),SIN=Math.sin(Math.PI/6),LAST=+time.max;
const cubes=(f,k)=>[0,1,2,3].map(c=>f.slice(12*k+3*c,12*k+3*c+3));
const centre=k=>{const p=cubes(F[0],k);return[0,1].map(i=>(p[0][i]+p[1][i]+p[2][i]+p[3][i])/4).concat(60);};
let reach=220;for(let k=0;k<=LAST;k++){const m=centre(k);F.forEach(f=>cubes(f,k).forEach(x=>{reach=Math.max(reach,Math.hypot(x[0]-m[0],x[1]-m[1]));}));}
const scale=Math.min(85/(.5*reach+90),145/(reach+70));
function show(){const k=+time.value,a=view.value*Math.PI/180,m=centre(k);
const at=p=>{const x=p[0]-m[0],y=p[1]-m[1],u=x*Math.cos(a)-y*Math.sin(a),v=x*Math.sin(a)+y*Math.cos(a);
return[scale*u,-scale*((p[2]-m[2])*COS+v*SIN)];};
$('now').textContent=(k/RATE).toFixed(1)+' s';$('angle').textContent=view.value+'°';
let g='';const far=Math.ceil(400/scale/200)*200,near=i=>Math.round(m[i]/200)*200;
for(let d=-far;d<=far;d+=200){const[x,y]=[near(0),near(1)];
g+='M'+at([x+d,y-far,0])+'L'+at([x+d,y+far,0])+'M'+at([x-far,y+d,0])+'L'+at([x+far,y+d,0]);}
$('grid').setAttribute('d',g);$('bar').setAttribute('d','M-150 90h'+200*scale+'m0 -3v6M-150 87v6');
const o=at(m),arm=i=>{const p=m.slice();p[i]+=22/scale;const q=at(p);return[125+q[0]-o[0],70+q[1]-o[1]];};
$('axes').setAttribute('d',[0,1,2].map(i=>'M125 70L'+arm(i)).join(''));
['x','y','z'].forEach((n,i)=>{const q=arm(i);$(n).setAttribute('x',q[0]+2);$(n).setAttribute('y',q[1]-2);});
F.forEach((f,n)=>{const p=cubes(f,k),q=p.map(at);
$('b'+n).setAttribute('points',q.join(' '));$('s'+n).setAttribute('points',p.map(x=>at([x[0],x[1],0])).join(' '));
q.forEach((x,c)=>{const e=$('c'+n+c);e.setAttribute('cx',x[0]);e.setAttribute('cy',x[1]);e.setAttribute('r',62*scale);});});}
let run=null;play.addEventListener('click',()=>{if(run){clearInterval(run);run=null;play.textContent='Play';return;}
if(+time.value>=LAST)time.value=0;play.textContent='Pause';
run=setInterval(()=>{if(+time.value>=LAST){play.click();return;}time.value=+time.value+1;show();},1000/RATE);});
time.addEventListener('input',show);view.addEventListener('input',show);show();
";
