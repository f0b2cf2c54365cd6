// The mathematics of a live page. `about` is what Python wrote, `source` the functions that it generated from the
// equations; a path is gamma (rows x orders), column after column: all components, their first derivatives, and so on.

function unpacked(text) {
  return new Float64Array(Uint8Array.from(atob(text), (each) => each.charCodeAt(0)).buffer);
}

// The path ------------------------------------------------------------------------------------------------------------

// A straight line, evaluated about the nearer end: the same operations as in `RestToRest`.
function lineAt({ start, end, law, duration }, t, path) {
  const { start_time, dimension } = about.path, last = start_time + duration, whole = last - start_time;
  const clipped = (x) => Math.min(Math.max(x, 0), whole);
  const s = new Float64Array(about.orders);
  source[`law${law}`]([clipped(t - start_time), clipped(last - t), whole], s);
  if (t < start_time || t >= last) s.fill(0, 1);
  for (let i = 0; i < dimension; i++) {
    const way = end[i] - start[i];
    path[i] = s[0] > 0.5 ? end[i] - (1 - s[0]) * way : s[0] * way + start[i];
    for (let k = 1; k < about.orders; k++) path[k * about.rows + i] = s[k] * way;
  }
  clockAt(t, path);
}

// A row of a table, stretched in time: each derivative by time has one factor more. Before the first row it rests.
function rowAt({ duration }, row, path) {
  const { start_time, dimension, times, jets } = about.path, slower = about.path.duration / duration;
  const used = Math.min(Math.max(row, 0), times.length - 1), rests = row < 0;
  for (let k = 0, factor = 1; k < about.orders; k++, factor *= slower)
    for (let i = 0; i < dimension; i++)
      path[k * about.rows + i] = rests && k ? 0 : jets[(used * about.orders + k) * dimension + i] * factor;
  clockAt(start_time + (times[used] - start_time) / slower, path);
}

function clockAt(t, path) {
  if (about.rows === about.path.dimension) return;
  for (let k = 0; k < about.orders; k++) path[k * about.rows + about.rows - 1] = k === 0 ? t : +(k === 1);
}

// Instants k = 0, 1, ..., and -1 for the one before: their times, and what writes the path there.
function gridOf(settings, count) {
  const { start_time, times } = about.path, last = count - 1;
  if (about.path.kind === "line")
    return { count, time: (k) => start_time + (settings.duration * k) / last,
             path: (k, to) => lineAt(settings, start_time + (settings.duration * k) / last, to) };
  const stride = Math.max(1, Math.round((times.length - 1) / last)), stretch = settings.duration / about.path.duration;
  return { count: Math.floor((times.length - 1) / stride) + 1,
           time: (k) => start_time + (times[Math.min(k * stride, times.length - 1)] - start_time) * stretch,
           path: (k, to) => rowAt(settings, k * stride, to) };
}

// The exact inversion -----------------------------------------------------------------------------------------------

// Values of all outputs at the instants of a grid, one row an output; NaN where the equations are not solved.
function inverted(settings, grid) {
  const { count } = grid, size = about.outputs.length, path = new Float64Array(about.rows * about.orders);
  const found = new Float64Array(size), t = new Float64Array(count), exact = source.exact;
  const rows = about.outputs.map(() => new Float64Array(count)), margins = about.path_limits.map(() => new Float64Array(count));
  const left = new Float64Array(margins.length);
  for (let k = 0; k < count; k++) {
    t[k] = grid.time(k);
    grid.path(k, path);
    exact(path, settings.parameters, found);
    for (let i = 0; i < size; i++) rows[i][k] = found[i];
    if (margins.length) source.path_limits(path, settings.parameters, left);
    for (let i = 0; i < margins.length; i++) margins[i][k] = left[i];
  }
  goOn(rows);
  addUp(t, rows);
  return { t, rows, margins };
}

// Angles go on from instant to instant.
function goOn(rows) {
  const turn = 2 * Math.PI;
  about.outputs.forEach(({ wraps }, i) => {
    for (let k = 1, row = rows[i]; wraps && k < row.length; k++) {
      const change = row[k - 1] - row[k];
      if (Math.abs(change) > Math.PI) row[k] += turn * Math.round(change / turn);
    }
  });
}

// The last rows: integrals of powers over the time, and roots of mean squares of torques.
function addUp(t, rows) {
  about.added_up.forEach(({ of, rms }, i) => {
    const from = rows[of], row = rows[rows.length - about.added_up.length + i], squared = (k) => (rms ? from[k] ** 2 : from[k]);
    for (let k = 0, sum = 0; k < row.length; k++) {
      if (k) sum += ((t[k] - t[k - 1]) * (squared(k) + squared(k - 1))) / 2;
      row[k] = rms ? (k ? Math.sqrt(sum / (t[k] - t[0])) : Math.abs(from[k])) : sum;
    }
  });
}

// The scheme of the paper: the projected form, backward Euler ---------------------------------------------------------

const TOLERANCE = 1e-9, MOST_ITERATIONS = 30;

function marched(settings, step) {
  const steps = Math.max(2, Math.round(settings.duration / step)), grid = gridOf(settings, steps + 1);
  const h = (grid.time(grid.count - 1) - grid.time(0)) / (grid.count - 1), { unknowns, state: size, orders } = about.steps;
  const path = new Float64Array(about.rows * about.orders), next = new Float64Array(size), found = new Float64Array(about.outputs.length);
  const givens = new Float64Array(size + about.rows * orders + 1 + settings.parameters.length);
  const state = begun(settings, grid, h), t = new Float64Array(grid.count), rows = about.outputs.map(() => new Float64Array(grid.count).fill(NaN));
  const x = new Float64Array(unknowns), scale = new Float64Array(unknowns), blocks = about.steps.blocks.map(workOf);
  givens.set(settings.parameters, size + about.rows * orders + 1);
  givens[size + about.rows * orders] = h;
  for (let k = 0, good = true; k < grid.count; k++) {
    t[k] = grid.time(k);
    grid.path(k, path);
    if (k) {
      givens.set(state);
      givens.set(path.subarray(0, about.rows * orders), size);
      source.guess(givens, x, scale);
      for (let number = 0; good && number < blocks.length; number++) good = solved(blocks[number], x, givens, scale);
      source.next(x, givens, next);
      state.set(next);
    }
    if (!good) continue;
    source.observe(state, path, settings.parameters, found);
    for (let i = 0; i < rows.length; i++) rows[i][k] = found[i];
  }
  goOn(rows);
  addUp(t, rows);
  return { t, rows, h };
}

// The first state: positions by exact inversion at the start and, in the past, one step before.
function begun(settings, grid, h) {
  const { unknowns, state, instants } = about.steps, path = new Float64Array(about.rows * about.orders);
  const values = new Float64Array(unknowns * instants), first = new Float64Array(state);
  for (let k = 0; k < instants; k++) {
    if (about.path.kind === "line") lineAt(settings, about.path.start_time - k * h, path);
    else grid.path(-k, path);
    source.begin(path, settings.parameters, values.subarray(k * unknowns, (k + 1) * unknowns));
  }
  source.first(values, [h], first);
  return first;
}

// A block with what its solution needs, made once: new arrays at every step take longer than the computing.
function workOf(block, number) {
  const n = block.columns.length;
  return { ...block, evaluate: source[`block${number}`], residual: new Float64Array(n), jacobian: new Float64Array(n * n) };
}

// Newton's method on one block of unknowns; linear blocks take one step.
function solved({ columns, linear, evaluate, residual, jacobian }, x, givens, scale) {
  const n = columns.length;
  for (let k = 0; k < MOST_ITERATIONS; k++) {
    evaluate(x, givens, residual, jacobian);
    if (!eliminated(jacobian, residual, n)) return false;
    let most = 0;
    for (let i = 0; i < n; i++) {
      x[columns[i]] -= residual[i];
      most = Math.max(most, Math.abs(residual[i] / scale[columns[i]]));
    }
    if (!(most < Infinity)) return false;
    if (linear || most < TOLERANCE) return true;
  }
  return false;
}

// Solve a small dense system in place, columns one after the other, with pivots.
function eliminated(matrix, right, n) {
  for (let j = 0; j < n; j++) {
    let pivot = j;
    for (let i = j + 1; i < n; i++) if (Math.abs(matrix[j * n + i]) > Math.abs(matrix[j * n + pivot])) pivot = i;
    if (!matrix[j * n + pivot]) return false;
    for (let k = 0; k < n && pivot !== j; k++) swap(matrix, k * n + j, k * n + pivot);
    if (pivot !== j) swap(right, j, pivot);
    for (let i = j + 1; i < n; i++) {
      const factor = matrix[j * n + i] / matrix[j * n + j];
      for (let k = j + 1; k < n; k++) matrix[k * n + i] -= factor * matrix[k * n + j];
      right[i] -= factor * right[j];
    }
  }
  for (let j = n - 1; j >= 0; j--) {
    right[j] /= matrix[j * n + j];
    for (let i = 0; i < j; i++) right[i] -= matrix[j * n + i] * right[j];
  }
  return true;
}

function swap(array, i, j) {
  [array[i], array[j]] = [array[j], array[i]];
}

// What is read off rows ---------------------------------------------------------------------------------------------

// Largest magnitude and where it is.
function peakOf(row) {
  let at = 0;
  for (let k = 1; k < row.length; k++) if (Math.abs(row[k]) > Math.abs(row[at]) || row[at] !== row[at]) at = k;
  return { value: row[at], at };
}

function interpolated(t, row, time) {
  let low = 0, high = t.length - 1;
  if (!(time > t[0])) return row[0];
  if (time >= t[high]) return row[high];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle;
    else high = middle;
  }
  const part = (time - t[low]) / (t[high] - t[low]);
  return row[low] + part * (row[high] - row[low]);
}

// The largest difference between the page's own numbers and those that Python wrote, relative to the peak of each.
function liveCheck() {
  const times = about.solved.t, own = inverted(startSettings(), aboutGrid(times));
  let worst = 0;
  about.outputs.forEach((_, i) => {
    const wrote = about.solved.rows[i], peak = scaleOf(about.solved.rows, i);
    for (let k = 0; k < times.length; k++) {
      const apart = Math.abs(own.rows[i][k] - wrote[k]) / peak;
      if (!(apart <= worst)) worst = apart; // NaN too
    }
  });
  return worst;
}

// The peak of a row; one that is next to nothing counts as a millionth of the largest in the same unit.
function scaleOf(rows, i) {
  const alike = rows.filter((_, k) => about.outputs[k].unit === about.outputs[i].unit);
  const largest = Math.max(...alike.map((row) => Math.abs(peakOf(row).value)));
  return Math.max(Math.abs(peakOf(rows[i]).value), 1e-6 * largest, Number.MIN_VALUE);
}

function aboutGrid(times) {
  const settings = startSettings();
  if (about.path.kind === "table") return gridOf(settings, times.length);
  return { count: times.length, time: (k) => times[k], path: (k, to) => lineAt(settings, times[k], to) };
}

function startSettings() {
  const { start = [], end = [], duration } = about.path;
  return { parameters: Float64Array.from(about.parameters, ({ value }) => value), start: [...start], end: [...end], duration, law: 0 };
}
