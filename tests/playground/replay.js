/* Plays recorded episodes again: `node replay.js ENGINE_JS WASM FILE...` prints how far apart each one gets. */

/** Returns the largest differences of an episode's states, and whether all else is the same. */
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
    return { steps: episode.steps.length, ended: episode.steps.at(-1).ended, state, observed, reward, ending };
  });
}

if (typeof process !== "undefined" && process.argv[1]?.endsWith("replay.js")) {
  const fs = require("fs"), [script, wasm, ...files] = process.argv.slice(2);
  const { Engine } = new Function(`${fs.readFileSync(script, "utf8")}; return { Engine };`)();
  const module = new WebAssembly.Module(fs.readFileSync(wasm));
  for (const file of files) console.log(JSON.stringify(replay(Engine, module, JSON.parse(fs.readFileSync(file, "utf8")))));
}
