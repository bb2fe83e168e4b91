// Draws one scene that plays, by the compositing rule of the raster room: projected ellipses widened by the blur of the fit,
// alpha cut at its smallest and largest, sRGB blended from back to front. `DATA` is the page's JSON; blobs are gzip in base64.
"use strict";
const ALPHA_MIN = 1 / 255, ALPHA_MAX = 0.99, NEAR = 0.01, BLUR = 0.3, MARGIN = 0.3, BANDS = 65536, TEXELS = 4, COLUMNS = 256;
const MARKS = [[1, 0.35, 0.1], [0.1, 0.75, 1], [0.75, 0.3, 1], [0.3, 0.9, 0.3]];

async function unpacked(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// SPZ version 3 as pack_spz writes it: quaternions wxyz, linear scale, colours at degree 0.
function splatsOf(buffer) {
  const view = new DataView(buffer), count = view.getUint32(8, true), unit = 2 ** -view.getUint8(13);
  const mean = new Float32Array(3 * count), quat = new Float32Array(4 * count);
  const [opacity, rgb, scale] = [new Float32Array(count), new Float32Array(3 * count), new Float32Array(3 * count)];
  const start = { opacity: 16 + 9 * count, rgb: 16 + 10 * count, scale: 16 + 13 * count, quat: 16 + 16 * count };
  for (let i = 0; i < 3 * count; i++) {
    const at = 16 + 3 * i;
    mean[i] = ((view.getUint8(at) << 8 | view.getUint8(at + 1) << 16 | view.getInt8(at + 2) << 24) >> 8) * unit;
    rgb[i] = Math.max(0.28209479177387814 * (view.getUint8(start.rgb + i) / 255 - 0.5) / 0.15 + 0.5, 0);
    scale[i] = Math.exp(view.getUint8(start.scale + i) / 16 - 10);
  }
  for (let i = 0; i < count; i++) {
    opacity[i] = view.getUint8(start.opacity + i) / 255;
    let packed = view.getUint32(start.quat + 4 * i, true), rest = 1;
    const largest = packed >>> 30;
    for (let axis = 3; axis >= 0; axis--) {
      if (axis === largest) continue;
      const value = (packed & 511) / 511 * Math.SQRT1_2 * (packed & 512 ? -1 : 1);
      quat[4 * i + (axis + 1) % 4] = value;
      rest -= value * value;
      packed >>>= 10;
    }
    quat[4 * i + (largest + 1) % 4] = Math.sqrt(Math.max(rest, 0));
  }
  return { count, mean, quat, opacity, rgb, scale };
}

function multiply(a, i, b, j, out, k) {
  const [w, x, y, z] = [a[i], a[i + 1], a[i + 2], a[i + 3]], [W, X, Y, Z] = [b[j], b[j + 1], b[j + 2], b[j + 3]];
  out[k] = w * W - x * X - y * Y - z * Z;
  out[k + 1] = w * X + x * W + y * Z - z * Y;
  out[k + 2] = w * Y - x * Z + y * W + z * X;
  out[k + 3] = w * Z + x * Y - y * X + z * W;
}

function rotate(q, i, v, j, out) {
  const [w, x, y, z] = [q[i], q[i + 1], q[i + 2], q[i + 3]], [a, b, c] = [v[j], v[j + 1], v[j + 2]];
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  out[0] = a + w * tx + y * tz - z * ty;
  out[1] = b + w * ty + z * tx - x * tz;
  out[2] = c + w * tz + x * ty - y * tx;
}

// Relative motions of all (node, reference) pairs at one frame as unit dual quaternions (P,8).
function motionsAt(frame, motion) {
  const table = new Float64Array(8 * DATA.pairs), t = [0, 0, 0, 0], moved = [0, 0, 0];
  for (let p = 0; p < DATA.pairs; p++) {
    const now = 7 * (frame * DATA.nodes + motion.pairNode[p]);
    multiply(motion.poses, now, motion.inverse, 7 * p, table, 8 * p);
    rotate(motion.poses, now, motion.inverse, 7 * p + 4, moved);
    for (let axis = 0; axis < 3; axis++) t[axis + 1] = (moved[axis] + motion.poses[now + 4 + axis]) / 2;
    multiply(t, 0, table, 8 * p, table, 8 * p + 4);
  }
  return table;
}

// Moves dynamic Gaussian `d` (row `row`) by the blend of its nodes; writes `mean` and `quat` of `posed`.
function carry(d, row, table, motion, splats, posed) {
  const sum = new Float64Array(8), K = DATA.slots, first = 8 * motion.index[d * K], q = new Float64Array(8);
  for (let k = 0; k < K; k++) {
    const at = 8 * motion.index[d * K + k];
    let dot = 0;
    for (let c = 0; c < 4; c++) dot += table[at + c] * table[first + c];
    const weight = motion.weight[d * K + k] * (dot < -1e-3 ? -1 : 1);
    for (let c = 0; c < 8; c++) sum[c] += weight * table[at + c];
  }
  const strength = motion.strength[d], sign = sum[0] < 0 && strength < 1 ? -strength : strength;
  for (let c = 0; c < 8; c++) sum[c] *= sign;
  sum[0] += 1 - strength;
  let length = Math.hypot(sum[0], sum[1], sum[2], sum[3]);
  if (length < 1e-4) { sum.fill(0); length = sum[0] = 1; }
  for (let c = 0; c < 8; c++) sum[c] /= length;
  const conjugate = [sum[0], -sum[1], -sum[2], -sum[3]], moved = [0, 0, 0];
  multiply(sum, 4, conjugate, 0, q, 0);
  rotate(sum, 0, splats.mean, 3 * row, moved);
  for (let axis = 0; axis < 3; axis++) posed.mean[3 * row + axis] = moved[axis] + 2 * q[axis + 1];
  multiply(sum, 0, splats.quat, 4 * row, posed.quat, 4 * row);
}

function presence(span, i, time) {
  const [a, b, c, d] = span.subarray(4 * i, 4 * i + 4);
  if (time >= b && time <= c) return 1;
  if (time < b) return time <= a ? 0 : (time - a) / (b - a);
  return time >= d ? 0 : (d - time) / (d - c);
}

// Writes the texels of row i: centre and opacity, covariance (6), colour.
function fill(i, posed, splats, opacity, colour, texels) {
  const [w, x, y, z] = posed.quat.subarray(4 * i, 4 * i + 4), [a, b, c] = splats.scale.subarray(3 * i, 3 * i + 3);
  const m = [
    (1 - 2 * (y * y + z * z)) * a, 2 * (x * y - w * z) * b, 2 * (x * z + w * y) * c,
    2 * (x * y + w * z) * a, (1 - 2 * (x * x + z * z)) * b, 2 * (y * z - w * x) * c,
    2 * (x * z - w * y) * a, 2 * (y * z + w * x) * b, (1 - 2 * (x * x + y * y)) * c,
  ];
  const dot = (i, j) => m[i] * m[j] + m[i + 1] * m[j + 1] + m[i + 2] * m[j + 2], at = 4 * TEXELS * i;
  texels.set(posed.mean.subarray(3 * i, 3 * i + 3), at);
  texels.set([opacity, dot(0, 0), dot(0, 3), dot(0, 6), dot(3, 3), dot(3, 6), dot(6, 6), 0], at + 3);
  texels.set(colour, at + 12);
}

const VERTEX = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D splats; uniform mat4 view; uniform vec4 K; uniform vec2 size; uniform float blur;
in uint row; out vec2 offset; flat out vec3 conic; flat out vec4 paint;
void main() {
  ivec2 at = ivec2(int(row % ${COLUMNS}u) * ${TEXELS}, int(row / ${COLUMNS}u));
  vec4 p = texelFetch(splats, at, 0), s = texelFetch(splats, at + ivec2(1, 0), 0), r = texelFetch(splats, at + ivec2(2, 0), 0);
  paint = vec4(texelFetch(splats, at + ivec2(3, 0), 0).rgb, p.w);
  vec3 c = (view * vec4(p.xyz, 1.0)).xyz;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); offset = vec2(0.0); conic = vec3(0.0);
  if (c.z <= ${NEAR} || p.w < ${ALPHA_MIN}) return;
  vec2 uv = c.xy / c.z, centre = uv * K.xy + K.zw, margin = ${MARGIN} * 0.5 * size / K.xy;
  uv = clamp(uv, -K.zw / K.xy - margin, (size - K.zw) / K.xy + margin);
  mat3 R = mat3(view), S = mat3(s.x, s.y, s.z, s.y, s.w, r.x, s.z, r.x, r.y);
  vec3 one = vec3(R[0].x, R[1].x, R[2].x), two = vec3(R[0].y, R[1].y, R[2].y), three = vec3(R[0].z, R[1].z, R[2].z);
  vec3 a = (one - three * uv.x) * K.x / c.z, b = (two - three * uv.y) * K.y / c.z;
  float xx = dot(a, S * a) + blur, yy = dot(b, S * b) + blur, xy = dot(a, S * b), det = xx * yy - xy * xy;
  if (det <= 0.0) return;
  conic = vec3(yy, -xy, xx) / det;
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  offset = corner * sqrt(vec2(xx, yy) * 2.0 * max(log(p.w / ${ALPHA_MIN}), 0.0));
  vec2 clip = (centre + offset) / size * 2.0 - 1.0;
  gl_Position = vec4(clip.x, -clip.y, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec2 offset; flat in vec3 conic; flat in vec4 paint; out vec4 colour;
void main() {
  float q = conic.x * offset.x * offset.x + 2.0 * conic.y * offset.x * offset.y + conic.z * offset.y * offset.y;
  float alpha = min(paint.a * exp(-0.5 * q), ${ALPHA_MAX});
  if (alpha < ${ALPHA_MIN}) discard;
  colour = vec4(paint.rgb * alpha, alpha);
}`;
const WHOLE = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
const SHOWN = `#version 300 es
precision highp float; uniform highp sampler2D picture; out vec4 colour;
void main() { colour = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.0); }`;

// Sorts rows by depth from back to front, in a worker.
const SORTER = `onmessage = ({ data: { mean, z, shift } }) => {
  const count = mean.length / 3, depth = new Float32Array(count), order = new Uint32Array(count);
  let near = Infinity, far = -Infinity;
  for (let i = 0; i < count; i++) {
    depth[i] = z[0] * mean[3 * i] + z[1] * mean[3 * i + 1] + z[2] * mean[3 * i + 2] + shift;
    if (depth[i] > ${NEAR}) { near = Math.min(near, depth[i]); far = Math.max(far, depth[i]); }
  }
  // Bands of equal inverse depth: fine where splats are near.
  const top = 1 / near, step = (${BANDS} - 1) / Math.max(top - 1 / far, 1e-12), band = new Uint16Array(count);
  const starts = new Uint32Array(${BANDS} + 1);
  for (let i = 0; i < count; i++) {
    band[i] = depth[i] > ${NEAR} ? Math.min(Math.max((1 / depth[i] - 1 / far) * step, 0), ${BANDS} - 1) : ${BANDS} - 1;
    starts[band[i] + 1]++;
  }
  for (let b = 0; b < ${BANDS}; b++) starts[b + 1] += starts[b];
  for (let i = 0; i < count; i++) order[starts[band[i]]++] = i;
  postMessage(order, [order.buffer]);
}`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "shader");
  return made;
}

function texture(gl, format, width, height) {
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
}

class Viewer {
  constructor(canvas, splats, motion) {
    Object.assign(this, { canvas, splats, motion, frame: 0, yaw: 0, pitch: 0, mark: -1 });
    this.posed = { mean: splats.mean.slice(), quat: splats.quat.slice() };
    const gl = this.gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw new Error("This browser has no WebGL 2 with float pictures.");
    this.rows = Math.max(Math.ceil(splats.count / COLUMNS), 1);
    this.texels = new Float32Array(4 * TEXELS * COLUMNS * this.rows);
    gl.activeTexture(gl.TEXTURE0);
    texture(gl, gl.RGBA32F, TEXELS * COLUMNS, this.rows);
    this.draws = program(gl, VERTEX, FRAGMENT);
    this.shows = program(gl, WHOLE, SHOWN);
    gl.activeTexture(gl.TEXTURE1);
    texture(gl, gl.RGBA16F, canvas.width, canvas.height); // 8 bits would round after every splat
    this.target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, gl.getParameter(gl.TEXTURE_BINDING_2D), 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    const row = gl.getAttribLocation(this.draws, "row");
    gl.enableVertexAttribArray(row);
    gl.vertexAttribIPointer(row, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(row, 1);
    this.row = row;
    this.sorter = new Worker(URL.createObjectURL(new Blob([SORTER])));
    this.pose(true);
  }

  // Poses what moves at this frame, or everything, and hands it to the graphics card.
  pose(all) {
    const { splats, motion, gl } = this, table = motion.index.length ? motionsAt(this.frame, motion) : null;
    const from = all || motion.span.length ? 0 : DATA.static;
    for (let i = from; i < splats.count; i++) {
      if (i >= DATA.static) carry(i - DATA.static, i, table, motion, splats, this.posed);
      let opacity = splats.opacity[i];
      if (motion.span.length) opacity = 1 - (1 - opacity) ** presence(motion.span, i, DATA.times[this.frame]);
      let colour = splats.rgb.subarray(3 * i, 3 * i + 3);
      if (this.mark >= 0 && motion.marks[this.mark * splats.count + i]) {
        colour = Array.from(colour, (value, c) => 0.4 * value + 0.6 * MARKS[this.mark % MARKS.length][c]);
      }
      fill(i, this.posed, splats, opacity, colour, this.texels);
    }
    const row = Math.floor(from / COLUMNS);
    gl.activeTexture(gl.TEXTURE0);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, TEXELS * COLUMNS, this.rows - row, gl.RGBA, gl.FLOAT, this.texels, 4 * TEXELS * COLUMNS * row);
  }

  // world_to_camera (row-major 4x4) of this frame's camera, swung about the point in front of it as `trajectory.aside` does.
  view() {
    const m = DATA.world_to_camera[this.frame], axis = (i) => m.slice(4 * i, 4 * i + 3), depth = DATA.depth;
    if (!this.yaw && !this.pitch) return m;
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const unit = (a) => a.map((value) => value / Math.hypot(...a));
    const centre = [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));
    const [a, b] = [this.yaw, this.pitch].map((degrees) => degrees * Math.PI / 180);
    const back = [Math.sin(a) * Math.cos(b), -Math.sin(b), -Math.cos(a) * Math.cos(b)];
    const target = centre.map((value, i) => value + depth * m[8 + i]);
    const eye = target.map((value, i) => value + depth * (back[0] * m[i] + back[1] * m[4 + i] + back[2] * m[8 + i]));
    const forward = unit(target.map((value, i) => value - eye[i])), right = unit(cross(axis(1), forward)), down = cross(forward, right);
    return [right, down, forward].flatMap((row) => [...row, -dot(row, eye)]).concat([0, 0, 0, 1]);
  }

  // Draws the present frame; resolves when the picture is there.
  async draw() {
    const m = this.view(), mean = this.posed.mean;
    this.sorter.postMessage({ mean, z: m.slice(8, 11), shift: m[11] });
    const order = await new Promise((done) => { this.sorter.onmessage = ({ data }) => done(data); });
    const { gl, canvas, draws } = this, uniform = (name) => gl.getUniformLocation(draws, name), K = DATA.intrinsics[this.frame];
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(draws);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform1i(uniform("splats"), 0);
    gl.uniformMatrix4fv(uniform("view"), true, m);
    gl.uniform4f(uniform("K"), ...K);
    gl.uniform2f(uniform("size"), canvas.width, canvas.height);
    gl.uniform1f(uniform("blur"), BLUR);
    gl.enableVertexAttribArray(this.row);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.splats.count);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.shows);
    gl.uniform1i(gl.getUniformLocation(this.shows, "picture"), 1);
    gl.disableVertexAttribArray(this.row);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}

// The three controls: time, dragging within the believed angle, and a button for each word.
function control(viewer) {
  const at = (id) => document.getElementById(id), slider = at("time"), play = at("play");
  let dirty = false, busy = false, playing = false, started = 0;
  const refresh = async () => {
    if (busy) { dirty = true; return; }
    busy = true;
    do { dirty = false; await viewer.draw(); } while (dirty);
    busy = false;
  };
  const show = (frame) => {
    if (frame === viewer.frame) return;
    viewer.frame = frame;
    slider.value = frame;
    viewer.pose(false);
    refresh();
  };
  const step = (now) => {
    if (!playing) return;
    show(Math.floor((now - started) / 1000 * DATA.fps) % DATA.times.length);
    requestAnimationFrame(step);
  };
  play.onclick = () => {
    playing = !playing;
    play.textContent = playing ? "Pause" : "Play";
    started = performance.now() - viewer.frame / DATA.fps * 1000;
    requestAnimationFrame(step);
  };
  slider.max = DATA.times.length - 1;
  slider.oninput = () => show(Number(slider.value));
  viewer.canvas.onpointermove = (event) => {
    if (!event.buttons) return;
    const yaw = viewer.yaw - event.movementX * 0.1, pitch = viewer.pitch + event.movementY * 0.1;
    const shrink = Math.min(1, DATA.degrees / Math.hypot(yaw, pitch, 1e-9));
    [viewer.yaw, viewer.pitch] = [yaw * shrink, pitch * shrink];
    refresh();
  };
  viewer.canvas.onpointerdown = (event) => viewer.canvas.setPointerCapture(event.pointerId);
  viewer.canvas.ondblclick = () => { viewer.yaw = viewer.pitch = 0; refresh(); };
  DATA.words.forEach((word, index) => {
    const button = document.createElement("button");
    button.textContent = word;
    button.onclick = () => { viewer.mark = viewer.mark === index ? -1 : index; viewer.pose(true); refresh(); };
    at("words").append(button);
  });
}

async function start() {
  const canvas = document.getElementById("view"), asked = new URLSearchParams(location.hash.slice(1));
  [canvas.width, canvas.height] = [DATA.width, DATA.height];
  const buffer = await unpacked(DATA.motion), motion = {};
  for (const [name, [kind, offset, length]] of Object.entries(DATA.layout)) {
    motion[name] = new { f: Float32Array, u: Uint32Array, b: Uint8Array }[kind](buffer, offset, length);
  }
  const viewer = new Viewer(canvas, splatsOf(await unpacked(DATA.splats)), motion);
  viewer.frame = Math.min(Math.max(Number(asked.get("frame")) || 0, 0), DATA.times.length - 1);
  [viewer.yaw, viewer.pitch] = [Number(asked.get("yaw")) || 0, Number(asked.get("pitch")) || 0];
  viewer.mark = DATA.words.indexOf(asked.get("word"));
  viewer.pose(true);
  await viewer.draw();
  document.getElementById("time").value = viewer.frame;
  if (asked.has("picture")) document.getElementById("message").textContent = canvas.toDataURL("image/png");
  control(viewer);
}
start().catch((error) => { document.getElementById("message").textContent = error.message; });
