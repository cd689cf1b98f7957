/* Drawing of worlds with bodies, and of the plane of tasks. Colours are variables of style.css. */

const WIDEST = 21, NARROWEST = 9, LOWEST = 6, METRE = 42; /* sizes of a view in metres, and pixels per metre */

const shades = new Map();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => shades.clear());

/** Returns a colour of the current mode, light or dark, by name. */
const colour = (name) => {
  if (!shades.has(name))
    shades.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return shades.get(name);
};

/** Fits a canvas to its size on the page; returns its context and size, in CSS pixels. */
function fitted(canvas) {
  const { width, height } = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}

/** A view of a world, which maps metres to pixels of the canvas. */
class Camera {
  constructor() {
    this.x = null;
  }

  /** Follows a point; `room` is the area of the canvas. */
  follow(x, y, room) {
    const wide = Math.min(Math.max(room.width / METRE, NARROWEST), WIDEST);
    this.scale = Math.min(room.width / wide, room.height / LOWEST);
    const metres = room.width / this.scale;
    this.room = room;
    const goal = [x + 0.12 * metres, y + 0.11 * (room.height / this.scale)];
    const ease = this.x === null || Math.abs(goal[0] - this.x) > metres ? 1 : 0.15;
    this.x = (this.x ?? goal[0]) + ease * (goal[0] - (this.x ?? goal[0]));
    this.y = (this.y ?? goal[1]) + ease * (goal[1] - (this.y ?? goal[1]));
  }

  place(x, y) {
    const { left, top, width, height } = this.room;
    return [left + width / 2 + (x - this.x) * this.scale, top + height / 2 - (y - this.y) * this.scale];
  }

  metres(left, top) {
    const { room } = this;
    return [
      this.x + (left - room.left - room.width / 2) / this.scale,
      this.y - (top - room.top - room.height / 2) / this.scale,
    ];
  }
}

/** Draws the world that `runners` share, in the view of `camera`. */
function drawWorld(context, camera, terrain, runners, look) {
  const { left, top, width, height } = camera.room;
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  const sky = context.createLinearGradient(0, top, 0, top + height);
  sky.addColorStop(0, colour("sky-top"));
  sky.addColorStop(1, colour("sky-bottom"));
  context.fillStyle = sky;
  context.fillRect(left, top, width, height);
  const water = terrain.water_y > -1e6 ? camera.place(0, terrain.water_y)[1] : Infinity;
  drawGoal(context, camera, terrain);
  for (let index = 0; index < terrain.creepers.shape[0]; index++) {
    const [x0, y0, x1, y1] = terrain.creepers.values.subarray(4 * index, 4 * index + 4);
    const [a, b] = camera.place(x0, y1), [c, d] = camera.place(x1, y0);
    context.fillStyle = colour("creeper");
    if (c > left && a < left + width) context.fillRect(a, b, c - a, d - b);
  }
  drawSolid(context, camera, terrain.surface, top + height, colour("soil"), colour("soil-edge"));
  drawSolid(context, camera, terrain.ceiling, top, colour("rock"), colour("rock-edge"));
  drawMarks(context, camera, terrain);
  const behind = [...runners].sort((a, b) => a.x - b.x);
  for (const runner of behind) if (look.lidars) drawLidars(context, camera, runner);
  behind.forEach((runner) => drawBody(context, camera, runner));
  if (water < top + height) {
    context.fillStyle = colour("water");
    context.fillRect(left, Math.max(water, top), width, top + height - Math.max(water, top));
  }
  if (look.names) behind.forEach((runner) => drawName(context, camera, runner));
  context.restore();
}

function drawSolid(context, camera, surface, edge, fill, line) {
  const { left, width } = camera.room, points = [];
  for (let index = 0; index < surface.shape[0]; index++) {
    const [x0, y0, x1, y1] = surface.values.subarray(4 * index, 4 * index + 4);
    const start = camera.place(x0, y0), end = camera.place(x1, y1);
    if (end[0] >= left - 2 && start[0] <= left + width + 2) points.push(...(points.length ? [end] : [start, end]));
  }
  if (!points.length) return;
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.strokeStyle = line;
  context.lineWidth = 2;
  context.stroke();
  context.lineTo(points.at(-1)[0], edge);
  context.lineTo(points[0][0], edge);
  context.fillStyle = fill;
  context.fill();
}

/** Returns the height of the ground at `x`. */
function groundAt(terrain, x) {
  const { shape, values } = terrain.surface;
  for (let at = 0; at < 4 * shape[0]; at += 4)
    if (values[at + 2] >= x && values[at + 2] > values[at]) {
      const share = (x - values[at]) / (values[at + 2] - values[at]);
      return values[at + 1] + Math.max(share, 0) * (values[at + 3] - values[at + 1]);
    }
  return values.at(-1);
}

function drawMarks(context, camera, terrain) {
  const [first] = camera.metres(camera.room.left, 0), [last] = camera.metres(camera.room.left + camera.room.width, 0);
  context.fillStyle = colour("mark");
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "center";
  for (let mark = Math.max(0, 5 * Math.ceil(first / 5)); mark <= last; mark += 5) {
    const [x, y] = camera.place(mark, groundAt(terrain, mark));
    context.fillText(`${mark} m`, x, y + 17);
  }
}

function drawGoal(context, camera, terrain) {
  const foot = camera.place(terrain.goal_x, groundAt(terrain, terrain.goal_x)), top = foot[1] - 3.2 * camera.scale;
  context.strokeStyle = colour("outline");
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(...foot);
  context.lineTo(foot[0], top);
  context.stroke();
  context.fillStyle = colour("goal");
  context.beginPath();
  context.moveTo(foot[0], top);
  context.lineTo(foot[0] + camera.scale, top + 0.35 * camera.scale);
  context.lineTo(foot[0], top + 0.7 * camera.scale);
  context.fill();
}

function drawBody(context, camera, runner) {
  const { body } = runner, vertices = body.built.vertices[2], first = body.built.first_vertex[2];
  const state = runner.engine.view("state"), dead = runner.dead;
  context.lineWidth = 1.2;
  context.lineJoin = "round";
  const order = [...Array(body.parts).keys()].sort((a, b) => (a === body.head) - (b === body.head) || b - a);
  for (const part of order) {
    const [x, y, angle] = state.subarray(6 * part, 6 * part + 3);
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    context.beginPath();
    for (let corner = first[part]; corner < first[part + 1]; corner++) {
      const [u, v] = [vertices[2 * corner], vertices[2 * corner + 1]];
      context.lineTo(...camera.place(x + cosine * u - sine * v, y + sine * u + cosine * v));
    }
    context.closePath();
    context.fillStyle = dead ? colour("dead") : runner.colour;
    context.globalAlpha = part === body.head ? 1 : 0.78;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour("outline");
    context.stroke();
  }
  const grips = runner.engine.view("grips");
  body.sensors.forEach(([part, u, v, radius], sensor) => {
    const [x, y, angle] = state.subarray(6 * part, 6 * part + 3);
    const [touches, holds] = [grips[2 * sensor], grips[2 * sensor + 1]].map((each) => Number(each) !== runner.nothing);
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    const centre = camera.place(x + cosine * u - sine * v, y + sine * u + cosine * v);
    context.fillStyle = colour(holds ? "holding" : touches ? "touching" : "free");
    context.beginPath();
    context.arc(...centre, Math.max(3.5, radius * camera.scale), 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  });
}

function drawLidars(context, camera, runner) {
  const { rays } = runner.body, [x, y] = runner.engine.view("state").subarray(6 * runner.body.head);
  const seen = runner.observation, wide = runner.medium ? 2 : 1, start = seen.length - wide * rays.length;
  rays.forEach(([u, v], ray) => {
    const share = seen[start + ray], kind = runner.medium ? seen[start + rays.length + ray] : 0;
    const end = camera.place(x + share * u, y + share * v);
    context.strokeStyle = context.fillStyle = colour(kind > 0 ? "lidar-creeper" : kind < 0 ? "lidar-water" : "lidar");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(...camera.place(x, y));
    context.lineTo(...end);
    context.stroke();
    context.fillRect(end[0] - 2, end[1] - 2, 4, 4);
  });
}

function drawName(context, camera, runner) {
  const [x, y] = runner.engine.view("state").subarray(6 * runner.body.head);
  const [left, top] = camera.place(x, y);
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "center";
  context.lineWidth = 3;
  context.strokeStyle = colour("halo");
  context.fillStyle = runner.colour;
  const height = Math.max(top - 0.9 * camera.scale - 15 * runner.place, camera.room.top + 14 + 15 * runner.place);
  context.strokeText(runner.policy.label, left, height);
  context.fillText(runner.policy.label, left, height);
}

const INSET = { left: 40, right: 12, top: 10, bottom: 34 };

/** Plane of two task dimensions, with the curriculum, the mastered test tasks and the task that is played. */
class Plane {
  constructor(canvas, choose) {
    this.canvas = canvas;
    const drag = (event) => {
      if (!this.space || (event.type === "pointermove" && !event.buttons)) return;
      if (event.type === "pointerdown") canvas.setPointerCapture(event.pointerId);
      const box = canvas.getBoundingClientRect(), { left, right, top, bottom } = INSET;
      const shares = [
        (event.clientX - box.left - left) / (box.width - left - right),
        1 - (event.clientY - box.top - top) / (box.height - top - bottom),
      ].map((share) => Math.min(Math.max(share, 0), 1));
      choose(this.axes.map((axis, index) => [axis, this.value(axis, shares[index])]));
    };
    canvas.addEventListener("pointerdown", drag);
    canvas.addEventListener("pointermove", drag);
  }

  value(axis, share) {
    const { low, high } = this.space[axis];
    return low + share * (high - low);
  }

  /** Draws two dimensions of `space`, the `tests` and `curriculum` of a policy, and the `task` that is played. */
  draw({ space, axes, tests, mastered, curriculum, tint, task }) {
    Object.assign(this, { space, axes });
    const { context, width, height } = fitted(this.canvas);
    const share = (axis, value) => (value - space[axis].low) / (space[axis].high - space[axis].low || 1);
    const inner = [width - INSET.left - INSET.right, height - INSET.top - INSET.bottom];
    const place = (each) => [
      INSET.left + share(axes[0], each[axes[0]]) * inner[0],
      INSET.top + (1 - share(axes[1], each[axes[1]])) * inner[1],
    ];
    context.clearRect(0, 0, width, height);
    context.fillStyle = colour("paper");
    context.fillRect(INSET.left, INSET.top, ...inner);
    const dot = (each, radius, fill, line) => {
      context.beginPath();
      context.arc(...place(each), radius, 0, 2 * Math.PI);
      if (fill) context.fill();
      if (line) context.stroke();
    };
    context.save();
    context.beginPath();
    context.rect(INSET.left - 7, INSET.top - 7, inner[0] + 14, inner[1] + 14);
    context.clip();
    context.fillStyle = colour("mastered");
    context.strokeStyle = colour("faint");
    context.lineWidth = 1;
    tests.forEach((each, index) => dot(each, 4.5, mastered[index], !mastered[index]));
    context.fillStyle = tint;
    context.globalAlpha = 0.55;
    curriculum.forEach((each) => dot(each, 2.4, true, false));
    context.globalAlpha = 1;
    context.strokeStyle = colour("ink");
    context.lineWidth = 2.5;
    dot(task, 7, false, true);
    context.restore();
    context.strokeStyle = colour("line");
    context.lineWidth = 1;
    context.strokeRect(INSET.left, INSET.top, ...inner);
    context.fillStyle = colour("soft");
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    const [x, y] = axes.map((axis) => space[axis]), number = (value) => String(+value.toPrecision(3)).replace("-", "−");
    context.fillText(spoken(x.name), INSET.left + inner[0] / 2, height - 6);
    context.fillText(number(x.low), INSET.left, height - 20);
    context.fillText(number(x.high), INSET.left + inner[0], height - 20);
    context.textAlign = "right";
    context.fillText(number(y.high), INSET.left - 5, INSET.top + 9);
    context.fillText(number(y.low), INSET.left - 5, INSET.top + inner[1]);
    context.translate(11, INSET.top + inner[1] / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(spoken(y.name), 0, 0);
  }
}

/** Returns an identifier with spaces in place of underscores. */
const spoken = (name) => name.replaceAll("_", " ");
