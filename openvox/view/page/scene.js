"use strict";
// A voxel map drawn by WebGL 2: one quad for each open face, turned by finger, mouse or keys.

const VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 cell;
layout(location = 1) in float place;
layout(location = 2) in vec2 faceAndConfidence;
uniform mat4 projection;
uniform vec3 eye;
uniform vec2 middle;
uniform float floorTop, ceiling;
uniform int walls; // 0 all, 1 cut away, 2 none
flat out float v_place;
flat out float v_light;
flat out float v_confidence;
out vec2 v_corner;
const float LIGHT[6] = float[6](0.80, 0.66, 0.72, 0.88, 0.50, 1.00);
void main() {
  int face = int(faceAndConfidence.x);
  int axis = face / 2;
  float upper = float(face % 2);
  vec2 corner = vec2(float(gl_VertexID % 2), float(gl_VertexID / 2));
  vec3 at = cell + (axis == 0 ? vec3(upper, corner) : axis == 1 ? vec3(corner.x, upper, corner.y) : vec3(corner, upper));
  bool near = dot(cell.xy - middle, eye.xy - middle) > 0.0;
  bool cut = walls == 2 || (walls == 1 && cell.z > floorTop && (near || cell.z >= ceiling));
  float side = eye[axis] - at[axis];
  bool away = upper > 0.5 ? side <= 0.0 : side >= 0.0;
  gl_Position = away || (place == 0.0 && cut) ? vec4(2.0, 2.0, 2.0, 1.0) : projection * vec4(at, 1.0);
  v_place = place;
  v_light = LIGHT[face];
  v_confidence = faceAndConfidence.y / 255.0;
  v_corner = corner;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
flat in float v_place;
flat in float v_light;
flat in float v_confidence;
in vec2 v_corner;
uniform sampler2D palette;
uniform vec3 dim;
uniform bool byConfidence, picking;
out vec4 color;
const vec3 RAMP[5] = vec3[5](
  vec3(0.27, 0.00, 0.33), vec3(0.23, 0.32, 0.55), vec3(0.13, 0.57, 0.55), vec3(0.37, 0.79, 0.38), vec3(0.99, 0.91, 0.15));
void main() {
  int place = int(v_place + 0.5);
  if (picking) {
    color = vec4(float(place % 256) / 255.0, float(place / 256) / 255.0, 1.0, 1.0);
    return;
  }
  vec4 own = texelFetch(palette, ivec2(place % 256, place / 256), 0);
  vec3 base = own.rgb;
  if (byConfidence && place > 0) {
    float at = clamp(v_confidence, 0.0, 1.0) * 4.0;
    int low = min(int(at), 3);
    base = mix(RAMP[low], RAMP[low + 1], at - float(low));
  }
  base = mix(dim, base, own.a);
  vec2 width = fwidth(v_corner);
  vec2 border = min(v_corner, 1.0 - v_corner) / max(width, vec2(1e-4));
  float line = 1.0 - clamp(min(border.x, border.y), 0.0, 1.0);
  float strength = 0.16 * clamp(1.2 - 5.0 * max(width.x, width.y), 0.0, 1.0);
  color = vec4(base * v_light * (1.0 - strength * line), 1.0);
}`;

const LENS = 0.30; // half of the picture's smaller side, at distance 1
const FACE_BYTES = 12;

/** Where the scenes of a page are looked at from; they turn together. Metres and radians. */
class View {
  constructor(low, high) {
    this.low = low;
    this.high = high;
    this.listeners = [];
    this.home();
  }
  home() {
    this.azimuth = this.first ?? 0.9;
    this.elevation = 0.75;
    this.target = [0, 1, 2].map((a) => (this.low[a] + this.high[a]) / 2);
    this.zoom = 1;
    this.changed();
  }
  changed() {
    this.elevation = Math.min(1.55, Math.max(-0.3, this.elevation));
    this.zoom = Math.min(20, Math.max(0.3, this.zoom));
    for (const listen of this.listeners) listen();
  }
  axes() {
    const [c, s, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    return { right: [-s, c, 0], up: [-c * se, -s * se, ce], back: [c * ce, s * ce, se] };
  }
  /** Distance at which all corners of the map are inside a picture of this shape. */
  distance(lensX, lensY) {
    const { right, up, back } = this.axes();
    const middle = [0, 1, 2].map((a) => (this.low[a] + this.high[a]) / 2);
    let far = 0.5;
    for (let corner = 0; corner < 8; corner++) {
      const d = [0, 1, 2].map((a) => (corner >> a & 1 ? this.high[a] : this.low[a]) - middle[a]);
      const needed = Math.max(Math.abs(dot(d, right)) / lensX, Math.abs(dot(d, up)) / lensY) + dot(d, back);
      far = Math.max(far, needed);
    }
    return far / this.zoom;
  }
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

/** The open faces of the cells, 12 bytes each: x, y, z, place (16 bits), face, confidence, 2 of padding. */
function facesOf(map) {
  const cells = new DataView(bytesOf(map.cells).buffer);
  const count = cells.byteLength / 10;
  let total = 0;
  for (let i = 0; i < count; i++) for (let f = cells.getUint8(i * 10 + 8); f; f &= f - 1) total++;
  const out = new DataView(new ArrayBuffer(total * FACE_BYTES));
  let at = 0;
  for (let i = 0; i < count; i++) {
    const open = cells.getUint8(i * 10 + 8);
    for (let face = 0; face < 6; face++) {
      if (!(open >> face & 1)) continue;
      for (let k = 0; k < 4; k++) out.setUint16(at + 2 * k, cells.getUint16(i * 10 + 2 * k, true), true);
      out.setUint8(at + 8, face);
      out.setUint8(at + 9, cells.getUint8(i * 10 + 9));
      at += FACE_BYTES;
    }
  }
  return { buffer: out.buffer, total };
}

class Scene {
  /** map: as the page's data hold it. onPick(place): a voxel was clicked, 0 = none of an instance. */
  constructor(canvas, map, view, onPick) {
    this.canvas = canvas;
    this.map = map;
    this.view = view;
    this.onPick = onPick;
    this.walls = 1;
    this.selected = new Set();
    this.mode = map.palettes[0].name;
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.build();
    view.listeners.push(() => this.ask());
    new ResizeObserver(() => this.ask()).observe(canvas);
    listenTo(this);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.build(); this.ask(); });
  }

  build() {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no shader");
    gl.useProgram(program);
    this.at = new Proxy({}, { get: (_, name) => gl.getUniformLocation(program, name) });
    const faces = facesOf(this.map);
    this.total = faces.total;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, faces.buffer, gl.STATIC_DRAW);
    for (const [where, size, type, offset] of [[0, 3, gl.UNSIGNED_SHORT, 0], [1, 1, gl.UNSIGNED_SHORT, 6], [2, 2, gl.UNSIGNED_BYTE, 8]]) {
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, size, type, false, FACE_BYTES, offset);
      gl.vertexAttribDivisor(where, 1);
    }
    gl.enable(gl.DEPTH_TEST);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.paint();
  }

  /** Colours by place into the palette; what is not selected fades. */
  paint() {
    const gl = this.gl;
    const found = this.map.palettes.find((palette) => palette.name === this.mode) ?? this.map.palettes[0];
    const rows = Math.ceil((this.map.ids.length + 1) / 256);
    const texels = new Uint8Array(256 * 4 * rows);
    const structure = rgb("--structure");
    texels.set([...structure.map((x) => Math.round(255 * x)), this.selected.size ? 140 : 255]);
    found.colors.forEach((color, i) => {
      texels.set([...color, !this.selected.size || this.selected.has(i + 1) ? 255 : 70], 4 * (i + 1));
    });
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, rows, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    gl.uniform1i(this.at.byConfidence, Number(this.mode === "confidence"));
  }

  set(changes) {
    Object.assign(this, changes);
    this.paint();
    this.ask();
  }

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.draw(); });
  }

  draw(picking = false) {
    const { gl, canvas, view, map } = this;
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const least = Math.min(width, height);
    const lens = [LENS * width / least, LENS * height / least];
    const { right, up, back } = view.axes();
    const distance = view.distance(...lens);
    const eye = [0, 1, 2].map((a) => view.target[a] + distance * back[a]);
    const [near, far] = [distance * 0.02, distance * 2 + 200];
    const depth = [(far + near) / (near - far), 2 * far * near / (near - far)];
    const size = map.size;
    const origin = map.low.map((x) => x * size);
    const column = (axis) => [right[axis] / lens[0], up[axis] / lens[1], depth[0] * back[axis], -back[axis]].map((x) => x * size);
    const offset = [0, 1, 2].map((a) => origin[a] - eye[a]);
    const last = [dot(offset, right) / lens[0], dot(offset, up) / lens[1], depth[0] * dot(offset, back) + depth[1], -dot(offset, back)];
    const inCells = (point) => point.map((x, a) => (x - origin[a]) / size);
    gl.viewport(0, 0, width, height);
    gl.uniformMatrix4fv(this.at.projection, false, [...column(0), ...column(1), ...column(2), ...last]);
    gl.uniform3fv(this.at.eye, inCells(eye));
    gl.uniform2fv(this.at.middle, inCells(view.low.map((x, a) => (x + view.high[a]) / 2)).slice(0, 2));
    gl.uniform1f(this.at.floorTop, map.floor);
    gl.uniform1f(this.at.ceiling, map.ceiling);
    gl.uniform1i(this.at.walls, this.walls);
    gl.uniform3fv(this.at.dim, rgb("--dim"));
    gl.uniform1i(this.at.picking, Number(picking));
    gl.clearColor(...(picking ? [0, 0, 0] : rgb("--scene")), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.total);
    this.step = 2 * LENS * distance / least * scale; // metres a pixel of the page
  }

  /** Place of the instance under a point of the page, 0 = none. */
  pick(x, y) {
    const gl = this.gl;
    const [width, height] = [this.canvas.width, this.canvas.height];
    const frame = gl.createFramebuffer();
    const target = [gl.createRenderbuffer(), gl.createRenderbuffer()];
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]].forEach(([format, where], i) => {
      gl.bindRenderbuffer(gl.RENDERBUFFER, target[i]);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, where, gl.RENDERBUFFER, target[i]);
    });
    this.draw(true);
    const box = this.canvas.getBoundingClientRect();
    const texel = new Uint8Array(4);
    const [u, v] = [(x - box.left) / box.width * width, (1 - (y - box.top) / box.height) * height];
    gl.readPixels(Math.floor(u), Math.floor(v), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, texel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    target.forEach((buffer) => gl.deleteRenderbuffer(buffer));
    this.ask();
    return texel[2] === 255 ? texel[0] + 256 * texel[1] : 0;
  }
}

/** A colour of the page's style, 0 .. 1. */
function rgb(name) {
  const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16) / 255);
}

/** Fingers, mouse and keys turn, move and zoom a scene's view. */
function listenTo(scene) {
  const { canvas, view } = scene;
  const fingers = new Map();
  let moved = 0;
  const turn = (dx, dy) => { view.azimuth -= dx * 0.008; view.elevation += dy * 0.008; };
  const shift = (dx, dy) => {
    const { right, up } = view.axes();
    view.target = view.target.map((x, a) => x - (dx * right[a] - dy * up[a]) * scene.step);
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (!fingers.size) moved = 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    try { canvas.setPointerCapture(event.pointerId); } catch { /* the pointer is gone already */ }
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (fingers.size === 1) {
      (event.shiftKey || event.buttons & 6 ? shift : turn)(dx, dy);
    } else {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (a) => Math.max(1, Math.hypot(a[0] - other[0], a[1] - other[1]));
      view.zoom *= apart(now) / apart(before);
      shift(dx / 2, dy / 2);
    }
    fingers.set(event.pointerId, now);
    view.changed();
  });
  const lift = (event) => {
    if (fingers.delete(event.pointerId) && event.type === "pointerup" && moved < 6 && !fingers.size) {
      scene.onPick(scene.pick(event.clientX, event.clientY));
    }
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return; // the wheel scrolls the page until the map is clicked
    event.preventDefault();
    view.zoom *= Math.exp(-event.deltaY * 0.0015);
    view.changed();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => turn(-20, 0), ArrowRight: () => turn(20, 0), ArrowUp: () => turn(0, 20), ArrowDown: () => turn(0, -20),
      "+": () => { view.zoom *= 1.2; }, "=": () => { view.zoom *= 1.2; }, "-": () => { view.zoom /= 1.2; }, Home: () => view.home(),
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
    view.changed();
  });
}
