// Shows a robot on a canvas: shaded solids with a depth buffer, seen from any side. No WebGL: it is drawn the same where
// there is no GPU.
// Each `figure.player` holds as JSON a film (report/scene.py) or the beginning of a live robot (report/live.py), and
// gets canvas, buttons and keys here.
"use strict";
(() => {
  const AROUND = 24, FINE = 1.2e6, NEAR = 0.02, TURN = 0.12;

  const INK = "#1c2126", ALARM = "#c1121f", LOAD = "#009E73", AXIS = "#0072B2", TOUCH = [1, 0.55, 0.05];
  const DARK = matchMedia("(prefers-color-scheme: dark)");
  const LINES = { false: ["#0072B2", "#C04F00", "#007A59", "#A8447E"], true: ["#56B4E9", "#F2994A", "#2CC295", "#E29BC4"] };
  const line = (i, count) => (count > 4 ? `hsl(${(360 * i) / count} 70% ${DARK.matches ? 65 : 38}%)` : LINES[DARK.matches][i]);
  const SHOWN_S = 8;
  // Views of a robot that looks along x: the directions of the camera, rad.
  const SIDES = { "a corner": {}, "the front": { yaw: Math.PI, pitch: -0.1 }, "the right": { yaw: Math.PI / 2, pitch: -0.1 },
    above: { yaw: 0, pitch: -1.5 } };

  const clamp = (x, low, high) => Math.max(low, Math.min(high, x));
  const make = (tag, properties = {}, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };
  const named = (element, label) => { element.setAttribute("aria-label", label); return element; };
  const button = (words, onclick) => make("button", { type: "button", onclick }, words);

  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function unit(a) { const n = Math.hypot(...a) || 1; return a.map((x) => x / n); }
  function cross(a, b) {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  }

  // The faces of a solid: corners anticlockwise seen from outside, and the surface's normal at each.
  // Solids of revolution are bands between two rings of [radius, height, outward and upward part of the normal].
  function solid(shape) {
    const [a, b, c] = shape.size, bands = [];
    if (shape.kind === "box") return box(shape.size);
    const arc = (from, to, steps, z) => {
      const ring = (i) => {
        const t = from + ((to - from) * i) / steps;
        return [a * Math.cos(t), z + a * Math.sin(t), Math.cos(t), Math.sin(t)];
      };
      for (let i = 0; i < steps; i++) bands.push([ring(i), ring(i + 1)]);
    };
    if (shape.kind === "capsule") {
      arc(-Math.PI / 2, 0, 6, -b);
      bands.push([[a, -b, 1, 0], [a, b, 1, 0]]);
      arc(0, Math.PI / 2, 6, b);
    } else if (shape.kind === "cylinder")
      bands.push([[0, -b, 0, -1], [a, -b, 0, -1]], [[a, -b, 1, 0], [a, b, 1, 0]], [[a, b, 0, 1], [0, b, 0, 1]]);
    else arc(-Math.PI / 2, Math.PI / 2, 12, 0);
    const scale = shape.kind === "ellipsoid" ? [1, b / a, c / a] : [1, 1, 1];
    const corner = ([radius, z, out, up], k) => {
      const t = (2 * Math.PI * k) / AROUND, x = Math.cos(t), y = Math.sin(t);
      return {
        point: [radius * x, radius * y * scale[1], z * scale[2]],
        normal: unit([out * x, (out * y) / scale[1], up / scale[2]]),
      };
    };
    const faces = [];
    for (const [low, high] of bands)
      for (let k = 0; k < AROUND; k++)
        faces.push([corner(low, k), corner(low, k + 1), corner(high, k + 1), corner(high, k)]);
    return faces.map(face);
  }

  function box(size) {
    const faces = [];
    for (let axis = 0; axis < 3; axis++)
      for (const sign of [-1, 1]) {
        const normal = [0, 1, 2].map((i) => (i === axis ? sign : 0));
        const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([s, t]) => {
          const point = size.map((x, i) => (i === axis ? sign * x : i === (axis + 1) % 3 ? s * x : t * x));
          return { point, normal };
        });
        faces.push(face(sign > 0 ? corners : corners.reverse()));
      }
    return faces;
  }

  function face(corners) {
    const [p, q, r, s] = corners.map((corner) => corner.point);
    return { corners, normal: unit(cross(r.map((x, i) => x - p[i]), s.map((x, i) => x - q[i]))) };
  }

  // The convex hull of points in a plane, in order around it.
  function hull(points) {
    const half = (sorted) => {
      const kept = [];
      for (const p of sorted) {
        const turns = (a, b) => (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        while (kept.length > 1 && turns(kept.at(-2), kept.at(-1)) <= 0) kept.pop();
        kept.push(p);
      }
      return kept;
    };
    points.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    return [...half(points), ...half(points.reverse())];
  }

  // Position and unit quaternion (w x y z) of a shape as a 3 x 4 matrix.
  function placed(p) {
    const n = Math.hypot(p[3], p[4], p[5], p[6]), [w, x, y, z] = [p[3] / n, p[4] / n, p[5] / n, p[6] / n];
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), p[0]],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), p[1]],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), p[2]],
    ];
  }
  function turned(m, v) { return m.map((row) => dot(row, v)); }
  function moved(m, v) { return m.map((row) => dot(row, v) + row[3]); }

  // A canvas, the camera and the mouse; `pose()` says what there is to see.
  class View {
    constructor(figure, data) {
      this.figure = figure;
      this.data = data;
      this.solids = data.shapes.map(solid);
      this.pointers = new Map();
      this.view = this.start();
      this.canvas = make("canvas", { tabIndex: 0 });
      this.canvas.setAttribute("role", "application");
      const on = (name, act, options) => this.canvas.addEventListener(name, act, options);
      on("keydown", (event) => this.key(event, this.viewKeys()));
      on("wheel", (event) => {
        if (!this.scrolls(event)) return;
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY / 600), event);
      }, { passive: false });
      on("contextmenu", (event) => event.preventDefault());
      on("pointerdown", (event) => {
        this.canvas.focus({ preventScroll: true });
        this.canvas.setPointerCapture(event.pointerId);
        this.pointers.set(event.pointerId, event);
        const pans = event.button > 0 || event.shiftKey || this.pointers.size > 1;
        if (this.act === "hold") this.let();
        this.act = pans ? "pan" : this.hold(event) ? "hold" : "turn";
      });
      on("pointermove", (event) => this.move(event));
      for (const name of ["pointerup", "pointercancel"])
        on(name, (event) => {
          this.pointers.delete(event.pointerId);
          if (this.act === "hold") this.let();
          this.act = null;
        });
    }

    // What stands in the figure: the canvas, a bar with the buttons of this player, speeds and those of every camera, words.
    build(buttons, speeds, act, hint, ...more) {
      const speed = named(make("select", { onchange: () => act(Number(speed.value)) }, ...speeds.map((value) =>
        make("option", { value, selected: value === 1 }, (value < 1 ? `1/${1 / value}` : value) + " ×"))), "Speed");
      this.followed = button("Camera: follows", () => this.follow());
      this.words = make("p", { className: "told" });
      const choose = () => { this.home(from.value); from.selectedIndex = 0; };
      const from = named(make("select", { onchange: choose }, make("option", { hidden: true }, "View from"),
        ...Object.keys(SIDES).map((value, i) => make("option", { value }, `${value} (${i + 1})`))), "View from");
      const bar = make("div", { className: "controls" }, ...buttons, speed, from, this.followed, button("Reset view", () => this.home()));
      const parts = [this.canvas, bar, this.words, make("p", { className: "hint" }, hint)];
      this.figure.querySelector(".stage").replaceChildren(...(more.length ? [make("div", { className: "scene" }, ...parts)] : parts), ...more);
      new ResizeObserver(() => this.draw()).observe(this.canvas);
    }

    hold() { return false; }
    let() {}
    scrolls() { return document.activeElement === this.canvas; }
    start() { return { yaw: this.data.yaw, pitch: this.data.pitch, zoom: 1, pan: [0, 0, 0], place: null }; }
    // The view as at first, or from a side of the robot as it stood then.
    home(side) {
      this.view = { ...this.start(), ...SIDES[side] };
      this.draw();
    }

    // The camera follows the robot, or stays where it is.
    follow() {
      this.view.place = this.view.place ? null : this.anchor(this.pose());
      this.followed.textContent = this.view.place ? "Camera: stays" : "Camera: follows";
      this.draw();
    }

    move(event) {
      const before = this.pointers.get(event.pointerId);
      if (!before) return;
      const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
      if (this.pointers.size > 1) {
        const other = [...this.pointers.values()].find((each) => each.pointerId !== event.pointerId);
        const apart = (each) => Math.hypot(each.clientX - other.clientX, each.clientY - other.clientY) || 1;
        this.zoom(apart(before) / apart(event), event);
        this.pan(-dx / 2, -dy / 2);
      } else if (this.act === "turn") this.turn(-dx / 150, -dy / 150);
      else if (this.act === "pan") this.pan(-dx, -dy);
      else if (this.act === "hold") this.pull(event);
      this.pointers.set(event.pointerId, event);
    }

    key(event, actions) {
      const act = actions[event.key.length > 1 ? event.key : event.key.toLowerCase()];
      if (event.ctrlKey || event.metaKey || event.altKey || !act) return;
      event.preventDefault();
      act();
    }
    viewKeys() {
      return {
        ArrowLeft: () => this.turn(-TURN, 0), ArrowRight: () => this.turn(TURN, 0),
        ArrowUp: () => this.turn(0, -TURN), ArrowDown: () => this.turn(0, TURN),
        "+": () => this.zoom(0.87), "=": () => this.zoom(0.87), "-": () => this.zoom(1.15),
        Home: () => this.home(), f: () => this.follow(),
        ...this.sideKeys(),
      };
    }

    sideKeys() { return Object.fromEntries(Object.keys(SIDES).map((side, i) => [i + 1, () => this.home(side)])); }

    turn(yaw, pitch) {
      this.view.yaw += yaw;
      this.view.pitch = clamp(this.view.pitch + pitch, -1.5, 1.5);
      this.draw();
    }
    // Move what the camera looks at by so many pixels to the right and down.
    pan(x, y) {
      const { right, up, metres } = this.camera;
      this.view.pan = this.view.pan.map((at, i) => at + metres * (x * right[i] - y * up[i]));
      this.draw();
    }
    // What is under the pointer stays there.
    zoom(factor, event) {
      const zoom = clamp(this.view.zoom * factor, 0.1, 6), share = 1 - zoom / this.view.zoom;
      if (event) {
        const box = this.canvas.getBoundingClientRect();
        const aside = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
        this.pan(share * aside[0], share * aside[1]);
      }
      this.view.zoom = zoom;
      this.draw();
    }

    // The number of the shape under the pointer and how far away it is.
    hit(event) {
      const box = this.canvas.getBoundingClientRect(), seen = this.seen, ratio = this.canvas.width / box.width;
      if (!seen) return null;
      const x = Math.floor((event.clientX - box.left) * ratio * seen.fine) - seen.left;
      const y = Math.floor((event.clientY - box.top) * ratio * seen.fine) - seen.top;
      const i = y * seen.width + x;
      if (x < 0 || y < 0 || x >= seen.width || y >= seen.height || !seen.depth[i]) return null;
      return { shape: seen.owner[i], depth: 1 / seen.depth[i] };
    }
    // The place under the pointer at this depth.
    place(event, depth) {
      const box = this.canvas.getBoundingClientRect(), { eye, forward, right, up, focus, width, height } = this.camera;
      const ratio = width / box.width;
      const x = ((event.clientX - box.left) * ratio - width / 2) / focus;
      const y = (height / 2 - (event.clientY - box.top) * ratio) / focus;
      return eye.map((at, i) => at + depth * (forward[i] + x * right[i] + y * up[i]));
    }

    height(ground, x, y) { return ground[0] + ground[1] * x + ground[2] * y; }
    anchor({ torsos, ground }) {
      const [x, y] = [0, 1].map((i) => torsos.reduce((sum, torso) => sum + torso[i], 0) / torsos.length);
      return [x, y, this.data.middle + this.height(ground, x, y)];
    }

    draw() {
      const ratio = Math.min(window.devicePixelRatio || 1, 2), box = this.canvas.getBoundingClientRect();
      const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio), pose = this.pose();
      if (!width || !height) return;
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      const data = this.data, { yaw, pitch, zoom, pan, place } = this.view;
      const forward = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
      const right = [Math.sin(yaw), -Math.cos(yaw), 0], up = cross(right, forward);
      const target = (place || this.anchor(pose)).map((x, i) => x + pan[i]);
      const distance = zoom * data.distance * Math.max(1, ((pose.torsos.length > 1 ? 1.1 : 0.8) * height) / width);
      const eye = target.map((x, i) => x - distance * forward[i]), focus = height / 2 / data.field;
      this.camera = {
        eye, forward, right, up, focus, width, height, ratio, metres: (distance / focus) * ratio,
        see: (p) => {
          const away = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]], depth = dot(away, forward);
          if (depth < NEAR) return null;
          return [width / 2 + (focus * dot(away, right)) / depth, height / 2 - (focus * dot(away, up)) / depth, depth];
        },
      };
      const context = this.canvas.getContext("2d");
      const horizon = Math.max(1, height / 2 + focus * Math.tan(clamp(pitch, -1.4, 1.4)));
      const sky = context.createLinearGradient(0, horizon - height / 2, 0, horizon);
      sky.addColorStop(0, DARK.matches ? "#2b3947" : "#d5dfea"); sky.addColorStop(1, DARK.matches ? "#1d2329" : "#ffffff");
      context.fillStyle = sky;
      context.fillRect(0, 0, width, height);
      const matrices = pose.shapes.map(placed), over = eye[2] > this.height(pose.ground, eye[0], eye[1]);
      if (data.grid && over) this.drawGround(context, this.camera, target, matrices, pose.ground);
      this.drawSolids(context, this.camera, matrices);
      if (this.touching) {
        const { seen } = this;
        context.globalAlpha = 0.7;
        this.drawSolids(context, this.camera, matrices, TOUCH);
        Object.assign(this, { seen });
        context.globalAlpha = 1;
      }
      for (const arrow of pose.arrows) this.drawArrow(context, this.camera, arrow);
      this.canvas.dataset.yaw = yaw.toFixed(3);
    }

    drawGround(context, camera, target, matrices, ground) {
      const { grid, light } = this.data, reach = 16 * grid;
      const [x0, y0] = target.slice(0, 2).map((x) => Math.round(x / grid) * grid);
      context.lineWidth = Math.max(1, camera.height / 500);
      for (let k = -16; k <= 16; k++) {
        const half = Math.sqrt(Math.max(0, reach * reach - k * k * grid * grid)), pieces = 8;
        for (const axis of [0, 1])
          for (let i = 0; i < pieces; i++) {
            const at = (j) => half * ((2 * j) / pieces - 1);
            const point = (s) => {
              const [x, y] = axis ? [x0 + k * grid, y0 + s] : [x0 + s, y0 + k * grid];
              return [x, y, this.height(ground, x, y)];
            };
            const a = camera.see(point(at(i))), b = camera.see(point(at(i + 1)));
            if (!a || !b) continue;
            const fade = 1 - Math.hypot(k * grid, (at(i) + at(i + 1)) / 2) / reach;
            context.strokeStyle = `rgba(120, 124, 130, ${(0.6 * Math.max(0, fade)).toFixed(3)})`;
            context.beginPath();
            context.moveTo(a[0], a[1]);
            context.lineTo(b[0], b[1]);
            context.stroke();
          }
      }
      const falls = ground[1] * light[0] + ground[2] * light[1] - light[2];
      context.beginPath();
      matrices.forEach((matrix, s) => {
        if (this.data.shapes[s].hidden) return;
        const points = this.solids[s].flatMap((f) => f.corners.slice(0, 2)).map(({ point }) => {
          const p = moved(matrix, point), t = Math.max(p[2] - this.height(ground, p[0], p[1]), 0) / falls;
          return camera.see(p.map((x, i) => x + t * light[i]));
        });
        if (points.every(Boolean)) hull(points).forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
      });
      context.fillStyle = DARK.matches ? "rgba(0, 0, 0, 0.5)" : "rgba(40, 40, 50, 0.28)";
      context.fill("nonzero");
    }

    // Triangles with a depth buffer into a picture of their own, finer than the canvas, which smooths the edges: of the
    // shapes with looks in their colours, or of those that touch in this one.
    drawSolids(context, camera, matrices, paint) {
      const fine = Math.min(2, Math.sqrt(FINE / (camera.width * camera.height))), triangles = [];
      const [ambient, diffuse, headlight, skylight] = this.data.brightness;
      let left = Infinity, right = -Infinity, top = Infinity, bottom = -Infinity;
      const drawn = ({ hidden, touches }) => (paint ? touches : !hidden);
      matrices.forEach((matrix, s) => drawn(this.data.shapes[s]) && this.solids[s].forEach((f) => {
        const first = moved(matrix, f.corners[0].point);
        if (dot(first.map((x, i) => x - camera.eye[i]), turned(matrix, f.normal)) >= 0) return;
        const seen = f.corners.map(({ point, normal }) => {
          const at = camera.see(moved(matrix, point)), out = turned(matrix, normal);
          const facing = (way) => Math.max(0, -dot(out, way));
          const light = ambient * (1 + skylight * out[2]) + diffuse * facing(this.data.light) + headlight * facing(camera.forward);
          return at && [at[0] * fine, at[1] * fine, 1 / at[2], light];
        });
        if (seen.some((p) => !p)) return;
        for (const [x, y] of seen) {
          left = Math.min(left, x); right = Math.max(right, x);
          top = Math.min(top, y); bottom = Math.max(bottom, y);
        }
        triangles.push([seen[0], seen[1], seen[2], s], [seen[0], seen[2], seen[3], s]);
      }));
      left = Math.max(0, Math.floor(left)); right = Math.min(Math.ceil(camera.width * fine), Math.ceil(right) + 1);
      top = Math.max(0, Math.floor(top)); bottom = Math.min(Math.ceil(camera.height * fine), Math.ceil(bottom) + 1);
      this.seen = null;
      if (right <= left || bottom <= top) return;
      const width = right - left, height = bottom - top, picture = new ImageData(width, height);
      const pixels = new Uint32Array(picture.data.buffer), depth = new Float32Array(width * height);
      const owner = new Uint16Array(width * height);
      this.seen = { fine, left, top, width, height, depth, owner };
      for (const [a, b, c, s] of triangles) {
        const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if (Math.abs(area) < 1e-6) continue;
        const color = (paint || this.data.shapes[s].color).map((x) => 255 * x);
        const x0 = Math.max(left, Math.ceil(Math.min(a[0], b[0], c[0]) - 0.5));
        const x1 = Math.min(right - 1, Math.floor(Math.max(a[0], b[0], c[0]) - 0.5));
        const y0 = Math.max(top, Math.ceil(Math.min(a[1], b[1], c[1]) - 0.5));
        const y1 = Math.min(bottom - 1, Math.floor(Math.max(a[1], b[1], c[1]) - 0.5));
        for (let y = y0; y <= y1; y++)
          for (let x = x0; x <= x1; x++) {
            const px = x + 0.5 - a[0], py = y + 0.5 - a[1];
            const v = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / area;
            const w = (py * (b[0] - a[0]) - px * (b[1] - a[1])) / area;
            if (v < -1e-6 || w < -1e-6 || v + w > 1 + 1e-6) continue;
            const near = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]), i = (y - top) * width + x - left;
            if (near <= depth[i]) continue;
            depth[i] = near;
            owner[i] = s;
            const light = a[3] + v * (b[3] - a[3]) + w * (c[3] - a[3]);
            const red = Math.min(255, color[0] * light), green = Math.min(255, color[1] * light);
            pixels[i] = (255 << 24) | (Math.min(255, color[2] * light) << 16) | (green << 8) | red;
          }
      }
      this.buffer = this.buffer || document.createElement("canvas");
      Object.assign(this.buffer, { width, height });
      this.buffer.getContext("2d").putImageData(picture, 0, 0);
      context.imageSmoothingQuality = "high";
      context.drawImage(this.buffer, left / fine, top / fine, width / fine, height / fine);
    }

    pushed(torso, force, words) {
      const way = unit(force);
      return { from: torso.map((x, i) => x - this.data.arrow * way[i]), to: torso, color: ALARM, words };
    }

    // An arrow from one place to another, m, with words at its tail.
    drawArrow(context, camera, { from, to, color, words }) {
      const tail = camera.see(from), head = camera.see(to), ratio = camera.ratio;
      if (!tail || !head) return;
      const length = Math.hypot(head[0] - tail[0], head[1] - tail[1]), size = Math.min(12 * ratio, length);
      const along = unit([head[0] - tail[0], head[1] - tail[1], 0]);
      const back = [head[0] - size * along[0], head[1] - size * along[1]];
      context.strokeStyle = context.fillStyle = color;
      context.lineWidth = 3 * ratio;
      context.beginPath();
      context.moveTo(tail[0], tail[1]);
      context.lineTo(back[0], back[1]);
      context.stroke();
      context.beginPath();
      context.moveTo(head[0], head[1]);
      context.lineTo(back[0] - (size / 2) * along[1], back[1] + (size / 2) * along[0]);
      context.lineTo(back[0] + (size / 2) * along[1], back[1] - (size / 2) * along[0]);
      context.fill();
      if (!words) return;
      context.font = `${13 * ratio}px sans-serif`;
      context.textAlign = "center";
      context.lineWidth = 4 * ratio;
      context.strokeStyle = "#ffffff";
      const place = [tail[0], tail[1] + (along[1] < -0.3 ? 20 : -10) * ratio];
      context.strokeText(words, ...place);
      context.fillText(words, ...place);
    }
  }

  // A film: postures at even times, seen at any.
  class Film extends View {
    constructor(figure, data) {
      super(figure, data);
      this.last = data.frames.length - 1;
      this.time = 0; this.speed = 1; this.playing = false;
      named(this.canvas, `${data.title}: the moving robot. Arrow keys turn the view, plus and minus zoom, F lets the ` +
        "camera stay or follow, space plays and pauses, comma and full stop go a frame back and on, Home resets the view.");
      this.played = button("Play", () => this.toggle());
      this.slider = named(make("input", { type: "range", min: 0, max: this.length, step: 1 / data.fps, value: 0,
        oninput: () => this.seek(Number(this.slider.value)) }), "Time in seconds");
      this.clock = make("output");
      this.build([this.played, this.slider, this.clock], [0.1, 0.25, 0.5, 1, 2], (speed) => { this.speed = speed; },
        "Drag or arrow keys: turn. Right button or Shift: move. Click, then wheel, or + −: zoom. Space: play. , . : a frame " +
        "back or on.");
      this.words.hidden = !data.told.length;
      this.draw();
    }

    get length() { return this.last / this.data.fps; }
    seek(time) { this.time = clamp(time, 0, this.length); this.draw(); }
    viewKeys() {
      const frame = 1 / this.data.fps;
      return { ...super.viewKeys(), " ": () => this.toggle(),
        ",": () => this.seek(this.time - frame), ".": () => this.seek(this.time + frame) };
    }

    // Films side by side play and pause together.
    toggle() {
      const on = !this.playing, grid = this.figure.closest(".grid");
      for (const each of grid ? grid.querySelectorAll("figure.player") : [this.figure]) each.player.play(on);
    }
    play(on) {
      if (on === this.playing) return;
      this.playing = on;
      this.played.textContent = on ? "Pause" : "Play";
      if (!on) return;
      if (this.time >= this.length) this.time = 0;
      let before = null;
      const step = (now) => {
        if (!this.playing) return;
        if (before !== null) this.time += (this.speed * Math.min(now - before, 100)) / 1000;
        before = now;
        if (this.time >= this.length) { this.time = this.length; this.play(false); }
        this.draw();
        if (this.playing) requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    }

    // Numbers at the present time, between two frames of a list of them.
    between(list) {
      const x = Math.min(this.time * this.data.fps, this.last), i = Math.min(Math.floor(x), Math.max(this.last - 1, 0));
      const share = x - i, a = list[i], b = list[Math.min(i + 1, this.last)];
      return a.map((p, s) => {
        const flip = p.length > 3 && p[3] * b[s][3] + p[4] * b[s][4] + p[5] * b[s][5] + p[6] * b[s][6] < 0 ? -1 : 1;
        return p.map((value, k) => value + share * ((k > 2 ? flip : 1) * b[s][k] - value));
      });
    }

    pose() {
      const [torso] = this.between(this.data.torso.map((p) => [p]));
      const now = this.data.pushes.filter((push) => this.time >= push.start - 1e-9 && this.time < push.start + push.seconds);
      const arrows = now.map(({ force, words }) => this.pushed(torso, force, words));
      return { shapes: this.between(this.data.frames), torsos: [torso], ground: [0, 0, 0], arrows };
    }

    draw() {
      super.draw();
      this.slider.value = this.time;
      this.clock.textContent = `${this.time.toFixed(2)} s`;
      this.words.textContent = (this.data.told.filter(([start]) => start <= this.time + 1e-9).pop() || [0, ""])[1];
      this.canvas.dataset.time = this.time.toFixed(3);
    }
  }

  const STEERED = { forward: ["w", "ArrowUp", "s", "ArrowDown"], left: ["a", "ArrowLeft", "d", "ArrowRight"], turn: ["q", "", "e", ""] };

  // A robot that moves in another program: what that sends is drawn, and what a person does is sent back.
  class Live extends View {
    constructor(figure, data) {
      super(figure, data);
      Object.assign(this, { latest: data.first, told: { ...data.live.told }, held: new Set(), history: [], charts: new Map() });
      figure.classList.add("live");
      named(this.canvas, `${data.title}: the live robot. Drag the robot to pull it, drag beside it to turn the view.`);
      this.canvas.dataset.pictures = 0;
      this.paused = button("Pause", () => this.pause());
      this.recorded = button("Record", () => this.record());
      this.fastest = Math.max(...Object.values(data.live.ranges["forward, m/s"] || [1]));
      const { home, touchable: touch } = data.live, { first: { world } } = data, poses = Object.keys(home).length > 0;
      this.drives = !poses && Object.keys(data.live.ranges).length > 0;
      const keys = (part, forth, back) => [this.range(part)[2] > 0 && forth, this.range(part)[1] < 0 && back].filter(Boolean);
      const go = [...keys("forward", "W", "S"), ...keys("left", "A", "D")], turn = keys("turn", "Q", "E");
      const hints = [go.length && `${go.join(" ")} or arrows: go.`, turn.length && `${turn.join(" ")}: turn.`,
        this.drives && "Shift: faster. Space: stand.", poses && "Space: home posture.",
        touch && "Drag the robot: pull it.", data.live.scales.push && "X: push.",
        "Drag beside it: look around. Right button: move. Wheel: zoom. P: pause. R: restart, all as at first. N: next episode.",
        "Full stop: a decision alone. 1 to 4: from a corner, front, side, top.",
        "M: centre of mass. C: collision shapes. J: axes of the joints."];
      this.panel = make("div", { className: "panel" });
      this.sliders = {};
      this.joints = make("details", { className: "joints", open: true }, make("summary", {}, "set-points, degrees"));
      for (const [name, [low, high]] of Object.entries(data.live.ranges))
        this.slider(name, low, high, this.told[name], (value) => this.tell({ [name]: value }));
      if (this.drives) this.panel.append(this.thumb());
      const acts = [(this.drives || poses) && button(poses ? "Home posture" : "Stand", () => this.stand()),
        data.live.scales.push && button("Push", () => this.push())];
      this.panel.append(make("p", { className: "controls" }, ...acts.filter(Boolean)));
      for (const [name, [low, high, now, words]] of Object.entries(data.live.scales))
        this.slider(words, low, high, name in world ? world[name] : now, (value) => { if (name !== "push") this.send({ [name]: value }); }, name);
      if (poses) this.panel.append(this.joints);
      this.switches = { m: this.toggle("Centre of mass", "weighed"),
        c: this.toggle("Collision shapes", "touching", "Only the orange shapes can touch."),
        j: this.toggle("Axes", "turning", "Joints with a motor turn about the arrows, or slide along them.") };
      const { policies, policy } = data.live;
      const change = () => { this.send({ policy: others.value }); others.value = policy; }; // the page of another is loaded
      const others = named(make("select", { onchange: change },
        ...policies.map((value) => make("option", { value, selected: value === policy }, value))), "Policy");
      const buttons = [...(policies.length ? [others] : []), this.paused, button("Step", () => this.once()), button("Restart", () => this.restart()),
        button("Next episode", () => this.send({ episode: 1 })), ...Object.values(this.switches), this.recorded];
      this.build(buttons, [0.1, 0.25, 0.5, 1], (pace) => this.send({ pace }), hints.filter(Boolean).join(" "), this.panel);
      const told = this.words;
      this.words = make("strong");
      this.words.setAttribute("role", "status"); // read aloud when it changes
      this.clock = make("span");
      told.append(this.clock, " ", this.words);
      document.addEventListener("keydown", (event) => this.drive(event, true));
      document.addEventListener("keyup", (event) => this.drive(event, false));
      window.addEventListener("blur", () => { this.held.clear(); this.steer(); });
      setInterval(() => this.gamepad(), 50);
      this.listen();
    }

    listen() {
      const stream = new EventSource("/frames");
      stream.onmessage = (event) => {
        this.latest = { ...JSON.parse(event.data), at: performance.now() };
        if (this.latest.policy !== this.data.live.policy) return location.reload();
        if (this.latest.paused || this.latest.compiling !== null) this.since = this.latest.at;
        this.gone = "";
        if (!this.latest.paused || !this.history.length) this.history.push(this.latest);
        while (this.latest.time - this.history[0].time > SHOWN_S) this.history.shift();
        if (this.asked) return;
        this.asked = requestAnimationFrame(() => { this.asked = 0; this.draw(); });
      };
      stream.onerror = () => {
        this.gone = stream.readyState === EventSource.CLOSED
          ? "The program shows the robot to as many windows as it can: close one of them and load this page again."
          : "The program that moves the robot has ended, or does not answer.";
        this.draw();
      };
    }

    // Messages that a slow server has not taken yet are joined into one.
    async send(message) {
      const told = { ...(this.waiting || {}).told, ...message.told };
      this.waiting = { ...this.waiting, ...message, ...(Object.keys(told).length ? { told } : {}) };
      if (this.sending) return;
      this.sending = true;
      while (this.waiting) {
        const body = JSON.stringify(this.waiting);
        this.waiting = null;
        try {
          await fetch("/hands", { method: "POST", headers: { "Content-Type": "application/json" }, body });
        } catch { break; }
      }
      this.sending = false;
    }

    // A button that sets and clears a flag of what is drawn; `hint` says what one sees.
    toggle(words, flag, hint = "") {
      const made = button(words, () => {
        this[flag] = !this[flag];
        made.setAttribute("aria-pressed", this[flag]);
        this.note(this[flag] ? hint : "");
      });
      made.setAttribute("aria-pressed", false);
      return made;
    }

    slider(words, low, high, now, act, name = words) {
      const joint = name in this.data.live.home, step = joint ? "any" : Number(((high - low) / 100).toPrecision(1));
      const output = make("output"), show = (value) => { output.textContent = value.toFixed(joint ? 1 : 2); };
      const input = make("input", { type: "range", min: low, max: high, step, value: now, oninput: () => {
        show(Number(input.value));
        act(Number(input.value));
      } });
      show(now);
      this.sliders[name] = { input, show };
      (joint ? this.joints : this.panel).append(make("label", {}, make("span", {}, words), input, output));
    }

    show(values) {
      for (const [name, value] of Object.entries(values)) {
        this.sliders[name].input.value = value;
        this.sliders[name].show(value);
      }
    }
    tell(told) {
      Object.assign(this.told, told);
      this.show(told);
      this.send({ told });
    }
    // The command to stand: no velocity, or the set-points of the robot's posture.
    stand() { this.tell(Object.fromEntries(Object.keys(this.told).map((name) => [name, this.data.live.home[name] || 0]))); }
    // The episode again, the world and the command as at first.
    restart() {
      const { push, ...world } = Object.fromEntries(Object.entries(this.data.live.scales).map(([name, scale]) => [name, scale[2]]));
      this.held.clear();
      this.show(push === undefined ? world : { ...world, push });
      this.stand();
      this.send({ ...world, episode: 0 });
    }

    // Name, lowest and highest of a part of the command.
    range(part) {
      const named = ([each]) => this.drives && each.match(/^\w*/)[0] === part;
      const [name, [low, high]] = Object.entries(this.data.live.ranges).find(named) || ["", [0, 0]];
      return [name, low, high];
    }

    // Shares of the largest command for the parts that `STEERED` names.
    share(shares) {
      const told = {};
      for (const [part, share] of Object.entries(shares)) {
        const [name, low, high] = this.range(part), value = share > 0 ? share * high : -share * low;
        if (share && !value) this.note(`This policy has no such command: ${name || part} is from ${low} to ${Number(high.toFixed(2))}.`);
        if (name) told[name] = value || 0;
      }
      if (Object.keys(told).length) this.tell(told);
    }

    drive(event, down) {
      const own = /^(INPUT|SELECT|BUTTON|SUMMARY)$/.test(event.target.tagName);
      if (own && (event.key.length > 1 || event.key === " ")) return;
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const key = event.key.length > 1 ? event.key : event.key.toLowerCase();
      this.fast = event.shiftKey;
      if (Object.values(STEERED).some((keys) => keys.includes(key)) && this.drives) {
        event.preventDefault();
        if (this.held.has(key) === down) return;
        this.held[down ? "add" : "delete"](key);
        this.steer();
      } else if (down && !event.repeat)
        this.key(event, { " ": () => this.stand(), p: () => this.pause(), r: () => this.restart(),
          n: () => this.send({ episode: 1 }), x: () => this.push(), ".": () => this.once(), ...this.sideKeys(),
          ...Object.fromEntries(Object.entries(this.switches).map(([name, made]) => [name, () => made.click()])) });
    }
    steer() {
      const shares = {}, size = this.fast ? 1 : 0.6;
      for (const [part, [forth, other, back, another]] of Object.entries(STEERED)) {
        const ways = Number(this.held.has(forth) || this.held.has(other)) - Number(this.held.has(back) || this.held.has(another));
        if (ways || (this.pressed || {})[part]) shares[part] = size * ways;
      }
      this.pressed = shares;
      this.share(shares);
    }
    // A stick for a thumb, on screens that are touched: up is forward, aside turns, or goes aside if it cannot turn.
    thumb() {
      const knob = make("span"), pad = make("div", { className: "stick" }, knob), aside = this.range("turn")[2] ? "turn" : "left";
      pad.setAttribute("aria-hidden", true); // the sliders say as much
      const put = (x, y) => {
        knob.style.transform = `translate(${2.2 * x}rem, ${2.2 * y}rem)`;
        this.share({ forward: -y, [aside]: -x });
      };
      pad.onpointermove = pad.onpointerdown = (event) => {
        if (event.type === "pointerdown") pad.setPointerCapture(event.pointerId);
        if (!pad.hasPointerCapture(event.pointerId)) return;
        const box = pad.getBoundingClientRect(), at = (x, start, size) => (2 * (x - start)) / size - 1;
        const [x, y] = [at(event.clientX, box.left, box.width), at(event.clientY, box.top, box.height)], far = Math.max(1, Math.hypot(x, y));
        put(x / far, y / far);
      };
      pad.onpointerup = pad.onpointercancel = () => put(0, 0);
      return pad;
    }
    gamepad() {
      const pad = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find(Boolean);
      if (!pad) return;
      const axis = (i) => (Math.abs(pad.axes[i] || 0) < 0.15 ? 0 : -pad.axes[i]);
      const shares = { forward: axis(1), left: axis(0), turn: axis(2) }, text = JSON.stringify(shares);
      if (text !== this.stick && (this.stick || text.match(/[1-9]/))) this.share(shares);
      this.stick = text;
      const buttons = pad.buttons.map((each) => each.pressed), before = this.buttons || [];
      if (buttons[0] && !before[0]) this.push();
      if (buttons[9] && !before[9]) this.pause();
      this.buttons = buttons;
    }

    // Words for three seconds.
    note(words) {
      Object.assign(this, { noted: words, noted_until: performance.now() + 3000 });
      this.draw();
    }

    viewKeys() {
      const keys = super.viewKeys();
      if (this.drives) for (const name of Object.keys(keys)) if (name.startsWith("Arrow")) delete keys[name];
      return keys;
    }
    scrolls() { return true; }
    push() { if (this.sliders.push) this.send({ push: Number(this.sliders.push.input.value) }); }
    // One decision; the robot waits before and after it.
    once() { this.send({ once: true }); this.latest.paused = true; }
    pause() { this.send({ paused: !this.latest.paused }); this.latest.paused = !this.latest.paused; this.draw(); }

    hold(event) {
      const found = this.data.live.touchable && this.hit(event);
      if (!found) return false;
      this.held_at = { depth: found.depth, shape: found.shape };
      const point = this.place(event, found.depth);
      this.pulled = point;
      this.send({ grab: { shape: found.shape, point, to: point } });
      return true;
    }
    pull(event) {
      this.pulled = this.place(event, this.held_at.depth);
      this.send({ grab: { to: this.pulled } });
    }
    let() { this.pulled = null; this.send({ grab: null }); }

    // A film of what is seen, as the browser's own recorder makes it.
    record() {
      if (this.recorder) return this.recorder.stop();
      const parts = [], recorder = new MediaRecorder(this.canvas.captureStream(30));
      recorder.ondataavailable = (event) => parts.push(event.data);
      recorder.onstop = () => {
        const type = recorder.mimeType.split(";")[0];
        const link = make("a", { href: URL.createObjectURL(new Blob(parts, { type })), download: `robot.${type.split("/")[1]}` });
        link.click();
        this.recorder = null;
        this.recorded.textContent = "Record";
      };
      recorder.start();
      this.recorder = recorder;
      this.recorded.textContent = "Save film";
    }

    pose() {
      const { shapes, torsos, ground, forces, pushes, ahead, centres, axes } = this.latest;
      const most = Math.max(...forces.map((f) => Math.hypot(f[3], f[4], f[5])), this.most || 1);
      this.most = most;
      const arrow = (color, size) => (f) => ({ from: f.slice(0, 3), color, to: [0, 1, 2].map((i) => f[i] + size * f[i + 3]) });
      const arrows = forces.map(arrow(LOAD, this.data.arrow / most));
      if (this.turning) arrows.push(...axes.map(arrow(AXIS, this.data.arrow / 3)));
      if (this.pulled && this.held_at) {
        arrows.push({ from: shapes[this.held_at.shape].slice(0, 3), to: this.pulled, color: ALARM });
      }
      const [forward, left] = ["forward, m/s", "left, m/s"].map((name) => (this.told[name] || 0) / this.fastest);
      const on = (a, b) => [a, b, this.height(ground, a, b)], size = 1.5 * this.data.arrow;
      if (this.weighed) for (const at of centres) arrows.push({ from: at, to: on(at[0], at[1]), color: "#2f4b7c", words: "centre of mass" });
      torsos.forEach((torso, i) => {
        if (pushes[i]) arrows.push(this.pushed(torso, pushes[i], `push ${Math.hypot(...pushes[i]).toFixed(2)} N s`));
        const [x, y] = ahead[i], robot = torsos.length > 1 ? `robot ${i + 1}` : "";
        if (forward || left || robot)
          arrows.push({ from: on(torso[0], torso[1]), color: "#7a5195", words: robot || "command",
            to: on(torso[0] + size * (forward * x - left * y), torso[1] + size * (forward * y + left * x)) });
      });
      return { shapes, torsos, ground, arrows };
    }

    draw() {
      super.draw();
      const { time, words, episodes, paused, compiling, world } = this.latest, { scales } = this.data.live;
      this.paused.textContent = paused ? "Go on" : "Pause";
      const present = this.gone || (compiling === null && words) || (performance.now() < this.noted_until ? this.noted : "");
      if (this.words.textContent !== present) this.words.textContent = present;
      const which = episodes.length > 1 ? `episodes ${episodes.join(", ")}` : `episode ${episodes[0]}`;
      const pictures = ++this.canvas.dataset.pictures;
      if (pictures % 4 === 1 || compiling !== null)
        this.clock.textContent = compiling === null ? `${which}, ${time.toFixed(1)} s${this.rate()}` : `compiling, ${compiling.toFixed(0)} s`;
      const { ratio } = this.camera || {}, context = this.canvas.getContext("2d");
      const changed = Object.entries(world).filter(([name, value]) => value !== scales[name][2]);
      context.font = `${13 * ratio}px sans-serif`;
      context.textAlign = "left";
      context.fillStyle = DARK.matches ? "#ffffff" : INK;
      changed.forEach(([name, value], i) => context.fillText(`${scales[name][3]}: ${value.toFixed(2)}`, 10 * ratio, (20 + 18 * i) * ratio));
      this.canvas.dataset.time = time.toFixed(3);
      if (pictures % 4 === 1) this.drawCharts();
    }

    // Words for how fast the robot moves: its seconds for each of the last two.
    rate() {
      if (this.latest.paused) return ", paused";
      const { at, time } = this.latest, first = this.history.find((each) => each.at >= Math.max(at - 2000, this.since || 0));
      return first && at - first.at > 500 ? `, ${((1000 * (time - first.time)) / (at - first.at)).toFixed(2)} × real time` : "";
    }

    drawCharts() {
      for (const [title, lines] of Object.entries(this.latest.charts)) {
        const commanded = title in this.told, names = Object.keys(lines);
        if (!this.charts.has(title)) {
          const canvas = make("canvas"), legend = make("p", { className: "legend" });
          const open = commanded || title.startsWith("load") || (!this.drives && title.startsWith("joint"));
          const choice = this.choice(title, names);
          const details = make("details", { open }, make("summary", {}, title), ...(choice ? [choice] : []), canvas, legend);
          this.panel.append(details);
          this.charts.set(title, { details, canvas, legend, choice });
        }
        const { details, canvas, legend, choice } = this.charts.get(title), chosen = choice ? choice.value.split("\n") : names;
        if (details.open) this.drawChart(canvas, legend, title, chosen, commanded ? this.data.live.ranges[title] : [0, 0]);
      }
    }

    // Which of many lines are drawn: all, those of a leg, or one. Of more than can be told apart, first a leg's.
    choice(title, names) {
      if (names.length < 5) return null;
      const legs = Object.entries(this.data.legs).filter(([, joints]) => joints.length && joints.every((name) => names.includes(name)));
      const groups = [["all", names], ...(legs.length > 1 ? legs : []), ...names.map((name) => [name, [name]])];
      const select = named(make("select", {}, ...groups.map(([label, lines]) => make("option", { value: lines.join("\n") }, label))),
        `Lines of ${title}`);
      select.selectedIndex = names.length > 12 && legs.length > 1 ? 1 : 0;
      return select;
    }

    // The last seconds of some lines, at least over this range of values, and the present values below them.
    drawChart(canvas, legend, title, names, range) {
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = 80, now = this.latest;
      Object.assign(canvas, { width: width * ratio, height: height * ratio }); // this also wipes it
      const context = canvas.getContext("2d"), ink = getComputedStyle(this.figure).color;
      const number = (x) => (x === null ? "–" : x.toFixed(2).replace(/^-(0\.?0*)$/, "$1"));
      const color = (i) => (names[i] === "commanded" ? ink : line(i - names.includes("commanded"), names.length));
      const shown = this.history.filter((each) => title in each.charts), { length } = now.ended;
      const value = (each, name) => // null after an episode's end
        (name !== "commanded" && each.ended[length > 1 ? name.slice(6) - 1 : 0] ? null : each.charts[title][name]);
      const values = shown.flatMap((each) => names.map((name) => value(each, name))).filter((x) => x !== null);
      const low = Math.min(...range, ...values), high = Math.max(...range, ...values);
      const y = (value) => height - 4 - ((height - 8) * (value - low)) / (high - low || 1);
      legend.replaceChildren(...names.map((name, i) => {
        const words = make("span", {}, `${name} ${number(value(now, name))}`);
        words.style.color = color(i);
        return words;
      }));
      context.scale(ratio, ratio);
      context.font = "11px sans-serif";
      const left = 8 + Math.max(...[low, high].map((x) => context.measureText(number(x)).width)); // beside the curves
      const draw = (style, dash, points) => {
        context.strokeStyle = style;
        context.setLineDash(dash);
        context.beginPath();
        let drawn = false;
        for (const [x, height] of points) {
          if (height !== null) context[drawn ? "lineTo" : "moveTo"](x, y(height));
          drawn = height !== null;
        }
        context.stroke();
      };
      draw("#8886", [], [[left, 0], [width, 0]]);
      context.lineWidth = 1.5;
      names.forEach((name, i) => draw(color(i), name === "commanded" ? [5, 4] : [],
        shown.map((each) => [left + (width - left) * (1 - (now.time - each.time) / SHOWN_S), value(each, name)])));
      context.fillStyle = ink;
      context.textAlign = "right";
      context.fillText(number(high), left - 4, 12);
      context.fillText(number(low), left - 4, height - 4);
    }
  }

  document.querySelectorAll("figure.player").forEach((figure) => {
    const data = JSON.parse(figure.querySelector("script").textContent);
    figure.player = data.live ? new Live(figure, data) : new Film(figure, data);
  });
})();
