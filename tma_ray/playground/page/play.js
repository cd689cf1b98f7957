/* The page: what is played, and the controls that change it. */

const SPEEDS = [0.125, 0.25, 0.5, 1, 2, 4, 8];
const TINTS = ["runner-1", "runner-2", "runner-3", "runner-4"];
const MOST_RUNNERS = TINTS.length;
const KICK = 2.5; /* change of a body's speed by a push, in m/s */

const element = (id) => document.getElementById(id);
const signed = (value, digits = 0) => value.toFixed(digits).replace("-", "−");

/** A body controlled by a policy, in the world that all runners share. */
class Runner {
  constructor(module, page, policy, place) {
    Object.assign(this, { page, policy, place, body: page.body });
    this.engine = new Engine(module, this.body, page.data.constants.engine);
    this.network = policy.weights ? new Policy(module, policy) : null;
    this.medium = page.environment === "parkour";
    this.nothing = page.data.constants.engine.NOTHING;
  }

  reset(terrain, push, seed) {
    this.random = new Random(seed);
    this.observation = this.engine.reset(terrain, push);
    Object.assign(this, { steps: 0, total: 0, over: "" });
  }

  step() {
    if (this.over) return;
    const { MAX_EPISODE_STEPS } = this.page.data.constants.engine;
    const made = this.engine.step(this.action());
    this.observation = made.observation;
    this.total += made.reward;
    this.steps += 1;
    if (made.ended) this.over = this.x > this.page.terrain.goal_x ? "at the goal" : "fell";
    else if (this.steps >= MAX_EPISODE_STEPS) this.over = "time is up";
  }

  action() {
    if (this.network) return this.network.act(this.observation);
    const size = this.body.motors + this.body.grips;
    return Array.from({ length: size }, () => (this.policy.name === "random" ? this.random.uniform(-1, 1) : 0));
  }

  get x() {
    return this.engine.view("state")[6 * this.body.head];
  }

  get dead() {
    return this.medium && this.observation[5] > 0;
  }

  get colour() {
    return colour(TINTS[this.place]);
  }

  get mastered() {
    return this.total > (this.policy.threshold ?? this.page.data.constants.engine.MASTERY_RETURN);
  }
}

class Page {
  constructor(data) {
    this.data = data;
    this.module = new WebAssembly.Module(data.wasm);
    this.worlds = new Worlds(this.module, data.constants, data.cppn);
    this.policies = [...data.policies, { name: "random", label: "untrained", facts: "uniform actions" }];
    this.policies.push({ name: "zero", label: "untrained", facts: "no torque" });
    this.camera = [...Array(MOST_RUNNERS)].map(() => new Camera());
    Object.assign(this, { playing: true, speed: 1, lidars: false, apart: false, heights: null, due: 0, probe: 1 });
    this.plane = new Plane(element("plane"), (values) => this.choose(values));
    const { start } = data;
    this.environment = start.environment;
    this.bodyName = start.embodiment;
    this.seed = start.seed;
    this.chosen = start.policies.map((index) => this.policies.at(index));
    this.task = null;
    this.fillChoices();
    this.prepare(start.task);
    this.bind();
    this.drawn = performance.now();
    requestAnimationFrame((now) => this.frame(now));
  }

  get body() {
    return this.data.bodies[this.bodyName][this.environment];
  }

  /** Dimensions of the task: those of the policy's own space if it was trained here, else the environment's. */
  get space() {
    return this.chosen.find((policy) => this.fits(policy) && policy.space)?.space ?? this.domain;
  }

  get domain() {
    return this.data.spaces[this.environment];
  }

  fits(policy) {
    const { observation, motors, grips } = this.body;
    return !policy.weights || (policy.sizes[0] === observation && policy.sizes.at(-1) === motors + grips);
  }

  /** Creates runners for the chosen policies; `task` is played if it fits the task space. */
  prepare(task = this.task) {
    this.chosen = this.chosen.filter((policy) => this.fits(policy));
    if (!this.chosen.length) this.chosen = [this.policies.find((policy) => this.fits(policy))];
    const { space } = this;
    const middle = space.map(({ low, high }) => low + (high - low) / 2);
    this.task = task && task.length === space.length ? [...task] : middle;
    const free = space.map((_, axis) => axis).filter((axis) => space[axis].high > space[axis].low);
    this.axes = this.environment === "parkour" ? [3, 6] : free.slice(0, 2);
    this.runners?.forEach((runner) => runner.engine.release());
    this.runners = this.chosen.map((policy, place) => new Runner(this.module, this, policy, place));
    this.traced = this.chosen.findIndex((policy) => policy.tests?.length);
    this.probe = 1;
    this.fillPanel(free);
    this.restart();
  }

  restart() {
    const random = new Random(this.seed), { PUSH } = this.data.constants.engine;
    const push = random.uniform(-PUSH, PUSH);
    this.terrain = this.heights
      ? this.worlds.drawn(this.environment, this.heights)
      : this.worlds.build(this.environment, this.task, random);
    this.runners.forEach((runner) => runner.reset(this.terrain, push, this.seed));
    this.camera.forEach((camera) => (camera.x = null));
    this.due = 0;
    this.show();
  }

  choose(values) {
    values.forEach(([axis, value]) => (this.task[axis] = value));
    this.heights = null;
    this.restart();
  }

  another() {
    const random = new Random((this.seed += 1));
    this.choose(this.space.map(({ low, high }, axis) => [axis, random.uniform(low, high)]));
  }

  /** Adds or removes a policy; one that does not fit the body is shown alone, with its own body. */
  toggle(policy) {
    const others = this.chosen.filter((each) => each !== policy);
    if (!this.fits(policy)) {
      this.environment = policy.environment;
      this.bodyName = policy.embodiment;
      this.chosen = [policy];
      this.heights = null;
    } else if (others.length < this.chosen.length) this.chosen = others.length ? others : this.chosen;
    else this.chosen = [...others, policy].slice(-MOST_RUNNERS);
    this.prepare();
  }

  frame(now) {
    const seconds = Math.min((now - this.drawn) / 1000, 0.1);
    this.drawn = now;
    if (this.playing) {
      this.due += (seconds * this.speed) / this.data.constants.engine.TIME_STEP;
      for (; this.due >= 1; this.due -= 1) this.runners.forEach((runner) => runner.step());
    }
    this.draw();
    requestAnimationFrame((next) => this.frame(next));
  }

  draw() {
    const { context, width, height } = fitted(element("world"));
    const lanes = this.apart ? this.runners.map((runner) => [runner]) : [this.runners];
    lanes.forEach((lane, index) => {
      const still = lane.filter((runner) => !runner.over);
      const leader = (still.length ? still : lane).reduce((a, b) => (b.x > a.x ? b : a));
      const state = leader.engine.view("state"), at = 6 * leader.body.head;
      const room = { left: 0, top: (index * height) / lanes.length, width, height: height / lanes.length };
      this.camera[index].follow(state[at], state[at + 1], room);
      const look = { lidars: this.lidars, names: this.runners.length > 1 };
      drawWorld(context, this.camera[index], this.terrain, lane, look);
    });
    if (this.drag) this.drawDrag(context);
    this.tell();
  }

  drawDrag(context) {
    const { from, to } = this.drag;
    context.strokeStyle = colour("goal");
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    context.stroke();
  }

  /** Pushes `runners`, by default all, changing their velocity by (x, y) in m/s. */
  push(x, y, runners = this.runners) {
    runners.filter((runner) => !runner.over).forEach((runner) => {
      const mass = runner.body.built.mass[2].reduce((sum, each) => sum + each, 0);
      runner.engine.push(mass * x, mass * y);
    });
  }

  /** Moves the ground to the line between two positions of the pointer. */
  sketch(from, to) {
    const { STEP, GROUND_HEIGHT, STARTPAD_STEPS } = this.data.constants.engine;
    const { TRACK_POINTS } = this.data.constants.parkour;
    this.heights ??= Array.from({ length: TRACK_POINTS }, (_, point) =>
      point < STARTPAD_STEPS ? GROUND_HEIGHT : groundAt(this.terrain, point * STEP));
    const [a, b] = from[0] < to[0] ? [from, to] : [to, from];
    for (let point = Math.round(a[0] / STEP); point <= Math.round(b[0] / STEP); point++) {
      if (point <= STARTPAD_STEPS || point >= TRACK_POINTS) continue;
      const share = b[0] > a[0] ? Math.min(Math.max((point * STEP - a[0]) / (b[0] - a[0]), 0), 1) : 1;
      this.heights[point] = a[1] + share * (b[1] - a[1]);
    }
    this.terrain = this.worlds.drawn(this.environment, this.heights);
  }

  /* The panel */

  fillChoices() {
    const options = (values, chosen) =>
      values.map((value) => Object.assign(new Option(spoken(value), value), { selected: value === chosen }));
    element("environment").replaceChildren(...options(Object.keys(this.data.spaces), this.environment));
    const [own] = this.bodyName.split(":");
    const names = Object.keys(this.data.bodies).filter((name) => !name.includes(":"));
    element("body").replaceChildren(...options(names, own));
    const sizes = Object.keys(this.data.bodies).filter((name) => name.startsWith(`${own}:`));
    const labels = [own, ...sizes].map((name) => new Option(name.slice(own.length + 1).replace("=", " ") || "as drawn", name));
    element("size").replaceChildren(...labels);
    element("size").value = this.bodyName;
    element("size").disabled = !sizes.length;
  }

  fillPanel(free) {
    this.fillChoices();
    element("policies").replaceChildren(...this.policies.map((policy) => this.policyRow(policy)));
    const { space } = this, sliders = element("sliders");
    sliders.replaceChildren(...free.map((axis) => this.slider(space[axis], axis)));
    for (const id of ["across", "up"]) {
      const chooser = element(id);
      chooser.replaceChildren(...free.map((axis) => new Option(spoken(space[axis].name), axis)));
      chooser.value = this.axes[id === "up" ? 1 : 0];
    }
    element("axes").hidden = free.length < 3;
    const traced = this.chosen[this.traced];
    element("time").hidden = !traced?.curriculum.length;
    element("legend").hidden = !traced;
    if (traced) element("traced").textContent = `${traced.label}, seed ${traced.seed}`;
    element("sketch").setAttribute("aria-pressed", "false");
  }

  policyRow(policy) {
    const row = document.createElement("button"), place = this.chosen.indexOf(policy);
    row.type = "button";
    row.className = "policy";
    row.setAttribute("aria-pressed", String(place >= 0));
    const dot = document.createElement("i");
    if (place >= 0) dot.style.background = `var(--${TINTS[place]})`;
    const name = document.createElement("b"), facts = document.createElement("span");
    name.textContent = policy.label;
    const share = policy.mastered === null ? "" : ` · masters ${policy.mastered}%`;
    facts.textContent = policy.facts ?? `seed ${policy.seed}${share}`;
    if (!this.fits(policy)) facts.textContent = spoken(policy.embodiment);
    row.title = policy.weights ? `${policy.student}, challenge ${spoken(policy.challenge)}, run ${policy.name}` : "";
    const state = document.createElement("em");
    state.dataset.place = place;
    row.append(dot, name, facts, state);
    row.addEventListener("click", () => this.toggle(policy));
    return row;
  }

  slider({ name, low, high, unit }, axis) {
    const label = document.createElement("label"), input = document.createElement("input");
    const value = document.createElement("output");
    Object.assign(input, { type: "range", min: low, max: high, step: (high - low) / 200, value: this.task[axis] });
    input.dataset.axis = axis;
    const title = document.createElement("span");
    title.textContent = spoken(name);
    label.title = unit;
    label.append(title, value, input);
    input.addEventListener("input", () => this.choose([[axis, Number(input.value)]]));
    return label;
  }

  /** Shows the task in the sliders and the plane. */
  show() {
    for (const input of element("sliders").querySelectorAll("input")) {
      input.value = this.task[input.dataset.axis];
      input.previousSibling.textContent = signed(this.task[input.dataset.axis], 2);
    }
    const traced = this.chosen[this.traced], probes = traced?.curriculum ?? [];
    const shown = probes[Math.round(this.probe * (probes.length - 1))];
    element("probe").value = this.probe;
    element("step-shown").textContent = shown ? `${(shown.step / 1e6).toFixed(2)} M steps` : "";
    this.plane.draw({
      space: this.space,
      axes: this.axes,
      tests: traced?.tests ?? [],
      mastered: traced?.tests_mastered ?? [],
      curriculum: shown?.tasks ?? [],
      tint: colour(TINTS[Math.max(this.traced, 0)]),
      task: this.task,
    });
    element("seed").textContent = `world ${this.seed}`;
    element("clear").hidden = !this.heights;
  }

  /** Shows the return, steps and outcome of each runner. */
  tell() {
    for (const cell of element("policies").querySelectorAll("em")) {
      const runner = this.runners[cell.dataset.place];
      if (!runner) continue;
      const verdict = runner.mastered ? "mastered" : runner.over || "not mastered";
      const text = `return ${signed(runner.total)} · step ${runner.steps} · ${verdict}`;
      if (cell.textContent !== text) cell.textContent = text;
      cell.className = runner.mastered ? "good" : runner.over ? "over" : "";
    }
  }

  set(name, value) {
    this[name] = value;
    element("play").textContent = this.playing ? "Pause" : "Play";
    element("speed").textContent = `${this.speed} ×`;
    for (const id of ["lidars", "apart"]) element(id).setAttribute("aria-pressed", String(this[id]));
  }

  faster(notches) {
    const index = SPEEDS.indexOf(this.speed) + notches;
    this.set("speed", SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)]);
  }

  get sketching() {
    return element("sketch").getAttribute("aria-pressed") === "true";
  }

  bind() {
    const acts = {
      play: () => this.set("playing", !this.playing),
      step: () => (this.set("playing", false), this.runners.forEach((runner) => runner.step())),
      again: () => this.restart(),
      another: () => this.another(),
      slower: () => this.faster(-1),
      faster: () => this.faster(1),
      lidars: () => this.set("lidars", !this.lidars),
      apart: () => this.set("apart", !this.apart),
      "push-back": () => this.push(-KICK, 0),
      "push-on": () => this.push(KICK, 0),
      sketch: () => {
        element("sketch").setAttribute("aria-pressed", String(!this.sketching));
        element("world").classList.toggle("sketching", this.sketching);
      },
      clear: () => ((this.heights = null), this.restart()),
    };
    for (const [id, act] of Object.entries(acts)) element(id).addEventListener("click", act);
    const keys = {
      " ": "play", s: "step", r: "again", n: "another", "-": "slower", "+": "faster", "=": "faster", l: "lidars",
      o: "apart", d: "sketch", ArrowLeft: "push-back", ArrowRight: "push-on",
    };
    document.addEventListener("keydown", (event) => {
      const typed = event.target.matches("select, input") || event.ctrlKey || event.metaKey || event.altKey;
      const id = keys[event.key] ?? keys[event.key.toLowerCase()];
      if (typed || !id || (event.key === " " && event.target.matches("button"))) return;
      event.preventDefault();
      acts[id]();
    });
    const change = (id, act) => element(id).addEventListener("input", (event) => act(event.target.value));
    change("environment", (value) => this.move(value, this.bodyName));
    change("body", (value) => this.move(this.environment, value));
    change("size", (value) => this.move(this.environment, value));
    change("probe", (value) => ((this.probe = Number(value)), this.show()));
    change("across", (value) => ((this.axes[0] = Number(value)), this.show()));
    change("up", (value) => ((this.axes[1] = Number(value)), this.show()));
    new ResizeObserver(() => this.show()).observe(element("plane"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.prepare());
    this.bindWorld(element("world"));
    this.set("playing", this.playing);
  }

  move(environment, body) {
    Object.assign(this, { environment, bodyName: body, heights: null });
    this.prepare();
  }

  /** Handles drags on the picture, which push the nearest body or draw the ground. */
  bindWorld(canvas) {
    const at = (event) => [event.offsetX, event.offsetY];
    const lane = ([, y]) => {
      const index = Math.floor((y / canvas.clientHeight) * (this.apart ? this.runners.length : 1));
      return Math.min(Math.max(index, 0), this.runners.length - 1);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.drag = { from: at(event), to: at(event) };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.drag) return;
      const camera = this.camera[lane(this.drag.from)];
      if (this.sketching) {
        this.sketch(camera.metres(...this.drag.to), camera.metres(...at(event)));
        this.drag.from = this.drag.to;
      }
      this.drag.to = at(event);
    });
    canvas.addEventListener("pointercancel", () => (this.drag = null));
    canvas.addEventListener("pointerup", () => {
      if (!this.drag) return;
      const { from, to } = this.drag, index = lane(from), camera = this.camera[index];
      this.drag = null;
      if (this.sketching) return void (this.heights && this.restart());
      const [x, y] = camera.metres(...from), reach = (to[0] - from[0]) / camera.scale, lift = (from[1] - to[1]) / camera.scale;
      const candidates = this.apart ? [this.runners[index]] : this.runners;
      const far = (runner) => {
        const state = runner.engine.view("state"), head = 6 * runner.body.head;
        return Math.hypot(state[head] - x, state[head + 1] - y);
      };
      const nearest = candidates.reduce((a, b) => (far(b) < far(a) ? b : a));
      if (Math.hypot(reach, lift) > 0.15) this.push(2 * reach, 2 * lift, [nearest]);
    });
  }
}

/** Unpacks the data that tma_ray.playground.page packed into the page. */
async function unpacked() {
  const packed = Uint8Array.from(atob(element("data").textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const all = new Uint8Array(await new Response(stream).arrayBuffer());
  const end = 4 + new DataView(all.buffer).getUint32(0, true);
  return JSON.parse(new TextDecoder().decode(all.subarray(4, end)), (_, value) => {
    if (!value?.array) return value;
    const [at, count, width] = value.array, bytes = new Uint8Array(count * width);
    for (let k = 0; k < bytes.length; k++) bytes[k] = all[end + at + (k % width) * count + Math.floor(k / width)];
    return width === 1 ? bytes : new Float32Array(bytes.buffer);
  });
}

unpacked().then(
  (data) => (window.playground = new Page(data)),
  (error) => (element("trouble").textContent = `This browser cannot run the playground: ${error.message}`),
);
