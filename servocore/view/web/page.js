// The live page: its settings, the computed run, and the elements that show it.

const KEPT = "All limits are kept.";
const INSTANTS = 2001, MOST_STEPS = 20000;

class LivePage {
  constructor(root) {
    this.root = root;
    this.part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.settings = startSettings();
    this.step = about.step;
    this.bounds = about.outputs.map((_, i) => this.firstBounds(i));
    this.now = about.path.start_time;
    this.measured = 0;
    this.compute();
    this.build();
    this.listen();
    this.resize();
    this.show();
  }

  // Computing ---------------------------------------------------------------------------------------------------------

  compute() {
    if (!about.live) {
      this.run = { ...about.solved, margins: [], parameters: this.settings.parameters };
      return;
    }
    const begun = performance.now();
    this.run = { ...inverted(this.settings, gridOf(this.settings, INSTANTS)), parameters: Float64Array.from(this.settings.parameters) };
    this.measured = performance.now() - begun;
    const steps = this.settings.duration / this.step;
    this.paper = about.steps && steps <= MOST_STEPS ? marched(this.settings, this.step) : null;
    this.errors = this.paper && this.inputs().map((i) => this.errorOf(i));
  }

  inputs() {
    return about.outputs.flatMap(({ input }, i) => (input ? [i] : []));
  }

  // Inputs by the scheme of the paper less the exact ones, at the instants of its steps, as shares of the peak.
  errorOf(i) {
    const { t, rows } = this.paper, peak = scaleOf(this.run.rows, i);
    const row = Float64Array.from(t, (time, k) => (rows[i][k] - interpolated(this.run.t, this.run.rows[i], time)) / peak);
    return { t, row, largest: Math.abs(peakOf(row).value) };
  }

  // The limits of an output that the scene has; null where it has none, until the reader sets some.
  firstBounds(i) {
    const limit = about.limits.find(({ output, rate }) => output === i && !rate);
    return limit ? { low: limit.low ?? -Infinity, high: limit.high ?? Infinity } : null;
  }

  // Whether the scene or the reader has set a limit; the range of validity of a model (`path_limits`) is none.
  limited() {
    return this.bounds.some(Boolean) || about.limits.some(({ rate }) => rate);
  }

  // Violated limits, as sentences.
  broken() {
    const found = [], { t, rows, margins } = this.run;
    this.bounds.forEach((bounds, i) => {
      if (!bounds) return;
      const { name, unit } = about.outputs[i], factor = factorOf(unit), beyond = (value) => Math.max(value - bounds.high, bounds.low - value);
      let worst = i < rows.length - about.added_up.length ? 0 : t.length - 1; // what the run adds up counts at its end
      for (let k = worst + 1; k < t.length; k++) if (beyond(rows[i][k]) > beyond(rows[i][worst])) worst = k;
      const tolerance = 1e-9 * Math.max(...[bounds.low, bounds.high].filter(Number.isFinite).map(Math.abs), 0);
      if (beyond(rows[i][worst]) > tolerance)
        found.push({ output: i, text: `${name} reaches ${written(rows[i][worst] * factor, 3)} ${shownUnit(unit)} at ${written(t[worst], 3)} s` });
    });
    for (const { output, rate, low, high } of about.limits.filter((each) => each.rate)) this.rateBroken(output, low, high, found);
    about.path_limits.forEach(({ reason }, i) => {
      const k = margins[i]?.findIndex((value) => !(value > 0)) ?? -1;
      if (k >= 0) found.push({ output: null, text: `${reason} at ${written(t[k], 3)} s` });
    });
    return found;
  }

  // The verdict above the plots; empty where no limit was set, for there is nothing to judge.
  verdict(broken) {
    if (broken.length) return `Limit exceeded: ${broken.map((each) => each.text).join("; ")}.`;
    if (this.run.rows.some((row) => row.some(Number.isNaN))) return "Some instants are not solved.";
    return this.limited() ? KEPT : "";
  }

  rateBroken(i, low, high, found) {
    const { t, rows } = this.run, row = rows[i];
    for (let k = 1; k < t.length; k++) {
      const rate = (row[k] - row[k - 1]) / (t[k] - t[k - 1]);
      if (rate <= (high ?? Infinity) * (1 + 1e-6) && rate >= (low ?? -Infinity) * (1 + 1e-6)) continue;
      return found.push({ output: i, text: `the rate of ${about.outputs[i].name} is ${written(rate, 3)} ${about.outputs[i].unit}/s at ${written(t[k], 3)} s` });
    }
  }

  // Building ----------------------------------------------------------------------------------------------------------

  build() {
    this.view = { from: this.run.t[0], to: this.run.t[this.run.t.length - 1] };
    if (about.parts.length) this.stage = new Stage(this.part("stage"));
    else this.part("space").hidden = true;
    this.buildPlots();
    this.buildTransport();
    if (about.live) this.buildControls();
    this.root.hidden = false;
  }

  buildPlots() {
    const on = {
      go: (time) => this.go(time), hover: (time) => this.plots.forEach(({ plot }) => plot.point(time ?? this.now)),
      zoom: (from, to) => this.zoom(from, to), whole: () => this.zoom(), closer: (factor, about) => this.closer(factor, about),
    };
    this.plots = about.outputs.map(({ name, unit, description }, i) => ({
      plot: new Plot({ title: name, unit: shownUnit(unit), factor: factorOf(unit), describe: `${name} over time: ${description}` }, this.view, on), output: i,
    }));
    if (about.live && about.steps) this.plots.push({ plot: new Plot({ title: "error of the paper's scheme", unit: "% of peak", factor: 100, logarithmic: true,
      describe: "inputs by the scheme of the paper less the exact ones, in percent of the largest" }, this.view, on), output: null });
    const order = [...this.inputs(), null, ...about.shown, ...about.outputs.keys()], more = made("details", {}, made("summary", {}, "more"));
    this.plots.sort((a, b) => order.indexOf(a.output) - order.indexOf(b.output));
    const chosen = new Set([...this.inputs(), null, ...about.shown]), choices = this.part("choices"), place = this.part("plots");
    for (const each of this.plots) {
      each.plot.element.hidden = !chosen.has(each.output);
      const box = made("input", { type: "checkbox", checked: !each.plot.element.hidden });
      box.addEventListener("change", () => { each.plot.element.hidden = !box.checked; this.resize(); this.showPlots(); });
      (about.outputs[each.output]?.inner ? more : choices).append(made("label", {}, box, each.output === null ? "error" : symbol(about.outputs[each.output].name)));
      if (each.output !== null) each.plot.heading.append(this.boundField(each.output));
      place.append(each.plot.element);
    }
    if (more.childElementCount > 1) choices.append(more);
    this.part("zoom").append(button("+", "zoom in around the time", () => this.closer(1.5, this.now)),
      button("−", "zoom out", () => this.closer(1 / 1.5, this.now)), button("whole run", "show the whole run", () => this.zoom()));
  }

  // A field for the largest magnitude that an output may have, or two where its limits differ by more than the sign.
  boundField(i) {
    const { name, nonnegative } = about.outputs[i], bounds = this.bounds[i];
    const { low, high } = bounds ?? { low: -Infinity, high: Infinity }, one = nonnegative ? low === -Infinity : low === -high;
    const text = one ? (nonnegative ? "limit" : "limit ±") : "limits";
    const shown = one ? [[`limit of the magnitude of ${name}`, high]] : [[`lower limit of ${name}`, low], [`upper limit of ${name}`, high]];
    const fields = shown.map(([describe, value]) => this.numberOfBound(i, describe, value));
    const given = (field, none) => (field.value === "" ? none : Number(field.value) / factorOf(about.outputs[i].unit));
    const set = () => {
      const least = one ? -given(fields[0], Infinity) : given(fields[0], -Infinity), most = given(fields.at(-1), Infinity);
      this.bounds[i] = least < most && !(least === -Infinity && most === Infinity) ? { low: least, high: most } : null;
      this.show();
    };
    fields.forEach((field) => field.addEventListener("input", () => { fit(field); set(); }));
    return made(one ? "label" : "span", { className: "bound-field" }, text, ...fields);
  }

  numberOfBound(i, describe, value) {
    const { unit } = about.outputs[i];
    const field = made("input", { type: "number", step: "any", placeholder: "none", value: Number.isFinite(value) ? precise(value * factorOf(unit)) : "" });
    field.setAttribute("aria-label", `${describe} in ${shownUnit(unit)}`);
    fit(field);
    return field;
  }

  buildTransport() {
    this.play = button("▶ Play", "play the motion", () => this.toggle());
    this.play.classList.add("primary");
    this.scrub = made("input", { type: "range", min: 0, max: 1, step: "any", value: 0 });
    this.scrub.setAttribute("aria-label", "time");
    this.scrub.addEventListener("input", () => this.go(this.timeOf(Number(this.scrub.value))));
    this.scrub.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -0.01, ArrowRight: 0.01, ArrowDown: -0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 }[event.key];
      if (!by) return;
      event.preventDefault();
      this.go(this.timeOf(Number(this.scrub.value) + by));
    });
    this.clock = made("span", { className: "clock" });
    this.speed = made("select", {}, ...[0.25, 0.5, 1, 2, 4, 8].map((each) => made("option", { value: each, textContent: `${each}×`, selected: each === 2 })));
    this.speed.setAttribute("aria-label", "speed of playing");
    this.part("transport").append(this.play, this.scrub, this.clock, this.speed);
  }

  buildControls() {
    this.sliders = [];
    const ends = about.path.kind === "line" ? [this.endSliders("start", "Start"), this.endSliders("end", "Target")] : [];
    this.part("controls").append(group("Manoeuvre", ...this.manoeuvreSliders()), ...this.dataSliders(), ...ends);
    this.part("actions").append(button("Reset", "go back to the numbers that Python wrote", () => this.reset()),
      button("Save as CSV", "save what is shown as a table", () => this.save()));
  }

  add(options, act) {
    const made = slider(options, (value) => {
      act(value);
      this.change();
    });
    this.sliders.push({ ...made, value: options.value });
    return made.element;
  }

  manoeuvreSliders() {
    const { duration, kind, laws } = about.path, least = { value: duration, low: duration / 4, high: 3 * duration, lower: 1e-3 * duration, upper: 1e3 * duration };
    const found = [this.add({ label: "duration", unit: "s", ...least }, (value) => { this.settings.duration = value; })];
    if (kind === "line" && laws.length > 1) found.push(this.lawChoice());
    const range = { low: duration / 4000, high: duration / 20, lower: duration / MOST_STEPS, upper: duration / 4 };
    const step = { label: "paper's step", unit: "s", value: this.step, describe: "step of the paper's scheme", ...range };
    if (about.steps) found.push(this.add(step, (value) => { this.step = value; }));
    return found;
  }

  dataSliders() {
    const found = about.parameters.map(({ name, unit, value, lower, upper, description }, i) => {
      const label = name.replaceAll("_", " "), describe = description ? `${label}: ${description}` : label;
      const range = { ...spread(value, lower, upper), lower: lower ?? -Infinity, upper: upper ?? Infinity };
      return this.add({ label, unit, value, describe, ...range }, (x) => { this.settings.parameters[i] = x; });
    });
    return found.length ? [group("Data", ...found)] : [];
  }

  // One end of a straight line, each component as far beyond both ends as the line is long.
  endSliders(end, title) {
    const { start, end: last } = about.path, room = 0.4 * Math.max(...start.map((each, i) => Math.abs(each - last[i])), 1e-6);
    return group(title, ...about.path[end].map((value, i) => {
      const { name, unit } = about.components[i], range = { low: Math.min(start[i], last[i]) - room, high: Math.max(start[i], last[i]) + room };
      return this.add({ label: symbol(name), unit, value, describe: `${title.toLowerCase()} ${name}`, ...range }, (x) => { this.settings[end][i] = x; });
    }));
  }

  lawChoice() {
    const select = made("select", {}, ...about.path.laws.map(({ name }, k) => made("option", { value: k, textContent: name })));
    select.addEventListener("change", () => { this.settings.law = Number(select.value); this.change(); });
    this.law = select;
    return made("label", { className: "control" }, made("span", { className: "control-name" }, "time law"), select);
  }

  // What the user does ------------------------------------------------------------------------------------------------

  // Compute at once, show with the next picture of the screen.
  change() {
    const share = (this.now - this.run.t[0]) / (this.run.t[this.run.t.length - 1] - this.run.t[0]);
    this.compute();
    this.changed = true;
    const { t } = this.run, whole = [t[0], t[t.length - 1]];
    Object.assign(this.view, { from: whole[0], to: whole[1] });
    this.now = whole[0] + share * (whole[1] - whole[0]);
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.show();
    });
  }

  reset() {
    this.settings = startSettings();
    this.step = about.step;
    this.sliders.forEach(({ set, value }) => set(value));
    if (this.law) this.law.value = 0;
    this.change();
  }

  go(time) {
    const { t } = this.run;
    this.now = Math.min(Math.max(time, t[0]), t[t.length - 1]);
    this.showTime();
  }

  timeOf(share) {
    const { t } = this.run;
    return t[0] + Math.min(Math.max(share, 0), 1) * (t[t.length - 1] - t[0]);
  }

  zoom(from = this.run.t[0], to = this.run.t[this.run.t.length - 1]) {
    const { t } = this.run, least = (t[t.length - 1] - t[0]) / 500;
    if (to - from < least) [from, to] = [(from + to) / 2 - least / 2, (from + to) / 2 + least / 2];
    Object.assign(this.view, { from: Math.max(from, t[0]), to: Math.min(to, t[t.length - 1]) });
    this.showPlots();
  }

  closer(factor, time) {
    const { from, to } = this.view;
    this.zoom(time - (time - from) / factor, time + (to - time) / factor);
  }

  toggle() {
    this.playing = !this.playing;
    this.play.textContent = this.playing ? "❚❚ Pause" : "▶ Play";
    this.play.setAttribute("aria-label", this.playing ? "pause the motion" : "play the motion");
    if (!this.playing) return;
    if (this.now >= this.run.t[this.run.t.length - 1]) this.go(this.run.t[0]);
    let before = performance.now();
    const frame = (stamp) => {
      if (!this.playing) return;
      this.go(this.now + (Math.max(stamp - before, 0) / 1000) * Number(this.speed.value));
      before = stamp;
      if (this.now >= this.run.t[this.run.t.length - 1]) this.toggle();
      else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  save() {
    const { t, rows } = this.run, lines = [["time", ...about.outputs.map(({ name }) => name)].join(",")];
    for (let k = 0; k < t.length; k++) lines.push([t[k], ...rows.map((row) => row[k])].join(","));
    const link = made("a", { href: URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" })), download: `${about.name}.csv` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // Showing -----------------------------------------------------------------------------------------------------------

  show() {
    this.stage?.take(this.run);
    this.showStatus();
    this.showPlots();
    this.showTime();
  }

  showStatus() {
    const broken = this.broken(), status = this.part("status");
    const text = this.verdict(broken);
    if (status.textContent !== text) status.textContent = text;
    status.hidden = text === "";
    status.classList.toggle("exceeded", text !== "" && text !== KEPT);
    for (const { plot, output } of this.plots) plot.element.classList.toggle("exceeded", output !== null && broken.some((each) => each.output === output));
    if (!about.live) return;
    // The first time says how long the browser takes to get ready rather than to compute.
    if (this.changed) this.part("time").textContent = `${this.run.t.length} instants computed in ${this.measured.toFixed(1)} ms.`;
    const paper = this.part("paper");
    if (paper && this.errors) paper.replaceChildren(`At a step of ${written(this.paper.h, 3)} s the paper's scheme is off by `,
      ...this.inputs().flatMap((i, k) => [k ? ", " : "", symbol(about.outputs[i].name), ` ${written(100 * this.errors[k].largest, 2)} %`]), " of its peak. Exact inversion has no step.");
  }

  showPlots() {
    const inputs = this.inputs();
    for (const { plot, output } of this.plots) {
      if (plot.element.hidden) continue;
      if (output === null) {
        plot.show((this.errors ?? []).map(({ t, row }, k) => ({ t, row, kind: `input${k % 4}`, label: about.outputs[inputs[k]].name })), null);
        continue;
      }
      const exact = { t: this.run.t, row: this.run.rows[output], kind: "exact", label: "" };
      const paper = this.paper && inputs.includes(output) ? [{ t: this.paper.t, row: this.paper.rows[output], kind: "paper", label: "paper" }] : [];
      plot.show([exact, ...paper], this.bounds[output]);
    }
    this.plots.forEach(({ plot }) => plot.point(this.now));
  }

  showTime() {
    const { t } = this.run, first = t[0], last = t[t.length - 1];
    this.scrub.value = (this.now - first) / (last - first);
    this.clock.textContent = `${this.now.toFixed(2)} s`;
    this.scrub.setAttribute("aria-valuetext", this.clock.textContent);
    this.stage?.draw(this.now);
    this.plots.forEach(({ plot }) => plot.point(this.now));
    this.showColours();
  }

  showColours() {
    const part = about.parts.find(({ colour }) => colour !== null && colour !== undefined), legend = this.part("legend");
    if (!part) return;
    const { name, unit } = about.outputs[part.colour], { low, high } = rangeOf(this.run.rows[part.colour]);
    legend.hidden = false;
    const stops = [0, 0.25, 0.5, 0.75, 1].map(tensionColour).join(",");
    const bar = made("span", { className: "bar" });
    bar.style.background = `linear-gradient(to right, ${stops})`;
    legend.replaceChildren(`${name} `, written(low, 3), bar, `${written(high, 3)} ${shownUnit(unit)}; now `,
      made("b", {}, written(interpolated(this.run.t, this.run.rows[part.colour], this.now), 4)), ` ${shownUnit(unit)}`);
  }

  resize() {
    this.stage?.resize();
    this.plots.forEach(({ plot }) => plot.resize());
  }

  listen() {
    const again = () => { this.resize(); this.showPlots(); this.stage?.draw(this.now); };
    new ResizeObserver(again).observe(this.root);
    for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", again);
  }
}

// How far a slider goes to both sides of a value, within its bounds.
function spread(value, lower, upper) {
  const most = upper ?? Infinity, least = lower ?? -Infinity;
  if (value > 0) return { low: Math.max(value / 5, least), high: Math.min(value * 5, most) };
  const room = 5 * Math.abs(value) || 1;
  return { low: Math.max(value - room, least), high: Math.min(value + room, most) };
}

function begin() {
  const root = document.getElementById("live");
  try {
    about.solved = { t: unpacked(about.solved.t), rows: rowsOf(unpacked(about.solved.values)) };
    if (about.path.kind === "table") Object.assign(about.path, { times: unpacked(about.path.times), jets: unpacked(about.path.jets) });
    if (about.live) document.getElementById("live-check").textContent = String(Number(liveCheck().toPrecision(2)));
    window.servocore = new LivePage(root);
    const time = /\bt=([\d.]+)/.exec(location.hash);
    if (time) window.servocore.go(Number(time[1]));
  } catch (error) {
    root.before(made("p", { className: "live-failed", textContent: `The live part of this page does not run in this browser: ${error.message}` }));
    throw error;
  }
}

function rowsOf(values) {
  const count = values.length / about.outputs.length;
  return about.outputs.map((_, i) => values.subarray(i * count, (i + 1) * count));
}

begin();
