// The system in space: points from the values of one instant, projected onto a canvas. z points up.

const LOOK = { azimuth: -1.08, elevation: 0.38, zoom: 1 }; // in rad

class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.look = { ...LOOK, elevation: about.flat ? 0.06 : LOOK.elevation, azimuth: about.flat ? -Math.PI / 2 : LOOK.azimuth };
    this.orbit();
  }

  // Take in a run: where every point is at every instant, and how much room all of it needs.
  take(run) {
    const count = run.t.length, size = 3 * about.points, values = new Float64Array(about.outputs.length), p = new Float64Array(size);
    this.run = run;
    this.places = new Float64Array(count * size);
    for (let k = 0; k < count; k++) {
      for (let i = 0; i < values.length; i++) values[i] = run.rows[i][k];
      source.points(values, run.parameters, p);
      this.places.set(p, k * size);
    }
    this.measure();
  }

  measure() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    this.places.forEach((value, k) => {
      if (value < low[k % 3]) low[k % 3] = value;
      if (value > high[k % 3]) high[k % 3] = value;
    });
    this.reach = about.parts.map((part) => (part.kind === "bridge" ? 1.12 * this.farthest(part) : 0));
    const reach = Math.max(0, ...this.reach);
    if (reach) this.sweep(low, high);
    const extent = Math.max(...high.map((each, i) => each - low[i]), 1e-3);
    this.ground = about.grounded ? low[2] - 0.1 * extent : null;
    if (about.grounded) low[2] = this.ground;
    this.centre = low.map((each, i) => (each + high[i]) / 2);
    this.bounds = { low, high };
    this.extent = extent;
    this.radius = Math.hypot(...high.map((each, i) => each - low[i])) / 2 || 1;
  }

  // A bridge needs the room over which its tip goes.
  sweep(low, high) {
    about.parts.forEach(({ kind, places: [a, b] }, number) => {
      for (let k = 0; kind === "bridge" && k < this.run.t.length; k++) {
        tipOf(this.point(a, k), this.point(b, k), this.reach[number]).forEach((value, i) => {
          [low[i], high[i]] = [Math.min(low[i], value), Math.max(high[i], value)];
        });
      }
    });
  }

  farthest({ places: [a, b] }) {
    let most = 0;
    for (let k = 0; k < this.run.t.length; k++) {
      const [from, to] = [this.point(a, k), this.point(b, k)];
      most = Math.max(most, Math.hypot(...to.map((each, i) => each - from[i])));
    }
    return most;
  }

  point(number, k) {
    const from = 3 * (k * about.points + number);
    return [this.places[from], this.places[from + 1], this.places[from + 2]];
  }

  // Between instants points go straight: 2000 instants make that finer than a pixel.
  pointAt(number, time) {
    const { t } = this.run, last = t.length - 1;
    const k = Math.min(Math.max(Math.floor(((time - t[0]) / (t[last] - t[0])) * last), 0), last - 1);
    const part = Math.min(Math.max((time - t[k]) / (t[k + 1] - t[k]), 0), 1), [a, b] = [this.point(number, k), this.point(number, k + 1)];
    return a.map((each, i) => each + part * (b[i] - each));
  }

  // Drag to orbit, pinch or wheel with Ctrl to come closer, arrow keys as well.
  orbit() {
    const { canvas } = this, held = new Map();
    canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); });
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      held.set(event.pointerId, event);
      this.turn(-0.008 * (event.clientX - before.clientX), 0.008 * (event.clientY - before.clientY));
    });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      this.closer(Math.exp(-0.002 * event.deltaY));
    }, { passive: false });
    const keys = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.06], ArrowDown: [0, -0.06] };
    canvas.addEventListener("keydown", (event) => {
      if (keys[event.key]) this.turn(...keys[event.key]);
      else if (event.key === "+") this.closer(1.15);
      else if (event.key === "-") this.closer(1 / 1.15);
      else return;
      event.preventDefault();
    });
  }

  turn(azimuth, elevation) {
    this.look.azimuth += azimuth;
    this.look.elevation = Math.min(Math.max(this.look.elevation + elevation, -0.1), 1.5);
    this.draw(this.time);
  }

  closer(factor) {
    this.look.zoom = Math.min(Math.max(this.look.zoom * factor, 0.4), 6);
    this.draw(this.time);
  }

  // Where a point is on the canvas, and how far from the eye.
  project(point) {
    const { azimuth, elevation, zoom } = this.look, [x, y, z] = point.map((each, i) => each - this.centre[i]);
    const right = -Math.sin(azimuth) * x + Math.cos(azimuth) * y, away = -(Math.cos(azimuth) * x + Math.sin(azimuth) * y);
    const up = Math.cos(elevation) * z + Math.sin(elevation) * away, depth = Math.cos(elevation) * away - Math.sin(elevation) * z;
    const nearness = (7 * this.radius) / (7 * this.radius + depth), scale = this.scale * zoom * nearness;
    return { x: this.middle.x + scale * right, y: this.middle.y - scale * up, depth, right: nearness * right, up: nearness * up };
  }

  // Look up size and colours: asking the browser each time would make it lay out the page each time.
  resize() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    const style = getComputedStyle(canvas);
    this.ink = Object.fromEntries(["ink", "faint", "rule", "steel", "exact", "paper", "good", "card"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    this.font = `13px ${style.fontFamily}`;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio))
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    [this.width, this.height] = [width, height];
  }

  // Choose scale and middle so that all of the run is seen, from wherever one looks.
  fit() {
    const { low, high } = this.bounds, room = { x: 46, y: 38 }, sides = { right: [Infinity, -Infinity], up: [Infinity, -Infinity] };
    [this.scale, this.middle] = [1, { x: 0, y: 0 }];
    for (let corner = 0; corner < 8; corner++) {
      const seen = this.project(low.map((each, i) => ((corner >> i) & 1 ? high[i] : each)));
      for (const [key, range] of Object.entries(sides)) [range[0], range[1]] = [Math.min(range[0], seen[key]), Math.max(range[1], seen[key])];
    }
    const [wide, tall] = [sides.right[1] - sides.right[0], sides.up[1] - sides.up[0]], least = 1e-3 * this.extent;
    this.scale = Math.min((this.width - 2 * room.x) / Math.max(wide, least), (this.height - 2 * room.y) / Math.max(tall, least));
    const scale = this.scale * this.look.zoom;
    this.middle = { x: this.width / 2 - (scale * (sides.right[0] + sides.right[1])) / 2, y: this.height / 2 + (scale * (sides.up[0] + sides.up[1])) / 2 };
  }

  draw(time) {
    this.time = time;
    if (!this.run || !this.width) return;
    this.fit();
    const { context } = this;
    context.clearRect(0, 0, this.width, this.height);
    context.lineCap = context.lineJoin = "round";
    context.font = this.font;
    this.labels = [];
    this.drawFloor();
    this.drawPath(time);
    const drawn = about.parts.map((part, k) => ({ part, at: part.places.map((number) => this.pointAt(number, time)), reach: this.reach[k] }));
    drawn.map((each) => ({ ...each, depth: Math.max(...each.at.map((point) => this.project(point).depth)) - (SOLID.has(each.part.kind) ? this.radius : 0) }))
      .sort((a, b) => b.depth - a.depth)
      .forEach((each) => PAINT[each.part.kind](this, each, time));
    this.drawLabels();
    this.drawAxes();
  }

  line(points, colour, width, dashes = []) {
    const { context } = this;
    context.beginPath();
    points.map((each) => this.project(each)).forEach(({ x, y }, k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dashes);
    context.stroke();
    context.setLineDash([]);
  }

  dot(point, radius, colour, edge = this.ink.ink) {
    const { x, y } = this.project(point), { context } = this, light = context.createRadialGradient(x - radius / 3, y - radius / 3, radius / 8, x, y, radius);
    light.addColorStop(0, "#ffffffcc");
    light.addColorStop(0.35, colour);
    light.addColorStop(1, colour);
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = light;
    context.fill();
    context.strokeStyle = edge;
    context.lineWidth = 1.2;
    context.stroke();
  }

  write(text, point, right = 10, down = 4, colour = this.ink.ink) {
    const { x, y } = this.project(point);
    this.labels.push({ text, x: x + right, y: y + down, colour });
  }

  // Labels come last, each with a rim in the colour of the card: a part that is drawn over one would make it illegible.
  drawLabels() {
    const { context } = this;
    context.lineWidth = 4;
    context.strokeStyle = this.ink.card;
    for (const { text, x, y, colour } of this.labels) {
      context.strokeText(text, x, y);
      context.fillStyle = colour;
      context.fillText(text, x, y);
    }
  }

  drawFloor() {
    if (this.ground === null) return;
    const { low, high } = this.bounds, step = niceStep(this.extent / 9), z = this.ground;
    const span = [0, 1].map((i) => [Math.floor(low[i] / step + 1e-9) * step, Math.ceil(high[i] / step - 1e-9) * step]);
    if (about.flat) return this.line([[span[0][0], 0, z], [span[0][1], 0, z]], this.ink.rule, 1.5);
    for (let x = span[0][0]; x <= span[0][1] + 1e-9; x += step) this.line([[x, span[1][0], z], [x, span[1][1], z]], this.ink.rule, 0.7);
    for (let y = span[1][0]; y <= span[1][1] + 1e-9; y += step) this.line([[span[0][0], y, z], [span[0][1], y, z]], this.ink.rule, 0.7);
  }

  // The prescribed path: solid up to now, dashed ahead.
  drawPath(time) {
    if (about.tracked === null) return;
    const { t } = this.run, stride = Math.max(1, Math.floor(t.length / 240)), behind = [], ahead = [];
    for (let k = 0; k < t.length; k += stride) (t[k] <= time ? behind : ahead).push(this.point(about.tracked, k));
    const here = this.pointAt(about.tracked, time), end = this.point(about.tracked, t.length - 1);
    this.line([...behind, here], this.ink.paper, 2.4);
    this.line([here, ...ahead, end], this.ink.paper, 1.6, [5, 5]);
    this.write("start", this.point(about.tracked, 0), -48, 5, this.ink.faint); // beside the load, which begins there
    this.write("target", this.point(about.tracked, t.length - 1), -22, -12, this.ink.faint);
    if (this.ground === null || about.flat) return;
    this.line([...behind, here, ...ahead, end].map(([x, y]) => [x, y, this.ground]), this.ink.faint, 1, [2, 4]);
    this.line([here, [here[0], here[1], this.ground]], this.ink.faint, 1, [2, 4]);
    const shadow = this.project([here[0], here[1], this.ground]), { context } = this;
    context.beginPath();
    context.ellipse(shadow.x, shadow.y, 9, 9 * Math.max(Math.sin(this.look.elevation), 0.1), 0, 0, 2 * Math.PI);
    context.fillStyle = "#00000038";
    context.fill();
  }

  drawAxes() {
    const corner = [34, this.height - 30], { azimuth, elevation } = this.look, { context } = this, length = 24;
    const axes = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
    for (const [name, [x, y, z]] of Object.entries(axes)) {
      if (about.flat && name === "y") continue;
      const right = -Math.sin(azimuth) * x + Math.cos(azimuth) * y, away = -(Math.cos(azimuth) * x + Math.sin(azimuth) * y);
      const up = Math.cos(elevation) * z + Math.sin(elevation) * away, to = [corner[0] + length * right, corner[1] - length * up];
      context.beginPath();
      context.moveTo(...corner);
      context.lineTo(...to);
      context.strokeStyle = this.ink.faint;
      context.lineWidth = 1.4;
      context.stroke();
      context.fillStyle = this.ink.faint;
      context.fillText(name, to[0] + 5 * right - 3, to[1] - 9 * up + 4);
    }
  }
}

const SOLID = new Set(["body", "box", "pin"]);

// How each kind of part looks; `at` are its points now.
const PAINT = {
  rope(stage, { part, at }, time) {
    const share = shareOf(stage.run, part.colour, time);
    stage.line(at, share === null ? stage.ink.ink : tensionColour(share), share === null ? 1.6 : 1.6 + 2.4 * share);
  },
  bar: (stage, { at }) => stage.line(at, stage.ink.steel, 5),
  post: (stage, { at: [top] }) => stage.line([[top[0], top[1], stage.ground ?? top[2]], top], stage.ink.steel, 7),
  bridge(stage, { at: [from, to], reach }) {
    const tip = tipOf(from, to, reach);
    stage.line([from, tip], stage.ink.steel, 8);
    stage.line([from, tip], stage.ink.card, 2);
    stage.dot(from, 6, stage.ink.steel);
  },
  rail(stage, { part, at: [here] }) {
    const { low, high } = stage.bounds, i = part.along, room = 0.06 * stage.extent;
    const ends = [low[i] - room, high[i] + room].map((value) => here.map((each, k) => (k === i ? value : each)));
    stage.line(ends, stage.ink.steel, 5);
  },
  spring(stage, { at: [from, to] }) {
    const turns = 9, side = 0.025 * stage.extent, points = [from];
    for (let k = 1; k < 2 * turns; k++)
      points.push(from.map((each, i) => each + ((to[i] - each) * k) / (2 * turns) + (i === 2 ? (k % 2 ? side : -side) : 0)));
    stage.line([...points, to], stage.ink.faint, 1.6);
  },
  box(stage, { part, at: [here] }) {
    const { x, y } = stage.project(here), { context } = stage, size = 9;
    context.fillStyle = stage.ink.good;
    context.strokeStyle = stage.ink.ink;
    context.lineWidth = 1.2;
    context.beginPath();
    context.rect(x - 1.3 * size, y - size, 2.6 * size, 2 * size);
    context.fill();
    context.stroke();
    stage.write(part.name, here, 17, -9);
  },
  body(stage, { part, at: [here] }) {
    stage.dot(here, 12, stage.ink.exact);
    stage.write(part.name, here, 17, 5);
  },
  pin: (stage, { at: [here] }) => stage.dot(here, 4, stage.ink.steel),
};

// The point so far from one point through another.
function tipOf(from, to, reach) {
  const length = Math.hypot(...to.map((each, i) => each - from[i])) || 1;
  return from.map((each, i) => each + ((to[i] - each) * reach) / length);
}

// Where a value lies between the smallest and the largest of the run, 0 to 1; null where nothing is to be shown.
function shareOf(run, index, time) {
  if (index === null || index === undefined) return null;
  const row = run.rows[index], { low, high } = rangeOf(row);
  return high - low > 1e-9 * Math.abs(high) ? (interpolated(run.t, row, time) - low) / (high - low) : 0.5;
}

function rangeOf(row) {
  let low = Infinity, high = -Infinity;
  for (const each of row) {
    if (each < low) low = each;
    if (each > high) high = each;
  }
  return { low, high };
}

// Blue to orange through a pale middle: distinguishable with any colour vision, and the line gets thicker as well.
function tensionColour(share) {
  const stops = [[0, 114, 178], [120, 160, 185], [230, 159, 0], [213, 94, 0]], place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const k = Math.min(Math.floor(place), stops.length - 2);
  return `rgb(${stops[k].map((each, i) => Math.round(each + (place - k) * (stops[k + 1][i] - each))).join(",")})`;
}
