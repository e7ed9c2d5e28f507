//! The animated overlay as one HTML page with a slider: no file beside it, no network.

use crate::Silhouette;
use crate::picture::{BLUE, GREEN, GROUND, PictureError, RED, common_size};
use core::fmt::Write;

/// Overlaid frames (robot, simulation) with their times as a page that plays, stops and steps.
///
/// # Errors
/// When there is no frame or sizes differ.
pub fn overlay_html(
    title: &str,
    t_s: &[f64],
    frames: &[(&Silhouette, &Silhouette)],
) -> Result<String, PictureError> {
    let (width, height) = common_size(frames.iter().flat_map(|(a, b)| [*a, *b]))?;
    let mut data = String::new();
    for (t_s, (robot, simulated)) in t_s.iter().zip(frames) {
        let [red, blue, green] = layers(robot, simulated);
        let _ = writeln!(data, "[{t_s:.3},[{red}],[{blue}],[{green}]],");
    }
    let colour = |[r, g, b]: [u8; 3]| format!("#{r:02x}{g:02x}{b:02x}");
    let page = PAGE
        .replace("{title}", &escaped(title))
        .replace("{width}", &width.to_string())
        .replace("{height}", &height.to_string())
        .replace("{ground}", &colour(GROUND))
        .replace("{red}", &colour(RED))
        .replace("{blue}", &colour(BLUE))
        .replace("{green}", &colour(GREEN));
    Ok(page.replace("{data}", &data))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// Spans `y,from,to,` of robot alone, simulation alone, and both.
fn layers(robot: &Silhouette, simulated: &Silhouette) -> [String; 3] {
    let mut layers = [String::new(), String::new(), String::new()];
    for y in 0..robot.height() {
        let (a, b) = (robot.row_words(y), simulated.row_words(y));
        let rows: [Vec<u64>; 3] = [
            a.iter().zip(&b).map(|(a, b)| a & !b).collect(),
            a.iter().zip(&b).map(|(a, b)| b & !a).collect(),
            a.iter().zip(&b).map(|(a, b)| a & b).collect(),
        ];
        for (layer, row) in layers.iter_mut().zip(&rows) {
            for (from, to) in spans(row) {
                let _ = write!(layer, "{y},{from},{to},");
            }
        }
    }
    layers
}

/// Runs of set bits as (from, to).
fn spans(row: &[u64]) -> Vec<(usize, usize)> {
    let mut spans: Vec<(usize, usize)> = Vec::new();
    if row.iter().all(|word| *word == 0) {
        return spans;
    }
    for x in (0..row.len() * 64).filter(|x| row[x / 64] >> (x % 64) & 1 == 1) {
        match spans.last_mut() {
            Some((_, to)) if *to == x => *to = x + 1,
            _ => spans.push((x, x + 1)),
        }
    }
    spans
}

const PAGE: &str = r##"<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>body{font:15px system-ui,sans-serif;color:#333;margin:1.5em;max-width:{width}px}canvas{width:100%;border:1px solid #ddd}
input{width:100%}b{font-weight:600}.r{color:{red}}.b{color:{blue}}.g{color:{green}}</style>
<h3>{title}</h3>
<canvas id="c" width="{width}" height="{height}"></canvas>
<input id="s" type="range" min="0" value="0" aria-label="time">
<p><button id="p">play</button> <span id="t"></span> &nbsp; <b class="r">robot</b> &nbsp; <b class="b">simulation</b> &nbsp; <b class="g">both</b></p>
<script>
const frames=[
{data}];
const c=document.getElementById("c").getContext("2d"),s=document.getElementById("s"),t=document.getElementById("t"),p=document.getElementById("p");
s.max=frames.length-1;
function area(l){let n=0;for(let i=0;i<l.length;i+=3)n+=l[i+2]-l[i+1];return n}
function draw(){const f=frames[+s.value];c.fillStyle="{ground}";c.fillRect(0,0,{width},{height});
["{red}","{blue}","{green}"].forEach((colour,k)=>{c.fillStyle=colour;const l=f[k+1];for(let i=0;i<l.length;i+=3)c.fillRect(l[i+1],l[i],l[i+2]-l[i+1],1)});
const all=area(f[1])+area(f[2])+area(f[3]);t.textContent=f[0].toFixed(2)+" s, R "+(all?(area(f[3])/all).toFixed(3):"-")}
let timer=0;
function step(){s.value=(+s.value+1)%frames.length;draw();const k=+s.value;timer=setTimeout(step,k?1000*(frames[k][0]-frames[k-1][0]):500)}
p.onclick=()=>{if(timer){clearTimeout(timer);timer=0;p.textContent="play"}else{p.textContent="stop";step()}};
s.oninput=draw;draw();
</script></html>
"##;
