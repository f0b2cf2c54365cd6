// Loads a module that `servocore export SCENE --wasm FILE` has written, in a browser or in another JavaScript engine:
//   const crane = await load(fetch("crane.wasm"));            // or the bytes themselves
//   const { outputs, verdicts } = crane.invert(path, { parameters: { load_mass: 80 } });
// A path is a Float64Array, value after value (all x, all y, all z, all vx, ...) as `about.path` lists them.
export async function load(source) {
  const given = await source;
  const module = await WebAssembly.compile(given instanceof Response ? await given.arrayBuffer() : given);
  const [text] = WebAssembly.Module.customSections(module, "servocore");
  const about = JSON.parse(new TextDecoder().decode(text));
  const { memory, __heap_base, invert, march } = (await WebAssembly.instantiate(module)).exports;

  function run(count, path, parameters, times, call) {
    const instants = count - (times ? 0 : about.instants.length - 1); // marching begins with a past
    const values = about.parameters.map(({ name, start }) => parameters[name] ?? start);
    const unknown = Object.keys(parameters).find((name) => !about.parameters.some((each) => each.name === name));
    if (unknown !== undefined) throw new RangeError(`${about.title} has no parameter ${unknown}`);
    if (path.length !== count * about.path.length || !(instants > 0))
      throw new RangeError(`a path has ${about.path.length} values at each instant, ${path.length} do not fit`);
    const numbers = [times ?? [], path, values]; // one after the other behind what the module keeps for itself
    const places = [Math.ceil(__heap_base.value / 8)];
    for (const size of [...numbers.map((each) => each.length), about.outputs.length * instants, instants])
      places.push(places.at(-1) + size);
    const missing = places[5] * 8 - memory.buffer.byteLength;
    if (missing > 0) memory.grow(Math.ceil(missing / 65536));
    const all = new Float64Array(memory.buffer);
    numbers.forEach((each, k) => all.set(each, places[k]));
    const solved = call(...places.map((place) => place * 8));
    const outputs = about.outputs.map(({ name }, k) =>
      [name, all.slice(places[3] + k * instants, places[3] + (k + 1) * instants)]);
    const verdicts = new Int32Array(memory.buffer, places[4] * 8, instants).slice();
    return { solved, outputs: Object.fromEntries(outputs), verdicts };
  }

  return {
    about,
    invert: invert && ((path, { parameters = {}, count = Math.floor(path.length / about.path.length), times } = {}) =>
      run(count, path, parameters, times ?? new Float64Array(count),
        (t, from, p, to, verdicts) => invert(count, t, from, p, to, verdicts))),
    march: march && ((path, step, { parameters = {}, count = Math.floor(path.length / about.path.length), start = 0 } = {}) =>
      run(count, path, parameters, null,
        (_, from, p, to, verdicts) => march(count, start, step, from, p, to, verdicts))),
  };
}
