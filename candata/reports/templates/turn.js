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
