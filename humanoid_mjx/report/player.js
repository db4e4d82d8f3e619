// Plays the motion of a robot on a canvas: shaded solids with a depth buffer, seen from any side. No WebGL: it is drawn
// the same where there is no GPU.
// Each `figure.player` holds its film as JSON (report/player.py) and gets canvas, buttons and keys here.
"use strict";
(() => {
  const AROUND = 24, FINE = 1.2e6, NEAR = 0.02, TURN = 0.12;

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
      this.view = this.start();
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
      this.canvas.setAttribute("role", "application");
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
      this.words = make("p", { className: "told", hidden: !this.film.told.length });
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
    start() { return { yaw: this.film.yaw, pitch: this.film.pitch, zoom: 1 }; }
    home() { this.view = this.start(); this.draw(); }
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
        if (this.time >= this.length) {
          if (this.figure.hasAttribute("data-autoplay")) this.time = 0;
          else { this.time = this.length; this.toggle(); }
        }
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
      const target = [tx, ty, film.middle], distance = zoom * film.distance * Math.max(1, 0.8 * height / width);
      const eye = target.map((x, i) => x - distance * forward[i]), focus = height / 2 / film.field;
      const camera = {
        eye, forward, width, height,
        see: (p) => {
          const away = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]], depth = dot(away, forward);
          if (depth < NEAR) return null;
          return [width / 2 + (focus * dot(away, right)) / depth, height / 2 - (focus * dot(away, up)) / depth, depth];
        },
      };
      const context = this.canvas.getContext("2d");
      const horizon = Math.max(1, height / 2 + focus * Math.tan(Math.max(-1.4, Math.min(1.4, pitch))));
      const sky = context.createLinearGradient(0, horizon - height / 2, 0, horizon);
      sky.addColorStop(0, "#d5dfea"); sky.addColorStop(1, "#ffffff");
      context.fillStyle = sky;
      context.fillRect(0, 0, width, height);
      const matrices = this.between(film.frames).map(placed);
      if (film.grid && eye[2] > 0) this.drawGround(context, camera, target, matrices);
      this.drawSolids(context, camera, matrices);
      this.drawPush(context, camera, [tx, ty, tz], ratio);
      this.slider.value = this.time;
      this.clock.textContent = `${this.time.toFixed(2)} s`;
      this.words.textContent = (film.told.filter(([start]) => start <= this.time + 1e-9).pop() || [0, ""])[1];
      this.canvas.dataset.time = this.time.toFixed(3);
      this.canvas.dataset.yaw = yaw.toFixed(3);
    }

    drawGround(context, camera, target, matrices) {
      const { grid, light } = this.film, reach = 1.6;
      const [x0, y0] = target.slice(0, 2).map((x) => Math.round(x / grid) * grid);
      context.lineWidth = Math.max(1, camera.height / 500);
      for (let k = -16; k <= 16; k++) {
        const half = Math.sqrt(Math.max(0, reach * reach - k * k * grid * grid)), pieces = 8;
        for (const axis of [0, 1])
          for (let i = 0; i < pieces; i++) {
            const at = (j) => half * ((2 * j) / pieces - 1);
            const point = (s) => (axis ? [x0 + k * grid, y0 + s, 0] : [x0 + s, y0 + k * grid, 0]);
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
      context.beginPath();
      matrices.forEach((matrix, s) => this.solids[s].forEach((f) => {
        if (dot(turned(matrix, f.normal), light) >= 0) return;
        const points = f.corners.map(({ point }) => {
          const [x, y, z] = moved(matrix, point), t = Math.max(z, 0) / -light[2];
          return camera.see([x + t * light[0], y + t * light[1], 0]);
        });
        if (points.some((p) => !p)) return;
        points.forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
        context.closePath();
      }));
      context.fillStyle = "rgba(40, 40, 50, 0.28)";
      context.fill("nonzero");
    }

    // Triangles with a depth buffer into a picture of their own, finer than the canvas, which smooths the edges.
    drawSolids(context, camera, matrices) {
      const fine = Math.min(2, Math.sqrt(FINE / (camera.width * camera.height))), triangles = [];
      const [ambient, diffuse, headlight] = this.film.brightness;
      let left = Infinity, right = -Infinity, top = Infinity, bottom = -Infinity;
      matrices.forEach((matrix, s) => this.solids[s].forEach((f) => {
        const first = moved(matrix, f.corners[0].point);
        if (dot(first.map((x, i) => x - camera.eye[i]), turned(matrix, f.normal)) >= 0) return;
        const seen = f.corners.map(({ point, normal }) => {
          const at = camera.see(moved(matrix, point)), out = turned(matrix, normal);
          const facing = (way) => Math.max(0, -dot(out, way));
          const light = ambient + diffuse * facing(this.film.light) + headlight * facing(camera.forward);
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
      if (right <= left || bottom <= top) return;
      const width = right - left, height = bottom - top, picture = new ImageData(width, height);
      const pixels = new Uint32Array(picture.data.buffer), depth = new Float32Array(width * height);
      for (const [a, b, c, s] of triangles) {
        const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if (Math.abs(area) < 1e-6) continue;
        const color = this.film.shapes[s].color.map((x) => 255 * x);
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

    drawPush(context, camera, torso, ratio) {
      for (const push of this.film.pushes) {
        const since = this.time - push.start;
        if (since < -1e-9 || since >= push.seconds) continue;
        const way = unit(push.force), head = camera.see(torso);
        const tail = camera.see(torso.map((x, i) => x - this.film.arrow * way[i]));
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
        const place = [tail[0], tail[1] + (along[1] < -0.3 ? 20 : -10) * ratio];
        context.strokeText(push.words, ...place);
        context.fillText(push.words, ...place);
      }
    }
  }

  document.querySelectorAll("figure.player").forEach((figure) => new Player(figure));
})();
