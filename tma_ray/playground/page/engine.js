/* The compiled engine of tma_ray.physics.compiled: a body in a world, with memory laid out by Python. */

const KINDS = { double: Float64Array, float: Float32Array, i64: BigInt64Array, bool: Uint8Array };

/** Returns an array in the form that the engine takes: element type, shape and flat values. */
const array = (kind, shape, values) => ({ kind, shape, values });

/** Swinging creepers, as `Chains` of tma_ray.physics.chipmunk: none on the page. */
const NO_CHAINS = [[0], [0], [0], [0, 2], [0, 2, 2]].map((shape, index) => array(index ? "double" : "i64", shape, []));

/** An instance of the WebAssembly module with its own memory. */
class Machine {
  constructor(module) {
    this.exports = new WebAssembly.Instance(module, {}).exports;
    this.exports._initialize();
    this.arguments = this.exports.keep(4096);
    this.results = this.exports.keep(512);
  }

  /** Copies an array into memory that stays allocated until `drop`. */
  keep({ kind, shape, values }) {
    const at = this.exports.keep(Math.max(values.length, 1) * KINDS[kind].BYTES_PER_ELEMENT);
    const kept = { kind, shape, at };
    const wide = kind === "i64" ? BigInt : Number;
    this.view(kept).set(Array.from(values, (value) => wide(value)));
    return kept;
  }

  drop(kept) {
    this.exports.drop(kept.at);
  }

  /** Returns a view of an array in memory, valid until the next call, which may grow the memory. */
  view({ kind, shape, at }) {
    return new KINDS[kind](this.exports.memory.buffer, at, shape.reduce((product, size) => product * size, 1));
  }

  /** Calls an exported kernel with numbers, kept arrays and tuples of these; returns the numbers of its result. */
  call(name, ...values) {
    const flat = [];
    const flatten = (value) => {
      if (typeof value === "number") flat.push(value);
      else if (Array.isArray(value)) value.forEach(flatten);
      else flat.push(value.at, ...value.shape);
    };
    values.forEach(flatten);
    new Float64Array(this.exports.memory.buffer, this.arguments, flat.length).set(flat);
    this.exports[name](this.arguments, this.results);
    return new Float64Array(this.exports.memory.buffer, this.results, 64);
  }

  /** Returns a copy of the array described in `results` from index `place` on. */
  copy(kind, results, place, dimensions) {
    const shape = Array.from(results.subarray(place + 1, place + 1 + dimensions));
    return array(kind, shape, this.view({ kind, shape, at: results[place] }).slice());
  }
}

/** One body in one world at a time.
 *
 * `body` is a record of tma_ray.playground.contents, `constants` are those of its engine. */
class Engine {
  constructor(module, body, constants) {
    this.machine = new Machine(module);
    this.body = body;
    this.constants = constants;
    const keep = (value) => (typeof value === "number" ? value : this.machine.keep(array(...value)));
    this.built = Object.values(body.built).map(keep);
    const memory = ([kind, size, values]) =>
      this.machine.keep(array(kind, [size], [...values, ...new Array(size - values.length).fill(0)]));
    this.floats = memory(body.floats);
    this.integers = memory(body.integers);
    this.parts = {};
    for (const [name, [place, shape]] of Object.entries(body.views)) {
      const owner = body.whole.includes(name) ? this.integers : this.floats;
      this.parts[name] = { kind: owner.kind, shape, at: owner.at + 8 * place };
    }
    this.observed = this.machine.keep(array("float", [body.observation], new Float32Array(body.observation)));
    this.world = null;
  }

  /** Returns a part of the memory by name, such as state (p, 6) or contacts (p, 2). */
  view(name) {
    return this.machine.view(this.parts[name]);
  }

  /** Builds a world, runs the steps before an episode, and returns the first observation. */
  reset(terrain, push) {
    this.release();
    const hangs = this.body.grips > 0 && terrain.ceiling.shape[0] > 0;
    const spawn = hangs ? array("double", [2], this.hung(terrain)) : terrain.spawn;
    const { constants, machine } = this;
    this.view("grips").fill(BigInt(constants.NOTHING));
    for (const name of ["holds", "medium", "wet"]) this.view(name).fill(0n);
    const kept = {};
    const keep = (name, value) => (kept[name] = machine.keep(value));
    const creepers = terrain.creepers.shape[0];
    const land = [
      keep("solids", terrain.solids), terrain.friction, keep("surface", terrain.surface), keep("spawn", spawn),
      terrain.goal_x, terrain.ground_solids, keep("ceiling", terrain.ceiling), keep("creepers", terrain.creepers),
      keep("holders", terrain.holders), terrain.water_y,
    ];
    const hanging = NO_CHAINS.map((value, index) => keep(`chains${index}`, value));
    const forces = [constants.GRAVITY, push * constants.TIME_STEP];
    const made = machine.call("build", this.built, land, hanging, this.body.settings, forces, this.parts.handles);
    const shapes = machine.copy("i64", made, 0, 1), swinging = machine.copy("i64", made, 2, 2);
    keep("shapes", shapes);
    keep("swinging", swinging);
    const poses = new Float64Array(4 * creepers), rest = terrain.creepers.values;
    for (let index = 0; index < creepers; index++) {
      const at = 4 * index;
      poses.set([(rest[at] + rest[at + 2]) / 2, (rest[at + 1] + rest[at + 3]) / 2, 1], at);
    }
    keep("poses", array("double", [creepers, 4], poses));
    const movable = Array.from(terrain.holders.values, (holder) => (Number(holder) === constants.FIXED ? 0 : 1));
    keep("movable", array("i64", [creepers], movable));
    this.world = { ...kept, terrain };
    const floats = machine.view(this.floats), integers = machine.view(this.integers);
    floats.set([terrain.goal_x, terrain.water_y, 0], constants.GOAL_X);
    floats[constants.BEFORE] = 0;
    const places = ["surface", "ceiling", "creepers", "poses", "movable", "swinging"].map((name) => kept[name]);
    const sizes = places.slice(0, 3).map((place) => place.shape[0]);
    integers.set([...sizes, ...places.map((place) => place.at)].map(BigInt), constants.TERRAIN);
    return this.firstSteps(hangs);
  }

  /** Runs the steps before an episode, which do not count as steps under or outside water. */
  firstSteps(hangs) {
    const action = new Float64Array(this.body.motors + this.body.grips);
    if (hangs) action.fill(1, this.body.motors);
    let observation = null;
    for (let index = 0; index < (hangs ? this.constants.HANGING_STEPS : 1); index++) {
      observation = this.step(action).observation;
      this.view("medium").fill(0n);
    }
    return observation;
  }

  /** Advances the world by one time step. */
  step(action) {
    this.view("action").set(action);
    const [reward, ended] = this.machine.call("step", this.floats, this.integers, this.observed);
    return { observation: this.machine.view(this.observed).slice(), reward, ended: ended !== 0 };
  }

  /** Pushes the head by hand, with an impulse in N s. */
  push(x, y) {
    const head = Number(this.view("handles")[1 + this.body.head]);
    this.machine.call("push", head, x, y);
  }

  /** Returns the spawn point from which the highest grip sensor reaches the ceiling. */
  hung(terrain) {
    const [x, y] = terrain.spawn.values, ceiling = terrain.ceiling.values;
    let above = 0;
    while (ceiling[4 * above + 2] < x) above++;
    return [x, ceiling[4 * above + 1] - this.body.reach];
  }

  release() {
    if (this.world === null) return;
    const { shapes, swinging, terrain, ...others } = this.world;
    this.machine.call("release", this.parts.handles, this.parts.holds, shapes, swinging, this.body.parts);
    for (const kept of [shapes, swinging, ...Object.values(others)]) this.machine.drop(kept);
    this.world = null;
  }
}

/** A trained network that maps observations to actions, with the arithmetic of the students' kernels. */
class Policy {
  constructor(module, stored) {
    this.machine = new Machine(module);
    this.stored = stored;
    const widest = Math.max(...stored.sizes);
    this.weights = this.machine.keep(array("float", [stored.weights.length], stored.weights));
    this.sizes = this.machine.keep(array("i64", [stored.sizes.length], stored.sizes));
    this.work = this.machine.keep(array("float", [2, widest], new Float32Array(2 * widest)));
    this.active = this.machine.keep(array("i64", [widest], new Float64Array(widest)));
    this.inputs = this.machine.keep(array("float", [stored.sizes[0]], new Float32Array(stored.sizes[0])));
  }

  act(observation) {
    const { normaliser, tanh, squash, scale, bounds } = this.stored;
    const inputs = normaliser
      ? observation.map((value, k) => {
          const scaled = (value - normaliser.mean[k]) / normaliser.deviation[k];
          return Math.min(Math.max(scaled, -normaliser.clip), normaliser.clip);
        })
      : observation;
    this.machine.view(this.inputs).set(inputs);
    const { weights, sizes, work, active } = this;
    const made = this.machine.call("network", weights, sizes, work, active, tanh ? 1 : 0, this.inputs);
    let actions = this.machine.copy("float", made, 0, 1).values;
    if (squash) actions = actions.map((value) => Math.tanh(value));
    if (scale) actions = actions.map((value, k) => Math.fround(Math.fround(value * scale.weight[k]) + scale.bias[k]));
    if (bounds) actions = actions.map((value, k) => Math.min(Math.max(value, bounds.low[k]), bounds.high[k]));
    return actions;
  }
}
