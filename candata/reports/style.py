"""The page's style sheet and script; no fonts, images or code from elsewhere."""

from __future__ import annotations

#: Name of a colour to its value on a light and on a dark page; print takes the light one.
COLOURS = {
    "paper": ("#fbfaf7", "#14171a"),
    "card": ("#ffffff", "#1b1f23"),
    "ink": ("#1c2126", "#e8e6e1"),
    "muted": ("#666d75", "#9aa1a8"),
    "rule": ("#e6e2d9", "#2b3036"),
    "rule2": ("#c9c4b9", "#454c54"),
    "accent": ("#0f766e", "#4fc3b4"),
    "quiet": ("#a9aeb4", "#6b737b"),
    "recorded": ("#8d959e", "#7d8791"),
    "before": ("#cc6a1f", "#f0954a"),
    "after": ("#0f766e", "#4fc3b4"),
    "band": ("#d6d9dc", "#343b42"),
    "hole": ("#d3d6da", "#3c434a"),
    "heat0": ("#faf4e6", "#26231f"),
    "heat1": ("#f8d9a0", "#5d3a26"),
    "heat2": ("#ee9d55", "#a8482a"),
    "heat3": ("#cc4b33", "#e8853d"),
    "heat4": ("#7c1533", "#fde4a8"),
    "onheat": ("#ffffff", "#14171a"),
    "good": ("#0f766e", "#4fc3b4"),
    "part": ("#a86a12", "#e0b04f"),
    "bad": ("#b4432c", "#ee7f66"),
    "tie": ("#6d4fa8", "#b39be6"),
    "none": ("#55606b", "#a3adb7"),
}


def _palette(theme: int) -> str:
    """Return the declarations of the light (0) or dark (1) colours."""
    return " ".join(f"--{name}:{pair[theme]};" for name, pair in COLOURS.items())


_LAYOUT = """
* { box-sizing:border-box; }
html { -webkit-text-size-adjust:100%; }
body { margin:0; background:var(--paper); color:var(--ink); font:15px/1.5 system-ui,-apple-system,
  "Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif; font-variant-numeric:tabular-nums; }
main { max-width:1280px; margin:0 auto; padding:22px 24px 56px; }
.kicker { margin:0; color:var(--muted); font-size:13px; overflow-wrap:anywhere; }
h1 { margin:2px 0 0; font:600 clamp(34px,5.2vw,54px)/1.1 "Iowan Old Style","Palatino Linotype",Palatino,
  Georgia,"Times New Roman",serif; letter-spacing:-.015em; color:var(--tone); }
.meaning { margin:4px 0 18px; color:var(--muted); max-width:88ch; text-wrap:balance; }
h2 { margin:44px 0 12px; font-size:19px; font-weight:650; letter-spacing:-.01em; }
h3 { margin:0; font-size:14px; font-weight:650; }
h3 + .sub { margin:1px 0 6px; }
.sub,.note { color:var(--muted); font-size:13px; margin:0; }
.note { margin-top:8px; }
.answers { display:grid; grid-template-columns:repeat(4,minmax(0,1fr)); gap:0 28px; margin:0;
  border-top:2px solid var(--ink); }
.answers div { padding:10px 0 16px; min-width:0; }
.answers dt { font-size:12.5px; font-weight:650; color:var(--muted); margin:0 0 3px; }
.answers dd { margin:0; overflow-wrap:break-word; }
.lead { display:block; font:600 24px/1.2 "Iowan Old Style","Palatino Linotype",Palatino,Georgia,serif; }
.lead { margin:0 0 5px; text-wrap:balance; } .answers .lead.big { font-size:34px; line-height:1;
  margin-top:-2px; }
.bar { display:block; position:relative; height:6px; margin:8px 0 9px; background:var(--rule);
  border-radius:3px; }
.bar i { position:absolute; top:0; bottom:0; left:0; border-radius:3px; background:var(--tone); }
.bar b { position:absolute; top:-3px; bottom:-3px; border:solid var(--ink); border-width:0 1.5px; }
.first { display:grid; grid-template-columns:minmax(0,1.08fr) minmax(0,1fr) minmax(0,1fr); gap:16px;
  align-items:start; }
figure,.card { margin:0; padding:14px 16px; background:var(--card); border:1px solid var(--rule);
  border-radius:8px; min-width:0; }
.strip { margin-top:16px; }
.traces { display:grid; grid-template-columns:repeat(auto-fit,minmax(280px,1fr)); gap:4px 20px; }
.traces p { margin:6px 0 0; font-size:12.5px; overflow-wrap:anywhere; }
.traces small { color:var(--muted); font-size:inherit; }
.key span { white-space:nowrap; margin-right:12px; }
.key span::before { content:""; display:inline-block; width:16px; height:3px; margin-right:5px;
  vertical-align:middle; border-radius:2px; background:currentColor; }
.recorded { color:var(--recorded); } .nominal { color:var(--before); } .repaired { color:var(--after); }
.noise { color:var(--rule2); }
.scroll { overflow-x:auto; }
.film { display:grid; grid-template-columns:72px repeat(var(--n),minmax(120px,1fr)); gap:5px;
  align-items:center;
  min-width:min-content; }
.film img { width:100%; height:auto; display:block; border-radius:4px; }
.when { font-size:12px; color:var(--muted); text-align:center; }
.who { font-size:13px; font-weight:600; } .who.recorded { color:var(--ink); }
table { border-collapse:collapse; width:100%; font-size:14px; }
th,td { padding:7px 14px 7px 0; text-align:left; border-bottom:1px solid var(--rule);
  vertical-align:top; }
th { font-size:12.5px; font-weight:600; color:var(--muted); white-space:nowrap; }
td.n,th.n { text-align:right; } td.n,th.n,td.u { white-space:nowrap; }
td:last-child,th:last-child { padding-right:0; }
.wrap td { overflow-wrap:anywhere; } .terms td:first-child { white-space:nowrap; }
.wrap th { white-space:normal; width:170px; }
tr.now td { font-weight:600; } tr.now td:first-child { color:var(--tone); }
.two { display:grid; grid-template-columns:minmax(0,1fr) minmax(0,1fr); gap:16px 32px;
  align-items:start; }
.courses figure > h3 { overflow-wrap:anywhere; } .courses { margin-top:8px; }
.file { position:relative; }
.file button { position:absolute; top:8px; right:8px; padding:4px 11px; font:inherit; font-size:13px;
  cursor:pointer;
  color:var(--ink); background:var(--paper); border:1px solid var(--rule2); border-radius:6px; }
.file button:focus-visible,.scroll:focus-visible { outline:2px solid var(--accent); outline-offset:2px; }
.change { margin:0 0 18px; padding:12px 16px; background:var(--card); border:1px solid var(--rule);
  border-left:4px solid var(--tone); border-radius:8px; }
.change ol,.change ul { margin:4px 0 0; padding-left:20px; } .change p { margin:4px 0 0; }
.change li + li { margin-top:6px; } .change small { display:block; color:var(--muted); font-size:13px; }
code { font:13px/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace; overflow-wrap:anywhere; }
.look { display:grid; grid-template-columns:minmax(0,1fr) minmax(0,1.15fr); gap:16px; align-items:start;
  margin-bottom:16px; }
.look .shown { position:sticky; top:12px; }
.chart { position:relative; padding:18px 8px 20px 46px; font-size:11px; line-height:1.2; }
.chart.titled { padding-bottom:36px; } .chart .plot { position:relative; }
.plot svg,.range svg,.gain svg { position:absolute; inset:0; width:100%; height:100%; overflow:visible; }
.yt,.xt,.yl,.xl { position:absolute; white-space:nowrap; color:var(--muted); }
.yt { right:100%; padding-right:6px; transform:translateY(-50%); }
.xt { top:100%; padding-top:4px; transform:translateX(-50%); }
.yl { left:0; top:2px; } .xl { left:46px; right:8px; bottom:2px; text-align:center; }
svg path { vector-effect:non-scaling-stroke; fill:none; }
.grid { stroke:var(--rule); stroke-width:1px; } .line { stroke-width:1.5px; stroke-linejoin:round; }
.line.recorded { stroke:var(--recorded); stroke-width:4px; }
.line.before { stroke:var(--before); } .line.after { stroke:var(--after); }
.dots path { stroke:var(--quiet); stroke-width:8px; stroke-linecap:round; pointer-events:all; }
.dots.many path { stroke-width:5px; } .dots.before path { stroke:var(--before); }
.dots.after path { stroke:var(--after); } .dots.null path { stroke:var(--rule2); stroke-width:6px; }
.dots.named path { stroke:var(--accent); stroke-width:11px; }
.span { stroke:var(--quiet); stroke-width:2px; } .span.named { stroke:var(--accent); }
.rule.zero { stroke:var(--rule2); stroke-width:1px; } svg path.band { fill:var(--band); }
.course p { margin:0; font-size:12px; overflow-wrap:anywhere; } .course .chart { padding-top:6px; }
.heat { font-size:12px; border-collapse:separate; border-spacing:2px; table-layout:fixed; }
.heat td { padding:0; height:18px; text-align:center; border:0; border-radius:2px; font-size:11px; }
.heat th { padding:0 6px 0 0; border:0; font-size:12px; font-weight:400; color:var(--ink); }
.heat thead td,.heat thead th { height:auto; padding:0 0 2px; text-align:center; color:var(--muted); }
.heat thead td { width:38%; } .heat .group th { padding:6px 0 1px; font-weight:650; color:var(--muted); }
.heat tbody tr:not(.group) th { text-align:right; overflow:hidden; text-overflow:ellipsis; }
.heat button { all:unset; cursor:pointer; } .heat button:focus-visible { outline:2px solid var(--accent); }
.pick { cursor:pointer; } .pick:hover th { color:var(--accent); text-decoration:underline; }
.pick.on th { color:var(--accent); font-weight:650; } .pick.on td { outline:2px solid var(--accent); }
.alike tbody tr th { text-align:left !important; white-space:normal; line-height:1.25; }
.alike thead td { width:46%; } .alike .own { background:var(--rule); } .alike td { height:24px; }
.scale { margin:6px 0 0; font-size:11px; color:var(--muted); display:flex; gap:3px; flex-wrap:wrap;
  justify-content:flex-end; }
.scale span { padding:1px 8px; border-radius:2px; } .scale .hole { width:14px; height:14px; }
.hole { background:repeating-linear-gradient(45deg,var(--hole) 0 2px,transparent 2px 5px); }
.h0 { background:var(--heat0); } .h1 { background:color-mix(in oklab,var(--heat0),var(--heat1)); }
.h2 { background:var(--heat1); } .h3 { background:color-mix(in oklab,var(--heat1),var(--heat2)); }
.h4 { background:var(--heat2); } .h5 { background:color-mix(in oklab,var(--heat2),var(--heat3)); }
.h6 { background:var(--heat3); } .h7 { background:color-mix(in oklab,var(--heat3),var(--heat4)); }
.h8 { background:var(--heat4); } .h0,.h1,.h2,.h3,.h4 { color:var(--ink); }
.h5,.h6,.h7,.h8 { color:var(--onheat); }
.rank,.bars { font-size:13px; } .rank td,.rank th,.bars td,.bars th { padding:4px 8px 4px 0; border:0; }
.rank tbody th,.bars th { font-size:13px; font-weight:400; color:var(--ink); white-space:normal; width:44%; }
.rank .named th { font-weight:650; color:var(--accent); } td.gain { position:relative; min-width:90px; }
.rank td.gain { padding:0; } .gain svg { inset:0 10px 0 6px; width:calc(100% - 16px); }
.gain.ticks .xt { top:0; font-size:11px; padding:0; margin-left:6px; } .rank tfoot td { height:18px; }
.bars i { display:block; height:12px; border-radius:2px; min-width:2px; } .bars th { width:84px; }
.bars i.before { background:var(--before); } .bars i.after { background:var(--after); }
.bars i.floor { background:var(--recorded); } .bars .n { width:44px; }
.range { position:relative; display:block; width:110px; height:16px; margin-top:3px; }
.tag { padding:0 6px; border-radius:4px; font-size:12px; color:var(--paper); background:var(--bad); }
pre { margin:0; padding:14px 16px; overflow-x:auto; background:var(--card); border:1px solid var(--rule);
  border-radius:8px; font:13px/1.5 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace; }
@media (max-width:1000px) { .look { grid-template-columns:minmax(0,1fr); } .look .shown { position:static; }
  .first { grid-template-columns:minmax(0,1fr) minmax(0,1fr); }
  .first figure:last-child { grid-column:1/-1; }
  .answers { grid-template-columns:minmax(0,1fr) minmax(0,1fr); } }
@media (max-width:680px) { main { padding:16px 14px 40px; }
  .first,.answers,.two { grid-template-columns:minmax(0,1fr); }
  .answers div { border-bottom:1px solid var(--rule); } .answers { margin-bottom:16px; }
  figure,.card { padding:12px 10px; } .heat:not(.alike) thead th { writing-mode:vertical-rl;
  transform:rotate(180deg); text-align:left; vertical-align:bottom; padding:4px 0 0; }
  .film { grid-template-columns:repeat(var(--n),minmax(128px,1fr)); }
  .film .corner { display:none; } .film .who { grid-column:1/-1; position:sticky; left:0;
  width:max-content; } }
@media print { * { print-color-adjust:exact; -webkit-print-color-adjust:exact; }
  .look { grid-template-columns:1fr 1fr; } .look .shown { position:static; } .change { break-inside:avoid; }
  .look figure { break-inside:auto; } .course,.chart { break-inside:avoid; } .heat td { height:13px; }
  .heat th { font-size:10px; line-height:1.1; }
  main { max-width:none; padding:0; } .file button { display:none; }
  figure,.card,tr,.answers div { break-inside:avoid; } h2 { break-after:avoid; }
  .first { grid-template-columns:1fr 1fr; } .first figure:last-child { grid-column:1/-1; }
  table { font-size:11px; } th,td { padding:4px 8px 4px 0; } th { font-size:10.5px; }
  .scroll { overflow:visible; } .film { grid-template-columns:66px repeat(var(--n),minmax(0,1fr)); }
  body { font-size:12px; } }""".strip()

#: The whole style sheet: the colours of each theme, then the layout.
STYLE = f"""
:root {{ color-scheme: light dark; {_palette(0)} }}
@media (prefers-color-scheme: dark) {{ :root {{ {_palette(1)} }} }}
@media print {{ :root {{ color-scheme: light; {_palette(0)} --paper:#ffffff; }} }}
{_LAYOUT}
""".strip()


#: Draws every Plotly figure in the theme's colours, again when the theme changes or the page is printed.
PLOTLY_SCRIPT = """
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const themed = node => typeof node === "string" ? (node[0] === "@" ? colour(node.slice(1)) : node)
    : Array.isArray(node) ? node.map(themed)
    : node && typeof node === "object"
      ? Object.fromEntries(Object.entries(node).map(([k, v]) => [k, themed(v)])) : node;
  const axis = own => ({ gridcolor: colour("rule"), linecolor: colour("rule2"),
    zerolinecolor: colour("rule"), ...own });
  const draw = () => {
    for (const [id, spec] of Object.entries(figures)) {
      const own = themed(spec.layout);
      const layout = { showlegend: false, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
        font: { family: getComputedStyle(document.body).fontFamily, size: 11, color: colour("ink") },
        hoverlabel: { bgcolor: colour("paper"), bordercolor: colour("rule2"),
          font: { color: colour("ink") } },
        ...own, xaxis: axis(own.xaxis), yaxis: axis(own.yaxis) };
      Plotly.react(id, themed(spec.data), layout, { displayModeBar: false, responsive: true });
    }
  };
  draw();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addEventListener("beforeprint", draw);
  addEventListener("afterprint", draw);
})();
""".strip()


#: Shows the episodes of the element that is clicked in the heat map, and copies effects.yaml.
SCRIPT = """
(() => {
  const rows = document.querySelectorAll("tr.pick"), panels = document.querySelectorAll(".panel");
  const show = (label, move) => {
    panels.forEach(p => { p.hidden = p.dataset.element !== label; });
    rows.forEach(r => { const on = r.dataset.shows === label; r.classList.toggle("on", on);
      r.querySelector("button").setAttribute("aria-pressed", on); });
    const open = document.querySelector(".panel:not([hidden])");
    if (move && open && !matchMedia("(min-width:1001px)").matches)
      open.scrollIntoView({ behavior: "smooth", block: "nearest" });
  };
  rows.forEach(r => r.addEventListener("click", () => show(r.dataset.shows, true)));
  const open = document.querySelector(".panel:not([hidden])");
  if (open) show(open.dataset.element, false);
  const button = document.getElementById("copy");
  const file = document.getElementById("effects-file");
  if (button) button.addEventListener("click", async () => {
    try { await navigator.clipboard.writeText(file.textContent); button.textContent = "Copied"; }
    catch { getSelection().selectAllChildren(file); button.textContent = "Selected: press Ctrl+C"; }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  });
})();
""".strip()
