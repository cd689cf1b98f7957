/* Does in node what a page does: `node replay.js SCRIPTS WASM FILE...` prints a line of JSON for each file. */

/** Plays recorded episodes again; returns how far apart each one gets, and whether all else is the same. */
function replay(Engine, module, { body, constants, episodes }) {
  const engine = new Engine(module, body, constants);
  const whole = (value) => (Array.isArray(value) ? { kind: value[0], shape: value[1], values: value[2] } : value);
  return episodes.map((episode) => {
    const terrain = Object.fromEntries(Object.entries(episode.terrain).map(([name, value]) => [name, whole(value)]));
    terrain.water_y ??= -Infinity;
    const furthest = (a, b) => Math.max(...Array.from(a, (value, index) => Math.abs(value - b[index])));
    let observed = furthest(engine.reset(terrain, episode.push), episode.first);
    let state = 0, reward = 0, ending = true;
    episode.actions.forEach((action, index) => {
      const made = engine.step(action), expected = episode.steps[index];
      state = Math.max(state, furthest(engine.view("state"), expected.state));
      observed = Math.max(observed, furthest(made.observation, expected.observation));
      reward = Math.max(reward, Math.abs(made.reward - expected.reward));
      ending = ending && made.ended === expected.ended;
    });
    return { steps: episode.steps.length, state, observed, reward, ending };
  });
}

if (typeof process !== "undefined") {
  const fs = require("fs"), [scripts, wasm, ...files] = process.argv.slice(2);
  const text = `${fs.readFileSync(scripts, "utf8")}; return { Engine, Policy, Worlds };`;
  const { Engine, Policy, Worlds } = new Function(text)();
  const module = new WebAssembly.Module(fs.readFileSync(wasm));
  for (const file of files) {
    const content = JSON.parse(fs.readFileSync(file, "utf8"));
    let said = null;
    if (content.episodes) said = replay(Engine, module, content);
    else if (content.policy) {
      const policy = new Policy(module, content.policy);
      said = content.observations.map((each) => Array.from(policy.act(Float32Array.from(each))));
    } else {
      const given = { normal: () => content.drawn.shift() };
      said = new Worlds(module, content.constants, content.worlds.cppn).build(content.name, content.task, given);
    }
    const plain = (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);
    console.log(JSON.stringify(said, plain));
  }
}
