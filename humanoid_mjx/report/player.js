// Plays the motion of a robot on a canvas: shaded solids, sorted from far to near, seen from any side.
// Each `figure.player` holds its film as JSON (report/player.py) and gets canvas, buttons and keys here.
"use strict";
(() => {
  const AROUND = 20, LIGHT = unit([-0.5, 0.25, -0.85]), AMBIENT = 0.5, DIFFUSE = 0.55;
  const FIELD = Math.tan(Math.PI / 8), NEAR = 0.02, GRID = 0.1, TURN = 0.12, PUSH_SHOWN = 0.5, ARROW = 0.11;
  const START = { yaw: (130 * Math.PI) / 180, pitch: (-12 * Math.PI) / 180, zoom: 1 };

  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function unit(a) { const n = Math.hypot(...a) || 1; return a.map((x) => x / n); }
  function cross(a, b) {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  }

  // Solids of revolution come as rings of [radius, height], boxes as six faces cut into squares.
  function solid(shape) {
    const [a, b, c] = shape.size, rings = [];
    const arc = (from, to, steps, z) => {
      for (let i = 0; i <= steps; i++) {
        const t = from + ((to - from) * i) / steps;
        rings.push([a * Math.cos(t), z + a * Math.sin(t)]);
      }
    };
    const side = () => { for (let i = 1; i < 6; i++) rings.push([a, b * (i / 3 - 1)]); };
    if (shape.kind === "box") return box(shape.size);
    if (shape.kind === "capsule") { arc(-Math.PI / 2, 0, 5, -b); side(); arc(0, Math.PI / 2, 5, b); }
    else if (shape.kind === "cylinder") { rings.push([0, -b], [a, -b]); side(); rings.push([a, b], [0, b]); }
    else arc(-Math.PI / 2, Math.PI / 2, 10, 0);
    const scale = shape.kind === "ellipsoid" ? [1, b / a, c / a] : [1, 1, 1];
    const at = (ring, k) => {
      const t = (2 * Math.PI * k) / AROUND;
      return [ring[0] * Math.cos(t), ring[0] * Math.sin(t) * scale[1], ring[1] * scale[2]];
    };
    const faces = [];
    for (let i = 0; i + 1 < rings.length; i++)
      for (let k = 0; k < AROUND; k++)
        faces.push(face([at(rings[i], k), at(rings[i], k + 1), at(rings[i + 1], k + 1), at(rings[i + 1], k)]));
    return faces.filter((f) => f);
  }

  function box(size) {
    const faces = [], cut = Math.max(...size) / 2;
    for (let axis = 0; axis < 3; axis++)
      for (const sign of [-1, 1]) {
        const u = (axis + 1) % 3, v = (axis + 2) % 3;
        const nu = Math.ceil(size[u] / cut), nv = Math.ceil(size[v] / cut);
        for (let i = 0; i < nu; i++)
          for (let j = 0; j < nv; j++) {
            const corner = (s, t) => {
              const p = [0, 0, 0];
              p[axis] = sign * size[axis];
              p[u] = size[u] * ((2 * (i + s)) / nu - 1);
              p[v] = size[v] * ((2 * (j + t)) / nv - 1);
              return p;
            };
            const around = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            faces.push(face(sign > 0 ? around : around.reverse()));
          }
      }
    return faces;
  }

  // A polygon, its corners anticlockwise seen from outside; none where it has no area.
  function face(points) {
    const d = [0, 1, 2].map((i) => points[2][i] - points[0][i]), e = [0, 1, 2].map((i) => points[3][i] - points[1][i]);
    const normal = cross(d, e);
    return Math.hypot(...normal) < 1e-12 ? null : { points, normal: unit(normal) };
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

  class Player {
    constructor(figure) {
      this.figure = figure;
      this.film = JSON.parse(figure.querySelector("script").textContent);
      this.solids = this.film.shapes.map(solid);
      this.last = this.film.frames.length - 1;
      this.time = 0; this.speed = 1; this.playing = false; this.drawn = "";
      this.view = { ...START };
      this.build();
      new ResizeObserver(() => this.draw()).observe(this.canvas);
      if (figure.hasAttribute("data-autoplay") && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.toggle();
      this.draw();
    }

    get length() { return this.last / this.film.fps; }

    build() {
      const make = (tag, properties, ...children) => {
        const element = Object.assign(document.createElement(tag), properties);
        element.append(...children);
        return element;
      };
      this.canvas = make("canvas", { tabIndex: 0 });
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", `${this.film.title}: the moving robot. Arrow keys turn the view, plus and ` +
        "minus zoom, space plays and pauses, comma and full stop go a frame back and on, Home resets the view.");
      this.button = make("button", { type: "button", onclick: () => this.toggle() }, "Play");
      this.slider = make("input", { type: "range", min: 0, max: this.length, step: 1 / this.film.fps, value: 0,
        oninput: () => this.seek(Number(this.slider.value)) });
      this.slider.setAttribute("aria-label", "Time in seconds");
      this.clock = make("output", {});
      const speeds = make("select", { onchange: () => { this.speed = Number(speeds.value); } },
        ...[[0.1, "1/10"], [0.25, "1/4"], [0.5, "1/2"], [1, "1"], [2, "2"]].map(([value, text]) =>
          make("option", { value, selected: value === 1 }, text + " ×")));
      speeds.setAttribute("aria-label", "Speed");
      const home = make("button", { type: "button", onclick: () => this.home() }, "Reset view");
      this.words = make("p", { className: "told" });
      const hint = make("p", { className: "hint" },
        "Drag or arrow keys: turn. Wheel or + −: zoom. Space: play. , . : a frame back or on.");
      const bar = make("div", { className: "controls" }, this.button, this.slider, this.clock, speeds, home);
      this.figure.querySelector(".stage").replaceChildren(this.canvas, bar, this.words, hint);
      this.canvas.addEventListener("keydown", (event) => this.key(event));
      this.canvas.addEventListener("wheel", (event) => {
        if (document.activeElement !== this.canvas) return;
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY / 600));
      }, { passive: false });
      this.canvas.addEventListener("pointerdown", (event) => {
        this.canvas.focus();
        this.canvas.setPointerCapture(event.pointerId);
        this.drag = [event.clientX, event.clientY];
      });
      this.canvas.addEventListener("pointermove", (event) => {
        if (!this.drag) return;
        const [x, y] = this.drag;
        this.drag = [event.clientX, event.clientY];
        this.turn((x - event.clientX) / 150, (y - event.clientY) / 150);
      });
      for (const name of ["pointerup", "pointercancel"])
        this.canvas.addEventListener(name, () => { this.drag = null; });
    }

    key(event) {
      const frame = 1 / this.film.fps;
      const actions = {
        ArrowLeft: () => this.turn(-TURN, 0), ArrowRight: () => this.turn(TURN, 0),
        ArrowUp: () => this.turn(0, -TURN), ArrowDown: () => this.turn(0, TURN),
        "+": () => this.zoom(0.87), "=": () => this.zoom(0.87), "-": () => this.zoom(1.15),
        " ": () => this.toggle(), Home: () => this.home(),
        ",": () => this.seek(this.time - frame), ".": () => this.seek(this.time + frame),
      };
      if (event.ctrlKey || event.metaKey || event.altKey || !actions[event.key]) return;
      event.preventDefault();
      actions[event.key]();
    }

    turn(yaw, pitch) {
      this.view.yaw += yaw;
      this.view.pitch = Math.max(-1.5, Math.min(1.5, this.view.pitch + pitch));
      this.draw();
    }
    zoom(factor) { this.view.zoom = Math.max(0.25, Math.min(6, this.view.zoom * factor)); this.draw(); }
    home() { this.view = { ...START }; this.draw(); }
    seek(time) { this.time = Math.max(0, Math.min(this.length, time)); this.draw(); }

    toggle() {
      this.playing = !this.playing;
      this.button.textContent = this.playing ? "Pause" : "Play";
      if (!this.playing) return;
      if (this.time >= this.length) this.time = 0;
      let before = null;
      const step = (now) => {
        if (!this.playing) return;
        if (before !== null) this.time += (this.speed * Math.min(now - before, 100)) / 1000;
        before = now;
        if (this.time >= this.length) { this.time = this.length; this.toggle(); }
        this.draw();
        if (this.playing) requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    }

    // Numbers at the present time, between two frames of a list of them.
    between(list) {
      const x = Math.min(this.time * this.film.fps, this.last), i = Math.min(Math.floor(x), Math.max(this.last - 1, 0));
      const share = x - i, a = list[i], b = list[Math.min(i + 1, this.last)];
      return a.map((p, s) => {
        const flip = p.length > 3 && p[3] * b[s][3] + p[4] * b[s][4] + p[5] * b[s][5] + p[6] * b[s][6] < 0 ? -1 : 1;
        return p.map((value, k) => value + share * ((k > 2 ? flip : 1) * b[s][k] - value));
      });
    }

    draw() {
      const ratio = Math.min(window.devicePixelRatio || 1, 2), box = this.canvas.getBoundingClientRect();
      const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
      if (!width || !height) return;
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      const film = this.film, [[tx, ty, tz]] = this.between(film.torso.map((p) => [p]));
      const { yaw, pitch, zoom } = this.view;
      const forward = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
      const right = [Math.sin(yaw), -Math.cos(yaw), 0], up = cross(right, forward);
      const target = [tx, ty, film.middle], distance = (zoom * 0.58 * film.view * Math.max(1, 0.8 * height / width)) / FIELD;
      const eye = target.map((x, i) => x - distance * forward[i]), focus = height / 2 / FIELD;
      const camera = {
        eye, forward, width, height,
        see: (p) => {
          const away = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]], depth = dot(away, forward);
          if (depth < NEAR) return null;
          return [width / 2 + (focus * dot(away, right)) / depth, height / 2 - (focus * dot(away, up)) / depth, depth];
        },
      };
      const context = this.canvas.getContext("2d");
      const sky = context.createLinearGradient(0, 0, 0, height);
      sky.addColorStop(0, "#d5dfea"); sky.addColorStop(0.45, "#ffffff");
      context.fillStyle = sky;
      context.fillRect(0, 0, width, height);
      const matrices = this.between(film.frames).map(placed);
      if (film.ground && eye[2] > 0) this.drawGround(context, camera, target, matrices);
      this.drawSolids(context, camera, matrices);
      this.drawPush(context, camera, [tx, ty, tz], ratio);
      this.slider.value = this.time;
      this.clock.textContent = `${this.time.toFixed(2)} s`;
      this.words.textContent = (film.told.filter(([start]) => start <= this.time + 1e-9).pop() || [0, ""])[1];
      this.canvas.dataset.time = this.time.toFixed(3);
      this.canvas.dataset.yaw = yaw.toFixed(3);
    }

    drawGround(context, camera, target, matrices) {
      const reach = 1.6, [x0, y0] = target.slice(0, 2).map((x) => Math.round(x / GRID) * GRID);
      context.lineWidth = Math.max(1, camera.height / 500);
      for (let k = -16; k <= 16; k++) {
        const half = Math.sqrt(Math.max(0, reach * reach - k * k * GRID * GRID)), pieces = 8;
        for (const axis of [0, 1])
          for (let i = 0; i < pieces; i++) {
            const at = (j) => half * ((2 * j) / pieces - 1);
            const point = (s) => (axis ? [x0 + k * GRID, y0 + s, 0] : [x0 + s, y0 + k * GRID, 0]);
            const a = camera.see(point(at(i))), b = camera.see(point(at(i + 1)));
            if (!a || !b) continue;
            const fade = 1 - Math.hypot(k * GRID, (at(i) + at(i + 1)) / 2) / reach;
            context.strokeStyle = `rgba(120, 124, 130, ${(0.6 * Math.max(0, fade)).toFixed(3)})`;
            context.beginPath();
            context.moveTo(a[0], a[1]);
            context.lineTo(b[0], b[1]);
            context.stroke();
          }
      }
      context.beginPath();
      matrices.forEach((matrix, s) => this.solids[s].forEach((f) => {
        if (dot(turned(matrix, f.normal), LIGHT) >= 0) return;
        const points = f.points.map((p) => {
          const [x, y, z] = moved(matrix, p), t = Math.max(z, 0) / -LIGHT[2];
          return camera.see([x + t * LIGHT[0], y + t * LIGHT[1], 0]);
        });
        if (points.some((p) => !p)) return;
        points.forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
        context.closePath();
      }));
      context.fillStyle = "rgba(40, 40, 50, 0.28)";
      context.fill("nonzero");
    }

    drawSolids(context, camera, matrices) {
      const shown = [];
      matrices.forEach((matrix, s) => this.solids[s].forEach((f) => {
        const points = f.points.map((p) => moved(matrix, p)), normal = turned(matrix, f.normal);
        if (dot([0, 1, 2].map((i) => points[0][i] - camera.eye[i]), normal) >= 0) return;
        const seen = points.map(camera.see);
        if (seen.some((p) => !p)) return;
        const light = AMBIENT + DIFFUSE * Math.max(0, -dot(normal, LIGHT));
        const color = this.film.shapes[s].color.map((x) => Math.min(255, Math.round(255 * light * x)));
        shown.push({ seen, depth: seen.reduce((sum, p) => sum + p[2], 0) / seen.length, color: `rgb(${color})` });
      }));
      shown.sort((a, b) => b.depth - a.depth);
      context.lineJoin = "round";
      context.lineWidth = 1;
      for (const { seen, color } of shown) {
        context.fillStyle = context.strokeStyle = color;
        context.beginPath();
        seen.forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
        context.closePath();
        context.fill();
        context.stroke();
      }
    }

    drawPush(context, camera, torso, ratio) {
      for (const push of this.film.pushes) {
        const since = this.time - push.start;
        if (since < -1e-9 || since >= Math.max(push.seconds, PUSH_SHOWN)) continue;
        const way = unit(push.force), tail = camera.see(torso.map((x, i) => x - ARROW * way[i])), head = camera.see(torso);
        if (!tail || !head) continue;
        const along = unit([head[0] - tail[0], head[1] - tail[1], 0]), size = 12 * ratio;
        const back = [head[0] - size * along[0], head[1] - size * along[1]];
        context.strokeStyle = context.fillStyle = "#c1121f";
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
        context.font = `${13 * ratio}px sans-serif`;
        context.textAlign = "center";
        context.lineWidth = 4 * ratio;
        context.strokeStyle = "#ffffff";
        const place = [tail[0] - 12 * ratio * along[0], tail[1] - 12 * ratio * along[1]];
        context.strokeText(push.words, ...place);
        context.fillText(push.words, ...place);
      }
    }
  }

  document.querySelectorAll("figure.player").forEach((figure) => new Player(figure));
})();
