// Loads a module that `servocore export SCENE --wasm FILE` has written, in a browser or in another JavaScript engine:
//   const crane = await load(fetch("crane.wasm"));            // or the bytes themselves
//   const { outputs, verdicts } = crane.invert(path, { parameters: { load_mass: 80 } });
// A path is a Float64Array, value after value (all x, all y, all z, all vx, ...) as `about.path` lists them.
export async function load(source) {
  const given = await source;
  if (given instanceof Response && !given.ok) throw new Error(`${given.url}: ${given.status} ${given.statusText}`);
  const module = await WebAssembly.compile(given instanceof Response ? await given.arrayBuffer() : given);
  const [text] = WebAssembly.Module.customSections(module, "servocore");
  if (!text) throw new TypeError("this module is none of `servocore export --wasm`");
  const about = JSON.parse(new TextDecoder().decode(text));
  const { memory, __heap_base, invert, march } = (await WebAssembly.instantiate(module)).exports;

  const refuse = (sentence) => { throw new RangeError(sentence); };
  function run(path, parameters, times, past, call) {
    const count = Math.floor(path.length / about.path.length), instants = count - past;
    const unknown = Object.keys(parameters).find((name) => !about.parameters.some((each) => each.name === name));
    if (unknown !== undefined) refuse(`${about.title} has no parameter ${unknown}`);
    const values = about.parameters.map(({ name, unit, start, min = -Infinity, max = Infinity }) => {
      const value = Number(parameters[name] ?? start);
      if (!Number.isFinite(value)) refuse(`${name} = ${parameters[name]} ${unit} is not a finite number`);
      return value >= min && value <= max ? value
        : refuse(`${name} = ${parameters[name]} ${unit} is outside its range [${min}, ${max}] ${unit}`);
    });
    if (path.length !== count * about.path.length || !(instants > 0))
      refuse(`a path has ${about.path.length} values at each instant, at least at ${past + 1}: ${path.length} do not fit`);
    if (times.length !== count) refuse(`a path of ${count} instants needs as many times, not ${times.length}`);
    const numbers = [times, path, values]; // one after the other behind what the module keeps for itself
    const places = [Math.ceil(__heap_base.value / 8)];
    for (const size of [...numbers.map((each) => each.length), about.outputs.length * instants, instants])
      places.push(places.at(-1) + size);
    const missing = places[5] * 8 - memory.buffer.byteLength;
    if (missing > 0) memory.grow(Math.ceil(missing / 65536));
    const all = new Float64Array(memory.buffer);
    numbers.forEach((each, k) => all.set(each, places[k]));
    const solved = call(count, ...places.map((place) => place * 8));
    const outputs = about.outputs.map(({ name }, k) =>
      [name, all.slice(places[3] + k * instants, places[3] + (k + 1) * instants)]);
    const verdicts = new Int32Array(memory.buffer, places[4] * 8, instants).slice();
    return { solved, outputs: Object.fromEntries(outputs), verdicts };
  }
  const untimed = (path) => new Float64Array(Math.floor(path.length / about.path.length));

  return {
    about,
    invert: invert && ((path, { parameters = {}, times } = {}) => {
      if (about.timed && !times) refuse(`the equations of ${about.title} contain the time: times are needed`);
      return run(path, parameters, times ?? untimed(path), 0, invert);
    }),
    march: march && ((path, step, { parameters = {}, start = 0 } = {}) => {
      if (!(step > 0 && Number.isFinite(+step + +start))) refuse(`steps are above 0 s, not ${step} s from ${start} s on`);
      return run(path, parameters, untimed(path), about.instants.length - 1,
        (count, _, ...places) => march(count, start, step, ...places));
    }),
  };
}
