// Draws one scene that plays, by the compositing rule of the raster room: projected ellipses widened by the blur of the fit,
// alpha cut at its smallest and largest, sRGB blended from back to front. `DATA` is the page's JSON; blobs are gzip in base64.
"use strict";
const ALPHA_MIN = 1 / 255, ALPHA_MAX = 0.99, NEAR = 0.01, BLUR = 0.3, MARGIN = 0.3, TEXELS = 4, COLUMNS = 512, WIDTH = TEXELS * COLUMNS;
const FINEST = 2, QUICK_MS = 30; // pixels a side for one of the clip's at most, and only where a frame stays below so many ms
const OPAQUE = 0.998; // what the largest byte may stand for; 1 would never fade
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
    opacity[i] = Math.min(view.getUint8(start.opacity + i) / 255, OPAQUE);
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
const BLEND = new Float64Array(8), CONJUGATE = new Float64Array(4), SHIFT = new Float64Array(4), MOVED = new Float64Array(3);
function carry(d, row, table, motion, splats, posed) {
  const { index, weight } = motion, K = DATA.slots, first = 8 * index[d * K], sum = BLEND.fill(0);
  for (let k = 0; k < K; k++) {
    const at = 8 * index[d * K + k];
    let dot = 0;
    for (let c = 0; c < 4; c++) dot += table[at + c] * table[first + c];
    const share = weight[d * K + k] * (dot < -1e-3 ? -1 : 1);
    for (let c = 0; c < 8; c++) sum[c] += share * table[at + c];
  }
  const strength = motion.strength[d], sign = sum[0] < 0 && strength < 1 ? -strength : strength;
  for (let c = 0; c < 8; c++) sum[c] *= sign;
  sum[0] += 1 - strength;
  let length = Math.sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2] + sum[3] * sum[3]);
  if (length < 1e-4) { sum.fill(0); length = sum[0] = 1; }
  for (let c = 0; c < 8; c++) sum[c] /= length;
  for (let c = 0; c < 4; c++) CONJUGATE[c] = c ? -sum[c] : sum[c];
  multiply(sum, 4, CONJUGATE, 0, SHIFT, 0);
  rotate(sum, 0, splats.mean, 3 * row, MOVED);
  for (let axis = 0; axis < 3; axis++) posed.mean[3 * row + axis] = MOVED[axis] + 2 * SHIFT[axis + 1];
  multiply(sum, 0, splats.quat, 4 * row, posed.quat, 4 * row);
}

function presence(span, i, time) {
  const a = span[4 * i], b = span[4 * i + 1], c = span[4 * i + 2], d = span[4 * i + 3];
  if (time >= b && time <= c) return 1;
  if (time < b) return time <= a ? 0 : (time - a) / (b - a);
  return time >= d ? 0 : (d - time) / (d - c);
}

// Writes centre and covariance (6) into the texels of row i; opacity and colour have their own places there.
function place(i, posed, { scale }, texels) {
  const { mean, quat } = posed, w = quat[4 * i], x = quat[4 * i + 1], y = quat[4 * i + 2], z = quat[4 * i + 3];
  const a = scale[3 * i], b = scale[3 * i + 1], c = scale[3 * i + 2], at = 4 * TEXELS * i;
  const xa = (1 - 2 * (y * y + z * z)) * a, xb = 2 * (x * y - w * z) * b, xc = 2 * (x * z + w * y) * c;
  const ya = 2 * (x * y + w * z) * a, yb = (1 - 2 * (x * x + z * z)) * b, yc = 2 * (y * z - w * x) * c;
  const za = 2 * (x * z - w * y) * a, zb = 2 * (y * z + w * x) * b, zc = (1 - 2 * (x * x + y * y)) * c;
  for (let axis = 0; axis < 3; axis++) texels[at + axis] = mean[3 * i + axis];
  texels[at + 4] = xa * xa + xb * xb + xc * xc;
  texels[at + 5] = xa * ya + xb * yb + xc * yc;
  texels[at + 6] = xa * za + xb * zb + xc * zc;
  texels[at + 7] = ya * ya + yb * yb + yc * yc;
  texels[at + 8] = ya * za + yb * zb + yc * zc;
  texels[at + 9] = za * za + zb * zb + zc * zc;
}

const VERTEX = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D splats; uniform highp usampler2D order; uniform mat4 view; uniform vec4 K; uniform vec2 size; uniform float blur;
out vec2 offset; flat out vec3 conic; flat out vec4 paint;
void main() {
  int quad = gl_VertexID / 4, row = int(texelFetch(order, ivec2(quad % ${WIDTH}, quad / ${WIDTH}), 0).r);
  ivec2 at = ivec2(row % ${COLUMNS} * ${TEXELS}, row / ${COLUMNS});
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
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  float half_gap = length(vec2(0.5 * (xx - yy), xy)), large = 0.5 * (xx + yy) + half_gap, reach = 2.0 * log(p.w / ${ALPHA_MIN});
  vec2 along = abs(xy) > 1e-6 ? normalize(vec2(xy, large - xx)) : xx < yy ? vec2(0.0, 1.0) : vec2(1.0, 0.0);
  corner *= sqrt(vec2(large, det / large) * reach); // the ellipse's own axes: a quad as small as it can be
  offset = corner.x * along + corner.y * vec2(-along.y, along.x);
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

// Sorts rows by depth from back to front, in a worker: by the bits of positive floats, which rise as they do, 16 at a time.
const SORTER = `onmessage = ({ data: { mean, z, shift } }) => {
  const count = mean.length / 3, size = Math.ceil(count / ${WIDTH}) * ${WIDTH}, depth = new Float32Array(count), bits = new Uint32Array(depth.buffer);
  for (let i = 0; i < count; i++) depth[i] = Math.max(z[0] * mean[3 * i] + z[1] * mean[3 * i + 1] + z[2] * mean[3 * i + 2] + shift, 0);
  let order = new Uint32Array(size).map((_, i) => i), other = new Uint32Array(size);
  for (const places of [0, 16]) {
    const starts = new Uint32Array(65537);
    for (let i = 0; i < count; i++) starts[65536 - (bits[i] >>> places & 65535)]++;
    for (let b = 0; b < 65536; b++) starts[b + 1] += starts[b];
    for (let k = 0; k < count; k++) other[starts[65535 - (bits[order[k]] >>> places & 65535)]++] = order[k];
    [order, other] = [other, order];
  }
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
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  return made;
}

class Viewer {
  constructor(canvas, splats, motion) {
    Object.assign(this, { canvas, splats, motion, frame: 0, yaw: 0, pitch: 0, mark: -1, posedFrame: -1 });
    this.posed = { mean: splats.mean.slice(), quat: splats.quat.slice() };
    const gl = this.gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2; use a newer one, or switch its graphics acceleration on.");
    const fine = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"); // phones: the second
    this.format = fine ? gl.RGBA16F : gl.RGBA8; // 8 bits round after every splat
    this.rows = Math.max(Math.ceil(splats.count / COLUMNS), 1);
    if (this.rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("More Gaussians than this browser can hold.");
    this.texels = new Float32Array(4 * WIDTH * this.rows);
    gl.activeTexture(gl.TEXTURE0);
    texture(gl, gl.RGBA32F, WIDTH, this.rows);
    gl.activeTexture(gl.TEXTURE2);
    texture(gl, gl.R32UI, WIDTH, Math.ceil(this.rows / TEXELS));
    this.draws = program(gl, VERTEX, FRAGMENT);
    this.shows = program(gl, WHOLE, SHOWN);
    this.target = gl.createFramebuffer();
    this.resize(1);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(6 * splats.count).map((_, i) => 4 * (i / 6 | 0) + [0, 1, 2, 2, 1, 3][i % 6]), gl.STATIC_DRAW);
    this.sorter = new Worker(URL.createObjectURL(new Blob([SORTER])));
  }

  // Draws from now on with `fine` pixels a side for each of the clip's.
  resize(fine) {
    const { gl, canvas } = this;
    [canvas.width, canvas.height, this.fine] = [DATA.width * fine, DATA.height * fine, fine];
    gl.activeTexture(gl.TEXTURE1);
    if (this.picture) gl.deleteTexture(this.picture);
    this.picture = texture(gl, this.format, canvas.width, canvas.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
  }

  // Writes the colours of all Gaussians, those of the marked word tinted; `pose` hands them on.
  paint() {
    const { splats, motion, texels } = this, tint = MARKS[this.mark % MARKS.length];
    for (let i = 0; i < splats.count; i++) {
      const marked = this.mark >= 0 && motion.marks[this.mark * splats.count + i];
      for (let c = 0; c < 3; c++) {
        const value = splats.rgb[3 * i + c];
        texels[4 * TEXELS * i + 12 + c] = marked ? 0.4 * value + 0.6 * tint[c] : value;
      }
    }
  }

  // Poses what moves at this frame, at first everything, and hands it to the graphics card.
  pose() {
    const { splats, motion, gl, posed, texels } = this, table = motion.index.length ? motionsAt(this.frame, motion) : null;
    const first = this.posedFrame < 0, fades = motion.span.length > 0, from = first || fades ? 0 : DATA.static;
    for (let i = from; i < splats.count; i++) {
      const moves = i >= DATA.static, at = 4 * TEXELS * i, opacity = splats.opacity[i];
      if (moves) carry(i - DATA.static, i, table, motion, splats, posed);
      if (moves || first) place(i, posed, splats, texels);
      texels[at + 3] = fades ? 1 - (1 - opacity) ** presence(motion.span, i, DATA.times[this.frame]) : opacity;
    }
    this.posedFrame = this.frame;
    this.upload(from);
  }

  upload(from) {
    const { gl } = this, row = Math.floor(from / COLUMNS);
    gl.activeTexture(gl.TEXTURE0);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, WIDTH, this.rows - row, gl.RGBA, gl.FLOAT, this.texels, 4 * WIDTH * row);
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

  // Draws the present frame, which may change meanwhile; resolves when the picture is there.
  async draw() {
    if (this.paintedMark !== this.mark) { this.paint(); this.paintedMark = this.mark; this.posedFrame = -1; }
    if (this.posedFrame !== this.frame) this.pose();
    const m = this.view(), K = DATA.intrinsics[this.frame].map((value) => value * this.fine);
    this.sorter.postMessage({ mean: this.posed.mean, z: m.slice(8, 11), shift: m[11] });
    const order = await new Promise((done) => { this.sorter.onmessage = ({ data }) => done(data); });
    const { gl, canvas, draws } = this, uniform = (name) => gl.getUniformLocation(draws, name);
    gl.activeTexture(gl.TEXTURE2);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDTH, order.length / WIDTH, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(draws);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform1i(uniform("splats"), 0);
    gl.uniform1i(uniform("order"), 2);
    gl.uniformMatrix4fv(uniform("view"), true, m);
    gl.uniform4f(uniform("K"), ...K);
    gl.uniform2f(uniform("size"), canvas.width, canvas.height);
    gl.uniform1f(uniform("blur"), BLUR * this.fine ** 2);
    gl.drawElements(gl.TRIANGLES, 6 * this.splats.count, gl.UNSIGNED_INT, 0); // instances of four corners are slower
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.shows);
    gl.uniform1i(gl.getUniformLocation(this.shows, "picture"), 1);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  // Draws again with more pixels where they would be seen and the graphics card is quick enough to play so.
  async refine() {
    const fine = Math.min(Math.ceil(this.canvas.getBoundingClientRect().width * devicePixelRatio / DATA.width), FINEST);
    const finished = () => this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
    finished();
    const began = performance.now();
    await this.draw();
    finished();
    if (fine > 1 && (performance.now() - began) * fine ** 2 < QUICK_MS) { this.resize(fine); await this.draw(); }
  }
}

// The three controls: time, dragging within the believed angle, and a button for each word.
function control(viewer) {
  const at = (id) => document.getElementById(id), slider = at("time"), play = at("play"), { canvas } = viewer;
  let dirty = false, busy = false, playing = false, started = 0, held = null;
  const refresh = async () => {
    if (busy) { dirty = true; return; }
    busy = true;
    do { dirty = false; await viewer.draw(); } while (dirty);
    busy = false;
  };
  const show = (frame) => {
    slider.value = frame;
    at("clock").textContent = `${(frame / DATA.fps).toFixed(1)} s`;
    if (frame === viewer.frame) return;
    viewer.frame = frame;
    refresh();
  };
  const step = (now) => { // `now` may be a little before the click
    if (!playing) return;
    show(Math.floor(Math.max(now - started, 0) / 1000 * DATA.fps) % DATA.times.length);
    requestAnimationFrame(step);
  };
  const setPlaying = (wanted) => {
    play.textContent = wanted ? "Pause" : "Play";
    if (playing === wanted) return;
    playing = wanted;
    started = performance.now() - viewer.frame / DATA.fps * 1000;
    requestAnimationFrame(step);
  };
  play.onclick = () => setPlaying(!playing);
  slider.max = DATA.times.length - 1;
  show(viewer.frame);
  for (const part of [play, slider, at("clock")]) part.hidden = DATA.times.length < 2;
  slider.oninput = () => { setPlaying(false); show(Number(slider.value)); };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    held = { x: event.clientX, y: event.clientY, yaw: viewer.yaw, pitch: viewer.pitch };
  };
  canvas.onpointermove = (event) => { // a drag over half the picture goes all the way
    if (!event.buttons || !held) return;
    const turn = 2 * DATA.degrees / Math.min(canvas.clientWidth, canvas.clientHeight);
    const yaw = held.yaw - (event.clientX - held.x) * turn, pitch = held.pitch + (event.clientY - held.y) * turn;
    const shrink = Math.min(1, DATA.degrees / Math.hypot(yaw, pitch, 1e-9));
    [viewer.yaw, viewer.pitch] = [yaw * shrink, pitch * shrink];
    refresh();
  };
  canvas.ondblclick = () => { viewer.yaw = viewer.pitch = 0; refresh(); };
  DATA.words.forEach((word, index) => {
    const button = document.createElement("button");
    button.textContent = word;
    button.onclick = () => {
      viewer.mark = viewer.mark === index ? -1 : index;
      for (const [i, other] of [...at("words").children].entries()) other.setAttribute("aria-pressed", i === viewer.mark);
      refresh();
    };
    at("words").append(button);
  });
  return setPlaying;
}

async function start() {
  const canvas = document.getElementById("view"), asked = new URLSearchParams(location.hash.slice(1));
  const buffer = await unpacked(DATA.motion), motion = {};
  for (const [name, [kind, offset, length]] of Object.entries(DATA.layout)) {
    motion[name] = new { f: Float32Array, u: Uint32Array, b: Uint8Array }[kind](buffer, offset, length);
  }
  const viewer = new Viewer(canvas, splatsOf(await unpacked(DATA.splats)), motion), message = document.getElementById("message");
  viewer.frame = Math.min(Math.max(Number(asked.get("frame")) || 0, 0), DATA.times.length - 1);
  [viewer.yaw, viewer.pitch] = [Number(asked.get("yaw")) || 0, Number(asked.get("pitch")) || 0];
  viewer.mark = DATA.words.indexOf(asked.get("word"));
  await viewer.draw();
  if (asked.has("picture")) { message.textContent = canvas.toDataURL("image/png"); return; }
  message.textContent = document.body.dataset.hint;
  await viewer.refine();
  const setPlaying = control(viewer);
  setPlaying(!asked.has("frame"));
}
const complain = (error) => { document.getElementById("message").textContent = error.message; };
addEventListener("error", complain);
start().catch(complain);
