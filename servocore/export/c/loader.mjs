// Loads a module that `servocore export SCENE --wasm FILE` has written, in a browser or in another JavaScript engine:
//   const crane = await load(fetch("crane.wasm"));            // or the bytes themselves
//   const { outputs, verdicts } = crane.invert(path, { parameters: { load_mass: 80 } });
// A path is a Float64Array, value after value (all x, all y, all z, all vx, ...) as `about.path` lists them.
export async function load(source) {
  const given = await source, refuse = (sentence) => { throw new RangeError(sentence); };
  if (given instanceof Response && !given.ok) throw new Error(`${given.url}: ${given.status} ${given.statusText}`);
  const module = await WebAssembly.compile(given instanceof Response ? await given.arrayBuffer() : given);
  const [text] = WebAssembly.Module.customSections(module, "servocore");
  if (!text) throw new TypeError("this module is none of `servocore export --wasm`");
  const about = JSON.parse(new TextDecoder().decode(text)), { title } = about;
  const { memory, __heap_base, invert, march } = (await WebAssembly.instantiate(module)).exports;

  function run(call, path, times, parameters, past) {
    const size = about.path.length, count = path?.length / size, instants = count - past;
    if (!(Number.isInteger(count) && instants > 0))
      refuse(`a path has ${size} values at each instant, at least at ${past + 1}: ${path?.length} do not fit`);
    if (times && times.length !== count) refuse(`a path of ${count} instants needs as many times, not ${times.length}`);
    for (const name in parameters)
      if (!about.parameters.some((each) => each.name === name)) refuse(`${title} has no parameter ${name}`);
    const values = about.parameters.map(({ name, unit, start, min = -Number.MAX_VALUE, max = Number.MAX_VALUE }) => {
      const value = parameters?.[name] ?? start; // NaN is in no range
      return value >= min && value <= max ? value
        : refuse(`${name} = ${value} ${unit} is outside its range [${min}, ${max}] ${unit}`);
    });
    // One after the other, behind the memory of the module: these, the table of outputs, the verdicts.
    const arrays = [times ?? new Float64Array(count), path, values];
    const lengths = [...arrays.map((each) => each.length), about.outputs.length * instants, instants];
    let end = Math.ceil(__heap_base.value / 8);
    const places = lengths.map((length) => (end += length) - length);
    memory.grow(Math.max(0, Math.ceil((8 * end - memory.buffer.byteLength) / 65536)));
    const all = new Float64Array(memory.buffer);
    arrays.forEach((each, k) => all.set(each, places[k]));
    const solved = call(count, ...places.map((place) => 8 * place)), table = all.subarray(places[3], places[4]);
    const outputs = about.outputs.map(({ name }, k) => [name, table.slice(k * instants, (k + 1) * instants)]);
    const verdicts = new Int32Array(memory.buffer, 8 * places[4], instants).slice();
    return { solved, outputs: Object.fromEntries(outputs), verdicts };
  }

  return {
    about,
    invert: invert && ((path, { parameters = {}, times } = {}) => {
      if (about.timed && !times) refuse(`the equations of ${title} contain the time: times are needed`);
      return run(invert, path, times, parameters, 0);
    }),
    march: march && ((path, step, { parameters = {}, start = 0 } = {}) => {
      if (!(step > 0 && Number.isFinite(step + start))) refuse(`steps are above 0 s, not ${step} s from ${start} s on`);
      const call = (count, _, ...places) => march(count, start, step, ...places);
      return run(call, path, null, parameters, about.instants.length - 1);
    }),
  };
}
