// Sliders with a number beside them: drag for a feeling, type for a value.

const UNITS = { rad: "°", "rad/s": "°/s", "kg.m2": "kg m²", "m/s2": "m/s²", "N.m": "N m", 1: "–" };

function shownUnit(unit) {
  return UNITS[unit] ?? unit;
}

function factorOf(unit) {
  return unit === "rad" || unit === "rad/s" ? 180 / Math.PI : 1;
}

// A slider from `low` to `high`, logarithmic where both are positive and far apart.
function slider({ label, unit, value, low, high, lower = -Infinity, upper = Infinity, describe = "" }, changed) {
  const bent = low > 0 && high / low > 8, place = (x) => (bent ? Math.log(x / low) / Math.log(high / low) : (x - low) / (high - low));
  const at = (share) => (bent ? low * (high / low) ** share : low + share * (high - low));
  const range = made("input", { type: "range", min: 0, max: 1, step: "any", value: place(value) });
  const number = made("input", { type: "number", step: "any", value: precise(value), inputMode: "decimal" });
  const name = made("span", { className: "control-name" }, label);
  range.setAttribute("aria-label", `${describe || name.textContent} in ${shownUnit(unit)}`);
  number.setAttribute("aria-label", `${describe || name.textContent} in ${shownUnit(unit)}, as a number`);
  if (describe) name.title = describe;
  const said = () => {
    range.setAttribute("aria-valuetext", `${number.value} ${shownUnit(unit)}`);
    fit(number);
  };
  range.addEventListener("input", () => {
    number.value = shortened(at(Number(range.value)));
    said();
    changed(Number(number.value));
  });
  range.addEventListener("keydown", (event) => { // by a hundredth: steps of any size have no keys of their own
    const by = { ArrowLeft: -0.01, ArrowDown: -0.01, ArrowRight: 0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1 }[event.key];
    if (!by) return;
    event.preventDefault();
    range.value = Math.min(Math.max(Number(range.value) + by, 0), 1);
    range.dispatchEvent(new Event("input"));
  });
  number.addEventListener("input", () => {
    const wanted = Number(number.value), good = number.value !== "" && Number.isFinite(wanted) && wanted >= lower && wanted <= upper;
    number.setCustomValidity(good ? "" : `from ${lower} to ${upper}`);
    if (!good) return;
    range.value = place(wanted);
    said();
    changed(wanted);
  });
  said();
  const element = made("div", { className: "control" }, name, range, number, made("span", { className: "unit" }, shownUnit(unit)));
  const set = (x) => { range.value = place(x); number.value = precise(x); said(); };
  return { element, set };
}

// What was given, without the round-off of degrees.
function precise(value) {
  return Number(value.toPrecision(12));
}

// As wide as its number at least: 184000 without its last digit would be read as 18400.
function fit(field) {
  field.style.minWidth = `calc(${field.value.length}ch + 1rem)`;
}

// Three digits are enough for what is dragged.
function shortened(value) {
  return Number(value.toPrecision(3));
}

function group(title, ...controls) {
  return made("fieldset", {}, made("legend", {}, title), ...controls);
}

function button(text, describe, act) {
  const element = made("button", { type: "button", textContent: text, title: describe });
  element.setAttribute("aria-label", describe);
  element.addEventListener("click", act);
  return element;
}
