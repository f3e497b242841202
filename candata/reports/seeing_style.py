"""What pages on datasets add to the style sheet, and the script that turns paths in space."""

from __future__ import annotations

from candata.reports.style import STYLE

#: Name of a colour to its value on a light and on a dark page.
COLOURS = {
    "ax": ("#c2402f", "#ef7a66"),
    "ay": ("#3d7f2e", "#7cc46a"),
    "az": ("#2d62b8", "#7aa7ee"),
    "touch": ("#f6e3c4", "#453622"),
    "touching": ("#c98a2b", "#dca24c"),
    "free": ("#dcdfe2", "#343b42"),
    "onset": ("#ee9d55", "#f0954a"),
    "sustained": ("#0f766e", "#4fc3b4"),
    "release": ("#6d4fa8", "#b39be6"),
}
_LIGHT, _DARK = (" ".join(f"--{name}:{pair[i]};" for name, pair in COLOURS.items()) for i in (0, 1))

_LAYOUT = """
h1 { overflow-wrap:anywhere; } h1 small { font-size:.5em; color:var(--muted); letter-spacing:0; }
.channels td:last-child { min-width:230px; }
.channel { margin:0 0 18px; }
.multiples { display:grid; grid-template-columns:repeat(auto-fill,minmax(172px,1fr)); gap:10px 18px; }
.multiples.wide { grid-template-columns:repeat(auto-fill,minmax(258px,1fr)); }
.multiples > div { min-width:0; break-inside:avoid; }
.multiples p { margin:4px 0 0; font-size:12.5px; overflow-wrap:anywhere; } .multiples p.small { font-size:11.5px; }
.multiples .chart { padding-left:42px; padding-right:14px; } .multiples .xl { left:42px; }
svg path.histo { fill:var(--accent); stroke:none; opacity:.85; }
svg path.histo.this { fill:none; stroke:var(--before); stroke-width:1.8px; opacity:1; }
svg path.histo.against { fill:var(--band); stroke:var(--recorded); stroke-width:1px; opacity:1; }
svg path.touch { fill:var(--touch); } .key-touch { color:var(--touching); }
.line { stroke-linecap:round; }
.line.axis-x,.space .axis-x { stroke:var(--ax); } .key-axis-x { color:var(--ax); }
.line.axis-y,.space .axis-y { stroke:var(--ay); } .key-axis-y { color:var(--ay); }
.line.axis-z,.space .axis-z { stroke:var(--az); } .key-axis-z { color:var(--az); }
.key-after { color:var(--after); } .key-before,.key-this { color:var(--before); }
.key-against { color:var(--recorded); } .key-way { color:var(--quiet); } .key-held { color:var(--touching); }
.named .chart { padding-left:122px; } .named .xl { left:122px; }
.named .yt { max-width:118px; overflow:hidden; text-overflow:ellipsis; padding:1px 6px 1px 0; }
.stroke { stroke-width:12px; } .stroke.touching { stroke:var(--touching); } .stroke.free { stroke:var(--free); }
.stroke.onset { stroke:var(--onset); } .stroke.sustained { stroke:var(--sustained); }
.stroke.release { stroke:var(--release); }
.key-free { color:var(--quiet); } .key-onset { color:var(--onset); } .key-sustained { color:var(--sustained); }
.key-release { color:var(--release); }
.shares { display:flex; height:16px; border-radius:4px; overflow:hidden; margin:6px 0 4px; }
.shares i { display:block; } .shares .free { background:var(--free); } .shares .onset { background:var(--onset); }
.shares .sustained { background:var(--sustained); } .shares .release { background:var(--release); }
.tips { font-size:13px; } .tips th { width:38%; font-weight:400; color:var(--ink); overflow-wrap:anywhere;
  white-space:normal; } .tips th,.tips td { border:0; padding:3px 8px 3px 0; } .tips .n { width:64px; }
.tips i { display:block; height:10px; border-radius:2px; background:var(--touching); min-width:1px; }
.space { display:block; width:100%; max-width:480px; margin:0 auto; touch-action:pan-y; cursor:grab; }
.space path { stroke-width:1.5px; stroke-linecap:round; stroke-linejoin:round; }
.space .floor { stroke:var(--rule2); stroke-width:.8px; } .space .way { stroke:var(--quiet); stroke-width:2px; }
.space .way.contact { stroke:var(--touching); stroke-width:2.6px; }
.space .start { stroke:var(--ink); stroke-width:9px; } .space .end { stroke:var(--after); stroke-width:9px; }
.key-start { color:var(--ink); } .key-end { color:var(--after); }
.space text { font-size:40px; fill:var(--muted); text-anchor:middle; } .space .title { fill:var(--ink); }
.episode { margin:18px 0 30px; } .episode > h3 { font-size:16px; overflow-wrap:anywhere; }
.episode h4 { margin:16px 0 2px; font-size:13.5px; } .pair { display:grid; gap:16px; align-items:start;
  grid-template-columns:minmax(0,1fr) minmax(0,1.6fr); } .pair > div { min-width:0; }
.differs td { font-weight:650; } td.wide { overflow-wrap:anywhere; min-width:130px; }
.rows td { font-size:13px; padding-right:12px; } .rows .weight { min-width:80px; }
.rows .weight i { display:block; height:8px; margin-top:6px; border-radius:2px; background:var(--quiet); }
.rows .differs .weight i { background:var(--before); }
@media (max-width:820px) { .pair { grid-template-columns:minmax(0,1fr); } }
@media (max-width:680px) { .named .chart { padding-left:84px; } .named .xl { left:84px; }
  .named .yt { max-width:82px; } .multiples { grid-template-columns:repeat(auto-fill,minmax(140px,1fr)); }
  .multiples.wide { grid-template-columns:minmax(0,1fr); } }
@media print { .turn { display:none; } .multiples { grid-template-columns:repeat(4,minmax(0,1fr)); }
  .multiples.wide { grid-template-columns:repeat(3,minmax(0,1fr)); } .space { max-width:330px; }
  .episode { break-before:auto; } h4 { break-after:avoid; } }
"""

#: The whole style sheet of a page on datasets.
SEEING_STYLE = f"""{STYLE}
:root {{ {_LIGHT} }}
@media (prefers-color-scheme: dark) {{ :root {{ {_DARK} }} }}
@media print {{ :root {{ {_LIGHT} }} }}
{_LAYOUT.strip()}"""

#: Turns a path in space under the pointer: the projection of `candata.reports.space`, for another direction.
TURN_SCRIPT = """<script>
(() => {
  const rad = Math.PI / 180;
  for (const svg of document.querySelectorAll("svg.space")) {
    let azimuth = +svg.dataset.azimuth, elevation = +svg.dataset.elevation, from = null;
    const parts = [...svg.querySelectorAll("[data-p]")].map(node => [node, node.dataset.p.split(";").map(
      stroke => stroke.split(",").map(point => point.split(" ").map(Number)))]);
    const draw = () => {
      const sa = Math.sin(azimuth * rad), ca = Math.cos(azimuth * rad);
      const se = Math.sin(elevation * rad), ce = Math.cos(elevation * rad);
      const seen = ([x, y, z]) => [Math.round(ca * y - sa * x), Math.round(se * (ca * x + sa * y) - ce * z)];
      for (const [node, strokes] of parts) {
        if (node.tagName === "text") {
          const [x, y] = seen(strokes[0][0]);
          node.setAttribute("x", x); node.setAttribute("y", y);
        } else node.setAttribute("d", strokes.map(stroke => "M" + stroke.map(p => seen(p).join(" ")).join("L")
          + (stroke.length === 1 ? "h0" : "")).join(""));
      }
    };
    svg.addEventListener("pointerdown", e => { from = [e.clientX, e.clientY]; svg.setPointerCapture(e.pointerId); });
    svg.addEventListener("pointermove", e => {
      if (!from) return;
      azimuth -= 0.5 * (e.clientX - from[0]);
      elevation = Math.max(-89, Math.min(89, elevation + 0.5 * (e.clientY - from[1])));
      from = [e.clientX, e.clientY];
      draw();
    });
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { from = null; });
  }
})();
</script>"""
