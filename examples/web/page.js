/* page.js - the page: starts the WebAssembly of page.c, draws with WebGL2, and passes on what the user does. */
"use strict";
(() => {
const $ = id => document.getElementById(id);
const view = $("view"), over = $("over");

/* ------------------------------------------------------------------------------------------
 * WebAssembly
 * ------------------------------------------------------------------------------------------ */

/* A module with one SIMD instruction: it is valid where the browser has SIMD. */
const SIMD_PROBE = new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0,
  253, 15, 253, 98, 11]);
const query = new URLSearchParams(location.search);
let simd = WebAssembly.validate(SIMD_PROBE) && query.get("simd") !== "0";
let c, failed = "";

function bytesOf(id) {
  const text = atob($(id).textContent.trim()), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; ++i) bytes[i] = text.charCodeAt(i);
  return bytes;
}

function textAt(pointer) {
  const bytes = new Uint8Array(c.memory.buffer);
  let end = pointer;
  while (bytes[end]) ++end;
  return new TextDecoder().decode(bytes.subarray(pointer, end));
}

async function start() {
  const module = await WebAssembly.compile(bytesOf(simd ? "wasm-simd" : "wasm-plain"));
  const imports = {page: {failed: text => { failed = textAt(text); }}, wasi_snapshot_preview1: {}};
  for (const {module: from, name} of WebAssembly.Module.imports(module))
    if (from === "wasi_snapshot_preview1")
      imports[from][name] = name === "proc_exit" ? code => { throw new Error("exit " + code); } : () => 52;
  c = (await WebAssembly.instantiate(module, imports)).exports;
  if (c._initialize) c._initialize();
}

const doubles = (pointer, count) => new Float64Array(c.memory.buffer, pointer, count);

/* Calls f with a copy of numbers in the memory of c. */
function withDoubles(numbers, f) {
  const pointer = c.page_new(8 * numbers.length);
  doubles(pointer, numbers.length).set(numbers);
  const result = f(pointer);
  c.page_delete(pointer);
  return result;
}

/* ------------------------------------------------------------------------------------------
 * messages, theme
 * ------------------------------------------------------------------------------------------ */

let messageTimer;
function say(text, good) {
  const box = $("message");
  box.textContent = text;
  box.className = good ? "card good" : "card";
  box.style.display = "block";
  clearTimeout(messageTimer);
  messageTimer = setTimeout(() => { box.style.display = "none"; }, good ? 5000 : 9000);
}
const complain = () => say(textAt(c.page_error()));

const dark = () => document.documentElement.dataset.theme === "dark";
function setTheme(name) {
  document.documentElement.dataset.theme = name;
  $("theme").textContent = name === "dark" ? "Light" : "Dark";
}
setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", e => setTheme(e.matches ? "dark" : "light"));

/* ------------------------------------------------------------------------------------------
 * small vectors, camera: z points upwards
 * ------------------------------------------------------------------------------------------ */

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const l = Math.hypot(...a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };
function times(a, b) { /* 4 x 4, by columns */
  const r = new Float32Array(16);
  for (let i = 0; i < 4; ++i)
    for (let j = 0; j < 4; ++j)
      for (let k = 0; k < 4; ++k) r[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return r;
}
function lookAt(eye, target, up) {
  const f = unit(sub(target, eye)), r = unit(cross(f, up)), u = cross(r, f);
  return [r[0], u[0], -f[0], 0, r[1], u[1], -f[1], 0, r[2], u[2], -f[2], 0, -dot(r, eye), -dot(u, eye), dot(f, eye), 1];
}

const camera = {yaw: -1.2, pitch: 0.3, distance: 3, target: [0, 0, 0.5]};
const VIEW_ANGLE = 0.6; /* of the shorter side, rad */

function shape() { /* the camera, all that follows from it */
  const {yaw, pitch, distance, target} = camera, aspect = view.clientWidth / view.clientHeight;
  const back = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
  const eye = along(target, distance, back), forward = back.map(v => -v);
  const right = unit(cross(forward, [0, 0, 1])), up = cross(right, forward);
  const t = Math.tan(VIEW_ANGLE / 2), half = aspect > 1 ? [t * aspect, t] : [t, t / aspect];
  const near = 0.02 * distance, far = 60 * distance;
  const beside = view.clientWidth > 720 ? 150 / view.clientWidth : 0; /* the panel covers what is on the right */
  const project = [1 / half[0], 0, 0, 0, 0, 1 / half[1], 0, 0, beside, 0, (far + near) / (near - far), -1, 0, 0,
    2 * far * near / (near - far), 0];
  return {eye, forward, right, up, half, beside, matrix: times(project, lookAt(eye, target, [0, 0, 1]))};
}

function rayAt(px, py) {
  const s = shape(), x = 2 * px / view.clientWidth - 1 + s.beside, y = 1 - 2 * py / view.clientHeight;
  return {origin: s.eye, forward: s.forward, direction: unit(along(along(s.forward, x * s.half[0], s.right), y * s.half[1], s.up))};
}

function onScreen(x) { /* pixels */
  const s = shape(), d = sub(x, s.eye), depth = dot(d, s.forward);
  return [(dot(d, s.right) / depth / s.half[0] + 1 - s.beside) / 2 * view.clientWidth,
    (1 - dot(d, s.up) / depth / s.half[1]) / 2 * view.clientHeight];
}

/* ------------------------------------------------------------------------------------------
 * drawing
 * ------------------------------------------------------------------------------------------ */

const SHADOW = 1024;
const PALETTE = [ /* outside, inside */
  [0.86, 0.34, 0.27], [1.0, 0.80, 0.50], [0.20, 0.56, 0.80], [0.93, 0.95, 0.72], [0.93, 0.62, 0.20], [1.0, 0.90, 0.62],
  [0.25, 0.66, 0.47], [0.86, 0.95, 0.70], [0.55, 0.62, 0.74], [0.98, 0.66, 0.34], [0.68, 0.45, 0.78], [0.97, 0.83, 0.93],
  [0.88, 0.46, 0.60], [1.0, 0.87, 0.80], [0.36, 0.70, 0.76], [0.95, 0.90, 0.65], [0.62, 0.68, 0.30], [0.98, 0.93, 0.70]];
const LIGHT = unit([-0.45, -0.6, 1.15]);

const VERTEX = `#version 300 es
layout(location=0) in vec3 x; layout(location=1) in vec3 n; layout(location=2) in float color;
uniform mat4 camera, light; out vec3 at, normal; out vec4 shade; flat out int which;
void main() { at = x; normal = n; which = int(color + 0.5); shade = light * vec4(x, 1.0); gl_Position = camera * vec4(x, 1.0); }`;
const COMMON = `#version 300 es
precision highp float; precision highp sampler2DShadow;
uniform sampler2DShadow map; uniform vec3 sun, eye;
float lit(vec4 shade, float bias) {
  vec3 p = shade.xyz / shade.w * 0.5 + 0.5; float sum = 0.0;
  if (any(greaterThan(abs(p - 0.5), vec3(0.5)))) return 1.0;
  for (int i = -1; i <= 1; ++i) for (int j = -1; j <= 1; ++j)
    sum += texture(map, vec3(p.xy + 1.4 * vec2(i, j) / ${SHADOW}.0, p.z - bias));
  return sum / 9.0;
}`;
const BODY = COMMON + `
in vec3 at, normal; in vec4 shade; flat in int which; uniform vec3 palette[${PALETTE.length}]; out vec4 result;
void main() {
  vec3 n = normalize(normal), v = normalize(eye - at), base = which == 101 ? vec3(0.50, 0.55, 0.63) : which == 100 ? vec3(0.06, 0.05, 0.06) : palette[which % ${PALETTE.length}];
  if (dot(n, v) < -0.2) n = -n;
  float sunny = max(dot(n, sun), 0.0) * lit(shade, 0.004), sky = 0.5 + 0.5 * n.z;
  vec3 c = base * (mix(vec3(0.44, 0.41, 0.42), vec3(0.64, 0.67, 0.72), sky) + 0.50 * sunny * vec3(1.0, 0.96, 0.9));
  c += 0.16 * sunny * pow(max(dot(reflect(-sun, n), v), 0.0), 28.0) + 0.07 * pow(1.0 - max(dot(n, v), 0.0), 3.0);
  result = vec4(c, 1.0);
}`;
const FLOOR_VERTEX = `#version 300 es
uniform mat4 camera, light; uniform vec4 place; out vec3 at; out vec4 shade;
void main() {
  vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  at = vec3(place.xy + p * place.w, place.z); shade = light * vec4(at, 1.0); gl_Position = camera * vec4(at, 1.0);
}`;
const FLOOR = COMMON + `
in vec3 at; in vec4 shade; uniform vec4 place; uniform vec3 tint; uniform float depth; out vec4 result;
void main() {
  float far = length(at.xy - place.xy) / place.w, fade = 1.0 - smoothstep(0.25, 1.0, far);
  vec2 g = abs(fract(at.xy / (place.w / 16.0) - 0.5) - 0.5) / fwidth(at.xy / (place.w / 16.0));
  float line = (1.0 - min(min(g.x, g.y), 1.0)) * 0.10;
  float dark = fade * depth * (1.0 - lit(shade, 0.002));
  line *= fade * (1.0 - dark);
  result = vec4(tint * line + vec3(0.02, 0.04, 0.08) * dark, line + dark);
}`;
const DEPTH = `#version 300 es
precision highp float; void main() {}`;

let gl, programs, buffers, shadowMap, shadowFrame;

function program(vertex, fragment) {
  const p = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const s = gl.createShader(kind);
    gl.shaderSource(s, text);
    gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
    gl.attachShader(p, s);
  }
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
  const at = {};
  for (let i = 0; i < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); ++i) {
    const name = gl.getActiveUniform(p, i).name.replace("[0]", "");
    at[name] = gl.getUniformLocation(p, name);
  }
  return {p, at};
}

function startDrawing() {
  gl = view.getContext("webgl2", {antialias: true, alpha: true, premultipliedAlpha: true});
  if (!gl) throw new Error("this browser has no WebGL2");
  programs = {body: program(VERTEX, BODY), floor: program(FLOOR_VERTEX, FLOOR), depth: program(VERTEX, DEPTH)};
  buffers = {vertex: gl.createBuffer(), index: gl.createBuffer(), array: gl.createVertexArray(), none: gl.createVertexArray()};
  gl.bindVertexArray(buffers.array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffers.vertex);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.index);
  [[3, 0], [3, 12], [1, 24]].forEach(([size, offset], i) => {
    gl.enableVertexAttribArray(i);
    gl.vertexAttribPointer(i, size, gl.FLOAT, false, 28, offset);
  });
  shadowMap = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, shadowMap);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW, SHADOW);
  for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]])
    gl.texParameteri(gl.TEXTURE_2D, name, value);
  shadowFrame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, shadowFrame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, shadowMap, 0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
}

function fit(canvas) {
  const scale = Math.min(devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * scale), h = Math.round(canvas.clientHeight * scale);
  if (canvas.width !== w || canvas.height !== h) canvas.width = w, canvas.height = h;
  return scale;
}

function lightMatrix() { /* from the sun, all that may throw a shadow */
  const r = 1.5 * world.radius, m = camera.target, e = along(m, 4 * r, LIGHT);
  return times([1 / r, 0, 0, 0, 0, 1 / r, 0, 0, 0, 0, -2 / (8 * r), 0, 0, 0, -1, 1], lookAt(e, world.middle || m, [0, 1, 0]));
}

let indices = 0;
function draw() {
  if (c.page_draw(run.paused ? 1 : 0)) return complain();
  const s = shape(), light = lightMatrix();
  gl.bindVertexArray(buffers.array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffers.vertex);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(c.memory.buffer, c.page_vertex(), 7 * c.page_vertices()), gl.DYNAMIC_DRAW);
  if (c.page_changed()) {
    indices = c.page_indices();
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(c.memory.buffer, c.page_index(), indices), gl.DYNAMIC_DRAW);
  }
  gl.enable(gl.DEPTH_TEST);
  gl.disable(gl.BLEND);
  gl.bindFramebuffer(gl.FRAMEBUFFER, shadowFrame);
  gl.viewport(0, 0, SHADOW, SHADOW);
  gl.clear(gl.DEPTH_BUFFER_BIT);
  gl.useProgram(programs.depth.p);
  gl.uniformMatrix4fv(programs.depth.at.camera, false, light);
  gl.drawElements(gl.TRIANGLES, indices, gl.UNSIGNED_INT, 0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  fit(view);
  gl.viewport(0, 0, view.width, view.height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.bindTexture(gl.TEXTURE_2D, shadowMap);
  for (const name of ["body", "floor"]) {
    const {p, at} = programs[name];
    gl.useProgram(p);
    gl.uniformMatrix4fv(at.camera, false, s.matrix);
    gl.uniformMatrix4fv(at.light, false, light);
    gl.uniform3fv(at.sun, LIGHT);
    gl.uniform3fv(at.eye, s.eye);
    gl.uniform1i(at.map, 0);
    if (name === "body") {
      gl.uniform3fv(at.palette, PALETTE.flat());
      gl.drawElements(gl.TRIANGLES, indices, gl.UNSIGNED_INT, 0);
    } else {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.bindVertexArray(buffers.none);
      gl.uniform4fv(at.place, [world.middle[0], world.middle[1], world.floor, 3.2 * world.radius]);
      gl.uniform3fv(at.tint, dark() ? [0.62, 0.70, 0.80] : [0.10, 0.16, 0.24]);
      gl.uniform1f(at.depth, dark() ? 0.6 : 0.32);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  }
}

function number(x) {
  if (x === 0) return "0";
  const a = Math.abs(x);
  return a >= 1e5 || a < 1e-3 ? x.toExponential(2).replace(/\.?0*e\+?/, "e") : String(Number(x.toPrecision(3)));
}

function drawOver() {
  const scale = fit(over), g = over.getContext("2d"), hand = doubles(c.page_hand(), 7);
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, over.clientWidth, over.clientHeight);
  if (swipe.length > 1) {
    g.strokeStyle = dark() ? "#fff" : "#1c2733";
    g.lineWidth = 2.5;
    g.lineCap = "round";
    g.beginPath();
    swipe.forEach((p, i) => i ? g.lineTo(...p) : g.moveTo(...p));
    g.stroke();
  }
  const solids = doubles(c.page_arrows(), 1)[0], all = [...doubles(c.page_arrows(), 1 + 6 * solids)];
  for (let k = 0; k < solids; ++k) {
    const x = all.slice(6 * k + 1, 6 * k + 4), force = all.slice(6 * k + 4, 6 * k + 7);
    if (Math.hypot(...force) > 0) drawArrow(g, x, force);
  }
  if (hand[0]) drawArrow(g, [...hand.subarray(1, 4)], [...hand.subarray(4, 7)]);
}

/* A force at x: an arrow and a number. */
function drawArrow(g, x, force) {
  const size = Math.hypot(...force), from = onScreen(x), s = shape(), way = unit(force);
  const dx = dot(way, s.right), dy = -dot(way, s.up), length = 130 * size / (size + 0.3 * world.scale);
  const to = [from[0] + dx * length, from[1] + dy * length], flat = Math.hypot(dx, dy) * length;
  g.strokeStyle = g.fillStyle = dark() ? "#ffd166" : "#b3261e";
  g.lineWidth = 3.5;
  g.beginPath();
  g.arc(...from, 5, 0, 7);
  g.fill();
  if (flat > 12) {
    const a = Math.atan2(dy, dx);
    g.beginPath();
    g.moveTo(...from);
    g.lineTo(to[0] - 8 * Math.cos(a), to[1] - 8 * Math.sin(a));
    g.stroke();
    g.beginPath();
    g.moveTo(...to);
    for (const b of [-0.42, 0.42]) g.lineTo(to[0] - 15 * Math.cos(a + b), to[1] - 15 * Math.sin(a + b));
    g.fill();
  }
  g.font = "600 15px system-ui, sans-serif";
  g.lineWidth = 4;
  g.strokeStyle = dark() ? "#0d1117" : "#fff";
  g.textAlign = "left";
  const text = number(size) + " N", wide = g.measureText(text).width, right = dx >= 0 || flat < 12;
  const left = Math.max(4, Math.min(over.clientWidth - wide - 4, right ? to[0] + 12 : to[0] - 12 - wide)); /* on the screen */
  g.strokeText(text, left, to[1] - 8);
  g.fillText(text, left, to[1] - 8);
}

/* ------------------------------------------------------------------------------------------
 * scenes, sliders, link
 * ------------------------------------------------------------------------------------------ */

let scenes = [], current = 0, values = [], linked = "";
const world = {radius: 1, middle: [0, 0, 0], floor: 0, scale: 1, speed: 1};
const run = {paused: false, slow: false, behind: 0, energies: [], physics: 0, drawing: 0, step: 0, rate: 1};
const defaults = k => scenes[k].sliders.map(s => s.value);
const padded = list => [...list, ...new Array(16 - list.length).fill(0)];

const INFO = ["time", "h", "kinetic", "elastic", "load", "rejected", "corrections", "pieces", "broken", "nodes", "tets", "bodies",
  "x0", "y0", "z0", "x1", "y1", "z1", "floor", "speed", "contacts", "large"];
function info() {
  const from = doubles(c.page_info(), INFO.length), result = {};
  INFO.forEach((name, i) => { result[name] = from[i]; });
  return result;
}

function measureWorld() {
  const i = info();
  world.middle = [(i.x0 + i.x1) / 2, (i.y0 + i.y1) / 2, (i.z0 + i.z1) / 2];
  world.radius = 0.5 * Math.hypot(i.x1 - i.x0, i.y1 - i.y0, i.z1 - i.z0);
  world.floor = i.floor > -1e29 ? i.floor : i.z0 - 0.12 * world.radius;
  world.speed = i.speed;
  const E = scenes[current].sliders.findIndex(s => s.name === "E");
  world.scale = 0.01 * (E < 0 ? 1e5 : values[E]) * world.radius * world.radius;
}

function resetCamera() {
  camera.target = [...world.middle];
  camera.yaw = -1.22, camera.pitch = 0.3;
  camera.distance = 1.18 * world.radius / Math.sin(VIEW_ANGLE / 2);
}

/* Opens a scene; false: it could not, the one before goes on. */
function open(k, wanted, keepCamera) {
  const status = withDoubles(padded(wanted), p => c.page_open(k, p));
  if (status) { complain(); return false; }
  opened(k, wanted, keepCamera);
  return true;
}

function opened(k, wanted, keepCamera) {
  current = k;
  held = null; /* the hand and the ball were of the world before */
  ++changes;
  values = [...wanted];
  swipe.length = 0;
  run.behind = 0;
  run.energies = [];
  measureWorld();
  if (!keepCamera) resetCamera();
  showScene();
  remember();
}

function setSlider(k, value) {
  const s = scenes[current].sliders[k];
  if (c.page_set(k, value)) { complain(); showSlider(k); return false; }
  ++changes;
  values[k] = value;
  measureWorld();
  if (s.again) run.energies = [];
  showSlider(k);
  remember();
  return true;
}

const toRange = (s, v) => s.log ? Math.log(v / s.low) / Math.log(s.high / s.low) : (v - s.low) / (s.high - s.low);
const fromRange = (s, t) => {
  const v = s.log ? s.low * Math.pow(s.high / s.low, t) : s.low + t * (s.high - s.low);
  const rounded = Number(v.toPrecision(3));
  return s.name === "jellies" || s.name === "up" ? Math.round(v) : Math.min(s.high, Math.max(s.low, rounded));
};

function showSlider(k) {
  const s = scenes[current].sliders[k], row = $("sliders").children[k];
  row.querySelector("[type=text]").value = number(values[k]);
  row.querySelector("[type=range]").value = 1000 * toRange(s, values[k]);
}

function showScene() {
  const scene = scenes[current];
  [...$("scenes").children].forEach((b, k) => b.setAttribute("aria-pressed", k === current));
  $("scenes").children[current].scrollIntoView({block: "nearest", inline: "center"});
  $("title").textContent = scene.title;
  $("hint").textContent = scene.hint;
  $("sliders").replaceChildren(...scene.sliders.map((s, k) => {
    const row = document.createElement("div");
    row.className = "slider";
    row.innerHTML = `<label for="s${k}"></label><span><input type="text" inputmode="decimal" aria-label="value"><small></small></span>` +
      `<input type="range" id="s${k}" min="0" max="1000" step="1">`;
    row.querySelector("label").textContent = s.name;
    row.querySelector("small").textContent = s.unit.replace("^2", "\u00b2").replace("^3", "\u00b3");
    const text = row.querySelector("[type=text]"), range = row.querySelector("[type=range]");
    text.addEventListener("change", () => setSlider(k, text.value.trim() === "" ? NaN : Number(text.value)));
    range.addEventListener("input", () => { text.value = number(fromRange(s, range.value / 1000)); });
    range.addEventListener("change", () => setSlider(k, fromRange(s, range.value / 1000)));
    return row;
  }));
  scene.sliders.forEach((s, k) => showSlider(k));
}

/* The address holds the scene and what differs from its defaults. */
function remember() {
  const scene = scenes[current], parts = ["scene=" + scene.name];
  scene.sliders.forEach((s, k) => { if (values[k] !== s.value) parts.push(s.name + "=" + values[k]); });
  linked = "#" + parts.join("&");
  history.replaceState(null, "", linked);
}

function openLinked() {
  const wanted = new URLSearchParams(location.hash.slice(1)), k = scenes.findIndex(s => s.name === (wanted.get("scene") || scenes[0].name));
  if (k < 0) {
    say("the link names a scene that is not there: " + wanted.get("scene"));
    return open(0, defaults(0));
  }
  const list = scenes[k].sliders.map(s => wanted.has(s.name) ? Number(wanted.get(s.name)) : s.value);
  return open(k, list) || open(k, defaults(k));
}

function loadFile(name, buffer) {
  const bytes = new Uint8Array(buffer), encoded = new TextEncoder().encode(name + "\0"), k = scenes.length - 1;
  const list = current === k ? [...values] : defaults(k), up = scenes[k].sliders.findIndex(s => s.name === "up");
  list[up] = /\.(obj|ply|off)$/i.test(name) ? 1 : 2;
  const text = c.page_new(encoded.length), data = c.page_new(bytes.length || 1);
  if (!text || !data) return say(name + ": out of memory");
  new Uint8Array(c.memory.buffer, text, encoded.length).set(encoded);
  new Uint8Array(c.memory.buffer, data, bytes.length).set(bytes);
  const status = withDoubles(padded(list), p => c.page_file(text, data, bytes.length, p));
  c.page_delete(text);
  if (status) return say(name + ": " + textAt(c.page_error()));
  opened(k, list);
  say(`${name}: ${info().tets} tets, made 1 m large`, true);
}

/* ------------------------------------------------------------------------------------------
 * time
 * ------------------------------------------------------------------------------------------ */

function steps(count) {
  ++changes;
  const from = performance.now(), status = c.page_step(count);
  run.step = performance.now() - from;
  if (!status) return true;
  run.paused = true;
  showRun();
  complain();
  return false;
}

const BUDGET = 26; /* ms of a frame for physics; what is too slow for that goes slower */
/* What a picture depends on. While that stays, as in a paused scene, nothing is drawn. */
let changes = 0, pictured = "";
const pictureOf = () => [changes, run.paused, camera.yaw, camera.pitch, camera.distance, dark(), view.clientWidth, view.clientHeight, swipe.length,
  held ? [held.at, held.depth] : 0, devicePixelRatio].join(" ");

let last = 0, frames = 0, drawn = 0, shown = 0, clock = 0, simulated = 0;
function frame(now) {
  try {
    const passed = Math.min(0.1, Math.max(0, (now - last) / 1000)), before = performance.now();
    last = now;
    if (!run.paused) {
      const h = values[scenes[current].sliders.findIndex(s => s.name === "h")] / 1000;
      run.behind = Math.min(run.behind + passed * world.speed * (run.slow ? 0.15 : 1), 4 * h + 0.05);
      let count = 0, spent = 0;
      if (held) moveHand();
      while (run.behind >= h && spent < BUDGET && !run.paused) {
        if (!steps(1)) break;
        run.behind -= h;
        simulated += h;
        ++count;
        spent = performance.now() - before;
      }
      if (count) run.physics += 0.1 * (spent / count - run.physics);
      if (spent >= BUDGET) run.behind = Math.min(run.behind, h);
    }
    clock += passed;
    const drawing = performance.now();
    if (pictured !== pictureOf()) {
      draw();
      drawOver();
      pictured = pictureOf();
    }
    run.drawing += 0.1 * (performance.now() - drawing - run.drawing);
    ++frames;
    ++drawn;
    if (now - shown > 200) showNumbers(now);
  } catch (e) {
    run.paused = true;
    say((failed || e.message) + ". The page starts again.");
    setTimeout(() => location.reload(), 4000);
    console.error(e);
    return;
  }
  requestAnimationFrame(frame);
}

function showNumbers(now) {
  const i = info(), total = i.kinetic + i.elastic + i.load;
  if (clock > 0) run.rate = simulated / clock;
  run.energies.push([i.kinetic, i.elastic]);
  if (run.energies.length > 120) run.energies.shift();
  const rows = [["energy", number(total) + " J"], ["physics", run.physics.toFixed(1) + " ms a step"], ["drawing", run.drawing.toFixed(1) + " ms"],
    ["rejected steps", i.rejected], ["pieces", i.pieces], ["contacts", i.contacts], ["corrections", i.corrections, 1], ["tets", i.bodies > 1 ? i.bodies + " x " + i.tets : i.tets, 1],
    ["time", i.time.toFixed(2) + " s", 1], ["speed", "x " + number(Number(run.rate.toFixed(2))), 1], ["frames", (1000 * frames / (now - shown)).toFixed(0) + " /s", 1]];
  $("rows").replaceChildren(...rows.map(([name, value, wide]) => {
    const row = document.createElement("tr");
    row.className = wide ? "wide" : "";
    for (const text of [name, value]) row.appendChild(document.createElement("td")).textContent = text;
    return row;
  }));
  drawEnergies();
  frames = 0, shown = now, clock = simulated = 0;
}

function drawEnergies() { /* kinetic on top of elastic */
  const canvas = $("energy"), scale = fit(canvas), g = canvas.getContext("2d"), w = canvas.clientWidth, h = canvas.clientHeight;
  const most = Math.max(1e-9, ...run.energies.map(e => e[0] + e[1])), n = run.energies.length;
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, w, h);
  [[e => e[0] + e[1], dark() ? "#e08a5b" : "#d9622b"], [e => e[1], dark() ? "#4c9cf0" : "#1668c7"]].forEach(([f, color]) => {
    g.fillStyle = color;
    g.globalAlpha = 0.75;
    g.beginPath();
    g.moveTo(0, h);
    run.energies.forEach((e, k) => g.lineTo(w * k / 119, h - (h - 1) * f(e) / most));
    g.lineTo(w * (n - 1) / 119, h);
    g.fill();
  });
}

function showRun() {
  $("pause").setAttribute("aria-pressed", run.paused);
  $("pause").textContent = run.paused ? "Play" : "Pause";
  $("slow").setAttribute("aria-pressed", run.slow);
}

/* ------------------------------------------------------------------------------------------
 * mouse, touch
 * ------------------------------------------------------------------------------------------ */

let tool = "grab", held = null, turning = null;
const swipe = [], pointers = new Map();

function setTool(name) {
  tool = name;
  for (const k of ["grab", "poke", "cut"]) $(k).setAttribute("aria-pressed", k === name);
  view.style.cursor = name === "grab" ? "default" : "crosshair";
}

function moveHand() {
  const ray = rayAt(...held.at), s = held.depth / dot(ray.direction, ray.forward);
  if (c.page_move(...along(ray.origin, s, ray.direction))) complain();
}

/* Takes hold of what is at a pixel, or pokes at it with the ball; false: nothing is there. */
function grabAt(px, py) {
  const ray = rayAt(px, py), distance = c.page_grab(...ray.origin, ...ray.direction, tool === "poke" ? 1 : 0);
  if (distance === -2) complain();
  if (distance < 0) return false;
  held = {at: [px, py], depth: distance * dot(ray.direction, ray.forward)};
  return true;
}

function letGo() {
  if (held) c.page_release();
  if (held) ++changes;
  held = null;
}

/* The blade goes from one pixel to another, through all that is behind. */
function cutAlong(a, b) {
  const reach = 20 * world.radius + camera.distance, blade = p => {
    const ray = rayAt(...p);
    return [...along(ray.origin, 0.01, ray.direction), ...along(ray.origin, reach, ray.direction)];
  };
  const marked = withDoubles(blade(a), from => withDoubles(blade(b), to => c.page_cut(from, to)));
  if (marked < 0) complain();
  return marked;
}

function orbit(dx, dy) {
  camera.yaw -= 0.008 * dx;
  camera.pitch = Math.max(-0.2, Math.min(1.5, camera.pitch + 0.008 * dy));
}
const zoom = by => { camera.distance = Math.max(0.4 * world.radius, Math.min(20 * world.radius, camera.distance * by)); };

view.addEventListener("pointerdown", e => {
  view.setPointerCapture(e.pointerId);
  view.focus({preventScroll: true});
  $("help").style.display = "none";
  const at = [e.offsetX, e.offsetY];
  pointers.set(e.pointerId, at);
  if (pointers.size > 1 || e.button > 0) { letGo(); swipe.length = 0; turning = at; return; }
  if (tool === "cut" || e.shiftKey) swipe.splice(0, swipe.length, at);
  else if (!grabAt(...at)) turning = at;
});
view.addEventListener("pointermove", e => {
  const at = [e.offsetX, e.offsetY], before = pointers.get(e.pointerId);
  if (!before) return;
  pointers.set(e.pointerId, at);
  if (pointers.size > 1) {
    const other = [...pointers].find(([id]) => id !== e.pointerId)[1], gap = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
    zoom(Math.max(0.5, Math.min(2, gap(before) / Math.max(1, gap(at)))));
    orbit((at[0] - before[0]) / 2, (at[1] - before[1]) / 2);
  } else if (held) held.at = at;
  else if (swipe.length) {
    const end = swipe[swipe.length - 1];
    if (Math.hypot(at[0] - end[0], at[1] - end[1]) < 3) return;
    cutAlong(end, at);
    swipe.push(at);
  } else if (turning) orbit(at[0] - before[0], at[1] - before[1]);
});
function pointerEnd(e) {
  pointers.delete(e.pointerId);
  letGo();
  swipe.length = 0;
  if (!pointers.size) turning = null;
}
view.addEventListener("pointerup", pointerEnd);
view.addEventListener("pointercancel", pointerEnd);
view.addEventListener("contextmenu", e => e.preventDefault());
view.addEventListener("wheel", e => {
  e.preventDefault();
  if (held) held.depth = Math.max(0.1 * camera.distance, held.depth - 0.0006 * e.deltaY * world.radius);
  else zoom(Math.exp(0.0012 * e.deltaY));
}, {passive: false});

/* ------------------------------------------------------------------------------------------
 * buttons, keys, files
 * ------------------------------------------------------------------------------------------ */

const act = {
  grab: () => setTool("grab"),
  poke: () => setTool("poke"),
  cut: () => setTool("cut"),
  pause: () => { run.paused = !run.paused; showRun(); },
  one: () => { run.paused = true; showRun(); if (held) moveHand(); steps(1); },
  reset: () => { letGo(); open(current, values, true); },
  slow: () => { run.slow = !run.slow; showRun(); },
  theme: () => setTheme(dark() ? "light" : "dark"),
  link: async () => {
    remember();
    try { await navigator.clipboard.writeText(location.href); say("The link is copied.", true); }
    catch (e) { say("The address of this page is the link.", true); }
  },
  keys: () => { $("help").style.display = $("help").style.display === "block" ? "none" : "block"; },
  open: () => $("file").click(),
  more: () => $("more").setAttribute("aria-pressed", $("panel").classList.toggle("open")),
};
for (const [id, f] of Object.entries(act)) $(id).addEventListener("click", f);

const KEYS = {g: "grab", p: "poke", c: "cut", " ": "pause", n: "one", ".": "one", r: "reset", s: "slow", d: "theme", l: "link", "?": "keys"};
addEventListener("keydown", e => {
  if (e.target.matches("input[type=text]") || e.ctrlKey || e.metaKey || e.altKey) return;
  const key = e.key.toLowerCase();
  if (e.target.matches("input") && e.key.startsWith("Arrow")) return;
  if (key === " " && e.target.matches("button")) e.target.blur();
  if (KEYS[key]) act[KEYS[key]]();
  else if (/^[1-9]$/.test(key) && scenes[key - 1]) open(key - 1, defaults(key - 1));
  else if (key === "0") resetCamera();
  else if (key === "+" || key === "=") zoom(0.9);
  else if (key === "-") zoom(1.1);
  else if (key === "escape") $("help").style.display = "none";
  else if (e.key.startsWith("Arrow"))
    orbit({ArrowLeft: -12, ArrowRight: 12}[e.key] || 0, {ArrowUp: 12, ArrowDown: -12}[e.key] || 0);
  else return;
  e.preventDefault();
});

addEventListener("dragover", e => { e.preventDefault(); $("drop").style.display = "flex"; });
addEventListener("dragleave", e => { if (!e.relatedTarget) $("drop").style.display = "none"; });
addEventListener("drop", async e => {
  e.preventDefault();
  $("drop").style.display = "none";
  const file = e.dataTransfer.files[0];
  if (file) loadFile(file.name, await file.arrayBuffer());
});
$("file").addEventListener("change", async () => {
  const file = $("file").files[0];
  if (file) loadFile(file.name, await file.arrayBuffer());
  $("file").value = "";
});
addEventListener("hashchange", () => { if (location.hash !== linked) openLinked(); });

/* ------------------------------------------------------------------------------------------
 * the beginning; what tests ask for
 * ------------------------------------------------------------------------------------------ */

window.softfem = {
  ready: false, info, run, onScreen, shape, camera, world, act, steps, setSlider,
  get simd() { return simd; }, get scene() { return scenes[current].name; }, get scenes() { return scenes.map(s => s.name); },
  open: (name, slider, value) => {
    const k = scenes.findIndex(s => s.name === name);
    return open(k, scenes[k].sliders.map(s => s.name === slider ? value : s.value));
  },
  get drawn() { return drawn; },
  hash: () => textAt(c.page_hash()),
  hand: () => [...doubles(c.page_hand(), 7)],
};

(async () => {
  try {
    startDrawing();
    await start();
    scenes = JSON.parse(textAt(c.page_scenes()));
    $("scenes").replaceChildren(...scenes.map((s, k) => {
      const b = document.createElement("button");
      b.textContent = s.title;
      b.addEventListener("click", () => open(k, defaults(k)));
      return b;
    }));
    setTool("grab");
    openLinked();
    last = performance.now();
    requestAnimationFrame(frame);
    window.softfem.ready = true;
  } catch (e) {
    say(e.message);
    throw e;
  }
})();
})();
