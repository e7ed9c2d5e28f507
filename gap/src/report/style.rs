//! Head of the page: encoding, and the style sheet for screen, dark screen, phone and print.

/// From the document type to the title.
pub(super) const HEAD: &str = r#"<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="data:,"><style>
:root{--ink:#1b1b1b;--paper:#fff;--before:#c2410c;--after:#1d70b8;--line:#bbb;--faint:#8884;--soft:#a9cdec;--grey:#ddd;color-scheme:light}
@media screen and (prefers-color-scheme:dark){:root{--ink:#eee;--paper:#151515;--before:#fb923c;--after:#60a5fa;--line:#666;--soft:#1f4e7d;--grey:#3a3a3a;color-scheme:dark}}
body{font:16px/1.45 system-ui,sans-serif;margin:0;color:var(--ink);background:var(--paper)}main{max-width:60rem;margin:auto;padding:1rem}
h1{font-size:1.5rem;margin:0;overflow-wrap:anywhere}h2{font-size:1.15rem;margin:1.4rem 0 .5rem}.about{margin:.1rem 0 .6rem;opacity:.8}.lead{font-size:1.2rem;font-weight:600;margin:.6rem 0 .3rem}.doubt{margin:.3rem 0}
p,li{overflow-wrap:anywhere}.warning{border-left:.4rem solid var(--before);padding-left:.6rem}footer{font-size:.85rem;border-top:1px solid var(--line);margin-top:1rem}
.first{display:grid;grid-template-columns:minmax(0,1fr) minmax(0,1fr);gap:0 2rem}.first h2{margin-top:.6rem}@media screen and (max-width:44rem){.first{grid-template-columns:minmax(0,1fr)}.lead{font-size:1.05rem}h1{font-size:1.25rem}}
nav ul{list-style:none;padding:0;margin:0}nav li{display:grid;grid-template-columns:6.8rem 1fr;padding:.3rem 0;border-bottom:1px solid var(--line)}nav a{font-weight:600;color:var(--after)}@media screen and (min-width:44rem){nav code{white-space:nowrap}}
figure{margin:0}figcaption{font-size:.85rem;opacity:.8}.where{display:block;width:100%;max-width:30rem;height:auto}.where text{font:13px system-ui,sans-serif;fill:currentColor}.where .strong{font-weight:700}.where .end{text-anchor:end}.where .middle{text-anchor:middle}.where .small{font-size:11px}
.where .box{fill:none;stroke:var(--line)}.where .paper{fill:var(--paper)}.where .cause{fill:var(--soft)}.where .bent,.where .rest{fill:var(--grey)}.where .arrow{fill:var(--line)}
.stair{display:grid;grid-template-columns:1fr auto;gap:0 1rem;margin:.4rem 0;break-inside:avoid}.stair .bar{grid-column:1/3}
.bar{height:.9rem;margin-top:.1rem;background:var(--after);min-width:1px}.bar.rest{background:#999}.bar,.where *,.heat{print-color-adjust:exact;-webkit-print-color-adjust:exact}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid var(--line);vertical-align:top}.heat{display:block;margin:-.3rem -.6rem;padding:.3rem .6rem;background:color-mix(in srgb,var(--before) var(--heat),transparent);white-space:nowrap}
.card{border-left:.4rem solid var(--after);padding:.1rem 1rem;margin:1rem 0;break-inside:avoid}.card h3,.card p{margin:.4rem 0}.card dl{display:grid;grid-template-columns:minmax(6rem,max-content) 1fr;gap:.1rem 1rem;margin:.4rem 0}.card dt{max-width:14rem}.card dd{margin:0;overflow-wrap:anywhere}
.k0{color:var(--ink)}.k1{color:var(--before)}.k2{color:var(--after)}
.plot{margin:1.2rem 0;display:grid;grid-template-columns:3.2rem 1fr;break-inside:avoid}.plot figcaption,.plot .legend{grid-column:1/3}.plot figcaption{font-weight:600;font-size:1rem;opacity:1}
.plot .ylabel{grid-column:1/3;font-size:.8rem;margin-bottom:.4rem}.plot .xlabel{grid-column:2;font-size:.8rem;text-align:right}.plot svg{width:100%;height:13rem;border:1px solid var(--line);box-sizing:border-box}.plot.map svg{height:auto;aspect-ratio:1}.plot.map{max-width:26rem}
.yticks,.xticks{position:relative;font-size:.8rem;line-height:1}.yticks span{position:absolute;right:.4rem;transform:translateY(-50%)}.xticks{grid-column:2;height:1.2rem;margin-top:.2rem}.xticks span{position:absolute;transform:translateX(-50%)}
.plot polyline{fill:none;stroke:currentColor;stroke-width:1.5;vector-effect:non-scaling-stroke}.plot polyline.k1{stroke-dasharray:6 3}.plot .grid{stroke:var(--faint);fill:none;vector-effect:non-scaling-stroke}
.legend span{margin-right:1rem;white-space:nowrap}.legend i{display:inline-block;width:1.4rem;border-top:3px solid currentColor;vertical-align:middle;margin-right:.3rem}.legend .k1 i{border-top-style:dashed}
.replay{width:100%;height:auto;border:1px solid var(--line);box-sizing:border-box;display:block}.replay.hand{max-width:26rem}.replay line{stroke:currentColor;stroke-width:4}.replay circle{fill:currentColor;fill-opacity:.15;stroke:currentColor}.replay polyline{fill:none;stroke:currentColor;stroke-width:3}.replay polyline[id^=s]{stroke-width:1;stroke-opacity:.4}.replay path{stroke:var(--faint);fill:none}.replay path.axis{stroke:currentColor;stroke-width:1.5}.replay text{font:9px system-ui,sans-serif;fill:currentColor}
input[type=range]{width:100%;min-height:2rem}button{font:inherit;padding:.3rem 1rem}summary{padding:.4rem 0;cursor:pointer}:focus-visible{outline:3px solid var(--after)}
@media print{input,button,label,nav,#replay output{display:none}.first{grid-template-columns:minmax(0,1fr)}h2{break-after:avoid}tr{break-inside:avoid}main{max-width:none;padding:0}.wide{overflow:visible}body{font-size:11px}.where{max-width:11cm}details::details-content{content-visibility:visible;display:block}}
</style>"#;
