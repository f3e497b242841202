(() => {
  const player = document.getElementById("player");
  if (!player) return;
  const NO_VALUE = -32768, ARROW_M_PER_N = 0.01;
  const part = name => player.querySelector(name);
  const stage = part(".stage"), slider = part(".scrub input"), clock = part("output"), playButton = part(".play");
  const darkScheme = matchMedia("(prefers-color-scheme: dark)");
  let shown = null, time = 0, azimuth = -55, elevation = 22, zoom = 1, playing = false, printing = false, last = 0;

  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
  const numbers = packed => {
    const whole = new Int16Array(bytes(packed.data)), values = new Float32Array(whole.length);
    for (let i = 0; i < whole.length; i++)
      values[i] = whole[i] === NO_VALUE ? NaN : packed.low + packed.step * whole[i];
    return values;
  };
  const colours = () => printing || !darkScheme.matches
    ? { ink: "#1c2126", muted: "#666d75", rule: "#e6e2d9", touch: "#c98a2b", force: "#c2402f", light: 42, axes: ["#c2402f", "#3d7f2e", "#2d62b8"] }
    : { ink: "#e8e6e1", muted: "#9aa1a8", rule: "#2b3036", touch: "#dca24c", force: "#ef7a66", light: 64, axes: ["#ef7a66", "#7cc46a", "#7aa7ee"] };
  const hue = (k, light) => `hsl(${(175 + 137.5 * k) % 360} 60% ${light}%)`;

  const doubleAreas = (vertices, faces) => {
    const areas = new Float32Array(faces.length / 3);
    const side = (from, to) => [0, 1, 2].map(k => vertices[3 * to + k] - vertices[3 * from + k]);
    for (let i = 0; i < areas.length; i++) {
      const [a, b, c] = faces.subarray(3 * i, 3 * i + 3), u = side(a, b), v = side(a, c);
      areas[i] = Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
    }
    return areas;
  };

  const geometries = {};
  const geometry = name => geometries[name] ??= (() => {
    const node = [...document.querySelectorAll("script.geometry")].find(n => n.dataset.name === name);
    const record = JSON.parse(node.textContent);
    for (const body of record.bodies) {
      for (const solid of body.solids) {
        solid.vertices = numbers(solid.vertices);
        solid.faces = new Uint16Array(bytes(solid.faces));
        solid.areas = doubleAreas(solid.vertices, solid.faces);
      }
      if (body.points) body.points = numbers(body.points);
    }
    return record;
  })();

  const turned = (q, x, y, z) => {
    const [w, a, b, c] = q, tx = 2 * (b * z - c * y), ty = 2 * (c * x - a * z), tz = 2 * (a * y - b * x);
    return [x + w * tx + b * tz - c * ty, y + w * ty + c * tx - a * tz, z + w * tz + a * ty - b * tx];
  };

  /* Where body number b is at the time shown: place and unit quaternion, between two frames. */
  const pose = (frames, count, b) => {
    let k = frames.time.findIndex(t => t > time);
    k = k < 0 ? frames.time.length - 1 : Math.max(k - 1, 0);
    const next = Math.min(k + 1, frames.time.length - 1), step = frames.time[next] - frames.time[k];
    const share = step > 0 ? Math.min(Math.max((time - frames.time[k]) / step, 0), 1) : 0;
    const at = (values, size, frame) => values.subarray((frame * count + b) * size, (frame * count + b + 1) * size);
    const p0 = at(frames.position, 3, k), p1 = at(frames.position, 3, next);
    const q0 = at(frames.quaternion, 4, k), q1 = at(frames.quaternion, 4, next);
    const sign = q0[0] * q1[0] + q0[1] * q1[1] + q0[2] * q1[2] + q0[3] * q1[3] < 0 ? -1 : 1;
    const q = [0, 1, 2, 3].map(i => q0[i] * (1 - share) + sign * q1[i] * share), norm = Math.hypot(...q) || 1;
    return { p: [0, 1, 2].map(i => p0[i] * (1 - share) + p1[i] * share), q: q.map(v => v / norm), frame: k };
  };

  const fit = canvas => {
    const ratio = devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    const width = Math.max(Math.round(box.width), 1), height = Math.max(Math.round(box.height), 1);
    if (canvas.width !== width * ratio || canvas.height !== height * ratio) {
      canvas.width = width * ratio; canvas.height = height * ratio;
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    return [pen, width, height];
  };

  const camera = (frames, width, height) => {
    const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
    const sa = Math.sin(a), ca = Math.cos(a), se = Math.sin(e), ce = Math.cos(e);
    const distance = 4 * frames.radius, scale = zoom * 0.46 * Math.min(width, height) / frames.radius;
    const [cx, cy, cz] = frames.centre;
    const scaleAt = depth => scale * distance / Math.max(distance - depth, 0.1 * distance);
    const seen = (x, y, z) => {
      x -= cx; y -= cy; z -= cz;
      const right = ca * y - sa * x, out = ca * x + sa * y, depth = ce * out + se * z, up = ce * z - se * out;
      const s = scaleAt(depth);
      return [width / 2 + s * right, height / 2 - s * up, depth];
    };
    seen.scaleAt = scaleAt;
    return seen;
  };

  const drawStage = () => {
    const frames = shown.frames;
    if (!frames) return;
    const [pen, width, height] = fit(stage), ink = colours();
    const seen = camera(frames, width, height), bodies = geometry(shown.geometry).bodies;
    const still = [], moving = [];
    bodies.forEach((body, b) => {
      const { p, q } = pose(frames, bodies.length, b);
      const place = (x, y, z) => { const v = turned(q, x, y, z); return seen(v[0] + p[0], v[1] + p[1], v[2] + p[2]); };
      for (const solid of body.solids) {
        const points = [];
        for (let i = 0; i < solid.vertices.length; i += 3)
          points.push(place(solid.vertices[i], solid.vertices[i + 1], solid.vertices[i + 2]));
        for (let i = 0; i < solid.faces.length; i += 3) {
          const [u, v, w] = [points[solid.faces[i]], points[solid.faces[i + 1]], points[solid.faces[i + 2]]];
          const area = (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0]);
          if (solid.closed && area >= 0) continue;
          const depth = (u[2] + v[2] + w[2]) / 3, scale = seen.scaleAt(depth);
          const facing = Math.min(Math.abs(area) / (solid.areas[i / 3] * scale * scale || 1), 1);
          (body.still ? still : moving).push([depth, [u, v, w], solid.colour, 0.55 + 0.45 * facing]);
        }
      }
      if (body.points) {
        pen.fillStyle = ink.touch;
        for (let i = 0; i < body.points.length; i += 3) {
          const [x, y] = place(body.points[i], body.points[i + 1], body.points[i + 2]);
          pen.fillRect(x - 1, y - 1, 2, 2);
        }
      }
      if (body.axes) [0, 1, 2].forEach(k => {
        const start = place(0, 0, 0), end = place(...[0, 1, 2].map(i => i === k ? 0.4 * frames.radius : 0));
        stroke(pen, [start, end], ink.axes[k], 2);
      });
    });
    for (const triangles of [still, moving]) {
      triangles.sort((a, b) => a[0] - b[0]);
      for (const [, [u, v, w], [r, g, b, opacity], light] of triangles) {
        pen.globalAlpha = opacity;
        pen.fillStyle = pen.strokeStyle = `rgb(${[r, g, b].map(c => Math.round(255 * c * light)).join(" ")})`;
        pen.beginPath(); pen.moveTo(u[0], u[1]); pen.lineTo(v[0], v[1]); pen.lineTo(w[0], w[1]); pen.closePath();
        pen.fill();
        if (opacity === 1) { pen.lineWidth = 0.6; pen.stroke(); }
      }
      pen.globalAlpha = 1;
    }
    drawForces(pen, frames, seen, ink);
  };

  const stroke = (pen, points, colour, width) => {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.beginPath();
    points.forEach(([x, y], i) => i ? pen.lineTo(x, y) : pen.moveTo(x, y));
    pen.stroke();
  };

  const drawForces = (pen, frames, seen, ink) => {
    const { frame } = pose(frames, 1, 0), count = frames.tips.length / 3 / frames.time.length;
    for (let i = 3 * frame * count; i < 3 * (frame + 1) * count; i += 3) {
      const tip = frames.tips.subarray(i, i + 3), force = frames.forces.subarray(i, i + 3);
      if (![...tip, ...force].every(Number.isFinite) || Math.hypot(...force) < 0.05) continue;
      const end = [0, 1, 2].map(k => tip[k] + ARROW_M_PER_N * force[k]);
      stroke(pen, [seen(...tip), seen(...end)], ink.force, 2.2);
      const [x, y] = seen(...end);
      pen.fillStyle = ink.force; pen.beginPath(); pen.arc(x, y, 3, 0, 7); pen.fill();
    }
  };

  const PAD = { left: 54, right: 8, top: 6, bottom: 16 };
  const across = (t, width) => PAD.left + (width - PAD.left - PAD.right) * (shown.end > 0 ? t / shown.end : 0);
  const short = v => Math.abs(v) >= 1000 || (v && Math.abs(v) < 0.001) ? v.toExponential(1) : String(+v.toPrecision(3));

  const drawLane = lane => {
    const [pen, width, height] = fit(lane.canvas), ink = colours();
    pen.font = "11px system-ui"; pen.fillStyle = ink.muted;
    const bottom = height - PAD.bottom;
    if (lane.spans) {
      const step = (bottom - PAD.top) / lane.spans.length;
      lane.spans.forEach((tip, k) => {
        pen.fillStyle = ink.muted; pen.textAlign = "right";
        pen.fillText(k + 1, PAD.left - 6, PAD.top + step * (k + 0.5) + 4);
        pen.fillStyle = ink.touch;
        for (const [a, b] of tip.spans)
          pen.fillRect(across(a, width), PAD.top + step * (k + 0.15), Math.max(across(b, width) - across(a, width), 1), 0.7 * step);
      });
    } else {
      const span = lane.high - lane.low || 1, y = v => bottom - (bottom - PAD.top) * (v - lane.low) / span;
      pen.textAlign = "right";
      for (const v of [lane.low, (lane.low + lane.high) / 2, lane.high]) {
        stroke(pen, [[PAD.left, y(v)], [width - PAD.right, y(v)]], ink.rule, 1);
        pen.fillText(short(Math.abs(v) < 1e-6 * span ? 0 : v), PAD.left - 5, y(v) + 4);
      }
      for (const line of lane.lines) {
        pen.setLineDash(line.command ? [4, 3] : []);
        pen.strokeStyle = hue(line.hue, ink.light); pen.lineWidth = line.command ? 1 : 1.4; pen.beginPath();
        let broken = true;
        line.values.forEach((v, i) => {
          if (Number.isNaN(v)) { broken = true; return; }
          pen[broken ? "moveTo" : "lineTo"](across(lane.time[i], width), y(v)); broken = false;
        });
        pen.stroke();
      }
      pen.setLineDash([]);
    }
    pen.fillStyle = ink.muted;
    pen.textAlign = "left"; pen.fillText("0", PAD.left, height - 3);
    pen.textAlign = "right"; pen.fillText(`${short(shown.end)} s`, width - PAD.right, height - 3);
    stroke(pen, [[across(time, width), PAD.top], [across(time, width), bottom]], ink.ink, 1);
    lane.legend.forEach(([node, line]) => { node.textContent = valueText(lane, line); });
  };

  const valueText = (lane, line) => {
    if (line.spans) return line.spans.some(([a, b]) => a <= time && time < b) ? "touches" : "";
    let k = lane.time.findIndex(t => t > time);
    k = k < 0 ? lane.time.length - 1 : Math.max(k - 1, 0);
    const value = line.values[k], span = lane.high - lane.low;
    return Number.isFinite(value) ? short(Math.abs(value) < 1e-6 * span ? 0 : value) : "";
  };

  const makeLane = (title, unit) => {
    const lane = document.createElement("div"), heading = document.createElement("p");
    const canvas = document.createElement("canvas"), legend = document.createElement("div");
    lane.className = "lane"; legend.className = "legend";
    heading.textContent = unit ? `${title} [${unit}]` : title;
    canvas.setAttribute("role", "img"); canvas.setAttribute("aria-label", `${title} over time`);
    lane.append(heading, canvas, legend);
    part(".lanes").append(lane);
    const seek = e => {
      const box = canvas.getBoundingClientRect();
      const share = (e.clientX - box.left - PAD.left) / (box.width - PAD.left - PAD.right);
      show(Math.min(Math.max(share, 0), 1) * shown.end);
    };
    canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); seek(e); });
    canvas.addEventListener("pointermove", e => { if (e.buttons) seek(e); });
    return { canvas, legend: [], box: legend };
  };

  const entry = (lane, name, line, colour) => {
    const span = document.createElement("span"), value = document.createElement("b");
    span.style.setProperty("--line", colour);
    span.append(`${name} `, value);
    lane.box.append(span);
    lane.legend.push([value, line]);
  };

  const prepareLanes = () => {
    part(".lanes").replaceChildren();
    shown.drawn = shown.lanes.map(record => {
      const lane = { ...record, ...makeLane(record.title, record.unit) }, names = [];
      lane.low = Infinity; lane.high = -Infinity;
      for (const line of lane.lines) {
        line.values = numbers(line);
        if (!names.includes(line.name)) names.push(line.name);
        line.hue = names.indexOf(line.name);
        for (const v of line.values) if (!Number.isNaN(v)) { lane.low = Math.min(lane.low, v); lane.high = Math.max(lane.high, v); }
        if (!line.command) entry(lane, line.name, line, hue(line.hue, 50));
      }
      if (lane.low > lane.high) lane.low = lane.high = 0;
      lane.canvas.classList.toggle("tall", names.length > 6);
      return lane;
    });
    if (!shown.touch.length) return;
    const lane = { spans: shown.touch, ...makeLane("contact", "") };
    lane.canvas.style.height = `${22 + 16 * shown.touch.length}px`;
    shown.touch.forEach((tip, k) => entry(lane, `${k + 1}. ${tip.name}`, tip, "var(--touching)"));
    shown.drawn.push(lane);
  };

  const draw = () => { drawStage(); shown.drawn.forEach(drawLane); };
  const show = t => {
    time = t;
    slider.value = t;
    clock.textContent = `${t.toFixed(2)} s`;
    draw();
  };

  const open = number => {
    const node = document.querySelector(`script.playback[data-number="${number}"]`);
    if (!node) return;
    shown = JSON.parse(node.textContent);
    if (shown.frames) for (const name of ["position", "quaternion", "tips", "forces"]) shown.frames[name] = numbers(shown.frames[name]);
    const row = document.querySelector(`[data-open="${number}"]`);
    document.querySelectorAll(".episodes tr.open").forEach(r => r.classList.remove("open"));
    row?.closest("tr").classList.add("open");
    player.hidden = false;
    player.classList.toggle("flat", !shown.frames);
    part(".player-name").textContent = shown.id;
    part(".player-facts").textContent = shown.facts;
    part(".player-notes").replaceChildren(...shown.notes.map(text => Object.assign(document.createElement("li"), { textContent: text })));
    slider.max = shown.end || 1;
    zoom = 1;
    stop();
    prepareLanes();
    show(0);
  };

  const stop = () => { playing = false; playButton.textContent = "Play"; };
  const tick = now => {
    if (!playing) return;
    const t = time + (now - last) / 1000;
    last = now;
    show(Math.min(t, shown.end));
    if (t >= shown.end) stop(); else requestAnimationFrame(tick);
  };
  playButton.addEventListener("click", () => {
    if (playing) { stop(); return; }
    playing = true; playButton.textContent = "Pause"; last = performance.now();
    if (time >= shown.end) time = 0;
    requestAnimationFrame(tick);
  });
  slider.addEventListener("input", () => { stop(); show(+slider.value); });
  let from = null;
  stage.addEventListener("pointerdown", e => { from = [e.clientX, e.clientY]; stage.setPointerCapture(e.pointerId); });
  stage.addEventListener("pointermove", e => {
    if (!from) return;
    azimuth -= 0.5 * (e.clientX - from[0]);
    elevation = Math.max(-89, Math.min(89, elevation + 0.5 * (e.clientY - from[1])));
    from = [e.clientX, e.clientY];
    drawStage();
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { from = null; });
  player.querySelectorAll("[data-zoom]").forEach(button => button.addEventListener("click", () => {
    zoom = Math.max(0.3, Math.min(8, zoom * +button.dataset.zoom));
    drawStage();
  }));
  const redraw = () => { if (shown) draw(); };
  addEventListener("resize", redraw);
  darkScheme.addEventListener("change", redraw);
  addEventListener("beforeprint", () => { printing = true; redraw(); });
  addEventListener("afterprint", () => { printing = false; redraw(); });

  document.querySelectorAll("[data-open]").forEach(button => button.addEventListener("click", () => {
    open(button.dataset.open);
    player.scrollIntoView({ block: "nearest" });
  }));
  const first = document.querySelector("script.playback");
  if (first) open(first.dataset.number);
})();
