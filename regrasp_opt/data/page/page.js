"use strict";
// Draws the scene that the page holds: WebGL without any library. Matrices are column-major Float32Arrays of 16.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const element = (id) => document.getElementById(id);
  const canvas = element("canvas");
  const gl = canvas.getContext("webgl", { antialias: true, alpha: true, stencil: true });
  if (!gl) { element("failed").style.display = "block"; return; }

  // ---- numbers
  const decode = (text, Kind) => new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
  const product = (a, b) => {
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++)
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    return out;
  };
  const matrix = (p) => {
    const [x, y, z, w] = [p[3], p[4], p[5], p[6]];
    return new Float32Array([
      1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
      2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
      2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0, p[0], p[1], p[2], 1]);
  };
  const identity = matrix([0, 0, 0, 0, 0, 0, 1]);
  const perspective = (angle, aspect, near, far) => {
    const f = Math.min(1, aspect) / Math.tan(angle / 2); // a narrow window sees as far to the sides as a square one
    return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
      0, 0, 2 * far * near / (near - far), 0]);
  };
  const lookAt = (eye, target) => {
    const z = unit(minus(eye, target)), x = unit(cross([0, 0, 1], z)), y = cross(z, x);
    return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0,
      -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);
  };

  // ---- meshes
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  function upload(mesh) {
    const v = decode(mesh.vertices, Float32Array), f = decode(mesh.faces, Uint32Array);
    const n = new Float32Array(v.length);
    for (let k = 0; k < f.length; k += 3) {
      const [a, b, c] = [f[k], f[k + 1], f[k + 2]].map((i) => [v[3 * i], v[3 * i + 1], v[3 * i + 2]]);
      const normal = cross(minus(b, a), minus(c, a));
      for (let j = 0; j < 3; j++) for (let d = 0; d < 3; d++) n[3 * f[k + j] + d] += normal[d];
    }
    return make(v, n, f, mesh.colours && Float32Array.from(decode(mesh.colours, Uint8Array), (c) => c / 255));
  }
  gl.getExtension("OES_element_index_uint");
  function make(vertices, normals, faces, colours) {
    const store = (kind, data) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(kind, buffer);
      gl.bufferData(kind, data, gl.STATIC_DRAW);
      return buffer;
    };
    return { vertices: store(gl.ARRAY_BUFFER, vertices), normals: store(gl.ARRAY_BUFFER, normals),
      colours: colours && store(gl.ARRAY_BUFFER, colours), faces: store(gl.ELEMENT_ARRAY_BUFFER, faces),
      count: faces.length };
  }

  // ---- program
  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 position, normal, colour; uniform mat4 view, model, flatten; varying vec3 n, c, p;
    void main() { vec4 world = flatten * (model * vec4(position, 1.0)); p = world.xyz / world.w; c = colour;
      n = mat3(model) * normal; gl_Position = view * vec4(p, 1.0); }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float; varying vec3 n, c, p; uniform vec3 eye; uniform float opacity, lit;
    void main() {
      vec3 N = normalize(n), V = normalize(eye - p), L = normalize(vec3(0.45, 0.55, 1.0));
      if (dot(N, V) < 0.0) N = -N;
      vec3 base = pow(c, vec3(2.2));
      float sky = 0.5 + 0.5 * N.z, fill = max(dot(N, normalize(vec3(-0.8, 0.3, 0.3))), 0.0);
      vec3 light = mix(vec3(0.26, 0.25, 0.24), vec3(0.47, 0.49, 0.52), sky) + 0.66 * max(dot(N, L), 0.0) + 0.14 * fill;
      vec3 shown = base * light + 0.16 * pow(max(dot(N, normalize(L + V)), 0.0), 40.0);
      shown = pow(mix(base, shown, lit), vec3(1.0 / 2.2));
      gl_FragColor = vec4(shown * opacity, opacity); }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = {}, uniform = {};
  for (const name of ["position", "normal", "colour"]) at[name] = gl.getAttribLocation(program, name);
  for (const name of ["view", "model", "flatten", "eye", "opacity", "lit"])
    uniform[name] = gl.getUniformLocation(program, name);

  function draw(mesh, model, colour, opacity = 1, lit = 1, first = 0, count = mesh.count) {
    const attribute = (location, buffer) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
    };
    attribute(at.position, mesh.vertices);
    attribute(at.normal, mesh.normals);
    if (mesh.colours) attribute(at.colour, mesh.colours);
    else { gl.disableVertexAttribArray(at.colour); gl.vertexAttrib3fv(at.colour, colour); }
    gl.uniformMatrix4fv(uniform.model, false, model);
    gl.uniform1f(uniform.opacity, opacity);
    gl.uniform1f(uniform.lit, lit);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.faces);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 4 * first);
  }

  // ---- what the scene holds
  const meshes = scene.meshes.map(upload);
  const parts = scene.parts.map((part) => ({ ...part, mesh: meshes[part.mesh], rgb: rgb(part.colour) }));
  const objectPoints = decode(scene.meshes[scene.object].vertices, Float32Array);
  const top = (pose) => { // the point above its middle, at its highest [m]
    const m = matrix(pose), low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let k = 0; k < objectPoints.length; k += 3) for (let d = 0; d < 3; d++) {
      const x = m[d] * objectPoints[k] + m[4 + d] * objectPoints[k + 1] + m[8 + d] * objectPoints[k + 2] + m[12 + d];
      low[d] = Math.min(low[d], x);
      high[d] = Math.max(high[d], x);
    }
    return [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]];
  };
  const ghosts = scene.ghosts.map((g) => {
    const tag = document.createElement("div");
    tag.className = "tag";
    tag.textContent = g.name;
    element("tags").append(tag);
    return { ...g, rgb: rgb(g.colour), opacity: 0.5, top: top(g.pose), tag };
  });
  const fields = scene.fields.map((field) => ({ ...field, mesh: upload(field.mesh) }));
  const candidates = scene.candidates && { ...scene.candidates, trail: upload(scene.candidates.trail),
    poses: decode(scene.candidates.poses, Float32Array), colours: decode(scene.candidates.colours, Uint8Array) };
  const states = decode(scene.states, Float32Array), bodies = scene.bodies;
  const bodyPose = (state, body) => states.subarray(7 * (state * bodies + body), 7 * (state * bodies + body) + 7);
  const camera = { target: scene.target.slice() };
  const away = minus(scene.eye, scene.target);
  camera.distance = Math.hypot(...away);
  camera.turn = Math.atan2(away[1], away[0]);
  camera.rise = Math.asin(away[2] / camera.distance);
  const chosen = scene.grasps.map((g) => g.best);
  let step = 0, playing = false, pending = false, projection = identity;

  const moves = scene.seconds !== null;
  const stateOf = (k) => {
    const { transition, state } = scene.steps[k];
    if (moves || transition < 0) return state;
    const g = scene.grasps[transition];
    return g.first_state + 2 * chosen[transition] + (state - g.first_state) % 2;
  };
  const eyeOf = () => {
    const flat = Math.cos(camera.rise) * camera.distance;
    return [camera.target[0] + flat * Math.cos(camera.turn), camera.target[1] + flat * Math.sin(camera.turn),
      camera.target[2] + Math.sin(camera.rise) * camera.distance];
  };
  const same = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) < 2e-3 &&
    Math.abs(a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]) > 0.9999;
  const shadow = () => { // along the light, onto the table
    const h = scene.table_height + 0.0012, [x, y] = [0.45, 0.55];
    return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, -x, -y, 0, 0, x * h, y * h, h, 1]);
  };
  const causesHere = () => element("causes").checked && scene.causes[scene.steps[step].pose] || null;
  const bytes = (colour) => rgb(colour).map((c) => 255 * c);
  const marksShown = () => {
    const causes = causesHere();
    if (causes) return causes.of_grasp.map((c, id) => ({ id, k: id, colour: bytes(causes.legend[c][1]) }));
    const g = scene.grasps[scene.steps[step].transition];
    return element("marks").checked && g ? g.ids.map((id, k) => ({ id, k, colour: g.colours[k] })) : [];
  };
  const TAIL = 5, red = rgb(scene.chosen);
  const candidatesShown = () => candidates !== null && element("candidates").checked;
  const frame = () => Number(element("iteration").value);
  function* candidateGhosts() { // the accepted one first
    const { count, length, poses, colours, accepted } = candidates;
    const order = [...Array(count).keys()].sort((a, b) => (b === accepted) - (a === accepted));
    for (const b of order) for (let i = 0; i < length; i++) {
      const at = 7 * ((frame() * count + b) * length + i), c = 3 * (frame() * count + b);
      yield { pose: poses.subarray(at, at + 7), opacity: b === accepted ? 0.75 : 0.5,
        rgb: b === accepted ? red : [0, 1, 2].map((k) => colours[c + k] / 255) };
    }
  }
  function drawGhosts(shown, drawn) { // of several at one place only the first, and of each only what is nearest
    gl.enable(gl.BLEND);
    for (const { pose, rgb, opacity } of shown) {
      if (drawn.some((other) => same(pose, other))) continue;
      drawn.push(pose);
      gl.colorMask(false, false, false, false);
      draw(meshes[scene.object], matrix(pose), rgb);
      gl.colorMask(true, true, true, true);
      draw(meshes[scene.object], matrix(pose), rgb, opacity);
    }
    gl.disable(gl.BLEND);
  }
  function drawTrail() { // the last steps
    const { trail, count, length } = candidates, each = 6 * count * length, from = Math.max(0, frame() - TAIL);
    if (frame() > 0) draw(trail, identity, null, 0.6, 0, each * from, each * (frame() - from));
  }
  const markMatrix = (id) =>
    product(matrix(bodyPose(stateOf(step), bodies - 1)), matrix(scene.marks[id]));

  function render() {
    pending = false;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio].map(Math.round);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    const eye = eyeOf();
    projection = product(perspective(0.6, width / Math.max(height, 1), 0.05, 20), lookAt(eye, camera.target));
    gl.uniformMatrix4fv(uniform.view, false, projection);
    gl.uniformMatrix4fv(uniform.flatten, false, identity);
    gl.uniform3fv(uniform.eye, eye);
    const state = stateOf(step);
    const pose = (part) => part.body < 0 ? identity : matrix(bodyPose(state, part.body));
    const table = parts.filter((part) => part.name === "table");
    const others = parts.filter((part) => part.name !== "table");
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.ALWAYS, 1, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.REPLACE);
    for (const part of table) draw(part.mesh, pose(part), part.rgb);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const field = fields[Number(element("field").value)];
    if (field) draw(field.mesh, identity, null, 0.62, 0.25);
    if (candidatesShown()) drawTrail();
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 1, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.uniformMatrix4fv(uniform.flatten, false, shadow());
    gl.depthMask(false);
    for (const part of others) if (part.body >= 0) draw(part.mesh, pose(part), [0.1, 0.13, 0.18], 0.22, 0);
    gl.depthMask(true);
    gl.uniformMatrix4fv(uniform.flatten, false, identity);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);
    for (const part of others) draw(part.mesh, pose(part), part.rgb);
    for (const { id, k, colour } of marksShown()) {
      const picked = !causesHere() && chosen[scene.steps[step].transition] === k;
      draw(meshes[scene.mark], markMatrix(id), picked ? red : colour.map((c) => c / 255));
    }
    const drawn = [bodyPose(state, bodies - 1)];
    if (candidatesShown()) drawGhosts(candidateGhosts(), drawn);
    if (element("ghosts").checked) drawGhosts(ghosts, drawn);
    placeTags();
  }
  const corners = [0, 1].flatMap((x) => [0, 1].flatMap((y) => [0, 1].map((z) => [x, y, z])));
  const ends = [0, 1, 2].map((d) => { // of what marks a grasp
    const all = decode(scene.meshes[scene.mark].vertices, Float32Array).filter((_, k) => k % 3 === d);
    return [Math.min(...all), Math.max(...all)];
  });
  function markBox(id) { // the rectangle around the mark of a grasp on the screen [px]
    const m = markMatrix(id), at = corners.map((c) => {
      const [x, y, z] = c.map((side, d) => ends[d][side]);
      return onScreen([0, 1, 2].map((r) => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r]));
    });
    const [xs, ys] = [0, 1].map((d) => at.map((p) => p[d]));
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }
  const boxOf = (id) => { const r = element(id).getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; };
  const heights = [...Array(50).keys()].map((k) => 8 + 10 * k); // of labels above what they name, then below it [px]
  heights.push(...heights.map((h) => -30 - h));
  function placeTags() { // where they hide no grasp, no panel and no other label; nowhere if there is no such place
    const taken = [...marksShown().map(({ id }) => markBox(id)), boxOf("head"), boxOf("bar")];
    for (const { tag, top } of ghosts) {
      tag.hidden = !element("ghosts").checked;
      if (tag.hidden) continue;
      const [x, y] = onScreen(top), [w, h] = [tag.offsetWidth, tag.offsetHeight];
      const up = heights.find((up) => y - up - h >= 0 && y - up <= canvas.clientHeight && !taken.some(
        (box) => x - w / 2 < box[2] && box[0] < x + w / 2 && y - up - h < box[3] && box[1] < y - up));
      tag.hidden = up === undefined;
      if (tag.hidden) continue;
      taken.push([x - w / 2, y - up - h, x + w / 2, y - up]);
      tag.style.left = `${x - w / 2}px`;
      tag.style.top = `${y - up - h}px`;
      tag.style.setProperty("--line", `${Math.max(up, 0)}px`);
    }
  }
  const redraw = () => { if (!pending) { pending = true; requestAnimationFrame(render); } };

  // ---- panel
  const number = (x, digits) => x === null ? "-" : x.toFixed(digits);
  function show(k) {
    step = Math.min(Math.max(Math.round(k), 0), scene.steps.length - 1);
    element("slider").value = step;
    const { label, transition } = scene.steps[step];
    const time = moves ? `${(scene.seconds * step / Math.max(scene.steps.length - 1, 1)).toFixed(1)} s, ` : "";
    element("label").textContent = time + label;
    const g = scene.grasps[transition];
    element("info").textContent = g ? describe(g, chosen[transition]) : "";
    const field = fields[Number(element("field").value)];
    const energies = g && g.energies[0] !== null;
    const costs = field ? [field.low, field.high] : candidatesShown() ? candidates.ends : null;
    element("what").textContent = costs ? "connectivity cost J_seq (low: more shared grasps)"
      : energies ? "grasps by learned energy (low: the model is sure of them)" : "grasps by clearance [mm]";
    const ends = costs ? costs : g ? g.ends : [null, null];
    [element("low").textContent, element("high").textContent] = ends.map((x) => x === null ? "-" : String(Number(x.toFixed(3))));
    const causes = causesHere();
    for (const id of ["what", "scale", "ends"]) element(id).hidden = !(g && !causes || costs);
    element("causekeys").replaceChildren(...(causes ? causes.legend : []).filter(([, , count]) => count)
      .map(([name, colour, count]) => key(`${count} ${name}`, [colour])));
    if (causes) element("info").textContent = "Click or tap a grasp.";
    if (candidates) element("stage").textContent = candidates.labels[frame()];
    redraw();
  }
  const describe = (g, k) => `grasp ${g.ids[k]}, one of ${g.ids.length} shared: energy ${number(g.energies[k], 3)}, ` +
    `clearance ${number(1e3 * g.clearance[k], 1)} mm.${moves ? "" : " Click or tap another."}`;
  const key = (name, colours, opacity = 1) => {
    const key = document.createElement("span");
    key.className = "key";
    for (const colour of colours) {
      const patch = document.createElement("i");
      Object.assign(patch.style, { background: colour, opacity });
      key.append(patch);
    }
    key.append(name);
    return key;
  };
  scene.stops.forEach(({ name, support, first, last }) => { // a bar while the object rests there, and its name
    const bar = document.createElement("i"), label = document.createElement("button");
    const along = (step) => 100 * step / Math.max(scene.steps.length - 1, 1), middle = along((first + last) / 2);
    Object.assign(bar.style, { background: ghosts.find((g) => g.name === name).colour, left: `${along(first)}%`,
      width: `calc(${along(last - first)}% + 8px)` });
    Object.assign(label.style, { left: `${middle}%`, transform: `translateX(-${middle}%)`,
      maxWidth: `${100 / scene.stops.length}%` });
    label.append(name, document.createElement("br"), support);
    label.title = support ? `${name}, on ${support}` : name;
    label.addEventListener("click", () => { playing = false; caption(); show(first); });
    element("stops").append(bar, label);
  });
  function choose(transition, k) { chosen[transition] = k; show(step); }
  element("title").textContent = scene.title;
  element("subtitle").textContent = scene.subtitle;
  element("scale").style.background = `linear-gradient(90deg, ${scene.scale.join(",")})`;
  element("keys").append(...scene.legend.map(({ name, colours, opacity }) => key(name, colours, opacity)));
  element("more").open = window.innerWidth > 560 && window.innerHeight > 400;
  element("more").addEventListener("toggle", redraw);
  element("markline").hidden = scene.grasps.length === 0;
  element("causeline").hidden = scene.causes.length === 0;
  element("causes").checked = scene.causes.length > 0 && scene.grasps.length === 0;
  fields.forEach((field, k) => element("field").append(new Option(`of pose ${field.number}`, k)));
  element("fieldline").hidden = fields.length === 0;
  element("slider").max = scene.steps.length - 1;
  element("slider").addEventListener("input", (event) => { playing = false; caption(); show(Number(event.target.value)); });
  for (const id of ["ghosts", "marks", "causes", "field", "candidates"]) element(id).addEventListener("change", () => show(step));
  if (candidates) {
    element("candidateline").hidden = false;
    element("iteration").max = candidates.labels.length - 1;
    element("iteration").addEventListener("input", () => show(step));
  }
  const caption = () => { element("play").textContent = playing ? "Pause" : "Play"; };
  element("play").addEventListener("click", () => {
    playing = !playing;
    caption();
    if (!playing) return;
    const last = scene.steps.length - 1, from = step >= last ? 0 : step;
    const rate = moves ? last / scene.seconds : 0.8, began = performance.now();
    const tick = (now) => {
      if (!playing) return;
      const k = from + rate * (now - began) / 1000;
      show(Math.floor(k));
      if (k >= last) { playing = false; caption(); } else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  });

  // ---- pointer: drag turns, with the right button, shift or two fingers it shifts, wheel and pinch zoom, a click or tap
  // chooses a grasp
  const pointers = new Map(); // where each finger is
  let touched = null, shifts = false;
  const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
  const zoom = (factor) => { camera.distance = Math.min(6, Math.max(0.2, camera.distance * factor)); };
  const shift = (dx, dy) => {
    const gain = camera.distance / Math.min(canvas.clientHeight, canvas.clientWidth) * 0.62;
    const [c, s] = [Math.cos(camera.turn), Math.sin(camera.turn)];
    camera.target[0] += gain * (s * dx - c * dy);
    camera.target[1] += gain * (-c * dx - s * dy);
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    touched = pointers.size === 1 ? [event.clientX, event.clientY] : null;
    shifts = event.button || event.shiftKey;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId), now = [event.clientX, event.clientY];
    if (!before) return;
    pointers.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    const other = [...pointers].find(([id]) => id !== event.pointerId);
    if (other) {
      zoom(apart(before, other[1]) / Math.max(apart(now, other[1]), 1));
      shift(dx / 2, dy / 2);
    } else if (shifts) shift(dx, dy);
    else {
      camera.turn -= dx * 0.006;
      camera.rise = Math.min(1.55, Math.max(-0.2, camera.rise + dy * 0.006));
    }
    redraw();
  });
  canvas.addEventListener("pointerup", (event) => {
    const at = [event.clientX, event.clientY], still = touched && apart(at, touched) < (event.pointerType === "mouse" ? 4 : 10);
    pointers.delete(event.pointerId);
    touched = null;
    if (still && !moves) pick(...at);
  });
  canvas.addEventListener("pointercancel", (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY * 0.001));
    redraw();
  }, { passive: false });
  window.addEventListener("resize", redraw);
  function screen(id) { // where the palm of a grasp's mark is on the screen [px]
    const m = markMatrix(id);
    return onScreen([0, 1, 2].map((d) => m[12 + d] - 0.03 * m[8 + d]));
  }
  function onScreen(p) { // where a point is on the screen [px]
    const [x, y, w] = [0, 1, 3].map((r) => projection[r] * p[0] + projection[4 + r] * p[1] + projection[8 + r] * p[2] +
      projection[12 + r]);
    return [(x / w + 1) / 2 * canvas.clientWidth, (1 - y / w) / 2 * canvas.clientHeight];
  }
  function pick(x, y) {
    const near = marksShown().map(({ id, k }) => {
      const [a, b] = screen(id);
      return { k, distance: Math.hypot(a - x, b - y) };
    }).sort((a, b) => a.distance - b.distance)[0];
    if (!near || near.distance >= 22) return;
    const causes = causesHere();
    if (!causes) choose(scene.steps[step].transition, near.k);
    else element("info").textContent = `grasp ${near.k}: ${causes.legend[causes.of_grasp[near.k]][0]}`;
  }
  show(0);
  const look = (nearer) => { camera.distance *= nearer; redraw(); };
  window.plan = { show, choose, screen, ghost: (k) => onScreen(ghosts[k].top), look, scene, camera, get step() { return step; }, get state() { return stateOf(step); } };
})();
