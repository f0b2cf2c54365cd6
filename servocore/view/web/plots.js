// Plots over time as SVG: text stays text, a print stays sharp, and colours follow the page.

const SVG = made("div", { innerHTML: "<svg></svg>" }).firstChild.namespaceURI, MOST_POINTS = 900;
const MARGIN = { left: 58, right: 18, top: 8, bottom: 22 };

function drawn(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

function made(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) key in element && key !== "list" ? (element[key] = value) : element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// 1, 2 or 5 times a power of ten, not smaller than what is wanted.
function niceStep(wanted) {
  const power = 10 ** Math.floor(Math.log10(wanted)), share = wanted / power;
  return power * (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10);
}

function ticks(low, high, most) {
  const step = niceStep((high - low) / most), found = [];
  for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12) + 1e-12 * step; k++) found.push(k * step);
  return { step, found };
}

const RAISED = Object.fromEntries([..."-0123456789"].map((each, k) => [each, "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"[k]]));

function written(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-3 && size < 1e6) return String(Number(value.toPrecision(digits))).replace("-", "−");
  const [mantissa, exponent] = value.toExponential(Math.min(digits - 1, 1)).split("e");
  return `${Number(mantissa) === 1 ? "" : `${mantissa.replace("-", "−")}·`}10${[...String(Number(exponent))].map((each) => RAISED[each]).join("")}`;
}

// One panel. `view` is the shared stretch of time {from, to}; `on` has the handlers of user actions.
class Plot {
  constructor({ title, unit, factor = 1, logarithmic = false, describe }, view, on) {
    Object.assign(this, { title, unit, factor, logarithmic, view, on, curves: [], bounds: null });
    this.reading = made("span", { className: "reading" });
    this.heading = made("div", { className: "plot-heading" }, made("span", { className: "plot-title" }, symbol(title), ` (${unit})`), this.reading);
    this.svg = drawn("svg", { role: "img", tabindex: 0, "aria-label": `${describe}; arrow keys move the time, plus and minus zoom` });
    this.element = made("figure", { className: "plot" }, this.heading, this.svg);
    this.listen();
  }

  // Curves are {t, row, kind}: kind is a class of the style sheet and a word in the reading.
  show(curves, bounds) {
    Object.assign(this, { curves, bounds });
    this.draw();
  }

  resize() {
    [this.width, this.height] = [this.svg.clientWidth, this.svg.clientHeight];
  }

  draw() {
    const { width, height } = this;
    if (!width || !this.curves.length) return;
    this.inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
    this.range = this.rangeInView();
    this.svg.replaceChildren();
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.drawGrid();
    this.drawBounds();
    for (const { t, row, kind } of this.curves) drawn("path", { class: `curve ${kind}`, d: this.outline(t, row) }, this.svg);
    this.cursor = drawn("line", { class: "cursor", y1: MARGIN.top, y2: MARGIN.top + this.inner.height }, this.svg);
    this.selection = drawn("rect", { class: "selection", y: MARGIN.top, height: this.inner.height, width: 0 }, this.svg);
    this.point(this.now ?? this.view.from);
  }

  x(time) {
    return MARGIN.left + ((time - this.view.from) / (this.view.to - this.view.from)) * this.inner.width;
  }

  y(value) {
    const { low, high } = this.range, place = this.logarithmic ? Math.log10(Math.max(Math.abs(value), 10 ** low)) : value;
    return MARGIN.top + (1 - (place - low) / (high - low)) * this.inner.height;
  }

  timeAt(event) {
    const share = (event.clientX - this.svg.getBoundingClientRect().left - MARGIN.left) / this.inner.width;
    return this.view.from + Math.min(Math.max(share, 0), 1) * (this.view.to - this.view.from);
  }

  rangeInView() {
    let low = Infinity, high = -Infinity;
    for (const { t, row } of this.curves)
      for (let k = 0; k < row.length; k++) {
        if (t[k] < this.view.from || t[k] > this.view.to || !Number.isFinite(row[k])) continue;
        if (row[k] < low) low = row[k];
        if (row[k] > high) high = row[k];
      }
    if (!(low <= high)) [low, high] = [0, 1];
    if (this.logarithmic) return this.decades(Math.max(Math.abs(low), Math.abs(high)) * this.factor);
    [low, high] = [low * this.factor, high * this.factor];
    const slightest = 1e-6 * Math.max(Math.abs(low), Math.abs(high), 1e-9), room = Math.max(0.06 * (high - low), 0);
    return high - low < slightest ? { low: low - 1e4 * slightest, high: high + 1e4 * slightest } : { low: low - room, high: high + room };
  }

  // Six powers of ten below the largest value.
  decades(largest) {
    const high = Math.ceil(Math.log10(Math.max(largest, 1e-12)) + 0.05);
    return { low: high - 6, high };
  }

  drawGrid() {
    const { low, high } = this.range, down = MARGIN.top + this.inner.height, right = MARGIN.left + this.inner.width;
    const values = this.logarithmic ? [0, 2, 4, 6].map((k) => 10 ** (low + k)) : ticks(low, high, 4).found;
    for (const value of values) {
      drawn("line", { class: value === 0 ? "zero" : "grid", x1: MARGIN.left, x2: right, y1: this.y(value), y2: this.y(value) }, this.svg);
      drawn("text", { class: "tick", x: MARGIN.left - 6, y: this.y(value) + 4, "text-anchor": "end" }, this.svg).textContent = written(Number(value.toPrecision(6)));
    }
    const times = ticks(this.view.from, this.view.to, Math.max(3, this.inner.width / 70)).found, last = times[times.length - 1];
    for (const time of times) {
      drawn("line", { class: "grid", x1: this.x(time), x2: this.x(time), y1: MARGIN.top, y2: down }, this.svg);
      drawn("text", { class: "tick", x: this.x(time), y: down + 15, "text-anchor": "middle" }, this.svg).textContent =
        `${written(Number(time.toPrecision(6)))}${time === last ? " s" : ""}`;
    }
  }

  drawBounds() {
    if (!this.bounds) return;
    for (const [value, beyond] of [[this.bounds.low, this.range.low], [this.bounds.high, this.range.high]]) {
      const at = value * this.factor;
      if (!Number.isFinite(at) || at <= this.range.low || at >= this.range.high) continue;
      const [top, bottom] = [this.y(at), this.y(beyond)].sort((a, b) => a - b);
      drawn("rect", { class: "beyond", x: MARGIN.left, width: this.inner.width, y: top, height: bottom - top }, this.svg);
      drawn("line", { class: "bound", x1: MARGIN.left, x2: MARGIN.left + this.inner.width, y1: this.y(at), y2: this.y(at) }, this.svg);
    }
  }

  // At most a few points a pixel.
  outline(t, row) {
    const { from, to } = this.view, share = (to - from) / (t[t.length - 1] - t[0]), stride = Math.max(1, Math.floor((t.length * share) / MOST_POINTS));
    const near = (to - from) / 50, parts = [];
    let pen = "M";
    for (let k = 0; k < t.length; k += k + stride < t.length || k === t.length - 1 ? stride : t.length - 1 - k) {
      if (t[k] < from - near || t[k] > to + near) continue;
      if (!Number.isFinite(row[k])) { pen = "M"; continue; }
      parts.push(`${pen}${this.x(t[k]).toFixed(1)} ${this.y(row[k] * this.factor).toFixed(1)}`);
      pen = "L";
    }
    return parts.join("");
  }

  // Move the cursor and say the values there.
  point(time) {
    this.now = time;
    if (!this.cursor || !this.inner) return;
    const inside = time >= this.view.from && time <= this.view.to;
    this.cursor.setAttribute("x1", this.x(time));
    this.cursor.setAttribute("x2", this.x(time));
    this.cursor.style.visibility = inside ? "visible" : "hidden";
    this.reading.replaceChildren(...this.curves.map(({ t, row, kind, label }) =>
      made("span", { className: `value ${kind}` }, ...(label ? [label === "paper" ? label : symbol(label), " "] : []), `${written(interpolated(t, row, time) * this.factor)}`)));
  }

  listen() {
    let from = null;
    this.svg.addEventListener("pointerdown", (event) => {
      if (!this.inner || event.button) return;
      from = { x: event.clientX, time: this.timeAt(event), touch: event.pointerType === "touch" };
      this.svg.setPointerCapture(event.pointerId);
      if (from.touch) this.on.go(from.time);
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (!this.inner) return;
      const time = this.timeAt(event);
      if (from?.touch) return this.on.go(time);
      if (from && Math.abs(event.clientX - from.x) > 4) this.select(from.time, time);
      this.on.hover(time);
    });
    this.svg.addEventListener("pointerup", (event) => {
      if (!from) return;
      const time = this.timeAt(event), dragged = Math.abs(event.clientX - from.x) > 4;
      if (!from.touch && dragged) this.on.zoom(Math.min(from.time, time), Math.max(from.time, time));
      else if (!dragged) this.on.go(time);
      from = null;
    });
    this.svg.addEventListener("pointerleave", () => this.on.hover(null));
    this.svg.addEventListener("dblclick", () => this.on.whole());
    this.svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      this.on.closer(Math.exp(-0.002 * event.deltaY), this.timeAt(event));
    }, { passive: false });
    this.svg.addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    const step = (this.view.to - this.view.from) / 100, moves = { ArrowLeft: -step, ArrowRight: step, PageUp: 10 * step, PageDown: -10 * step };
    if (event.key in moves) this.on.go(this.now + moves[event.key]);
    else if (event.key === "+" || event.key === "=") this.on.closer(1.5, this.now);
    else if (event.key === "-") this.on.closer(1 / 1.5, this.now);
    else if (event.key === "Escape" || event.key === "0") this.on.whole();
    else return;
    event.preventDefault();
  }

  select(from, to) {
    const [left, right] = [this.x(from), this.x(to)].sort((a, b) => a - b);
    this.selection.setAttribute("x", left);
    this.selection.setAttribute("width", right - left);
  }
}

// A name as it is written in formulas: M_b with its index below the line.
function symbol(name) {
  const [stem, ...index] = name.split("_"), greek = { phi: "φ", alpha: "α", beta: "β" }, element = made("i", {}, greek[stem] ?? stem);
  if (stem.length > 3 && !(stem in greek)) return made("span", {}, name.replaceAll("_", " "));
  return index.length ? made("span", {}, element, made("sub", {}, index.join(" "))) : made("span", {}, element);
}
