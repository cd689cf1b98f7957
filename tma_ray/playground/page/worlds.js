/* Worlds of tasks: random details are drawn here, terrain is laid out by the kernels of tma_ray.terrain. */

/** Seeded generator of random numbers, not numpy's: the same seed gives another world than in Python. */
class Random {
  constructor(seed) {
    this.state = seed >>> 0;
  }

  uniform(low = 0, high = 1) {
    this.state = (this.state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(this.state ^ (this.state >>> 15), this.state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return low + (high - low) * (((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32);
  }

  normal(mean, deviation) {
    const radius = Math.sqrt(-2 * Math.log(1 - this.uniform()));
    return mean + deviation * radius * Math.cos(2 * Math.PI * this.uniform());
  }
}

const EMPTY = array("double", [0, 4], []);

class Worlds {
  constructor(module, constants, cppn) {
    this.machine = new Machine(module);
    this.constants = constants;
    this.cppn = cppn;
  }

  /** Returns the world of a task of `environment`, with random details drawn from `random`. */
  build(environment, task, random) {
    return environment === "parkour" ? this.parkour(task, random) : this.stumpTracks(task, random);
  }

  /** Returns a world whose ground was drawn by hand, with one height per terrain step from x = 0 on. */
  drawn(environment, heights) {
    const { STEP } = this.constants.engine, { GOAL_X, FRICTION } = this.constants[environment];
    const solid = this.columns(heights, heights.map((height) => height + 100));
    const grounds = solid.surface.shape[0];
    const ground = array("double", [grounds, 4, 2], solid.solids.values.subarray(0, 8 * grounds));
    const water = environment === "parkour" ? heights[0] - 40 : -Infinity;
    return this.terrain(ground, solid.surface, GOAL_X, water, FRICTION, Math.floor(GOAL_X / STEP));
  }

  stumpTracks([mean, gap], random) {
    const own = this.constants.stump_tracks, { TRACK_LENGTH, FIRST_STUMP, STUMP_WIDTH, STUMP_HEIGHT_STD } = own;
    const spacing = Math.max(own.MINIMUM_SPACING, gap);
    const count = Math.trunc((TRACK_LENGTH - FIRST_STUMP + spacing) / (STUMP_WIDTH + spacing));
    const heights = Array.from({ length: count }, () => random.normal(Math.max(0, mean), STUMP_HEIGHT_STD));
    return this.stumps(heights, spacing);
  }

  /** Returns Stump Tracks with stumps of `heights` in terrain steps. */
  stumps(heights, spacing) {
    const own = this.constants.stump_tracks;
    const kept = this.machine.keep(array("double", [heights.length], heights));
    const made = this.machine.call("stump_tracks", kept, spacing);
    const [solids, surface] = [this.machine.copy("double", made, 0, 3), this.machine.copy("double", made, 4, 2)];
    this.machine.drop(kept);
    return this.terrain(solids, surface, own.GOAL_X, -Infinity, own.FRICTION);
  }

  parkour(task, random) {
    const own = this.constants.parkour, { STEP, GROUND_HEIGHT, STARTPAD_STEPS } = this.constants.engine;
    const [level, width, mean, gap, delta] = task.slice(3);
    const curves = this.curves(task.slice(0, 3));
    const track = (side, start) =>
      Array.from({ length: own.TRACK_POINTS }, (_, point) => {
        const at = Math.max(point - STARTPAD_STEPS, 0);
        return start + (curves[at][side] - curves[0][side]) / delta;
      });
    const ground = track(0, GROUND_HEIGHT);
    const ceiling = track(1, GROUND_HEIGHT + own.CEILING_OFFSET / delta).map((y, x) => Math.max(y, ground[x]));
    const { solids, surface, underside } = this.columns(ground, ceiling);
    const order = own.INSERTION_ORDER, shuffled = new Float64Array(solids.values.length);
    order.forEach((from, to) => shuffled.set(solids.values.subarray(8 * from, 8 * from + 8), 8 * to));
    const over = Math.max(1, Math.trunc(Math.max(own.MINIMUM_CREEPER_WIDTH, width) / STEP));
    const period = Math.ceil(Math.max(own.MINIMUM_CREEPER_SPACING, gap) / STEP) + 1;
    const creepers = [];
    for (let point = 0; point < own.TRACK_POINTS - over; point += period) {
      const height = Math.max(own.MINIMUM_CREEPER_HEIGHT, random.normal(mean, own.CREEPER_HEIGHT_STD));
      const top = Math.max(ceiling[point], ceiling[point + over]), left = point * STEP;
      creepers.push(left, top - height, left + Math.max(own.MINIMUM_CREEPER_WIDTH, width), top);
    }
    const bottom = own.GROUND_LIMIT / delta;
    const water = bottom + Math.max(own.MINIMUM_WATER_LEVEL, level) * (Math.max(...ceiling) - bottom);
    const terrain = this.terrain({ ...solids, values: shuffled }, surface, own.GOAL_X, water, own.FRICTION);
    const count = creepers.length / 4, holders = new Array(count).fill(this.constants.engine.FIXED);
    return {
      ...terrain,
      ground_solids: surface.shape[0],
      ceiling: underside,
      creepers: array("double", [count, 4], Float64Array.from(creepers)),
      holders: array("i64", [count], holders),
    };
  }

  /** Returns the network's curves (200, 2), equal to Python's up to float32 rounding. */
  curves(theta) {
    const { POINTS } = this.constants.parkour;
    const soft = (value) => Math.log1p(Math.exp(-Math.abs(value))) + Math.max(value, 0);
    const bends = [Math.tanh, soft, Math.tanh, soft, (value) => value];
    return Array.from({ length: POINTS }, (_, point) => {
      let signal = [point / (POINTS - 1), ...theta];
      this.cppn.forEach(([[inputs, outputs], values], layer) => {
        const sums = new Float64Array(outputs);
        for (let i = 0; i < inputs; i++) for (let j = 0; j < outputs; j++) sums[j] += signal[i] * values[i * outputs + j];
        signal = sums.map(bends[layer]);
      });
      return signal;
    });
  }

  columns(ground, ceiling) {
    const kept = [ground, ceiling].map((heights) => this.machine.keep(array("double", [heights.length], heights)));
    const made = this.machine.call("parkour", ...kept);
    const solids = this.machine.copy("double", made, 0, 3), surface = this.machine.copy("double", made, 4, 2);
    const underside = this.machine.copy("double", made, 7, 2);
    kept.forEach((each) => this.machine.drop(each));
    return { solids, surface, underside };
  }

  terrain(solids, surface, goal, water, friction) {
    const { STARTPAD_STEPS, STEP, GROUND_HEIGHT } = this.constants.engine;
    const spawn = array("double", [2], [(STARTPAD_STEPS * STEP) / 2, GROUND_HEIGHT]);
    return {
      solids, friction, surface, spawn, goal_x: goal, ground_solids: solids.shape[0],
      ceiling: EMPTY, creepers: EMPTY, holders: array("i64", [0], []), water_y: water,
    };
  }
}
